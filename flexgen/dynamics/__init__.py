"""Equations of motion, their friction and hysteresis, and inverse dynamics as a DAE."""
