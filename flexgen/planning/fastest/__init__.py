"""Minimum time along a path, with limits of motors, gears and vibration."""
