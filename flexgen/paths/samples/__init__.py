"""Recorded paths."""
