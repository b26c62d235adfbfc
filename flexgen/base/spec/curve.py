"""A key whose value is a curve of the largest torque over the speed, as points of a convex
region.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.keys import Key
from flexgen.base.spec.tables import Table

TORQUE_SPEED = (
    "two or more points [speed, torque] of the largest torque over the speed: the speed rises "
    "from 0, the torque falls, and falls faster from point to point"
)


def is_torque_speed(points: np.ndarray) -> bool:
    """Whether points (n, 2) bound a convex region: speeds rise from 0, torques fall, and fall
    faster and faster.
    """
    if (
        points.ndim != 2
        or points.shape[1] != 2
        or len(points) < 2
        or not np.isfinite(points).all()
    ):
        return False
    speeds, torques = np.diff(points, axis=0).T
    if (
        points[0, 0] != 0.0
        or points[0, 1] <= 0.0
        or points[-1, 1] < 0.0
        or not (speeds > 0.0).all()
    ):
        return False
    rates = torques / speeds
    return bool((rates <= 0.0).all() and (np.diff(rates) <= 1e-9 * np.abs(rates).max()).all())


def points_of(curve: Any) -> np.ndarray | None:
    """Points (n, 2) of a curve, (0, 2) of an empty one; None where they are not those of a
    torque-speed curve.
    """
    try:
        points = np.array(curve, dtype=float)
    except (TypeError, ValueError):
        return None
    if points.size == 0:
        return points.reshape(0, 2)
    return points if is_torque_speed(points) else None


def checked_curves(
    name: str, curves: Sequence[Any]
) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Curves of motors as tuples of (speed, torque), empty for a motor without one; an empty tuple
    where no motor has one. ArgumentError where one is not a curve; ``name``: of the argument.
    """
    out = []
    for curve in curves:
        points = points_of(curve)
        if points is None:
            raise ArgumentError(
                f"{name}: given {show_value(curve)}, expected {TORQUE_SPEED}; or nothing"
            )
        out.append(tuple((float(speed), float(torque)) for speed, torque in points))
    return tuple(out) if any(out) else ()


def read_curve(table: Table, key: Key) -> tuple[tuple[float, float], ...]:
    """The points of a torque-speed curve; ModelError where they are none."""
    entries = table.entries[key.name].value
    rows = [one.value for one in entries] if isinstance(entries, list) else []
    pairs = [[x.value for x in row] if isinstance(row, list) else [] for row in rows]
    if not all(len(pair) == 2 and all(type(x) in (int, float) for x in pair) for pair in pairs):
        raise table.fail(key.name, TORQUE_SPEED)
    curve = np.array(pairs, dtype=float)
    if not is_torque_speed(curve):
        raise table.fail(key.name, TORQUE_SPEED)
    return tuple((float(x), float(y)) for x, y in curve)
