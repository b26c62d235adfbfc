"""The overlay of a URDF file with all repairs that it needs, and assumed gears and motors."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.files.atomic_files import temporary_folder
from flexgen.base.spec.tables import show
from flexgen.base.spec.toml_text import toml, toml_key
from flexgen.model.elements import Coordinate, Dof, RobotModel
from flexgen.model.format.closure import closed_values
from flexgen.model.inertia import mass_matrix, massless_coordinates
from flexgen.model.reader import read
from flexgen.model.urdf.urdf import Urdf, among
from flexgen.model.urdf.urdf_chain import MOVING
from flexgen.model.urdf.urdf_loops import find_closures
from flexgen.model.urdf.urdf_mimic import Motions
from flexgen.model.urdf.urdf_source import PACKAGE, locate, split_ends
from flexgen.studies.templates.payload_beam import Beam, text_of_payload
from flexgen.studies.templates.urdf_repairs import (
    Repairs,
    find_repairs,
    path_between,
    refuse_problems,
)

# Hz with locked motors, of the gears of an overlay
FREQUENCY = 20.0
# damping ratio of the gears of an overlay
DAMPING = 0.03
# Hz and ratio, largest of a gear at home and in the move of an overlay: its numbers do not depend
# on the pose, so that both rise where the inertia is small. Gears of robots are below 300 Hz and
# 0.4.
MOST_FREQUENCY = 280.0
MOST_DAMPING = 0.35
LEAST_FREQUENCY = 3.2  # Hz, at the largest inertia: softer gears are not known of robots
# inertia of the rotor at the joint to that of the arm, largest at home and in the move
MOST_ROTOR = 400.0
# kg m^2, of the smallest servo motors: 1 g cm^2
LEAST_ROTOR = 1e-7
RATIO = 100.0  # rad/rad
RATIO_TRANSLATION = 500.0  # rad/m
# kg m^2, of a rotor whose joint has no inertia of its own: a small servo motor
ROTOR = 1e-5
STEP = 0.3  # rad or m, of the move of an overlay
# of the largest speed of a joint in this move to its mean: 2.71 with five continuous derivatives,
# and a fifth more for the elasticity
PEAK = 3.25
HALVINGS = 6  # of the move of an overlay, until its closed loops can be closed
POSES = 48  # drawn, at which the largest inertia of a joint is searched
# rad and m around home: the part of a larger range, or of one without limits, in which poses are
# drawn
REACH = math.pi
REACH_TRANSLATION = 0.5
RIGID = 'gear = { type = "rigid" }'
NO_INERTIA = 1e-9  # kg m^2 or kg: below, a gear would be too soft to be a number
WIDTH = 100  # characters of a line with a list
FILL_IN = "fill in: kg, m, kg m^2 about the center of mass: xx, yy, zz, xy, yz, xz"


@dataclass(frozen=True)
class Inertias:
    """Inertia of a joint with all others locked [kg m^2 or kg].

    ``largest`` over drawn poses, ``smallest`` at home and in the move of the overlay.
    """

    largest: float
    smallest: float

    @property
    def rise(self) -> float:
        """Relative increase of the natural frequency from the largest to the smallest inertia."""
        return math.sqrt(self.largest / max(self.smallest, NO_INERTIA))


@dataclass(frozen=True)
class Overlay:
    """A new overlay: its text, a line for each repair, and links whose bodies are missing."""

    text: str
    repairs: tuple[str, ...] = ()
    unfinished: tuple[str, ...] = ()


def overlay_of_urdf(name: str, given: str, folder: Path, payload: Beam | None = None) -> Overlay:
    """A model file for a URDF file, with elastic gears in all joints, or with an elastic payload.

    Parameters
    ----------
    name : str
        Of the robot, an identifier.
    given : str
        ``FILE.urdf#BASE:TIP``; without ``#BASE:TIP`` from the root to the link behind the most
        coordinates.
    folder : path
        Where the file will be, for the path to the URDF file.
    payload : Beam, optional
        On the tip. Then the robot takes positions: its gears are rigid.

    Raises
    ------
    ArgumentError, ModelError
        There is no such file or link; the URDF file has an error that no overlay repairs.
    """
    file, _, ends = given.partition("#")
    path = locate(file, Path())
    if path is None:
        raise ArgumentError(
            f"urdf: given {file!r}, which is not a file, expected FILE.urdf or FILE.urdf#BASE:TIP"
        )
    urdf = Urdf(path, file)
    base, tip = split_ends(ends, urdf.links) if ends else longest_chain(urdf)
    for what, link in (("BASE", base), ("TIP", tip)):
        if link not in urdf.links:
            raise ArgumentError(
                f"urdf: given {link!r} as {what}, expected a link of {file}: "
                f"{among(link, urdf.links)}"
            )
    repairs = find_repairs(urdf, base, tip, find_closures(urdf, path))
    robot = _rigid_robot(urdf, path, repairs)
    loose = _find_massless(urdf, robot, repairs)
    shown = file if file.startswith(PACKAGE) else Path(os.path.relpath(path, folder)).as_posix()
    elasticity = "elastic gears" if payload is None else "an elastic payload"
    lines = [*_head(name, path.name, shown, robot, repairs, elasticity)]
    is_rigid = bool(repairs.unfinished) or payload is not None
    inertia = {} if is_rigid else _inertias(robot)
    lines += _defaults(bool(repairs.unfinished)) if payload is None else _followed_positions()
    joints = _joints(robot, repairs, inertia, loose)
    lines += joints if payload is None else _without_gears(joints)
    for link in repairs.unfinished:
        body = {"mass": 0.0, "com": [0.0] * 3, "inertia": [0.0] * 6}
        repairs.link(link, body=body)
    for link, table in repairs.links.items():
        lines += [f"[link.{toml_key(link)}]"]
        lines += [
            f"{key} = {toml(value)}" + f"  # {FILL_IN}" * (key == "body" and not value["mass"])
            for key, value in _sort_keys(table)
        ]
        lines += [""]
    lines += [] if payload is None else text_of_payload(payload)
    text = "\n".join([*lines, *_move(robot)])
    return Overlay(text, tuple(repairs.notes), tuple(repairs.unfinished))


# --- the chain -----------------------------------------------------------------------------------


def longest_chain(urdf: Urdf) -> tuple[str, str]:
    """The ends of the chain with the most coordinates that move a mass.

    From the root of a URDF file, or the link behind the last joint that is free, to the end of a
    branch; to the link
    before the first joint that moves no mass, unless nothing in the file has one.
    """
    root = next(name for name in urdf.links if name not in urdf.parent_joint)
    inner = {joint.parent for joint in urdf.joints.values()}
    heavy = _links_with_mass(urdf) or set(urdf.links)
    best = (root, root, (-1, -1))
    for link in (name for name in urdf.links if name not in inner):
        path = path_between(urdf, root, link)
        free = [k for k, joint in enumerate(path) if joint.movable and joint.type not in MOVING]
        base = path[free[-1]].child if free else root
        path = path[free[-1] + 1 :] if free else path
        joints = [joint for joint in path if joint.type in MOVING and joint.child in heavy]
        light = [joint for joint in path if joint.type in MOVING and joint.child not in heavy]
        names = {joint.name for joint in joints}
        followers = [joint for joint in joints if _leaders(urdf, joint.name) - {joint.name}]
        loose = [joint for joint in followers if not _leaders(urdf, joint.name) <= names]
        size = (len(joints) - len(followers), len(joints) - len(loose))
        if size > best[2]:
            best = (base, light[0].parent if light else link, size)
    return best[0], best[1]


def _links_with_mass(urdf: Urdf) -> set[str]:
    """The links that have a mass, or one behind them."""
    out: set[str] = set()
    for name, link in urdf.links.items():
        try:
            stated = urdf.stated_inertial(link)
        except ModelError:
            continue
        here: str | None = name if stated is not None and stated.mass > 0.0 else None
        while here is not None and here not in out:
            out.add(here)
            holder = urdf.parent_joint.get(here)
            here = None if holder is None else holder.parent
    return out


def _leaders(urdf: Urdf, name: str) -> set[str]:
    """The first joint of a chain of <mimic>; the joint itself where the chain is broken."""
    try:
        return set(Motions(urdf, {})(urdf.joints[name]).joints)
    except ModelError:
        return {name}


def _rigid_robot(urdf: Urdf, path: Path, repairs: Repairs) -> RobotModel:
    """The repaired robot, rigid; with a rotor in each joint its inertia matrix is regular."""
    lines = ['name = "rigid"', "[urdf]", f"file = {toml(str(path.resolve()))}", *_urdf(repairs)]
    lines += ['[joint."*"]', "motor = { ratio = 1, inertia = 1 }"]
    for kind, tables in (("joint", repairs.joints), ("link", repairs.links)):
        for name, table in tables.items():
            lines += [f"[{kind}.{toml_key(name)}]"]
            lines += [f"{key} = {toml(value)}" for key, value in table.items()]
    for link in repairs.unfinished:
        if link not in repairs.links:
            lines += [f"[link.{toml_key(link)}]"]
            lines += ["body = { mass = 0 }"]
    with temporary_folder() as place:
        rigid = place / "rigid.toml"
        rigid.write_text("\n".join(lines), encoding="utf-8")
        try:
            return read(rigid)
        except ModelError as error:
            where = f"line {error.line}, " if error.file == urdf.file and error.line else ""
            repairs.problems.append(
                f"{where}{error.key}: given {error.given}, expected {error.expected}"
            )
            refuse_problems(urdf, repairs)
            raise


def _find_massless(urdf: Urdf, robot: RobotModel, repairs: Repairs) -> set[str]:
    """Name the bodies that are to be filled in, and return coordinates without inertia."""
    bodies = {element.name: element.body.mass > 0.0 for element in robot.elements}
    elements = {dof.name: e.name for e in robot.elements for dof in e.dofs}
    behind = {name: name in bodies and bodies[name] for name in bodies}
    for element in reversed(robot.elements):
        parent = robot.parents[element.name]
        if behind[element.name] and parent in behind:
            behind[parent] = True
    links = {
        elements[name]: urdf.joints[joint.name].child for name, joint in robot.urdf_joints.items()
    }
    still = replace(robot, motors=tuple(replace(motor, inertia=0.0) for motor in robot.motors))
    massless = set(massless_coordinates(still))
    empty = [name for name in links if not behind[name]]
    empty += [elements[name] for name in massless if not bodies[elements[name]]]
    for name in dict.fromkeys(name for name in links if name in empty):
        if links[name] not in repairs.unfinished:
            repairs.unfinished.append(links[name])
            repairs.notes.append(
                f"link {show(links[name])}: a body to be filled in, since nothing behind its "
                "joint has a mass"
                if not behind[name]
                else f"link {show(links[name])}: a body to be filled in, since its joint moves "
                "nothing "
                "of its own"
            )
    if empty:
        return set()
    for name in sorted(massless):
        repairs.notes.append(
            f"joint {show(robot.urdf_joints[name].name)}: a rotor of {ROTOR:g} kg m^2 and a rigid "
            "gear, since the "
            "bodies have no inertia about it"
        )
    return massless


def _inertias(robot: RobotModel) -> dict[str, Inertias]:
    """The inertias of each joint, by the names of their coordinates."""
    still = replace(robot, motors=tuple(replace(motor, inertia=0.0) for motor in robot.motors))
    rng = np.random.default_rng(1)
    home = np.array(robot.home)
    ranges = np.array(
        [
            _range(coordinate, float(value))
            for coordinate, value in zip(robot.coordinates, home, strict=True)
        ]
    )
    largest = np.diag(mass_matrix(still, home))
    for _ in range(POSES):
        pose = rng.uniform(ranges[:, 0], ranges[:, 1])
        if not _can_be_closed(robot, pose):
            continue
        largest = np.maximum(largest, np.diag(mass_matrix(still, pose)))
    end = np.array(_end_of_move(robot))
    of_move = [np.diag(mass_matrix(still, home + part * (end - home))) for part in (0.0, 0.5, 1.0)]
    smallest = np.min(of_move, axis=0)
    return {
        coordinate.name: Inertias(float(high), float(low))
        for coordinate, high, low in zip(robot.coordinates, largest, smallest, strict=True)
    }


def _range(coordinate: Coordinate, home: float) -> tuple[float, float]:
    """The range of a coordinate in which poses are drawn."""
    reach = REACH if coordinate.unit == "rad" else REACH_TRANSLATION
    low, high = _ends(coordinate.dof)
    return max(low, home - reach), min(high, home + reach)


def _ends(dof: Dof | None) -> tuple[float, float]:
    """Limits of a degree of freedom, infinite where it has none."""
    low, high = (None, None) if dof is None else (dof.lower, dof.upper)
    return -math.inf if low is None else low, math.inf if high is None else high


# --- the text ------------------------------------------------------------------------------------


def _head(
    name: str, file: str, shown: str, robot: RobotModel, repairs: Repairs, elasticity: str
) -> Sequence[str]:
    """The lines before the joints; ``elasticity``: words for what is elastic."""
    angles = ", ".join(_place(c, x) for c, x in zip(robot.coordinates, robot.home, strict=True))
    plain = "".join(c if c.isprintable() else "?" for c in f"{repairs.base} to {repairs.tip}")
    out = [
        f"name = {toml(name)}",
        f"description = {toml(f'from {plain} of {_printable(file)}, with {elasticity}')}",
        "source = "
        f"{toml(f'bodies: {_printable(file)}; ASSUMED by flexgen: gears, motors, damping')}",
        f"home_rad = [{angles}]  # rad, of translations m",
        "",
        "[urdf]",
        f"file = {toml(shown)}",
        *_urdf(repairs),
    ]
    if repairs.unfinished:
        names = toml(repairs.unfinished)
        out += [
            (
                "# UNFINISHED: fill in the bodies of these links below; until then the file is "
                "refused"
            ),
            f"unfinished = {names}"
            if len(names) < WIDTH
            else _lines("unfinished", repairs.unfinished),
        ]
    if repairs.notes:
        out += ["", "# Repaired by flexgen; the URDF file is unchanged:"]
        out += [f"# - {_printable(note)}" for note in repairs.notes]
    return [*out, ""]


def _urdf(repairs: Repairs) -> Sequence[str]:
    """The keys of [urdf] after its file."""
    out = [f"base = {toml(repairs.base)}", f"tip = {toml(repairs.tip)}"]
    for key, names in (("branches", repairs.branches), ("drop", repairs.drop)):
        if names:
            out.append(_lines(key, names))
    if not any(repairs.lock.values()):
        return [
            *out,
            *([_lines("lock", list(repairs.lock)) + "  # at zero"] if repairs.lock else []),
        ]
    return [
        *out,
        *(f"lock.{toml_key(name)} = {toml(value)}" for name, value in repairs.lock.items()),
    ]


def _lines(key: str, names: Sequence[str]) -> str:
    """A list of names, in several lines if it is long."""
    line = f"{key} = {toml(names)}"
    if len(line) < WIDTH:
        return line
    return "\n".join([f"{key} = [", *(f"    {toml(name)}," for name in names), "]"])


def _printable(text: str) -> str:
    """A text for a comment: one line, with nothing that an editor does not show."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _defaults(unfinished: bool) -> Sequence[str]:
    """The table of all joints."""
    ratio = f"motor = {{ ratio = {RATIO:g} }}  # motor angle / joint angle"
    stiff = 'gear = { type = "elastic", side = "arm", spring = { type = "linear"'
    first = [
        "# All numbers below are assumed: replace them by those of your robot. Defaults for all",
        "# joints:",
        '[joint."*"]',
    ]
    if unfinished:
        return [
            *first,
            'gear = { type = "rigid" }',
            ratio,
            "",
            "# Gears are rigid, since the inertia of the arm is not known before its bodies are",
            "# filled in. An elastic one:",
            f"# {stiff}, stiffness = K }}, damping = D }}",
            "# motor = { inertia = J }",
            "# with K in N m/rad (N/m), D in N m s/rad (N s/m), J in kg m^2 on the motor side.",
            "",
        ]
    return [
        *first,
        f"{stiff} }} }}",
        ratio,
        "",
        f"# Gears: {FREQUENCY:g} Hz with locked motors at the pose with the largest inertia,",
        f"# damping ratio {DAMPING:g}; less where they would be above {MOST_FREQUENCY:g} Hz and "
        f"{MOST_DAMPING:g} at",
        "# home or in the move. Stiffness in N m/rad (N/m), damping in N m s/rad (N s/m) on the",
        "# arm side. Rotor inertia in kg m^2: times ratio^2 it is that of the arm; at least",
        f"# {LEAST_ROTOR:g}.",
    ]


