"""Performance of a robot: minimum time, iterative learning, identification of the load."""
