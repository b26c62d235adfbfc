"""Frequency responses from the spectra of inputs and outputs, with the covariance of noise.

    V_ep = Y_ep - G U_ep,   G = Y U^H (U U^H)^-1
    (spectra of experiments e, averaged over the periods p)
    C = sum V V^H / ((P - 1) n_e)
    covariance of the error of the outputs in one period
    cov G_ab, G_cd = C_ac S_bd,   S = (U U^H)^-T / P     noise only
    N_uu, N_yu = noise parts of U U^H and Y U^H
    in closed loop the noise of U and Y has the same causes

Source: R. Pintelon and J. Schoukens, System Identification, 2nd ed. 2012, ch. 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Estimate:
    """Frequency responses ``G`` and their covariances; names and shapes as in `flexgen.Frf`."""

    G: np.ndarray
    UU: np.ndarray
    C: np.ndarray
    variance: np.ndarray
    total: np.ndarray | None
    noise_UU: np.ndarray
    noise_YU: np.ndarray


def estimate(
    U: np.ndarray,
    Y: np.ndarray,
    average: str = "arithmetic",
    noise: tuple[np.ndarray, np.ndarray] | None = None,
) -> Estimate:
    """Frequency responses from the spectra of inputs and outputs.

    Parameters
    ----------
    U, Y : complex arrays (k, realizations, periods, lines, inputs or outputs, experiments)
    average : str
        Over the realizations; one of the names of `flexgen.frf`.
    noise : optional
        Spectra of the noise of inputs and outputs in the mean of the periods, (k, realizations,
        samples, lines, channels, experiments), whose sum of squares is its variance; default: from
        the differences of the periods.

    Raises
    ------
    numpy.linalg.LinAlgError
        The inputs of the experiments are not independent.
    """
    P = U.shape[2]
    E = U.shape[5]
    R = U.shape[1]
    mean_U = U.mean(axis=2)
    mean_Y = Y.mean(axis=2)
    if average == "h1":  # all periods by themselves
        mean_U, mean_Y = (_side_by_side(x) for x in (U, Y))
    weakest = np.linalg.svd(mean_U, compute_uv=False)[..., -1]
    if U.shape[4] > mean_U.shape[-1] or np.any(
        weakest <= 1e-9 * np.abs(mean_U).max(axis=(-2, -1))
    ):
        raise np.linalg.LinAlgError("dependent inputs")
    each = np.linalg.solve(
        (mean_U @ _H(mean_U)).swapaxes(-1, -2), (mean_Y @ _H(mean_U)).swapaxes(-1, -2)
    )
    each = each.swapaxes(-1, -2)  # (k, realizations, lines, outputs, inputs)
    if noise is None:
        V = Y - each[:, :, None] @ U
        count = max((P - 1) * E * R, 1)
        away_U, away_Y = (x - x.mean(axis=2, keepdims=True) for x in (U, Y))
        scale = 1 / max((P - 1) * P, 1)
    else:
        V = noise[1] - each[:, :, None] @ noise[0]
        count = E * R
        (away_U, away_Y) = noise
        scale = 1.0
    C = (V @ _H(V)).sum(axis=(1, 2)) / count
    noise_UU, noise_YU = (scale * (x @ _H(away_U)).sum(axis=(1, 2)) for x in (away_U, away_Y))
    UU = (mean_U @ _H(mean_U)).sum(axis=1) / (P if average == "h1" else 1)
    S = np.linalg.inv(UU) / (P if noise is None else 1)
    variance = (
        np.real(np.einsum("klaa->kla", C))[..., :, None]
        * np.real(np.einsum("klbb->klb", S))[..., None, :]
    )
    total = np.var(each, axis=1, ddof=1) / R if R > 1 else None
    return Estimate(average_of(each, average), UU, C, variance, total, noise_UU, noise_YU)


def _side_by_side(x: np.ndarray) -> np.ndarray:
    """Periods as further experiments: (k, realizations, lines, channels, periods *
    experiments).
    """
    moved = x.transpose(0, 1, 3, 4, 2, 5)
    return moved.reshape(*moved.shape[:4], -1)


def _H(x: np.ndarray) -> np.ndarray:
    return x.conj().swapaxes(-1, -2)


def average_of(each: np.ndarray, average: str) -> np.ndarray:
    """Mean over the realizations, axis 1."""
    if average in ("arithmetic", "h1") or each.shape[1] == 1:
        return each.mean(axis=1)
    if average == "harmonic":
        return np.linalg.inv(np.linalg.inv(each).mean(axis=1))
    reference = each.mean(axis=1, keepdims=True)
    return np.exp(np.log(each / reference).mean(axis=1)) * reference[:, 0]
