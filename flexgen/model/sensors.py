"""Sensors of a robot beside the motor encoders, and their tables in a model file.

    [[sensor]]
    name = "acc"
    type = "accelerometer"              gyro, link_encoder, tracker
    element = "arm2"                    whose body carries it; "tool"
    position = [0.1, 0.0, 0.0]          in the frame of that body [m]
    axes = ["x", "z"]                   measured directions in that frame: x, y, z or vectors; default all three
    unit = "m/s^2"                      of what it sends
    noise = 0.02                        standard deviation of a sample
    sample_s = 5e-4                     default: as the drives
    delay_s = 0.0                       from the motion to the sample

An accelerometer measures the specific force, acceleration minus gravity. A link encoder measures one arm coordinate
(``coordinate = "q1"``), a tracker the position of a point of the tool in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexgen.model.checked_table import Table, closest

UNITS = {
    "accelerometer": {"m/s^2": 1.0, "g": 9.80665},
    "gyro": {"rad/s": 1.0, "deg/s": 0.017453292519943295},
    "link_encoder": {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295, "m": 1.0, "mm": 1e-3},
    "tracker": {"m": 1.0, "mm": 1e-3},
}
ORDERS = {"accelerometer": 0, "gyro": 1, "link_encoder": 2, "tracker": 2}  # time derivatives up to an acceleration
TOOL = "tool"
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
MOST = 64  # sensors


@dataclass(frozen=True)
class Sensor:
    """A sensor.

    Parameters
    ----------
    name : str
    type : str
        A key of `UNITS`.
    place : str
        Name of an element or ``"tool"``; of a link encoder the name of its coordinate.
    position : tuple (3,) [m]
        In the frame of the place.
    axes : tuple of tuples (3,)
        Unit vectors, in the frame of the place; of a tracker in the world; of a link encoder none.
    labels : tuple of str
        Of the channels.
    noise : float
        Standard deviation of a sample, SI units.
    sample_s : float or None [s]
        None: that of the drives.
    delay_s : float [s]
    unit : str
        SI unit of the channels.
    """

    name: str
    type: str
    place: str
    position: tuple[float, ...]
    axes: tuple[tuple[float, ...], ...]
    labels: tuple[str, ...]
    noise: float
    sample_s: float | None
    delay_s: float
    unit: str

    @property
    def order(self) -> int:
        """Time derivatives that make an acceleration of what it measures."""
        return ORDERS[self.type]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels: ``name.x``; of a link encoder its name."""
        return tuple(f"{self.name}.{label}" if label else self.name for label in self.labels)


def read_sensors(root: Table, elements: Sequence[str], coordinates: Sequence[tuple[str, str]]) -> tuple[Sensor, ...]:
    """The sensors of a model file.

    Parameters
    ----------
    root : Table
    elements : sequence of str
    coordinates : sequence of (str, str)
        Names and units of the arm coordinates.
    """
    if "sensor" not in root:
        return ()
    out: list[Sensor] = []
    tables = root.tables("sensor")
    if len(tables) > MOST:
        raise root.fail("sensor", f"at most {MOST} sensors", f"{len(tables)}")
    for table in tables:
        out.append(_sensor(table, [sensor.name for sensor in out], elements, dict(coordinates)))
    return tuple(out)


def _sensor(table: Table, taken: list[str], elements: Sequence[str], coordinates: dict[str, str]) -> Sensor:
    common = ("name", "type", "unit", "noise", "sample_s", "delay_s")
    name = table.name(taken=taken)
    kind = table.choice("type", tuple(UNITS))
    own = {"link_encoder": ("coordinate",), "tracker": ("position", "axes"), "gyro": ("element", "axes")}
    table.only(*common, *own.get(kind, ("element", "position", "axes")))
    units = tuple(UNITS[kind])
    axes: tuple[tuple[float, ...], ...] = ()
    labels: tuple[str, ...] = ("",)
    place = TOOL
    if kind == "link_encoder":
        place = _known(table, "coordinate", list(coordinates))
        units = ("rad", "mrad", "deg") if coordinates[place] == "rad" else ("m", "mm")
    else:
        axes, labels = _axes(table)
        if kind != "tracker":
            place = _known(table, "element", [*elements, TOOL])
    unit = table.choice("unit", units)
    factor = UNITS[kind][unit]
    return Sensor(
        name=name,
        type=kind,
        place=place,
        position=table.vector("position", 3, (0.0, 0.0, 0.0), "m") if "position" in table else (0.0, 0.0, 0.0),
        axes=axes,
        labels=labels,
        noise=factor * table.number("noise", 0.0, least=0.0),
        sample_s=table.optional("sample_s", above=0.0),
        delay_s=table.number("delay_s", 0.0, least=0.0),
        unit=next(si for si, one in UNITS[kind].items() if one == 1.0 and si in units),
    )


def _known(table: Table, key: str, known: Sequence[str]) -> str:
    given = table.text(key)
    if given not in known:
        raise table.fail(key, closest(given, known))
    return given


def _axes(table: Table) -> tuple[tuple[tuple[float, ...], ...], tuple[str, ...]]:
    """Unit vectors and labels of the measured directions."""
    if "axes" not in table:
        return tuple(_AXES.values()), tuple(_AXES)
    entries = table.entries["axes"].value
    if not isinstance(entries, list) or not 1 <= len(entries) <= 3:
        raise table.fail("axes", "one to three of x, y, z, or vectors of three numbers")
    axes, labels = [], []
    for k, entry in enumerate(entries):
        if isinstance(entry.value, str) and entry.value in _AXES:
            axes.append(_AXES[entry.value])
            labels.append(entry.value)
            continue
        numbers = [one.value for one in entry.value] if isinstance(entry.value, list) else []
        good = len(numbers) == 3 and all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
        length = sum(x * x for x in numbers) ** 0.5 if good else 0.0
        if not 1e-9 < length < 1e9:
            raise table.fail("axes", "one to three of x, y, z, or vectors of three numbers")
        axes.append(tuple(x / length for x in numbers))
        labels.append(str(k + 1))
    if len(set(labels)) != len(labels):
        raise table.fail("axes", "different directions")
    return tuple(axes), tuple(labels)
