"""Joints on one chain of a tree of elements."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import flexgen
from flexgen.exports.mechanisms import on_one_chain


def test_joints_of_one_chain_are_those_of_an_element_and_its_parents() -> None:
    def element(name: str, *joints: str) -> Any:
        return Made(name=name, dofs=[Made(name=joint) for joint in joints])

    elements = [
        element("trunk", "q0"),
        element("left", "q1", "q2"),
        element("right", "q3"),
        element("hand", "q4"),
    ]
    model: Any = Made(
        elements=elements,
        parents={"trunk": "base", "left": "trunk", "right": "trunk", "hand": "left"},
    )
    for joints in (["q0"], ["q0", "q1", "q2", "q4"], ["q4", "q0"], ["q0", "q3"], []):
        assert on_one_chain(model, joints)
    for joints in (["q1", "q3"], ["q0", "q3", "q4"], ["q9"]):
        assert not on_one_chain(model, joints)
    assert on_one_chain(flexgen.read("manutec_r3"), ["q1", "q2", "q3"])
