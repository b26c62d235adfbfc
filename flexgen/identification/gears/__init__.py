"""Hysteresis, transmission errors and cogging, identified from motor angles and torques."""
