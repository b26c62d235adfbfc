"""Functions for inverse dynamics along a prescribed output, as builders: output constraint and
rows without motor.

    W(q_a) v_a = Z',      W a_a + W' v_a = Z'',
    row = [M a_a + c + g - arm forces]_e - tau_e = 0

and their first derivatives. The coordinates follow from the output
(`flexgen.inversion.problem.reduced_problem`), then gears and motors:
``tau_g = [M a_a + c + g - arm forces]_g``, the deflection of the gears from `gear_law` of
`flexgen.dynamics.mechanics.dynamics`.

Here from the Lagrangian; by recursion in `flexgen.codegen.recursion.inversion_functions`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.dynamics import rotor_forces
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.system import Builder, Built, System
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel

MASSLESS = 1e-9  # relative: an inertia that is rounding


def _check(system: System, name: str) -> None:
    """ArgumentError where the model does not have the function."""
    reason = obstacle(system.model, "reduced problem")
    if reason is not None:
        raise ArgumentError(f"function {name}: {reason}")


def output_constraint(system: System) -> Built:
    """Error of the output, the map W from velocities to rates of the output, and ``W' v_a``."""
    _check(system, "output_constraint")
    chain = system.lagrangian.chain
    output = output_map(system)
    bias = ca.jtimes(ca.mtimes(output.rate, chain.v_a), chain.q_a, chain.v_a)
    return constraint_ports(system, output.target, output.error, output.rate, bias)


def inversion_rows(system: System) -> Built:
    """Torques of the gears, and residuals of the rows without motor."""
    _check(system, "inversion_rows")
    return row_ports(system, system.arm_left)


def inversion_jacobians(system: System) -> Built:
    """First derivatives of the output's rates and of the rows without motor."""
    _check(system, "inversion_jacobians")
    lag = system.lagrangian
    left = system.arm_left
    q = lag.chain.q_a
    v = lag.chain.v_a
    a = lag.a_a
    rate = ca.mtimes(output_map(system).rate, v)
    second = ca.jtimes(rate, ca.vertcat(q, v), ca.vertcat(v, a))
    of_output = [ca.jacobian(rate, q), ca.jacobian(second, q), ca.jacobian(second, v)]
    e = list(system.model.i_e)
    of_left = [left[e], *(ca.jacobian(left[e], x) for x in (q, v, a))] if e else []
    return derivative_ports(system, of_output, of_left)


def constraint_ports(
    system: System, target: ca.SX, error: ca.SX, rate: ca.SX, bias: ca.SX
) -> Built:
    """`output_constraint` from the output's error (n_y), its map W (n_y, n_a) and ``W' v_a``
    (n_y).
    """
    chain = system.lagrangian.chain
    return (
        [chain.q_a, chain.v_a, target],
        ["q_a", "v_a", "target"],
        [error, rate, bias],
        ["y_err", "W", "Wdot_v"],
    )


def row_ports(system: System, left: ca.SX) -> Built:
    """`inversion_rows` from ``M a_a + c + g`` (n_a)."""
    lag = system.lagrangian
    model = system.model
    force = left - lag.arm_forces
    inputs = [lag.chain.q_a, lag.chain.v_a, lag.a_a]
    names = ["q_a", "v_a", "a_a"]
    tau_g = force[list(model.i_g)]
    if not model.i_e:
        return inputs, names, [tau_g], ["tau_g"]
    row = force[list(model.i_e)] - lag.tau_e + rotor_rows(system)
    return inputs, names, [tau_g, row], ["tau_g", "row"]


def rotor_rows(system: System) -> ca.SX:
    """Forces (n_e) on the rows without motor of rotors that coordinates without motor turn, in
    complete motor coupling.

    The rotors move as behind rigid gears, ``v_m = eta v_g``: the acceleration of a deflection is
    small against that of its joint, and so is the share of a rotor in these rows. Zero, without
    an operation, where no such coordinate turns a rotor.
    """
    model = system.model
    if obstacle(model, "simplified coupling") is None:
        return ca.SX.zeros(model.n_e)
    lag = system.lagrangian
    i_g = list(model.i_g)
    eta = ca.SX(ca.DM(model.eta))
    moving = (ca.mtimes(eta, x[i_g]) for x in (lag.chain.v_a, lag.a_a))
    return rotor_forces(system, *moving)[list(model.i_e)]


def derivative_ports(system: System, of_output: list[ca.SX], of_left: list[ca.SX]) -> Built:
    """`inversion_jacobians` from the derivatives of the output's rates, and of the rows e of
    ``M a_a + c + g``.

    ``of_left``: the rows (n_e) and their derivatives in coordinates, velocities and accelerations
    (n_e, n_a).
    """
    lag = system.lagrangian
    e = list(system.model.i_e)
    q = lag.chain.q_a
    v = lag.chain.v_a
    a = lag.a_a
    names = ["dy1_dq", "dy2_dq", "dy2_dv"]
    if e:
        row, by_q, by_v, by_a = of_left
        force = lag.arm_forces[e] + lag.tau_e - rotor_rows(system)
        of_output = [
            *of_output,
            row - force,
            by_q - ca.jacobian(force, q),
            by_v - ca.jacobian(force, v),
            by_a - ca.jacobian(force, a),
        ]
        names += ["row", "row_q", "row_v", "row_a"]
    return [q, v, a], ["q_a", "v_a", "a_a"], of_output, names


def lacks_inertia(
    model: RobotModel,
    jacobians: ca.Function,
    constraint: ca.Function,
    values: Mapping[str, Sequence[float]],
) -> bool:
    """Whether some motion of the coordinates without motor that keeps the output has no inertia,
    in every pose.

    ``A = R_a S`` is singular then: R the rows without motor, S the motions with ``W S = 0``. Such
    is a chain of masses on one axis whose output is the last mass. Seen at the home pose and at
    two others, drawn.

    Parameters
    ----------
    model : RobotModel
    jacobians, constraint : casadi.Function
        Its functions `inversion_jacobians` and `output_constraint`.
    values : mapping of str to numbers
        Further inputs of these, by name.
    """
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    rng = np.random.default_rng(0)
    for amplitude in (0.0, 0.3, 0.3) if i_e else ():
        q = amplitude * rng.standard_normal(model.n_a)
        q[i_g] += model.home
        by_a, W = (
            np.array(
                f.call({key: x for key, x in {"q_a": q, **values}.items() if key in f.name_in()})[
                    name
                ]
            )
            for f, name in ((jacobians, "row_a"), (constraint, "W"))
        )
        if not (np.isfinite(by_a).all() and np.isfinite(W).all()):
            return False
        # units of rows and columns: their own inertia
        own = np.sqrt(np.diag(by_a[:, i_e]).clip(np.finfo(float).tiny))
        A = by_a[:, i_e] - by_a[:, i_g] @ np.linalg.lstsq(W[:, i_g], W[:, i_e], rcond=None)[0]
        if np.linalg.svd(A / own / own[:, None], compute_uv=False)[-1] > MASSLESS:
            return False
    return bool(i_e)


BUILDERS: dict[str, Builder] = {
    "output_constraint": output_constraint,
    "inversion_jacobians": inversion_jacobians,
    "inversion_rows": inversion_rows,
}
