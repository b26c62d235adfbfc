"""Robots with branches: every function on each of its routes against MuJoCo, and with planted bugs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from random_robots import Case
from random_trees import trees
from robot_checks import Found, check_mujoco, close

from flexgen.mechanics.equations import derive
from flexgen.recursion import dh_chain
from flexgen.recursion.functions import _BUILDERS, arm_of, recursive_function

SAMPLE, ALL = 2, 40
LARGEST = 1e-10  # of the largest entry of a result: recursion against Lagrange
GIVEN = {"q_a": "q_a", "v_a": "v_a", "a_a": "a_a", "q_m": "q_m", "v_m": "v_m", "tau_m": "tau_m"}


def on_trees(check, count: int, start: int = 0) -> None:
    """A check of that many random trees, the same ones every time."""
    quiet = {"database": None, "deadline": None, "suppress_health_check": list(HealthCheck), "print_blob": False}
    settings(max_examples=count, phases=(Phase.generate,), **quiet)(seed(start)(given(trees())(check)))()


def check_tree(case: Case) -> None:
    """Lagrange and the recursion against MuJoCo, and every function that has a recursion against Lagrange."""
    equations = derive(case.model)
    for route in ("lagrange", "fast"):
        check_mujoco(Found(equations, route), case)
    check_recursion(equations, case)


def check_recursion(equations, case: Case) -> None:
    """Every function with a recursion, against that of Lagrange's equations."""
    checked = 0
    for name in _BUILDERS:
        fast = recursive_function(equations, name)
        if fast is None:
            continue
        slow, checked = equations.function(name), checked + 1
        for s in case.states:
            known = {port: getattr(s, attribute) for port, attribute in GIVEN.items()} | {"a_m": 1.0 + 0.0 * s.q_m}
            arguments = [known.get(port, np.full(fast.size_in(port), 0.3)) for port in fast.name_in()]
            for x, y in zip(fast.call(arguments), slow.call(arguments), strict=True):
                close(name, np.array(x), np.array(y), LARGEST, 1e-9 + np.abs(np.array(y)).max(initial=0.0))
    assert checked >= 6


def test_functions_of_a_sample_of_random_trees_agree():
    on_trees(check_tree, SAMPLE)


@pytest.mark.slow
def test_functions_of_forty_random_trees_agree():
    on_trees(check_tree, ALL, start=1)


def without_leads(lay):
    """The frames of joints without the rotation about z that only further children have."""

    def planted(*arguments):
        chain = lay(*arguments)
        return replace(chain, joints=tuple(replace(joint, lead=(1.0, 0.0)) for joint in chain.joints))

    return planted


def on_the_last_joint(lay):
    """The load on the last joint, as if the robot were a chain."""

    def planted(*arguments):
        chain = lay(*arguments)
        return replace(chain, carrier=len(chain.joints) - 1)

    return planted


@pytest.mark.slow
@pytest.mark.parametrize("bug", [without_leads, on_the_last_joint])
def test_planted_bugs_of_the_frames_are_found(monkeypatch, bug):
    monkeypatch.setattr(dh_chain, "_lay", bug(dh_chain._lay))

    def check(case: Case) -> None:
        arm_of.cache_clear()
        check_recursion(derive(case.model), case)

    with pytest.raises(AssertionError, match="found"):
        on_trees(check, 6)
    arm_of.cache_clear()


def test_an_element_on_another_parent_is_found():
    def check(case: Case) -> None:
        elements = list(case.model.elements)
        k = next(k for k in range(1, len(elements)) if case.model.parents[elements[k].name] != "base")
        elements[k] = replace(elements[k], parent="base")
        check_mujoco(Found(derive(replace(case.model, elements=tuple(elements)))), case)

    with pytest.raises(AssertionError, match="found"):
        on_trees(check, 2)
