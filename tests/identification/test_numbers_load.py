"""The search for a load, with torques that are linear in its mass, its first moment and a delay: a
linear fit.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.identification.load import payload
from flexgen.identification.load.compliances import stiffness_deviations
from flexgen.identification.rigid.rests_of_motors import Rests
from flexgen.model.elements import Body

SAMPLES = 80
KEPT = slice(10, -10)


def estimate(
    monkeypatch: pytest.MonkeyPatch,
    true: list[float],
    noise: float = 0.01,
    shown: int = 4,
    own: float = 2.0,
) -> Any:
    """Two motors; the payload of the file has a mass of ``own``, the torques are those of ``true``
    and a delay.
    """
    rng = np.random.default_rng(8)
    made: Any = object.__new__(payload._Estimate)
    made.robot = Made(n_a=3, i_g=(0, 2), name="arm", eta=np.eye(2), payload=Body())
    made.to_arm = np.eye(2)
    made._rests = [Rests(np.ones(SAMPLES), 0.0, 0.1, lambda x: x, 1, 1, 10)] * 2
    made.moving = 60
    made.of_file = np.array([7.0, own, 0.1, -0.05, 0.2])
    made.kept = KEPT
    made.h = 0.01
    made.effective = 30.0
    made.farthest = 3.0
    made.length = 1.0
    made.unit = 1.0
    made.block = 0.5
    made.slopes = rng.normal(size=(SAMPLES, 3, 4)) * [1, 2, 3, 4]
    made.slopes[:, :, shown:] = 0.0
    made.in_arm = rng.normal(size=(SAMPLES, 3))
    made.late = rng.normal(size=(SAMPLES, 2))
    # of motors is known; rigid
    made.friction = np.zeros((SAMPLES, 0, 2))
    made.stiffness_sd = np.zeros(3)
    mass = true[0]
    com = np.array(true[1:4])
    delay = true[4]
    load = made.slopes[:, [0, 2]] @ np.array([mass, *(mass * com)])
    made.tau_g = load - delay * made.late + noise * rng.normal(size=(SAMPLES, 2))
    made.tau_g[:9] = 1e3  # spoiled by the low pass
    made.scale = np.abs(made.tau_g[KEPT]).max(axis=0)
    made.nominal = Made(function=lambda name: made.in_arm[None] if name == "arm_forces" else None)
    monkeypatch.setattr(payload, "evaluate", lambda friction, q, v: [friction])
    monkeypatch.setattr(
        payload._Estimate, "motion", lambda self, values, softer: (None, None, softer)
    )
    monkeypatch.setattr(payload._Estimate, "_low_pass", lambda self, x: x)
    monkeypatch.setattr(payload._Estimate, "forces", forces)
    return made


def forces(self: Any, q: Any, v: Any, a: Any, values: np.ndarray) -> np.ndarray:
    """``a`` is how much softer the springs are: their torques do not depend on the load here."""
    soft = self.of_springs @ a if hasattr(self, "of_springs") else 0.0
    return np.asarray(
        self.slopes @ np.array([values[0], *(values[0] * values[1:])]) + self.in_arm + soft
    )


def linear_fit(
    made: Any, chosen: list[int] | slice = slice(None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Chosen of mass, first moments, delay; residuals, scales, covariance of the numbers, torques
    over the scales.
    """
    tau = made.tau_g[KEPT]
    scale = np.abs(tau).max(axis=0)
    rows = (
        np.concatenate([made.slopes[KEPT][:, [0, 2]], -made.late[KEPT][:, :, None]], axis=2)
        / scale[:, None]
    )
    J = rows.reshape(-1, 5)[:, chosen]
    y = (tau / scale).ravel()
    found = np.linalg.lstsq(J, y, rcond=None)[0]
    r = (J @ found - y).reshape(-1, 2)
    variance = (np.mean(r**2) + 1e-8 * np.mean(y**2)) * r.size / (30.0 * 2 - 5)
    return found, r, scale, np.linalg.inv(J.T @ J) * variance, y


