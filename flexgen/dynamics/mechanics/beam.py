"""Modes of a beam that is clamped at one end and carries a rigid body at the other, and their
integrals, for its kinetic and potential energy.

Bending (Euler and Bernoulli), mode k of a uniform cantilever without a body at its tip:
``phi(x) = cosh(b x) - cos(b x) - s (sinh(b x) - sin(b x))`` with ``cosh(b L) cos(b L) = -1`` and
``s = (cosh(bL) + cos(bL)) / (sinh(bL) + sin(bL))``. A body of mass m and moment of inertia J
changes the conditions at the tip, mu the mass per length:

    E I phi'''(L) = -m w^2 phi(L),  E I phi''(L) = J w^2 phi'(L),  w^2 = b^4 E I / mu

Torsion and elongation: ``phi(x) = sin(z x / L)``, with ``z tan(z)`` the inertia of the beam over
that of the body (polar moments of inertia, masses). Modes are scaled to ``phi(L) = 1``, so that a
modal coordinate is the deflection [m] or the twist [rad] of the tip in its mode. A constant
tension N adds the integrals of ``N phi_i' phi_k'`` to the stiffness of bending.

Source: L. Meirovitch, Fundamentals of Vibrations, 2001, sec. 8.3 to 8.6; the integrals are done
by Gauss quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexgen.model.elements import Beam, BeamTip

# Step of the search for natural frequencies of bending, in z = b L; they are at least 0.1 apart
# for bodies of up to a million times the mass of the beam.
SEARCH_STEP = 0.01


@dataclass(frozen=True)
class ModalBeam:
    """Integrals over a beam with modal coordinates ordered as in the model (bending after bending,
    mode after mode; torsion; elongation).

    ``direction`` (n, 3): unit vector in which the mode moves the axis of the beam, zero for
    torsion. ``slope`` (n,): phi'(L) of bending [1/m]. ``twist`` (n,): twist of the tip, 1 for
    torsion. ``mass`` [kg];
    ``s0`` [kg m], ``s1`` [kg m]: integral of x dm and of phi dm (n,); ``j0`` [kg m^2]: integral of
    x^2 dm; ``j1`` (n,): integral of x phi dm; ``m2`` (n, n): integral of phi_i phi_k dm [kg];
    ``polar`` [kg m^2]: moment of inertia of a beam with torsion about its axis; ``polar1`` (n,),
    ``polar2`` (n, n): its integrals with phi and with phi_i phi_k [kg m^2];
    ``stiffness``, ``damping`` (n, n) [N/m, N s/m; of torsion N m/rad, N m s/rad].
    """

    direction: np.ndarray
    slope: np.ndarray
    twist: np.ndarray
    mass: float
    s0: float
    s1: np.ndarray
    j0: float
    j1: np.ndarray
    m2: np.ndarray
    polar: float
    polar1: np.ndarray
    polar2: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


class _Mode(NamedTuple):
    """A mode at the points of the quadrature.

    ``group``: index of the bending, or the kind; ``shape``: phi; ``strain``: its derivative that
    stores energy (phi'' of bending, else phi') times the root of the stiffness of the section;
    ``tilt``: phi' of bending [1/m], else 0; ``carried``: inertia of the tip that moves with the
    mode [kg or kg m^2].
    """

    group: int | str
    direction: tuple[float, float, float]
    shape: np.ndarray
    strain: np.ndarray
    tilt: np.ndarray
    slope: float
    carried: float
    damping_ratio: float


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


def root_with_tip(k: int, mass: float, inertia: float) -> float:
    """The k-th natural frequency, z = b L, of a cantilever with a body at its tip.

    ``mass``: of the body over that of the beam; ``inertia``: its moment of inertia over mu L^3.
    """
    from scipy.optimize import brentq

    def condition(z: np.ndarray) -> np.ndarray:
        """Determinant of the two conditions at the tip, over 2 cosh(z)."""
        co = np.cos(z)
        si = np.sin(z)
        th = np.tanh(z)
        one = 1.0 / np.cosh(z)
        return (
            one
            + co
            + mass * z * (co * th - si)
            - inertia * z**3 * (si + co * th)
            + mass * inertia * z**4 * (one - co)
        )

    z = np.arange(SEARCH_STEP, (k + 1) * np.pi, SEARCH_STEP)
    signs = np.signbit(condition(z))
    change = np.flatnonzero(signs[1:] != signs[:-1])[k - 1]
    return float(brentq(condition, z[change], z[change + 1], xtol=1e-15, rtol=1e-15))


def mode_shape(
    k: int, length: float, x: np.ndarray, tip: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mode k of bending scaled to one at the tip: phi, phi' [1/m] and phi'' [1/m^2] at the
    positions ``x`` [m].

    ``tip``: mass and moment of inertia of the body at the tip, as those of `root_with_tip`.
    """
    mass, inertia = tip
    z = root_with_tip(k, mass, inertia) if any(tip) else clamped_free_root(k)
    b = z / length
    moment = inertia * z**3
    s = (np.cosh(z) + np.cos(z) - moment * (np.sinh(z) + np.sin(z))) / (
        np.sinh(z) + np.sin(z) - moment * (np.cosh(z) - np.cos(z))
    )

    def shape(y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mode and two derivatives in x, unscaled, at ``y = b x``: difference of hyperbolic and
        circular functions that is clamped at 0.
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

    scale = shape(np.array(z))[0]
    phi, slope, curvature = shape(b * np.asarray(x, dtype=float))
    return phi / scale, slope / scale, curvature / scale


def sine_mode(
    k: int, length: float, x: np.ndarray, inertia: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mode k of torsion or elongation scaled to one at the tip: phi and phi' [1/m] at the
    positions ``x`` [m].

    ``inertia``: of the body at the tip over that of the beam; ``cot(z) = inertia z``.
    """
    from scipy.optimize import brentq

    z = (k - 0.5) * np.pi
    if inertia:
        z = float(
            brentq(
                lambda y: np.cos(y) - inertia * y * np.sin(y),
                (k - 1.0) * np.pi,
                z,
                xtol=1e-15,
                rtol=1e-15,
            )
        )
    y = z * np.asarray(x, dtype=float) / length
    return np.sin(y) / np.sin(z), z / length * np.cos(y) / np.sin(z)


def _modes(beam: Beam, x: np.ndarray) -> list[_Mode]:
    """The modes of a beam at the positions ``x`` [m]."""
    whole = beam.mass_per_length * beam.length
    tip = BeamTip() if beam.tip is None else beam.tip
    out = []
    for n, bending in enumerate(beam.bendings):
        # bending in y turns the tip about z
        carried = tip.inertia[2 if bending.direction == "y" else 1]
        ratio = (tip.mass / whole, carried / (whole * beam.length**2))
        for k in range(1, bending.modes + 1):
            shape, tilt, curvature = mode_shape(k, beam.length, x, ratio)
            end = np.array(beam.length)
            slope = float(mode_shape(k, beam.length, end, ratio)[1])
            out.append(
                _Mode(
                    n,
                    (0.0, 1.0, 0.0) if bending.direction == "y" else (0.0, 0.0, 1.0),
                    shape,
                    np.sqrt(bending.stiffness / beam.mass_per_length) * curvature,
                    tilt,
                    slope,
                    tip.mass + carried * slope**2,
                    bending.damping_ratio,
                )
            )
    still = np.zeros_like(x)
    if beam.torsion is not None:
        ratio_x = tip.inertia[0] / (beam.torsion.inertia_per_length * beam.length)
        root = np.sqrt(beam.torsion.stiffness / beam.mass_per_length)
        for k in range(1, beam.torsion.modes + 1):
            shape, strain = sine_mode(k, beam.length, x, ratio_x)
            ratio_d = beam.torsion.damping_ratio
            given = ((0.0, 0.0, 0.0), shape, root * strain, still, 0.0, tip.inertia[0], ratio_d)
            out.append(_Mode("torsion", *given))
    if beam.stretch is not None:
        root = np.sqrt(beam.stretch.stiffness / beam.mass_per_length)
        for k in range(1, beam.stretch.modes + 1):
            shape, strain = sine_mode(k, beam.length, x, tip.mass / whole)
            ratio_d = beam.stretch.damping_ratio
            given = ((1.0, 0.0, 0.0), shape, root * strain, still, 0.0, tip.mass, ratio_d)
            out.append(_Mode("stretch", *given))
    return out


def modal_beam(beam: Beam) -> ModalBeam:
    """Integrals of a `Beam` (see `ModalBeam`) by Gauss quadrature along its length; damping is
    modal, ``2 zeta sqrt(k m)`` for each mode alone.

    The stiffness of a mode is the integral of ``E I`` times its squared curvature, of ``G J`` or
    ``E A`` times its squared derivative, and that of a tension.
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    x = beam.length * (nodes + 1) / 2
    dm = beam.mass_per_length * beam.length / 2 * weights
    modes = _modes(beam, x)
    twist = np.array([1.0 if mode.group == "torsion" else 0.0 for mode in modes])
    same = np.array([[a.group == b.group for b in modes] for a in modes])
    every = np.array([mode.shape for mode in modes])
    shapes = every * (1.0 - twist)[:, None]
    # modes of one bending are orthogonal where the tip carries nothing: quadrature errors off the
    # diagonal are set to zero; modes of two bendings are not, and their products enter the
    # products of inertia
    apart = same & ~np.eye(len(modes), dtype=bool) & (beam.tip is None)
    m2 = np.where(apart, 0.0, (shapes * dm) @ shapes.T)
    strain = np.array([mode.strain for mode in modes])
    stiffness = np.diag(np.sum(strain**2 * dm, axis=1))
    if beam.axial_load:
        tilt = np.array([mode.tilt for mode in modes])
        force = beam.axial_load / beam.mass_per_length
        stiffness = stiffness + np.where(same, force * (tilt * dm) @ tilt.T, 0.0)
    turned = every * twist[:, None]
    per_mass = 0.0 if beam.torsion is None else beam.torsion.inertia_per_length
    di = per_mass / beam.mass_per_length * dm
    polar2 = np.where(apart, 0.0, (turned * di) @ turned.T)
    moving = np.diag(m2) + np.diag(polar2) + np.array([mode.carried for mode in modes])
    zeta = np.array([mode.damping_ratio for mode in modes])
    return ModalBeam(
        direction=np.array([mode.direction for mode in modes]),
        slope=np.array([mode.slope for mode in modes]),
        twist=twist,
        mass=beam.mass_per_length * beam.length,
        s0=float(dm @ x),
        s1=shapes @ dm,
        j0=float(dm @ x**2),
        j1=(shapes * dm) @ x,
        m2=m2,
        polar=float(np.sum(di)),
        polar1=turned @ di,
        polar2=polar2,
        stiffness=stiffness,
        damping=np.diag(2 * zeta * np.sqrt(np.diag(stiffness) * moving)),
    )
