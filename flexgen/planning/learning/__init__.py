"""Iterative learning along a path."""
