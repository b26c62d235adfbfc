"""The position servo of a robot: its gains, filters and keys; knows no robot."""
