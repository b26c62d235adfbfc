"""The equations of motion of a robot, from the Lagrangian, as CasADi functions."""
