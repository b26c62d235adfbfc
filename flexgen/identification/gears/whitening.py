"""Weights of frequencies with which the noise of torques becomes white."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.signal import welch
from scipy.signal.windows import tukey

from flexgen.identification.gears.signals import Signals

PIECE = 512  # samples of the pieces whose mean is a density
TAPER = 0.05  # of the record, in which both ends are faded


class Torques(Protocol):
    """Torques ``measured`` (k, n_m) in the band of the ``signals``, of
    `flexgen.identification.gears.fit.GearModel`.
    """

    signals: Signals
    measured: np.ndarray


class Whitening:
    """Weights of frequencies with which a noise (k, n_m) becomes white; none above the band;
    ``floor``: see `FLOOR`.
    """

    def __init__(self, noise: np.ndarray, model: Torques, floor: float) -> None:
        n = len(noise)
        f, power = welch(noise, 1.0, nperseg=min(n, PIECE), axis=0, detrend=False)
        least = floor * np.std(model.measured, axis=0)
        at = np.fft.rfftfreq(n)
        self._weigh(np.array([np.interp(at, f, each) for each in power.T]).T / 2 + least**2, model)

    @classmethod
    def of_bands(cls, lines: np.ndarray, power: np.ndarray, model: Torques) -> Whitening:
        """Whitening for the ``power`` (bands, n_m) of a noise in bands of so many ``lines``
        (bands, 1).
        """
        n = len(model.measured)
        middle = np.cumsum(lines) - lines[:, 0] / 2
        made = cls.__new__(cls)
        at = np.arange(n // 2 + 1)
        levels = np.log(power / lines / n)
        made._weigh(np.exp([np.interp(at, middle, each) for each in levels.T]).T, model)
        return made

    def _weigh(self, density: np.ndarray, model: Torques) -> None:
        """Weights for a density (lines, n_m)."""
        n = len(model.measured)
        signals = model.signals
        self._taper = tukey(n, TAPER)
        inside = np.fft.rfftfreq(n) / signals.sample_s <= signals.band_hz
        self._weight = inside[:, None] / np.sqrt(density)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Rows (k, n_m, ...) with these weights."""
        end = (1,) * (x.ndim - 2)
        found = np.fft.rfft(x * self._taper.reshape(-1, 1, *end), axis=0) * self._weight.reshape(
            *self._weight.shape, *end
        )
        return np.asarray(np.fft.irfft(found, len(x), axis=0))
