"""Which springs a robot needs: those that are missing are found, those that are not there are not
added.
"""

from __future__ import annotations

import numpy as np
import pytest
from identification_cases import NOISY, another, poses_of, small_plan, without_coulomb
from toolchain import needs_compiler

import flexgen
from flexgen.cli.main import main
from flexgen.identification.responses.structure import structure
from flexgen.identification.rigid.missing_springs import (
    additions,
    perpendicular,
    without,
)
from flexgen.model.elements import RobotModel

pytestmark = needs_compiler


def measured(
    truth: RobotModel, model: RobotModel, seed: int = 0, **changes: object
) -> flexgen.Frf:
    """Frequency responses of a robot in the experiment that is planned for a model."""
    plan = small_plan(
        model, poses_of(model, 6, spread=0.6), hardware=NOISY, period_s=4.0, periods=4, **changes
    )
    return flexgen.frf(flexgen.measure(plan, truth, seed=seed, progress=False))


@pytest.mark.slow
def test_no_spring_is_added_to_a_complete_model_and_none_is_removed():
    model = without_coulomb("planar5_nmp")
    found = structure(model, measured(another(model, 1), model), progress=False)
    assert found.added == () and found.removed == ()
    assert {change.kind for change in found.changes} == {"add", "remove"}
    assert all(change.gain < 0 for change in found.changes)


@pytest.mark.full
def test_the_missing_torsion_of_a_body_is_found(capsys, tmp_path):
    """manutec_r3_18 without the torsion of body 5 about y."""
    model = without_coulomb("manutec_r3_18")
    start = without(model, "t5y")
    data = measured(another(model, 2, 0.2), model, lines=30, f_min=1.25, f_max=110.0)
    found = structure(start, data, progress=False)
    assert len(found.added) == 1 and found.removed == ()
    new = next(dof for e in found.model.elements for dof in e.dofs if dof.name in found.added)
    element = next(e.name for e in found.model.elements if new in e.dofs)
    assert element == "body5" and np.abs(new.axis).tolist() == [0.0, 1.0, 0.0]
    true = next(
        dof for e in another(model, 2, 0.2).elements for dof in e.dofs if dof.name == "t5y"
    )
    assert new.spring.stiffness == pytest.approx(true.spring.stiffness, rel=5e-3)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(20))
def test_random_robots_get_no_spring_that_is_not_there(seed):
    model = without_coulomb("manutec_r3_18")
    data = measured(another(model, 10 + seed, 0.2), model, seed, lines=30, f_min=1.25, f_max=110.0)
    assert structure(model, data, progress=False).added == ()


def test_candidates_are_perpendicular_and_new():
    model = flexgen.read("manutec_r3_18")
    names = [dof.name for dof, _ in additions(model)]
    assert "q5_u" not in names or "q5_v" not in names  # one of them is there: t5y
    for _, changed in additions(model):
        assert changed.n_e == model.n_e + 1
    for axis in (np.array([0, 0, 1.0]), np.array([0.6, 0.8, 0.0])):
        u, v = perpendicular(axis)
        assert np.allclose([u @ axis, v @ axis, u @ v, u @ u, v @ v], [0, 0, 0, 1, 1])


@pytest.mark.slow
def test_the_command_line_prints_changes(tmp_path, capsys):
    model = without_coulomb("planar5_nmp")
    measured(model, model).save(tmp_path / "frf.npz")
    assert main(["identify", "planar5_nmp", str(tmp_path / "frf.npz"), "--structure", "-q"]) == 0
    printed = capsys.readouterr().out
    assert "added nothing, removed nothing" in printed and "gain of the criterion" in printed
    assert (
        main(
            [
                "identify",
                "planar5_nmp",
                str(tmp_path / "frf.npz"),
                "--structure",
                "--out",
                str(tmp_path / "x.toml"),
            ]
        )
        == 0
    )
    assert "wrote" in capsys.readouterr().out
    assert flexgen.read(tmp_path / "x.toml").name == "planar5_nmp"
