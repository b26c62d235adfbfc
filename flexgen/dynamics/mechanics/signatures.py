"""The table of all functions of a model: names, equations, and the arrays that go in and come out,
with their units.

Header, manifest, wrappers, the help of the command line and the docstring of `Equations` are
rendered from it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class Row:
    """A row of the table: name, summary, equation, names of inputs and outputs in `PORTS`.

    ``optional``: part of a library only where it is named.
    """

    name: str
    summary: str
    equation: str
    inputs: str
    outputs: str
    optional: bool = False


_FUNCTIONS = (
    Row(
        "forward_kinematics",
        "Position and rotation matrix of the tool in the world.",
        "p_world = p + R p_tool",
        "q_a",
        "p R",
    ),
    Row(
        "jacobian",
        "Jacobian of the tool: its linear, then its angular velocity, in world axes.",
        "(v_tool, omega_tool) = J(q_a) v_a",
        "q_a",
        "J",
    ),
    Row(
        "mass_matrix",
        "Mass matrix of the arm, without rotors.",
        "T = v_a' M(q_a) v_a / 2",
        "q_a",
        "M",
    ),
    Row(
        "mass_matrix_packed",
        "One triangle of the mass matrix: batches that do not fit into the cache take half the "
        "memory. Only where it is named.",
        "T = v_a' M(q_a) v_a / 2",
        "q_a",
        "M_packed",
        optional=True,
    ),
    Row(
        "bias",
        "Coriolis, centripetal and gravity forces of the arm.",
        "h = c(q_a, v_a) + g(q_a)",
        "q_a v_a",
        "h",
    ),
    Row("gravity", "Gravity forces of the arm.", "g = dU(q_a)/dq_a", "q_a", "g"),
    Row(
        "inverse_dynamics",
        "Forces that the arm needs for a given motion, without friction and springs.",
        "tau_a = M(q_a) a_a + c(q_a, v_a) + g(q_a)",
        "q_a v_a a_a",
        "tau_a",
    ),
    Row(
        "inverse_dynamics_derivatives",
        "First derivatives of the inverse dynamics.",
        "d tau_a = dtau_dq d q_a + dtau_dv d v_a + dtau_da d a_a",
        "q_a v_a a_a",
        "dtau_dq dtau_dv dtau_da",
    ),
    Row(
        "arm_forward_dynamics",
        "Accelerations of the arm under given forces on its coordinates, without rotors, "
        "friction and springs: the inverse of inverse_dynamics.",
        "a_a = M(q_a)^-1 (tau_a - c(q_a, v_a) - g(q_a))",
        "q_a v_a tau_a",
        "a_a",
    ),
    Row(
        "arm_forward_derivatives",
        "First derivatives of the arm's forward dynamics.",
        "d a_a = da_dq d q_a + da_dv d v_a + da_dtau d tau_a,  da_dtau = M^-1",
        "q_a v_a tau_a",
        "da_dq da_dv da_dtau",
    ),
    Row(
        "forward_dynamics",
        "Accelerations of arm and motors under the motors' torques, with springs, dampers and "
        "friction. Entries of q_m and v_m behind rigid gears are ignored; those of a_m are "
        "filled in.",
        "M a_a + c + g = tau_a,  J_m a_m + f(v_m) + eta^-T tau_g = tau_m",
        "q_a v_a q_m v_m tau_m",
        "a_a a_m",
    ),
    Row(
        "forward_dynamics_tool_force",
        "The same with a force and a torque on the tool, and the torques of the elastic gears; "
        "zero for rigid gears.",
        "M a_a + c + g = tau_a + J' f_tool,  J_m a_m + f(v_m) + eta^-T tau_g = tau_m",
        "q_a v_a q_m v_m tau_m f_tool",
        "a_a a_m tau_g",
    ),
    Row(
        "tool_motion",
        "Velocity and acceleration of the tool, linear and angular, in world axes.",
        "v_tool = J v_a,  a_tool = J a_a + J' v_a",
        "q_a v_a a_a",
        "v_tool a_tool",
    ),
    Row(
        "sensors",
        "Signals of the sensors of the model, in the order of the file, without noise.",
        "accelerometer: axes' R' (p'' - gravity),  gyro: axes' omega,  link encoder: q_a,  "
        "tracker: axes' p,  joint torque: (M a_a + c + g - f)_i,  wrench: of what is behind "
        "it,  strain: gauge q_e + offset",
        "q_a v_a a_a",
        "y_s",
    ),
    Row(
        "sensor_derivatives",
        "First derivatives of the signals of the sensors.",
        "d y_s = dys_dq d q_a + dys_dv d v_a + dys_da d a_a",
        "q_a v_a a_a",
        "dys_dq dys_dv dys_da",
    ),
    Row(
        "linearize",
        "Linearization of the forward dynamics in the state x = (q_a, q_m, v_a, v_m), "
        "of the motors only those behind elastic gears.",
        "d(dx/dt) = A dx + B d(tau_m)",
        "q_a v_a q_m v_m tau_m",
        "A B",
    ),
    Row(
        "flexible_joint_motion",
        "Acceleration and jerk of an arm with elastic joints from its state, without damping of "
        "the gears.",
        "M a_a + c + g - f = T,  T = spring(eta^-1 q_m - q_a);  j_a = d a_a/dt",
        "q_a v_a q_m v_m",
        "a_a j_a",
    ),
    Row(
        "flexible_joint_torque",
        "Torques of the motors that give an arm with elastic joints a fourth derivative of its "
        "coordinates, without damping of the gears.",
        "tau_m = J_m eta (a_a + d'') + f(v_m) + eta^-T T,  spring(d)'' = (M a_a + c + g - f)''",
        "q_a v_a a_a j_a s_a q_m v_m",
        "tau_m",
    ),
    Row(
        "motor_harmonics",
        "Motors behind gears with transmission error e, cogging torques, and factors of the "
        "motor torques.",
        "q_m - n e(q_m) = w_m,  (J_m a_m + f(v_m) + gear_share eta^-T tau_g - tau_c) / gain_m = "
        "tau_m",
        "w_m dw_m ddw_m",
        "q_m v_m a_m gear_share tau_c gain_m",
    ),
    Row(
        "loaded_friction",
        "Friction torques of the motors where some depend on the torques of the gears; instead "
        "of motor_friction.",
        "f_m = f(v_m, tau_l)",
        "v_m tau_l",
        "f_m",
    ),
    Row(
        "rotor_coupling",
        "Forces of the moving rotors on the joints that turn their carriers, and torques that "
        "the carriers take from the rotors, in complete motor coupling.",
        "tau_g = tau_g of resting rotors + tau_rg,  J_m a_m + tau_rm + f(v_m) + eta^-T tau_g = "
        "tau_m",
        "q_a v_a a_a v_m a_m",
        "tau_rg tau_rm",
    ),
    Row(
        "output_constraint",
        "How far the output is from a target, and the map W from speeds to rates of the output.",
        "y_err = y(q_a) - target,  dy/dt = W(q_a) v_a,  d2y/dt2 = W a_a + Wdot_v",
        "q_a v_a target",
        "y_err W Wdot_v",
    ),
    Row(
        "inversion_jacobians",
        "Derivatives of the output's rates, and of the equations of the coordinates without "
        "motor.",
        "y1 = W v_a,  y2 = W a_a + W' v_a,  row = [M a_a + c + g - f]_e - tau_e, f: the arm's "
        "frictions",
        "q_a v_a a_a",
        "dy1_dq dy2_dq dy2_dv row row_q row_v row_a",
    ),
    Row(
        "inversion_rows",
        "Torques of the gears for a given motion, and the remainder of the equations of the "
        "coordinates without motor.",
        "tau_g = [M a_a + c + g - f]_g,  row = [M a_a + c + g - f]_e - tau_e, f: the arm's "
        "frictions",
        "q_a v_a a_a",
        "tau_g row",
    ),
    Row(
        "gear_law",
        "Torques of the gears' springs at given deflections, and their derivatives; zero for "
        "rigid gears.",
        "tau_p = spring(deflection),  dtau_p = d tau_p/d deflection",
        "deflection",
        "tau_p dtau_p",
    ),
    Row(
        "motor_friction",
        "Friction torques of the motors.",
        "f_m = f(v_m)",
        "v_m",
        "f_m",
    ),
)

# --- products with derivatives -------------------------------------------------------------------

NOT_DIFFERENTIATED = """
mass_matrix_packed inverse_dynamics_derivatives arm_forward_derivatives sensor_derivatives \
linearize inversion_jacobians
""".split()  # (all but the first are derivatives themselves)
DIFFERENTIATED = tuple(row.name for row in _FUNCTIONS if row.name not in NOT_DIFFERENTIATED)
TANGENT = "_tangent"
COTANGENT = "_cotangent"
PRODUCTS = (
    (
        "NAME_jvp",
        (
            "Change of the results of a function for a small change of its inputs. Only where "
            "it is named."
        ),
    ),
    (
        "NAME_vjp",
        (
            "Derivatives of a weighted sum of the results of a function in its inputs. Only "
            "where it is named."
        ),
    ),
)


def split_product(name: str) -> tuple[str, str]:
    """The function and the kind of a product with its derivatives, ``"jvp"`` or ``"vjp"``; else
    the name and "".
    """
    base, _, kind = name.rpartition("_")
    return (base, kind) if kind in ("jvp", "vjp") else (name, "")


def _products(row: Row) -> list[Row]:
    """The rows of the products with a function's derivatives."""
    x = row.inputs.split()
    y = row.outputs.split()
    directions = [n + TANGENT for n in x]
    weights = [n + COTANGENT for n in y]
    changes = [n + TANGENT for n in y]
    derivatives = [n + COTANGENT for n in x]
    (jvp, change), (vjp, derivative) = (
        (name.replace("NAME", row.name), text) for name, text in PRODUCTS
    )
    forward = " ".join([*x, *directions])
    back = " ".join([*x, *weights])
    return [
        Row(
            jvp,
            change.replace("a function", row.name),
            "dy = (dy/dx) dx",
            forward,
            " ".join(changes),
            True,
        ),
        Row(
            vjp,
            derivative.replace("a function", row.name),
            "x_bar = (dy/dx)' y_bar",
            back,
            " ".join(derivatives),
            True,
        ),
    ]


