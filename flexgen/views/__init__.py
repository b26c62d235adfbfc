"""Figures, reports and texts of results."""
