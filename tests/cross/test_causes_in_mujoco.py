"""Faults of a record and a spring below the base are named where MuJoCo's mass matrix is the
robot.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, without_coulomb

import flexgen
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.causes import explain as causes
from flexgen.identification.causes.hypotheses import transform
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import FitStatus
from flexgen.identification.rigid.missing_springs import base_springs
from flexgen.model.elements import RobotModel

pytest.importorskip("mujoco")
from mujoco_referee import MujocoReferee

W = 2 * np.pi * np.geomspace(1.0, 120.0, 25)
POSES = 3


def robot(name: str) -> RobotModel:
    """A model without gravity and Coulomb friction."""
    return replace(without_coulomb(name), gravity=(0.0, 0.0, 0.0))


def linear(model: RobotModel, pose: np.ndarray) -> np.ndarray:
    """Motor accelerations over motor torques (lines, n_m, n_m) at a pose of the joints, from
    MuJoCo's mass matrix and springs, dampers and frictions that are written here.
    """
    n = len(model.coordinates)
    size = n + model.n_m
    D = np.zeros((size, size))
    K = np.zeros((size, size))
    q = np.zeros(n)
    q[list(model.i_g)] = pose
    names = [c.name for c in model.coordinates]
    dofs = {dof.name: dof for element in model.elements for dof in element.dofs}
    for j, motor in enumerate(model.motors):
        at = names.index(motor.drives[0])
        gear = dofs[motor.drives[0]].gear
        row = np.zeros(size)
        row[at] = -1.0
        row[n + j] = 1.0 / motor.ratio[0]
        K += gear.spring.stiffness * np.outer(row, row)
        D += gear.damping * np.outer(row, row)
        D[n + j, n + j] += motor.friction.viscous
    for at, name in enumerate(names):
        if dofs[name].gear is None:
            K[at, at] += dofs[name].spring.stiffness
            D[at, at] += dofs[name].damping
    M = MujocoReferee(model).mass_matrix(np.concatenate([q, model.eta @ pose]))
    s = 1j * W[:, None, None]
    return (s**2 * np.linalg.inv(s**2 * M + s * D + K))[:, n:, n:]


def measured(model: RobotModel, plant: RobotModel) -> Frf:
    """Responses of a plant with noise of 0.1 %, in the record of a model."""
    poses = poses_of(model, POSES)
    data = exact_responses(model, poses, W, Drive(0.0))
    G = np.array([linear(plant, pose) for pose in poses])
    sd = 1e-3 * np.abs(G)
    noise = np.random.default_rng(1).standard_normal((2, *G.shape)) / np.sqrt(2)
    G = G + sd * (noise[0] + 1j * noise[1])
    variance = np.maximum(sd, 1e-9 * np.abs(G).max()) ** 2
    C = np.eye(model.n_m) * variance.max(axis=-1)[..., None, :].swapaxes(-1, -2)
    return replace(data, G=G, variance=variance, C=C)


def named(model: RobotModel, data: Frf) -> tuple[FitStatus, list[str]]:
    """Status and words of the causes of a fit of the springs and dampers of the gears."""
    found = flexgen.identify(model, data, free=["stiffness", "damping"], starts=1, progress=False)
    return found.status, [cause.words for cause in found.causes]


def on_pedestal(model: RobotModel, axis: str) -> RobotModel:
    """The robot on a pedestal of 40 kg m^2 and 2e6 N m/rad."""
    plant = dict((dof.name, made) for dof, made in base_springs(model))[f"base_{axis}"]
    numbers = {"stiffness": 2e6, "damping": 2e3}
    values = {f"base_{axis}.{key}": value for key, value in numbers.items()}
    return with_values(plant, values | {f"pedestal.inertia_{2 * axis}": 40.0})


@pytest.mark.parametrize(("name", "axis"), [("planar5_nmp", "z"), ("elbow", "y")])
def test_a_spring_below_the_base_is_named(name, axis):
    model = robot(name)
    status, words = named(model, measured(model, on_pedestal(model, axis)))
    assert status is FitStatus.MODEL_ERROR
    assert words == [f"a spring below the base about its axis {axis} of 2e+06 N m/rad"]


def test_a_right_record_has_no_cause():
    for name in ("planar5_nmp", "elbow"):
        model = robot(name)
        assert named(model, measured(model, model)) == (FitStatus.FITTED, [])


@pytest.mark.parametrize(
    ("angles", "torques", "words"),
    [
        ((1.0, 1.0), (1 / 1.05, 1 / 1.05), "torques of all motors 5 % too large in the record"),
        ((-1.0, 1.0), (-1.0, 1.0), "the signs of angle and torque of m1 or of m2"),
    ],
)
def test_scale_of_all_torques_and_signs_of_an_axis_are_named(angles, torques, words):
    model = robot("planar5_nmp")
    data = transform(measured(model, model), np.diag(angles), np.diag(torques))
    status, found = named(model, data)
    assert status is not FitStatus.FITTED and words in found


def test_a_planted_pedestal_without_inertia_is_not_found(monkeypatch):
    """The inertia of the pedestal is fitted, too: with that of the guess the spring is another."""
    model = robot("planar5_nmp")
    data = measured(model, on_pedestal(model, "z"))
    right = causes.springs_of
    monkeypatch.setattr(
        causes, "springs_of", lambda model: [(dof, made, "") for dof, made, _ in right(model)]
    )
    words = named(model, data)[1]
    assert "a spring below the base about its axis z of 2e+06 N m/rad" not in words
