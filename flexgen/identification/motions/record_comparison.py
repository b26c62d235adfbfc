"""A model compared with a record of motion: measured joint angles in, joint torques out.

The joints of the model move as measured (`flexgen.simulation.driven_joints`), with the
angles low-passed over the whole record before a window is cut out. The torques of the record are
not filtered. Each channel is compared without its mean over the window, which holds the offset of
the sensor and the mass of the robot:

    r = y(t) - y_model(t - lag),  R2 = 1 - sum (r - mean r)^2 / sum (y - mean y)^2

Moment about a coordinate without motor, such as the hinge of a payload: the wrench on the tool
that has the torques of the joints, by least squares, along the motion of the tool by this
coordinate,

    w = argmin |J_g' w - tau_g|,    moment = J_e' w

with the same matrix for the record and the model. A robot with more than six joints averages the
errors of its sensors this way, and torques that its own links take are left out in part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from flexgen.base.checks.bounds import NotNegative, Positive
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.joint_motion import JointMotion
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.identification.motions.record_result import Channel, RecordComparison, Score
from flexgen.identification.records.joint_record import LIMIT_HZ, JointRecord
from flexgen.model.abilities import needs
from flexgen.model.elements import RobotModel
from flexgen.simulation.driven_joints import DrivenMotion, drive_joints

# Signal over the noise of its sensor, root mean squares, from which on a channel is judged.
ABOVE_NOISE = 3.0
# s: a lag is searched within this time on either side; at the ends of it none is stated.
LONGEST_LAG = 0.05
# s: a given lag, at most on either side.
LARGEST_LAG = 1.0
FEWEST = 50  # rows in the window
WRENCH = 6  # components of force and torque
# Smallest over largest singular value of the Jacobian, below which the wrench is not determined.
REGULAR = 1e-2
# Order of the differences whose scatter is that of white noise, and the sum of their squares.
ORDER = 6
POWER_OF_DIFFERENCES = 924.0  # binomial(12, 6)


@checked_types
@needs("compare_record")
def compare_record(
    model: str | Path | RobotModel | Equations,
    record: JointRecord | str | Path,
    *,
    window: Sequence[float] | None = None,
    about: str | None = None,
    columns: Sequence[str] | None = None,
    lag: float | None = None,
    smallest: NotNegative = 0.0,
    limit_hz: Positive = LIMIT_HZ,
) -> RecordComparison:
    """Compare a model with a record of motion: torques of the joints from their measured angles.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    record : JointRecord, or the name of a .csv file
        Angles and torques of the joints, measured on the link side of the gears; at rest at its
        begin. A log of libfranka is read as it is.
    window : two floats, optional [s]
        Begin and end of what is compared, such as those after the motion. Default: all but
        the ends, where the low pass reaches beyond the record.
    about : str, optional
        Compare the moment about this coordinate without motor, such as the hinge of a payload.
    columns : sequence of str, optional
        Names of the columns of a file without a header; those without unit are in SI units.
    lag : float, optional [s]
        Time by which torques are recorded later than angles, such as that of another record.
        Default: the one that fits best.
    smallest : float [N m or N]
        Root mean square of a signal below which it is not compared; three times its noise at
        least.
    limit_hz : float [Hz]
        Of the low pass of the joint angles.

    Returns
    -------
    RecordComparison

    Raises
    ------
    ArgumentError
        The record is not one of this model, begins in motion, or does not have the window; the
        moment does not follow from the torques of the joints.

    Examples
    --------
    >>> import numpy as np
    >>> time = 0.001 * np.arange(2000)
    >>> swing = 0.2 * np.sin(np.pi * np.clip(time - 0.5, 0.0, 0.5)) ** 4  # rad, a joint
    >>> angle, torque = np.outer(swing, [1, 1]), np.zeros((2000, 2))
    >>> record = flexgen.JointRecord(time, angle, torque, ("q1", "q2"))
    >>> flexgen.compare_record("elbow", record).scores[0].is_predicted
    False
    """
    if lag is not None and not abs(lag) <= LARGEST_LAG:
        raise ArgumentError(f"lag: given {lag:g}, expected a time from -1 to 1 s")
    equations = model if isinstance(model, Equations) else derive(model)
    robot = equations.model
    given = _read(record, robot, columns)
    _check_joints(robot, given)
    motion = given.motion(limit_hz)
    driven = drive_joints(equations, motion)
    rows = _rows_in(given, motion, window)
    if about is None:
        curves = driven.tau_g
        measured = given.torque
        channels = _channels_of_joints(robot)
    else:
        to_moment = _moments(equations, about, driven)
        curves = np.einsum("nj,nj->n", to_moment, driven.tau_g)[:, None]
        at = np.clip(np.searchsorted(driven.time, given.time), 0, len(driven.time) - 1)
        measured = np.einsum("nj,nj->n", to_moment[at], given.torque)[:, None]
        channels = (Channel(f"moment about {about}", _unit_of(robot, about)),)
    noise = _noise(measured, given.time <= motion.begin + motion.edge)
    predict = make_interp_spline(driven.time, curves, 3)
    case = _Case(given.time[rows], measured[rows], predict, motion, noise, smallest)
    shifted = _best_lag(case) if lag is None else lag
    found = [case.score(k, channel, shifted) for k, channel in enumerate(channels)]
    return RecordComparison(
        model=robot,
        source=given.source,
        scores=tuple(found),
        lag_s=shifted,
        is_lag_fitted=lag is None,
        window_s=(float(case.time[0]), float(case.time[-1])),
        limit_hz=limit_hz,
        time=case.time,
        measured=case.values,
        predicted=case.curve_at(shifted or 0.0),
    )


def _read(
    record: JointRecord | str | Path, robot: RobotModel, columns: Sequence[str] | None
) -> JointRecord:
    """The record as it is given, or read from its file."""
    if not isinstance(record, JointRecord):
        return JointRecord.read(record, robot, columns)
    if columns is not None:
        raise ArgumentError("columns: given with a JointRecord, expected the name of a .csv file")
    return record


def _check_joints(robot: RobotModel, record: JointRecord) -> None:
    """ArgumentError where the record has other joints than the model."""
    names = tuple(robot.coordinates[i].name for i in robot.i_g)
    if record.joints != names:
        raise ArgumentError(
            f"{record.source}: given the joints {', '.join(record.joints)}, expected "
            f"{', '.join(names)}, the actuated ones of {robot.title} in their order"
        )


def _channels_of_joints(robot: RobotModel) -> tuple[Channel, ...]:
    """The torque of each joint."""
    return tuple(
        Channel(
            f"torque of {robot.coordinates[i].name}",
            "N m" if robot.coordinates[i].unit == "rad" else "N",
        )
        for i in robot.i_g
    )


def _unit_of(robot: RobotModel, name: str) -> str:
    """Unit of the force on a coordinate."""
    found = {c.name: c.unit for c in robot.coordinates}
    return "N m" if found[name] == "rad" else "N"


def _rows_in(
    record: JointRecord, motion: JointMotion, window: Sequence[float] | None
) -> np.ndarray:
    """Where (n,) rows are in the window; the model is known there with every lag."""
    margin = max(motion.edge, LONGEST_LAG)
    first = motion.begin + margin
    last = motion.end - margin
    ends = (first, last) if window is None else window
    if len(ends) != 2:
        raise ArgumentError(f"window: given {len(ends)} numbers, expected two: begin and end [s]")
    begin, end = ends
    if not first - 1e-9 <= begin < end <= last + 1e-9:
        raise ArgumentError(
            f"window: given ({begin:g}, {end:g}), expected two increasing times from {first:.4g} "
            f"to {last:.4g} s: near the ends of {record.source} the low pass reaches beyond it"
        )
    rows = (record.time >= begin) & (record.time <= end)
    if rows.sum() < FEWEST:
        raise ArgumentError(
            f"window: given ({begin:g}, {end:g}), which has {rows.sum()} rows of {record.source}, "
            f"expected at least {FEWEST}"
        )
    return np.asarray(rows)


def _noise(measured: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Root mean square (k,) of the noise, the larger one of that at rest, at the begin, and that
    of differences of high order.
    """
    differences = np.diff(measured, ORDER, axis=0)
    white = np.sqrt((differences**2).mean(axis=0) / POWER_OF_DIFFERENCES)
    if rest.sum() < 2:
        return np.asarray(white)
    return np.maximum(white, measured[rest].std(axis=0))


