"""Data classes of tasks: moves, and programs of moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, suggestion
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.tables import Where as Where

Vector = Sequence[float]
Matrix = tuple[tuple[float, ...], ...]

NO_ROTATION: Vector = (0.0, 0.0, 0.0)
DEGREES = (5, 7, 9, 11)  # of a spline through samples
LONGEST_NAME = 100
TOOL_MOVES = ("tool_line", "tool_circle", "tool_polyline")  # that a moving frame can carry
ORTHOGONAL = 1e-9  # largest error of R R' = 1 of a rotation matrix
RADIUS = 0.25  # m: a rotation by an angle is counted as a path length of RADIUS times the angle


@checked_class
@dataclass(frozen=True)
class PoseTarget:
    """A pose of the tool as the end of a joint move, for arms with six actuated joints.

    ``position`` [m] and ``orientation`` (a rotation matrix) in world axes. ``configuration``:
    signs (+1, -1) of shoulder, elbow and wrist of the joints that reach it, as the flags of
    `flexgen.kinematics`; empty: there must be only one within the limits of the joints. ``turns``:
    whole turns of each actuated coordinate beyond an angle within half a turn of zero; empty: the
    turns, within the limits, that are closest to the start of the move.

    Examples
    --------
    >>> import numpy as np
    >>> above = flexgen.PoseTarget((0.5, 0.6, 1.2), np.eye(3), configuration=(1, -1, 1))  # m
    >>> flexgen.MoveJ(target=above).target.configuration
    (1, -1, 1)
    """

    position: Vector
    orientation: Matrix
    configuration: tuple[int, ...] = ()
    turns: tuple[int, ...] = ()

    def __post_init__(self) -> None:  # lists and arrays of whole numbers too
        for name in ("configuration", "turns"):
            object.__setattr__(
                self, name, tuple(int(x) if x == int(x) else x for x in getattr(self, name))
            )


@checked_class
@dataclass(frozen=True)
class MoveJ:
    """Straight line in the actuated coordinates to ``end`` [rad or m], or to the pose ``target``
    of the tool.

    ``speed`` [rad/s or m/s] is that of the fastest coordinate (None: that of the program).
    ``zone`` [rad or m]: distance to the end at which the rounded corner begins, measured in the
    coordinate that moves farthest; 0: stop. ``pause`` [s]: time at rest at the end.

    Examples
    --------
    >>> # rad, s
    >>> steps = flexgen.MoveJ((0.4, 0.0), zone=0.05), flexgen.MoveJ((0.4, 0.3), pause=0.2)
    >>> joints = (1.0, 5.0, 50.0, 500.0)  # speed, acceleration and two more derivatives
    >>> there = flexgen.Program(
    ...     "there", start=(0.0, 0.0), smoothness=5, steps=steps, joint_profile=joints
    ... )
    >>> f"{flexgen.plan('elbow', there).duration:.3f} s"
    '1.996 s'
    """

    end: Vector = ()
    speed: float | None = None
    zone: float = 0.0
    pause: float = 0.0
    where: Where | None = field(default=None, compare=False, repr=False)
    target: PoseTarget | None = None
    space: ClassVar[str] = "joint"


@checked_class
@dataclass(frozen=True)
class MoveL:
    """Straight line of the tool by ``displacement``, or to ``position`` [m, world axes].

    The tool rotates by the rotation vector ``rotation`` [rad, world axes], or to ``orientation``
    (a rotation matrix), about a fixed axis, in proportion to the path length. ``speed`` [m/s]
    (None: that of the program or move). ``zone`` [m]: distance to the end at which the rounded
    corner begins; 0: the robot stops. ``pause`` [s]: time at rest at the end. ``configuration``:
    signs of shoulder, elbow and wrist that the joints must have at the end (a line cannot change
    them); empty: any.

    Examples
    --------
    >>> legs = (flexgen.MoveL((-0.2, 0.0, 0.0), zone=0.05), flexgen.MoveL((0.0, 0.0, -0.2)))  # m
    >>> start, profile = (0.5, -0.3), (0.5, 2.0, 20.0, 200.0)
    >>> corner = flexgen.Move("corner", "tool_polyline", start, 0.0, 5, legs=legs, profile=profile)
    >>> f"{flexgen.plan('elbow', corner).duration:.3f} s"
    '2.678 s'
    """

    displacement: Vector = ()
    position: Vector = ()
    rotation: Vector = NO_ROTATION
    orientation: Matrix = ()
    speed: float | None = None
    zone: float = 0.0
    pause: float = 0.0
    where: Where | None = field(default=None, compare=False, repr=False)
    configuration: tuple[int, ...] = ()
    space: ClassVar[str] = "tool"


@checked_class
@dataclass(frozen=True)
class MoveC(MoveL):
    """Arc of the tool through ``via``; all other fields as in `MoveL`.

    ``via`` [m, world axes] has the same origin as the end point: the start of the move if
    ``displacement`` is given, the world origin if ``position`` is given.

    Examples
    --------
    >>> legs = (flexgen.MoveC((-0.2, 0.0, -0.2), via=(-0.15, 0.0, -0.05)),)  # m
    >>> start, profile = (0.5, -0.3), (0.5, 2.0, 20.0, 200.0)
    >>> arc = flexgen.Move("arc", "tool_polyline", start, 0.0, 5, legs=legs, profile=profile)
    >>> f"{flexgen.plan('elbow', arc).duration:.3f} s"
    '1.282 s'
    """

    via: Vector = ()


Step = MoveJ | MoveL


@checked_class
@dataclass(frozen=True)
class Carrier:
    """Motion of the frame of a workpiece during a move of the tool, in proportion to the path: it
    is moved by ``displacement`` [m] and turned by the rotation vector ``rotation`` [rad] about
    ``origin`` [m], all in world axes.

    The path is stated as if the frame stayed where it is at the start.

    Examples
    --------
    >>> turn = flexgen.Carrier(origin=(0.5, 0.0, 0.0), rotation=(0.0, 0.2, 0.0))
    >>> start, way = (0.5, -0.3), (0.1, 0.0, 0.2)  # rad, m
    >>> seam = flexgen.Move("seam", "tool_line", start, 1.0, 5, displacement=way, carrier=turn)
    >>> flexgen.plan("elbow", seam).duration
    1.0
    """

    origin: Vector = (0.0, 0.0, 0.0)
    displacement: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = NO_ROTATION


@checked_class
@dataclass(frozen=True)
class Posture:
    """Rule by which a move of the tool chooses the joints that the tool leaves free.

    They change as little as possible, in the sense of the sum of their squared changes, each times
    its weight. ``joints``: those with a motion of their own, which change by ``change`` [rad or m]
    during the move, in proportion to the path; 0: fixed. ``weighted``, ``weights`` (> 0): joints
    whose weight is not 1, such as a track in m among angles in rad.

    Examples
    --------
    >>> flexgen.Posture(("q3",), (0.0,), ("rail",), (25.0,)).text
    'q3 fixed, weight of rail 25'
    """

    joints: tuple[str, ...] = ()
    change: Vector = ()
    weighted: tuple[str, ...] = ()
    weights: Vector = ()

    def __post_init__(self) -> None:
        for names, values in ((self.joints, self.change), (self.weighted, self.weights)):
            if len(names) != len(values):
                raise ArgumentError(
                    f"posture: given {len(values)} numbers for {len(names)} joints, expected one "
                    "for each"
                )

    @classmethod
    def hold(cls, joint: str) -> Posture:
        """The posture with a joint that keeps its value."""
        return cls((joint,), (0.0,))

    @property
    def text(self) -> str:
        """The rule in words."""
        parts = [
            f"{name} changes by {change:g}" if change else f"{name} fixed"
            for name, change in zip(self.joints, self.change, strict=True)
        ]
        parts += [
            f"weight of {name} {weight:g}"
            for name, weight in zip(self.weighted, self.weights, strict=True)
        ]
        return ", ".join(parts)


@checked_class
@dataclass(frozen=True)
class Move:
    """A named reference move that starts and ends at rest.

    ``type``:

    * ``"tool_line"``: straight line of the tool by ``displacement`` [m, world axes] with a
      rotation by the vector ``rotation`` [rad, axis times angle, world axes] from the tool's pose
      at ``start``;
    * ``"tool_circle"``: arc of the tool by ``angle`` [rad] about the ``axis`` (world axes) through
      ``center`` [m, from the tool's position at the start, world axes]; ``rotation`` as above. See
      `circle_through` for an arc through points;
    * ``"tool_polyline"``: ``legs``, a sequence of straight lines and arcs (`MoveL`, `MoveC`), with
      corners rounded within the ``zone`` of each leg;
    * ``"sampled"``: a spline of ``degree`` through the samples in ``file``, or with ``smooth`` > 0
      a smooth spline that is at most so far from them [rad or m, as the columns]; ``start`` is
      only the initial guess of the inverse kinematics, and not needed if the file contains joint
      positions;
    * ``"joint"``: from ``start`` to ``end`` in the actuated coordinates [rad or m], or to the pose
      ``target``;
    * ``"output_line"``: the outputs move by ``displacement`` [their unit]; ``start`` is that of
      the joints.

    Time: either ``duration`` [s] and ``smoothness`` k, a polynomial time law with k continuous
    derivatives, all zero at both ends; or ``profile``, bounds on speed, acceleration, jerk,
    snap, ... along the path [m/s^j for the tool, else the unit of the coordinates], with
    ``duration`` 0: the duration is computed such that the limits of the joints hold too. With a
    profile, ``smoothness`` 0 means that the derivative before the last bounded one is trapezoidal
    (two bounds: the speed, three: the acceleration, ...); another value means polynomial changes
    of speed. A rotation of the tool by an angle is counted as a path length of ``radius`` [m]
    times the angle. Or ``duration`` and ``timing``, see
    `flexgen.paths.timing.time_laws.SplineLaw`. ``carrier``: motion of the workpiece during a move
    of the tool with a ``duration``. ``posture``: of a robot with more motors than the tool has
    outputs, how the other joints are chosen; None: least change. ``frame``: of an element of the
    robot, such as the table of a positioner, in which a move of the tool is stated and with which
    it moves. ``fixed_tool``: the frame of a tool that stands in the room, or on an element, while
    the robot carries the workpiece: the path is that of this tool, in the axes of the workpiece.

    Examples
    --------
    >>> # rad, s
    >>> lift = flexgen.Move(
    ...     "lift", "joint", start=(0.0, 0.0), end=(0.5, 0.0), duration=0.8, smoothness=5
    ... )
    >>> print(flexgen.solve("elbow", lift).status)
    solved
    """

    name: str
    type: str
    start: Vector
    duration: float
    smoothness: int
    displacement: Vector = ()
    rotation: Vector = NO_ROTATION
    end: Vector = ()
    center: Vector = ()
    axis: Vector = ()
    angle: float = 0.0
    legs: tuple[MoveL, ...] = ()
    file: str = ""
    degree: int = 7
    profile: Vector = ()
    radius: float = RADIUS
    timing: Vector = ()
    target: PoseTarget | None = None
    where: Where | None = field(default=None, compare=False, repr=False)
    smooth: float = 0.0
    carrier: Carrier | None = None
    posture: Posture | None = None
    frame: WorkFrame | None = None
    fixed_tool: WorkFrame | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if not (
            isinstance(self.name, str)
            and 0 < len(self.name) <= LONGEST_NAME
            and self.name.isprintable()
        ):
            expected = f"a printable text of 1 to {LONGEST_NAME} characters"
            raise ArgumentError(f"move.name: given {show_value(self.name)}, expected {expected}")


@checked_class
@dataclass(frozen=True, kw_only=True)
class Program(Move):
    """A sequence of ``steps`` (`MoveJ`, `MoveL`, `MoveC`) that starts at the joint position
    ``start``.

    ``profile`` [m/s^j] bounds the steps of the tool, ``joint_profile`` [rad/s^j or m/s^j] those of
    the joints; both and ``smoothness`` as in `Move`. A step without ``zone`` ends at rest. A step
    with ``zone`` continues into the next one without a stop; both must be of the same space,
    joints or tool. ``laws``: for each motion from rest to rest its duration [s] and the
    coefficients of a `flexgen.paths.timing.time_laws.SplineLaw`, in place of the profiles.

    Examples
    --------
    >>> steps = flexgen.MoveJ((0.4, 0.0)), flexgen.MoveJ((0.4, 0.3), pause=0.2)  # rad, s
    >>> joints = (1.0, 5.0, 50.0, 500.0)  # speed, acceleration and two more derivatives
    >>> there = flexgen.Program(
    ...     "there", start=(0.0, 0.0), smoothness=5, steps=steps, joint_profile=joints
    ... )
    >>> len(flexgen.plan("elbow", there).segments)
    2
    """

    type: str = "program"
    start: Vector
    duration: float = 0.0
    smoothness: int = 0
    steps: tuple[Step, ...] = ()
    joint_profile: Vector = ()
    laws: tuple[Vector, ...] = ()

    __repr__ = short_repr


def check_name(what: str, text: object) -> None:
    """ArgumentError where ``text`` may not be a name in a model file."""
    problem = identifier_problem(text) if isinstance(text, str) else "a text"
    if problem:
        raise ArgumentError(f"{what}: given {show_value(text)}, expected {problem}")


def unknown_move(model: str, names: Sequence[str], given: Any) -> str:
    """The message where a model has no move of the given name."""
    if not names:
        return (
            f"move: given {show_value(given)}, but model {model} has no moves; write [[move]] "
            "tables into a TOML file and give it with --moves FILE (in Python "
            "flexgen.read_moves(FILE, model) or a flexgen.Move), or write an overlay of the "
            "URDF file with moves; models/README.md describes both"
        )
    hint = suggestion(str(given), names)
    return (
        f"move: given {show_value(given)}, expected one of model {model}: {', '.join(names)}{hint}"
    )


@checked_class
@dataclass(frozen=True)
class WorkFrame:
    """A frame of a workpiece, a fixture or a table, in which moves are stated: ``p_world =
    position + rotation p``.

    ``position`` [m] and ``rotation`` (a rotation matrix) in world axes; with ``element``, from the
    tip of this element of the robot, which carries the frame.

    Examples
    --------
    >>> turned = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    >>> table = flexgen.WorkFrame("table", (0.8, 0.2, 0.1), turned)
    >>> line = flexgen.Move("line", "tool_line", (0.5, -0.3), 1.0, 5, displacement=(0.1, 0.0, 0.2))
    >>> table.place(line).displacement
    (0.0, 0.1, 0.2)
    """

    name: str
    position: Vector = (0.0, 0.0, 0.0)
    rotation: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    element: str = ""

    def __post_init__(self) -> None:
        R = np.array(self.rotation, dtype=float)
        is_rotation = R.shape == (3, 3) and np.allclose(R @ R.T, np.eye(3), atol=ORTHOGONAL)
        if not is_rotation or np.linalg.det(R) < 0.0:
            raise ArgumentError(
                f"rotation of frame {self.name}: given {show_value(self.rotation)}, expected a "
                "rotation matrix (3, 3)"
            )

    def place(self, move: Move) -> Move:
        """A move that is stated in this frame, in world axes; of the frame of an element, the move
        with this frame, which is placed when the move is planned.

        Parameters
        ----------
        move : Move
            Of the tool, of the joints to a pose of the tool, or a program of these. Its start
            stays, as it is one of the joints.

        Returns
        -------
        Move

        Raises
        ------
        ArgumentError
            The move has samples, or is one of outputs that are not the tool.
        """
        if move.type in ("sampled", "output_line"):
            raise ArgumentError(
                f"move {move.name}: given the type {move.type}, expected a move of the tool or "
                f"the joints for frame {self.name}"
            )
        if self.element:
            if move.type not in TOOL_MOVES or move.carrier is not None:
                given = f"the type {move.type}" if move.carrier is None else "a carrier"
                raise ArgumentError(
                    f"move {move.name}: given {given}, expected {', '.join(TOOL_MOVES)} without a "
                    f"carrier for frame {self.name}, which element {self.element} carries"
                )
            return replace(move, frame=self)
        changed: dict[str, Any] = {
            name: self._turn(getattr(move, name))
            for name in ("displacement", "rotation", "center", "axis")
        }
        changed["legs"] = tuple(self.place_step(leg) for leg in move.legs)
        changed["target"] = None if move.target is None else self._place_target(move.target)
        if move.carrier is not None:
            changed["carrier"] = Carrier(
                self._shift(move.carrier.origin),
                self._turn(move.carrier.displacement),
                self._turn(move.carrier.rotation),
            )
        if isinstance(move, Program):
            changed["steps"] = tuple(self.place_step(step) for step in move.steps)
        return replace(move, **changed)

    def place_step(self, step: Any) -> Any:
        """A step of a program, or a leg of a move, that is stated in this frame, in world axes.

        Parameters
        ----------
        step : MoveJ, MoveL or MoveC

        Returns
        -------
        MoveJ, MoveL or MoveC
        """
        if isinstance(step, MoveJ):
            target = None if step.target is None else self._place_target(step.target)
            return replace(step, target=target)
        changed: dict[str, Any] = {
            "displacement": self._turn(step.displacement),
            "rotation": self._turn(step.rotation),
            "position": self._shift(step.position),
            "orientation": self._orient(step.orientation),
        }
        if isinstance(step, MoveC):
            # the origin of the point is that of the end
            own = self._shift if len(step.position) else self._turn
            changed["via"] = own(step.via)
        return replace(step, **changed)

    def _turn(self, vector: Vector) -> Vector:
        """A vector in world axes; one that is not given stays."""
        if not len(vector):
            return vector
        return tuple((np.array(self.rotation) @ np.array(vector, dtype=float)).tolist())

    def _shift(self, point: Vector) -> Vector:
        """A point in the world [m]; one that is not given stays."""
        if not len(point):
            return point
        return tuple((np.array(self.position) + self._turn(point)).tolist())

    def _orient(self, orientation: Matrix) -> Matrix:
        """An orientation in world axes; one that is not given stays."""
        if not len(orientation):
            return orientation
        turned = np.array(self.rotation) @ np.array(orientation, dtype=float)
        return tuple(map(tuple, turned.tolist()))

    def _place_target(self, target: PoseTarget) -> PoseTarget:
        """A pose of the tool in the world."""
        return replace(
            target,
            position=self._shift(target.position),
            orientation=self._orient(target.orientation),
        )
