"""Robots, plans and experiments that the tests of identification share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.model.elements import RobotModel

NOISY = DriveHardware(5e-4, encoder_noise_rad=1e-4, torque_noise_Nm=0.02)


def without_coulomb(name: str) -> RobotModel:
    """The model with viscous friction only: its frequency responses do not depend on the
    amplitude.
    """
    model = flexgen.read(name)
    motors = (
        replace(m, friction=replace(m.friction, coulomb=0.0, stribeck=0.0)) for m in model.motors
    )
    return replace(model, motors=tuple(motors))


def another(model: RobotModel, seed: int, spread: float = 0.3) -> RobotModel:
    """The robot with other springs and dampers: factors up to ``exp(spread)``."""
    rng = np.random.default_rng(seed)
    values = {
        p.name: p.value * np.exp(rng.uniform(-spread, spread))
        for p in select(model, ["stiffness", "damping"])
    }
    return with_values(model, values)


def poses_of(model: RobotModel, count: int, seed: int = 0, spread: float = 0.4) -> np.ndarray:
    """Joint positions (count, n_g) about home."""
    home = np.array(model.home)
    return home + np.random.default_rng(seed).uniform(-spread, spread, (count, len(home)))


def exact_responses(
    model: RobotModel, poses: np.ndarray, w: np.ndarray, drive: Drive, relative_sd: float = 1e-3
) -> Frf:
    """Frequency responses of the linear model itself, as data: without noise, weights of equal
    relative size.
    """
    local = LocalModel(model, ())
    q_m = poses @ model.eta.T
    G = local.response(local.values, q_m, w, drive, derivatives=False).G
    n = model.n_m
    variance = (relative_sd * np.abs(G)) ** 2
    eye = np.broadcast_to(np.eye(n, dtype=complex), G.shape)
    C = eye * variance.max(axis=-1)[..., None, :].swapaxes(-1, -2)
    motors = tuple(m.name for m in model.motors)
    return Frf(
        model.name,
        motors,
        q_m,
        w,
        G,
        eye.copy(),
        C,
        variance,
        None,
        1,
        n,
        drive.sample_s,
        drive.delay_s,
        np.zeros((len(poses), n)),
    )


def small_plan(model: RobotModel, poses: np.ndarray, **changes: object) -> Plan:
    """A short experiment."""
    arguments: dict[str, object] = {
        "poses": poses,
        "lines": 30,
        "period_s": 2.0,
        "periods": 2,
        "speed_rms": 0.02,
    }
    return flexgen.excite(model, **{**arguments, "progress": False, **changes})


def noisy_responses() -> Frf:
    """Responses of two poses and four lines with covariances that are all different."""
    model = without_coulomb("planar5_nmp")
    w = 2 * np.pi * np.array([3.0, 8.0, 21.0, 55.0])
    made = exact_responses(model, poses_of(model, 2), w, Drive(1e-3, 1e-3), 1e-2)
    rng = np.random.default_rng(2)
    root, other = (rng.normal(size=(2, 4, 2, n, 2)) @ [1, 1j] for n in (2, 3))
    C = root @ root.conj().swapaxes(-1, -2) * np.abs(made.G).mean() ** 2 * 1e-4
    UU = other @ other.conj().swapaxes(-1, -2)
    by_input = np.einsum("klbb->klb", np.linalg.inv(UU).real / 5)
    variance = np.einsum("klaa->kla", C).real[..., :, None] * by_input[..., None, :]
    return replace(made, C=C, UU=UU, variance=variance, periods=5, experiments=3)
