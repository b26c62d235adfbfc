"""Timed segments: a curve with its time law, from rest to rest, within path bounds and joint
limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.model.moves import Move
from flexgen.paths.geometry.blended_curve import BlendedCurve
from flexgen.paths.geometry.jets import JET, Attitude
from flexgen.paths.geometry.segments import POSITION
from flexgen.paths.reference import Reference
from flexgen.paths.timing.joint_limits import InverseKinematics
from flexgen.paths.timing.time_laws import Law

if TYPE_CHECKING:
    from flexgen.paths.timing.speed_planning import SpeedLaw, Stretch

INSTANTS = 801  # equidistant instants at which bounds are checked
BETWEEN = 17  # more instants between two breaks of a law
NEARLY = 0.98  # of the largest; such a local maximum may be higher between the instants
INSIDE = 16  # intervals in a section of a curve and between two breaks of a law, at least
# rad or m: where a joint moves farther from one instant to the next, its limits are checked in
# between
TURN = 0.1
FINER = 4  # times
PLACED = 3  # times that the instants of the ends of sections are interpolated
POINTS = 33  # per stretch, at which its curvature is evaluated
STRETCHES = 48  # per curve through samples
TOLERANCE = 1e-6  # relative excess of a bound before the segment is slowed down
SLOWDOWN_MAX = 1e4  # a segment that needs more passes a singular pose


class Curve(Protocol):
    """Geometry of a timed segment: position (and orientation) over a parameter from 0 to
    ``length``.
    """

    @property
    def length(self) -> float:
        """Range of the parameter."""
        ...

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives."""
        ...

    @property
    def breaks(self) -> np.ndarray:
        """Parameters at which a derivative up to order 5 may jump."""
        ...

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k), and the orientation, from the jet (n, k) of the parameter."""
        ...


@dataclass(frozen=True)
class TimedSegment:
    """A motion from rest to rest from ``start`` [s] on, in the space ``"tool"``, ``"output"`` or
    ``"joint"``.
    """

    space: str
    curve: Curve
    law: Law
    start: float = 0.0

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives of law and curve together."""
        return min(self.law.smoothness, self.curve.smoothness)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Time derivatives 0 to 5 of the position (n, d, 6), and the orientation, at the instants
        ``t`` [s].
        """
        t = np.asarray(t, dtype=float)
        since = t - self.start
        duration = self.law.duration
        # at the end and after it: rest, whatever the rounding of the difference
        return self.curve(
            self.law(np.where(t >= self.start + duration, since + duration, since), JET - 1)
        )

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which a derivative up to order 5 may jump [s]."""
        out = [self.law.breaks]
        if len(self.curve.breaks):
            low = np.zeros(len(self.curve.breaks))
            high = np.full(len(self.curve.breaks), self.law.duration)
            for _ in range(60):
                middle = (low + high) / 2
                before = self.law(middle, 0)[:, 0] < self.curve.breaks
                low = np.where(before, middle, low)
                high = np.where(before, high, middle)
            out.append(high)
        return self.start + np.unique(np.concatenate(out))

    def instants(self, count: int) -> np.ndarray:
        """``count`` equidistant instants [s], and `INSIDE` intervals in each section of a curve of
        several segments.
        """
        equidistant = self.start + np.linspace(0.0, self.law.duration, count)
        if not isinstance(self.curve, BlendedCurve) or len(self.curve.sections) == 1:
            return equidistant
        ends = np.cumsum([section.length for section in self.curve.sections])[:-1]
        t = np.union1d(np.linspace(0.0, self.law.duration, 4 * len(ends)), self.law.breaks)
        for _ in range(PLACED):
            t = np.union1d(t, np.interp(ends, self.law(t, 1)[:, 0], t))
        borders = np.concatenate(
            [[0.0], np.interp(ends, self.law(t, 1)[:, 0], t), [self.law.duration]]
        )
        inside = borders[:-1, None] + np.diff(borders)[:, None] * np.linspace(0.0, 1.0, INSIDE + 1)
        return np.union1d(equidistant, self.start + inside.ravel())


@dataclass(frozen=True)
class JointMotion(Move):
    """A move that was planned before as a motion of the joints; ``rule``: in words, how the joints
    were chosen.
    """

    segments: tuple[TimedSegment, ...] = ()
    rule: str = ""


