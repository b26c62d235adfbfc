"""Curves of the largest torque over the speed: with the axes they bound a convex region."""

from __future__ import annotations

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.curve import checked_curves, is_torque_speed


@pytest.mark.parametrize(
    ("points", "good"),
    [
        ([[0, 5], [10, 5], [20, 3], [30, 0]], True),
        ([[0, 5], [10, 4], [20, 3]], True),
        ([[0, 5], [10, 5]], True),
        ([[0, 5]], False),
        ([[1, 5], [10, 4]], False),
        ([[0, 0], [10, 0]], False),
        ([[0, 5], [10, -1]], False),
        ([[0, 5], [10, 5.1]], False),
        ([[0, 5], [10, 3], [20, 2]], False),  # falls slower
        ([[0, 5], [10, 4], [10, 3]], False),
        ([[0, 5, 1], [10, 4, 1]], False),
        ([[0, 5], [10, np.nan]], False),
    ],
)
def test_a_curve_falls_faster_and_faster(points: list[list[float]], good: bool) -> None:
    assert is_torque_speed(np.array(points, dtype=float)) is good
    assert checked_curves("m", [[], ()]) == ()
    if good:
        assert checked_curves("m", [points, []]) == (tuple(map(tuple, points)), ())
        return
    expected = r"^m: given .*, expected two or more points \[speed, torque\]"
    with pytest.raises(ArgumentError, match=expected):
        checked_curves("m", [[], points])
