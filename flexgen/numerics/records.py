"""Files of records, and what records say about themselves: lost samples, transients that have not decayed.

A transient is in the first period more than in the later ones, noise is in all alike: with the spectra ``X_p`` of the
periods, ``E_p = sum |X_{p+1} - X_p|^2`` is the same for all p up to its scatter, and ``E_1`` larger with a transient.

Source: R. Pintelon and J. Schoukens, System Identification, 2nd ed. 2012, sec. 2.5 (transients of periodic signals).
"""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.npz_files import NpzError, read_npz

# least steps, over the resolution, in which one repeated sample is seen; in coarser ones a number
# of them
FINE = 100
COARSE = 4
TRANSIENT = "a transient remains"  # the words of a warning that withholds intervals
SURE = 6.0  # standard deviations of a ratio of powers
SMALLEST = 1e-4  # transient over signal


def lost_samples(x: np.ndarray) -> np.ndarray:
    """Where samples of ``x`` (n,) repeat the one before and a jump makes up for it.

    Once where the steps are far above the resolution, else `COARSE` times. An axis that stands still and starts has no
    such jump.
    """
    steps = np.abs(np.diff(x))
    least = float(steps[steps > 0].min())
    still = 1 if np.median(steps) > FINE * least else COARSE
    run = np.asarray(np.lib.stride_tricks.sliding_window_view(steps == 0, still).all(axis=1))[:-2]
    jump, after = steps[still:-1], steps[still + 1 :]
    return np.asarray(np.flatnonzero(run & (jump >= 5 * least) & (jump > 1.5 * after)))


def first_period_excess(X: np.ndarray) -> np.ndarray:
    """``E_1`` over the mean of the others, per channel (c,); 1 where it can be scatter or is below `SMALLEST`.

    ``X`` (..., periods, lines, c): complex spectra of records. With fewer than three periods all are 1.
    """
    X = X.reshape(-1, *X.shape[-3:])
    if X.shape[1] < 3:
        return np.ones(X.shape[-1])
    power = np.abs(np.diff(X, axis=1)) ** 2
    later = power[:, 1:].mean(axis=(0, 1))  # (lines, c)
    each = later.sum(axis=0)
    # real numbers of the same power
    count = 2 * len(X) * each**2 / np.maximum((later**2).sum(axis=0), 1e-300)
    ratio = power[:, 0].mean(axis=0).sum(axis=0) / np.maximum(each, 1e-300)
    large = power[:, 0].mean(axis=(0, 1)) > SMALLEST**2 * (np.abs(X) ** 2).mean(axis=(0, 1, 2))
    return np.asarray(
        np.where((ratio > 1 + SURE * np.sqrt(4 / np.maximum(count, 1))) & large, ratio, 1.0)
    )


def first_period_differs(*signals: np.ndarray) -> np.ndarray:
    """Where (c,) the first period of one of the signals differs from the others."""
    return np.asarray(np.any([first_period_excess(X) > 1.0 for X in signals], axis=0))


def slow_transients(X: np.ndarray) -> np.ndarray:
    """Where (c,) a transient is in all periods: differences shrink by a factor r, |r| above the 1/2 of noise."""
    D = np.diff(X.reshape(-1, *X.shape[-3:]), axis=1)
    if D.shape[1] < 2:
        return np.zeros(X.shape[-1], bool)
    power = (np.abs(D) ** 2).mean(axis=(0, 1))  # (lines, c)
    each, pairs = power.sum(axis=0), D.shape[0] * (D.shape[1] - 1)
    kept = np.abs((D[:, 1:] * D[:, :-1].conj()).sum(axis=(0, 1, 2))) / np.maximum(
        pairs * each, 1e-300
    )
    count = pairs * each**2 / np.maximum((power**2).sum(axis=0), 1e-300)
    large = power.mean(axis=0) > SMALLEST**2 * (np.abs(X) ** 2).reshape(-1, X.shape[-1]).mean(
        axis=0
    )
    return np.asarray((kept > 0.5 + SURE / np.sqrt(np.maximum(count, 1))) & large)


def read_named(file: Path, size_max: int) -> dict[str, Any]:
    """The arrays of a file of another program by their names: .npz, .mat (version 5), .csv with names in line 1.

    Raises
    ------
    ArgumentError
        The file is larger than ``size_max`` bytes, cannot be read, or ends otherwise.
    """
    if file.stat().st_size > size_max:
        raise ArgumentError(
            f"{file}: given {file.stat().st_size} bytes, expected at most {size_max}"
        )
    if file.suffix == ".npz":
        try:
            return dict(read_npz(file, size_max))
        except NpzError as error:
            raise ArgumentError(f"{file}: {error}") from None
    if file.suffix == ".csv":
        return _csv(file)
    if file.suffix == ".mat":
        from scipy.io import loadmat

        try:
            found = loadmat(str(file))
        except Exception as error:  # the reader raises many kinds for a damaged file
            raise ArgumentError(
                f"{file}: cannot be read as a MAT file of version 5 ({error})"
            ) from None
        return {
            name: x
            for name, x in found.items()
            if isinstance(x, np.ndarray) and not name.startswith("_")
        }
    raise ArgumentError(f"{file}: given the ending {file.suffix!r}, expected .mat, .npz or .csv")


def _csv(file: Path) -> dict[str, Any]:
    """Columns by the names in the first line."""
    try:
        with file.open(encoding="utf-8-sig") as stream:
            names = [name.strip() for name in stream.readline().split(",")]
            if not (first := stream.readline()).strip():
                raise ValueError("no numbers")
            values = np.loadtxt(chain([first], stream), delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        expected = (
            "names in line 1, then numbers with a decimal point, and commas between the columns"
        )
        why = str(error).partition("; use")[0]
        raise ArgumentError(f"{file}: cannot be read: {why}; expected {expected}") from None
    if values.shape[1] != len(names) or len(set(names)) != len(names):
        raise ArgumentError(
            f"{file}: given {values.shape[1]} columns and the names {names}, expected one name each"
        )
    return dict(zip(names, values.T, strict=True))
