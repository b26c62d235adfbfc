"""Uncertainty: how far a robot may be from its path, from what is known about the accuracy of its
model.
"""
