"""Calibration: from tracked positions at rest to lengths, zeros, springs and masses of a tree of
bodies.
"""
