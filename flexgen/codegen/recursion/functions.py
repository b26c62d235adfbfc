"""Fast functions: the functions of `Equations` by recursions that are specialized to one robot.

The Lagrangian defines and checks the results; here the same arguments give the same results with
fewer operations. The forces of gears, springs, frictions and drags are the graphs of the
Lagrangian. Of several recursions the shortest for the robot is used. A robot for which recursion
and Lagrangian differ uses the Lagrangian.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np

from flexgen.codegen.recursion import (
    accelerations,
    composite_body,
    inversion_functions,
    kinematics,
    products,
)
from flexgen.codegen.recursion.arm import Arm, Columns, Route, arm_of, matrix_of, vectors
from flexgen.codegen.recursion.dh_chain import Chain, make_chain
from flexgen.codegen.recursion.tape import Scalar, Tape
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.signatures import split_product
from flexgen.dynamics.mechanics.system import Built
from flexgen.model.abilities import obstacle

# with the motors
_WHOLE = ("forward_dynamics", "forward_dynamics_tool_force", "residual_jacobians")
TRIALS = 3  # states at which a robot is tested before the recursion is used for it
NEAR = 0.02  # distance from home [rad, m] at which closed loops can be closed
AGREEMENT = 1e-9  # of the largest entry: far above rounding, far below errors that matter


def fast_function(equations: Equations, name: str) -> ca.Function | None:
    """A function of `Equations` by recursion, with the same arguments and dense results, where the
    robot passes a test.

    Before the first use for a robot, its inverse dynamics, mass matrix and tool pose are compared
    with the Lagrangian's at some states: see `agrees`. Where they differ, no function of this
    robot uses the recursion.

    Parameters
    ----------
    equations : Equations
        Of the robot.
    name : str
        As for ``Equations.function``.

    Returns
    -------
    casadi.Function or None
        None where `recursive_function` has none, and for robots that do not pass: the Lagrangian's
        is to be used.
    """
    function = recursive_function(equations, name)
    return function if function is not None and _passes(equations) else None


def recursive_function(equations: Equations, name: str) -> ca.Function | None:
    """A function of `Equations` by recursion, whether or not the robot passes the test of
    `fast_function`.

    Parameters
    ----------
    equations : Equations
        Of the robot.
    name : str
        As for ``Equations.function``.

    Returns
    -------
    casadi.Function or None
        None where there is no recursion: robots with beams, the whole robot where rotors turn with
        their carriers, functions other than those of the table below, robots whose bodies or
        rotors may change at run time, and accelerations of robots with a singular mass matrix
        (such as a massless last link): a recursion would divide by zero.
    """
    model = equations.model
    base, product = split_product(name)
    carried = base in _WHOLE and obstacle(model, "simplified coupling") is not None
    carried = carried or (
        name in inversion_functions.BUILDERS and obstacle(model, "reduced problem") is not None
    )
    inertias = any(parameter.inertia for parameter in equations.parameters)
    if base not in RECURSIVE_BUILDERS or carried or inertias:
        return None
    arm = arm_of(equations)
    if obstacle(arm.tree, "recursion") is not None:
        return None
    if name not in arm.functions:
        try:
            built = _product(arm, base, product) if product else RECURSIVE_BUILDERS[name](arm)
            arm.functions[name] = None if built is None else equations.build(name, *built)
        except ZeroDivisionError:
            arm.functions[name] = None
    return arm.functions[name]


def _product(arm: Arm, name: str, product: str) -> Built | None:
    """The product of a function's derivatives, by a recursion of its own where no run-time
    parameter changes it.
    """
    function = recursive_function(arm.equations, name)
    finished = name not in products.BUILDERS
    if function is None or "parameters" in function.name_in() or finished:
        return None if function is None else products.of_function(arm, function, product)
    # (chooses the recursion for accelerations)
    recursive_function(arm.equations, "arm_forward_dynamics")
    inputs, names, found, named = products.BUILDERS[name](arm, product)
    # closures are in the function and in its derivatives
    return inputs, names, ca.cse(found) if arm.closed is not None else found, named


def agrees(equations: Equations) -> bool:
    """Whether the recursion gives a robot's inverse dynamics, mass matrix and tool pose as the
    Lagrangian does.

    Compared at fixed random states (rotations and translations within 1 rad or 1 m, those of
    closed loops within `NEAR` of home, speeds and accelerations within 1), parameters at the
    values of the file; no entry may differ by more than `AGREEMENT` of the largest one.

    Parameters
    ----------
    equations : Equations
        Of a robot that has fast functions.

    Returns
    -------
    bool
    """
    rng = np.random.default_rng(0)
    n_a = equations.model.n_a
    values = np.array([parameter.value for parameter in equations.parameters])
    states = [
        {name: rng.uniform(-1.0, 1.0, n_a) for name in ("q_a", "v_a", "a_a")}
        | {"parameters": values}
        for _ in range(TRIALS)
    ]
    if equations.model.loops:
        home = np.zeros(n_a)
        home[list(equations.model.i_g)] = equations.model.home
        states = [state | {"q_a": home + NEAR * state["q_a"]} for state in states]
    for name in ("inverse_dynamics", "mass_matrix", "forward_kinematics"):
        fast = recursive_function(equations, name)
        slow = equations.function(name)
        assert fast is not None
        for state in states:
            results = [f.call([state[port] for port in f.name_in()]) for f in (fast, slow)]
            a, b = (np.concatenate([x.full().ravel() for x in result]) for result in results)
            if not np.max(np.abs(a - b)) <= AGREEMENT * np.max(np.abs(b)):  # (NaN does not agree)
                return False
    return True


@lru_cache(maxsize=4)
def _passes(equations: Equations) -> bool:
    """`agrees`, evaluated once for each robot; the last few results are kept."""
    return agrees(equations)


def operations_of(function: ca.Function) -> int:
    """Arithmetic operations of an SX function; sines, cosines and other functions are not
    counted.
    """
    counted = (
        ca.OP_DIV,
        ca.OP_INV,
        ca.OP_SQRT,
        ca.OP_ADD,
        ca.OP_SUB,
        ca.OP_MUL,
        ca.OP_NEG,
        ca.OP_SQ,
        ca.OP_TWICE,
    )
    return sum(function.instruction_id(k) in counted for k in range(function.n_instructions()))


# --- the arm -------------------------------------------------------------------------------------


def _inverse_dynamics(arm: Arm) -> Built:
    """Torques ``tau_a`` (n_a) of ``q_a, v_a, a_a``: symbols of inputs, their names, results, their
    names, as of every builder here.
    """
    inputs = arm.symbols("q_a", "v_a", "a_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q, v, a = vectors(tape, *inputs)
        return arm.torques(tape, chain, q, v, a, columns)

    return (
        inputs,
        ["q_a", "v_a", "a_a"],
        [ca.vertcat(*arm.shortest([route], several=False))],
        ["tau_a"],
    )


def _bias(arm: Arm) -> Built:
    """Forces ``h`` (n_a) of ``q_a, v_a`` without acceleration, gravity included; returned as of
    `_inverse_dynamics`.
    """
    inputs = arm.symbols("q_a", "v_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        still: list[Scalar] = [0.0] * arm.model.n_a
        q, v = vectors(tape, *inputs)
        return arm.torques(tape, chain, q, v, still, columns)

    return inputs, ["q_a", "v_a"], [ca.vertcat(*arm.shortest([route]))], ["h"]


def _gravity(arm: Arm) -> Built:
    """Forces ``g`` (n_a) that hold the arm at ``q_a``, by the recursion or as the gradient of
    potential energy; returned as of `_inverse_dynamics`.
    """
    inputs = arm.symbols("q_a")

    def by_recursion(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        still: list[Scalar] = [0.0] * arm.model.n_a
        return arm.torques(tape, chain, tape.vector(inputs[0]), still, still, columns)

    def by_differentiation(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q = tape.vector(inputs[0])
        return tape.gradient(composite_body.height(tape, chain, arm.joints(tape, q).q), q)

    routes = [by_recursion] if arm.closed is not None else [by_recursion, by_differentiation]
    return inputs, ["q_a"], [ca.vertcat(*arm.shortest(routes))], ["g"]


def _mass_matrix(arm: Arm) -> Built:
    """Mass matrix ``M`` (n_a, n_a) of the arm at ``q_a``; returned as of `_inverse_dynamics`."""
    inputs = arm.symbols("q_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        return [x for row in arm.mass_matrix(tape, chain, tape.vector(inputs[0])) for x in row]

    return inputs, ["q_a"], [matrix_of(arm.shortest([route]), arm.model.n_a)], ["M"]


def _arm_forward_dynamics(arm: Arm) -> Built:
    tau_a = ca.SX.sym("tau_a", arm.model.n_a)
    a_a = _accelerations(arm, tau_a, np.zeros((arm.model.n_a, arm.model.n_a)))
    return [*arm.symbols("q_a", "v_a"), tau_a], ["q_a", "v_a", "tau_a"], [a_a], ["a_a"]


def _accelerations(arm: Arm, force: ca.SX, armature: np.ndarray) -> ca.SX:
    """Accelerations (n_a) of the arm under ``force`` (n_a), expressions in any symbols;
    ``armature`` (n_a, n_a): rotors, added to the mass matrix.
    """
    shared = accelerations.kind(armature)
    # the choice depends on the arm only, not on the function that is asked for first
    if shared and np.any(armature):
        recursive_function(arm.equations, "arm_forward_dynamics")
    routes: list[Route] = [
        lambda *plan, by=by: by(*plan).a for by in accelerations.routes(arm, force, armature)
    ]
    return ca.vertcat(*arm.shortest(routes, kind=shared))


def _inverse_dynamics_derivatives(arm: Arm) -> Built:
    names = ["q_a", "v_a", "a_a"]
    return arm.symbols(*names), names, arm.derivatives, ["dtau_dq", "dtau_dv", "dtau_da"]


def _arm_residual_jacobians(arm: Arm) -> Built:
    names = ["q_a", "v_a", "a_a"]
    by_q, by_v, M = arm.derivatives
    return arm.symbols(*names), names, [M, ca.horzcat(by_q, by_v)], ["M", "R_a"]


# --- the whole robot -----------------------------------------------------------------------------


def _forward_dynamics(arm: Arm) -> Built:
    a_a, a_m = _whole_accelerations(arm, arm.equations.lagrangian.forces[: arm.model.n_a])
    names = ["q_a", "v_a", "q_m", "v_m", "tau_m"]
    return arm.symbols(*names), names, [a_a, a_m], ["a_a", "a_m"]


def _forward_dynamics_tool_force(arm: Arm) -> Built:
    """Accelerations of arm and motors, and gear torques, with a wrench ``f_tool`` (6) [N, N m] on
    the tool: ``J' f_tool`` joins the forces. Returned as of `_inverse_dynamics`.
    """
    lagrangian = arm.equations.lagrangian
    f_tool = ca.SX.sym("f_tool", 6)
    pushed = ca.mtimes(_jacobian(arm)[2][0].T, f_tool)
    a_a, a_m = _whole_accelerations(arm, lagrangian.forces[: arm.model.n_a] + pushed)
    names = ["q_a", "v_a", "q_m", "v_m", "tau_m"]
    outputs = [a_a, a_m, ca.densify(lagrangian.tau_g)]
    return [*arm.symbols(*names), f_tool], [*names, "f_tool"], outputs, ["a_a", "a_m", "tau_g"]


def _whole_accelerations(arm: Arm, on_arm: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Accelerations of the arm (n_a) under forces ``on_arm`` (n_a), and of the motors (n_m):
    geared ones follow the arm, others follow the forces of the equations on them.
    """
    model = arm.model
    forces = arm.equations.lagrangian.forces
    a_a = _accelerations(arm, on_arm, arm.armature)
    geared = ca.mtimes(ca.SX(ca.DM(model.eta)), ca.vertcat(*[a_a[i] for i in model.i_g]))
    a_m = [geared[j] for j in range(model.n_m)]
    for k, j in enumerate(model.i_m):
        a_m[j] = forces[model.n_a + k] * (1.0 / model.motors[j].inertia)
    return a_a, ca.vertcat(ca.SX(0, 1), *a_m)


