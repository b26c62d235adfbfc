"""Figures by which people compare robots on a path, in the sense of ISO 9283."""
