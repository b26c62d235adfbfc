"""The fit of responses with its residuals replaced: linear ones, whose fits, costs and decisions
are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.estimator.minimize import Minimum
from flexgen.identification.estimator.problem import Problem
from flexgen.identification.responses import graybox
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.result import FitStatus

FREE = ["q1.stiffness", "q2.damping"]


class Linear:
    """Residuals ``J (x - best) + rest`` whose least cost is `cost` for a degree of freedom;
    `steps`: what was asked.
    """

    def __init__(self, vector: ParameterVector, cost: float) -> None:
        rng = np.random.default_rng(5)
        self.vector = vector
        self.best = vector.start + np.array([0.3, -0.2])
        self.count = 41
        self.J = rng.normal(size=(40, 2)) + 1j * rng.normal(size=(40, 2))
        rest = rng.normal(size=40) + 1j * rng.normal(size=40)
        g = np.linalg.solve(np.real(self.J.conj().T @ self.J), np.real(self.J.conj().T @ rest))
        rest = rest - self.J @ g  # no part of it can be fitted
        self.rest = rest * np.sqrt(40 * cost) / np.linalg.norm(rest)
        self.steps: list[str] = []
        self.local = Made(springs=())
        self.variance = np.ones(1)
        self.deflection_sd = np.zeros(1)
        self.kind = "nls"

    def cost(self, x: np.ndarray) -> float:
        return float((np.abs(self.J @ (x - self.best) + self.rest) ** 2).sum())

    def sums(self, x: np.ndarray) -> Any:
        r = self.J @ (x - self.best) + self.rest
        return self.cost(x), np.real(self.J.conj().T @ r), np.real(self.J.conj().T @ self.J)

    @property
    def problem(self) -> Problem:
        return self.vector.problem(self.sums, self.cost)

    def average_springs(self, x: np.ndarray) -> None:
        self.steps.append("springs")

    def on(self, data: Any, floor: float = 0.0) -> Linear:
        self.steps.append(f"on {data.name}")
        return self

    def find_unexplained(self, x: np.ndarray) -> float:
        return 0.07

    def covariance(self, x: np.ndarray, A: np.ndarray) -> np.ndarray:
        return np.diag([4.0, 9.0])


def data_of(name: str, total: Any = None, noise_UU: Any = None) -> Any:
    return Made(
        name=name,
        sensors=(),
        warnings=(),
        relative_sd=lambda: 1e-3,
        total=total,
        noise_UU=noise_UU,
        G=None,
    )


def fitted(
    monkeypatch: pytest.MonkeyPatch,
    cost: float,
    springs: Sequence[str] = (),
    unsure: float | None = None,
    told: Any = None,
    starts: int = 1,
    hidden: tuple[str, ...] = (),
    **more: Any,
) -> tuple[Any, Linear]:
    """The result of responses whose residuals have a given cost."""
    vector = ParameterVector(flexgen.read("elbow"), FREE)
    linear = Linear(vector, cost)
    linear.local.springs = springs
    monkeypatch.setattr(graybox, "Residuals", lambda *given, **named: linear)
    monkeypatch.setattr(
        graybox, "obstacle", lambda data: "" if unsure is not None else "no amplitudes"
    )
    monkeypatch.setattr(graybox, "correct_responses", lambda r, x: (data_of("corrected"), unsure))
    monkeypatch.setattr(graybox, "find_shift", lambda r, x, A, G: np.array([0.5, -1.0]))
    monkeypatch.setattr(graybox, "explain", lambda r, x: ("a cause",))
    monkeypatch.setattr(graybox, "hidden_causes", lambda r, x: hidden)
    monkeypatch.setattr(graybox, "IdentificationResult", Made)
    monkeypatch.setattr(graybox, "_grade", lambda residuals, x, data: (x.tolist(), data.name))
    monkeypatch.setattr(graybox, "_report_hidden", lambda *given: ("hidden",))
    given: dict[str, Any] = {
        "data": data_of("measured"),
        "residual": "nls",
        "structured": False,
        "floor": None,
    } | more
    found = graybox._fit(vector, **given, starts=(starts, 1.2, 7), tell=told)
    return found, linear


def test_a_fit_of_noise_is_the_least_squares_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its prior; its cost counts complex residuals less half of the real parameters."""
    found, linear = fitted(monkeypatch, 1.0, starts=3)
    A = np.real(linear.J.conj().T @ linear.J)
    vector = found.vector
    away = np.linalg.solve(A + np.diag(vector.prior_sd**-2.0), A @ (linear.best - vector.start))
    assert_allclose(found.x, vector.start + away, rtol=0, atol=1e-5)
    assert found.cost == linear.cost(found.x) / 40.0 == pytest.approx(1.0, rel=2e-3)
    assert (found.status, found.model_error, found.starts, found.agreed) == (
        FitStatus.FITTED,
        0.0,
        3,
        3,
    )
    assert_allclose(found.formal_covariance, np.diag([4.0, 9.0]))
    assert found.grade == (found.x.tolist(), "measured")
    assert (
        found.weak == ("hidden",)
        and found.causes == ()
        and found.at_bound == ()
        and 0 < found.wall_s < 60
    )
    assert linear.steps == ["springs"] and found.weights == "nls" and found.iterations >= 2


