"""Causes of a misfit: a fault that is planted is named, with its size; a model that fits has
none.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, without_coulomb

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.causes import explain as causes
from flexgen.identification.causes import hypotheses
from flexgen.identification.causes.hypotheses import masses_of, transform, with_sample_time
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import FitStatus
from flexgen.identification.rigid.missing_springs import additions, without

W = 2 * np.pi * np.geomspace(1.0, 120.0, 25)
DRIVE = Drive(5e-4)
ROBOT = without_coulomb("planar5_nmp")
TRUTH = with_values(ROBOT, {"q1.stiffness": 3.6e5, "q2.damping": 300.0, "q3.stiffness": 1.3e5})


def times(factor, names):
    return with_values(TRUTH, {p.name: factor * p.value for p in select(TRUTH, names)})


def measured(truth=TRUTH, drive=DRIVE):
    """Responses with a noise of 0.1 %."""
    data = exact_responses(truth, poses_of(ROBOT, 3), W, drive)
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((2, *data.G.shape)) / np.sqrt(2)
    return replace(data, G=data.G + np.sqrt(data.variance) * (noise[0] + 1j * noise[1]))


def on_channels(angles=(1.0, 1.0), torques=(1.0, 1.0)):
    return transform(measured(), np.diag(angles), np.diag(torques))


FAULTS = {
    "mass of arm3 20 % larger": lambda: measured(times(1.2, ["arm3.mass"])),
    "mass of arm3 150 % larger": lambda: measured(times(2.5, ["arm3.mass"])),
    "a missing payload of 2 kg": lambda: measured(with_values(TRUTH, {"payload.mass": 2.0})),
    "all masses 5 % larger": lambda: measured(times(1.05, masses_of(TRUTH))),
    "rotor inertia of m1 10 % smaller": lambda: measured(times(0.9, ["m1.inertia"])),
    "torques that act 0.3 ms later than stated": lambda: measured(drive=Drive(5e-4, 3e-4)),
    "torque of m1 5 % too large in the record": lambda: on_channels(torques=(1 / 1.05, 1.0)),
    "angle of m2 5 % too large in the record": lambda: on_channels(angles=(1.0, 1.05)),
    "sample time 1 % longer than stated": lambda: with_sample_time(measured(), 1 / 1.01),
    "the sign of the torque of m1": lambda: on_channels(torques=(-1.0, 1.0)),
    "the sign of the angle of m2": lambda: on_channels(angles=(1.0, -1.0)),
    "angles in degrees, read as radians,": lambda: on_channels(angles=(180 / np.pi, 180 / np.pi)),
    "exchanged torques of m1 and m2": lambda: transform(measured(), np.eye(2), np.eye(2)[::-1]),
    "exchanged angles of m1 and m2": lambda: transform(measured(), np.eye(2)[::-1], np.eye(2)),
}


def explained(data, model=ROBOT):
    return flexgen.identify(
        model, replace(data, delay_s=0.0), free=["stiffness", "damping"], starts=1, progress=False
    )


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_size(fault):
    """The other parameters are off too; the words state the size to two digits."""
    found = explained(FAULTS[fault]())
    assert found.status != FitStatus.FITTED
    assert found.causes[0].words == fault and found.causes[0].share > 0.99
    assert f"possible cause: {found.causes[0]}" in found.to_text()
    assert found.to_dict()["causes"][0]["words"] == fault


@pytest.mark.parametrize("late, words", [(-1.5e-4, "earlier"), (1.5e-4, "later")])
def test_a_delay_is_told_relative_to_the_stated_one(
    late: float, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The record states 0.4 ms. Planted: a fit that begins at none, and tells the whole delay."""
    stated = 4e-4
    data = replace(measured(drive=Drive(5e-4, stated + late)), delay_s=stated)

    def first() -> str:
        found = flexgen.identify(
            ROBOT, data, free=["stiffness", "damping"], starts=1, progress=False
        )
        assert found.status != FitStatus.FITTED
        return found.causes[0].words

    assert first() == f"torques that act 0.15 ms {words} than stated"
    mute = hypotheses.numbers_of
    monkeypatch.setattr(causes, "numbers_of", lambda vector, delay: mute(vector))
    assert first() != f"torques that act 0.15 ms {words} than stated"


@pytest.mark.slow
def test_the_size_is_that_of_a_fit_not_of_one_step(monkeypatch):
    """Planted: without the refit the share of 20 % of mass is the prediction of a linear step,
    which is wrong.
    """
    found = explained(measured(times(1.2, ["arm3.mass"])))
    assert found.causes[0].size == pytest.approx(1.2, abs=1e-3)
    monkeypatch.setattr("flexgen.identification.estimator.minimize.ITERATIONS", 1)
    forgotten = causes.explain(Residuals(found.vector, found.data), found.x)
    assert not forgotten or forgotten[0].share < 0.99 or abs(forgotten[0].size - 1.2) > 0.01


