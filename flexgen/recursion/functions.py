"""The fast path: functions of `Equations` made by recursions that are specialised to one robot.

The Lagrangian defines what is computed and judges it; here the same arguments give the same results with fewer
operations. The forces of gears, springs, frictions and drags are the graphs of the Lagrangian themselves. Where there
are several ways, the shortest for the robot is taken. A robot for which the two differ falls back to the Lagrangian.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial

import casadi as ca
import numpy as np

from flexgen.mechanics.equations import Equations
from flexgen.model.elements import Body, RobotModel
from flexgen.recursion import (
    articulated_body,
    composite_body,
    derivatives,
    inversion_functions,
    kinematics,
    newton_euler,
)
from flexgen.recursion.dh_chain import Chain, Inertia, compose, inertia_of, inverse, laid, pose_of
from flexgen.recursion.regrouping import Plan, plans
from flexgen.recursion.tape import Cost, Scalar, Tape

AD_UP_TO = 10  # coordinates; the recursion for derivatives is shorter than differentiated code beyond
TRIALS = 3  # states at which a robot is tested before the recursion is used for it
AGREEMENT = 1e-9  # of the largest entry: far above rounding, far below errors that matter

Built = tuple[list[ca.SX], list[str], list[ca.SX], list[str]]
Columns = tuple[bool, ...]
Route = Callable[[Tape, Chain, Columns], list[Scalar]]


def fast_function(equations: Equations, name: str) -> ca.Function | None:
    """A function of `Equations` by recursion, with the same arguments and dense results, where the robot passes a test.

    Before a robot's first function is handed out, its inverse dynamics, mass matrix and tool pose are compared with the
    Lagrangian's at some states: see `agrees`. Where they differ, the recursion is used for nothing of this robot.

    Parameters
    ----------
    equations : Equations
        Of the robot.
    name : str
        As for ``Equations.function``.

    Returns
    -------
    casadi.Function or None
        None where `recursive_function` has none, and for robots that do not pass: the Lagrangian's is to be used.
    """
    function = recursive_function(equations, name)
    return function if function is not None and _arm_of(equations).agrees else None


def recursive_function(equations: Equations, name: str) -> ca.Function | None:
    """A function of `Equations` by recursion, whether or not the robot passes the test of `fast_function`.

    Parameters
    ----------
    equations : Equations
        Of the robot.
    name : str
        As for ``Equations.function``.

    Returns
    -------
    casadi.Function or None
        None where there is no fast path: robots with beams, the whole machine where rotors turn with their carriers,
        functions other than those of the table below, and accelerations of robots whose motion nothing resists (such
        as a massless last link): a recursion would divide by the number zero.
    """
    model = equations.model
    carried = model.motor_coupling == "complete" and name in ("forward_dynamics", "slopes")
    carried = carried or (name in inversion_functions.BUILDERS and not model.inverts)
    if name not in _BUILDERS or carried or any(element.beam is not None for element in model.elements):
        return None
    arm = _arm_of(equations)
    if name not in arm.functions:
        try:
            arm.functions[name] = equations.built(name, *_BUILDERS[name](arm))
        except ZeroDivisionError:
            arm.functions[name] = None
    return arm.functions[name]


def agrees(equations: Equations) -> bool:
    """Whether the recursion gives a robot's inverse dynamics, mass matrix and tool pose as the Lagrangian does.

    Asked at fixed random states (rotations and translations within 1 rad or 1 m, speeds and accelerations within 1),
    parameters at the values of the file; no entry may differ by more than `AGREEMENT` of the largest one.

    Parameters
    ----------
    equations : Equations
        Of a robot that has a fast path.

    Returns
    -------
    bool
    """
    rng, n_a = np.random.default_rng(0), equations.model.n_a
    values = np.array([parameter.value for parameter in equations.parameters])
    states = [
        {name: rng.uniform(-1.0, 1.0, n_a) for name in ("q_a", "v_a", "a_a")} | {"parameters": values}
        for _ in range(TRIALS)
    ]
    for name in ("inverse_dynamics", "mass_matrix", "forward_kinematics"):
        fast, slow = recursive_function(equations, name), equations.function(name)
        assert fast is not None
        for state in states:
            results = [f.call([state[port] for port in f.name_in()]) for f in (fast, slow)]
            a, b = (np.concatenate([x.full().ravel() for x in result]) for result in results)
            if not np.max(np.abs(a - b)) <= AGREEMENT * np.max(np.abs(b)):  # (what is not a number does not agree)
                return False
    return True


def cost_of(function: ca.Function) -> Cost:
    """What the instructions of an SX function cost; sines, cosines and other functions are not counted."""
    weight = {ca.OP_DIV: 4, ca.OP_INV: 4, ca.OP_SQRT: 4}
    weight |= dict.fromkeys((ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE), 1)
    depth: dict[int, int] = {}
    count = longest = 0
    for k in range(function.n_instructions()):
        kind, reads, writes = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if kind == ca.OP_OUTPUT:
            longest = max(longest, depth.get(reads[0], 0))
            continue
        before = 0 if kind in (ca.OP_INPUT, ca.OP_CONST) else max((depth.get(x, 0) for x in reads), default=0)
        count += kind in weight
        depth[writes[0]] = before + weight.get(kind, 0)
    return Cost(count, longest)


@dataclass(frozen=True)
class _Arm:
    """The symbols of the machine, and rows and matrices from the shortest of some routes."""

    equations: Equations
    functions: dict[str, ca.Function | None] = field(default_factory=dict)

    @property
    def model(self) -> RobotModel:
        return self.equations.model

    @cached_property
    def agrees(self) -> bool:
        """Whether the robot passed the test of `fast_function`."""
        return agrees(self.equations)

    def symbols(self, *names: str) -> list[ca.SX]:
        """Vectors by their names, the Lagrangian's own."""
        lag = self.equations.lagrangian
        known = {"q_a": lag.chain.q_a, "v_a": lag.chain.v_a, "a_a": lag.a_a}
        known |= {"q_m": lag.q_m, "v_m": lag.v_m, "a_m": lag.a_m, "tau_m": lag.tau_m}
        return [known[name] for name in names]

    def chain(self, tape: Tape, plan: Plan) -> Chain:
        """The chain of a plan, with the symbols of the payload where its numbers may change at run time."""
        if not self.loaded:
            return plan.chain
        body = self.equations.with_symbols.payload
        rotation, position = compose(plan.chain.tool, inverse(pose_of(self.model.tool)))
        mass, *com = (tape.symbol(x) if isinstance(x, ca.SX) else float(x) for x in (body.mass, *body.com))
        com = [
            p + row[0] * com[0] + row[1] * com[1] + row[2] * com[2]
            for p, row in zip(position.tolist(), rotation.tolist(), strict=True)
        ]
        first = [mass * x for x in com]
        own = inertia_of(Body(inertia=body.inertia)).moved((rotation, np.zeros(3))).second.tolist()
        second = [[x + y * z for x, z in zip(row, com, strict=True)] for row, y in zip(own, first, strict=True)]
        load = Inertia(mass, np.array(first, dtype=object), np.array(second, dtype=object))
        last = plan.chain.joints[-1]
        return replace(plan.chain, joints=(*plan.chain.joints[:-1], replace(last, inertia=last.inertia + load)))

    @property
    def loaded(self) -> bool:
        """Whether numbers of the payload may change at run time."""
        return any(parameter.name.startswith("payload.") for parameter in self.equations.parameters)

    def shortest(self, routes: Iterable[Route], several: bool = True) -> list[ca.SX]:
        """The results of the route with the fewest operations (over the best plan only, or over several)."""
        found: tuple[int, Tape, list[Scalar]] | None = None
        known = plans(replace(self.model, payload=Body()) if self.loaded else self.model)
        for plan in known if several else known[:1]:
            for route in routes:
                tape = Tape()
                results = route(tape, self.chain(tape, plan), plan.columns)
                count = tape.cost(results).operations
                if found is None or count < found[0]:
                    found = count, tape, results
        assert found is not None
        return found[1].build(found[2])

    @cached_property
    def derivatives(self) -> list[ca.SX]:
        """Derivatives of inverse dynamics in coordinates, speeds and accelerations, (n_a, n_a) each."""
        inputs = self.symbols("q_a", "v_a", "a_a")
        n = self.model.n_a

        def by_recursion(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
            q, v, a = _vectors(tape, *inputs)
            found = derivatives.derivatives(tape, chain, q, v, a, columns)
            return [x for A in found for row in A for x in row]

        def by_differentiation(tape: Tape, chain: Chain, columns: Columns, forward: bool) -> list[Scalar]:
            q, v, a = _vectors(tape, *inputs)
            tau = newton_euler.inverse_dynamics(tape, chain, q, v, a, columns)
            M = [x for row in _mass(tape, chain, q) for x in row]
            if not forward:
                gradients = [tape.gradient(x, [*q, *v]) for x in tau]
                return [*(x for row in gradients for x in row[:n]), *(x for row in gradients for x in row[n:]), *M]
            tangents = [tape.tangents(tau, x) for x in (*q, *v)]
            return [*(x for part in (tangents[:n], tangents[n:]) for row in zip(*part, strict=True) for x in row), *M]

        routes: list[Route] = [by_recursion]
        if n <= AD_UP_TO:
            routes += [partial(by_differentiation, forward=True), partial(by_differentiation, forward=False)]
        flat = self.shortest(routes)
        return [_square(flat[k * n * n : (k + 1) * n * n], n) for k in range(3)]

    @property
    def armature(self) -> np.ndarray:
        """What the rotors behind rigid gears add to the mass matrix, shape (n_a, n_a) [kg m^2, kg]."""
        model, out = self.model, np.zeros((self.model.n_a, self.model.n_a))
        rigid = [j for j in range(model.n_m) if j not in model.i_m]
        eta = model.eta[rigid]
        out[np.ix_(model.i_g, model.i_g)] = eta.T @ np.diag([model.motors[j].inertia for j in rigid]) @ eta
        return out


@lru_cache(maxsize=4)
def _arm_of(equations: Equations) -> _Arm:
    """What was made for some equations lately."""
    return _Arm(equations)


def _vectors(tape: Tape, *symbols: ca.SX) -> list[list[Scalar]]:
    return [tape.vector(x) for x in symbols]


def _square(rows: Sequence[ca.SX], n: int) -> ca.SX:
    return ca.reshape(ca.vertcat(*rows), n, len(rows) // n).T if rows else ca.SX(0, n)


# --- the arm ---------------------------------------------------------------------------------------------------------


def _inverse_dynamics(arm: _Arm) -> Built:
    inputs = arm.symbols("q_a", "v_a", "a_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q, v, a = _vectors(tape, *inputs)
        return newton_euler.inverse_dynamics(tape, chain, q, v, a, columns)

    return inputs, ["q_a", "v_a", "a_a"], [ca.vertcat(*arm.shortest([route], several=False))], ["tau_a"]


def _bias(arm: _Arm) -> Built:
    inputs = arm.symbols("q_a", "v_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        still: list[Scalar] = [0.0] * arm.model.n_a
        q, v = _vectors(tape, *inputs)
        return newton_euler.inverse_dynamics(tape, chain, q, v, still, columns)

    return inputs, ["q_a", "v_a"], [ca.vertcat(*arm.shortest([route]))], ["h"]


def _gravity(arm: _Arm) -> Built:
    inputs = arm.symbols("q_a")

    def by_recursion(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        still: list[Scalar] = [0.0] * arm.model.n_a
        return newton_euler.inverse_dynamics(tape, chain, tape.vector(inputs[0]), still, still, columns)

    def by_differentiation(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q = tape.vector(inputs[0])
        return tape.gradient(composite_body.height(tape, chain, q), q)

    return inputs, ["q_a"], [ca.vertcat(*arm.shortest([by_recursion, by_differentiation]))], ["g"]


def _mass_matrix(arm: _Arm) -> Built:
    inputs = arm.symbols("q_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        return [x for row in _mass(tape, chain, tape.vector(inputs[0])) for x in row]

    return inputs, ["q_a"], [_square(arm.shortest([route]), arm.model.n_a)], ["M"]


def _mass(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> composite_body.Matrix:
    """The mass matrix, with axes shared by parallel joints or without: what is shorter."""
    found = [composite_body.mass_matrix(tape, chain, q, together) for together in (True, False)]
    return min(found, key=lambda M: tape.cost([x for row in M for x in row]).operations)


def _arm_forward_dynamics(arm: _Arm) -> Built:
    tau_a = ca.SX.sym("tau_a", arm.model.n_a)
    a_a = _accelerations(arm, tau_a, np.zeros((arm.model.n_a, arm.model.n_a)))
    return [*arm.symbols("q_a", "v_a"), tau_a], ["q_a", "v_a", "tau_a"], [a_a], ["a_a"]


def _accelerations(arm: _Arm, force: ca.SX, armature: np.ndarray) -> ca.SX:
    """Accelerations of the arm under forces, expressions in any symbols, with rotors that add to the mass matrix."""
    q_a, v_a = arm.symbols("q_a", "v_a")
    n = arm.model.n_a
    still: list[Scalar] = [0.0] * n
    own = np.diag(armature).tolist()

    def by_mass_matrix(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q, v, tau = _vectors(tape, q_a, v_a, force)
        h = newton_euler.inverse_dynamics(tape, chain, q, v, still, columns)
        M = _mass(tape, chain, q)
        M = [[x + y for x, y in zip(row, more, strict=True)] for row, more in zip(M, armature.tolist(), strict=True)]
        return articulated_body.solved(tape, M, [x - y for x, y in zip(tau, h, strict=True)])

    def by_articulated_bodies(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q, v, tau = _vectors(tape, q_a, v_a, force)
        turns = [newton_euler.turn_of(tape, joint, x) for joint, x in zip(chain.joints, q, strict=True)]
        moving = newton_euler.motions(tape, chain, turns, q, v, still, columns)
        loads = newton_euler.loads(chain, moving)
        return articulated_body.forward_dynamics(tape, chain, q, loads, turns, tau, own)

    coupled = np.any(armature != np.diag(own))
    return ca.vertcat(*arm.shortest([by_mass_matrix] if coupled else [by_mass_matrix, by_articulated_bodies]))


def _inverse_dynamics_derivatives(arm: _Arm) -> Built:
    names = ["q_a", "v_a", "a_a"]
    return arm.symbols(*names), names, arm.derivatives, ["dtau_dq", "dtau_dv", "dtau_da"]


def _arm_slopes(arm: _Arm) -> Built:
    names = ["q_a", "v_a", "a_a"]
    by_q, by_v, M = arm.derivatives
    return arm.symbols(*names), names, [M, ca.horzcat(by_q, by_v)], ["M", "R"]


# --- the whole machine -----------------------------------------------------------------------------------------------


def _forward_dynamics(arm: _Arm) -> Built:
    model, forces = arm.model, arm.equations.lagrangian.forces
    a_a = _accelerations(arm, forces[: model.n_a], arm.armature)
    geared = ca.mtimes(ca.SX(ca.DM(model.eta)), ca.vertcat(*[a_a[i] for i in model.i_g]))
    a_m = [geared[j] for j in range(model.n_m)]
    for k, j in enumerate(model.i_m):
        a_m[j] = forces[model.n_a + k] * (1.0 / model.motors[j].inertia)
    names = ["q_a", "v_a", "q_m", "v_m", "tau_m"]
    return arm.symbols(*names), names, [a_a, ca.vertcat(ca.SX(0, 1), *a_m)], ["a_a", "a_m"]


def _slopes(arm: _Arm) -> Built:
    model, forces = arm.model, arm.equations.lagrangian.forces
    n, n_a, i_m = model.dof, model.n_a, model.i_m
    by_q, by_v, M_a = arm.derivatives
    M, R = ca.SX.zeros(n, n), ca.SX.zeros(n, 2 * n + model.n_m)
    M[:n_a, :n_a] = M_a + ca.SX(ca.DM(arm.armature))
    for k, j in enumerate(i_m):
        M[n_a + k, n_a + k] = model.motors[j].inertia
    R[:n_a, :n_a], R[:n_a, n : n + n_a] = by_q, by_v
    q_a, v_a, q_m, v_m, tau_m = arm.symbols("q_a", "v_a", "q_m", "v_m", "tau_m")
    y, dy = (ca.vertcat(x, *[x_m[j] for j in i_m]) for x, x_m in ((q_a, q_m), (v_a, v_m)))
    R = R - ca.horzcat(*(ca.jacobian(forces, x) for x in (y, dy, tau_m)))
    names = ["q_a", "v_a", "a_a", "q_m", "v_m", "tau_m", "a_m"]
    return arm.symbols(*names), names, [M, R], ["M", "R"]


# --- the tool --------------------------------------------------------------------------------------------------------


def _forward_kinematics(arm: _Arm) -> Built:
    inputs, tape = arm.symbols("q_a"), Tape()
    p, R = kinematics.tool_pose(tape, laid(arm.model, to_mass=False), tape.vector(inputs[0]))
    flat = tape.build([*p, *(x for row in R for x in row)])
    return inputs, ["q_a"], [ca.vertcat(*flat[:3]), _square(flat[3:], 3)], ["p", "R"]


def _jacobian(arm: _Arm) -> Built:
    inputs, tape = arm.symbols("q_a"), Tape()
    J = kinematics.jacobian(tape, laid(arm.model, to_mass=False), tape.vector(inputs[0]))
    return inputs, ["q_a"], [_square(tape.build([x for row in J for x in row]), arm.model.n_a)], ["J"]


_BUILDERS: dict[str, Callable[[_Arm], Built]] = {
    "mass_matrix": _mass_matrix,
    "bias": _bias,
    "gravity": _gravity,
    "inverse_dynamics": _inverse_dynamics,
    "inverse_dynamics_derivatives": _inverse_dynamics_derivatives,
    "arm_forward_dynamics": _arm_forward_dynamics,
    "arm_slopes": _arm_slopes,
    "forward_dynamics": _forward_dynamics,
    "slopes": _slopes,
    "forward_kinematics": _forward_kinematics,
    "jacobian": _jacobian,
    **inversion_functions.BUILDERS,
}
