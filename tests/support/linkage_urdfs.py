"""The four-bar arm of `linkages` as URDF files: its loop as <constraint> or in a YAML file."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from tests.support.linkages import FOUR_BAR

# Lengths [m]: lower arm, crank, half of the rod, and its bearing on the forearm.
LOWER = 0.7
CRANK = -0.2
HALF_ROD = 0.35
BEARING = -0.18
SHOULDER = 0.5

# name: parent, position, angle of the joint in its name, mass, center of mass, inertia
LINKS = {
    "lower": ("base", (0.0, 0.0, SHOULDER), "q1", 30.0, 0.3, (0.2, 2.0, 2.0)),
    "fore": ("lower", (LOWER, 0.0, 0.0), "q3", 20.0, 0.25, (0.1, 1.0, 1.0)),
    "crank": ("base", (0.0, 0.0, SHOULDER), "q2", 8.0, -0.1, (0.02, 0.05, 0.05)),
    "rod": ("crank", (CRANK, 0.0, 0.0), "q4", 0.0, 0.0, (0.0, 0.0, 0.0)),
    "rod_end": ("rod", (HALF_ROD, 0.0, 0.0), "", 5.0, 0.0, (0.01, 0.3, 0.3)),
}
CONSTRAINT = """
<constraint name="bar" type="{kind}">
<parent link="rod_end"/><parent_origin xyz="{half} 0 0"/><parent_axis xyz="0 1 0"/>
<child link="fore"/><child_origin xyz="{at} {aside} 0"/><child_axis xyz="0 1 0"/>
</constraint>"""
TRANSMISSIONS = "".join(
    f'\n<transmission name="t{name}"><type>x</type><joint name="{name}"/></transmission>'
    for name in ("q1", "q2")
)
ROS2_CONTROL = (
    '\n<ros2_control name="r" type="system">'
    + "".join(
        f'<joint name="{name}">{command}<state_interface name="position"/></joint>'
        for name, command in (
            ("q1", '<command_interface name="effort"/>'),
            ("q2", '<command_interface name="effort"/>'),
            ("q3", ""),
            ("q4", ""),
        )
    )
    + "</ros2_control>"
)


def constraint(kind: str = "spherical", at: float = BEARING, aside: float = 0.0) -> str:
    """The loop as <constraint>; ``at``, ``aside`` [m]: of its end on the forearm."""
    return CONSTRAINT.format(kind=kind, half=HALF_ROD, at=at, aside=aside)


def urdf_of_four_bar(inside: str, zero: Mapping[str, float], more: str = "") -> str:
    """The rigid arm as URDF with other elements ``inside``.

    ``zero``: angles [rad] of the model file at which the joints of the URDF file are at zero;
    ``more``: elements of the passive joints.
    """
    out = ['<robot name="four_bar">', '<link name="base"/>']
    for name, (_, _, _, mass, com, (xx, yy, zz)) in LINKS.items():
        body = (
            f'<inertial><origin xyz="{com} 0 0"/><mass value="{mass}"/><inertia ixx="{xx}" '
            f'iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        out.append(f'<link name="{name}">{body if mass else ""}</link>')
    for name, (parent, (x, y, z), joint, *_) in LINKS.items():
        kind = "continuous" if joint else "fixed"
        turn = -zero.get(joint, 0.0)
        out.append(
            f'<joint name="{joint or "bolt"}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{x} {y} {z}" rpy="0 {turn!r} 0"/>'
            f'<axis xyz="0 -1 0"/>{more if joint in ("q3", "q4") else ""}</joint>'
        )
    return "\n".join([*out, inside, "</robot>"])


def rigid_four_bar() -> str:
    """The model file of the arm without elasticity, payload and rotors."""
    head, *parts = FOUR_BAR.split("[[element]]")
    text = "[[element]]".join([head, *parts])
    text = text[: text.index("[tool]")]
    for stiffness, damping in (("4e5", "300.0"), ("3e5", "200.0")):
        text = text.replace(
            'gear.type = "elastic"\ngear.side = "arm"\n'
            f'gear.spring = {{ type = "linear", stiffness = {stiffness} }}\n'
            f"gear.damping = {damping}\n",
            'gear.type = "rigid"\n',
        )
    stretch = text[text.index('[[element.dof]]\nname = "s"') : text.index("[[loop]]")]
    text = text.replace(stretch, "")
    for inertia, ratio in (("0.004", "120.0"), ("0.003", "110.0")):
        text = text.replace(f"inertia = {inertia}", "inertia = 0.0")
        text = text.replace(f"ratio = {ratio}", "ratio = 1.0")
    return text + '[output]\ntype = "joint"\njoints = ["q1", "q2"]\n'


def hinge_in_base(zero: Mapping[str, float]) -> np.ndarray:
    """Position (3,) of the bearing of rod and forearm in the base at the angles ``zero``."""
    out = np.array([0.0, 0.0, SHOULDER])
    angle = 0.0
    for joint, length in (("q1", LOWER), ("q3", BEARING)):
        angle += zero[joint]
        out += length * np.array([math.cos(angle), 0.0, math.sin(angle)])
    return out
