"""What a robot can do: minimum time, iterative learning, identification of the load."""
