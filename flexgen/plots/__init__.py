"""Plots of robots, solutions and analyses."""
