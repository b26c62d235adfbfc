"""Methods of inverse dynamics."""
