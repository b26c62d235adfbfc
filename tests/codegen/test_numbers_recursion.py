"""Each form of the recursions alone, with numbers instead of symbols: against the Lagrangian,
differences and SciPy.

A robot whose recursion is wrong uses the Lagrangian, which hides errors from tests of results:
here no form is compared with another that would replace it, and counts of operations show where
one was replaced. Of 278 mutants of the room drawn at random (one changed operator or constant
each) this file alone kills 237.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from emitted_hashes import GOLDEN_CASADI
from recursion_cases import FUNCTIONS, dense_chain, robot
from referee import matrix, random_body, random_placement
from scipy.spatial.transform import Rotation

from flexgen.codegen.recursion import (
    articulated_body,
    column_functions,
    columns,
    composite_body,
    derivatives,
    dh_chain,
    functions,
    kinematics,
    newton_euler,
)
from flexgen.codegen.recursion.dh_chain import Chain, KeptInertia, make_chain, regroup
from flexgen.codegen.recursion.functions import operations_of, recursive_function
from flexgen.codegen.recursion.regrouping import KEPT_ALL
from flexgen.codegen.recursion.tape import Tape, Value
from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import Columns, Expressions, Products, Routine, Rows, Sums
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.elements import (
    Body,
    Dof,
    Element,
    Gear,
    LinearSpring,
    Motor,
    Placement,
    RobotModel,
)

Z = (0.0, 0.0, 1.0)
X = (1.0, 0.0, 0.0)
Y = (0.0, 1.0, 0.0)


def made(rows: list[tuple[str, Any, Placement, Body]], seed: int, **rest: Any) -> RobotModel:
    """A robot of rows (kind, axes, place, body); several axes are coordinates of one element on
    one point.
    """
    rng = np.random.default_rng(seed)
    elements = []
    motors = []
    for k, (kind, axes, place, body) in enumerate(rows):
        dofs = []
        for i, axis in enumerate(axes):
            elastic = Gear(rigid=False, spring=LinearSpring(2e3), damping=2.0)
            gear = (
                {"gear": Gear(rigid=True)}
                if i == 0
                else {"spring": LinearSpring(1e4), "damping": 3.0}
            )
            gear = {"gear": elastic} if i == 0 and k == 1 else gear
            dofs.append(Dof(f"q{k}{i}", kind, axis, **gear))  # type: ignore[arg-type]
        elements.append(Element(f"b{k}", tuple(dofs), place, Placement(), body))
        motors.append(Motor(f"m{k}", 1e-3, (f"q{k}0",), (20.0,)))
    return robot(elements, motors, tool=random_placement(rng), **rest)


def at(*position: float, about: str = "z", degrees: float = 0.0) -> Placement:
    return Placement(
        position, matrix(Rotation.from_euler(about, degrees, degrees=True).as_matrix())
    )


def parallel() -> RobotModel:
    """Parallel and opposite axes, a slide among them, quarter turns and frames on common
    normals.
    """
    bodies = [random_body(np.random.default_rng(k)) for k in range(6)]
    ball = replace(bodies[2], com=(0.1, 0.0, 0.0), inertia=matrix(0.2 * np.eye(3)))
    rows = [
        ("rotation", (Z,), at(0.0, 0.0, 0.4), bodies[0]),
        ("rotation", (Z,), at(0.3, 0.4, 0.1, degrees=90), bodies[1]),
        ("rotation", (tuple(-x for x in Z),), at(0.2, 0.1, 0.0, degrees=30), ball),
        ("translation", (Z,), at(0.0, 0.3, 0.2), bodies[3]),
        ("rotation", (X,), at(0.1, 0.0, 0.0, degrees=180), bodies[4]),
        ("rotation", (Z,), at(0.0, 0.0, 0.2, about="x", degrees=-90), bodies[5]),
    ]
    return made(rows, 11)


def on_points() -> RobotModel:
    """Three axes on one point without a body between them, twice; after a slide, gravity along no
    axis.
    """
    rng = np.random.default_rng(5)
    rows = [
        ("translation", (Y,), at(0.1, 0.2, 0.0), random_body(rng)),
        ("rotation", (Z, X, Y), at(0.0, 0.3, 0.2), random_body(rng)),
        ("rotation", (Y, Z, X), at(0.4, 0.0, 0.1), random_body(rng)),
    ]
    return made(rows, 12, gravity=(1.0, 2.0, -9.0), base=random_placement(rng))


def half_empty() -> RobotModel:
    """Bodies without mass between others, and a payload."""
    plain = dense_chain(5, 3, sliding=True)
    elements = [
        x if k in (1, 2, 4) else replace(x, body=Body()) for k, x in enumerate(plain.elements)
    ]
    return replace(plain, elements=tuple(elements), payload=random_body(np.random.default_rng(8)))


def equal() -> RobotModel:
    """A turning chain whose bodies all have the same mass."""
    plain = dense_chain(4, 2)
    return replace(
        plain, elements=tuple(replace(x, body=replace(x.body, mass=2.0)) for x in plain.elements)
    )


ROBOTS: dict[str, Callable[[], RobotModel]] = {
    "dense": lambda: dense_chain(4, 1),
    "sliding": lambda: dense_chain(5, 3, sliding=True),
    "parallel": parallel,
    "on points": on_points,
    "half empty": half_empty,
    "equal": equal,
}
each_robot = pytest.mark.parametrize("name", ROBOTS)


@cache
def equations_of(name: str) -> Equations:
    return derive(ROBOTS[name]())


def groupings(name: str) -> Iterator[Chain]:
    """The chain as it is, and with inertia moved to the body before in several ways."""
    chain = make_chain(equations_of(name).model)
    yield chain
    for kept in (
        KeptInertia(),
        KEPT_ALL,
        KeptInertia("balance"),
        KeptInertia("none", True, False),
    ):
        yield regroup(chain, [kept] * len(chain.joints))


def states(name: str, count: int = 2) -> list[Made]:
    rng = np.random.default_rng(7)
    n = equations_of(name).model.n_a
    return [
        Made(**{x: rng.uniform(-2.0, 2.0, n).tolist() for x in ("q", "v", "a")})
        for _ in range(count)
    ]


def torque(name: str, q: Any, v: Any, a: Any) -> np.ndarray:
    """The Lagrangian's."""
    return np.array(equations_of(name).function("inverse_dynamics")(q, v, a)).ravel()


