"""Calibration with touches of planes and spheres, and with dial gauges.

The robots are computed here: positions by matrices, deflections by the moments of the weights
about the axes, from drawn geometries. Nothing of flexgen takes part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses.parameters import Priors

AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
GRAVITY = np.array([0.0, 0.0, -9.81])
NOISE = 5e-5
PRIORS = Priors(zero=0.02, position=0.003, rotation=0.003, compliance=0.5, tracker=0.003)
SHIFTS = ("x", "y", "z", "rx", "ry", "rz")


def turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) about an axis, by Rodrigues."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s = np.sin(angle)[:, None, None]
    c = np.cos(angle)[:, None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


@dataclass
class Arm:
    """An arm of six axes: origins (6, 3), masses and centers of links, compliances, its tip."""

    origins: np.ndarray
    masses: np.ndarray
    centers: np.ndarray
    compliances: np.ndarray
    tip: np.ndarray
    zeros: np.ndarray
    turns: np.ndarray

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, ...]:
        """Axes and origins of the joints, centers of the links, the tip, and its rotation."""
        R = np.tile(np.eye(3), (len(q), 1, 1))
        p = np.zeros((len(q), 3))
        axes = []
        origins = []
        centers = []
        for k in range(6):
            p = p + R @ self.origins[k]
            for angle, axis in zip(self.turns[k], np.eye(3), strict=True):
                R = R @ turn(axis, np.full(len(q), angle))
            axes.append(R @ AXES[k])
            origins.append(p)
            R = R @ turn(AXES[k], q[:, k])
            centers.append(p + R @ self.centers[k])
        return np.array(axes), np.array(origins), np.array(centers), p + R @ self.tip, R

    def rest(self, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tip (N, 3) and its rotation at rest, where the gears carry the weights."""
        bent = np.zeros_like(commands)
        for _ in range(60):
            axes, origins, centers, tip, R = self.frames(commands + self.zeros + bent)
            load = np.zeros_like(bent)
            weights = self.masses[:, None, None] * GRAVITY
            for k in range(6):
                moment = np.cross(centers[k:] - origins[k], weights[k:]).sum(axis=0)
                load[:, k] = (axes[k] * moment).sum(axis=1)
            before = bent
            bent = self.compliances * load
            if np.abs(bent - before).max() < 1e-13:
                break
        return tip, R


def nominal(seed: int) -> Arm:
    """The arm of the model file, of drawn lengths."""
    rng = np.random.default_rng(1000 + seed)
    reach = rng.uniform([0.3, 0.4, 0.3], [0.45, 0.6, 0.5])
    origins = [[0, 0, 0.2], [0.1, 0, reach[0]], [0, 0, reach[1]]]
    origins += [[0.2, 0, 0.1], [reach[2], 0, 0], [0.1, 0, 0]]
    centers = [[0, 0, 0.1], [0, 0, 0.2], [0.1, 0, 0.05], [0.1, 0, 0], [0.03, 0, 0], [0.03, 0, 0.0]]
    return Arm(
        np.array(origins, float),
        rng.uniform(0.8, 1.2, 6) * [30, 25, 15, 8, 4, 2],
        np.array(centers, float),
        1 / (rng.uniform(0.8, 1.2, 6) * [2e5, 1.2e5, 8e4, 2e4, 1.5e4, 1e4]),
        np.array([0.08, 0.05, 0.12]),
        np.zeros(6),
        np.zeros((6, 3)),
    )


def with_errors(arm: Arm, seed: int, placements: bool) -> tuple[Arm, dict[str, float]]:
    """The arm with drawn errors, and its numbers by name."""
    rng = np.random.default_rng(seed)
    zeros = 0.5 * PRIORS.zero * rng.normal(size=6)
    softer = arm.compliances * np.maximum(1 + 0.25 * rng.normal(size=6), 0.3)
    tip = arm.tip + 0.5 * PRIORS.tracker * rng.normal(size=3)
    shifts = 0.5 * PRIORS.position * rng.normal(size=(6, 3)) * placements
    turns = 0.5 * PRIORS.rotation * rng.normal(size=(6, 3)) * placements
    for k, axis in enumerate(AXES):  # the zero does the same
        turns[k, int(np.argmax(axis))] = 0.0
    true = Arm(arm.origins + shifts, arm.masses, arm.centers, softer, tip, zeros, turns)
    numbers = {f"q{k + 1}.zero": zeros[k] for k in range(6)}
    numbers |= {f"q{k + 1}.compliance": softer[k] for k in range(6)}
    numbers |= {f"tip.{axis}": tip[k] for k, axis in enumerate("xyz")}
    for k in range(6 * placements):
        both = (*shifts[k], *turns[k])
        numbers |= {f"body{k + 1}.{s}": x for s, x in zip(SHIFTS, both, strict=True)}
    return true, {name: float(x) for name, x in numbers.items()}


