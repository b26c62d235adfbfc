"""Whether a motion that was found is a solution."""