def difference(f: Callable[[np.ndarray], np.ndarray], x: Any, h: float = 1e-4) -> np.ndarray:
    """Derivatives of f by central differences of order four, along a last axis."""
    out = []
    for e in h * np.eye(len(x)):
        near, far = ((f(x + k * e) - f(x - k * e)) / (2 * k * h) for k in (1, 2))
        out.append((4 * near - far) / 3)
    return np.stack(out, axis=-1)


def close(found: Any, expected: Any, tolerance: float = 1e-12) -> None:
    found = np.array(found, dtype=float)
    expected = np.array(expected, dtype=float)
    assert found.shape == expected.shape
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=tolerance * max(1e-3, np.abs(expected).max())
    )


@each_robot
def test_torques_and_mass_matrices_of_all_groupings_are_the_lagrangians(name: str) -> None:
    for s in states(name):
        n = len(s.q)
        still = [0.0] * len(s.q)
        expected = torque(name, s.q, s.v, s.a)
        M = np.array(equations_of(name).function("mass_matrix")(s.q))
        gravity = torque(name, s.q, still, still)
        for chain in groupings(name):
            for carried in ([True] * n, [False] * n, [k % 2 == 0 for k in range(n)]):
                close(
                    newton_euler.inverse_dynamics(Tape(), chain, s.q, s.v, s.a, carried), expected
                )
            for together in (True, False):
                close(composite_body.mass_matrix(Tape(), chain, s.q, together), M)
            close(
                difference(
                    lambda q, c=chain: np.array(composite_body.height(Tape(), c, q.tolist())), s.q
                ),
                gravity,
                1e-9,
            )


