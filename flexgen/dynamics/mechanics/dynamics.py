"""Kinematics and dynamics of a robot as builders of CasADi functions, from the Lagrangian.

    M_a(q_a) a_a + c(q_a, v_a) + g(q_a) = tau_a,
    tau_a = tau_g on the actuated rows, tau_e on the others
    tau_g = spring(eta^-1 q_m - q_g) + D_g (eta^-1 v_m - v_g),
    tau_e = -spring_e(q_e) - D_e v_e
    J_m a_m + f(v_m) + eta^-T tau_g = tau_m

Source: S. Moberg, Modeling and Control of Flexible Manipulators, 2010 (extended flexible joint
model).
"""

from __future__ import annotations

import casadi as ca

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.force_laws import friction_torque, spring_torque
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.motor_harmonics import given_torques, motors_of_gears
from flexgen.dynamics.mechanics.system import Builder, Built, System, solve_symmetric
from flexgen.model.abilities import obstacle

STATE = ["q_a", "v_a", "q_m", "v_m", "tau_m"]
MOTION = ["q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m"]


def symbols_of(system: System, names: list[str]) -> list[ca.SX]:
    """The Lagrangian's symbols of these names."""
    lag = system.lagrangian
    known = {"q_a": lag.chain.q_a, "v_a": lag.chain.v_a, "a_a": lag.a_a}
    known |= {"q_m": lag.q_m, "v_m": lag.v_m, "a_m": lag.a_m, "tau_m": lag.tau_m}
    return [known[name] for name in names]


# --- the tool ------------------------------------------------------------------------------------


def tool_velocity(system: System) -> ca.SX:
    """Spatial velocity of the tool (6,): linear, then angular, world axes."""
    tool = system.lagrangian.chain.tool
    return ca.vertcat(ca.mtimes(tool.R, tool.v), ca.mtimes(tool.R, tool.w))


def forward_kinematics(system: System) -> Built:
    """Position and rotation matrix of the tool in the world."""
    chain = system.lagrangian.chain
    return [chain.q_a], ["q_a"], [chain.tool.p, chain.tool.R], ["p", "R"]


def jacobian(system: System) -> Built:
    """Jacobian of the tool: linear, then angular velocity."""
    chain = system.lagrangian.chain
    return [chain.q_a], ["q_a"], [ca.jacobian(tool_velocity(system), chain.v_a)], ["J"]


def jacobian_dot(system: System) -> Built:
    """Time derivative of the Jacobian of the tool."""
    chain = system.lagrangian.chain
    J = ca.densify(ca.jacobian(tool_velocity(system), chain.v_a))
    dJ = ca.reshape(ca.jtimes(ca.vec(J), chain.q_a, chain.v_a), 6, system.model.n_a)
    return [chain.q_a, chain.v_a], ["q_a", "v_a"], [dJ], ["dJ"]


def output(system: System) -> Built:
    """The declared output; for a pose the position of the tool."""
    chain = system.lagrangian.chain
    declared = system.model.output
    if declared.type == "combination":
        y = ca.mtimes(ca.SX(ca.DM(declared.weights)), chain.q_a)
        return [chain.q_a], ["q_a"], [y], ["y"]
    y = chain.tool.p[list(declared.tool_rows)]
    if declared.has_angle:
        from flexgen.dynamics.mechanics.tool_angle import tool_angle

        y = ca.vertcat(y, tool_angle(system).value)
    if declared.weights:
        y = ca.vertcat(y, ca.mtimes(ca.SX(ca.DM(declared.weights)), chain.q_a))
    return [chain.q_a], ["q_a"], [y], ["y"]


def chain_points(system: System) -> Built:
    """Corner points of the chain, for drawing."""
    chain = system.lagrangian.chain
    return [chain.q_a], ["q_a"], [ca.horzcat(*chain.points)], ["chain_points"]


def line_states(system: System) -> Built:
    """Lengths, rates and tensions of the lines between two points."""
    chain = system.lagrangian.chain
    columns = [
        ca.vertcat(ca.SX(0, 1), *values)
        for values in (
            [line.length for line in chain.lines],
            [line.rate for line in chain.lines],
            [line.tension for line in chain.lines],
        )
    ]
    return [chain.q_a, chain.v_a], ["q_a", "v_a"], columns, ["l", "dl", "F_l"]


