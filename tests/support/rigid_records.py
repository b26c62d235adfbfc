"""Records of the rigid elbow by its inverse dynamics, and of the elbow with soft gears by the
exact inverse of elastic gears.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import flexgen
from flexgen.identification.rigid.rigid_regressor import Motion
from flexgen.model.elements import RobotModel

H = 4e-3
N = 2500  # samples of a period of 10 s
STIFFNESS = np.array([6e5, 4e5])  # N m/rad: deflections of 5 mrad
DAMPING = np.array([300.0, 150.0])  # N m s/rad
VISCOUS = np.array([0.02, 0.03])
COULOMB = np.array([0.5, 0.8])
OFFSET = np.array([0.1, -0.2])


def swung(model: RobotModel, count: int = 600) -> Motion:
    t = H * np.arange(count)
    q = np.stack([0.9 * np.sin(3.1 * t + 0.3), 0.7 * np.cos(4.3 * t)], axis=1)
    v = np.stack([0.9 * 3.1 * np.cos(3.1 * t + 0.3), -0.7 * 4.3 * np.sin(4.3 * t)], axis=1)
    a = -(np.array([3.1, 4.3]) ** 2) * q
    e = flexgen.derive(model).function("inverse_dynamics").map(count)
    arm = np.array(e(q.T, v.T, a.T)).T
    inertia = np.array([m.inertia for m in model.motors])
    friction = (
        np.array([0.02, 0.03]) * (v @ model.eta.T)
        + np.array([0.5, 0.8]) * np.tanh(v / 5e-4)
        + np.array([0.1, -0.2])
    )
    return Motion(t, q, arm @ np.linalg.inv(model.eta) + inertia * (a @ model.eta.T) + friction)


def described(folder: Path, name: str, motion: Motion, model: RobotModel) -> Path:
    """A description of the recorded angles and torques of both motors."""
    q_m = motion.q @ model.eta.T
    columns = {"t": motion.t, "u1": motion.tau_m[:, 0], "u2": motion.tau_m[:, 1]}
    np.savez(folder / f"{name}.npz", **columns, q1=q_m[:, 0], q2=q_m[:, 1])
    text = 'model = "elbow@rigid"\nhold = "zoh"\n[time]\nname = "t"\nunit = "s"\n'
    for k in (1, 2):
        for kind, column, unit in (("torque", f"u{k}", "N m"), ("angle", f"q{k}", "rad")):
            text += f'[[{kind}]]\nmotor = "m{k}"\nname = "{column}"\nunit = "{unit}"\n'
            text += 'side = "motor"\n'
    (folder / f"{name}.toml").write_text(f'{text}[[recording]]\nfile = "{name}.npz"\n')
    return folder / f"{name}.toml"


def soft(stiffness: np.ndarray = STIFFNESS) -> RobotModel:
    names = {}
    damping = DAMPING if stiffness is STIFFNESS else 0.01 * DAMPING
    for place, k, d in zip(("upper.dof.q1", "fore.dof.q2"), stiffness, damping, strict=True):
        names |= {f"element.{place}.gear.spring.stiffness": k, f"element.{place}.gear.damping": d}
    return flexgen.read("elbow", overrides=names)


def derivative(x: np.ndarray, order: int) -> np.ndarray:
    """Of one period (n, ...), by its Fourier series."""
    w = 2j * np.pi * np.fft.rfftfreq(len(x), H)[:, None]
    return np.fft.irfft(np.fft.rfft(x, axis=0) * w**order, len(x), axis=0)


def recorded(
    late: float = 0.0, noise: float = 0.0, seed: int = 0, damping: np.ndarray = DAMPING
) -> Motion:
    """A periodic motion of the links; motors ahead of them by the deflections of springs and
    dampers.
    """
    model = flexgen.read("elbow@rigid")
    rng = np.random.default_rng(seed)
    t = H * np.arange(N)
    lines = np.array([2, 5, 9, 14])
    size = rng.uniform(0.1, 0.4, (2, 4)) / np.sqrt(lines)
    phase = rng.uniform(0, 6, (2, 4))
    angle = 2 * np.pi * lines * t[:, None, None] / (N * H) + phase
    q = (size * np.sin(angle)).sum(axis=2)
    e = flexgen.derive(model).function("inverse_dynamics").map(N)
    arm = np.array(e(q.T, derivative(q, 1).T, derivative(q, 2).T)).T
    w = 2j * np.pi * np.fft.rfftfreq(N, H)[:, None]
    motors = q + np.fft.irfft(np.fft.rfft(arm, axis=0) / (STIFFNESS + w * damping), N, axis=0)
    v = derivative(motors, 1) @ model.eta.T
    a = derivative(motors, 2) @ model.eta.T
    tau = arm @ np.linalg.inv(model.eta) + np.array([m.inertia for m in model.motors]) * a
    tau += VISCOUS * v + COULOMB * np.tanh(v / np.abs(np.diag(model.eta)) / 5e-4) + OFFSET
    shifted = np.fft.irfft(np.fft.rfft(tau, axis=0) * np.exp(-w * late), N, axis=0)
    return Motion(t, motors, shifted + noise * rng.standard_normal(tau.shape))
