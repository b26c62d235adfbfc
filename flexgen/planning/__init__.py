"""Optimal control, shortest time and learning along a path."""
