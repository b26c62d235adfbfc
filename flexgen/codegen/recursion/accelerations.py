"""Accelerations of an arm under forces: the recursions to choose from, each with its solution for
other forces.

(M + A) a = f - h,        A: constant inertias of rotors on the coordinates
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.codegen.recursion import articulated_body, newton_euler
from flexgen.codegen.recursion.arm import Arm, Columns, vectors
from flexgen.codegen.recursion.dh_chain import Chain
from flexgen.codegen.recursion.tape import Scalar, Tape


@dataclass(frozen=True)
class Solved:
    """Accelerations on a tape, the coordinates and speeds there, and ``(M + A)^-1 x`` with the
    same factors.
    """

    a: list[Scalar]
    q: list[Scalar]
    v: list[Scalar]
    solve: Callable[[Sequence[Scalar]], list[Scalar]]


Solver = Callable[[Tape, Chain, Columns], Solved]


def kind(armature: np.ndarray) -> str:
    """Results of one kind share the choice of the recursion: all but those of coordinates that
    rotors couple.
    """
    return "" if np.any(armature != np.diag(np.diag(armature))) else "accelerations"


def routes(arm: Arm, force: ca.SX, armature: np.ndarray) -> list[Solver]:
    """The recursions for the accelerations (n_a) under ``force`` (n_a), expressions in any
    symbols.

    Through the mass matrix, and, where the rotor inertias ``armature`` (n_a, n_a) are those of
    single joints and no mechanism or loop couples joints, through articulated bodies.
    """
    q_a, v_a = arm.symbols("q_a", "v_a")
    still: list[Scalar] = [0.0] * arm.model.n_a
    own = np.diag(armature).tolist()

    def by_mass_matrix(tape: Tape, chain: Chain, columns: Columns) -> Solved:
        """Solve ``(M + armature) a = force - h`` by L'DL."""
        q, v, f = vectors(tape, q_a, v_a, force)
        h = arm.torques(tape, chain, q, v, still, columns)
        M = arm.mass_matrix(tape, chain, q)
        M = [
            [x + y for x, y in zip(row, more, strict=True)]
            for row, more in zip(M, armature.tolist(), strict=True)
        ]

        def solve(right: Sequence[Scalar]) -> list[Scalar]:
            return articulated_body.solve_symmetric(tape, M, right)

        return Solved(solve([x - y for x, y in zip(f, h, strict=True)]), q, v, solve)

    def by_articulated_bodies(tape: Tape, chain: Chain, columns: Columns) -> Solved:
        """Featherstone's recursion: velocity forces and ``force`` to the base, accelerations back
        to the tool; later right sides find the bodies at rest.
        """
        q, v, f = vectors(tape, q_a, v_a, force)
        turns = [
            newton_euler.turn_of(tape, joint, x) for joint, x in zip(chain.joints, q, strict=True)
        ]
        loads = newton_euler.loads(
            chain, newton_euler.motions(tape, chain, turns, q, v, still, columns)
        )
        none: list[newton_euler.Wrench] = [([0.0] * 3, [0.0] * 3) for _ in chain.joints]

        def solve(right: Sequence[Scalar]) -> list[Scalar]:
            return articulated_body.forward_dynamics(tape, chain, q, none, turns, right, own)

        return Solved(
            articulated_body.forward_dynamics(tape, chain, q, loads, turns, f, own), q, v, solve
        )

    # (mechanisms and loops couple joints that are not next to each other)
    free = kind(armature) and not arm.coupled
    return [by_mass_matrix, by_articulated_bodies] if free else [by_mass_matrix]
