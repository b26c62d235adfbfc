"""Joints that move together: from coordinates to joints, and from forces of joints to coordinates.

A mechanism (``mimic``) makes a joint a constant sum of coordinates. A closed loop makes a joint a
function of them, q_j = phi(q): with the Jacobian N = dphi/dq

    v_j = N v,    a_j = N a + N' v,    tau = N' tau_j
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from flexgen.codegen.recursion.tape import Scalar, Tape
from flexgen.dynamics.mechanics.closed_loops import closed_joints
from flexgen.dynamics.mechanics.equations import Equations

Matrix = list[list[Scalar]]


@dataclass(frozen=True)
class Joints:
    """All joints on a tape: positions q, speeds v, accelerations a.

    ``moves``: of each joint the derivatives in the coordinates that move it, by number; None where
    each joint has a coordinate of its own. ``n_a``: number of coordinates.
    """

    q: list[Scalar]
    v: list[Scalar]
    a: list[Scalar]
    moves: Sequence[Mapping[int, Scalar]] | None
    n_a: int

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
class ClosedJoints:
    """The joints of a robot with closed loops: a function of ``q, v, a`` (n_a each) to positions,
    speeds, accelerations (n_j each) and the Jacobian N (n_j, n_a).
    """

    function: ca.Function

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
        *motion, N = self.function.call(given)
        own = [[_on_tape(tape, x[k]) for k in range(x.numel())] for x in motion]
        moves = [
            {k: _on_tape(tape, N[j, k]) for k in range(len(q)) if not N[j, k].is_zero()}
            for j in range(N.shape[0])
        ]
        return Joints(own[0], own[1], own[2], moves, len(q))


def _on_tape(tape: Tape, x: ca.SX) -> Scalar:
    """An expression as a value of a tape."""
    return float(x) if x.is_constant() else tape.symbol(x)


def closed_joints_of(equations: Equations) -> ClosedJoints:
    """The `ClosedJoints` of a robot."""
    model = equations.model
    q, v, a = (ca.SX.sym(name, model.n_a) for name in "qva")
    known = closed_joints(model, q)
    joints = []
    for dof in (dof for element in model.elements for dof in element.dofs):
        own = dict(dof.mimic) or {dof.name: 1.0}
        joints.append(sum(factor * known[name] for name, factor in own.items()))
    at = ca.vertcat(*joints)
    N = ca.jacobian(at, q)
    speed = ca.mtimes(N, v)
    rate = ca.mtimes(N, a) + ca.jtimes(speed, q, v)
    return ClosedJoints(ca.Function("joints", [q, v, a], [at, speed, rate, N]))
