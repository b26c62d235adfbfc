"""Joints that move together: from coordinates to joints, and from forces of joints to coordinates.

A mechanism (``mimic``) makes a joint a constant sum of coordinates. A closed loop makes a joint a
function of them, q_j = phi(q): with the Jacobian N = dphi/dq

    v_j = N v,    a_j = N a + (dN/dt) v,    tau = N' tau_j

All follow from the equations of the loops, c(z) = 0 with z = (q, q_d), J = dc/dz and
K(u) = d(J u)/dz, without derivatives of phi:

    N_d = -J_d^-1 J_i,    (dN/dt v)_d = -J_d^-1 K(v_z) v_z
    S = d(N v)/dq:            S_d = -J_d^-1 K(v_z) N
    A = d(N a + N' v)/dq:     A_d = -J_d^-1 (d(J a_z + K(v_z) v_z)/dz N + 2 K(v_z) S)
    d(N' tau)/dq = N' d(J' lambda)/dz N,    lambda = -J_d^-T tau_d

lambda are the forces in the cuts of the loops.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from flexgen.codegen.recursion.tape import Scalar, Tape, Value
from flexgen.dynamics.mechanics.closed_loops import closed_joints, independent_errors
from flexgen.dynamics.mechanics.square_systems import solve_square
from flexgen.model.elements import RobotModel
from flexgen.model.format.closure import passive_joints

Matrix = list[list[Scalar]]


@dataclass(frozen=True)
class Joints:
    """All joints on a tape: positions q, speeds v, accelerations a.

    ``moves``: of each joint the derivatives in the coordinates that move it, by number; None where
    each joint has a coordinate of its own. ``n_a``: number of coordinates. ``given``: of closed
    loops, all that the tape has from `ClosedJoints`: q, v, a, and the Jacobian row by row.
    """

    q: list[Scalar]
    v: list[Scalar]
    a: list[Scalar]
    moves: Sequence[Mapping[int, Scalar]] | None
    n_a: int
    given: tuple[Scalar, ...] = ()

    def gather(self, x: Sequence[Any]) -> list[Any]:
        """Numbers of all joints, such as torques, or rows of such numbers, added up for the
        coordinates.
        """
        if self.moves is None:
            return list(x)
        none: Any = [0.0] * len(x[0]) if isinstance(x[0], Sequence) else 0.0
        out = [none] * self.n_a
        for own, row in zip(self.moves, x, strict=True):
            for k, factor in own.items():
                if isinstance(row, Sequence):
                    out[k] = [y + factor * z for y, z in zip(out[k], row, strict=True)]
                else:
                    out[k] = out[k] + factor * row
        return out

    def gather_matrix(self, A: Matrix) -> Matrix:
        """A matrix over pairs of joints, added up for pairs of coordinates."""
        if self.moves is None:
            return A
        columns = [list(column) for column in zip(*self.gather(A), strict=True)]
        return [list(row) for row in zip(*self.gather(columns), strict=True)]


@dataclass(frozen=True)
class Changes:
    """Changes of joints in motion: derivatives of their speeds in the coordinates, S (n_j, n_a),
    and of their accelerations in coordinates, A (n_j, n_a); those in speeds are ``2 S``. ``N``
    (n_j, n_a): the Jacobian.
    """

    N: ca.SX
    S: ca.SX
    A: ca.SX


@dataclass(frozen=True)
class ClosedJoints:
    """The joints of a robot with closed loops as functions of its coordinates (n_a).

    ``motion``: ``q, v, a`` to positions, speeds, accelerations (n_j each) and the Jacobian N (n_j,
    n_a). ``moved``: to `Changes`. ``turned``: ``q, tau_j`` to the derivative of ``N' tau_j`` in q
    (n_a, n_a) at constant tau_j. ``rates``: ``q, v, a`` and their rates to those of all entries of
    ``motion``, the Jacobian row by row; ``weights``: ``q, v, a`` and weights of these entries to
    the derivatives of their weighted sum in q, v and a.
    """

    motion: ca.Function
    moved: ca.Function
    turned: ca.Function
    rates: ca.Function
    weights: ca.Function

    def on_tape(
        self,
        tape: Tape,
        q: Sequence[Scalar],
        v: Sequence[Scalar] | None,
        a: Sequence[Scalar] | None,
    ) -> Joints:
        """The joints as values given from outside the tape."""
        still: list[Scalar] = [0.0] * len(q)
        given = [ca.vertcat(*tape.build(x)) for x in (q, v or still, a or still)]
        *motion, N = self.motion.call(given)
        own = [[_on_tape(tape, x[k]) for k in range(x.numel())] for x in motion]
        moves = [
            {k: _on_tape(tape, N[j, k]) for k in range(len(q)) if not N[j, k].is_zero()}
            for j in range(N.shape[0])
        ]
        rows = [row.get(k, 0.0) for row in moves for k in range(len(q))]
        flat = (*own[0], *own[1], *own[2], *rows)
        return Joints(own[0], own[1], own[2], moves, len(q), flat)

    def jvp(
        self,
        tape: Tape,
        results: Sequence[Scalar],
        at: Joints,
        inputs: Sequence[ca.SX],
        rates: Sequence[ca.SX],
    ) -> list[Scalar]:
        """Rates of results of joints ``at`` the ``inputs`` q, v, a with their ``rates``."""
        given = self.rates(*inputs, *rates)
        pairs = [
            (x, _on_tape(tape, given[k])) for k, x in enumerate(at.given) if isinstance(x, Value)
        ]
        return tape.jvp(results, pairs)

    def vjp(
        self,
        tape: Tape,
        cotangents: Sequence[tuple[Scalar, Scalar]],
        at: Joints,
        inputs: Sequence[ca.SX],
    ) -> list[Scalar]:
        """Derivatives in the ``inputs`` q, v, a (3 n_a) of the sum of ``weight * result`` over
        pairs of them, where results are those of joints ``at`` the inputs.
        """
        weights = ca.vertcat(*tape.build(tape.vjp(cotangents, at.given)))
        found = ca.vertcat(*self.weights(*inputs, weights))
        return [_on_tape(tape, found[k]) for k in range(found.numel())]

    def changes(self, q: ca.SX, v: ca.SX, a: ca.SX) -> Changes:
        """The `Changes` at a motion of the coordinates."""
        return Changes(*(ca.sparsify(x) for x in self.moved.call([q, v, a])))


def _on_tape(tape: Tape, x: ca.SX) -> Scalar:
    """An expression as a value of a tape."""
    return float(x) if x.is_constant() else tape.symbol(x)


def closed_joints_of(model: RobotModel, tree: RobotModel) -> ClosedJoints:
    """The `ClosedJoints` of a model, for the joints of a ``tree`` whose joints are sums of its
    coordinates and passive joints.
    """
    n = model.n_a
    q, v, a = (ca.SX.sym(name, n) for name in "qva")
    known = closed_joints(model, q)
    at = _Closure.of(model)
    z = ca.vertcat(*[known[name] for name in at.names])
    sums = ca.SX(ca.sparsify(ca.DM(_sums(tree, at.names))))
    none = ca.SX.zeros(len(at.names))
    J, _, _, _ = at.function.call([z, none, none, none[n:]])
    J_d = J[:, n:]
    inverse = solve_square(J_d, ca.SX.eye(J_d.shape[0]))
    N = ca.vertcat(ca.SX.eye(n), -ca.mtimes(inverse, J[:, :n]))
    v_z = ca.mtimes(N, v)
    _, K, _, _ = at.function.call([z, v_z, none, none[n:]])
    bent = ca.mtimes(inverse, ca.mtimes(K, v_z))
    a_z = ca.mtimes(N, a) - ca.vertcat(ca.SX(n, 1), bent)
    _, K, G, _ = at.function.call([z, v_z, a_z, none[n:]])
    S = ca.vertcat(ca.SX(n, n), -ca.mtimes(inverse, ca.mtimes(K, N)))
    A_d = -ca.mtimes(inverse, ca.mtimes(G, N) + 2 * ca.mtimes(K, S))
    A = ca.vertcat(ca.SX(n, n), A_d)
    tau = ca.SX.sym("tau", sums.shape[0])
    multipliers = -ca.mtimes(inverse.T, ca.mtimes(sums.T, tau)[n:])
    _, _, _, W = at.function.call([z, none, none, multipliers])
    C = ca.mtimes(N.T, ca.mtimes(W, N))
    motion = [ca.densify(ca.mtimes(sums, x)) for x in (z, v_z, a_z)]
    joints = ca.Function("joints", [q, v, a], [*motion, ca.mtimes(sums, N)])
    return ClosedJoints(
        joints,
        ca.Function("moved", [q, v, a], [ca.mtimes(sums, x) for x in (N, S, A)]),
        ca.Function("turned", [q, tau], [C]),
        *_products(joints),
    )


def _products(joints: ca.Function) -> tuple[ca.Function, ca.Function]:
    """``rates`` and ``weights`` of `ClosedJoints`."""
    inputs = [ca.SX.sym(name, joints.numel_in(0)) for name in "qva"]
    *motion, N = joints.call(inputs)
    flat = ca.densify(ca.vertcat(*motion, ca.vec(N.T)))
    x = ca.vertcat(*inputs)
    changes = [ca.SX.sym(f"d{name}", joints.numel_in(0)) for name in "qva"]
    weight = ca.SX.sym("weight", flat.numel())
    back = ca.vertsplit(ca.densify(ca.jtimes(flat, x, weight, True)), joints.numel_in(0))
    rates = ca.jtimes(flat, x, ca.vertcat(*changes))
    return (
        ca.Function("rates", [*inputs, *changes], [rates]),
        ca.Function("weights", [*inputs, weight], back),
    )


def _sums(tree: RobotModel, names: Sequence[str]) -> np.ndarray:
    """Factors (n_j, n_z) of coordinates and passive joints in the joints of a tree."""
    rows = []
    for dof in (dof for element in tree.elements for dof in element.dofs):
        own = dict(dof.mimic) or {dof.name: 1.0}
        rows.append([own.get(name, 0.0) for name in names])
    return np.array(rows)


@dataclass(frozen=True)
class _Closure:
    """Equations of the loops ``c(z) = 0`` in coordinates and passive joints z, by ``names``.

    ``function``: of ``z, u, w, lambda`` to the Jacobian J of c, and the derivatives in z of
    ``J u``, of ``J w + (J u)' u`` and of ``J' lambda``, at constant u, w and lambda.
    """

    names: tuple[str, ...]
    function: ca.Function

    @classmethod
    def of(cls, model: RobotModel) -> _Closure:
        """The closure of all loops of a model."""
        passive = [dof.name for dof in passive_joints(model)]
        names = (*(c.name for c in model.coordinates), *passive)
        z, u, w = (ca.SX.sym(name, len(names)) for name in "zuw")
        multipliers = ca.SX.sym("lambda", len(passive))
        values = dict(zip(names, ca.vertsplit(z), strict=True))
        c = independent_errors(model, model.loops, passive, values)
        J = ca.jacobian(c, z)
        K = ca.jacobian(ca.mtimes(J, u), z)
        G = ca.jacobian(ca.mtimes(J, w) + ca.mtimes(K, u), z)
        W = ca.jacobian(ca.mtimes(J.T, multipliers), z)
        return cls(names, ca.Function("closure", [z, u, w, multipliers], [J, K, G, W]))
