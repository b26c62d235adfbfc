"""A model file from a table of Denavit-Hartenberg parameters; assumed numbers are marked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

import numpy as np

from flexgen.base.errors import ArgumentError, FileError, ModelError
from flexgen.base.files.atomic_files import temporary_folder
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import c_name_problem
from flexgen.base.spec.toml_text import exact, toml
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import RobotModel
from flexgen.model.inertia import mass_matrix
from flexgen.model.reader import read
from flexgen.studies.templates.dh_arm import (
    RULES,
    Body,
    Drive,
    Link,
    Pose,
    Value,
    angle_of,
    drive,
    links,
    payload,
    placements,
)
from flexgen.studies.templates.dh_moves import ANGLE, Arm, Kept, choose_axes, draw_poses
from flexgen.studies.templates.dh_table import DhTable, Row, likely_convention, read_dh

POSES = 200
"""Poses over which the largest inertia of each joint is computed."""

COLUMN = 48
"""Column at which comments begin."""

ANY_OUTPUT = 'type = "tool_pose"'
"""Output of the arm before its own one is chosen."""

FORMULAS = {
    "standard": "Rz(theta + q) Tz(d) Tx(a) Rx(alpha)",
    "modified": "Rx(alpha) Tx(a) Rz(theta + q) Tz(d)",
}
FRICTION_UNITS = {"coulomb": "N m", "viscous": "N m s/rad", "beta": "s/rad"}


@dataclass(frozen=True)
class DhModel:
    """A model file and what to know about it.

    ``text``: TOML. ``home``: actuated coordinates [rad or m]. ``zero``, ``tool``: the tool with
    all joints at 0, and at home [m, world axes]. ``moves``: names and durations [s]. ``assumed``:
    numbers that are not of the table, with the rule. ``missing``: quantities that are not in the
    file. ``warnings``: contradictions in the table.
    """

    text: str
    convention: str
    home: tuple[float, ...]
    zero: tuple[float, ...]
    tool: tuple[float, ...]
    moves: tuple[tuple[str, float], ...]
    assumed: tuple[str, ...]
    missing: tuple[str, ...]
    warnings: tuple[str, ...]


def model_from_dh(name: str, table: str | Path, convention: str | None = None) -> DhModel:
    """The model file of an arm with elastic gears, from a table of Denavit-Hartenberg parameters.

    Numbers that the table does not have are assumed, and marked. Home and moves are chosen such
    that the arm can do them: within its ranges, far from singular poses, with at most 50 % of the
    speeds and 60 % of the torques.

    Parameters
    ----------
    name : str
        Of the robot, an identifier.
    table : path
        CSV file, see `flexgen.studies.templates.dh_table.read_dh`.
    convention : str, optional
        "standard", or "modified" (Craig); not needed where the header has ``a_prev`` and
        ``alpha_prev``.

    Returns
    -------
    DhModel

    Raises
    ------
    ArgumentError, FileError
        The name is not an identifier; the table has an error, with its file, line and column.
    """
    problem = c_name_problem(name)
    if problem is not None:
        raise ArgumentError(f"name: given {name!r}, expected {problem}")
    return _Writer(name, read_dh(table, convention)).model()


class _Writer:
    """Text of one model."""

    def __init__(self, name: str, table: DhTable) -> None:
        """Draft the model rigid first: drives that the table lacks need the largest inertia at
        each joint.
        """
        self.name = name
        self.table = table
        self.links = links(table)
        self.assumed: list[str] = []
        self.warnings = _suspicions(table)
        self.drives: dict[str, Drive] = {}
        robot = _read(self._file([ANY_OUTPUT], None), table)
        inertia = _largest_inertia(robot)
        joints = iter(inertia)
        self.drives = {
            link.row.name: drive(link.row, float(next(joints)))
            for link in self.links
            if link.row.kind != "fixed"
        }

    def model(self) -> DhModel:
        """The file, with home and moves."""
        self.assumed.clear()
        robot = _read(self._file([ANY_OUTPUT], None), self.table)
        axes = choose_axes(derive(robot))
        output = _output(axes, robot)
        self.assumed.clear()
        equations = derive(_read(self._file(output, None), self.table))
        arm = Arm(equations, axes)
        home = self._home(arm)
        kept = list(arm.moves(home, tool=bool(axes)))
        self._check_moves(kept, bool(axes))
        self._check_gravity(arm, home)
        self.assumed.clear()
        text = self._file(output, home, [_move(move, arm) for move in kept])
        zero, at_home = self._tool_positions(arm, home)
        return DhModel(
            text,
            self.table.convention,
            tuple(map(float, home)),
            zero,
            at_home,
            tuple((move.move.name, move.move.duration) for move in kept),
            tuple(self.assumed),
            tuple(self._missing()),
            tuple(self.warnings),
        )

    def _home(self, arm: Arm) -> np.ndarray:
        """The home pose: that of the table, and of the search where it has none."""
        given = [row.cells.get("home") for row in self.table.joints]
        found = arm.home()
        home = [found[k] if cell is None else cell.value for k, cell in enumerate(given)]
        return np.array(home)

    def _check_moves(self, kept: Sequence[Kept], tool: bool) -> None:
        """A warning where no move is left, or no line though the output is the ``tool``."""
        names = [move.move.name for move in kept]
        if not names:
            self.warnings.append(
                "no move: the motors cannot move the arm, or its ranges are too small; look at "
                "the units of the torques, masses and limits"
            )
        elif tool and "line" not in names:
            self.warnings.append(
                "no line of the tool from home: the pose is close to a singular one or to limits; "
                "give another pose in the column home"
            )

    def _check_gravity(self, arm: Arm, home: np.ndarray) -> None:
        """A warning for each motor that gravity overcomes at ``home`` (n_g) or in some random
        pose.
        """
        robot = arm.robot
        poses = np.vstack([home, draw_poses(robot, POSES)])
        q = np.zeros((len(poses), robot.n_a))
        q[:, list(robot.i_g)] = poses
        force = evaluate(arm.equations.function("gravity"), q)[0].reshape(len(q), -1)
        torque = np.abs(np.linalg.solve(robot.eta.T, force[:, list(robot.i_g)].T)).max(axis=1)
        for motor, largest in zip(robot.motors, torque, strict=True):
            if motor.torque_max and largest > motor.torque_max:
                self.warnings.append(
                    f"motor {motor.name}: gravity needs up to {largest:.3g} N m in the range "
                    f"of the joints, torque_max is {motor.torque_max:.3g} N m; the torque is that "
                    "of the motor, not of the joint; or a counterbalance is missing"
                )

    def _tool_positions(
        self, arm: Arm, home: np.ndarray
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The tool [m] with all joints at 0, and at home."""
        robot = arm.robot
        q = np.zeros((2, robot.n_a))
        q[1, list(robot.i_g)] = home
        p = evaluate(arm.equations.function("forward_kinematics"), q)[0]
        zero, at_home = (tuple(float(x) for x in row) for row in p.reshape(2, 3))
        return zero, at_home

    def _missing(self) -> list[str]:
        """Limits and frictions that the table does not have."""
        found = []
        columns = ("lower", "upper", "torque_max", "coulomb", "viscous")
        for name in columns:
            without = [row.name for row in self.table.joints if name not in row]
            if without:
                of = "all joints" if len(without) == len(self.table.joints) else ", ".join(without)
                found.append(f"{name} of {of}")
        slow = [
            row.name
            for row in self.table.joints
            if "speed_max" not in row and "joint_speed_max" not in row
        ]
        if slow:
            found.append(f"speed_max of {', '.join(slow)}")
        return found

    # --- text ------------------------------------------------------------------------------------
    def _file(
        self, output: list[str], home: np.ndarray | None, moves: Sequence[list[str]] = ()
    ) -> str:
        """The text of the file; without drives yet, and without home: for the search."""
        lines: list[str] = []
        for link in self.links:
            lines += self._element(link)
        for k, row in enumerate(self.table.joints):
            lines += self._motor(k, row.name)
        lines += self._tool()
        lines += ["[output]", *output, ""] if output else []
        for move in moves:
            lines += move
        return "\n".join([*self._head(home), *lines])

    def _head(self, home: np.ndarray | None) -> list[str]:
        """Lines before the elements; ``home`` (n_g) [rad, m]: None for the middle of the
        ranges.
        """
        table = self.table
        about = f"{len(table.joints)} joints, from a table of {table.convention} DH parameters"
        note = "; numbers are assumed where the file says so" if self.assumed else ""
        source = f"{Path(table.file).name}{note}"
        lines = [
            f'name = "{self.name}"',
            f"description = {toml(about)}",
            f"source = {toml(source)}",
            _annotate("gravity = [0, 0, -9.81]", "m/s^2, world axes; the base is upright"),
        ]
        pose = _middle(table) if home is None else home
        rotary = [row.rotary for row in table.joints]
        values = [math.degrees(x) if turns else x for x, turns in zip(pose, rotary, strict=True)]
        given = all("home" in row for row in table.joints)
        origin = "of the table" if given else "chosen: far from singular poses and limits"
        unit = "deg" if all(rotary) else "deg, of translations m"
        lines.append(_annotate(f"home_deg = {_short(values)}", f"{unit}; {origin}"))
        return [
            *lines,
            "",
            f"# Convention: {table.convention}, from frame i-1 to frame i:",
            f"# {FORMULAS[table.convention]}.",
            "# Centers of mass and inertias are in frame i, which moves with link i; inertias",
            "# about the center of mass. SI units; keys that end in _deg are angles in degrees.",
            *self._legend(),
            "",
        ]

    def _legend(self) -> list[str]:
        """The rules of the assumed numbers."""
        used = dict.fromkeys(note.partition(": ")[2] for note in self.assumed)
        if not used:
            return []
        lines = ["#", "# ASSUMED numbers are not of the table: replace them. Their rules:"]
        for rule in used:
            text = f"{rule}: {RULES[rule]}."
            lines += wrap(text, 100, initial_indent="# - ", subsequent_indent="#   ")
        return lines

    def _element(self, link: Link) -> list[str]:
        """Lines of an element: its row of the table as a comment, poses, body, joint unless it is
        fixed.
        """
        row = link.row
        given = ", ".join(
            f"{name} = {cell.text} {cell.unit}"
            for name, cell in row.cells.items()
            if name in ("a", "alpha", "d", "theta")
        )
        lines = [f"# {row.name}: {given}", "[[element]]", f'name = "{link.name}"']
        for key, pose in (("origin", link.origin), ("link", link.link)):
            if not pose.empty:
                lines.append(f"{key} = {_pose(pose)}")
        lines += ["", *self._body("element.body", link.body, f"frame {link.name[4:]}"), ""]
        return lines + (self._joint(row.name, link) if row.kind != "fixed" else [])

    def _body(self, key: str, body: Body, frame: str) -> list[str]:
        """Lines of a body under the table ``key``, in words of its ``frame``, as ``"frame 2"``;
        one without mass has no center and inertia.
        """
        place = f"link {frame[6:]}" if key != "payload" else key
        lines = [f"[{key}]", self._line("mass", body.mass, "kg", place)]
        if body.mass.number == 0.0:
            return lines
        return [
            *lines,
            self._line("com", body.center, f"m, {frame}", place),
            self._line("inertia", body.inertia, "kg m^2", place),
        ]

    def _joint(self, name: str, link: Link) -> list[str]:
        """Lines of the joint ``name`` of a link, with an elastic gear where its drive is known,
        else a rigid one.
        """
        row = link.row
        direction = int(row.get("direction", 1.0))
        lines = [
            "[[element.dof]]",
            f'name = "{name}"',
            f'type = "{row.kind}"',
            f"axis = [0, 0, {direction}]",
        ]
        for key in ("lower", "upper"):
            if key in row:
                lines.append(_limit(key, row))
        if "joint_speed_max" in row:
            unit = "rad/s" if row.rotary else "m/s"
            lines.append(_annotate(f"speed_max = {exact(row.get('joint_speed_max'))}", unit))
        found = self.drives.get(name)
        if found is None:
            return [*lines, 'gear = { type = "rigid" }', ""]
        per = "rad" if row.rotary else "m"
        force = "N m" if row.rotary else "N"
        stiffness = self._line("stiffness", found.stiffness, f"{force}/{per}, joint side", name)
        damping = self._line("damping", found.damping, f"{force} s/{per}, joint side", name)
        return [
            *lines,
            "",
            "[element.dof.gear]",
            'type = "elastic"',
            'side = "arm"',
            damping,
            "",
            "[element.dof.gear.spring]",
            'type = "linear"',
            stiffness,
            "",
        ]

    def _motor(self, k: int, joint: str) -> list[str]:
        """Lines of motor k, which drives ``joint``; without a known drive one of ratio 1 and no
        inertia.
        """
        found = self.drives.get(joint)
        name = f"m{k + 1}"
        lines = ["[[motor]]", f'name = "{name}"', f'drives = "{joint}"']
        if found is None:
            return [*lines, "ratio = 1", "inertia = 0", ""]
        rotary = self.table.joints[k].rotary
        unit = "motor angle / joint angle" if rotary else "rad/m"
        lines.append(self._line("ratio", found.ratio, unit, name))
        lines.append(self._line("inertia", found.inertia, "kg m^2, motor side", name))
        for key, value, unit in (
            ("torque_max", found.torque_max, "N m at the motor"),
            ("speed_max", found.speed_max, "rad/s at the motor"),
        ):
            if value is not None:
                lines.append(self._line(key, value, unit, name))
        if found.friction:
            lines += ["", "[motor.friction]"]
            for key, value in found.friction.items():
                lines.append(self._line(key, value, FRICTION_UNITS[key], name))
        return [*lines, ""]

    def _tool(self) -> list[str]:
        """Lines of the tool's pose and the payload, each where the table has one."""
        lines: list[str] = []
        row = self.table.tool
        if row is not None:
            lines += ["[tool]", *_tool_pose(placements(row, self.table.convention)), ""]
        body = payload(self.table)
        if body is not None:
            lines += [*self._body("payload", body, "frame of the last link"), ""]
        return lines

    def _line(self, key: str, value: Value, unit: str, place: str) -> str:
        """A line of the file; notes an assumed number."""
        text = f"{key} = {toml(value.value)}"
        if not value.origin:
            return _annotate(text, f"{unit}; {value.computed}" if value.computed else unit)
        self.assumed.append(f"{key} of {place}: {value.origin}")
        return _annotate(text, f"{unit}; ASSUMED: {value.origin}")