def beside_the_arm(arm: Arm) -> tuple[ca.SX, ca.SX]:
    """Rotors in ``M_y``; springs, dampers, frictions and torques in ``R_y``:
    ``-d(forces)/d(y, dy, tau_m)``.
    """
    model = arm.model
    forces = arm.equations.lagrangian.forces
    n = model.dof
    n_a = model.n_a
    i_m = model.i_m
    M = ca.SX.zeros(n, n)
    M[:n_a, :n_a] = ca.SX(ca.DM(arm.armature))
    for k, j in enumerate(i_m):
        M[n_a + k, n_a + k] = model.motors[j].inertia
    q_a, v_a, q_m, v_m, tau_m = arm.symbols("q_a", "v_a", "q_m", "v_m", "tau_m")
    y, dy = (ca.vertcat(x, *[x_m[j] for j in i_m]) for x, x_m in ((q_a, q_m), (v_a, v_m)))
    return M, -ca.densify(ca.horzcat(*(ca.jacobian(forces, x) for x in (y, dy, tau_m))))


def _residual_jacobians(arm: Arm) -> Built:
    """``M_y`` (dof, dof) and ``R_y`` (dof, 2 dof + n_m) of the whole robot: rotors and forces of
    the drives, to which the derivatives of the arm are added. Returned as of `_inverse_dynamics`.
    """
    n = arm.model.dof
    n_a = arm.model.n_a
    by_q, by_v, M_a = arm.derivatives
    M, R = beside_the_arm(arm)
    M[:n_a, :n_a] += M_a
    R[:n_a, :n_a] += by_q
    R[:n_a, n : n + n_a] += by_v
    names = ["q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m"]
    return arm.symbols(*names), names, [M, R], ["M_y", "R_y"]


