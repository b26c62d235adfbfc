"""Identification: from measurements of a robot to the parameters of its model."""
