"""Names of what a controller does between its ticks, and what they mean."""

from __future__ import annotations

HOLDS = {"spline": "spline", "linear": "linear hold", "zoh": "zero-order hold"}
