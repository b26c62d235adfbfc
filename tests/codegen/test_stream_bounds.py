"""Operations of a stream's update: what contents, functions and sizes add to the bound.

The operations of the C itself are counted in tests/client/test_stream_constants.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexgen.codegen.emission import stream_bounds
from flexgen.codegen.emission.size_terms import Linear
from flexgen.codegen.emission.stream_bounds import stream_operations
from flexgen.codegen.emission.stream_layout import Contents

SIZES = {"n_a": 7, "n_g": 5, "n_e": 2, "n_m": 4, "n_y": 3, "n_t": 6}
OPERATIONS = {
    "output_constraint": 1009,
    "inversion_rows": 10007,
    "gear_law": 101,
    "inversion_jacobians": 100003,
}
PLAIN = Contents(0, False, False, False, False, False, (0, 0, 0))
# Instants at which the laws of motors are evaluated: of the first window, and of two nodes with
# limits; of the node of an interval; of a sample, where they have two derivatives.
INSTANTS = (2 * stream_bounds.BACK + 2 + stream_bounds.AHEAD + 2, 1, 3)


def parts(
    sizes: dict[str, int] | None = None,
    block: int = 8,
    has: Contents = PLAIN,
    **operations: int,
) -> np.ndarray:
    """Constant, per interval and per sample."""
    found = stream_operations(sizes or SIZES, OPERATIONS | operations, block, has)
    return np.array([found.constant, found.per_interval, found.per_sample])


@pytest.mark.parametrize(
    ("content", "before", "grown"),
    [
        ({"elements": 3}, {}, (True, False, True)),
        ({"elements": 4}, {"elements": 3}, (True, False, True)),
        ({"elements": 3, "curved": True}, {"elements": 3}, (True, False, True)),
        ({"curved": True}, {}, (False, False, False)),
        ({"position": True}, {}, (True, False, True)),
        ({"position": True, "filters": (0, 5, 0)}, {"position": True}, (True, False, True)),
        ({"position": True, "filters": (2, 0, 0)}, {"position": True}, (False, False, True)),
        ({"position": True, "filters": (0, 0, 3)}, {"position": True}, (False, False, True)),
        ({"bristles": True}, {}, (True, False, True)),
        ({"bounds": True}, {}, (True, True, False)),
        ({"harmonics": True}, {}, (False, False, False)),
    ],
    ids=str,
)
def test_a_content_adds_operations_where_it_is_computed(
    content: dict[str, Any], before: dict[str, Any], grown: tuple[bool, ...]
) -> None:
    added = parts(has=replace(PLAIN, **content)) - parts(has=replace(PLAIN, **before))
    assert (added >= 0).all()
    assert tuple(added > 0) == grown


@pytest.mark.parametrize(
    ("functions", "one"),
    [
        ({"motor_friction": 307}, 307),
        ({"motor_harmonics": 211}, 211 + 12 * SIZES["n_m"]),
        # instead of the friction without load, with a load for each motor
        (
            {"motor_friction": 307, "loaded_friction": 401},
            401 + SIZES["n_m"] * (2 * SIZES["n_g"] + 1),
        ),
    ],
    ids=str,
)
def test_laws_of_motors_are_computed_at_every_instant(functions: dict[str, int], one: int) -> None:
    assert (parts(**functions) - parts()).tolist() == [one * count for count in INSTANTS]


@pytest.mark.parametrize("name", OPERATIONS)
def test_the_bound_is_linear_in_the_operations_of_a_function(name: str) -> None:
    """A change that all shares of blocks and groups divide."""
    step = 1 << 12
    first, second, third = (parts(**{name: k * step}) for k in (1, 2, 3))
    assert (second - first == third - second).all()
    assert second[0] > first[0]


@pytest.mark.parametrize("name", SIZES)
def test_a_larger_robot_needs_more_operations(name: str) -> None:
    larger = parts(SIZES | {name: SIZES[name] + 1})
    assert (larger >= parts()).all()
    assert larger[0] > parts()[0]


def test_longer_blocks_compute_more_at_once_and_the_same_for_a_sample() -> None:
    """Of a group of points only whole ones are computed; a sample is one of them."""
    longer = parts(block=16)
    assert longer[0] > parts()[0] and longer[1] >= parts()[1]
    assert longer[2] == parts()[2]
    rigid = parts(SIZES | {"n_e": 0})
    assert (rigid < parts()).all()


def test_bounds_are_added_and_multiplied_by_parts() -> None:
    assert (Linear(1, 2, 3) + Linear(10, 20, 30)).times(2) == Linear(22, 44, 66)
