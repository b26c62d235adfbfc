"""What the sensors of a model measure, as CasADi graphs.

accelerometer    a . R' (p'' - g)         specific force along its axes a, R and p of its frame in the world
gyro             a . w                    angular velocity of its body, in the axes of the body
link encoder     q_a,i
tracker          a . p                    position of a point of the tool, in the world
"""

from __future__ import annotations

import casadi as ca

from flexgen.mechanics.kinematics import Frame, place
from flexgen.mechanics.system import System
from flexgen.model.elements import Placement
from flexgen.model.sensors import TOOL, Sensor


def sensor_signals(system: System) -> ca.SX:
    """The channels of all sensors, (n,): functions of the coordinates ``y``, their velocities and accelerations."""
    signals = [_signal(system, sensor) for sensor in system.model.sensors]
    return ca.vertcat(*signals) if signals else ca.SX(0, 1)


def _signal(system: System, sensor: Sensor) -> ca.SX:
    chain = system.lagrangian.chain
    if sensor.type == "link_encoder":
        return chain.q_a[[c.name for c in system.model.coordinates].index(sensor.place)]
    axes = ca.SX(ca.DM(sensor.axes))
    body = chain.tool if sensor.place == TOOL else chain.frames[sensor.place]
    frame: Frame = place(body, Placement(tuple(sensor.position)))
    if sensor.type == "tracker":
        return ca.mtimes(axes, frame.p)
    if sensor.type == "gyro":
        return ca.mtimes(axes, frame.w)
    velocity = ca.mtimes(frame.R, frame.v)  # of the point, in the world
    states = ca.vertcat(chain.q_a, chain.v_a), ca.vertcat(chain.v_a, system.lagrangian.a_a)
    force = ca.jtimes(velocity, *states) - ca.SX(ca.DM(system.model.gravity))
    return ca.mtimes(axes, ca.mtimes(frame.R.T, force))
