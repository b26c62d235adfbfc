"""Analysis of a robot: modes, zeros, index, solvability of the inverse dynamics."""
