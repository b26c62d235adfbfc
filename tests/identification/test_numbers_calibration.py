"""Statics of a calibration by other routes: slopes by differences, loads and rests by the
potential energy.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.poses import calibrate, mistakes
from flexgen.identification.poses import fit as fits
from flexgen.identification.poses.accuracy import accuracy_of
from flexgen.identification.poses.fit import Poses, fit
from flexgen.identification.poses.parameters import GROUPS, Priors, Unknown, unknowns_of
from flexgen.identification.poses.statics import (
    Near,
    Numbers,
    Statics,
    frame_rotation,
    frame_slopes,
)
from flexgen.identification.poses.tree import Tree, rotations

NAMES = ("elbow", "manutec_r3", "mechanism")


def robot(name: str) -> flexgen.RobotModel:
    """With trackers at the tool, on the first moving element, and on the base, and a payload.

    ``mechanism``: the elbow with a hand that both joints turn.
    """
    hand: dict[str, Any] = {}
    if name == "mechanism":
        name = "elbow"
        elements = tomllib.loads(Path(flexgen.read("elbow").file).read_text())["element"]
        turn = {
            "name": "q3",
            "type": "rotation",
            "axis": [0, 1, 0],
            "mimic": {"q1": -0.6, "q2": 0.4},
        }
        body = {"mass": 30.0, "com": [0.2, 0.0, 0.1], "inertia": [1.0, 1.0, 1.0]}
        hand = {
            "element": [
                *elements,
                {"name": "hand", "origin": {"position": [1.2, 0, 0]}, "body": body, "dof": [turn]},
            ]
        }
    model = flexgen.read(name)
    first = model.elements[0].name
    trackers: list[dict[str, Any]] = [
        {"name": "t", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
        {
            "name": "u",
            "type": "tracker",
            "unit": "m",
            "element": first,
            "position": [0.1, 0.0, 0.05],
        },
    ]
    payload = {"payload": {"mass": 4.0}} if name == "elbow" else {}
    return flexgen.read(name, overrides={**hand, "sensor": trackers, **payload})


def case(name: str, seed: int = 1) -> tuple[Statics, Numbers, list[Any], np.ndarray]:
    """Four poses, all groups of numbers free, away from the model file."""
    model = robot(name)
    tree = Tree(model)
    rng = np.random.default_rng(seed)
    groups = tuple(GROUPS)
    unknowns = unknowns_of(tree, groups, (), Priors())
    x = np.array(
        [u.start + 0.02 * rng.standard_normal() * (abs(u.start) or 0.1) for u in unknowns]
    )
    statics = Statics(tree, rng.uniform(-1.0, 1.0, (4, model.n_g)))
    return statics, Numbers.of(tree, unknowns, x), unknowns, x


@pytest.mark.parametrize("name", NAMES)
def test_slopes_of_all_numbers_are_differences(name: str) -> None:
    statics, numbers, unknowns, x = case(name)
    rest = statics.rest(numbers)
    found, _ = statics.slopes(numbers, rest, unknowns)
    assert found.shape == (4, 2, 3, len(unknowns)) and {u.kind for u in unknowns} >= {
        "node",
        "frame",
        "tracker",
    }
    factors = [u.name for u in unknowns if u.kind == "factor"]
    assert factors == (["q3.mimic.q1", "q3.mimic.q2"] if name == "mechanism" else [])
    for k, unknown in enumerate(unknowns):
        if (
            factors
            and unknown.kind not in ("factor", "compliance")
            and unknown.name not in ("q1.zero", "q2.zero", "hand.mass")
        ):
            continue  # as without a mechanism
        h = {"node": 1e-6, "frame": 1e-6, "tracker": 1e-6, "center": 1e-3}.get(
            unknown.kind, 1e-3 * abs(x[k])
        )
        more, less = (
            statics.rest(
                Numbers.of(statics.tree, unknowns, x + s * h * (np.arange(len(x)) == k))
            ).measured
            for s in (1.0, -1.0)
        )
        size = np.abs(found[..., k]).max() + 1e-9
        assert_allclose(
            found[..., k],
            (more - less) / (2 * h),
            rtol=1e-4,
            atol=1e-5 * size + 1e-12,
            err_msg=unknown.name,
        )


@pytest.mark.parametrize("name", NAMES)
def test_a_rest_balances_springs_and_gravity(name: str) -> None:
    """Of the model itself: deflections times stiffness are the gradient of the potential energy of
    its equations.
    """
    model = robot(name)
    tree = Tree(model)
    commands = np.random.default_rng(3).uniform(-1.0, 1.0, (5, model.n_g))
    statics = Statics(tree, commands)
    numbers = Numbers.of(tree)
    rest = statics.rest(numbers)
    assert_allclose(rest.near.deflection, rest.load * numbers.compliances, atol=1e-9)
    gravity = derive(model).function("gravity")
    names = [c.name for c in model.coordinates]
    for k in range(5):
        q = np.array([rest.q[k, tree.index[x]] for x in names])
        g = np.array(gravity(q)).ravel()
        for e, coordinate in enumerate(tree.elastic):
            i = names.index(coordinate)
            assert rest.load[k, e] == pytest.approx(-g[i], rel=1e-9, abs=1e-9)
    place = derive(model).function("forward_kinematics")
    expected = [place(np.array([rest.q[k, tree.index[x]] for x in names])) for k in range(5)]
    tip = np.array([[0.05, 0.02, 0.1]])
    points = [np.array(p).ravel() + np.array(R) @ tip[0] for p, R in expected]
    assert_allclose(rest.points[:, 0], points, atol=1e-9)
    rigid = statics.rest(numbers, rigid=True)
    assert not rigid.near.deflection.any() and rigid.near.inverse is None
    assert_allclose(rigid.q[:, statics.actuated], commands)
    soft = replace(numbers, compliances=1e3 * numbers.compliances * np.ones(len(tree.elastic)))
    if name == "elbow":
        with pytest.raises(
            SolverError, match=r"^calibration: (a pose has )?no static equilibrium"
        ):
            statics.rest(replace(soft, compliances=0 * soft.compliances + 1.0))
    again = statics.rest(numbers, rest.near)
    assert_allclose(again.q, rest.q, atol=1e-12)
    for inverse in (
        rest.near.inverse,
        None if rest.near.inverse is None else rest.near.inverse[::-1],
    ):
        # also with that of other poses
        far = statics.rest(numbers, Near(np.zeros_like(rest.near.deflection), inverse))
        assert_allclose(far.q, rest.q, atol=1e-9)
    part = statics.among(np.array([3, 1])).rest(numbers)
    assert_allclose(part.measured, rest.measured[[3, 1]], atol=1e-9)


def test_frames_of_a_measurement_turn_about_x_y_z() -> None:
    frame = np.array([1.0, 2.0, 3.0, 0.3, -0.5, 0.8])
    assert_allclose(
        frame_rotation(frame), Rotation.from_euler("XYZ", frame[3:]).as_matrix(), atol=1e-14
    )
    h = 1e-6
    for k, slope in enumerate(frame_slopes(frame)):
        e = h * (np.arange(6) == 3 + k)
        assert_allclose(
            slope, (frame_rotation(frame + e) - frame_rotation(frame - e)) / (2 * h), atol=1e-9
        )
    axis = np.array([0.6, 0.0, 0.8])
    found = rotations(axis, np.array([0.4, -1.2]))
    assert_allclose(
        found, [Rotation.from_rotvec(a * axis).as_matrix() for a in (0.4, -1.2)], atol=1e-14
    )


def test_a_point_of_a_frame_moves_with_the_nodes_before_it() -> None:
    """Rotations and translations, the first node included; a point of the base does not move."""
    tree = Tree(robot("elbow"))
    q = 0.1 * np.random.default_rng(2).standard_normal((3, len(tree.nodes)))
    at = tree.posture(q)
    h = 1e-6
    place = np.array([0.1, -0.2, 0.3])
    for mount in (tree.tool, tree.tip("upper"), tree.tip("base")):
        point = tree.point(at, mount, place)
        slopes = tree.point_slopes(at, mount, point)
        for k in range(len(tree.nodes)):
            e = h * (np.arange(len(tree.nodes)) == k)
            change = (
                tree.point(tree.posture(q + e), mount, place)
                - tree.point(tree.posture(q - e), mount, place)
            ) / (2 * h)
            assert_allclose(slopes[:, :, k], change, atol=1e-8)
    first = tree._add("more", tree.tip("base"), np.array([0.0, 0.0, 1.0]), False)
    other = Tree(robot("elbow"))
    mount = replace(first, node=0)
    slopes = other.point_slopes(
        other.posture(q), mount, other.point(other.posture(q), mount, place)
    )
    assert slopes[:, :, 0].any() and not slopes[:, :, 1:].any()
    n = len(other.nodes)
    assert (
        other.carries[0].all() and other.carries[:, 0].sum() == 1 and np.trace(other.carries) == n
    )


# --- what a user reads ---------------------------------------------------------------------------
def test_poses_that_do_not_fit_the_model_are_refused() -> None:
    arm: Any = SimpleNamespace(n_g=2, name="arm")

    def check(
        count: int = calibrate.FEWEST,
        joints: int = 2,
        trackers: int = 1,
        folds: int = 5,
        lost: bool = False,
        different: int = 1000,
    ) -> None:
        positions = np.full((count, trackers, 3), np.nan if lost else 1.0)
        commands = np.tile(np.arange(count)[:, None] % different, (1, joints))
        poses = flexgen.StaticPoses(commands, positions)
        calibrate.check_poses(arm, poses, 1, folds)

    fewest = calibrate.FEWEST
    check()
    check(folds=0)
    check(folds=2)
    check(folds=fewest)
    advice = "expected 2 and 1, those of model arm"
    for more, words in (
        ({"joints": 3}, f"poses: given 3 joints and 1 trackers, {advice}"),
        ({"trackers": 2}, f"poses: given 2 joints and 2 trackers, {advice}"),
        ({"count": fewest - 1}, f"poses: given {fewest - 1}, expected at least {fewest}"),
        (
            {"different": 1},
            (
                f"poses: given {fewest} with 1 different commands, expected at least {fewest} "
                "that differ"
            ),
        ),
        ({"folds": 1}, f"folds: given 1, expected 0, or 2 to {fewest}, the number of poses"),
        (
            {"folds": fewest + 1},
            f"folds: given {fewest + 1}, expected 0, or 2 to {fewest}, the number of poses",
        ),
        ({"folds": -1}, f"folds: given -1, expected 0, or 2 to {fewest}, the number of poses"),
        (
            {"lost": True},
            (
                "poses: given a tracker that was seen in no pose, expected at least one "
                "position of each"
            ),
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            check(**more)  # type: ignore[arg-type]
        assert str(caught.value) == words


def test_warnings_of_a_calibration() -> None:
    """Compliances that would be negative, errors on other poses, gross errors, and no end."""
    unknowns: Any = [
        SimpleNamespace(name=name) for name in ("q1.compliance", "q2.compliance", "q1.zero")
    ]
    errors = np.full((30, 2), 1e-3)

    def found(**more: Any) -> Any:
        fields = {"errors": errors, "scale": 1e-3, "converged": True}
        made = SimpleNamespace(**(fields | more))
        made.sizes = made.errors / made.scale
        return made

    none = np.zeros(3)
    assert calibrate.warnings_of(unknowns, found(), none, None) == ()
    assert (
        calibrate.warnings_of(unknowns, found(), none, np.full((30, 2), 0.99e-3 * calibrate.MANY))
        == ()
    )
    pull = np.array([1.01 * calibrate.PULL, 0.99 * calibrate.PULL, 0.0])
    (text,) = calibrate.warnings_of(unknowns, found(), pull, None)
    assert text.startswith(
        "the measurements ask for a negative compliance of q1: a mechanism, a spring below it or "
    )
    held = np.full((30, 2), 2e-3 * calibrate.MANY)
    held[3] = np.nan
    (text,) = calibrate.warnings_of(unknowns, found(), none, held)
    assert text.startswith(
        f"the mean error on poses that were not fitted is {2 * calibrate.MANY:.2g} times that "
        "of the"
    )
    gross = errors.copy()
    gross[4, 1] = 1.01e-3 * calibrate.GROSS
    gross[7, 0] = 0.99e-3 * calibrate.GROSS
    gross[9, 0] = np.nan
    size = f"{calibrate.GROSS:.3g}"
    expected = (f"1 poses have an error above {size} mm: rows 5 of the poses",)
    assert calibrate.warnings_of(unknowns, found(errors=gross), none, None) == expected
    gross[:11] = 1.0
    (text,) = calibrate.warnings_of(unknowns, found(errors=gross), none, None)
    assert text.endswith(
        "rows 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ... of the poses"
    ) and text.startswith("11 poses")
    gross[10] = 0.0
    assert calibrate.warnings_of(unknowns, found(errors=gross), none, None)[0].endswith(
        "9, 10 of the poses"
    )
    assert calibrate.warnings_of(unknowns, found(converged=False), none, None) == (
        "the search did not end at a minimum",
    )


@pytest.mark.parametrize(
    ("errors", "named"),
    [
        ({"a": 0.5, "b": 0.02}, "probably b"),
        ({"a": 0.9, "b": 0.8}, "check units, signs and the order of the columns"),
    ],
)
def test_a_mistake_in_the_poses_is_the_one_that_explains_most(
    errors: dict[str, float], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the model leaves much of the motion unexplained; what is left is over the scatter of
    the positions.
    """
    sizes: dict[Any, tuple[float, float]] = {"given": (1.0, 1.1)} | {
        name: (x, 1.0) for name, x in errors.items()
    }

    class Part:
        model = SimpleNamespace(name="arm")

        def with_commands(self, commands: Any) -> Any:
            return commands

    monkeypatch.setattr(mistakes, "start_frames", lambda statics, measured, placed: "start")
    monkeypatch.setattr(mistakes, "agreement", lambda statics, measured, start: sizes[measured])
    wrong = [(name, SimpleNamespace(commands=name, positions=name)) for name in errors]
    monkeypatch.setattr(mistakes, "possible_mistakes", lambda model, data: wrong)
    data: Any = SimpleNamespace(commands="given", positions="given", source="run.csv")
    told: list[str] = []
    statics: Any = Part()
    with pytest.raises(ArgumentError) as caught:
        mistakes.find_start(statics, data, (), told.append)
    assert str(caught.value) == (
        "run.csv: given positions that scatter by 1.1 m, of which the model leaves 1 m "
        f"unexplained, expected poses of arm: {named}"
    )
    first = "frame of the measurement, trackers and unknown places"
    assert told == [
        first,
        "91 % of the motion is not explained: searching for a mistake in the poses",
    ]
    sizes["given"] = (0.99 * mistakes.DOUBTFUL, 1.0)
    assert mistakes.find_start(statics, data, (), told.append) == "start" and told[2:] == [first]


