"""A known force on the tool along a path: what a process, such as milling, exerts there.

    R(q, v, a) - (J' f)_e = 0,    tau_g = ... - (J' f)_g,
    f = (force, torque) on the tool at its origin, world axes

``J`` (6, n_a): Jacobian of the tool. Before the path and after it the force stays as it is at its
ends: the arm begins and ends in equilibrium with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PPoly

from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.motion.torque_curve import spline
from flexgen.base.motion.trajectory import Trajectory
from flexgen.model.elements import RobotModel
from flexgen.paths.force.force_files import is_table, read_force
from flexgen.paths.force.tool_force import CHANNEL, LABELS, UNITS

# s: between the samples of a function of time, at most; samples, at most
STEP = 2.5e-4
SAMPLES = 200_001
RESOLVED = 0.25  # interval of a mesh times the angular frequency of a force that it resolves
ROUNDING = 1e-9  # of a constant force that was computed or read from a file
EXPECTED = (
    "an array (n, 3) [N] of samples at equal steps from the start to the end of the path, (n, "
    "6) with moments [N m], (n, 2) for an output with two axes; a function of the time [s] that "
    "returns one; a Trajectory, or its file, with the channel force; or a CSV file with the "
    "columns time_s, fx, fy, fz (, mx, my, mz)"
)


@dataclass(frozen=True)
class ProcessForce:
    """Force and torque on the tool, (6,) [N, N m] in world axes, between 0 and ``duration`` [s] of
    a path.
    """

    curve: PPoly
    duration: float

    def jets(self, t: np.ndarray) -> np.ndarray:
        """Value, first and second time derivative at the instants ``t`` (n,) [s]: (n, 18), one
        after the other.
        """
        inside = np.clip(t, 0.0, self.duration)
        rows = [self.curve(inside), *(self.curve.derivative(k)(inside) for k in (1, 2))]
        still = (t < 0.0) | (t > self.duration)
        for row in rows[1:]:
            row[still] = 0.0
        return np.hstack(rows)

    def at(self, t: np.ndarray) -> np.ndarray:
        """Values at the instants ``t`` (n,) [s], (n, 6)."""
        return np.asarray(self.curve(np.clip(t, 0.0, self.duration)))

    def mean(self, t: np.ndarray, width: float) -> np.ndarray:
        """Means over intervals of this width [s] about the instants ``t`` (n,), (n, 6)."""

        def integral(s: np.ndarray) -> np.ndarray:
            inside = np.clip(s, 0.0, self.duration)
            return np.asarray(whole(inside) + (s - inside)[:, None] * self.at(s))

        whole = self.curve.antiderivative()
        return (integral(t + width / 2) - integral(t - width / 2)) / width

    def held(self, t: np.ndarray, width: float) -> np.ndarray:
        """Forces to hold over intervals of this width [s] about the instants ``t`` (n,), as
        `flexgen.simulation.integration.hold`.

        Means less 1/12 of their second difference: a mean alone moves what it pushes by
        ``width^2 / 12`` times the acceleration of the force too little.
        """
        before, own, after = (self.mean(t + k * width, width) for k in (-1, 0, 1))
        return own - (before - 2.0 * own + after) / 12.0

    def on_output(self, model: RobotModel, t: np.ndarray) -> np.ndarray:
        """Force on the output at the instants t [s], dual to its rates, and two derivatives, (n, 3
        n_y).

        ArgumentError where the output is a combination of joints, or has no coordinate in a
        direction in which the force acts.
        """
        output = model.output
        jets = self.jets(t)
        if output.type == "combination":
            raise ArgumentError(
                f"force: given for the output of model {model.name}, combinations of joints, "
                "expected one of the tool"
            )
        rows = list(range(6)) if output.type == "tool_pose" else list(output.tool_rows)
        for k in set(range(6)) - set(rows):
            if np.abs(jets[:, k]).max() > 0.0:
                raise ArgumentError(
                    f"force: given {LABELS[k]} up to {np.abs(jets[:, k]).max():.4g} {UNITS[k]}, "
                    f"expected zero: the output of model {model.name} is the position "
                    f"{' '.join(output.axes)}"
                    + (" and the angle about one axis, on which no torque acts" * output.has_angle)
                )
        further = np.zeros((len(jets), output.size - len(rows)))  # no force on joints and angle
        n = len(output.axes)
        parts: list[np.ndarray] = []
        for order in range(3):
            own = jets[:, 6 * order :][:, rows]
            parts += [own[:, :n], further, own[:, n:]]
        return np.hstack(parts)

    @property
    def resolving(self) -> float:
        """Longest interval [s] of a mesh that resolves the force; infinite for a constant one.

        `RESOLVED` times the square root of half the range of its values over its second time
        derivative, of which the 99th percentile counts: a sine has 1 over its angular frequency.
        """
        jets = self.jets(np.linspace(0.0, self.duration, 2001))
        size = np.ptp(jets[:, :6], axis=0).max() / 2
        bend = np.abs(jets[:, 12:18])
        varies = size > ROUNDING * np.abs(jets[:, :6]).max()
        fastest = np.percentile(bend.max(axis=1), 99) if varies else 0.0
        return float(RESOLVED * np.sqrt(size / fastest)) if fastest > 0.0 else np.inf

    def channel(
        self, t: np.ndarray
    ) -> tuple[str, np.ndarray, tuple[str, ...], str, tuple[str, ...]]:
        """The row of a trajectory: name, values (n, 6), units, meaning, labels."""
        return CHANNEL, self.at(t), UNITS, "force and torque on the tool, world axes", LABELS


def make_force(
    given: Any, model: RobotModel, duration: float, expected: str = EXPECTED
) -> ProcessForce:
    """The force along a path of this ``duration`` [s] from what a user gives: a file, a
    trajectory, a function of time, or samples (n, 3 or 6) at equal intervals. ArgumentError for
    another object, with what is ``expected``.
    """
    if isinstance(given, str | Path):
        file = Path(given)
        if not file.exists():
            raise ArgumentError(
                f"force: given the file {str(file)!r}, which does not exist, expected {expected}"
            )
        given = read_force(file, "time_s", expected) if is_table(file) else Trajectory.load(file)
    if isinstance(given, Trajectory):
        t, values = _from_trajectory(given, duration)
    elif callable(given):
        t, values = _from_function(given, duration, expected)
    else:
        values = _numbers(given, expected)
        t = np.linspace(0.0, duration, len(values))
    return ProcessForce(spline(t, _wrench(values, model, expected)), duration)


def scale_force(
    given: Any, model: RobotModel, factor: float
) -> Callable[[np.ndarray], np.ndarray]:
    """Scaled force, a user's times a factor, as a function of instants (n,) [s] from the start to
    the end of the path.
    """
    return lambda t: factor * make_force(given, model, float(t[-1])).at(t)


def _numbers(given: Any, expected: str) -> np.ndarray:
    """Samples (n, k), n at least 2; ArgumentError for anything else."""
    try:
        values = np.zeros(0) if np.iscomplexobj(given) else np.asarray(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(0)
    if values.ndim != 2 or len(values) < 2:
        shown = (
            f"an array of shape {np.shape(given)}"
            if isinstance(given, np.ndarray)
            else show_value(given)
        )
        raise ArgumentError(f"force: given {shown}, expected {expected}")
    return values


def _from_function(
    given: Callable[[np.ndarray], Any], duration: float, expected: str
) -> tuple[np.ndarray, np.ndarray]:
    """Instants (n,) [s] on the path, at most `STEP` apart, and the values (n, k) of a function of
    time there; ArgumentError for an error in it, or another number of rows.
    """
    t = np.linspace(0.0, duration, int(np.clip(np.ceil(duration / STEP), 400, SAMPLES - 1)) + 1)
    try:
        values = _numbers(given(t), expected)
    except FlexgenError:
        raise
    except Exception as error:  # of the function of a user
        raise ArgumentError(
            f"force: given a function that raises {type(error).__name__} for an array of "
            f"{len(t)} instants ({error}), expected f(t) with t (n,) [s] that returns (n, 3)"
        ) from error
    if len(values) != len(t):
        raise ArgumentError(
            f"force: given a function that returns {len(values)} rows for {len(t)} instants, "
            "expected a row for each: f(t) with t (n,) [s] returns (n, 3)"
        )
    return t, values


def _from_trajectory(data: Trajectory, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Instants [s] and values of the force channel of a trajectory; ArgumentError where it has
    other units or does not cover the path, 0 to ``duration`` [s].
    """
    if CHANNEL not in data:
        raise ArgumentError(
            f"force: given a trajectory with {', '.join(data)}, expected the channel {CHANNEL}"
        )
    units = data.units[CHANNEL]
    wanted = UNITS[: len(data.units[CHANNEL])]
    if tuple(units) != wanted:
        raise ArgumentError(f"force: given in {', '.join(units)}, expected {', '.join(wanted)}")
    slack = 1e-9 * duration
    if data.time[0] > slack or data.time[-1] < duration - slack:
        raise ArgumentError(
            f"force: given from {data.time[0]:.4g} to {data.time[-1]:.4g} s, expected at least "
            f"from 0 to {duration:.4g} s, the path"
        )
    return data.time, np.asarray(data[CHANNEL], float)


def _wrench(values: np.ndarray, model: RobotModel, expected: str) -> np.ndarray:
    """Samples (n, 6) from those of a user; ArgumentError for a wrong number of columns, NaN or
    infinity.
    """
    axes = model.output.axes
    out = np.zeros((len(values), 6))
    planar = len(axes) == 2
    columns = {3: [0, 1, 2], 6: list(range(6))} | (
        {2: ["xyz".index(axis) for axis in axes]} if planar else {}
    )
    if values.shape[1] not in columns:
        raise ArgumentError(f"force: given {values.shape[1]} columns, expected {expected}")
    if not np.isfinite(values).all():
        row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise ArgumentError(f"force: given NaN or infinity in row {row}, expected finite numbers")
    out[:, columns[values.shape[1]]] = values
    return out
