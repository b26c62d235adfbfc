"""What is asked: time laws and paths; no solver inside."""
