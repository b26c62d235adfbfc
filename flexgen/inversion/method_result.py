"""MethodResult: what a method of inverse dynamics found, before anybody has verified it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexgen.inversion.motor_side import MotorMotion
from flexgen.inversion.status import Status


@dataclass(frozen=True)
class MethodResult:
    """What a method found at n instants.

    ``t`` (n,) [s], 0 at the start of the path; ``q v a`` (n, n_a): motion of the arm; ``tau_g`` (n, n_g): gear torques,
    arm side; ``drives``: motors. ``status``: ``SOLVED``, ``LIMITS_ACTIVE`` or ``BASELINE``. ``lead`` [s]: how long
    before the path the motion begins. ``verdict``: message of the solver. ``iterations``, ``intervals``: of its mesh.
    ``details``: further figures, JSON types.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau_g: np.ndarray
    drives: MotorMotion
    lead: float = 0.0
    status: Status = Status.SOLVED
    verdict: str = ""
    iterations: int = 0
    intervals: int = 0
    details: Mapping[str, Any] = field(default_factory=dict)
