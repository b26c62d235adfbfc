"""Motion of the coordinates without motor while the joints move as given, and the torques of
the joints.

With the actuated coordinates q_g(t) given, the others q_e obey their rows of the equations of
motion, and the torques of the gears on the links follow from the rows of the joints:

    M_ee a_e = tau_e(q, v) + f_e(q, v) - h_e(q, v) - M_eg a_g,
    tau_g = M_ge a_e + M_gg a_g + h_g - f_g

h: Coriolis, centripetal and gravity forces, f: joint frictions and drags, tau_e: springs and
dampers. Motors and gears do not appear: the angles are those of the links. The method is the
classical one of Runge and Kutta with steps that resolve the highest natural frequency.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.joint_motion import JointMotion
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import balance, hold_joints

# rad: phase of the fastest mode in a step: the error of its phase is below 1e-5 of the way
PHASE = 0.15
MOST_STEPS = 2_000_000
# Largest speed at the begin, relative to the largest of the record, that is a robot at rest.
STILL = 0.02


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """The motion of all coordinates: ``time`` (n,) [s], ``q_a``, ``v_a``, ``a_a`` (n, n_a), and
    the torques of the gears on the links, ``tau_g`` (n, n_g) [N m or N].
    """

    time: np.ndarray
    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    tau_g: np.ndarray


def drive_joints(equations: Equations, motion: JointMotion) -> DrivenMotion:
    """The motion of a robot whose joints move as given, such as recorded, from equilibrium.

    Parameters
    ----------
    equations : Equations
    motion : JointMotion
        Of the actuated coordinates, at rest at its begin.

    Returns
    -------
    DrivenMotion
        At the steps of the record.

    Raises
    ------
    ArgumentError
        The record begins in motion, or is too long for the fastest mode of the model.
    SolverError
        There is no equilibrium at the begin, or the motion becomes infinite.
    """
    model = equations.model
    time = np.arange(motion.begin, motion.end + 1e-9, motion.step)
    _check_rest(motion, time)
    start = motion.at(time[:1])[0][0]
    rest = hold_joints(equations, start).q_a[list(model.i_e)]
    substeps = _substeps(equations, start, rest, motion.step)
    if substeps * len(time) > MOST_STEPS:
        raise ArgumentError(
            f"record: given {len(time)} rows for a model whose fastest mode needs {substeps} "
            f"steps for each, expected at most {MOST_STEPS} steps; make this mode rigid, or "
            "shorten the record"
        )
    state = np.concatenate([rest, np.zeros(model.n_e)])
    if model.n_e:
        state = _integrate(equations, motion, time, state, substeps)
    else:
        state = np.zeros((len(time), 0))
    return _with_torques(equations, motion, time, state)


def _check_rest(motion: JointMotion, time: np.ndarray) -> None:
    """ArgumentError where the joints move at the begin: the deflections there are not known."""
    speed = np.abs(motion.at(time)[1]).max(axis=1)
    first = speed[time <= motion.begin + motion.edge].max()
    if first > STILL * speed.max():
        raise ArgumentError(
            f"record: given joints that move at the begin, by {first:.3g} rad/s (m/s), expected "
            f"at rest in the first {motion.edge:.3g} s, where the deflections are those of the "
            "equilibrium; begin the record before the motion"
        )


def _acceleration(equations: Equations) -> ca.Function:
    """Accelerations of the coordinates without motor, a function of (state, q_g, v_g, a_g)."""
    model = equations.model
    n_e, n_g = model.n_e, model.n_g
    x = ca.SX.sym("x", 2 * n_e)
    given = [ca.SX.sym(name, n_g) for name in ("q_g", "v_g", "a_g")]
    zero = ca.SX.zeros(n_e)
    q, v, a = (
        _merge(model.i_e, model.i_g, *pair)
        for pair in zip((x[:n_e], x[n_e:], zero), given, strict=True)
    )
    M = equations.function("mass_matrix")(q)
    load = ca.mtimes(M, a) + equations.function("bias")(q, v)
    load -= equations.function("arm_forces")(q, v)
    rows = list(model.i_e)
    force = equations.function("elastic_torque")(q, v) - load[rows]
    return ca.Function("a_e", [x, *given], [ca.solve(M[rows, rows], force)])


def _merge(i_e: tuple[int, ...], i_g: tuple[int, ...], of_e: ca.SX, of_g: ca.SX) -> ca.SX:
    """A vector of all coordinates from that of those without motor and that of the joints."""
    out = ca.SX.zeros(len(i_e) + len(i_g))
    for k, i in enumerate(i_e):
        out[i] = of_e[k]
    for k, i in enumerate(i_g):
        out[i] = of_g[k]
    return out


def _substeps(equations: Equations, q_g: np.ndarray, q_e: np.ndarray, step: float) -> int:
    """Steps of the integration in one of the record, for the fastest mode with held joints."""
    model = equations.model
    if not model.n_e:
        return 1
    q_a = equations.lagrangian.chain.q_a
    stiffness = ca.jacobian(balance(equations), q_a)
    rows = list(model.i_e)
    pose = np.zeros(model.n_a)
    pose[rows] = q_e
    pose[list(model.i_g)] = q_g
    K = np.array(ca.Function("K", [q_a], [stiffness])(pose))[:, rows]
    M = evaluate(equations.function("mass_matrix"), pose)[0][0][np.ix_(rows, rows)]
    fastest = float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(M, K))).max()))
    return max(1, int(np.ceil(fastest * step / PHASE)))


def _integrate(
    equations: Equations,
    motion: JointMotion,
    time: np.ndarray,
    start: np.ndarray,
    substeps: int,
) -> np.ndarray:
    """States (n, 2 n_e), positions and speeds of the coordinates without motor."""
    h = motion.step / substeps
    n_e = equations.model.n_e
    n_g = equations.model.n_g
    a_e = _acceleration(equations)
    x = ca.SX.sym("x", 2 * n_e)
    u = [ca.SX.sym(f"u{k}", 3 * n_g) for k in range(3)]

    def slope(state: ca.SX, given: ca.SX) -> ca.SX:
        """Time derivative of the state."""
        return ca.vertcat(state[n_e:], a_e(state, *ca.vertsplit(given, n_g)))

    k1 = slope(x, u[0])
    k2 = slope(x + h / 2 * k1, u[1])
    k3 = slope(x + h / 2 * k2, u[1])
    k4 = slope(x + h * k3, u[2])
    step = ca.Function("step", [x, *u], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    count = substeps * (len(time) - 1)
    fine = time[0] + h / 2 * np.arange(2 * count + 1)
    inputs = np.hstack(motion.at(np.minimum(fine, motion.end))).T
    parts = inputs[:, :-1:2], inputs[:, 1::2], inputs[:, 2::2]
    found = np.array(step.mapaccum(count)(start, *parts)).T
    states = np.vstack([start, found[substeps - 1 :: substeps]])
    if not np.isfinite(states).all():
        raise SolverError(
            "joints: the coordinates without motor grow without bound; look at their "
            "stiffness and damping with 'flexgen check'"
        )
    return states


def _with_torques(
    equations: Equations, motion: JointMotion, time: np.ndarray, states: np.ndarray
) -> DrivenMotion:
    """The motion of all coordinates and the torques of the joints."""
    model = equations.model
    n_e = model.n_e
    given = motion.at(time)
    size = len(time), model.n_a
    q, v, a = np.zeros(size), np.zeros(size), np.zeros(size)
    for whole, of_joints in zip((q, v, a), given, strict=True):
        whole[:, list(model.i_g)] = of_joints
    if n_e:
        q[:, list(model.i_e)] = states[:, :n_e]
        v[:, list(model.i_e)] = states[:, n_e:]
        of_e = _acceleration(equations).map(len(time))(states.T, *(x.T for x in given))
        a[:, list(model.i_e)] = np.array(of_e).T
    load = evaluate(equations.function("inverse_dynamics"), q, v, a)[0]
    load = load - evaluate(equations.function("arm_forces"), q, v)[0]
    rows = list(model.i_g)
    tau = np.reshape(load, (len(time), -1))[:, rows]
    return DrivenMotion(time, q, v, a, tau)
