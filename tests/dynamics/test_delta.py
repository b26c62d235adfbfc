"""A delta robot with elastic rods: nine passive joints in three spatial loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.codegen.recursion import arm
from flexgen.codegen.recursion.functions import recursive_function
from flexgen.studies.templates.new_model import new_model
from tests.support.linkages import home_of, read_text
from tests.support.worst_accelerations import worst_of


def delta(folder: Path) -> flexgen.RobotModel:
    """The robot of the template, without the friction of its motors."""
    lines = new_model("delta", "delta").splitlines()
    return read_text(folder, "\n".join(x for x in lines if not x.startswith("friction")))


@pytest.mark.slow
def test_accelerations_are_those_of_multipliers(tmp_path: Path) -> None:
    """Bodies and rods in absolute coordinates: asked 1e-9."""
    assert worst_of(delta(tmp_path), 5) < 1e-11


@pytest.mark.full
def test_hundred_accelerations_are_those_of_multipliers(tmp_path: Path) -> None:
    """Accelerations at 100 states."""
    assert worst_of(delta(tmp_path), 100) < 1e-11


@pytest.mark.slow
def test_recursion_is_the_lagrangian(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows without motor and accelerations; they differ without the masses of the rods."""
    model = delta(tmp_path)

    def difference() -> float:
        equations = flexgen.derive(model)
        rng = np.random.default_rng(0)
        worst = 0.0
        for name in ("inversion_rows", "forward_dynamics"):
            slow = equations.function(name)
            fast = recursive_function(equations, name)
            assert fast is not None
            given = [rng.uniform(-0.1, 0.1, slow.numel_in(k)) for k in range(slow.n_in())]
            given[0] = 0.01 * given[0] + home_of(model)
            for a, b in zip(slow.call(given), fast.call(given), strict=True):
                scale = np.abs(np.array(a)).max()
                worst = max(worst, float(np.abs(np.array(a - b)).max() / scale))
        return worst

    assert difference() < 1e-10
    monkeypatch.setattr(arm, "with_rods_as_bodies", without_rods)
    assert difference() > 1e-3


def without_rods(model: flexgen.RobotModel) -> flexgen.RobotModel:
    """The robot without its lines."""
    return replace(model, lines=())
