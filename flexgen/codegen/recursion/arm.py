"""The arm that recursions work on: its symbols, its chain of bodies, and the choice of the
shortest recursion.

A route is one way to compute a result on a tape. `Arm.shortest` runs several routes over several
plans (places of the link frames, see `flexgen.codegen.recursion.regrouping`) and keeps the one
with the fewest operations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial

import casadi as ca
import numpy as np

from flexgen.codegen.recursion import composite_body, derivatives, kinematics, newton_euler
from flexgen.codegen.recursion.dh_chain import (
    Chain,
    Inertia,
    compose,
    inertia_of,
    inverse,
    pose_of,
)
from flexgen.codegen.recursion.joints import ClosedJoints, Joints, closed_joints_of
from flexgen.codegen.recursion.regrouping import Plan, plans
from flexgen.codegen.recursion.rods import with_rods_as_bodies
from flexgen.codegen.recursion.tape import Scalar, Tape
from flexgen.dynamics.mechanics.dynamics import symbols_of
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.elements import Body, Dof, RobotModel

# coordinates; the recursion for derivatives is shorter than differentiated code beyond
AD_UP_TO = 10

Columns = tuple[bool, ...]
Route = Callable[[Tape, Chain, Columns], list[Scalar]]


@dataclass(frozen=True)
class Arm:
    """The symbols of a robot's equations, and results from the shortest of several recursions.

    ``functions``: those that were made, by name; None where the recursion has none. ``choices``:
    the plan and the route that were the shortest, for results that are asked for several times.
    """

    equations: Equations
    functions: dict[str, ca.Function | None] = field(default_factory=dict)
    choices: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def model(self) -> RobotModel:
        """The robot, with its numbers."""
        return self.equations.model

    def symbols(self, *names: str) -> list[ca.SX]:
        """Vectors by their names, the Lagrangian's own."""
        return symbols_of(self.equations, list(names))

    @cached_property
    def moves(self) -> tuple[dict[int, float], ...] | None:
        """Of each joint the factors of the coordinates that move it, by number; None where each
        joint has a coordinate of its own, and where closed loops move joints.
        """
        dofs = [dof for element in self.model.elements for dof in element.dofs]
        at = {coordinate.name: k for k, coordinate in enumerate(self.model.coordinates)}
        if self.model.loops or not any(dof.mimic for dof in dofs):
            return None
        return tuple(
            {at[name]: x for name, x in (dof.mimic or ((dof.name, 1.0),))} for dof in dofs
        )

    @property
    def coupled(self) -> bool:
        """Whether mechanisms or closed loops move several joints together."""
        return self.moves is not None or bool(self.model.loops)

    @cached_property
    def closed(self) -> ClosedJoints | None:
        """Joints of a robot with closed loops as functions of its coordinates; None without."""
        return closed_joints_of(self.model, self.tree) if self.model.loops else None

    @cached_property
    def tree(self) -> RobotModel:
        """The bodies that recursions run over, with those of rods in closed loops."""
        return with_rods_as_bodies(self.model)

    def joints(
        self,
        tape: Tape,
        q: Sequence[Scalar],
        v: Sequence[Scalar] | None = None,
        a: Sequence[Scalar] | None = None,
    ) -> Joints:
        """The joints on a tape, at coordinates q, and speeds v and accelerations a (None: 0)."""
        if self.closed is not None:
            return self.closed.on_tape(tape, q, v, a)
        still: list[Scalar] = [0.0] * self.model.n_a
        at, speed, rate = (self._to_joints(x) for x in (q, v or still, a or still))
        return Joints(at, speed, rate, self.moves, self.model.n_a)

    def _to_joints(self, x: Sequence[Scalar]) -> list[Scalar]:
        """Angles, speeds or accelerations of all joints from those of the coordinates."""
        if self.moves is None:
            return list(x)
        none: Scalar = 0.0
        return [sum((factor * x[k] for k, factor in own.items()), none) for own in self.moves]

    def torques(
        self,
        tape: Tape,
        chain: Chain,
        q: Sequence[Scalar],
        v: Sequence[Scalar],
        a: Sequence[Scalar],
        columns: Columns,
    ) -> list[Scalar]:
        """Inverse dynamics ``M(q) a + h(q, v)`` (n_a) [N m, N] in coordinates, recorded on
        ``tape``; ``columns``: per joint which form its angular acceleration has, as in
        `newton_euler.Motion`.
        """
        return self.torques_at(tape, chain, self.joints(tape, q, v, a), columns)

    def torques_at(self, tape: Tape, chain: Chain, at: Joints, columns: Columns) -> list[Scalar]:
        """`torques` of joints on the tape."""
        return at.gather(newton_euler.inverse_dynamics(tape, chain, at.q, at.v, at.a, columns))

    def mass_matrix(self, tape: Tape, chain: Chain, q: Sequence[Scalar]) -> composite_body.Matrix:
        """The mass matrix (n_a, n_a) at q, recorded on ``tape`` with or without axes that parallel
        joints share, whichever takes fewer operations.
        """
        at = self.joints(tape, q)
        found = [
            composite_body.mass_matrix(tape, chain, at.q, together) for together in (True, False)
        ]
        M = min(found, key=lambda M: tape.count([x for row in M for x in row]))
        return at.gather_matrix(M)

    def jacobian(self, tape: Tape, chain: Chain, q: Sequence[Scalar]) -> composite_body.Matrix:
        """The Jacobian of the tool, rows of the twist."""
        at = self.joints(tape, q)
        return [at.gather(row) for row in kinematics.jacobian(tape, chain, at.q)]

    def torque_changes(
        self,
        tape: Tape,
        chain: Chain,
        q: Sequence[Scalar],
        v: Sequence[Scalar],
        a: Sequence[Scalar],
        columns: Columns,
    ) -> list[composite_body.Matrix]:
        """Derivatives of `torques` in coordinates, speeds and accelerations, (n_a, n_a) each;
        arguments as there. Of robots without closed loops, whose joints are sums of coordinates.
        """
        at = self.joints(tape, q, v, a)
        found = derivatives.derivatives(tape, chain, at.q, at.v, at.a, columns)
        return [at.gather_matrix(A) for A in found]

    def chain(self, tape: Tape, plan: Plan) -> Chain:
        """The chain of a plan; where the payload may change at run time, its mass, center and
        inertia are added to the carrying joint as symbols.
        """
        if not self.loaded:
            return plan.chain
        body = self.equations.with_symbols.payload
        rotation, position = compose(plan.chain.tool, inverse(pose_of(self.model.tool)))
        mass, *com = (
            tape.symbol(x) if isinstance(x, ca.SX) else float(x) for x in (body.mass, *body.com)
        )
        com = [
            p + row[0] * com[0] + row[1] * com[1] + row[2] * com[2]
            for p, row in zip(position.tolist(), rotation.tolist(), strict=True)
        ]
        first = [mass * x for x in com]
        own = inertia_of(Body(inertia=body.inertia)).moved((rotation, np.zeros(3))).second.tolist()
        second = [
            [x + y * z for x, z in zip(row, com, strict=True)]
            for row, y in zip(own, first, strict=True)
        ]
        load = Inertia(mass, np.array(first, dtype=object), np.array(second, dtype=object))
        joints = list(plan.chain.joints)
        k = plan.chain.carrier
        joints[k] = replace(joints[k], inertia=joints[k].inertia + load)
        return replace(plan.chain, joints=tuple(joints))

    @property
    def loaded(self) -> bool:
        """Whether numbers of the payload may change at run time."""
        return any(
            parameter.name.startswith("payload.") for parameter in self.equations.parameters
        )

    def shortest(
        self, routes: Sequence[Route], several: bool = True, kind: str = ""
    ) -> list[ca.SX]:
        """The results of the route with the fewest operations, over all plans or (``several``
        false) the best one only.

        Results of one ``kind`` take the plan and the route of the first of them.
        """
        found: tuple[int, Tape, list[Scalar], tuple[int, int]] | None = None
        known = plans(replace(self.tree, payload=Body()) if self.loaded else self.tree)
        pairs = [(i, k) for i in range(len(known) if several else 1) for k in range(len(routes))]
        for i, k in [self.choices[kind]] if kind in self.choices else pairs:
            tape = Tape()
            results = routes[k](tape, self.chain(tape, known[i]), known[i].columns)
            count = tape.count(results)
            if found is None or count < found[0]:
                found = count, tape, results, (i, k)
        assert found is not None
        if kind:
            self.choices[kind] = found[3]
        return found[1].build(found[2])

    @cached_property
    def derivatives(self) -> list[ca.SX]:
        """Derivatives of inverse dynamics in coordinates, velocities and accelerations, (n_a, n_a)
        each.
        """
        inputs = self.symbols("q_a", "v_a", "a_a")
        n = self.model.n_a
        if self.closed is not None:
            return self.closed_changes(range(n))[1:]

        def by_recursion(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
            q, v, a = vectors(tape, *inputs)
            found = self.torque_changes(tape, chain, q, v, a, columns)
            return [x for A in found for row in A for x in row]

        def by_differentiation(
            tape: Tape, chain: Chain, columns: Columns, forward: bool
        ) -> list[Scalar]:
            """All three on the recorded operations; ``forward``: one tangent per coordinate and
            speed, else one gradient per torque. M needs neither.
            """
            q, v, a = vectors(tape, *inputs)
            tau = self.torques(tape, chain, q, v, a, columns)
            M = [x for row in self.mass_matrix(tape, chain, q) for x in row]
            if not forward:
                gradients = [tape.gradient(x, [*q, *v]) for x in tau]
                return [
                    *(x for row in gradients for x in row[:n]),
                    *(x for row in gradients for x in row[n:]),
                    *M,
                ]
            tangents = [tape.tangents(tau, x) for x in (*q, *v)]
            return [
                *(
                    x
                    for part in (tangents[:n], tangents[n:])
                    for row in zip(*part, strict=True)
                    for x in row
                ),
                *M,
            ]

        routes: list[Route] = [by_recursion]
        if n <= AD_UP_TO:
            routes += [
                partial(by_differentiation, forward=True),
                partial(by_differentiation, forward=False),
            ]
        flat = self.shortest(routes)
        return [matrix_of(flat[k * n * n : (k + 1) * n * n], n) for k in range(3)]

    def closed_changes(self, rows: Sequence[int]) -> list[ca.SX]:
        """Some ``rows`` (m) of inverse dynamics of a robot with closed loops, and their
        derivatives in coordinates, speeds and accelerations (m, n_a).

            tau = N' tau_j,    dtau/da = N' M_j N,    dtau/dv = N' (dtau_j/dv_j N + 2 M_j S)
            dtau/dq = N' (dtau_j/dq_j N + dtau_j/dv_j S + M_j A) + d(N' tau_j)/dq
        """
        assert self.closed is not None
        inputs = self.symbols("q_a", "v_a", "a_a")

        def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
            q, v, a = vectors(tape, *inputs)
            at = self.joints(tape, q, v, a)
            tau = newton_euler.inverse_dynamics(tape, chain, at.q, at.v, at.a, columns)
            found = derivatives.derivatives(tape, chain, at.q, at.v, at.a, columns)
            return [*tau, *(x for A in found for row in A for x in row)]

        flat = self.shortest([route], several=False)
        n_j = len(self.tree_joints)
        tau = ca.vertcat(*flat[:n_j])
        by_q, by_v, M = (
            ca.sparsify(matrix_of(flat[n_j + k * n_j * n_j : n_j + (k + 1) * n_j * n_j], n_j))
            for k in range(3)
        )
        by = self.closed.changes(*inputs)
        kept = list(rows)
        left = by.N[:, kept].T
        moved = ca.mtimes(by_q, by.N) + ca.mtimes(by_v, by.S) + ca.mtimes(M, by.A)
        sped = ca.mtimes(by_v, by.N) + 2 * ca.mtimes(M, by.S)
        turned = self.closed.turned(inputs[0], tau)[kept, :]
        found = [
            ca.mtimes(left, tau),
            ca.mtimes(left, moved) + turned,
            ca.mtimes(left, sped),
            ca.mtimes(left, ca.mtimes(M, by.N)),
        ]
        return [ca.densify(x) for x in found]

    @property
    def tree_joints(self) -> tuple[Dof, ...]:
        """The joints of the `tree`, in the order of its chain."""
        return tuple(dof for element in self.tree.elements for dof in element.dofs)

    @property
    def armature(self) -> np.ndarray:
        """Share of the rotors behind rigid gears in the mass matrix, shape (n_a, n_a) [kg m^2,
        kg].
        """
        model = self.model
        out = np.zeros((self.model.n_a, self.model.n_a))
        rigid = [j for j in range(model.n_m) if j not in model.i_m]
        eta = model.eta[rigid]
        out[np.ix_(model.i_g, model.i_g)] = (
            eta.T @ np.diag([model.motors[j].inertia for j in rigid]) @ eta
        )
        return out


@lru_cache(maxsize=4)
def arm_of(equations: Equations) -> Arm:
    """The `Arm` of some equations; the last few are kept."""
    return Arm(equations)


def vectors(tape: Tape, *symbols: ca.SX) -> list[list[Scalar]]:
    """The entries of some symbols on a tape."""
    return [tape.vector(x) for x in symbols]


def matrix_of(entries: Sequence[ca.SX], columns: int) -> ca.SX:
    """A matrix from its entries, row after row."""
    return (
        ca.reshape(ca.vertcat(*entries), columns, len(entries) // columns).T
        if entries
        else ca.SX(0, columns)
    )
