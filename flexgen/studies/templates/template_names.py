"""Names of the templates, each a file ``NAME.toml`` in this folder."""

FLEXIBLE_LINK = "flexible-link"
TEMPLATES = (
    "planar",
    "gantry",
    "scara",
    "palletizer",
    "four-bar",
    "delta",
    "six-axis",
    "seven-axis",
    "track",
    "counterbalanced",
    FLEXIBLE_LINK,
)