def _moments(equations: Equations, about: str, driven: DrivenMotion) -> np.ndarray:
    """Factors (n, n_g) of the torques of the joints in the moment about a coordinate."""
    robot = equations.model
    names = [c.name for c in robot.coordinates]
    behind = [names[i] for i in robot.i_e if i > max(robot.i_g)]
    if about not in behind:
        raise ArgumentError(
            f"about: given {about!r}, expected a coordinate without motor behind all joints of "
            f"{robot.title}: {', '.join(behind) or 'it has none'}"
        )
    if robot.n_g < WRENCH:
        raise ArgumentError(
            f"about: given a robot with {robot.n_g} joints, expected at least {WRENCH}: the "
            "wrench on the tool does not follow from fewer torques; compare the joints instead"
        )
    J = evaluate(equations.function("jacobian"), driven.q_a)[0]
    of_joints = np.swapaxes(J[:, :, list(robot.i_g)], 1, 2)
    sizes = np.linalg.svd(of_joints, compute_uv=False)
    worst = int(np.argmin(sizes[:, -1] / sizes[:, 0]))
    if sizes[worst, -1] < REGULAR * sizes[worst, 0]:
        raise ArgumentError(
            "about: given a record with a pose close to a singular one at "
            f"{driven.time[worst]:.4g} s, expected regular poses, where the wrench on the tool "
            "follows from the torques; compare the joints instead"
        )
    inverse = np.linalg.pinv(of_joints)
    return np.asarray(np.einsum("nk,nkj->nj", J[:, :, names.index(about)], inverse))


