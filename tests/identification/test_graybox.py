"""The fit of frequency responses: least squares by another search, its statuses, and what its
result says of numbers that the data do not show.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, without_coulomb
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.records import TRANSIENT
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.causes.explain import Cause
from flexgen.identification.estimator.minimize import Minimum
from flexgen.identification.responses import graybox
from flexgen.identification.responses.graybox import fit_status, hidden_numbers, weak_directions
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import WEAK, FitStatus

W = 2 * np.pi * np.geomspace(2.0, 80.0, 10)
FREE = ["q1.stiffness", "q2.damping"]
MODEL = without_coulomb("planar5_nmp")
BEGIN = {p.name: 1.1 * p.value for p in select(MODEL, FREE)}


def noisy(size: float = 1.0, relative_sd: float = 1e-2, seed: int = 3) -> flexgen.Frf:
    """Responses with noise of ``size`` times the standard deviation that they state."""
    exact = exact_responses(MODEL, poses_of(MODEL, 2), W, Drive(5e-4), relative_sd)
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(*exact.G.shape, 2)) @ [1, 1j] / np.sqrt(2)
    return replace(exact, G=exact.G + size * np.sqrt(exact.variance) * noise)


def fitted(data: flexgen.Frf, **more: Any) -> Any:
    given = {"free": FREE, "starts": 1, "structured": False, "progress": False} | more
    return flexgen.identify(MODEL, data, start=BEGIN, **given)


@pytest.mark.parametrize("residual", ["nls", "lls"])
def test_a_fit_is_the_minimum_of_weighted_squares_and_prior(residual: str) -> None:
    """By SciPy with the residuals as they are; the cost is over complex residuals less half of
    the real numbers.
    """
    data = noisy()
    prior = {"q1.stiffness": 0.02}
    found = fitted(data, residual=residual, floor=0.0, priors=prior)
    vector = ParameterVector(MODEL, FREE, start=BEGIN, priors=prior)
    residuals = Residuals(vector, data, residual)

    def errors(x: np.ndarray) -> np.ndarray:
        r = residuals.weight(x, False)[0].ravel()
        return np.concatenate([r.real, r.imag, (x - vector.start) / vector.prior_sd])

    best = least_squares(errors, vector.start, xtol=1e-12, ftol=1e-12)
    sd = np.sqrt(np.diag(found.formal_covariance))
    assert (np.abs(found.x - best.x) < 0.02 * sd).all()
    r = residuals.weight(found.x, False)[0]
    assert found.cost == pytest.approx((np.abs(r) ** 2).sum() / (r.size - 1), rel=1e-9)
    A = residuals.sums(found.x)[2]
    assert_allclose(found.formal_covariance, residuals.covariance(found.x, A), rtol=1e-6)
    assert (found.weights, found.at_bound) == (residual, ())


@pytest.mark.parametrize(
    ("size", "more", "status", "error"),
    [
        (1.0, {}, "FITTED", 0.0),
        (0.5, {}, "NOISE_TOO_LARGE", 0.0),
        (5.0, {}, "MODEL_ERROR", 7e-2),
        (1.7, {}, "MODEL_ERROR", 1.9e-2),
        (5.0, {"floor": 0.02}, "MODEL_ERROR", 0.02),
        (5.0, {"floor": 0.05}, "FITTED", 0.05),
        (0.0, {}, "NOISE_TOO_LARGE", 0.0),
        (1.0, {"structured": True}, "FITTED", 0.0),
    ],
)
def test_noise_beyond_what_is_stated_is_an_error_of_the_model(
    size: float, more: dict[str, Any], status: str, error: float
) -> None:
    """Of the part of the responses that the cost needs, or of the part that is given."""
    data = noisy(size)
    found = fitted(data, **more)
    if "floor" in more and status == "FITTED":
        assert found.model_error == error and found.cost < 2.0
        return
    assert found.status is FitStatus[status]
    assert found.model_error == pytest.approx(error, rel=1e-12 if "floor" in more else 0.25)
    if size == 1.7:
        # the weights are about the residuals of the fit, averaged over seven lines on either side
        away = np.abs(Residuals(found.vector, data).response(found.x).G - data.G) ** 2
        near = [away[:, max(0, k - 7) : k + 8].mean(axis=1) for k in range(len(W))]
        variance = np.maximum(np.stack(near, axis=1), data.variance)
        assert 0.8 < np.median(found.variance / variance) < 1.2


def test_searches_begin_within_the_spread_and_those_that_agree_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Numbers with a logarithm only; those without an equilibrium are left out."""
    starts: list[np.ndarray] = []
    search = graybox.minimize
    failing: set[int] = set()

    def minimize(problem: Any, start: np.ndarray, *given: Any) -> Minimum:
        starts.append(start)
        if len(starts) - 1 in failing:
            raise SolverError(f"no rest {len(starts)}")
        found = search(problem, start, *given)
        return replace(found, objective=found.objective * (2.0 if len(starts) == 2 else 1.0))

    monkeypatch.setattr(graybox, "minimize", minimize)
    told: list[str] = []
    free = [*FREE, "delay"]
    found = fitted(noisy(), free=free, starts=6, spread=1.3, floor=0.0, progress=told.append)
    vector = ParameterVector(MODEL, free, start=BEGIN)
    away = np.array(starts) - vector.start
    assert not away[0].any() and not away[:, 2].any() and (away[1:6, :2] != 0.0).all()
    assert np.log(1.15) < np.abs(away).max() <= np.log(1.3)
    assert (found.starts, found.agreed) == (6, 5)  # the second one ended at twice the cost
    assert told[:6] == [f"start {k} of 6" for k in range(1, 7)]
    failing |= {len(starts) + 1}
    assert fitted(noisy(), starts=3, floor=0.0).starts == 2
    failing |= set(range(99))
    with pytest.raises(SolverError, match="no rest"):
        fitted(noisy(), starts=2)


