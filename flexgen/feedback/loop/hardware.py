"""Drives and sensors of a sampled closed loop: sample time, delays, noise, resolution, limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.curve import checked_curves
from flexgen.model.elements import RobotModel
from flexgen.simulation.environment.robot_function import RobotFunction


@checked_class
@dataclass(frozen=True)
class DriveHardware:
    """Sampling, sensors and limits of the drives, motor side.

    Parameters
    ----------
    sample_s : float [s]
    delay_s : float [s]
        From the measurement to the torque, also of several samples; simulated by whole
        integration steps.
    encoder_resolution_rad, encoder_noise_rad : float [rad]
        Smallest difference that the encoders show, and standard deviation of white noise before
        it; 0: none.
    torque_noise_Nm : float [N m]
        Standard deviation of white noise on the torque of each interval; 0: none.
    torque_max_Nm : tuple of float [N m]
        Limits of the motors; empty: none.
    torque_speed : sequence of sequences of (float, float) [rad/s, N m]
        Of each motor points of the largest torque over the speed, see `flexgen.Limits`; empty:
        none.

    Examples
    --------
    >>> drives = flexgen.DriveHardware(sample_s=1e-3, encoder_noise_rad=1e-5, torque_noise_Nm=0.02)
    >>> flexgen.excite(
    ...     "elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10, hardware=drives
    ... ).hardware.sample_s
    0.001
    """

    sample_s: float = 5e-4
    delay_s: float = 0.0
    encoder_resolution_rad: float = 0.0
    encoder_noise_rad: float = 0.0
    torque_noise_Nm: float = 0.0
    torque_max_Nm: tuple[float, ...] = ()
    torque_speed: Sequence[Sequence[Sequence[float]]] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sample_s) and self.sample_s > 0):
            raise ArgumentError(f"sample_s: given {self.sample_s!r}, expected a time > 0 in s")
        if not 0 <= self.delay_s < math.inf:
            raise ArgumentError(f"delay_s: given {self.delay_s!r}, expected a time >= 0 in s")
        for name in ("encoder_resolution_rad", "encoder_noise_rad", "torque_noise_Nm"):
            if not 0 <= (value := getattr(self, name)) < math.inf:
                raise ArgumentError(f"{name}: given {value!r}, expected a number >= 0")
        object.__setattr__(self, "torque_speed", checked_curves("torque_speed", self.torque_speed))

    @classmethod
    def from_model(cls, model: RobotModel, **values: float) -> DriveHardware:
        """With the torque limits of a model, 0 where a motor has none; ``values``: the other
        fields.
        """
        most = tuple(motor.torque_max or 0.0 for motor in model.motors)
        return cls(
            **values,
            torque_max_Nm=most,
            torque_speed=tuple(motor.torque_speed for motor in model.motors),
        )


@dataclass(frozen=True)
class SensorChannels:
    """The sensors other than the encoders, channel by channel, (n_s,) each.

    ``noise``: standard deviation of a sample; ``bias``; ``resolution``: smallest difference, 0:
    none; ``delay_samples``: whole samples from the motion to the measurement. Units of the
    channels. ``function``: signals of sensors that feel the force on the tool; None: those of the
    library.
    """

    noise: np.ndarray
    bias: np.ndarray
    resolution: np.ndarray
    delay_samples: np.ndarray
    function: RobotFunction | None = None

    @classmethod
    def ideal(cls, channels: int) -> SensorChannels:
        """Without noise, bias, resolution and delay."""
        none = np.zeros(channels)
        return cls(none, none, none, np.zeros(channels, int))

    def __post_init__(self) -> None:
        shape = self.noise.shape
        for name in ("noise", "bias", "resolution", "delay_samples"):
            x = getattr(self, name)
            if x.shape != shape or not np.isfinite(x).all() or (name != "bias" and np.any(x < 0)):
                raise ArgumentError(
                    f"sensors, {name}: given {x!r}, expected {shape[0]} finite numbers >= 0"
                )