def test_a_hidden_cause_makes_a_fit_of_noise_a_model_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not where the model error is given, nor of logarithms."""
    found, _ = fitted(monkeypatch, 1.0, hidden=("a spring",))
    assert (
        found.status is FitStatus.MODEL_ERROR
        and found.causes == ("a spring",)
        and found.model_error == 0.0
    )
    for given in ({"floor": 0.0}, {"residual": "lls"}):
        found, _ = fitted(monkeypatch, 1.0, hidden=("a spring",), **given)
        assert found.status is FitStatus.FITTED and found.causes == ()


def test_a_fit_averages_springs_and_corrects_large_motions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Springs three times after the first; what the correction leaves unsure widens the
    covariance.
    """
    told: list[str] = []
    found, linear = fitted(monkeypatch, 1.0, springs=("q1",), unsure=2.0, told=told.append)
    assert linear.steps == ["springs"] * 4 + ["on corrected"]
    assert told == ["start 1 of 1", "correction for large motions"]
    assert_allclose(found.formal_covariance, np.array([[4.0 + 1.0, -2.0], [-2.0, 9.0 + 4.0]]))
    sure, _ = fitted(monkeypatch, 1.0, unsure=0.0)
    assert_allclose(sure.formal_covariance, np.diag([4.0, 9.0]))


@pytest.mark.parametrize(
    ("cost", "floor", "residual", "found_error", "asked", "error", "status", "causes"),
    [
        (1.99, None, "nls", 0.02, False, 0.0, FitStatus.FITTED, False),  # a cost below 2
        (2.01, None, "nls", 0.02, True, 0.02, FitStatus.MODEL_ERROR, True),
        # a small one: what is unexplained
        (2.01, None, "nls", 1e-3, True, 0.07, FitStatus.MODEL_ERROR, True),
        (2.01, None, "lls", 0.02, True, 0.02, FitStatus.MODEL_ERROR, False),
        (2.01, 0.03, "nls", 0.02, False, 0.03, FitStatus.MODEL_ERROR, False),
        (0.51, None, "nls", 0.02, False, 0.0, FitStatus.FITTED, False),
        (0.49, None, "nls", 0.02, False, 0.0, FitStatus.NOISE_TOO_LARGE, False),
    ],
)
def test_a_model_error_is_searched_where_noise_does_not_explain_the_cost(
    monkeypatch: pytest.MonkeyPatch,
    cost: float,
    floor: float | None,
    residual: str,
    found_error: float,
    asked: bool,
    error: float,
    status: FitStatus,
    causes: bool,
) -> None:
    """And causes where the errors are not given; costs of 0.5 to 2 are those of noise."""
    degrees: list[float] = []

    def with_error(
        vector: Any, data: Any, residuals: Any, best: Minimum, count: float, tell: Any
    ) -> Any:
        degrees.append(count)
        return found_error, residuals, best

    monkeypatch.setattr(graybox, "_with_model_error", with_error)
    found, _ = fitted(monkeypatch, cost, floor=floor, residual=residual)
    assert degrees == ([40.0] if asked else []) and (found.model_error, found.status) == (
        error,
        status,
    )
    assert found.causes == (("a cause",) if causes else ())


