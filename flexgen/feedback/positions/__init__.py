"""Robots that take positions: commands that make their servos send the torques of inverse
dynamics.
"""
