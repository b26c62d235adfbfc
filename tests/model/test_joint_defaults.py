"""Defaults of joints in an overlay: they fill what a joint does not state."""

from __future__ import annotations

from typing import Any

import pytest

from flexgen.base.spec.toml_lines import Entry
from flexgen.model.urdf.joint_defaults import merge

Table = dict[str, Any]


def entry(value: Any, line: int) -> Entry:
    inner = {k: entry(v, line) for k, v in value.items()} if isinstance(value, dict) else value
    return Entry(inner, line)


def plain(table: dict[str, Entry]) -> Table:
    return {k: plain(e.value) if isinstance(e.value, dict) else e.value for k, e in table.items()}


GEAR = {"type": "x", "ratio": 100, "loss": 1}
SPRING = {"spring": {"stiffness": 3}}


@pytest.mark.parametrize(
    ("default", "own", "expected"),
    [
        ({"a": 1, "b": 2}, {"b": 3}, {"a": 1, "b": 3}),
        # tables of one type are merged, one of another type replaces the default
        ({"gear": GEAR}, {"gear": {"ratio": 50}}, {"gear": {**GEAR, "ratio": 50}}),
        ({"gear": GEAR}, {"gear": {"type": "x", "ratio": 50}}, {"gear": {**GEAR, "ratio": 50}}),
        ({"gear": GEAR}, {"gear": {"type": "y"}}, {"gear": {"type": "y"}}),
        ({"gear": {"ratio": 9}}, {"gear": {"type": "y"}}, {"gear": {"type": "y"}}),
        ({"gear": {"ratio": 9}}, {"gear": {"loss": 2}}, {"gear": {"ratio": 9, "loss": 2}}),
        ({"gear": GEAR}, {"gear": 5}, {"gear": 5}),
        # a spring excludes gear and motor
        ({"gear": GEAR, "motor": {"inertia": 1}, "a": 1}, SPRING, {**SPRING, "a": 1}),
    ],
)
def test_defaults_fill_what_a_joint_does_not_state(
    default: Table, own: Table, expected: Table
) -> None:
    assert plain(merge(entry(default, 1).value, entry(own, 2).value)) == expected


def test_entries_keep_the_lines_in_which_they_are_stated() -> None:
    found = merge(entry({"gear": GEAR}, 1).value, entry({"gear": {"ratio": 50}}, 7).value)
    gear = found["gear"]
    assert gear.line == 7 and gear.value["ratio"].line == 7 and gear.value["loss"].line == 1