def line_points(system: System) -> Built:
    """Ends of the lines in the world, for drawing."""
    chain = system.lagrangian.chain
    points = ca.horzcat(ca.SX(3, 0), *[line.points for line in chain.lines])
    return [chain.q_a], ["q_a"], [points], ["line_points"]


# --- the arm -------------------------------------------------------------------------------------


def mass_matrix(system: System) -> Built:
    """Mass matrix of the arm, without rotors."""
    lag = system.lagrangian
    return [lag.chain.q_a], ["q_a"], [ca.hessian(lag.kinetic_arm, lag.chain.v_a)[0]], ["M"]


def bias(system: System) -> Built:
    """Coriolis, centripetal and gravity forces of the arm."""
    lag = system.lagrangian
    h = ca.substitute(system.arm_left, lag.a_a, ca.SX.zeros(system.model.n_a))
    return [lag.chain.q_a, lag.chain.v_a], ["q_a", "v_a"], [h], ["h"]


def gravity(system: System) -> Built:
    """Gravity forces of the arm."""
    lag = system.lagrangian
    return [lag.chain.q_a], ["q_a"], [ca.gradient(lag.gravity, lag.chain.q_a)], ["g"]


def inverse_dynamics(system: System) -> Built:
    """Forces of the arm for a given motion, without friction and springs."""
    names = ["q_a", "v_a", "a_a"]
    return symbols_of(system, names), names, [system.arm_left], ["tau_a"]


def arm_forward_dynamics(system: System) -> Built:
    """Accelerations of the arm under given forces on its coordinates."""
    lag = system.lagrangian
    tau_a = ca.SX.sym("tau_a", system.model.n_a)
    M = mass_matrix(system)[2][0]
    h = bias(system)[2][0]
    inputs = [lag.chain.q_a, lag.chain.v_a, tau_a]
    return inputs, ["q_a", "v_a", "tau_a"], [solve_symmetric(M, tau_a - h)], ["a_a"]


def arm_forces(system: System) -> Built:
    """Joint frictions and body drags of the arm, as they act."""
    lag = system.lagrangian
    return [lag.chain.q_a, lag.chain.v_a], ["q_a", "v_a"], [lag.arm_forces], ["f_a"]


def elastic_torque(system: System) -> Built:
    """Torques of the springs and dampers of the coordinates without motor."""
    lag = system.lagrangian
    return [lag.chain.q_a, lag.chain.v_a], ["q_a", "v_a"], [lag.tau_e], ["tau_e"]


# --- motors and gears ----------------------------------------------------------------------------


def motor_friction(system: System) -> Built:
    """Friction torques of the motors."""
    v_m = system.lagrangian.v_m
    model = system.with_symbols
    if (reason := obstacle(system.model, "friction of speeds")) is not None:
        raise ArgumentError(f"motor_friction: {reason}; use loaded_friction")
    friction = [
        friction_torque(m.friction, v_m[j], None, model.temperature)
        for j, m in enumerate(model.motors)
    ]
    return [v_m], ["v_m"], [ca.vertcat(*friction)], ["f_m"]


def loaded_friction(system: System) -> Built:
    """Friction torques of the motors, of which some depend on the torques of the gears."""
    v_m = system.lagrangian.v_m
    model = system.with_symbols
    tau_l = ca.SX.sym("tau_l", system.model.n_m)
    friction = [
        friction_torque(m.friction, v_m[j], tau_l[j], model.temperature)
        for j, m in enumerate(model.motors)
    ]
    return [v_m, tau_l], ["v_m", "tau_l"], [ca.vertcat(*friction)], ["f_m"]


def motor_harmonics(system: System) -> Built:
    """Motors behind gears with transmission error, cogging torques, and the factors of the motors'
    torques.
    """
    n = system.model.n_m
    names = ["w_m", "dw_m", "ddw_m"]
    inputs = [ca.SX.sym(name, n) for name in names]
    q_m, *others = motors_of_gears(system.with_symbols, *inputs)
    gain, cogging, _ = given_torques(system.with_symbols, q_m, ca.SX.ones(n))
    return (
        inputs,
        names,
        [q_m, *others, cogging, gain],
        ["q_m", "v_m", "a_m", "gear_share", "tau_c", "gain_m"],
    )


