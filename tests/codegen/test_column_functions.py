"""Functions of long arms in loops over the joints, step by step in NumPy: against the
Lagrangian's, planted errors.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from recursion_cases import arguments, check, dense_chain, largest, some_states, values

from flexgen.codegen.emission.spec import library_spec
from flexgen.codegen.recursion import column_functions, columns
from flexgen.codegen.recursion.column_functions import long_chain
from flexgen.codegen.recursion.functions import recursive_function
from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import Columns, Factor, Routine
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.elements import Body, Gear, LinearSpring, Placement, RobotModel

DERIVATIVES = ("inverse_dynamics_derivatives", "arm_forward_derivatives", "linearize")


def hollow(n: int, seed: int) -> RobotModel:
    """A chain where two joints of three move nothing but what follows, sliding ones among them."""
    model = dense_chain(n, seed, sliding=True)
    bodies = [
        element if k % 3 == 2 else replace(element, body=Body())
        for k, element in enumerate(model.elements)
    ]
    return replace(model, elements=tuple(bodies))


def elastic(n: int, seed: int) -> RobotModel:
    """A chain with gears that are springs, but for two."""
    model = dense_chain(n, seed)
    elements = []
    for k, element in enumerate(model.elements):
        gear = (
            Gear(rigid=True)
            if k % 6 == 1
            else Gear(rigid=False, spring=LinearSpring(1e4), damping=3.0)
        )
        elements.append(replace(element, dofs=(replace(element.dofs[0], gear=gear),)))
    motors = tuple(replace(motor, ratio=(20.0,)) for motor in model.motors)
    return replace(model, elements=tuple(elements), motors=motors)


ROBOTS = {
    "dense": lambda: dense_chain(12, 2),
    "sliding": lambda: dense_chain(13, 3, sliding=True),
    "hollow": lambda: hollow(15, 4),
}


def program_of(equations: Equations, name: str) -> Routine:
    """Program of the library's function of that name."""
    return library_spec(equations, [name]).functions[0].program


def in_loops(program: Routine) -> bool:
    return any(isinstance(step, Columns) for step in program.steps)


@pytest.mark.parametrize(
    "robot", [*(pytest.param(x, marks=pytest.mark.slow) for x in ("dense", "sliding")), "hollow"]
)
def test_derivatives_and_mass_matrix_are_the_lagrangians(robot):
    equations = derive(ROBOTS[robot]())
    rng = np.random.default_rng(1)
    chain = long_chain(equations)
    assert chain is not None
    mass_matrix = Routine(tuple(columns.mass_matrix(chain, "M")))
    derivatives = program_of(equations, "inverse_dynamics_derivatives")
    assert in_loops(derivatives)
    for state in some_states(equations.model):
        given = arguments(state, rng)
        found = evaluate_routine(derivatives, given)
        names = ("dtau_dq", "dtau_dv", "dtau_da")
        check(equations, "inverse_dynamics_derivatives", given, [found[name] for name in names])
        check(equations, "mass_matrix", given, [evaluate_routine(mass_matrix, given)["M"]])


@pytest.mark.parametrize("robot", [pytest.param("dense", marks=pytest.mark.slow), "hollow"])
def test_derivatives_of_accelerations(robot):
    """Against the implicit function theorem: M da = -dtau at the acceleration of the same
    state.
    """
    equations = derive(ROBOTS[robot]())
    program = program_of(equations, "arm_forward_derivatives")
    assert any(isinstance(step, Factor) for step in program.steps)
    given = arguments(some_states(equations.model, 1)[0], np.random.default_rng(2))
    found = evaluate_routine(program, given)
    (a_a,) = values(recursive_function(equations, "arm_forward_dynamics"), given)
    by_q, by_v, M = values(
        recursive_function(equations, "inverse_dynamics_derivatives"),
        {**given, "a_a": a_a.ravel()},
    )
    for name, expected in (("da_dq", -by_q), ("da_dv", -by_v), ("da_dtau", np.eye(len(M)))):
        assert largest(M @ found[name] - expected) <= 1e-12 * largest(
            np.abs(M) @ np.abs(found[name])
        )


