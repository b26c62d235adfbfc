"""Observers of an elastic robot's state: extended Kalman filter, constant gains by pose, collision
detection.
"""
