"""Programs of moves in model files."""
