"""The robot as a URDF file with an overlay."""
