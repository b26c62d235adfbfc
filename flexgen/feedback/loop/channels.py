"""The measured channels of an observer, chosen by name.

=================== ===============================================================================
motors              all motor angles; also each by the name of its motor
a sensor's name     all channels of a sensor of the model file; also each by its own name,
                    ``acc.x``
tool_accelerometer  three axes at the tool, where the model file has none
tool_gyro           three axes at the tool
link_encoders       all arm coordinates with a motor
=================== ===============================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import check_positive, is_number, mapping_of
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.model.elements import RobotModel

MOTORS = "motors"
ACCELEROMETER = "tool_accelerometer"
GYRO = "tool_gyro"
ENCODERS = "link_encoders"
ENCODER_NOISE = 1e-4  # rad
NOISES = {ACCELEROMETER: 0.05, GYRO: 1e-3, ENCODERS: 1e-5}  # m/s^2, rad/s, rad or m
_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
Noise = float | Mapping[str, float]


@dataclass(frozen=True)
class Channels:
    """Chosen channels.

    Attributes
    ----------
    model : RobotModel
        With the sensors that are used, and no others.
    names : tuple of str
        Of the channels, in the order of the measurements.
    index : array (n_y,) of int
        A motor's number, or n_m plus the number of a signal of the model's sensors.
    noise : array (n_y,)
        Standard deviations [rad, m/s^2, rad/s, m].
    """

    model: RobotModel
    names: tuple[str, ...]
    index: np.ndarray
    noise: np.ndarray

    @property
    def accelerating(self) -> bool:
        """Whether a channel depends on accelerations."""
        return any(sensor.order == 0 for sensor in self.model.sensors)


def channels_of(
    model: RobotModel, outputs: str | Sequence[str], noise: Noise | None = None
) -> Channels:
    """The channels with the given names.

    Parameters
    ----------
    model : RobotModel
    outputs : str or sequence of str
        See the table of this module.
    noise : float or mapping of str to float, optional
        Standard deviations by the same names, or one for all; default: 1e-4 rad for motor angles,
        those of the model file for its sensors, and 0.05 m/s^2, 1e-3 rad/s and 1e-5 rad for the
        others.

    Raises
    ------
    ArgumentError
        A name is not known or given twice, a noise is not above zero, or a sensor has a delay.
    """
    given = (
        (outputs,)
        if isinstance(outputs, str)
        else tuple(outputs)
        if isinstance(outputs, Iterable)
        else ()
    )
    if not given or not all(isinstance(name, str) for name in given):
        raise ArgumentError(
            f"outputs: given {outputs!r}, expected names: {', '.join(_list_names(model))}"
        )
    own = _map_noises(noise, given)
    motors = [motor.name for motor in model.motors]
    names: list[str] = []
    sensors: list[Sensor] = []
    for name in given:
        sensors += _sensors(model, name)
        names += [c for s in _sensors(model, name) for c in _channels(s, name)] or _motors(
            name, motors, model
        )
    double = [name for k, name in enumerate(names) if name in names[:k]]
    if double:
        raise ArgumentError(f"outputs: given {double[0]!r} twice, expected each channel once")
    sensors = list({sensor.name: sensor for sensor in sensors}.values())
    for sensor in sensors:
        if sensor.delay_s > 0:
            raise ArgumentError(
                f"outputs: given the sensor {sensor.name} with delay_s = {sensor.delay_s:g}, "
                "expected one without delay; shift its record, or leave the sensor out"
            )
    of_sensors = [channel for sensor in sensors for channel in sensor.channels]
    index = [
        motors.index(name) if name in motors else len(motors) + of_sensors.index(name)
        for name in names
    ]
    used = replace(model, sensors=tuple(sensors))
    return Channels(used, tuple(names), np.array(index), _noises(names, used, own))


def _list_names(model: RobotModel) -> list[str]:
    """Names that may be given."""
    own = [name for s in model.sensors for name in dict.fromkeys((s.name, *s.channels))]
    return [MOTORS, *(motor.name for motor in model.motors), *own, ACCELEROMETER, GYRO, ENCODERS]


def _motors(name: str, motors: list[str], model: RobotModel) -> list[str]:
    """The motors that an entry of ``outputs`` names: all of ``motors``, or one."""
    if name == MOTORS:
        return motors
    if name in motors:
        return [name]
    raise ArgumentError(
        f"outputs: given {name!r}, expected one of {', '.join(_list_names(model))}"
    )


def _sensors(model: RobotModel, name: str) -> list[Sensor]:
    """The sensors of a name; none for motors."""
    found = [sensor for sensor in model.sensors if name in (sensor.name, *sensor.channels)]
    if found or name in (MOTORS, *(motor.name for motor in model.motors)):
        return found

    def sensor(own: str, kind: str, place: str, labels: tuple[str, ...], unit: str) -> Sensor:
        axes = _AXES if labels != ("",) else ()
        noise = NOISES[name]
        return Sensor(own, kind, place, (0.0, 0.0, 0.0), axes, labels, noise, None, 0.0, unit)

    if name == ACCELEROMETER:
        return [sensor(name, "accelerometer", TOOL, tuple("xyz"), "m/s^2")]
    if name == GYRO:
        return [sensor(name, "gyro", TOOL, tuple("xyz"), "rad/s")]
    if name == ENCODERS:
        driven = [model.coordinates[i] for i in model.i_g]
        return [sensor(f"link_{c.name}", "link_encoder", c.name, ("",), c.unit) for c in driven]
    return []


def _map_noises(noise: object, given: Sequence[str]) -> dict[str, float]:
    """Noises by the names of outputs; one number is that of all."""
    if is_number(noise):
        return dict.fromkeys(given, float(noise))  # type: ignore[arg-type]
    return mapping_of(
        "noise", {} if noise is None else noise, "a number > 0, or numbers by the names of outputs"
    )


def _channels(sensor: Sensor, name: str) -> tuple[str, ...]:
    """The channels of a sensor that a name means."""
    return (name,) if name in sensor.channels else sensor.channels


def _noises(names: Sequence[str], model: RobotModel, given: Mapping[str, float]) -> np.ndarray:
    """Standard deviation (n_y,) [rad, or of the sensor] of each of the channels ``names``.

    ``given``: by channel, sensor or group; the most specific entry counts, and the noise of the
    model file where there is none. ArgumentError where one is not above zero.
    """
    motors = [motor.name for motor in model.motors]
    groups: dict[str, tuple[str, ...]] = {name: (MOTORS,) for name in motors}
    values = dict.fromkeys(motors, ENCODER_NOISE)
    for sensor in model.sensors:
        for channel, own_noise in zip(sensor.channels, sensor.noises, strict=True):
            groups[channel] = (
                (ENCODERS, sensor.name) if sensor.type == "link_encoder" else (sensor.name,)
            )
            values[channel] = own_noise
    unknown = set(given) - {key for name in names for key in (name, *groups[name])}
    if unknown:
        raise ArgumentError(
            f"noise: given {sorted(unknown)[0]!r}, expected one of the outputs {', '.join(names)}"
        )
    out = []
    for name in names:
        keys = [key for key in (name, *groups[name][::-1]) if key in given]
        value = given[keys[0]] if keys else values[name]
        check_positive(
            f"noise of {name}", value, "a number > 0; a filter needs the noise of what it measures"
        )
        out.append(float(value))
    return np.array(out)