class _Case:
    """Rows of the window with the curve of the model, for one lag or another."""

    def __init__(
        self,
        time: np.ndarray,
        values: np.ndarray,
        curve: Callable[[np.ndarray], np.ndarray],
        motion: JointMotion,
        noise: np.ndarray,
        smallest: float,
    ) -> None:
        self.time = time
        self.values = values
        self._curve = curve
        self._span = (motion.begin, motion.end)
        centered = values - values.mean(axis=0)
        self.signal = np.sqrt((centered**2).mean(axis=0))
        self.noise = noise
        self.is_judged = self.signal > np.maximum(ABOVE_NOISE * noise, smallest)

    def curve_at(self, lag: float) -> np.ndarray:
        """Curve of the model (n, k), as much later."""
        return np.asarray(self._curve(np.clip(self.time - lag, *self._span)))

    def residual(self, lag: float) -> np.ndarray:
        """Record less model (n, k), without the means."""
        difference = self.values - self.curve_at(lag)
        return np.asarray(difference - difference.mean(axis=0))

    def cost(self, lag: float) -> float:
        """Sum of 1 - R2 of the channels that are judged."""
        power = (self.residual(lag) ** 2).mean(axis=0) / np.maximum(self.signal, 1e-300) ** 2
        return float(power[self.is_judged].sum())

    def score(self, k: int, channel: Channel, lag: float | None) -> Score:
        """The score of a channel; without figures where it is not judged, or for no lag."""
        signal = float(self.signal[k])
        noise = float(self.noise[k])
        if not self.is_judged[k]:
            return Score(channel, signal, noise)
        plain = self._figures(k, 0.0)
        shifted = (None, None, None) if lag is None else self._figures(k, lag)
        offset = float((self.values - self.curve_at(lag or 0.0))[:, k].mean())
        return Score(
            channel=channel,
            signal=signal,
            noise=noise,
            r2=plain[0],
            rms=plain[1],
            largest=plain[2],
            r2_lag=shifted[0],
            rms_lag=shifted[1],
            largest_lag=shifted[2],
            offset=offset,
        )

    def _figures(self, k: int, lag: float) -> tuple[float, float, float]:
        """R2, root mean square and largest size of the residual of a channel."""
        residual = self.residual(lag)[:, k]
        rms = float(np.sqrt((residual**2).mean()))
        return 1.0 - (rms / float(self.signal[k])) ** 2, rms, float(np.abs(residual).max())


def _best_lag(case: _Case) -> float | None:
    """The lag [s] with the smallest sum of squares; None: an end of the search, or no signal."""
    if not case.is_judged.any():
        return None
    trials = np.linspace(-LONGEST_LAG, LONGEST_LAG, 41)
    costs = [case.cost(x) for x in trials]
    at = int(np.argmin(costs))
    if at in (0, len(trials) - 1):
        return None
    bounds = trials[at - 1], trials[at + 1]
    return float(minimize_scalar(case.cost, bounds=bounds, method="bounded").x)