def _followed_positions() -> Sequence[str]:
    """The table of all joints of a robot that follows positions."""
    return [
        "# The robot takes positions and follows them: its gears are rigid.",
        '[joint."*"]',
        'gear = { type = "rigid" }',
        f"motor = {{ ratio = {RATIO:g} }}  # motor angle / joint angle, ASSUMED",
        "",
    ]


def _without_gears(lines: Sequence[str]) -> list[str]:
    """Tables of joints without the gears that the default has, and none without a key."""
    text = "\n".join(line for line in lines if line != RIGID)
    return ["\n".join([part, ""]) for part in text.split("\n\n") if "=" in part]


def _joints(
    robot: RobotModel, repairs: Repairs, inertia: Mapping[str, Inertias], loose: set[str]
) -> list[str]:
    """The tables of the joints, those of mechanisms too where they are repaired."""
    names = {joint.name: name for name, joint in robot.urdf_joints.items()}
    coordinates = {coordinate.name: coordinate for coordinate in robot.coordinates}
    out: list[str] = []
    for joint in robot.urdf_joints.values():
        table = dict(repairs.joints.get(joint.name, {}))
        coordinate = coordinates.get(names[joint.name])
        drive: list[str] = []
        if coordinate is not None:
            ratio = RATIO if coordinate.unit == "rad" else RATIO_TRANSLATION
            effort = repairs.torques.get(joint.name)
            size = inertia.get(coordinate.name)
            drive = _drive(ratio, size, effort, coordinate.name in loose, bool(inertia))
            table.pop("gear", None)
            if coordinate.unit != "rad":
                drive[-1] += "  # ratio of a translation in rad/m"
        if not table and not drive:
            continue
        rows = [f"{key} = {toml(value)}" for key, value in _sort_keys(table)]
        out += [f"[joint.{toml_key(joint.name)}]", *rows, *drive, ""]
    return out


