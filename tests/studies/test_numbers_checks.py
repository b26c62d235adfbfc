"""Numbers of a checked model by hand; costs and bounds of a discretized motion; searches along a
path in steps.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import flexgen
from flexgen.base.errors import SolverError
from flexgen.cli.verbs import solve as verbs
from flexgen.dynamics.dae import taylor_array
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.responses import result
from flexgen.inversion.methods import full_model
from flexgen.studies.check import numbers
from flexgen.studies.check.finding import Usual, make_finding

ELBOW: dict[str, Any] = {
    "motor.m1.torque_max": 50.0,
    "motor.m1.speed_max": 300.0,
    "element.upper.dof.q1.speed_max": 2.0,
    "move": [],
}


# --- plausibility --------------------------------------------------------------------------------
def test_numbers_of_a_checked_model_are_those_of_its_file() -> None:
    """Of the elbow at home: bodies, drives and springs, with masses and torques of gravity at the
    joints.
    """
    model = flexgen.read("elbow", overrides=ELBOW)
    equations = derive(model)
    q = np.radians([30.0, -20.0])
    M = np.diag(np.array(equations.function("mass_matrix")(q)))
    G = np.abs(np.array(equations.function("gravity")(q)).ravel())
    m = np.array([339.12, 190.25])
    trace = np.array([88.67 + 88.67 + 7.5, 4.0 + 2 * 48.64])
    length = 1.150 + 1.241
    K = np.array([7.5189e6, 4.0999e6])
    D = np.array([1400.0, 600.0])
    ratio = np.array([1872 / 7, 757 / 3])
    rotor = 0.0118
    ball = 2 / 5 * m * (3 * m / (4 * np.pi * 7850.0)) ** (2 / 3)
    expected: dict[tuple[str, str], float] = {}
    for k, (body, joint, motor) in enumerate((("upper", "q1", "m1"), ("fore", "q2", "m2"))):
        place = f"element.{body}.body"
        spring = f"element.{body}.dof.{joint}.gear"
        expected |= {
            (f"{place}.mass", "inertia to that of a steel ball of this mass"): trace[k]
            / (3 * ball[k]),
            (f"{place}.inertia", "inertia to mass times length of the arm squared"): trace[k]
            / (2 * m[k] * length**2),
            (f"{place}.mass", "mass to that of all other bodies"): m[k] / m[1 - k],
            (f"motor.{motor}.ratio", "ratio of a rotation"): ratio[k],
            (f"motor.{motor}.inertia", "rotor inertia"): rotor,
            (
                f"motor.{motor}.ratio",
                f"rotor inertia times ratio^2 to the inertia of the arm at {joint}",
            ): rotor * ratio[k] ** 2 / M[k],
            (f"{spring}.spring.stiffness", "lowest mode of the spring"): np.sqrt(K[k] / M[k])
            / (2 * np.pi),
            (f"{spring}.spring.stiffness", "deflection by gravity at home"): G[k] / K[k],
            (f"{spring}.damping", "damping ratio of the spring"): D[k]
            / (2 * np.sqrt(K[k] * M[k])),
        }
    expected |= {
        ("motor.m1.speed_max", "motor speed"): 300.0,
        ("motor.m1.speed_max", "speed of q1 at the largest motor speed"): 300.0 / ratio[0],
        ("element.upper.dof.q1.speed_max", "joint speed"): 2.0,
        ("motor.m1.torque_max", "torque of the motor to that of gravity at home"): 50.0
        * ratio[0]
        / G[0],
    }
    found = {
        (one.key, one.quantity): float(one.value.split()[0])
        for one in flexgen.check(model).findings
        if one.key.split(".")[0] in ("element", "motor")
    }
    assert set(found) == set(expected)
    for key, value in expected.items():
        assert found[key] == pytest.approx(value, rel=2e-3), key


@pytest.mark.parametrize(
    ("value", "mark", "distance"),
    [
        (2.0, "ok", 0.0),
        (20.0, "ok", 0.0),
        (1.999, "unusual", np.log10(2.0 / 1.999)),
        (200.0, "unusual", 1.0),
        (1000.0, "unusual", np.log10(50.0)),
        (1000.1, "error", np.log10(50.005)),
        (0.02, "unusual", 2.0),
        (0.0199, "error", np.log10(2 / 0.0199)),
        (0.0, "error", 99.0),
        (np.nan, "error", 99.0),
    ],
)
def test_numbers_are_marked_by_their_usual_range(value: float, mark: str, distance: float) -> None:
    usual = Usual(2.0, 20.0, 0.02, 1000.0)
    found = make_finding("key", "size", value, "m", usual, "look")
    assert (found.mark, found.distance) == (mark, pytest.approx(distance))
    assert found.advice == ("" if mark == "ok" else "look") and found.usual == "2 to 20 m"
    assert (str(Usual(0.0, 3.0)), str(Usual(3.0, np.inf))) == ("at most 3", "at least 3")
    assert (
        Usual(0.0, 3.0).mark(0.5) == Usual(0.0, 3.0).mark(0.0) == "ok"
        and Usual(2.0, 3.0).mark(1e9) == "unusual"
    )
    assert Usual(0.0, 3.0).distance(-1.0) == 0.0 and Usual(0.0, 3.0).distance(np.inf) == 99.0


def test_springs_of_translations_and_without_damping() -> None:
    joint: Any = Made(unit="m")
    rows = {
        one.quantity: one for one in numbers._spring(joint, "gear", "low", (4e4, 400.0, 4.0, 2e-3))
    }
    assert rows["lowest mode of the spring"].value == f"{100 / (2 * np.pi):.4g} Hz"
    assert rows["deflection by gravity at home"].value == "0.002 m"
    assert rows["deflection by gravity at home"].usual == "at most 0.005 m"
    assert (
        rows["damping ratio of the spring"].value == "0.5"
        and rows["damping ratio of the spring"].mark == "unusual"
    )
    assert (
        rows["damping ratio of the spring"].advice
        == "damping in N s/m on the side of the spring, or the stiffness"
    )
    assert {one.key for one in rows.values()} == {"gear.spring.low", "gear.damping"}
    joint.unit = "rad"
    rows = {
        one.quantity: one
        for one in numbers._spring(joint, "gear", "stiffness", (4e4, 800.0, 4.0, 0.0))
    }
    assert set(rows) == {"lowest mode of the spring", "damping ratio of the spring, overdamped"}
    found = list(numbers._spring(joint, "gear", "stiffness", (4e4, 0.0, 4.0, 0.0)))[-1]
    assert (found.mark, found.value, found.usual) == ("unusual", "0: no damping", "0.001 to 0.4")


def test_real_poles_are_told_where_they_are_fast() -> None:
    """Slow ones are motions that are not held; six are shown."""
    poles = np.array([-5.0, -50.0, -51.0 + 1e-6j, -52.0 + 1e-3j, -53.0, -54.0, -55.0, -56.0, 60.0])
    found = numbers.report_overdamped(poles, 20.0)
    assert found.value == "-50, -51, -53, -54, -55, -56 1/s" and found.mark == "ok"
    assert (
        numbers.report_overdamped(np.append(poles, -57.0), 20.0).value
        == "-50, -51, -53, -54, -55, -56, ... 1/s"
    )
    assert numbers.report_overdamped(poles, 60.0).value == "none"


# --- the method full -----------------------------------------------------------------------------
def test_costs_and_bounds_of_a_discretized_motion() -> None:
    """Two intervals of an arm with one joint and one motor: places of the terms in the
    unknowns.
    """
    model: Any = Made(dof=2, n_m=1)
    stages = full_model.STAGES
    size = 3 * 6 + 2 * full_model.STAGES * 4
    accelerations = np.arange(18, 18 + 30).reshape(2 * stages, 3)
    errors = np.arange(48, 58).reshape(2 * stages, 1)
    mesh: Any = Made(N=2, n=3, n_nodes=18, size=size, own=(accelerations, errors))
    slow: Any = Made(
        ends=[np.array([1.0, 2.0]), np.array([3.0, 4.0])],
        torques=[np.array([5.0]), np.array([6.0])],
    )
    for finite, rho in ((np.zeros(0, int), 1e-9), (np.array([0]), 1e-3)):
        bounds: Any = Made(finite=finite.tolist(), torque=np.array([8.0]))
        weight, aim = full_model._cost(model, mesh, slow, 0.5, bounds)
        expected = np.zeros(size)
        target = np.zeros(size)
        expected[errors.ravel()] = 1 / (2 * stages)
        expected[accelerations[:, 2]] = rho / (2 * stages) * (full_model.ACCELERATION * 0.5) ** 2
        expected[12:18] = [1e3, 1e3, 0.0, 1e3, 1e3, 1e3]
        target[12:18] = [3.0, 4.0, 0.0, 0.0, 0.0, 6.0]
        assert_allclose(weight, expected)
        assert_array_equal(aim, target)
        scales: Any = Made(torque=np.array([2.0]), state=np.arange(1.0, 7.0))
        lower, upper = full_model._bounds_of_unknowns(model, mesh, slow, scales, bounds)
        first = np.array([1.0, 2.0, 0.0, 0.0, 0.0, 5.0]) / np.arange(1.0, 7.0)
        assert_allclose(lower[:6], first)
        assert_allclose(upper[:6], first)
        assert (lower[[11, 17]] == -4.0).all() and (upper[[11, 17]] == 4.0).all()
        others = np.setdiff1d(np.arange(6, size), [11, 17])
        assert np.isinf(lower[others]).all() and np.isinf(upper[others]).all()


# --- the derivative array ------------------------------------------------------------------------
@pytest.mark.parametrize("reach", [1.0, 0.5, 0.25, 0.125])
def test_consistent_points_are_found_at_rising_speeds(
    reach: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps are halved where one fails, down to an eighth; derivatives of order k scale as the
    speed to the power k.
    """
    asked: list[float] = []

    def newton(
        series: Any, reference: Any, t: float, speed: float, start: np.ndarray, scales: Any
    ) -> Any:
        asked.append(speed)
        if speed - (done[-1] if done else 0.0) > reach:
            return None
        done.append(speed)
        return start

    done: list[float] = []
    monkeypatch.setattr(taylor_array, "_gauss_newton", newton)
    guess = np.array([[[1.0], [2.0], [3.0]]])
    monkeypatch.setattr(taylor_array, "_quasistatic_motion", lambda *given: guess)
    series: Any = Made(dae=None, scales=lambda point: "scales")
    out, scales = taylor_array.consistent(series, None, np.array([0.3]), 1)
    assert_allclose(out[0, :, 0], [1.0, 2.0, 3.0])
    assert done == pytest.approx(np.arange(1, round(1 / reach) + 1) * reach) and scales == [
        "scales"
    ]
    assert asked[: len(asked) - len(done) + 1] == [
        0.5**k for k in range(len(asked) - len(done) + 1)
    ]


