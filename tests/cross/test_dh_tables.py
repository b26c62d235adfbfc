"""Model files from drawn DH tables against textbook matrices and Pinocchio."""

from __future__ import annotations

import dh_tables
import numpy as np
import pytest

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.studies.templates.dh_model import model_from_dh

TOLERANCE = 1e-12  # relative to the largest entry, of chains of at most seven joints
CONVENTIONS = ("standard", "modified")
POSES = 5


@pytest.fixture
def made(tmp_path):
    """The equations of the model file of some joints."""

    def call(joints, convention, seed):
        table = tmp_path / "arm.csv"
        file = tmp_path / "arm.toml"
        dh_tables.write(table, joints, np.random.default_rng(seed))
        file.write_text(model_from_dh("arm", table, convention).text)
        return derive(flexgen.read(file))

    return call


def poses(joints, seed):
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (POSES, len(joints)))


def distance(value, expected):
    return np.abs(value - expected).max() / max(1.0, np.abs(expected).max())


def compare(equations, joints, convention, seed):
    """Largest relative difference of tool frame and inertia matrix to the textbook matrices."""
    worst = 0.0
    for q in poses(joints, seed):
        p, R = evaluate(equations.function("forward_kinematics"), q)
        M = evaluate(equations.function("mass_matrix"), q)[0].reshape(len(q), -1)
        T = dh_tables.frames(joints, convention, q)[-1]
        worst = max(
            worst,
            distance(p[0], T[:3, 3]),
            distance(R[0], T[:3, :3]),
            distance(M, dh_tables.mass_matrix(joints, convention, q)),
        )
    return worst


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("seed", range(4))
def test_kinematics_and_inertia_are_those_of_textbook_matrices(made, convention, seed):
    joints = dh_tables.draw(seed, 3 + seed)
    assert compare(made(joints, convention, seed), joints, convention, seed) < TOLERANCE


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_kinematics_inertia_and_gravity_are_those_of_pinocchio(made, convention):
    pin = pytest.importorskip("pinocchio")
    joints = dh_tables.draw(11, 6)
    equations = made(joints, convention, 11)
    model = dh_tables.pinocchio_model(joints, convention)
    data = model.createData()
    for q in poses(joints, 11):
        p, R = evaluate(equations.function("forward_kinematics"), q)
        M = evaluate(equations.function("mass_matrix"), q)[0].reshape(6, 6)
        g = evaluate(equations.function("gravity"), q)[0].ravel()
        upper = np.triu(pin.crba(model, data, q))
        pin.framesForwardKinematics(model, data, q)
        flange = data.oMf[model.getFrameId("flange")]
        assert distance(p[0], flange.translation) < TOLERANCE
        assert distance(R[0], flange.rotation) < TOLERANCE
        assert distance(M, upper + np.triu(upper, 1).T) < TOLERANCE
        assert distance(g, pin.computeGeneralizedGravity(model, data, q)) < TOLERANCE


def test_planted_exchange_of_the_conventions_is_seen(made):
    joints = dh_tables.draw(3, 5)
    equations = made(joints, "standard", 3)
    assert compare(equations, joints, "modified", 3) > 1e-3


def test_planted_sign_of_alpha_is_seen(made):
    joints = dh_tables.draw(3, 5)
    wrong = [dh_tables.Joint(**{**vars(joint), "alpha": -joint.alpha}) for joint in joints]
    assert compare(made(wrong, "standard", 3), joints, "standard", 3) > 1e-3


def test_the_urdf_export_of_the_written_file_has_its_equations(made, tmp_path):
    """Placements, axes, gears and motors go through a second format and back."""
    joints = dh_tables.draw(5, 6)
    equations = made(joints, "modified", 5)
    exported = flexgen.export_urdf(equations.model, tmp_path / "again.urdf")
    again = flexgen.read(exported.details["overlay"])
    one, other = (
        evaluate(
            derive(robot).function("inverse_dynamics"), *(poses(joints, k)[0] for k in (1, 2, 3))
        )[0]
        for robot in (equations.model, again)
    )
    assert distance(other, one) < TOLERANCE
    assert again.eta == pytest.approx(equations.model.eta)