def test_a_load_is_the_linear_fit_of_its_first_moments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Less the payload of the file; its deviations are those of the fit, to first order."""
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02])
    load = made.solve()
    found, r, scale, covariance, _ = linear_fit(made)
    mass = found[0] - 2.0
    com = (found[1:4] - 2.0 * np.array([0.1, -0.05, 0.2])) / (found[0] - 2.0)
    # the center of mass is held by 1 m, millimeters show here
    assert load.mass == pytest.approx(mass, rel=1e-6) and load.delay_s == pytest.approx(
        found[4], rel=1e-5
    )
    assert_allclose(load.com, com, rtol=1e-4)
    assert load.total_mass == pytest.approx(found[0]) and abs(mass - 3.0) < 0.05
    assert_allclose(load.total_com, found[1:4] / found[0], rtol=1e-4)
    assert load.mass_sd == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-4)
    slopes = np.column_stack([-com, np.eye(3)]) / mass  # of com in the mass and the first moments
    assert_allclose(
        load.com_sd, np.sqrt(np.diag(slopes @ covariance[:4, :4] @ slopes.T)), rtol=1e-3
    )
    assert_allclose(load.residual_Nm, np.sqrt((r**2).mean(axis=0)) * scale, rtol=1e-5)


def test_a_load_without_mass_has_no_center(monkeypatch: pytest.MonkeyPatch) -> None:
    """The record is that of the payload of the file."""
    made = estimate(monkeypatch, [2.0, 0.1, -0.05, 0.2, 0.0], noise=0.0)
    load = made.solve()
    assert load.mass == pytest.approx(0.0, abs=1e-9) and load.delay_s == pytest.approx(
        0.0, abs=1e-9
    )
    assert np.isnan(load.com).all() or abs(load.mass) > 1e-9
    assert load.mass_sd == pytest.approx(np.sqrt(linear_fit(made)[3][0, 0]), rel=1e-4)


def test_deviations_are_those_of_blocks_where_these_are_larger(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each number by itself."""
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02])
    left = np.diag([0.25, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setattr(payload._Estimate, "_left_out", lambda self, r, J, prior: left)
    load = made.solve()
    assert load.mass_sd == 0.5
    # of com where the mass changes and first moments stay
    along = np.abs(load.com) / load.mass * 0.5
    alone = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02])
    monkeypatch.setattr(payload._Estimate, "_left_out", lambda self, r, J, prior: 0 * left)
    assert_allclose(load.com_sd, np.maximum(along, alone.solve().com_sd), rtol=1e-9)


def test_a_load_that_the_record_does_not_show_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mass without torques, torques that no load explains, and steps that end nowhere."""
    with pytest.raises(
        SolverError,
        match="load: the motion does not determine the mass; move the joints that carry",
    ):
        estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02], shown=0).solve()
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02], noise=4.0)
    _, r, _, _, y = linear_fit(made)
    part = np.linalg.norm(r) / np.linalg.norm(y)
    assert 0.4 < part < 0.5
    made.solve()  # less than half is left
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02], noise=5.0)
    _, r, _, _, y = linear_fit(made)
    part = np.linalg.norm(r) / np.linalg.norm(y)
    assert 0.5 < part < 0.6
    with pytest.raises(
        SolverError,
        match=f"no load explains the record, {100 * part:.0f} % of the torques are left;",
    ):
        made.solve()
    monkeypatch.setattr(payload, "STEPS", 1)
    monkeypatch.setattr(payload, "SEARCHES", 1)
    with pytest.raises(
        SolverError,
        match=r"load: no solution in 1 steps; does the record belong to the model arm\?",
    ):
        estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02]).solve()


def test_a_direction_that_no_motion_shows_is_known_by_the_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within a meter of the center of mass of its payload; the other numbers are those of a fit
    without it.
    """
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02], shown=3)
    load = made.solve()
    known = linear_fit(made, [0, 1, 2, 4])[0]
    assert load.mass == pytest.approx(known[0] - 2.0, rel=1e-4)
    assert_allclose(
        load.com[:2], (known[1:3] - 2.0 * np.array([0.1, -0.05])) / load.mass, rtol=1e-3
    )
    assert load.com[2] == pytest.approx(0.2) and load.com_sd[2] == pytest.approx(1.0, rel=1e-4)
    # of the difference, and of the total
    assert load.com_sd[:2].max() < 0.02 and str(load).count("not determined") == 2
    assert str(load).count(", z not determined in the frame of the last tip") == 2


