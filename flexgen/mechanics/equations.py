"""The equations of motion of a model as CasADi functions: what every other room of flexgen asks for.

    M_a(q_a) a_a + c(q_a, v_a) + g(q_a) = tau_a,      tau_a = tau_g on the actuated rows, tau_e on the others
    tau_g = spring(eta^-1 q_m - q_g) + D_g (eta^-1 v_m - v_g),        tau_e = -spring_e(q_e) - D_e v_e
    J_m a_m + f(v_m) + eta^-T tau_g = tau_m

Source: S. Moberg, Modeling and Control of Flexible Manipulators, 2010 (extended flexible joint model).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path

import casadi as ca

from flexgen.errors import ArgumentError
from flexgen.mechanics import inversion_functions
from flexgen.mechanics.force_laws import friction_torque, spring_torque
from flexgen.mechanics.lagrangian import Lagrangian, equations_of, gears, lagrangian
from flexgen.mechanics.parameters import parametrised
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

Built = tuple[list[ca.SX], list[str], list[ca.SX], list[str]]


class Equations:
    """Equations of motion of one model; each function is built when it is first asked for.

    Functions (`function`), arguments -> results, sizes as in the model, SI units, arm quantities on the arm side:

    ==================== ===================================== ==========================================
    forward_kinematics   q_a                                   p (3), R (3, 3): tool in the world
    jacobian             q_a                                   J (6, n_a): linear, then angular velocity
    jacobian_dot         q_a, v_a                              dJ (6, n_a)
    mass_matrix          q_a                                   M (n_a, n_a)
    bias                 q_a, v_a                              h = c + g
    gravity              q_a                                   g
    inverse_dynamics     q_a, v_a, a_a                         tau_a = M a_a + c + g
    inverse_dynamics_    q_a, v_a, a_a                         dtau_dq, dtau_dv, dtau_da (n_a, n_a)
    derivatives
    arm_forward_dynamics q_a, v_a, tau_a                       a_a = M^-1 (tau_a - c - g)
    arm_slopes           q_a, v_a, a_a                         M (n_a, n_a), R (n_a, 2 n_a) = d tau_a/d(q_a, v_a)
    arm_forces           q_a, v_a                              frictions and drags on the arm, as they act
    motor_friction       v_m                                   f_m (n_m)
    rotor_torque         q_a, v_a, a_a, v_m, a_m               d/dt of the rotors' axial momentum (n_m)
    gear_spring          twist (n_g, arm side)                 tau (n_g), slope (n_g); zero for rigid gears
    gear_torque          q_a, v_a, q_m, v_m                    tau_g (n_g); zero for rigid gears
    elastic_torque       q_a, v_a                              tau_e (n_e)
    forward_dynamics     q_a, v_a, q_m, v_m, tau_m             a_a, a_m
    residual             q_a, v_a, a_a, q_m, v_m, a_m, tau_m   r_a (n_a), r_m (n_m)
    state_rate           x (n_x), tau_m                        dx: the state-space right-hand side
    linearize            q_a, v_a, q_m, v_m, tau_m             A (n_x, n_x), B (n_x, n_m)
    slopes               q_a, v_a, a_a, q_m, v_m, tau_m, a_m   M, R = d residual/d(y, dy, tau_m): A, B from -M^-1 R
    second_order         q_a, v_a, a_a, q_m, v_m, a_m, tau_m   M, D, K, B: variation of the equations in y
    energy               q_a, v_a, q_m, v_m                    kinetic, potential [J]
    power                q_a, v_a, q_m, v_m, tau_m             P_motor, P_dissipated [W]
    output               q_a                                   y (n_y), or p of the tool for a pose
    places               q_a                                   corner points of the chain (3, k), for drawing
    output_constraint    q_a, v_a, target                      y_err (n_y), W (n_y, n_a), Wdot_v (n_y)
    inversion_slopes     q_a, v_a, a_a                         dy1_dq, dy2_dq, dy2_dv, row, row_q, row_v, row_a
    inversion_rows       q_a, v_a, a_a                         tau_g (n_g), row (n_e)
    gear_law             twist (n_g, arm side)                 tau_p, dtau_p: as gear_spring
    ==================== ===================================== ==========================================

    ``x = (q_a, q_me, v_a, v_me)`` with ``q_me`` the motors behind elastic gears. Entries of ``q_m``, ``v_m``, ``a_m``
    behind rigid gears are ignored as inputs (they follow their joints) and returned filled in.

    Functions of equations with ``parameters`` (names: see `flexgen.mechanics.parameters`) have these as a last argument
    where they depend on them. ``model`` keeps the numbers, ``with_symbols`` has the symbols in their place.
    """

    def __init__(self, model: RobotModel, parameters: Sequence[str] = ()) -> None:
        made = parametrised(model, parameters)
        self.model, self.parameters, self.symbols = made.given, made.parameters, made.symbols
        self.with_symbols = made.model
        self._functions: dict[str, ca.Function] = {}

    @cached_property
    def lagrangian(self) -> Lagrangian:
        """The energies and forces that all functions follow from."""
        return lagrangian(self.with_symbols)

    def function(self, name: str) -> ca.Function:
        """The CasADi function of that name (see the class); ArgumentError for an unknown one."""
        if name not in self._functions:
            builders: dict[str, Callable[[], Built]] = {
                "forward_kinematics": self._forward_kinematics,
                "jacobian": self._jacobian,
                "jacobian_dot": self._jacobian_dot,
                "mass_matrix": self._mass_matrix,
                "bias": self._bias,
                "gravity": self._gravity,
                "inverse_dynamics": self._inverse_dynamics,
                "inverse_dynamics_derivatives": self._inverse_dynamics_derivatives,
                "arm_forward_dynamics": self._arm_forward_dynamics,
                "arm_slopes": self._arm_slopes,
                "arm_forces": self._arm_forces,
                "motor_friction": self._motor_friction,
                "rotor_torque": self._rotor_torque,
                "gear_spring": self.gear_spring,
                "gear_torque": self._gear_torque,
                "elastic_torque": self._elastic_torque,
                "forward_dynamics": self._forward_dynamics,
                "residual": self._residual,
                "state_rate": self._state_rate,
                "linearize": self._linearize,
                "slopes": self._slopes,
                "second_order": self._second_order,
                "energy": self._energy,
                "power": self._power,
                "output": self._output,
                "places": self._places,
                **{name: partial(inversion_functions.definition, self, name) for name in inversion_functions.FUNCTIONS},
            }
            if name not in builders:
                raise ArgumentError(f"function: given {name!r}, expected one of {', '.join(builders)}")
            self._functions[name] = self.built(name, *builders[name]())
        return self._functions[name]

    def built(
        self, name: str, inputs: list[ca.SX], names_in: list[str], outputs: list[ca.SX], names_out: list[str]
    ) -> ca.Function:
        """A function with dense results; its last argument is ``parameters`` where they depend on them."""
        outputs = [ca.densify(x) for x in outputs]
        if self.parameters and ca.depends_on(ca.veccat(*outputs), self.symbols):
            inputs, names_in = [*inputs, self.symbols], [*names_in, "parameters"]
        return ca.Function(name, inputs, outputs, names_in, names_out)

    # --- shorthands -------------------------------------------------------------------------------------------------

    @cached_property
    def _y(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Minimal coordinates y = (q_a, q_me), their speeds and accelerations."""
        lag, i_m = self.lagrangian, self.model.i_m  # (an empty index into a single motor has the wrong shape)
        return (
            ca.vertcat(lag.chain.q_a, *[lag.q_m[j] for j in i_m]),
            ca.vertcat(lag.chain.v_a, *[lag.v_m[j] for j in i_m]),
            ca.vertcat(lag.a_a, *[lag.a_m[j] for j in i_m]),
        )

    @cached_property
    def _left(self) -> ca.SX:
        """Lagrange's equations of the whole machine without springs and forces, at the accelerations (a_a, a_me)."""
        lag = self.lagrangian
        return equations_of(lag.kinetic, lag.gravity, *self._y)

    @cached_property
    def _mass(self) -> ca.SX:
        """Mass matrix of the whole machine in y."""
        return ca.hessian(self.lagrangian.kinetic, self._y[1])[0]

    @cached_property
    def _acceleration(self) -> ca.SX:
        """Accelerations of y that the equations of motion give."""
        rest = ca.substitute(self._left, self._y[2], ca.SX.zeros(self._y[2].shape))
        return solve_symmetric(self._mass, self.lagrangian.forces - rest)

    def _a_m_all(self, a_a: ca.SX, a_me: ca.SX) -> ca.SX:
        """Accelerations of all motors from those of the arm and of the motors behind elastic gears."""
        model = self.model
        geared = ca.mtimes(ca.SX(ca.DM(model.eta)), a_a[list(model.i_g)])
        at = {j: k for k, j in enumerate(model.i_m)}
        return ca.vertcat(*[a_me[at[j]] if j in at else geared[j] for j in range(model.n_m)])

    # --- functions --------------------------------------------------------------------------------------------------

    def _forward_kinematics(self) -> Built:
        chain = self.lagrangian.chain
        return [chain.q_a], ["q_a"], [chain.tool.p, chain.tool.R], ["p", "R"]

    @cached_property
    def _twist(self) -> ca.SX:
        tool = self.lagrangian.chain.tool
        return ca.vertcat(ca.mtimes(tool.R, tool.v), ca.mtimes(tool.R, tool.w))

    def _jacobian(self) -> Built:
        chain = self.lagrangian.chain
        return [chain.q_a], ["q_a"], [ca.jacobian(self._twist, chain.v_a)], ["J"]

    def _jacobian_dot(self) -> Built:
        chain = self.lagrangian.chain
        J = ca.densify(ca.jacobian(self._twist, chain.v_a))
        dJ = ca.reshape(ca.jtimes(ca.vec(J), chain.q_a, chain.v_a), 6, self.model.n_a)
        return [chain.q_a, chain.v_a], ["q_a", "v_a"], [dJ], ["dJ"]

    def _mass_matrix(self) -> Built:
        lag = self.lagrangian
        return [lag.chain.q_a], ["q_a"], [ca.hessian(lag.kinetic_arm, lag.chain.v_a)[0]], ["M"]

    @cached_property
    def arm_left(self) -> ca.SX:
        """The arm's side of the equations, ``M a_a + c + g``."""
        lag = self.lagrangian
        return equations_of(lag.kinetic_arm, lag.gravity, lag.chain.q_a, lag.chain.v_a, lag.a_a)

    def _bias(self) -> Built:
        lag = self.lagrangian
        h = ca.substitute(self.arm_left, lag.a_a, ca.SX.zeros(self.model.n_a))
        return [lag.chain.q_a, lag.chain.v_a], ["q_a", "v_a"], [h], ["h"]

    def _gravity(self) -> Built:
        lag = self.lagrangian
        return [lag.chain.q_a], ["q_a"], [ca.gradient(lag.gravity, lag.chain.q_a)], ["g"]

    def _inverse_dynamics(self) -> Built:
        lag = self.lagrangian
        return [lag.chain.q_a, lag.chain.v_a, lag.a_a], ["q_a", "v_a", "a_a"], [self.arm_left], ["tau_a"]

    def _inverse_dynamics_derivatives(self) -> Built:
        lag = self.lagrangian
        inputs = [lag.chain.q_a, lag.chain.v_a, lag.a_a]
        outputs = [ca.jacobian(self.arm_left, x) for x in inputs]
        return inputs, ["q_a", "v_a", "a_a"], outputs, ["dtau_dq", "dtau_dv", "dtau_da"]

    def _arm_forward_dynamics(self) -> Built:
        lag = self.lagrangian
        tau_a = ca.SX.sym("tau_a", self.model.n_a)
        M, h = self._mass_matrix()[2][0], self._bias()[2][0]
        inputs = [lag.chain.q_a, lag.chain.v_a, tau_a]
        return inputs, ["q_a", "v_a", "tau_a"], [solve_symmetric(M, tau_a - h)], ["a_a"]

    def _arm_slopes(self) -> Built:
        inputs, names, (by_q, by_v, M), _ = self._inverse_dynamics_derivatives()
        return inputs, names, [M, ca.horzcat(by_q, by_v)], ["M", "R"]

    def _arm_forces(self) -> Built:
        lag = self.lagrangian
        return [lag.chain.q_a, lag.chain.v_a], ["q_a", "v_a"], [lag.arm_forces], ["f_a"]

    def _motor_friction(self) -> Built:
        v_m = self.lagrangian.v_m
        friction = [friction_torque(motor.friction, v_m[j]) for j, motor in enumerate(self.with_symbols.motors)]
        return [v_m], ["v_m"], [ca.vertcat(*friction)], ["f_m"]

    def _rotor_torque(self) -> Built:
        lag = self.lagrangian
        inputs = [lag.chain.q_a, lag.chain.v_a, lag.a_a, lag.v_m, lag.a_m]
        moving, rates = ca.vertcat(inputs[0], inputs[1], inputs[3]), ca.vertcat(inputs[1], inputs[2], inputs[4])
        rate = ca.jtimes(lag.momentum_m, moving, rates)
        return inputs, ["q_a", "v_a", "a_a", "v_m", "a_m"], [rate], ["tau_r"]

    def gear_spring(self) -> Built:
        """Arguments and results of the function of that name."""
        twist = ca.SX.sym("twist", self.model.n_g)
        tau: list[ca.SX] = []
        for k, (gear, ratio) in enumerate(gears(self.with_symbols)):
            spring = gear.spring
            tau.append(ca.SX(0) if spring is None else ratio * spring_torque(spring, ratio * twist[k]))
        slope = [ca.gradient(torque, twist[k]) for k, torque in enumerate(tau)]
        return [twist], ["twist"], [ca.vertcat(*tau), ca.vertcat(*slope)], ["tau", "slope"]

    def _gear_torque(self) -> Built:
        lag = self.lagrangian
        inputs = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m]
        return inputs, ["q_a", "v_a", "q_m", "v_m"], [lag.tau_g], ["tau_g"]

    def _elastic_torque(self) -> Built:
        lag = self.lagrangian
        return [lag.chain.q_a, lag.chain.v_a], ["q_a", "v_a"], [lag.tau_e], ["tau_e"]

    def _state(self) -> tuple[list[ca.SX], list[str]]:
        lag = self.lagrangian
        symbols = [lag.chain.q_a, lag.chain.v_a, lag.q_m, lag.v_m, lag.tau_m]
        return symbols, ["q_a", "v_a", "q_m", "v_m", "tau_m"]

    def _forward_dynamics(self) -> Built:
        n_a = self.model.n_a
        a_a, a_me = self._acceleration[:n_a], self._acceleration[n_a:]
        return *self._state(), [a_a, self._a_m_all(a_a, a_me)], ["a_a", "a_m"]

    def _residual(self) -> Built:
        lag, n_a = self.lagrangian, self.model.n_a
        r = self._left - lag.forces
        at = {j: k for k, j in enumerate(self.model.i_m)}
        geared = self._a_m_all(lag.a_a, lag.a_m[list(self.model.i_m)])
        r_m = ca.vertcat(*[r[n_a + at[j]] if j in at else lag.a_m[j] - geared[j] for j in range(self.model.n_m)])
        inputs = [lag.chain.q_a, lag.chain.v_a, lag.a_a, lag.q_m, lag.v_m, lag.a_m, lag.tau_m]
        names = ["q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m"]
        return inputs, names, [r[:n_a], r_m], ["r_a", "r_m"]

    def _second_order(self) -> Built:
        lag = self.lagrangian
        y, dy, _ = self._y
        r = self._left - lag.forces
        inputs = [lag.chain.q_a, lag.chain.v_a, lag.a_a, lag.q_m, lag.v_m, lag.a_m, lag.tau_m]
        names = ["q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m"]
        outputs = [self._mass, ca.jacobian(r, dy), ca.jacobian(r, y), -ca.jacobian(r, lag.tau_m)]
        return inputs, names, outputs, ["M", "D", "K", "B"]

    def _state_rate(self) -> Built:
        lag, n = self.lagrangian, self.model.dof
        y, dy, _ = self._y
        x = ca.SX.sym("x", 2 * n)
        dx = ca.substitute(ca.vertcat(dy, self._acceleration), ca.vertcat(y, dy), x)
        return [x, lag.tau_m], ["x", "tau_m"], [dx], ["dx"]

    @cached_property
    def _varied(self) -> ca.SX:
        """Derivatives of the equations' residual in (y, dy, tau_m)."""
        lag, (y, dy, _) = self.lagrangian, self._y
        r = self._left - lag.forces
        return ca.horzcat(ca.jacobian(r, y), ca.jacobian(r, dy), ca.jacobian(r, lag.tau_m))

    def _slopes(self) -> Built:
        lag = self.lagrangian
        inputs = [lag.chain.q_a, lag.chain.v_a, lag.a_a, lag.q_m, lag.v_m, lag.tau_m, lag.a_m]
        names = ["q_a", "v_a", "a_a", "q_m", "v_m", "tau_m", "a_m"]
        return inputs, names, [self._mass, self._varied], ["M", "R"]

    def _linearize(self) -> Built:
        n = self.model.dof
        slopes = ca.substitute(self._varied, self._y[2], self._acceleration)
        lower = -solve_symmetric(self._mass, slopes)
        upper = ca.horzcat(ca.SX.zeros(n, n), ca.SX.eye(n))
        A = ca.vertcat(upper, lower[:, : 2 * n])
        B = ca.vertcat(ca.SX.zeros(n, self.model.n_m), lower[:, 2 * n :])
        return *self._state(), [A, B], ["A", "B"]

    def _energy(self) -> Built:
        lag = self.lagrangian
        symbols, names = self._state()
        return symbols[:4], names[:4], [lag.kinetic, lag.potential], ["kinetic", "potential"]

    def _power(self) -> Built:
        lag = self.lagrangian
        return *self._state(), [lag.power_motor, lag.power_dissipated], ["P_motor", "P_dissipated"]

    def _output(self) -> Built:
        chain, output = self.lagrangian.chain, self.model.output
        if output.type == "combination":
            y = ca.mtimes(ca.SX(ca.DM(output.weights)), chain.q_a)
        else:
            y = chain.tool.p[["xyz".index(axis) for axis in output.axes]]
        return [chain.q_a], ["q_a"], [y], ["y"]

    def _places(self) -> Built:
        chain = self.lagrangian.chain
        return [chain.q_a], ["q_a"], [ca.horzcat(*chain.places)], ["places"]


