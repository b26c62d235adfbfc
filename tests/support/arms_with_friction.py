"""Six-axis arms with steep friction in their motors, of the template and of tables.

The tables are those of Denavit and Hartenberg. `arm` draws one of them, `moves_of` ten moves of
it: polylines, circles, lines and joint moves, all with motors that reverse. The numbers are those
of no particular robot: masses, stiffnesses and rotors are scaled with the arm's size.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

import flexgen
from flexgen.base.errors import FlexgenError
from flexgen.model.elements import RobotModel
from flexgen.model.friction import Friction
from flexgen.model.moves import Move, MoveL
from flexgen.paths.path import Path, joints_along
from flexgen.studies.templates.new_model import new_model

ARMS = 30
MOVES = 10
STEEPNESS = (1.0, 50.0)  # s/rad: of the frictions, drawn evenly by their logarithm
FASTEST = 2.0  # rad/s: of a joint; faster ones pass close to singular poses
SHARPEST = 25.0  # m/s^2: of the tool; a narrow corner at speed needs a thousand times the motors
TRIES = 400  # moves that are drawn, at most
SHARE = (0.02, 0.1)  # of the largest motor torque: Coulomb friction

# a [m], alpha [deg], d [m] of each joint: an arm of 40 kg, and one of 7 kg with an offset wrist
TABLES = (
    (
        (0.175, -90, 0.495),
        (1.095, 0, 0.0),
        (0.175, -90, 0.0),
        (0.0, 90, 1.27),
        (0.0, -90, 0.0),
        (0.0, 0, 0.135),
    ),
    (
        (0.05, -90, 0.33),
        (0.44, 0, 0.0),
        (0.035, -90, 0.0),
        (0.0, 90, 0.42),
        (0.0, -90, 0.0),
        (0.0, 0, 0.08),
    ),
)
ZEROS = (
    0,
    -90,
    0,
    0,
    0,
    180,
)  # deg: joint angles of the tables at which the robots' angles are zero
PAYLOADS = (40.0, 7.0)  # kg
# of the first one: masses [kg], stiffnesses [N m/rad], ratios, rotors [kg m^2], torques [N m]
MASSES = (150, 75, 70, 35, 12, 2)
STIFFNESSES = (3.4e6, 3.4e6, 1.35e6, 2.75e5, 2.4e5, 1.7e5)
RATIOS = (120, 155, 150, 110, 110, 80)
ROTORS = (7.5e-3, 7.5e-3, 3e-3, 6e-4, 6e-4, 4e-4)
TORQUES = (28, 28, 16, 5, 5, 4)


def arm(number: int, folder: str) -> RobotModel:
    """The arm of a number from 0 to `ARMS` - 1: even ones of the template, odd ones of tables."""
    rng = np.random.default_rng(number)
    text = new_model(f"arm_{number}", "six-axis") if number % 2 == 0 else _of_table(number, rng)
    file = f"{folder}/arm_{number}.toml"
    with open(file, "w", encoding="utf-8") as out:
        out.write(text)
    model = flexgen.read(file)
    motors = []
    for motor in model.motors:
        beta = float(np.exp(rng.uniform(*np.log(STEEPNESS))))
        coulomb = float(rng.uniform(*SHARE)) * motor.torque_max
        friction = Friction(viscous=motor.friction.viscous, coulomb=coulomb, beta=beta)
        motors.append(
            replace(
                motor,
                friction=friction,
                inertia=motor.inertia * float(rng.uniform(0.7, 1.5)),
                ratio=tuple(float(x * rng.uniform(0.8, 1.2)) for x in motor.ratio),
            )
        )
    return replace(model, motors=tuple(motors))


def _of_table(number: int, rng: np.random.Generator) -> str:
    """The model file of an arm from a table, its size drawn."""
    kind = (number // 2) % 2
    size = float(rng.uniform(0.8, 1.2)) * (1.0, 0.35)[kind]
    lengths = float(rng.uniform(0.85, 1.15))
    lines = [
        f'name = "arm_{number}"',
        'description = "drawn arm"',
        "gravity = [0, 0, -9.81]",
        "home_deg = [0, 20, 10, 0, 50, 0]",
    ]
    for k, (a, alpha, d) in enumerate(TABLES[kind]):
        mass = MASSES[k] * size**2
        radius = 0.2 * size
        com = [-0.5 * a * lengths, 0.0, 0.1 * d]
        moment = mass * (radius**2 + (0.3 * (a + d)) ** 2) / 2
        K = STIFFNESSES[k] * size**2
        lines += [
            "[[element]]",
            f'name = "body{k + 1}"',
            f"origin = {{ rpy_deg = [0, 0, {ZEROS[k]}] }}",
            (
                f"link = {{ position = [{a * lengths}, 0, {d * lengths}], rpy_deg = [{alpha}, "
                "0, 0] }"
            ),
            f"body = {{ mass = {mass}, com = {com}, inertia = {[0.7 * moment, moment, moment]} }}",
            "[[element.dof]]",
            f'name = "q{k + 1}"',
            'type = "rotation"',
            "axis = [0, 0, 1]",
            'gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = '
            f"{K} }}, damping = {5e-4 * K} }}",
        ]
    for k in range(6):
        lines += [
            "[[motor]]",
            f'name = "m{k + 1}"',
            f'drives = "q{k + 1}"',
            f"ratio = {RATIOS[k]}",
            f"inertia = {ROTORS[k] * size**2}",
            "friction = { viscous = 1e-3 }",
            f"torque_max = {TORQUES[k] * size**2}",
        ]
    inertia = [0.01 * PAYLOADS[kind]] * 3
    return "\n".join(
        [
            *lines,
            "[tool]",
            "position = [0, 0, 0.1]",
            "[payload]",
            f"mass = {PAYLOADS[kind]}",
            "com = [0, 0, 0.08]",
            f"inertia = {inertia}",
            "[output]",
            'type = "tool_pose"',
            "",
        ]
    )


def moves_of(equations: flexgen.Equations, number: int) -> list[Move]:
    """Ten moves of an arm that it can follow, each slow enough for its motors."""
    rng = np.random.default_rng(1000 + number)
    out = list[Move]()
    for _ in range(TRIES):
        if len(out) == MOVES:
            return out
        move = _draw(
            equations.model, rng, ("seam", "circle", "back", "joints", "line")[len(out) % 5]
        )
        move = replace(move, name=f"{move.name}{len(out)}")
        try:
            path = Path(equations, move)
            found = list(joints_along(path, speeds=True))
        except FlexgenError:
            continue
        speed = max(float(np.abs(v).max()) for _, v in found)
        along = path.sample_orders(np.linspace(0.0, path.duration, 2001), 3)
        acceleration = float(np.abs(along.derivative(2)[:, :3]).max())
        if speed < FASTEST and acceleration < SHARPEST:
            out.append(move)
    raise AssertionError(f"arm {number}: no ten moves that it can follow")


def _draw(model: RobotModel, rng: np.random.Generator, kind: str) -> Move:
    """A move near home; lengths follow the reach of the arm."""
    start = np.asarray(model.home) + rng.uniform(-0.25, 0.25, 6)
    reach = float(sum(abs(x) for e in model.elements for x in e.link.position)) or 1.0
    size = 0.08 * min(reach, 2.5)
    duration = float(rng.uniform(1.0, 3.0))
    common: dict[str, Any] = {"start": tuple(start), "duration": duration, "smoothness": 5}
    steps = rng.uniform(-1.0, 1.0, (3, 3)) * size
    turns = rng.uniform(-0.2, 0.2, (3, 3))
    if kind == "joints":
        end = start + rng.uniform(-0.4, 0.4, 6)
        return Move(kind, "joint", end=tuple(end), **common)
    if kind == "line":
        line = {"displacement": tuple(3 * steps[0]), "rotation": tuple(turns[0])}
        return Move(kind, "tool_line", **line, **common)
    if kind == "circle":
        normal = np.cross(steps[0], steps[1])
        arc = {"center": tuple(steps[0]), "axis": tuple(normal), "rotation": tuple(turns[0])}
        return Move(kind, "tool_circle", angle=float(rng.uniform(2.0, 6.0)), **arc, **common)
    if kind == "back":
        # there, aside, and back in the opposite direction
        steps[2] = -steps[0]
        turns[2] = -turns[0]
    zones = [0.3 * min(np.linalg.norm(x), np.linalg.norm(y)) for x, y in pairwise(steps)]
    legs = tuple(
        MoveL(tuple(step), rotation=tuple(turn), zone=float(zone))
        for step, turn, zone in zip(steps, turns, [*zones, 0.0], strict=True)
    )
    return Move(kind, "tool_polyline", legs=legs, **common)
