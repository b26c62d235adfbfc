"""Faults of a record as changes of its responses, one by one; their words; poses and channels of
recordings.

Of `flexgen.identification.causes.hypotheses`, `flexgen.identification.records.experiment_file`,
`flexgen.identification.records.description`, `flexgen.simulation.result`,
`flexgen.dynamics.mechanics.beam`, `flexgen.identification.responses.gear_changes`,
`flexgen.identification.causes.explain`, `flexgen.inversion.judge.verification`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from flexgen.base.spec.parts import Beam, Bending
from flexgen.dynamics.mechanics.beam import modal_beam
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.causes import explain, hypotheses
from flexgen.identification.causes.explain import Cause
from flexgen.identification.estimator.problem import Prior, Problem
from flexgen.identification.records import experiment_file
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.gear_changes import Linearization, fit_changes
from flexgen.inversion.judge.verification import plan_error
from flexgen.model.elements import Output
from flexgen.simulation.result import output_error


def responses() -> Frf:
    """Of two motors and a sensor of rates, with complex numbers that are all different."""
    rng = np.random.default_rng(1)

    def of(*shape: int) -> np.ndarray:
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    A = of(2, 3, 3, 3)
    B = of(2, 3, 2, 2)
    C, UU = (x @ x.conj().swapaxes(-1, -2) for x in (A, B))
    numbers = {"periods": 5, "experiments": 3, "sample_s": 1e-3, "delay_s": 2e-3, "warnings": ()}
    numbers |= {"model": "arm", "motors": ("m1", "m2"), "sensors": ("a.x",), "orders": (1,)}
    arrays = {
        "poses": np.zeros((2, 2)),
        "w": np.array([1.0, 2.0, 4.0]),
        "G": of(2, 3, 3, 2),
        "UU": UU,
        "C": C,
    }
    arrays |= {"variance": rng.uniform(1, 2, (2, 3, 3, 2)), "speed_sd": np.zeros((2, 2))}
    arrays |= {"total": rng.uniform(2, 3, (2, 3, 3, 2))}
    return Frf(**arrays, **numbers)  # type: ignore[arg-type]


def test_a_change_of_channels_is_one_of_responses_and_covariances() -> None:
    """``y -> L y`` and ``u -> R^-1 u``, as of each line; variances by squares."""
    data = responses()
    rng = np.random.default_rng(2)
    L = rng.normal(size=(3, 3))
    R = rng.normal(size=(2, 2))
    found = hypotheses.transform(data, L, R)
    for at in np.ndindex(2, 3):
        assert_allclose(found.G[at], L @ data.G[at] @ R)
        assert_allclose(found.C[at], L @ data.C[at] @ L.T)
        assert_allclose(R @ found.UU[at] @ R.T, data.UU[at], rtol=1e-9, atol=1e-9)
        assert_allclose(found.variance[at], L**2 @ data.variance[at] @ R**2)
        assert data.total is not None and found.total is not None
        assert_allclose(found.total[at], L**2 @ data.total[at] @ R**2)
    assert hypotheses.transform(replace(data, total=None), L, R).total is None
    late = hypotheses.with_sample_time(data, 1.25)
    assert_allclose(late.w, data.w / 1.25)
    assert (late.sample_s, late.delay_s) == (1.25e-3, 2.5e-3)
    # accelerations, and a rate
    assert_allclose(late.G, data.G / np.array([1.25**2, 1.25**2, 1.25])[:, None])


def test_all_faults_of_a_record_are_tried() -> None:
    """Words and changes of each, in their order; L and R are rows of what is exchanged, scaled or
    turned around.
    """
    data = responses()
    found = list(hypotheses.changes_of(data))
    deg = np.pi / 180
    left = {
        "angles in degrees, read as radians": (deg, deg, 1),
        "angle of m1 in degrees, read as radians": (deg, 1, 1),
        "angle of m2 in degrees, read as radians": (1, deg, 1),
        "angles in radians, read as degrees": (1 / deg, 1 / deg, 1),
        "angle of m1 in radians, read as degrees": (1 / deg, 1, 1),
        "angle of m2 in radians, read as degrees": (1, 1 / deg, 1),
        "the sign of the angle of m1": (-1, 1, 1),
        "the sign of the angle of m2": (1, -1, 1),
    }
    right = {"the sign of the torque of m1": (-1, 1), "the sign of the torque of m2": (1, -1)}
    words = [x.say(1.5) for x in found]
    assert words[:3] == [
        "sample time 50 % longer than stated",
        "angle of m1 50 % too large in the record",
        "angle of m2 50 % too large in the record",
    ]
    assert found[0].change(data, 1.5).sample_s == 1.5 * data.sample_s  # longer, as the words are
    assert [x.gross for x in found] == [False] * 3 + [True] * (len(found) - 3)
    assert_allclose(found[2].change(data, 1.5).G, data.G * np.array([1.0, 1 / 1.5, 1.0])[:, None])
    swapped = [1, 0, 2]
    expected = {name: np.diag(x) @ data.G for name, x in left.items()}
    expected |= {name: data.G @ np.diag(x) for name, x in right.items()}
    expected["exchanged angles of m1 and m2"] = data.G[:, :, swapped]
    expected["exchanged torques of m1 and m2"] = data.G[..., ::-1]
    expected["exchanged angles and torques of m1 and m2"] = data.G[:, :, swapped][..., ::-1]
    expected["torques without hold"] = data.G
    gross = dict(zip(words[3:], found[3:], strict=True))
    names = {name.replace(",", ""): G for name, G in expected.items()}
    assert {word.replace(",", "") for word in gross} == set(names)
    for word, change in gross.items():
        assert_allclose(change.change(data, 1.0).G, names[word.replace(",", "")])
    assert gross["torques without hold"].change(data, 1.0).sample_s == 0.0
    assert "torques without hold" not in [
        x.say(1.0) for x in hypotheses.changes_of(replace(data, sample_s=0.0))
    ]


def test_faults_are_told_with_their_size_and_direction() -> None:
    say = hypotheses._say_change("payload", "heavier", "lighter")
    assert [say(x) for x in (1.2, 0.75)] == ["payload 20 % heavier", "payload 25 % lighter"]
    assert (
        hypotheses._say_recorded("torque", inverse=True)(0.8)
        == "torque 25 % too large in the record"
    )
    assert hypotheses._say_delay(2.5e-3) == "torques that act 2.5 ms later than stated"
    assert hypotheses._say_delay(-1e-3) == "torques that act 1 ms earlier than stated"
    assert hypotheses._say_value("friction", 2.0, "N m")(0.25) == "friction of 0.5 N m"
    assert str(Cause("a wrong mass", 0.625, 1.0)) == "a wrong mass explains 62 % of the misfit"


@pytest.mark.parametrize(
    ("joint", "key", "factor"), [("rad", "pose_deg", math.pi / 180), ("rad", "pose_rad", 1.0)]
)
def test_poses_of_recordings_have_the_unit_of_their_key(
    joint: str, key: str, factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rotations in the unit of the key; translations always in metres."""
    model = Made(i_g=(0, 1), coordinates=[Made(unit=joint, dof=None), Made(unit="m", dof=None)])
    seen: dict[str, Any] = {}

    def angles(name: str, turns: list[bool]) -> list[float]:
        assert name == "pose"
        seen["turns"] = turns
        return [factor * 30.0, 0.5]

    root = Made(number=lambda *_, **__: 0.2)
    recording = Made(file="run.csv", periods_before=None)
    record = Made(angles=angles)
    monkeypatch.setattr(
        experiment_file,
        "read_description",
        lambda path: Made(root=Keys(root), model=model, recordings=[(record, recording)]),
    )
    monkeypatch.setattr(experiment_file, "_parts", lambda *given: given)
    monkeypatch.setattr(experiment_file, "_experiment", lambda found, poses: poses)
    poses: Any = experiment_file.read_experiment(key)
    assert seen["turns"] == [True, False] and poses == {
        (factor * 30.0, 0.5): [(recording, 0.2, 0, True)]
    }


