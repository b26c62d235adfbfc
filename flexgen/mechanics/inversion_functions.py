"""What inverse dynamics along a prescribed output asks of a model: a constraint, and the rows without motor.

    W(q_a) v_a = Z',      W a_a + W' v_a = Z'',      row = [M a_a + c + g - arm forces]_e - tau_e = 0

and their first derivatives. The coordinates follow from the output (`flexgen.inversion.reduced_problem`), gears and
motors afterwards: ``tau_g = [M a_a + c + g - arm forces]_g``, the twist of the gears from `gear_law`.

Defined by the Lagrangian, see `definition`; by recursion in `flexgen.recursion.inversion_functions`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca

from flexgen.errors import ArgumentError
from flexgen.mechanics.outputs import output_map

if TYPE_CHECKING:
    from flexgen.mechanics.equations import Equations

Built = tuple[list[ca.SX], list[str], list[ca.SX], list[str]]

FUNCTIONS = ("output_constraint", "inversion_slopes", "inversion_rows", "gear_law")
EXPECTED = "as many outputs as motors, and simplified motor coupling"


def definition(equations: Equations, name: str) -> Built:
    """Arguments and results of a function of `FUNCTIONS`, from the Lagrangian.

    Parameters
    ----------
    equations : Equations
        Of the model.
    name : str
        One of `FUNCTIONS`.

    Returns
    -------
    tuple
        Inputs, their names, outputs, their names.

    Raises
    ------
    ArgumentError
        Where the model does not have them.
    """
    if not equations.model.inverts:
        raise ArgumentError(f"model {equations.model.name}: {name} needs {EXPECTED}")
    lag, left = equations.lagrangian, equations.arm_left
    q, v, a = lag.chain.q_a, lag.chain.v_a, lag.a_a
    if name == "gear_law":
        inputs, names, outputs, _ = equations.gear_spring()
        return inputs, names, outputs, ["tau_p", "dtau_p"]
    if name == "inversion_rows":
        return rows(equations, left)
    output = output_map(equations)
    rate = ca.mtimes(output.rate, v)
    if name == "output_constraint":
        return constraint(equations, output.target, output.error, output.rate, ca.jtimes(rate, q, v))
    second = ca.jtimes(rate, ca.vertcat(q, v), ca.vertcat(v, a))
    of_output = [ca.jacobian(rate, q), ca.jacobian(second, q), ca.jacobian(second, v)]
    e = list(equations.model.i_e)
    chosen = [left[e], *(ca.jacobian(left[e], x) for x in (q, v, a))] if e else []
    return slopes(equations, of_output, chosen)


def constraint(equations: Equations, target: ca.SX, error: ca.SX, rate: ca.SX, bias: ca.SX) -> Built:
    """`output_constraint`: how far the output is from its target, the map from speeds to its rate, and ``W' v_a``."""
    chain = equations.lagrangian.chain
    return [chain.q_a, chain.v_a, target], ["q_a", "v_a", "target"], [error, rate, bias], ["y_err", "W", "Wdot_v"]


def rows(equations: Equations, left: ca.SX) -> Built:
    """`inversion_rows` from ``M a_a + c + g`` (n_a)."""
    lag, model = equations.lagrangian, equations.model
    force = left - lag.arm_forces
    inputs, names = [lag.chain.q_a, lag.chain.v_a, lag.a_a], ["q_a", "v_a", "a_a"]
    tau_g = force[list(model.i_g)]
    if not model.i_e:
        return inputs, names, [tau_g], ["tau_g"]
    return inputs, names, [tau_g, force[list(model.i_e)] - lag.tau_e], ["tau_g", "row"]


def slopes(equations: Equations, of_output: list[ca.SX], of_left: list[ca.SX]) -> Built:
    """`inversion_slopes` from the derivatives of the output's rates, and of the rows e of ``M a_a + c + g``.

    ``of_left``: the rows (n_e) and their derivatives in coordinates, speeds and accelerations (n_e, n_a).
    """
    lag, e = equations.lagrangian, list(equations.model.i_e)
    q, v, a = lag.chain.q_a, lag.chain.v_a, lag.a_a
    names = ["dy1_dq", "dy2_dq", "dy2_dv"]
    if e:
        row, by_q, by_v, by_a = of_left
        force = lag.arm_forces[e] + lag.tau_e
        of_output = [*of_output, row - force, by_q - ca.jacobian(force, q), by_v - ca.jacobian(force, v), by_a]
        names += ["row", "row_q", "row_v", "row_a"]
    return [q, v, a], ["q_a", "v_a", "a_a"], of_output, names
