"""Inputs of frequency responses: torques that drives hold between their samples, with delays.

    h(w) exp(-j w t_d) k_t,        h = sinc(w T/2) exp(-j w T/2)

Sample time T, delay t_d, and torque constants k_t (1 where the drive is right). Samples cannot
tell the motion at w from that at its *images*, which a held torque moves too. They add up,

    Y(w) = sum_i G(w_i) h(w_i) exp(-j w_i t_d) k_t U(w),        w_i = w + 2 pi i/T

What i != 0 adds to the response of an inertia is about 6 (w T/(2 pi))^4 of it, 1 % at a fifth of
the sample rate.

Source: K. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, sec. 7.2 (aliasing).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

IMAGES = 8  # on each side; later ones have less than a thousandth of all


@dataclass(frozen=True)
class Drive:
    """Delays and filters between the commanded torque and the motor, and between motion and
    samples of sensors.

    Parameters
    ----------
    sample_s : float
        Sample time of a torque that is held between samples [s]; 0: no hold.
    delay_s : float
        Delay of the torque behind the measurement of the motor angles [s].
    torque_constants : tuple of float
        Torque of each motor over the recorded one; empty: 1.
    sensor_delays : mapping
        Name of a sensor -> delay [s] instead of that of the model.
    has_images : bool
        False: the motion between the samples is known too.
    """

    sample_s: float = 0.0
    delay_s: float = 0.0
    torque_constants: tuple[float, ...] = ()
    sensor_delays: Mapping[str, float] = field(default_factory=dict)
    has_images: bool = True

    def transfer(self, w: np.ndarray, n_m: int) -> np.ndarray:
        """``h(w) exp(-j w t_d) k_t`` (lines, n_m)."""
        half = w * self.sample_s / 2
        hold = np.sinc(half / np.pi) * np.exp(-1j * (half + w * self.delay_s))
        return hold[:, None] * np.array(self.torque_constants or (1.0,) * n_m)

    def images(self) -> np.ndarray:
        """Distances ``2 pi i/T`` (images,) [rad/s] of the images, the nearest first."""
        held = self.sample_s > 0 and self.has_images
        return np.array(
            [2 * np.pi * i / self.sample_s for k in range(1, IMAGES + 1) for i in (k, -k) if held]
        )


def with_drive(drive: Drive, changes: Mapping[str, float], motors: Sequence[str]) -> Drive:
    """The drive with other delays (``delay``, ``<sensor>.delay``) or torque constants
    (``<motor>.torque_constant``).
    """
    constants = list(drive.torque_constants or (1.0,) * len(motors))
    for j, name in enumerate(motors):
        constants[j] = changes.get(f"{name}.torque_constant", constants[j])
    late = {
        name.removesuffix(".delay"): value
        for name, value in changes.items()
        if name.endswith(".delay")
    }
    delays = {**drive.sensor_delays, **late}
    delay_s = changes.get("delay", drive.delay_s)
    return replace(drive, delay_s=delay_s, torque_constants=tuple(constants), sensor_delays=delays)
