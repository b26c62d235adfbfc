"""Data classes of a robot description: frozen data, with properties that count and look up.

Notation (S. Moberg, Modeling and Control of Flexible Manipulators, Linkoeping 2010): arm
coordinates ``q_a`` in the order of the elements consist of actuated ones ``q_g`` (a gear between
them and a motor) and non-actuated ones ``q_e`` (spring-damper only); motor coordinates ``q_m`` are
on the motor side of the gears.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import table_html
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.fourier import FourierSum
from flexgen.base.spec.parts import Beam as Beam
from flexgen.base.spec.parts import BeamTip as BeamTip
from flexgen.base.spec.parts import Bending as Bending
from flexgen.base.spec.parts import Tolerances
from flexgen.base.spec.sensors import Sensor
from flexgen.model.friction import FRICTION_LAWS as FRICTION_LAWS
from flexgen.model.friction import NO_FRICTION, Friction
from flexgen.model.friction import friction_key as friction_key
from flexgen.model.moves import Move as Move
from flexgen.model.moves import Program, WorkFrame, check_name, unknown_move

if TYPE_CHECKING:
    from flexgen.base.spec.lines import Line
    from flexgen.base.spec.memory import HysteresisLaw, LuGre

Vector = tuple[float, ...]
Matrix = tuple[tuple[float, ...], ...]

IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Vector = (0.0, 0.0, 0.0)
# Numbers that a sentence names; it counts the others.
NAMES_SHOWN = 8


@dataclass(frozen=True)
class Placement:
    """A constant pose: ``p_parent = position + rotation @ p_child``; position in m, rotation a
    rotation matrix.
    """

    position: Vector = ZERO
    rotation: Matrix = IDENTITY


@dataclass(frozen=True)
class Tool(Placement):
    """The pose of a tool frame from the tip of ``element``; empty: that of the last one.

    Limits ``speed_max`` [m/s] and ``acceleration_max`` [m/s^2] of its origin; None: no limit.
    """

    element: str = ""
    speed_max: float | None = None
    acceleration_max: float | None = None


@dataclass(frozen=True)
class LinearSpring:
    """``tau = stiffness d`` (stiffness in N m/rad or N/m)."""

    stiffness: float


@dataclass(frozen=True)
class CubicSpring:
    """``tau = stiffness d + cubic d^3`` (cubic in N m/rad^3 or N/m^3)."""

    stiffness: float
    cubic: float


@dataclass(frozen=True)
class SmoothSpring:
    """Low and high stiffness, once continuously differentiable.

    ``tau = low d + (high - low)/(3 break_at^2) d^3`` for ``|d| <= break_at``, stiffness ``high``
    beyond.
    """

    low: float
    high: float
    break_at: float


@dataclass(frozen=True)
class PiecewiseSpring:
    """Piecewise linear: stiffness ``low`` for ``|d| <= break_at``, ``high`` beyond; continuous."""

    low: float
    high: float
    break_at: float


@dataclass(frozen=True)
class BacklashSpring:
    """Smooth dead band of half width ``gap``.

    ``tau = stiffness (d - (r(d + gap) - r(d - gap))/2)`` with ``r(x) = sqrt(x^2 + smoothing^2)``.
    """

    stiffness: float
    gap: float
    smoothing: float


Spring = LinearSpring | CubicSpring | SmoothSpring | PiecewiseSpring | BacklashSpring


@dataclass(frozen=True)
class Gear:
    """Gear between a motor and an actuated degree of freedom."""

    rigid: bool  # without a spring: the motor angle is the joint angle times the ratio
    side: str = "arm"  # or "motor": the side of the gear to which spring and damping refer
    spring: Spring | None = None  # None for a rigid gear
    damping: float = 0.0  # in parallel with the spring [N m s/rad or N s/m]
    hysteresis: HysteresisLaw | tuple[HysteresisLaw, ...] | None = None  # or its elements
    # of the motor angle, e(q_m) [rad or m] at the joint
    transmission_error: FourierSum | None = None
    # at the joint [N m or N], and over the motion in the root mean square
    torque_max: float | None = None
    torque_rms_max: float | None = None

    @property
    def type(self) -> str:
        """Kind of the gear in a model file."""
        return "rigid" if self.rigid else "elastic"


@dataclass(frozen=True)
class Dof:
    """One degree of freedom: rotation about, or translation along, a unit axis of the preceding
    frame.

    Exactly one of ``gear`` (actuated), ``spring`` (non-actuated), ``mimic`` and ``passive`` is
    given; with ``mimic``, pairs (name, factor) of coordinates, ``q = sum factor q_name``: a
    mechanism, whose moments act on those. ``passive`` [rad or m]: position near which closed loops
    hold the joint at home; it has no coordinate, since the loops determine it from the others.
    ``friction``: arm side. ``counterbalance``: pairs (s_k, c_k) [N m] of the
    torque ``sum_k s_k sin(k q) + c_k cos(k q)``, k = 1, 2, ..., that acts on a rotation, as of a
    gas spring or a weight between it and the element before.
    ``lower``, ``upper`` [rad or m], ``speed_max`` [rad/s or m/s], ``acceleration_max``, and
    ``deflection_max`` [rad or m] of a spring are limits; None: no limit.
    """

    name: str
    type: str  # "rotation" or "translation"
    axis: Vector
    gear: Gear | None = None
    spring: Spring | None = None
    damping: float = 0.0
    friction: Friction = NO_FRICTION
    lower: float | None = None
    upper: float | None = None
    speed_max: float | None = None
    acceleration_max: float | None = None
    deflection_max: float | None = None
    counterbalance: tuple[tuple[float, float], ...] = ()
    mimic: tuple[tuple[str, float], ...] = ()
    passive: float | None = None

    @property
    def actuated(self) -> bool:
        """Whether a gear connects it to a motor."""
        return self.gear is not None

    @property
    def dependent(self) -> bool:
        """Whether coordinates determine it, by a mechanism or by closed loops."""
        return bool(self.mimic) or self.passive is not None


@dataclass(frozen=True)
class Body:
    """A rigid body: mass [kg], center of mass [m] and inertia tensor about it [kg m^2], in its own
    frame.

    ``rotational_drag`` [N m s/rad]: damping of the absolute rotation, torque
    ``-rotational_drag omega``.
    """

    mass: float = 0.0
    com: Vector = ZERO
    inertia: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    rotational_drag: float = 0.0


@dataclass(frozen=True)
class Element:
    """A link: placement, degrees of freedom in order, body frame, body, and optionally a beam.

    Frames: tip of the parent -> ``origin`` (constant) -> degrees of freedom -> ``link``
    (constant) -> body -> beam tip. The tip is the body frame, or the end of the beam. ``parent``:
    an earlier element, ``"base"``, or None for the one before; several elements with one parent
    make a tree.
    """

    name: str
    dofs: tuple[Dof, ...]
    origin: Placement = Placement()
    link: Placement = Placement()
    body: Body = Body()
    beam: Beam | None = None
    parent: str | None = None


@dataclass(frozen=True)
class LoopFrame(Placement):
    """An end of a closed loop: a pose in the body frame of ``element``, or in the frame of the
    base for ``"base"``.
    """

    element: str = "base"


@dataclass(frozen=True)
class Loop:
    """A closed loop: the frames ``start`` and ``end`` of two bodies coincide.

    ``type``: ``"point"``, the origins coincide (3 equations, 2 of them independent in a planar
    loop), as of a spherical bearing or of a pin in a plane; ``"axis"``, also the z axes (5), as of
    a pin; ``"pose"``, all axes (6), as of one body that is cut into two.
    """

    name: str
    type: str
    start: LoopFrame
    end: LoopFrame


@dataclass(frozen=True)
class Motor:
    """A motor: rotor inertia [kg m^2, axial, motor side] and its gear:
    ``q_m = sum_k ratio_k q_(drives_k)``.

    A motor that drives several joints (a coupled wrist) gives a row with several entries of the
    ratio matrix ``eta``. ``axis`` (unit, in the frame of the element ``carrier``, or of the base
    for ``"base"``) is used by the complete model only. Limits, on the motor side, None where there
    is none: ``torque_max`` [N m], ``speed_max`` [rad/s], ``torque_rate_max`` [N m/s],
    ``torque_rms_max`` [N m], the root mean square with the time constant ``thermal_time`` [s] of
    the winding (None: over the whole motion), and ``torque_speed``, points (speed [rad/s], torque
    [N m]) of the largest torque over the speed. Sums of the motor angle: ``cogging`` [N m], a
    torque that acts on the rotor in addition, and ``torque_ripple`` r; the motor gives
    ``tau_m (1 + r(q_m))``. ``lugre`` adds to ``friction``.
    """

    name: str
    inertia: float
    drives: tuple[str, ...]
    ratio: Vector
    friction: Friction = NO_FRICTION
    axis: Vector | None = None
    carrier: str | None = None
    torque_max: float | None = None
    speed_max: float | None = None
    torque_rate_max: float | None = None
    torque_rms_max: float | None = None
    thermal_time: float | None = None
    torque_speed: tuple[tuple[float, float], ...] = ()
    cogging: FourierSum | None = None
    torque_ripple: FourierSum | None = None
    encoder_error: FourierSum | None = None  # [rad]: the encoder shows q_m + e(q_m)
    lugre: LuGre | None = None


# The outputs with a rotation, in messages.
OF_ROTATION = (
    'an output of type "tool_pose", or "tool_position_angle" for a rotation about one axis'
)
# Sine of the angle between two directions that are one: vectors of a file have nine decimals.
PARALLEL = 1e-9


@dataclass(frozen=True)
class Output:
    """The output that a reference path prescribes.

    ``type``: ``"tool_position"`` (rows chosen by ``axes``, a subset of "xyz"),
    ``"tool_position_angle"`` (these rows, then the angle of the tool about ``rotation_axis``, see
    `flexgen.dynamics.mechanics.tool_angle`), ``"tool_pose"`` (position and rotation) or
    ``"combination"`` (``y = weights q_a``; a joint output is a combination with one weight of 1).
    Weighted sums may also follow the position and angle of the tool: ``joints`` of the model file,
    or `flexgen.paths.geometry.redundancy`, adds them. The rotation of a pose is last: position,
    sums, rotation. ``unit``: that of the rows. ``rotation_axis``: unit vector in world axes;
    ``reference``: the axis of the tool frame whose direction gives the angle.
    """

    type: str
    axes: str = "xyz"
    weights: Matrix = ()
    unit: str = "m"
    rotation_axis: Vector = ()
    reference: str = "x"

    @property
    def size(self) -> int:
        """Number of scalar outputs n_y."""
        return self.tool_size + len(self.weights) + 3 * self.is_pose

    @property
    def is_pose(self) -> bool:
        """Whether the last three outputs are the rotation of the tool."""
        return self.type == "tool_pose"

    @property
    def is_with_joints(self) -> bool:
        """Whether weighted sums of coordinates follow the position or pose of the tool."""
        return self.type != "combination" and bool(self.weights)

    @property
    def of_tool(self) -> Output:
        """The output without the weighted sums that follow the tool."""
        return replace(self, weights=()) if self.is_with_joints else self

    @property
    def first_turn(self) -> int:
        """Number of outputs before the rotation of a pose."""
        return self.tool_size + len(self.weights)

    @property
    def tool_size(self) -> int:
        """Number of the first outputs that are those of the tool: position, then an angle."""
        return len(self.axes) + self.has_angle

    @property
    def has_angle(self) -> bool:
        """Whether the last output is the angle of the tool about one axis."""
        return self.type == "tool_position_angle"

    def is_tilted_by(self, rotation: Vector) -> bool:
        """Whether a rotation vector (3) has a part across the rotation axis."""
        across = np.cross(rotation, self.rotation_axis)
        return bool(np.linalg.norm(across) > PARALLEL * max(1.0, float(np.linalg.norm(rotation))))

    @property
    def axis_text(self) -> str:
        """The rotation axis as in a file."""
        return f"[{', '.join(f'{x:.6g}' for x in self.rotation_axis)}]"

    @property
    def tool_rows(self) -> tuple[int, ...]:
        """Axes (0 to 2) of the tool's position that are the first outputs; combination: none."""
        return tuple("xyz".index(axis) for axis in self.axes)

    @property
    def target_size(self) -> int:
        """Number of scalars of a target: n_y, or 12 for a pose (position, rotation matrix by
        columns), 12 and the sums between them for a pose with sums.
        """
        return self.size + 6 * self.is_pose


