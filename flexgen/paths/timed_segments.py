"""Legs: a curve and its law, from rest to rest, within bounds on the path and the limits of the joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flexgen.errors import SolverError
from flexgen.paths.blended_curve import BlendedCurve
from flexgen.paths.jets import JET, Attitude
from flexgen.paths.joint_limits import Posture
from flexgen.paths.reference import Reference
from flexgen.paths.speed_planning import SpeedLaw, Stretch, speed_law
from flexgen.paths.time_laws import Law

INSTANTS = 801  # at which bounds are checked
BETWEEN = 17  # instants more from each break of a law to the next
NEARLY = 0.98  # of the largest: a summit that may be higher between the instants
POINTS = 33  # of a stretch at which its curvature is looked at
STRETCHES = 48  # of a curve through samples
EXACT = 1e-6  # relative: by so much a bound may be exceeded before the leg is slowed
SLOWEST = 1e4  # a leg that has to be slowed by more passes a singular pose


class Curve(Protocol):
    """Where a leg goes: position (and orientation) over its own parameter from 0 to ``length``."""

    @property
    def length(self) -> float:
        """What the parameter runs over."""
        ...

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives."""
        ...

    @property
    def breaks(self) -> np.ndarray:
        """Parameters at which a derivative up to the fifth may jump."""
        ...

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k), and the orientation, from the jet (n, k) of the parameter."""
        ...


@dataclass(frozen=True)
class TimedSegment:
    """One run from rest to rest, beginning at ``start`` [s], in the space ``"tool"``, ``"output"`` or ``"joint"``."""

    space: str
    curve: Curve
    law: Law
    start: float = 0.0

    @property
    def smoothness(self) -> int:
        """Number of continuous derivatives of law and curve together."""
        return min(self.law.smoothness, self.curve.smoothness)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Time derivatives 0 to 5 of the position (n, d, 6), and the orientation, at the instants ``t`` [s]."""
        return self.curve(self.law(np.asarray(t, dtype=float) - self.start, JET - 1))

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which a derivative up to the fifth may jump [s]."""
        out = [self.law.breaks]
        if len(self.curve.breaks):
            low, high = np.zeros(len(self.curve.breaks)), np.full(len(self.curve.breaks), self.law.duration)
            for _ in range(60):
                middle = (low + high) / 2
                before = self.law(middle, 0)[:, 0] < self.curve.breaks
                low, high = np.where(before, middle, low), np.where(before, high, middle)
            out.append(high)
        return self.start + np.unique(np.concatenate(out))


def rates(space: str, x: np.ndarray, turn: Attitude | None, radius: float) -> np.ndarray:
    """Sizes (n, 5) of the derivatives 1 to 5 of a curve.

    Of a tool the length, or ``radius`` [m] times that of its turn where that is larger; else of the coordinate that
    changes most.
    """
    if space != "tool":
        return np.abs(x[:, :, 1:]).max(axis=1)
    out = np.linalg.norm(x[:, :, 1:], axis=1)
    if turn is not None:
        out = np.maximum(out, radius * np.linalg.norm(turn[1], axis=1))
    return np.asarray(out)


def _stretches(
    space: str, curve: Curve, bounds: tuple[float, ...], radius: float, speeds: list[float] | None
) -> list[Stretch]:
    """Parts of a curve with the speed that their curvature allows; ``speeds``: bounds for the segments of a chain."""
    if isinstance(curve, BlendedCurve):
        lengths = [part.length for part in curve.parts]
        each = speeds or [bounds[0]] * len(curve.segments)
        caps = [min(each[p.segment], each[p.segment + 1]) if p.corner else each[p.segment] for p in curve.parts]
    else:
        lengths = [curve.length / STRETCHES] * STRETCHES
        caps = [bounds[0]] * STRETCHES
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    out = []
    for k, cap in enumerate(caps):
        s = np.zeros((POINTS, JET))
        s[:, 0], s[:, 1] = np.linspace(starts[k], starts[k + 1], POINTS), 1.0
        peaks = rates(space, *curve(s), radius).max(axis=0)
        cap = cap / max(peaks[0], 1e-300)
        for order, bound in enumerate(bounds[1 : JET - 1], 2):
            if peaks[order - 1] > 0:
                cap = min(cap, float(bound / peaks[order - 1]) ** (1 / order))
        out.append(Stretch(lengths[k], cap))
    return out


def bounded_law(
    reference: Reference,
    space: str,
    curve: Curve,
    bounds: tuple[float, ...],
    smoothness: int,
    radius: float,
    q_g: np.ndarray | None,
    speeds: list[float] | None = None,
) -> SpeedLaw:
    """The law of a leg under bounds on its speed, acceleration, jerk, ..., and the limits of the model's joints.

    First each part of the curve gets the speed that its curvature allows, then the changes of speed are planned, and in
    the end all is slowed by one factor where a bound is exceeded, or a limit of a joint of the rigid arm at one of 401
    instants.

    Parameters
    ----------
    bounds : of the tool [m/s, m/s^2, ...] or of the outputs or coordinates
    smoothness : int
        0: trapezoids, else polynomial changes of speed.
    radius : float [m]
        At which a turn of the tool counts.
    q_g : array (n_g) or None
        Posture at the start, where the curve is not one of joints.
    speeds : bounds on the speed along the segments of a chain
    """
    stretches = _stretches(space, curve, bounds, radius, speeds)
    law = speed_law(stretches, (max(s.speed for s in stretches), *bounds[1:]), smoothness)
    x, turn = curve(law(np.linspace(0.0, law.duration, INSTANTS // 2 + 1)))
    found = _peaks(TimedSegment(space, curve, law), radius)
    factor = max(float(f / b) ** (1 / k) for k, (f, b) in enumerate(zip(found, bounds, strict=False), 1))
    posture = Posture(reference.equations)
    if posture.limited:
        if space == "joint":
            v, a = x[:, :, 1], x[:, :, 2]
        else:
            sample = reference.sample(space, x, turn)
            v, a = posture.rates(sample, posture.follow(sample, np.asarray(q_g)))
        factor = max(factor, posture.excess(v, a) * (1 + EXACT))
    if not factor < SLOWEST:
        raise SolverError(f"path: the limits of the joints would slow it by {factor:.1e}: it passes a singular pose")
    return law.slowed(factor) if factor > 1 + EXACT else law


def _peaks(leg: TimedSegment, radius: float) -> np.ndarray:
    """Largest sizes (5) of the derivatives along a leg: at even instants, between the breaks, and near summits."""
    end = leg.law.duration
    first, last = leg.law.breaks[:-1, None], leg.law.breaks[1:, None]
    between = first + (last - first) * np.linspace(1e-9, 1 - 1e-9, BETWEEN)
    t = np.sort(np.concatenate([np.linspace(0.0, end, INSTANTS), between.ravel()]))
    found = rates(leg.space, *leg.at(t), radius)
    high = found[1:-1] >= np.maximum(NEARLY * found.max(axis=0), np.maximum(found[:-2], found[2:]))
    summits = np.flatnonzero(high.any(axis=1)) + 1
    near = t[summits - 1, None] + (t[summits + 1] - t[summits - 1])[:, None] * np.linspace(0, 1, POINTS)
    return np.asarray(np.maximum(found.max(axis=0), rates(leg.space, *leg.at(near.ravel()), radius).max(axis=0)))


def posture_after(reference: Reference, leg: TimedSegment, q_g: np.ndarray) -> np.ndarray:
    """Actuated coordinates (n_g) of the rigid arm at the end of a leg, from those at its start."""
    x, turn = leg.at(np.linspace(leg.start, leg.start + leg.law.duration, INSTANTS // 4 + 1))
    if leg.space == "joint":
        return np.array(x[-1, :, 0])
    return Posture(reference.equations).follow(reference.sample(leg.space, x, turn), q_g)[-1]
