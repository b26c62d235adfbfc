"""Statistics, grade and status of a fit."""
