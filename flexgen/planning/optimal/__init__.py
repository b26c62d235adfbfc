"""Optimal control with costs and constraints of the user: collocation as an object."""