@pytest.mark.slow
def test_linearization_of_the_whole_robot():
    equations = derive(elastic(12, 5))
    program = program_of(equations, "linearize")
    assert in_loops(program)
    given = arguments(some_states(equations.model, 1)[0], np.random.default_rng(3))
    found = evaluate_routine(program, given)
    expected = dict(zip(("A", "B"), values(equations.function("linearize"), given), strict=True))
    n = equations.model.dof
    M, _ = values(
        equations.function("residual_jacobians"), {**given, **accelerations(equations, given)}
    )
    for name, x in expected.items():
        assert np.array_equal(found[name][:n], x[:n])
        assert largest(M @ (found[name] - x)[n:]) <= 1e-12 * largest(np.abs(M) @ np.abs(x[n:]))


def accelerations(equations: Equations, given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    a_a, a_m = values(equations.function("forward_dynamics"), given)
    return {"a_a": a_a.ravel(), "a_m": a_m.ravel()}


@pytest.mark.slow
def test_short_arms_and_changing_payloads_are_not_in_loops():
    short = derive(dense_chain(column_functions.LONG_CHAIN - 1, 2))
    assert long_chain(short) is None
    assert not any(in_loops(program_of(short, name)) for name in DERIVATIVES)
    loaded = derive(dense_chain(12, 2), parameters=["payload.mass"])
    assert long_chain(loaded) is None


def test_arms_with_massless_bodies_or_parallel_axes_are_not_in_loops():
    """Where there is nothing to add up, and where one expression for each entry is short."""
    empty = replace(
        dense_chain(12, 2),
        elements=tuple(replace(x, body=Body()) for x in dense_chain(12, 2).elements),
    )
    assert long_chain(derive(empty)) is None
    elements = [
        replace(
            x,
            origin=Placement((0.3, 0.0, 0.0)),
            link=Placement(),
            dofs=(replace(x.dofs[0], axis=(0.0, 0.0, 1.0)),),
        )
        for x in dense_chain(12, 2).elements
    ]
    assert long_chain(derive(replace(dense_chain(12, 2), elements=tuple(elements)))) is None


def no_linear_rate(monkeypatch):
    def wrong(speed: ca.SX, axis: ca.SX) -> ca.SX:
        return ca.vertcat(ca.cross(speed[:3], axis[:3]), ca.cross(speed[:3], axis[3:]))

    monkeypatch.setattr(columns, "_rate_of_axis", wrong)


def transposed_moment(monkeypatch):
    less = columns._less
    monkeypatch.setattr(columns, "_less", lambda A, x: less(A.T, x))


def lost_body(monkeypatch):
    bodies = columns.bodies_of
    monkeypatch.setattr(columns, "bodies_of", lambda chain: bodies(chain)[:-1])


@pytest.mark.parametrize(
    "bug",
    [
        no_linear_rate,
        *(pytest.param(x, marks=pytest.mark.slow) for x in (transposed_moment, lost_body)),
    ],
)
@pytest.mark.slow
def test_robots_that_fail_before_use_are_not_in_loops(bug, monkeypatch):
    """A planted error: the check before use sees it, and the function is the recursion's."""
    bug(monkeypatch)
    equations = derive(dense_chain(12, 2))
    assert long_chain(equations) is None
    assert not in_loops(program_of(equations, "inverse_dynamics_derivatives"))


def test_earlier_requests_do_not_change_the_functions():
    """The route to accelerations is chosen once: the text does not depend on the order of the
    functions.
    """
    model = elastic(5, 6)
    texts = []
    for names in (
        ["forward_dynamics", "arm_forward_dynamics"],
        ["arm_forward_dynamics", "forward_dynamics"],
    ):
        equations = derive(model)
        programs = {name: program_of(equations, name).steps[0].function for name in names}
        texts.append({name: str(f.instructions_sx()) for name, f in programs.items()})
    assert texts[0] == texts[1]
