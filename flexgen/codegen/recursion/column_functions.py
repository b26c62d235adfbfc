"""Functions of long arms by the same expressions for each joint: the choice of their chain, and a
check of the results.

Loops over the joints are shorter than one expression for each entry where an arm has many of them:
`recursion.columns`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from flexgen.codegen.recursion import columns
from flexgen.codegen.recursion.arm import arm_of
from flexgen.codegen.recursion.derivatives import derivatives
from flexgen.codegen.recursion.dh_chain import Chain, KeptInertia, make_chain, regroup
from flexgen.codegen.recursion.functions import (
    AGREEMENT,
    TRIALS,
    beside_the_arm,
    fast_function,
    operations_of,
)
from flexgen.codegen.recursion.regrouping import plans
from flexgen.codegen.recursion.tape import Tape
from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import Columns, Expressions, Products, Routine, Step, Sums
from flexgen.dynamics.mechanics.dynamics import symbols_of
from flexgen.dynamics.mechanics.equations import Equations

LONG_CHAIN = 12  # coordinates from which loops over joints are shorter
LANES = 8  # columns that are computed at once
SHORTER = 0.6  # loops are used where they need less than this fraction of the operations


def long_chain(equations: Equations) -> Chain | None:
    """The chain of an arm whose functions are loops over its joints; None where they are not, or
    do not agree.

    Parameters
    ----------
    equations : Equations

    Returns
    -------
    Chain or None
        None for short arms, for those with mechanisms or loops or without recursion, and where
        numbers of the payload may change at run time.
    """
    if (
        equations.model.n_a < LONG_CHAIN
        or equations.model.branched
        or arm_of(equations).loaded
        or arm_of(equations).coupled
        or fast_function(equations, "inverse_dynamics") is None
    ):
        return None
    return _chain_of(equations)


@lru_cache(maxsize=4)
def _chain_of(equations: Equations) -> Chain | None:
    """The chain with the fewest operations: masses stay with the bodies, or go to those before as
    far as they can.
    """
    n = equations.model.n_a
    own = make_chain(equations.model)
    if not columns.bodies_of(own):
        return None
    chain = min(
        (regroup(own, [kept] * n) for kept in (KeptInertia(), KeptInertia("all", True, True))),
        key=_derivatives_cost,
    )
    if not columns.bodies_of(chain) or _derivatives_cost(chain) > SHORTER * _direct_cost(
        equations
    ):
        return None
    return chain if loops_agree(equations, chain) else None


def _derivatives_cost(chain: Chain) -> float:
    return cost(columns.derivatives(chain, ("Q", 0), ("V", 0), "M"))


def _direct_cost(equations: Equations) -> int:
    """Operations of the derivatives as one expression for each entry."""
    plan = plans(equations.model)[0]
    tape = Tape()
    n = equations.model.n_a
    q, v, a = (tape.vector(ca.SX.sym(name, n)) for name in "qva")
    found = derivatives(tape, plan.chain, q, v, a, plan.columns)
    return tape.count([x for A in found for row in A for x in row])


def cost(steps: Sequence[Step]) -> float:
    """Operations for one point, where several columns are computed at once."""
    count = 0.0
    for step in steps:
        match step:
            case Expressions():
                count += operations_of(step.function)
            case Columns():
                count += operations_of(step.function) * -(-step.n // LANES)
            case Sums():
                count += step.rows * len(step.at)
            case Products():
                # both triangles are computed
                count += step.operations / (LANES / 2 if step.symmetric else LANES)
    return count


def shorter_mass_matrix(equations: Equations, target: str) -> list[Step] | None:
    """Steps to the mass matrix in a port, where loops are shorter than one expression for each
    entry.
    """
    chain = long_chain(equations)
    direct = fast_function(equations, "mass_matrix")
    if chain is None or direct is None:
        return None
    steps = columns.mass_matrix(chain, target)
    return steps if cost(steps) < SHORTER * operations_of(direct) else None


def loops_agree(equations: Equations, chain: Chain) -> bool:
    """Whether the steps of `columns` give the derivatives and the bias of inverse dynamics, along
    random directions at `TRIALS` random states, within `AGREEMENT` of the largest term.
    """
    f = fast_function(equations, "inverse_dynamics")
    n = equations.model.n_a
    assert f is not None
    given = [ca.SX.sym(name, n) for name in f.name_in()]
    ways = [ca.SX.sym(f"d{name}", n) for name in f.name_in()]
    along = ca.Function(
        "along", [*given, *ways], [ca.jtimes(f(*given), ca.vertcat(*given), ca.vertcat(*ways))]
    )
    program = Routine(tuple(columns.derivatives(chain, ("Q", 0), ("V", 0), "M")))
    at_rest = Routine(tuple(columns.bias(chain, "M")))
    rng = np.random.default_rng(0)
    for _ in range(TRIALS):
        state, way = rng.uniform(-1.0, 1.0, (2, 3, n))
        found = evaluate_routine(program, dict(zip(("q_a", "v_a", "a_a"), state, strict=True)))
        bias = evaluate_routine(at_rest, {"q_a": state[0], "v_a": state[1]})["bias"]
        tau = f(*state[:2], np.zeros(n)).full()
        if not np.max(np.abs(bias.ravel() - tau.ravel())) <= AGREEMENT * np.max(np.abs(tau)):
            return False
        terms = [found[name] @ x for name, x in zip("QVM", way, strict=True)]
        expected = along(*state, *way).full().ravel()
        largest = max(np.max(np.abs(term)) for term in terms)
        # (NaN does not agree)
        if not np.max(np.abs(sum(terms) - expected)) <= AGREEMENT * largest:
            return False
    return True


@dataclass(frozen=True)
class AroundTheArm:
    """Rotor inertias and friction, added to the arm's equations: forces without acceleration,
    terms of M_y and R_y.

    Parameters
    ----------
    left : Expressions
        From the ports and the arm's ``bias`` to the remaining forces, ``row_left`` (1, n).
    rotors, changes : Expressions
        To be added to ``M_y`` and to ``R_y``.
    """

    left: Expressions
    rotors: Expressions
    changes: Expressions


def around_the_arm(equations: Equations) -> AroundTheArm:
    """Rotors, springs, dampers and frictions of ``M_y ddy = left``,
    ``R_y = d(-left)/d(y, dy, tau_m)``.
    """
    n = equations.model.dof
    n_a = equations.model.n_a
    names = ["q_a", "v_a", "q_m", "v_m", "tau_m"]
    inputs = symbols_of(equations, names)
    felt = ca.SX.sym("bias", 1, n_a)
    left = equations.lagrangian.forces - ca.vertcat(felt.T, ca.SX.zeros(n - n_a))
    M, R = beside_the_arm(arm_of(equations))
    return AroundTheArm(
        Expressions(
            equations.build("left", [*inputs, felt], [*names, "bias"], [left.T], ["row_left"])
        ),
        Expressions(equations.build("rotors", [], [], [M], ["M_y"]), added=True),
        Expressions(equations.build("changes", inputs, names, [R], ["R_y"]), added=True),
    )