@pytest.mark.parametrize(
    ("cost", "total", "noise_UU", "left", "asked", "error"),
    [
        (1.0, None, 1, 5e-3, True, 5e-3),
        (1.0, None, None, 5e-3, True, 0.0),
        (1.0, None, 1, 1e-3, True, 0.0),
        (1.0, 1, 1, 5e-3, False, 0.0),
        (1.99, None, 1, 5e-3, True, 5e-3),
        (0.51, None, 1, 5e-3, True, 5e-3),
        (0.49, None, 1, 5e-3, False, 0.0),
    ],
)
def test_structured_weights_end_a_fit_that_noise_explains(
    monkeypatch: pytest.MonkeyPatch,
    cost: float,
    total: Any,
    noise_UU: Any,
    left: float,
    asked: bool,
    error: float,
) -> None:
    """Of which the rest is a model error only where the noise of the torques is known."""
    calls: list[float] = []

    def with_structure(vector: Any, data: Any, residuals: Any, best: Minimum, count: float) -> Any:
        calls.append(count)
        return residuals, replace(best, cost=48.0), left

    monkeypatch.setattr(graybox, "_with_structure", with_structure)
    data = data_of("measured", total, noise_UU)
    found, _ = fitted(monkeypatch, cost, structured=True, data=data)
    assert calls == [40.0] * asked and found.model_error == error and (found.cost == 1.2) == asked
    assert fitted(monkeypatch, cost, structured=True, floor=0.02, data=data)[0].model_error == 0.02


def fit_with(x: np.ndarray, objective: float) -> Minimum:
    return Minimum(x, 40.0, objective, np.eye(len(x)), 2, True, np.zeros(len(x), bool))


def test_starts_agree_within_a_thousandth(monkeypatch: pytest.MonkeyPatch) -> None:
    """The result is the best of them."""
    start = ParameterVector(flexgen.read("elbow"), FREE).start
    objectives = (50.049, 50.0, 50.051, 60.0)
    fits = [fit_with(start + k, value) for k, value in enumerate(objectives)]
    monkeypatch.setattr(graybox, "_searches", lambda *given: fits)
    found, _ = fitted(monkeypatch, 1.0)
    assert (found.starts, found.agreed) == (4, 2)
    assert_allclose(found.x, start + 1)
    # all but zero: within 1e-9 for each degree of freedom
    for more, agreed in ((4.11e-8, 1), (4.09e-8, 2)):
        fits[1:3] = [fit_with(start, 1e-9), fit_with(start, more)]
        assert fitted(monkeypatch, 1.0)[0].agreed == agreed


