"""The fast path against the Lagrangian: every function, on every model and on random robots, to
rounding.

Counts of operations are guarded: they are what the fast path is for.
"""

from __future__ import annotations

from pathlib import Path

import hypothesis
import numpy as np
import pytest
from random_robots import cases
from recursion_cases import (
    FUNCTIONS,
    MADE,
    ROBOTS,
    arguments,
    check,
    equations_of,
    robot,
    six_axes,
    some_states,
    values,
)
from referee import ALL_MODELS, model_of

from flexgen.codegen.recursion import functions as fast_room
from flexgen.codegen.recursion.functions import (
    agrees,
    fast_function,
    operations_of,
    recursive_function,
)
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.elements import Body, Dof, Element, Gear, Motor, Placement, RobotModel


@pytest.mark.parametrize("name", [*ALL_MODELS, *ROBOTS, *MADE], ids=lambda name: Path(name).stem)
def test_recursion_agrees_with_the_lagrangian(name):
    equations = equations_of(name)
    rng = np.random.default_rng(5)
    states = [arguments(s, rng) for s in some_states(equations.model)]
    for function in FUNCTIONS:
        fast = recursive_function(equations, function)
        if fast is None:
            continue
        slow = equations.function(function)
        assert fast.name_in() == slow.name_in()
        assert fast.name_out() == slow.name_out()
        assert all(fast.sparsity_in(i).is_dense() for i in range(fast.n_in()))
        assert all(fast.sparsity_out(i) == slow.sparsity_out(i) for i in range(fast.n_out()))
        for given in states:
            check(equations, function, given, values(fast, given))


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_MODELS)
def test_recursion_exists_without_beams_and_complete_coupling(name):
    """Beams; the whole machine where rotors turn with their carriers; everything else has one."""
    model = model_of(name)
    straight = all(element.beam is None for element in model.elements)
    assert (fast_function(equations_of(name), "gravity") is not None) == straight
    if model.motor_coupling == "complete":
        assert fast_function(equations_of(name), "forward_dynamics") is None
    assert fast_function(equations_of("elbow"), "energy") is None


@pytest.mark.parametrize("name", [*ALL_MODELS, *ROBOTS, *MADE], ids=lambda name: Path(name).stem)
def test_every_robot_passes_the_test_before_use(name):
    """Functions of `recursive_function` are used only if they agree with the definition."""
    equations = equations_of(name)
    if recursive_function(equations, "gravity") is not None:
        assert agrees(equations)
        assert fast_function(equations, "gravity") is recursive_function(equations, "gravity")


def test_the_test_before_use_is_done_once(monkeypatch):
    asked = []
    monkeypatch.setattr(fast_room, "agrees", lambda equations: bool(asked.append(equations)))
    equations = derive(six_axes())
    assert [fast_function(equations, name) for name in FUNCTIONS] == [None] * len(FUNCTIONS)
    assert asked == [equations]


def nothing_resists() -> dict[str, RobotModel]:
    """Robots whose accelerations are not defined, because a motion has no inertia anywhere."""
    full = Body(3.0, (0.1, 0.0, 0.0), ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)))
    shapes = {
        "alone": ["rotation", Body()],
        "last": ["rotation", full, Body()],
        "on the axis": ["rotation", full, Body(1.0)],
        "slider": ["translation", Body()],
    }
    out = {}
    for name, (kind, *bodies) in shapes.items():
        elements = []
        motors = []
        for k, body in enumerate(bodies):
            dof = Dof(f"q{k}", kind, (0.0, 0.0, 1.0), gear=Gear(rigid=True))
            elements.append(Element(f"b{k}", (dof,), Placement((0.3, 0.0, 0.0)), body=body))
            motors.append(Motor(f"m{k}", 1e-4, (f"q{k}",), (100.0,)))
        out[name] = robot(elements, motors)
    return out


