"""The equations of motion of a model as CasADi functions: the table of all functions, and `derive`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import casadi as ca

from flexgen.errors import ArgumentError
from flexgen.mechanics import dynamics, inversion_functions, linearization
from flexgen.mechanics.system import Builder, System
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

BUILDERS: dict[str, Builder] = dynamics.BUILDERS | linearization.BUILDERS | inversion_functions.BUILDERS


class Equations(System):
    """Equations of motion of one model; each function is built when it is first used.

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
    arm_residual_        q_a, v_a, a_a                         M (n_a, n_a), R (n_a, 2 n_a) = d tau_a/d(q_a, v_a)
    jacobians
    arm_forces           q_a, v_a                              frictions and drags on the arm, as they act
    motor_friction       v_m                                   f_m (n_m)
    rotor_torque         q_a, v_a, a_a, v_m, a_m               d/dt of the rotors' axial momentum (n_m)
    gear_law             twist (n_g, arm side)                 tau_p (n_g), dtau_p (n_g): zero for rigid gears
    gear_torque          q_a, v_a, q_m, v_m                    tau_g (n_g); zero for rigid gears
    elastic_torque       q_a, v_a                              tau_e (n_e)
    forward_dynamics     q_a, v_a, q_m, v_m, tau_m             a_a, a_m
    residual             q_a, v_a, a_a, q_m, v_m, a_m, tau_m   r_a (n_a), r_m (n_m)
    state_rate           x (n_x), tau_m                        dx: the state-space right-hand side
    linearize            q_a, v_a, q_m, v_m, tau_m             A (n_x, n_x), B (n_x, n_m)
    residual_jacobians   q_a, v_a, a_a, q_m, v_m, a_m, tau_m   M (n, n) = dr/dddy, R (n, 2 n + n_m) = dr/d(y, dy, tau_m)
    energy               q_a, v_a, q_m, v_m                    kinetic, potential [J]
    power                q_a, v_a, q_m, v_m, tau_m             P_motor, P_dissipated [W]
    output               q_a                                   y (n_y), or p of the tool for a pose
    places               q_a                                   corner points of the chain (3, k), for drawing
    output_constraint    q_a, v_a, target                      y_err (n_y), W (n_y, n_a), Wdot_v (n_y)
    inversion_jacobians     q_a, v_a, a_a                         dy1_dq, dy2_dq, dy2_dv, row, row_q, row_v, row_a
    inversion_rows       q_a, v_a, a_a                         tau_g (n_g), row (n_e)
    ==================== ===================================== ==========================================

    ``x = (q_a, q_me, v_a, v_me)`` with ``q_me`` the motors behind elastic gears. Entries of ``q_m``, ``v_m``, ``a_m``
    behind rigid gears are ignored as inputs (they follow their joints) and returned filled in. ``r`` (n): residual of
    the equations of motion in ``y = (q_a, q_me)``.

    Functions of equations with ``parameters`` (names: see `flexgen.mechanics.parameters`) have these as a last argument
    where they depend on them. ``model`` keeps the numbers, ``with_symbols`` has the symbols in their place.
    """

    def __init__(self, model: RobotModel, parameters: Sequence[str] = ()) -> None:
        super().__init__(model, parameters)
        self._functions: dict[str, ca.Function] = {}

    def __reduce__(self) -> tuple[type[Equations], tuple[RobotModel, tuple[str, ...]]]:
        """Pickled as the model and the names of its parameters; the functions are built again where they are used."""
        return Equations, (self.model, tuple(parameter.name for parameter in self.parameters))

    def function(self, name: str) -> ca.Function:
        """The CasADi function of that name (see the class); ArgumentError for an unknown one."""
        if name not in self._functions:
            if name not in BUILDERS:
                raise ArgumentError(f"function: given {name!r}, expected one of {', '.join(BUILDERS)}")
            self._functions[name] = self.build(name, *BUILDERS[name](self))
        return self._functions[name]


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
