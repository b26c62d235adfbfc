"""Names of what a controller does between its ticks, and what they mean."""

from __future__ import annotations

from typing import Literal

HoldName = Literal["spline", "linear", "zoh"]
HOLDS: dict[HoldName, str] = {"spline": "spline", "linear": "linear hold", "zoh": "zero-order hold"}
