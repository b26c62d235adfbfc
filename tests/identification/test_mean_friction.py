"""Frictions that a linear model contains."""

from __future__ import annotations

import pytest

from flexgen.identification.rigid.mean_friction import is_linear
from flexgen.model.elements import Friction


@pytest.mark.parametrize(
    ("friction", "linear"),
    [
        (Friction(), True),
        (Friction(viscous=0.5), True),
        (Friction(viscous=0.5, offset=2.0), True),
        (Friction(viscous=0.5, coulomb=0.1, beta=2.0), False),
    ],
)
def test_only_viscous_friction_is_linear(friction: Friction, linear: bool) -> None:
    assert is_linear(friction) == linear
