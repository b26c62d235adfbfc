"""MethodResult: the motion and torques of a method of inverse dynamics, before the
verification.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.motor_side import (
    MotorMotion,
    couple_torques,
    motor_motion,
)
from flexgen.inversion.problem.problem import HELD
from flexgen.inversion.problem.reduced_problem import Motion


@dataclass(frozen=True)
class MethodResult:
    """Motion and torques that a method found at n instants, before the verification.

    Attributes
    ----------
    t : array (n,) [s]
        0 at the start of the path.
    q, v, a : arrays (n, n_a)
        Motion of the arm.
    tau_g : array (n, n_g) [N m]
        Gear torques, arm side.
    motors : MotorMotion
    preactuation : float [s]
        How long before the path the motion begins.
    status : Status
        SOLVED, LIMITS_ACTIVE or BASELINE.
    verdict : str
        Message of the solver.
    iterations, intervals : int
        Of the solver and of its mesh.
    details : mapping
        Further figures, JSON types.
    warnings : tuple of str
    tau_h : array (n, n_g) or None [N m]
        Torques of the gears' hysteresis, arm side; None where no gear has any.
    tau_b : array (n, n_m) or None [N m]
        Torques ``s0 z + s1 z'`` of the bristles of the motors' friction; None where no motor has
        any.
    held : float [s]
        How long the last torque is held in the verification; 0 where the motion continues.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau_g: np.ndarray
    motors: MotorMotion
    preactuation: float = 0.0
    status: Status = Status.SOLVED
    verdict: str = ""
    iterations: int = 0
    intervals: int = 0
    details: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    tau_h: np.ndarray | None = None
    tau_b: np.ndarray | None = None
    held: float = HELD


def with_motors(
    equations: Equations,
    t: np.ndarray,
    motion: Motion,
    *,
    preactuation: float = 0.0,
    verdict: str = "",
    iterations: int = 0,
    intervals: int = 0,
) -> MethodResult:
    """The result of a motion of the arm; the motors follow from its gear torques.

    Parameters
    ----------
    equations : Equations
    t : array (n,) [s]
    motion : Motion
    preactuation, verdict, iterations, intervals
        As in `MethodResult`.
    """
    tau_g = couple_torques(equations, t, motion.q, motion.v, motion.a, motion.tau_g)
    return MethodResult(
        t,
        motion.q,
        motion.v,
        motion.a,
        tau_g[:, :, 0],
        motor_motion(equations, t, motion.q, motion.v, motion.a, tau_g),
        preactuation,
        Status.SOLVED,
        verdict,
        iterations,
        intervals,
    )