def given_torque(system: System) -> Built:
    """Torques that the motors give, with ripple, and their cogging torques."""
    lag = system.lagrangian
    given, cogging, _ = given_torques(system.with_symbols, lag.q_m, lag.tau_m)
    return [lag.q_m, lag.tau_m], ["q_m", "tau_m"], [given + cogging], ["tau_d"]


def rotor_torque(system: System) -> Built:
    """Time derivative of the rotors' axial momentum."""
    lag = system.lagrangian
    names = ["q_a", "v_a", "a_a", "v_m", "a_m"]
    inputs = symbols_of(system, names)
    moving = ca.vertcat(inputs[0], inputs[1], inputs[3])
    rates = ca.vertcat(inputs[1], inputs[2], inputs[4])
    return inputs, names, [ca.jtimes(lag.momentum_m, moving, rates)], ["tau_r"]


def rotor_coupling(system: System) -> Built:
    """Forces of the rotors' speeds on the joints with motor, and torques that the carriers take
    from the rotors, in complete motor coupling.
    """
    reason = obstacle(system.model, "rotors in C")
    if reason is not None:
        raise ArgumentError(f"rotor_coupling: {reason}")
    lag = system.lagrangian
    names = ["q_a", "v_a", "a_a", "v_m", "a_m"]
    inputs = symbols_of(system, names)
    q_a, v_a, a_a, v_m, a_m = inputs
    turning = ca.substitute(lag.momentum_m, v_m, ca.SX.zeros(v_m.shape))
    taken = ca.jtimes(turning, ca.vertcat(q_a, v_a), ca.vertcat(v_a, a_a))
    on_joints = rotor_forces(system, v_m, a_m)[list(system.model.i_g)]
    return inputs, names, [on_joints, taken], ["tau_rg", "tau_rm"]


def rotor_forces(system: System, v_m: ca.SX, a_m: ca.SX) -> ca.SX:
    """Forces (n_a) that the arm needs where rotors move against their carriers in complete motor
    coupling, of the part ``sum_j J_j v_m,j a_j . omega_carrier`` of the kinetic energy; ``v_m``,
    ``a_m`` (n_m): speeds and accelerations of the motors, as symbols or graphs.
    """
    lag = system.lagrangian
    q_a = lag.chain.q_a
    v_a = lag.chain.v_a
    speed, acceleration = (ca.SX.sym(name, system.model.n_m) for name in ("v_m", "a_m"))
    turning = ca.substitute(lag.momentum_m, lag.v_m, ca.SX.zeros(speed.shape))
    energy = ca.dot(speed, turning)
    momentum = ca.gradient(energy, v_a)
    rates = ca.vertcat(v_a, lag.a_a, acceleration)
    forces = ca.jtimes(momentum, ca.vertcat(q_a, v_a, speed), rates) - ca.gradient(energy, q_a)
    given = ca.vertcat(v_m, a_m)
    return ca.substitute(forces, ca.vertcat(speed, acceleration), given)


def gear_law(system: System) -> Built:
    """Torques of the gears' springs, and their derivatives in the deflection; zero for rigid
    gears.
    """
    deflection = ca.SX.sym("deflection", system.model.n_g)
    tau: list[ca.SX] = []
    for k, (gear, ratio) in enumerate(gears(system.with_symbols)):
        spring = gear.spring
        tau.append(
            ca.SX(0) if spring is None else ratio * spring_torque(spring, ratio * deflection[k])
        )
    dtau = [ca.gradient(torque, deflection[k]) for k, torque in enumerate(tau)]
    return [deflection], ["deflection"], [ca.vertcat(*tau), ca.vertcat(*dtau)], ["tau_p", "dtau_p"]


def gear_torque(system: System) -> Built:
    """Torques of the elastic gears, springs and dampers; zero for rigid gears."""
    lag = system.lagrangian
    names = STATE[:4]
    return symbols_of(system, names), names, [lag.tau_g], ["tau_g"]


# --- the whole robot -----------------------------------------------------------------------------


def forward_dynamics(system: System) -> Built:
    """Accelerations of arm and motors under the motors' torques."""
    n_a = system.model.n_a
    a_a = system.acceleration[:n_a]
    a_me = system.acceleration[n_a:]
    outputs = [a_a, system.motor_accelerations(a_a, a_me)]
    return symbols_of(system, STATE), STATE, outputs, ["a_a", "a_m"]


