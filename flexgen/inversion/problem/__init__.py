"""The problem of inverse dynamics of a move."""
