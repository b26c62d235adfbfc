"""Steps along the chain of an arm, as the text of its equations takes them."""

from __future__ import annotations

import pytest

import flexgen
from flexgen.analysis.printing.elements import Return, chain_steps
from flexgen.analysis.printing.equations import Symbols


@pytest.mark.parametrize("name", ["elbow", "manutec_r3", "two_arm"])
def test_steps_return_where_a_branch_begins_and_for_the_tool(name: str) -> None:
    model = flexgen.read(name)
    found = [
        step.name
        for step in chain_steps(model, Symbols(), [0] * model.n_m)
        if isinstance(step, Return)
    ]
    expected = []
    here = "base"
    for element in model.elements:
        if model.parents[element.name] != here:
            expected.append(model.parents[element.name])
        here = element.name
    assert found == expected + [model.tip] * (model.tip != here)
    assert bool(found) is model.branched
