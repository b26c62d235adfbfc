"""Reports: a solution as one HTML page."""