@each_robot
def test_derivatives_of_all_groupings_are_differences_of_the_lagrangians_torques(
    name: str,
) -> None:
    s = states(name, 1)[0]
    expected = [
        difference(lambda x: torque(name, x, s.v, s.a), s.q),
        difference(lambda x: torque(name, s.q, x, s.a), s.v),
        difference(lambda x: torque(name, s.q, s.v, x), s.a),
    ]
    for chain in groupings(name):
        for carried in (True, False):
            found = derivatives.derivatives(Tape(), chain, s.q, s.v, s.a, [carried] * len(s.q))
            for x, y in zip(found, expected, strict=True):
                close(x, y, 1e-9)


@each_robot
def test_accelerations_balance_the_torques_with_and_without_rotors(name: str) -> None:
    n = equations_of(name).model.n_a
    joined = 0
    for s in states(name):
        M = np.array(equations_of(name).function("mass_matrix")(s.q))
        h = torque(name, s.q, s.v, [0.0] * n)
        for chain in groupings(name):
            turns = [
                newton_euler.turn_of(Tape(), joint, q)
                for joint, q in zip(chain.joints, s.q, strict=True)
            ]
            for armature in ([0.0] * n, [0.0] * (n - 1) + [0.7], [0.3 + k for k in range(n)]):
                moving = newton_euler.motions(
                    Tape(), chain, turns, s.q, s.v, [0.0] * n, [True] * n
                )
                loads = newton_euler.loads(chain, moving)
                found = articulated_body.forward_dynamics(
                    Tape(), chain, s.q, loads, turns, s.a, armature
                )
                expected = np.linalg.solve(M + np.diag(armature), np.array(s.a) - h)
                close(found, expected, 1e-9)
                close(
                    articulated_body.solve_symmetric(
                        Tape(), (M + np.diag(armature)).tolist(), (np.array(s.a) - h).tolist()
                    ),
                    expected,
                    1e-9,
                )
                joined += sum(articulated_body._find_joints_on_one_point(chain, armature))
    # with the inertia at its bodies both points, and that before the rotor; elsewhere the
    # groupings fill empty bodies
    assert joined == (2 * 2 * (4 + 2) if name == "on points" else 0)


@each_robot
def test_tool_moves_as_its_pose_says(name: str) -> None:
    """Jacobians and their rates are differences of the pose; the pose is the Lagrangian's."""
    equations = equations_of(name)
    chain = make_chain(equations.model, to_mass=False)
    pose = equations.function("forward_kinematics")

    def place(q: Any) -> np.ndarray:
        return np.array(pose(q)[0]).ravel()

    def turn(q: Any) -> np.ndarray:
        return np.array(pose(q)[1])

    def jacobian(q: Any) -> np.ndarray:
        return np.array(kinematics.jacobian(Tape(), chain, list(q)), dtype=float)

    for s in states(name):
        p, R = kinematics.tool_pose(Tape(), chain, s.q)
        close(p, place(s.q))
        close(R, turn(s.q))
        spin = np.einsum("ijn,kj->ikn", difference(turn, s.q), turn(s.q))
        close(
            jacobian(s.q),
            np.vstack([difference(place, s.q), spin[2, 1], spin[0, 2], spin[1, 0]]),
            1e-9,
        )
        found = kinematics.rates(Tape(), chain, s.q, s.v, s.a)
        q, v, a = (np.array(x) for x in (s.q, s.v, s.a))

        def along(t: Any, q: np.ndarray = q, v: np.ndarray = v, a: np.ndarray = a) -> np.ndarray:
            return jacobian(q + t[0] * v + t[0] ** 2 / 2 * a)

        first = difference(along, np.zeros(1))[..., 0]
        h = 1e-3
        second = sum(
            c * along([k * h]) for k, c in zip(range(-2, 3), (-1, 16, -30, 16, -1), strict=True)
        ) / (12 * h**2)
        columns_of = np.array([[*zip(*c, strict=True)] for c in found.columns], dtype=float)
        for k, (expected, tolerance) in enumerate(
            ((jacobian(q), 1e-13), (first, 1e-9), (second, 1e-7))
        ):
            close(columns_of[:, :, k].T, expected, tolerance)
        motion = jacobian(q) @ a + first @ v
        close(found.bias, motion, 1e-9)
        close([*found.w, *found.dw], [*(jacobian(q) @ v)[3:], *motion[3:]], 1e-9)


