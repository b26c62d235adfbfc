"""Ideal signals of all sensors of a robot along a motion, without noise, delay and resolution."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.files.trajectory_files import common_unit
from flexgen.base.motion.trajectory import Trajectory, channel_values
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.fourier import FourierSum
from flexgen.base.spec.ports import Port
from flexgen.base.spec.sensors import WRENCH
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import channel_units
from flexgen.dynamics.mechanics.sensors import sensor_signals
from flexgen.model.elements import RobotModel

MOTION = ("q_a", "v_a", "a_a")
TOOL = 6


def encoder_error(given: FourierSum, q_m: np.ndarray) -> np.ndarray:
    """Error of an encoder [rad], its reading less the motor angle ``q_m`` (n,) [rad]."""
    k = np.outer(q_m, given.harmonics)
    return np.asarray(np.cos(k) @ given.cos + np.sin(k) @ given.sin)


def shown_angles(model: RobotModel, q_m: np.ndarray) -> np.ndarray:
    """Readings (n, n_m) [rad] of the encoders of a model at the motor angles ``q_m`` (n, n_m)
    [rad].
    """
    out = np.array(q_m, dtype=float)
    for j, motor in enumerate(model.motors):
        if motor.encoder_error is not None:
            out[:, j] += encoder_error(motor.encoder_error, out[:, j])
    return out


@checked_types
def sense(model: str | Path | RobotModel | Equations, motion: Trajectory) -> Trajectory:
    """Compute what the sensors of a model read along a motion.

    ``y_s``: signals of the ``[[sensor]]`` tables; ``q_m``: what the motor encoders show,
    ``q_m + e(q_m)`` with the ``encoder_error`` e of each motor. Torques of joints and wrenches
    follow from the motion, not from the springs::

        tau_i = (M a_a + c + g - f)_i,    f = friction and drag of the arm + J' force

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    motion : Trajectory
        Channels ``q_a v_a a_a`` (n, n_a), ``q_m`` (n, n_m), and ``force`` (n, 6) where a force [N]
        and torque [N m] act on the tool at its origin, world axes; as of `Solution.trajectory`.

    Returns
    -------
    Trajectory
        ``y_s`` (n, n_s), SI units, without noise and delay, and ``q_m`` (n, n_m) [rad]; labels:
        names of the channels.

    Raises
    ------
    ArgumentError
        The motion has other coordinates than the model or lacks a channel, or the model has no
        sensor.

    Examples
    --------
    >>> joint = {"name": "torque1", "type": "joint_torque", "coordinate": "q1", "unit": "N m"}
    >>> robot = flexgen.read("planar5_nmp", overrides={"sensor": [joint]})
    >>> seen = flexgen.sense(robot, flexgen.solve(robot, "line").trajectory)
    >>> seen.labels["y_s"], f"{seen['y_s'][0, 0]:.0f} N m"  # it holds the arm at rest
    (('torque1',), '857 N m')
    """
    equations = model if isinstance(model, Equations) else derive(model)
    robot = equations.model
    sensors = [
        (name, unit) for s in robot.sensors for name, unit in zip(s.channels, s.units, strict=True)
    ]
    if not sensors:
        raise ArgumentError(
            f"model: given {robot.name} without a [[sensor]], expected one or more"
        )
    wanted = channel_units(robot)
    given = {
        name: channel_values("motion", motion, name, wanted[name]) for name in (*MOTION, "q_m")
    }
    if "force" in motion:
        wrench = {label: "N" if label in WRENCH[:3] else "N m" for label in WRENCH}
        given["force"] = channel_values("motion", motion, "force", wrench)
    force = given.get("force", np.zeros((len(motion.time), TOOL)))
    signals = evaluate(signals_of(equations), *(given[name] for name in MOTION), force)[0]
    labels, units = zip(*sensors, strict=True)
    channels = {"y_s": signals.reshape(len(force), -1), "q_m": shown_angles(robot, given["q_m"])}
    ports = {
        "y_s": Port("y_s", (len(labels),), common_unit(units), "signals of the sensors"),
        "q_m": Port("q_m", (robot.n_m,), "rad", "motor angles as the encoders show them"),
    }
    names = {"y_s": labels, "q_m": tuple(motor.name for motor in robot.motors)}
    meta = {"model": robot.name, "variant": robot.variant, "kind": "sensors"}
    return Trajectory(motion.time, channels, ports, names, meta, {"y_s": units})


def signals_of(equations: Equations, numbers: bool = False) -> ca.Function:
    """All signals (n_s,) from ``q_a, v_a, a_a, force``; ``numbers``: and from the run-time
    parameters.
    """
    pushed = equations.pushed
    lag = pushed.lagrangian
    assert pushed.force is not None
    inputs = [
        lag.chain.q_a,
        lag.chain.v_a,
        lag.a_a,
        pushed.force,
        *([pushed.symbols] if numbers else []),
    ]
    return ca.Function("sensor_signals", inputs, [ca.cse(ca.densify(sensor_signals(pushed)))])
