"""The model file that the user has: CAD, the catalogue of the gears and guesses.

No friction, gears with a linear spring, bearings with guessed stiffnesses, a
tracker whose ball is where the drawing has it, and the moves of the task. The text needs no
module of flexgen: the format is that of models/README.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.commissioning.chains import Axis, Body, Chain, rigid_pose
from benchmarks.commissioning.paths import SMOOTHNESS, test_paths
from benchmarks.commissioning.paths import Path as ToolPath

SAMPLE_S = 2e-3  # of the file of a corner


def listed(values: object) -> str:
    """An array of TOML with all digits."""
    return "[" + ", ".join(repr(float(v)) for v in np.asarray(values, float).ravel()) + "]"


def body_text(body: Body) -> str:
    """An inline table with mass, center and inertia."""
    i = body.inertia
    entries = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[1, 2], i[0, 2]]
    return (
        f"{{ mass = {float(body.mass)!r}, com = {listed(body.com)}, inertia = {listed(entries)} }}"
    )


def axis_text(axis: Axis) -> str:
    """A degree of freedom, with its gear or its spring."""
    lines = ["", "[[element.dof]]", f'name = "{axis.name}"', 'type = "rotation"']
    lines.append(f"axis = {listed(axis.axis)}")
    if axis.gear is None:
        lines.append(f'spring = {{ type = "linear", stiffness = {float(axis.stiffness)!r} }}')
        lines.append(f"damping = {float(axis.damping)!r}")
    else:
        lines.append(f"lower_rad = {axis.range[0]!r}")
        lines.append(f"upper_rad = {axis.range[1]!r}")
        spring = f'{{ type = "linear", stiffness = {float(axis.gear.stiffness)!r} }}'
        lines.append(
            f'gear = {{ type = "elastic", side = "arm", spring = {spring}, '
            f"damping = {float(axis.gear.damping)!r} }}"
        )
    return "\n".join(lines)


def motors_text(chain: Chain) -> str:
    """Tables of the motors, without friction."""
    lines = []
    for number, axis in enumerate(chain.joints, start=1):
        gear = axis.gear
        assert gear is not None
        lines += ["", "[[motor]]", f'name = "m{number}"', f'drives = "{axis.name}"']
        lines.append(f"ratio = {gear.ratio!r}")
        lines.append(f"inertia = {gear.rotor!r}")
        lines.append(f"torque_max = {gear.torque_max!r}")
    return "\n".join(lines)


def move_text(path: ToolPath, chain: Chain, folder: Path) -> str:
    """A table of a move; a corner is written to a file of samples in the folder."""
    lines = ["", "[[move]]", f'name = "{path.name}"']
    start = f"start_deg = {listed(path.start_deg)}"
    law = [f"duration = {path.duration!r}", f"smoothness = {SMOOTHNESS}"]
    if path.center is not None:
        lines += ['type = "tool_circle"', start, f"center = {listed(path.center)}"]
        lines += [f"axis = {listed(path.axis)}", f"angle_deg = {path.turn_deg!r}", *law]
    elif len(path.legs) == 1:
        lines += ['type = "tool_line"', start, f"displacement = {listed(path.legs[0])}", *law]
    else:
        lines += ['type = "sampled"', start, f'file = "{path.name}.csv"', "degree = 9"]
        write_samples(path, chain, folder / f"{path.name}.csv")
    return "\n".join(lines)


def write_samples(path: ToolPath, chain: Chain, file: Path) -> None:
    """Positions of the tool over time, with the constant orientation of an arm with a wrist."""
    time = np.linspace(0.0, path.duration, round(path.duration / SAMPLE_S) + 1)
    place, _ = rigid_pose(chain, path.start())
    rows = np.column_stack([time, place + path.displacement(time)])
    np.savetxt(file, rows, fmt="%.12g", delimiter=",", header="t,x,y,z", comments="")


def write_model(chain: Chain, path: Path) -> None:
    """A model file of this chain, with linear gears and without friction."""
    lines = [f'name = "{chain.name}"', f"gravity = {listed([0, 0, -9.81])}"]
    lines.append(f"home_rad = {listed(chain.home)}")
    for link in chain.links:
        lines += ["", "[[element]]", f'name = "{link.name}"']
        lines.append(f"origin = {{ position = {listed(link.origin)} }}")
        lines.append(f"body = {body_text(link.body)}")
        lines += [axis_text(axis) for axis in link.axes]
    lines.append(motors_text(chain))
    lines += ["", "[tool]", f"position = {listed(chain.tool)}"]
    lines += ["", f"[payload]\n{payload_text(chain.payload)}"]
    lines += ["", "[[sensor]]", 'name = "ball"', 'type = "tracker"', 'element = "tool"']
    lines += [f"position = {listed(chain.ball - chain.tool)}", 'unit = "m"', "noise = 3e-5"]
    kind = "tool_position" if len(chain.gears) == 3 else "tool_pose"
    lines += ["", "[output]", f'type = "{kind}"']
    lines += [move_text(move, chain, path.parent) for move in test_paths(chain)]
    lines += ["", joints_text(chain)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def joints_text(chain: Chain) -> str:
    """A variant whose only springs are those of the gears."""
    removed = [
        f'"element.{link.name}.dof.{axis.name}"'
        for link in chain.links
        for axis in link.axes
        if axis.gear is None
    ]
    lines = ["[variant.joints]", 'description = "rigid bearings and links"']
    return "\n".join([*lines, f"remove = [{', '.join(removed)}]"])


def payload_text(body: Body) -> str:
    """Keys of the table of the payload."""
    inline = body_text(body)
    return inline[2:-2].replace(", com", "\ncom").replace(", inertia", "\ninertia")


def write_datasheet(chain: Chain, path: Path) -> None:
    """Datasheet that the user starts from: the stated arm of `robots.stated`."""
    write_model(chain, path)
