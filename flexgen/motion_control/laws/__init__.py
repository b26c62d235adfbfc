"""Feedback laws that are designed from a model of the robot."""