@dataclass(frozen=True)
class UrdfJoint:
    """The joint of a URDF file that a degree of freedom was read from, for exports.

    ``offset`` [rad or m]: its position where a mechanism has it at the zero of the model.
    ``lower``, ``upper`` [rad or m], ``speed_max`` [its unit/s], ``effort`` [N m or N]: those of
    its limits that are numbers of a real joint.
    """

    name: str
    offset: float = 0.0
    lower: float | None = None
    upper: float | None = None
    speed_max: float | None = None
    effort: float | None = None


@dataclass(frozen=True)
class Coordinate:
    """One arm coordinate: name, unit ("rad" or "m"), whether it is actuated, and the element to
    which it belongs.
    """

    name: str
    unit: str
    actuated: bool
    element: str
    dof: Dof | None  # None for the modal coordinate of a beam


def coordinates_of(elements: Sequence[Element]) -> tuple[Coordinate, ...]:
    """The arm coordinates of some elements, in their order."""
    out: list[Coordinate] = []
    for element in elements:
        for dof in (dof for dof in element.dofs if not dof.dependent):
            unit = "rad" if dof.type == "rotation" else "m"
            out.append(Coordinate(dof.name, unit, dof.actuated, element.name, dof))
        if element.beam is not None:
            out += [
                Coordinate(f"{element.name}_{name}", unit, False, element.name, None)
                for name, unit in modal_names(element.beam)
            ]
    return tuple(out)


