"""Joints above a link of a URDF file, and the growth of a motion that a library computes."""

from __future__ import annotations

import ctypes
from threading import Event
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.model.urdf.overlay import _Overlay
from flexgen.runtime.inversion import growth
from flexgen.runtime.inversion.growth import Growth


def test_joints_above_a_link_are_those_up_to_the_base() -> None:
    joints = {"hand": Made(name="q3", parent="fore"), "fore": Made(name="q2", parent="upper")}
    joints |= {"upper": Made(name="q1", parent="base"), "other": Made(name="q9", parent="base")}
    reader: Any = Made(urdf=Made(parent_joint=joints))
    for link, expected in (("hand", {"q1", "q2", "q3"}), ("upper", {"q1"}), ("base", set())):
        assert _Overlay._above(reader, link) == expected


@pytest.mark.parametrize(
    ("real", "c_real"), [(np.float64, ctypes.c_double), (np.float32, ctypes.c_float)]
)
def test_the_growth_of_a_motion_is_asked_of_its_library(
    real: Any, c_real: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its period in the precision of the library, and a workspace of its size."""
    asked: list[Any] = []
    motion = growth.Inversion.__new__(growth.Inversion)
    fields = {key: np.ones((3, 2)) for key in growth._WIDTHS} | {"period": 0.25, "n_pre": 0}
    for name, value in fields.items():
        object.__setattr__(motion, name, value)
    monkeypatch.setattr(
        growth,
        "struct_of",
        lambda kind, **arrays: ctypes.c_int(sum(x.size for x in arrays.values())),
    )

    def entry(given: Any, n: Any, period: Any, *pointers: Any) -> int:
        asked.append((n.value, type(period), period.value, pointers[-1].value))
        if len(asked) > 1:
            return -4
        ctypes.cast(pointers[-3], ctypes.POINTER(c_real))[0] = 2.5
        return 0

    sizes = dict.fromkeys(growth._WIDTHS.values(), 2)
    failures: Any = {-4: (SolverError, "not finite")}
    kind: Any = ctypes.c_int
    made = Growth("arm", sizes, kind, entry, 40, np.zeros(0, real), failures, (print, ()))
    assert made(motion) == 2.5 and asked == [(3, c_real, 0.25, 40)]
    with pytest.raises(SolverError, match="growth: not finite"):
        made(motion)
    with pytest.raises(
        ArgumentError, match="growth, motion: given int, expected what invert returned"
    ):
        made(3)  # type: ignore[arg-type]
    assert isinstance(made.closed, type(Event()))
