"""Forces of a process along a path."""
