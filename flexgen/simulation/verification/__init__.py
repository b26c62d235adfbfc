"""Residual and growth of errors of a motion."""
