"""What sensors of a robot read, and walls that its tool touches."""
