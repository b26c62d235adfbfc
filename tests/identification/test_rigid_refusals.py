"""Arguments of `identify_rigid` that are refused, with what is expected instead."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.rigid.rigid_body import identify_rigid
from flexgen.model.format.format_robot import HARMONICS

MOTION: Any = SimpleNamespace(q=np.zeros((3, 2)), tau_m=np.zeros((3, 3)))
MOST = f"counterbalance: given {HARMONICS} harmonics for 'q1', expected {HARMONICS - 1} at most"
ONE_OF = r"counterbalance: given .*, expected one of q1, q2 and >= 1"


@pytest.mark.parametrize(
    ("motions", "counterbalance", "text"),
    [
        ([], {"q1": HARMONICS}, MOST),
        ([], {"q9": 1}, ONE_OF),
        ([], {"q1": 0}, ONE_OF),
        ([], {"q1": 1.5}, ONE_OF),
        (
            [],
            {"q1": HARMONICS - 1},
            "motions, prior: expected at least one motion and a deviation > 0",
        ),
        ([MOTION], None, "motion: given 2 joints and 3 motors, expected 2, 2"),
    ],
)
def test_refusals(motions: Any, counterbalance: Any, text: str) -> None:
    given = {} if counterbalance is None else {"counterbalance": counterbalance}
    with pytest.raises(ArgumentError, match=f"^{text}$"):
        identify_rigid(flexgen.read("elbow"), motions, **given)
