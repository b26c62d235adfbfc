"""Circles, corners and turns: every derivative against high precision, zones kept, planted bugs
seen.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb

import mpmath as mp
import numpy as np
import pytest
from exact_paths import (
    DIGITS,
    bump_integrals,
    corner_length,
    corner_point,
    derivatives,
    polynomial_law,
    spin,
    turn,
)

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.model.moves import Move, MoveC, MoveL
from flexgen.paths.geometry import blended_curve
from flexgen.paths.geometry.segments import Line, circle_through
from flexgen.paths.path import Path

# Sums of up to some ten terms of the size of the largest, each rounded; the fifth derivative loses
# most.
EXACT = 1e-11


@pytest.fixture(scope="module")
def robot():
    return flexgen.derive("manutec_r3")


@pytest.fixture(scope="module")
def start(robot):
    return robot.model.move("line").start


def worst(found: np.ndarray, right: np.ndarray, scale: np.ndarray) -> float:
    """Largest difference of derivatives (rows, orders), in units of the size of each order."""
    return float((np.abs(found - right).max(axis=0) / scale).max())


def sizes(values: np.ndarray) -> np.ndarray:
    """Largest size of each derivative on a path (n, d, k)."""
    return np.abs(values).max(axis=(0, 1))


def circle_error(robot, start, **changes) -> float:
    """Largest error of a circle with a turn, against the sine and cosine in high precision."""
    center = (0.05, 0.12, -0.03)
    axis = (0.3, -0.2, 1.0)
    angle = 1.9
    rotation = (0.2, 0.4, -0.3)
    move = Move(
        "arc",
        "tool_circle",
        start,
        0.8,
        5,
        center=center,
        axis=axis,
        angle=angle,
        rotation=rotation,
    )
    path = Path(robot, replace(move, **changes))
    times = [0.1, 0.35, 0.71]
    sample = path.sample(np.array(times))
    every = path.sample(np.linspace(0, 0.8, 101))
    law = polynomial_law(0.8, 5)
    p0, R0 = path.reference.tool_pose(start)
    R0 = mp.matrix(R0.tolist())

    def place(t):
        p = mp.matrix(center) - turn(axis, angle * law(t)) * mp.matrix(center)
        R = turn(rotation, mp.norm(mp.matrix(rotation)) * law(t)) * R0
        return [p0[i] + p[i] for i in range(3)] + [R[i, j] for i in range(3) for j in range(3)]

    error = 0.0
    for k, t in enumerate(times):
        right = derivatives(place, t, 5)
        error = max(error, worst(sample.y[k], right[:3], sizes(every.y)))
        error = max(error, float(np.abs(sample.R[k].ravel() - right[3:, 0]).max()))
        error = max(error, worst(sample.w[k], spin(right[3:]), sizes(every.w)))
    return error


def test_circle_derivatives_are_exact(robot, start) -> None:
    assert circle_error(robot, start) < EXACT
    assert circle_error(robot, start, angle=1.9 + 1e-9) > EXACT  # a planted error


def test_a_wrong_chain_rule_would_be_seen(robot, start, monkeypatch: pytest.MonkeyPatch) -> None:
    from flexgen.paths.geometry import jets

    monkeypatch.setattr(jets, "comb", lambda n, k: 4 if (n, k) == (4, 2) else comb(n, k))
    assert circle_error(robot, start) > 1e3 * EXACT


def corner_path(robot, start) -> Path:
    legs = (
        MoveL((0.12, 0.0, 0.0), rotation=(0.3, 0.1, 0.0), zone=0.05),
        MoveL((0.05, 0.11, 0.0), rotation=(0.0, 0.0, 0.5)),
    )
    return Path(robot, Move("corner", "tool_polyline", start, 0.9, 6, legs=legs, radius=0.1))


@pytest.fixture(scope="module")
def exact_corner(robot, start) -> tuple[float, np.ndarray]:
    """An instant inside a rounded corner with turns, and the pose there: arc length by quadrature,
    60 digits.
    """
    path = corner_path(robot, start)
    curve = path.segments[0].curve
    p0, R0 = path.reference.tool_pose(start)
    R0 = mp.matrix(R0.tolist())
    turns = ((0.3, 0.1, 0.0), (0.0, 0.0, 0.5))
    law = polynomial_law(0.9, 6)
    with mp.workdps(DIGITS):
        zone = mp.mpf(0.05)
        ways = [mp.matrix(leg.displacement) for leg in path.move.legs]
        lengths = [mp.norm(way) for way in ways]
        d1, d2 = ([x / n for x in way] for way, n in zip(ways, lengths, strict=True))
        _, area = bump_integrals(4)
        before = lengths[0] - zone
        after = lengths[1] - zone
        inside = corner_length(d1, d2, zone)

    def place(t):
        x = corner_point(d1, d2, zone, law(t) * (before + inside + after) - before)
        l1 = lengths[0] - zone * area(-x)
        l2 = zone * area(x)
        p = [mp.mpf(p0[i]) + d1[i] * l1 + d2[i] * l2 for i in range(3)]
        R1 = turn(turns[0], mp.norm(mp.matrix(turns[0])) * l1 / lengths[0])
        R = turn(turns[1], mp.norm(mp.matrix(turns[1])) * l2 / lengths[1]) * R1 * R0
        return p + [R[i, j] for i in range(3) for j in range(3)]

    times = np.linspace(0, 0.9, 20001)
    s = path.segments[0].law(times, 0)[:, 0]
    t = float(np.interp(curve.sections[0].length + 0.4 * curve.sections[1].length, s, times))
    return t, derivatives(place, t, 5)


def corner_error(robot, start, exact_corner) -> float:
    """Largest error there."""
    t, right = exact_corner
    path = corner_path(robot, start)
    sample = path.sample(np.array([t]))
    every = path.sample(np.linspace(0, 0.9, 301))
    return max(
        worst(sample.y[0], right[:3], sizes(every.y)),
        float(np.abs(sample.R[0].ravel() - right[3:, 0]).max()),
        worst(sample.w[0], spin(right[3:]), sizes(every.w)),
    )


@pytest.mark.slow
def test_corner_derivatives_are_exact(robot, start, exact_corner) -> None:
    assert corner_error(robot, start, exact_corner) < EXACT


@pytest.mark.slow
def test_a_wrong_arc_length_would_be_seen(
    robot, start, exact_corner, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = blended_curve.inverse_function
    factor = np.array([1, 1, 1, 1, 1, 1 + 1e-7])
    monkeypatch.setattr(
        blended_curve, "inverse_function", lambda u, slope: right(u, slope) * factor
    )
    assert corner_error(robot, start, exact_corner) > 10 * EXACT


def test_corners_have_unit_speed_and_join_smoothly(robot, start) -> None:
    curve = corner_path(robot, start).segments[0].curve
    s = np.zeros((20001, 6))
    s[:, 0] = np.linspace(0, curve.length, len(s))
    s[:, 1] = 1.0
    x = curve(s)[0]
    assert np.abs(np.linalg.norm(x[:, :, 1], axis=1) - 1).max() < 1e-13
    edges = np.cumsum([section.length for section in curve.sections])[:-1]
    # fifth derivative included: the change next to an edge is that of a slope
    for order in range(6):
        around = [np.zeros((2, 6)), np.zeros((2, 6))]
        for side, shift in zip(around, (-1e-9, 1e-9), strict=True):
            side[:, 0] = edges + shift
            side[:, 1] = 1.0
        change = np.abs(curve(around[1])[0][:, :, order] - curve(around[0])[0][:, :, order]).max()
        assert change < 1e-5 * max(1.0, np.abs(x[:, :, order]).max()), order


@pytest.mark.parametrize("seed", range(12))
def test_zones_are_kept(robot, start, seed: int) -> None:
    """Random chains of lines and arcs: outside of the corners they are the segments, inside within
    the zone.
    """
    rng = np.random.default_rng(seed)
    legs = []
    corner = np.zeros(3)
    ends = []
    count = 5
    zones = rng.uniform(0.005, 0.03, count - 1)
    for k in range(count):
        way = rng.normal(size=3)
        way *= rng.uniform(0.07, 0.2) / np.linalg.norm(way)
        if legs and np.dot(way, legs[-1].displacement) < -0.8 * np.linalg.norm(
            way
        ) * np.linalg.norm(legs[-1].displacement):
            way = -way
        zone = float(zones[k]) if k < count - 1 else 0.0
        legs.append(
            MoveL(tuple(way), rotation=tuple(rng.normal(size=3) * 0.2 * (k % 2)), zone=zone)
        )
        corner = corner + way
        ends.append(corner)
    path = Path(
        robot, Move("chain", "tool_polyline", start, 1.0, 5, legs=tuple(legs), radius=0.01)
    )
    curve = path.segments[0].curve
    s = np.zeros((8001, 6))
    s[:, 0] = np.linspace(0, curve.length, len(s))
    s[:, 1] = 1.0
    x = curve(s)[0]
    points = x[:, :, 0] - path.reference.tool_pose(start)[0]
    at = np.searchsorted(np.cumsum([section.length for section in curve.sections]), s[:, 0])
    begins = np.vstack([np.zeros(3), ends[:-1]])
    for k, section in enumerate(curve.sections):
        inside = points[at == k]
        if section.corner:
            assert np.linalg.norm(inside - ends[section.segment], axis=1).max() < zones[
                section.segment
            ] * (1 + 1e-9)
        else:
            d = np.array(legs[section.segment].displacement)
            off = np.cross(inside - begins[section.segment], d) / np.linalg.norm(d)
            assert np.abs(off).max() < 1e-14
    assert np.abs(points[-1] - ends[-1]).max() < 1e-14
    assert (
        np.abs(np.linalg.norm(np.diff(x[:, :, 0], axis=0), axis=1).sum() - curve.length)
        < 1e-4 * curve.length
    )
    assert np.abs(np.linalg.norm(x[:, :, 1], axis=1) - 1).max() < 1e-12


def test_a_rotation_longer_than_the_translation_sets_the_speed(robot, start) -> None:
    bounds = (0.5, 5.0, 100.0, 4000.0)
    quick = Move("quick", "tool_line", start, 0.0, 0, (0.01, 0.0, 0.0), profile=bounds)
    turned = replace(quick, rotation=(0.0, 0.0, 1.0), radius=0.25)
    sample = Path(robot, turned).sample(np.linspace(0, Path(robot, turned).duration, 2001))
    peaks = 0.25 * np.linalg.norm(sample.w, axis=1).max(axis=0)
    assert Path(robot, turned).duration > 2 * Path(robot, quick).duration
    assert all(peaks[k] <= bounds[k] * (1 + 1e-6) for k in range(4))


def test_circle_through_three_points(robot) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        via, end = rng.normal(size=(2, 3))
        center, axis, angle = circle_through(via, end)
        for point in (np.zeros(3), via, end):
            assert abs(
                np.linalg.norm(point - center) - np.linalg.norm(center)
            ) < 1e-12 * np.linalg.norm(center)
            assert abs((point - center) @ axis) < 1e-12 * np.linalg.norm(center)
        angles = [
            np.arctan2(np.cross(-center, p - center) @ axis, -center @ (p - center)) % (2 * np.pi)
            for p in (via, end)
        ]
        assert 0 < angles[0] < angles[1] and abs(angles[1] - angle) < 1e-9
    for via, end in (
        ([1, 0, 0], [2, 0, 0]),
        ([1, 0, 0], [1, 0, 0]),
        ([0, 0, 0], [1, 0, 0]),
        ([1, 0, 0], [0, 0, 0]),
        ([1, 0, 0], [1, 1e-10, 0]),
        ([1e-10, 1e-10, 0], [1, 0, 0]),
    ):
        assert circle_through(np.array(via), np.array(end)) is None
    # almost a full line, but a circle
    assert circle_through(np.array([1, 0, 0]), np.array([-1, 1e-6, 0])) is not None


@pytest.mark.parametrize(
    ("total", "turn", "radius", "largest", "length", "by_arc_length"),
    [
        (0.5, 2.5, 0.0, False, 0.5, True),
        (0.5, 2.5, 0.1, False, 0.5, True),
        (0.5, 2.5, 0.3, False, 0.75, False),
        (0.5, 0.0, 0.0, True, 0.4, False),
        (0.0, 2.5, 0.0, False, 1.0, False),
        (0.0, 2.5, 0.3, False, 0.75, False),
        (0.0, 0.0, 0.0, False, 1.0, False),
    ],
)
def test_a_line_is_as_long_as_its_path_or_as_its_rotation_on_the_radius(
    total: float, turn: float, radius: float, largest: bool, length: float, by_arc_length: bool
) -> None:
    along = total * np.array([0.6, 0.0, -0.8])
    found = Line(along, turn * np.array([0.0, 0.6, 0.8]), radius, largest)
    assert found.length == pytest.approx(length)
    assert found.by_arc_length == by_arc_length


def test_arcs_in_a_polyline_end_at_their_stated_points(robot, start) -> None:
    legs = (
        MoveL((0.1, 0.0, 0.0), zone=0.02),
        MoveC((0.0, 0.1, 0.0), via=(0.05, 0.05, 0.0), zone=0.02),
        MoveL((-0.1, 0, 0)),
    )
    path = Path(robot, Move("bow", "tool_polyline", start, 1.0, 5, legs=legs))
    sample = path.sample(np.array([0.0, 1.0]))
    assert np.abs(sample.y[1, :, 0] - sample.y[0, :, 0] - [0.0, 0.1, 0.0]).max() < 1e-15
    assert path.smoothness == 5 and Path(robot, replace(path.move, smoothness=8)).smoothness == 5


def test_full_circle_comes_back(robot, start) -> None:
    move = Move(
        "round", "tool_circle", start, 1.0, 5, center=(0.1, 0, 0), axis=(0, 0, 2), angle=2 * np.pi
    )
    sample = Path(robot, move).sample(np.array([0.0, 0.5, 1.0]))
    assert np.abs(sample.y[2, :, 0] - sample.y[0, :, 0]).max() < 1e-15
    assert np.abs(sample.y[1, :, 0] - sample.y[0, :, 0] - [0.2, 0, 0]).max() < 1e-15


def test_paths_that_turn_back_or_overlap_are_refused(robot, start) -> None:
    back = (MoveL((0.1, 0, 0), zone=0.02), MoveL((-0.1, 0, 0)))
    with pytest.raises(
        ArgumentError, match=r"step 1: given zone 0\.02, expected 0, because the path reverses"
    ):
        Path(robot, Move("back", "tool_polyline", start, 1.0, 5, legs=back))
    wide = (MoveL((0.1, 0, 0), zone=0.08), MoveL((0, 0.1, 0), zone=0.08), MoveL((0.1, 0, 0)))
    with pytest.raises(
        ArgumentError,
        match=r"step 2: given zone 0\.08 and 0\.08, expected zones that fit into the length 0\.1",
    ):
        Path(robot, Move("wide", "tool_polyline", start, 1.0, 5, legs=wide))


def joint_error(path: Path, t: float) -> float:
    """Largest error of the tool's derivatives while the joints of planar5 move, against its closed
    form.
    """
    law = polynomial_law(path.duration, path.move.smoothness)
    move = path.move

    def place(time):
        q1, q2 = (
            mp.mpf(a) + (mp.mpf(b) - mp.mpf(a)) * law(time)
            for a, b in zip(move.start, move.end, strict=True)
        )
        reach = [(mp.mpf(0.8), q1), (mp.mpf(0.35) + mp.mpf(0.45), q1 + q2)]
        return [sum(r * f(q) for r, q in reach) for f in (mp.cos, mp.sin)]

    every = path.sample(np.linspace(0, path.duration, 101))
    return worst(path.sample(np.array([t])).y[0], derivatives(place, t, 5), sizes(every.y))


def test_the_tool_of_a_joint_move_is_exact() -> None:
    equations = flexgen.derive("planar5_nmp")
    path = Path(equations, equations.model.move("joints"))
    assert max(joint_error(path, t) for t in (0.07, 0.29, 0.55)) < EXACT
    shifted = Path(
        equations, replace(path.move, end=(path.move.end[0] * (1 + 1e-9), path.move.end[1]))
    )
    shifted.move = path.move
    assert joint_error(shifted, 0.29) > 10 * EXACT
