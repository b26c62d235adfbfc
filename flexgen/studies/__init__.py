"""Many cases of one robot: tolerances, sweeps, scenarios, plausibility, templates."""
