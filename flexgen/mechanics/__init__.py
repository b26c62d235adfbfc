"""From a robot's data to its equations of motion."""