@pytest.mark.parametrize("size", [0.2, 1.0])
def test_a_direction_that_no_motion_of_a_short_arm_shows_is_not_determined(
    size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All lengths of the arm of the test before by this size: its deviation is the reach."""
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02], shown=3)
    made.of_file[-3:] = size * made.of_file[-3:]
    made.length = size
    made.farthest = 3.0 * size
    made.slopes[:, :, 1:] /= size
    load = made.solve()
    assert load.com_sd[2] == pytest.approx(size, rel=1e-4) and load.com[2] == pytest.approx(
        0.2 * size
    )
    assert str(load).count("not determined") == 2
    assert str(load).count(", z not determined in the frame of the last tip") == 2


def test_the_center_of_a_mass_that_is_nearly_zero_is_near() -> None:
    assert_allclose(
        payload.values_of(np.array([2.0, 0.4, -0.2, 0.0, 9.0]), 3.0), [2.0, 0.2, -0.1, 0.0]
    )
    assert_allclose(
        payload.values_of(np.array([1e-6, 0.01, -0.01, 1e-6, 9.0]), 3.0), [1e-6, 3.0, -3.0, 1.0]
    )


def test_springs_that_are_softer_change_no_load(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ridge fit with one number more for each spring."""
    made = estimate(monkeypatch, [5.0, 0.3, -0.2, 0.1, 0.02])
    made.stiffness_sd = np.array([0.2, 0.0, 0.1])
    # as a mass
    made.of_springs = (
        0.02 * np.random.default_rng(3).normal(size=(SAMPLES, 3, 3)) + made.slopes[:, :, :1]
    )
    made.tau_g = made.tau_g + made.of_springs[:, [0, 2]] @ [0.3, 0.0, 0.1]
    made.scale = np.abs(made.tau_g[KEPT]).max(axis=0)
    tau = made.tau_g[KEPT] / made.scale
    parts = [
        made.slopes[KEPT][:, [0, 2]],
        -made.late[KEPT][:, :, None],
        made.of_springs[KEPT][:, [0, 2]][:, :, [0, 2]],
    ]
    J = (np.concatenate(parts, axis=2) / made.scale[:, None]).reshape(-1, 7)
    prior = np.diag([0.0] * 5 + [0.2**-2, 0.1**-2])
    found = np.linalg.lstsq(J, tau.ravel(), rcond=None)[0]
    for _ in range(20):
        r = J @ found - tau.ravel()
        variance = (np.mean(r**2) + 1e-8 * np.mean(tau**2)) * r.size / (30.0 * 2 - 5)
        found = np.linalg.solve(J.T @ J + prior * variance, J.T @ tau.ravel())
    H = np.linalg.inv(J.T @ J + prior * variance)
    load = made.solve()
    assert load.mass_sd == pytest.approx(np.sqrt(variance * H[0, 0]), rel=1e-4)
    # where the search ends
    assert abs(load.total_mass - found[0]) < payload.DISTANCE * load.mass_sd
    assert abs(load.mass - 3.0) < 0.1
    made.stiffness_sd = np.zeros(3)
    monkeypatch.setattr(payload._Estimate, "_left_out", lambda self, r, J, prior: np.zeros((5, 5)))
    assert made.solve().mass - 3.0 > 0.3


def test_the_deviation_of_a_spring_is_that_of_the_model_file() -> None:
    """By name, else that of all stiffnesses, else a fifth; rigid gears and springs that are known
    have none.
    """
    model = flexgen.read("planar5_nmp")
    assert stiffness_deviations(model).tolist() == [0.2, 0.2, 0.2]
    stated = {"stiffness": 0.1, "parameters": ["q2.stiffness", "q3.stiffness"], "sd": [0.05, 0.0]}
    for uncertainty, expected in (
        ({"masses": 0.03}, [0.2, 0.2, 0.2]),
        ({"stiffness": 0.1}, [0.1, 0.1, 0.1]),
        (stated, [0.1, 0.05, 0.0]),
    ):
        given = flexgen.read("planar5_nmp", overrides={"uncertainty": uncertainty})
        assert stiffness_deviations(given).tolist() == expected
    assert not stiffness_deviations(flexgen.read("elbow@rigid")).any()
    assert stiffness_deviations(flexgen.read("beam_arm")).tolist() == [0.2] * 4
