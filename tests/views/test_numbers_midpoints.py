"""Residuals at the midpoints of motions with states, and the forces of a process on the page of a
run.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
from gear_friction import loaded, torque
from numpy.testing import assert_allclose

from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.verification import residual
from flexgen.views.reports import control_page


def test_a_hysteresis_loads_springs_and_frictions() -> None:
    """Its torque z is taken from the arm, and z/n added to the motors, with the friction under the
    larger load.
    """
    model = loaded("elbow", lost_motion=1e-3)
    plain = loaded("elbow")
    n = np.diag(model.eta)
    t = np.linspace(0.0, 0.5, 7)
    q_g = np.stack([0.3 * t**2, -0.2 * t**3], axis=1)
    v_g = np.stack([0.6 * t, -0.6 * t**2], axis=1)
    a_g = np.stack([0.6 + 0 * t, -1.2 * t], axis=1)
    bend = np.array([1e-4, -2e-4])
    motion: Any = Made(
        t=t, q_a=q_g, v_a=v_g, a_a=a_g, q_m=(q_g + bend) * n, v_m=v_g * n, a_m=a_g * n
    )
    motion.tau_m = np.zeros((7, 2))
    motion.force = None
    motion.tau_b = None
    z = np.stack([200.0 + 100 * t, -50.0 + 0 * t], axis=1)
    motion.tau_h = z
    found = residual.midpoint_residual(derive(model), motion)
    motion.tau_h = None
    without = residual.midpoint_residual(derive(plain), motion)
    middle = (t[:-1] + t[1:]) / 2
    z_mid = np.stack([200.0 + 100 * middle, -50.0 + 0 * middle], axis=1)
    v_m = np.stack([0.6 * middle, -0.6 * middle**2], axis=1) * n
    k = [
        dof.gear.spring.stiffness for e in plain.elements for dof in e.dofs if dof.gear is not None
    ]  # type: ignore[union-attr]
    load = np.array(k) * bend / n
    more = torque(v_m, load + z_mid / n) - torque(v_m, load + 0 * z_mid)
    assert_allclose(found[:, :2] - without[:, :2], -z_mid, rtol=1e-9)
    assert_allclose(found[:, 2:] - without[:, 2:], z_mid / n + more, rtol=1e-6)
    assert np.abs(more).max() > 1e-3


def test_forces_of_a_process_in_words() -> None:
    found = {"force_max_N": 12.0, "assumed_force_max_N": 10.0, "force_error_max_Nm": 0.5}
    run: Any = Made(force_figures=lambda: found)
    assert control_page._forces(run) == [
        ("force of the process on the tool, largest", 12.0, "N"),
        ("force that the feedforward assumes, largest", 10.0, "N"),
        ("moment of the feedforward less that of the process, largest", 0.5, "Nm"),
    ]
