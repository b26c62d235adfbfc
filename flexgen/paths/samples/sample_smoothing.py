"""Smoothing of the samples of a path, and the noise in their second derivative.

A spline of degree p through samples has the derivatives of their errors too: an error of 1e-4 rad
every 10 ms is 4 rad/s^2 (root mean square of the second derivative of white noise, pi^2/sqrt(5)
times the error over the step squared). The smooth path is a spline of least squares that is
nowhere farther from the samples than stated; its knots are at samples, equally many between two of
them, and so many that it predicts samples best that are left out.

Noise shows in the differences D^6 x of order 6, divided for steps that are not equal: of white
noise neighbors have the correlation -6/7, of a motion that the samples resolve they have the same
sign.

Source: C. de Boor, A Practical Guide to Splines, 2001, ch. 14 (least squares by splines); P.
Craven and G. Wahba, Numerische Mathematik 31, 1979 (generalized cross-validation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.sparse.linalg import splu

from flexgen.base.errors import ArgumentError

# Factor by which the number of knots grows from trial to trial.
GROWTH = 1.15
# Samples for each knot, at least.
LEAST_SAMPLES = 2
# Trials without an improvement after which the search ends.
NO_BETTER = 6
# Part of the samples that coefficients fit exactly, at most, in the score.
MOST_FITTED = 0.9
# A score that is so near to the best one, relative, is as good.
NEARLY = 1.02
# Samples for each knot from which a spline does not follow a single wrong sample.
FAR_APART = 5
# Order of the differences that show noise, and their correlation with the neighbor below which
# they are noise.
ORDER = 6
ALTERNATING = -0.5
# Largest error of white noise over its standard deviation, among some hundreds of samples.
LARGEST_OF_NOISE = 4.0
# Second derivative of the spline through the samples over that of the smooth path from which it is
# called noise.
NOISY = 1.1
# Fewest samples in which noise is looked for.
FEWEST = 20
# Change of the direction [rad] from one sample to the next that is a kink.
KINK = 0.2
# Ratio of a kink to the changes at the samples next to it, at least.
KINK_OVER_OTHERS = 5.0
# Decimals in which the rounding of samples is looked for, and the tolerance in units of the last
# one.
DECIMALS = range(9)
ROUNDED = 1e-6


@dataclass(frozen=True)
class SmoothSpline:
    """A spline of least squares, with its ``knots`` inner ones.

    ``deviation``: the largest from the samples; ``mean_square``: the mean of the squares of all
    deviations.
    """

    spline: BSpline
    deviation: float
    knots: int
    mean_square: float


def smooth_spline(
    parameter: np.ndarray, values: np.ndarray, degree: int, largest: float, angles: int, rest: bool
) -> SmoothSpline:
    """The spline near the samples that predicts samples best that are left out.

    Among those that deviate from the samples by at most ``largest``, the one with the least
    generalized cross-validation ``rms^2/(1 - p/n)^2``, p: coefficients; fewer knots where it is
    nearly as good.

    Parameters
    ----------
    parameter : array (n,)
        Increasing, from 0.
    values : array (n, d)
    degree : int
        Odd.
    largest : float [unit of each column]
        Of the last ``angles`` columns, a quaternion: the angle [rad].
    rest : bool
        The first ``(degree - 1)/2`` derivatives are zero at both ends.

    Raises
    ------
    ArgumentError
        No spline that the samples determine is near enough; the message names the sample.
    """
    n = len(parameter)
    count = 0
    since = 0
    trials: list[tuple[float, SmoothSpline]] = []
    worst = (np.inf, 0)
    while count <= (n - degree - 1) // LEAST_SAMPLES and since < NO_BETTER:
        trial, at = _least_squares(parameter, values, degree, count, angles, rest)
        coefficients = count + degree + 1 - (degree - 1) * rest
        score = trial.mean_square / (1.0 - min(coefficients / n, MOST_FITTED)) ** 2
        if trial.deviation <= largest:
            since = 0 if not trials or score < min(trials, key=_score)[0] else since + 1
            trials.append((score, trial))
        elif trial.deviation < worst[0] and count <= n / FAR_APART:
            worst = (trial.deviation, at)
        count = max(count + 1, int(GROWTH * count))
    if not trials:
        raise ArgumentError(
            f"smooth: given {largest:g}, but near sample {worst[1] + 1} a smooth path is "
            f"{worst[0]:.3g} away from the samples: a kink, a wrong sample, or samples that do "
            "not begin and end at rest; give a larger deviation, or correct the samples there"
        )
    enough = NEARLY * min(trials, key=_score)[0]
    return next(trial for score, trial in trials if score <= enough)


def _score(trial: tuple[float, SmoothSpline]) -> float:
    return trial[0]


def _least_squares(
    parameter: np.ndarray, values: np.ndarray, degree: int, count: int, angles: int, rest: bool
) -> tuple[SmoothSpline, int]:
    """The spline of a ``degree`` with ``count`` inner knots that is nearest to the samples, and
    the number of the sample farthest from it.

    Parameters
    ----------
    parameter : array (n,)
    values : array (n, width)
        The last ``angles`` columns are of quaternions, whose distance is an angle.
    rest : bool
        Derivatives are zero at both ends: their first and last coefficients are equal.
    """
    at = np.linspace(0, len(parameter) - 1, count + 2)[1:-1]
    inner = np.interp(at, np.arange(len(parameter)), parameter)
    ends = np.full(degree + 1, parameter[0]), np.full(degree + 1, parameter[-1])
    t = np.concatenate([ends[0], inner, ends[1]])
    design = BSpline.design_matrix(parameter, t, degree)
    columns = np.arange(design.shape[1])
    if rest:  # equal coefficients at the ends
        still = (degree - 1) // 2
        columns = np.clip(columns, still, len(columns) - 1 - still) - still
    merge = sparse.csr_matrix((np.ones(len(columns)), (np.arange(len(columns)), columns)))
    reduced = design @ merge
    normal = (reduced.T @ reduced).tocsc()
    coefficients = merge @ splu(normal).solve(reduced.T @ values)
    spline = BSpline(t, coefficients, degree)
    away = np.abs(spline(parameter) - values)
    mean = float((away**2).mean())
    if angles:
        turned = 2.0 * np.linalg.norm(away[:, -angles:], axis=1, keepdims=True)
        away = np.hstack([away[:, :-angles], turned])
    each = away.max(axis=1)
    return SmoothSpline(spline, float(each.max()), count, mean), int(np.argmax(each))


def noise_of(parameter: np.ndarray, x: np.ndarray) -> float:
    """Standard deviation of the white noise in samples x (n,) of a smooth motion; 0: none."""
    if len(x) < FEWEST:
        return 0.0
    windows = np.lib.stride_tricks.sliding_window_view(parameter, ORDER + 1)
    apart = windows[:, :, None] - windows[:, None, :]
    step = (parameter[-1] - parameter[0]) / (len(parameter) - 1)
    scaled = apart / step + np.eye(ORDER + 1)
    weights = 1.0 / scaled.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    differences = (weights * np.lib.stride_tricks.sliding_window_view(x, ORDER + 1)).sum(axis=1)
    power = float(differences @ differences)
    if power == 0.0:
        return 0.0
    correlation = float(differences[1:] @ differences[:-1]) / power
    return float(np.sqrt(power / len(differences))) if correlation < ALTERNATING else 0.0


def noise_warnings(
    parameter: np.ndarray,
    values: np.ndarray,
    through: BSpline,
    names: Sequence[str],
    scale: float,
    rest: bool,
) -> tuple[str, ...]:
    """A sentence for each column whose second derivative is noise, with the figures.

    Parameters
    ----------
    parameter : array (n,)
        Of the samples, increasing from 0: their time over ``scale`` [s], or a length.
    values : array (n, d)
    through : BSpline
        Through the samples.
    names : sequence of str (d,)
    scale : float
    rest : bool
        The path is at rest at both ends.
    """
    out = []
    for k, name in enumerate(names):
        sd = noise_of(parameter, values[:, k])
        if sd == 0.0:
            continue
        largest = LARGEST_OF_NOISE * sd
        try:
            smooth = smooth_spline(
                parameter, values[:, k : k + 1], through.k, largest, 0, rest=rest
            )
        except ArgumentError:
            continue
        fine = np.linspace(parameter[0], parameter[-1], 8 * len(parameter))
        noisy = float(np.abs(through.derivative(2)(fine)[:, k]).max()) / scale**2
        quiet = float(np.abs(smooth.spline.derivative(2)(fine)).max()) / scale**2
        if noisy < NOISY * quiet:
            continue
        out.append(_noise_text(name, sd, noisy, quiet, largest, values[:, k]))
    return tuple(out)


def _noise_text(
    name: str, sd: float, noisy: float, quiet: float, largest: float, x: np.ndarray
) -> str:
    """The sentence on the noise of a column."""
    unit = next((10.0**-k for k in DECIMALS if _is_rounded(x, 10.0**-k)), 0.0)
    cause = ""
    if unit:
        cause = f"; rounding to {unit:g} alone gives {unit / np.sqrt(12):.2g}"
    return (
        f"the second derivative of the samples of {name} is noise: up to {noisy:.3g} on the "
        f"spline through them, {quiet:.3g} on a smooth path that is {largest:.2g} from them; "
        f"errors of the samples of {sd:.2g} (or late times){cause}: set smooth = "
        f"{_round_up(largest)} for this move"
    )


def _is_rounded(x: np.ndarray, unit: float) -> bool:
    return bool(np.abs(x / unit - np.round(x / unit)).max() < ROUNDED * max(1.0, np.abs(x).max()))


def _round_up(x: float) -> str:
    """A number with one digit that is not smaller."""
    power = 10.0 ** np.floor(np.log10(x))
    return f"{np.ceil(x / power - 1e-9) * power:.1g}"


def kinks_of(parameter: np.ndarray, values: np.ndarray, timed: bool) -> list[tuple[int, float]]:
    """Numbers of the samples at which the path has a kink, and the size of the kink.

    The angle [rad], or the relative jump of the speed. Without times the direction changes from
    one sample to the next by more than `KINK`, and by `KINK_OVER_OTHERS` times that of the samples
    next to it; with times the speed changes by such a part of its largest value.
    """
    if len(values) < ORDER:
        return []
    slopes = np.diff(values, axis=0)
    if timed:
        slopes = slopes / np.diff(parameter)[:, None]
        size = float(np.linalg.norm(slopes, axis=1).max())
        turn = np.linalg.norm(np.diff(slopes, axis=0), axis=1) / max(size, 1e-300)
    else:
        unit = slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-300)
        turn = 2.0 * np.arcsin(np.minimum(np.linalg.norm(np.diff(unit, axis=0), axis=1) / 2, 1.0))
    beside = np.pad(turn, 2)
    n = len(turn)
    others = np.max([beside[k : k + n] for k in (0, 1, 3, 4)], axis=0)
    found = np.flatnonzero((turn > KINK) & (turn > KINK_OVER_OTHERS * others))
    return [(int(k) + 1, float(turn[k])) for k in found]
