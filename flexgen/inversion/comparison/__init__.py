"""Methods of inverse dynamics for comparison: integration of the DAE after index reduction,
optimization on a grid.
"""
