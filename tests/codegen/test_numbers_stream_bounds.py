"""Bounds of streams as they were compared with the C: each content changes the numbers that it is
counted with.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

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
# of the plain stream
COUNT = (20656842, 973445, 246511)
# and what is more with a content
WITH: list[tuple[dict[str, Any], tuple[int, int, int]]] = [
    ({"elements": 3}, (90671174, 0, 4121417)),
    ({"elements": 3, "curved": True}, (127499174, 0, 5795417)),
    ({"position": True}, (80, 0, 292)),
    ({"position": True, "filters": (2, 5, 3)}, (1225740, 0, 520)),
    ({"position": True, "filters": (0, 5, 0)}, (1225740, 0, 352)),
    ({"bristles": True}, (5764596, 0, 419120)),
    ({"bounds": True}, (305580, 305580, 0)),
    ({"harmonics": True}, (0, 0, 0)),
]
CALLED: list[tuple[dict[str, int], tuple[int, int, int]]] = [
    ({"motor_harmonics": 211}, (6216, 259, 777)),
    ({"motor_friction": 307}, (7368, 307, 921)),
    ({"loaded_friction": 401, "motor_friction": 307}, (10680, 445, 1335)),
]


def more(found: Linear, less: tuple[int, int, int]) -> tuple[int, int, int]:
    """Excess of a linear bound over that of the plain stream."""
    return found.constant - less[0], found.per_interval - less[1], found.per_sample - less[2]


@pytest.mark.parametrize(("content", "count"), WITH, ids=[str(list(row[0])) for row in WITH])
def test_contents_of_a_stream_take_time(
    content: dict[str, Any], count: tuple[int, int, int]
) -> None:
    has = replace(PLAIN, **content)
    assert more(stream_operations(SIZES, OPERATIONS, 8, has), COUNT) == count


@pytest.mark.parametrize(("functions", "count"), CALLED, ids=[str(list(row[0])) for row in CALLED])
def test_functions_that_a_stream_calls_take_time(
    functions: dict[str, int], count: tuple[int, int, int]
) -> None:
    assert more(stream_operations(SIZES, OPERATIONS | functions, 8, PLAIN), COUNT) == count


def test_bounds_of_a_plain_stream() -> None:
    assert more(stream_operations(SIZES, OPERATIONS, 8, PLAIN), COUNT) == (0, 0, 0)
    # of numbers in single precision
    assert stream_operations(SIZES, OPERATIONS, 16, PLAIN) == Linear(31721290, 1209227, 246511)
    rigid = SIZES | {"n_e": 0}
    assert stream_operations(rigid, OPERATIONS, 8, PLAIN) == Linear(10262526, 251296, 246391)
    assert (Linear(1, 2, 3) + Linear(10, 20, 30)).times(2) == Linear(22, 44, 66)
