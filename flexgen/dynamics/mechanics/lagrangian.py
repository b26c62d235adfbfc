"""Energies and generalized forces of the extended flexible joint model, and Lagrange's equations
by differentiation.

Coordinates ``y = (q_a, q_me)``: the arm coordinates and the motors behind elastic gears. A motor
behind a rigid gear follows its joints, ``q_m = eta q_g``, and its inertia and torque act on them
directly.

    d/dt dT/dy' - dT/dy + dV/dy = Q,     T = T_bodies(q_a, v_a) + T_rotors

Simplified motor coupling: ``T_rotor = J v_m^2 / 2``; complete:
``T_rotor = J (v_m + a . omega_carrier)^2 / 2`` with the rotor's axis a in the body that carries
it.

Source: S. Moberg, Modeling and Control of Flexible Manipulators, 2010; P. Tomei, IEEE TAC 36(10),
1991, for the coupling.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from flexgen.dynamics.mechanics.force_laws import (
    friction_torque,
    spring_energy,
    spring_torque,
    stiffness_at_zero,
)
from flexgen.dynamics.mechanics.kinematics import Kinematics, kinematics
from flexgen.dynamics.mechanics.motor_harmonics import gear_angles, gear_rates, given_torques
from flexgen.model.elements import Gear, RobotModel


@dataclass(frozen=True)
class Lagrangian:
    """Energies and forces as graphs in the symbols ``q_a v_a a_a`` (n_a) and ``q_m v_m a_m tau_m``
    (n_m).

    ``kinetic``, ``potential`` [J]: of the whole robot. ``kinetic_arm``, ``gravity`` [J]: without
    rotors and springs (in complete coupling with the rotors' share for motors at rest). ``forces``
    (n_a + n_me): generalized forces that have no potential. ``power_motor``, ``power_dissipated``
    [W]. ``tau_g`` (n_g): torque of the elastic gears on the arm side; ``tau_e`` (n_e): torque of
    the non-actuated elements; ``tau_gm`` (n_m): torques of the gears on the motor side;
    ``momentum_m`` (n_m): axial momentum of the rotors for the motor velocities v_m [N m s];
    ``arm_forces`` (n_a): joint frictions, body drags, tensions of lines and forces on the tool, as
    they act.
    """

    model: RobotModel
    chain: Kinematics
    a_a: ca.SX
    q_m: ca.SX
    v_m: ca.SX
    a_m: ca.SX
    tau_m: ca.SX
    kinetic: ca.SX
    kinetic_arm: ca.SX
    gravity: ca.SX
    potential: ca.SX
    forces: ca.SX
    power_motor: ca.SX
    power_dissipated: ca.SX
    tau_g: ca.SX
    tau_e: ca.SX
    tau_gm: ca.SX
    momentum_m: ca.SX
    arm_forces: ca.SX


def equations_of(kinetic: ca.SX, potential: ca.SX, y: ca.SX, dy: ca.SX, ddy: ca.SX) -> ca.SX:
    """Left side of Lagrange's equations, ``d/dt dT/dy' - dT/dy + dV/dy``, at the accelerations
    ``ddy``.
    """
    momentum = ca.gradient(kinetic, dy)
    rate = ca.jtimes(momentum, ca.vertcat(y, dy), ca.vertcat(dy, ddy))
    return rate - ca.gradient(kinetic, y) + ca.gradient(potential, y)


@dataclass
class _Forces:
    """Sums over the joints of the forces, energies and losses of springs, dampers and frictions.

    ``stored`` [J]: energy of the springs; ``lost`` [W]: dissipated power; ``on_arm`` (n_a): joint
    frictions and counterbalances; ``tau_g`` (n_g), ``tau_e``: torques of the gears and of the
    joints without motor, in chain order.
    """

    on_arm: list[ca.SX]
    stored: ca.SX = field(default_factory=lambda: ca.SX(0))
    lost: ca.SX = field(default_factory=lambda: ca.SX(0))
    tau_g: list[ca.SX] = field(default_factory=list)
    tau_e: list[ca.SX] = field(default_factory=list)


def lagrangian(model: RobotModel, force: ca.SX | None = None) -> Lagrangian:
    """Build the `Lagrangian` of a model; ``force`` (6,): force and torque on the tool, see
    `System.force`.

    Springs, friction, drag and motor torques are generalized forces. A motor behind a rigid gear
    has the angle of its joints, and its torque and friction act on these.
    """
    chain = kinematics(model)
    q_a = chain.q_a
    v_a = chain.v_a
    a_a = ca.SX.sym("a_a", model.n_a)
    q_m, v_m, a_m, tau_m = (ca.SX.sym(name, model.n_m) for name in ("q_m", "v_m", "a_m", "tau_m"))
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    i_m = list(model.i_m)
    q_g = q_a[i_g]
    v_g = v_a[i_g]
    eta = ca.SX(ca.DM(model.eta))

    # a motor behind a rigid gear is where its joints are
    elastic = set(i_m)
    q_geared = ca.mtimes(eta, q_g)
    v_geared = ca.mtimes(eta, v_g)
    q_m_all = ca.vertcat(*[q_m[j] if j in elastic else q_geared[j] for j in range(model.n_m)])
    v_m_all = ca.vertcat(*[v_m[j] if j in elastic else v_geared[j] for j in range(model.n_m)])
    kinetic, carried, momentum_m = _rotor_energies(model, chain, v_m, v_m_all)

    rates = gear_rates(model, q_m_all)
    joints = _joint_forces(model, chain, gear_angles(model, q_m_all), ca.mtimes(rates, v_m_all))
    _add_beams(joints, chain)
    tau_e = _elastic_torques(model, chain, joints.tau_e)
    tau_g = ca.vertcat(*joints.tau_g)
    tau_gm = ca.mtimes(rates.T, tau_g)

    drag = ca.gradient(chain.drag, v_a)
    lost = joints.lost + ca.dot(drag, v_a)
    arm_forces = ca.vertcat(*joints.on_arm) - drag
    if chain.lines:
        arm_forces = arm_forces + line_forces(chain)
        joints.stored = joints.stored + sum(line.energy for line in chain.lines)
        lost = lost + sum(line.damping_force * line.rate for line in chain.lines)
    if force is not None:  # J' f from its power, which the robot receives
        power = ca.dot(
            force, ca.vertcat(*(ca.mtimes(chain.tool.R, x) for x in (chain.tool.v, chain.tool.w)))
        )
        arm_forces = arm_forces + ca.gradient(power, v_a)
        lost = lost - power
    force = ca.SX(arm_forces)
    warm = model.temperature
    friction_m = ca.vertcat(
        *[
            friction_torque(m.friction, v_m_all[j], tau_gm[j], warm)
            for j, m in enumerate(model.motors)
        ]
    )
    lost = lost + ca.dot(friction_m, v_m_all)
    given, cogging, cogged = given_torques(model, q_m_all, tau_m)
    force_m = given + cogging - friction_m
    rigid = [j for j in range(model.n_m) if j not in elastic]
    # springs are generalized forces here, not potential: one expression serves statics, dynamics
    # and the torque output
    force[i_g] = force[i_g] + tau_g
    if rigid:
        force[i_g] = force[i_g] + ca.mtimes(eta[rigid, :].T, force_m[rigid])
    if i_e:
        force[i_e] = force[i_e] + tau_e
    motor_rows = [force_m[j] - tau_gm[j] for j in i_m]
    return Lagrangian(
        model=model,
        chain=chain,
        a_a=a_a,
        q_m=q_m,
        v_m=v_m,
        a_m=a_m,
        tau_m=tau_m,
        kinetic=kinetic,
        kinetic_arm=chain.kinetic + carried,
        gravity=chain.gravity,
        potential=chain.gravity + joints.stored + cogged,
        forces=ca.vertcat(force, *motor_rows),
        power_motor=ca.dot(given, v_m_all),
        power_dissipated=lost,
        tau_g=tau_g,
        tau_e=tau_e,
        tau_gm=tau_gm,
        momentum_m=momentum_m,
        arm_forces=arm_forces,
    )


def line_forces(chain: Kinematics) -> ca.SX:
    """Forces of the lines' tensions on the coordinates (n_a), ``-(dl/dq)' F``."""
    rates = ca.vertcat(*[line.rate for line in chain.lines])
    tensions = ca.vertcat(*[line.tension for line in chain.lines])
    # the derivatives of the rates in the velocities are those of the lengths in the coordinates
    return -ca.jtimes(rates, chain.v_a, tensions, True)


def _rotor_energies(
    model: RobotModel, chain: Kinematics, v_m: ca.SX, v_m_all: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Kinetic energy of bodies and rotors [J], the rotors' share for motors at rest [J], and their
    axial momentum.

    ``v_m`` (n_m): the symbols of the motor velocities, for the momentum; ``v_m_all``: those of
    motors behind rigid gears replaced by the velocities of their joints.
    """
    kinetic = chain.kinetic
    carried = ca.SX(0)
    momentum = []
    for j, motor in enumerate(model.motors):
        if model.motor_coupling == "complete":
            assert motor.axis is not None and motor.carrier is not None  # checked by the reader
            turning = ca.dot(ca.SX(ca.DM(motor.axis)), chain.spin[motor.carrier])
            kinetic = kinetic + motor.inertia * (v_m_all[j] + turning) ** 2 / 2
            carried = carried + motor.inertia * turning**2 / 2
            momentum.append(motor.inertia * (v_m[j] + turning))
        else:
            kinetic = kinetic + motor.inertia * v_m_all[j] ** 2 / 2
            momentum.append(motor.inertia * v_m[j])
    return kinetic, carried, ca.vertcat(*momentum)


def _joint_forces(model: RobotModel, chain: Kinematics, theta: ca.SX, omega: ca.SX) -> _Forces:
    """Springs, dampers, frictions and counterbalances of the joints: forces, stored energy and
    lost power.

    ``theta``, ``omega`` (n_g,) [rad or m, per s]: motors seen from the arm side. A spring on the
    motor side sees deflections times the ratio.
    """
    q_a = chain.q_a
    v_a = chain.v_a
    out = _Forces([ca.SX(0) for _ in range(model.n_a)])
    k = 0
    joints = gears(model)
    for i, coordinate in enumerate(model.coordinates):
        dof = coordinate.dof
        if dof is None:
            continue
        braking = friction_torque(dof.friction, v_a[i])
        out.on_arm[i] = out.on_arm[i] - braking
        out.lost = out.lost + braking * v_a[i]
        for n, (sine, cosine) in enumerate(dof.counterbalance, 1):
            out.on_arm[i] = out.on_arm[i] + sine * ca.sin(n * q_a[i]) + cosine * ca.cos(n * q_a[i])
            out.stored = out.stored + (sine * ca.cos(n * q_a[i]) - cosine * ca.sin(n * q_a[i])) / n
        if dof.gear is None:
            assert dof.spring is not None
            out.stored = out.stored + spring_energy(dof.spring, q_a[i])
            out.lost = out.lost + dof.damping * v_a[i] ** 2
            out.tau_e.append(-spring_torque(dof.spring, q_a[i]) - dof.damping * v_a[i])
            continue
        gear, ratio = joints[k]
        if gear.spring is None:
            out.tau_g.append(ca.SX(0))
        else:
            deflection = ratio * (theta[k] - q_a[i])
            rate = ratio * (omega[k] - v_a[i])
            out.stored = out.stored + spring_energy(gear.spring, deflection)
            out.lost = out.lost + gear.damping * rate**2
            out.tau_g.append(
                ratio * (spring_torque(gear.spring, deflection) + gear.damping * rate)
            )
        k += 1
    return out


def _add_beams(joints: _Forces, chain: Kinematics) -> None:
    """Add the energy that the beams store and the power that they dissipate."""
    for first, beam in chain.modal:
        rows = slice(first, first + len(beam.slope))
        q = chain.q_a[rows]
        v = chain.v_a[rows]
        K = ca.SX(ca.DM(beam.stiffness))
        D = ca.SX(ca.DM(beam.damping))
        joints.stored = joints.stored + ca.dot(q, ca.mtimes(K, q)) / 2
        joints.lost = joints.lost + ca.dot(v, ca.mtimes(D, v))


def gears(model: RobotModel) -> list[tuple[Gear, float]]:
    """The gear of each actuated coordinate, and the factor from an arm-side deflection to the side
    of its spring.
    """
    out = []
    for i in model.i_g:
        dof = model.coordinates[i].dof
        assert dof is not None and dof.gear is not None  # what makes a coordinate actuated
        on_motor = dof.gear.side == "motor" and not dof.gear.rigid
        out.append(
            (
                dof.gear,
                next(m.ratio[0] for m in model.motors if m.drives == (dof.name,))
                if on_motor
                else 1.0,
            )
        )
    return out


def gear_stiffness(model: RobotModel, rigid: float = 0.0) -> np.ndarray:
    """Stiffness at zero of the springs of all gears (n_g,) [N m/rad or N/m], arm side; ``rigid``
    where one has none.
    """
    found = [
        rigid if g.spring is None else ratio**2 * stiffness_at_zero(g.spring)
        for g, ratio in gears(model)
    ]
    return np.array(found, float)


def _elastic_torques(model: RobotModel, chain: Kinematics, joints: list[ca.SX]) -> ca.SX:
    """Torques (n_e,) of all non-actuated coordinates in chain order: those of ``joints`` from the
    list, in its order, beams from their stiffness and damping matrices.
    """
    torques: dict[int, ca.SX] = {}
    for first, beam in chain.modal:
        n = len(beam.slope)
        q = chain.q_a[first : first + n]
        v = chain.v_a[first : first + n]
        torque = -ca.mtimes(ca.SX(ca.DM(beam.stiffness)), q) - ca.mtimes(
            ca.SX(ca.DM(beam.damping)), v
        )
        torques.update({first + k: torque[k] for k in range(n)})
    rest = iter(joints)
    return ca.vertcat(
        ca.SX(0, 1), *[torques[i] if i in torques else next(rest) for i in model.i_e]
    )
