"""Bounds of a planned motion from the limits of the model file, or from those given."""

from __future__ import annotations

import numpy as np

from flexgen.mechanics.limits import Limits
from flexgen.planning.phase import Phase


def apply_limits(phase: Phase, limits: Limits | None, model_limits: bool) -> None:
    """Bounds of a phase: ``limits``, and with ``model_limits`` those of the model file that they do not replace."""
    model = phase.equations.model
    given = limits or Limits()
    torque, speed = given.arrays(model.n_m)
    deflection = given.deflections(model.n_e)
    if model_limits:
        own = [np.array([getattr(m, x) or np.inf for m in model.motors]) for x in ("torque_max", "speed_max")]
        torque = torque if given.torque is not None else own[0]
        speed = speed if given.speed is not None else own[1]
    for name, size in (("tau_m", torque), ("v_m", speed), ("elastic_deflection", deflection)):
        if len(size) and np.isfinite(size).any():
            phase.bound(name, -size, size)
    if not model_limits:
        return
    for c in model.coordinates:
        dof = c.dof
        if dof is None:
            continue
        if dof.lower is not None or dof.upper is not None:
            phase.bound(f"q_a[{dof.name}]", dof.lower, dof.upper)
        for name, limit in (("v_a", dof.speed_max), ("a_a", dof.acceleration_max)):
            if limit is not None:
                phase.bound(f"{name}[{dof.name}]", -limit, limit)
