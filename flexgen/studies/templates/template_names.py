"""Names of the templates, each a file ``NAME.toml`` in this folder."""

TEMPLATES = ("planar", "gantry", "scara", "palletizer", "six-axis")
