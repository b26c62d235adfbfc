"""Simulated experiments, poses of a plan and starts of segments, with what they call replaced."""

from __future__ import annotations

import inspect
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.experiments import experiment, operating_points, plan
from flexgen.identification.motions.motion_fit import Shooting
from flexgen.inversion.methods import collocation


def test_groups_of_runs_have_noise_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """A generator for each group: the first run of it is added to a multiple of the seed, which no
    other has.
    """
    made: list[Any] = []

    class Stop(Exception):
        """The second group has begun."""

    def loop(
        robot: Any,
        library: Any,
        hardware: Any,
        controller: Any,
        q_a: Any,
        *given: Any,
        **more: Any,
    ) -> Any:
        made.append((q_a.tolist(), more))
        if len(made) == 3:
            raise Stop
        return Made(hold=lambda tau: None, periods=lambda *given, **more: [], saturated=0)

    robot = Made(n_a=1, n_m=1, name="arm")
    rest = Made(y=np.array([[1.0, 9.0], [2.0, 9.0]]), tau_m=np.zeros((2, 1)))
    local = Made(rest=lambda values, poses: rest, values=None)
    for name, value in (
        ("_robot", robot),
        ("library_with", None),
        ("LocalModel", local),
        ("largest_rate", 1.0),
        ("integration_steps", 4),
        ("_Spectra", Made(sensors=None)),
        ("settle", None),
    ):
        monkeypatch.setattr(experiment, name, lambda *given, value=value, **more: value)
    monkeypatch.setattr(experiment, "LANES", 2)
    monkeypatch.setattr(experiment, "ClosedLoop", loop)
    given: Any = Made(
        poses=np.zeros((2, 1)),
        realizations=1,
        experiments=3,
        periods=1,
        lines=[1],
        sensors=(),
        samples=2,
    )
    given.hardware = None
    given.controller = None
    given.transients = 0
    given.reference = lambda r, e: np.zeros((2, 1))
    with pytest.raises(Stop):
        inspect.unwrap(experiment.measure)(given, None, seed=5)
    assert [more["seed"] for _, more in made] == [
        5 * 1_000_003,
        5 * 1_000_003 + 2,
        5 * 1_000_003 + 4,
    ]
    assert [q_a for q_a, _ in made] == [[[1.0], [1.0]], [[1.0], [2.0]], [[2.0], [2.0]]]
    assert all(more["steps"] == 4 for _, more in made)


def test_poses_of_a_plan_are_chosen_among_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """At random as many as are asked for, else the best of 300; without those whose motion leaves
    a range.
    """
    model = flexgen.read("elbow")
    asked: list[Any] = []

    def candidates(model: Any, count: int, seed: int) -> np.ndarray:
        asked.append((count, seed))
        return np.arange(2.0 * 6).reshape(6, 2)

    def information(
        vector: Any, given: Any, offered: np.ndarray, every: int, fewest: int, progress: Any
    ) -> Any:
        asked.append((len(offered), every, fewest))
        return "F", np.array([0, 2, 3])

    monkeypatch.setattr(operating_points, "candidates", candidates)
    monkeypatch.setattr(operating_points, "information", information)
    monkeypatch.setattr(operating_points, "choose", lambda F, count, vector, criterion: {2, 0})
    monkeypatch.setattr(plan, "_swing", lambda given: None)
    monkeypatch.setattr(
        plan, "_within", lambda model, pose, swing: "q1" if pose[0] == 2.0 else None
    )
    monkeypatch.setattr(plan, "_check_speeds", lambda given, model: None)
    monkeypatch.setattr(plan, "_check_reach", lambda given, model: None)
    monkeypatch.setattr(plan, "replace", lambda given, **more: Made(**(vars(given) | more)))
    given: Any = Made(lines=np.arange(90))

    def poses(count: Any, criterion: str) -> np.ndarray:
        return np.asarray(plan._with_poses(given, model, None, count, criterion, 7, None).poses)

    left = np.delete(np.arange(12.0).reshape(6, 2), 1, axis=0)
    assert_allclose(poses(3, "random"), left)
    best = next(name for name in operating_points.CRITERIA if name != "random")
    assert_allclose(poses(2, best), left[[0, 3]])
    assert asked == [(3, 7), (300, 7), (5, 4, 2)]
    assert_allclose(poses([[0.1, 0.2]], best), np.array([[0.1, 0.2]]) @ model.eta.T)
    for count, criterion in ((0, best), (2, "worst")):
        with pytest.raises(
            ArgumentError, match=r"poses, criterion: given .* expected >= 1 and one of "
        ):
            poses(count, criterion)
    with pytest.raises(
        ArgumentError,
        match=r"poses: given an array of shape \(1, 3\), expected \(poses, 2\) in rad or m",
    ):
        poses([[0.1, 0.2, 0.3]], best)
    monkeypatch.setattr(plan, "_within", lambda model, pose, swing: "q1")
    with pytest.raises(
        ArgumentError, match="speed_rms: the motion leaves the limits of the joints at every pose"
    ):
        poses(3, "random")


