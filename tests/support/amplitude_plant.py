"""A robot in the time domain with gears and frictions that its model lacks: an integrator of its
own.

The equations of the linear robot come from the model; the torque of each gear, as a function of
its deflection, and the friction of each motor are added here. Classical Runge-Kutta steps, a drive
with speed and position control, torques held between samples, white noise on the angles. Nothing
is taken from the code that judges the measurement.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import casadi as ca
import numpy as np
from toolchain import CC

from flexgen.analysis.second_order import motor_rows
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.responses.local_model import LocalModel
from flexgen.model.elements import RobotModel

STEPS = 4  # in a sample


@dataclass(frozen=True)
class Law:
    """Torques in addition to the linear ones: of gears, arm side, and of motors.

    ``gear(j, d, dd, z)``: torque and derivative of the state z of gear j; ``motor(j, w)``:
    friction of motor j.
    """

    gear: Callable[[int, ca.SX, ca.SX, ca.SX], tuple[ca.SX, ca.SX]] = field(
        default=lambda j, d, dd, z: (0 * d, 0 * z)
    )
    motor: Callable[[int, ca.SX], ca.SX] = field(default=lambda j, w: 0 * w)


def backlash(stiffness: np.ndarray, gap: np.ndarray) -> Law:
    """A dead band of half width ``gap``: what the gear of this stiffness lacks inside of it."""
    return Law(
        gear=lambda j, d, dd, z: (-stiffness[j] * ca.fmax(ca.fmin(d, gap[j]), -gap[j]), 0 * z)
    )


def cubic(coefficient: np.ndarray) -> Law:
    return Law(gear=lambda j, d, dd, z: (coefficient[j] * d**3, 0 * z))


def hysteresis(stiffness: np.ndarray, largest: np.ndarray) -> Law:
    """Bouc-Wen: ``z' = k d' (1 - (1 + sgn(z d')) z^2 / (2 h^2))``, between -h and h, in parallel
    with the spring.
    """

    def gear(j: int, d: ca.SX, dd: ca.SX, z: ca.SX) -> tuple[ca.SX, ca.SX]:
        return z, stiffness[j] * dd * (1 - (1 + ca.sign(z * dd)) / 2 * (z / largest[j]) ** 2)

    return Law(gear=gear)


def coulomb(torque: np.ndarray, width: float = 0.05) -> Law:
    """Coulomb friction of the motors [N m]; ``width`` [rad/s]: of its step."""
    return Law(motor=lambda j, w: torque[j] * ca.tanh(w / width))


def simulate(
    plan: Plan, robot: RobotModel, law: Law, noise_rad: float = 1e-4, seed: int = 0, late: int = 0
) -> Experiment:
    """The experiment of a plan on this robot: spectra of torques and angles at the lines.

    ``late``: samples by which the recorded torques are earlier than those that act.
    """
    period = _period(plan, robot, law)
    local = LocalModel(robot, ())
    rest = local.rest(local.values, plan.poses)
    rng = np.random.default_rng(seed)
    n = robot.dof
    m = robot.n_m
    N = plan.samples
    t = np.arange(N) * plan.hardware.sample_s
    runs = [
        (k, r, e)
        for k in range(len(plan.poses))
        for r in range(plan.realizations)
        for e in range(m)
    ]
    shape = (len(plan.poses), plan.realizations, m, plan.periods, len(plan.lines), m)
    tau_m = np.empty(shape, complex)
    q_m = np.empty(shape, complex)
    w = 2j * np.pi * np.fft.rfftfreq(N, plan.hardware.sample_s)[:, None]
    basis = np.exp(-2j * np.pi * plan.frequencies[:, None] * t) * 2 / N
    for k, r, e in runs:
        q = plan.reference(r, e)
        v = np.fft.irfft(w * np.fft.rfft(q, axis=0), N, axis=0)
        start = np.concatenate([rest.y[k], np.zeros(n + m), np.zeros(m)])
        fixed = np.concatenate([plan.poses[k], rest.tau_m[k]])
        for p in range(-max(plan.transients, 1), plan.periods):
            ramp = np.linspace(0, 1, N)[:, None] if p == -max(plan.transients, 1) else 1.0
            error = noise_rad * rng.standard_normal((N, m))
            inputs = np.hstack([ramp * q, ramp * v, error, np.tile(fixed, (N, 1))]).T
            states, out = (np.asarray(x) for x in period(start, inputs))
            start = states[:, -1]
            if p >= 0:
                tau_m[k, r, e, p] = basis @ np.roll(out[:m], -late, axis=1).T
                q_m[k, r, e, p] = basis @ out[m:].T
    speed = np.sqrt((np.abs(w_of(plan) * q_m) ** 2).sum(axis=-2).mean(axis=(1, 2, 3)) / 2)
    return Experiment(
        plan, tau_m, q_m, speed, np.zeros(len(plan.poses), np.int64), f"simulation of {robot.name}"
    )


def w_of(plan: Plan) -> np.ndarray:
    return 2 * np.pi * plan.frequencies[:, None]


def at_level(plan: Plan, factor: float) -> Plan:
    """The plan with amplitudes that are larger by a factor."""
    return replace(plan, amplitudes=factor * plan.amplitudes)


def _period(plan: Plan, robot: RobotModel, law: Law) -> ca.Function:
    """(state, inputs of all samples) -> states after each sample; torques and angles at its
    beginning.

    State: y, dy, states of the gears, integrals of the speed errors.
    """
    equations = Equations(robot)
    n = robot.dof
    m = robot.n_m
    y, dy, ddy = equations.y
    tau = equations.lagrangian.tau_m
    z = ca.SX.sym("z", m)
    C = motor_rows(robot)
    theta = np.linalg.inv(robot.eta) @ C
    extra = ca.SX.zeros(n)
    rates = []
    for j, i in enumerate(robot.i_g):
        row = theta[j].copy()
        row[i] -= 1.0
        torque, rate = law.gear(j, ca.mtimes(ca.DM(row).T, y), ca.mtimes(ca.DM(row).T, dy), z[j])
        extra += ca.SX(ca.DM(row)) * torque
        rates.append(rate)
    for j in range(m):
        extra += ca.SX(ca.DM(C[j])) * law.motor(j, ca.mtimes(ca.DM(C[j]).T, dy))
    M = ca.jacobian(equations.residual, ddy)
    bias = ca.substitute(equations.residual, ddy, ca.SX.zeros(n)) + extra
    f = ca.Function("f", [ca.vertcat(y, dy, z), tau], [ca.vertcat(dy, -ca.solve(M, bias), *rates)])
    x = ca.SX.sym("x", 2 * n + m)
    s = ca.SX.sym("s", m)
    inputs = ca.SX.sym("u", 5 * m)
    q_ref, v_ref, noise, pose, hold = ca.vertsplit(inputs, m)
    law_ = plan.controller
    angle = ca.mtimes(ca.DM(C), x[:n])
    w = (
        v_ref
        + ca.DM(law_.position_gain) * (pose + q_ref - angle - noise)
        - ca.mtimes(ca.DM(C), x[n : 2 * n])
    )
    u = hold + ca.DM(law_.speed_gain) * (w + ca.DM(law_.integral_gain) * s)
    h = plan.hardware.sample_s / STEPS
    held = ca.SX.sym("held", m)
    now = ca.SX.sym("now", 2 * n + m)
    a = f(now, held)
    b = f(now + h / 2 * a, held)
    c = f(now + h / 2 * b, held)
    d = f(now + h * c, held)
    step = ca.Function("step", [now, held], [now + h / 6 * (a + 2 * b + 2 * c + d)])
    after = x
    for _ in range(STEPS):
        after = step(after, u)
    state = ca.vertcat(x, s)
    after = ca.vertcat(after, s + plan.hardware.sample_s * w)
    one = ca.Function("sample", [state, inputs], [after, ca.vertcat(u, angle + noise)])
    return _compiled(one).mapaccum("period", plan.samples)


def _compiled(function: ca.Function) -> ca.Function:
    """The function in C, where there is a compiler: CasADi's interpreter takes eight times as
    long.
    """
    if CC is None:
        return function
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "one.so")
        Path(folder, "one.c").write_text(_text(function), encoding="ascii")
        subprocess.run(
            [CC, "-O1", "-shared", "-fPIC", "one.c", "-lm", "-o", library], cwd=folder, check=True
        )
        return ca.external(function.name(), str(library))  # stays loaded


def _text(function: ca.Function) -> str:
    code = ca.CodeGenerator("one.c")
    code.add(function)
    return str(code.dump())
