"""Clamped-free Euler-Bernoulli modes of a beam and their integrals, for its kinetic and potential
energy.

Mode k of a uniform cantilever: ``phi(x) = cosh(b x) - cos(b x) - s (sinh(b x) - sin(b x))`` with
``cosh(b L) cos(b L) = -1`` and ``s = (cosh(bL) + cos(bL)) / (sinh(bL) + sin(bL))``, here scaled to
``phi(L) = 1``, so that a modal coordinate is the tip deflection of its mode in m.

Source: L. Meirovitch, Fundamentals of Vibrations, 2001, sec. 8.3; the integrals are done by Gauss
quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.model.elements import Beam


@dataclass(frozen=True)
class ModalBeam:
    """Integrals over a beam with modal coordinates ordered as in the model (bending after bending,
    mode after mode).

    ``direction`` (n, 3): unit vector in which the mode bends. ``slope`` (n,): phi'(L) [1/m].
    ``mass`` [kg];
    ``s0`` [kg m], ``s1`` [kg m]: integral of x dm and of phi dm (n,); ``j0`` [kg m^2]: integral of
    x^2 dm; ``j1`` (n,): integral of x phi dm; ``m2`` (n, n): integral of phi_i phi_k dm [kg];
    ``stiffness``, ``damping`` (n, n) [N/m, N s/m].
    """

    direction: np.ndarray
    slope: np.ndarray
    mass: float
    s0: float
    s1: np.ndarray
    j0: float
    j1: np.ndarray
    m2: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


def clamped_free_root(k: int) -> float:
    """The k-th root (k = 1, 2, ...) of ``cosh(z) cos(z) = -1``: 1.8751, 4.6941, 7.8548, ..."""
    # takes longer to import than all else of a model without beams
    from scipy.optimize import brentq

    middle = (k - 0.5) * np.pi
    # cos(z) + 1/cosh(z) has the same roots and does not overflow
    return float(
        brentq(
            lambda z: np.cos(z) + 1.0 / np.cosh(z),
            middle - 0.5,
            middle + 0.5,
            xtol=1e-15,
            rtol=1e-15,
        )
    )


def mode_shape(k: int, length: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mode k scaled to one at the tip: phi, phi' [1/m] and phi'' [1/m^2] at the positions ``x``
    [m].
    """
    z = clamped_free_root(k)
    b = z / length
    s = (np.cosh(z) + np.cos(z)) / (np.sinh(z) + np.sin(z))

    def shape(y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mode and two derivatives in x, unscaled, at ``y = b x``: difference of hyperbolic and
        circular functions that is clamped at 0 and free at the length.
        """
        ch = np.cosh(y)
        sh = np.sinh(y)
        co = np.cos(y)
        si = np.sin(y)
        return (
            ch - co - s * (sh - si),
            b * (sh + si - s * (ch - co)),
            b**2 * (ch + co - s * (sh + si)),
        )

    tip = shape(np.array(z))[0]
    phi, slope, curvature = shape(b * np.asarray(x, dtype=float))
    return phi / tip, slope / tip, curvature / tip


def modal_beam(beam: Beam) -> ModalBeam:
    """Integrals of a `Beam` (see `ModalBeam`) by Gauss quadrature along its length; damping is
    modal, ``2 zeta sqrt(k m)`` for each mode alone.

    The stiffness of a mode is the integral of ``E I`` times its squared curvature.
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    x = beam.length * (nodes + 1) / 2
    dm = beam.mass_per_length * beam.length / 2 * weights
    phi = []
    direction = []
    slope = []
    bend = []
    zeta = []
    group = []
    for n, bending in enumerate(beam.bendings):
        for k in range(1, bending.modes + 1):
            shape, _, curvature = mode_shape(k, beam.length, x)
            phi.append(shape)
            slope.append(float(mode_shape(k, beam.length, np.array(beam.length))[1]))
            direction.append((0.0, 1.0, 0.0) if bending.direction == "y" else (0.0, 0.0, 1.0))
            bend.append(np.sqrt(bending.stiffness / beam.mass_per_length) * curvature)
            zeta.append(bending.damping_ratio)
            group.append(n)
    shapes = np.array(phi)
    curvatures = np.array(bend)
    # modes of one bending are orthogonal: quadrature errors off the diagonal are set to zero;
    # modes of two bendings are not, and their products enter the products of inertia
    zero = np.equal.outer(group, group) & ~np.eye(len(group), dtype=bool)
    m2 = np.where(zero, 0.0, (shapes * dm) @ shapes.T)
    stiffness = np.diag(np.sum(curvatures**2 * dm, axis=1))
    damping = np.diag(2 * np.array(zeta) * np.sqrt(np.diag(stiffness) * np.diag(m2)))
    return ModalBeam(
        direction=np.array(direction),
        slope=np.array(slope),
        mass=beam.mass_per_length * beam.length,
        s0=float(dm @ x),
        s1=shapes @ dm,
        j0=float(dm @ x**2),
        j1=(shapes * dm) @ x,
        m2=m2,
        stiffness=stiffness,
        damping=damping,
    )