TABLE = (
    *_FUNCTIONS,
    *(each for row in _FUNCTIONS if row.name in DIFFERENTIATED for each in _products(row)),
)

PYTHON_TABLE = (  # of Equations only, not emitted as C
    Row(
        "jacobian_dot",
        "Time derivative of the Jacobian of the tool.",
        "dJ = dJ(q_a)/dt",
        "q_a v_a",
        "dJ",
    ),
    Row(
        "arm_forces",
        "Joint frictions and body drags of the arm, as they act.",
        "",
        "q_a v_a",
        "f_a",
    ),
    Row(
        "given_torque",
        "Torques on the rotors: of the motors, with ripple, and cogging.",
        "",
        "q_m tau_m",
        "tau_d",
    ),
    Row(
        "rotor_torque",
        "Time derivative of the rotors' axial momentum.",
        "tau_r = d/dt (dT_rotors/dv_m)",
        "q_a v_a a_a v_m a_m",
        "tau_r",
    ),
    Row(
        "gear_torque",
        "Torques of the elastic gears, springs and dampers; zero for rigid gears.",
        "tau_g = spring(deflection) + damping d(deflection)/dt",
        "q_a v_a q_m v_m",
        "tau_g",
    ),
    Row(
        "elastic_torque",
        "Torques of the springs and dampers of the coordinates without motor.",
        "tau_e = -K_e q_e - D_e v_e for linear springs",
        "q_a v_a",
        "tau_e",
    ),
    Row(
        "residual",
        "Residuals of the equations of motion: of the arm's coordinates, then of the motors.",
        "r = d/dt dL/ddy - dL/dy - forces(y, dy, tau_m),  y = (q_a, q_m)",
        "q_a v_a a_a q_m v_m a_m tau_m",
        "r_a r_m",
    ),
    Row(
        "residual_jacobians",
        "Jacobians of the residual in y = (q_a, q_m of the motors behind elastic gears), n = "
        "n_x/2 of them.",
        "M_y = dr/dddy,  R_y = dr/d(y, dy, tau_m)",
        "q_a v_a a_a q_m v_m a_m tau_m",
        "M_y R_y",
    ),
    Row(
        "arm_residual_jacobians",
        "First derivatives of the inverse dynamics as the mass matrix and one block.",
        "R_a = d tau_a/d(q_a, v_a)",
        "q_a v_a a_a",
        "M R_a",
    ),
    Row(
        "state_rate",
        "Right-hand side of the state-space equations.",
        "dx/dt = dx(x, tau_m)",
        "x tau_m",
        "dx",
    ),
    Row(
        "energy",
        "Kinetic and potential energy, also of bodies that cannot move; the potential of "
        "gravity is zero at the origin of the world.",
        "",
        "q_a v_a q_m v_m",
        "kinetic potential",
    ),
    Row(
        "power",
        "Power of the motors, and power that frictions, dampers and drags dissipate.",
        "d(kinetic + potential)/dt = P_motor - P_dissipated",
        "q_a v_a q_m v_m tau_m",
        "P_motor P_dissipated",
    ),
    Row(
        "output",
        "The declared output; for a pose the position of the tool.",
        "y = y(q_a)",
        "q_a",
        "y",
    ),
    Row("chain_points", "Corner points of the chain, for drawing.", "", "q_a", "chain_points"),
    Row(
        "line_states",
        "Lengths, rates and tensions of the lines between two points.",
        "l = |p2 - p1|, F = F(l, dl/dt)",
        "q_a v_a",
        "l dl F_l",
    ),
    Row("line_points", "Ends of the lines in the world, in turn.", "", "q_a", "line_points"),
)

