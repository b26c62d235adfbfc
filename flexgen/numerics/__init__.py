"""Numerical methods that know no robot."""