# --- loops over columns --------------------------------------------------------------------------


def long_hollow() -> RobotModel:
    """Bodies without mass between others, slides among the joints."""
    plain = dense_chain(8, 3, sliding=True)
    elements = [x if k % 3 != 1 else replace(x, body=Body()) for k, x in enumerate(plain.elements)]
    return replace(plain, elements=tuple(elements))


def long_equal() -> RobotModel:
    """A turning chain whose bodies all have the same mass."""
    plain = dense_chain(8, 2)
    return replace(
        plain, elements=tuple(replace(x, body=replace(x.body, mass=2.0)) for x in plain.elements)
    )


LONG: dict[str, Callable[[], RobotModel]] = {"hollow": long_hollow, "equal": long_equal}


def long_groupings(name: str) -> list[Chain]:
    chain = make_chain(LONG[name]())
    return [
        chain,
        *(regroup(chain, [kept] * len(chain.joints)) for kept in (KeptInertia(), KEPT_ALL)),
    ]


@pytest.mark.parametrize("name", LONG)
def test_loops_over_columns_give_the_torques_and_derivatives_of_the_recursions(name: str) -> None:
    """Of chains that no library computes in loops as well: no other form takes the place of
    these.
    """
    rng = np.random.default_rng(3)
    n = 8
    q, v, a = rng.uniform(-2.0, 2.0, (3, n))
    given = {"q_a": q, "v_a": v, "a_a": a}
    chains = long_groupings(name)[:2]
    carried = [True] * n
    moved = tuple(x.tolist() for x in (q, v, a))
    Q, V, M = (
        np.array(x, dtype=float)
        for x in derivatives.derivatives(Tape(), chains[0], *moved, carried)
    )
    rest = newton_euler.inverse_dynamics(Tape(), chains[0], *moved[:2], [0.0] * n, carried)
    for chain in chains:
        found = evaluate_routine(
            Routine(tuple(columns.derivatives(chain, ("R", 0), ("R", n), "M"))), given
        )
        close(found["R"], np.hstack([Q, V]), 1e-11)
        close(found["M"], M)
        close(
            evaluate_routine(Routine(tuple(columns.mass_matrix(chain, "M"))), {"q_a": q})["M"], M
        )
        steps = columns.bias(chain, "M")
        at_rest = evaluate_routine(Routine(tuple(steps)), {"q_a": q, "v_a": v})
        close(at_rest["bias"].ravel(), rest, 1e-11)
        later = Routine((*steps, *columns.derivatives_after(chain, ("Q", 1), ("V", 0))))
        # (the accelerations are a row that is found between the two)
        found = evaluate_routine(later, {"q_a": q, "v_a": v, "row_a_a": a[None]})
        close(found["Q"][:, 1:], Q, 1e-11)
        close(found["V"], V, 1e-11)


