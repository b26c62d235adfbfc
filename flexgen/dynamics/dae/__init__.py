"""Inverse dynamics as a differential-algebraic equation (DAE)."""
