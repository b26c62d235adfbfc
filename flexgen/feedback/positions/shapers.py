"""Input shapers: commands as a sum of delayed copies of themselves, after which one mode rests.

    q_shaped(t) = sum A_i q(t - t_i),  sum A_i = 1,  A_i > 0

Of a mode with the natural frequency w and the damping ratio d, with w_d = w sqrt(1 - d^2),
T = pi / w_d and K = exp(-d pi / sqrt(1 - d^2)):

    ZV:  A = (1, K) / (1 + K),         t = (0, T)       no residual vibration
    ZVD: A = (1, 2 K, K^2) / (1 + K)^2, t = (0, T, 2 T)  nor its slope over w

Source: N. Singer, W. Seering, Journal of Dynamic Systems, Measurement, and Control 112(1), 1990.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from flexgen.base.checks.bounds import Bound, Positive
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError

ShaperName = Literal["none", "zv", "zvd"]
NAMES: tuple[ShaperName, ...] = ("none", "zv", "zvd")
Damping = Annotated[float, Bound(0.0, 0.99, words="a damping ratio from 0 to 0.99")]
SUM = 1e-9  # of the amplitudes from 1, at most


@checked_class
@dataclass(frozen=True)
class Shaper:
    """An input shaper: impulses with ``amplitudes`` at ``times``.

    Parameters
    ----------
    times : array (n,) [s]
        The first is zero; increasing.
    amplitudes : array (n,)
        Positive, of sum 1: shaped positions stay between those that are shaped.

    Examples
    --------
    >>> zv = flexgen.Shaper.of_mode("zv", frequency_hz=2.0)
    >>> zv.times.round(3), zv.amplitudes
    (array([0.  , 0.25]), array([0.5, 0.5]))
    >>> f"{zv.vibration(2.2):.3f}"  # of a mode at 2.2 Hz remains, relative to no shaper
    '0.156'
    """

    times: np.ndarray
    amplitudes: np.ndarray

    __repr__ = short_repr

    def __post_init__(self) -> None:
        shapes = np.shape(self.times), np.shape(self.amplitudes)
        if len(shapes[0]) != 1 or shapes[0] != shapes[1] or not shapes[0][0]:
            raise ArgumentError(
                f"shaper: given times {shapes[0]}, amplitudes {shapes[1]}, expected (n,) of both"
            )
        if self.times[0] != 0.0 or not (np.diff(self.times) > 0.0).all():
            raise ArgumentError(
                f"times: given {self.times.tolist()}, expected increasing ones [s] from 0 on"
            )
        total = float(np.sum(self.amplitudes))
        if not ((np.array(self.amplitudes) > 0.0).all() and abs(total - 1.0) <= SUM):
            raise ArgumentError(
                f"amplitudes: given {self.amplitudes.tolist()}, expected positive ones of sum 1"
            )

    @classmethod
    def of_mode(cls, name: ShaperName, frequency_hz: Positive, damping: Damping = 0.0) -> Shaper:
        """The shaper of a mode.

        Parameters
        ----------
        name : str
            ``"none"``: one impulse; ``"zv"``: no vibration remains; ``"zvd"``: nor changes at
            first order with the frequency, for twice the delay.
        frequency_hz : float [Hz]
            Undamped natural frequency.
        damping : float
            Damping ratio.

        Returns
        -------
        Shaper
        """
        share = math.exp(-damping * math.pi / math.sqrt(1.0 - damping**2))
        half = 1.0 / (2.0 * frequency_hz * math.sqrt(1.0 - damping**2))
        amplitudes = {
            "none": np.array([1.0]),
            "zv": np.array([1.0, share]) / (1.0 + share),
            "zvd": np.array([1.0, 2.0 * share, share**2]) / (1.0 + share) ** 2,
        }[name]
        return cls(half * np.arange(len(amplitudes)), amplitudes)

    @property
    def delay_s(self) -> float:
        """By which the commands end later [s]."""
        return float(self.times[-1])

    def vibration(self, frequency_hz: Positive, damping: Damping = 0.0) -> float:
        """Vibration of a mode that remains, relative to that without a shaper.

        ``exp(-d w t_n) |sum A_i exp((d w + i w_d) t_i)|``
        """
        w = 2.0 * math.pi * frequency_hz
        rate = complex(damping * w, w * math.sqrt(1.0 - damping**2))
        sums = self.amplitudes @ np.exp(rate * (self.times - self.times[-1]))
        return float(np.abs(sums))

    def shape(self, time: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shaped positions of a table, at its equal steps.

        An impulse between two instants is divided among them in proportion, as for a robot that
        interpolates linearly.

        Parameters
        ----------
        time : array (n,) [s]
            At equal steps.
        positions : array (n, k)

        Returns
        -------
        time : array (m,) [s]
            Longer by the delay, rounded up.
        positions : array (m, k)

        Raises
        ------
        ArgumentError
            Steps are unequal, or the arrays have other shapes.
        """
        time = np.asarray(time, dtype=float)
        q = np.asarray(positions, dtype=float)
        steps = np.diff(np.atleast_1d(time))
        is_even = len(steps) > 0 and steps[0] > 0.0 and np.ptp(steps) <= SUM
        if time.ndim != 1 or q.ndim != 2 or len(q) != len(time) or not is_even:
            raise ArgumentError(
                f"shape: given times {time.shape}, positions {q.shape}, expected equal steps (n,) "
                "and (n, joints)"
            )
        step = float(steps.mean())
        more = math.ceil(self.delay_s / step - SUM)
        whole = time[0] + step * np.arange(len(time) + more)
        out = np.zeros((len(whole), q.shape[1]))
        for at, amplitude in zip(self.times, self.amplitudes, strict=True):
            for j in range(q.shape[1]):
                out[:, j] += amplitude * np.interp(whole - at, time, q[:, j])
        return whole, out