def test_segments_start_with_the_angles_and_speeds_of_the_motors() -> None:
    """Differences of second order: exact for parabolas. Outputs of link encoders are coordinates,
    later ones moved.
    """
    model = flexgen.read("elbow")
    made: Any = object.__new__(Shooting)
    t = np.arange(3) * 0.1
    motors = np.stack([1 + 2 * t + 3 * t**2, -1 + 4 * t - t**2], axis=1)
    made.model = model
    made.sample_s = 0.1
    made.starts = [(0, 0)]
    made.y = motors[None]
    found = made._start_states()
    arm = np.linalg.inv(model.eta)
    n = model.dof
    assert_allclose(found[0, :2], arm @ [1.0, -1.0])
    assert_allclose(found[0, 2:n], [1.0, -1.0])
    assert_allclose(found[0, n : n + 2], arm @ [2.0, 4.0])
    assert_allclose(found[0, n + 2 :], [2.0, 4.0])
    sensors = [Made(name="e", type="link_encoder", channels=("e",), place="q2", delay_s=0.15)]
    sensors.append(Made(name="f", type="link_encoder", channels=("f",), place="q1", delay_s=0.0))
    coordinates = [Made(name="q1"), Made(name="q2")]
    made.model = Made(coordinates=coordinates, sensors=sensors, dof=4)
    made.local = Made(motor_rows=np.eye(4)[2:])
    run = Made(
        t=np.arange(9) * 0.1,
        q_m=np.zeros((9, 2)),
        signals=np.stack([np.arange(9.0), 10 * np.arange(9.0)], axis=1),
    )
    rows, records = made._outputs(Made(sensors=("e", "f")), [run])
    assert_allclose(rows, np.vstack([np.eye(4)[2:], np.eye(4)[1], np.eye(4)[0]]))
    assert made.late == 2 and records[0].shape == (9, 4)
    assert_allclose(records[0][:7, 2], np.arange(7.0) + 1.5)
    assert_allclose(records[0][:, 3], 10 * np.arange(9.0), atol=1e-12)
    sensors[0].type = "accelerometer"
    with pytest.raises(
        ArgumentError, match="signals: given e, expected link encoders only; leave others out"
    ):
        made._outputs(Made(sensors=("e", "f")), [run])


@pytest.mark.parametrize(
    ("first", "doubtful", "expected"), [("m", False, "m"), ("m", True, "s"), (None, True, "s")]
)
def test_the_motion_with_the_smaller_residual_is_taken(
    first: str | None, doubtful: bool, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the collocation or of a spline, where the first one is in doubt; a single one is not
    compared.
    """
    nodes = np.array([-0.1, 0.0, 0.5])
    compared = list[str]()
    nlp = Made(status="solved", iterations=3)
    dense = (np.zeros(2), np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 3)))
    found = Made(nlp=nlp, q_e=None, dense=lambda table, count: dense)
    reduction = Made(
        close=lambda guess, targets: guess,
        targets=lambda sample: None,
        motion=lambda *given: (first, doubtful),
    )

    def residual(equations: Any, result: Any) -> np.ndarray:
        compared.append(result[0])
        return np.array([2.0 if result[0] == "m" else 1.0])

    monkeypatch.setattr(collocation, "Reduction", lambda equations: reduction)
    monkeypatch.setattr(collocation, "collocate", lambda *given, **more: found)
    monkeypatch.setattr(collocation, "_smooth_by_spline", lambda *given: "s")
    monkeypatch.setattr(
        collocation, "with_motors", lambda equations, t, motion, **more: (motion, more)
    )
    monkeypatch.setattr(collocation, "motion_residual", residual)
    problem: Any = Made(
        check_options=lambda name: None, limits=None, progress=None, nodes=lambda h: (0.1, nodes)
    )
    problem.equations = Made(model=Made(i_e=(1,)))
    problem.path = Made(sample=lambda t: None)
    problem.step = 0.1
    chosen: Any = collocation.solve(problem, 0.5)
    assert chosen == (
        expected,
        {"preactuation": 0.1, "verdict": "solved", "iterations": 3, "intervals": 2},
    )
    assert compared == (["m", "s"] if first and doubtful else [])
