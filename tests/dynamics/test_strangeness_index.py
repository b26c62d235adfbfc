"""The strangeness index is searched from the structural index on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.dae import strangeness_index


@pytest.mark.parametrize(("orders", "found_at"), [([3], 3), ([3, 4, 5], 5), ([3, 4, 5, 6], 6)])
def test_the_strangeness_index_is_searched_until_all_points_have_one(
    orders: list[int], found_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the structural index on, up to the highest."""
    asked: list[int] = []

    def consistent(series: Any, reference: Any, instants: np.ndarray, order: int) -> Any:
        asked.append(order)
        return "x", [order, order]

    def characterize(F_x: Any, F_dx: Any, scale: int) -> Any:
        known = scale >= found_at and (F_x == 0 or found_at < 6)
        return SimpleNamespace(verdict="found" if known else "not found", order=scale)

    series = SimpleNamespace(jacobians=lambda x: ([0, 1], [0, 1]))
    replaced = {
        "TaylorArray": lambda dae: series,
        "InverseDae": lambda equations: None,
        "consistent": consistent,
        "characterize": characterize,
        "structural_index": lambda equations: SimpleNamespace(index=3),
    }
    for name, value in replaced.items():
        monkeypatch.setattr(strangeness_index, name, value)
    reference: Any = SimpleNamespace(duration=1.0)
    function: Any = strangeness_index.kunkel_mehrmann
    found = function(None, reference, [0.2, 0.4], highest=6)
    assert asked == orders and len(found) == 2 and found[0].order == orders[-1]
    for wrong in ([0.4, 0.2], [0.2, 0.2], [], [np.nan], [[0.1]]):
        with pytest.raises(
            ArgumentError, match=r"^times: given .*, expected rising instants in s$"
        ):
            function(None, reference, wrong)
