"""A chain of segments as one curve: corners rounded within their zones, parameter arc length, orientation along.

Near the corner between two segments, over the parameter range of ``z`` (the zone) to either side, the first is still
being finished while the second has begun: with lengths covered l_1(u), l_2(u)

    p(u) = p_corner + (c_1(l_1) - c_1(L_1)) + c_2(l_2),        l_2 = z a((u - u_corner)/z),   a'' a bump on [-1, 1]

and likewise the turns, R = R_2(l_2) R_1(l_1). Outside a(x) = x or 0, so the curve leaves the first segment and joins
the second with all derivatives that the bump gives, and as a(x) + a(-x) <= 1 it stays within z of the corner. Where
lengths are arc lengths, a table turns the parameter of the corner into arc length too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from flexgen.paths.arc_length import ArcTable
from flexgen.paths.jets import (
    JET,
    Attitude,
    along,
    attitude,
    hamilton,
    product,
    quaternion,
    reverse,
    root,
    turns,
)
from flexgen.paths.segments import Segment, attitude_along, turned
from flexgen.paths.time_laws import TimeLaw

BUMP = 4  # continuous derivatives of a'; those of the curve are one more
PANELS = 24  # of the arc-length table of a corner
SHARPEST = 0.05  # smallest rate in a corner, of 1: below it the path turns back
ANALYTIC = 99  # continuous derivatives of a curve without corners


@dataclass(frozen=True)
class Part:
    """A stretch of a chain in arc length: of one segment, or the corner between it and the next one."""

    segment: int
    corner: bool
    length: float
    first: float  # parameter at its start


class BlendedCurve:
    """The curve of a chain of segments.

    Parameters
    ----------
    start : array (d)
    R_start : array (3, 3) or None
        Orientation of the tool at the start; None for coordinates.
    segments : list of Segment
    zones : list of float
        At the ends of all segments but the last.
    """

    def __init__(
        self, start: np.ndarray, R_start: np.ndarray | None, segments: list[Segment], zones: list[float]
    ) -> None:
        self.start, self.segments, self.zones = np.asarray(start, dtype=float), segments, zones
        self.R_start = None if R_start is None else np.asarray(R_start, dtype=float)
        self.ends = np.cumsum([segment.length for segment in segments])
        self.smoothness = BUMP + 1 if any(z > 0 for z in zones) else ANALYTIC
        self.breaks = np.zeros(0)

    @cached_property
    def _starts(self) -> list[tuple[np.ndarray, np.ndarray | None]]:
        """Position and orientation before each segment, and after the last."""
        out = [(self.start, self.R_start)]
        for segment in self.segments:
            position, R = out[-1]
            angle = float(np.linalg.norm(segment.turn))
            if R is not None and angle > 0:
                R = turns(segment.turn / angle, np.array([angle]))[0] @ R
            out.append((position + segment.total, R))
        return out

    @property
    def end(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Position (d) and orientation (3, 3) at the end."""
        return self._starts[-1]

    @cached_property
    def parts(self) -> list[Part]:
        """Segments and corners in turn."""
        out = []
        zones = [0.0, *self.zones, 0.0]
        for k, segment in enumerate(self.segments):
            first = float(self.ends[k]) - segment.length + zones[k]
            straight = segment.length - zones[k] - zones[k + 1]
            if straight > 1e-12 * segment.length:
                out.append(Part(k, False, straight, first))
            if zones[k + 1] > 0:
                table = self._tables[k]
                length = 2 * zones[k + 1] if table is None else table.length
                out.append(Part(k, True, length, float(self.ends[k]) - zones[k + 1]))
        return out

    @cached_property
    def _tables(self) -> list[ArcTable | None]:
        out: list[ArcTable | None] = []
        for k, zone in enumerate(self.zones):
            if zone == 0 or not (self.segments[k].led and self.segments[k + 1].led):
                out.append(None)
                continue
            knots = self.ends[k] + zone * np.linspace(-1, 1, PANELS + 1)
            out.append(ArcTable(partial(self._pace, k), knots))
        return out

    def sharpest(self, k: int) -> float:
        """Smallest speed [of 1] in the corner at the end of segment k, if the parameter runs evenly."""
        if not (self.segments[k].led and self.segments[k + 1].led):
            return 1.0
        u = self.ends[k] + self.zones[k] * np.linspace(-1, 1, 201)
        return float(self._pace(k, u).min())

    def _pace(self, k: int, u: np.ndarray) -> np.ndarray:
        """|dp/du| (n,) there."""
        return np.asarray(np.linalg.norm(self._corner(k, _identity(u)[:, :2], False)[0][:, :, 1], axis=1))

    def _rate(self, k: int, u: np.ndarray) -> np.ndarray:
        """Square of |dp/du| and its derivatives, (n, 5), in the corner at the end of segment k."""
        x = self._corner(k, _identity(u), False)[0][:, :, 1:]
        return product(x, x).sum(axis=1)

    def _corner(self, k: int, u: np.ndarray, turning: bool = True) -> tuple[np.ndarray, Attitude | None]:
        """Jet of the position, and orientation, in the corner after segment k, from the jet of the parameter."""
        before, after, zone = self.segments[k], self.segments[k + 1], self.zones[k]
        step = TimeLaw(2 * zone, BUMP)
        rise = step.with_integral(u[:, 0] - (self.ends[k] - zone), u.shape[1] - 1)
        fall = step.with_integral(self.ends[k] + zone - u[:, 0], u.shape[1] - 1) * (-1.0) ** np.arange(u.shape[1])
        covered = along(rise[:, None, :], u)[:, 0]
        remaining = along(fall[:, None, :], u)[:, 0]
        first = -remaining
        first[:, 0] += before.length
        position, R = self._starts[k]
        x = before.displacement(first) + after.displacement(covered)
        x[:, :, 0] += position
        if R is None or not turning:
            return x, None
        still = np.zeros((len(u), 4, u.shape[1]))
        still[:, :, 0] = quaternion(R)
        return x, attitude(hamilton(turned(after, covered), hamilton(turned(before, first), still)))

    @property
    def length(self) -> float:
        """Arc length, or what stands for it."""
        return sum(part.length for part in self.parts)

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, d, k) of the position, and the orientation, from the jet (n, k) of the arc length."""
        x = np.zeros((len(s), len(self.start), s.shape[1]))
        R, w = np.zeros((len(s), 3, 3)), np.zeros((len(s), 3, s.shape[1] - 1))
        starts = np.concatenate([[0.0], np.cumsum([part.length for part in self.parts])])
        at = np.clip(np.searchsorted(starts, s[:, 0], side="right") - 1, 0, len(self.parts) - 1)
        for k, part in enumerate(self.parts):
            here = at == k
            if not here.any():
                continue
            inner = s[here].copy()
            inner[:, 0] -= starts[k]
            if part.corner:
                x[here], turn = self._corner(part.segment, self._parameter(part, inner))
            else:
                segment = self.segments[part.segment]
                inner[:, 0] += part.first - (self.ends[part.segment] - segment.length)
                position, before = self._starts[part.segment]
                way = segment.displacement(inner)
                way[:, :, 0] += position
                x[here] = way
                turn = None if before is None else attitude_along(segment, inner, before)
            if turn is not None:
                R[here], w[here] = turn
        return x, None if self.R_start is None else (R, w)

    def _parameter(self, part: Part, s: np.ndarray) -> np.ndarray:
        """Jet of the parameter in a corner from the jet of the arc length since its start."""
        table = self._tables[part.segment]
        if table is None:
            u = s.copy()
            u[:, 0] += part.first
            return u
        u = table.parameter(s[:, 0])
        return along(reverse(u, root(self._rate(part.segment, u)))[:, None, :], s)[:, 0]


def _identity(u: np.ndarray) -> np.ndarray:
    out = np.zeros((len(u), JET))
    out[:, 0], out[:, 1] = u, 1.0
    return out