def test_steps_of_loops_carry_only_columns_of_bodies_and_rows_of_numbers_that_differ() -> None:
    def arrays(chain: Chain) -> dict[str, tuple[int, int]]:
        steps = columns.derivatives(chain, ("Q", 0), ("V", 0), "M")
        made = [step for step in steps if isinstance(step, Columns)]
        return {
            x.function.name(): (x.n, sum(len(table) for table in x.tables.values())) for x in made
        }

    # rows of numbers: turning or not, 10 of an inertia, the mass of a body, the mass behind a
    # joint
    turning, hollow = (arrays(long_groupings(name)[0]) for name in ("equal", "hollow"))
    expected = {
        "axes": 0,
        "rates": 0,
        "moments": 9,
        "momenta": 1,
        "motion": 0,
        "gains": 0,
        "forces": 0,
        "changes": 1,
    }
    assert turning == {name: (8, rows) for name, rows in expected.items()} | {
        "moments": (8, turning["moments"][1])
    }
    assert turning["moments"][1] == len(
        [row for row in inertias(long_groupings("equal")[0]).T if np.ptp(row)]
    )
    sizes = {
        "axes": 8,
        "rates": 8,
        "moments": 5,
        "momenta": 8,
        "motion": 5,
        "gains": 8,
        "forces": 5,
        "changes": 8,
    }
    assert {name: n for name, (n, _) in hollow.items()} == sizes
    assert hollow["axes"][1] == hollow["forces"][1] == 1
    assert columns.bodies_of(long_groupings("hollow")[0]) == (0, 2, 3, 5, 6)


def inertias(chain: Chain) -> np.ndarray:
    """Ten numbers of each body."""
    bodies = [joint.inertia for joint in chain.joints]
    return np.array([[x.mass, *x.first, *x.second[np.triu_indices(3)]] for x in bodies])


def test_the_check_of_loops_sees_errors_from_one_billionth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chain = long_groupings("equal")[1]
    equations: Any = Made(model=Made(n_a=8))
    symbols = [ca.SX.sym(name, 8) for name in ("q_a", "v_a", "a_a")]
    tape = Tape()
    tau = newton_euler.inverse_dynamics(
        tape, chain, *(tape.vector(x) for x in symbols), [True] * 8
    )
    right = ca.vertcat(*tape.build(tau))
    names = ["q_a", "v_a", "a_a"]

    def agrees(changed: ca.SX) -> bool:
        f = ca.Function("f", symbols, [changed], names, ["tau"])
        monkeypatch.setattr(column_functions, "fast_function", lambda equations, name: f)
        return column_functions._agrees(equations, chain)

    assert agrees((1 + 2e-10) * right) and not agrees((1 + 2e-9) * right)
    assert not agrees(right + 1e-4 * ca.sumsqr(symbols[2]))  # (the same without acceleration)
    assert not agrees(right + ca.SX.nan())


def test_loops_are_taken_from_twelve_joints_where_they_are_much_shorter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = long_equal()
    equations: Any = Made(model=model)
    costs = {0.0: 70.0, 1.0: 61.0}  # by whether the first body keeps its mass

    def cost(chain: Chain) -> float:
        return costs[float(chain.joints[1].inertia.mass > 0)]

    monkeypatch.setattr(column_functions, "_derivatives_cost", cost)
    monkeypatch.setattr(column_functions, "_direct_cost", lambda equations: 100)
    monkeypatch.setattr(column_functions, "_agrees", lambda equations, chain: True)
    chosen = column_functions._chain_of.__wrapped__
    assert chosen(equations) is None
    costs[0.0] = 60.0
    found = chosen(equations)
    assert found is not None and [x.inertia.mass for x in found.joints[1:]] == [0.0] * 7
    costs[1.0] = 50.0
    found = chosen(equations)
    assert found is not None and all(x.inertia.mass > 0 for x in found.joints)
    monkeypatch.setattr(column_functions, "_agrees", lambda equations, chain: False)
    assert chosen(equations) is None
    empty = replace(model, elements=tuple(replace(x, body=Body()) for x in model.elements))
    assert chosen(Made(model=empty)) is None

    class Asked:
        """An arm of n joints that may carry a payload that changes, or have a mechanism."""

        def __init__(
            self,
            n: int,
            loaded: bool,
            recursion: bool,
            branched: bool = False,
            moves: object = None,
        ) -> None:
            self.model = Made(n_a=n, branched=branched)
            self.loaded = loaded
            self.recursion = recursion
            self.moves = moves

    monkeypatch.setattr(column_functions, "_chain_of", lambda asked: "chain")
    monkeypatch.setattr(column_functions, "arm_of", lambda asked: asked)
    monkeypatch.setattr(
        column_functions, "fast_function", lambda asked, name: asked.recursion or None
    )
    cases = (
        (12, False, True),
        (11, False, True),
        (40, True, True),
        (40, False, False),
        (40, False, True, True),
    )
    cases += ((40, False, True, False, ({0: 1.0},)),)
    found_for = [column_functions.long_chain(Asked(*x)) for x in cases]  # type: ignore[arg-type]
    assert found_for == ["chain", None, None, None, None, None]


