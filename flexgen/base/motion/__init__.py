"""Sampled motions and what is between their samples."""
