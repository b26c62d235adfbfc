"""White, independent noise of inputs and outputs: its covariance at the outputs, and its variances
from covariances.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls


def fit_levels(C: np.ndarray, G: np.ndarray, powers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances of the spectra of the noise of torques (n_m,) and outputs (n_o,), from
    covariances.

    Nonnegative least squares of ``C = G S_u G^H + w^(2 m) S_y`` in units of C itself. Lines that
    fit worse than most count less: transients that the noise leaves between the periods are not
    white.
    """
    n_o, n = G.shape[-2:]
    L = np.linalg.cholesky(regular(C))
    levels = np.zeros(n + n_o)
    trust = np.ones((*G.shape[:2], 1, 1))
    for _ in range(6):
        white = np.linalg.inv(L) * np.sqrt(trust)
        columns = []
        for j in range(n):
            g = white @ G[..., :, j : j + 1]
            columns.append((g @ g.conj().swapaxes(-1, -2)).ravel())
        for j in range(n_o):
            g = white[..., :, j : j + 1] * np.sqrt(powers[:, j, None, None])
            columns.append((g @ g.conj().swapaxes(-1, -2)).ravel())
        target = (white @ C @ white.conj().swapaxes(-1, -2)).ravel()
        M = np.array(columns).T
        scale = np.linalg.norm(M, axis=0)
        M = np.vstack([M.real, M.imag]) / scale
        levels = nnls(M, np.concatenate([target.real, target.imag]))[0] / scale
        L = np.linalg.cholesky(regular(structured_covariance(G, powers, levels[:n], levels[n:])))
        white = np.linalg.inv(L)
        misfit = np.linalg.norm(
            white @ C @ white.conj().swapaxes(-1, -2) - np.eye(n_o), axis=(-2, -1)
        )
        trust = np.minimum(1.0, np.median(misfit) / np.maximum(misfit, 1e-300))[..., None, None]
    return levels[:n], levels[n:]


def structured_covariance(
    G: np.ndarray, powers: np.ndarray, torque: np.ndarray, output: np.ndarray
) -> np.ndarray:
    """``G S_u G^H + w^(2 m) S_y`` (k, lines, n_o, n_o); ``powers``: w^(2 m) (lines, n_o)."""
    white = (powers * output)[:, :, None] * np.eye(G.shape[-2])
    return regular((G * torque) @ G.conj().swapaxes(-1, -2) + white.astype(complex))


def regular(C: np.ndarray) -> np.ndarray:
    """A covariance with a diagonal so little larger that it is positive definite for sure."""
    size = np.real(np.einsum("...aa->...a", C))
    least = np.maximum(size, 1e-12 * size.max(axis=-1, keepdims=True)) * 1e-9 + 1e-300
    return C + least[..., None] * np.eye(C.shape[-1])
