"""Model files: reading and checking the description of a robot."""
