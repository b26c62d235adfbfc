"""Physically consistent bodies: their ten numbers, their pseudo-inertia, and parameters under
which it is positive.

The ten numbers of a body are mass, mass x center of mass, and inertia about the origin of its
frame.

Source: C. Rucker and P. Wensing, IEEE RA-L 7(2), 2022 (log-Cholesky parameters).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.model.elements import Body

LEAST_LENGTH = 0.01  # of a body
LEAST = 1e-8  # over all bodies


class Feasible:
    """Bodies with a positive definite pseudo-inertia: logarithms of the diagonal of L, and its
    lower entries.

    ``unit``: of the ten numbers in L, see `units`.
    """

    _LOWER = ((1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2))

    def __init__(self, bodies: int, unit: np.ndarray | float = 1.0) -> None:
        x = ca.SX.sym("x", 10)
        L = ca.SX.zeros(4, 4)
        for k in range(4):
            L[k, k] = ca.exp(x[k])
        for k, (i, j) in enumerate(self._LOWER):
            L[i, j] = x[4 + k]
        P = ca.mtimes(L, L.T)
        S = P[:3, :3]
        inertia = ca.trace(S) * ca.SX.eye(3) - S
        pi = ca.vertcat(
            P[3, 3],
            P[0, 3],
            P[1, 3],
            P[2, 3],
            inertia[0, 0],
            inertia[1, 1],
            inertia[2, 2],
            inertia[0, 1],
            inertia[1, 2],
            inertia[0, 2],
        )
        self.bodies = bodies
        self._unit = np.broadcast_to(unit, 10)
        self._function = ca.Function("feasible", [x], [pi, ca.densify(ca.jacobian(pi, x))])

    def pi(self, x: np.ndarray) -> np.ndarray:
        """Numbers of the bodies (10 bodies,)."""
        return (evaluate(self._function, x.reshape(-1, 10))[0] * self._unit).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of `pi`, block diagonal."""
        blocks = (
            evaluate(self._function, x.reshape(-1, 10))[1].reshape(-1, 10, 10)
            * self._unit[:, None]
        )
        out = np.zeros((10 * self.bodies, 10 * self.bodies))
        for k, block in enumerate(blocks):
            out[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = block
        return out

    def x(self, pi: np.ndarray) -> np.ndarray:
        """Parameters of bodies; one that is not physically consistent is made a little larger
        first.
        """
        out = []
        for row in pi.reshape(-1, 10) / self._unit:
            P = pseudo_inertia(row)
            values, vectors = np.linalg.eigh(P)
            values = np.maximum(values, 1e-4 * max(values[-1], 1e-6))
            L = np.linalg.cholesky((vectors * values) @ vectors.T)
            out.append([*np.log(np.diag(L)), *(L[i, j] for i, j in self._LOWER)])
        return np.array(out).ravel()


def pseudo_inertia(row: np.ndarray) -> np.ndarray:
    """The pseudo-inertia (4, 4) of a body with the numbers ``row`` (10,)."""
    m, hx, hy, hz, xx, yy, zz, xy, yz, xz = row
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    P = np.zeros((4, 4))
    P[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    P[:3, 3] = P[3, :3] = (hx, hy, hz)
    P[3, 3] = m
    return P


def numbers_of(body: Body) -> np.ndarray:
    """The ten numbers of a body."""
    c = np.array(body.com, dtype=float)
    h = body.mass * c
    about = body.mass * (c @ c * np.eye(3) - np.outer(c, c))
    I = np.array(body.inertia, dtype=float) + about  # noqa: E741
    return np.array([body.mass, *h, I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[1, 2], I[0, 2]])


def body_of(row: np.ndarray) -> Body:
    """The body with these ten numbers."""
    m = row[0]
    h = row[1:4]
    c = h / m
    xx, yy, zz, xy, yz, xz = row[4:]
    about_frame = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    I = about_frame - m * (c @ c * np.eye(3) - np.outer(c, c))  # noqa: E741
    return Body(float(m), tuple(c.tolist()), tuple(map(tuple, I.tolist())))


def units(pi: np.ndarray) -> np.ndarray:
    """Mass, mass x length, mass x length^2 of all bodies together, of the ten numbers; ones where
    there is no mass.
    """
    mass = pi[::10].sum()
    square = pi.reshape(-1, 10)[:, 4:7].sum() / 2
    length = np.sqrt(square / mass) if mass > 0 < square else 1.0
    return np.asarray((mass or 1.0) * length ** np.repeat([0, 1, 2], [1, 3, 6]))


def scales(pi: np.ndarray) -> np.ndarray:
    """Typical sizes of the ten numbers of each body: mass, mass x length, mass x length^2."""
    unit = units(pi)
    rows = pi.reshape(-1, 10)
    mass = rows[:, 0]
    least = (LEAST_LENGTH * unit[1] / unit[0]) ** 2
    length = np.sqrt(
        np.maximum(rows[:, 4:7].sum(axis=1) / np.where(mass > 0, 2 * mass, np.inf), least)
    )
    out = mass[:, None] * length[:, None] ** np.repeat([0, 1, 2], [1, 3, 6])
    return np.asarray(np.maximum(out, LEAST * unit)).ravel()
