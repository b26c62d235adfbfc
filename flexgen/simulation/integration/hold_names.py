"""Names of the holds of a controller, its output between samples, and their meaning."""

from __future__ import annotations

from typing import Literal

HoldName = Literal["spline", "linear", "zoh"]
HOLDS: dict[HoldName, str] = {
    "spline": "spline",
    "linear": "linear hold",
    "zoh": "zero-order hold",
}
