"""Robots with a positioner, as text of model files, and where MuJoCo sees their frames."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import flexgen
from flexgen.model.elements import RobotModel
from flexgen.studies.templates.new_model import new_model

POSITIONER = """
[[element]]
name = "cradle"
parent = "base"
origin = {{ position = [0.95, 0.1, 0.35], rpy_deg = [0, 0, 20] }}
body = {{ mass = 80.0, com = [0, 0, 0.05], inertia = [4.0, 3.0, 5.0] }}

[[element.dof]]
name = "tilt"
type = "rotation"
axis = [0, 1, 0]
gear = {{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = 3e5 }}, \
damping = 200.0 }}

[[element]]
name = "table"
origin = {{ position = [0.05, 0, 0.15] }}
body = {{ mass = 60.0, com = [0.02, 0, 0.05], inertia = [2.0, 2.0, 3.0] }}

[[element.dof]]
name = "turn"
type = "rotation"
axis = [0, 0, 1]
gear = {{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = 1e5 }}, \
damping = 70.0 }}
{bearing}
[[motor]]
name = "m7"
drives = "tilt"
ratio = 150
inertia = 1e-3
friction = {{ viscous = 1e-3 }}

[[motor]]
name = "m8"
drives = "turn"
ratio = 100
inertia = 8e-4
friction = {{ viscous = 1e-3 }}

[tool]
element = "flange"
position = [0.12, 0, 0]

[payload]
mass = 5.0
com = [0.1, 0, 0]
inertia = [0.03, 0.03, 0.03]

[output]
type = "tool_pose"
joints = ["tilt", "turn"]

[[frame]]
name = "part"
element = "table"
position = [0.1, 0.05, 0.12]
rpy_deg = [5.0, -10.0, 30.0]
{moves}
"""
# Between the table and its part: what no motor moves.
BEARING = """
[[element.dof]]
name = "bearing"
type = "rotation"
axis = [1, 0, 0]
spring = { type = "linear", stiffness = 2e5 }
damping = 100.0
"""
START = "[0.1, 0.2, 0.1, 0.1, 0.8, 0.2, 0.2, -0.3]"
SEAM = f"""
[[move]]
name = "seam"
type = "tool_line"
frame = "part"
start_rad = {START}
displacement = [0.10, -0.05, 0.04]
rotation_rad = [0.1, 0.0, -0.1]
duration = 1.0
smoothness = 5
posture = {{ joints = {{ tilt = 0.25, turn = -0.5 }} }}
"""


def cell(folder: Path, moves: str = SEAM, bearing: str = "") -> RobotModel:
    """A six-axis arm with elastic gears and a positioner that tilts and turns."""
    text = new_model("cell", "six-axis")
    elements, rest = text.split("# ratio: motor angle", 1)
    motors = rest.partition("\n")[2].split("[tool]")[0]
    elements = elements.replace("45.0, 0.0]", "45.0, 0.0, 0.0, 0.0]", 1)
    before, after = POSITIONER.format(bearing=bearing, moves=moves).split("[[motor]]", 1)
    file = folder / "cell.toml"
    file.write_text(elements + before + motors + "[[motor]]" + after)
    return flexgen.read(file)


class Seen:
    """The frames of a robot as MuJoCo places them."""

    def __init__(self, model: RobotModel, folder: Path) -> None:
        file = flexgen.export_mujoco(model, folder / f"{model.name}.xml")
        self.model = mujoco.MjModel.from_xml_path(str(file.path))
        self.data = mujoco.MjData(self.model)
        self.robot = model

    def move(self, q_a: np.ndarray) -> None:
        """Move to these arm coordinates (n_a,)."""
        for coordinate, q in zip(self.robot.coordinates, q_a, strict=True):
            joint = self.model.joint(coordinate.name)
            self.data.qpos[joint.qposadr[0]] = q
        mujoco.mj_kinematics(self.model, self.data)

    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Position and orientation of the tool."""
        site = self.data.site("tool")
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def body(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Position and orientation of an element's body frame."""
        body = self.data.body(name)
        return body.xpos.copy(), body.xmat.reshape(3, 3).copy()
