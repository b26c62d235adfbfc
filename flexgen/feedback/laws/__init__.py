"""Feedback laws designed from a model of the robot: LQG, loop shaping, feedback linearization,
full-state LQ.
"""
