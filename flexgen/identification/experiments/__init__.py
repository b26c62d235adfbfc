"""Planned and simulated experiments, and their spectra."""
