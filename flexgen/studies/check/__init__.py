"""Plausibility: are the numbers of a model those of a robot, or is a unit wrong?"""
