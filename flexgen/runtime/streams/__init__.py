"""Streams of samples through a loaded library."""
