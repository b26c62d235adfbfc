"""A figure of a result, and lengths and angles as text."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Figure(NamedTuple):
    """A figure: its name, its value (None where there is none), its unit, and its key in JSON."""

    label: str
    value: str | float | None
    unit: str
    key: str


def format_size(value: float | None, unit: str) -> str:
    """A length [m] or angle [rad] with a prefix of its unit: ``9.18e-05 um``, ``4.2 mm``; a dash for None."""
    if value is None or not np.isfinite(value):
        return "-"
    factor, prefix = (1.0, "") if value >= 0.9995 else (1e3, "m") if value >= 0.9995e-3 else (1e6, "u")
    return f"{factor * value:.3g} {prefix}{unit}"


def both_measured(in_m: float | None, in_rad: float | None) -> str:
    """A length and an angle: ``4.2 mm and 3 urad``; empty where there is neither."""
    return " and ".join(format_size(value, unit) for value, unit in ((in_m, "m"), (in_rad, "rad")) if value is not None)
