"""Each form of the recursions alone, with numbers instead of symbols: against the Lagrangian,
differences and SciPy.

A robot whose recursion is wrong uses the Lagrangian, which hides errors from tests of results:
here no form is compared with another that would replace it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from recursion_cases import dense_chain, robot
from referee import matrix, random_body, random_placement
from scipy.spatial.transform import Rotation

from flexgen.codegen.recursion import (
    articulated_body,
    composite_body,
    derivatives,
    dh_chain,
    functions,
    kinematics,
    newton_euler,
)
from flexgen.codegen.recursion.dh_chain import Chain, KeptInertia, make_chain, regroup
from flexgen.codegen.recursion.functions import fast_function, operations_of, recursive_function
from flexgen.codegen.recursion.regrouping import KEPT_ALL
from flexgen.codegen.recursion.tape import Tape
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


ROBOTS: dict[str, Callable[[], RobotModel]] = {
    "dense": lambda: dense_chain(4, 1),
    "sliding": lambda: dense_chain(5, 3, sliding=True),
    "parallel": parallel,
    "on points": on_points,
    "half empty": half_empty,
}
# Inertia that stays with its body; None: the chain as it is.
KEPT = {
    "all stays": None,
    "all moves": KeptInertia(),
    "all is kept": KEPT_ALL,
    "balanced": KeptInertia("balance"),
    "one kind": KeptInertia("none", True, False),
}
each_robot = pytest.mark.parametrize("name", ROBOTS)
each_grouping = pytest.mark.parametrize("kept", KEPT)


@cache
def equations_of(name: str) -> Equations:
    return derive(ROBOTS[name]())


@cache
def chain_of(name: str, kept: str) -> Chain:
    chain = make_chain(equations_of(name).model)
    inertia = KEPT[kept]
    return chain if inertia is None else regroup(chain, [inertia] * len(chain.joints))


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
@each_grouping
def test_torques_and_mass_matrices_are_the_lagrangians(name: str, kept: str) -> None:
    chain = chain_of(name, kept)
    n = len(chain.joints)
    still = [0.0] * n
    for s in states(name):
        for carried in ([True] * n, [False] * n, [k % 2 == 0 for k in range(n)]):
            found = newton_euler.inverse_dynamics(Tape(), chain, s.q, s.v, s.a, carried)
            close(found, torque(name, s.q, s.v, s.a))
        M = equations_of(name).function("mass_matrix")(s.q)
        for together in (True, False):
            close(composite_body.mass_matrix(Tape(), chain, s.q, together), M)

        def height(q: np.ndarray) -> np.ndarray:
            return np.array(composite_body.height(Tape(), chain, q.tolist()))

        close(difference(height, s.q), torque(name, s.q, still, still), 1e-9)


@cache
def slopes(name: str) -> list[np.ndarray]:
    """Of the Lagrangian's torques in q, v and a, by differences."""
    s = states(name, 1)[0]
    return [
        difference(lambda x: torque(name, x, s.v, s.a), s.q),
        difference(lambda x: torque(name, s.q, x, s.a), s.v),
        difference(lambda x: torque(name, s.q, s.v, x), s.a),
    ]


@each_robot
@each_grouping
@pytest.mark.parametrize("carried", [True, False])
def test_derivatives_are_differences_of_the_lagrangians_torques(
    name: str, kept: str, carried: bool
) -> None:
    s = states(name, 1)[0]
    chain = chain_of(name, kept)
    found = derivatives.derivatives(Tape(), chain, s.q, s.v, s.a, [carried] * len(s.q))
    for x, y in zip(found, slopes(name), strict=True):
        close(x, y, 1e-9)


