"""Path deviation: smooth deviations from a path, as splines in time that are zero before and after
them.

    position  p + d_p(t),    orientation  exp(d_r(t)) R,    d = sum_i c_i B_i(t)

with B-splines B_i of degree seven, which have six continuous derivatives: the torque depends on
four or five of them, and the fastest zeros of six-axis robots make a jump in the next one a kink
of the torque.

Source: C. de Boor, A Practical Guide to Splines, 2001, ch. IX; for the derivatives of a rotation
vector: J. Stuelpnagel, SIAM Review 6(4), 1964.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

DEGREE = 7
SUPPORT = DEGREE + 1  # intervals between knots over which one spline is not zero


@dataclass(frozen=True)
class DeviationBasis:
    """The deviations ``d`` (n, n_y) spanned by splines with knots ``spacing`` [s] apart.

    Parameters
    ----------
    t : ndarray (n,) [s]
        Instants.
    first : float [s]
        The first knot: there all deviations and six derivatives are zero.
    spacing : float [s]
        Distance of the knots.
    count : int
        Number of splines; the last one ends ``count + 7`` intervals after the first knot.
    """

    t: np.ndarray
    first: float
    spacing: float
    count: int

    @cached_property
    def basis(self) -> list[np.ndarray]:
        """Values and derivatives one to six of the splines, each (n, count)."""
        # splines are complete between the eighth knot and the eighth from the end
        knots = self.first + self.spacing * np.arange(-DEGREE, self.count + 2 * DEGREE + 1)
        picked = np.pad(np.eye(self.count), ((DEGREE, DEGREE), (0, 0)))
        spline = BSpline(knots, picked, DEGREE)
        inside = (self.t > self.first) & (
            self.t < self.first + self.spacing * (self.count + DEGREE)
        )
        return [spline(self.t, nu=k) * inside[:, None] for k in range(DEGREE)]

    @property
    def middles(self) -> np.ndarray:
        """Instants where the splines are largest, (count,) [s]."""
        return self.first + self.spacing * (np.arange(self.count) + SUPPORT / 2)

    def along(self, c: np.ndarray, k: int = 0) -> np.ndarray:
        """The deviation (n, n_y) with coefficients ``c`` (count, n_y), or its k-th derivative."""
        return self.basis[k] @ c


def deviated_path(
    y: np.ndarray, dy: np.ndarray, ddy: np.ndarray, d: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A path plus deviations.

    Parameters
    ----------
    y : ndarray (n, n_t)
        Output; for a pose position and rotation matrix by columns.
    dy, ddy : ndarray (n, n_y)
        Its derivatives; for a pose linear and angular, world axes.
    d : three arrays (n, n_y)
        Deviation and its first two time derivatives; of a pose the last three are a rotation
        vector, world axes.

    Returns
    -------
    y, dy, ddy : arrays of the same shapes
    """
    n, n_y = dy.shape
    if y.shape[1] == n_y:
        return y + d[0], dy + d[1], ddy + d[2]
    f, df, ddf = (x[:, 3:] for x in d)
    R = y[:, 3:].reshape(n, 3, 3).transpose(0, 2, 1)
    E = _matrices(f)
    turn, turn_rate = _turn(f, df, ddf)
    spun, spun_rate = (np.einsum("nij,nj->ni", E, x[:, 3:]) for x in (dy, ddy))
    columns = np.einsum("nij,njk->nik", E, R).transpose(0, 2, 1).reshape(n, 9)
    return (
        np.hstack([y[:, :3] + d[0][:, :3], columns]),
        np.hstack([dy[:, :3] + d[1][:, :3], turn + spun]),
        np.hstack([ddy[:, :3] + d[2][:, :3], turn_rate + np.cross(turn, spun) + spun_rate]),
    )


def _matrices(f: np.ndarray) -> np.ndarray:
    """exp of rotation vectors (n, 3)."""
    S = np.zeros((len(f), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        S[:, j, i] = f[:, k]
        S[:, i, j] = -f[:, k]
    angle = np.linalg.norm(f, axis=1)[:, None, None]
    return (
        np.eye(3) + np.sinc(angle / np.pi) * S + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (S @ S)
    )


def _turn(f: np.ndarray, df: np.ndarray, ddf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angular velocity ``f' + A f x f' + B f x (f x f')`` of a rotation vector that moves, and its
    rate.
    """
    # angle squared; both factors as series, to 1e-12 up to one radian
    u = (f**2).sum(axis=1)[:, None]
    A = 1 / 2 - u / 24 * (1 - u / 30 * (1 - u / 56 * (1 - u / 90 * (1 - u / 132))))
    B = 1 / 6 - u / 120 * (1 - u / 42 * (1 - u / 72 * (1 - u / 110 * (1 - u / 156))))
    dA = -1 / 24 + u / 360 - u**2 / 13440 + u**3 / 907200 - u**4 / 95800320
    dB = -1 / 120 + u / 2520 - u**2 / 120960 + u**3 / 9979200 - u**4 / 1245404160
    du = 2 * (f * df).sum(axis=1)[:, None]
    once = np.cross(f, df)
    twice = np.cross(f, np.cross(f, df))
    other = np.cross(f, ddf)
    double = np.cross(f, np.cross(f, ddf))
    w = df + A * once + B * twice
    rate = ddf + dA * du * once + A * other + dB * du * twice + B * (np.cross(df, once) + double)
    return w, rate
