"""Collocation methods as tables that check their own order conditions.

Sources: E. Hairer, S. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 1993, sec.
II.7; II, 1996, IV.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial, legendre


@dataclass(frozen=True)
class Tableau:
    """A collocation method with the nodes ``c``: ``A[i, j] = int_0^c_i l_j``,
    ``b[j] = int_0^1 l_j``, and twice.

    ``AA[i, j]``, ``bb[j]``: ``int_0^c_i int_0^t l_j`` and to 1, for second-order equations.
    ``order``: of the quadrature (b, c), which is asserted.
    """

    name: str
    c: np.ndarray
    A: np.ndarray
    b: np.ndarray
    AA: np.ndarray
    bb: np.ndarray
    order: int

    def __post_init__(self) -> None:
        for k in range(1, self.order + 1):  # B(order): sum b c^(k-1) = 1/k
            assert abs(self.b @ self.c ** (k - 1) - 1 / k) < 1e-12, (
                f"{self.name}: order condition {k}"
            )
        for k in range(1, len(self.c) + 1):  # C(s): sum A c^(k-1) = c^k/k
            assert np.allclose(self.A @ self.c ** (k - 1), self.c**k / k, atol=1e-12), (
                f"{self.name}: stage order {k}"
            )

    def lagrange(self, theta: np.ndarray) -> np.ndarray:
        """Values of the Lagrange polynomials of the nodes at ``theta``, (n, s)."""
        others = [np.delete(self.c, j) for j in range(len(self.c))]
        columns = [
            np.prod((theta[:, None] - o) / (c - o), axis=1)
            for c, o in zip(self.c, others, strict=True)
        ]
        return np.stack(columns, axis=1)

    def weights(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrals ``int_0^theta l_j`` and ``int int l_j`` for dense output, each (n, s)."""
        once, twice = _integrals(self.c)
        return np.array([[p(x) for p in once] for x in theta]), np.array(
            [[p(x) for p in twice] for x in theta]
        )


def _integrals(c: np.ndarray) -> tuple[list[Polynomial], list[Polynomial]]:
    """Integrals and double integrals from 0, as polynomials, of the Lagrange polynomials of the
    nodes c (s,) in [0, 1].
    """
    once = []
    twice = []
    for j in range(len(c)):
        others = np.delete(c, j)
        lagrange = Polynomial(np.atleast_1d(np.poly(others))[::-1] / np.prod(c[j] - others))
        once.append(lagrange.integ())
        twice.append(lagrange.integ(2))
    return once, twice


def _tableau(name: str, c: np.ndarray, order: int) -> Tableau:
    """The collocation tableau of the nodes c (s,) in [0, 1], for equations of first and of second
    order.
    """
    once, twice = _integrals(c)
    A = np.array([[p(x) for p in once] for x in c])
    AA = np.array([[p(x) for p in twice] for x in c])
    return Tableau(
        name, c, A, np.array([p(1.0) for p in once]), AA, np.array([p(1.0) for p in twice]), order
    )


def gauss(stages: int) -> Tableau:
    """Gauss-Legendre collocation, order 2 s: symmetric, so that stable and unstable modes are
    treated alike.
    """
    return _tableau(f"Gauss {stages}", (legendre.leggauss(stages)[0] + 1) / 2, 2 * stages)


def radau(stages: int) -> Tableau:
    """Radau IIA collocation, order 2 s - 1: stiffly accurate, for the fast stable motion of damped
    gears.
    """
    inner = legendre.Legendre.basis(stages) - legendre.Legendre.basis(stages - 1)
    roots = np.sort(np.real(inner.roots()))
    return _tableau(f"Radau IIA {stages}", np.append((roots[:-1] + 1) / 2, 1.0), 2 * stages - 1)


def lobatto() -> Tableau:
    """Lobatto IIIA collocation at both ends and the middle, order 4: the method of Hermite and
    Simpson.
    """
    return _tableau("Lobatto IIIA 3", np.array([0.0, 0.5, 1.0]), 4)
