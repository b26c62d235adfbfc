"""Functions of long arms in loops over the joints, step by step in NumPy: against the
Lagrangian's, planted errors.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from recursion_cases import arguments, check, dense_chain, largest, some_states, values

from flexgen.codegen.emission.spec import library_spec
from flexgen.codegen.recursion import column_functions, columns, derivatives, newton_euler
from flexgen.codegen.recursion.arm import arm_of
from flexgen.codegen.recursion.column_functions import SHORTER, cost, long_chain, loops_agree
from flexgen.codegen.recursion.dh_chain import Chain, KeptInertia, make_chain, regroup
from flexgen.codegen.recursion.functions import (
    fast_function,
    operations_of,
    recursive_function,
)
from flexgen.codegen.recursion.regrouping import KEPT_ALL
from flexgen.codegen.recursion.tape import Tape
from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import (
    Columns,
    Expressions,
    Factor,
    Products,
    Routine,
    Rows,
    Step,
    Sums,
)
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
    slopes = program_of(equations, "inverse_dynamics_derivatives")
    assert in_loops(slopes)
    for state in some_states(equations.model):
        given = arguments(state, rng)
        found = evaluate_routine(slopes, given)
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


# --- steps of eight joints -----------------------------------------------------------------------
def equal(n: int, seed: int) -> RobotModel:
    """A turning chain whose bodies all have the same mass."""
    model = dense_chain(n, seed)
    bodies = [replace(x, body=replace(x.body, mass=2.0)) for x in model.elements]
    return replace(model, elements=tuple(bodies))


@cache
def chain_of(kind: str, kept: KeptInertia | None = None) -> Chain:
    """Too short for loops in a library: no other form takes the place of these."""
    chain = make_chain({"hollow": hollow(8, 3), "equal": equal(8, 2)}[kind])
    return chain if kept is None else regroup(chain, [kept] * 8)


@pytest.mark.parametrize("kind", ["hollow", "equal"])
@pytest.mark.parametrize("kept", [None, KeptInertia()])
def test_loops_give_the_torques_and_derivatives_of_the_recursions(kind, kept):
    q, v, a = np.random.default_rng(3).uniform(-2.0, 2.0, (3, 8))
    given = {"q_a": q, "v_a": v, "a_a": a}
    moved = tuple(x.tolist() for x in (q, v, a))
    carried = [True] * 8
    plain = chain_of(kind)
    Q, V, M = (
        np.array(x, dtype=float) for x in derivatives.derivatives(Tape(), plain, *moved, carried)
    )
    rest = newton_euler.inverse_dynamics(Tape(), plain, *moved[:2], [0.0] * 8, carried)
    chain = chain_of(kind, kept)

    def close(found, expected, tolerance=1e-11):
        assert largest(found - expected) <= tolerance * largest(expected)

    steps = columns.derivatives(chain, ("R", 0), ("R", 8), "M")
    found = evaluate_routine(Routine(tuple(steps)), given)
    close(found["R"], np.hstack([Q, V]))
    close(found["M"], M)
    steps = columns.bias(chain, "M")
    close(evaluate_routine(Routine(tuple(steps)), given)["bias"].ravel(), np.array(rest))
    # the accelerations are a row that is found between the two
    later = Routine((*steps, *columns.derivatives_after(chain, ("Q", 1), ("V", 0))))
    found = evaluate_routine(later, {"q_a": q, "v_a": v, "row_a_a": a[None]})
    close(found["Q"][:, 1:], Q)
    close(found["V"], V)


@pytest.mark.parametrize(("kind", "bodies"), [("hollow", (2, 5)), ("equal", tuple(range(8)))])
def test_loops_carry_only_columns_of_bodies_and_rows_of_numbers_that_differ(kind, bodies):
    chain = chain_of(kind)
    assert columns.bodies_of(chain) == bodies
    steps = columns.derivatives(chain, ("Q", 0), ("V", 0), "M")
    loops = {step.function.name(): step for step in steps if isinstance(step, Columns)}
    for name, step in loops.items():
        assert step.n == (len(bodies) if name in ("moments", "motion", "forces") else 8), name
        assert all(np.ptp(row) > 0 for table in step.tables.values() for row in np.array(table))
    inertias = [chain.joints[k].inertia for k in bodies]
    numbers = np.array([[x.mass, *x.first, *x.second[np.triu_indices(3)]] for x in inertias])
    rows = sum(len(table) for table in loops["moments"].tables.values())
    assert rows == sum(np.ptp(row) > 0 for row in numbers.T)
    # whether a joint turns is a row where slides are among them
    assert any(loops["axes"].tables) == (kind == "hollow")


# --- the choice of loops -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("factor", "squares", "agrees"),
    [(1 + 2e-10, 0.0, True), (1 + 2e-9, 0.0, False), (np.nan, 0.0, False), (1.0, 1e-4, False)],
)
def test_the_check_before_use_sees_errors_from_one_billionth(monkeypatch, factor, squares, agrees):
    """Planted in the recursion that the loops are compared with; the last one is zero without
    acceleration.
    """
    chain = chain_of("equal", KEPT_ALL)
    names = ["q_a", "v_a", "a_a"]
    symbols = [ca.SX.sym(name, 8) for name in names]
    tape = Tape()
    tau = newton_euler.inverse_dynamics(
        tape, chain, *(tape.vector(x) for x in symbols), [True] * 8
    )
    wrong = factor * ca.vertcat(*tape.build(tau)) + squares * ca.sumsqr(symbols[2])
    f = ca.Function("f", symbols, [wrong], names, ["tau"])
    monkeypatch.setattr(column_functions, "fast_function", lambda equations, name: f)
    assert loops_agree(derive(equal(8, 2)), chain) == agrees


@cache
def long_arm() -> Equations:
    return derive(hollow(12, 4))


def test_the_chain_of_a_long_arm_has_the_fewest_operations():
    """Less than a share of those of one expression for each entry."""
    chain = long_chain(long_arm())
    own = make_chain(long_arm().model)
    steps = [
        cost(columns.derivatives(x, ("Q", 0), ("V", 0), "M"))
        for x in (chain, *(regroup(own, [kept] * 12) for kept in (KeptInertia(), KEPT_ALL)))
    ]
    assert steps[0] == min(steps[1:])
    direct = recursive_function(long_arm(), "inverse_dynamics_derivatives")
    assert steps[0] < SHORTER * operations_of(direct)


@pytest.mark.parametrize("reason", ["loaded", "moves", "branched", "no recursion", "short"])
def test_arms_that_loops_do_not_describe_have_none(monkeypatch, reason):
    model = long_arm().model
    first, *others, last = model.elements
    equations = long_arm()
    if reason == "loaded":
        equations = derive(model, parameters=["payload.mass"])
    elif reason == "branched":
        last = replace(last, parent=first.name)
        equations = derive(replace(model, elements=(first, *others, last)))
    elif reason == "moves":
        # a further joint that turns with the last one
        dof = replace(last.dofs[0], name="more", gear=None, mimic=((last.dofs[0].name, 1.0),))
        more = replace(last, name="more", dofs=(dof,))
        equations = derive(replace(model, elements=(*model.elements, more)))
    elif reason == "short":
        monkeypatch.setattr(column_functions, "LONG_CHAIN", 13)
    else:
        monkeypatch.setattr(column_functions, "fast_function", lambda *_: None)
    assert (arm_of(equations).moves is not None) == (reason == "moves")
    assert long_chain(equations) is None


X = ca.SX.sym("x", 2)
THREE = ca.Function("f", [X], [X[0] * X[1] - 2 * X[0]], ["x"], ["y"])
ABOVE = (Rows("a", 0, 2), Rows("b", 0, 2))
BELOW = (Rows("c", 0, 3), Rows("d", 0, 3))


@pytest.mark.parametrize(
    ("steps", "operations"),
    [
        ([Expressions(THREE)], 3),
        *(([Columns(THREE, n)], 3 * lanes) for n, lanes in ((1, 1), (8, 1), (9, 2), (17, 3))),
        ([Sums("a", "b", 6, 20, (0, 3, 5))], 6 * 3),
        ([Products(ABOVE, BELOW, 9, "M")], Products(ABOVE, BELOW, 9, "M").operations / 8),
        # both triangles of a symmetric one are computed
        (
            [Products(ABOVE, ABOVE[::-1], 9, "M"), Expressions(THREE)],
            Products(ABOVE, ABOVE[::-1], 9, "M").operations / 4 + 3,
        ),
    ],
)
def test_costs_count_lanes_rows_and_both_triangles(steps: list[Step], operations: float):
    assert operations_of(THREE) == 3
    assert cost(steps) == operations


@pytest.mark.slow
def test_loops_are_used_where_they_are_shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Than a fraction of the operations of one expression for each entry; never for a short
    arm.
    """
    equations = derive(ROBOTS["hollow"]())
    chain = long_chain(equations)
    direct = fast_function(equations, "mass_matrix")
    assert chain is not None and direct is not None
    steps = columns.mass_matrix(chain, "M")
    fraction = column_functions.cost(steps) / operations_of(direct)
    for part, used in ((1 + 1e-9, True), (1 - 1e-9, False)):
        monkeypatch.setattr(column_functions, "SHORTER", part * fraction)
        found = column_functions.shorter_mass_matrix(equations, "M")
        assert (found is not None and len(found) == len(steps)) == used
    monkeypatch.setattr(column_functions, "SHORTER", np.inf)
    short = derive(dense_chain(column_functions.LONG_CHAIN - 1, 2))
    assert column_functions.shorter_mass_matrix(short, "M") is None
