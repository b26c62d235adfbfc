"""The functions of the equations by recursions specialized to one robot."""