@each_robot
@each_grouping
@pytest.mark.parametrize("rotors", ["none", "last", "all"])
def test_accelerations_balance_the_torques(name: str, kept: str, rotors: str) -> None:
    chain = chain_of(name, kept)
    n = len(chain.joints)
    armature = {"none": [0.0] * n, "last": [0.0] * (n - 1) + [0.7]}.get(
        rotors, [0.3 + k for k in range(n)]
    )
    for s in states(name):
        M = np.array(equations_of(name).function("mass_matrix")(s.q)) + np.diag(armature)
        left = np.array(s.a) - torque(name, s.q, s.v, [0.0] * n)
        turns = [
            newton_euler.turn_of(Tape(), joint, q)
            for joint, q in zip(chain.joints, s.q, strict=True)
        ]
        moving = newton_euler.motions(Tape(), chain, turns, s.q, s.v, [0.0] * n, [True] * n)
        loads = newton_euler.loads(chain, moving)
        found = articulated_body.forward_dynamics(Tape(), chain, s.q, loads, turns, s.a, armature)
        close(found, np.linalg.solve(M, left), 1e-9)
        solved = articulated_body.solve_symmetric(Tape(), M.tolist(), left.tolist())
        close(solved, np.linalg.solve(M, left), 1e-9)


@pytest.mark.parametrize(
    ("name", "kept", "rotor", "joined"),
    [
        ("on points", "all stays", None, [2, 3, 5, 6]),
        ("on points", "all stays", 6, [2, 3]),
        ("on points", "all moves", None, []),
        ("dense", "all stays", None, []),
    ],
)
def test_joints_on_one_point_without_a_body_or_rotor_are_joined(
    name: str, kept: str, rotor: int | None, joined: list[int]
) -> None:
    """Both points, that before the rotor alone, and none where the groupings fill empty bodies."""
    chain = chain_of(name, kept)
    armature = [0.7 * (k == rotor) for k in range(len(chain.joints))]
    found = articulated_body.find_joints_on_one_point(chain, armature)
    assert [k for k, x in enumerate(found) if x] == joined


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
    zero = [[0.0] * 3] * 3
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
    close(some.turned(turn).H, R @ H)
    close(some.turned(turn).J, R @ J @ R.T)
    half = some.turned(turn).linear_turned(turn)
    close([half.J, half.H, half.M], [R @ J @ R.T, R @ H @ R.T, R @ M @ R.T])


# --- no robot falls back -------------------------------------------------------------------------
USED = ("bias", "gravity", "inverse_dynamics", "mass_matrix", "forward_kinematics", "jacobian")
USED += ("inverse_dynamics_derivatives", "arm_forward_dynamics", "tool_motion")


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp", "four_mass", "parallel"])
def test_no_robot_falls_back_to_longer_functions(name: str) -> None:
    """Where a recursion is wrong or longer, the Lagrangian would take its place."""
    equations = equations_of(name) if name in ROBOTS else derive(name)
    assert functions.agrees(equations)
    for form in USED:
        fast = fast_function(equations, form)
        assert fast is not None and fast is recursive_function(equations, form)
        assert operations_of(fast) <= operations_of(equations.function(form))


@pytest.mark.parametrize("name", ["inverse_dynamics", "mass_matrix", "forward_kinematics"])
@pytest.mark.parametrize(
    ("factor", "agrees"), [(1 + 4e-10, True), (1 + 4e-9, False), (np.nan, False)]
)
def test_the_check_before_use_sees_errors_from_one_billionth_at_moderate_states(
    monkeypatch: pytest.MonkeyPatch, name: str, factor: float, agrees: bool
) -> None:
    """Planted in the last result of one function; three states of each are asked for."""
    equations = equations_of("dense")
    asked: list[np.ndarray] = []

    def changed(_: Equations, form: str) -> Any:
        f = recursive_function(equations, form)
        assert f is not None

        def call(given: list[np.ndarray]) -> list[ca.DM]:
            asked.append(np.ravel(given))
            *others, last = f.call(given)
            return [*others, last * factor if form == name else last]

        return Made(name_in=f.name_in, call=call)

    monkeypatch.setattr(functions, "recursive_function", changed)
    assert functions.agrees(equations) == agrees
    if agrees:
        entries = np.concatenate(asked)
        assert len(asked) == 9 and len({*map(tuple, asked)}) == 6
        assert np.abs(entries).max() <= 1.0 and np.ptp(entries) > 1.6
