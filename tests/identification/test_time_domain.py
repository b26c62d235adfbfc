"""Refinement by simulation of a short experiment: sums by differences, the change by noise, and
what other experiments say.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from identification_cases import without_coulomb
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.time_domain import (
    Simulated,
    Validation,
    frictions_of,
    refined_status,
    validate,
    validate_on_others,
)
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.result import FitStatus, IdentificationResult

pytestmark = needs_compiler
POSES = [[0.5, -0.3], [0.1, 0.2], [0.9, 0.4]]
FREE = ["q1.stiffness", "q2.damping"]
NOISY = DriveHardware(1e-3, delay_s=2e-4, encoder_noise_rad=1e-5, torque_noise_Nm=1e-3)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    plan = flexgen.excite(
        "elbow", poses=POSES, period_s=0.2, f_min=5.0, f_max=60.0, lines=5, periods=3,
        transients=2, realizations=2, hardware=NOISY, speed_rms=0.05,
    )  # fmt: skip
    stiff = {"element.upper.dof.q1.gear.spring.stiffness": 8e6}
    return flexgen.measure(plan, flexgen.read("elbow", overrides=stiff), seed=1)


@pytest.fixture(scope="module")
def found(experiment: Experiment) -> IdentificationResult:
    responses = flexgen.frf(experiment)
    coarse = flexgen.identify("elbow", responses, free=FREE, starts=1, structured=False)
    return replace(coarse, status=FitStatus.FITTED)


@pytest.fixture
def simulated(experiment: Experiment, found: IdentificationResult) -> Simulated:
    return Simulated(found.vector, experiment, [(1, 0, 1), (0, 1, 0)])


def test_spectra_are_those_of_the_experiment(
    simulated: Simulated, found: IdentificationResult, experiment: Experiment
) -> None:
    """As accelerations, with the deviation of their mean from seven lines of all runs; derivatives
    begin ten time constants of the position control before the period, a quarter at least.
    """
    w2 = (2 * np.pi * experiment.plan.frequencies[:, None]) ** 2
    each = w2 * np.array([experiment.q_m[1, 0, 1], experiment.q_m[0, 1, 0]])
    assert_allclose(simulated.measured, each.mean(axis=1))
    variance = np.var(each, axis=1, ddof=1).mean(axis=0) / 3
    smooth = [variance[max(0, k - 3) : k + 4].mean(axis=0) for k in range(len(w2))]
    assert_allclose(simulated.sd[0], np.sqrt(smooth), rtol=1e-4)
    away = np.abs(simulated.spectra(found.x) - simulated.measured)
    assert away.max() < 0.03 * np.abs(simulated.measured).max()
    assert simulated.count == 2 * 5 * 2 and not simulated.shift.any()
    for gain, last in ((100.0, 100), (1000.0, 50), (40.0, 200), (0.0, 200)):
        controller = replace(experiment.plan.controller, position_gain=np.array([2 * gain, gain]))
        plan = replace(experiment.plan, controller=controller)
        made = Simulated(found.vector, replace(experiment, plan=plan), [(0, 0, 0)])
        assert made.last == last


def test_sums_of_a_simulation_are_those_of_its_differences(
    experiment: Experiment, found: IdentificationResult
) -> None:
    """Known derivatives serve again where x moved little, or the cost hardly changed."""
    controller = replace(experiment.plan.controller, position_gain=np.full(2, 60.0))
    plan = replace(experiment.plan, controller=controller)
    simulated = Simulated(found.vector, replace(experiment, plan=plan), [(1, 0, 1), (0, 1, 0)])
    x = found.vector.start
    r = simulated.residual(x).ravel()
    weighted = (simulated.spectra(x) - simulated.measured) / simulated.sd
    assert_allclose(r, weighted.ravel(), rtol=1e-6)
    steps = 1e-3 * np.eye(2)
    J = np.stack(
        [(simulated.residual(x + h) - simulated.residual(x - h)).ravel() / 2e-3 for h in steps],
        axis=1,
    )
    away = []
    for whole in (False, True):
        if whole:
            simulated.use_whole()
        told: list[str] = []
        simulated.progress = told.append
        cost, gradient, A = simulated.sums(x)
        assert cost == pytest.approx((np.abs(r) ** 2).sum())
        size = np.sqrt(np.outer(np.diag(A), np.diag(A)))
        away.append(np.abs(A - np.real(J.conj().T @ J)).max() / size.max())
        assert_allclose(gradient, np.real(J.conj().T @ r), rtol=0.05)
        assert len(told) == 2 and told[0].endswith(" s of robot in the plan")
        for step, simulations in ((0.0099, 1), (0.3, 3)):
            before = simulated.simulations
            simulated.sums(x + np.array([step, 0.0]))
            assert simulated.simulations - before == simulations
    # from a whole period before they are more accurate
    assert 0.02 > away[0] > 1.5 * away[1]
    # far away where the cost is the same
    before = simulated.simulations
    simulated.sums(x + np.array([0.3, 0.02]))
    assert simulated.simulations - before == 1


def test_noise_shifts_spectra_by_its_mean_over_sixteen_simulations(
    simulated: Simulated, found: IdentificationResult
) -> None:
    sd = simulated.sd
    quiet = simulated.spectra(found.x)
    noisy = [simulated.spectra(found.x, noise=time_domain.SEED + k) for k in range(16)]
    told: list[str] = []
    simulated.progress = told.append
    simulated.use_noise(found.x)
    assert_allclose(simulated.shift, np.mean(noisy, axis=0) - quiet, atol=1e-12)
    assert_allclose(simulated.sd, sd * np.sqrt(1 + 3 / 16))
    assert told == ["change of the motion by noise: 16 simulations"]
    r = simulated.residual(found.x)
    assert_allclose(r, (quiet + simulated.shift - simulated.measured) / simulated.sd, rtol=1e-6)
    simulated.plan = replace(simulated.plan, hardware=DriveHardware(1e-3))
    before = simulated.shift
    simulated.use_noise(found.x)
    assert simulated.shift is before


def test_a_refinement_finds_the_spring_with_its_deviation(
    experiment: Experiment, found: IdentificationResult
) -> None:
    """On one experiment at each pose, from the values of the responses and those that are given;
    what the drives have is not identified again.
    """
    free = [*FREE, "delay", "m1.torque_constant"]
    fine = flexgen.refine(found, experiment, free=free, start={"q2.damping": 550.0})
    vector = fine.vector
    assert vector.names == tuple(FREE)
    begin = dict(zip(vector.names, vector.values(vector.start), strict=True))
    assert begin == pytest.approx({**found.used(), "q2.damping": 550.0})
    sd = fine.sd["q1.stiffness"]
    assert sd is not None and abs(np.log(fine.values["q1.stiffness"] / 8e6)) < 4 * sd
    assert fine.status is FitStatus.FITTED and 0.3 < fine.cost < 2.0 and fine.grade is None
    assert (fine.weights, fine.starts, fine.agreed, fine.weak) == ("time domain", 1, 1, ())
    same = Simulated(vector, experiment, [(0, 0, 0), (1, 0, 1), (2, 1, 0)])
    same.use_noise(fine.x)
    same.use_whole()
    cost, _, A = same.sums(fine.x)
    assert fine.cost == pytest.approx(cost / (30 - 1), rel=0.02)
    prior = np.diag(vector.prior_sd**-2.0)
    inverse = np.linalg.inv(A + prior)
    expected = inverse @ (0.5 * max(fine.cost, 1.0) * A + prior) @ inverse
    assert_allclose(np.diag(fine.formal_covariance), np.diag(expected), rtol=0.05)


def test_a_validation_compares_accelerations_and_correlations_of_lines(
    experiment: Experiment, found: IdentificationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the experiments that follow the used ones, other ones from pose to pose."""
    for used, runs in (
        (1, [(0, 0, 1), (1, 1, 0), (2, 1, 1)]),
        (3, [(0, 1, 1), (1, 0, 0), (2, 0, 1)]),
    ):
        told: list[str] = []
        checked = validate(found, experiment, used=used, progress=told.append)
        assert told == ["change of the motion by noise: 16 simulations"]
        same = Simulated(found.vector, experiment, runs)
        same.use_noise(found.x)
        r = same.residual(found.x)
        for j in range(2):
            wrong = np.linalg.norm((same.sd * r)[..., j]) / np.linalg.norm(same.measured[..., j])
            assert checked.fit_percent[j] == pytest.approx(100 * (1 - wrong))
            inside = []
            for lag in range(1, 5):
                products = (r[:, lag:, j] * r[:, :-lag, j].conj()).sum()
                part = abs(products.real) / (np.abs(r[..., j]) ** 2).sum()
                inside.append(part < 2.58 / np.sqrt(2 * 15))
            assert checked.white[j] == np.mean(inside)
        assert checked.cost == pytest.approx((np.abs(r) ** 2).mean())
    # of four lags of residuals that are alike, two are above the band
    monkeypatch.setattr(Simulated, "residual", lambda self, x: np.full((3, 5, 2), 0.3 + 0.1j))
    assert validate(found, experiment).white == (0.5, 0.5)
    with pytest.raises(ArgumentError, match="used: given 4, expected fewer than the 4 experiment"):
        validate(found, experiment, used=4)


