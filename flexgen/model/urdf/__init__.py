"""Robots in URDF, and the overlay with what URDF cannot contain."""
