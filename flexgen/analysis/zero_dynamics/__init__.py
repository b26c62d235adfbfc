"""Zeros, zero dynamics and solvability of the inverse dynamics."""