def test_starts_are_drawn_within_the_spread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of numbers with a logarithm only; those without a solution are left out."""
    vector = ParameterVector(flexgen.read("elbow"), ["q1.stiffness", "delay"])
    log = np.array([u.scale == "log" for u in vector.unknowns])
    starts: list[np.ndarray] = []
    failing = {2}

    def search(residuals: Any, start: np.ndarray) -> Any:
        starts.append(start)
        if len(starts) - 1 in failing:
            raise SolverError(f"no rest {len(starts)}")
        return len(starts)

    monkeypatch.setattr(graybox, "_search", search)
    assert graybox._searches(vector, None, 4, 1.3, 3, None) == [1, 2, 4]  # type: ignore[arg-type]
    rng = np.random.default_rng(3)
    drawn = [np.zeros(2), *(rng.uniform(-1, 1, 2) * np.log(1.3) * log for _ in range(3))]
    assert log.tolist() == [True, False] and np.abs(drawn[1][0]) > 0
    assert_allclose(np.array(starts) - vector.start, drawn)
    failing |= set(range(20))
    with pytest.raises(SolverError, match="no rest 6"):
        graybox._searches(vector, None, 2, 1.3, 3, None)  # type: ignore[arg-type]


def test_a_delay_needs_its_sensor_in_the_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal names those that are there."""
    sensors = [Made(name=name, channels=(f"{name}.x", f"{name}.y")) for name in ("acc", "imu")]
    vector: Any = Made(model=Made(sensors=sensors), names=("q1.stiffness", "acc.delay"))
    data = Made(sensors=("imu.y",))
    told = "free: given 'acc.delay', expected a sensor of the data: imu"
    with pytest.raises(ArgumentError) as refused:
        graybox._fit(vector, data, "nls", True, None, (1, 1.2, 0), None)  # type: ignore[arg-type]
    assert str(refused.value) == told
    with pytest.raises(ArgumentError, match="a sensor of the data: none"):
        graybox._fit(vector, Made(sensors=()), "nls", True, None, (1, 1.2, 0), None)


def test_a_part_of_the_response_makes_the_cost_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then the part of each element by itself, four times."""
    G = np.full((1, 40, 1, 1), 3.0 + 0j)
    noise = np.full((1, 40, 1, 1), 0.01)
    on: list[Any] = []

    class Residuals:
        variance = noise

        def response(self, x: np.ndarray) -> Any:
            return Made(G=G * (1 + x[0]))

        def on(self, data: Any, floor: float = 0.0, extra: Any = 0.0) -> Residuals:
            on.append((floor, extra))
            return self

    told: list[str] = []
    monkeypatch.setattr(graybox, "_search", lambda residuals, x: fit_with(x / 2, 1.0))
    best = fit_with(np.array([0.2]), 1.0)
    data: Any = Made(G=G)
    error, _, last = graybox._with_model_error(None, data, Residuals(), best, 40.0, told.append)
    # difference 0.36 each: 40 x 0.36 / (0.01 + e^2 9) = 40
    assert on[0][0] == pytest.approx(np.sqrt((0.36 - 0.01) / 9), rel=1e-12)
    differences = [(0.6 / 2 ** (k + 1)) ** 2 for k in range(4)]
    extras = [max(d - 0.01, 0.0) for d in differences]
    for (floor, extra), expected in zip(on[1:], extras, strict=True):
        assert floor == 0.0
        assert_allclose(extra, np.full((1, 40, 1, 1), expected), atol=1e-15)
    assert error == np.sqrt(extras[-1] / 9) == 0.0 and last.x == pytest.approx([0.2 / 32])
    assert (
        told[0] == f"model error {100 * np.sqrt(extras[0] / 9):.2g} % of the responses, fit 1 of 4"
    )
    assert len(told) == 4


def test_structured_weights_are_left_where_they_explain_less(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They are polished twice; a misfit above twice the count returns what was before."""
    made: list[Any] = []

    class Polish:
        count = 20.0
        misfit_of = 0.0

        def __init__(self, *given: Any, deflection_sd: Any) -> None:
            self.at: list[float] = []
            made.append((self, deflection_sd))

        def use_structure(self, x: np.ndarray) -> None:
            self.at.append(float(x[0]))

        def misfit(self, x: np.ndarray) -> float:
            return self.misfit_of

        def find_unexplained(self, x: np.ndarray) -> float:
            return 0.01 * float(x[0])

    monkeypatch.setattr(graybox, "Residuals", Polish)
    monkeypatch.setattr(graybox, "_search", lambda residuals, x: fit_with(x + 1.0, 1.0))
    before = fit_with(np.array([1.0]), 1.0)
    plain = Made(count=40.0, deflection_sd="sd")
    for misfit, kept in ((39.9, False), (40.1, True)):  # times 40 / 20, against 2 x 40
        Polish.misfit_of = misfit
        residuals, best, left = graybox._with_structure(None, None, plain, before, 40.0)
        polish, sd = made[-1]
        assert sd == "sd" and polish.at == [1.0, 2.0] and left == pytest.approx(0.03)
        assert (residuals is plain and best is before) == kept
        if not kept:
            assert residuals is polish and best.x == 3.0 and best.cost == pytest.approx(2 * misfit)


