"""Excitation whose power is where it tells most about the parameters."""

from __future__ import annotations

import numpy as np
import pytest
from identification_cases import NOISY, poses_of, without_coulomb

import flexgen
from flexgen.identification.experiments.operating_points import (
    covariance,
    information,
    information_by_line,
)
from flexgen.identification.experiments.optimal_spectrum import optimal_power
from flexgen.identification.experiments.plan import default_free
from flexgen.identification.responses.parameters import ParameterVector


def test_the_best_of_two_lines_in_closed_form() -> None:
    """Two lines that each tell one parameter: variances 1/(p a) + 1/((1 - p) b), p =
    sqrt(b)/(sqrt(a) + sqrt(b)).
    """
    vector = ParameterVector(flexgen.read("planar5_nmp"), ["q1.stiffness", "q2.stiffness"])
    # so large that the prior does not count
    a = 9e6
    b = 1e6
    power = optimal_power(np.array([np.diag([a, 0.0]), np.diag([0.0, b])]), vector)
    assert power == pytest.approx([1 / 4, 3 / 4], abs=2e-3)


def test_no_random_spectrum_is_better() -> None:
    model = without_coulomb("planar5_nmp")
    plan = flexgen.excite(model, poses=poses_of(model, 1), f_max=100.0, hardware=NOISY)
    vector = ParameterVector(model, default_free(model))
    F = information_by_line(vector, plan, plan.poses[0])
    assert np.allclose(F.sum(axis=0), information(vector, plan, plan.poses)[0][0], rtol=1e-10)
    target = np.array([not name.endswith("viscous") for name in vector.names])

    def trace(power: np.ndarray) -> float:
        C = covariance(np.einsum("l,lab->ab", power, F), vector.prior_sd)
        return float(np.trace(C[target][:, target]))

    best = trace(optimal_power(F, vector))
    rng = np.random.default_rng(0)
    assert all(
        best <= trace(rng.dirichlet(np.full(len(F), alpha)))
        for alpha in (0.1, 1.0, 10.0)
        for _ in range(100)
    )


def test_the_plan_keeps_its_speeds_and_predicts_less(tmp_path) -> None:
    model = without_coulomb("planar5_nmp")
    plans = [
        flexgen.excite(model, poses=poses_of(model, 2), f_max=100.0, hardware=NOISY, spectrum=x)
        for x in (0.0, 0.5, "optimal")
    ]
    assert np.allclose(plans[2].speed_sd, plans[1].speed_sd, rtol=1e-12)
    counted = [name for name in plans[0].predicted if not name.endswith("viscous")]
    rms = [np.sqrt(np.mean([plan.predicted[name] ** 2 for name in counted])) for plan in plans]
    assert rms[2] < 0.95 * rms[1] < rms[0]
