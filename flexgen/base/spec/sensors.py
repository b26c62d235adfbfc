"""Sensors of a robot in addition to the motor encoders.

An accelerometer measures the specific force, acceleration minus gravity. A link encoder measures
one arm coordinate (``coordinate = "q1"``), a tracker the position of a point of the tool in the
world. A joint torque sensor measures what gear or spring transmit to the arm, a force-torque
sensor (``wrench``) what holds the body that carries it and the parts behind, a strain gauge the
deflection of a coordinate without motor: ``gauge q + offset``.
"""

from __future__ import annotations

from dataclasses import dataclass

UNITS = {
    "accelerometer": {"m/s^2": 1.0, "g": 9.80665},
    "gyro": {"rad/s": 1.0, "deg/s": 0.017453292519943295},
    "link_encoder": {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295, "m": 1.0, "mm": 1e-3},
    "tracker": {"m": 1.0, "mm": 1e-3},
    "joint_torque": {"N m": 1.0, "N": 1.0},
    "wrench": {"N": 1.0, "kN": 1e3},
    "strain": {"1": 1.0, "um/m": 1e-6},
}
FORCES = ("joint_torque", "wrench")
# time derivatives up to an acceleration
ORDERS = {
    "accelerometer": 0,
    "gyro": 1,
    "link_encoder": 2,
    "tracker": 2,
    "strain": 2,
} | dict.fromkeys(FORCES, 0)
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
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
        Name of an element or ``"tool"``; of a link encoder, joint torque sensor or strain gauge
        that of its coordinate.
    position : tuple (3,) [m]
        In the frame of the place.
    axes : tuple of tuples (3,)
        Unit vectors, in the frame of the place; of a tracker in the world; of a link encoder none.
    labels : tuple of str
        Of the channels.
    noise : float
        Standard deviation of a sample, SI units; of a wrench that of its forces.
    sample_s : float or None [s]
        None: that of the drives.
    delay_s : float [s]
    unit : str
        SI unit of the channels; of a wrench that of its forces.
    moment_noise : float or None [N m]
        Standard deviation of the moments of a wrench.
    gauge, offset : float or None [1/rad or 1/m, 1]
        Of a strain gauge.
    is_tool : bool
        Whether a tracker is the origin of the tool frame.
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
    moment_noise: float | None = None
    gauge: float | None = None
    offset: float | None = None
    is_tool: bool = False

    @property
    def of_force(self) -> bool:
        """Whether it depends on the masses, and on forces that act on the tool."""
        return self.type in FORCES

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the channels."""
        return (
            ("N",) * 3 + ("N m",) * 3 if self.type == "wrench" else (self.unit,) * len(self.labels)
        )

    @property
    def noises(self) -> tuple[float, ...]:
        """Standard deviation of a sample of each channel."""
        moments = (self.moment_noise or 0.0,) * 3 if self.type == "wrench" else ()
        return (self.noise,) * (len(self.labels) - len(moments)) + moments

    @property
    def order(self) -> int:
        """Time derivatives that make an acceleration of what it measures."""
        return ORDERS[self.type]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels: ``name.x``; of a link encoder its name."""
        return tuple(f"{self.name}.{label}" if label else self.name for label in self.labels)
