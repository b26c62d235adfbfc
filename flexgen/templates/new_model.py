"""New model files with plausible numbers: from a template, or as an overlay on a URDF file."""

from __future__ import annotations

import json
import math
import os
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.model.elements import Coordinate, RobotModel
from flexgen.model.inertia import mass_matrix
from flexgen.model.reader import read
from flexgen.model.urdf import Urdf, among
from flexgen.model.urdf_chain import MOVING
from flexgen.model.urdf_source import PACKAGE, locate
from flexgen.spec.ports import c_name_problem
from flexgen.spec.tables import bare
from flexgen.templates.template_names import TEMPLATES

# Hz with locked motors and damping ratio of the gears of an overlay
FREQUENCY, DAMPING = 20.0, 0.03
RATIO, RATIO_TRANSLATION = 100.0, 500.0  # rad/rad, rad/m
STEP = 0.3  # rad or m, of the move of an overlay


def new_model(
    name: str, template: str = "planar", urdf: str | None = None, folder: str | Path = "."
) -> str:
    """The text of a new model file.

    Parameters
    ----------
    name : str
        Of the robot.
    template : str
        One of `TEMPLATES`.
    urdf : str, optional
        Instead of a template: ``FILE.urdf#BASE:TIP``; without ``#BASE:TIP`` from the root to the link behind the most
        moving joints.
    folder : path
        Where the file will be, for the path to the URDF file.

    Returns
    -------
    str
        Comments state the unit of each number.

    Raises
    ------
    ArgumentError, ModelError
        The name is not an identifier; there is no such template; the URDF file has an error.
    """
    problem = c_name_problem(name)
    if problem is not None:
        raise ArgumentError(f"name: given {name!r}, expected {problem}")
    if urdf is not None:
        return _overlay(name, urdf, Path(folder))
    if template not in TEMPLATES:
        raise ArgumentError(f"template: given {template!r}, expected one of {', '.join(TEMPLATES)}")
    text = (files("flexgen.templates") / f"{template}.toml").read_text(encoding="utf-8")
    return f'name = "{name}"\n' + text.partition("\n")[2]


def _overlay(name: str, given: str, folder: Path) -> str:
    """A model file for a URDF file, with elastic gears in all joints."""
    file, _, ends = given.partition("#")
    path = locate(file, Path())
    if path is None:
        raise ArgumentError(
            f"urdf: given {file!r}, which is not a file, expected FILE.urdf or FILE.urdf#BASE:TIP"
        )
    urdf = Urdf(path, file)
    base, _, tip = ends.partition(":") if ends else _longest(urdf)
    for what, link in (("BASE", base), ("TIP", tip)):
        if link not in urdf.links:
            raise ArgumentError(
                f"urdf: given {link!r} as {what}, expected a link of {file}: {among(link, urdf.links)}"
            )
    chain = _above(urdf, tip)
    lock = [
        joint.name
        for joint in urdf.joints.values()
        if joint.type in MOVING and joint.name not in chain
    ]
    table = [
        f'base = "{base}"',
        f'tip = "{tip}"',
        *([f"lock = {json.dumps(lock)}  # at zero"] if lock else []),
    ]
    with TemporaryDirectory() as place:  # the rigid robot
        rigid = Path(place) / "rigid.toml"
        rigid.write_text(
            "\n".join(
                [f'name = "{name}"', "[urdf]", f"file = {json.dumps(str(path.resolve()))}", *table]
            )
        )
        robot = read(rigid)
    home = np.array(robot.home)
    inertia = np.diag(mass_matrix(robot, home))
    shown = file if file.startswith(PACKAGE) else Path(os.path.relpath(path, folder)).as_posix()
    angles = ", ".join(f"{value:.6g}" for value in home)
    lines = [
        f'name = "{name}"',
        f'description = "from {base} to {tip} of {path.name}, with elastic gears"',
        f'source = "bodies: {path.name}; ASSUMED by flexgen: gears, motors, damping"',
        f"home_rad = [{angles}]  # rad, of translations m",
        "",
        "[urdf]",
        f"file = {json.dumps(shown)}",
        *table,
        "",
        "# All numbers below are assumed: replace them by those of your robot. Defaults for all joints:",
        '[joint."*"]',
        'gear = { type = "elastic", side = "arm", spring = { type = "linear" } }',
        f"motor = {{ ratio = {RATIO:g} }}  # motor angle / joint angle",
        "",
        f"# Gears: {FREQUENCY:g} Hz with locked motors at home, damping ratio {DAMPING:g}. Stiffness in N m/rad (N/m),",
        "# damping in N m s/rad (N s/m) on the arm side. Rotor inertia in kg m^2: times ratio^2 it is that of the arm.",
    ]
    for coordinate, size in zip(robot.coordinates, inertia, strict=True):
        lines += _joint(coordinate, float(size))
    return "\n".join([*lines, *_move(robot)])


def _joint(coordinate: Coordinate, inertia: float) -> list[str]:
    """The table of one joint; a joint without inertia has a rigid gear."""
    table = f"[joint.{bare(coordinate.name)}]"
    ratio = RATIO if coordinate.unit == "rad" else RATIO_TRANSLATION
    if inertia < 1e-9:
        return [table, 'gear = { type = "rigid" }  # no inertia at home', ""]
    K = inertia * (2.0 * math.pi * FREQUENCY) ** 2
    D = 2.0 * DAMPING * math.sqrt(K * inertia)
    own = "" if coordinate.unit == "rad" else f"ratio = {ratio:g}, "
    unit = "" if coordinate.unit == "rad" else "  # ratio of a translation in rad/m"
    return [
        table,
        f"gear = {{ spring = {{ stiffness = {K:.2g} }}, damping = {D:.2g} }}",
        f"motor = {{ {own}inertia = {inertia / ratio**2:.2g} }}{unit}",
        "",
    ]


def _move(robot: RobotModel) -> list[str]:
    """A move of all joints from home, towards the middle of their ranges."""
    end = []
    for value, coordinate in zip(robot.home, robot.coordinates, strict=True):
        dof = coordinate.dof
        low, high = (None, None) if dof is None else (dof.lower, dof.upper)
        step = STEP if coordinate.unit == "rad" else STEP / 3.0
        if low is not None and high is not None:
            step = min(step, 0.25 * (high - low)) * (1.0 if value <= (low + high) / 2.0 else -1.0)
        end.append(f"{value + step:.6g}")
    start = ", ".join(f"{value:.6g}" for value in robot.home)
    return [
        "[[move]]",
        'name = "joints"',
        'type = "joint"',
        f"start_rad = [{start}]",
        f"end_rad = [{', '.join(end)}]",
        "duration = 1.0  # s",
        "smoothness = 5  # continuous derivatives of the path",
        "",
    ]


def _above(urdf: Urdf, link: str) -> list[str]:
    """The moving joints between the root and a link."""
    out = []
    while (joint := urdf.parent_joint.get(link)) is not None:
        out += [joint.name] * (joint.type in MOVING)
        link = joint.parent
    return out


def _longest(urdf: Urdf) -> tuple[str, str, str]:
    """The root link of a URDF file, and the link behind the most moving joints."""
    root = next(name for name in urdf.links if name not in urdf.parent_joint)
    inner = {joint.parent for joint in urdf.joints.values()}
    return (
        root,
        "",
        max(
            (name for name in urdf.links if name not in inner),
            key=lambda name: len(_above(urdf, name)),
        ),
    )
