"""Paths of the output: geometry, time laws and move planning."""
