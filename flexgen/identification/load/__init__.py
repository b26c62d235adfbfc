"""Payload from a recorded motion."""
