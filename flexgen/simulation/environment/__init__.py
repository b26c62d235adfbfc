"""Signals of the sensors of a robot, and walls that its tool touches."""
