"""Mean slope of a friction law over a speed that is Gaussian, and the nodes of means over Gaussian
numbers.
"""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np

from flexgen.base.spec.parts import GearFriction
from flexgen.dynamics.mechanics.force_laws import friction_torque
from flexgen.model.elements import Friction

# Panels of the integral over a Gaussian speed in units of its deviation, fine near zero where
# friction has its step.
_PANELS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0)
_NODES = 6


def mean_viscous_change(
    friction: Friction,
    sd: ca.SX,
    temperature: float | ca.SX | None = None,
    load: ca.SX | None = None,
    load_sd: ca.SX | None = None,
) -> ca.SX:
    """``E[f(w) w]/sd^2 - f'(0)`` for a Gaussian speed w with deviation ``sd``; zero at ``sd`` = 0.

    Of a friction that depends on the ``load`` [N m]: the mean also over a Gaussian load with
    deviation ``load_sd``, without correlation with the speed: they are a quarter of a period apart
    where inertia is the load.
    """
    w = ca.SX.sym("w")
    x = ca.SX.sym("load")
    torque = friction_torque(friction, w, x, temperature)
    others = [
        each for each in ca.symvar(torque) if not (ca.is_equal(each, w) or ca.is_equal(each, x))
    ]
    law = ca.Function("law", [w, x, *others], [torque, ca.gradient(torque, w)])
    rest = ca.SX(0) if load is None else load
    still = law(0.0, rest, *others)[1]
    if load_sd is not None:
        rest = _mean_load(friction, rest, load_sd)
    nodes, weights = _half_normal()
    mean = ca.SX(0)
    for node, weight in zip(nodes, weights, strict=True):
        up = law(node * sd, rest, *others)[0]
        down = law(-node * sd, rest, *others)[0]
        mean += weight * node * (up - down) / 2
    safe = ca.if_else(sd > 0, sd, 1.0)
    return ca.if_else(sd > 0, mean / safe - still, 0.0)


def _mean_load(friction: Friction, load: ca.SX, sd: ca.SX) -> ca.SX:
    """The load at which the friction is its mean over a Gaussian load, of whose rounded magnitude
    it is a multiple.
    """
    if not friction.loaded:
        return load
    assert isinstance(friction, GearFriction)
    s = friction.load_smoothing
    size = ca.SX(0)
    for node, weight in zip(*_half_normal(), strict=True):
        size += weight * (ca.hypot(load + sd * node, s) + ca.hypot(load - sd * node, s)) / 2
    # (the root has no derivative at 0)
    return ca.sqrt(ca.fmax(size**2 - s**2, 0) + (1e-9 * s) ** 2)


def normal_nodes() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for the mean over a standard Gaussian."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(15)
    return nodes, weights / weights.sum()


def _half_normal() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for the mean of an even function of a standard Gaussian: Gauss-Legendre on
    panels.
    """
    t, a = np.polynomial.legendre.leggauss(_NODES)
    x = np.concatenate([(lo + hi) / 2 + (hi - lo) / 2 * t for lo, hi in pairwise(_PANELS)])
    weights = np.concatenate([(hi - lo) / 2 * a for lo, hi in pairwise(_PANELS)])
    return x, weights * np.sqrt(2 / np.pi) * np.exp(-(x**2) / 2)


def is_linear(friction: Friction) -> bool:
    """Whether a friction law is viscous, with an offset at most."""
    return all(
        not isinstance(x, ca.SX) and x == 0.0
        for name, x in vars(friction).items()
        if name not in ("viscous", "offset", "alpha", "beta")
    )
