"""A single rigid rotor with a direct drive: the double integrator ``J y'' = u`` as a robot."""

from __future__ import annotations

from pathlib import Path

INERTIA = 2.0 + 0.5  # kg m^2: load and rotor

TEXT = """
name = "double_integrator"
description = "a rotor without friction"
gravity = [0.0, 0.0, 0.0]
home_rad = [0.0]

[[element]]
name = "load"
body = { mass = 1.0, inertia = [2.0, 2.0, 2.0] }

[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 0, 1]
gear = { type = "rigid" }

[[motor]]
name = "m1"
drives = "q1"
ratio = 1
inertia = 0.5

[output]
type = "combination"
unit = "rad"
rows = [{ q1 = 1.0 }]

[[move]]
name = "turn"
type = "output_line"
start_rad = [0.0]
displacement = [1.5]
duration = 2.0
smoothness = 5
"""


def double_integrator(folder: Path) -> Path:
    """The model file in a folder."""
    path = folder / "double_integrator.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path