def kind_of_mode(coordinate: Coordinate) -> str:
    """Bending, torsion or elongation: of the modal coordinate of a beam."""
    ending = coordinate.name.removeprefix(f"{coordinate.element}_")
    if ending.startswith("twist"):
        return "torsion"
    return "elongation" if ending.startswith("x") else "bending"


def modal_names(beam: Beam) -> list[tuple[str, str]]:
    """Endings of the names of a beam's modal coordinates, and their units, in their order:
    bending after bending, torsion, stretch.
    """
    groups = [(bending.direction, "m", bending.modes) for bending in beam.bendings]
    if beam.torsion is not None:
        groups.append(("twist", "rad", beam.torsion.modes))
    if beam.stretch is not None:
        groups.append(("x", "m", beam.stretch.modes))
    return [(f"{kind}{k + 1}", unit) for kind, unit, modes in groups for k in range(modes)]


@checked_result
@dataclass(frozen=True, repr=False)
class RobotModel:
    """A robot as described in a model file, in SI units.

    Examples
    --------
    >>> robot = flexgen.read("elbow")
    >>> robot.dof, [motor.name for motor in robot.motors], robot.move("line").duration
    (4, ['m1', 'm2'], 1.0)
    """

    name: str
    description: str
    source: str
    gravity: Vector
    base: Placement
    elements: tuple[Element, ...]
    motors: tuple[Motor, ...]
    tool: Placement
    payload: Body
    output: Output
    home: Vector  # actuated coordinates
    moves: tuple[Move, ...]
    motor_coupling: str = "simplified"  # or "complete"
    variant: str = ""
    variants: tuple[str, ...] = ()
    file: str = ""
    programs: tuple[Program, ...] = ()
    text: str = ""  # canonical text of the data; caches use its hash
    sensors: tuple[Sensor, ...] = ()
    uncertainty: Tolerances | None = None
    not_measured: tuple[str, ...] = ()  # names of numbers that a calibration left as they were
    servo: Any = None  # ServoTable of flexgen.model.position_servo.keys
    temperature: Any = 20.0  # [deg C], a number; a symbol where it is a run-time parameter
    lines: tuple[Line, ...] = ()  # springs, gas springs, rods and cables between two points
    loops: tuple[Loop, ...] = ()  # frames of two bodies that coincide
    # by the name of the degree of freedom; no part of the data of the robot
    urdf_joints: Mapping[str, UrdfJoint] = field(default_factory=dict, compare=False, repr=False)
    # of `flexgen.read`: what the file and the variant do not have; for new model files
    overrides: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)
    # in which moves of the file are stated; the moves themselves are in world axes
    frames: tuple[WorkFrame, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse names that files, C, XML and pages are not made for; those of moves are checked
        by themselves.
        """
        check_name("model.name", self.name)
        if self.variant:
            check_name("model.variant", self.variant)
        dofs = tuple(dof for element in self.elements for dof in element.dofs)
        named: dict[str, Sequence[Any]] = {
            "element": self.elements,
            "coordinate": dofs,
            "motor": self.motors,
            "sensor": self.sensors,
            "line": self.lines,
            "loop": self.loops,
        }
        for kind, group in named.items():
            for one in group:
                check_name(f"{kind}.name", one.name)

    def __repr__(self) -> str:
        return f"<RobotModel {self.title}: {self._size_text()}>"

    def _repr_html_(self) -> str:
        """The robot as a table, for notebooks."""
        moves = ", ".join(move.name for move in (*self.moves, *self.programs))
        rows = [
            ("description", self.description),
            ("source", " ".join(self.source.split())),
            ("size", self._size_text()),
            ("coordinates", ", ".join(f"{c.name} [{c.unit}]" for c in self.coordinates)),
            (
                "motors",
                ", ".join(
                    f"{motor.name} (drives {' '.join(motor.drives)})" for motor in self.motors
                ),
            ),
            ("output", f"{self.output.type.replace('_', ' ')}, {self.output.size} numbers"),
            ("moves", moves or "none"),
            ("variants", ", ".join(self.variants) or "none"),
        ]
        return table_html(self.title, rows)

    @property
    def not_measured_sentence(self) -> str:
        """The numbers that no measurement determines, in one sentence; empty where there are
        none.
        """
        names = self.not_measured
        if not names:
            return ""
        more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
        verb = "is" if len(names) == 1 else "are"
        value = "value" if len(names) == 1 else "values"
        shown = ", ".join(names[:NAMES_SHOWN])
        return f"{shown}{more} {verb} not measured: {value} of the model file"

    @cached_property
    def parents(self) -> dict[str, str]:
        """The parent of each element, by name: another element, or ``"base"``."""
        before = ["base", *(element.name for element in self.elements)]
        return {
            e.name: e.parent or previous
            for e, previous in zip(self.elements, before, strict=False)
        }

    @property
    def tip(self) -> str:
        """Name of the element that carries the tool and the payload."""
        return (self.tool.element if isinstance(self.tool, Tool) else "") or self.elements[-1].name

    @property
    def branched(self) -> bool:
        """Whether the elements are more than a chain that ends at the tool."""
        return [*self.parents.values(), self.tip] != ["base", *self.parents]

    @property
    def title(self) -> str:
        """Name, with the variant: ``name@variant``."""
        return f"{self.name}@{self.variant}" if self.variant else self.name

    def _size_text(self) -> str:
        counts = f"{self.n_m} motors, {self.n_g} actuated and {self.n_e} non-actuated coordinates"
        return f"{counts}, {self.dof} degrees of freedom"

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The arm coordinates q_a in the order of the elements."""
        return coordinates_of(self.elements)

    @cached_property
    def i_g(self) -> tuple[int, ...]:
        """Indices in q_a of the actuated coordinates."""
        return tuple(i for i, c in enumerate(self.coordinates) if c.actuated)

    @cached_property
    def i_e(self) -> tuple[int, ...]:
        """Indices in q_a of the non-actuated coordinates."""
        return tuple(i for i, c in enumerate(self.coordinates) if not c.actuated)

    @property
    def n_a(self) -> int:
        """Number of arm coordinates, n_g + n_e."""
        return len(self.coordinates)

    @property
    def n_g(self) -> int:
        """Number of actuated arm coordinates."""
        return len(self.i_g)

    @property
    def n_e(self) -> int:
        """Number of non-actuated arm coordinates."""
        return len(self.i_e)

    @property
    def n_m(self) -> int:
        """Number of motors."""
        return len(self.motors)

    @cached_property
    def i_m(self) -> tuple[int, ...]:
        """Indices in q_m of the motors with elastic gears: each of these adds a degree of
        freedom.
        """
        gears = {
            c.name: c.dof.gear
            for c in self.coordinates
            if c.dof is not None and c.dof.gear is not None
        }
        return tuple(j for j, motor in enumerate(self.motors) if not gears[motor.drives[0]].rigid)

    @property
    def dof(self) -> int:
        """Number of degrees of freedom: n_g + n_e + the number of motors with elastic gears."""
        return self.n_a + len(self.i_m)

    def inversion_obstacle(self, any_coupling: bool = False) -> str | None:
        """The reason why the inverse dynamics of the model cannot be reduced to its output, or
        None.

        Parameters
        ----------
        any_coupling : bool
            Allow complete motor coupling, too: the full equations of motion are solved.

        Returns
        -------
        str or None
            A sentence without full stop for an error message: what the model has and what is
            expected.
        """
        if self.output.size != self.n_m:
            counts = f"outputs {self.output.size}, motors {self.n_m}"
            fitting = ""
            if self.output.type == "tool_pose" and self.n_m < self.output.size:
                fitting = (
                    ', such as an output of type "tool_position_angle", the position of the tool '
                    'and its rotation about one axis, or "joint"'
                )
            return (
                f"model {self.name}: given {counts}, expected as many outputs as motors{fitting}"
            )
        if self.motor_coupling != "simplified" and not any_coupling:
            return (
                f"model {self.name}: given motor_coupling {self.motor_coupling!r}, expected "
                "'simplified'"
            )
        return None

    @cached_property
    def eta(self) -> np.ndarray:
        """Gear-ratio matrix, ``q_m = eta q_g`` for rigid gears, shape (n_m, n_g), possibly
        non-diagonal.
        """
        column = {self.coordinates[i].name: k for k, i in enumerate(self.i_g)}
        eta = np.zeros((self.n_m, self.n_g))
        for j, motor in enumerate(self.motors):
            for name, ratio in zip(motor.drives, motor.ratio, strict=True):
                eta[j, column[name]] = ratio
        eta.setflags(write=False)
        return eta

    @checked_types(own=("name",))
    def move(self, name: str | None = None) -> Move:
        """The move or program with this name (None: the first one); ArgumentError if there is
        none.
        """
        for move in (*self.moves, *self.programs):
            if name is None or move.name == name:
                return move
        raise ArgumentError(
            unknown_move(self.name, [move.name for move in (*self.moves, *self.programs)], name)
        )
