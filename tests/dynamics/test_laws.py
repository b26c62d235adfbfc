"""Laws of mechanics, on every model of the collection and on synthetic chains; each law fails on a
planted bug.

A check is a function of the answers to be judged (`referee.Answers`), a model and some random
states. It raises AssertionError where the law is broken; the controls hand it answers with a bug
and expect just that.
"""

from __future__ import annotations

import numpy as np
import pytest
from planted_bugs import (
    ANGULAR,
    asymmetric_mass,
    indefinite_mass,
    light_mass,
    scaled,
    slow_forward_dynamics,
    trusting_motors,
    wrong_coriolis,
    wrong_gravity,
)
from referee import (
    ALL_MODELS,
    Answers,
    State,
    answers,
    assert_close,
    model_of,
    random_state,
    twist_size,
)
from scipy.integrate import solve_ivp

from flexgen.model.elements import BacklashSpring, RobotModel, Spring

# the same expression evaluated along another route: rounding of some hundred operations
EXACT = 1e-12
SOLVED = 1e-9  # through a linear system whose condition number may reach 1e5
# fourth-order central differences at the step below: truncation and rounding are both smaller
DIFFERENCE = 1e-8
# the same for the accelerations, where friction bends over a few hundredths of a rad/s
LINEAR = 1e-6
ENERGY = 1e-8  # of the energy that moves, for an integration with a relative tolerance of 1e-12
# [rad or m] of the differences: (10 STEP)^4 = 1e-12 for shapes that vary over a tenth of their
# unit
STEP = 1e-4
FINE = 1e-5  # the same for the accelerations: friction varies over a fiftieth of a rad/s
# relative error of one evaluation of the accelerations, of stiff springs behind which positions
# round
ROUNDING = 1e-12

STATES = 5


def states(model: RobotModel, n: int = STATES, seed: int = 20) -> list[State]:
    rng = np.random.default_rng(seed)
    return [random_state(model, rng) for _ in range(n)]


def slope(function, h: float):
    """Derivative of ``function(s)`` at s = 0: central differences of fourth order."""
    return (8 * (function(h) - function(-h)) - (function(2 * h) - function(-2 * h))) / (12 * h)


def joined(values) -> np.ndarray:
    return np.concatenate([np.ravel(x) for x in values])


def spring_step(spring: Spring | None, largest: float) -> float:
    """A difference step well inside the rounding of a sharp spring."""
    if isinstance(spring, BacklashSpring):
        return min(largest, 0.003 * spring.smoothing)
    return largest if spring is None else min(largest, 0.002 * twist_size(spring))


def steps(model: RobotModel, largest: float) -> tuple[np.ndarray, np.ndarray]:
    """Difference steps for each of q_a and of q_m: those of a motor move its joints by as much."""
    h = {}
    for c in model.coordinates:
        h[c.name] = spring_step(
            None if c.dof is None else c.dof.spring or c.dof.gear.spring, largest
        )
        if c.dof is not None and c.dof.gear is not None and c.dof.gear.side == "motor":
            h[c.name] /= max(
                abs(r)
                for m in model.motors
                for n, r in zip(m.drives, m.ratio, strict=True)
                if n == c.name
            )
    motors = [min(h[name] for name in m.drives) * max(map(abs, m.ratio)) for m in model.motors]
    return np.array(list(h.values())), np.array(motors)


# --- the checks ----------------------------------------------------------------------------------


def check_mass_matrix(a: Answers, model: RobotModel, some: list[State]) -> None:
    """M is symmetric and positive definite."""
    for s in some:
        M = a.mass_matrix(s.q_a)
        assert np.all(np.diag(M) > 0)
        size = np.sqrt(np.diag(M))
        M = M / np.outer(size, size)
        assert_close(M, M.T, EXACT)
        assert np.linalg.eigvalsh(M)[0] > 1e-9  # an arm whose coordinates can be told apart


