"""Frictions with a state, in addition to the equations of motion."""
