"""From a CasADi function to scalar C statements."""
