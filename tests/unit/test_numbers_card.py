"""Numbers of a GPU: codes of CUDA as published, sizes of workspaces, and shapes of many problems."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

from flexgen.cuda import driver, inversion
from flexgen.errors import ArgumentError


def test_codes_of_the_driver_are_those_of_its_header() -> None:
    """Of cuda.h: CU_DEVICE_ATTRIBUTE_..., CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL, CUDA_ERROR_..., and its largest grid."""
    assert (driver._MAJOR, driver._MINOR, driver._ORDINAL) == (75, 76, 9)
    assert (driver._OUT_OF_MEMORY, driver._NO_DEVICE, driver._LAUNCH_RESOURCES) == (2, 100, 701)
    assert driver._SMALLEST == (7, 5) and driver._MOST_BLOCKS == 2147483647


def test_workspaces_grow_in_steps_of_at_most_an_eighth() -> None:
    """No step below 16 reals; eight sizes between two powers of two."""
    found = {n: inversion.workspace_of(n) for n in range(1, 3000)}
    assert all(n <= size <= max(n, 9 * n / 8) for n, size in found.items())
    assert [found[n] for n in (1, 7, 15, 16, 17, 31, 32, 33, 63, 65, 1025)] == [
        1,
        7,
        15,
        16,
        18,
        32,
        32,
        36,
        64,
        72,
        1152,
    ]
    assert len({size for size in found.values() if 1024 <= size < 2048}) == 8


class Array:
    """An array on a card; what was demanded of it."""

    def __init__(self, *shape: int) -> None:
        self.shape, self.demanded = shape, None

    def demand(self, shape: Any, real: Any, order: str) -> None:
        assert (real, order) == (np.float64, "C")
        self.demanded = shape


@pytest.mark.parametrize("own", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_many_problems_share_what_they_do_not_have_of_their_own(own: tuple[int, int, int]) -> None:
    """Paths with their rates, parameters, and starts: each of them one, or one for each of seven problems."""
    inverter = Made(_sizes={"n_t": 4, "n_y": 3, "n_a": 2}, _real=np.float64, _parameters=np.zeros(5))
    made: Any = object.__new__(inversion.CudaManyInverter)
    made._inverter = inverter
    path, parameters, start = ((7,) * each for each in own)
    given: dict[str, Any] = {
        "y": Array(*path, 50, 4),
        "dy": Array(*path, 50, 3),
        "ddy": Array(*path, 50, 3),
        "q_start": Array(*start, 2),
        "parameters": Array(*parameters, 5),
    }
    if not any(own):
        with pytest.raises(ArgumentError, match="given one path, one q_start and one set of parameters, expected the"):
            made._demand(given)
        return
    assert made._demand(given) == (dict(zip(("own_path", "own_parameters", "own_q_start"), own, strict=True)), 7)
    none = (None,)
    assert given["y"].demanded == (*none * own[0], None, 4)
    assert given["dy"].demanded == given["ddy"].demanded == (*path, 50, 3)
    assert given["q_start"].demanded == (*none * own[2], 2)
    assert given["parameters"].demanded == (*none * own[1], 5)
    if own == (1, 1, 1):
        given["q_start"] = Array(6, 2)
        with pytest.raises(ArgumentError, match="given 7 of y, 7 of dy, 7 of ddy, 6 of q_start, 7 of parameters, exp"):
            made._demand(given)
