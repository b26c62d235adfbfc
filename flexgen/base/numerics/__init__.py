"""Numerical methods, independent of robots."""