def _middle(table: DhTable) -> np.ndarray:
    """A pose (n_g) within all limits: 0 where it is within them."""
    pose = []
    for row in table.joints:
        low = row.get("lower", -math.inf)
        high = row.get("upper", math.inf)
        near = low if low > 0.0 else high if high < 0.0 else 0.0
        pose.append(0.5 * (low + high) if near and math.isfinite(high - low) else near)
    return np.array(pose)


def _annotate(text: str, note: str) -> str:
    return f"{text:<{COLUMN}} # {note}"


def _short(values: Sequence[float]) -> str:
    """A list of angles or positions; rounding of multiples is left out."""
    return toml([float(f"{value:.12g}") for value in values])


def _limit(key: str, row: Row) -> str:
    """A limit in degrees or m."""
    cell = row.cells[key]
    if not row.rotary:
        return _annotate(f"{key} = {exact(cell.value)}", "m")
    return _annotate(f"{key}_deg = {exact(angle_of(row, key, degrees=True))}", "deg")


def _pose(pose: Pose) -> str:
    """A placement as a table in one line."""
    rpy = "rpy_deg" if pose.degrees else "rpy_rad"
    return f"{{ position = {toml(pose.position)}, {rpy} = {toml(pose.rpy)} }}"


def _tool_pose(poses: tuple[Pose, Pose]) -> list[str]:
    """The lines of the pose of the tool: one constant pose after another."""
    before, after = poses
    R = before.rotation
    p = np.array(before.position) + R @ np.array(after.position)
    lines = [_annotate(f"position = {toml(p)}", "m, frame of the last link")]
    if before.empty or not any(before.rpy):
        key = "rpy_deg" if after.degrees else "rpy_rad"
        return [*lines, f"{key} = {toml(after.rpy)}"] if any(after.rpy) else lines
    return [*lines, f"rotation = {toml((R @ after.rotation).ravel())}"]


