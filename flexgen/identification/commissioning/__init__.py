"""One fit of all numbers of a robot to all of its records, see `commission`."""