@pytest.mark.parametrize(
    ("more", "status"),
    [({}, "MODEL_ERROR"), ({"floor": 0.0}, "FITTED"), ({"residual": "lls"}, "FITTED")],
)
def test_a_hidden_cause_makes_a_fit_of_noise_a_model_error(
    more: dict[str, Any], status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not where the model error is given, nor of logarithms."""
    cause = Cause("a spring", 0.9, 1.0)
    monkeypatch.setattr(graybox, "hidden_causes", lambda residuals, x: (cause,))
    found = fitted(noisy(), **more)
    assert found.status is FitStatus[status]
    assert found.causes == ((cause,) if status == "MODEL_ERROR" else ())


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, "fitted"),
        ({"converged": False, "bound": True}, "not_converged"),
        ({"bound": True, "cost": 3.0}, "at_bound"),
        ({"error": 1.01e-3}, "model_error"),
        ({"error": 0.99e-3, "cost": 1.99}, "fitted"),
        ({"cost": 2.01}, "model_error"),
        ({"cost": 2.01, "error": 0.99e-3}, "small_error"),
        ({"cost": 2.01, "error": 0.99e-3, "stated": True}, "model_error"),
        ({"warnings": (f"a {TRANSIENT} of 3 %",)}, "model_error"),
        ({"cost": 0.49}, "noise_too_large"),
        ({"cost": 0.49, "sd": 0.9e-7}, "fitted"),
        ({"cost": 0.51}, "fitted"),
    ],
)
def test_the_status_of_a_fit(changes: dict[str, Any], status: str) -> None:
    usual = {"converged": True, "bound": False, "cost": 1.0, "error": 0.0, "stated": False}
    given: dict[str, Any] = {**usual, "warnings": (), "sd": 1e-3, **changes}
    held = np.array([False, given["bound"]])
    fit = Minimum(np.zeros(2), 1.0, 1.0, np.eye(2), 2, given["converged"], held)
    data = replace(noisy(0.0, given["sd"]), warnings=given["warnings"])
    found = fit_status(fit, given["cost"], given["error"], data, given["stated"])
    assert found is FitStatus[status.upper()]


def test_directions_that_data_do_not_determine_are_told_in_words() -> None:
    """Deviations of logarithms, and of others over their prior: the largest entries first."""
    names = ["q1.stiffness", "q2.stiffness", "delay"]
    vector = ParameterVector(MODEL, names, priors={"delay": 4e-3})
    unit = np.diag([1.0, 1.0, 1 / 4e-3])
    strong = 0.5e6
    sd = 2 * WEAK

    def lines(diagonal: list[float], weak: np.ndarray | None = None) -> tuple[str, ...]:
        A = np.diag(diagonal)
        if weak is not None:
            other = np.array([weak[1], -weak[0], 0.0])
            A = A + strong * np.outer(other, other) + 0.5 / sd**2 * np.outer(weak, weak)
        return weak_directions(vector, unit @ A @ unit)

    part = f"(sd {100 * sd:.0f} %)"
    assert lines([strong] * 3) == ()
    assert lines([0.5 / sd**2, strong, strong]) == (
        f"q1.stiffness is not determined by the data {part}",
    )
    assert lines([strong, strong, 0.5 / sd**2]) == (f"delay is not determined by the data {part}",)
    assert lines([strong, strong, 0.5 / (0.99 * WEAK) ** 2]) == ()
    assert lines([0.5e-3, strong, strong])[0].endswith("(sd more than a factor of 10)")
    one = np.array([1.0, 0.5, 0.0]) / np.sqrt(1.25)
    assert lines([0.0, 0.0, strong], one) == (
        f"q1.stiffness, q2.stiffness can change together {part}",
    )
    against = np.array([-0.5, 1.0, 0.0]) / np.sqrt(1.25)
    assert lines([0.0, 0.0, strong], against) == (
        f"q2.stiffness can change together, and q1.stiffness against them {part}",
    )


def test_what_noise_of_torques_and_friction_hide_is_told() -> None:
    """Where the information of a number is enough, and its deviation with that noise is not."""
    robot = flexgen.read("planar5_nmp", overrides={
        "motor.m1.friction": {"type": "smooth", "viscous": 0.1, "coulomb": 0.5, "beta": 3.0},
    })  # fmt: skip
    names = ["q1.stiffness", "q2.stiffness", "q3.stiffness", "m1.viscous", "delay"]
    vector = ParameterVector(robot, names)
    formal = np.array([0.99, 0.5, 1.01, 1.5, 0.5]) * WEAK
    covariance = np.diag(np.array([1.01, 0.99, 2.0, 2.0, 2.0]) * WEAK) ** 2
    A = np.diag(0.5 / formal**2)
    transient = f"of a {TRANSIENT} in it"
    data = replace(noisy(), warnings=("one", transient))
    why = (
        "noise of the torques causes too much of the motion that shows them; excite with a "
        "higher speed"
    )
    coulomb = (
        "frequency responses do not tell m1.viscous from Coulomb friction: the values of the file "
        "are kept; refine with the experiment"
    )
    told = hidden_numbers(vector, data, A, covariance)
    assert told == (transient, f"not determined by the data: q1.stiffness: {why}", coulomb)
    fast = replace(data, warnings=(), speed_sd=np.array([[0.0, 0.1]] * 2))
    first = hidden_numbers(vector, fast, A, covariance)[0]
    assert first.startswith("the responses are not corrected for large motions: ")


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"spread": 0.999}, "spread: given 0.999, expected a number >= 1"),
        ({"floor": 1.0}, "floor: given 1.0, expected a part of |G| between 0 and 1"),
        ({"floor": -1e-9}, "floor: given -1e-09, expected a finite number >= 0 or None"),
        ({"free": ["acc.delay"]}, "free: given 'acc.delay', expected a sensor of the data: none"),
    ],
)
def test_settings_that_no_fit_can_have_are_refused(more: dict[str, Any], text: str) -> None:
    sensor = {"name": "acc", "type": "tracker", "unit": "m"}
    model = flexgen.read("planar5_nmp", overrides={"sensor": [sensor]})
    with pytest.raises(ArgumentError) as caught:
        flexgen.identify(model, noisy(), progress=False, **more)
    assert str(caught.value) == text