def test_a_fit_refuses_data_and_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motors of another robot, unknown residuals, spreads below one and floors of the whole
    response.
    """
    model = flexgen.read("elbow")
    names = tuple(motor.name for motor in model.motors)
    data: Any = Made(motors=names)

    def told(data: Any = data, residual: str = "nls", floor: Any = None, spread: Any = 1.5) -> str:
        with pytest.raises(ArgumentError) as refused:
            graybox._check(model, data, residual, floor, 1, spread)
        return str(refused.value)

    graybox._check(model, data, "lls", 0.0, 1, 1.0)
    graybox._check(model, data, "nls", 0.999, 1, 1.5)
    order = f"expected {', '.join(names)} in this order, those of elbow"
    assert (
        told(Made(motors=names[::-1]))
        == f"data: given the motors {', '.join(names[::-1])}, {order}"
    )
    assert told(residual="l1") == "residual: given 'l1', expected one of nls, lls"
    assert told(spread=0.999) == "spread: given 0.999, expected a number >= 1"
    assert told(spread=np.nan).endswith("expected a number >= 1") and "expected a number" in told(
        spread="2"
    )
    for floor in (1.0, -1e-9, np.nan):
        assert (
            told(floor=floor) == f"floor: given {floor!r}, expected a part of |G| between 0 and 1"
        )


def test_what_noise_of_torques_hides_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the information of a number is enough, and its deviation with that noise is not."""
    weak = graybox.WEAK
    unknowns = [
        Made(name=name, scale=scale)
        for name, scale in (("a", "log"), ("b", "log"), ("c", "log"), ("d", "unit"))
    ]
    vector: Any = Made(unknowns=unknowns, names=("a", "b", "c", "d"), model=None)
    monkeypatch.setattr(graybox, "with_coulomb", lambda model: ["b", "e"])
    monkeypatch.setattr(graybox, "obstacle", lambda data: data.obstacle)
    data: Any = Made(
        warnings=("one", f"of a {graybox.TRANSIENT} in it"), speed_sd=np.zeros(2), obstacle="a law"
    )
    formal = np.array([0.99, 0.5, 1.01, 0.5]) * weak
    covariance = np.diag(np.array([1.01, 0.99, 2.0, 2.0]) * weak) ** 2
    told = graybox._report_hidden(vector, data, np.diag(0.5 / formal**2), covariance)
    why = (
        "noise of the torques causes too much of the motion that shows them; excite with a "
        "higher speed"
    )
    coulomb = (
        "frequency responses do not tell b from Coulomb friction: the values of the file are "
        "kept; refine with the experiment"
    )
    assert told == (data.warnings[1], f"not determined by the data: a: {why}", coulomb)
    data.speed_sd = np.array([0.0, 0.1])
    large = "the responses are not corrected for large motions: a law"
    assert graybox._report_hidden(vector, data, np.eye(4), 0 * covariance) == (
        data.warnings[1],
        large,
        coulomb,
    )
    data.obstacle = ""
    assert graybox._report_hidden(vector, data, np.eye(4), 0 * covariance) == (
        data.warnings[1],
        coulomb,
    )
