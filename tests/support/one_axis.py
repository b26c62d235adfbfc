"""A model file of one axis along x: a carriage behind a motor."""

from __future__ import annotations


def one_axis(
    name: str, gear: str, *, mass: float, ratio: float, rotor: float, way: float, duration: float
) -> str:
    """``gear``: the inline table of its gear; ``way`` [m] of its joint move."""
    return f"""
name = "{name}"
gravity = [0.0, 0.0, -9.81]
home_rad = [0.0]
[[element]]
name = "carriage"
body = {{ mass = {mass}, inertia = [1, 1, 1] }}
[[element.dof]]
name = "x"
type = "translation"
axis = [1, 0, 0]
gear = {gear}
[[motor]]
name = "m1"
drives = "x"
ratio = {ratio}
inertia = {rotor}
[output]
type = "tool_position"
axes = "x"
[[move]]
name = "there"
type = "joint"
start_rad = [0.0]
end_rad = [{way}]
duration = {duration}
smoothness = 5
"""
