"""What a robot is: data read from a file, nothing derived."""
