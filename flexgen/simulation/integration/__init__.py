"""Integrators of the full model, in C and in Python."""