@dataclass(frozen=True)
class PlannedMove:
    """A planned move of one model.

    ``segments``: motions from rest to rest, in order; ``q_g`` (n_g): actuated coordinates at the
    start [rad or m].
    """

    segments: tuple[TimedSegment, ...]
    q_g: np.ndarray


def derivative_norms(
    space: str, x: np.ndarray, attitude: Attitude | None, radius: float
) -> np.ndarray:
    """Norms (n, 5) of the derivatives 1 to 5 of a curve, from its jet ``x`` (n, width, 6) and its
    orientation.

    For the tool: the Euclidean norm of the position, or ``radius`` [m] times that of the angular
    velocity if that is larger, or times the derivative of an angle after the position; otherwise
    the maximum norm over the coordinates.
    """
    if space != "tool":
        return np.abs(x[:, :, 1:]).max(axis=1)
    out = np.linalg.norm(x[:, :POSITION, 1:], axis=1)
    for angle in np.moveaxis(x[:, POSITION:, 1:], 1, 0):
        out = np.maximum(out, radius * np.abs(angle))
    if attitude is not None:
        out = np.maximum(out, radius * np.linalg.norm(attitude[1], axis=1))
    return np.asarray(out)


def _stretches(
    space: str, curve: Curve, bounds: tuple[float, ...], radius: float, speeds: list[float] | None
) -> list[Stretch]:
    """Stretches of a curve, each with its length and the largest speed: that of its segment,
    lowered so that curvature alone stays within the higher ``bounds`` (acceleration, jerk, ...).

    ``speeds``: bounds of the curve's segments; ``radius`` [m]: with which rotations count.
    """
    from flexgen.paths.timing.speed_planning import Stretch

    if isinstance(curve, BlendedCurve):
        lengths = [section.length for section in curve.sections]
        each = speeds or [bounds[0]] * len(curve.segments)
        caps = [
            min(each[p.segment], each[p.segment + 1]) if p.corner else each[p.segment]
            for p in curve.sections
        ]
    else:
        lengths = [curve.length / STRETCHES] * STRETCHES
        caps = [bounds[0]] * STRETCHES
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    out = []
    for k, cap in enumerate(caps):
        s = np.zeros((POINTS, JET))
        s[:, 0] = np.linspace(starts[k], starts[k + 1], POINTS)
        s[:, 1] = 1.0
        peaks = derivative_norms(space, *curve(s), radius).max(axis=0)
        cap = cap / max(peaks[0], 1e-300)
        for order, bound in enumerate(bounds[1 : JET - 1], 2):
            if peaks[order - 1] > 0:
                cap = min(cap, float(bound / peaks[order - 1]) ** (1 / order))
        out.append(Stretch(lengths[k], cap))
    return out


def plan_law(
    reference: Reference,
    space: str,
    curve: Curve,
    bounds: tuple[float, ...],
    smoothness: int,
    radius: float,
    q_g: np.ndarray | None,
    speeds: list[float] | None = None,
) -> SpeedLaw:
    """Plan a law within bounds on speed, acceleration, jerk, ... of the path and the limits of the
    model's joints.

    1. Each stretch of the curve gets the speed that its curvature allows. 2. The changes of speed
       are planned. 3. If a
    bound of the path or a joint limit of the undeflected arm is exceeded, one factor slows down
    the whole motion.

    Parameters
    ----------
    reference : Reference
    space : str
    curve : Curve
    bounds : tuple of float
        Of the tool [m/s, m/s^2, ...], or of the outputs or coordinates.
    smoothness : int
        0: trapezoids; else number of continuous derivatives of polynomial changes of speed.
    radius : float [m]
        Scales the angle of rotation of the tool to a length.
    q_g : array (n_g) or None
        Actuated coordinates at the start, if the curve is not in the joint space.
    speeds : list of float, optional
        Bounds on the speed along the segments of a blended curve.

    Raises
    ------
    SolverError
        The path leaves the workspace or passes a singular pose.
    """
    from flexgen.paths.timing.speed_planning import speed_law

    stretches = _stretches(space, curve, bounds, radius, speeds)
    law = speed_law(stretches, (max(s.speed for s in stretches), *bounds[1:]), smoothness)
    segment = TimedSegment(space, curve, law)
    found = _peaks(segment, radius)
    factor = max(
        float(f / b) ** (1 / k) for k, (f, b) in enumerate(zip(found, bounds, strict=False), 1)
    )
    kinematics = InverseKinematics(reference.equations)
    if kinematics.has_limits:
        factor = max(
            factor, _joint_slowdown(reference, kinematics, segment, q_g) * (1 + TOLERANCE)
        )
    if not factor < SLOWDOWN_MAX:
        raise SolverError(
            f"path: the joint limits would slow it down by a factor of {factor:.1e}; it passes "
            "a singular pose"
        )
    return law.slow_down(factor) if factor > 1 + TOLERANCE else law


