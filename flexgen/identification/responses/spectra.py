"""Spectra of samples at the excited lines, and at the frequencies next to them.

    X(l) = 2/N sum_k x(t_k) exp(-j w_l t_k)          one period of N samples

A record of P periods has P - 1 frequencies between two multiples of 1/period, at which nothing is
excited: what is found there is noise, and the transient of a motion that has not settled. Both are
smooth functions of the frequency; at the line itself the transient is the value of a polynomial
through its neighbors (local polynomial method).

Source: R. Pintelon and J. Schoukens, System Identification, 2nd ed. 2012, sec. 7.3 (robust local
polynomial method).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError

MOST_OFFSETS = 4  # on each side of a line
SPECTRA_BESIDE = ("offsets", "beside", "offsets_later", "beside_later")
LEAST_LATER = 3  # periods of a record without its first, so that they can be compared
DEGREE = 2  # of the polynomial, with six offsets or more; else 1


def spectrum(x: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Amplitudes (lines, n) of the Fourier series of one period of samples (N, n)."""
    return 2.0 / len(x) * np.fft.rfft(x, axis=0)[lines]


def windowed_spectrum(x: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Amplitudes (lines, n) of a segment without period, with a Hann window of mean square 1 and
    without its mean.
    """
    window = np.hanning(len(x) + 1)[:-1]
    window = window / np.sqrt((window**2).mean())
    return spectrum((x - x.mean(axis=0)) * window[:, None], lines)


def line_offsets(lines: np.ndarray, periods: int) -> np.ndarray:
    """Offsets from the lines, in multiples of ``1 / (periods * period_s)``, at which nothing is
    excited.

    Multiples of ``1 / period_s`` are not among them: distortion is there.

    Raises
    ------
    ArgumentError
        There are fewer than two on each side.
    """
    excited = set((periods * lines).tolist())
    free = [
        d
        for d in range(1, 4 * MOST_OFFSETS)
        if d % periods
        and all(periods * line + s * d not in excited for line in lines.tolist() for s in (-1, 1))
        and d < periods * lines[0]
    ]
    if len(free) < 2:
        raise ArgumentError(
            f"transients: given {periods} periods and lines from {lines[0]} on, expected two "
            "unexcited frequencies or more on each side of a line: measure more periods, or "
            "leave lines out"
        )
    chosen = np.array(free[:MOST_OFFSETS])
    return np.concatenate([-chosen[::-1], chosen])


def spectra_beside(
    x: np.ndarray, lines: np.ndarray, offsets: np.ndarray, period: int, periods: int
) -> np.ndarray:
    """Contribution of one period (N, n) to the spectra (offsets, lines, n) of the whole record
    beside the lines.

    ``period``: its number, from 0, of ``periods``.
    """
    n = np.arange(len(x))
    out = np.empty((len(offsets), len(lines), x.shape[1]), complex)
    at = {d: k for k, d in enumerate(offsets.tolist())}
    for d in sorted(set(map(abs, at))):  # one transform of real samples has both sides of a line
        turn = np.exp(-2j * np.pi * d * (n / len(x) + period) / periods)
        found = 2.0 / len(x) * np.fft.fft(x * turn[:, None], axis=0)
        out[at[d]] = found[lines]
        out[at[-d]] = found[-lines].conj()
    return out / periods


def records_beside(lines: np.ndarray, periods: int) -> dict[str, tuple[int, np.ndarray]]:
    """First period, from 0, and `line_offsets` of the whole record, and of the one without its
    first period ("_later").

    The second only where `LEAST_LATER` periods are left. The names are ends of `SPECTRA_BESIDE`.

    Raises
    ------
    ArgumentError
        As `line_offsets`, of the whole record.
    """
    out = {"": (0, line_offsets(lines, periods))}
    if periods > LEAST_LATER:
        with suppress(ArgumentError):
            out["_later"] = 1, line_offsets(lines, periods - 1)
    return out


def all_spectra_beside(x: np.ndarray, lines: np.ndarray) -> dict[str, Any]:
    """Arrays named as in `SPECTRA_BESIDE` of x (poses, experiments, periods, samples, n); none:
    too few periods.
    """
    out: dict[str, Any] = {}
    with suppress(ArgumentError):
        for end, (first, offsets) in records_beside(lines, x.shape[2]).items():
            part = x[:, :, first:].reshape(*x.shape[:2], -1, x.shape[-1])
            at = (x.shape[2] - first) * lines[None, :] + offsets[:, None]
            found = 2.0 / part.shape[2] * np.fft.fft(part, axis=2)[:, :, at]
            out |= {f"offsets{end}": offsets, f"beside{end}": found[:, None]}
    return out


def checked_beside(
    arrays: dict[str, np.ndarray], runs: tuple[int, ...], last: tuple[int, ...]
) -> dict[str, Any]:
    """The arrays `SPECTRA_BESIDE` of a file, (*runs, offsets, *last); ValueError where they have
    other sizes.
    """
    out: dict[str, Any] = {name: arrays[name] for name in SPECTRA_BESIDE if name in arrays}
    for names in (SPECTRA_BESIDE[:2], SPECTRA_BESIDE[2:]):
        offsets, beside = (out.get(name) for name in names)
        if (offsets is None) != (beside is None):
            raise ValueError(f"{', '.join(names)}: expected both or none")
        if offsets is not None and beside is not None:
            if offsets.ndim != 1 or beside.shape != (*runs, len(offsets), *last):
                raise ValueError(f"{', '.join(names)}: arrays of different sizes")
            out[names[0]] = offsets.astype(int)
    return out


@dataclass(frozen=True)
class SteadySpectra:
    """Spectra without transients.

    ``lines`` (..., lines, n); ``noise`` (..., offsets, lines, n) of the whole record, ``freedom``
    of the offsets are independent; ``spread``: variance at a line over that of the noise, since
    the transient is not known exactly.
    """

    lines: np.ndarray
    noise: np.ndarray
    freedom: int
    spread: float


def without_transients(
    lines: np.ndarray, beside: np.ndarray, offsets: np.ndarray
) -> SteadySpectra:
    """Subtract the transient that the spectra beside the lines show.

    Parameters
    ----------
    lines : complex array (..., lines, n)
        Of the whole record.
    beside : complex array (..., offsets, lines, n)
    offsets : array of int (offsets,)
    """
    degree = DEGREE if len(offsets) >= 2 * DEGREE + 2 else 1
    A = offsets[:, None].astype(float) ** np.arange(degree + 1)
    fit = np.linalg.pinv(A)  # (degree + 1, offsets)
    transient = np.einsum("d,...dln->...ln", fit[0], beside)
    smooth = np.einsum("ed,...dln->...eln", A @ fit, beside)
    return SteadySpectra(
        lines - transient, beside - smooth, len(offsets) - degree - 1, 1.0 + float(fit[0] @ fit[0])
    )
