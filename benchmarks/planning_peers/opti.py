"""One planning problem solved twice for `benchmarks/planning.py`: with flexgen, and by hand with
CasADi's Opti.

Least integral of squared motor torques or accelerations between two poses at rest, Gauss
collocation with three points on the full elastic robot. Each function is what a user writes; its
lines are counted.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import flexgen


def with_flexgen(model, move, mesh, cost):
    """A plan, solved and simulated."""
    problem = flexgen.plan_problem(model, move, mesh=mesh)
    problem.add_squares(problem[cost] / 100)
    return problem.solve(accuracy=1e-3, progress=False)


def by_hand(model, move, mesh, cost):
    """A plan with Opti: the user writes equilibria, collocation, guess and scales."""
    equations = flexgen.derive(model)
    robot = equations.model
    n_a = robot.n_a
    n_m = robot.n_m
    T = robot.move(move).duration
    n = n_a + n_m
    path = flexgen.plan(equations, move)
    start = rest(equations, path, 0.0)
    end = rest(equations, path, T)
    points = (np.polynomial.legendre.leggauss(3)[0] + 1) / 2
    basis = [
        np.poly1d(np.poly(np.delete(points, j)) / np.prod(points[j] - np.delete(points, j)))
        for j in range(3)
    ]
    once = [p.integ() for p in basis]
    twice = [p.integ(2) for p in basis]
    weights = [p(1.0) for p in once]
    h = T / mesh
    y, a, u = (ca.SX.sym(name, size) for name, size in (("y", 2 * n), ("a", n), ("u", n_m)))
    motion = [y[:n_a], y[n : n + n_a], a[:n_a], y[n_a:n], y[n + n_a :], a[n_a:]]
    rows = ca.Function(
        "rows", [y, a, u], [ca.vertcat(*equations.function("residual")(*motion, u))]
    )
    side = np.r_[np.ones(n_a), np.abs(robot.eta).max(axis=1)]
    opti = ca.Opti()
    Y = opti.variable(2 * n, mesh + 1)
    A = [opti.variable(n, 3) for _ in range(mesh)]
    U = [opti.variable(n_m, 3) for _ in range(mesh)]
    size = np.r_[side, side]
    total = 0
    opti.subject_to(Y[:, 0] == np.r_[start, np.zeros(n)] / size)
    opti.subject_to(Y[:, -1] == np.r_[end, np.zeros(n)] / size)
    share = np.linspace(0, 1, mesh + 1)
    law = 10 * share**3 - 15 * share**4 + 6 * share**5
    rate = np.gradient(law, share) / T
    guess = np.vstack([np.outer(start, 1 - law) + np.outer(end, law), np.outer(end - start, rate)])
    opti.set_initial(Y, guess / size[:, None])
    for k in range(mesh):
        q = Y[:n, k]
        v = Y[n:, k]
        acceleration = [100 * A[k][:, j] for j in range(3)]
        for i, c in enumerate(points):
            at = q + h * c * v + h**2 * sum(float(twice[j](c)) * acceleration[j] for j in range(3))
            speed = v + h * sum(float(once[j](c)) * acceleration[j] for j in range(3))
            x = size * ca.vertcat(at, speed)
            opti.subject_to(rows(x, side * acceleration[i], U[k][:, i]) / 1e4 == 0)
            effort = U[k][:, i] if cost == "tau_m" else (side * acceleration[i])[n_a:]
            total += h * weights[i] * ca.sumsqr(effort / 100)
        opti.subject_to(
            Y[:n, k + 1]
            == q + h * v + h**2 * sum(float(twice[j](1)) * acceleration[j] for j in range(3))
        )
        opti.subject_to(
            Y[n:, k + 1] == v + h * sum(weights[j] * acceleration[j] for j in range(3))
        )
    opti.minimize(total)
    quiet = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.sb": "yes",
        "ipopt.tol": 1e-7,
        "expand": False,
    }
    opti.solver("ipopt", {**quiet, "ipopt.constr_viol_tol": 1e-9, "ipopt.max_iter": 300})
    found = opti.solve()
    return equations, opti, found, Y, U, start, size, basis, T


def check_by_hand(equations, opti, found, Y, U, start, size, basis, T):
    """The simulation of what `by_hand` found: largest distance of the output at the nodes from the
    planned one.
    """
    robot = equations.model
    mesh = len(U)
    n_a = robot.n_a
    n_m = robot.n_m
    h = T / len(U)
    torque = np.array([found.value(one).reshape(n_m, 3) for one in U])
    nodes = np.linspace(0, T, mesh + 1)
    state = found.value(Y) * size[:, None]
    x = np.r_[start, 0 * start]
    worst = 0.0
    rate_of = equations.function("state_rate")
    output = equations.function("output")
    for k in range(mesh):
        t0 = nodes[k]
        now = torque[k]

        def held(t, t0=t0, now=now):
            return sum(p((t - t0) / h) * now[:, j] for j, p in enumerate(basis))

        run = solve_ivp(
            lambda t, x, held=held: np.array(rate_of(x, held(t))).ravel(),
            (t0, t0 + h),
            x,
            "Radau",
            rtol=1e-9,
            atol=1e-10,
        )
        x = run.y[:, -1]
        off = output(x[:n_a]) - output(state[:n_a, k + 1])
        worst = max(worst, float(ca.norm_2(off)))
    return worst


def rest(equations, path, t):
    """Coordinates of the equilibrium on the path at an instant: the user solves statics by
    Newton's method.
    """
    robot = equations.model
    q = ca.SX.sym("q", robot.n_a)
    i_g = list(robot.i_g)
    i_e = list(robot.i_e)
    sample = path.sample(np.array([t]))
    p, R = equations.function("forward_kinematics")(q)
    error = equations.function("output")(q) - sample.y[0, :, 0]
    if robot.output.type == "tool_pose":
        E = ca.mtimes(R, sample.R[0].T)
        turn = ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2
        error = ca.vertcat(p - sample.y[0, :, 0], turn)
    zero = np.zeros(robot.n_a)
    load = equations.function("inverse_dynamics")(q, zero, zero)
    row = load[i_e] - equations.function("elastic_torque")(q, zero)
    solver = ca.rootfinder(
        "rest", "newton", {"x": q, "g": ca.vertcat(error, row)}, {"error_on_fail": False}
    )
    start = np.zeros(robot.n_a)
    move = robot.move(path.move.name)
    start[i_g] = move.end if t > 0 and move.type == "joint" else move.start
    found = np.array(solver(start, 0)).ravel()
    tau = np.array(equations.function("inverse_dynamics")(found, zero, zero)).ravel()[i_g]
    stiffness = np.array(equations.function("gear_law")(np.zeros(robot.n_g))[1]).ravel()
    return np.r_[found, robot.eta @ (found[i_g] + tau / stiffness)]
