"""Legs of polylines: zones between them, and speeds of their own."""

from __future__ import annotations

from typing import Any

import pytest

import flexgen
from flexgen.base.errors import ModelError

FIRST: dict[str, Any] = {"displacement": [0.1, 0.0, 0.0], "zone": 0.02}
LAST: dict[str, Any] = {"displacement": [0.0, 0.1, 0.0]}
PROFILE = [0.4, 2.0, 30.0, 600.0]


def read(legs: list[dict[str, Any]], **more: Any) -> flexgen.Move:
    """The first move of a robot with a polyline."""
    move = {"name": "two", "type": "tool_polyline", "start_rad": [0.3, -1.1], "smoothness": 5}
    robot = flexgen.read("planar5_nmp", overrides={"move": [move | {"legs": legs} | more]})
    return robot.moves[0]


def test_the_last_leg_of_a_polyline_has_no_zone() -> None:
    """It counts as 0."""
    assert [leg.zone for leg in read([FIRST, LAST], profile=PROFILE).legs] == [0.02, 0.0]


WRONG: dict[str, tuple[list[dict[str, Any]], dict[str, Any], str]] = {
    "a zone of the last leg": (
        [FIRST, LAST | {"zone": 0.01}],
        {"profile": PROFILE},
        "expected no zone in the last leg",
    ),
    "no zone": ([{"displacement": [0.1, 0.0, 0.0]}, LAST], {"profile": PROFILE}, "zone"),
    "a speed without profile": (
        [FIRST | {"speed": 0.1}, LAST],
        {"duration": 1.0},
        "expected no speed, or a profile of the move",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_legs_are_refused(name: str) -> None:
    legs, more, text = WRONG[name]
    with pytest.raises(ModelError, match=text):
        read(legs, **more)
