"""Recursions of a robot whose first joint carries two branches, the second one turned and
shifted.
"""

from __future__ import annotations

from pathlib import Path

import flexgen
from flexgen.codegen.recursion import functions
from flexgen.dynamics.mechanics.equations import derive

BODY = "body = { mass = 3.0, com = [0.1, 0.2, -0.1], inertia = [0.1, 0.12, 0.09] }"
TEXT = f"""\
name = "fork"
gravity = [0.0, 0.0, -9.81]
home_rad = [0.2, -0.4, 0.3]
tool = {{ position = [0.1, 0, 0.2] }}
output = {{ type = "joint", joints = ["q1", "q2", "q3"] }}

[[element]]
name = "trunk"
origin = {{ position = [0.1, 0.2, 0.3], rpy_deg = [10, 20, 30] }}
{BODY}
dof = [{{ name = "q1", type = "rotation", axis = [0, 0, 1], gear = {{ type = "rigid" }} }}]

[[element]]
name = "right"
origin = {{ position = [0.4, 0.1, 0.2], rpy_deg = [20, 30, 40] }}
{BODY}
dof = [{{ name = "q2", type = "rotation", axis = [0, 1, 0], gear = {{ type = "rigid" }} }}]

[[element]]
name = "left"
parent = "trunk"
origin = {{ position = [-0.3, 0.5, 0.1], rpy_deg = [-50, 10, 70] }}
{BODY}
dof = [{{ name = "q3", type = "rotation", axis = [1, 0, 0], gear = {{ type = "rigid" }} }}]
""" + "".join(
    f'\n[[motor]]\nname = "m{k}"\ndrives = "q{k}"\nratio = 100.0\ninertia = 1e-4\n'
    for k in (1, 2, 3)
)


def test_recursions_of_a_robot_with_two_branches_are_those_of_its_energy(tmp_path: Path) -> None:
    """Otherwise it has the functions of its energy, which are right and longer."""
    (tmp_path / "fork.toml").write_text(TEXT)
    equations = derive(flexgen.read(tmp_path / "fork.toml"))
    assert functions.agrees(equations)