class Lines(Poses):
    """Positions that are linear in the unknowns."""

    def numbers(self, x: np.ndarray) -> Any:
        return x


def lines(robust: bool, whitening: np.ndarray | None = None) -> tuple[Lines, np.ndarray]:
    """Two points in 12 poses, one not seen once and one with a gross error; the first compliance
    comes out negative.
    """
    rng = np.random.default_rng(5)
    slopes = rng.normal(size=(12, 2, 3, 4))
    x = np.array([-0.02, 0.3, 0.5, -0.7])
    measured = slopes @ x + 0.01 * rng.normal(size=(12, 2, 3))
    measured[4, 1] = np.nan
    measured[7, 0, 2] += 0.5
    rows = [
        ("compliance", 0.1, 1.0),
        ("compliance", 0.2, 0.05),
        ("frame", 0.0, np.inf),
        ("center", -0.5, 0.5),
    ]
    unknowns = [Unknown(kind, "", kind, (0,), start, sd) for kind, start, sd in rows]
    statics: Any = SimpleNamespace(
        rest=lambda x, near: SimpleNamespace(measured=slopes @ x, near=near),
        slopes=lambda x, rest, unknowns: (slopes, rest.near),
        touches=None,
    )
    return Lines(statics, measured, unknowns, robust, whitening), slopes


