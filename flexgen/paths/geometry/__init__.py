"""Curves without time."""
