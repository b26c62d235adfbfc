"""Equations written down as C."""
