"""Position commands of a move: the inverse of servo, gears and arm.

The motor angles and torques of the solution are sampled as the servo does it; its inverse gives
the reference with which it sends these torques, and the samples of the interface are those whose
interpolation is closest to it. Servo and robot are then simulated with these samples, in C, and
compared with the path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Positive
from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.mechanics.equations import Equations, robot_of
from flexgen.feedback.loop.case import HOLD_S, Case, control_case
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.reference import MotionReference, motion_reference, time_grid
from flexgen.feedback.loop.result import ControlRun
from flexgen.feedback.positions.inverse import holding_offset, invert_servo
from flexgen.feedback.positions.result import PositionCommands
from flexgen.feedback.positions.samples import Interpolation, basis, fit_samples, fit_within
from flexgen.feedback.positions.servo import Servo, filter_reference, servo_of
from flexgen.inversion.solution import Solution
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.path import Path

PERIOD_S = 4e-3
LONGEST_S = 0.1  # period of an interface, at most
# of the reference after the motion, relative; time after it, at most
SETTLED = 1e-6
LONGEST_AFTER_S = 30.0
REACHED = 1.0 - 1e-4  # of a limit
AT_REST = 1e-9  # rad: the first position that is this far from rest begins the table


@checked_types(own=("period", "plants"))
@reported("command_positions")
def command_positions(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    servo: Any = None,
    period: Positive = PERIOD_S,
    interpolation: Interpolation = "linear",
    speed: np.ndarray | None = None,
    acceleration: np.ndarray | None = None,
    plants: Mapping[str, Mapping[str, float]] | None = None,
    solution: Solution | None = None,
    progress: Choice = None,
) -> PositionCommands:
    """Positions to send to a robot that takes no torques, so that its tool follows a move exactly.

        servo(samples, interpolated) sends the torques of inverse dynamics
        along the motor angles of the solution

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    servo : Servo, Cascade, PPI, or str, optional
        Of the robot: ``"ppi"`` (proposed gains) or a ``.toml`` file, such as that of 'flexgen
        identify-servo --out'; default: that of the model file, and ppi where it has none. See
        `flexgen.Servo`.
    period : float [s]
        Between two positions, such as 0.004, 0.008 or 0.012.
    interpolation : str
        Of the robot between two positions.
    speed : array (n_g,), optional [rad/s or m/s]
        Largest commanded speed of each joint.
    acceleration : array (n_g,), optional [rad/s^2 or m/s^2]
        Largest commanded acceleration of each joint.
    plants : mapping of str to changes, optional
        Another robot. Several have names, as in `flexgen.control`; the model itself is simulated
        too.
    solution : Solution, optional
        The move solved before; default: `flexgen.solve` with its default method.
    progress : callable or bool, optional

    Returns
    -------
    PositionCommands

    Raises
    ------
    ArgumentError
        An argument is out of range, or the servo does not fit the robot.
    SolverError
        The move has no solution, or no positions keep the limits.

    Examples
    --------
    >>> found = flexgen.command_positions("elbow", period=0.008, interpolation="cubic")
    >>> found.status, found.tool_error_max_m < 1e-7
    ('solved', True)
    """
    tell: Callable[[str], None] = progress if callable(progress) else lambda line: None
    own = servo_of(servo, robot_of(model))
    _check_period(period, own)
    case = control_case(
        model,
        move,
        sample_time=own.sample_time,
        delay=own.delay,
        plants=plants,
        solution=solution,
        progress=progress if callable(progress) else None,
    )
    found, _ = case_controller(case, own.feedback)
    assert isinstance(found, Cascade)
    case = replace(case, reference=_long_reference(case, found))
    reference = case.reference
    joints = np.linalg.inv(case.model.eta).T
    tell("inverting the servo")
    r = invert_servo(own, found, reference.held, reference.motion["q_m"]) @ joints
    first, last = reference.time[[0, -1]] / period
    edges = period * np.arange(np.ceil(first - 1e-9), np.floor(last + 1e-9) + 1)
    B = basis(reference.time, edges, interpolation)
    limits = _limit(case.model, "speed", speed), _limit(case.model, "acceleration", acceleration)
    samples, active = _fit(
        B, r, period, limits, [case.model.coordinates[i].name for i in case.model.i_g]
    )
    tell("simulating servo and robot")
    run = _simulate(case, own, found, B @ samples, "position commands")
    trajectory = case.solution.trajectory
    planned = (
        trajectory.at(np.clip(edges, trajectory.time[0], trajectory.time[-1]))["q_m"] @ joints
    )
    today = _simulate(case, own, found, B @ planned, "planned motor angles")
    kept = _cut_rest(samples)
    shown = samples[kept] + holding_offset(found, reference.held[0]) @ joints
    names, units = zip(
        *((c.name, c.unit) for c in (case.model.coordinates[i] for i in case.model.i_g)),
        strict=True,
    )
    return PositionCommands(
        edges[kept],
        shown @ case.model.eta.T,
        shown,
        names,
        units,
        period,
        interpolation,
        own,
        run,
        today,
        active,
    )


def _check_period(period: Any, servo: Servo) -> None:
    if not is_number(period) or not servo.sample_time * (1 - 1e-9) <= period <= LONGEST_S:
        raise ArgumentError(
            f"period: given {show_value(period)}, expected from {servo.sample_time:g} s, the "
            f"sample time of the servo, to {LONGEST_S:g} s"
        )


def _long_reference(case: Case, gains: Cascade) -> MotionReference:
    """The reference until the position loop and the integral parts, which fill after the path, are
    at rest.

    One sample of the servo is at the begin of the path, so that positions begin to act at samples.
    """
    rates = np.concatenate([gains.position_gain, gains.integral_gain])
    after = min(-np.log(SETTLED) / float(rates[rates > 0.0].min()), LONGEST_AFTER_S)
    trajectory = case.solution.trajectory
    span = float(trajectory.time[0]), float(trajectory.time[-1])
    begin = case.sample_time * np.floor(span[0] / case.sample_time + 1e-9)
    time = time_grid(begin, span[1], case.sample_time, HOLD_S, after)
    path = Path(case.equations, case.solution.move)
    return motion_reference(trajectory, path, case.sample_time, case.delay, case.library, time)


def _limit(model: RobotModel, name: str, given: Any) -> np.ndarray | None:
    """A bound of the commands of all joints; ArgumentError for another number of them."""
    if given is None:
        return None
    bound = np.asarray(given, float)
    if bound.shape != (model.n_g,) or not (np.isfinite(bound).all() and (bound > 0.0).all()):
        raise ArgumentError(
            f"{name}: given {show_value(given)}, expected {model.n_g} numbers > 0, one for each "
            "joint"
        )
    return bound


def _fit(
    B: csc_matrix,
    r: np.ndarray,
    period: float,
    limits: tuple[np.ndarray | None, np.ndarray | None],
    names: list[str],
) -> tuple[np.ndarray, tuple[str, ...]]:
    """The samples, and the limits that they reach, or would exceed without them."""

    def largest(samples: np.ndarray, share: float) -> list[str]:
        found = []
        for n, (word, bound) in enumerate(zip(("speed", "acceleration"), limits, strict=True), 1):
            if bound is not None:
                size = np.abs(np.diff(samples, n=n, axis=0)).max(axis=0) / period**n
                found += [f"{word} of {names[j]}" for j in np.flatnonzero(size > share * bound)]
        return found

    samples = fit_samples(B, r)
    if not (exceeded := largest(samples, 1.0)):
        return samples, ()
    samples = fit_within(B, r, period, limits)
    return samples, tuple(dict.fromkeys([*exceeded, *largest(samples, REACHED)]))


def _simulate(case: Case, servo: Servo, gains: Cascade, r: np.ndarray, name: str) -> ControlRun:
    """Servo and robots with a reference (n, n_g) at the samples of the servo, which holds the
    robot at the start.
    """
    used = filter_reference(servo, r @ case.model.eta.T, np.asarray(gains.position_gain, float))
    held = np.tile(case.reference.held[0], (len(used), 1))
    reference = replace(case.reference, motion={**case.reference.motion, "q_m": used}, held=held)
    return run_case(replace(case, reference=reference), gains, name)


def _cut_rest(samples: np.ndarray) -> slice:
    """From the last position at rest before the motion to the first one after it."""
    far = np.flatnonzero(np.abs(samples - samples[0]).max(axis=1) > AT_REST)
    first = max(int(far[0]) - 1, 0) if far.size else 0
    rest = np.flatnonzero(np.abs(samples - samples[-1]).max(axis=1) > AT_REST)
    last = min(int(rest[-1]) + 2, len(samples)) if rest.size else len(samples)
    return slice(first, last)