def test_a_missing_spring_is_named_with_its_stiffness():
    """Also where a body is attached without any coordinate: about the axis of the spring that is
    not there.
    """
    found = explained(measured(), without(ROBOT, "q3"))
    assert (
        found.causes[0].words.startswith("a missing spring arm3_z of 1.3e+05 N m/rad")
        and len(found.causes) == 1
    )


def test_a_body_that_slides_may_turn_about_all_axes():
    """Behind a joint that turns, its own axis is left out: there the spring would be one of the
    gear.
    """
    elbow = flexgen.read("elbow")
    upper, fore = elbow.elements
    slides = replace(upper, dofs=(replace(upper.dofs[0], type="translation"),))
    found = [dof for dof, _ in additions(replace(elbow, elements=(slides, fore)))]
    assert [dof.name for dof in found] == ["q1_u", "q1_v", "q1_w", "q2_u", "q2_v"]
    np.testing.assert_allclose(np.abs(np.linalg.det([dof.axis for dof in found[:3]])), 1.0)


def test_a_body_on_springs_without_motor_may_turn_about_the_other_axes():
    """A platform on springs that lacks one of them; after its own springs."""
    elbow = flexgen.read("elbow")
    upper, fore = elbow.elements
    joint = upper.dofs[0]
    spring = replace(joint, name="roll", axis=(1.0, 0.0, 0.0), gear=None, spring=joint.gear.spring)
    base = replace(
        upper, name="platform", dofs=(replace(spring, name="heave", type="translation"), spring)
    )
    found = dict(
        (dof.name, model) for dof, model in additions(replace(elbow, elements=(base, fore)))
    )
    assert list(found)[:2] == ["platform_y", "platform_z"]
    assert [dof.name for dof in found["platform_y"].elements[0].dofs] == [
        "heave",
        "roll",
        "platform_y",
    ]


def test_a_score_is_the_decrease_of_least_squares():
    """Against the residuals of two linear fits."""
    rng = np.random.default_rng(3)
    r = rng.standard_normal(40)
    J = rng.standard_normal((40, 3))
    j = rng.standard_normal(40)
    basis = np.linalg.qr(J)[0]
    more = np.column_stack([J, j])
    left = [r - A @ np.linalg.lstsq(A, r, rcond=None)[0] for A in (J, more)]
    assert causes.score(basis, r - basis @ (basis.T @ r), j) == pytest.approx(
        left[0] @ left[0] - left[1] @ left[1]
    )
    assert causes.score(basis, r, J[:, 0]) == 0.0


def test_a_spring_across_a_plane_changes_no_residual_of_a_planar_arm():
    """Also where the residuals have weights by the structure of the noise: all hypotheses have
    those of the fit.
    """
    residuals = Residuals(ParameterVector(ROBOT, ["stiffness"]), measured())
    x = residuals.vector.start
    residuals.use_structure(x)
    columns = causes.columns_of_springs(residuals, x, causes.stack(residuals.weight(x, False)[0]))
    across = [column for spring, column in columns if spring.name in ("q1_u", "q2_u")]
    assert len(across) == 8 and np.abs(across).max() < 1e-6


def test_the_rest_of_a_soft_arm_does_not_depend_on_the_searches_before():
    """A spring that softens step by step bends on where a search from the unbent arm does not."""
    residuals = Residuals(ParameterVector(ROBOT, ["stiffness"]), measured())
    x = residuals.vector.start.copy()
    at = residuals.vector.names.index("q3.stiffness")
    for factor in np.geomspace(1.0, 4.375e-5, 35):
        x[at] = residuals.vector.start[at] + np.log(factor)
        with suppress(SolverError):
            residuals.rest(x)
    with pytest.raises(SolverError, match="equilibrium at pose 3"):
        residuals.rest(x)
    assert list(causes.columns_of_numbers(residuals, residuals.vector.start))
    # no cause is named there, and the fit is returned
    assert not list(causes.columns_of_numbers(residuals, x))


def test_a_model_that_fits_has_no_cause():
    found = explained(measured())
    assert found.status == FitStatus.FITTED and found.causes == ()
    assert "possible cause" not in found.to_text() and found.to_dict()["causes"] == []


def test_rounding_of_data_without_noise_has_no_cause():
    """A delay of 7e-12 s explained it, so that a fit to ten digits was called a model error."""
    plan = flexgen.excite("planar5_nmp", poses=3, period_s=2.0, lines=30, speed_rms=0.02)
    changed = {"element.arm1.dof.q1.gear.spring.stiffness": 2e5}
    robot = flexgen.read("planar5_nmp", overrides=changed)
    found = flexgen.identify("planar5_nmp", flexgen.frf(flexgen.measure(plan, robot)))
    assert found.values["q1.stiffness"] == pytest.approx(2e5, rel=1e-7)
    assert found.status == FitStatus.FITTED and not found.causes
