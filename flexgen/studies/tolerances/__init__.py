"""Uncertainty: tool error of a robot, from the tolerances of its model."""
