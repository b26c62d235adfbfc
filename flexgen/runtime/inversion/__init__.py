"""Inversion of paths and poses by a loaded library."""
