"""Measurement equations of the sensors of a model, as CasADi graphs.

accelerometer    a . R' (p'' - g)
specific force along its axes a, R and p of its frame in the world
gyro             a . w                    angular velocity of its body, in the axes of the body
link encoder     q_a,i
tracker          a . p                    position of a point of the tool, in the world
joint torque     (M a + c + g - f)_i
f: friction and other forces on the arm; that of gear or spring and damper
wrench           d/dt dT/du - dT/dx + dV/dx - f_u,
u = x': a motion of all behind the cut against the rest, at x = 0
strain           gauge q_a,i + offset
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.lines import Anchor
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.dynamics.mechanics.kinematics import Frame, kinematics, place
from flexgen.dynamics.mechanics.lagrangian import equations_of, line_forces
from flexgen.dynamics.mechanics.system import System
from flexgen.model.elements import Body, Dof, Element, Placement, RobotModel, Tool

CUT = "sensor_cut"  # element of a motion behind a sensor
MOTIONS = [f"{CUT}_{kind}_{k}" for kind in ("translation", "rotation") for k in range(3)]


def sensor_signals(system: System) -> ca.SX:
    """The channels of all sensors, (n,): functions of the coordinates ``y``, their velocities and
    accelerations.
    """
    signals = [_signal(system, sensor) for sensor in system.model.sensors]
    return ca.vertcat(*signals) if signals else ca.SX(0, 1)


def _signal(system: System, sensor: Sensor) -> ca.SX:
    """Signals of a sensor as expressions of motion and torques [of the sensor].

    Encoder: coordinate; strain gauge: ``gauge q + offset``; joint torque: torque that the arm
    needs there; tracker: position; gyro: angular velocity; accelerometer: acceleration of its
    point less gravity, in its axes.
    """
    chain = system.lagrangian.chain
    if sensor.of_force and system.model.motor_coupling == "complete":
        raise ArgumentError(
            f"sensor {sensor.name}: given a {sensor.type} in a model with motor_coupling = "
            '"complete", whose rotors add to the forces, expected motor_coupling = "simplified"'
        )
    if sensor.type == "wrench":
        return _wrench(system, sensor)
    if sensor.type in ("link_encoder", "joint_torque", "strain"):
        i = [c.name for c in system.model.coordinates].index(sensor.place)
        if sensor.type == "joint_torque":
            return (system.arm_left - system.lagrangian.arm_forces)[i]
        return (
            chain.q_a[i] if sensor.gauge is None else sensor.gauge * chain.q_a[i] + sensor.offset
        )
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


def _wrench(system: System, sensor: Sensor) -> ca.SX:
    """Force and moment (6,) [N, N m] that hold what is behind the sensor, at its point, in the
    axes of its frame.

    The model gets six degrees of freedom at the sensor, which are at rest: their equations of
    motion are the wrench.
    """
    arm = system.lagrangian.chain
    model = _cut_behind(system.with_symbols, sensor)
    chain = kinematics(model)
    a = ca.SX.sym("a", model.n_a)
    left = equations_of(chain.kinetic, chain.gravity, chain.q_a, chain.v_a, a) + ca.gradient(
        chain.drag, chain.v_a
    )
    if chain.lines:
        left -= line_forces(chain)
    if system.force is not None:
        velocity = ca.vertcat(*(ca.mtimes(chain.tool.R, x) for x in (chain.tool.v, chain.tool.w)))
        left -= ca.gradient(ca.dot(system.force, velocity), chain.v_a)
    behind = [c.name in MOTIONS for c in model.coordinates]
    rest = [k for k, own in enumerate(behind) if not own]
    motion = [ca.SX.zeros(model.n_a) for _ in range(3)]
    for own, of_arm in zip(motion, (arm.q_a, arm.v_a, system.lagrangian.a_a), strict=True):
        own[rest] = of_arm
    return ca.substitute(
        [left[np.flatnonzero(behind).tolist()]], [chain.q_a, chain.v_a, a], motion
    )[0]


def _cut_behind(model: RobotModel, sensor: Sensor) -> RobotModel:
    """The model with six more degrees of freedom at the frame of the sensor, which move all that
    is behind it.

    Forces on these coordinates are those that the sensor carries. The element of the sensor gives
    its body to the part behind the cut, as the sensor is before it.
    """
    at = model.tool if sensor.place == TOOL else Placement()
    R = np.array(at.rotation)
    p = np.array(at.position) + R @ sensor.position
    back = Placement(tuple((-R.T @ p).tolist()), tuple(map(tuple, R.T.tolist())))
    dofs = tuple(
        Dof(name, name.split("_")[2], tuple(np.eye(3)[k % 3].tolist()))
        for k, name in enumerate(MOTIONS)
    )
    cut = Element(CUT, dofs, Placement(tuple(p.tolist()), at.rotation), back)
    own = model.tip if sensor.place == TOOL else sensor.place
    elements: tuple[Element, ...] = ()
    for element in model.elements:
        parent = model.parents[element.name]
        moved = sensor.place != TOOL and parent == own
        element = replace(element, parent=CUT if moved else parent)
        if element.name == own and sensor.place == TOOL:
            elements += (element, replace(cut, parent=own))
        elif element.name == own:
            behind = replace(cut, body=element.body, beam=element.beam, parent=own)
            elements += (replace(element, body=Body(), beam=None), behind)
        else:
            elements += (element,)
    tip = CUT if model.tip == own else model.tip
    lines = model.lines
    if sensor.place != TOOL:
        lines = tuple(
            replace(line, start=_behind(line.start, own), end=_behind(line.end, own))
            for line in lines
        )
    tool = Tool(model.tool.position, model.tool.rotation, tip)
    return replace(model, elements=elements, tool=tool, lines=lines)


def _behind(anchor: Anchor, own: str) -> Anchor:
    """The end of a line behind the cut, where it is fixed to the body of the sensor's element."""
    return replace(anchor, element=CUT) if anchor.element == own else anchor