# --- the tool ------------------------------------------------------------------------------------


def _forward_kinematics(arm: Arm) -> Built:
    """Position ``p`` (3) [m] and rotation matrix ``R`` of the tool at ``q_a``; returned as of
    `_inverse_dynamics`.
    """
    inputs = arm.symbols("q_a")
    tape = Tape()
    p, R = kinematics.tool_pose(
        tape, make_chain(arm.tree, to_mass=False), arm.joints(tape, tape.vector(inputs[0])).q
    )
    flat = tape.build([*p, *(x for row in R for x in row)])
    return inputs, ["q_a"], [ca.vertcat(*flat[:3]), matrix_of(flat[3:], 3)], ["p", "R"]


def _jacobian(arm: Arm) -> Built:
    """Jacobian ``J`` (6, n_a) of the tool, linear rows first; returned as of
    `_inverse_dynamics`.
    """
    inputs = arm.symbols("q_a")
    tape = Tape()
    J = arm.jacobian(tape, make_chain(arm.tree, to_mass=False), tape.vector(inputs[0]))
    return (
        inputs,
        ["q_a"],
        [matrix_of(tape.build([x for row in J for x in row]), arm.model.n_a)],
        ["J"],
    )


def _tool_motion(arm: Arm) -> Built:
    """Velocity and acceleration of the tool (6), linear components first; returned as of
    `_inverse_dynamics`.
    """
    names = ["q_a", "v_a", "a_a"]
    tape = Tape()
    inputs = arm.symbols(*names)
    at = arm.joints(tape, *vectors(tape, *inputs))
    moving = kinematics.rates(tape, make_chain(arm.tree, to_mass=False), at.q, at.v, at.a)
    still: Scalar = 0.0
    v_tool = [still] * 6
    a_tool = list(moving.bias)
    for (J, _, _), speed in zip(moving.columns, at.v, strict=True):
        v_tool = [x + y * speed for x, y in zip(v_tool, J, strict=True)]
    flat = tape.build([*v_tool, *a_tool])
    return inputs, names, [ca.vertcat(*flat[:6]), ca.vertcat(*flat[6:])], ["v_tool", "a_tool"]


RECURSIVE_BUILDERS: dict[str, Callable[[Arm], Built]] = {
    "mass_matrix": _mass_matrix,
    "bias": _bias,
    "gravity": _gravity,
    "inverse_dynamics": _inverse_dynamics,
    "inverse_dynamics_derivatives": _inverse_dynamics_derivatives,
    "arm_forward_dynamics": _arm_forward_dynamics,
    "arm_residual_jacobians": _arm_residual_jacobians,
    "forward_dynamics": _forward_dynamics,
    "forward_dynamics_tool_force": _forward_dynamics_tool_force,
    "residual_jacobians": _residual_jacobians,
    "forward_kinematics": _forward_kinematics,
    "jacobian": _jacobian,
    "tool_motion": _tool_motion,
    **inversion_functions.BUILDERS,
}