def _output(axes: Sequence[int], robot: RobotModel) -> list[str]:
    """The lines of the table output."""
    if len(axes) == 6:
        return [_annotate('type = "tool_pose"', "position and orientation of the tool")]
    if axes:
        text = "".join("xyz"[i] for i in axes if i < 3)
        if 5 in axes:
            turning = _annotate("rotation_axis = [0, 0, 1]", "world axes: the tool stays upright")
            return [f'type = "{ANGLE}"', f'axes = "{text}"', turning]
        return ['type = "tool_position"', f'axes = "{text}"']
    names = [robot.coordinates[i].name for i in robot.i_g]
    return ['type = "joint"', f"joints = {toml(names)}"]


def _move(kept: Kept, arm: Arm) -> list[str]:
    """The table of a move."""
    move = kept.move
    angles = [unit == "rad" for unit in arm.units]
    unit = "deg" if all(angles) else "deg, of translations m"

    def pose(values: Sequence[float]) -> str:
        return _short([math.degrees(x) if a else x for x, a in zip(values, angles, strict=True)])

    lines = ["[[move]]", f'name = "{move.name}"', f'type = "{move.type}"']
    lines.append(_annotate(f"start_deg = {pose(move.start)}", unit))
    if move.type == "tool_line":
        lines.append(
            _annotate(
                f"displacement = {_short(move.displacement)}",
                "m, world axes: of the straight line",
            )
        )
    elif move.type == "tool_circle":
        lines += [
            _annotate(
                f"center = {_short(move.center)}", "m, world axes, from the tool at the start"
            ),
            f"axis = {_short(move.axis)}",
            _annotate("angle_deg = 360", "deg"),
        ]
    else:
        lines.append(_annotate(f"end_deg = {pose(move.end)}", unit))
    lines.append(_annotate(f"duration = {exact(move.duration)}", f"s; {kept.why}"))
    return [
        *lines,
        _annotate(f"smoothness = {move.smoothness}", "continuous derivatives of the path"),
        "",
    ]


