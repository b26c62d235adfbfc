"""Faults of a record as changes of its responses, one by one, with their words; steps and refits
of planted faults.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, without_coulomb
from numpy.testing import assert_allclose

import flexgen
from flexgen.identification.causes import hypotheses
from flexgen.identification.causes.explain import Cause, refit, score
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_inputs import Drive

FREE = ["q1.stiffness", "q2.damping"]
VECTOR = ParameterVector(without_coulomb("planar5_nmp"), FREE)
W = 2 * np.pi * np.geomspace(2.0, 90.0, 9)


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
    return Frf(**arrays, **numbers)


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
    both = {
        "the signs of angle and torque of m1": ((-1, 1, 1), (-1, 1)),
        "the signs of angle and torque of m2": ((1, -1, 1), (1, -1)),
    }
    right = {"the sign of the torque of m1": (-1, 1), "the sign of the torque of m2": (1, -1)}
    words = [x.say(1.5) for x in found]
    assert words[:4] == [
        "sample time 50 % longer than stated",
        "torques of all motors 50 % too large in the record",
        "angle of m1 50 % too large in the record",
        "angle of m2 50 % too large in the record",
    ]
    assert found[0].change(data, 1.5).sample_s == 1.5 * data.sample_s  # longer, as the words are
    assert [x.gross for x in found] == [False] * 4 + [True] * (len(found) - 4)
    assert_allclose(found[1].change(data, 1.5).G, 1.5 * data.G)
    assert_allclose(found[3].change(data, 1.5).G, data.G * np.array([1.0, 1 / 1.5, 1.0])[:, None])
    swapped = [1, 0, 2]
    expected = {name: np.diag(x) @ data.G for name, x in left.items()}
    expected |= {name: data.G @ np.diag(x) for name, x in right.items()}
    expected |= {name: np.diag(x) @ data.G @ np.diag(y) for name, (x, y) in both.items()}
    expected["exchanged angles of m1 and m2"] = data.G[:, :, swapped]
    expected["exchanged torques of m1 and m2"] = data.G[..., ::-1]
    expected["exchanged angles and torques of m1 and m2"] = data.G[:, :, swapped][..., ::-1]
    expected["torques without hold"] = data.G
    gross = dict(zip(words[4:], found[4:], strict=True))
    names = {name.replace(",", ""): G for name, G in expected.items()}
    assert {word.replace(",", "") for word in gross} == set(names)
    for word, change in gross.items():
        assert_allclose(change.change(data, 1.0).G, names[word.replace(",", "")])
    assert gross["torques without hold"].change(data, 1.0).sample_s == 0.0
    assert "torques without hold" not in [
        x.say(1.0) for x in hypotheses.changes_of(replace(data, sample_s=0.0))
    ]


def test_a_score_is_the_decrease_by_the_best_step() -> None:
    rng = np.random.default_rng(2)
    J = rng.standard_normal((20, 3))
    r = rng.standard_normal(20)
    column = rng.standard_normal(20)
    basis = np.linalg.qr(J)[0]
    rest = r - basis @ (basis.T @ r)  # at the minimum in the other parameters
    whole = np.column_stack([J, column])
    left = rest - whole @ np.linalg.lstsq(whole, rest, rcond=None)[0]
    assert score(basis, rest, column) == pytest.approx(rest @ rest - left @ left)
    # what the parameters do already
    assert score(basis, rest, J @ [1.0, 2.0, -1.0]) == 0.0


def test_faults_are_told_with_their_size_and_direction() -> None:
    numbers = {n.names[0]: n for n in hypotheses.numbers_of(VECTOR)}
    loaded = flexgen.read("planar5_nmp", overrides={"payload": {"mass": 2.0}})
    carried = {n.names[0]: n for n in hypotheses.numbers_of(ParameterVector(loaded, FREE))}
    free = flexgen.read("planar5_nmp", overrides={"motor.m1.friction.viscous": 0.0})
    slips = {n.names[0]: n for n in hypotheses.numbers_of(ParameterVector(free, FREE))}
    assert ("m1.viscous" in slips) and all(
        (f"{m.name}.viscous" in numbers) == (m.friction.viscous == 0.0)
        for m in VECTOR.model.motors
    )
    for found, size, words in (
        (slips["m1.viscous"], 0.5, "viscous friction of m1 of 0.5 N m s/rad"),
        (numbers["arm3.mass"], 1.2, "mass of arm3 20 % larger"),
        (carried["payload.mass"], 0.75, "payload 25 % lighter"),
        (numbers["payload.mass"], 0.75, "a missing payload of 0.75 kg"),
        (numbers["m1.torque_constant"], 0.8, "torque of m1 25 % too large in the record"),
        (numbers["delay"], 2.5e-3, "torques that act 2.5 ms later than stated"),
        (numbers["delay"], -1e-3, "torques that act 1 ms earlier than stated"),
    ):
        assert found.say(size) == words
    assert str(Cause("a wrong mass", 0.625, 1.0)) == "a wrong mass explains 62 % of the misfit"


@pytest.mark.parametrize("number", [0, 1])
def test_a_small_fault_is_fitted_with_the_numbers_and_its_prior(number: int) -> None:
    """Of the sample time, and of an angle: the factor of exact responses, and nothing is left."""
    robot = VECTOR.model
    data = exact_responses(robot, poses_of(robot, 2), W, Drive(5e-4), 1e-3)
    change = list(hypotheses.changes_of(data))[number]
    wrong = Residuals(VECTOR, change.change(data, 1 / 1.03))
    cost, words, factor = refit(wrong, change, VECTOR.start + 0.01)
    assert factor == pytest.approx(1.03, rel=1e-4) and words == change.say(factor)
    assert cost < 1e-2 < 1e3 < wrong.cost(VECTOR.start)


def test_a_whole_fault_is_not_scaled() -> None:
    """Only the numbers are fitted, from where they began."""
    robot = VECTOR.model
    data = exact_responses(robot, poses_of(robot, 2), W, Drive(5e-4), 1e-3)
    change = next(
        x for x in hypotheses.changes_of(data) if "sign of the torque of m2" in x.say(1.0)
    )
    cost, words, factor = refit(
        Residuals(VECTOR, change.change(data, 1.0)), change, VECTOR.start + 3
    )
    assert (words, factor) == ("the sign of the torque of m2", 1.0) and cost < 1e-6
