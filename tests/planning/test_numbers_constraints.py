"""Limits of a plan as constraints of its signals, and parameters of functions whose arguments are
checked.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.checks.type_checks import _parameters
from flexgen.base.errors import ArgumentError
from flexgen.inversion.problem.limits import Limits
from flexgen.planning.optimal import model_limits


class Phase:
    """A phase that keeps its bounds and constraints; signals are symbols."""

    def __init__(self, model: Any, functions: Any = None, number: int = 0) -> None:
        self.equations = Made(model=model, function=lambda name: (functions or {})[name])
        self.number = number
        self.bounds = dict[str, Any]()
        self.rows = dict[str, Any]()
        self.sizes = {
            "tau_m": 2,
            "v_m": 2,
            "q_a": 2,
            "v_a": 2,
            "a_a": 2,
            "q_m": 2,
            "a_m": 2,
            "tool_velocity": 3,
        }
        self.signals: dict[str, ca.SX] = {}

    def __getitem__(self, name: str) -> ca.SX:
        return self.signals.setdefault(name, ca.SX.sym(name, self.sizes.get(name, 1)))

    def bound(self, name: str, low: Any, high: Any) -> None:
        self.bounds[name] = low, high

    def subject_to(self, value: ca.SX, low: Any, high: Any, name: str) -> None:
        self.rows.setdefault(name, []).append((value, low, high))

    def value(self, name: str, **signals: Any) -> np.ndarray:
        """A constraint with numbers for the signals."""
        (value, _, _) = self.rows[name][-1]
        order = list(self.signals)
        function = ca.Function("value", [self.signals[x] for x in order], [ca.densify(value)])
        given = [
            signals.get(
                x.partition("[")[0] if x not in signals else x, np.zeros(self.sizes.get(x, 1))
            )
            for x in order
        ]
        return np.array(function(*given)).ravel()


def joint(name: str, **more: Any) -> Any:
    fields = {
        "name": name,
        "speed_max": None,
        "acceleration_max": None,
        "lower": None,
        "upper": None,
    }
    return Made(name=name, dof=Made(**(fields | more)))


def test_ranges_and_rates_of_joints_are_the_smaller_ones() -> None:
    """Of the file and of the limits that are given; without those of the file their ranges are
    none.
    """
    coordinates = [
        joint("q1", lower=-1.0, upper=2.0, speed_max=3.0),
        joint("p"),
        joint("q2", acceleration_max=5.0),
    ]
    model: Any = Made(coordinates=coordinates, i_g=(0, 2), n_g=2)
    given = {"joint_speed": np.array([2.0, 4.0]), "joint_acceleration": np.array([np.inf, 6.0])}
    kept: Any = Made(bounds=lambda name, n: given[name])
    whole = Phase(model)
    alone = Phase(model)
    model_limits._bound_joints(whole, kept, True)  # type: ignore[arg-type]
    assert whole.bounds == {
        "q_a[q1]": (-1.0, 2.0),
        "v_a[q1]": (-2.0, 2.0),
        "v_a[q2]": (-4.0, 4.0),
        "a_a[q2]": (-5.0, 5.0),
    }
    model_limits._bound_joints(alone, kept, False)  # type: ignore[arg-type]
    assert alone.bounds == {"v_a[q1]": (-2.0, 2.0), "v_a[q2]": (-4.0, 4.0), "a_a[q2]": (-6.0, 6.0)}


def test_torques_at_speeds_are_lines_in_four_quadrants() -> None:
    """Between the points of a curve; a reserve is taken off the torque."""
    model: Any = Made(motors=[Made(name="m1"), Made(name="m2")])
    kept: Any = Made(reserve=0.2, torque_speed=(((0.0, 10.0), (100.0, 6.0), (200.0, 0.0)), ()))
    phase = Phase(model)
    model_limits._bound_curves(phase, kept)  # type: ignore[arg-type]
    assert list(phase.rows) == ["torque of m1 at its speed"]
    ((_, low, high),) = phase.rows["torque of m1 at its speed"]
    assert low == -np.inf
    for speed, largest in ((50.0, 8.0), (100.0, 6.0), (150.0, 3.0)):
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            for part, inside in ((0.999, True), (1.001, False)):
                torque = 0.8 * part * largest
                found = phase.value(
                    "torque of m1 at its speed",
                    **{"tau_m[m1]": signs[0] * torque, "v_m[m1]": signs[1] * speed},
                )
                assert bool((found <= high).all()) is inside


def test_torques_of_gears_are_those_of_springs_or_of_the_motor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a rigid one the torque that the rotors and frictions leave; not where rotors turn with
    other bodies.
    """
    motors = [Made(inertia=0.1), Made(inertia=0.2)]
    model: Any = Made(
        i_g=(0, 1),
        coordinates=[joint("q1"), joint("q2")],
        motors=motors,
        motor_coupling="simplified",
        name="arm",
    )
    model.eta = np.array([[10.0, 3.0], [0.0, 20.0]])
    monkeypatch.setattr(
        model_limits, "gears", lambda model: [(Made(rigid=False), 1.0), (Made(rigid=True), 1.0)]
    )
    monkeypatch.setattr(model_limits, "motor_frictions", lambda equations, v_m, elastic: 2.0 * v_m)
    spring = {"gear_torque": lambda q_a, v_a, q_m, v_m: 7.0 * q_a + v_m}
    phase = Phase(model, spring)
    model_limits._bound_gears(phase, np.array([50.0, 60.0]))  # type: ignore[arg-type]
    assert [phase.rows[f"gear torque of {name}"][0][1:] for name in ("q1", "q2")] == [
        (-50.0, 50.0),
        (-60.0, 60.0),
    ]
    state = {"q_a": [1.0, 2.0], "v_m": [0.5, 0.25], "tau_m": [4.0, 5.0], "a_m": [10.0, 20.0]}
    assert_allclose(phase.value("gear torque of q1", **state), [7.5])
    left = np.array([4.0 - 0.1 * 10.0 - 1.0, 5.0 - 0.2 * 20.0 - 0.5])
    assert_allclose(phase.value("gear torque of q2", **state), [np.array([3.0, 20.0]) @ left])
    model.motor_coupling = "complete"
    with pytest.raises(
        ArgumentError,
        match="limits: given gear_torque of the rigid gear q2, expected tau_m bounds",
    ):
        model_limits._bound_gears(Phase(model, spring), np.array([50.0, 60.0]))
    free = Phase(model, spring)
    model_limits._bound_gears(free, np.array([50.0, np.inf]))  # type: ignore[arg-type]
    assert list(free.rows) == ["gear torque of q1"]


