"""Motion of the coordinates without motor while the joints move as given, and the torques of
the joints.

With the actuated coordinates q_g(t) given, the others q_e obey their rows of the equations of
motion, and the torques of the gears on the links follow from the rows of the joints:

    M_ee a_e = tau_e(q, v) + f_e(q, v) - h_e(q, v) - M_eg a_g,
    tau_g = M_ge a_e + M_gg a_g + h_g - f_g

h: Coriolis, centripetal and gravity forces, f: joint frictions and drags, tau_e: springs and
dampers. Or the motors are given, as those of a robot that follows positions: then joints with
elastic gears belong to the coordinates e, with the torques of their gears. The method is the
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
from flexgen.dynamics.mechanics.statics import hold_joints, hold_motors

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
        At the steps of the motion.

    Raises
    ------
    ArgumentError
        The motion begins without rest, or is too long for the fastest mode of the model.
    SolverError
        There is no equilibrium at the begin, or the motion becomes infinite.
    """
    return _drive(DrivenRobot(equations, through_gears=False), motion)


def drive_motors(equations: Equations, motion: JointMotion) -> DrivenMotion:
    """The motion of a robot whose motors follow positions, from equilibrium.

    ``motion``: of the joints that rigid gears would turn. Arguments, result and errors are those
    of `drive_joints`.
    """
    return _drive(DrivenRobot(equations, through_gears=True), motion)


class DrivenRobot:
    """Equations of the coordinates that are free while the others, or the motors, are given.

    ``free``: indices of the free coordinates; ``given``: those of the others.
    """

    def __init__(self, equations: Equations, *, through_gears: bool) -> None:
        self.equations = equations
        self.model = equations.model
        self.through_gears = through_gears
        gears = [self.model.coordinates[i].dof for i in self.model.i_g]
        self._bending = [
            k
            for k, dof in enumerate(gears)
            if through_gears and dof is not None and dof.gear is not None and not dof.gear.rigid
        ]
        bent = [self.model.i_g[k] for k in self._bending]
        self.free = [*self.model.i_e, *bent]
        self.given = [i for i in self.model.i_g if i not in bent]
        self.acceleration = self._acceleration()

    def _acceleration(self) -> ca.Function:
        """Accelerations of the free coordinates: a function of (state, q, v, a of the joints)."""
        model = self.model
        function = self.equations.function
        n = len(self.free)
        x = ca.SX.sym("x", 2 * n)
        given = [ca.SX.sym(name, model.n_g) for name in ("q_g", "v_g", "a_g")]
        parts = x[:n], x[n:], ca.SX.zeros(n)
        q, v, a = (self._merge(*pair) for pair in zip(parts, given, strict=True))
        M = function("mass_matrix")(q)
        load = ca.mtimes(M, a) + function("bias")(q, v) - function("arm_forces")(q, v)
        force = ca.SX.zeros(model.n_a)
        if model.n_e:
            force[list(model.i_e)] = function("elastic_torque")(q, v)
        if self._bending:
            eta = ca.DM(model.eta)
            tau = function("gear_torque")(q, v, eta @ given[0], eta @ given[1])
            for k in self._bending:
                force[model.i_g[k]] = tau[k]
        rows = self.free
        a_e = ca.solve(M[rows, rows], (force - load)[rows])
        return ca.Function("a_e", [x, *given], [a_e])

    def _merge(self, of_free: ca.SX, of_joints: ca.SX) -> ca.SX:
        """A vector of all coordinates from that of the free ones and that of the joints."""
        out = ca.SX.zeros(self.model.n_a)
        places = {i: k for k, i in enumerate(self.model.i_g)}
        for i in self.given:
            out[i] = of_joints[places[i]]
        for k, i in enumerate(self.free):
            out[i] = of_free[k]
        return out

    def rest(self, q_g: np.ndarray) -> np.ndarray:
        """Free coordinates in equilibrium with the joints, or the motors, at a position."""
        found = hold_joints(self.equations, q_g)
        if self.through_gears:
            found = hold_motors(self.equations, self.model.eta @ q_g, found.q_a)
        return np.asarray(found.q_a[self.free])

    def rates(self, q_g: np.ndarray) -> np.ndarray:
        """Eigenvalues [1/s] of the free coordinates at rest at a position, slowest first."""
        n = len(self.free)
        x = ca.SX.sym("x", 2 * n)
        still = np.zeros(self.model.n_g)
        slope = ca.jacobian(self.acceleration(x, q_g, still, still), x)
        at = np.concatenate([self.rest(q_g), np.zeros(n)])
        below = np.array(ca.DM(ca.Function("slope", [x], [slope])(at)))
        A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), below])
        found = np.linalg.eigvals(A)
        return np.asarray(found[np.argsort(np.abs(found))])


def _drive(robot: DrivenRobot, motion: JointMotion) -> DrivenMotion:
    """The motion of a robot from equilibrium."""
    time = np.arange(motion.begin, motion.end + 1e-9, motion.step)
    _check_rest(motion, time)
    start = motion.at(time[:1])[0][0]
    n = len(robot.free)
    if not n:
        return _with_torques(robot, motion, time, np.zeros((len(time), 0)))
    fastest = float(np.abs(robot.rates(start)).max())
    substeps = max(1, int(np.ceil(fastest * motion.step / PHASE)))
    if substeps * len(time) > MOST_STEPS:
        raise ArgumentError(
            f"record: given {len(time)} rows for a model whose fastest mode needs {substeps} "
            f"steps for each, expected at most {MOST_STEPS} steps; make this mode rigid, or "
            "shorten the record"
        )
    state = np.concatenate([robot.rest(start), np.zeros(n)])
    return _with_torques(robot, motion, time, _integrate(robot, motion, time, state, substeps))


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


def _integrate(
    robot: DrivenRobot, motion: JointMotion, time: np.ndarray, start: np.ndarray, substeps: int
) -> np.ndarray:
    """States (n, 2 n_free), positions and speeds of the free coordinates."""
    h = motion.step / substeps
    n = len(robot.free)
    n_g = robot.model.n_g
    x = ca.SX.sym("x", 2 * n)
    u = [ca.SX.sym(f"u{k}", 3 * n_g) for k in range(3)]

    def slope(state: ca.SX, given: ca.SX) -> ca.SX:
        """Time derivative of the state."""
        return ca.vertcat(state[n:], robot.acceleration(state, *ca.vertsplit(given, n_g)))

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
            "joints: the coordinates without motor grow without bound; look at their stiffness "
            "and damping with 'flexgen check'"
        )
    return states


def _with_torques(
    robot: DrivenRobot, motion: JointMotion, time: np.ndarray, states: np.ndarray
) -> DrivenMotion:
    """The motion of all coordinates and the torques of the joints."""
    model = robot.model
    n = len(robot.free)
    given = motion.at(time)
    size = len(time), model.n_a
    q, v, a = np.zeros((3, *size))
    for whole, of_joints in zip((q, v, a), given, strict=True):
        whole[:, list(model.i_g)] = of_joints
    if n:
        q[:, robot.free] = states[:, :n]
        v[:, robot.free] = states[:, n:]
        found = robot.acceleration.map(len(time))(states.T, *(x.T for x in given))
        a[:, robot.free] = np.array(found).T
    load = evaluate(robot.equations.function("inverse_dynamics"), q, v, a)[0]
    load = load - evaluate(robot.equations.function("arm_forces"), q, v)[0]
    tau = np.reshape(load, (len(time), -1))[:, list(model.i_g)]
    return DrivenMotion(time, q, v, a, tau)