FUNCTIONS = tuple(row.name for row in TABLE if not row.optional)
OPTIONAL = tuple(row.name for row in TABLE if row.optional)
# of models whose output determines the motors' motion
INVERSION = FUNCTIONS[FUNCTIONS.index("output_constraint") :]
# the same, and of the models that have them
INVERTING = (*INVERSION, "motor_harmonics", "loaded_friction", "rotor_coupling")
# with the springs of the gears
GEARED = ("forward_dynamics", "forward_dynamics_tool_force", "linearize")
FLEXIBLE_JOINT = ("flexible_joint_motion", "flexible_joint_torque")  # of arms with elastic joints
# The functions that a robot may lack, by the part of the table of abilities with the reason.
PARTS: dict[str, tuple[str, ...]] = {
    "elastic joints": FLEXIBLE_JOINT,
    "sensors": ("sensors", "sensor_derivatives"),
    "reduced problem": INVERSION,
    "forces of an instant": (*FLEXIBLE_JOINT, *GEARED),
    "friction of speeds": ("motor_friction",),
    "friction of loads": ("loaded_friction",),
    "harmonics in C": ("motor_harmonics",),
    "rotors in C": ("rotor_coupling",),
    "inversion Jacobians": ("inversion_jacobians",),
}

# name: sizes, unit (templates: see _unit), meaning
PORTS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "q_a": (("n_a",), "{q}", "arm coordinates in chain order"),
    "v_a": (("n_a",), "{q}/s", "arm velocities"),
    "a_a": (("n_a",), "{q}/s^2", "arm accelerations"),
    "j_a": (("n_a",), "{q}/s^3", "arm jerks"),
    "s_a": (("n_a",), "{q}/s^4", "fourth time derivatives of the arm coordinates"),
    "q_m": (("n_m",), "rad", "motor angles, motor side"),
    "v_m": (("n_m",), "rad/s", "motor speeds, motor side"),
    "f_tool": (
        ("6",),
        "mixed",
        "on the tool at its origin, world axes: force [N], then torque [N m]",
    ),
    "v_tool": (
        ("6",),
        "mixed",
        "of the tool's origin [m/s], then angular velocity [rad/s], world axes",
    ),
    "a_tool": (
        ("6",),
        "mixed",
        "of the tool's origin [m/s^2], then angular acceleration [rad/s^2], world axes",
    ),
    "y_s": (("n_s",), "mixed", "signals of the sensors: m/s^2, rad/s, rad or m"),
    "dys_dq": (
        ("n_s", "n_a"),
        "mixed",
        "unit of the row's signal per unit of the column's coordinate",
    ),
    "dys_dv": (
        ("n_s", "n_a"),
        "mixed",
        "unit of the row's signal per unit of the column's velocity",
    ),
    "dys_da": (
        ("n_s", "n_a"),
        "mixed",
        "unit of the row's signal per unit of the column's acceleration",
    ),
    "a_m": (("n_m",), "rad/s^2", "motor accelerations, motor side"),
    "tau_m": (("n_m",), "N m", "motor torques, motor side"),
    "tau_a": (("n_a",), "{tau}", "forces on the arm coordinates, arm side"),
    "h": (("n_a",), "{tau}", "bias forces, arm side"),
    "g": (("n_a",), "{tau}", "gravity forces, arm side"),
    "M": (("n_a", "n_a"), "{M}", "mass matrix, symmetric"),
    "M_packed": (
        ("n_packed",),
        "{M}",
        "lower triangle of the mass matrix by columns: M_00, M_10, ..., M_11, M_21, ...",
    ),
    "p": (("3",), "m", "position of the tool, world axes"),
    "R": (("3", "3"), "1", "rotation matrix, columns: axes of the tool in the world"),
    "J": (
        ("6", "n_a"),
        "mixed",
        "rows 0-2 in m/s, rows 3-5 in rad/s, per unit of the column's velocity",
    ),
    "dtau_dq": (
        ("n_a", "n_a"),
        "mixed",
        "unit of the row's force per unit of the column's coordinate",
    ),
    "dtau_dv": (
        ("n_a", "n_a"),
        "mixed",
        "unit of the row's force per unit of the column's velocity",
    ),
    "dtau_da": (("n_a", "n_a"), "{M}", "mass matrix, symmetric"),
    "da_dq": (
        ("n_a", "n_a"),
        "mixed",
        "unit of the row's acceleration per unit of the column's coordinate",
    ),
    "da_dv": (
        ("n_a", "n_a"),
        "mixed",
        "unit of the row's acceleration per unit of the column's velocity",
    ),
    "da_dtau": (("n_a", "n_a"), "mixed", "inverse of the mass matrix, symmetric"),
    "A": (("n_x", "n_x"), "mixed", "unit of the row's x/s per unit of the column's x"),
    "B": (("n_x", "n_m"), "mixed", "unit of the row's x/s per N m"),
    "target": (("n_t",), "{y}", "where the output shall be"),
    "y_err": (("n_y",), "{y}", "output less target"),
    "W": (("n_y", "n_a"), "mixed", "unit of the row's rate per unit of the column's velocity"),
    "Wdot_v": (("n_y",), "{y}/s^2", "second time derivative of the output without accelerations"),
    "dy1_dq": (("n_y", "n_a"), "mixed", "d(W v_a)/dq_a"),
    "dy2_dq": (("n_y", "n_a"), "mixed", "d(W a_a + W' v_a)/dq_a"),
    "dy2_dv": (("n_y", "n_a"), "mixed", "d(W' v_a)/dv_a"),
    "row": (("n_e",), "{tau}", "forces on the coordinates without motor that nothing holds"),
    "row_q": (("n_e", "n_a"), "mixed", "d row/dq_a"),
    "row_v": (("n_e", "n_a"), "mixed", "d row/dv_a"),
    "row_a": (("n_e", "n_a"), "{M}", "d row/da_a: rows of the mass matrix"),
    "tau_g": (("n_g",), "{tau}", "torques of the gears on the arm, arm side"),
    "deflection": (("n_g",), "{q}", "of the gears, arm side: eta^-1 q_m - q_g"),
    "tau_p": (("n_g",), "{tau}", "torques of the gears' springs, arm side"),
    "dtau_p": (("n_g",), "mixed", "unit of the torque per unit of the coordinate"),
    "f_m": (("n_m",), "N m", "friction torques, motor side"),
    "tau_l": (("n_m",), "N m", "torques of the gears, motor side"),
    "w_m": (
        ("n_m",),
        "rad",
        "motor angles behind gears without transmission error, eta (q_g + deflection)",
    ),
    "dw_m": (("n_m",), "rad/s", "time derivative of w_m"),
    "ddw_m": (("n_m",), "rad/s^2", "time derivative of dw_m"),
    "gear_share": (
        ("n_m",),
        "1",
        "1 - n e'(q_m), part of the torque of its gear that a motor carries",
    ),
    "tau_c": (("n_m",), "N m", "cogging torques, motor side"),
    "tau_rg": (("n_g",), "{tau}", "forces of the moving rotors on the joints, arm side"),
    "tau_rm": (("n_m",), "N m", "torques that the carriers take from the rotors, motor side"),
    "gain_m": (("n_m",), "1", "torque that a motor gives over tau_m, one and its ripple"),
}
for _row in _FUNCTIONS:
    if _row.name in DIFFERENTIATED:
        for _name in f"{_row.inputs} {_row.outputs}".split():
            _extents, _template, _ = PORTS[_name]
            PORTS[_name + TANGENT] = _extents, _template, f"change of {_name}"
            PORTS[_name + COTANGENT] = (
                _extents,
                "mixed",
                f"unit of the weighted sum per unit of {_name}",
            )