def test_costs_of_steps_count_lanes_rows_and_both_triangles() -> None:
    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [x[0] * x[1] - 2 * x[0]], ["x"], ["y"])  # 3 operations
    above = (Rows("a", 0, 2), Rows("b", 0, 2))
    below = (Rows("c", 0, 3), Rows("d", 0, 3))
    assert operations_of(f) == 3
    assert column_functions.cost([Expressions(f)]) == 3
    assert [column_functions.cost([Columns(f, n)]) for n in (1, 8, 9, 17)] == [3, 3, 6, 9]
    assert column_functions.cost([Sums("a", "b", 6, 20, (0, 3, 5))]) == 18
    product = Products(above, below, 9, "M")
    assert column_functions.cost([product]) == product.operations / 8
    half = Products(above, above[::-1], 9, "M")
    assert (
        half.symmetric and column_functions.cost([half, Expressions(f)]) == half.operations / 4 + 3
    )


# --- numbers on a tape ---------------------------------------------------------------------------


def test_a_tape_of_random_operations_has_the_values_and_derivatives_of_casadi() -> None:
    """Sums, differences, products, multiples, sines, reciprocals with all signs; gradients and
    tangents.
    """
    rng = np.random.default_rng(2)
    for _ in range(12):
        tape = Tape()
        x = ca.SX.sym("x", 3)
        symbols = tape.vector(x)
        pool: list[tuple[Any, ca.SX]] = list(zip(symbols, ca.vertsplit(x), strict=True))
        for kind in rng.choice(11, 14):
            (a, A), (b, B) = (pool[k] for k in rng.integers(0, len(pool), 2))
            c = float(rng.choice([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0]))
            angle = [(u, U) for u, U in pool if isinstance(u, Value)][-1]
            new = [
                (a + b, A + B),
                (a - b, A - B),
                (a * b, A * B),
                (-a, -A),
                (a + c, A + c),
                (c - a, c - A),
                (c * a, c * A),
                (a - c, A - c),
                (tape.sine(angle[0]), ca.sin(angle[1])),
                (tape.sine(angle[0], True), ca.cos(angle[1])),
                (tape.inverse(a * a + 2.0), 1 / (A * A + 2)),
            ]
            pool.append(new[kind])
        results = [u for u, _ in pool[3:]]
        expected = ca.vertcat(*[ca.SX(U) for _, U in pool[3:]])
        at = rng.uniform(-1.0, 1.0, 3)
        count = tape.count(results)
        close(
            ca.Function("f", [x], [ca.vertcat(*tape.build(results))])(at),
            ca.Function("f", [x], [expected])(at),
            1e-12,
        )
        assert count == tape.count(results)
        slope = np.array(ca.Function("J", [x], [ca.densify(ca.jacobian(expected, x))])(at))
        by_rows = [ca.vertcat(*tape.build(tape.gradient(u, symbols))) for u in results]
        close(ca.Function("f", [x], [ca.horzcat(*by_rows).T])(at), slope, 1e-12)
        by_columns = [ca.vertcat(*tape.build(tape.tangents(results, u))) for u in symbols]
        close(ca.Function("f", [x], [ca.horzcat(*by_columns)])(at), slope, 1e-12)


