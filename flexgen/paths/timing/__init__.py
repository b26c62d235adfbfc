"""Time laws along curves."""