PORTS["parameters" + TANGENT] = ("n_p",), "mixed", "change of parameters"
PORTS["parameters" + COTANGENT] = (
    ("n_p",),
    "mixed",
    "unit of the weighted sum per unit of parameters",
)
# of the functions in PYTHON_TABLE; n = n_x/2, k: corner points, n_l: lines
PYTHON_PORTS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "dJ": (("6", "n_a"), "mixed", "as J, per second"),
    "f_a": (("n_a",), "{tau}", "friction and drag forces, arm side"),
    "tau_d": (("n_m",), "N m", "torque on the rotor, motor side"),
    "tau_r": (("n_m",), "N m", "rate of the rotors' momentum, motor side"),
    "tau_e": (("n_e",), "{tau}", "torques of springs and dampers"),
    "r_a": (("n_a",), "{tau}", "residual of the arm, arm side"),
    "r_m": (("n_m",), "N m", "residual of the motors, motor side"),
    "M_y": (("n", "n"), "mixed", "mass matrix of y"),
    "R_y": (("n", "2 * n + n_m"), "mixed", "derivatives in y, dy and tau_m"),
    "R_a": (("n_a", "2 * n_a"), "mixed", "derivatives in q_a and v_a"),
    "x": (
        ("n_x",),
        "mixed",
        "state (q_a, q_m, v_a, v_m), of the motors only those behind elastic gears",
    ),
    "dx": (("n_x",), "mixed", "its time derivative"),
    "kinetic": ((), "J", "kinetic energy"),
    "potential": ((), "J", "potential energy of gravity and springs"),
    "P_motor": ((), "W", "power of the motors"),
    "P_dissipated": ((), "W", "dissipated power"),
    "y": (("n_y",), "{y}", "output"),
    "chain_points": (("3", "k"), "m", "points, world axes"),
    "l": (("n_l",), "m", "lengths"),
    "dl": (("n_l",), "m/s", "rates of the lengths"),
    "F_l": (("n_l",), "N", "tensions, with those of the dampers"),
    "line_points": (("3", "2 * n_l"), "m", "first end, second end of each line"),
}


