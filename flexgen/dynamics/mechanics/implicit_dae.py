"""The equations of motion as one implicit differential-algebraic equation F(xdot, x, z, u) = 0
with names and units.

    x = (q_a, q_me, v_a, v_me),  z = (tau_g, y),  u = tau_m

    dq/dt - v                               = 0      n rows
    equations of motion at (q, v, dv/dt, u) = 0      n rows
    tau_g - gear torques at (q, v)          = 0      n_g rows
    y - output at q_a                       = 0
    rows of the declared output (of a pose: its position)

``q_me``: the motors behind elastic gears. The derivative of F in (xdot, z) is regular: the
differential index is one. The equations with the output prescribed, of index three to five, are
`flexgen.dynamics.dae.system.InverseDae`.
"""

from __future__ import annotations

import casadi as ca

from flexgen.dynamics.mechanics import dynamics
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.dynamics.mechanics.system import ImplicitDae, System


def implicit_dae(system: System) -> ImplicitDae:
    """The `ImplicitDae` of a robot: ``F(xdot, x, z, u) = 0`` with the state ``x = (y, dy)``, gear
    torques and outputs ``z``, motor torques ``u``.

    Rows: ``xdot`` of the coordinates is ``dy``, equations of motion, definitions of z.
    """
    model = system.model
    lag = system.lagrangian
    y, dy, ddy = system.y
    n = model.dof
    i_g = list(model.i_g)
    output = ca.densify(dynamics.output(system)[2][0])
    n_z = model.n_g + output.numel()
    xdot = ca.SX.sym("xdot", 2 * n)
    x = ca.SX.sym("x", 2 * n)
    z = ca.SX.sym("z", n_z)
    rows = ca.vertcat(
        xdot[:n] - x[n:], system.residual, z[: model.n_g] - lag.tau_g, z[model.n_g :] - output
    )  # fmt: skip
    rows = ca.substitute(rows, ca.vertcat(y, dy, ddy), ca.vertcat(x[:n], x[n:], xdot[n:]))
    inputs = [xdot, x, z, lag.tau_m]
    names = ["xdot", "x", "z", "u"]
    function = system.build("dae", inputs, names, [rows], ["F"])
    arm = [c.name for c in model.coordinates]
    motors = [model.motors[j].name for j in model.i_m]
    unit = [c.unit for c in model.coordinates] + ["rad"] * len(motors)
    force = ["N m" if u == "rad" else "N" for u in unit]
    states = [f"q_a[{a}]" for a in arm] + [f"q_m[{m}]" for m in motors]
    speeds = [f"v_a[{a}]" for a in arm] + [f"v_m[{m}]" for m in motors]
    gears = [f"tau_g[{arm[i]}]" for i in i_g]
    outputs = [f"y[{label}]" for label in output_labels(model)["y_ref"]]
    of_y = list(output_units(model))
    of_g = [force[i] for i in i_g]
    return ImplicitDae(
        function=function,
        x=tuple(states + speeds),
        z=tuple(gears + outputs),
        u=tuple(f"tau_m[{motor.name}]" for motor in model.motors),
        rows=tuple(
            [f"rate of {name}" for name in states]
            + [f"equation of motion of {name}" for name in [*arm, *motors]]
            + [f"definition of {name}" for name in [*gears, *outputs]]
        ),
        x_units=tuple(unit + [f"{u}/s" for u in unit]),
        z_units=tuple(of_g + of_y),
        u_units=("N m",) * model.n_m,
        row_units=tuple([f"{u}/s" for u in unit] + force + of_g + of_y),
    )
