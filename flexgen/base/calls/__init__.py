"""Time limit, interruption, progress and former names of public calls."""