def reference(rows: Sequence[Row]) -> str:
    """Text of a table for docstrings: name, inputs -> outputs with shapes, summary and
    equation.
    """
    lines = []
    for row in rows:
        shapes = []
        for name in row.outputs.split():
            extents = (PORTS | PYTHON_PORTS)[name][0]
            shapes.append(
                f"{name} ({', '.join(extents).replace(' * ', ' ')})" if extents else name
            )
        text = row.summary + (f" ``{row.equation}``" if row.equation else "")
        head = f"{row.name}({', '.join(row.inputs.split())}) -> {', '.join(shapes)}"
        lines += textwrap.wrap(head, 112, subsequent_indent="        ")
        lines += [f"    {line}" for line in textwrap.wrap(text, 108, break_on_hyphens=False)]
    return "\n".join(lines)


def function_obstacles(model: RobotModel) -> dict[str, str | None]:
    """Why a model's library cannot have a function, for each row of the table; None where it
    can.
    """
    from flexgen.model.abilities import obstacle  # here: it needs numpy, the names do not

    obstacles: dict[str, str] = {}
    for part, names in PARTS.items():
        if (reason := obstacle(model, part)) is not None:
            obstacles |= dict.fromkeys(names, reason) | obstacles
    return {row.name: obstacles.get(split_product(row.name)[0]) for row in TABLE}


def offered_functions(model: RobotModel) -> tuple[str, ...]:
    """The functions that a model's library can have."""
    obstacles = function_obstacles(model)
    return tuple(name for name in FUNCTIONS if obstacles[name] is None)
