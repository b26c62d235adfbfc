"""What the equations say about a robot: modes, zeros, index."""