@pytest.mark.parametrize("case", ["least squares", "robust", "whitened"])
def test_a_fit_minimizes_its_documented_objective(case: str) -> None:
    """With the scale of its own errors, found by a minimizer without slopes; a compliance ends at
    its bound.
    """
    root = 50 * (np.eye(6) + 0.2 * np.random.default_rng(2).normal(size=(12, 6, 6)))
    problem, slopes = lines(case != "least squares", root if case == "whitened" else None)
    told: list[str] = []
    found = fit(problem, np.array([0.1, 0.2, 0.0, -0.5]), progress=told.append)
    start = np.array([0.1, 0.2, 0.0, -0.5])
    sd = np.array([1.0, 0.05, np.inf, 0.5])
    seen = np.isfinite(problem.measured).all(axis=2) & problem.valid
    assert seen.sum() == 23 and found.converged

    def gaps(x: np.ndarray) -> np.ndarray:
        gap = slopes @ x - problem.measured
        gap[4, 1] = 0.0
        return np.asarray(gap)

    def cost(x: np.ndarray, scale: float) -> float:
        u = np.sqrt((gaps(x) ** 2).sum(axis=2)) / scale
        times = 1
        if case == "whitened":
            u = np.sqrt(
                np.array(
                    [
                        (root[i] @ gaps(x)[i].ravel()) @ (root[i] @ gaps(x)[i].ravel())
                        for i in range(12)
                    ]
                )
                / 2
            )
            times = 2
        loss = u**2 if case == "least squares" else np.where(u > 2.5, 5.0 * u - 6.25, u**2)
        return float(times * loss.sum() + (((x - start) / sd) ** 2).sum())

    x = start.copy()
    for _ in range(4):
        scale = float(np.median(np.sqrt((gaps(x) ** 2).sum(axis=2))[seen])) / 1.538172
        args = (scale,)
        bounds = [(1e-4, None), (2e-4, None), (None, None), (None, None)]
        x = minimize(cost, x, args=args, bounds=bounds, method="SLSQP", options={"ftol": 1e-10}).x
    assert_allclose(found.x, x, atol=1e-4)
    assert found.x[0] == 1e-4 and found.scale == pytest.approx(scale, rel=1e-2)
    lengths = np.sqrt((gaps(found.x) ** 2).sum(axis=2))
    assert np.isnan(found.errors[4, 1]) and found.errors[seen] == pytest.approx(lengths[seen])
    mean = 1e3 * np.sqrt((gaps(start) ** 2).sum(axis=2))[seen].mean()
    assert told[0] == f"step 0: mean error {mean:.3f} mm" and len(told) < 12
    sure = accuracy_of(problem, found)
    assert (
        not sure.covariance[0].any()
        and not sure.covariance[:, 0].any()
        and not sure.pull[1:].any()
    )
    # the objective is quadratic: where the compliance would be without a bound
    if case == "least squares":
        H = np.einsum(
            "nkai,nkaj->ij", slopes * seen[..., None, None], slopes
        ) / found.scale**2 + np.diag(sd**-2.0)
        right = (
            np.einsum("nkai,nka->i", slopes, problem.measured * seen[..., None]) / found.scale**2
            + sd**-2.0 * start
        )
        inverse = np.linalg.inv(H)
        assert_allclose(
            sure.pull[0], ((inverse @ right)[0] - 1e-4) / np.sqrt(inverse[0, 0]), rtol=1e-3
        )


def test_a_fit_that_ends_early_has_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, _ = lines(True)
    monkeypatch.setattr(fits, "STEPS", 1)
    assert not fit(problem, np.array([0.1, 0.2, 0.0, -0.5])).converged
    monkeypatch.setattr(fits, "STEPS", 0)
    # from within the bounds
    assert_allclose(fit(problem, np.array([-0.1, 0.2, 0.0, -0.5])).x, [1e-4, 0.2, 0.0, -0.5])


def test_errors_of_a_small_robot_keep_their_scale() -> None:
    """A floor of 1 um made priors stronger than points of a robot of 2 cm that are measured to 0.1
    um.
    """
    for size, least in ((0.02, 2e-8), (3.0, 1e-6), (0.0, 1e-6)):
        measured = np.zeros((3, 1, 3))
        measured[1, 0, 2] = size
        measured[2, 0] = np.nan
        made = Poses(SimpleNamespace(touches=None), measured, [], True)  # type: ignore[arg-type]
        for error in (1e-7, 1e-12):
            found = made.scale(np.full((3, 1), error))
            assert found == pytest.approx(max(error / fits.MEDIAN_LENGTH, least), rel=1e-12)
