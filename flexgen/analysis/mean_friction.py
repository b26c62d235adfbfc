"""Mean slope of a friction law over a speed that is Gaussian, and the nodes of means over Gaussian numbers."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np

from flexgen.mechanics.force_laws import friction_torque
from flexgen.model.elements import Friction

# Panels of the integral over a Gaussian speed in units of its deviation, fine near zero where friction has its step.
_PANELS, _NODES = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0), 6


def mean_viscous_change(friction: Friction, sd: ca.SX, temperature: float | ca.SX | None = None) -> ca.SX:
    """``E[f(w) w]/sd^2 - f'(0)`` for a Gaussian speed w with deviation ``sd``; zero at ``sd`` = 0."""
    w = ca.SX.sym("w")
    torque = friction_torque(friction, w, None, temperature)
    others = [x for x in ca.symvar(torque) if not ca.is_equal(x, w)]
    law = ca.Function("law", [w, *others], [torque, ca.gradient(torque, w)])
    at_rest = law(0.0, *others)[1]
    x, weights = _half_normal()
    mean = ca.SX(0)
    for node, weight in zip(x, weights, strict=True):
        up, down = law(node * sd, *others)[0], law(-node * sd, *others)[0]
        mean += weight * node * (up - down) / 2
    safe = ca.if_else(sd > 0, sd, 1.0)
    return ca.if_else(sd > 0, mean / safe - at_rest, 0.0)


def normal_nodes() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for the mean over a standard Gaussian."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(15)
    return nodes, weights / weights.sum()


def _half_normal() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for the mean of an even function of a standard Gaussian: Gauss-Legendre on panels."""
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
