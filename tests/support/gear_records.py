"""Records of motor angles and torques of robots in MuJoCo that follow sums of sines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hysteretic import Plant, feedback_gains

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.exports.mujoco.mujoco_checks import with_friction

# factor of the feedback's stiffness, twice that of its damping: the natural frequency is doubled
FIRM = 4.0
START_S = 2.0  # in which the motion begins


def record_in_mujoco(
    name: str,
    made: Callable[[np.ndarray], tuple[Any, Any]],
    seconds: float,
    *,
    size: float = 0.25,
    fastest: float = 2.0,
    lines: int = 12,
    seed: int = 1,
    step: float = 2e-4,
    sample: float = 1e-3,
    noise: float = 0.0,
) -> Trajectory:
    """Angles and torques about the home of a model; ``made(deflections at rest)``: law and kept of
    `Plant`.

    Each joint follows ``lines`` sines up to ``fastest`` Hz, ``size`` [rad]: of their sum, about.
    ``noise`` [rad]: of the angles that the feedback and the record have, white, held from sample
    to sample.
    """
    model = with_friction(flexgen.read(name), "viscous")
    rest = hold_joints(flexgen.derive(model), np.array(model.home))
    frequencies = np.geomspace(0.1, fastest, lines)
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (lines, model.n_g))
    amplitudes = size / np.sqrt(lines) / (1 + frequencies / 0.7)

    # also in the middle of a step, for Runge and Kutta
    t = step / 2 * np.arange(2 * round(seconds / step) + 3)
    part = np.minimum(t / START_S, 1.0)[:, None]
    grown = part**3 * (10 - 15 * part + 6 * part**2)
    rate = 30 * (part * (1 - part)) ** 2 / START_S
    s, ds = (np.zeros((len(t), model.n_g)) for _ in range(2))
    for f, phase, a in zip(frequencies, phases, amplitudes, strict=True):
        s += a * np.sin(2 * np.pi * f * t[:, None] + phase)
        ds += a * 2 * np.pi * f * np.cos(2 * np.pi * f * t[:, None] + phase)
    r = rest.q_m + (grown * s) @ model.eta.T
    dr = (rate * s + grown * ds) @ model.eta.T

    of_angles = noise * np.random.default_rng(seed + 50).normal(
        size=(round(seconds / sample) + 2, model.n_m)
    )
    of_speeds = np.diff(of_angles, axis=0, prepend=0.0) / sample

    def torque(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        k = round(2 * t / step)
        n = int(t / sample + 1e-6)
        return (
            rest.tau_m
            + stiffness * (r[k] - q - of_angles[n])
            + damping * (dr[k] - v - of_speeds[n])
        )

    k_p, k_v = feedback_gains(model)
    stiffness = FIRM * k_p
    damping = np.sqrt(FIRM) * k_v
    law, kept = made(np.linalg.inv(model.eta) @ rest.q_m - rest.q_a[list(model.i_g)])
    plant = Plant(name, law, kept, torque, step)
    rows = []
    every = round(sample / step)

    def look(k: int) -> None:
        if (k + 1) % every == 0:
            q = plant.d.qpos[plant.rotors].copy()
            v = plant.d.qvel[plant.rotors].copy()
            rows.append(np.concatenate([q + of_angles[len(rows) + 1], torque(plant.d.time, q, v)]))

    plant.run(0.0, np.concatenate([rest.q_a, rest.q_m]), round(seconds / step), look)
    table = np.array(rows)
    return motor_record(
        model, sample * (1 + np.arange(len(table))), table[:, : model.n_m], table[:, model.n_m :]
    )


def motor_record(
    model: flexgen.RobotModel, time: np.ndarray, q_m: np.ndarray, tau_m: np.ndarray
) -> Trajectory:
    """A record as a trajectory."""
    names = tuple(motor.name for motor in model.motors)
    n = model.n_m
    ports = {
        "q_m": Port("q_m", (n,), "rad", "angles"),
        "tau_m": Port("tau_m", (n,), "N m", "torques"),
    }
    return Trajectory(time, {"q_m": q_m, "tau_m": tau_m}, ports, {"q_m": names, "tau_m": names})


def with_noise(record: Trajectory, sd: float, seed: int = 0) -> Trajectory:
    """The record with white noise [rad] on its angles."""
    noise = sd * np.random.default_rng(seed).normal(size=record["q_m"].shape)
    changed = {**record.channels, "q_m": record["q_m"] + noise}
    return Trajectory(record.time, changed, record.ports, record.labels)