def _sort_keys(table: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """The keys of a table, the new name first."""
    return sorted(table.items(), key=lambda item: item[0] != "rename")


def _drive(
    ratio: float, inertia: Inertias | None, effort: float | None, loose: bool, known: bool
) -> list[str]:
    """The lines of gear and motor of a joint; a joint without inertia has a rigid gear."""
    motor: dict[str, str] = {} if ratio == RATIO else {"ratio": f"{ratio:g}"}
    if effort is not None:
        motor["torque_max"] = toml(effort / ratio)
    if not known or inertia is None:
        gear = RIGID
    elif loose or inertia.largest < NO_INERTIA:
        gear = 'gear = { type = "rigid" }  # no inertia of its own'
        if loose:
            motor["inertia"] = f"{ROTOR:g}"
    else:
        frequency = max(min(FREQUENCY, MOST_FREQUENCY / inertia.rise), LEAST_FREQUENCY)
        damping = min(DAMPING, MOST_DAMPING / inertia.rise)
        K = inertia.largest * (2.0 * math.pi * frequency) ** 2
        D = 2.0 * damping * math.sqrt(K * inertia.largest)
        gear = f"gear = {{ spring = {{ stiffness = {K:.2g} }}, damping = {D:.2g} }}"
        at_joint = min(inertia.largest, MOST_ROTOR * inertia.smallest)
        motor["inertia"] = f"{max(at_joint / ratio**2, LEAST_ROTOR):.2g}"
    rows = ", ".join(f"{key} = {value}" for key, value in motor.items())
    return [gear, *([f"motor = {{ {rows} }}"] if rows else [])]


def _end_of_move(robot: RobotModel) -> list[float]:
    """The end of the move of an overlay: from home towards the middle of the ranges."""
    end = []
    for value, coordinate in zip(robot.home, robot.coordinates, strict=True):
        low, high = _ends(coordinate.dof)
        step = STEP if coordinate.unit == "rad" else STEP / 3.0
        if math.isfinite(low) and math.isfinite(high):
            step = min(step, 0.25 * (high - low)) * (1.0 if value <= (low + high) / 2.0 else -1.0)
        elif value + step > high:
            step = -step
        end.append(value + step)
    # closed loops may not reach it: then a shorter way
    for _ in range(HALVINGS):
        if _can_be_closed(robot, np.array(end)):
            break
        end = [(value + x) / 2.0 for value, x in zip(robot.home, end, strict=True)]
    return end


def _can_be_closed(robot: RobotModel, pose: np.ndarray) -> bool:
    """Whether the closed loops of a rigid robot can be closed at these coordinates."""
    try:
        closed_values(robot, pose)
    except ArgumentError:
        return False
    return True


def _move(robot: RobotModel) -> list[str]:
    """A move of all joints from home, towards the middle of their ranges."""
    end = []
    duration = 1.0
    places = zip(robot.home, _end_of_move(robot), robot.coordinates, strict=True)
    for value, last, coordinate in places:
        end.append(_place(coordinate, last))
        limit = None if coordinate.dof is None else coordinate.dof.speed_max
        if limit is not None:
            duration = max(duration, PEAK * abs(last - value) / limit)
    start = ", ".join(_place(c, x) for c, x in zip(robot.coordinates, robot.home, strict=True))
    return [
        "[[move]]",
        'name = "joints"',
        'type = "joint"',
        f"start_rad = [{start}]",
        f"end_rad = [{', '.join(end)}]",
        f"duration = {math.ceil(10.0 * duration) / 10.0!r}  # s",
        "smoothness = 5  # continuous derivatives of the path",
        "",
    ]


def _place(coordinate: Coordinate, value: float) -> str:
    """A position with six digits, or with all of them where these would be beyond a limit."""
    low, high = _ends(coordinate.dof)
    rounded = float(f"{value:.6g}")
    return toml(rounded if low <= rounded <= high else value)
