"""Bounds of a planned motion from the limits of the model file, or from those given.

torque_speed   +-tau/(1 - r) +- k v <= c for each edge of a curve, which falls faster and faster
torque_rate    |dtau/dt| <= rate at both ends of each interval, between which it is linear; the
               torque does not jump
gear_torque    of springs and dampers; of rigid gears eta' (tau - J a - friction)
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.model.abilities import obstacle
from flexgen.planning.optimal.phase import Phase
from flexgen.planning.optimal.signals import motor_frictions

EFFECTIVE = ("torque_rms", "thermal_time", "gear_torque_rms")


def apply_limits(phase: Phase, limits: Limits | None, model_limits: bool) -> None:
    """Bounds of a phase: ``limits``, and with ``model_limits`` those of the model file that they
    do not replace.

    ArgumentError for effective torques in ``limits``; those of the model file are warnings of the
    solution.
    """
    model = phase.equations.model
    given = limits or Limits()
    if means := [name for name in EFFECTIVE if getattr(given, name) is not None]:
        raise ArgumentError(
            f"limits: given {', '.join(means)}, expected other kinds: effective torques are "
            "means over the motion; add a cost on the torque, or use flexgen.fastest"
        )
    kept = given.merge(model) if model_limits else given
    torque, speed = kept.arrays(model.n_m)
    curves = kept.torque_speed or ((),) * model.n_m
    speed = np.minimum(speed, [curve[-1][0] if curve else np.inf for curve in curves])
    for name, size in (
        ("tau_m", torque),
        ("v_m", speed),
        ("elastic_deflection", kept.deflections(model.n_e)),
    ):
        if len(size) and np.isfinite(size).any():
            phase.bound(name, -size, size)
    _bound_joints(phase, kept, model_limits)
    _bound_curves(phase, kept)
    if kept.torque_rate is not None:
        _bound_rates(phase, kept.bounds("torque_rate", model.n_m), given.torque_rate is not None)
    if kept.gear_torque is not None:
        _bound_gears(phase, (1.0 - kept.reserve) * kept.bounds("gear_torque", model.n_g))
    _bound_tool(phase, kept)


def _bound_joints(phase: Phase, kept: Limits, model_limits: bool) -> None:
    """Range, speed and acceleration of coordinates: of the limits ``kept`` and, with
    ``model_limits``, of the model, the smaller one of both.
    """
    model = phase.equations.model
    of_gear = {i: k for k, i in enumerate(model.i_g)}
    both = kept.bounds("joint_speed", model.n_g), kept.bounds("joint_acceleration", model.n_g)
    for i, c in enumerate(model.coordinates):
        dof = c.dof
        own = (
            (None, None)
            if dof is None or not model_limits
            else (dof.speed_max, dof.acceleration_max)
        )
        if model_limits and dof is not None and (dof.lower is not None or dof.upper is not None):
            phase.bound(f"q_a[{dof.name}]", dof.lower, dof.upper)
        for name, limit, more in zip(("v_a", "a_a"), own, both, strict=True):
            least = min(
                np.inf if limit is None else limit, more[of_gear[i]] if i in of_gear else np.inf
            )
            if np.isfinite(least):
                phase.bound(f"{name}[{c.name}]", -least, least)


def _bound_curves(phase: Phase, kept: Limits) -> None:
    """Torques at the speeds of the motors: each piece of a torque-speed curve is a line, and
    bounds torque and speed of both signs.
    """
    left = 1.0 - kept.reserve
    for motor, curve in zip(phase.equations.model.motors, kept.torque_speed or (), strict=False):
        if not curve:
            continue
        points = np.array(curve)
        k = -np.diff(points[:, 1]) / np.diff(points[:, 0])
        c = points[1:, 1] + k * points[1:, 0]
        tau = phase[f"tau_m[{motor.name}]"] / left
        v = phase[f"v_m[{motor.name}]"]
        rows = [s * tau + t * ca.DM(k) * v for s in (1, -1) for t in (1, -1)]
        phase.subject_to(
            ca.vertcat(*rows), -np.inf, np.tile(c, 4), name=f"torque of {motor.name} at its speed"
        )


def _bound_rates(phase: Phase, rate: np.ndarray, given: bool) -> None:
    """Rates of the torques, at most ``rate`` (n_m,) [N m/s], at both ends of each interval.

    Torques are polynomials on an interval, and continuous then. ``given``: by the user;
    ArgumentError where there are several phases, between which torques jump.
    """
    if phase.number and given:
        raise ArgumentError(
            "then: given in a problem with torque_rate, expected one phase: between two the "
            "torque jumps"
        )
    mesh = phase.mesh
    finite = np.isfinite(rate)
    phase.continuous_torque()
    powers = np.linalg.inv(np.vander(mesh.table.c, increasing=True))  # of the Lagrange polynomials
    slopes = (
        np.array([[k * theta ** max(k - 1, 0) for k in range(mesh.s)] for theta in (0.0, 1.0)])
        @ powers
    )
    D = np.zeros((mesh.N * mesh.s, 2 * mesh.N))
    for n in range(mesh.N):
        D[n * mesh.s : (n + 1) * mesh.s, 2 * n : 2 * n + 2] = slopes.T / mesh.h[n]
    tau = phase.nodes("tau_m")[np.flatnonzero(finite).tolist(), :]
    change = ca.vec(ca.mtimes(tau, ca.sparsify(ca.DM(D))))
    time = phase.nodes("time")
    most = (time[-1] - time[0]) * ca.DM(np.tile(rate[finite], 2 * mesh.N))
    for sign in (1, -1):
        phase.subject_to(sign * change - most, -np.inf, 0.0, name="rate of the torque")


def _bound_gears(phase: Phase, most: np.ndarray) -> None:
    """Torques of the gears, at most ``most`` (n_g,) on the arm side [N m, N]; ArgumentError for a
    rigid one whose motor turns with other bodies.
    """
    equations = phase.equations
    model = phase.equations.model
    names = [model.coordinates[i].name for i in model.i_g]
    rigid = [gear.rigid for gear, _ in gears(model)]
    elastic = equations.function("gear_torque")(
        phase["q_a"], phase["v_a"], phase["q_m"], phase["v_m"]
    )
    for k in np.flatnonzero(np.isfinite(most)):
        value = elastic[int(k)]
        if rigid[k]:
            if obstacle(model, "simplified coupling") is not None:
                raise ArgumentError(
                    f"limits: given gear_torque of the rigid gear {names[k]}, expected tau_m "
                    "bounds"
                )
            inertia = ca.DM([motor.inertia for motor in model.motors])
            through = (
                phase["tau_m"]
                - inertia * phase["a_m"]
                - motor_frictions(equations, phase["v_m"], elastic)
            )
            value = ca.mtimes(ca.DM(model.eta[:, k]).T, through)
        phase.subject_to(value, -most[k], most[k], name=f"gear torque of {names[k]}")


def _bound_tool(phase: Phase, kept: Limits) -> None:
    """Squared speed and acceleration of the tool's origin over those of their bounds."""
    if kept.tool_speed is not None:
        phase.subject_to(
            ca.sumsqr(phase["tool_velocity"]) / kept.tool_speed**2,
            -np.inf,
            1.0,
            name="speed of the tool",
        )
    if kept.tool_acceleration is not None:
        q, v, a = (phase[name] for name in ("q_a", "v_a", "a_a"))
        J = phase.equations.function("jacobian")(q)
        dJ = phase.equations.function("jacobian_dot")(q, v)
        x = (ca.mtimes(J, a) + ca.mtimes(dJ, v))[:3]
        phase.subject_to(
            ca.sumsqr(x) / kept.tool_acceleration**2, -np.inf, 1.0, name="acceleration of the tool"
        )
