"""The robot as an MJCF file."""
