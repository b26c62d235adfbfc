"""Robots with closed loops for tests: a four-bar arm, and drawn planar and spatial ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import flexgen
from flexgen.model.format.closure import home_closure

# An arm whose forearm is moved by a crank on the base and a rod whose length is elastic.
FOUR_BAR = """
name = "four_bar"
gravity = [0.0, 0.0, -9.81]
home_deg = [60.0, -40.0]

[[element]]
name = "lower"
origin = { position = [0, 0, 0.5] }
body = { mass = 30.0, com = [0.3, 0, 0], inertia = [0.2, 2.0, 2.0] }
[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, -1, 0]
gear.type = "elastic"
gear.side = "arm"
gear.spring = { type = "linear", stiffness = 4e5 }
gear.damping = 300.0

[[element]]
name = "fore"
origin = { position = [0.7, 0, 0] }
body = { mass = 20.0, com = [0.25, 0, 0], inertia = [0.1, 1.0, 1.0] }
[[element.dof]]
name = "q3"
type = "rotation"
axis = [0, -1, 0]
passive = { near_deg = -100.0 }

[[element]]
name = "crank"
parent = "base"
origin = { position = [0, 0, 0.5] }
body = { mass = 8.0, com = [-0.1, 0, 0], inertia = [0.02, 0.05, 0.05] }
[[element.dof]]
name = "q2"
type = "rotation"
axis = [0, -1, 0]
gear.type = "elastic"
gear.side = "arm"
gear.spring = { type = "linear", stiffness = 3e5 }
gear.damping = 200.0

[[element]]
name = "rod"
origin = { position = [-0.2, 0, 0] }
[[element.dof]]
name = "q4"
type = "rotation"
axis = [0, -1, 0]
passive = { near_deg = 100.0 }

[[element]]
name = "rod_end"
origin = { position = [0.35, 0, 0] }
body = { mass = 5.0, inertia = [0.01, 0.3, 0.3] }
[[element.dof]]
name = "s"
type = "translation"
axis = [1, 0, 0]
spring = { type = "linear", stiffness = 2e7 }
damping = 4000.0

[[loop]]
name = "bar"
from = { element = "rod_end", position = [0.35, 0, 0] }
to = { element = "fore", position = [-0.18, 0, 0] }

[[motor]]
name = "m1"
inertia = 0.004
drives = "q1"
ratio = 120.0

[[motor]]
name = "m2"
inertia = 0.003
drives = "q2"
ratio = 110.0

[tool]
position = [0.8, 0, 0]
element = "fore"

[payload]
mass = 25.0
com = [0.8, 0, 0]

[output]
type = "tool_position"
axes = "xz"

