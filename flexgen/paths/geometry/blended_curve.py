"""Consecutive segments as one curve: corners blended within their zones, arc length as parameter.

Near the corner between two segments, over the parameter range of ``z`` (the zone) to either side,
the first still moves while the second has started: with lengths covered l_1(u), l_2(u)

    p(u) = p_corner + (c_1(l_1) - c_1(L_1)) + c_2(l_2),        l_2 = z a((u - u_corner)/z),
    a'' a bump on [-1, 1]

and likewise the rotations, R = R_2(l_2) R_1(l_1). Outside a(x) = x or 0, so the curve leaves the
first segment and joins the second with as many continuous derivatives as the bump has; as a(x) +
a(-x) <= 1 it stays within z of the corner. If the parameters of both segments are arc lengths, a
table converts the parameter of the corner to arc length.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from flexgen.paths.geometry.arc_length import ArcTable
from flexgen.paths.geometry.jets import (
    JET,
    Attitude,
    attitude,
    compose,
    inverse_function,
    product,
    quaternion,
    quaternion_product,
    rotation_matrices,
    square_root,
)
from flexgen.paths.geometry.segments import POSITION, Segment, attitude_along, rotation_along
from flexgen.paths.geometry.trigonometry import root
from flexgen.paths.timing.time_laws import TimeLaw

BUMP = 4  # continuous derivatives of a'; those of the curve are one more
PANELS = 24  # of the arc-length table of a corner
MIN_CORNER_SPEED = 0.05  # smallest |dp/du| in a corner; below it the path reverses
ANALYTIC = 99  # continuous derivatives of a curve without corners


@dataclass(frozen=True)
class Section:
    """A section of a blended curve: the straight section of one segment, or the corner between it
    and the next one.
    """

    segment: int
    corner: bool
    length: float
    start: float  # parameter at its start


class BlendedCurve:
    """The curve of consecutive segments with blended corners.

    Parameters
    ----------
    start : array (d)
    R_start : array (3, 3) or None
        Orientation of the tool at the start; None if the curve has no orientation.
    segments : list of Segment
    zones : list of float
        Zones [unit of the parameter] at the ends of all segments but the last.
    """

    def __init__(
        self,
        start: np.ndarray,
        R_start: np.ndarray | None,
        segments: list[Segment],
        zones: list[float],
    ) -> None:
        self.start = np.asarray(start, dtype=float)
        self.segments = segments
        self.zones = zones
        self.R_start = None if R_start is None else np.asarray(R_start, dtype=float)
        self.ends = np.cumsum([segment.length for segment in segments])
        self.smoothness = BUMP + 1 if any(z > 0 for z in zones) else ANALYTIC
        self.breaks = np.zeros(0)

    @cached_property
    def poses(self) -> list[tuple[np.ndarray, np.ndarray | None]]:
        """Position and orientation before each segment, and after the last."""
        out = [(self.start, self.R_start)]
        for segment in self.segments:
            position, R = out[-1]
            angle = float(np.linalg.norm(segment.rotation))
            if R is not None and angle > 0:
                R = rotation_matrices(segment.rotation / angle, np.array([angle]))[0] @ R
            out.append((position + segment.total, R))
        return out

    @property
    def end(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Position (d) and orientation (3, 3) at the end."""
        return self.poses[-1]

    @cached_property
    def sections(self) -> list[Section]:
        """Segments and corners in order."""
        out = []
        zones = [0.0, *self.zones, 0.0]
        for k, segment in enumerate(self.segments):
            start = float(self.ends[k]) - segment.length + zones[k]
            straight = segment.length - zones[k] - zones[k + 1]
            if straight > 1e-12 * segment.length:
                out.append(Section(k, False, straight, start))
            if zones[k + 1] > 0:
                table = self.tables[k]
                length = 2 * zones[k + 1] if table is None else table.length
                out.append(Section(k, True, length, float(self.ends[k]) - zones[k + 1]))
        return out

    @cached_property
    def tables(self) -> list[ArcTable | None]:
        """Arc lengths of the corners; None where the parameter is not to become the arc length."""
        out: list[ArcTable | None] = []
        for k, zone in enumerate(self.zones):
            if zone == 0 or not (
                self.segments[k].by_arc_length and self.segments[k + 1].by_arc_length
            ):
                out.append(None)
                continue
            knots = self.ends[k] + zone * np.linspace(-1, 1, PANELS + 1)
            out.append(ArcTable(partial(self._speed, k), knots))
        return out

    def min_corner_speed(self, k: int) -> float:
        """Smallest |dp/du| in the corner at the end of segment k; 1 on the segments."""
        if not (self.segments[k].by_arc_length and self.segments[k + 1].by_arc_length):
            return 1.0
        u = self.ends[k] + self.zones[k] * np.linspace(-1, 1, 201)
        return float(self._speed(k, u).min())

    def _speed(self, k: int, u: np.ndarray) -> np.ndarray:
        """|dp/du| (n,) of the position in the corner at the end of segment k."""
        x = self._corner(k, _identity(u)[:, :2], False)[0][:, :POSITION, 1]
        return root(_sum_in_order(x * x))

    def _speed_squared(self, k: int, u: np.ndarray) -> np.ndarray:
        """Square of |dp/du| and its derivatives, (n, 5), in the corner at the end of segment k."""
        x = self._corner(k, _identity(u), False)[0][:, :POSITION, 1:]
        return _sum_in_order(product(x, x))

    def _corner(
        self, k: int, u: np.ndarray, rotate: bool = True
    ) -> tuple[np.ndarray, Attitude | None]:
        """Jet of the position (n, 3, k), and orientation, in the corner after segment ``k``, from
        the jet ``u`` (n, k) of the parameter.

        The parameter of the segment before slows down to its end over the zone while that of the
        segment after speeds up, so both displacements add up. ``rotate`` False: without
        orientation, None.
        """
        before = self.segments[k]
        after = self.segments[k + 1]
        zone = self.zones[k]
        step = TimeLaw(2 * zone, BUMP)
        rise = step.with_integral(u[:, 0] - (self.ends[k] - zone), u.shape[1] - 1)
        fall = step.with_integral(self.ends[k] + zone - u[:, 0], u.shape[1] - 1) * (
            -1.0
        ) ** np.arange(u.shape[1])
        covered = compose(rise[:, None, :], u)[:, 0]
        remaining = compose(fall[:, None, :], u)[:, 0]
        first = -remaining
        first[:, 0] += before.length
        position, R = self.poses[k]
        x = before.displacement(first) + after.displacement(covered)
        x[:, :, 0] += position
        if R is None or not rotate:
            return x, None
        initial = np.zeros((len(u), 4, u.shape[1]))
        initial[:, :, 0] = quaternion(R)
        return x, attitude(
            quaternion_product(
                rotation_along(after, covered),
                quaternion_product(rotation_along(before, first), initial),
            )
        )

    @property
    def length(self) -> float:
        """Range of the parameter: the arc length where all segments are parametrized by it."""
        return sum(section.length for section in self.sections)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k) of the position, and the orientation, from the jet (n, k) of the arc
        length.
        """
        x = np.zeros((len(s), len(self.start), s.shape[1]))
        R = np.zeros((len(s), 3, 3))
        w = np.zeros((len(s), 3, s.shape[1] - 1))
        starts = np.concatenate([[0.0], np.cumsum([section.length for section in self.sections])])
        at = np.clip(np.searchsorted(starts, s[:, 0], side="right") - 1, 0, len(self.sections) - 1)
        for k, section in enumerate(self.sections):
            here = at == k
            if not here.any():
                continue
            inner = s[here].copy()
            inner[:, 0] -= starts[k]
            if section.corner:
                x[here], rotation = self._corner(section.segment, self._parameter(section, inner))
            else:
                segment = self.segments[section.segment]
                inner[:, 0] += section.start - (self.ends[section.segment] - segment.length)
                position, before = self.poses[section.segment]
                moved = segment.displacement(inner)
                moved[:, :, 0] += position
                x[here] = moved
                rotation = None if before is None else attitude_along(segment, inner, before)
            if rotation is not None:
                R[here], w[here] = rotation
        return x, None if self.R_start is None else (R, w)

    def _parameter(self, section: Section, s: np.ndarray) -> np.ndarray:
        """Jet (n, k) of the parameter in a corner from the jet ``s`` (n, k) of the arc length
        since its start: the inverse function of the arc length.
        """
        table = self.tables[section.segment]
        if table is None:
            u = s.copy()
            u[:, 0] += section.start
            return u
        u = table.parameter(s[:, 0])
        return compose(
            inverse_function(u, square_root(self._speed_squared(section.segment, u)))[:, None, :],
            s,
        )[:, 0]


def _sum_in_order(x: np.ndarray) -> np.ndarray:
    """Sums over the second axis, one entry after the other, as in C."""
    total = x[:, 0]
    for i in range(1, x.shape[1]):
        total = total + x[:, i]
    return total


def _identity(u: np.ndarray) -> np.ndarray:
    """Jet (n, `JET`) of a parameter with respect to itself: value u (n,), derivative 1, then 0."""
    out = np.zeros((len(u), JET))
    out[:, 0] = u
    out[:, 1] = 1.0
    return out
