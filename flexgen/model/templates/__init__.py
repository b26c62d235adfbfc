"""Texts of model files: templates, overlays for URDF files, defaults for all joints, new numbers in a file."""
