"""Rows of the tables of motors and sensors, and checks of all motors together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from flexgen.base.spec.fourier import STEEPEST
from flexgen.base.spec.keys import (
    Context,
    Format,
    Key,
    Kinds,
    Type,
    choice,
    direction,
    flag,
    known,
    list_of,
    name,
    number,
    sub,
    vector,
    words,
)
from flexgen.base.spec.parts import GearFriction
from flexgen.base.spec.sensors import TOOL, UNITS, WRENCH, Sensor
from flexgen.base.spec.tables import LARGEST, Table, closest
from flexgen.model.elements import ZERO, Coordinate, Gear, Motor, Vector, coordinates_of
from flexgen.model.format.format_robot import COGGING, ENCODER_ERROR, FRICTION, RIPPLE, lugre

MOST = 64  # sensors
# sensors of joints; units of translations
_JOINTS = ("link_encoder", "joint_torque")
_LINEAR = ("m", "mm", "N")
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


# --- motors --------------------------------------------------------------------------------------


def _gears(here: Context) -> dict[str, Gear | None]:
    """The gear of each degree of freedom."""
    return {dof.name: dof.gear for element in here.of_file("element") for dof in element.dofs}


def _check_drives(table: Table, here: Context) -> None:
    """Raise an error for a motor that drives what it cannot."""
    gears = _gears(here)
    actuated = [joint for joint, gear in gears.items() if gear is not None]
    for joint in here.values["drives"]:
        if joint not in gears:
            raise table.fail("drives", closest(joint, actuated))
        if joint not in actuated:
            raise table.fail(
                "drives", "degrees of freedom with a gear", f"{joint}, which has none"
            )
    if len(_rigid(here)) > 1:
        raise table.fail("drives", "driven joints whose gears are all elastic or all rigid")


def _rigid(here: Context) -> set[bool]:
    """Whether the gears of a motor are rigid."""
    return {
        gear.rigid for joint in here.values["drives"] if (gear := _gears(here)[joint]) is not None
    }


def _check_rotor(table: Table, here: Context) -> None:
    """The error of a motor: without inertia behind an elastic gear, or without axis and carrier
    where the coupling needs them.
    """
    if here.values["inertia"] == 0.0 and _rigid(here) != {True}:
        raise table.fail("inertia", "a number > 0 behind an elastic gear")
    if here.of_file("motor_coupling") == "complete":
        for key in ("axis", "carrier"):
            if key not in table:
                raise table.fail(key, f'{key}, because motor_coupling = "complete"')


def _read_ratio(table: Table, key: Key, here: Context) -> Vector:
    """The ratio to each driven joint, one number or a list, none of them zero."""
    count = len(here.values["drives"])
    value = table.entries["ratio"].value if "ratio" in table else None
    if isinstance(value, list):
        ratio = table.vector("ratio", count, what="one for each driven joint")
    elif count == 1:
        ratio = (table.number("ratio"),)
    else:
        raise table.fail("ratio", f"a list of {count} numbers (one for each driven joint)")
    if min(map(abs, ratio)) < 1.0 / LARGEST:
        raise table.fail("ratio", "a ratio that is not 0")
    return ratio


def _check_rms(table: Table, here: Context) -> None:
    if here.values["torque_rms_max"] is None and here.values["thermal_time"] is not None:
        raise table.fail("thermal_time", "torque_rms_max in addition to a thermal_time")


def _check_ripple(table: Table, here: Context) -> None:
    ripple = here.values["torque_ripple"]
    if ripple is not None and ripple.bound() >= 1.0:
        raise table.fail(
            "torque_ripple", "amplitudes whose sum is below 1", f"a sum of {ripple.bound():.3g}"
        )


def _check_encoder(table: Table, here: Context) -> None:
    """The error of an encoder whose reading would fall while the angle rises."""
    error = here.values["encoder_error"]
    if error is not None and error.bound(1) >= 1.0:
        expected = (
            "amplitudes whose sum, each times its harmonic, is below 1: the reading rises with "
            "the angle"
        )
        raise table.fail("encoder_error", expected, f"a sum of {error.bound(1):.3g}")


def _read_curve(table: Table, key: Key, here: Context) -> tuple[tuple[float, float], ...]:
    from flexgen.base.spec.curve import read_curve

    return read_curve(table, key)


_CURVE = Type(_read_curve, list_of(list_of({"type": "number"}, 2)) | {"minItems": 2})
_POINTS = (
    "largest torque over the speed, motor side: points from the speed 0 on that bound a convex "
    "region"
)
_SHARE = "change of the torque that the motor gives, as a part of it, over the motor angle"
_SHOWN = (
    "what the encoder or resolver shows less the motor angle, over that angle; 1 and 2 periods "
    "a turn as a rule"
)
_THERMAL = "time constant over which torque_rms_max holds, as of the winding"
_RATIO = Type(_read_ratio, {"anyOf": [number().schema, vector().schema]})
MOTOR = Format(
    "motor",
    (
        Key("name", name("motor"), "name of the motor"),
        Key(
            "drives",
            words(),
            "the degree of freedom that it drives, or a list of them (coupled wrist)",
            check=_check_drives,
        ),
        Key(
            "inertia", number(least=0.0), "rotor inertia, motor side", "kg m^2", check=_check_rotor
        ),
        Key(
            "ratio",
            _RATIO,
            "gear ratio, motor speed / joint speed, one for each driven joint; of a translation",
            "rad/m",
        ),
        replace(FRICTION, doc="friction on the motor side", check=None),
        Key(
            "axis",
            direction(),
            "axis of the rotor in the frame of its carrier (complete coupling)",
            default=None,
        ),
        Key(
            "carrier",
            choice(of=lambda here: ["base", *here.names["element"]]),
            "the element that carries the motor, or base (complete coupling)",
            default=None,
        ),
        Key("torque_max", number(above=0.0), "limit of the torque, motor side", "N m", None),
        Key("speed_max", number(above=0.0), "limit of the speed, motor side", "rad/s", None),
        Key(
            "torque_rate_max",
            number(above=0.0),
            "limit of the rate of the torque, motor side",
            "N m/s",
            None,
        ),
        Key(
            "torque_rms_max",
            number(above=0.0),
            "limit of the root mean square of the torque",
            "N m",
            None,
        ),
        Key(
            "thermal_time",
            number(above=0.0),
            f"{_THERMAL}; default: the whole motion",
            "s",
            None,
            check=_check_rms,
        ),
        Key("torque_speed", _CURVE, _POINTS, "rad/s, N m", default=()),
        Key(
            "cogging",
            sub(COGGING),
            "torque on the rotor in addition, over the motor angle",
            default=None,
        ),
        Key("torque_ripple", sub(RIPPLE), _SHARE, default=None, check=_check_ripple),
        Key("encoder_error", sub(ENCODER_ERROR), _SHOWN, default=None, check=_check_encoder),
        Key("lugre", sub(lugre), "friction with a state, in addition to friction", default=None),
    ),
    make=lambda drives, **values: Motor(drives=tuple(drives), **values),
)


def _check_error(place: Table, gear: Gear, joint: str, drivers: list[Motor]) -> None:
    """Raise an error for a transmission error of coupled gears, and for one as steep as the
    gear.
    """
    assert gear.transmission_error is not None
    if [motor.drives for motor in drivers] != [(joint,)]:
        raise place.fail(
            "gear", "a transmission_error only where one motor of its own drives the joint", "one"
        )
    steep = abs(drivers[0].ratio[0]) * gear.transmission_error.bound(1)
    if steep >= STEEPEST:
        expected = (
            "amplitudes whose sum, each times its harmonic and the gear ratio, is below "
            f"{STEEPEST}"
        )
        raise place.fail("gear", f"a transmission_error with {expected}", f"{steep:.3g}")


def check_motors(table: Table, here: Context) -> None:
    """Raise an error for joints without a motor, a wrong number of motors or a singular matrix of
    gear ratios.
    """
    found: tuple[Motor, ...] = here.values["motor"]
    gears: dict[str, Gear] = {
        joint: gear for joint, gear in _gears(here).items() if gear is not None
    }
    for joint, gear in gears.items():
        place = here.names["coordinate"][joint]
        drivers = [motor for motor in found if joint in motor.drives]
        if not drivers:
            raise place.fail("gear", f"a motor that drives {joint}", "a gear that no motor drives")
        if (
            not gear.rigid
            and gear.side == "motor"
            and [motor.drives for motor in drivers] != [(joint,)]
        ):
            given = 'side = "motor" on a joint that is not driven by one motor of its own'
            raise place.fail("gear", 'side = "arm"', given)
        if gear.transmission_error is not None:
            _check_error(place, gear, joint, drivers)
    for motor in found:
        behind = [gears[joint] for joint in motor.drives if joint in gears]
        loaded = isinstance(motor.friction, GearFriction) and motor.friction.loaded
        if loaded and any(gear.rigid for gear in behind):
            expected = "no load_coulomb, load_stribeck or load_smoothing, since its gear is rigid"
            raise here.names["motor"][motor.name].fail(
                "friction", expected, "friction that depends on the gear torque"
            )
    if len(found) != len(gears):
        expected = f"as many motors as actuated degrees of freedom, {len(gears)}"
        raise table.fail("motor", expected, f"{len(found)} motors")
    eta = np.array(
        [
            [dict(zip(m.drives, m.ratio, strict=True)).get(joint, 0.0) for joint in gears]
            for m in found
        ]
    )
    singular = np.linalg.svd(eta / np.abs(eta).max(axis=1, keepdims=True), compute_uv=False)
    if singular[-1] < 1e-9 * singular[0]:
        raise table.fail(
            "motor", "a regular matrix of gear ratios", "a singular matrix of gear ratios"
        )


# --- sensors -------------------------------------------------------------------------------------


def _read_axes(
    table: Table, key: Key, here: Context
) -> tuple[tuple[tuple[float, ...], ...], tuple[str, ...]]:
    """Unit vectors and labels of the measured directions, from x, y, z or vectors of any length;
    vectors are labeled by their number.
    """
    entries = table.entries["axes"].value
    if not isinstance(entries, list) or not 1 <= len(entries) <= 3:
        raise table.fail("axes", "one to three of x, y, z, or vectors of three numbers")
    axes = []
    labels = []
    for k, entry in enumerate(entries):
        if isinstance(entry.value, str) and entry.value in _AXES:
            axes.append(_AXES[entry.value])
            labels.append(entry.value)
            continue
        numbers = [one.value for one in entry.value] if isinstance(entry.value, list) else []
        good = len(numbers) == 3 and all(
            isinstance(x, int | float) and not isinstance(x, bool) for x in numbers
        )
        length = (
            sum(x * x for x in numbers) ** 0.5
            if good and all(abs(x) < 1e9 for x in numbers)
            else 0.0
        )
        if not 1e-9 < length < 1e9:
            raise table.fail("axes", "one to three of x, y, z, or vectors of three numbers")
        axes.append(tuple(x / length for x in numbers))
        labels.append(str(k + 1))
    if len(set(labels)) != len(labels):
        raise table.fail("axes", "different directions")
    return tuple(axes), tuple(labels)


def _family(kind: str, linear: bool) -> tuple[str, ...]:
    """Units of a sensor of a coordinate, of a translation or a rotation."""
    return tuple(unit for unit in UNITS[kind] if (unit in _LINEAR) == linear)


def _units(kind: str) -> Callable[[Context], tuple[str, ...]]:
    """Units that a sensor of a coordinate can send."""

    def of(here: Context) -> tuple[str, ...]:
        units = {coordinate.name: coordinate.unit for coordinate in _all(here)}
        return _family(kind, units[here.values["coordinate"]] == "m")

    return of


def _sensor(type: str, unit: str, noise: float, axes: Any = None, **values: Any) -> Sensor:
    """A sensor in SI units, from the values of its table in ``unit``; ``axes``: directions and
    labels.
    """
    place = values.pop("coordinate", None) or values.pop("element", TOOL)
    family = _family(type, unit in _LINEAR) if type in _JOINTS else UNITS[type]
    factor = UNITS[type][unit]
    si = next(one for one in family if UNITS[type][one] == 1.0)
    axes = axes or ((), WRENCH if type == "wrench" else ("",))
    values = {"position": ZERO} | values
    values |= {
        key: factor * values[key] for key in ("moment_noise", "gauge", "offset") if key in values
    }
    return Sensor(
        type=type,
        place=place,
        axes=axes[0],
        labels=axes[1],
        noise=factor * noise,
        unit=si,
        **values,
    )


_AXIS = {"anyOf": [{"enum": [*_AXES]}, list_of({"type": "number"}, 3)]}
_DIRECTIONS = Type(_read_axes, {"type": "array", "items": _AXIS, "minItems": 1, "maxItems": 3})
_ALL = (tuple(_AXES.values()), tuple(_AXES))
_DIRECTIONS_KEY = Key(
    "axes", _DIRECTIONS, "measured directions: x, y, z or vectors; default all three", default=_ALL
)


def _coordinate(doc: str, measured: Callable[[Coordinate], bool] = lambda one: True) -> Key:
    """The key of the coordinate that is measured."""
    return Key("coordinate", known(lambda here: [c.name for c in _all(here) if measured(c)]), doc)


def _all(here: Context) -> tuple[Coordinate, ...]:
    return coordinates_of(here.of_file("element"))


_ELEMENT = Key(
    "element",
    known(lambda here: [*here.names["element"], TOOL]),
    f'the element whose body carries the sensor, or "{TOOL}"',
)
_POSITION = Key("position", vector(3), "in the frame of that body, or of the tool", "m", ZERO)


def _check_is_tool(table: Table, here: Context) -> None:
    """Raise an error for a tool point that is elsewhere than the tool frame, or a second one."""
    if not here.values["is_tool"]:
        return
    if here.values["element"] != TOOL or any(here.values["position"]):
        raise table.fail("is_tool", "true only without element and position: it is the tool")
    if any(sensor.is_tool for sensor in here.before):
        raise table.fail("is_tool", "true of one tracker only")


_IS_TOOL = Key(
    "is_tool",
    flag(),
    "the tracker is the origin of the tool frame: a calibration moves the tool",
    default=False,
    check=_check_is_tool,
)


def _values(sensor: Sensor) -> dict[str, Any]:
    """The values of the keys of a sensor."""
    axes = [
        label if label in _AXES else axis
        for label, axis in zip(sensor.labels, sensor.axes, strict=False)
    ]
    return {
        **vars(sensor),
        "axes": None if axes == [*_AXES] else axes,
        "element": sensor.place,
        "coordinate": sensor.place,
    }


def _kind(kind: str, doc: str, own: tuple[Key, ...], *place: Key) -> Format:
    """The table of a kind of sensor: its own keys, the unit, the position, and the keys of all
    kinds.
    """
    units = choice(*UNITS[kind], of=_units(kind) if kind in _JOINTS else None)
    shared = (
        Key(
            "noise", number(least=0.0), "standard deviation of a sample, in this unit", default=0.0
        ),
        Key(
            "sample_s", number(above=0.0), "sample time []; default: that of the drives", "s", None
        ),
        Key("delay_s", number(least=0.0), "time from the motion to the sample", "s", 0.0),
    )
    return Format(
        doc,
        (*own, Key("unit", units, "unit of what the sensor sends"), *place, *shared),
        _sensor,
        _values,
    )


_ACCELERATION = "acceleration minus gravity at a point of a body"
_TRACKER = "position of a point of the tool, or of another body, in the world"
_TORQUE = "torque of gear or spring and damper on the arm; force of a translation"
_ANGLE = "the arm coordinate that is measured"
_JOINT = "the degree of freedom; not a deflection of a beam"
_WRENCH = (
    "force and moment that hold a body and the parts behind it, at a point; tool: the payload "
    "and what acts on it"
)
_MOMENT_NOISE = Key(
    "moment_noise",
    number(least=0.0),
    "as noise, of the moments, in this unit times m",
    default=0.0,
)
_STRAIN = "gauge q + offset: what a strain gauge on a spring reads"
_SPRING = "a coordinate without motor"
_GAUGE = Key("gauge", number(), "reading per deflection, in this unit", "1/rad or 1/m")
_OFFSET = Key("offset", number(), "reading without deflection, in this unit", default=0.0)
SENSOR = Kinds(
    "sensor",
    {
        "accelerometer": _kind(
            "accelerometer", _ACCELERATION, (_DIRECTIONS_KEY, _ELEMENT), _POSITION
        ),
        "gyro": _kind("gyro", "angular velocity of a body", (_DIRECTIONS_KEY, _ELEMENT)),
        "link_encoder": _kind("link_encoder", "an arm coordinate", (_coordinate(_ANGLE),)),
        "tracker": _kind(
            "tracker",
            _TRACKER,
            (_DIRECTIONS_KEY, replace(_ELEMENT, default=TOOL)),
            _POSITION,
            _IS_TOOL,
        ),
        "joint_torque": _kind(
            "joint_torque", _TORQUE, (_coordinate(_JOINT, lambda one: one.dof is not None),)
        ),
        "wrench": _kind("wrench", _WRENCH, (_ELEMENT,), _POSITION, _MOMENT_NOISE),
        "strain": _kind(
            "strain",
            _STRAIN,
            (_coordinate(_SPRING, lambda one: not one.actuated),),
            _GAUGE,
            _OFFSET,
        ),
    },
    shared=(Key("name", name("sensor"), "name of the sensor"),),
    strict=False,
    typed=True,
)
