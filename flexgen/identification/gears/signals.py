"""Motor angles and torques of a record in the band of the motion, at fewer samples, and their
noise.

Both pass the same linear-phase low-pass filter, which a linear robot does not see. Torques,
measured and computed from the angles, pass another one, since friction and hysteresis make higher
frequencies than those of the motion. Above the motion lies noise: its density is that of the
highest frequencies of the record, and the band ends where the motion falls below it. Angles have a
wider band than torques: little wider where torques are smooth, since noise would come through
hysteresis. Rough torques, of drives that amplify the noise of their angles, shake the gears above
the motion, which narrows their loops, so that the angles keep more of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import firwin, oaconvolve, welch
from scipy.stats import chi2

from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.arguments import is_number

ABOVE_NOISE = 10.0  # power of the motion over that of the noise, up to which the band goes
WIDER = 1.5  # than that, the band
LEAST_HZ = 5.0  # of the band
MOST = 1 / 20  # the latter of the sample rate
LEAST = 6  # lengths of the filter in a record, at least
TAPS = 12  # length of the filter in periods of the end of the band
WINDOW = ("kaiser", 9.0)
# end of the band of the angles over that of the torques: with smooth torques, and with rough ones
WIDE = (2.0, 3.0)
ROUGH = 1e-3  # of the torques: white noise in them from which they are rough
# pieces of the record; their window, whose side lobes are below the noise
SPECTRUM_S = 4.0
STEEP = ("kaiser", 18.0)
PER_PERIOD = 5  # samples in the period of that end, at least
# of a step: largest difference of a time from that of equal steps, such as by the rounding of a
# clock
EVEN = 0.02
QUIET = 0.35  # of the sample rate, above which all is noise


@dataclass(frozen=True)
class Signals:
    """A record in the band below ``band_hz``.

    ``time`` (n,) [s], ``q_m`` [rad], ``tau_m`` [N m] (n, n_m); ``angle_sd``, ``torque_sd`` (n_m,):
    of white noise on the samples of the record; ``taps``: the filter; ``every``: samples of the
    record for one of these.
    """

    time: np.ndarray
    q_m: np.ndarray
    tau_m: np.ndarray
    band_hz: float
    angle_sd: np.ndarray
    torque_sd: np.ndarray
    taps: np.ndarray
    every: int

    @property
    def sample_s(self) -> float:
        """Between two samples [s]."""
        return float(self.time[1] - self.time[0])

    def torques(self, x: np.ndarray) -> np.ndarray:
        """Torques (n, k) at these samples after the second filter (n - 2 margin, k)."""
        return _filter(x, self._again, 1)

    def reduce(self, x: np.ndarray) -> np.ndarray:
        """Other channels (n, k) of the record in the band of the angles, at these samples."""
        return _filter(x, self.taps, self.every)

    @property
    def margin(self) -> int:
        """Samples that the second filter takes from both ends."""
        return len(self._again) // 2

    @cached_property
    def _again(self) -> np.ndarray:
        return firwin(
            _count(1.0 / self.sample_s, self.band_hz),
            self.band_hz,
            fs=1.0 / self.sample_s,
            window=WINDOW,
        )

    @property
    def torque_noise(self) -> np.ndarray:
        """Standard deviation (n_m,) of the noise of the torques after both filters [N m]."""
        twice = np.zeros(self.every * (len(self._again) - 1) + 1)
        twice[:: self.every] = self._again
        return np.asarray(self.torque_sd * np.sqrt((np.convolve(twice, self.taps) ** 2).sum()))

    def angle_noise(self, rng: np.random.Generator) -> np.ndarray:
        """A sample (n, n_m) of the noise of the angles after the first filter [rad]."""
        white = rng.normal(
            size=(self.every * (len(self.time) - 1) + len(self.taps), len(self.angle_sd))
        )
        return _filter(white * self.angle_sd, self.taps, self.every)


def signals_of(record: Trajectory, motors: int, band_hz: float | None) -> Signals:
    """The record of so many motors in its band; ``band_hz``: its end, None: where the angles fall
    below their noise.

    Raises
    ------
    ArgumentError
        The record is of other motors, is not equidistant, or is too short; the band is wider than
        the sampling allows.
    """
    q_m = record["q_m"]
    tau_m = record["tau_m"]
    n = len(record.time)
    span = float(record.time[-1] - record.time[0])
    time = np.linspace(0.0, span, n)
    for name, x in (("q_m", q_m), ("tau_m", tau_m)):
        if x.shape[1] != motors:
            raise ArgumentError(f"record: given {x.shape[1]} columns of {name}, expected {motors}")
        if not np.isfinite(x).all():
            raise ArgumentError(
                f"record: given NaN or infinity in {name}, expected finite numbers"
            )
    if np.abs(record.time - record.time[0] - time).max() > EVEN * time[1]:
        raise ArgumentError(
            "record: given unequal steps in time, expected the same step between all samples"
        )
    still = [str(j + 1) for j in np.flatnonzero(np.ptp(q_m, axis=0) == 0.0)]
    if still:
        raise ArgumentError(
            f"record: given motor {', '.join(still)} at rest, expected that all motors move"
        )
    rate = (n - 1) / span
    size = min(n, int(SPECTRUM_S * rate))
    pieces = (n - size // 2) // (size - size // 2)  # which overlap by a half
    median = chi2.median(2 * pieces) / (2 * pieces)  # of the power of white noise, over its mean
    f, power = welch(q_m, rate, STEEP, nperseg=size, axis=0, detrend="linear")
    floor = np.median(power[f > QUIET * rate], axis=0) / median
    _, torque_power = welch(tau_m, rate, STEEP, nperseg=size, axis=0, detrend="linear")
    torque_sd = np.sqrt(np.median(torque_power[f > QUIET * rate], axis=0) / median * rate / 2)
    wide = WIDE[int((torque_sd > ROUGH * tau_m.std(axis=0)).any())]
    if band_hz is None:
        moves = (power > ABOVE_NOISE * floor).any(axis=1) & (f < QUIET * rate)
        first_quiet = f[np.argmin(moves[1:]) + 1] if not moves[1:].all() else f[-1]
        shortest = TAPS * rate / wide / max(n / LEAST - 3, 1.0)  # whose filter is not too long
        band_hz = float(np.clip(WIDER * first_quiet, max(LEAST_HZ, shortest), MOST * rate))
    elif not is_number(band_hz) or not 0.0 < band_hz <= MOST * rate:
        raise ArgumentError(
            f"band_hz: given {show_value(band_hz)}, expected a number > 0, at most "
            f"{MOST * rate:.4g} Hz"
        )
    count = _count(rate, wide * band_hz)
    if n < LEAST * count:
        least = LEAST * count / rate
        raise ArgumentError(
            f"record: given {span:.3g} s, expected at least {least:.3g} s to compare motions "
            f"below {band_hz:.3g} Hz"
        )
    taps = firwin(count, wide * band_hz, fs=rate, window=WINDOW)
    every = max(1, int(rate / (PER_PERIOD * wide * band_hz)))
    half = count // 2
    return Signals(
        time=time[half : n - half : every],
        q_m=_filter(q_m, taps, every),
        tau_m=_filter(tau_m, taps, every),
        band_hz=band_hz,
        angle_sd=np.sqrt(floor * rate / 2),
        torque_sd=torque_sd,
        taps=taps,
        every=every,
    )


def _count(rate: float, band_hz: float) -> int:
    """Coefficients of the filter, an odd number."""
    return 2 * int(np.ceil(TAPS / 2 * rate / band_hz)) + 1


def _filter(x: np.ndarray, taps: np.ndarray, every: int) -> np.ndarray:
    """Every so many samples of (n, k) after the filter, where it is filled."""
    return np.asarray(oaconvolve(x, taps[:, None], mode="valid", axes=0)[::every])
