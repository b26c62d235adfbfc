"""Filters of the torque of a drive, of order two, sampled by the bilinear transform with the
frequency in place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import check_positive, is_number


@checked_class
@dataclass(frozen=True)
class LowPass:
    """``w^2 / (s^2 + 2 zeta w s + w^2)``; frequency [Hz], damping ratio.

    Examples
    --------
    >>> b0, b1, b2, a1, a2 = flexgen.LowPass(150.0).section(sample_s=5e-4)
    >>> round((b0 + b1 + b2) / (1.0 + a1 + a2), 9)  # at zero frequency
    1.0
    >>> law = flexgen.PPI(speed_hz=40.0, filters=(flexgen.LowPass(150.0),))
    """

    frequency_hz: float
    damping: float = 0.7

    def __post_init__(self) -> None:
        _check_filter(self)

    @checked_types(own=("sample_s",))
    def section(self, sample_s: float) -> tuple[float, ...]:
        """``b0, b1, b2, a1, a2`` of the sampled filter; ArgumentError beyond half the sample
        rate.
        """
        return _bilinear(
            (0.0, 0.0, 1.0), (1.0, 2 * self.damping, 1.0), self.frequency_hz, sample_s
        )


@checked_class
@dataclass(frozen=True)
class Notch:
    """``(s^2 + 2 zeta_n w s + w^2) / (s^2 + 2 zeta_d w s + w^2)``; frequency [Hz], damping ratios.

    Examples
    --------
    >>> law = flexgen.PPI(position_hz=6.0, speed_hz=40.0, filters=(flexgen.Notch(25.0),))
    >>> flexgen.control("elbow", controller=law).margins()["begin"].stable
    True
    """

    frequency_hz: float
    zero_damping: float = 0.1
    pole_damping: float = 0.7

    def __post_init__(self) -> None:
        _check_filter(self)

    @checked_types(own=("sample_s",))
    def section(self, sample_s: float) -> tuple[float, ...]:
        """``b0, b1, b2, a1, a2`` of the sampled filter; ArgumentError beyond half the sample
        rate.
        """
        zeros = (1.0, 2 * self.zero_damping, 1.0)
        poles = (1.0, 2 * self.pole_damping, 1.0)
        return _bilinear(zeros, poles, self.frequency_hz, sample_s)


def _check_filter(of: LowPass | Notch) -> None:
    """ArgumentError where a number of a filter is not finite."""
    for part in fields(of):
        if not is_number(getattr(of, part.name)):
            raise ArgumentError(
                f"filter, {part.name}: given {show_value(getattr(of, part.name))}, expected a "
                "finite number"
            )


def _bilinear(
    b: tuple[float, float, float],
    a: tuple[float, float, float],
    frequency_hz: float,
    sample_s: float,
) -> tuple[float, ...]:
    """Coefficients ``b0 b1 b2 a1 a2`` of a filter in ``s/w`` with numerator b and denominator a,
    highest power first, sampled by the bilinear rule such that its response at w = 2 pi
    ``frequency_hz`` stays.
    """
    check_positive("sample_s", sample_s, "a time > 0 in s")
    if not 0 < frequency_hz < 0.5 / sample_s:
        raise ArgumentError(
            f"filter: given {frequency_hz} Hz, expected more than 0 and less than "
            f"{0.5 / sample_s:.4g} Hz, half the sample rate"
        )
    c = 1.0 / math.tan(math.pi * frequency_hz * sample_s)

    def sample(x: tuple[float, float, float]) -> tuple[float, float, float]:
        return (
            x[0] * c * c + x[1] * c + x[2],
            2 * (x[2] - x[0] * c * c),
            x[0] * c * c - x[1] * c + x[2],
        )

    above = sample(b)
    below = sample(a)
    return tuple(x / below[0] for x in (*above, *below[1:]))


Filter = LowPass | Notch

TERMS = 6  # of the series of an inverse of a low-pass filter


def inverse_taps(low_pass: Sequence[LowPass], sample_s: float) -> tuple[tuple[float, ...], int]:
    """Weights of the samples around the present one in the inverse of low-pass filters, and how
    many come before it.

        F = z^-1 (1 + D2/4) / (a(z) / a(1)),    D2 = z - 2 + z^-1,
        1 / (1 + D2/4) = sum_k (-D2/4)^k

    The error of the series is sin(w h/2)^(2 TERMS + 2) at the frequency w: it is 1e-7 at a tenth
    of the sample rate.
    """
    series = np.zeros(2 * TERMS + 1)
    power = np.ones(1)
    for k in range(TERMS + 1):
        series[TERMS - k : TERMS + k + 1] += power
        power = np.convolve(power, [-0.25, 0.5, -0.25])
    taps = np.ones(1)
    for one in low_pass:
        _, _, _, a1, a2 = one.section(sample_s)
        taps = np.convolve(taps, np.convolve(series, np.array([a2, a1, 1.0]) / (1.0 + a1 + a2)))
    return tuple(map(float, taps)), (TERMS + 1) * len(low_pass)