def text_of(arm: Arm) -> str:
    """The model file."""
    lines = ['name = "arm"', "gravity = [0.0, 0.0, -9.81]", f"home_deg = {[0.0] * 6}"]
    for k in range(6):
        lines += [
            "[[element]]",
            f'name = "body{k + 1}"',
            f"origin = {{ position = {arm.origins[k].tolist()} }}",
            f"body = {{ mass = {arm.masses[k]}, com = {arm.centers[k].tolist()}, "
            "inertia = [0.5, 0.5, 0.5] }",
            "[[element.dof]]",
            f'name = "q{k + 1}"',
            'type = "rotation"',
            f"axis = {AXES[k].tolist()}",
            "[element.dof.gear]",
            'type = "elastic"',
            'side = "arm"',
            f'spring = {{ type = "linear", stiffness = {1 / arm.compliances[k]} }}',
            "damping = 1.0",
        ]
    for k in range(6):
        lines += [
            "[[motor]]",
            f'name = "m{k + 1}"',
            f'drives = "q{k + 1}"',
            "ratio = 100",
            "inertia = 1e-4",
        ]
    lines += ["[output]", 'type = "tool_position"', 'axes = "xyz"']
    lines += ["[[sensor]]", 'name = "tip"', 'type = "tracker"', 'unit = "m"']
    return "\n".join([*lines, f"position = {arm.tip.tolist()}", ""])


@dataclass
class Feature:
    """A surface or gauge: its text, and its distance from tips (N, 3) with rotations."""

    text: str
    distance: Callable[[np.ndarray, np.ndarray], np.ndarray]
    readings: tuple[float, float] = (0.0, 0.0)
    numbers: tuple[tuple[str, float], ...] = ()
    sd: float = NOISE


def plane(name: str, normal: list[float], point: list[float], *distances: float) -> Feature:
    """A plane; touched at distances from it, as of a block of known height."""
    n = np.array(normal) / np.linalg.norm(normal)
    c = int(np.argmax(np.abs(n)))
    others = [k for k in range(3) if k != c]
    numbers = [(f"plane.{name}.{'xyz'[c]}", float(n @ point / n[c]))]
    numbers += [(f"plane.{name}.slope_{'xyz'[k]}", float(-n[k] / n[c])) for k in others]
    ends = (min(distances, default=0.0), max(distances, default=0.0))
    return Feature(f"plane {name}", lambda p, R: (p - point) @ n, ends, tuple(numbers))


def sphere(name: str, center: list[float], radius: float) -> Feature:
    numbers = tuple((f"sphere.{name}.{a}", x) for a, x in zip("xyz", center, strict=True))
    ends = (radius, radius)
    text = f"sphere {name}"
    return Feature(text, lambda p, R: np.linalg.norm(p - center, axis=1), ends, numbers)


def gauge(name: str, axis: str, zero: float) -> Feature:
    """A gauge along an axis of the world, whose zero is a coordinate."""
    sign = -1.0 if axis[0] == "-" else 1.0
    k = "xyz".index(axis[-1])
    numbers = ((f"gauge.{name}.{axis}.zero", zero),)
    return Feature(
        f"gauge {name} {axis}", lambda p, R: sign * p[:, k] - zero, (-0.005, 0.005), numbers
    )


def tool_gauge(name: str, axis: str, place: list[float]) -> Feature:
    """A gauge along an axis of the tool, of its displacement from a ball."""
    k = "xyz".index(axis[-1])
    return Feature(
        f"gauge {name} tool.{axis}",
        lambda p, R: (R[:, :, k] * (p - place)).sum(axis=1),
        (-0.005, 0.005),
        tuple((f"gauge.{name}.{a}", x) for a, x in zip("xyz", place, strict=True)),
    )