def test_a_path_without_consistent_points_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        taylor_array, "_gauss_newton", lambda *given: given[4] if given[3] <= 0.5 else None
    )
    monkeypatch.setattr(taylor_array, "_quasistatic_motion", lambda *given: np.ones((1, 3, 1)))
    series: Any = Made(dae=None, scales=lambda point: None)
    text = (
        r"^derivative array of order 1 at t = 0\.3 s: no consistent point found beyond 0\.5 of "
        r"the path's speed; try"
    )
    with pytest.raises(SolverError, match=text):
        taylor_array.consistent(series, None, np.array([0.3]), 1)  # type: ignore[arg-type]


# --- the verb solve ------------------------------------------------------------------------------
def test_files_of_several_moves_have_their_names() -> None:
    assert (
        verbs._insert_name(Path("out/line.npz"), "a") == Path("out/line_a.npz")
        and verbs._insert_name(None, "a") is None
    )
    assert verbs._below(Path("out"), "a") == Path("out/a") and verbs._below(None, "a") is None
    plain = {"hold": "spline", "sample_time": None, "delay": 0.0}
    assert not verbs._sends(Namespace(**plain))
    for changes in ({"hold": "zoh"}, {"sample_time": 0.0}, {"delay": 1e-9}):
        assert verbs._sends(Namespace(**plain | changes))
    told: list[str] = []
    robot: Any = Made(n_a=full_largest() + 1)
    verbs._announce(Namespace(method="full"), robot, told.append)
    assert told == [
        f"method full with {robot.n_a} coordinates takes many minutes; --method lq takes seconds"
    ]
    verbs._announce(Namespace(method="lq"), robot, told.append)
    robot.n_a -= 1
    verbs._announce(Namespace(method="full"), robot, told.append)
    assert len(told) == 1
    assert verbs.failure_of(Made(status=verbs.Status.LIMITS_EXCEEDED)) == 3
    assert verbs.failure_of(Made(status=verbs.Status.SOLVED)) == 1  # type: ignore[arg-type]