def test_a_tape_folds_constants_shares_operations_and_counts_what_is_left() -> None:
    tape = Tape()
    x, y = tape.vector(ca.SX.sym("x", 2))

    def count(*results: Any) -> int:
        return tape.count(list(results))

    assert (x * 0.0, 0.0 * y, tape.inverse(4.0)) == (0.0, 0.0, 0.25)
    assert (
        count(x, 1.0 * x, x + 0.0, 0.0 + x, 5.0) == 0 and count(-x) == 1 and count(-1.0 * x) == 1
    )
    assert count(x + y) == count(y + x) == count(x + y, y + x) == 1
    assert count(x - y) == count(y - x) == count(-(x - y)) == 1
    assert count(-(x + y)) == 2 and count(x - y, y - x) == 2
    assert (
        count(x + x) == count(2.0 * x) == count(x + x, 2.0 * x) == 1
        and count(x - x) == 0
        and (x - x) == 0.0
    )
    assert count(2.0 * x + 3.0 * x) == count(5.0 * x) == 1 and count(3.0 * x - 2.0 * x) == 0
    assert count(2.0 * (3.0 * x)) == 1 and count(0.5 * (2.0 * x)) == 0 and count(-2.0 * x) == 1
    assert count(x * y, y * x) == 1 and count((-x) * y) == 2 and count((-x) * (-y)) == 1
    assert count(x + 1.0) == 1 and count(1.0 - x) == 2 and count(tape.inverse(x)) == 1
    assert (
        count(tape.sine(x), tape.sine(x, cosine=True)) == 0
        and count(tape.sine(x) * tape.sine(x)) == 1
    )
    assert tape.sine(-x).negative and not tape.sine(-x, cosine=True).negative
    assert tape.find_needed([x * y + 2.0 * y, 3.0]) == sorted(tape.find_needed([x * y + 2.0 * y]))
    assert tape.operands(x.node) == () and tape.operands((2.0 * x).node) == (x.node,)
    assert tape.gradient(3.0, [x, y]) == [0.0, 0.0] and tape.tangents([2.0, y], x) == [0.0, 0.0]
    assert tape.gradient(-x, [x, y, 7.0]) == [-1.0, 0.0, 0.0] and tape.tangents([-x], x) == [-1.0]
    with pytest.raises(ZeroDivisionError):
        tape.inverse(np.float64(0.0))  # type: ignore[arg-type]


