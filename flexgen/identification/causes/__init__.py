"""Causes of a misfit: single faults of the model or of the record that explain it."""