[[move]]
name = "line"
type = "tool_line"
start_deg = [60.0, -40.0]
displacement = [0.15, 0.0, 0.2]
duration = 0.5
smoothness = 5
"""

LINE = """
[[line]]
name = "bar"
type = "rod"
from = { element = "crank", position = [-0.2, 0, 0] }
to = { element = "fore", position = [-0.18, 0, 0] }
stiffness = 2e7
damping = 4000.0
length = 0.5237
"""


def driven_by_a_line() -> str:
    """The four-bar arm whose rod is a line, and its forearm a joint without motor."""
    rod = FOUR_BAR.index('[[element]]\nname = "rod"')
    after = FOUR_BAR.index("[[motor]]")
    free = 'spring = { type = "linear", stiffness = 0.0 }'
    return (FOUR_BAR[:rod] + LINE + FOUR_BAR[after:]).replace(
        "passive = { near_deg = -100.0 }", free
    )


def driven_by_a_line_in_a_loop() -> str:
    """The four-bar arm whose rod is a passive stretch, which a line holds."""
    spring = 'spring = { type = "linear", stiffness = 2e7 }\ndamping = 4000.0'
    text = FOUR_BAR.replace(spring, "passive = { near = -0.176 }", 1)
    free = 'spring = { type = "linear", stiffness = 0.0 }'
    text = text.replace("passive = { near_deg = -100.0 }", free, 1)
    return text.replace("[[motor]]", LINE + "\n[[motor]]", 1)


def read_text(folder: Path, text: str) -> flexgen.RobotModel:
    """The robot of a text."""
    file = folder / "robot.toml"
    file.write_text(text, encoding="utf-8")
    return flexgen.read(file)


def home_of(model: flexgen.RobotModel) -> np.ndarray:
    """Coordinates at home, springs at rest (n_a,)."""
    home = home_closure(model)
    return np.array([home[c.name] for c in model.coordinates])


def drawn_text(rng: np.random.Generator, spatial: bool) -> str:
    """A drawn robot: a crank, a coupler and a rocker on a turning table with an elastic bearing,
    the crank with an elastic length.

    Planar: all hinges are parallel, in a drawn plane; the coupler has a passive hinge at the crank
    and closes on the rocker. Spatial: the hinges of crank and rocker have drawn axes, the coupler
    has a universal joint at the crank and a spherical bearing at the rocker.
    """
    plane = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    plane *= np.linalg.det(plane)
    n = [plane[:, 2] + (0.3 * rng.standard_normal(3) if spatial else 0.0) for _ in range(2)]
    crank, rocker = rng.uniform(-0.05, 0.05, 2) + np.array([0.25, 0.45])
    at_rocker = 0.6 + rng.uniform(-0.05, 0.05)

    def vector(x: np.ndarray) -> str:
        return f"[{', '.join(repr(float(y)) for y in x)}]"

    def body() -> str:
        tensor = 0.1 + rng.uniform(0.0, 0.05, 3)
        com = vector(rng.uniform(-0.1, 0.1, 3))
        return f"body = {{ mass = {rng.uniform(2, 9)}, com = {com}, inertia = {vector(tensor)} }}"

    def dof(name: str, axis: np.ndarray, rest: str, kind: str = "rotation") -> str:
        return (
            f'[[element.dof]]\nname = "{name}"\ntype = "{kind}"\naxis = {vector(axis)}\n{rest}\n'
        )

    def element(name: str, parent: str, at: np.ndarray) -> str:
        return (
            f'[[element]]\nname = "{name}"\nparent = "{parent}"\n'
            f"origin = {{ position = {vector(at)} }}\n{body()}\n"
        )

    gear = (
        'gear = { type = "elastic", side = "arm", damping = 50.0, '
        'spring = { type = "linear", stiffness = 1e5 } }'
    )
    spring = 'spring = { type = "linear", stiffness = 3e5 }\ndamping = 80.0'
    x, y, z = plane.T
    up = np.cos(1.2) * x + np.sin(1.2) * y
    tip = crank * up
    far = at_rocker * x + rocker * (np.cos(1.4) * x + np.sin(1.4) * y)
    way = far - tip
    parts = [
        'name = "drawn"\ngravity = [0.3, 0.5, -9.8]\nhome_rad = [0.2, 0.0]\n',
        element("table", "base", 0.1 * rng.standard_normal(3)),
        dof("t", rng.standard_normal(3), gear),
        dof("bearing", rng.standard_normal(3), spring),
        element("crank", "table", 0.1 * z),
        dof("a", n[0], gear),
        dof("stretch", up, spring, "translation"),
        element("coupler", "crank", tip),
        dof("b", z, "passive = { near_rad = 0.0 }"),
    ]
    if spatial:
        parts.append(dof("c", np.cross(z, way), "passive = { near_rad = 0.0 }"))
    parts += [
        element("rocker", "table", at_rocker * x + 0.1 * z),
        dof("d", n[1], "passive = { near_rad = 0.0 }"),
        '[[loop]]\nname = "ring"\n',
        f'from = {{ element = "coupler", position = {vector(way)} }}\n',
        f'to = {{ element = "rocker", position = {vector(far - at_rocker * x)} }}\n',
        '[[motor]]\nname = "m1"\ninertia = 0.002\ndrives = "t"\nratio = 90.0\n',
        '[[motor]]\nname = "m2"\ninertia = 0.003\ndrives = "a"\nratio = 70.0\n',
        f'[tool]\nposition = {vector(0.5 * up)}\nelement = "rocker"\n',
        "[payload]\nmass = 5.0\ncom = [0.1, 0.2, 0.1]\n",
        '[output]\ntype = "joint"\njoints = ["t", "a"]\n',
    ]
    return "\n".join(parts)