def check_forward_inverse(a: Answers, model: RobotModel, some: list[State]) -> None:
    """``M^-1 (tau - h) = a_a`` for ``tau`` from the inverse dynamics."""
    for s in some:
        tau = a.inverse_dynamics(s.q_a, s.v_a, s.a_a)
        assert_close(
            np.linalg.solve(a.mass_matrix(s.q_a), tau - a.bias(s.q_a, s.v_a)), s.a_a, SOLVED
        )
        assert_close(
            a.inverse_dynamics(s.q_a, 0 * s.v_a, 0 * s.a_a),
            a.gravity(s.q_a),
            EXACT,
            np.abs(tau).max(),
        )
        assert_close(a.bias(s.q_a, 0 * s.v_a), a.gravity(s.q_a), EXACT, np.abs(tau).max())


def check_residual(a: Answers, model: RobotModel, some: list[State]) -> None:
    """The residual vanishes at the accelerations of the forward dynamics, and only there."""
    for s in some:
        a_a, a_m = a.forward_dynamics(*s.x, s.tau_m)

        def residual(a_a, a_m, s=s):
            return joined(a.residual(s.q_a, s.v_a, a_a, s.q_m, s.v_m, a_m, s.tau_m))

        zero = residual(a_a, a_m)
        still = residual(0 * a_a, 0 * a_m)
        assert np.abs(still).max() > 0
        assert_close(zero, 0 * zero, SOLVED, np.abs(still).max())
        away = residual(a_a + s.a_a, a_m + s.tau_m)
        assert np.abs(away).max() > 1e-6 * np.abs(still).max()
        rigid = [j for j in range(model.n_m) if j not in model.i_m]
        assert_close(a_m[rigid], (model.eta @ a_a[list(model.i_g)])[rigid], EXACT)


def check_ignored(a: Answers, model: RobotModel, some: list[State]) -> None:
    """Motor positions and speeds behind rigid gears follow the joints, whatever is given for
    them.
    """
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    for s in some:
        q_m = s.q_m.copy()
        v_m = s.v_m.copy()
        q_m[rigid] = 7.0
        v_m[rigid] = -9.0
        there = (s.q_a, s.v_a, q_m, v_m)
        other = s.x
        assert_close(
            joined(a.forward_dynamics(*there, s.tau_m)),
            joined(a.forward_dynamics(*other, s.tau_m)),
            0.0,
        )
        assert_close(a.energy(*there), a.energy(*other), 0.0)
        assert_close(a.power(*there, s.tau_m), a.power(*other, s.tau_m), 0.0)
        assert_close(a.gear_torque(*there), a.gear_torque(*other), 0.0)


def check_passivity(a: Answers, model: RobotModel, some: list[State]) -> None:
    """``v' (dM/dt v - 2 c) = 0``: centripetal forces do no work but that of the changing
    inertia.
    """
    for s in some:
        v = s.v_a
        c = a.bias(s.q_a, v) - a.gravity(s.q_a)
        rate = slope(lambda h, s=s, v=v: v @ a.mass_matrix(s.q_a + h * v) @ v, STEP)
        # (dM/dt is of the size of M at speeds near one)
        terms = np.abs(v * c).sum() + v @ a.mass_matrix(s.q_a) @ v
        assert_close(rate, 2 * v @ c, DIFFERENCE, terms)


def check_potential(a: Answers, model: RobotModel, some: list[State]) -> None:
    """Gravity and springs are the gradient of the potential energy."""
    h_a, h_m = steps(model, STEP)
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    i_m = list(model.i_m)
    for s in some:
        still = 0 * s.v_a, 0 * s.v_m

        def potential(q_a, q_m, still=still):
            return a.energy(q_a, still[0], q_m, still[1])[1]

        def along_arm(k, s=s, potential=potential):
            e = np.eye(model.n_a)[k]
            return slope(lambda x: potential(s.q_a + x * e, s.q_m), h_a[k])

        def along_motor(j, s=s, potential=potential):
            e = np.eye(model.n_m)[j]
            return slope(lambda x: potential(s.q_a, s.q_m + x * e), h_m[j])

        tau_g = a.gear_torque(s.q_a, still[0], s.q_m, still[1])
        held = a.gravity(s.q_a)
        held[i_g] -= tau_g
        if model.lines:
            held -= a.arm_forces(s.q_a, still[0])
        if i_e:
            held[i_e] -= a.elastic_torque(s.q_a, still[0])
        energy = 10 * np.finfo(float).eps * abs(potential(s.q_a, s.q_m))  # its rounding
        for k in range(model.n_a):
            assert_close(
                along_arm(k), held[k], 1.0, DIFFERENCE * np.abs(held).max() + energy / h_a[k]
            )
        turned = np.linalg.solve(model.eta.T, tau_g)
        for j in i_m:
            assert_close(
                along_motor(j), turned[j], 1.0, DIFFERENCE * np.abs(turned).max() + energy / h_m[j]
            )


