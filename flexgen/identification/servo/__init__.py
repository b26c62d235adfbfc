"""Parameters of a position servo."""
