"""The sampled closed loop around the emitted model: sensors, drives, hold, delay and noise."""