def check_jacobian(a: Answers, model: RobotModel, some: list[State]) -> None:
    """J is the derivative of the tool's position and, through ``dR R'``, of its rotation."""
    for s in some:
        p, R = a.forward_kinematics(s.q_a)
        assert_close(R @ R.T, np.eye(3), EXACT)
        assert_close(np.linalg.det(R), 1.0, EXACT)
        J = a.jacobian(s.q_a)
        for k, e in enumerate(np.eye(model.n_a)):
            dp = slope(lambda h, s=s, e=e: a.forward_kinematics(s.q_a + h * e)[0].ravel(), STEP)
            spin = slope(lambda h, s=s, e=e: a.forward_kinematics(s.q_a + h * e)[1], STEP) @ R.T
            assert_close(J[:3, k], dp, DIFFERENCE, max(1.0, np.abs(p).max()))
            assert_close(
                J[3:, k],
                [spin[2, 1], spin[0, 2], spin[1, 0]],
                DIFFERENCE,
                max(1.0, np.abs(J[3:]).max()),
            )


def check_jacobian_dot(a: Answers, model: RobotModel, some: list[State]) -> None:
    """dJ is the derivative of J along the velocity."""
    for s in some:
        dJ = slope(lambda h, s=s: a.jacobian(s.q_a + h * s.v_a), STEP)
        assert_close(a.jacobian_dot(s.q_a, s.v_a), dJ, DIFFERENCE, max(1.0, np.abs(dJ).max()))


def check_linearize(a: Answers, model: RobotModel, some: list[State]) -> None:
    """A and B are the derivatives of ``x' = (v, accelerations)``, ``x = (q_a, q_m, v_a, v_m)``
    without rigid motors.
    """
    n = model.dof
    i_m = list(model.i_m)
    h_a, h_m = steps(model, FINE)
    h = np.concatenate([h_a, h_m[i_m], np.full(n, FINE)])
    for s in some:

        def rate(x, tau, s=s):
            q_m = s.q_m.copy()
            v_m = s.v_m.copy()
            q_a = x[: model.n_a]
            v_a = x[n : n + model.n_a]
            q_m[i_m] = x[model.n_a : n]
            v_m[i_m] = x[n + model.n_a :]
            a_a, a_m = a.forward_dynamics(q_a, v_a, q_m, v_m, tau)
            return np.concatenate([x[n:], a_a, a_m[i_m]])

        A, B = a.linearize(*s.x, s.tau_m)
        assert A.shape == (2 * n, 2 * n) and B.shape == (2 * n, model.n_m)
        x = np.concatenate([s.q_a, s.q_m[i_m], s.v_a, s.v_m[i_m]])
        noise = ROUNDING * np.abs(rate(x, s.tau_m)).max()
        for k, e in enumerate(np.eye(2 * n)):
            found = slope(lambda z, x=x, e=e, rate=rate, s=s: rate(x + z * e, s.tau_m), h[k])
            assert_close(A[:, k], found, 1.0, LINEAR * np.abs(found).max() + noise / h[k])
        for k, e in enumerate(np.eye(model.n_m)):
            found = rate(x, s.tau_m + e) - rate(x, s.tau_m)
            assert_close(B[:, k], found, 1.0, LINEAR * np.abs(found).max() + noise)


# s after which the torques of `states` drive a light robot with loops out of its workspace
WITHIN = {"delta": 0.03}


