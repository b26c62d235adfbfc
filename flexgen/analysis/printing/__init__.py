"""Closed-form equations for people to read."""
