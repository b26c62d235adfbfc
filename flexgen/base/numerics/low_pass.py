"""Band of a record, and samples below a limit of frequency: the same filter for all terms of a
linear model.

A model that is linear in its numbers holds for its filtered terms as it does for the terms, and so
a filter costs nothing but the samples at the ends; noise and vibrations above the limit are gone.

Source: F. Harris, Proceedings of the IEEE 66(1), 1978 (windows); M. Gautier, ICRA 1997 (the same
filter for all terms).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import firwin, upfirdn

POWER = 0.99  # of the signals below the frequency of `bandwidth`
SHAPE = 6.0  # of the Kaiser window: -60 dB
LENGTH = 3.0  # of the filter times the limit
RATE = 10.0  # samples that are kept, over the limit


def bandwidth(signals: Sequence[np.ndarray], step: float) -> float:
    """Frequency [Hz] below which signals (n, ...) of several records, of one sample time, have
    most of their power.
    """
    power = np.zeros(0)
    cells = max(len(x) for x in signals)
    for x in signals:
        window = np.hanning(len(x))[:, None]
        rows = x.reshape(len(x), -1)
        lines = (
            np.abs(np.fft.rfft(window * (rows - rows.mean(axis=0)), 2 * cells, axis=0)) ** 2
        ).sum(axis=1)
        power = lines + (power if len(power) else 0.0)
    total = np.cumsum(power)
    return float(np.searchsorted(total, POWER * total[-1]) / (2 * cells * step))


class LowPass:
    """A filter without phase that keeps every so many samples, and none at the ends.

    Parameters
    ----------
    step : float [s]
        Of the samples.
    limit : float [Hz]
        Where the amplitude is half.
    """

    def __init__(self, step: float, limit: float) -> None:
        self.half = round(LENGTH / (limit * step) / 2)
        self.every = max(1, int(1 / (RATE * limit * step)))
        # of the samples of the whole convolution that are kept
        self.first = -(-2 * self.half // self.every)
        self._taps = firwin(2 * self.half + 1, limit, fs=1 / step, window=("kaiser", SHAPE))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The samples (n, ...) that are kept, filtered."""
        rows = upfirdn(self._taps, x, down=self.every, axis=0)[
            self.first : -(-len(x) // self.every)
        ]
        return np.asarray(rows)

    def kept(self, x: np.ndarray) -> np.ndarray:
        """Unfiltered samples (n, ...) at the instants of the filtered ones."""
        return x[self.first * self.every - self.half : len(x) - self.half : self.every]

    def whole(self, x: np.ndarray) -> np.ndarray:
        """All samples (n, ...), filtered; at the ends those of a signal that is mirrored there."""
        padded = np.pad(
            x,
            ((self.half, self.half), *[(0, 0)] * (x.ndim - 1)),
            mode="reflect",
            reflect_type="odd",
        )
        return np.asarray(upfirdn(self._taps, padded, axis=0)[2 * self.half : len(padded)])
