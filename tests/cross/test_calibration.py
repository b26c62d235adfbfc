"""Calibration from static poses: against CasADi's statics, differences, known truths, planted
errors and real data.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from measured_numbers import check_numbers
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.identification.poses import components, frames, mistakes
from flexgen.identification.poses.model_file import changes_of
from flexgen.identification.poses.parameters import GROUPS, Priors, unknowns_of
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.model.elements import RobotModel

ROOT = Path(__file__).resolve().parents[2]
JUSTIN = ROOT / "examples" / "justin" / "justin.toml"
DATA = Path(os.environ.get("FLEXGEN_DATA", "")) / "justin" / "poses.csv"
TRACKERS = [
    {"name": "flange", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
    {
        "name": "elbow",
        "type": "tracker",
        "unit": "m",
        "element": "body4",
        "position": [0.1, 0.0, 0.05],
    },
]


@lru_cache
def arm() -> RobotModel:
    """Six axes with elastic gears and six axes across them, two trackers."""
    return flexgen.read("manutec_r3_18", overrides={"sensor": TRACKERS})


def overrides_of_balanced() -> dict[str, Any]:
    """Counterbalances, and the offset of a friction that acts at rest."""
    return {
        "sensor": TRACKERS,
        "element.body2.dof.q2.counterbalance": {"sin": [900.0, -120.0], "cos": [-200.0, 60.0]},
        "element.body3.dof.q3.friction": {"offset": 150.0},
        "element.body3.dof.t3z.counterbalance": {"cos": [80.0]},
    }


@lru_cache
def balanced() -> RobotModel:
    return flexgen.read("manutec_r3_18", overrides=overrides_of_balanced())


def commands(count: int, seed: int = 0, joints: int = 6) -> np.ndarray:
    """Random joints."""
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (count, joints))


def drawn(
    model: RobotModel, free: tuple[str, ...], priors: Priors, seed: int = 1
) -> tuple[Tree, list, np.ndarray]:
    """A tree, its unknowns, and values drawn from their priors; the frame of the measurement is
    moderate.
    """
    tree = Tree(model)
    unknowns = unknowns_of(tree, free, (), priors)
    rng = np.random.default_rng(seed)
    x = np.array([u.start + (0.3 if u.kind == "frame" else u.sd) * rng.normal() for u in unknowns])
    for k, u in enumerate(unknowns):
        if u.kind == "compliance":
            x[k] = abs(x[k])
    return tree, unknowns, x


@pytest.mark.parametrize("name", ["arm", "justin", "balanced"])
def test_positions_are_those_of_the_equations_of_motion(name: str) -> None:
    """The tree of nodes and CasADi's Lagrangian share no code: positions with sag to 1e-9 m,
    without to 1e-12 m.
    """
    model = {"arm": arm, "balanced": balanced}.get(name, lambda: flexgen.read(JUSTIN))()
    q = commands(6, joints=model.n_g)
    statics = Statics(Tree(model), q)
    for sag, close in ((True, 1e-9), (False, 1e-12)):
        here = statics.rest(Numbers.of(statics.tree), rigid=not sag).points
        assert np.abs(here - flexgen.tracker_positions(model, q, sag=sag)).max() < close
    stiffer = replace(
        Numbers.of(statics.tree), compliances=0.99 * Numbers.of(statics.tree).compliances
    )
    # planted
    assert np.abs(statics.rest(stiffer).points - flexgen.tracker_positions(model, q)).max() > 1e-7


def test_changed_keys_are_the_changed_numbers() -> None:
    """Zeros, places, compliances, factors and masses as keys of a model file move the trackers as
    in the tree.
    """
    model = flexgen.read(JUSTIN)
    q = commands(4, joints=17)
    for robot, joints in ((model, q), (arm(), commands(4))):
        tree, unknowns, x = drawn(robot, GROUPS, Priors(compliance=0.3, mass=0.1))
        numbers = Numbers.of(tree, unknowns, x)
        statics = Statics(tree, joints)
        there = flexgen.read(
            robot.file, overrides={"sensor": TRACKERS} if robot is arm() else None
        )
        changed = flexgen.read(
            there.file,
            overrides=({"sensor": TRACKERS} if robot is arm() else {})
            | changes_of(robot, numbers),
        )
        assert (
            np.abs(flexgen.tracker_positions(changed, joints) - statics.rest(numbers).points).max()
            < 1e-9
        )
        frame = numbers.frame
        seen = flexgen.read(
            there.file,
            overrides=({"sensor": TRACKERS} if robot is arm() else {})
            | changes_of(robot, numbers, frame),
        )
        assert (
            np.abs(flexgen.tracker_positions(seen, joints) - statics.rest(numbers).measured).max()
            < 1e-9
        )


def test_changed_keys_and_slopes_of_an_arm_with_counterbalances() -> None:
    """The angle of a counterbalance does not contain the zero of its joint, in the tree as in the
    model file.
    """
    model = balanced()
    q = commands(4)
    tree, unknowns, x = drawn(model, GROUPS, Priors(compliance=0.3, mass=0.1))
    statics = Statics(tree, q)
    numbers = Numbers.of(tree, unknowns, x)
    rest = statics.rest(numbers)
    changed = flexgen.read(
        "manutec_r3_18", overrides=overrides_of_balanced() | changes_of(model, numbers)
    )
    assert np.abs(flexgen.tracker_positions(changed, q) - rest.points).max() < 1e-9
    slopes, _ = statics.slopes(numbers, rest, unknowns)
    for k, u in enumerate(unknowns):
        if u.name.split(".")[0] in ("q2", "q3", "t3z"):
            step = np.zeros(len(x))
            step[k] = 1e-3 * u.sd
            high, low = (
                statics.rest(Numbers.of(tree, unknowns, x + s * step)).measured for s in (1, -1)
            )
            difference = (high - low) / (2 * step[k])
            assert (
                np.abs(difference - slopes[..., k]).max()
                < 1e-4 * np.abs(difference).max() + 2e-8 / step[k]
            ), u.name


@pytest.mark.slow
def test_slopes_are_differences() -> None:
    """Derivatives in all kinds of numbers, through the equilibrium, against central
    differences.
    """
    tree, unknowns, x = drawn(flexgen.read(JUSTIN), GROUPS, Priors(compliance=0.3, mass=0.1))
    statics = Statics(tree, commands(3, joints=17))
    rest = statics.rest(Numbers.of(tree, unknowns, x))
    slopes, _ = statics.slopes(Numbers.of(tree, unknowns, x), rest, unknowns)
    kinds = {u.kind for u in unknowns}
    assert kinds == {"node", "frame", "tracker", "compliance", "factor", "mass", "center"}
    for k, u in list(enumerate(unknowns))[::3] + [
        (k, u) for k, u in enumerate(unknowns) if u.kind == "factor"
    ]:
        step = np.zeros(len(x))
        step[k] = 1e-3 * (u.sd if u.kind != "frame" else 1e-2)
        high, low = (
            statics.rest(Numbers.of(tree, unknowns, x + s * step)).measured for s in (1, -1)
        )
        difference = (high - low) / (2 * step[k])
        assert (
            np.abs(difference - slopes[..., k]).max()
            < 1e-4 * np.abs(difference).max() + 2e-8 / step[k]
        ), u.name


@lru_cache
def calibrated(
    robust: bool = True, gross: int = 0
) -> tuple[flexgen.Calibration, np.ndarray, np.ndarray]:
    """A calibration of a robot drawn from the priors, noise 0.1 mm; joints and positions of 50
    other poses.
    """
    tree, unknowns, x = drawn(arm(), GROUPS, Priors(compliance=0.3))
    numbers = Numbers.of(tree, unknowns, x)
    q = commands(80)
    other = commands(50, seed=7)
    rng = np.random.default_rng(3)
    seen = Statics(tree, q).rest(numbers).measured + 1e-4 * rng.normal(size=(80, 2, 3))
    for k in range(gross):
        seen[5 * k, k % 2] += 0.05 * np.array([0.6, -0.8, 0.0])
    found = flexgen.calibrate(
        arm(), flexgen.StaticPoses(q, seen), robust=robust, folds=4, priors=Priors(compliance=0.3)
    )
    return found, other, Statics(tree, other).rest(numbers).measured


def test_a_tracker_on_an_elastic_base_is_taken() -> None:
    """Only springs move it; a rigid robot explains nothing of that."""
    base = {
        "name": "base",
        "type": "tracker",
        "unit": "m",
        "element": "foundation",
        "position": [0.3, 0.2, 0.1],
    }
    robot = flexgen.read("manutec_r3_30", overrides={"sensor": [*TRACKERS, base]})
    dofs = next(element.dofs for element in robot.elements if element.name == "foundation")
    springs = {
        f"element.foundation.dof.{d.name}.spring.stiffness": 0.8 * d.spring.stiffness for d in dofs
    }
    softer = flexgen.read(robot.file, overrides={"sensor": [*TRACKERS, base], **springs})
    q = commands(30)
    data = flexgen.StaticPoses(q, flexgen.tracker_positions(softer, q))
    found = flexgen.calibrate(robot, data, free=["compliances"], folds=0)
    assert not found.problem and found.errors.max() < 1e-6


def test_a_robot_that_differs_is_found() -> None:
    """Other poses of a robot with other zeros, places, springs and masses are predicted within the
    noise.
    """
    found, other, truth = calibrated()
    error = np.linalg.norm(found.predict(other) - truth, axis=2)
    assert error.mean() < 1e-4
    assert found.errors_before.mean() > 5e-3
    assert found.errors_held_out is not None
    assert 1e-4 < np.nanmean(found.errors_held_out) < 3e-4
    assert found.converged
    assert not found.problem
    check_numbers("calibration", 1e-5, found=found, figures=found.to_dict())


@pytest.mark.slow
def test_standard_deviations_agree_with_the_errors() -> None:
    """The truth is within 1.96 standard deviations for 90 to 99 % of the numbers that are drawn
    from their priors.
    """
    inside = []
    for seed in range(4):
        tree, unknowns, x = drawn(arm(), GROUPS, Priors(compliance=0.3), seed)
        q = commands(60, seed)
        noise = 1e-4 * np.random.default_rng(seed).normal(size=(60, 2, 3))
        seen = Statics(tree, q).rest(Numbers.of(tree, unknowns, x)).measured + noise
        found = flexgen.calibrate(
            arm(), flexgen.StaticPoses(q, seen), folds=0, priors=Priors(compliance=0.3)
        )
        for u, true in zip(unknowns, x, strict=True):
            if u.kind != "frame" and found.sd[u.name] > 0.0:
                inside.append(abs(found.values[u.name] - true) < 1.96 * found.sd[u.name])
    assert len(inside) > 300
    assert 0.90 < np.mean(inside) < 0.99


AXIS = """
[[element]]
name = "{0}"
parent = "{1}"
body = {{ mass = 6.0, com = [0.3, 0.05, 0.1], inertia = [0.1, 0.1, 0.1] }}
[[element.dof]]
name = "{2}"
type = "rotation"
axis = [0, 0.6, 0.8]
{3}
"""
SPRUNG = 'gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 5e3 } }'
BRANCHES = (
    'name = "branches"\ngravity = [0, 0, -9.81]\nhome_rad = [0, 0]\n'
    + AXIS.format("left", "base", "q1", SPRUNG)
    + AXIS.format("right", "base", "q2", SPRUNG)
    + AXIS.format("hand", "left", "turned", "mimic = { q1 = -0.5, q2 = -0.8 }")
    + "".join(
        f'[[motor]]\nname = "m{k}"\ndrives = "q{k}"\nratio = 100\ninertia = 1e-4\n' for k in (1, 2)
    )
    + '[output]\ntype = "joint"\njoints = ["q1", "q2"]\n'
    + (
        "[[sensor]]\n"
        'name = "point"\n'
        'type = "tracker"\n'
        'unit = "m"\n'
        'element = "hand"\n'
        "position = [0.4, 0.1, 0.0]\n"
    )
)


def test_an_axis_that_moves_the_tracker_by_a_mechanism_alone_is_fitted(tmp_path: Path) -> None:
    """q2 does not carry the hand, but a mechanism turns the hand with it, by its zero and its
    deflection too.
    """
    (tmp_path / "branches.toml").write_text(BRANCHES)
    model = flexgen.read(tmp_path / "branches.toml")
    there = flexgen.read(
        model.file, overrides={"element.right.dof.q2.gear.spring.stiffness": 3.5e3}
    )
    q = commands(60, joints=2)
    zero = np.array([0.0, 0.02])
    seen = flexgen.tracker_positions(there, q + zero) + 2e-5 * np.random.default_rng(0).normal(
        size=(60, 1, 3)
    )
    found = flexgen.calibrate(
        model, flexgen.StaticPoses(q, seen), free=["zeros", "compliances"], folds=0
    )
    assert not found.problem
    for name, value in (
        ("q2.zero", 0.02),
        ("q2.compliance", 1 / 3.5e3),
        ("q1.compliance", 1 / 5e3),
    ):
        assert abs(found.values[name] - value) < 3 * found.sd[name] and found.determined[name], (
            name
        )
    loads = {u.name for u in unknowns_of(Tree(model), ("masses",), (), Priors())}
    assert {"left.mass", "right.mass", "hand.mass"} <= loads


def test_a_body_that_loads_a_spring_by_a_mechanism_alone_has_an_unknown_mass(
    tmp_path: Path,
) -> None:
    text = BRANCHES.replace(SPRUNG, 'gear = { type = "rigid" }', 1)
    (tmp_path / "branches.toml").write_text(text)
    loads = {
        u.name
        for u in unknowns_of(
            Tree(flexgen.read(tmp_path / "branches.toml")), ("masses",), (), Priors()
        )
    }
    assert "hand.mass" in loads and "left.mass" not in loads


@pytest.mark.slow
def test_gross_errors_change_little() -> None:
    """Eight positions off by 50 mm: the robust fit stays within 0.2 mm, plain least squares does
    not.
    """
    for robust, least, most in ((True, 0.0, 2e-4), (False, 3e-4, 1.0)):
        found, other, truth = calibrated(robust, gross=8)
        assert least < np.linalg.norm(found.predict(other) - truth, axis=2).mean() < most
    assert "poses have an error above" in " ".join(calibrated(True, gross=8)[0].warnings)
    check_numbers(
        "calibration_gross",
        1e-5,
        robust=calibrated(True, gross=8)[0],
        plain=calibrated(False, gross=8)[0],
    )


def test_a_tilt_from_pose_to_pose_is_found() -> None:
    """Two trackers that an element's tilt moves together: its size, and what one tells about the
    other.
    """
    model = flexgen.read(JUSTIN)
    tree = Tree(model)
    q = commands(150, joints=17)
    statics = Statics(tree, q)
    numbers = Numbers.of(tree)
    rest = statics.rest(numbers)
    rng = np.random.default_rng(5)
    tilts = np.array([1e-3, 2e-3, 0.0])
    B = components.tilt_slopes(statics, numbers, rest, ["chest"])[0]
    shift = (B @ (tilts * rng.normal(size=(150, 3)))[..., None]).reshape(150, 2, 3)
    seen = rest.measured + shift + 3e-4 * rng.normal(size=shift.shape)
    found = components.find_tilt(statics, numbers, rest, seen, np.ones(150, bool))
    assert found is not None
    assert found.element == "chest"
    assert found.noise_m == pytest.approx(3e-4, rel=0.1)
    assert found.tilt_rad[:2] == pytest.approx(tilts[:2], rel=0.25)
    alone = np.linalg.norm(rest.measured - seen, axis=2).mean()
    others = components.seen_others(statics, numbers, rest, seen, found).mean()
    assert others < 0.6 * alone
    check_numbers("tilt", 1e-3, found=found, others=others)
    wrong = replace(found, tilt_rad=found.tilt_rad[[2, 0, 1]])  # planted: another axis
    assert components.seen_others(statics, numbers, rest, seen, wrong).mean() > 1.3 * others


def test_independent_errors_are_not_taken_for_a_tilt() -> None:
    """Noise of each point alone, seen with 24 and 40 poses: an element is named in one of a
    hundred.
    """
    tree = Tree(arm())
    named = least = 0
    for seed in range(6):
        statics = Statics(tree, commands(24 if seed % 2 else 40, seed))
        numbers = Numbers.of(tree)
        rest = statics.rest(numbers)
        rng = np.random.default_rng(seed)
        noise = 3e-4 * rng.normal(size=rest.measured.shape)
        B = components.tilt_slopes(statics, numbers, rest, ["body2"])[0]
        turned = (B @ (6e-4 * rng.normal(size=(len(B), 3)))[..., None]).reshape(noise.shape)
        usable = np.ones(len(B), bool)
        named += (
            components.find_tilt(statics, numbers, rest, rest.measured + noise, usable) is not None
        )
        least += (
            components.find_tilt(statics, numbers, rest, rest.measured + noise + turned, usable)
            is not None
        )
    assert named == 0 and least == 6


def test_the_frame_of_few_poses_is_found() -> None:
    """Frames turned by 90 to 180 degrees: the search that begins with the world's frame ends
    elsewhere in some.
    """
    tree = Tree(arm())
    first = replace(Numbers.of(tree), compliances=np.zeros(len(tree.elastic)))
    elsewhere = 0
    for count, seed in ((4, 1), (6, 7), (8, 25), (12, 56), (12, 3)):
        statics = Statics(tree, commands(count, seed))
        rng = np.random.default_rng(seed)
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(
            np.radians(rng.uniform(90, 180)) * axis / np.linalg.norm(axis)
        ).as_matrix()
        seen = statics.rest(first, rigid=True).points @ turn.T + [1.0, 2.0, -0.5]
        found = frames.start_frames(statics, seen, ())
        assert frames.rigid_errors(statics, seen, found).max() < 1e-9
        elsewhere += frames.search_start(statics, seen, (), first)[0] > 0.2
    assert elsewhere == 4


def test_a_tilt_is_found_though_the_search_meets_a_singular_covariance() -> None:
    """Two points that only a tilt about x moves, with noise 1e-4 of it: a step of the search
    leaves the numbers.
    """
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.0, 1.0, (24, 2, 3))
    B = np.moveaxis([np.cross(axis, points) for axis in np.eye(3)], 0, -1).reshape(24, 6, 3)
    tilts = 1e-3 * rng.normal(size=(24, 3, 1)) * [[1.0], [0.0], [0.0]]
    r = (B @ tilts)[..., 0] + 1e-7 * rng.normal(size=(24, 6))
    _, x = components.likelihood(r, B)
    sd = np.exp(x / 2)
    assert sd[1] == pytest.approx(np.sqrt((tilts[:, 0] ** 2).mean()), rel=0.05)
    assert max(sd[2:]) < 0.01 * sd[1]


@pytest.mark.slow
def test_a_wrong_mechanism_asks_for_negative_compliance() -> None:
    """The chest turned by the commanded angles instead of the actual ones: warned, by name; the
    right model is not.
    """
    truth = flexgen.read(JUSTIN)
    q = 0.6 * commands(120, joints=17)
    seen = flexgen.tracker_positions(truth, q) + 2e-4 * np.random.default_rng(0).normal(
        size=(120, 2, 3)
    )
    data = flexgen.StaticPoses(q, seen)
    right = flexgen.calibrate(truth, data, free=["compliances"], folds=0)
    assert not any("negative" in text for text in right.warnings)
    half = flexgen.read(
        JUSTIN, overrides={"element.chest.dof.upright.mimic": {"q1": -0.5, "q2": -0.5}}
    )
    wrong = flexgen.calibrate(half, data, free=["zeros", "compliances"], folds=0)
    assert any("negative compliance" in text for text in wrong.warnings)
    found = flexgen.calibrate(half, data, free=["zeros", "compliances", "mechanisms"], folds=0)
    assert found.values["upright.mimic.q1"] == pytest.approx(-1.0, abs=0.01)
    assert found.values["upright.mimic.q2"] == pytest.approx(-1.0, abs=0.01)


def test_proposed_poses_tell_more_than_random_ones() -> None:
    """D-optimal poses shrink the covariance more than the best of 20 random choices from the same
    candidates.
    """
    found, _, _ = calibrated()
    candidates = commands(60, seed=11)

    def gain(q: np.ndarray) -> float:
        statics = Statics(Tree(arm()), q)
        slopes, _ = statics.slopes(found._numbers, statics.rest(found._numbers), found.unknowns)
        J = slopes.reshape(-1, len(found.x))
        J = J / np.nanmedian(found.errors)
        return float(np.linalg.slogdet(np.eye(len(J)) + J @ found.covariance @ J.T)[1])

    rng = np.random.default_rng(0)
    random = [gain(candidates[rng.choice(60, 5, replace=False)]) for _ in range(20)]
    assert gain(found.propose_poses(5, candidates)) > max(random)
    with pytest.raises(ArgumentError, match="count: given 61"):
        found.propose_poses(61, candidates)


HEADER = ",".join(
    [
        *(f"q{k}_deg" for k in range(1, 7)),
        *(f"{t}_{a}_mm" for t in ("flange", "elbow") for a in "xyz"),
    ]
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty file"),
        (HEADER, "a line of names only"),
        (HEADER.replace("q3_deg", "q3"), "no column of q3, expected one, q3_rad or q3_deg"),
        (HEADER + ",q1_rad\n" + "0," * 12 + "0", "two columns of q1"),
        (HEADER + "\n" + "0," * 10 + "0", ":2: given 11 cells, expected 12"),
        (HEADER + "\n" + "0," * 11 + "a", ":2: elbow_z_mm: given 'a', expected a number"),
        (HEADER + "\n," + "0," * 10 + "0", ":2: q1_deg: given '', expected a number"),
        (HEADER + "\n" + "0," * 11 + "inf", "given 'inf'"),
    ],
)
def test_bad_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(text)
    with pytest.raises(ArgumentError) as caught:
        flexgen.calibrate(arm(), file)
    assert message in str(caught.value)


def test_bad_calls_are_refused() -> None:
    q = commands(10)
    data = flexgen.StaticPoses(q, np.zeros((10, 2, 3)))
    with pytest.raises(ArgumentError, match="given 'zero', expected"):
        flexgen.calibrate(arm(), data, free=["zero"])
    with pytest.raises(ArgumentError, match="place: given 'body9'"):
        flexgen.calibrate(arm(), data, place=["body9"])
    with pytest.raises(ArgumentError, match="given no tracker"):
        flexgen.calibrate("manutec_r3_18", data)
    with pytest.raises(ArgumentError, match="expected 6 and 2"):
        flexgen.calibrate(arm(), flexgen.StaticPoses(q[:, :5], np.zeros((10, 2, 3))))
    with pytest.raises(ArgumentError, match="seen in no pose"):
        flexgen.calibrate(arm(), flexgen.StaticPoses(q, np.full((10, 2, 3), np.nan)))
    with pytest.raises(ArgumentError, match="folds: given 11"):
        flexgen.calibrate(arm(), data, folds=11)
    with pytest.raises(ModelError, match="a beam"):
        flexgen.calibrate(flexgen.read("beam_arm", overrides={"sensor": TRACKERS[:1]}), data)
    with pytest.raises(ModelError, match="expected a linear spring"):
        flexgen.calibrate(
            flexgen.read("kr300", "backlash", overrides={"sensor": TRACKERS[:1]}), data
        )


MISTAKES = {
    "joints in degrees, read as radians": lambda q, y: (np.rad2deg(q), y),
    "positions in mm, read as m": lambda q, y: (q, 1e3 * y),
    "positions in a left-handed frame": lambda q, y: (q, y * [1.0, -1.0, 1.0]),
    "the sign of q2": lambda q, y: (q * [1, -1, 1, 1, 1, 1], y),
    "exchanged columns of q1 and q2": lambda q, y: (q[:, [1, 0, 2, 3, 4, 5]], y),
    "exchanged trackers flange and elbow": lambda q, y: (q, y[:, ::-1]),
    "q3 in degrees, read as radians": lambda q, y: (q * [1, 1, 180 / np.pi, 1, 1, 1], y),
    "y of elbow in mm, read as m": lambda q, y: (q, y * [[[1, 1, 1], [1, 1e3, 1]]]),
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_in_the_poses_is_named(words: str) -> None:
    """Of a robot with other zeros, lengths and springs, which is calibrated without the
    mistake.
    """
    tree, unknowns, x = drawn(arm(), ("zeros", "placements"), Priors())
    q = commands(40)
    y = Statics(tree, q).rest(Numbers.of(tree, unknowns, x)).measured
    with pytest.raises(ArgumentError, match=f"poses of manutec_r3_18: probably {words}"):
        flexgen.calibrate(arm(), flexgen.StaticPoses(*MISTAKES[words](q, y)), folds=0)


def test_agreement_is_the_median_error_and_scatter_of_the_worst_tracker(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Far from the origin, with positions that were not seen; the second tracker has more error
    for its scatter.

    The third has the most, but no joint moves it.
    """
    rng = np.random.default_rng(0)
    measured = [5.0, 6.0, 7.0] + rng.normal(size=(9, 3, 3)) * [[1.0], [0.5], [0.1]]
    measured[4, 0] = np.nan
    errors = rng.uniform(0.1, 0.2, (9, 3))
    errors[4, 0] = np.nan
    monkeypatch.setattr(mistakes, "rigid_errors", lambda *_: errors)
    monkeypatch.setattr(mistakes, "trackers_that_move", lambda *_: np.array([True, True, False]))
    seen = measured[:, 1]
    scatter = np.median(np.linalg.norm(seen - seen.mean(axis=0), axis=1))
    unused: Any = None
    assert mistakes.agreement(unused, measured, unused) == pytest.approx(
        (np.median(errors[:, 1]), scatter)
    )


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.0999, ""),
        (0.1001, "doubt"),
        (0.4999, "doubt"),
        (0.5001, "check units, signs and the order of the columns"),
    ],
)
@pytest.mark.parametrize("left", [0.55, 0.65, 0.9, 1.1])
def test_a_tenth_is_doubted_a_half_refused_and_a_third_named(
    error: float, words: str, left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``left``: what undoing a mistake leaves, over the third of the error up to which it is
    named, or a tenth.
    """
    named = left < 1.0 and left * error / 3 < 0.1
    parts = [(2 * error, 2.0), (2 * error, 2.0), (left * error / 3 * 4, 4.0)]
    data = flexgen.StaticPoses(commands(4), np.zeros((4, 2, 3)))
    statics: Any = SimpleNamespace(model=arm(), with_commands=lambda q: None)
    monkeypatch.setattr(mistakes, "start_frames", lambda *_: "numbers")
    monkeypatch.setattr(mistakes, "agreement", lambda *_: parts.pop(0))
    monkeypatch.setattr(
        mistakes, "possible_mistakes", lambda *_: [("one", data), ("another", data)]
    )
    if not words or (words == "doubt" and not named):
        assert mistakes.find_start(statics, data, ()) == "numbers"
        assert len(parts) == (2 if not words else 0)
        return
    words = "probably another" if named else words
    text = (
        f"that scatter by 2 m, of which the model leaves {2 * error:.3g} m unexplained, .*{words}"
    )
    with pytest.raises(ArgumentError, match=text):
        mistakes.find_start(statics, data, ())


def test_poses_of_nothing_are_refused() -> None:
    """Random positions: no single mistake explains them, and a robot that is only wrong by 0.2 rad
    is not refused.
    """
    q = commands(40)
    y = np.random.default_rng(5).normal(size=(40, 2, 3))
    with pytest.raises(ArgumentError, match="check units, signs and the order of the columns"):
        flexgen.calibrate(arm(), flexgen.StaticPoses(q, y), folds=0)
    moved = flexgen.tracker_positions(arm(), q + 0.2)
    found = flexgen.calibrate(arm(), flexgen.StaticPoses(q, moved), free=["zeros"], folds=0)
    assert found.errors.max() < 1e-2


def test_positions_that_were_not_seen_do_not_count() -> None:
    """Half of the positions of a tracker missing: the parameters are found; the errors there are
    nan.
    """
    tree, unknowns, x = drawn(arm(), ("zeros",), Priors())
    q = commands(40)
    seen = Statics(tree, q).rest(Numbers.of(tree, unknowns, x)).measured
    seen[::2, 1] = np.nan
    found = flexgen.calibrate(arm(), flexgen.StaticPoses(q, seen), free=["zeros"], folds=0)
    assert np.nanmax(found.errors) < 1e-6
    assert np.isnan(found.errors[::2, 1]).all()


@pytest.mark.slow
def test_command_line_writes_a_model_file(tmp_path: Path) -> None:
    """``flexgen calibrate`` from a CSV file to a model file that moves the trackers where they
    were measured.
    """
    text = arm().text
    assert text
    file = tmp_path / "arm.toml"
    table = "\n".join(
        (
            "[[sensor]]\n"
            f'name = "{t["name"]}"\n'
            'type = "tracker"\n'
            'unit = "m"\n'
            f"position = {t['position']}\n"
        )
        + (f'element = "{t["element"]}"\n' if "element" in t else "")
        for t in TRACKERS
    )
    file.write_text((ROOT / "models" / "manutec_r3_18.toml").read_text() + "\n" + table)
    tree, unknowns, x = drawn(flexgen.read(file), ("zeros", "compliances"), Priors(compliance=0.3))
    q = commands(40)
    seen = Statics(tree, q).rest(Numbers.of(tree, unknowns, x)).measured
    rows = np.hstack([np.degrees(q), 1e3 * seen.reshape(40, -1)])
    poses = tmp_path / "poses.csv"
    poses.write_text(
        HEADER + "\n" + "\n".join(",".join(f"{v:.12g}" for v in row) for row in rows) + "\n"
    )
    args = [
        "--free",
        "zeros,compliances",
        "--prior",
        "compliance=0.3",
        "--folds",
        "0",
        "--add-poses",
        "2",
    ]
    args += [
        "--out",
        str(tmp_path / "new.toml"),
        "--world",
        "measurement",
        "--report",
        str(tmp_path / "report"),
        "--json",
    ]
    done = subprocess.run(
        [sys.executable, str(ROOT / "cli.py"), "calibrate", str(file), str(poses), *args],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["mean_error_m"] < 1e-6
    assert len(data["proposed_poses"]) == 2
    assert (tmp_path / "report" / "index.html").exists()
    new = flexgen.read(f"{tmp_path / 'new.toml'}@calibrated")
    assert np.abs(flexgen.tracker_positions(new, q[:5]) - seen[:5]).max() < 1e-5


@pytest.mark.slow
@pytest.mark.skipif(
    not DATA.is_file(), reason="FLEXGEN_DATA names no folder with justin/poses.csv"
)
def test_real_humanoid() -> None:
    """400 measured poses of an elastic humanoid: errors on poses not fitted, one hand from the
    other, outliers.
    """
    poses = flexgen.StaticPoses.read(DATA, flexgen.read(JUSTIN))
    found = flexgen.calibrate(JUSTIN, poses, place=["right1", "left1"])
    assert found.errors_held_out is not None
    assert found.errors_seen is not None
    assert np.nanmean(found.errors_held_out) < 2.85e-3
    assert np.nanmean(found.errors_seen) < 1.8e-3
    rng = np.random.default_rng(0)
    spoiled = poses.positions.copy()
    for k in rng.choice(len(poses), 15, replace=False):
        direction = rng.normal(size=3)
        spoiled[k, k % 2] += 0.05 * direction / np.linalg.norm(direction)
    again = flexgen.calibrate(
        JUSTIN, flexgen.StaticPoses(poses.commands, spoiled), place=["right1", "left1"], folds=0
    )
    assert np.linalg.norm(again.predict(poses.commands) - poses.positions, axis=2).mean() < 3.1e-3
