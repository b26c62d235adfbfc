"""The reference of the servo of a model along a solution, in addition to its torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.loop.reference import hold_torques, time_grid
from flexgen.feedback.positions.columns import command_columns
from flexgen.feedback.positions.inverse import holding_offset, invert_servo
from flexgen.feedback.positions.servo import Servo, servo_of
from flexgen.inversion.solution import Solution

MOTION = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")


@provides("Solution.positions")
def with_positions(solution: Solution) -> Solution:
    """The solution with the channels ``command_m`` (motor side) and ``command_g`` (joints), at its
    samples.

    They are the reference with which the servo of the model sends the torques, held at its sample
    time, along the motor angles; between its samples a cubic spline. `flexgen.command_positions`
    has the samples for an interface, and what follows after the motion.

    Raises
    ------
    ArgumentError
        The model has no servo, or one without an inverse.
    """
    model = solution.model
    trajectory = solution.trajectory
    if model.servo is None:
        raise ArgumentError(
            f'command: given "position" for the model {model.title} without a servo, expected a '
            f"table [servo] in its "
            "file; flexgen.command_positions takes one as an argument"
        )
    servo = servo_of(None, model)
    gains = gains_at_begin(servo, solution)
    h = servo.sample_time
    first = float(trajectory.time[0])
    last = float(trajectory.time[-1])
    time = time_grid(first, last, h, 4 * h, 4 * h)
    held = hold_torques(trajectory, time, h, servo.delay)
    q_m = trajectory.at(np.clip(time, first, last))["q_m"]
    r = invert_servo(servo, gains, held, q_m) + holding_offset(gains, held[0])
    command = CubicSpline(time, r)(trajectory.time)
    values = {"command_m": command, "command_g": command @ np.linalg.inv(model.eta).T}
    ports, labels, units = command_columns(model)
    return replace(
        solution,
        trajectory=replace(
            trajectory,
            channels={**trajectory.channels, **values},
            ports={**trajectory.ports, **ports},
            labels={**trajectory.labels, **labels},
            units={**trajectory.units, **units},
        ),
    )


def gains_at_begin(servo: Servo, solution: Solution) -> Cascade:
    """The gains of the motors; those by frequencies with the inertias where the motion begins."""
    feedback = servo.feedback
    if isinstance(feedback, PPI):
        begin = [solution.trajectory[name][:1] for name in MOTION]
        return feedback.cascade(solution.model, servo.sample_time + servo.delay, begin)
    return feedback
