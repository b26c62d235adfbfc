"""Numbers of the rooms mechanics, analysis, codegen, inverse_kinematics and expressions by other
routes.

Balances of energy and of torques, polynomials with known roots, cases by hand.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.analysis.linear import LinearModel, linearize
from flexgen.analysis.zero_dynamics import solvability, zeros, zeros_along_path
from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission.kinematic_functions import kinematic_constants
from flexgen.codegen.emission.motor_constants import motor_constants
from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import Block, Routine, Solve, Zeros
from flexgen.dynamics.mechanics import outputs, parameters, statics
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.identification.rigid.mean_friction import is_linear
from flexgen.model.elements import Body, Friction, Gear, RobotModel
from flexgen.paths.geometry.segments import Line, circle_through
from flexgen.paths.inverse_kinematics import targets

TAU = 2 * np.pi


def loaded() -> RobotModel:
    """A robot with everything that stores or takes energy: payload, drag, frictions,
    counterbalances, soft joints.
    """
    robot = flexgen.read("planar5_nmp")
    elements = []
    for k, element in enumerate(robot.elements):
        dofs = tuple(
            replace(
                dof,
                friction=Friction(viscous=0.3, coulomb=0.5, beta=3.0, offset=0.2 + k),
                counterbalance=((4.0, -2.0), (1.0, 3.0)),
            )
            for dof in element.dofs
        )
        body = replace(element.body, rotational_drag=0.4 + 0.1 * k)
        elements.append(replace(element, dofs=dofs, body=body))
    motors = tuple(
        replace(m, friction=Friction(viscous=0.01, coulomb=0.1, beta=4.0, offset=0.3))
        for m in robot.motors
    )
    payload = Body(
        0.7, (0.05, 0.02, 0.1), ((0.02, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.01)), 0.2
    )
    return replace(
        robot, elements=tuple(elements), motors=motors, payload=payload, gravity=(0.0, -3.0, -9.0)
    )


def test_a_payload_is_a_body_on_the_last_element_and_energies_balance() -> None:
    """By differences along the motion: springs, counterbalances, drags and frictions of joints and
    motors.
    """
    model = loaded()
    n_a = model.n_a
    n_m = model.n_m
    rng = np.random.default_rng(3)
    equations = Equations(model)
    lag = equations.lagrangian
    x = [0.3 * rng.standard_normal(n) for n in (n_a, n_a, n_m, n_m)]
    x[2] = model.eta @ (x[0][list(model.i_g)] + 1e-3)
    tau = rng.standard_normal(n_m)
    names = ("kinetic", "potential", "power_motor", "power_dissipated")
    state = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m, lag.tau_m]
    parts = ca.Function("parts", state, [getattr(lag, name) for name in names])
    a_a, a_m = (np.array(a).ravel() for a in equations.function("forward_dynamics")(*x, tau))

    def energy(h: float) -> float:
        moved = [
            x[0] + h * x[1] + h**2 / 2 * a_a,
            x[1] + h * a_a,
            x[2] + h * x[3] + h**2 / 2 * a_m,
            x[3] + h * a_m,
        ]
        return sum(float(part) for part in parts(*moved, tau)[:2])

    into, lost = (float(part) for part in parts(*x, tau)[2:])
    h = 1e-5
    rate = (8 * (energy(h) - energy(-h)) - (energy(2 * h) - energy(-2 * h))) / (12 * h)
    assert rate == pytest.approx(into - lost, rel=1e-7)
    last = model.elements[-1]
    load = model.payload
    assert last.beam is None and last.body.mass > 0
    mass = last.body.mass + load.mass
    com = (last.body.mass * np.array(last.body.com) + load.mass * np.array(load.com)) / mass
    tensor = np.zeros((3, 3))
    for body in (last.body, load):
        r = np.array(body.com) - com
        tensor += np.array(body.inertia) + body.mass * (r @ r * np.eye(3) - np.outer(r, r))
    drag = last.body.rotational_drag + load.rotational_drag
    one = Body(mass, tuple(com.tolist()), tuple(map(tuple, tensor.tolist())), drag)
    joined = replace(
        model, elements=(*model.elements[:-1], replace(last, body=one)), payload=Body()
    )
    lag = Equations(joined).lagrangian
    state = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m, lag.tau_m]
    again = ca.Function("parts", state, [getattr(lag, name) for name in names])(*x, tau)
    assert_allclose([float(y) for y in again], [float(y) for y in parts(*x, tau)], rtol=1e-12)


def test_an_equilibrium_stays_at_rest_under_its_torques() -> None:
    """Forward dynamics at the equilibrium, from a start far away: gravity, frictions at rest, soft
    joints, payload.
    """
    equations = Equations(loaded())
    model = equations.model
    zero = np.zeros(model.n_a)
    for start in (None, 0.3 * np.ones(model.n_e)):
        found = statics.hold_joints(equations, np.array([0.4, -0.7][: model.n_g]), start)
        a_a, a_m = equations.function("forward_dynamics")(
            found.q_a, zero, found.q_m, np.zeros(model.n_m), found.tau_m
        )
        assert np.abs(np.array(a_a)).max() < 1e-8 and np.abs(np.array(a_m)).max() < 1e-8
        assert_allclose(found.q_a[list(model.i_g)], [0.4, -0.7][: model.n_g])
        assert np.abs(found.q_a[list(model.i_e)]).min() > 1e-4
        torque = np.array(
            equations.function("gear_law")(
                np.linalg.solve(model.eta, found.q_m) - found.q_a[list(model.i_g)]
            )[0]
        )
        assert_allclose(torque.ravel(), found.tau_g, rtol=1e-9)


def test_a_pose_error_is_the_sine_of_the_angle_about_its_axis() -> None:
    from scipy.spatial.transform import Rotation

    R = Rotation.random(random_state=1)
    E = Rotation.from_rotvec([0.2, -0.3, 0.4])
    place = np.array([1.0, 2.0, 3.0])
    target = np.array([0.5, 2.5, 2.0])
    flat = np.concatenate([target, R.as_matrix().T.ravel()])
    symbols = [ca.SX.sym("p", 3), ca.SX.sym("R", 3, 3), ca.SX.sym("t", 12)]
    f = ca.Function("f", symbols, [outputs.pose_error(*symbols)])
    angle = np.linalg.norm(E.as_rotvec())
    found = np.array(f(place, (E * R).as_matrix(), flat)).ravel()
    assert_allclose(
        found, [*(place - target), *(np.sin(angle) / angle * E.as_rotvec())], atol=1e-12
    )


def test_unknown_parameters_are_answered_with_the_names_of_groups() -> None:
    robot = flexgen.read("elbow")
    with pytest.raises(ArgumentError) as told:
        parameters.select(robot, ["stifness"])
    text = str(told.value)
    assert text.startswith("parameters: given 'stifness', expected some of ")
    listed = text.removeprefix("parameters: given 'stifness', expected some of ").split(", ")
    assert (
        listed == sorted(listed)
        and "stiffness" in listed
        and "payload" in listed
        and "payload.mass" in listed
    )
    assert "upper.mass" not in listed  # in no group: too many to list
    chosen = parameters.select(robot, ["upper.mass", "payload.mass"])
    assert [(p.name, p.unit, p.inertia) for p in chosen if p.name == "upper.mass"] == [
        ("upper.mass", "kg", True)
    ]
    assert [p.inertia for p in chosen if p.name == "payload.mass"] == [False]


# --- analysis ------------------------------------------------------------------------------------


def exact_zeros(at: LinearModel, count: int) -> np.ndarray:
    """The ``count`` zeros, from the determinant at count + 1 points, a polynomial, in 60
    digits.
    """
    with mpmath.workdps(60):
        M, D, K, B, W = (mpmath.matrix(x.tolist()) for x in (at.M, at.D, at.K, at.B, at.W))
        n, m = at.B.shape

        def determinant(s: Any) -> Any:
            pencil = mpmath.zeros(n + m)
            pencil[:n, :n] = M * s**2 + D * s + K
            pencil[:n, n:] = B
            pencil[n:, :n] = W
            return mpmath.det(pencil)

        points = [mpmath.mpf(300 * k) for k in range(count + 1)]
        powers = mpmath.matrix([[p ** (count - k) for k in range(count + 1)] for p in points])
        values = [determinant(p) for p in points]
        polynomial = list(mpmath.lu_solve(powers, mpmath.matrix(values)))
        further = mpmath.mpf(-777)
        assert mpmath.polyval(polynomial, further) == pytest.approx(
            determinant(further), rel=1e-30
        )
        return np.array([complex(r) for r in mpmath.polyroots(polynomial, 500, extraprec=500)])


@pytest.mark.parametrize("phase", ["minimum phase", "non-minimum phase"])
def test_zeros_of_robots_whose_rotors_turn_with_the_arm_are_those_of_the_pencil(
    phase: str,
) -> None:
    """Roots of det [[M s^2 + D s + K, B], [W, 0]] in 60 digits.

    A double one is accurate to the root of rounding. They do not depend on a library of linear
    algebra: an eigenvalue solver for this pencil is off by 1.5e-5 with the kernels of some
    processors.
    """
    turning = {
        "motor_coupling": "complete",
        "motor.m1.carrier": "base",
        "motor.m2.carrier": "arm1",
    }
    turning |= {"motor.m1.axis": [0, 0, 1], "motor.m2.axis": [0, 0, 1]}
    robot = flexgen.read(
        "planar5_mp" if phase == "minimum phase" else "planar5_nmp", overrides=turning
    )
    equations = flexgen.derive(robot)
    rest = statics.hold_joints(equations, np.array(robot.home))
    at = linearize(equations, rest)
    report = zeros.zero_report(equations, at, rest)
    roots = exact_zeros(at, 4)
    assert len(report.zeros) == 4 and report.phase == phase
    for root in roots:
        others = np.delete(roots, np.abs(roots - root).argmin())
        double = np.abs(others - root).min() < 1e-9 * abs(root)
        assert np.abs(report.zeros - root).min() < (1e-5 if double else 1e-8) * abs(root)
    unstable = roots.real.max() if phase.startswith("non") else np.inf
    assert report.unstable_time_constant_s == pytest.approx(1 / unstable, rel=1e-6)
    assert report.preview_s == pytest.approx(np.log(1e6) / unstable, rel=1e-6)


def test_zeros_of_pencils_and_state_spaces_are_the_roots_of_their_polynomials() -> None:
    """Also with a singular leading matrix, very different units, and systems without zeros or
    without an answer.
    """
    rng = np.random.default_rng(4)
    T = rng.normal(size=(3, 3))
    S = rng.normal(size=(3, 3))
    polynomials = [(2.0, 0.4, 50.0), (0.0, 3.0, -12.0), (1e-6, 1e-3, 5.0)]
    A, D, K = (T @ np.diag([p[k] for p in polynomials]) @ S for k in range(3))
    expected = np.concatenate(
        [np.roots(p) for p in ((2.0, 0.4, 50.0), (3.0, -12.0), (1e-6, 1e-3, 5.0))]
    )
    for scale in (1.0, 1e9):
        found = zeros.pencil_zeros(scale * A, scale * D, scale * K)
        assert found is not None
        assert_allclose(np.sort_complex(found), np.sort_complex(expected), rtol=1e-7)
    assert zeros.pencil_zeros(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2))) is None
    one = np.eye(1)
    for args, roots in (
        ((0 * one, one, 0 * one), [0.0]),
        ((one, 0 * one, 0 * one), [0.0, 0.0]),
        ((0 * one, 0 * one, one), []),
    ):
        found = zeros.pencil_zeros(*args)
        assert found is not None
        assert_allclose(found, roots, atol=1e-9)
    # (s + 2)(s - 3) / ((s + 1)(s + 4)(s + 5)) in controller form, hidden by a change of states and
    # of units
    plant = np.array([[-10.0, -29.0, -20.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    B = np.array([[1.0], [0.0], [0.0]])
    C = np.array([[1.0, -1.0, -6.0]])
    change = T @ np.diag([1.0, 1e4, 1e-3])
    back = np.linalg.inv(change)
    found = zeros._invariant_zeros(change @ plant @ back, change @ B, C @ back, np.zeros((1, 1)))
    assert found is not None
    assert_allclose(np.sort_complex(found), [-2.0, 3.0], rtol=1e-6)
    assert zeros._invariant_zeros(plant, B, np.zeros((1, 3)), np.zeros((1, 1))) is None
    found = zeros._invariant_zeros(plant, B, C, 2.0 * np.eye(1))
    assert_allclose(
        np.sort_complex(found), np.sort_complex(np.roots([2.0, 21.0, 57.0, 34.0])), rtol=1e-9
    )
    assert (
        len(zeros._invariant_zeros(plant, B, np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 1)))) == 0
    )


def path_of(changes: int, **rest: Any) -> Any:
    made = [
        zeros_along_path.Change(0.1 * k, k, k + 1, zeros_along_path.AXIS) for k in range(changes)
    ]
    plain = {
        "phase": "non-minimum phase",
        "slowest": 2.0,
        "fastest": 8.0,
        "slowest_stable": 3.0,
        "preview_s": 0.5,
        "unstable": np.array([1, 2]),
        "sigma_min": np.ones(2),
        "methods": ("lq", "bvp"),
        "changes": tuple(made),
    }
    return Made(**{**plain, **rest})


def test_verdicts_of_zeros_along_a_path_name_rates_changes_and_methods() -> None:
    def told(path: Any, sign: Any = (1.0, 1.0)) -> list[str]:
        return zeros_along_path._sentence(path, np.array([4, 4]), np.array(sign)).split("; ")

    head = [
        "non-minimum phase: 1 to 2 of 4 zeros unstable, 2..8 1/s",
        "preview required for exact tracking 500 ms",
    ]
    one = f"0 to 1 unstable at t = 0 s, through {zeros_along_path.AXIS}"
    assert told(path_of(0)) == [*head, "use lq or bvp"] and told(path_of(1)) == [
        *head,
        one,
        "use lq or bvp",
    ]
    assert (
        len(told(path_of(3))) == 6
        and told(path_of(4))[5] == "1 more changes"
        and told(path_of(9))[5] == "6 more changes"
    )
    assert told(path_of(0, fastest=2.009))[0].endswith("unstable, 2 1/s") and told(
        path_of(0, fastest=2.011)
    )[0].endswith("2..2.01 1/s")
    assert told(path_of(0), (0.0, 1.0))[2] == "a zero at infinity at 1 poses"
    assert told(path_of(0), (0.0, 0.0))[2] == "a zero at infinity at all poses"
    near = zeros_along_path.NEAR
    assert told(path_of(0, sigma_min=np.array([1.0, 0.5 * near])))[2] == "a zero near infinity"
    assert told(path_of(0, sigma_min=np.array([1.0, near])))[2] == "use lq or bvp"
    assert "a zero near infinity" not in told(path_of(1, sigma_min=np.array([1.0, 0.5 * near])))
    stable = path_of(0, phase="minimum phase")
    assert told(stable)[0] == "minimum phase: all 4 zeros stable, the slowest 3 1/s"
    assert told(path_of(0, phase="minimum phase", slowest_stable=None))[0].endswith(
        "stable, on the imaginary axis"
    )
    assert told(path_of(0, phase="flat")) == [
        "flat: no zeros",
        "the torque follows from the path and its derivatives alone",
        "use closed-form",
    ]


def test_results_of_zeros_along_a_path_follow_from_their_roots() -> None:
    t = np.array([0.0, 1.0, 2.0])
    q = np.zeros((3, 1))

    def made(
        roots: list[list[complex]],
        sigma: Any = (1.0, 1.0, 1.0),
        sign: Any = (1.0, 1.0, 1.0),
        n_e: int = 1,
    ) -> Any:
        return zeros_along_path._result(
            n_e, t, q, [np.array(r, complex) for r in roots], np.array(sigma), np.array(sign)
        )

    right = made([[5.0, -2.0], [4.0, -1.0], [8.0, -3.0]])
    assert (right.phase, right.slowest, right.fastest, right.slowest_stable) == (
        "non-minimum phase",
        4.0,
        8.0,
        -1.0 * -1.0,
    )
    assert (
        right.unstable.tolist() == [1, 1, 1]
        and right.methods == ("lq", "bvp")
        and right.changes == ()
    )
    assert right.preview_s == zeros_along_path.preview(0.25)
    left = made([[-5.0], [-2.0], [-3.0]])
    assert (left.phase, left.slowest, left.slowest_stable, left.preview_s) == (
        "minimum phase",
        None,
        2.0,
        0.0,
    )
    assert left.methods == ("lq", "bvp", "reduced") and made([[], [], []], n_e=0).methods == (
        "closed-form",
    )
    assert made([[], [], []]).phase == "flat"
    assert made(
        [[-5.0], [-2.0], [-3.0]], sigma=(1.0, 0.5 * zeros_along_path.NEAR, 1.0)
    ).methods == ("lq",)
    crossing = made([[-1.0], [0.5], [0.5]])
    (change,) = crossing.changes
    assert (change.t, change.before, change.after, change.through) == (
        0.5,
        0,
        1,
        zeros_along_path.AXIS,
    )
    assert crossing.preview_s == min(zeros_along_path.preview(2.0), 2.0) and crossing.methods == (
        "lq",
    )
    through = made([[-9.0], [9.0], [9.0]], sigma=(0.1, 0.3, 0.3), sign=(1.0, -1.0, -1.0))
    assert [(c.t, c.through) for c in through.changes] == [
        (pytest.approx(0.25), zeros_along_path.INFINITY)
    ]
    lost = made([[-1.0], [0.5, -2.0], [0.5, -2.0]])
    assert (
        lost.zeros[0, 1] == complex(np.inf, 0.0)
        and lost.changes[0].through == zeros_along_path.INFINITY
    )


def test_the_largest_entries_of_a_vector_are_named_in_order() -> None:
    names = ["a", "b", "c", "d", "e", "f"]
    least = solvability.ALONE
    assert (
        solvability._name_largest(np.array([0.1 * least, -8.0, 4.0, 0.0, 0.0, 0.0]), names)
        == "b, c"
    )
    assert (
        solvability._name_largest(np.array([-1.0, 0.99, 0.98, 0.97, 0.96, 0.95]), names)
        == "a, b, c, d"
    )
    assert (
        solvability._name_largest(np.array([0.5 * least, 1.01 * least, 1.0, 0, 0, 0]) * 1e3, names)
        == "c, b"
    )


# --- tables and poses ----------------------------------------------------------------------------


def slider(lower: float | None, upper: float | None, unit: str = "m") -> Any:
    return Made(unit=unit, dof=Made(lower=lower, upper=upper))


def test_starts_of_slides_are_spread_between_their_limits_and_of_rotations_over_a_turn() -> None:
    cases = [
        slider(None, None),
        slider(0.5, None),
        slider(None, 0.5),
        slider(0.1, 0.4),
        slider(-1.0, 1.0, "rad"),
        Made(unit="m", dof=None),
    ]
    found = kinematic_constants(Made(coordinates=cases, n_a=6, i_g=np.array([0, 2])))
    assert found.lower == (-1.0, 0.5, -1.5, 0.1, -np.pi, -1.0) and found.upper == (
        1.0,
        2.5,
        0.5,
        0.4,
        np.pi,
        1.0,
    )
    assert found.around == (True, False, False, False, False, True)
    assert found.is_rotation == (False, False, False, False, True, False) and found.i_g == (0, 2)


def test_turns_are_those_asked_for_or_the_closest_within_the_limits() -> None:
    def chosen(
        q: float, before: float, turns: tuple[int, ...] = (), **limits: Any
    ) -> float | None:
        coordinate = slider(limits.get("lower"), limits.get("upper"), limits.get("unit", "rad"))
        model: Any = Made(i_g=(0,), coordinates=[coordinate])
        found = targets._choose_turns(model, np.array([q]), np.array([before]), turns)
        return None if found is None else float(found[0])

    assert chosen(0.5, 0.0) == pytest.approx(0.5) and chosen(0.5, 4.0) == pytest.approx(0.5 + TAU)
    assert chosen(0.5 + 3 * TAU, -6.0) == pytest.approx(0.5 - TAU)
    assert chosen(3.5, 0.0) == pytest.approx(3.5 - TAU) and chosen(
        3.5, 0.0, (1,)
    ) == pytest.approx(3.5)
    assert chosen(0.5, 0.0, (-2,)) == pytest.approx(0.5 - 2 * TAU) and chosen(
        0.5, 9.0, (0,)
    ) == pytest.approx(0.5)
    assert chosen(0.5, 0.0, lower=1.0) == pytest.approx(0.5 + TAU) and chosen(
        0.5, 0.0, upper=0.0
    ) == pytest.approx(0.5 - TAU)
    assert (
        chosen(0.5, 0.0, lower=8.0) == pytest.approx(0.5 + 2 * TAU)
        and chosen(0.5, 0.0, lower=20.0) is None
    )
    assert (
        chosen(0.5, 0.0, lower=1.0, upper=6.0) is None
        and chosen(0.5, 0.0, (1,), upper=3.0) is None
    )
    assert (
        chosen(0.5, 0.0, lower=0.5 + 0.5 * targets.SLACK) == 0.5
        and chosen(0.5, 0.0, lower=0.5 + 2 * targets.SLACK, upper=1.0) is None
    )
    assert chosen(0.5, 9.0, unit="m") == 0.5 and chosen(0.5, 0.0, unit="m", upper=0.4) is None


def test_solutions_of_a_routine_go_to_the_blocks_of_their_ports() -> None:
    A = np.array([[4.0, 1.0], [1.0, 3.0]])
    R = np.arange(6.0).reshape(2, 3)
    blocks = (Block("a", 0, 0, 2), Block("a", 2, 2, 1), Block("b", 1, 3, 2))
    solve = Solve("A", "R", 2, 3, True, (0, 0), blocks, ones=(("b", 0, 1), ("a", 5, 0)))
    found = evaluate_routine(Routine((Zeros("z", 2, 3), solve)), {"A": np.triu(A), "R": R})
    X = -np.linalg.solve(A, np.hstack([R, -np.eye(2)]))
    expected = np.zeros((6, 3))
    expected[:2, :2] = X[:, :2]
    expected[2:4, 2:] = X[:, 2:3]
    expected[5, 0] = 1.0
    assert_allclose(found["a"], expected)
    assert_allclose(found["b"], [[0.0, 1.0], *X[:, 3:]])
    assert found["z"].shape == (2, 3) and not found["z"].any()
    assert solve.ports == ("a", "b") and solve.width == 5


def test_a_line_is_as_long_as_its_path_or_as_its_rotation_on_the_radius() -> None:
    total = np.array([0.3, 0.0, -0.4])
    turn = np.array([0.0, 1.5, 2.0])
    # no radius: no length
    assert (Line(total, turn).length, Line(0 * total, turn).length) == (pytest.approx(0.5), 1.0)
    assert (
        Line(total, turn, 0.1).length == pytest.approx(0.5)
        and Line(total, turn, 0.1).by_arc_length
    )
    assert (
        Line(total, turn, 0.3).length == pytest.approx(0.75)
        and not Line(total, turn, 0.3).by_arc_length
    )
    assert (
        Line(total, 0 * turn, largest=True).length == 0.4
        and not Line(total, 0 * turn, largest=True).by_arc_length
    )
    assert (
        not Line(0 * total, turn, 0.3).by_arc_length
        and not Line(0 * total, 0 * turn).by_arc_length
    )


@pytest.mark.parametrize("angle", [0.5, 2.0, 3.1, 5.5])
def test_a_circle_goes_through_three_points(angle: float) -> None:
    """Radius 2 about (0, 2, 0) from the origin, in the plane z = 0; ``via`` at 0.3 of the
    angle.
    """
    on = [np.array([2 * np.sin(x), 2 - 2 * np.cos(x), 0.0]) for x in (0.3 * angle, angle)]
    found = circle_through(*on)
    assert found is not None
    center, axis, turned = found
    assert_allclose(center, [0.0, 2.0, 0.0], atol=1e-12)
    assert_allclose(axis, [0.0, 0.0, 1.0], atol=1e-12)
    assert turned == pytest.approx(angle, rel=1e-12)


def test_points_that_coincide_or_lie_on_a_line_have_no_circle() -> None:
    far = np.array([1.0, 0.0, 0.0])
    near = np.array([1.0, 1e-10, 0.0])
    assert circle_through(far, near) is None and circle_through(far, 2 * far) is None
    assert circle_through(1e-10 * far + 1e-10 * near[[1, 0, 2]], far) is None
    # almost a full line, but a circle
    assert circle_through(far, np.array([-1.0, 1e-6, 0.0])) is not None


@pytest.mark.parametrize("side", ["arm", "motor"])
def test_constants_of_motors_are_those_of_their_gears(side: str) -> None:
    """A damper of the motor side acts on the arm by the ratio squared; a rigid gear has none,
    whatever it states.
    """
    model = flexgen.read("elbow")
    gear = replace(model.elements[1].dofs[0].gear, side=side, damping=3.0)
    dofs = [
        replace(e.dofs[0], gear=g)
        for e, g in zip(model.elements, (Gear(True, side, None, 7.0), gear), strict=True)
    ]
    elements = tuple(replace(e, dofs=(dof,)) for e, dof in zip(model.elements, dofs, strict=True))
    made = motor_constants(replace(model, elements=elements))
    factor = 1.0 if side == "arm" else model.eta[1, 1] ** 2
    assert made.gear_damping == (0.0, pytest.approx(3.0 * factor))
    assert made.damping_factor == (0.0, pytest.approx(factor)) and made.gear_is_rigid == (
        True,
        False,
    )
    assert_allclose(np.array(made.eta) @ np.array(made.eta_inverse), np.eye(2), atol=1e-12)
    assert made.rotor_inertia == tuple(m.inertia for m in model.motors) and made.gears == (
        "q1",
        "q2",
    )


def test_only_viscous_friction_is_linear() -> None:
    assert (
        is_linear(Friction(viscous=0.5))
        and is_linear(Friction())
        and is_linear(Friction(0.5, offset=2.0))
    )
    assert not is_linear(Friction(viscous=0.5, coulomb=0.1, beta=2.0))