class Keys:
    """A table without optional keys."""

    def __init__(self, found: Any) -> None:
        self.number = found.number

    def __contains__(self, key: str) -> bool:
        return False


@pytest.mark.parametrize("pose", ["tool_pose", "tool_position", "combination"])
def test_an_angle_is_that_of_poses_only(pose: str) -> None:
    equations = derive("elbow") if pose != "combination" else derive("four_mass")
    model = equations.model
    if pose == "tool_pose":
        equations = derive(replace(model, output=Output("tool_pose")))
    q = (
        np.array([[0.2, 0.3], [0.4, 0.5]])
        if pose != "combination"
        else np.full((2, model.n_a), 0.3)
    )
    forward, output = (equations.function(name) for name in ("forward_kinematics", "output"))
    y = np.array([np.array(output(x)).ravel() for x in q])
    R = np.array([np.array(forward(x)[1]) for x in q])
    turn = np.array(
        [
            [math.cos(0.1), -math.sin(0.1), 0.0],
            [math.sin(0.1), math.cos(0.1), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    reference = {"y_ref": y - 0.25, "R_ref": np.array([R[0], turn @ R[1]]).reshape(2, 9)}
    error, distance, angle = output_error(equations, reference, q)
    assert_allclose(error, 0.25)
    assert distance == pytest.approx(0.25 * math.sqrt(y.shape[1]))
    assert angle == (pytest.approx(0.1) if pose == "tool_pose" else None)
    without = output_error(equations, {"y_ref": y}, q)
    assert without[1:] == (pytest.approx(0.0, abs=1e-15), None)


def test_modes_of_a_beam_bend_in_their_direction() -> None:
    bendings = (Bending("z", 300.0, 2, 0.01), Bending("y", 500.0, 1, 0.02))
    found = modal_beam(Beam(0.7, 2.0, bendings))
    assert found.direction.tolist() == [[0, 0, 1], [0, 0, 1], [0, 1, 0]]
    assert found.mass == pytest.approx(1.4)
    assert found.s0 == pytest.approx(1.4 * 0.35) and found.j0 == pytest.approx(1.4 * 0.7**2 / 3)
    first = 1.87510406871**4  # (beta L)^4 of a cantilever
    omega = found.stiffness[0, 0] / found.m2[0, 0]
    assert omega == pytest.approx(first * 300.0 / (2.0 * 0.7**4), rel=1e-6)


def test_changes_of_gears_are_a_compromise_of_responses_and_prior() -> None:
    """With much noise they are zero with the covariance of the prior; else the least squares of an
    own program.
    """
    rng = np.random.default_rng(4)

    def of(*shape: int) -> np.ndarray:
        return 0.1 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))

    model = Linearization(
        w=np.geomspace(2.0, 50.0, 12),
        G=of(2, 12, 1, 1),
        L=of(2, 12, 1, 2),
        S=of(2, 12, 2, 2),
        P=of(2, 12, 2, 1),
        stiffness=np.array([3.0]),
        inertia=np.array([0.2]),
    )
    x = np.array([0.3, -0.1, 0.2, 0.5])
    h = 1e-6
    assert model.frequency == pytest.approx(10.0)
    assert_allclose(model.prior, [2.0, 0.5, 0.5, 5.0])
    assert_allclose(model.units, [[3.0], [3.0], [0.3], [2.0]])
    for k in range(4):
        high, low = (model.response(1, x + s * h * np.eye(4)[k]) for s in (1, -1))
        assert_allclose(
            model.derivative(1, x)[..., k], (high - low) / (2 * h), rtol=1e-5, atol=1e-8
        )
    G = model.response(1, x)
    loud = fit_changes(model, 1, G, np.full(G.shape, 1e12), x)
    assert_allclose(loud.x, 0.0, atol=1e-6)
    assert_allclose(loud.covariance, np.diag(model.prior**2) / 2, rtol=1e-6, atol=1e-9)
    variance = np.full(G.shape, 1e-2)
    found = fit_changes(model, 1, G, variance, np.zeros(4))

    def residual(x: np.ndarray) -> np.ndarray:
        away = (model.response(1, x) - G) / np.sqrt(variance + 1e-6 * np.abs(G) ** 2)
        return np.concatenate([away.real.ravel(), away.imag.ravel(), x / [2.0, 0.5, 0.5, 5.0]])

    assert_allclose(
        found.x, least_squares(residual, np.zeros(4), xtol=1e-12).x, rtol=1e-3, atol=1e-4
    )
    assert found.distortion == 0.0


@pytest.mark.parametrize("kind", ["tool_pose", "tool_position", "combination"])
def test_the_error_of_a_plan_is_the_distance_of_the_simulated_output(kind: str) -> None:
    """The largest of all instants, and the angle of a pose; nothing for a unit that the output
    does not have.
    """
    equations = derive("elbow") if kind != "combination" else derive("four_mass")
    if kind == "tool_pose":
        equations = derive(replace(equations.model, output=Output("tool_pose")))
    rng = np.random.default_rng(3)
    both = rng.uniform(0.1, 0.4, (2, 4, equations.model.n_a))
    forward, output = (equations.function(name) for name in ("forward_kinematics", "output"))
    y = np.array([[np.array(output(x)).ravel() for x in part] for part in both])
    planned, found = (Made(trajectory=Motion(part)) for part in both)
    metres, radians = plan_error(equations, planned, found)  # type: ignore[arg-type]
    length = y[..., :3] if kind == "tool_pose" else y
    assert metres == pytest.approx(np.linalg.norm(length[1] - length[0], axis=1).max())
    if kind != "tool_pose":
        assert radians is None
        return
    R = np.array([[np.array(forward(x)[1]) for x in part] for part in both])
    cosine = [(np.trace(a.T @ b) - 1) / 2 for a, b in zip(*R, strict=True)]
    assert radians == pytest.approx(np.arccos(np.clip(cosine, -1, 1)).max(), rel=1e-6)


class Motion:
    """Arm coordinates at some instants."""

    def __init__(self, q_a: np.ndarray) -> None:
        self.time = np.arange(float(len(q_a)))
        self.q_a = q_a

    def __getitem__(self, name: str) -> np.ndarray:
        assert name == "q_a"
        return self.q_a


def test_a_factor_of_the_responses_is_fitted_with_the_numbers_and_its_prior() -> None:
    """Linear residuals in a number and in the logarithm of the factor: the minimum of the squares
    with both priors.
    """
    rows = np.array([[2.0, 0.0], [0.0, 0.4], [0.3, 0.3]])
    target = np.array([3.0, 0.5, 0.2])
    start = np.array([0.8])
    sd = np.array([0.6])

    def on(data: float) -> Any:
        def weight(x: np.ndarray, derivatives: bool) -> tuple[np.ndarray, np.ndarray | None]:
            r = (rows @ [x[0], np.log(data)] - target + 0j)[None, :, None, None]
            return r, rows[None, :, None, None, :1] + 0j if derivatives else None

        def cost(x: np.ndarray) -> float:
            return float((np.abs(weight(x, False)[0]) ** 2).sum())

        def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            return (
                cost(x),
                rows[:, :1].T @ weight(x, False)[0].real.ravel(),
                rows[:, :1].T @ rows[:, :1],
            )

        vector = Made(start=start, prior_sd=sd, bounds=(np.array([-9.0]), np.array([9.0])))
        problem = Problem.of_sums(sums, cost, Prior.of_sd(start, sd), vector.bounds)
        return Made(data=data, vector=vector, count=1e-12, weight=weight, on=on, problem=problem)

    told: list[float] = []
    change: Any = hypotheses.Changed(
        lambda data, factor: data * factor, lambda factor: told.append(factor) or "late"
    )
    cost, words, factor = explain.refit(on(1.0), change, np.array([2.5]))
    prior = np.diag(1 / np.array([0.6, explain.LARGEST_FACTOR]))
    best = np.linalg.lstsq(
        np.vstack([rows, prior]), np.r_[target, prior @ [0.8, 0.0]], rcond=None
    )[0]
    assert (
        factor == pytest.approx(np.exp(best[1]), rel=1e-5) and words == "late" and told == [factor]
    )
    assert cost == pytest.approx(((rows @ best - target) ** 2).sum(), rel=1e-5)
    # a fault that is a whole one is not scaled: only the numbers are fitted, from where they began
    gross: Any = hypotheses.Changed(
        lambda data, factor: data * 2.0 * factor, lambda factor: "swapped", gross=True
    )
    cost, words, factor = explain.refit(on(1.0), gross, np.array([2.5]))
    left = target - rows[:, 1] * np.log(2.0)
    only = np.linalg.lstsq(
        np.vstack([rows[:, :1], prior[:1, :1]]), np.r_[left, 0.8 / 0.6], rcond=None
    )[0]
    assert (words, factor) == ("swapped", 1.0)
    assert cost == pytest.approx(((rows[:, :1] @ only - left) ** 2).sum(), rel=1e-5)
