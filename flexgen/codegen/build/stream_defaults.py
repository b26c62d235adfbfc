"""Defaults of a library from the home pose: options of a stream by the zero dynamics, gains of the
servo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

from flexgen.analysis.arm_linearization import held_motions
from flexgen.analysis.zero_dynamics.zeros import (
    PREVIEW_SHARE,
    pencil_zeros,
    preview,
    time_constants,
)
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.emission.interface import INTERVALS_MAX
from flexgen.codegen.emission.spec import LibrarySpec, StreamDefaults
from flexgen.codegen.statements.routine import Expressions
from flexgen.model.elements import RobotModel
from flexgen.runtime.identity import TOLERANCES

PERIOD = 5e-3  # s: of an update
SAMPLES = 5  # per interval
INTERVALS = 10  # of the shortest horizon
_STEPS = 60  # of Newton's method, at most
_SINGULAR = 1e-9  # rad/m: a pose where the output's Jacobian is singular


def with_defaults(model: RobotModel, spec: LibrarySpec) -> LibrarySpec:
    """The library with the recommended options of its stream, and with gains where its servo has
    frequencies.
    """
    constants = spec.motor_constants
    if constants is not None and constants.servo is not None and constants.servo.type == "ppi":
        from flexgen.analysis.servo_gains import servo_with_gains

        spec = replace(spec, motor_constants=replace(constants, servo=servo_with_gains(model)))
    return replace(spec, stream=stream_defaults(model, spec))


def stream_defaults(model: RobotModel, spec: LibrarySpec) -> StreamDefaults | None:
    """Recommended options of a stream; None where the arm has no equilibrium or a singular pose at
    home.

    The look-ahead is the `preview` of the slowest unstable zero for `PREVIEW_SHARE`, and at least
    `INTERVALS` updates.

    Parameters
    ----------
    model : RobotModel
        One that can be inverted.
    spec : LibrarySpec
        Its library, with the functions of the inversion. Run-time parameters have the values of
        the model file.
    """
    zero = slowest_unstable_zero(model, spec)
    if zero is None:
        return None
    ahead = preview(1.0 / zero, PREVIEW_SHARE) if zero > 0 else 0.0
    intervals = min(max(INTERVALS, math.ceil(ahead / PERIOD - 1e-9)), INTERVALS_MAX)
    return StreamDefaults(
        zero,
        intervals * PERIOD,
        PERIOD,
        intervals,
        SAMPLES,
        TOLERANCES[spec.precision],
        PREVIEW_SHARE,
    )


def slowest_unstable_zero(model: RobotModel, spec: LibrarySpec) -> float | None:
    """Smallest real part [1/s] of the unstable zeros of the output, with the joints at home and
    springs at equilibrium.

    0 where there is none; None without an equilibrium, at a singular pose, or where the zeros are
    undetermined.

    The zeros are those of ``A s^2 + D s + K`` with ``A = R_a S``, ``D = R_v S``, ``K = R_q S``:
    the Jacobians of the unactuated rows, restricted to motions ``S`` that keep the output where it
    is.
    """
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    if not i_e:
        return 0.0
    jacobians, constraint = (
        _values(spec, name) for name in ("inversion_jacobians", "output_constraint")
    )
    q = np.zeros(model.n_a)
    rest = np.zeros(model.n_a)
    q[i_g] = model.home
    change = np.inf
    for _ in range(_STEPS):
        row, by_q, by_v, by_a = (x[0] for x in jacobians(q, rest, rest)[3:])
        stiffness = by_q.reshape(model.n_e, model.n_a)[:, i_e]
        step = np.linalg.lstsq(stiffness, row.reshape(model.n_e), rcond=None)[0]
        change = float(np.abs(step).max())
        if not np.isfinite(change) or change < 1e-12:
            break
        q[i_e] -= step * min(1.0, 0.5 / change)
    if not change < 1e-9:
        return None
    W = constraint(q, rest, np.zeros(model.output.target_size))[1][0].reshape(-1, model.n_a)
    if np.linalg.svd(W[:, i_g], compute_uv=False)[-1] < _SINGULAR:
        return None
    A, D, K = (
        x.reshape(model.n_e, model.n_a) @ held_motions(model, W) for x in (by_a, by_v, by_q)
    )
    zeros = pencil_zeros(A, D, K)
    if zeros is None:
        return None
    slowest, _ = time_constants(zeros)
    return 1.0 / slowest if slowest > 0 else 0.0


def _values(spec: LibrarySpec, name: str) -> Callable[..., list[np.ndarray]]:
    """A function of the library in numbers, with the run-time parameters of the model file."""
    (found,) = (f for f in spec.functions if f.name == name)
    (step,) = (step for step in found.program.steps if isinstance(step, Expressions))
    function: ca.Function = step.function
    values = np.array([parameter.value for parameter in spec.parameters])
    held = [values] if "parameters" in function.name_in() else []
    return lambda *points: evaluate(function, *points, *held)