def solve_symmetric(A: ca.SX, B: ca.SX) -> ca.SX:
    """``X`` with ``A X = B``, ``A`` symmetric positive definite: L D L' without pivots, structural zeros skipped."""
    n, m = A.shape[0], B.shape[1]
    zero = ca.SX(0)
    L: list[list[ca.SX | None]] = [[None] * n for _ in range(n)]
    D: list[ca.SX] = []
    work: list[list[ca.SX | None]] = [[None] * n for _ in range(n)]  # L_ij d_j
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            left, right = L[j][k], work[j][k]
            if left is not None and right is not None:
                d = d - left * right
        D.append(1 / d)
        for i in range(j + 1, n):
            x = A[i, j]
            for k in range(j):
                left, right = L[i][k], work[j][k]
                if left is not None and right is not None:
                    x = x - left * right
            if not x.is_zero():
                work[i][j], L[i][j] = x, x * D[j]
    columns = []
    for c in range(m):
        x = [B[i, c] if B[i, c].nnz() else zero for i in range(n)]
        for i in range(n):
            for k in range(i):
                factor = L[i][k]
                if factor is not None:
                    x[i] = x[i] - factor * x[k]
        x = [x[i] * D[i] for i in range(n)]
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                factor = L[k][i]
                if factor is not None:
                    x[i] = x[i] - factor * x[k]
        columns.append(ca.vertcat(*x))
    return ca.horzcat(*columns)


def derive(model: str | Path | RobotModel, parameters: Sequence[str] = ()) -> Equations:
    """Equations of motion of a model.

    Parameters
    ----------
    model : str, Path or RobotModel
        A name in models/, a path (either with ``@variant``), or a model that was read before.
    parameters : sequence of str
        Numbers of the model that stay symbols; names as in `flexgen.mechanics.parameters`.

    Returns
    -------
    Equations

    Raises
    ------
    ModelError, ArgumentError
        Where the model cannot be read.
    """
    return Equations(model if isinstance(model, RobotModel) else read(model), parameters)