def check_energy(a: Answers, model: RobotModel, start: State, time: float = 0.15) -> None:
    """Energy balance: work of the motors minus dissipation of friction and dampers is the change
    of the energy of the machine.
    """
    n = model.dof
    i_m = list(model.i_m)

    def split(x):
        q_m = np.zeros(model.n_m)
        v_m = np.zeros(model.n_m)
        q_m[i_m] = x[model.n_a : n]
        v_m[i_m] = x[n + model.n_a : 2 * n]
        return x[: model.n_a], x[n : n + model.n_a], q_m, v_m

    def rate(t, x):
        tau_m = start.tau_m * (1 + np.sin(40 * t))
        there = split(x)
        a_a, a_m = a.forward_dynamics(*there, tau_m)
        driven, lost = a.power(*there, tau_m)
        work = np.array([driven, lost]).ravel()
        return np.concatenate([x[n : 2 * n], a_a, a_m[i_m], work])

    x = np.concatenate([start.q_a, start.q_m[i_m], start.v_a, start.v_m[i_m], [0.0, 0.0]])
    path = solve_ivp(rate, (0, time), x, method="DOP853", rtol=1e-12, atol=1e-12)
    assert path.success
    energies = np.array([joined(a.energy(*split(y))) for y in path.y.T])
    gained = energies.sum(1) - energies[0].sum()
    driven, lost = path.y[2 * n :]
    scale = max(np.ptp(energies[:, 0]), np.ptp(energies[:, 1]), np.ptp(driven), np.ptp(lost))
    assert scale > 0
    assert_close(gained, driven - lost, ENERGY, scale)


CHECKS = (
    check_mass_matrix,
    check_forward_inverse,
    check_residual,
    check_ignored,
    check_passivity,
    check_potential,
    check_jacobian,
    check_jacobian_dot,
    check_linearize,
)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__[6:])
@pytest.mark.parametrize("name", ALL_MODELS)
def test_every_model_obeys_the_law(name, check):
    model = model_of(name)
    check(answers(name), model, states(model))


@pytest.mark.parametrize("name", ALL_MODELS)
def test_energy_is_balanced(name):
    model = model_of(name)
    (start,) = states(model, 1)
    check_energy(answers(name), model, start, WITHIN.get(name, 0.15))


# --- controls: the checks see planted bugs -------------------------------------------------------


PLANTED = (
    (wrong_coriolis, check_passivity),
    (asymmetric_mass, check_mass_matrix),
    (indefinite_mass, check_mass_matrix),
    (light_mass, check_forward_inverse),
    (wrong_gravity, check_potential),
    (scaled("gear_torque", 1.0001), check_potential),
    (slow_forward_dynamics, check_residual),
    (scaled("jacobian", ANGULAR), check_jacobian),
    (scaled("jacobian_dot", -1.0), check_jacobian_dot),
    (scaled("linearize", (1.0001, 1.0)), check_linearize),
    (scaled("linearize", (1.0, -1.0)), check_linearize),
)


@pytest.mark.parametrize(("bug", "check"), PLANTED, ids=lambda x: x.__name__)
def test_planted_bug_breaks_its_law(bug, check):
    name = "synthetic_elastic"
    model = model_of(name)
    check(answers(name), model, states(model))
    with pytest.raises(AssertionError):
        check(bug(answers(name), model), model, states(model))


def test_use_of_ignored_motors_is_seen():
    model = model_of("synthetic_mixed")
    with pytest.raises(AssertionError):
        check_ignored(trusting_motors(answers("synthetic_mixed"), model), model, states(model))


@pytest.mark.parametrize(
    "bug",
    [
        wrong_coriolis,
        scaled("power", (1.0, -1.0)),
        scaled("power", (1.001, 1.0)),
        scaled("energy", (1.0, 0.999)),
    ],
)
def test_planted_bug_breaks_energy_balance(bug):
    name = "synthetic_elastic"
    model = model_of(name)
    (start,) = states(model, 1)
    check_energy(answers(name), model, start, time=0.01)
    with pytest.raises(AssertionError):
        check_energy(bug(answers(name), model), model, start, time=0.01)
