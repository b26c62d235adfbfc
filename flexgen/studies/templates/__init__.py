"""New model files: from a template, or as an overlay on a URDF file."""
