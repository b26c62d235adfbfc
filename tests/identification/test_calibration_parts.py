"""Poses of a calibration at rest: slopes by differences, loads by the potential energy, start
values where elements and trackers were placed, and fits by another search.
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
from scipy.stats import multivariate_normal

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.poses import calibrate, components, frames
from flexgen.identification.poses import fit as fits
from flexgen.identification.poses.accuracy import accuracy_of
from flexgen.identification.poses.components import Tilt
from flexgen.identification.poses.fit import Poses, fit
from flexgen.identification.poses.parameters import GROUPS, Priors, Unknown, unknowns_of
from flexgen.identification.poses.result import FRAME, Calibration
from flexgen.identification.poses.statics import (
    Near,
    Numbers,
    Statics,
    frame_rotation,
    frame_slopes,
)
from flexgen.identification.poses.tree import SHIFTS, Tree, rotations

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
    mount = replace(tree.tip("base"), node=0)
    slopes = tree.point_slopes(at, mount, tree.point(at, mount, place))
    assert slopes[:, :, 0].any() and not slopes[:, :, 1:].any()
    n = len(tree.nodes)
    assert tree.carries[0].all() and tree.carries[:, 0].sum() == 1 and np.trace(tree.carries) == n


FEWEST = calibrate.FEWEST
ADVICE = "expected 2 and 1, those of model elbow"
FOLDS = f"expected 0, or 2 to {FEWEST}, the number of poses"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, ""),
        ({"folds": 0}, ""),
        ({"folds": 2}, ""),
        ({"folds": FEWEST}, ""),
        ({"joints": 3}, f"given 3 joints and 1 trackers, {ADVICE}"),
        ({"trackers": 2}, f"given 2 joints and 2 trackers, {ADVICE}"),
        ({"count": FEWEST - 1}, f"poses: given {FEWEST - 1}, expected at least {FEWEST}"),
        ({"different": 1}, f"with 1 different commands, expected at least {FEWEST} that differ"),
        ({"folds": 1}, f"folds: given 1, {FOLDS}"),
        ({"folds": FEWEST + 1}, f"folds: given {FEWEST + 1}, {FOLDS}"),
        ({"folds": -1}, f"folds: given -1, {FOLDS}"),
        ({"lost": True}, "a tracker that was seen in no pose, expected at least one position of"),
    ],
)
def test_poses_that_do_not_fit_the_model_are_refused(changes: dict[str, Any], text: str) -> None:
    usual = {"count": FEWEST, "joints": 2, "trackers": 1, "folds": 5, "lost": False}
    given: dict[str, Any] = usual | {"different": 1000} | changes
    positions = np.full((given["count"], given["trackers"], 3), np.nan if given["lost"] else 1.0)
    each = np.arange(given["count"])[:, None] % given["different"]
    poses = flexgen.StaticPoses(np.tile(each, (1, given["joints"])).astype(float), positions)
    model = flexgen.read("elbow")
    if not text:
        calibrate.check_poses(model, poses, 1, given["folds"])
        return
    with pytest.raises(ArgumentError) as caught:
        calibrate.check_poses(model, poses, 1, given["folds"])
    assert text in str(caught.value)


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
    here = problem.linearize(start + 0.01)
    central = [
        (here.cost(start + 0.01 + z) - here.cost(start + 0.01 - z)) / 2e-6
        for z in 1e-6 * np.eye(4)
    ]
    assert_allclose(2 * here.slope, central, rtol=1e-4, atol=1e-3 * np.abs(central).max())
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


# --- start values --------------------------------------------------------------------------------
TURNED = [0.3, -0.2, 0.1, 2.0, 0.8, -1.0]  # of an element: m, rad
OFF = np.array([1.0, 2.0, -0.5, 0.4, -0.6, 2.0])  # frame of the measurement


def placed(poses: int) -> tuple[Statics, Numbers, list[int]]:
    """A rigid robot with an element and trackers at other places, seen from another frame."""
    trackers: list[dict[str, Any]] = [
        {"name": "t", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
        {"name": "u", "type": "tracker", "unit": "m", "element": "body1"},
    ]
    tree = Tree(flexgen.read("manutec_r3", overrides={"sensor": trackers}))
    at = [tree.index[f"body2.{name}"] for name in SHIFTS]
    statics = Statics(tree, np.random.default_rng(3).uniform(-1.0, 1.0, (poses, 6)))
    true = Numbers.of(tree)
    shifts = true.shifts.copy()
    shifts[at] = TURNED
    rigid = np.zeros(len(tree.elastic))
    moved = {"frame": OFF, "trackers": true.trackers + 0.1, "compliances": rigid}
    return statics, replace(true, shifts=shifts, **moved), at


def test_a_turned_element_is_found_with_the_trackers_and_the_frame() -> None:
    """Positions do not tell a shift along the axis before the element from one of the frame: they
    are what is equal. Without the element the search ends where it gains little.
    """
    statics, true, _ = placed(8)
    measured = statics.rest(true, rigid=True).measured.copy()
    measured[3, 0] = measured[5, 1] = np.nan
    begin = replace(Numbers.of(statics.tree), compliances=true.compliances)
    error, found = frames.search_start(statics, measured, ("body2",), begin)
    errors = frames.rigid_errors(statics, measured, found)
    assert np.isnan(errors[[3, 5], [0, 1]]).all() and np.isnan(errors).sum() == 2
    assert error == pytest.approx(np.nanmean(errors), rel=1e-9) and error < 1e-4
    soft = replace(found, compliances=np.full(len(found.compliances), 1e-4))
    assert_allclose(frames.rigid_errors(statics, measured, soft), errors, atol=1e-12)
    past = [frames.search_start(statics, measured, (), begin, n)[0] for n in range(1, 60)]
    part = -np.diff(past) / past[1:]
    ends = int(np.argmax(part < 1e-3))
    assert 8 < ends < 58 and (part[:ends] >= 1e-3).all() and not part[ends + 1 :].any()


def test_one_step_places_an_element_and_the_trackers_where_they_are() -> None:
    """All else known; a tracker in front of the element, and positions that were not seen, tell
    nothing of it.
    """
    statics, true, at = placed(6)
    shown = statics.rest(true, rigid=True).measured
    valid = np.ones(shown.shape[:2], bool)
    valid[2, 0] = False
    y = np.where(valid[..., None], shown, 1e3)
    wrong = replace(true, shifts=0.6 * true.shifts)
    rest = statics.rest(wrong, rigid=True)
    found = frames.place_element(statics, rest, wrong, "body2", y, valid)
    turn, expected = (
        Rotation.from_euler("XYZ", x).as_matrix() for x in (found.shifts[at[3:]], TURNED[3:])
    )
    assert_allclose(turn, expected, atol=1e-12)
    assert_allclose(found.shifts[at[:3]], TURNED[:3], atol=1e-12)
    # none on the element
    alone = Statics(
        Tree(replace(statics.tree.model, sensors=statics.tree.model.sensors[1:])), statics.commands
    )
    one = replace(wrong, trackers=wrong.trackers[1:])
    rest = alone.rest(one, rigid=True)
    assert frames.place_element(alone, rest, one, "body2", y[:, 1:], valid[:, 1:]) is one
    lost = replace(true, trackers=np.zeros((2, 3)))
    rest = statics.rest(lost, rigid=True)
    again, points = frames.place_trackers(statics, rest, lost, y, valid)
    assert_allclose(again.trackers, true.trackers, atol=1e-12)
    world = OFF[:3] + points @ Rotation.from_euler("XYZ", OFF[3:]).as_matrix().T
    assert_allclose(world, shown, atol=1e-12)


@pytest.mark.parametrize(("lost", "taken"), [(5, 63), (70, 60), (71, 130)])
def test_the_search_begins_from_eight_attitudes_on_some_of_the_poses(
    lost: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second one of 125 with all trackers; all where fewer than 60 were; then the best one
    with all poses.
    """
    statics, true, at = placed(130)
    measured = statics.rest(true, rigid=True).measured.copy()
    measured[:lost, 1, 2] = np.nan
    calls: list[Any] = []

    def search(
        part: Statics, y: np.ndarray, placed: Any, numbers: Numbers, rounds: int = 60
    ) -> tuple[float, Numbers]:
        calls.append((len(part.commands), len(y), numbers.shifts[at], rounds))
        return abs(len(calls) - 6.0), replace(numbers, frame=np.full(6, float(len(calls))))

    monkeypatch.setattr(frames, "search_start", search)
    found = frames.start_frames(statics, measured, ("body2",))
    assert [call[:2] for call in calls] == [(taken, taken)] * 8 + [(130, 130)]
    assert [call[3] for call in calls] == [10] * 8 + [60] and found.frame[0] == 9.0
    turns = np.array([call[2] for call in calls])
    assert not turns[0].any() and not turns[:, :3].any() and turns[1:8, 3:].all()
    assert_allclose(turns[8], turns[5])  # of the smallest error


