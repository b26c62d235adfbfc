"""Corners of a path between straight lines of the tool, and how robots pass them, in the sense of
ISO 9283.

With the programmed corner point c, the unit vectors u and w of the lines before and after it, and
the positions p_j of robot j from the middle of the first line to the middle of the second

    CR = max_j min_t |p_j - c|,
    CO = max_j max_t |d - (d.w) w|,  d = p_j - c,  where d.n > 0,  n = u - (u.w) w

Source: ISO 9283:1998, Manipulating industrial robots - Performance criteria and related test
methods, cornering deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move
from flexgen.paths.geometry.blended_curve import BlendedCurve
from flexgen.paths.geometry.path_distance import distance_from_path
from flexgen.paths.geometry.segments import Line
from flexgen.paths.path import Path
from flexgen.paths.timing.timed_segments import TimedSegment

INSTANTS = 20_001  # of a motion from rest to rest, among which the middle of a line is found
# lines that turn by less, or reverse within it, have no corner
STRAIGHT = float(np.cos(np.deg2rad(1.0)))


@dataclass(frozen=True)
class Corner:
    """A programmed corner: its ``point`` (k,) [m], unit vectors of the lines before and after it,
    and times [s].

    ``begin``, ``end``: when the command is in the middle of the line before and after it.
    """

    point: np.ndarray
    before: np.ndarray
    after: np.ndarray
    begin: float
    end: float


def find_corners(model: RobotModel, move: Move) -> tuple[Corner, ...]:
    """Corners between two consecutive straight lines of the tool in a move or program, rounded or
    with a stop.
    """
    if move.type not in ("tool_polyline", "program"):
        return ()
    path = Path(derive(model), move)
    if not path.reference.tool:
        return ()
    axes = path.reference.axes
    lines = [line for segment in path.segments for line in _lines(segment)]
    out = []
    for (start, total, begin), (corner, following, end) in pairwise(lines):
        u = total[axes]
        w = following[axes]
        sizes = float(np.linalg.norm(u)), float(np.linalg.norm(w))
        if min(sizes) > 0.0 and np.allclose(start + total, corner, rtol=0.0, atol=1e-9):
            u = u / sizes[0]
            w = w / sizes[1]
            if abs(u @ w) < STRAIGHT:
                out.append(Corner(corner[axes], u, w, begin, end))
    return tuple(out)


def _lines(segment: TimedSegment) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Start (3,) [m], displacement (3,) [m], and time in the middle [s], of the lines of a motion
    of the tool. Arcs and motions that are not of lines have a zero displacement.
    """
    curve = segment.curve
    if segment.space != "tool" or not isinstance(curve, BlendedCurve):
        return [(np.zeros(3), np.zeros(3), segment.start)]
    middles: dict[int, float] = {}
    passed = 0.0
    for section in curve.sections:
        middles.setdefault(
            section.segment, passed if section.corner else passed + section.length / 2
        )
        passed += section.length
    t = np.linspace(0.0, segment.law.duration, INSTANTS)
    x = segment.law(t, 1)[:, 0]
    return [
        (
            curve.poses[k][0],
            part.total if isinstance(part, Line) else np.zeros(3),
            segment.start + float(np.interp(middles.get(k, passed), x, t)),
        )
        for k, part in enumerate(curve.segments)
    ]


def corner_figures(
    corners: Sequence[Corner], time: np.ndarray, reference: np.ndarray, attained: np.ndarray
) -> dict[str, Any]:
    """Round-off error, that of the command, and overshoot [m]: the largest of all corners and
    robots.

    ``time`` (n,), ``reference`` (n, k), ``attained`` (robots, n, k) as of
    `flexgen.paths.accuracy.figures.path_accuracy`. The round-off is the distance of the corner's
    point from the path, the overshoot the largest distance from the next line beyond the corner.
    Empty without corners.
    """
    round_off = []
    commanded = []
    overshoot = []
    for corner in corners:
        here = (time >= corner.begin) & (time <= corner.end)
        outward = corner.before - (corner.before @ corner.after) * corner.after
        commanded.append(_nearest(reference[here] - corner.point))
        for p in attained:
            d = p[here] - corner.point
            across = d - (d @ corner.after)[:, None] * corner.after
            round_off.append(_nearest(d))
            overshoot.append(
                float(np.linalg.norm(across[d @ outward > 0.0], axis=1).max(initial=0.0))
            )
    if not corners:
        return {}
    return {
        "corner_round_off": max(round_off),
        "corner_round_off_commanded": max(commanded),
        "corner_overshoot": max(overshoot),
    }


def _nearest(d: np.ndarray) -> float:
    """Distance of the origin from the polyline through the points d (n, k)."""
    return float(distance_from_path(np.zeros((1, d.shape[1])), d)[0])
