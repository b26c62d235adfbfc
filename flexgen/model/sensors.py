"""Sensors of a robot in addition to the motor encoders.

An accelerometer measures the specific force, acceleration minus gravity. A link encoder measures one arm coordinate
(``coordinate = "q1"``), a tracker the position of a point of the tool in the world.
"""

from __future__ import annotations

from dataclasses import dataclass

UNITS = {
    "accelerometer": {"m/s^2": 1.0, "g": 9.80665},
    "gyro": {"rad/s": 1.0, "deg/s": 0.017453292519943295},
    "link_encoder": {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295, "m": 1.0, "mm": 1e-3},
    "tracker": {"m": 1.0, "mm": 1e-3},
}
ORDERS = {"accelerometer": 0, "gyro": 1, "link_encoder": 2, "tracker": 2}  # time derivatives up to an acceleration
TOOL = "tool"


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