def test_speed_and_acceleration_of_the_tool_are_squares_over_their_bounds() -> None:
    """``x'' = J a + J' v``, of the position only."""
    J = np.arange(12.0).reshape(6, 2)
    dJ = np.ones((6, 2))
    functions = {"jacobian": lambda q: ca.DM(J), "jacobian_dot": lambda q, v: ca.DM(dJ)}
    phase = Phase(Made(), functions)
    model_limits._bound_tool(phase, Made(tool_speed=2.0, tool_acceleration=5.0))
    assert_allclose(phase.value("speed of the tool", tool_velocity=[1.0, 2.0, 2.0]), [9.0 / 4.0])
    x = J @ [0.5, -1.0] + dJ @ [3.0, 4.0]
    found = phase.value("acceleration of the tool", a_a=[0.5, -1.0], v_a=[3.0, 4.0])
    assert_allclose(found, [x[:3] @ x[:3] / 25.0])
    assert all(row[0][1:] == (-np.inf, 1.0) for row in phase.rows.values())
    none = Phase(Made(), functions)
    model_limits._bound_tool(none, Made(tool_speed=None, tool_acceleration=None))
    assert none.rows == {}


def test_effective_torques_cannot_be_limits_of_a_plan() -> None:
    """They are means over the motion."""
    phase: Any = Phase(Made())
    with pytest.raises(
        ArgumentError,
        match="limits: given torque_rms, expected other kinds: effective torques are means",
    ):
        model_limits.apply_limits(phase, Limits(torque_rms=(1.0, 1.0)), True)


def test_parameters_of_a_function_are_counted() -> None:
    """By position and by name; free ones are more than any number of them."""

    def plain(a: int, b: int, *, c: int, d: int) -> None: ...

    def free(a: int, *more: int, b: int = 1, **named: int) -> None: ...

    assert (
        _parameters(plain) == 4
        and _parameters(lambda: None) == 0
        and _parameters(lambda self, x: None) == 2
    )
    assert _parameters(free) > 10


def test_bounds_of_limits_are_one_for_each_part() -> None:
    limits = flexgen.Limits(torque=(4.0, 6.0), reserve=0.25, deflection=(0.1,), tool_speed=2.0)
    assert_allclose(limits.bounds("torque", 2), [4.0, 6.0])
    assert_allclose(limits.bounds("gear_torque", 3), np.full(3, np.inf))
    assert_allclose(limits.deflections(1), [0.1])
    less = limits.without("torque", "tool_speed")
    assert less == flexgen.Limits(reserve=0.25, deflection=(0.1,))
    with pytest.raises(ArgumentError) as caught:
        limits.bounds("tool_speed", 1)
    assert str(caught.value).startswith(
        "limits: given kind 'tool_speed', expected one of torque, speed, "
    )
    with pytest.raises(
        ArgumentError, match=r"^limits: given kinds .*tau.*, expected fields of flexgen\.Limits$"
    ):
        limits.without("torque", "tau")
    for size in (-1, 10**9):
        with pytest.raises(
            ArgumentError, match=r"^limits, number of torque bounds: given .*, expected 0 to \d+$"
        ):
            limits.bounds("torque", size)
    for size in (1, 3):
        with pytest.raises(
            ArgumentError,
            match=rf"^limits: given torque \(4\.0, 6\.0\), expected {size} positive numb",
        ):
            limits.bounds("torque", size)
