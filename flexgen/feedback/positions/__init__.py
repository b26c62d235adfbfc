"""Position-controlled robots: commands with which their servos send the torques of inverse
dynamics.
"""