@pytest.mark.parametrize(
    ("changes", "more", "text"),
    [
        ({"motors": ("m2", "m1")}, {}, "given other motors or poses"),
        ({"speed_gain": 0.0}, {}, "without the gains and references of its drives, expected"),
        ({"amplitudes": np.zeros((5, 2))}, {}, "without the gains and references of its drives"),
        ({}, {"runs": 5}, "runs: given 5, expected 1 to 4, the experiments at each pose"),
        ({}, {"runs": 0}, "runs: given 0, expected 1 to 4, the experiments at each pose"),
        (
            {},
            {"free": ["q1.stiffness", "tip.delay"]},
            "free: given the delay of a sensor, which the motors do not show: 'identify' can fit",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused(
    changes: dict[str, Any],
    more: dict[str, Any],
    text: str,
    experiment: Experiment,
    found: IdentificationResult,
) -> None:
    plan = experiment.plan
    if "speed_gain" in changes:
        none = replace(plan.controller, speed_gain=np.zeros(2))
        plan = replace(plan, controller=none)
    else:
        plan = replace(plan, **changes)
    with pytest.raises(ArgumentError, match=text):
        flexgen.refine(found, replace(experiment, plan=plan), **more)


@pytest.mark.parametrize(
    ("converged", "at_bound", "cost", "error", "bent", "before", "status"),
    [
        (False, False, 1.0, 0.0, False, "FITTED", "NOT_CONVERGED"),
        (False, True, 1.0, 0.0, False, "FITTED", "NOT_CONVERGED"),
        (True, True, 1.0, 0.0, False, "FITTED", "AT_BOUND"),
        (True, False, 2.0, 1.01, False, "FITTED", "FITTED"),
        (True, False, 2.01, 0.99, False, "FITTED", "SMALL_ERROR"),
        (True, False, 2.01, 1.01, True, "FITTED", "MODEL_ERROR"),
        (True, False, 1.0, 0.0, False, "MODEL_ERROR", "MODEL_ERROR"),
        (True, False, 1.0, 0.0, True, "MODEL_ERROR", "FITTED"),
    ],
)
def test_the_status_of_a_refinement(
    converged: bool,
    at_bound: bool,
    cost: float,
    error: float,
    bent: bool,
    before: str,
    status: str,
    found: IdentificationResult,
) -> None:
    """``error``: of the angles, over the largest that is small; ``bent``: friction that responses
    do not describe.
    """
    fit: Any = Made(converged=converged, at_bound=np.array([False, at_bound]), x=2.0)
    measured = np.array([3.0, 4.0])
    away = error * time_domain.SMALL_ERROR * measured / 0.5
    simulated: Any = Made(
        residual=lambda x: away, sd=0.5, measured=measured, local=Made(springs=())
    )
    robot = flexgen.read("elbow") if bent else without_coulomb("elbow")
    laws = [replace(m.friction, coulomb=1.0 * bent, beta=1.0) for m in robot.motors]
    motors = [replace(m, friction=law) for m, law in zip(robot.motors, laws, strict=True)]
    robot = replace(robot, motors=tuple(motors))
    known = replace(found, vector=ParameterVector(robot, FREE), status=FitStatus[before])
    assert refined_status(fit, cost, simulated, known) is FitStatus[status]


def test_frictions_of_a_refinement_are_those_of_the_file(found: IdentificationResult) -> None:
    """Numbers above zero of motors and joints; beta only with a Coulomb friction."""
    joint = {"type": "smooth", "viscous": 0.1, "coulomb": 0.0, "beta": 9.0}
    model = flexgen.read("planar5_nmp", overrides={"element.arm1.dof.q1.friction": joint})
    first, second = model.motors
    shape = {"viscous": 1.0, "coulomb": 2.0, "beta": 3.0}
    none = {"viscous": 0.0, "coulomb": 0.0, "stribeck": 0.0, "beta": 3.0}
    motors = (
        replace(first, friction=replace(first.friction, **shape)),
        replace(second, friction=replace(second.friction, **none)),
    )
    robot = replace(model, motors=motors)
    names = frictions_of(replace(found, vector=ParameterVector(robot, ["q1.stiffness"])))
    assert names == ["m1.viscous", "m1.coulomb", "m1.beta", "q1.viscous"]


@pytest.mark.parametrize(
    ("cost", "fit", "status", "expected"),
    [
        (2.01, 99.89, "FITTED", "POORLY_VALIDATED"),
        (2.01, 99.89, "SMALL_ERROR", "POORLY_VALIDATED"),
        (2.01, 99.89, "MODEL_ERROR", "MODEL_ERROR"),
        (1.99, 10.0, "FITTED", "FITTED"),
        (2.01, 99.91, "FITTED", "FITTED"),
    ],
)
def test_a_fit_is_poorly_validated_where_others_deviate(
    cost: float, fit: float, status: str, expected: str, found: IdentificationResult
) -> None:
    checked = Validation((99.99, fit), cost, (1.0, 1.0))
    before = replace(found, status=FitStatus[status])
    assert validate_on_others(before, checked).status is FitStatus[expected]


@pytest.mark.parametrize(("counts", "several"), [((1, 1), False), ((2, 1), True), ((1, 2), True)])
def test_parameters_are_validated_where_there_is_another_experiment(
    counts: tuple[int, int], several: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    early = Made(status=Made(ended_early=False))
    monkeypatch.setattr(time_domain, "refine", lambda found, experiment, **more: early)
    monkeypatch.setattr(time_domain, "validate", lambda fine, experiment: "checked")
    monkeypatch.setattr(time_domain, "validate_on_others", lambda fine, checked: (fine, checked))
    given: Any = Made(plan=Made(experiments=counts[0], realizations=counts[1]))
    found: Any = "fit"
    expected: Any = ((early, "checked"), "checked") if several else (early, None)
    assert time_domain.refine_and_validate(found, given) == expected
