"""The nouns of what a robot is asked to do: moves, and programs of moves; frozen data, no computation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

Vector = tuple[float, ...]
Matrix = tuple[tuple[float, ...], ...]

NO_TURN: Vector = (0.0, 0.0, 0.0)
DEGREES = (5, 7, 9, 11)  # of splines through samples
RADIUS = 0.25  # m: at this distance from the tool point a turn of the tool counts as travel


@dataclass(frozen=True)
class Where:
    """Place of a table: the file as the user named it, its line and dotted path, and the lines of its keys."""

    file: str
    line: int
    key: str
    lines: tuple[tuple[str, int], ...] = ()

    def found(self, key: str) -> tuple[str, int]:
        """Dotted path and line of a key, with the unit that it has in the file; of the table where it is missing."""
        lines = dict(self.lines)
        for name in (key, f"{key}_rad", f"{key}_deg"):
            if name in lines:
                return f"{self.key}.{name}", lines[name]
        return f"{self.key}.{key}", self.line


@dataclass(frozen=True)
class MoveJ:
    """Straight line in the actuated coordinates to ``end`` [rad or m].

    ``speed`` [rad/s or m/s] of the fastest coordinate (None: that of the program). ``zone`` [rad or m]: from where on
    the corner at its end is rounded, measured in the coordinate that moves farthest; 0: stop. ``pause`` [s] at its end.
    """

    end: Vector
    speed: float | None = None
    zone: float = 0.0
    pause: float = 0.0
    where: Where | None = field(default=None, compare=False, repr=False)
    space: ClassVar[str] = "joint"


@dataclass(frozen=True)
class MoveL:
    """Straight line of the tool by ``displacement``, or to ``position`` [m, world axes].

    It turns by the rotation vector ``rotation`` [rad, world axes], or to ``orientation`` (a rotation matrix), about one
    axis, in step with the position. ``speed`` [m/s] (None: that of the program or move). ``zone`` [m]: distance to its
    end from which on the corner there is rounded; 0: stop. ``pause`` [s] at its end.
    """

    displacement: Vector = ()
    position: Vector = ()
    rotation: Vector = NO_TURN
    orientation: Matrix = ()
    speed: float | None = None
    zone: float = 0.0
    pause: float = 0.0
    where: Where | None = field(default=None, compare=False, repr=False)
    space: ClassVar[str] = "tool"


@dataclass(frozen=True)
class MoveC(MoveL):
    """Arc of the tool through ``via``; the rest as for `MoveL`.

    ``via`` [m, world axes] counts from the same origin as the end: from where the move starts with ``displacement``,
    from the world's origin with ``position``.
    """

    via: Vector = ()


Step = MoveJ | MoveL


@dataclass(frozen=True)
class Move:
    """A named reference move, rest to rest.

    ``type``:

    * ``"tool_line"``: straight line of the tool by ``displacement`` [m, world axes] with a rotation by the vector
      ``rotation`` [rad, axis times angle, world axes] from the tool's pose at ``start``;
    * ``"tool_circle"``: arc of the tool by ``angle`` [rad] about the ``axis`` (world axes) through ``center`` [m, from
      the tool's position at the start, world axes]; ``rotation`` as above. See `circle_through` for an arc through
      points;
    * ``"tool_polyline"``: ``legs``, straight lines and arcs (`MoveL`, `MoveC`) one after the other, with corners
      rounded within the ``zone`` of each;
    * ``"sampled"``: through the samples in ``file``, joined by a spline of ``degree``; ``start`` is only a guess for
      the inverse kinematics, not needed where the file has joints;
    * ``"joint"``: from ``start`` to ``end`` in the actuated coordinates;
    * ``"output_line"``: the outputs move by ``displacement`` [their unit].

    ``start`` and ``end`` are actuated coordinates [rad or m]. Time: either ``duration`` [s] and ``smoothness`` k, a
    polynomial law with k continuous derivatives, all zero at both ends; or ``profile``, bounds on speed, acceleration,
    jerk, snap, ... along the path [m/s^j for tools, else the unit of the coordinates], with ``duration`` 0: it is
    computed, so that the joints keep their limits too. Then ``smoothness`` 0 means trapezoids of the degree of the last
    bound (two bounds: of speed, three: of acceleration, ...), another k a polynomial. A turn of the tool counts as
    travel at the distance ``radius`` [m].
    """

    name: str
    type: str
    start: Vector
    duration: float
    smoothness: int
    displacement: Vector = ()
    rotation: Vector = NO_TURN
    end: Vector = ()
    center: Vector = ()
    axis: Vector = ()
    angle: float = 0.0
    legs: tuple[MoveL, ...] = ()
    file: str = ""
    degree: int = 7
    profile: Vector = ()
    radius: float = RADIUS
    where: Where | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, kw_only=True)
class Program(Move):
    """A list of moves that is one move: ``steps`` (`MoveJ`, `MoveL`, `MoveC`) from the posture ``start``.

    ``profile`` [m/s^j] bounds the steps of the tool, ``joint_profile`` [rad/s^j or m/s^j] those of the joints; both as
    for `Move`, ``smoothness`` too. A step without ``zone`` ends at rest; others flow into the next one, which must be
    of the same space: joints or tool.
    """

    type: str = "program"
    start: Vector
    duration: float = 0.0
    smoothness: int = 0
    steps: tuple[Step, ...] = ()
    joint_profile: Vector = ()