@pytest.mark.parametrize(
    ("errors", "best"), [([0.0999], 1.0), ([0.1001, 0.11], 1.0), ([0.1001, 0.01], 2.0)]
)
def test_a_search_from_the_frame_of_the_file_follows_where_the_first_error_is_large(
    errors: list[float], best: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Larger than a twentieth of the mean distance of the points from their mean, which is 2."""
    statics, _, _ = placed(6)
    begun: list[np.ndarray] = []

    def search(*given: Any) -> tuple[float, Numbers]:
        begun.append(given[3].frame)
        frame = np.full(6, float(len(begun)))
        return errors[len(begun) - 1], replace(given[3], frame=frame)

    monkeypatch.setattr(frames, "search_start", search)
    measured = np.tile([[[3.0, 5.0, 0.0], [-1.0, 5.0, 0.0]]], (6, 1, 1))
    assert frames.start_frames(statics, measured, ()).frame[0] == best
    assert len(begun) == len(errors)
    if len(begun) == 2:
        begun.clear()
        shown = statics.rest(replace(Numbers.of(statics.tree), frame=OFF), rigid=True).measured
        errors[0] = 1.0
        frames.start_frames(statics, shown, ())
        assert_allclose(begun[1], OFF, atol=1e-9)  # of the trackers as the file has them


def test_the_best_pose_of_points_is_a_rotation_and_a_shift() -> None:
    """Also of points in a plane, whose mirror image would fit as well."""
    rng = np.random.default_rng(8)
    R = Rotation.random(random_state=3).as_matrix()
    t = np.array([0.3, -2.0, 5.0])
    for flat in (1.0, 0.0):
        a = rng.standard_normal((10, 3)) * [1.0, 1.0, flat]
        found = frames.best_pose(a, a @ R.T + t)
        assert_allclose(found[0], R, atol=1e-12)
        assert_allclose(found[1], t, atol=1e-12)
    turned = Rotation.from_euler("XYZ", frames.angles_of(R)).as_matrix()
    assert_allclose(turned, R, atol=1e-12)
    a = rng.standard_normal((10, 3))
    assert np.linalg.det(frames.best_pose(a, a * [1.0, 1.0, -1.0])[0]) == pytest.approx(1.0)
    for sign in (1.0, -1.0):  # of a quarter turn, with rounding
        quarter = Rotation.from_euler("y", sign * np.pi / 2).as_matrix()
        quarter[0, 2] *= 1 + 1e-12
        assert frames.angles_of(quarter)[1] == sign * np.pi / 2


# --- tilts that trackers share -------------------------------------------------------------------
def test_errors_that_others_tell_are_means_under_their_measurements() -> None:
    """Of normal tilts and noise: the conditional mean from the joint covariance of six
    coordinates.
    """
    rng = np.random.default_rng(1)
    B = rng.normal(size=(3, 6, 3))
    gap = rng.normal(size=(3, 2, 3))
    tilt = Tilt("arm", 0.2, np.array([0.5, 1.0, 2.0]), 1.0)
    found = components.predict_others(tilt, B, gap)
    for pose in range(3):
        shared = B[pose] @ np.diag([0.25, 1.0, 4.0]) @ B[pose].T
        for one, other in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
            seen = shared[other, other] + 0.04 * np.eye(3)
            mean = shared[one, other] @ np.linalg.inv(seen) @ gap[pose].ravel()[other]
            assert_allclose(found[pose].ravel()[one], gap[pose].ravel()[one] - mean, rtol=1e-9)


def test_the_likelihood_of_tilts_is_that_of_normal_errors() -> None:
    """Its value, without the constant, is that of SciPy; at the minimum no number can be changed
    to a lower one.
    """
    rng = np.random.default_rng(6)
    B = rng.normal(size=(16, 6, 3))
    tilts = [0.05, 0.1, 0.02] * rng.normal(size=(16, 3))
    r = 0.02 * rng.normal(size=(16, 6)) + np.einsum("nij,nj->ni", B, tilts)

    def value(x: np.ndarray) -> float:
        total = 0.0
        for one, slopes in zip(r, B, strict=True):
            sigma = np.exp(x[0]) * np.eye(6) + slopes @ np.diag(np.exp(x[1:])) @ slopes.T
            total -= multivariate_normal(np.zeros(6), sigma).logpdf(one) + 3 * np.log(2 * np.pi)
        return total

    least, x = components.likelihood(r, B)
    assert least == pytest.approx(value(x), rel=1e-9)
    for k in range(4):
        for change in (-0.02, 0.02):
            assert value(x + change * (np.arange(4) == k)) > least
    assert_allclose(np.exp(x / 2), [0.02, 0.05, 0.1, 0.02], rtol=0.6)


# --- results -------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def calibrated() -> Calibration:
    """The elbow with zeros that are off, seen by two trackers."""
    trackers = [
        {"name": "a", "type": "tracker", "unit": "m", "position": [0.1, 0.0, 0.05]},
        {"name": "b", "type": "tracker", "unit": "m", "element": "upper"},
    ]
    model = flexgen.read("elbow", overrides={"sensor": trackers})
    rng = np.random.default_rng(5)
    commands = rng.uniform([-1.0, -0.5], [0.5, 1.5], (12, 2))
    tree = Tree(model)
    unknowns = unknowns_of(tree, ("zeros",), (), Priors())
    x = np.array([u.start for u in unknowns]) + 0.01
    seen = Statics(tree, commands).rest(Numbers.of(tree, unknowns, x)).measured
    poses = flexgen.StaticPoses(commands, seen + 1e-4 * rng.standard_normal(seen.shape))
    return flexgen.calibrate(model, poses, free=["zeros"], folds=0)


def test_proposed_poses_are_those_of_the_largest_determinants(calibrated: Calibration) -> None:
    """One after the other among candidates, with derivatives by differences of the predicted
    positions.
    """
    found = calibrated
    candidates = np.random.default_rng(1).uniform(-1.5, 1.5, (15, 2))
    chosen = found.propose_poses(3, candidates)
    tree = Tree(found.nominal)
    statics = Statics(tree, candidates)
    h = 1e-6
    slopes = []
    for e in h * np.eye(len(found.x)):
        more, less = (
            statics.rest(Numbers.of(tree, found.unknowns, found.x + s * e)).measured
            for s in (1.0, -1.0)
        )
        slopes.append((more - less).reshape(15, -1) / (2 * h))
    J = np.stack(slopes, axis=2) / np.median(found.errors)
    information = np.linalg.inv(found.covariance)
    expected: list[int] = []
    for _ in range(3):
        gains = [
            np.linalg.slogdet(information + j.T @ j)[1] if k not in expected else -np.inf
            for k, j in enumerate(J)
        ]
        expected.append(int(np.argmax(gains)))
        information = information + J[expected[-1]].T @ J[expected[-1]]
    assert_allclose(chosen, candidates[expected])
    before = found.covariance.copy()
    drawn = found.propose_poses(2)
    assert drawn.shape == (2, 2) and np.array_equal(found.covariance, before)
    commands = found.poses.commands
    assert (drawn >= commands.min(axis=0)).all() and (drawn <= commands.max(axis=0)).all()
    assert not np.array_equal(drawn, found.propose_poses(2, seed=3))
    with pytest.raises(
        ArgumentError, match=r"^candidates: given shape \(15, 1\), expected \(m, 2"
    ):
        found.propose_poses(1, candidates[:, :1])
    with pytest.raises(ArgumentError, match=r"^count: given 16, expected 1 to 15, the number of"):
        found.propose_poses(16, candidates)
    assert len(found.propose_poses(15, candidates)) == 15


def test_a_calibrated_model_is_of_the_variant_that_was_calibrated(calibrated: Calibration) -> None:
    rigid = replace(calibrated.nominal, variant="rigid")
    assert replace(calibrated, nominal=rigid).model.variant == "rigid"
    without = replace(calibrated, nominal=replace(calibrated.nominal, file=""))
    with pytest.raises(ArgumentError, match="given a model without a file"):
        _ = without.model


def test_numbers_and_words_of_a_calibration(calibrated: Calibration, tmp_path: Path) -> None:
    found = calibrated
    frame = [found.values[f"{FRAME}.{name}"] for name in ("x", "y", "z", "rx", "ry", "rz")]
    assert_allclose(found.frame, frame)
    tree = Tree(found.nominal)
    commands = np.array([[0.1, 0.2], [0.3, -0.4]])
    expected = Statics(tree, commands).rest(Numbers.of(tree, found.unknowns, found.x)).measured
    assert_allclose(found.predict(commands), expected)
    assert found.sentence.startswith(f"12 poses, {len(found.unknowns)} numbers; mean error ")
    open_end = replace(found, converged=False)
    assert found.problem == "" and "did not end" in open_end.problem
    sd = np.sqrt(np.diag(found.covariance))
    assert_allclose(list(found.sd.values()), sd)
    determined = [s < 0.3 * u.sd for s, u in zip(sd, found.unknowns, strict=True)]
    assert list(found.determined.values()) == determined
    written = found.write(tmp_path / "a.toml")
    variant = tomllib.loads(written.read_text())["variant"]["calibrated"]
    assert variant["set"] == found.changes
    assert variant["description"] == f"{found.poses.source}: {found.sentence}"
    # the trackers are overrides: the new file has them, and so has the calibrated model
    again = flexgen.read(f"{written}@calibrated")
    assert again.sensors == found.model.sensors
    for before, after in zip(found.nominal.sensors, again.sensors, strict=True):
        place = [found.values[f"{before.name}.{axis}"] for axis in "xyz"]
        assert replace(after, position=before.position) == before
        assert_allclose(after.position, place, rtol=0, atol=1e-15)
    moved = found.write(tmp_path / "b.toml", "measurement")
    assert tomllib.loads(moved.read_text())["variant"]["calibrated"]["set"] != variant["set"]
    for path, world, text in (
        ("a.toml", "none", r"^world: given 'none', expected 'robot' or 'measurement'$"),
        ("a.json", "robot", r"^path: given '.*a\.json', expected a name that ends in \.toml$"),
    ):
        with pytest.raises(ArgumentError, match=text):
            found.write(tmp_path / path, world)
