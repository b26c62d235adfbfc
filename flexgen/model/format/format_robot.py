"""Rows of the tables that describe the robot: placements, bodies, springs, degrees of freedom,
beams, motors.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from flexgen.base.registry import names
from flexgen.base.spec.fourier import fourier_sum
from flexgen.base.spec.keys import (
    REQUIRED,
    Context,
    Format,
    Key,
    Kinds,
    Type,
    angle,
    by_name,
    choice,
    direction,
    flag,
    name,
    number,
    one_or_more,
    sub,
    vector,
)
from flexgen.base.spec.parts import GearFriction
from flexgen.base.spec.tables import Table
from flexgen.model.elements import (
    FRICTION_LAWS,
    IDENTITY,
    NO_FRICTION,
    ZERO,
    BacklashSpring,
    Body,
    CubicSpring,
    Dof,
    Friction,
    Gear,
    LinearSpring,
    Matrix,
    PiecewiseSpring,
    Placement,
    SmoothSpring,
    Vector,
)

HARMONICS = 6  # of a counterbalance
BOUC_WEN = "bouc_wen"  # the law of hysteresis where none is named
ELEMENTS = 8  # of the hysteresis of a gear
COORDINATES_MAX = 64  # of the arm; the effort to derive and compile grows faster than their number
_INERTIA_TOLERANCE = 1e-9  # relative to the largest principal moment
_ROUNDING_ERROR = 1e-15  # of a sine or cosine
_ROTATION_TOLERANCE = 1e-9  # of a rotation matrix: its columns are orthogonal and of length 1


# --- placements ----------------------------------------------------------------------------------


def _snap(x: float) -> float:
    """The number, rounded to 0, 1 or -1 if it is equal to it within rounding errors."""
    for exact in (0.0, 1.0, -1.0):
        if abs(x - exact) < _ROUNDING_ERROR:
            return exact
    return x


def _cos_sin(angle: float, degrees: bool) -> tuple[float, float]:
    """Cosine and sine of an angle, exact at multiples of 90 degrees."""
    if not degrees:
        return _snap(math.cos(angle)), _snap(math.sin(angle))
    turns = round(angle / 90.0)
    remainder = math.radians(angle - 90.0 * turns)
    c = math.cos(remainder)
    s = math.sin(remainder)
    return ((c, s), (-s, c), (-c, -s), (s, -c))[turns % 4]


def rotation_matrix(rpy: tuple[float, ...], degrees: bool) -> Matrix:
    """Rotation matrix ``Rz(yaw) Ry(pitch) Rx(roll)``, exact at multiples of 90 degrees."""
    (cr, sr), (cp, sp), (cy, sy) = (_cos_sin(angle, degrees) for angle in rpy)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return tuple(tuple(_snap(x) for x in row) for row in rows)


def _read_rpy(table: Table, key: Key, here: Context) -> Matrix:
    full = table.unit_key(key.name)
    assert full is not None
    return rotation_matrix(table.vector(full, 3, what="roll, pitch, yaw"), full.endswith("_deg"))


def _read_rotation(table: Table, key: Key, here: Context) -> Matrix:
    """A rotation matrix (3, 3), given row by row; an error with rpy in addition, or where it is
    not orthogonal.
    """
    other = table.unit_key("rpy", required=False)
    if other is not None:
        raise table.fail("rotation", "one of the two", f"both {other} and rotation")
    matrix = np.array(table.vector("rotation", 9, what="a rotation matrix, row by row")).reshape(
        3, 3
    )
    off = np.abs(matrix.T @ matrix - np.eye(3)).max()
    if not off <= _ROTATION_TOLERANCE or np.linalg.det(matrix) < 0.0:
        raise table.fail(
            "rotation", "a rotation matrix: orthogonal columns of length 1, determinant 1"
        )
    return tuple(map(tuple, matrix.tolist()))


RPY = Type(_read_rpy, vector(3).schema, angle=True)
_ROTATION = Type(
    _read_rotation, vector(9).schema, write=lambda matrix: [x for row in matrix for x in row]
)


def _placement(position: Vector, rotation: Matrix, rpy: Matrix | None) -> Placement:
    return Placement(position, rotation if rpy is None else rpy)


PLACEMENT = Format(
    "constant pose",
    (
        Key("position", vector(3), "position", "m", ZERO),
        Key("rotation", _ROTATION, "rotation matrix, row by row", default=IDENTITY),
        Key("rpy", RPY, "rotations about the fixed x, y, z axes, in this order", "rad", None),
    ),
    make=_placement,
    definition="placement",
)


# --- bodies --------------------------------------------------------------------------------------


def _read_inertia(table: Table, key: Key, here: Context) -> Matrix:
    entries = table.vector(key.name, (3, 6), what="xx, yy, zz, optionally xy, yz, xz")
    xx, yy, zz, xy, yz, xz = entries if len(entries) == 6 else (*entries, 0.0, 0.0, 0.0)
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


def _write_inertia(inertia: Matrix) -> list[float]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    return [xx, yy, zz, xy, yz, xz]


def _check_inertia(table: Table, here: Context) -> None:
    """Raise an error for a tensor that no body has."""
    inertia = np.array(here.values["inertia"])
    largest = np.abs(inertia).max()
    if largest == 0.0:
        return
    if here.values["mass"] == 0.0:
        raise table.fail("inertia", "no inertia where the mass is 0")
    low, middle, high = np.linalg.eigvalsh(inertia / largest).tolist()
    given = (
        "a tensor with principal moments "
        f"{', '.join(f'{x * largest:.6g}' for x in (low, middle, high))}"
    )
    if low < -_INERTIA_TOLERANCE:
        raise table.fail("inertia", "principal moments >= 0", given)
    if not here.values["inertia_reduced"] and low + middle < high * (1.0 - _INERTIA_TOLERANCE):
        expected = (
            "no principal moment larger than the sum of the other two (or inertia_reduced = true)"
        )
        raise table.fail("inertia", expected, given)


def _default_com(table: Table, here: Context) -> Vector:
    """The center of mass of a body that states none: that of the payload is at the tool."""
    com: Vector = here.of_file("tool").position if table.key == "payload" else ZERO
    return com


def _body(inertia_reduced: bool, **values: Any) -> Body:
    return Body(**values)


_INERTIA = Type(_read_inertia, vector(3, 6).schema, write=_write_inertia)
_TENSOR = "inertia about the center of mass []: xx, yy, zz, optionally xy, yz, xz"
REDUCED = "the largest principal moment may exceed the sum of the others"
BODY = Format(
    "rigid body",
    (
        Key("mass", number(least=0.0), "mass", "kg"),
        Key("inertia", _INERTIA, _TENSOR, "kg m^2", Body().inertia),
        Key(
            "inertia_reduced",
            flag(),
            f"{REDUCED} (regrouped tensors)",
            default=False,
            check=_check_inertia,
        ),
        Key("com", vector(3), "center of mass in the body frame", "m", _default_com),
        Key(
            "rotational_drag",
            number(least=0.0),
            "damping of the absolute rotation",
            "N m s/rad",
            0.0,
        ),
    ),
    make=_body,
    definition="body",
)


# --- springs, friction, gears --------------------------------------------------------------------


def _either(unit: str) -> str:
    """A unit of a rotation, and that of a translation where it is another one."""
    linear = unit.replace("N m", "N").replace("rad", "m")
    return unit if linear == unit else f"{unit} or {linear}"


DAMPING = Key(
    "damping", number(least=0.0), "damping in parallel with the spring", _either("N m s/rad"), 0.0
)
_STIFFNESS = Key("stiffness", number(above=0.0), "stiffness", _either("N m/rad"))
_TWO = (
    Key("low", number(above=0.0), "stiffness at small deflections", _either("N m/rad")),
    Key("high", number(above=0.0), "stiffness at large deflections", _either("N m/rad")),
    Key(
        "break_at",
        number(above=0.0),
        "deflection at which the stiffness is the high one",
        _either("rad"),
    ),
)
_CUBIC = Key("cubic", number(least=0.0), "cubic coefficient", _either("N m/rad^3"))
_GAP = Key("gap", number(least=0.0), "half width of the dead band", _either("rad"))
_SMOOTHING = Key("smoothing", number(above=0.0), "width of the rounded corners", _either("rad"))
_SPRINGS = {
    "linear": Format("torque = stiffness d", (_STIFFNESS,), LinearSpring),
    "cubic": Format("torque = stiffness d + cubic d^3", (_STIFFNESS, _CUBIC), CubicSpring),
    "smooth": Format(
        "stiffness low at zero, growing to high at the deflection break_at", _TWO, SmoothSpring
    ),
    "piecewise": Format(
        "stiffness low up to the deflection break_at, high beyond", _TWO, PiecewiseSpring
    ),
    "backlash": Format(
        "dead band of half width gap, with rounded corners",
        (_STIFFNESS, _GAP, _SMOOTHING),
        BacklashSpring,
    ),
}
_SOFT = replace(_STIFFNESS, type=number(least=0.0))  # without a gear
SPRING = Kinds("spring with a stiffness > 0", _SPRINGS, strict=False, definition="spring")
JOINT_SPRING = Kinds(
    "spring",
    _SPRINGS | {"linear": replace(_SPRINGS["linear"], keys=(_SOFT,))},
    strict=False,
    definition="joint_spring",
)


def _check_law(law: type[Friction], table: Table, here: Context) -> None:
    """Raise an error for a number of a friction law that needs another one."""
    keys = dataclasses.fields(law)
    for key in keys:
        for needed in key.metadata["needs"].split():
            if here.values[key.name] and not here.values[needed]:
                users = [other.name for other in keys if needed in other.metadata["needs"].split()]
                raise table.fail(needed, f"a number > 0 together with {' or '.join(users)}")


def _law(law: type[Friction]) -> Format:
    """The table of a friction law: its keys are the fields of its class."""
    rows = _numbers(law)
    rows[-1] = replace(rows[-1], check=partial(_check_law, law))
    return Format(law.about, tuple(rows), law)


def _numbers(law: type) -> list[Key]:
    """The keys of the numbers of a law: its fields made by
    `flexgen.model.friction.friction_key`.
    """
    rows = []
    for one in dataclasses.fields(law):
        if about := one.metadata:
            kind = number(least=None if about["signed"] else 0.0, most=about["most"])
            rows.append(Key(one.name, kind, about["doc"], _either(about["unit"]), one.default))
    return rows


class _Laws(Mapping[str, Format]):
    """The tables of all laws, ``own`` of flexgen and a group of entry points, which take time:
    they are asked last.
    """

    def __init__(self, own: Iterable[str], group: str, table: Callable[[str], Format]) -> None:
        self.own = tuple(own)
        self.group = group
        self.table = table

    def __getitem__(self, kind: str) -> Format:
        return self.table(kind)

    def __iter__(self) -> Iterator[str]:
        yield from self.own
        yield from (name for name in names(self.group) if name not in self.own)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def friction() -> Kinds:
    """The friction laws."""
    from flexgen.model.friction import find_law

    def table(kind: str) -> Format:
        return _law(FRICTION_LAWS.get(kind) or find_law("frictions", kind, Friction, "torque"))

    laws = _Laws(FRICTION_LAWS, "frictions", table)
    return Kinds("friction law", laws, default=laws.own[0], strict=False, definition="friction")


def hysteresis() -> Kinds:
    """The hysteresis of a gear."""
    from flexgen.base.spec.memory import HYSTERESIS, HysteresisLaw
    from flexgen.model.friction import find_law

    def table(kind: str) -> Format:
        if kind == BOUC_WEN:
            return HYSTERESIS
        law = find_law("hysteresis", kind, HysteresisLaw, "slope")
        sizes = tuple(HYSTERESIS[one.name] for one in dataclasses.fields(HysteresisLaw))
        return Format(law.__doc__ or kind, (*sizes, *_numbers(law)), law)

    laws = _Laws([BOUC_WEN], "hysteresis", table)
    return Kinds("hysteresis law", laws, default=BOUC_WEN, strict=False, definition="hysteresis")


def lugre() -> Format:
    """The friction with a state of a motor."""
    from flexgen.base.spec.memory import LUGRE

    return LUGRE


ERROR = fourier_sum(_either("rad"), "transmission_error")
COGGING = fourier_sum("N m", "cogging")
RIPPLE = fourier_sum("", "torque_ripple")
ENCODER_ERROR = fourier_sum("rad", "encoder_error")
_PEAKS = (
    Key("torque_max", number(above=0.0), "limit of the torque, at the joint", "N m or N", None),
    Key(
        "torque_rms_max",
        number(above=0.0),
        "limit of its root mean square over a motion",
        "N m or N",
        None,
    ),
)
_RIGID = Format("no elasticity", _PEAKS, lambda type, **values: Gear(True, **values))
_ELASTIC = Format(
    "a spring between motor and joint",
    (
        Key(
            "side",
            choice("arm", "motor"),
            "the side of the gear to which spring and damping refer",
        ),
        Key("spring", sub(SPRING), "spring of the gear", note="the spring of the elastic gear"),
        DAMPING,
        Key(
            "hysteresis",
            one_or_more(hysteresis, ELEMENTS),
            "parallel to the spring; default: none",
            default=None,
        ),
        Key(
            "transmission_error",
            sub(ERROR),
            "transmission error at the joint, over the motor angle",
            default=None,
        ),
        *_PEAKS,
    ),
    make=lambda type, **values: Gear(False, **values),
)
GEAR = Kinds(
    "gear",
    {"rigid": _RIGID, "elastic": _ELASTIC},
    foreign='type = "elastic", or a rigid gear without {}',
    definition="gear",
    typed=True,
)


# --- degrees of freedom --------------------------------------------------------------------------


def _read_balance(table: Table, here: Context) -> None:
    if not (here.values["sin"] or here.values["cos"]):
        raise table.fail(
            "sin",
            "lists sin and cos of torques of the harmonics 1, 2, ... of the angle [N m], or one",
        )


def _balance(sin: Vector, cos: Vector) -> tuple[tuple[float, float], ...]:
    count = max(len(sin), len(cos))
    padded = (row + (0.0,) * (count - len(row)) for row in (sin, cos))
    return tuple(zip(*padded, strict=True))


_HARMONIC = Key(
    "sin", vector(range(1, HARMONICS + 1)), "torques of sin(k q), k = 1, 2, ...", "N m", ()
)
COUNTERBALANCE = Format(
    "counterbalance: torque on the arm by the angle",
    (
        _HARMONIC,
        replace(
            _HARMONIC, name="cos", doc="torques of cos(k q), k = 1, 2, ...", check=_read_balance
        ),
    ),
    make=_balance,
    take=lambda pairs: dict(zip(("sin", "cos"), zip(*pairs, strict=True), strict=True)),
    definition="counterbalance",
)


_WAYS = (
    "either a gear (actuated), a spring (non-actuated), mimic (a mechanism) or passive (moved by "
    "closed loops)"
)


def _check_dof(table: Table, here: Context) -> None:
    """Raise an error for crossed limits, and for a joint that is not either actuated or
    elastic.
    """
    lower = here.values["lower"]
    upper = here.values["upper"]
    if lower is not None and upper is not None and lower >= upper:
        key = next(key for key in ("lower", "lower_rad", "lower_deg") if key in table)
        raise table.fail(key, "a lower limit below the upper one")
    ways = [key for key in ("gear", "spring", "mimic", "passive") if key in table]
    if len(ways) > 1:
        raise table.fail(ways[1], _WAYS, f"both a {ways[1]} and a {ways[0]}")
    if not ways:
        raise table.fail("gear", _WAYS)
    if "deflection_max" in table and "spring" not in table:
        raise table.fail("deflection_max", "a spring whose deflection it limits")
    if "gear" in table and "damping" in table:
        raise table.fail(
            "damping", "the key damping inside the gear", "damping in addition to a gear"
        )


def limits(kind: Type, unit: str) -> tuple[Key, Key]:
    """Limits of the position of a joint."""
    return Key("lower", kind, "lower limit", unit, None), Key(
        "upper", kind, "upper limit", unit, None
    )


def _check_arm_friction(table: Table, here: Context) -> None:
    if isinstance(here.values["friction"], GearFriction):
        raise table.fail(
            "friction", 'another type of friction: type = "gear" is of motors', '"gear"'
        )


FRICTION = Key(
    "friction",
    sub(friction),
    "friction on the arm side",
    default=NO_FRICTION,
    check=_check_arm_friction,
)
RATES = (
    Key("speed_max", number(above=0.0), "limit of the speed", "rad/s or m/s", None),
    Key(
        "acceleration_max",
        number(above=0.0),
        "limit of the acceleration",
        "rad/s^2 or m/s^2",
        None,
    ),
    Key(
        "deflection_max",
        number(above=0.0),
        "limit of the deflection of a spring",
        "rad or m",
        None,
    ),
)
BALANCE = Key("counterbalance", sub(COUNTERBALANCE), "torque by the angle", default=())


def _check_mimic(table: Table, here: Context) -> None:
    """Raise an error for a mechanism without a coordinate, and for keys that it has not."""
    if "mimic" in table and not here.values["mimic"]:
        raise table.fail("mimic", "a factor for at least one coordinate")
    _check_alone(table, "mimic")


def _check_passive(table: Table, here: Context) -> None:
    """Raise an error for keys that a joint without motor and spring has not."""
    _check_alone(table, "passive")


def _check_near(table: Table, here: Context) -> None:
    """Raise an error where the position of a passive joint is missing."""
    if here.values["near"] is None:
        raise table.fail("near_rad", "near_rad or near_deg")


def _check_alone(table: Table, own: str) -> None:
    """Raise an error for keys of coordinates together with the key ``own`` of other joints."""
    for key in table.entries if own in table else ():
        if key not in ("name", "type", "axis", own):
            raise table.fail(key, f"no {key} together with {own}")


def _read_mimic(table: Table, key: Key, here: Context) -> tuple[tuple[str, float], ...]:
    """Factors by the names of coordinates; these are checked after all elements are read."""
    inner = table.table(key.name)
    assert inner is not None
    return tuple((name, inner.number(name)) for name in inner.entries)


_MIMIC = Type(_read_mimic, by_name(lambda here: []).schema, write=dict)


def _dof(kind: str, ends: tuple[Key, Key], unit: str, *more: Key) -> Format:
    """The format of a degree of freedom of a kind, "rotation" or "translation", with the keys of
    its ends, the ``unit`` of its damping, and ``more`` keys.
    """
    gear = "gear between the coordinate and its motor: the coordinate is actuated"
    spring = "spring instead of a gear: the coordinate has no motor"
    mimic = "moved by a mechanism, sum of factor times coordinates, no gear or spring"
    passive = "moved by closed loops, no gear or spring"
    about = "position at home, roughly: it selects one of several configurations"
    near = Format(
        "joint that closed loops move",
        (replace(ends[0], name="near", doc=about, default=REQUIRED, check=_check_near),),
        make=lambda near: near,
        take=lambda near: {"near": near},
    )
    return Format(
        f"a {kind}",
        (
            ends[0],
            replace(ends[1], check=_check_dof),
            Key("axis", direction(), "direction of the axis, any length"),
            Key("gear", sub(GEAR), gear, default=None),
            Key("spring", sub(JOINT_SPRING), spring, default=None),
            Key(
                "mimic",
                _MIMIC,
                f"{mimic}: factors by name",
                _either("rad/rad"),
                default=(),
                check=_check_mimic,
            ),
            Key("passive", sub(near), passive, default=None, check=_check_passive),
            replace(DAMPING, unit=unit),
            FRICTION,
            *RATES,
            *more,
        ),
        make=Dof,
        either={"gear": (), "spring": ("damping",), "mimic": (), "passive": ()},
    )


DOF = Kinds(
    "degree of freedom",
    {
        "rotation": _dof("rotation", limits(angle(), "rad"), "N m s/rad", BALANCE),
        "translation": _dof("translation", limits(number(), "m"), "N s/m"),
    },
    shared=(Key("name", name("coordinate"), "name of the coordinate"),),
    definition="dof",
    typed=True,
)
