"""Robots as Functional Mock-up Units (FMI 2.0 and 3.0), for simulation programs and real-time
targets.
"""
