"""Variance components of the residuals of a calibration: noise of each point, and a tilt of one
element that changes from pose to pose.

    r = noise + B tilt,      noise ~ N(0, s^2 I),   tilt ~ N(0, diag(d)),
    Sigma = s^2 I + B diag(d) B'

``r`` (3 k): errors of all trackers of a pose; ``B``: their derivatives in three rotations of the
element. ``s``, ``d``: those of the largest likelihood. Trackers that a tilt moves together tell
about each other: with one seen, the error of another is ``Sigma_ba Sigma_aa^-1 r_a``.

Source: S. R. Searle, G. Casella, C. E. McCulloch, Variance Components, 1992, ch. 6-7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammainccinv

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import short_repr
from flexgen.base.results import Result
from flexgen.identification.poses.parameters import Unknown, trackers_of
from flexgen.identification.poses.statics import Numbers, Rest, Statics
from flexgen.identification.poses.tree import SHIFTS

START_TILT = 1e-3  # rad
FEWEST = 20  # poses with all trackers seen
QUIET = 1e-7  # m: errors below this, as of simulated poses, need no explanation
CHANCE = 0.01  # of a tilt that is named although the errors are independent
UNSEEN = 1e3  # m: standard deviation of a point that was not seen


@checked_result
@dataclass(frozen=True)
class Tilt(Result):
    """The element whose tilt from pose to pose explains the remaining errors best.

    Parameters
    ----------
    element : str
    noise_m : float [m]
        Standard deviation of one axis of a point, without the tilt.
    tilt_rad : array (3,) [rad]
        Standard deviations of the rotations about the axes of the element's place at its parent.
    alone_m : float [m]
        Standard deviation of one axis of a point without such a tilt.

    Examples
    --------
    >>> import numpy as np
    >>> from flexgen.identification.poses.components import Tilt
    >>> Tilt("chest", 7e-4, np.array([1e-3, 1e-3, 2e-3]), 1.6e-3).element
    'chest'
    """

    element: str
    noise_m: float
    tilt_rad: np.ndarray
    alone_m: float

    __repr__ = short_repr


def tilt_slopes(
    statics: Statics, numbers: Numbers, rest: Rest, elements: Sequence[str]
) -> list[np.ndarray]:
    """``B`` (N, 3 k, 3) of each element."""
    names = [f"{element}.{shift}" for element in elements for shift in SHIFTS[3:]]
    turns = [Unknown(name, "rad", "node", (statics.tree.index[name],), 0.0, 1.0) for name in names]
    slopes = np.split(statics.slopes(numbers, rest, turns)[0], len(elements), axis=3)
    return [each.reshape(len(rest.q), -1, 3) for each in slopes]


def whitening_of(tilt: Tilt, B: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """``W`` (N, 3 k, 3 k) with ``W Sigma W' = 1``; points that were not seen, ``valid`` (N, k)
    False, do not count.
    """
    sigma = (B * tilt.tilt_rad**2) @ np.swapaxes(B, 1, 2) + tilt.noise_m**2 * np.eye(B.shape[1])
    unseen = np.repeat(np.where(valid, 0.0, UNSEEN**2), 3, axis=1)
    return np.linalg.inv(np.linalg.cholesky(sigma + unseen[:, :, None] * np.eye(B.shape[1])))


def find_tilt(
    statics: Statics, numbers: Numbers, rest: Rest, measured: np.ndarray, usable: np.ndarray
) -> Tilt | None:
    """The tilt of the largest likelihood among the elements that move at least two trackers.

    ``usable`` (N,): False for poses with gross errors. None: fewer than two trackers share an
    element, too few poses see them all, there are no errors, or noise alone is as likely: with
    independent errors twice the logarithm of the ratio of the likelihoods is at most as large as a
    chi-squared number of three degrees of freedom, and the largest of all elements exceeds the
    bound once in ``1 / CHANCE`` calibrations at most.
    """
    tree = statics.tree
    moved = {
        e.name: tree.carries[tree.index[f"{e.name}.rx"], [m.node for m in statics.places]]
        for e in tree.model.elements
    }
    shared = [name for name, which in moved.items() if which.sum() >= 2]
    seen = np.isfinite(measured).all(axis=2)
    complete = seen.all(axis=1) & usable
    if not shared or complete.sum() < FEWEST:
        return None
    r = (rest.measured - measured)[complete].reshape(int(complete.sum()), -1)
    if np.abs(r).max() < QUIET:
        return None
    slopes = tilt_slopes(statics, numbers, rest, shared)
    found = [(likelihood(r, B[complete]), name) for B, name in zip(slopes, shared, strict=True)]
    (least, x), name = min(found, key=lambda one: one[0][0])
    alone = 0.5 * r.size * (np.log((r**2).mean()) + 1.0)
    if alone - least < gammainccinv(1.5, CHANCE / len(shared)):  # half of the chi-squared number
        return None
    sd = np.exp(x / 2)
    return Tilt(name, float(sd[0]), sd[1:], float(np.sqrt((r**2).mean())))


def predict_others(tilt: Tilt, B: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Errors (N, k, 3) that remain at each tracker when all others of its pose are seen; ``gap``
    (N, k, 3) [m].
    """
    out = np.array(gap)
    k = gap.shape[1]
    for b in range(k):
        one = np.arange(3 * b, 3 * b + 3)
        rest = np.setdiff1d(np.arange(3 * k), one)
        shared = B * tilt.tilt_rad**2
        inner = shared[:, rest] @ np.swapaxes(B[:, rest], 1, 2) + tilt.noise_m**2 * np.eye(
            len(rest)
        )
        seen = gap.reshape(len(gap), -1)[:, rest]
        known = np.linalg.solve(inner, seen[..., None])
        out[:, b] -= (shared[:, one] @ np.swapaxes(B[:, rest], 1, 2) @ known)[..., 0]
    return out


