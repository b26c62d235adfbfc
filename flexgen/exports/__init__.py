"""Exports to the tools of others: FMU, MuJoCo, URDF, ROS 2, MATLAB. One module or package for each
kind.
"""
