"""Gains of a P-PI cascade by frequencies, from the inertias of a robot at rest.

position_gain = 2 pi f_p,   speed_gain = 2 pi f_v J,   integral_gain = 2 pi f_i,
J = J_m + M_jj / eta^2
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from flexgen.analysis import second_order
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.linearization import second_order_matrices
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.keys import FREQUENCIES, GAINS, ServoTable

# Frequencies over the lowest natural one with locked motors, and what takes its place where
# nothing is elastic [Hz].
MULTIPLES = {"position_hz": 0.5, "speed_hz": 3.0, "integral_hz": 0.1}
RIGID_HZ = 10.0
# largest speed gain times sample time and delay, over the inertia with all springs soft
SAMPLED_GAIN = 0.3


def chosen_frequencies(given: Mapping[str, float | None], lowest: float) -> dict[str, float]:
    """The frequencies [Hz], where not given by the lowest natural one with locked motors; 0:
    nothing is elastic.
    """
    own = lowest or RIGID_HZ
    return {
        name: MULTIPLES[name] * own if value is None else value for name, value in given.items()
    }


def cascade_gains(
    hz: Mapping[str, float], stiff: np.ndarray, soft: np.ndarray, late_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gains of position [1/s], speed [N m s/rad] and integral part [1/s], (n_m,) each.

    Parameters
    ----------
    hz : mapping
        ``position_hz``, ``speed_hz``, ``integral_hz``.
    stiff, soft : arrays (n_m,) [kg m^2]
        Of `flexgen.analysis.second_order.motor_inertias`.
    late_s : float [s]
        Sample time and delay together: they limit the speed gain.
    """
    position, speed, integral = (2 * np.pi * hz[name] for name in FREQUENCIES)
    return (
        np.full(len(stiff), position),
        np.minimum(speed * stiff, SAMPLED_GAIN * soft / late_s),
        np.full(len(stiff), integral),
    )


def inertias_at_rest(
    equations: Equations, q_a: np.ndarray, q_m: np.ndarray, tau_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Inertias that the motors move with all springs stiff, and soft, and the lowest frequency
    with locked motors [Hz].

    ``q_a`` (n_a,), ``q_m`` (n_m,), ``tau_m`` (n_m,); inertias (n_m,) [kg m^2].
    """
    model = equations.model
    arm = np.zeros((1, model.n_a))
    motors = np.zeros((1, model.n_m))
    motion = (q_a[None], arm, arm, q_m[None], motors, motors, tau_m[None])
    M, _, K, B = (
        x[0]
        for x in second_order_matrices(
            *evaluate(equations.function("residual_jacobians"), *motion)
        )
    )
    stiff, soft = second_order.motor_inertias(model, M, B, second_order.motor_rows(model))
    return stiff, soft, second_order.lowest_locked_hz(model, M, K)


def servo_with_gains(model: RobotModel) -> ServoTable | None:
    """The servo of a model by gains of each motor; those by frequencies with the inertias at rest
    at home.

    SolverError where the home pose has no equilibrium.
    """
    servo = model.servo
    if servo is None or servo.type == "cascade":
        return servo
    equations = derive(model)
    rest = hold_joints(equations, np.array(model.home))
    stiff, soft, lowest = inertias_at_rest(equations, rest.q_a, rest.q_m, rest.tau_m)
    hz = chosen_frequencies({name: getattr(servo, name) for name in FREQUENCIES}, lowest)
    gains = cascade_gains(hz, stiff, soft, servo.sample_time + servo.delay)
    values = {name: tuple(x.tolist()) for name, x in zip(GAINS, gains, strict=True)}
    return replace(servo, type="cascade", **dict.fromkeys(FREQUENCIES), **values)
