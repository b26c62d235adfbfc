"""Interpolating spline through samples of position, coordinates or orientation, in time or in arc
length.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, KroghInterpolator, make_interp_spline

from flexgen.base.errors import ArgumentError
from flexgen.paths.geometry.arc_length import ArcTable
from flexgen.paths.geometry.jets import (
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
from flexgen.paths.geometry.segments import POSITION
from flexgen.paths.samples.sample_files import Samples
from flexgen.paths.samples.sample_smoothing import kinks_of, noise_warnings, smooth_spline

# from so many samples on, speed of the first or last interval over the largest: not from rest
MANY = 20
FAST = 0.3
MIN_SPEED = 1e-3  # of the mean |dp/du|; below it arc length cannot be the parameter


def lengths_of(samples: Samples) -> int:
    """Number of the first columns that are lengths.

    Those of a tool may have an angle [rad] after them.
    """
    width = samples.values.shape[1]
    return min(width, POSITION) if samples.space == "tool" else width


def distances(samples: Samples, radius: float) -> np.ndarray:
    """Sums (n,) of the distances from sample to sample [m].

    A rotation by an angle counts as ``radius`` multiplied by it.
    """
    steps = np.diff(samples.values, axis=0)
    lengths = lengths_of(samples)
    distance = np.linalg.norm(steps[:, :lengths], axis=1)
    for turn in steps[:, lengths:].T:
        distance = np.hypot(distance, radius * turn)
    if samples.quaternions is not None:
        turn = 2 * radius * np.linalg.norm(np.diff(samples.quaternions, axis=0), axis=1)
        distance = np.hypot(distance, turn)
    return np.concatenate([[0.0], np.cumsum(distance)])


def turns_of(samples: Samples, radius: float) -> list[int]:
    """Numbers of the samples at which a path without times turns back: its direction, with
    rotations times ``radius`` [m], changes there by more than 90 deg. Empty for samples with a
    parameter.
    """
    if samples.knots is not None:
        return []
    steps = np.diff(samples.values, axis=0)
    steps[:, lengths_of(samples) :] *= radius
    if samples.quaternions is not None:
        steps = np.hstack([steps, 2 * radius * np.diff(samples.quaternions, axis=0)])
    return [int(k) + 1 for k in np.flatnonzero((steps[1:] * steps[:-1]).sum(axis=1) < 0.0)]


class SplineCurve:
    """The interpolating spline of odd ``degree`` through samples, or near them.

    ``smooth`` > 0: the largest deviation from the samples, in the unit of each of their columns,
    of orientations as an angle [rad]; see `flexgen.paths.samples.sample_smoothing`. ``notes``:
    sentences on the samples, for a user; ``warnings``: those of them that say what is wrong.
    ``unit``: of the columns, for the notes.

    If the samples have times, the parameter is the time from 0, and the first ``(degree - 1)/2``
    derivatives are zero at both ends: the path is at rest there. Otherwise the parameter is the
    arc length; if only the orientation changes, the angle times ``radius``. Orientation: a spline
    through the quaternions, normalized.
    """

    def __init__(
        self,
        samples: Samples,
        degree: int,
        radius: float,
        R_fixed: np.ndarray | None = None,
        smooth: float = 0.0,
        unit: str = "rad or m",
    ) -> None:
        values = samples.values
        q = samples.quaternions
        self.timed = samples.timed
        self.radius = radius
        self.degree = degree
        self.fixed = R_fixed
        self.width = values.shape[1]
        self.lengths = lengths_of(samples)
        both = values if q is None else np.hstack([values, q])
        knots = samples.knots if samples.knots is not None else distances(samples, radius)
        # mean interval between samples, the unit of the spline's own parameter u
        self.scale = float(knots[-1] - knots[0]) / (len(knots) - 1)
        knots = (knots - knots[0]) / self.scale
        spline = self._spline(knots, both, smooth)
        self._splines = [spline.derivative(k) if k else spline for k in range(JET)]
        self._moves = bool(np.ptp(values[:, : self.lengths], axis=0).max() > 0)
        self.smoothness = degree - 1
        inner = np.unique(spline.t)
        self.warnings = self._warnings(samples, knots, spline, smooth)
        self.notes = (*self.warnings, *self._remarks(smooth, unit))
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
            at = min(
                int(np.argmax(back) if back.any() else np.argmin(speeds)) // 8, len(knots) - 1
            )
            raise ArgumentError(
                "samples: given a path that stops or reverses near sample "
                f"{at + 1}{samples.line(at)}, expected one that moves forward; to stop on the "
                "path, add a column t with the time of each sample"
            )
        self.breaks = np.zeros(0)
        if self.smoothness < JET - 1:
            self.breaks = np.interp(inner, self.table.knots, self.table.lengths)

    def _spline(self, knots: np.ndarray, both: np.ndarray, smooth: float) -> BSpline:
        """The spline through the samples, or with ``smooth`` [m or rad] near them; sets
        `deviation`, the largest distance from them.

        ``knots`` (n,): parameters of the samples; ``both`` (n, width): their values, and
        quaternions. Samples with times begin and end at rest.
        """
        degree = self.degree
        self.deviation = 0.0
        self.inner_knots = 0
        if smooth:
            angles = both.shape[1] - self.width
            found = smooth_spline(knots, both, degree, smooth, angles, rest=self.timed)
            self.deviation = found.deviation
            self.inner_knots = found.knots
            return found.spline
        if not self.timed and len(knots) <= degree:  # one polynomial, in the degree of the others
            polynomial = KroghInterpolator(knots, both)
            knots = np.linspace(0.0, knots[-1], degree + 1)
            both = polynomial(knots)
        ends = None
        if self.timed:
            at_rest = [(k, np.zeros(both.shape[1])) for k in range(1, (degree - 1) // 2 + 1)]
            ends = (at_rest, at_rest)
        return make_interp_spline(knots, both, k=degree, bc_type=ends)

    def _remarks(self, smooth: float, unit: str) -> tuple[str, ...]:
        """A sentence on a path near the samples: its deviation, with the unit of the columns."""
        if not smooth:
            return ()
        return (
            f"its path is at most {self.deviation:.2g} {unit} from the samples "
            f"(smooth = {smooth:g} {unit}), with {self.inner_knots} knots",
        )

    def _warnings(
        self, samples: Samples, knots: np.ndarray, spline: BSpline, smooth: float
    ) -> tuple[str, ...]:
        """Sentences on samples that a path cannot follow: motion at an end, noise, kinks."""
        values = samples.values
        many = len(samples.values) >= MANY
        notes = list(_in_motion(knots, values) if self.timed and many else ())
        if smooth:
            return tuple(notes)
        names = samples.names or tuple(f"column {k + 1}" for k in range(self.width))
        scale = self.scale if self.timed else 1.0
        kinks = kinks_of(knots, values, self.timed)
        if kinks:
            at, turn = kinks[0]
            what = (
                f"the speed changes by {100 * turn:.0f} % of its largest value"
                if self.timed
                else f"the direction changes by {np.degrees(turn):.0f} deg"
            )
            more = f", and at {len(kinks) - 1} more" if len(kinks) > 1 else ""
            notes.append(
                f"its samples have a kink at sample {at + 1}{samples.line(at)}{more}: {what} from "
                "one sample to the next, which no smooth path follows; the path swings about the "
                "samples there: round the corner in the samples, or set smooth to the largest "
                "deviation that is allowed"
            )
        if many and not kinks:
            notes += noise_warnings(knots, values, spline, names, scale, self.timed)
        return tuple(notes)

    def _at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Jets in u of position (n, d, `JET`) and unit quaternion (n, 4, `JET`), at ``u`` (n,).

        None instead of a quaternion: the samples have no orientation.
        """
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
        """Position and orientation along the path, with their derivatives in time.

        Internally the spline has a parameter u of its own: samples are on average 1 apart in u.

        Parameters
        ----------
        s : array (n, k)
            Jet of the path parameter at n instants: its value and its first k - 1 derivatives in
            time. The parameter is the time since the first sample [s] where the samples have
            times, else the arc length; an arc length beyond an end is moved to this end.

        Returns
        -------
        tuple of array (n, d, k) and Attitude or None
            Jet of the d columns of the samples, in their units; rotation matrix with angular
            velocity and its derivatives, constant where the orientation is fixed; None: the path
            has no orientation.
        """
        if self.timed:
            u = s / self.scale
        else:
            u_of_points = self.table.parameter(np.clip(s[:, 0], 0.0, self.length))
            ds_du = square_root(self._speed_squared(u_of_points))
            u_of_s = inverse_function(u_of_points, ds_du)
            u = compose(u_of_s[:, None, :], s)[:, 0]
        # derivatives in u, which the chain rule turns into derivatives in time
        x, quaternion = self._at(u[:, 0])
        x = compose(x, u)
        if quaternion is not None:
            return x, attitude(compose(quaternion, u))
        if self.fixed is None:
            return x, None
        constant = np.broadcast_to(self.fixed, (len(s), 3, 3))
        no_rotation = np.zeros((len(s), 3, s.shape[1] - 1))
        return x, (constant, no_rotation)


def _in_motion(knots: np.ndarray, values: np.ndarray) -> tuple[str, ...]:
    """A sentence for each end at which the samples, unlike the path, are not at rest."""
    speeds = np.linalg.norm(np.diff(values, axis=0), axis=1) / np.diff(knots)
    return tuple(
        f"its samples {word} at {100 * speed / speeds.max():.0f} % of their largest speed, the "
        f"path at rest: add samples {more} rest"
        for speed, word, more in ((speeds[0], "begin", "from"), (speeds[-1], "end", "until"))
        if speed > FAST * speeds.max() > 0.0
    )