def _joint_slowdown(
    reference: Reference,
    kinematics: InverseKinematics,
    segment: TimedSegment,
    q_g: np.ndarray | None,
) -> float:
    """Factor by which the limits of joints and motors slow a motion down, from instants between
    the breaks of its law; at most 1: they hold.

    Where a joint moves far from one instant to the next, as near a singular pose, from more of
    them. ``q_g`` (n_g,): joints at the start.
    """
    breaks = segment.law.breaks
    end = segment.law.duration
    factor = 0.0
    first = breaks[:-1]
    last = breaks[1:]
    start = q_g
    counts = np.maximum(INSIDE, np.ceil((last - first) * (INSTANTS // 2) / end).astype(int)) + 1
    for _ in range(FINER):
        between = [np.linspace(1e-9, 1 - 1e-9, count) for count in counts]
        t = np.concatenate([a + (b - a) * u for a, b, u in zip(first, last, between, strict=True)])
        x, attitude = segment.at(t)
        ends = np.cumsum(counts)[:-1]
        if segment.space == "joint":
            q = x[:, :, 0]
            v = x[:, :, 1]
            a = x[:, :, 2]
        else:
            sample = reference.sample(segment.space, x, attitude)
            q = kinematics.follow_many(sample, np.asarray(start), t / end)
            v, a = kinematics.velocities(sample, q)
        parts = [np.split(values, ends) for values in (v, a)]
        for count in np.unique(counts):
            same = np.flatnonzero(counts == count)
            factor = max(
                factor,
                kinematics.slowdown(*(np.stack([one[k] for k in same], axis=1) for one in parts)),
            )
        far = np.abs(np.diff(q, axis=0)).max(axis=1) > TURN
        far[ends - 1] = False
        if segment.space == "joint" or not far.any():
            break
        here = np.flatnonzero(far)
        first = t[here]
        last = t[here + 1]
        start = q[here[0]]
        counts = np.full(len(first), INSIDE + 1)
    return factor


def _peaks(segment: TimedSegment, radius: float) -> np.ndarray:
    """Largest norms (5,) of the derivatives of a segment, `derivative_norms` with ``radius`` [m]:
    at equidistant instants, between breaks, and near local maxima.
    """
    end = segment.law.duration
    first = segment.law.breaks[:-1, None]
    last = segment.law.breaks[1:, None]
    between = first + (last - first) * np.linspace(1e-9, 1 - 1e-9, BETWEEN)
    t = np.sort(np.concatenate([np.linspace(0.0, end, INSTANTS), between.ravel()]))
    found = derivative_norms(segment.space, *segment.at(t), radius)
    high = found[1:-1] >= np.maximum(NEARLY * found.max(axis=0), np.maximum(found[:-2], found[2:]))
    maxima = np.flatnonzero(high.any(axis=1)) + 1
    near = t[maxima - 1, None] + (t[maxima + 1] - t[maxima - 1])[:, None] * np.linspace(
        0, 1, POINTS
    )
    return np.asarray(
        np.maximum(
            found.max(axis=0),
            derivative_norms(segment.space, *segment.at(near.ravel()), radius).max(axis=0),
        )
    )


def configuration_at_end(
    reference: Reference, segment: TimedSegment, q_g: np.ndarray
) -> np.ndarray:
    """Actuated coordinates (n_g,) of the undeflected arm at the end of a segment, from those at
    its start, ``q_g``: inverse kinematics along it.
    """
    t = segment.instants(INSTANTS // 4 + 1)
    x, attitude = segment.at(t)
    if segment.space == "joint":
        return np.array(x[-1, :, 0])
    sample = reference.sample(segment.space, x, attitude)
    at = (t - segment.start) / segment.law.duration
    kinematics = InverseKinematics(reference.equations)
    if len(t) == INSTANTS // 4 + 1:
        return kinematics.follow(sample, q_g)[-1]
    return kinematics.follow_many(sample, q_g, at)[-1]
