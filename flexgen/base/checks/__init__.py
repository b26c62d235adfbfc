"""Arguments of public functions against their annotations and bounds."""