def likelihood(r: np.ndarray, B: np.ndarray) -> tuple[float, np.ndarray]:
    """Least negative logarithm of the likelihood, and the logarithms of the variances
    ``s^2, d``.
    """

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        s2 = np.exp(x[0])
        d = np.exp(x[1:])
        sigma = s2 * np.eye(r.shape[1]) + (B * d) @ np.swapaxes(B, 1, 2)
        inverse = np.linalg.inv(sigma)
        z = (inverse @ r[..., None])[..., 0]
        slope = [s2 * (np.einsum("nii->", inverse) - (z**2).sum())]
        slope += [
            d[k]
            * (np.einsum("ni,nij,nj->", b, inverse, b) - (np.einsum("ni,ni->n", b, z) ** 2).sum())
            for k, b in enumerate(np.moveaxis(B, 2, 0))
        ]
        return 0.5 * ((r * z).sum() + np.linalg.slogdet(sigma)[1].sum()), 0.5 * np.array(slope)

    start = np.log([max((r**2).mean(), 1e-18), *3 * [START_TILT**2]])

    def search(below: float, above: float) -> tuple[float, np.ndarray]:
        bounds = [(x - below, x + above) for x in start]
        found = minimize(
            value,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"ftol": 1e-13, "gtol": 1e-8},
        )
        return float(found.fun), np.asarray(found.x)

    try:
        return search(25.0, 10.0)
    except np.linalg.LinAlgError:  # a step went so far that Sigma is singular to rounding
        return search(12.0, 4.0)


def seen_others(
    statics: Statics, numbers: Numbers, rest: Rest, measured: np.ndarray, tilt: Tilt
) -> np.ndarray:
    """Lengths (N, k) [m] of the errors that remain at each tracker when the others are seen; nan
    where one is not.
    """
    gap = rest.measured - measured
    lengths = np.full(gap.shape[:2], np.nan)
    complete = np.isfinite(gap).all(axis=(1, 2))
    if complete.any() and len(trackers_of(statics.model)) > 1:
        B = tilt_slopes(statics, numbers, rest, [tilt.element])[0][complete]
        lengths[complete] = np.linalg.norm(predict_others(tilt, B, gap[complete]), axis=2)
    return lengths