def forward_dynamics_tool_force(system: System) -> Built:
    """Accelerations under the motors' torques and a force on the tool ``f_tool`` (6,) [N, N m],
    ``M a + ... = ... + J' f_tool``, and the torques of the elastic gears.
    """
    n_a = system.model.n_a
    f_tool = ca.SX.sym("f_tool", 6)
    pushed = ca.mtimes(jacobian(system)[2][0].T, f_tool)
    acceleration = system.acceleration_under(
        ca.vertcat(pushed, ca.SX.zeros(system.model.dof - n_a))
    )
    a_a = acceleration[:n_a]
    a_me = acceleration[n_a:]
    outputs = [a_a, system.motor_accelerations(a_a, a_me), system.lagrangian.tau_g]
    return (
        [*symbols_of(system, STATE), f_tool],
        [*STATE, "f_tool"],
        outputs,
        ["a_a", "a_m", "tau_g"],
    )


def tool_motion(system: System) -> Built:
    """Velocity and acceleration of the tool."""
    names = ["q_a", "v_a", "a_a"]
    chain = system.lagrangian.chain
    inputs = symbols_of(system, names)
    v_tool = ca.densify(tool_velocity(system))
    states = ca.vertcat(chain.q_a, chain.v_a), ca.vertcat(chain.v_a, inputs[2])
    return inputs, names, [v_tool, ca.jtimes(v_tool, *states)], ["v_tool", "a_tool"]


def sensors(system: System) -> Built:
    """Signals of the model's sensors."""
    from flexgen.dynamics.mechanics.sensors import sensor_signals

    names = ["q_a", "v_a", "a_a"]
    return symbols_of(system, names), names, [sensor_signals(system)], ["y_s"]


def sensor_derivatives(system: System) -> Built:
    """First derivatives of these signals."""
    inputs, names, (signals,), _ = sensors(system)
    outputs = [ca.densify(ca.jacobian(signals, x)) for x in inputs]
    return inputs, names, outputs, ["dys_dq", "dys_dv", "dys_da"]


def residual(system: System) -> Built:
    """Residuals of the equations of motion: of the arm's coordinates, then of the motors."""
    lag = system.lagrangian
    n_a = system.model.n_a
    n_m = system.model.n_m
    r = system.residual
    at = {j: k for k, j in enumerate(system.model.i_m)}
    geared = system.motor_accelerations(lag.a_a, lag.a_m[list(system.model.i_m)])
    r_m = ca.vertcat(*[r[n_a + at[j]] if j in at else lag.a_m[j] - geared[j] for j in range(n_m)])
    return symbols_of(system, MOTION), MOTION, [r[:n_a], r_m], ["r_a", "r_m"]


def energy(system: System) -> Built:
    """Kinetic and potential energy."""
    lag = system.lagrangian
    names = STATE[:4]
    return symbols_of(system, names), names, [lag.kinetic, lag.potential], ["kinetic", "potential"]


def power(system: System) -> Built:
    """Power of the motors, and power that frictions, dampers and drags dissipate."""
    lag = system.lagrangian
    outputs = [lag.power_motor, lag.power_dissipated]
    return symbols_of(system, STATE), STATE, outputs, ["P_motor", "P_dissipated"]


BUILDERS: dict[str, Builder] = {
    "forward_kinematics": forward_kinematics,
    "jacobian": jacobian,
    "jacobian_dot": jacobian_dot,
    "mass_matrix": mass_matrix,
    "bias": bias,
    "gravity": gravity,
    "inverse_dynamics": inverse_dynamics,
    "arm_forward_dynamics": arm_forward_dynamics,
    "arm_forces": arm_forces,
    "motor_friction": motor_friction,
    "loaded_friction": loaded_friction,
    "motor_harmonics": motor_harmonics,
    "given_torque": given_torque,
    "rotor_torque": rotor_torque,
    "rotor_coupling": rotor_coupling,
    "gear_law": gear_law,
    "gear_torque": gear_torque,
    "elastic_torque": elastic_torque,
    "forward_dynamics": forward_dynamics,
    "forward_dynamics_tool_force": forward_dynamics_tool_force,
    "tool_motion": tool_motion,
    "sensors": sensors,
    "sensor_derivatives": sensor_derivatives,
    "residual": residual,
    "energy": energy,
    "power": power,
    "output": output,
    "chain_points": chain_points,
    "line_states": line_states,
    "line_points": line_points,
}
