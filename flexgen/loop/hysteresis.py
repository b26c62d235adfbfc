"""Robots of the loop whose gears have hysteresis: the equations of motion with Dahl's law, in C that CasADi writes.

    M a = forces + B^T z,    z = W s,    s' = K_h/W (d' - |d'| s),    d: deflections of the gears, s = 0 at the start

Rest, eigenvalues and controllers are those of the springs and dampers alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from flexgen.analysis import second_order
from flexgen.environment.robot_function import RobotFunction
from flexgen.loop.plants import LocalDynamics, Plants
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.hysteresis import GearHysteresis, gear_hysteresis
from flexgen.mechanics.parameters import with_values
from flexgen.model.elements import RobotModel
from flexgen.model.friction import hysteretic_joints
from flexgen.simulation.hysteretic_rate import deflection_rates, generalized_force


def split_plants(model: RobotModel, plants: Plants) -> tuple[Plants, tuple[GearHysteresis, ...]]:
    """The robots with springs and dampers alone, and the hysteresis of each; no laws for a model without hysteresis."""
    if not hysteretic_joints(model):
        return plants, ()
    names = [p.name for p in plants.parameters]
    numbers = [dict(zip(names, map(float, row), strict=True)) for row in plants.values]
    laws = [gear_hysteresis(with_values(model, each)) for each in numbers]
    kept = [k for k, p in enumerate(plants.parameters) if ".hysteresis." not in p.key]
    parameters = tuple(plants.parameters[k] for k in kept)
    return replace(plants, parameters=parameters, values=plants.values[:, kept]), tuple(laws)


def hysteretic_robots(
    equations: Equations, values: np.ndarray, laws: Sequence[GearHysteresis], progress: Callable[[str], None]
) -> RobotFunction:
    """The rate of the state (q_a, v_a, q_m, v_m, s) of robots with parameters ``values`` (lanes, n_p) and ``laws``.

    Its numbers (lanes, n_p + 2 n_g): the parameters, then W [N m] and K_h/W [1/rad] of each gear, zero where it has no
    hysteresis. BuildError where there is no compiler that works.
    """
    slips = np.array([law.slip for law in laws])
    per_slip = np.array([law.stiffness / np.where(law.present, law.slip, np.inf) for law in laws])
    numbers = np.hstack([values, slips, per_slip])
    return RobotFunction(_rate(equations), numbers, lambda line: progress(f"control: {line}"))


def _rate(equations: Equations) -> ca.Function:
    """The rate of one robot's state; inputs as in closed_loop.c."""
    model, lag, (y, dy, _) = equations.model, equations.lagrangian, equations.y
    n_a, n_m, n_g, i_m = model.n_a, model.n_m, model.n_g, list(model.i_m)
    state = ca.SX.sym("state", 2 * (n_a + n_m) + n_g)
    q_a, v_a, q_m, v_m, share = ca.vertsplit(state, np.cumsum([0, n_a, n_a, n_m, n_m, n_g]).tolist())
    slip, per_slip = ca.SX.sym("slip", n_g), ca.SX.sym("per_slip", n_g)
    a = equations.acceleration_under(generalized_force(equations.with_symbols, slip * share, lag.q_m))
    rate = deflection_rates(equations)
    more = per_slip * (rate - ca.fabs(rate) * share)
    dx = ca.vertcat(v_a, a[:n_a], v_m, equations.motor_accelerations(a[:n_a], a[n_a:]), more)
    (dx,) = ca.substitute([dx], [ca.vertcat(y, dy)], [ca.vertcat(q_a, q_m[i_m], v_a, v_m[i_m])])
    numbers = ca.vertcat(equations.symbols, slip, per_slip)
    force = [] if equations.force is None else [equations.force]
    return ca.Function("hysteretic_loop", [state, lag.tau_m, numbers, *force], [ca.densify(ca.cse(dx))])


def largest_rate(
    local: LocalDynamics,
    points: Sequence[np.ndarray],
    motion: dict[str, np.ndarray],
    values: np.ndarray,
    law: GearHysteresis,
) -> float:
    """Largest size of an eigenvalue right after a reversal at points of a motion, and of the law's own [1/s].

    ``motion``: all samples of ``v_a``, ``v_m``.
    """
    model, z = local.model, ca.SX.sym("z", local.model.n_g)
    B = np.array(ca.DM(ca.jacobian(generalized_force(model, z, ca.SX(ca.DM.zeros(model.n_m))), z)))
    M, D, K, _ = local.matrices(points, values)
    swings = second_order.largest_rate(M, D, K + B @ np.diag(law.stiffness) @ B.T)
    rates = np.abs(np.hstack([motion["v_a"], motion["v_m"][:, list(model.i_m)]]) @ B)[:, law.present]
    slips = rates * (law.stiffness / np.where(law.present, law.slip, np.inf))[law.present]
    return max(swings, float(slips.max(initial=0.0)))
