"""Coulomb friction of motors in the torques of a record, and its unknown value at standstill.

    tau_c = F tanh(v/v_c)

changes within a small part of a sample, and so it is computed at ``parts`` instants of each sample
and filtered there: the filter of the torques at a higher rate. Where a motor with such friction
stands still, it is any torque, which is taken out of all terms, see
`flexgen.identification.rigid.rests_of_motors`: only where there is some, since the noise would
hide other numbers behind it.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.signal import firwin, oaconvolve

from flexgen.identification.gears.driven_arm import MotorMotion
from flexgen.identification.gears.signals import WINDOW, Signals
from flexgen.identification.rigid.rests_of_motors import MOVING, Rests

FINEST = 2.5e-3  # in periods of the end of the band: between two of these instants, at least
STEEP = 2e-3  # v_c over the largest speed


class MotorFriction:
    """Coulomb friction in the band of a record.

    Parameters
    ----------
    signals : Signals
    motion : MotorMotion
        Its speeds say where motors stand still.
    """

    def __init__(self, signals: Signals, motion: MotorMotion) -> None:
        self.signals = signals
        self.motion = motion
        self.rests: tuple[Rests, ...] = ()
        self.sticks = False  # whether any motor has some
        self._last: tuple[MotorMotion, np.ndarray] | None = None  # of `coulomb`
        self.parts = max(1, int(np.ceil(signals.sample_s * signals.band_hz / FINEST)))

    def coulomb(self, motion: MotorMotion) -> np.ndarray:
        """Torques (k, n_m) in the band for F = 1."""
        if self._last is None or self._last[0] is not motion:
            v = self._speeds(motion)
            self._last = (
                motion,
                self._filter(np.tanh(v / (STEEP * np.abs(v).max(axis=0) + 1e-300))),
            )
        return self._last[1]

    def take_out(self, first: int, motors: np.ndarray) -> None:
        """From now on `project` leaves out standstill of these motors (n_m,), from sample
        ``first`` of the torques on.

        These are those in the band.
        """
        self.sticks = bool(motors.any())
        v = self._speeds(self.motion)[first * self.parts :]
        limit = self.signals.band_hz * self.signals.sample_s / self.parts
        reach = len(self._taps) - 1
        least = np.where(motors, MOVING * np.abs(v).max(axis=0), -1.0)
        self.rests = tuple(
            Rests(x, y, limit, self._filter, self.parts, reach)
            for x, y in zip(v.T, least, strict=True)
        )

    def project(self, x: np.ndarray) -> np.ndarray:
        """Torques (k, n_m, ...) after elimination of the friction at standstill."""
        return (
            np.stack([rest.project(x[:, j]) for j, rest in enumerate(self.rests)], axis=1)
            if self.rests
            else x
        )

    def _speeds(self, motion: MotorMotion) -> np.ndarray:
        """Speeds (n, n_m) at all instants."""
        count = self.parts * (len(motion.time) - 1) + 1
        return np.asarray(motion.curve(np.linspace(motion.time[0], motion.time[-1], count), 1))

    def _filter(self, x: np.ndarray) -> np.ndarray:
        """Samples of (n, ...) after the filter of `Signals.torques`, where it is filled."""
        taps = self._taps.reshape(-1, *(1,) * (x.ndim - 1))
        return np.asarray(oaconvolve(x, taps, mode="valid", axes=0)[:: self.parts])

    @cached_property
    def _taps(self) -> np.ndarray:
        signals = self.signals
        rate = self.parts / self.signals.sample_s
        return firwin(2 * self.parts * signals.margin + 1, signals.band_hz, fs=rate, window=WINDOW)
