"""Robots of the loop whose gears have hysteresis, or motors bristles: the equations of motion, in
C that CasADi writes.

    M a = forces + B^T sum z,    z = W s,    s' = K_h/W element_rate(d', s)

with the deflections d of the gears and s = 0 at the start, and the same of the bristles of motors
with s = s0 z/F, F the larger one of F_c and F_s. Rest, eigenvalues and controllers are those of
the springs, dampers and frictions without a state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from flexgen.analysis import second_order
from flexgen.dynamics.hysteresis.hysteresis import Layer, gear_layers
from flexgen.dynamics.hysteresis.lugre import MotorBristles, motor_bristles, sliding_torque
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.feedback.loop.plants import LocalDynamics, Plants
from flexgen.model.elements import RobotModel
from flexgen.model.friction import memory_laws
from flexgen.simulation.environment.robot_function import RobotFunction
from flexgen.simulation.integration.hysteretic_rate import (
    deflection_rates,
    friction_changes,
    generalized_force,
    motor_force,
    motor_speeds,
)


@dataclass(frozen=True)
class States:
    """Elements of a robot with a state: hysteresis of its gears, bristles of its motors."""

    gears: tuple[Layer, ...]
    motors: MotorBristles

    def numbers(self) -> np.ndarray:
        """W [N m] of the layers of elements, then their K_h/W [1/rad]; zero where a gear has
        none.
        """
        return np.concatenate([*(layer.slip for layer in self.gears), *self.slopes()])

    def slopes(self) -> list[np.ndarray]:
        """K_h/W [1/rad] of the layers."""
        return [
            layer.stiffness / np.where(layer.present, layer.slip, np.inf) for layer in self.gears
        ]

    def of_motors(self) -> np.ndarray:
        """F, F_c, F_s [N m], v_s, s0, s1 of the motors; F is zero where one has no bristles."""
        motors = self.motors
        there = self.motors.present
        levels = [np.where(there, x, 1.0) for x in (motors.coulomb, motors.static)]  # which divide
        most = np.where(there, np.maximum(*levels), 0.0)
        return np.concatenate(
            [most, *levels, motors.stribeck_speed, motors.stiffness, motors.damping]
        )


def split_plants(model: RobotModel, plants: Plants) -> tuple[Plants, tuple[States, ...]]:
    """The robots without elements that have a state, and these elements; none for a model without
    any.
    """
    if not memory_laws(model):
        return plants, ()
    names = [p.name for p in plants.parameters]
    numbers = [dict(zip(names, map(float, row), strict=True)) for row in plants.values]
    made = [with_values(model, each) for each in numbers]
    laws = [States(gear_layers(each), motor_bristles(each)) for each in made]
    kept = [
        k
        for k, p in enumerate(plants.parameters)
        if ".hysteresis." not in p.key and ".lugre." not in p.key
    ]
    parameters = tuple(plants.parameters[k] for k in kept)
    return replace(plants, parameters=parameters, values=plants.values[:, kept]), tuple(laws)


def hysteretic_robots(
    equations: Equations,
    values: np.ndarray,
    laws: Sequence[States],
    progress: Callable[[str], None],
) -> RobotFunction:
    """The rate of the state (q_a, v_a, q_m, v_m, s) of robots with parameters ``values`` (lanes,
    n_p) and ``laws``.

    Its numbers: the parameters, then `States.numbers`; where a motor has bristles, also 6 n_m of
    `States.of_motors`, and s is that of all layers of the gears, then of all motors. BuildError
    where no compiler works.
    """
    bristled = any(law.motors.present.any() for law in laws)
    rows = [[law.numbers(), *([law.of_motors()] if bristled else [])] for law in laws]
    numbers = np.hstack([values, np.array([np.concatenate(row) for row in rows])])
    return RobotFunction(
        _rate(equations, laws[0].gears, bristled),
        numbers,
        lambda line: progress(f"control: {line}"),
    )


def _rate(equations: Equations, layers: Sequence[Layer], bristled: bool) -> ca.Function:
    """The rate of one robot's state as a CasADi function, with inputs as in closed_loop.c: state,
    motor torques, numbers, and the force on the tool where there is one.

    The state is ``q_a v_a q_m v_m``, then the torque of each gear layer over its slip torque, and
    with ``bristled`` the deflection of the bristles of each motor, from -1 to 1. ``layers``: their
    exponents and gammas, which all robots have in common; other numbers are inputs.
    """
    model = equations.model
    lag = equations.lagrangian
    (y, dy, _) = equations.y
    n_a = model.n_a
    n_m = model.n_m
    n_g = model.n_g
    i_m = list(model.i_m)
    n_z = n_g * len(layers)
    state = ca.SX.sym("state", 2 * (n_a + n_m) + n_z + n_m * bristled)
    q_a, v_a, q_m, v_m, share, bent = ca.vertsplit(
        state, np.cumsum([0, n_a, n_a, n_m, n_m, n_z, n_m * bristled]).tolist()
    )
    slip = ca.SX.sym("slip", n_z)
    per_slip = ca.SX.sym("per_slip", n_z)
    law = ca.SX.sym("law", 6 * n_m * bristled)
    torques = ca.vertsplit(slip * share, n_g)
    z = sum(torques[1:], torques[0])
    forces = generalized_force(equations.with_symbols, z, lag.q_m) - motor_force(
        model, friction_changes(equations, z)
    )
    rate = deflection_rates(equations)
    parts = zip(layers, ca.vertsplit(share, n_g), strict=True)
    more = per_slip * ca.vertcat(*[layer.rates(rate, part, np.ones(n_g)) for layer, part in parts])
    if bristled:
        most, coulomb, static, speed, stiffness, damping = ca.vertsplit(law, n_m)
        turning = motor_speeds(equations)
        bending = turning - ca.fabs(turning) * most * bent / sliding_torque(
            turning, coulomb, static, speed
        )
        forces -= motor_force(model, most * bent + damping * bending)
        more = ca.vertcat(more, stiffness / ca.if_else(most > 0, most, 1) * bending)
    a = equations.acceleration_under(forces)
    dx = ca.vertcat(v_a, a[:n_a], v_m, equations.motor_accelerations(a[:n_a], a[n_a:]), more)
    # an empty index into a single motor has the wrong shape
    q_me, v_me = ([x[j] for j in i_m] for x in (q_m, v_m))
    (dx,) = ca.substitute([dx], [ca.vertcat(y, dy)], [ca.vertcat(q_a, *q_me, v_a, *v_me)])
    force = [] if equations.force is None else [equations.force]
    numbers = ca.vertcat(equations.symbols, slip, per_slip, law)
    return ca.Function(
        "hysteretic_loop", [state, lag.tau_m, numbers, *force], [ca.densify(ca.cse(dx))]
    )


def largest_rate(
    local: LocalDynamics,
    points: Sequence[np.ndarray],
    motion: dict[str, np.ndarray],
    values: np.ndarray,
    law: States,
) -> float:
    """Largest rate [1/s] that the integration of a robot with hysteresis must resolve.

    It is the largest of: eigenvalues of the robot with all layers stuck, at ``points`` of the
    motion; the rate at which a layer comes to its slip torque, and bristles to theirs, at the
    speeds of the motion.

    Parameters
    ----------
    local : LocalDynamics
    points : sequence of arrays
        Points of the motion, as of `LocalDynamics.matrices`.
    motion : dict
        All samples of ``v_a``, ``v_m`` [rad/s or m/s].
    values : array (n_p,)
        Run-time parameters of the robot.
    law : States
    """
    model = local.model
    motors = law.motors
    z = ca.SX.sym("z", model.n_g)
    tau = ca.SX.sym("tau", model.n_m)
    at_zero = generalized_force(model, z, ca.SX(ca.DM.zeros(model.n_m)))
    B, C = (
        np.array(ca.DM(ca.jacobian(f, x)))
        for f, x in ((at_zero, z), (motor_force(model, tau), tau))
    )
    M, D, K, _ = local.matrices(points, values)
    stiff = (
        K
        + B @ np.diag(sum(layer.stiffness for layer in law.gears)) @ B.T
        + C @ np.diag(motors.stiffness) @ C.T
    )
    swings = second_order.largest_rate(M, D + C @ np.diag(motors.damping) @ C.T, stiff)
    rates = np.abs(np.hstack([motion["v_a"], motion["v_m"][:, list(model.i_m)]]) @ B)
    slips = rates * np.max(
        [slope * x.sharpness for slope, x in zip(law.slopes(), law.gears, strict=True)], axis=0
    )
    least = np.minimum(motors.coulomb, motors.static)[motors.present]
    slides = np.abs(motion["v_m"])[:, motors.present] * motors.stiffness[motors.present] / least
    return max(swings, float(slips.max(initial=0.0)), float(slides.max(initial=0.0)))
