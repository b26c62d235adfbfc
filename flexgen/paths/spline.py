"""A curve through samples: splines of position, coordinates and orientation, in time or in arc length."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.errors import ArgumentError
from flexgen.paths.arc_length import ArcTable
from flexgen.paths.jets import (
    JET,
    Attitude,
    along,
    angular_velocity,
    attitude,
    inverse,
    product,
    reverse,
    root,
)
from flexgen.paths.sample_files import Samples

STILL = 1e-3  # of the mean rate: below it arc length is no parameter


class SplineCurve:
    """The interpolating spline of odd ``degree`` through samples.

    With time the parameter is time from 0, and the first ``(degree - 1)/2`` derivatives vanish at both ends: the path
    is at rest there. Without, the parameter is the arc length (of a tool that only turns: angle times ``radius``).
    Orientation: a spline through the quaternions, scaled to length 1.
    """

    def __init__(self, samples: Samples, degree: int, radius: float, R_fixed: np.ndarray | None = None) -> None:
        values, q = samples.values, samples.quaternions
        self.timed, self.radius, self.degree, self.fixed = samples.timed, radius, degree, R_fixed
        self.width = values.shape[1]
        both = values if q is None else np.hstack([values, q])
        knots = samples.knots
        if knots is None:
            steps = np.diff(values, axis=0)
            way = np.linalg.norm(steps, axis=1)
            if q is not None:
                way = np.hypot(way, 2 * radius * np.linalg.norm(np.diff(q, axis=0), axis=1))
            knots = np.concatenate([[0.0], np.cumsum(way)])
        self.scale = float(knots[-1] - knots[0]) / (len(knots) - 1)
        knots = (knots - knots[0]) / self.scale
        ends = None
        if self.timed:
            rest = [(k, np.zeros(both.shape[1])) for k in range(1, (degree - 1) // 2 + 1)]
            ends = (rest, rest)
        spline = make_interp_spline(knots, both, k=degree, bc_type=ends)
        self._splines = [spline.derivative(k) if k else spline for k in range(JET)]
        self._moves = bool(np.ptp(values, axis=0).max() > 0)
        self.smoothness = degree - 1
        inner = np.unique(spline.t)
        if self.timed:
            self.length = float(knots[-1]) * self.scale
            self.breaks = inner * self.scale if self.smoothness < JET - 1 else np.zeros(0)
            return
        self.table = ArcTable(self._pace, np.unique(np.concatenate([knots, inner])))
        self.length = self.table.length
        fine = np.linspace(0, knots[-1], 8 * len(knots))
        rates = self._pace(fine)
        slopes = self._splines[1](fine)
        back = (slopes[1:] * slopes[:-1]).sum(axis=1) < 0
        if back.any() or not rates.min() > STILL * rates.mean():
            at = int(np.argmax(back) if back.any() else np.argmin(rates)) // 8
            raise ArgumentError(
                f"samples: given a path that nearly stands still or turns back near its sample {at + 1}, "
                "expected one that goes on (give a column t to say when)"
            )
        self.breaks = np.zeros(0)
        if self.smoothness < JET - 1:
            self.breaks = np.interp(inner, self.table.knots, self.table.lengths)

    def _at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Jets of position and quaternion in the spline's own parameter."""
        both = np.stack([spline(u) for spline in self._splines], axis=-1)
        if both.shape[1] == self.width:
            return both, None
        raw = both[:, self.width :]
        return both[:, : self.width], product(raw, inverse(root(product(raw, raw).sum(axis=1)))[:, None])

    def _pace(self, u: np.ndarray) -> np.ndarray:
        """Rate of the arc length (n,)."""
        if self._moves:
            return np.asarray(np.linalg.norm(self._splines[1](u)[:, : self.width], axis=1))
        return np.sqrt(self._rate(u)[:, 0])

    def _rate(self, u: np.ndarray) -> np.ndarray:
        """Square of the rate of the arc length and its derivatives, (n, 5)."""
        x, q = self._at(u)
        way = product(x[:, :, 1:], x[:, :, 1:]).sum(axis=1)
        if q is None or self._moves:
            return way
        w = self.radius * angular_velocity(q)
        return product(w, w).sum(axis=1)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k), and the orientation, from the jet (n, k) of the parameter."""
        if self.timed:
            u = s / self.scale
        else:
            own = self.table.parameter(np.clip(s[:, 0], 0.0, self.length))
            u = along(reverse(own, root(self._rate(own)))[:, None, :], s)[:, 0]
        x, q = self._at(u[:, 0])
        x = along(x, u)
        if q is not None:
            return x, attitude(along(q, u))
        if self.fixed is None:
            return x, None
        return x, (np.broadcast_to(self.fixed, (len(s), 3, 3)), np.zeros((len(s), 3, s.shape[1] - 1)))
