"""Forward simulation of the full model."""
