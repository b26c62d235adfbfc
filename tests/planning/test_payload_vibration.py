"""The fastest move of a robot with a payload that vibrates: the bound holds for the payload, where
its motor follows positions in closed form.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from slide import DAMPING, FREQUENCY, SLIDE

import flexgen
from flexgen.planning.fastest.residual_vibration import vibrating_coordinates

ALLOWED = 4e-3  # m
LIMIT = 60.0  # N
OFF = (0.9, 1.1)  # stiffness over that of the model


def robot(folder: Path) -> flexgen.RobotModel:
    text = SLIDE.replace("inertia = 0.0", f"inertia = 0.0\ntorque_max = {LIMIT}")
    (folder / "slide.toml").write_text(text, encoding="utf-8")
    return flexgen.read(folder / "slide.toml")


def sway_after(found: flexgen.Solution, stiffness: float) -> float:
    """Amplitude [m] of the oscillator after the path: convolution of the acceleration of the
    cart with the impulse response.
    """
    path = flexgen.plan(found.model, found.move)
    time = np.linspace(0.0, path.duration, 20001)
    a = path.sample(time).y[:, 0, 2]
    w = 2 * np.pi * FREQUENCY * np.sqrt(stiffness)
    d = DAMPING / np.sqrt(stiffness)
    rate = -d * w + 1j * w * np.sqrt(1 - d**2)
    held = np.trapezoid(a * np.exp(rate * (time[-1] - time)), time)
    return float(np.abs(held) / (w * np.sqrt(1 - d**2)))


@pytest.mark.slow
def test_bound_of_a_payload_holds_where_the_output_does_not_move(tmp_path):
    slide = robot(tmp_path)
    found = flexgen.fastest(slide, coefficients=8, vibration=ALLOWED)
    assert (found.vibrating, found.unit) == (("sway",), "m")
    assert max(found.vibration.values()) <= 1.001 * ALLOWED
    assert min(found.default_vibration.values()) > 5 * ALLOWED
    quiet = max(sway_after(found.solution, x) for x in OFF)
    assert quiet < 0.1 * min(sway_after(found.default, x) for x in OFF)
    assert "vibration of sway after the path" in found.to_text()


def test_the_output_vibrates_of_robots_with_elastic_gears_or_a_tool_as_output(tmp_path):
    assert names_of(robot(tmp_path)) == ["sway"]
    text = (tmp_path / "slide.toml").read_text(encoding="utf-8")
    soft = '{ type = "elastic", side = "arm", spring = { type = "linear", stiffness = 1e5 } }'
    changes = (
        ('gear = { type = "rigid" }', f"gear = {soft}"),
        ('type = "joint"\njoints = ["q1"]', 'type = "tool_position"\naxes = "x"'),
    )
    for old, new in changes:
        assert old in text
        changed = text.replace(old, new).replace("inertia = 0.0", "inertia = 0.1")
        (tmp_path / "other.toml").write_text(changed, encoding="utf-8")
        assert names_of(flexgen.read(tmp_path / "other.toml")) == []


def names_of(model: flexgen.RobotModel) -> list[str]:
    return [model.coordinates[i].name for i in vibrating_coordinates(model)]