def touch(
    arm: Arm, feature: Feature, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Commands (count, 6) of the arm at which the feature is read, and its readings with noise."""
    low, high = feature.readings
    wanted = rng.uniform(low, high, count)
    if "plane" in feature.text:
        wanted = rng.choice([low, high], count)
    start = np.array([0.0, 0.3, 0.4, 0.0, 0.4, 0.0])
    q = start + rng.uniform(-1.0, 1.0, (count, 6)) * [1.2, 0.5, 0.6, 1.5, 1.0, 2.0]
    for _ in range(40):
        away = feature.distance(*arm.rest(q)) - wanted
        if np.abs(away).max() < 1e-9:
            break
        steps = (q + 1e-6 * np.eye(6)[:, None]).reshape(-1, 6)
        moved = feature.distance(*arm.rest(steps)).reshape(6, -1) - wanted - away
        J = moved.T / 1e-6
        step = -J * (away / np.maximum((J**2).sum(axis=1), 1e-3))[:, None]
        q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.3)
    found = np.abs(away) < 1e-7
    return q[found], (wanted + feature.sd * rng.normal(size=count))[found]


def measured(arm: Arm, features: list[Feature], count: int, seed: int) -> tuple[np.ndarray, ...]:
    """Commands, texts of touches and readings of all features, ``count`` of each."""
    rng = np.random.default_rng(seed)
    parts = [touch(arm, feature, count, rng) for feature in features]
    texts = [[feature.text] * len(q) for feature, (q, _) in zip(features, parts, strict=True)]
    q, readings = (np.concatenate(x) for x in zip(*parts, strict=True))
    return q, np.concatenate(texts)[:, None], readings[:, None]


def poses_of(
    q: np.ndarray, touches: np.ndarray, readings: np.ndarray, **more: np.ndarray
) -> flexgen.StaticPoses:
    none = np.full((len(q), 1, 3), np.nan)
    return flexgen.StaticPoses(q, none, "touches", touches=touches, readings=readings, **more)


BLOCK = [
    plane("table", [0.03, -0.02, 1.0], [0.8, 0.0, 0.35], 0.0, 0.1),
    plane("wall", [1.0, 0.1, 0.05], [0.9, 0.0, 0.5]),
    plane("side", [0.05, -1.0, 0.02], [0.7, 0.4, 0.5]),
    sphere("ball", [0.75, 0.1, 0.6], 0.0225),
]
GAUGES = [
    gauge("first", "z", 0.45),
    gauge("second", "-y", 0.1),
    gauge("third", "x", 0.8),
    tool_gauge("nest", "x", [0.75, 0.1, 0.6]),
    tool_gauge("nest", "y", [0.75, 0.1, 0.6]),
    tool_gauge("nest", "z", [0.75, 0.1, 0.6]),
]
SETS = {"touches": BLOCK, "gauges": GAUGES}


@lru_cache
def drawn(kind: str, placements: bool, seed: int, count: int) -> tuple:
    """The text of the model file, poses of the arm with errors, and the numbers by name."""
    arm = nominal(seed)
    true, numbers = with_errors(arm, seed, placements)
    poses = measured(true, SETS[kind], count, seed)
    numbers |= dict(number for feature in SETS[kind] for number in feature.numbers)
    return text_of(arm), poses, numbers


def robot_of(text: str, folder: Path) -> flexgen.RobotModel:
    (folder / "arm.toml").write_text(text)
    return flexgen.read(folder / "arm.toml")


def free_of(placements: bool) -> list[str]:
    return ["zeros", "compliances", *["placements"] * placements]


CASES = [
    pytest.param("touches", False, 6),
    pytest.param("gauges", False, 6),
    pytest.param("touches", True, 12, marks=pytest.mark.slow),
    pytest.param("gauges", True, 12, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("kind", "placements", "robots"), CASES)
def test_intervals_hold_what_touches_determine(
    kind: str, placements: bool, robots: int, tmp_path: Path
) -> None:
    """Zeros, places, compliances, tip, and the surfaces: 95 % intervals hold in 93 % or more."""
    away: list[float] = []
    for seed in range(robots):
        text, poses, numbers = drawn(kind, placements, seed, 60 if placements else 40)
        found = flexgen.calibrate(
            robot_of(text, tmp_path), poses_of(*poses), free=free_of(placements), priors=PRIORS,
            folds=0,
        )  # fmt: skip
        known = [name for name in numbers if found.determined.get(name)]
        away += [(found.values[name] - numbers[name]) / found.sd[name] for name in known]
        assert found.problem == "" and len(known) >= 15
        assert placements or {f"q{k}.zero" for k in (2, 3, 4, 5)} <= set(known)
        # the vertical axis carries no weight
        assert not found.determined["q1.compliance"]
        assert not any("length scale" in text for text in found.warnings)
        # of one number, the mean of the size is 0.8 standard deviations
        assert np.nanmean(found.errors) < 1.2 * 0.8 * NOISE < 0.2 * np.nanmean(found.errors_before)
    assert np.mean(np.abs(away) < 1.96) >= 0.93
    assert np.sqrt(np.mean(np.square(away))) < 1.3


def test_a_planted_error_is_outside_the_intervals(tmp_path: Path) -> None:
    """A joint that is turned; a block that is 2 mm higher, which remains in the errors."""
    text, (q, touches, readings), numbers = drawn("touches", False, 0, 40)
    robot = robot_of(text, tmp_path)
    turned = poses_of(q + 0.01 * (np.arange(6) == 2), touches, readings)
    found = flexgen.calibrate(robot, turned, free=free_of(False), priors=PRIORS, folds=0)
    assert abs(found.values["q3.zero"] - numbers["q3.zero"]) > 5 * found.sd["q3.zero"]
    higher = poses_of(q, touches, np.where(readings > 0.05, readings + 0.002, readings))
    found = flexgen.calibrate(robot, higher, free=free_of(False), priors=PRIORS, folds=0)
    assert np.nanmean(found.errors) > 2 * 0.8 * NOISE


def test_readings_with_stated_deviations_count_by_them(tmp_path: Path) -> None:
    """The plane is touched with noise of 1 mm: stated, the intervals hold and are narrower."""
    text, _, numbers = drawn("touches", False, 0, 40)
    true, _ = with_errors(nominal(0), 0, False)
    rough = [Feature(f.text, f.distance, f.readings, f.numbers, 1e-3) for f in BLOCK[:1]]
    q, touches, readings = measured(true, [*rough, *BLOCK[1:]], 40, 3)
    sd = np.where(touches == "plane table", 1e-3, NOISE)
    robot = robot_of(text, tmp_path)
    by_sd, alike = (
        flexgen.calibrate(
            robot, poses_of(q, touches, readings, **more), free=free_of(False), priors=PRIORS
        )
        for more in ({"sd": sd}, {})
    )
    names = [name for name in numbers if by_sd.determined.get(name)]
    away = [(by_sd.values[name] - numbers[name]) / by_sd.sd[name] for name in names]
    assert np.mean(np.abs(away) < 1.96) >= 0.9
    assert by_sd.sd["q3.zero"] < 0.9 * alike.sd["q3.zero"]
    assert by_sd.warnings == ()


def test_derivatives_of_touches_are_differences(tmp_path: Path) -> None:
    from flexgen.identification.poses.parameters import unknowns_of
    from flexgen.identification.poses.statics import Numbers, Statics
    from flexgen.identification.poses.tree import Tree

    rng = np.random.default_rng(2)
    tree = Tree(robot_of(text_of(nominal(0)), tmp_path))
    texts = [f.text for f in (*BLOCK, *GAUGES)] + ["coordinate -z", "gauge nest -tool.y"]
    q = rng.uniform(-1.0, 1.0, (len(texts), 6))
    touches = flexgen.identification.poses.touches.Touches.of(
        np.array(texts)[:, None], rng.uniform(0, 0.1, (len(texts), 1))
    )
    free = ("zeros", "placements", "compliances", "masses")
    unknowns = [*unknowns_of(tree, free, (), PRIORS), *touches.unknowns()]
    x = np.array([u.start + 0.1 * u.sd * rng.normal() * (u.sd < 5.0) for u in unknowns])
    x += np.array([0.3 * rng.normal() * (u.kind == "surface") for u in unknowns])
    statics = Statics(tree, q, None, touches)

    def away(values: np.ndarray) -> np.ndarray:
        return statics.rest(Numbers.of(tree, unknowns, values)).measured

    numbers = Numbers.of(tree, unknowns, x)
    J, _ = statics.slopes(numbers, statics.rest(numbers), unknowns)
    assert not J[:, :, 1:].any()
    for k, unknown in enumerate(unknowns):
        size = 1e-3 * abs(unknown.start) if unknown.kind == "compliance" else 1e-5
        step = size * (np.arange(len(unknowns)) == k)
        difference = (away(x + step) - away(x - step)) / (2 * size)
        assert np.abs(J[..., k] - difference).max() < 1e-6 * max(1.0, np.abs(difference).max())


def test_a_file_of_touches_is_read_as_arrays(tmp_path: Path) -> None:
    """In mm, with empty cells, without a header too; its numbers are in the text of the result."""
    text, (q, touches, readings), _ = drawn("touches", False, 0, 40)
    robot = robot_of(text, tmp_path)
    names = [*(f"q{k + 1} deg" for k in range(6)), "tip_touch", "tip_reading_mm", "tip_sd_mm"]
    rows = [
        [*map(repr, np.degrees(row).tolist()), name, repr(1e3 * x) if x else "", "0.05"]
        for row, name, x in zip(q, touches[:, 0], readings[:, 0].tolist(), strict=True)
    ]
    lines = [",".join(row) for row in rows]
    file = tmp_path / "touches.csv"
    file.write_text("\n".join([",".join(names), *lines]))
    poses = flexgen.StaticPoses.read(file, robot)
    assert poses.commands == pytest.approx(q, abs=1e-12)
    assert poses.readings == pytest.approx(readings, abs=1e-12)
    assert np.array_equal(poses.touches, touches) and not poses.is_measured
    assert poses.sd == pytest.approx(np.full((len(q), 1), 5e-5))
    found = flexgen.calibrate(robot, file, free=["zeros"], priors=PRIORS, folds=0)
    assert "plane.table.z" in found.to_text() and "sphere.ball.x" in found.to_text()
    file.write_text("\n".join(lines))
    again = flexgen.calibrate(robot, file, free=["zeros"], priors=PRIORS, folds=0, columns=names)
    assert again.values == found.values
    with pytest.raises(ArgumentError, match="columns: given with poses in memory"):
        flexgen.calibrate(robot, poses, columns=names)


@pytest.mark.parametrize("title", ["tip_readng_mm", "tip_read_mm", "tip_std_mm", "tip_toutch"])
def test_misspelt_columns_of_a_tracker_are_refused(title: str, tmp_path: Path) -> None:
    """Touches of planes without readings are read as 0; columns of other things are ignored."""
    text, _, _ = drawn("touches", False, 0, 40)
    robot = robot_of(text, tmp_path)
    rows = [f"{k},{2 * k},{3 * k},{k},{k},{k},plane table,5" for k in range(6)]
    head = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,tip_touch"
    file = tmp_path / "touches.csv"
    file.write_text("\n".join([f"{head},{title}", *rows]))
    with pytest.raises(ArgumentError, match=f"given the column '{title}', expected tip_"):
        flexgen.StaticPoses.read(file, robot)
    for other in ("tip_note", "tip_temperature", "speed"):
        file.write_text("\n".join([f"{head},{other}", *rows]))
        assert len(flexgen.StaticPoses.read(file, robot)) == 6


def test_touches_that_tell_nothing_are_refused(tmp_path: Path) -> None:
    """Few of one surface, no reading, unknown forms, both a position and a touch."""
    text, (q, touches, readings), _ = drawn("touches", False, 0, 40)
    robot = robot_of(text, tmp_path)
    one = np.where(np.arange(len(q))[:, None] == 0, "sphere lamp", touches)
    for given, said in (
        (one, "given 1 touches of sphere 'lamp', expected at least 4"),
        (np.where(touches == "plane wall", "plain wall", touches), "plain wall.*expected.*plane"),
        (
            np.where(touches == "plane wall", "plane", touches),
            "given .plane., expected 'plane NAME'",
        ),
        (np.where(touches == "plane wall", "gauge a w", touches), "expected an axis of x, -x"),
        (np.where(touches == "plane wall", "coordinate tool.x", touches), "expected an axis of"),
    ):
        with pytest.raises(ArgumentError, match=said):
            poses_of(q, given, readings)
    for more, said in (
        ({"readings": np.where(touches == "sphere ball", np.nan, readings)}, "no reading of the"),
        ({"readings": np.full_like(readings, np.inf)}, "an infinite reading"),
        ({"readings": readings[:3]}, "given readings of shape"),
        ({"readings": readings, "sd": 0.0 * readings}, "sd of 0 m in row 1, expected finite"),
        ({"readings": readings, "sd": readings + np.inf}, "sd of inf m in row 1"),
    ):
        none = np.full((len(q), 1, 3), np.nan)
        with pytest.raises(ArgumentError, match=said):
            flexgen.StaticPoses(q, none, touches=touches, **more)
    with pytest.raises(ArgumentError, match="position or a fixed point, of one tracker in row 1"):
        flexgen.StaticPoses(q, np.ones((len(q), 1, 3)), touches=touches, readings=readings)
    with pytest.raises(ArgumentError, match="probably joints in degrees"):
        flexgen.calibrate(robot, poses_of(np.rad2deg(q), touches, readings))


def far_gauges() -> tuple:
    """Poses over the whole workspace, which gauges along the axes of the world read."""
    arm = nominal(0)
    q = np.random.default_rng(0).uniform(-1.2, 1.2, (90, 6))
    features = [gauge("a", "x", 0.2), gauge("b", "y", 0.2), gauge("c", "z", 0.2)]
    of = np.array([feature.distance(*arm.rest(q)) for feature in features])
    which = np.arange(90) % 3
    names = np.array([feature.text for feature in features])[which][:, None]
    return text_of(arm), (q, names, of[which, np.arange(90)][:, None])


MISTAKES = {
    "joints in degrees": lambda q, readings: (np.rad2deg(q), readings),
    "q1 in degrees": lambda q, readings: (q * [180 / np.pi, 1, 1, 1, 1, 1], readings),
    "q3 in radians": lambda q, readings: (q * [1, 1, np.pi / 180, 1, 1, 1], readings),
    "the sign of q3": lambda q, readings: (q * [1, 1, -1, 1, 1, 1], readings),
    "exchanged columns of q2 and q3": lambda q, readings: (q[:, [0, 2, 1, 3, 4, 5]], readings),
    "readings 1000 times too large": lambda q, readings: (q, 1e3 * readings),
    "readings 1000 times too small": lambda q, readings: (q, 1e-3 * readings),
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_single_mistake_in_touches_is_named(words: str, tmp_path: Path) -> None:
    """Units and signs of joints, exchanged columns, units of readings of gauges."""
    text, (q, touches, readings) = far_gauges()
    wrong, read = MISTAKES[words](q, readings)
    with pytest.raises(ArgumentError, match=f"probably {words}"):
        flexgen.calibrate(robot_of(text, tmp_path), poses_of(wrong, touches, read))


def test_touches_that_the_model_does_not_explain_are_warned(tmp_path: Path) -> None:
    """Two joints with gears of another ratio: no single mistake, and much is left; not so without.

    The zeros of gauges stand in the table of surfaces alone, not also in that of the joints.
    """
    text, (q, touches, readings) = far_gauges()
    robot = robot_of(text, tmp_path)
    wrong = q * [1.0, 0.8, 0.9, 1.0, 1.0, 1.0]
    kept = {"free": ["compliances"], "folds": 0}
    found = flexgen.calibrate(robot, poses_of(wrong, touches, readings), **kept)
    assert any("of the motion of the trackers unexplained" in text for text in found.warnings)
    found = flexgen.calibrate(robot, poses_of(q, touches, readings), **kept)
    assert not any("unexplained" in text for text in found.warnings)
    lines = [line.split()[0] for line in found.to_text().splitlines() if ".zero " in line]
    assert lines and len(lines) == len(set(lines))
    hidden = [u for u in found.unknowns if u.kind not in ("surface", "compliance")]
    assert f"; {len(hidden)} of places, frames and trackers are in --json" in found.to_text()


def test_touches_that_alone_determine_a_number_have_finite_deviations(tmp_path: Path) -> None:
    """A sphere with four touches, three of which are one pose; a plane touched along a line."""
    text, (q, touches, readings), _ = drawn("touches", False, 0, 40)
    robot = robot_of(text, tmp_path)
    walls = np.flatnonzero(touches[:, 0] != "sphere ball")
    ball = np.flatnonzero(touches[:, 0] == "sphere ball")
    rows = np.concatenate([walls, ball[[0, 0, 0, 1]]])
    poses = poses_of(q[rows], touches[rows], readings[rows])
    found = flexgen.calibrate(robot, poses, free=["zeros"], priors=PRIORS)
    assert np.isfinite(found.covariance).all() and np.isfinite(list(found.sd.values())).all()
    assert found.problem == ""
    assert any(found.sd[f"sphere.ball.{axis}"] > 3.0 for axis in "xyz")
    assert not all(found.determined[f"sphere.ball.{axis}"] for axis in "xyz")