def test_turns_moments_and_articulated_inertias_are_those_of_matrices() -> None:
    rng = np.random.default_rng(4)
    A = rng.normal(size=(3, 3))
    p = rng.normal(size=3)
    v = rng.normal(size=3)

    def skew(x: Any) -> np.ndarray:
        return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])

    for degrees in (0.0, 90.0, 180.0, 270.0, 33.0):
        c, s = newton_euler.turn_by(Tape(), np.radians(degrees % 90), int(degrees // 90) + 4)
        close([c, s], [np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        for axes, about in (((0, 1), "z"), ((1, 2), "x")):
            R = Rotation.from_euler(about, degrees, degrees=True).as_matrix()
            cos, sin = (round(x, 15) + 0.0 for x in (c, s))
            close(composite_body.rotate_in_plane(A.tolist(), *axes, cos, sin), R @ A @ R.T)
        twist = Rotation.from_euler("x", 20, degrees=True).as_matrix()
        lead = Rotation.from_euler("z", 35, degrees=True).as_matrix()
        ahead, about = ((np.cos(np.radians(x)), np.sin(np.radians(x))) for x in (35, 20))
        turn = newton_euler.Turn(ahead, about, c, s, 0.0, 0)
        R = lead @ twist @ Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        close(turn.back(v.tolist()), R @ v)
        close(turn.into(v.tolist()), R.T @ v)
        close(composite_body.rotate_back(turn, A.tolist()), R @ A @ R.T)
    body = dh_chain.inertia_of(random_body(rng))
    whole = composite_body.EMPTY + body
    moved = whole.shifted(p.tolist())
    expected = body.moved((np.eye(3), p))
    close(
        [moved.mass, *moved.first, *np.ravel(moved.second)],
        [expected.mass, *expected.first, *expected.second.ravel()],
    )
    close(composite_body.combine_axes(A.tolist(), v.tolist()), A.T @ v)
    zero = articulated_body._zero()
    own = articulated_body.Articulated(zero, zero, zero) + body
    tensor = np.trace(body.second) * np.eye(3) - body.second
    close(own.J, tensor)
    close(own.H, skew(body.first))
    close(own.M, body.mass * np.eye(3))
    J = tensor + np.eye(3)
    H = skew(body.first) + A
    M = np.diag([1.0, 2.0, 3.0]) + 0.1
    some = articulated_body.Articulated(J.tolist(), H.tolist(), M.tolist())
    assert some.shifted([0.0, 0.0, 0.0]) is some
    far = some.shifted(p.tolist())
    S = skew(p)
    close(far.M, M)
    close(far.H, H + S @ M)
    close(far.J, J + S @ H.T - H @ S - S @ M @ S)
    close(some.turned(turn).H, R @ H) and close(some.turned(turn).J, R @ J @ R.T)
    half = some.turned(turn).linear_turned(turn)
    close([half.J, half.H, half.M], [R @ J @ R.T, R @ H @ R.T, R @ M @ R.T])


# --- no robot falls back -------------------------------------------------------------------------

FORMS = (
    *FUNCTIONS,
    "forward_dynamics_tool_force",
    "tool_motion",
    "output_constraint",
    "inversion_jacobians",
    "inversion_rows",
)
# Operations of each of these functions; a change of them says why. Those that rounding on another
# processor changes are left out.
OPERATIONS: dict[str, tuple[int, ...]] = {
    "elbow": (13, 19, 6, 31, 49, 35, 49, 55, 52, 8, 10, 73, 34, 24, 34, 31),
    "planar5_nmp": (39, 37, 7, 61, 152, 98, 152, 126, 155, 13, 16, 154, 56, 41, 125, 65),
    "four_mass": (0, 0, 0, 7, 0, 9, 0, 48, 25, 3, 0, 50, 4, 6, 20, 25),
    "parallel": (183, 231, 10, 276, *[-1] * 6, 96, *[-1] * 5),  # (-1: not here)
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_no_robot_falls_back_to_longer_functions(name: str) -> None:
    if not version("casadi").startswith(f"{GOLDEN_CASADI}."):
        pytest.skip(f"counted with CasADi {GOLDEN_CASADI}")
    equations = equations_of(name) if name in ROBOTS else derive(name)
    assert functions.agrees(equations)
    expected = OPERATIONS[name]
    found = [
        recursive_function(equations, form) if n != -1 else None
        for form, n in zip(FORMS, expected, strict=True)
    ]
    assert tuple(-1 if f is None else operations_of(f) for f in found) == expected


def test_the_check_before_use_sees_errors_from_one_billionth_at_moderate_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    equations = equations_of("dense")
    names = ("inverse_dynamics", "mass_matrix", "forward_kinematics")
    right = {name: recursive_function(equations, name) for name in names}
    asked: list[np.ndarray] = []

    def agrees(wrong: str, factor: float) -> bool:
        def changed(_: Equations, name: str) -> Any:
            f = right[name]
            assert f is not None

            def call(given: list[np.ndarray]) -> list[ca.DM]:
                asked.append(np.ravel(given))
                results = f.call(given)
                return [
                    x * factor if name == wrong and k == len(results) - 1 else x
                    for k, x in enumerate(results)
                ]

            return Made(name_in=f.name_in, call=call)

        monkeypatch.setattr(functions, "recursive_function", changed)
        return functions.agrees(equations)

    assert agrees("", 1.0) and len(asked) == 9
    states_asked = np.concatenate(asked)
    assert (
        np.abs(states_asked).max() <= 1.0
        and np.ptp(states_asked) > 1.6
        and len({*map(tuple, asked)}) == 6
    )
    for name in names:
        assert agrees(name, 1 + 4e-10) and not agrees(name, 1 + 4e-9) and not agrees(name, np.nan)
