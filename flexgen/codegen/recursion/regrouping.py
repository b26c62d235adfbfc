"""Choice of the regrouping and of the recursion variables for one robot, by counting operations.

The shortest choice depends on the robot: masses that are regrouped to the body before save
operations at one joint and cost some at another. Each joint is tried once, from the last to the
first; changes that shorten inverse dynamics are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca

from flexgen.codegen.recursion.dh_chain import Chain, KeptInertia, make_chain, regroup
from flexgen.codegen.recursion.newton_euler import inverse_dynamics
from flexgen.codegen.recursion.tape import Tape
from flexgen.model.elements import RobotModel

SEARCHED = 40  # coordinates; longer chains take too long to search
KEPT_ALL = KeptInertia("all", True, True)


@dataclass(frozen=True)
class Plan:
    """A regrouped chain, and for each joint whether ``U e_z`` is carried instead of the angular
    acceleration.
    """

    chain: Chain
    columns: tuple[bool, ...]


def operations(plan: Plan) -> int:
    """Operations of inverse dynamics."""
    tape = Tape()
    n = len(plan.chain.joints)
    q, v, a = (tape.vector(ca.SX.sym(name, n)) for name in "qva")
    return tape.count(inverse_dynamics(tape, plan.chain, q, v, a, plan.columns))


@lru_cache(maxsize=16)
def plans(model: RobotModel) -> tuple[Plan, ...]:
    """Candidate plans for a model without beams, the one with the shortest inverse dynamics
    first.
    """
    chain = make_chain(model)
    n = len(chain.joints)
    # moments of inertia that would move to the empty bodies between joints on one point are not
    # regrouped
    points = [joint.before >= 0 and _on_a_point(chain, i) for i, joint in enumerate(chain.joints)]
    groupings = [
        [KeptInertia()] * n,
        [KEPT_ALL] * n,
        [KeptInertia("none", point, point) for point in points],
    ]
    starts = [(tuple(kept), tuple([column] * n)) for kept in groupings for column in (True, False)]

    def make(kept: tuple[KeptInertia, ...], columns: tuple[bool, ...]) -> Plan:
        return Plan(regroup(chain, kept), columns)

    best = min(starts, key=lambda choice: operations(make(*choice)))
    least = operations(make(*best))
    for i in reversed(range(n if n <= SEARCHED else 0)):
        for other in _others(*best, i):
            count = operations(make(*other))
            if count < least:
                best = other
                least = count
    # columns that are best for inverse dynamics are mostly best for the other functions
    choices = [best, *starts, *((kept, best[1]) for kept, _ in starts[::2])]
    return tuple(make(*choice) for choice in dict.fromkeys(choices))


def _on_a_point(chain: Chain, i: int) -> bool:
    """Whether joint i turns about the same point as the one before it, which moves no body of its
    own.
    """
    here = chain.joints[i]
    own = chain.joints[chain.joints[i].before].inertia
    return (
        here.revolute
        and not here.place.any()
        and not (own.mass or own.first.any() or own.second.any())
    )


def _others(
    kept: tuple[KeptInertia, ...], columns: tuple[bool, ...], i: int
) -> Iterator[tuple[tuple[KeptInertia, ...], tuple[bool, ...]]]:
    """Choices of kept inertias and columns that differ from these at joint i in one respect."""
    here = kept[i]
    yield kept, (*columns[:i], not columns[i], *columns[i + 1 :])
    for changed in (
        *(replace(here, mass=mass) for mass in ("none", "all", "balance") if mass != here.mass),
        replace(here, first=not here.first),
        replace(here, second=not here.second),
    ):
        yield (*kept[:i], changed, *kept[i + 1 :]), columns
