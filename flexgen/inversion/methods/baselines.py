"""Baselines for comparison: rigid, flexible-joint and quasi-static feedforward, and exact
feedforward without the coupling of the rotors.

The first three follow the path with the kinematics of their own simpler model and take the torque
from it; simulated on the full model they have a tool error. None starts before the path. With q_e
the non-actuated coordinates and q_g the actuated ones:

rigid         q_e = 0, gears stiff:      q_m = eta q_g,
tau_m = J_m a_m + f(v_m) + eta^-T (M a + c + g)_g
fjm           q_e = 0, gears elastic:    q_m = eta (q_g + p),
D p' + spring(p) = tau_g = (M a + c + g)_g
quasistatic   q_e in equilibrium,
[M(q) a + c(q, v) + g(q)]_e + spring_e(q_e) = 0  with  v_e = a_e = 0 in it,
              then v_e ... from the derivatives of q_e(t); gears as in fjm

Quasi-static deflections are the first term of an expansion in the squares of (frequency of the
path / frequency of the elasticity); each of ``rounds`` inserts the derivatives of the previous
term and adds one term.

Their motor coupling is simplified. The baseline "simplified" is the exact inverse dynamics of the
robot in complete coupling whose rotors turn with their gears alone.

Source: A. De Luca, W. Book, in Springer Handbook of Robotics, 2016, ch. 11; P. Kokotovic, H.
Khalil, J. O'Reilly, Singular Perturbation Methods in Control, 1986, ch. 1 (expansion of the slow
motion).
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.motor_side import MotorMotion, motor_motion, motors_behind
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Motion, Reduction
from flexgen.model.abilities import obstacle
from flexgen.paths.path import Path, PathSample

SAMPLES = 200_000  # at most
# samples at rest on either side of the motion, for the derivatives of a spline at its ends
MARGIN = 8
ROUNDS = 1  # at most: one more would need two more derivatives of the path
NEWTON_STEPS = 30
CLOSE = 1e-11  # relative change at which Newton's method stops


def rigid(problem: InversionProblem, h: float) -> MethodResult:
    """Inverse dynamics of the robot with all springs stiff."""
    problem.check_options("rigid")
    reduction = simply_coupled(problem.equations)
    t = _instants(problem)
    motion = stiff_motion(reduction, problem.path, t)
    return _result(t, motion, stiff_motors(reduction.equations, motion))


def fjm(problem: InversionProblem, h: float) -> MethodResult:
    """Flexible-joint feedforward: the gears are elastic, all other elasticity is locked."""
    problem.check_options("fjm")
    reduction = simply_coupled(problem.equations)
    t = _instants(problem)
    motion = stiff_motion(reduction, problem.path, t)
    motors = motor_motion(reduction.equations, t, motion.q, motion.v, motion.a, motion.tau_g)
    return _result(t, motion, motors)


def quasistatic(problem: InversionProblem, h: float) -> MethodResult:
    """Flexible-joint feedforward with the quasi-static deflections of the other elasticities.

    Option ``rounds``: 0 (default) or 1: how often rates of the deflections are inserted into the
    equations, see the module. ``h`` is not used: the sampling is that of the problem.
    """
    problem.check_options("quasistatic", "rounds")
    rounds = problem.options.get("rounds", 0)
    if isinstance(rounds, bool) or rounds not in range(ROUNDS + 1):
        raise ArgumentError(
            f"options: method quasistatic was given rounds {rounds!r}, expected 0 to {ROUNDS}"
        )
    reduction = simply_coupled(problem.equations)
    t = _instants(problem)
    motion = quasistatic_motion(reduction, problem.path, t, rounds)
    motors = motor_motion(reduction.equations, t, motion.q, motion.v, motion.a, motion.tau_g)
    return _result(t, motion, motors)


def without_coupling(problem: InversionProblem, h: float) -> MethodResult:
    """Exact feedforward of a robot in complete motor coupling, as if its rotors turned with their
    gears alone; ``h`` [s]: length of the intervals. No options.
    """
    from flexgen.inversion.methods import closed_form, lq  # here: the others need no compiler

    problem.check_options("simplified")
    model = problem.equations.model
    if obstacle(model, "simplified coupling") is None:
        raise ArgumentError(
            f"method simplified: given {model.title}, whose rotors turn with their gears alone, "
            "expected motor_coupling = 'complete'"
        )
    simple = replace(model, motor_coupling="simplified")
    solve = lq.solve if simple.n_e else closed_form.solve
    return replace(solve(replace(problem, equations=Equations(simple)), h), status=Status.BASELINE)


def stiff_motion(reduction: Reduction, path: Path, t: np.ndarray) -> Motion:
    """The arm along the path with undeflected elements, at the instants ``t`` (n,) [s], and its
    gear torques.
    """
    sample = path.sample(t)
    still = np.zeros((len(t), len(reduction.i_e)))
    if sample.q_g is not None:  # the joints are given: singular poses do no harm
        coordinates = np.zeros((len(t), reduction.model.n_a, sample.q_g.shape[2]))
        coordinates[:, reduction.i_g] = sample.q_g
        return reduction.joint_motion(coordinates)
    guess = reduction.follow(path, t, reduction.start(path).q_a)
    guess[:, reduction.i_e] = 0.0
    return reduction.motion_through(
        sample, reduction.close(guess, reduction.targets(sample)), [still] * 4
    )


def stiff_motors(equations: Equations, motion: Motion) -> MotorMotion:
    """Motion of the motors behind stiff gears."""
    i_g = list(equations.model.i_g)
    return motors_behind(
        equations, [x[:, i_g] for x in (motion.q, motion.v, motion.a)], motion.tau_g[:, :, 0]
    )


def quasistatic_motion(reduction: Reduction, path: Path, t: np.ndarray, rounds: int = 0) -> Motion:
    """The arm along the path with quasi-static deflections.

    In each round the deflections are solved with the rates of those of the round before, at first
    zero. Rates are those of a spline, which extends `MARGIN` samples beyond both ends, where it
    would be inexact.

    Parameters
    ----------
    reduction : Reduction
    path : Path
    t : array (n,) [s]
        Evenly spaced.
    rounds : int
        How often the derivatives of the deflections are inserted into the equations.

    Returns
    -------
    Motion
        At the instants t.

    Raises
    ------
    SolverError
        The path leaves the workspace, or the springs cannot carry the loads.
    """
    step = t[1] - t[0]
    margin = step * np.arange(1, MARGIN + 1)
    wide = np.r_[t[0] - margin[::-1], t, t[-1] + margin]
    inside = slice(MARGIN, MARGIN + len(t))
    sample = path.sample(wide)
    q = reduction.follow(path, wide, reduction.start(path).q_a)
    rate = np.zeros((len(wide), len(reduction.i_e)))
    second = rate
    for _ in range(rounds + 1):
        q = solve_deflections(reduction, sample, q, rate, second)
        smooth = make_interp_spline(wide, q[:, reduction.i_e], k=min(7, len(wide) - 1))
        rate = smooth(wide, 1)
        second = smooth(wide, 2)
    motion = reduction.motion_through(sample, q, [smooth(wide, k) for k in (1, 2, 3, 4)])
    return Motion(*(getattr(motion, name)[inside] for name in ("q", "v", "a", "j", "s", "tau_g")))


def solve_deflections(
    reduction: Reduction, sample: PathSample, q: np.ndarray, v_e: np.ndarray, a_e: np.ndarray
) -> np.ndarray:
    """Arm coordinates (n, n_a) on the path whose non-actuated rows hold with the given ``v_e``,
    ``a_e`` (n, n_e).

    Newton's method at all instants at once, in q, v_g and a_g; ``q`` (n, n_a): its start;
    ``sample``: the path there. SolverError at a singular pose, and where the springs do not carry
    the loads.
    """
    n, n_a = q.shape
    i_g = reduction.i_g
    i_e = reduction.i_e
    stage = reduction.stage
    symbols = [ca.SX.sym(f"x{i}", stage.size_in(i)[0]) for i in range(4)]
    rows = stage(*symbols)
    free = [*range(n_a), *(n_a + i for i in i_g), *(2 * n_a + i for i in i_g)]
    newton = ca.Function(
        "deflected", symbols, [rows, ca.densify(ca.jacobian(rows, symbols[0])[:, free])]
    )
    X = np.zeros((n, 3 * n_a))
    X[:, :n_a] = q
    X[:, [n_a + i for i in i_e]] = v_e
    X[:, [2 * n_a + i for i in i_e]] = a_e
    targets = reduction.targets(sample)
    first = sample.derivative(1)
    second = sample.derivative(2)
    for _ in range(NEWTON_STEPS):
        residual, jacobian = evaluate(newton, X, targets, first, second)
        try:
            step = np.linalg.solve(
                jacobian.reshape(n, len(free), -1), -residual.reshape(n, -1, 1)
            )[:, :, 0]
        except np.linalg.LinAlgError:
            raise SolverError(
                "quasi-static deflections: singular pose on the path; choose another path"
            ) from None
        X[:, free] += step
        if not np.isfinite(X).all():
            break
        if np.abs(step).max() <= CLOSE * (1 + np.abs(X).max()):
            return X[:, :n_a].copy()
    raise SolverError(
        "quasi-static deflections: Newton's method does not converge, the springs do not carry "
        "the loads; give the move more time"
    )


def simply_coupled(equations: Equations) -> Reduction:
    """The reduced problem of the model, in simplified motor coupling."""
    if obstacle(equations.model, "simplified coupling") is None:
        return Reduction(equations)
    return Reduction(Equations(replace(equations.model, motor_coupling="simplified")))


def _instants(problem: InversionProblem) -> np.ndarray:
    """Instants from the start of the path to the end of the settling time [s]."""
    end = problem.path.duration + problem.windows[1]
    n = int(min(np.ceil(end / problem.step), SAMPLES))
    return np.linspace(0.0, end, n + 1)


def _result(t: np.ndarray, motion: Motion, motors: MotorMotion) -> MethodResult:
    """The result of a baseline, which is not verified; SolverError where its torques are not
    finite.
    """
    if not np.isfinite(motors.tau_m).all():
        raise SolverError(
            "the torque is not finite: a gear spring has no stiffness, or the path is not "
            "smooth; check the model, or raise the smoothness of the move"
        )
    return MethodResult(
        t, motion.q, motion.v, motion.a, motion.tau_g[:, :, 0], motors, status=Status.BASELINE
    )