def full_largest() -> int:
    from flexgen.inversion.choice import FULL_LARGEST

    return FULL_LARGEST


# --- identified numbers --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("weights", "sd", "scale", "weak"),
    [
        ("noise", 0.9 * result.WEAK, "log", (False, True)),
        ("noise", 1.1 * result.WEAK, "log", (True, True)),
        ("noise", 1.1 * result.WEAK, "linear", (False, True)),
        (result.TIME_DOMAIN, 0.9 * result.WEAK, "log", (False, False)),
        (result.TIME_DOMAIN, 1.1 * result.WEAK, "log", (True, True)),
    ],
)
def test_numbers_that_data_do_not_determine_are_weak(
    weights: str, sd: float, scale: str, weak: tuple[bool, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two numbers the second is a viscous friction next to Coulomb friction: hidden in
    frequency responses.
    """
    monkeypatch.setattr(result, "with_coulomb", lambda model: ("m1.viscous",))
    names = ("q1.stiffness", "m1.viscous")
    made: Any = object.__new__(result.IdentificationResult)
    vector = Made(names=names, unknowns=[Made(scale=scale)] * 2, model=None)
    vars(made).update(weights=weights, vector=vector, formal_covariance=np.diag([sd**2, sd**2]))
    assert tuple(made.is_weak(name) for name in names) == weak