@pytest.mark.parametrize("parameters", [(), ("payload",)])
@pytest.mark.parametrize("name", nothing_resists())
def test_without_inertia_the_lagrangian_is_used(name, parameters):
    """No division by the number zero while functions are made; what exists of them is right."""
    equations = derive(nothing_resists()[name], parameters)
    given = arguments(some_states(equations.model, 1)[0], np.random.default_rng(4))
    given["parameters"] = np.array([parameter.value for parameter in equations.parameters])
    for function in FUNCTIONS:
        fast = fast_function(equations, function)
        if function == "arm_forward_dynamics" and not parameters:
            assert fast is None
            assert not np.isfinite(values(equations.function(function), given)[0]).all()
        elif fast is not None and function != "arm_forward_dynamics":
            check(equations, function, given, values(fast, given))


@pytest.mark.parametrize("name", ["manutec_r3", "sliding5"])
def test_parameters(name):
    """Numbers that change at run time are arguments; others than those of the file give what a
    model with them has.
    """
    plain = equations_of(name).model
    rng = np.random.default_rng(8)
    names = ["payload", *(["stiffness", "friction"] if name.startswith("manutec") else [])]
    equations = Equations(plain, names)
    numbers = np.array([parameter.value for parameter in equations.parameters])
    changed = numbers * rng.uniform(0.5, 2.0, len(numbers)) + rng.uniform(0.0, 0.1, len(numbers))
    for function in FUNCTIONS:
        fast = fast_function(equations, function)
        assert fast is not None  # it passed the test with the values of the file
        assert ("parameters" in fast.name_in()) == (
            "parameters" in equations.function(function).name_in()
        )
        for s in some_states(plain, 1):
            for value in (numbers, changed):
                given = {**arguments(s, rng), "parameters": value}
                check(equations, function, given, values(fast, given))


def check_all(case) -> None:
    equations = derive(case.model)
    rng = np.random.default_rng(6)
    states = [arguments(s, rng) for s in case.states]
    for name in FUNCTIONS:
        fast = recursive_function(equations, name)
        for given in states if fast is not None else ():
            check(equations, name, given, values(fast, given))


@pytest.mark.slow
@hypothesis.given(cases())
@hypothesis.settings(max_examples=3, deadline=None, derandomize=True)
def test_random_robots(case):
    check_all(case)


@pytest.mark.full
@hypothesis.given(cases())
@hypothesis.settings(max_examples=20, deadline=None, derandomize=True)
def test_many_random_robots(case):
    check_all(case)


# --- what it is for ------------------------------------------------------------------------------

# Operations at most; a change that makes them more has to say why.
GUARDED = {
    ("six_axes", "inverse_dynamics"): 257,
    ("six_axes", "mass_matrix"): 104,
    ("six_axes", "arm_forward_dynamics"): 436,
    ("six_axes", "inverse_dynamics_derivatives"): 1203,
    ("six_axes", "forward_kinematics"): 68,
    ("manutec_r3", "inverse_dynamics"): 332,
    ("manutec_r3_efjm", "inverse_dynamics"): 877,
    ("manutec_r3_efjm", "mass_matrix"): 1784,
    ("manutec_r3_efjm", "arm_forward_dynamics"): 2243,
    ("manutec_r3_efjm", "inverse_dynamics_derivatives"): 11736,
}


@pytest.mark.parametrize(("name", "function"), GUARDED)
def test_counts_of_operations(name, function):
    fast = fast_function(equations_of(name), function)
    assert fast is not None
    assert operations_of(fast) <= GUARDED[name, function]


@pytest.mark.parametrize("name", ["six_axes", "manutec_r3", "manutec_r3_efjm", "kr300", "dense7"])
def test_fewer_operations_than_the_lagrangian(name):
    equations = equations_of(name)
    for function in ("inverse_dynamics", "mass_matrix", "arm_forward_dynamics"):
        fast = fast_function(equations, function)
        assert fast is not None
        assert 2 * operations_of(fast) < operations_of(equations.function(function))
