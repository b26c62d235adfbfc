"""The robot as a URDF file, the rigid part, and an overlay of flexgen with all that URDF cannot
contain.

An element of the chain is a link. Its frame is at the joints of the element, with the axes of the
body frame: the rotation of the placement ``link`` is moved in front of the joints,

    R(a, q) R_link = R_link R(R_link' a, q),

so that axes of bodies, rotors and sensors keep their directions. One degree of freedom of an
element is a joint of the URDF file (the actuated one, if there is one); the others are additional
degrees of freedom in the overlay and are rigid in the URDF file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.files.atomic_files import follow_links, staging_folder, unwritable, write_text
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.schema import write
from flexgen.base.spec.tables import show
from flexgen.base.spec.toml_text import toml
from flexgen.base.version import __version__
from flexgen.exports.exported import Exported, exported
from flexgen.exports.poses import roll_pitch_yaw, rotation_about
from flexgen.exports.urdf.overlay_tables import (
    beam_or_drag,
    line_table,
    output_table,
    sensor_table,
)
from flexgen.exports.xml_text import add, document
from flexgen.model.elements import Body, Dof, Element, RobotModel, UrdfJoint
from flexgen.model.format.format import MODEL, UNCERTAINTY
from flexgen.model.format.format_devices import MOTOR
from flexgen.model.format.format_robot import BODY, DOF, PLACEMENT
from flexgen.model.moves import Move, Program
from flexgen.model.position_servo.keys import SERVO_TABLE
from flexgen.model.reader import read
from flexgen.model.urdf.urdf_source import source_files

UNLIMITED = 1e6  # URDF demands limits of some joints: in their place where the model has none
ROUNDING = 1e-15  # of a sine or cosine that is zero
# Types of <constraint> by those of closed loops.
_CONSTRAINTS = {"point": "spherical", "axis": "revolute", "pose": "fixed"}
_WRITTEN_BY = ", written by flexgen "  # in the first line of an overlay


@dataclass(frozen=True)
class Step:
    """A link of the URDF file and the joint in front of it.

    ``dof``: the joint (its axis in the axes of the link), None for a fixed one; ``before``,
    ``after``: degrees of freedom that are in the overlay only; ``position``, ``rotation``: pose of
    the joint in the link before; ``body``: in the frame of the link. ``mimic``: of a joint that
    follows another one.
    """

    link: str
    joint: str
    dof: Dof | None
    before: tuple[Dof, ...]
    after: tuple[Dof, ...]
    position: np.ndarray
    rotation: np.ndarray
    body: Body
    parent: str  # the link before; empty: the ground
    mimic: UrdfMimic | None = None


@dataclass(frozen=True)
class UrdfMimic:
    """A joint that follows another one, ``factor q + offset`` [rad or m], and its limits.

    ``lower``, ``upper`` [rad or m]; None where the joint that it follows has none.
    """

    joint: str
    factor: float
    offset: float
    lower: float | None
    upper: float | None
    speed_max: float | None
    effort: float | None


@checked_types
def export_urdf(model: str | Path | RobotModel, path: str | Path) -> Exported:
    """Write a robot as a URDF file and an overlay next to it.

    The URDF file is the rigid robot, for other programs: links, joints, inertias, limits,
    frictions. Elastic degrees of freedom of elements with a motor joint are rigid in it; those of
    other elements are joints. The overlay, with the ending ``.toml``, adds gears, motors, springs,
    lines, moves, sensors, temperature, servo and uncertainty: `flexgen.read` of the overlay gives
    the same equations. An axis that a mechanism moves by one joint has `<mimic>`; one that follows
    several joints, or an elastic one that is rigid, is free in the URDF file. Joints of the URDF
    file have the names of the coordinates, links those of the elements. The files that the robot
    was read from are never replaced, nor is an overlay that flexgen did not write.

    Parameters
    ----------
    model : str, Path or RobotModel
        As for `flexgen.derive`.
    path : str or Path
        A name that ends in ``.urdf``.

    Returns
    -------
    Exported
        Its main file is the URDF file; ``details["overlay"]`` is the overlay.

    Raises
    ------
    ModelError
        An overlay cannot contain a part of the robot: a beam, a drag on a body, a sensor, motor or
        line on an element that does not move relative to the one before, a coordinate that moves
        no mass.
    ArgumentError
        There is no such model, its moves were changed in Python, or a file cannot be written or
        must not be replaced.

    Examples
    --------
    >>> print(*flexgen.export_urdf("elbow", "elbow.urdf").files)
    elbow.urdf elbow.toml
    """
    path = Path(path)
    if path.suffix != ".urdf":
        raise ArgumentError(f"path: given {path.name!r}, expected a name that ends in .urdf")
    robot = model if isinstance(model, RobotModel) else read(model)
    overlay = path.with_suffix(".toml")
    try:
        _check_targets(robot, path, overlay)
        steps = _follow(robot, _steps(robot))
        text = urdf_text(robot, steps)
        follow_links(path.parent).mkdir(parents=True, exist_ok=True)
        # read back what is written before it takes the place of others
        with staging_folder(path.parent) as folder:
            (folder / path.name).write_text(text, encoding="utf-8")
            tables = overlay_text(robot, steps, path.name, folder)
            (folder / overlay.name).write_text(tables, encoding="utf-8")
            try:
                again = read(folder / overlay.name)
            except ModelError as error:
                file = str(path.with_name(Path(error.file).name))
                raise ModelError(
                    file, error.line, error.key, error.given, error.expected
                ) from None
            _check_moves(robot, again)
    except OSError as error:
        raise unwritable(path, error) from error
    write_text(overlay, overlay_text(robot, steps, path.name, path.parent))
    write_text(path, text)
    what = (f"{robot.title}, rigid", "gears, motors, springs, moves")
    return exported(robot, "urdf", (path, overlay), what, details={"overlay": overlay})


def _check_targets(model: RobotModel, path: Path, overlay: Path) -> None:
    """Refuse two files that cannot both be written, or that would replace a file of the user."""
    sources = source_files(model.file)
    for target, what in ((path, "URDF file"), (overlay, "overlay")):
        given = f"path: given {str(path)!r}, whose {what} would be {str(target)!r}"
        if target.is_dir():
            raise ArgumentError(f"{given}, which is a directory; choose another name")
        if any(target.exists() and target.samefile(source) for source in sources):
            raise ArgumentError(
                f"{given}, from which the robot was read; expected another name or folder, as "
                "this file would be lost"
            )
        folder = Path(os.path.realpath(target)).parent
        if folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
            raise ArgumentError(
                f"{given}, in a folder that cannot be written; choose a folder that you may write"
            )
    if os.path.lexists(overlay) and not _is_ours(overlay):
        raise ArgumentError(
            f"path: given {str(path)!r}, whose overlay would replace {str(overlay)!r}, a file "
            "that flexgen did not write; choose another name, or move that file away"
        )


def _is_ours(overlay: Path) -> bool:
    """Whether the first line of a file says that flexgen wrote it."""
    try:
        with overlay.open("rb") as stream:
            line = stream.readline(4096)
    except OSError:
        return False
    return line.startswith(b"#") and _WRITTEN_BY.encode() in line


# --- the chain -----------------------------------------------------------------------------------


def _steps(model: RobotModel) -> list[Step]:
    """The links after the ground, one for each joint of the URDF file, and the tip if its frame is
    not that of the last link.

    A link has its frame at its joint, in the orientation of the element's body; a joint or link of
    its own gets a new name. ModelError for what a URDF file cannot have.
    """
    beam_or_drag(model)
    for kind, named in (
        ("element", model.elements),
        ("dof", model.coordinates),
        ("motor", model.motors),
    ):
        for name in (one.name for one in named):
            if problem := identifier_problem(name):
                raise ModelError(model.file, 0, f"{kind}.name", show(name), problem)
    names = {element.name for element in model.elements}
    coordinates = {coordinate.name for coordinate in model.coordinates}
    out: list[Step] = []
    ends = {"base": ("", np.zeros(3))}  # the link of each element, and the body frame in it
    for element in model.elements:
        parent, shift = ends[model.parents[element.name]]
        turn = np.array(element.link.rotation)
        position = shift + np.array(element.origin.position)
        rotation = np.array(element.origin.rotation) @ turn
        groups = joint_groups(element)
        for k, (before, dof, after) in enumerate(groups):
            last = k + 1 == len(groups)
            link = (
                element.name
                if last
                else _new_name(f"{element.name}_{dof.name if dof else k}", names)
            )
            names.add(link)
            shift = turn.T @ np.array(element.link.position)
            body = (
                replace(element.body, com=tuple((shift + np.array(element.body.com)).tolist()))
                if last
                else Body()
            )
            joint = (
                dof.name if dof is not None else _new_name(f"{element.name}_mount", coordinates)
            )
            coordinates.add(joint)
            before, own, after = (
                tuple(
                    replace(d, axis=tuple((turn.T @ np.array(d.axis) + 0.0).tolist()))
                    for d in group
                )
                for group in (before, (dof,) if dof else (), after)
            )
            out.append(
                Step(
                    link,
                    joint,
                    own[0] if own else None,
                    before,
                    after,
                    position,
                    rotation,
                    body,
                    parent,
                )
            )
            parent = link
            position = np.zeros(3)
            rotation = np.eye(3)
        ends[element.name] = parent, shift
    parent, shift = ends[model.tip]
    if shift.any():
        joint = _new_name("tip_mount", coordinates)
        link = _new_name("tip", names)
        out.append(Step(link, joint, None, (), (), shift, np.eye(3), Body(), parent))
    return out


def joint_groups(element: Element) -> list[tuple[tuple[Dof, ...], Dof | None, tuple[Dof, ...]]]:
    """Degrees of freedom in groups with one joint of the URDF file each: (before, joint,
    after).
    """
    if not element.dofs:
        return [((), None, ())]
    moved = [k for k, dof in enumerate(element.dofs) if dof.actuated or dof.dependent] or [0]
    out: list[tuple[tuple[Dof, ...], Dof | None, tuple[Dof, ...]]] = []
    for n, k in enumerate(moved):
        start = 0 if n == 0 else k
        end = moved[n + 1] if n + 1 < len(moved) else len(element.dofs)
        out.append((element.dofs[start:k], element.dofs[k], element.dofs[k + 1 : end]))
    return out


def _follow(model: RobotModel, steps: list[Step]) -> list[Step]:
    """The steps, those with a joint that follows another one of the file as in its URDF file."""
    joints = {step.dof.name for step in steps if step.dof}
    # sums of several, and elastic ones that are rigid in the file, are in the overlay only
    return [
        _follow_joint(model, step, step.dof)
        if step.dof is not None and len(step.dof.mimic) == 1 and step.dof.mimic[0][0] in joints
        else step
        for step in steps
    ]


def _follow_joint(model: RobotModel, step: Step, dof: Dof) -> Step:
    """A step whose joint follows another one, with the zero and the limits of its URDF file.

    The model has the offset in the pose of the joint. Without a URDF file the joint has no offset,
    and the limits are those that the other one gives it.
    """
    name, factor = dof.mimic[0]
    source = model.urdf_joints.get(dof.name)
    leader = next(c.dof for c in model.coordinates if c.name == name)
    assert leader is not None
    source = UrdfJoint(dof.name) if source is None else source
    lower, upper, speed = _range_of_follower(leader, factor, source.offset)
    if lower is not None and upper is not None and source.lower is not None:
        lower = source.lower
        upper = source.upper
    mimic = UrdfMimic(
        name, factor, source.offset, lower, upper, source.speed_max or speed, source.effort
    )
    if source.offset == 0.0:
        return replace(step, mimic=mimic)
    axis = np.array(dof.axis)
    if dof.type == "rotation":
        turn = step.rotation @ rotation_about(axis, -source.offset)
        turn[np.abs(turn) < ROUNDING] = 0.0
        return replace(step, mimic=mimic, rotation=turn)
    shift = step.position - step.rotation @ axis * source.offset
    return replace(step, mimic=mimic, position=shift)


def _range_of_follower(
    leader: Dof, factor: float, offset: float
) -> tuple[float | None, float | None, float | None]:
    """Limits of a joint that follows another one: both positions or none, and the speed."""
    speed = None if leader.speed_max is None else abs(factor) * leader.speed_max
    if leader.lower is None and leader.upper is None and leader.type == "rotation":
        return None, None, speed
    ends = (
        -UNLIMITED if leader.lower is None else factor * leader.lower + offset,
        UNLIMITED if leader.upper is None else factor * leader.upper + offset,
    )
    return min(ends), max(ends), speed


def _new_name(stem: str, taken: Iterable[str]) -> str:
    """An identifier that is not taken."""
    name = stem[:27].rstrip("_").replace("__", "_")
    k = 2
    while name in taken or name == "base" or identifier_problem(name):
        name = f"{stem[:24].rstrip('_')}{k}"
        k = k + 1
    return name


# --- the URDF file -------------------------------------------------------------------------------


def urdf_text(model: RobotModel, steps: list[Step]) -> str:
    """The URDF file."""
    root = ElementTree.Element("robot", {"name": model.name})
    root.append(
        ElementTree.Comment(f" rigid part of {model.title}, written by flexgen {__version__} ")
    )
    ground = _ground(steps)
    add(root, "link", name=ground)
    efforts = _efforts(model)
    for step in steps:
        _joint(root, step, step.parent or ground, efforts)
        link = add(root, "link", name=step.link)
        if step.body.mass > 0.0:
            inertial = add(link, "inertial")
            add(inertial, "origin", xyz=step.body.com)
            add(inertial, "mass", value=step.body.mass)
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = step.body.inertia
            add(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
    shifts = _shifts(model)
    for loop in model.loops:
        constraint = add(root, "constraint", name=loop.name, type=_CONSTRAINTS[loop.type])
        for side, frame in (("parent", loop.start), ("child", loop.end)):
            on_ground = frame.element == "base"
            add(constraint, side, link=ground if on_ground else frame.element)
            position = np.array(frame.position)
            if not on_ground:
                position = position + shifts[frame.element]
            rpy = roll_pitch_yaw(np.array(frame.rotation))
            add(constraint, f"{side}_origin", xyz=position, rpy=rpy)
            add(constraint, f"{side}_axis", xyz=(0.0, 0.0, 1.0))
    return '<?xml version="1.0"?>\n' + document(root)


def _shifts(model: RobotModel) -> dict[str, np.ndarray]:
    """Position (3,) [m] of the body frame of each element in the frame of its link."""
    return {
        e.name: np.array(e.link.rotation).T @ np.array(e.link.position) for e in model.elements
    }


def _joint(
    root: ElementTree.Element,
    step: Step,
    parent: str,
    efforts: Mapping[str, float],
) -> None:
    """Append the XML of a joint from link ``parent``: kind, pose, axis, limits, mimic and
    friction; ``efforts``: largest torques [N m, N] by joint.
    """
    dof = step.dof
    mimic = step.mimic
    turns = dof is not None and dof.type == "rotation"
    ends = (None, None) if dof is None else (dof.lower, dof.upper)
    if mimic is not None:
        ends = mimic.lower, mimic.upper
    kind = (
        "fixed"
        if dof is None
        else ("continuous" if ends == (None, None) else "revolute")
        if turns
        else "prismatic"
    )
    joint = add(root, "joint", name=step.joint, type=kind)
    add(joint, "parent", link=parent)
    add(joint, "child", link=step.link)
    add(joint, "origin", xyz=step.position, rpy=roll_pitch_yaw(step.rotation))
    if dof is None:
        return
    add(joint, "axis", xyz=dof.axis)
    effort = efforts.get(dof.name, UNLIMITED)
    velocity = dof.speed_max or UNLIMITED
    if mimic is not None:
        effort = mimic.effort or UNLIMITED
        velocity = mimic.speed_max or UNLIMITED
    limit = add(joint, "limit", effort=effort, velocity=velocity)
    if kind != "continuous":
        for side, value, none in zip(
            ("lower", "upper"), ends, (-UNLIMITED, UNLIMITED), strict=True
        ):
            limit.set(side, repr(none if value is None else value))
    if mimic is not None:
        offset = {"offset": mimic.offset} if mimic.offset else {}
        add(joint, "mimic", joint=mimic.joint, multiplier=mimic.factor, **offset)
    if dof.friction.viscous or dof.friction.coulomb:
        add(joint, "dynamics", damping=dof.friction.viscous, friction=dof.friction.coulomb)


def _efforts(model: RobotModel) -> dict[str, float]:
    """Largest torque of each joint that one motor drives alone [N m or N]."""
    return {
        motor.drives[0]: motor.torque_max * abs(motor.ratio[0])
        for motor in model.motors
        if len(motor.drives) == 1 and motor.torque_max is not None
    }


def _ground(steps: list[Step]) -> str:
    return _new_name("base_link", {step.link for step in steps})


# --- the overlay ---------------------------------------------------------------------------------


def overlay_text(model: RobotModel, steps: list[Step], file: str, folder: Path) -> str:
    """The overlay of a URDF file in the same folder."""
    data: dict[str, Any] = {"name": model.name}
    data |= {key: value for key in ("description", "source") if (value := getattr(model, key))}
    data |= {
        "gravity": model.gravity,
        "motor_coupling": model.motor_coupling,
        "home_rad": model.home,
    }
    data |= (
        {"temperature": model.temperature}
        if model.temperature != MODEL["temperature"].default
        else {}
    )
    data["base"] = write(PLACEMENT, model.base)
    data["tool"] = write(PLACEMENT, model.tool)
    data["tool"] |= {
        x: v for x in ("speed_max", "acceleration_max") if (v := getattr(model.tool, x, None))
    }
    forms: dict[str, Any] = {"uncertainty": UNCERTAINTY, "servo": SERVO_TABLE}
    data |= {
        key: write(form, value)
        for key, form in forms.items()
        if (value := getattr(model, key)) is not None
    }
    kept = {*(c.name for c in model.coordinates), *(sensor.name for sensor in model.sensors)}
    kept |= {line.name for line in model.lines}
    kept |= {step.link for step in steps} | {"payload"}
    data["not_measured"] = [x for x in model.not_measured if x.partition(".")[0] in kept]
    if model.payload.mass:
        data["payload"] = write(BODY, model.payload) | (
            {"inertia_reduced": True} if _reduced(model.payload) else {}
        )
    data["output"] = output_table(model)
    lines = [f"# {model.title}{_WRITTEN_BY}{__version__}: what {file} cannot contain"]
    lines += [f"{key} = {toml(value)}" for key, value in data.items() if value not in ({}, (), [])]
    tip = model.tip if steps[-1].link in model.parents else steps[-1].link
    branches = [
        step.link for step in steps if step.link not in {tip, *(other.parent for other in steps)}
    ]
    ends = {
        "file": file,
        "base": _ground(steps),
        "tip": tip,
        "branches": branches,
        "limits": False,
        "dynamics": False,
    }
    lines += [
        "",
        "[urdf]",
        *(f"{key} = {toml(value)}" for key, value in ends.items() if value != []),
    ]
    for step in steps:
        if step.dof is not None:
            lines += ["", f"[joint.{step.dof.name}]"]
            table = {
                key: value
                for key, value in write(DOF, step.dof).items()
                if key not in ("name", "type", "axis")
            }
            more = {"before": step.before, "after": step.after}
            table |= {key: [write(DOF, d) for d in group] for key, group in more.items() if group}
            lines += [f"{key} = {toml(value)}" for key, value in table.items()]
        if _reduced(step.body):
            lines += ["", f"[link.{step.link}]", "inertia_reduced = true"]
    shifts = _shifts(model)
    fixed = {step.link for step in steps if step.dof is None}
    for kind, tables in (
        ("motor", [write(MOTOR, motor) for motor in model.motors]),
        ("sensor", [sensor_table(sensor, shifts) for sensor in model.sensors]),
        ("line", [line_table(line, shifts) for line in model.lines]),
        *_tasks(model, folder, shifts).items(),
    ):
        for table in tables:
            owners = (table["from"], table["to"]) if kind == "line" else (table,)
            places = [end.get("carrier", end.get("element")) for end in owners]
            for place in (one for one in places if one in fixed):
                given = (
                    f"{table['name']} on {place}, which does not move relative to the element "
                    "before"
                )
                raise ModelError(
                    model.file, 0, f"{kind}.{table['name']}", given, "for URDF a moving element"
                )
            lines += [
                "",
                f"[[{kind}]]",
                *(f"{key} = {toml(value)}" for key, value in table.items()),
            ]
    return "\n".join(lines) + "\n"


def _reduced(body: Body) -> bool:
    low, middle, high = np.linalg.eigvalsh(np.array(body.inertia))
    return bool(low + middle < high * (1.0 - 1e-9))


def _tasks(
    model: RobotModel, folder: Path, shifts: Mapping[str, np.ndarray]
) -> dict[str, list[dict[str, Any]]]:
    """Frames, moves and programs as they stand in the model file; files of samples relative to a
    folder, frames of elements in the frame of their link.
    """
    data = json.loads(model.text) if model.text else {}
    out: dict[str, list[dict[str, Any]]] = {
        key: data.get(key, []) for key in ("frame", "move", "program")
    }
    files = {move.name: move.file for move in model.moves if move.file}
    for table in out["move"]:
        if table["name"] in files:
            table["file"] = os.path.relpath(files[table["name"]], folder)
    for table in out["frame"]:
        if "element" in table:
            position = np.array(table.get("position", (0.0, 0.0, 0.0))) + shifts[table["element"]]
            table["position"] = position.tolist()
    return out


def _check_moves(model: RobotModel, again: RobotModel) -> None:
    """Refuse moves that are not those of the model file: they were changed in Python."""
    ours, theirs = (
        [_drop_file(task) for task in (*robot.moves, *robot.programs)] for robot in (model, again)
    )
    if ours != theirs:
        raise ArgumentError(
            f"model {model.name}: given moves that are not those of its file, expected the "
            "model as flexgen.read returns it"
        )


def _drop_file(task: Move | Program) -> Move | Program:
    """A move without its file, whose path depends on the folder, and without frames of elements,
    which are those of links.
    """
    if not isinstance(task, Move):
        return task
    frame = None if task.frame is not None and task.frame.element else task.frame
    tool = task.fixed_tool
    tool = None if tool is not None and tool.element else tool
    return replace(task, file="", frame=frame, fixed_tool=tool)
