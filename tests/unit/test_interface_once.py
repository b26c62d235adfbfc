"""Numbers of statuses and limits, and members of enums of the C interface, are stated once, in interface.py."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from typing import get_args

import pytest
from emitted import ROOT

from flexgen.codegen.interface import ENUMS, LIMITS, STATUSES
from flexgen.simulation.hold_names import HoldName

SOURCE = ROOT / "flexgen"
ROWS = SOURCE / "codegen" / "interface.py"
NUMBERS = {status.name: status.code for status in STATUSES} | {limit.name: limit.value for limit in LIMITS}
MEMBERS = {frozenset(enum.names): enum.name for enum in ENUMS}
OWN_NAMES = SOURCE / "simulation" / "hold_names.py"  # of the simulation, for type checkers; compared below


def _number(node: ast.expr | None) -> int | None:
    """The number that an expression is; None for something else."""
    try:
        value = ast.literal_eval(node) if node is not None else None
    except ValueError:
        return None
    return value if type(value) is int else None


def restated(text: str) -> list[str]:
    """Names in a module that are given the number of a status or limit, and collections of an enum's members."""
    found = []
    for node in ast.walk(ast.parse(text)):
        targets: Iterable[ast.expr] = ()
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        for target in targets:
            name = target.id.lstrip("_") if isinstance(target, ast.Name) else ""
            if name in NUMBERS and _number(node.value) == NUMBERS[name]:  # type: ignore[attr-defined]
                found.append(name)
        entries = node.elts if isinstance(node, ast.Tuple | ast.List | ast.Set) else []
        entries = [*node.keys] if isinstance(node, ast.Dict) else entries
        words = [entry.value for entry in entries if isinstance(entry, ast.Constant)]
        if words and len(words) == len(entries) and all(isinstance(word, str) for word in words):
            found += [MEMBERS[frozenset(words)]] if frozenset(words) in MEMBERS else []
    return found


def test_no_module_states_a_number_or_the_members_of_an_enum_again():
    modules = [path for path in SOURCE.rglob("*.py") if path not in (ROWS, OWN_NAMES)]
    again = {str(path.relative_to(SOURCE)): restated(path.read_text(encoding="utf-8")) for path in modules}
    assert again.pop("runtime/stream.py") == ["cause"]  # what Python calls them, by the names of the members
    assert {name: found for name, found in again.items() if found} == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("_LIMITS_INFEASIBLE = -14", ["LIMITS_INFEASIBLE"]),
        ("LIMITS_ACTIVE: int = 2", ["LIMITS_ACTIVE"]),
        ('HOLDS = ("spline", "linear", "zoh")', ["hold"]),
        ('names = {"linear": 1, "spline": 0, "zoh": 2}', ["hold"]),
        ("HOLD_DELAY_MAX = 4", ["HOLD_DELAY_MAX"]),
        ('OK, HOLDS = 5, ("zoh", "none")', []),
    ],
)
def test_a_planted_second_statement_is_found(text, found):
    assert restated(text) == found


def test_the_simulation_has_the_holds_of_the_c_interface():
    (hold,) = (enum for enum in ENUMS if enum.name == "hold")
    assert get_args(HoldName) == hold.names
