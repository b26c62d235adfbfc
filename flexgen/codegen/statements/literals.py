"""Numbers as C."""

from __future__ import annotations

import math

import numpy as np


def literal(x: float, precision: str = "double") -> str:
    """A number as the shortest C expression that reads back to the same bits."""
    if math.isnan(x):
        return "NAN"
    if math.isinf(x):
        return "INFINITY" if x > 0 else "(-INFINITY)"
    text = repr(float(x))  # always with a point or an exponent
    if precision == "single":
        with np.errstate(over="ignore", under="ignore"):
            short = np.float32(x)
        if math.isinf(short):
            return literal(float(short))
        text = str(short) if "." in str(short) or "e" in str(short) else f"{short}.0"
        text += "f"
    return f"({text})" if text.startswith("-") else text
