"""Answers: trajectories of torque that follow a path."""
