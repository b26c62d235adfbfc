"""Interpolating spline through samples of position, coordinates or orientation, in time or in arc length."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.errors import ArgumentError
from flexgen.paths.arc_length import ArcTable
from flexgen.paths.jets import (
    JET,
    Attitude,
    angular_velocity,
    attitude,
    compose,
    inverse_function,
    product,
    reciprocal,
    square_root,
)
from flexgen.paths.sample_files import Samples
from flexgen.paths.segments import POSITION

# from so many samples on, speed of the first or last interval over the largest: not from rest
MANY, FAST = 20, 0.3
MIN_SPEED = 1e-3  # of the mean |dp/du|; below it arc length cannot be the parameter


class SplineCurve:
    """The interpolating spline of odd ``degree`` through samples.

    If the samples have times, the parameter is the time from 0, and the first ``(degree - 1)/2`` derivatives are zero
    at both ends: the path is at rest there. Otherwise the parameter is the arc length; if only the orientation changes,
    the angle times ``radius``. Orientation: a spline through the quaternions, normalized.
    """

    def __init__(
        self, samples: Samples, degree: int, radius: float, R_fixed: np.ndarray | None = None
    ) -> None:
        values, q = samples.values, samples.quaternions
        self.timed, self.radius, self.degree, self.fixed = samples.timed, radius, degree, R_fixed
        self.width = values.shape[1]
        # columns that are lengths; those of a tool may have an angle [rad] after them
        self.lengths = min(self.width, POSITION) if samples.space == "tool" else self.width
        both = values if q is None else np.hstack([values, q])
        knots = samples.knots
        if knots is None:
            steps = np.diff(values, axis=0)
            distance = np.linalg.norm(steps[:, : self.lengths], axis=1)
            for turn in steps[:, self.lengths :].T:
                distance = np.hypot(distance, radius * turn)
            if q is not None:
                distance = np.hypot(
                    distance, 2 * radius * np.linalg.norm(np.diff(q, axis=0), axis=1)
                )
            knots = np.concatenate([[0.0], np.cumsum(distance)])
        self.scale = float(knots[-1] - knots[0]) / (len(knots) - 1)
        knots = (knots - knots[0]) / self.scale
        ends = None
        if self.timed:
            at_rest = [(k, np.zeros(both.shape[1])) for k in range(1, (degree - 1) // 2 + 1)]
            ends = (at_rest, at_rest)
        self.in_motion = _in_motion(knots, values) if self.timed and len(values) >= MANY else ()
        spline = make_interp_spline(knots, both, k=degree, bc_type=ends)
        self._splines = [spline.derivative(k) if k else spline for k in range(JET)]
        self._moves = bool(np.ptp(values[:, : self.lengths], axis=0).max() > 0)
        self.smoothness = degree - 1
        inner = np.unique(spline.t)
        if self.timed:
            self.length = float(knots[-1]) * self.scale
            self.breaks = inner * self.scale if self.smoothness < JET - 1 else np.zeros(0)
            return
        self.table = ArcTable(self._speed, np.unique(np.concatenate([knots, inner])))
        self.length = self.table.length
        fine = np.linspace(0, knots[-1], 8 * len(knots))
        speeds = self._speed(fine)
        tangents = self._splines[1](fine)
        back = (tangents[1:] * tangents[:-1]).sum(axis=1) < 0
        if back.any() or not speeds.min() > MIN_SPEED * speeds.mean():
            at = int(np.argmax(back) if back.any() else np.argmin(speeds)) // 8
            raise ArgumentError(
                f"samples: given a path that stops or reverses near sample {at + 1}, expected one that moves forward; "
                "to stop on the path, add a column t with the time of each sample"
            )
        self.breaks = np.zeros(0)
        if self.smoothness < JET - 1:
            self.breaks = np.interp(inner, self.table.knots, self.table.lengths)

    def _at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Jets of position and quaternion in the parameter of the spline."""
        both = np.stack([spline(u) for spline in self._splines], axis=-1)
        if both.shape[1] == self.width:
            return both, None
        raw = both[:, self.width :]
        return both[:, : self.width], product(
            raw, reciprocal(square_root(product(raw, raw).sum(axis=1)))[:, None]
        )

    def _speed(self, u: np.ndarray) -> np.ndarray:
        """|dp/du| (n,)."""
        if self._moves:
            return np.asarray(np.linalg.norm(self._splines[1](u)[:, : self.lengths], axis=1))
        return np.sqrt(self._speed_squared(u)[:, 0])

    def _speed_squared(self, u: np.ndarray) -> np.ndarray:
        """Square of |dp/du| and its derivatives, (n, 5)."""
        x, q = self._at(u)
        line = x[:, : self.lengths, 1:]
        squared = product(line, line).sum(axis=1)
        if self._moves:
            return squared
        if q is None:
            turning = self.radius * x[:, self.lengths :, 1:]
            return squared if self.lengths == self.width else product(turning, turning).sum(axis=1)
        w = self.radius * angular_velocity(q)
        return product(w, w).sum(axis=1)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k), and the orientation, from the jet (n, k) of the parameter."""
        if self.timed:
            u = s / self.scale
        else:
            own = self.table.parameter(np.clip(s[:, 0], 0.0, self.length))
            u = compose(
                inverse_function(own, square_root(self._speed_squared(own)))[:, None, :], s
            )[:, 0]
        x, q = self._at(u[:, 0])
        x = compose(x, u)
        if q is not None:
            return x, attitude(compose(q, u))
        if self.fixed is None:
            return x, None
        return x, (
            np.broadcast_to(self.fixed, (len(s), 3, 3)),
            np.zeros((len(s), 3, s.shape[1] - 1)),
        )


def _in_motion(knots: np.ndarray, values: np.ndarray) -> tuple[str, ...]:
    """A sentence for each end at which the samples, unlike the path, are not at rest."""
    speeds = np.linalg.norm(np.diff(values, axis=0), axis=1) / np.diff(knots)
    return tuple(
        f"its samples {word} at {100 * speed / speeds.max():.0f} % of their largest speed, the path at rest: add "
        f"samples {more} rest"
        for speed, word, more in ((speeds[0], "begin", "from"), (speeds[-1], "end", "until"))
        if speed > FAST * speeds.max() > 0.0
    )