def _read(text: str, table: DhTable) -> RobotModel:
    """The robot of a text; an error of the model is one of the table."""
    with temporary_folder() as place:
        file = place / "new.toml"
        file.write_text(text, encoding="utf-8")
        try:
            return read(file)
        except ModelError as error:
            given = f"{error.given} ({error.key})"
            raise FileError(table.file, 0, "table", given, error.expected) from None


def _largest_inertia(robot: RobotModel) -> np.ndarray:
    """The largest inertia (n_g) of each joint over its poses [kg m^2 or kg]."""
    inertia = np.zeros(robot.n_g)
    for q_g in draw_poses(robot, POSES):
        q = np.zeros(robot.n_a)
        q[list(robot.i_g)] = q_g
        inertia = np.maximum(inertia, np.diag(mass_matrix(robot, q))[list(robot.i_g)])
    return inertia


def _suspicions(table: DhTable) -> list[str]:
    """Probable mistakes in the table."""
    found = []
    likely = likely_convention(table.joints)
    if likely and likely != table.convention:
        end = "begins" if likely == "modified" else "ends"
        found.append(
            f"the table {end} with a = 0 and alpha = 0, as tables of the convention {likely!r} "
            f"do; given {table.convention!r}: compare the position of the tool with all joints "
            "at 0 with the datasheet"
        )
    return found
