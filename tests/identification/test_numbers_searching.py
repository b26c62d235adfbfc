"""Fits of positions, causes of a misfit and limits: made-up problems, quadratic programs by all
active sets.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.causes import explain
from flexgen.identification.poses import fit as fitting
from flexgen.identification.poses.accuracy import accuracy_of
from flexgen.inversion.problem import limits

# --- fits of positions ---------------------------------------------------------------------------
POINTS = np.random.default_rng(4).uniform(-1.0, 1.0, (14, 2, 3))


class Rests:
    """Points that two angles turn and a number stretches, in place of a robot at rest."""

    tree = None
    touches = None

    def turned(self, x: np.ndarray) -> np.ndarray:
        c = np.cos(x[0])
        s = np.sin(x[0])
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0 + x[2]]])
        return POINTS @ R.T + [0.0, x[1], x[1] * x[2]]

    def rest(self, x: np.ndarray, near: Any = None) -> Any:
        if abs(x[0]) > 2.0:
            raise SolverError("no equilibrium")
        return SimpleNamespace(measured=self.turned(x), near=None)

    def slopes(self, x: np.ndarray, rest: Any, unknowns: Any) -> tuple[np.ndarray, None]:
        h = 1e-6
        return np.stack(
            [(self.turned(x + h * e) - self.turned(x - h * e)) / (2 * h) for e in np.eye(3)],
            axis=-1,
        ), None


def problem(
    monkeypatch: pytest.MonkeyPatch, measured: np.ndarray, robust: bool = True, **more: Any
) -> fitting.Poses:
    kinds = ("node", "node", "compliance")
    unknowns: Any = [
        SimpleNamespace(start=start, sd=sd, kind=kind, name=name)
        for start, sd, kind, name in zip(
            (0.0, 0.0, 0.1), (1.0, 2.0, 0.5), kinds, "abc", strict=True
        )
    ]
    monkeypatch.setattr(fitting.Poses, "numbers", lambda self, x: x)
    statics: Any = Rests()
    return fitting.Poses(statics, measured, unknowns, robust, **more)


@pytest.mark.parametrize("robust", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_fit_of_positions_is_the_minimum_of_its_objective(
    robust: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By another search, with the scale that the fit ends with; a gross error moves it less where
    the fit is robust.
    """
    true = np.array([0.4, -0.2, 0.3])
    noise = 1e-3 * np.random.default_rng(1).standard_normal(POINTS.shape)
    measured = Rests().turned(true) + noise
    measured[5, 0] += [0.2, 0.0, 0.0]
    measured[3, 1] = np.nan
    made = problem(monkeypatch, measured, robust)
    lines: list[str] = []
    found = fitting.fit(made, np.array([0.0, 0.0, 0.1]), progress=lines.append)
    assert (
        found.converged and lines[0].startswith("step 0: mean error ") and lines[0].endswith(" mm")
    )

    def objective(x: np.ndarray) -> float:
        return made.loss.value(made.residual(x), found.scale) + made.prior.value(x)

    best = minimize(
        objective,
        found.x,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000},
    )
    assert_allclose(found.x, best.x, atol=2e-5)
    assert np.isnan(found.errors[3, 1]) and np.isfinite(found.errors[3, 0])
    away = np.abs(found.x - true).max()
    assert (away < 1e-3) if robust else (2e-3 < away < 0.1), away
    lengths = np.linalg.norm(found.rest.measured - np.nan_to_num(measured), axis=2)
    valid = np.isfinite(measured).all(axis=2)
    assert_allclose(found.errors[valid], lengths[valid])
    assert found.scale == pytest.approx(np.median(lengths[valid]) / fitting.MEDIAN_LENGTH)
    sure = accuracy_of(made, found)
    sd = np.sqrt(np.diag(sure.covariance))
    assert (sd > 0).all() and not sure.pull.any()
    if robust:
        assert (np.abs(found.x - true) < 5 * sd).all() and sd.max() < 2e-3


def test_losses_are_squares_up_to_their_bend(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of lengths over the scale, or of whitened poses; what was not measured counts for
    nothing.
    """
    measured = Rests().turned(np.zeros(3))
    measured[0, 0] = np.nan
    gap = np.zeros(POINTS.shape)
    gap[1, 0] = [0.03, 0.0, 0.04]
    gap[2, 1] = [0.0, 0.5, 0.0]
    x = np.array([1.0, -2.0, 0.1])
    prior = 1.0 + 1.0
    plain, robust = (problem(monkeypatch, measured, kind) for kind in (False, True))
    r = gap.ravel()
    k = fitting.TUNING
    assert plain.loss.value(r, 0.1) == pytest.approx(0.5**2 + 5.0**2)
    assert 0.5 < k < 5.0
    assert robust.loss.value(r, 0.1) == pytest.approx(0.5**2 + 2 * k * 5.0 - k**2)
    assert plain.prior.value(x) == pytest.approx(prior)
    whitening = np.tile(10.0 * np.eye(6), (len(POINTS), 1, 1))
    white = problem(monkeypatch, measured, True, whitening=whitening)
    sizes = np.array([0.5, 5.0]) / np.sqrt(2)
    assert white.loss.value(10 * r, 1.0) == pytest.approx(
        2 * (sizes[0] ** 2 + 2 * k * sizes[1] - k**2)
    )
    assert_allclose(white.residual(x), 10 * plain.residual(x))
    assert plain.scale(np.full(plain.valid.shape, 0.2)) == pytest.approx(
        0.2 / fitting.MEDIAN_LENGTH
    )
    assert plain.scale(np.zeros(plain.valid.shape)) == fitting.SHARPEST
    assert plain.lower.tolist() == [-np.inf, -np.inf, fitting.LEAST * 0.1]
    lengths = plain.lengths(plain.rest(np.zeros(3)))
    assert not plain.residual(np.zeros(3)).any() and not lengths.any() and lengths.shape == (14, 2)


def test_slopes_of_an_objective_are_its_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = Rests().turned(np.array([0.4, -0.2, 0.3]))
    measured[5, 0] += [0.2, 0.0, 0.0]
    whitening = np.tile(np.diag([30.0, 20.0, 10.0, 5.0, 40.0, 15.0]), (len(POINTS), 1, 1))
    for more in ({}, {"whitening": whitening}):
        for robust in (False, True):
            made = problem(monkeypatch, measured, robust, **more)
            x = np.array([0.3, -0.1, 0.25])
            h = 1e-6
            here = made.linearize(x)
            central = [(here.cost(x + z) - here.cost(x - z)) / (2 * h) for z in h * np.eye(3)]
            assert_allclose(2 * here.slope, central, rtol=1e-5, atol=1e-4)
            assert here.rows.shape == (84, 3) and np.linalg.eigvalsh(here.matrix).min() > 0


def test_a_compliance_stays_at_its_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has no standard deviation, and is pulled beyond the bound."""
    measured = Rests().turned(np.array([0.1, 0.0, -0.05])) + 1e-4 * np.random.default_rng(
        0
    ).standard_normal(POINTS.shape)
    made = problem(monkeypatch, measured)
    found = fitting.fit(made, np.array([0.0, 0.0, 0.1]))
    sure = accuracy_of(made, found)
    assert found.x[2] == made.lower[2] and sure.covariance[2, 2] == 0.0 and sure.pull[2] < -1.0
    assert sure.pull[:2].tolist() == [0.0, 0.0] and (np.diag(sure.covariance)[:2] > 0).all()
    exact = problem(monkeypatch, Rests().turned(np.array([0.0, 0.0, 0.1])))
    ended = fitting.fit(exact, np.array([0.0, 0.0, 0.1]))
    assert ended.converged and np.array_equal(ended.x, [0.0, 0.0, 0.1])


# --- causes of a misfit --------------------------------------------------------------------------
def test_causes_are_named_by_the_part_that_they_explain(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best one from seven tenths on, and those within a twentieth; small faults are tried
    where none is gross.
    """
    # 99 degrees of freedom
    residuals: Any = SimpleNamespace(count=100, vector=[1, 2], data="data")
    best = SimpleNamespace(cost=1099.0, x=np.zeros(2))
    monkeypatch.setattr(explain, "_search", lambda residuals, x: best)
    monkeypatch.setattr(explain, "changes_of", lambda data: ["change"])
    costs: dict[str, float | Exception] = {}

    def refit(residuals: Any, hypothesis: str, x: np.ndarray) -> tuple[float, str, float]:
        cost = costs[hypothesis]
        if isinstance(cost, Exception):
            raise cost
        return cost, hypothesis, 2.0

    found: dict[str, list[str]] = {}
    monkeypatch.setattr(explain, "refit", refit)
    monkeypatch.setattr(explain, "_find_gross", lambda residuals, changes: found["gross"])
    monkeypatch.setattr(explain, "_find_small", lambda residuals, changes, x: found["small"])
    monkeypatch.setattr(explain, "_every_spring", lambda residuals: found["springs"])

    def shares(
        gross: dict[str, Any], small: dict[str, Any], **springs: float
    ) -> list[tuple[str, float]]:
        costs.clear()
        costs.update(gross | small | springs)
        found.update(gross=list(gross), small=list(small), springs=list(springs))
        return [
            (cause.words, round(cause.share, 3))
            for cause in explain.explain(residuals, np.zeros(2))
        ]

    assert shares({"a": 139.0}, {"b": 99.0}) == [("a", 0.96)]  # small ones are not tried
    assert shares({"a": 149.0}, {"b": 149.0, "c": 198.0, "d": 200.0}) == [
        ("a", 0.95),
        ("b", 0.95),
        ("c", 0.901),
    ]
    assert shares({}, {"a": 399.0, "b": 400.0}) == [("a", 0.7)]
    assert shares({}, {"a": 400.0}) == []
    assert shares({}, {"a": 0.0, "b": 2000.0}) == [("a", 1.0)]
    assert shares({"x": SolverError("no")}, {"y": ArgumentError("no"), "a": 99.0}) == [("a", 1.0)]
    assert shares({}, {"a": 199.0}, s=99.0) == [("s", 1.0)]  # springs where no step finds enough
    assert shares({}, {"a": 150.0}, s=99.0) == [("s", 1.0)]
    assert shares({}, {"s": 199.0}, s=199.0) == [("s", 0.9)]  # once
    assert shares({}, {"a": 148.0}, s=99.0) == [("a", 0.951)]
    assert str(explain.Cause("friction", 0.876, 1.0)) == "friction explains 88 % of the misfit"
    best.cost = 99.0
    assert shares({}, {"a": 0.0}) == []


def test_gross_faults_are_those_that_bring_the_responses_nearest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The three best of those that are nearer than the record as it is."""
    distances = {"data": 1.0, "a": 0.5, "b": 1.5, "c": 0.2, "d": 0.9, "e": 0.95, "f": 0.1}
    monkeypatch.setattr(explain, "_distance", lambda residuals, data, G: distances[data])

    def changed(name: str, gross: bool = True) -> Any:
        return SimpleNamespace(gross=gross, change=lambda data, factor: name, name=name)

    residuals: Any = SimpleNamespace(
        response=lambda x: SimpleNamespace(G="G"), vector=SimpleNamespace(start=0), data="data"
    )
    changes = [changed(name, name != "f") for name in "abcdef"]
    assert [change.name for change in explain._find_gross(residuals, changes)] == ["c", "a", "d"]


def test_a_score_is_the_decrease_by_the_best_step() -> None:
    rng = np.random.default_rng(2)
    J = rng.standard_normal((20, 3))
    r = rng.standard_normal(20)
    column = rng.standard_normal(20)
    basis = np.linalg.qr(J)[0]
    rest = r - basis @ (basis.T @ r)  # at the minimum in the other parameters
    whole = np.column_stack([J, column])
    left = rest - whole @ np.linalg.lstsq(whole, rest, rcond=None)[0]
    assert explain.score(basis, rest, column) == pytest.approx(rest @ rest - left @ left)
    # what the parameters do already
    assert explain.score(basis, rest, J @ [1.0, 2.0, -1.0]) == 0.0


def test_distances_of_responses_count_large_differences_alike() -> None:
    G = np.array([1.0 + 0j, 2.0, 4.0])
    data: Any = SimpleNamespace(G=G)
    residuals: Any = SimpleNamespace(
        on=lambda data: SimpleNamespace(variance=np.array([0.01, 0.0, 0.0]))
    )
    away = np.array([0.1, 0.6, 1e6])
    expected = np.mean(np.log1p([0.01 / (0.01 + 0.09), 0.36 / 0.36, 1e12 / 1.44]))
    assert explain._distance(residuals, data, G + away) == pytest.approx(expected)


# --- limits --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Result:
    """Result of an inversion with limits, with the attributes that the search reads."""

    t: Any
    details: dict[str, Any]
    preactuation: float = 0.0
    status: Any = None
    verdict: str = ""
    motors: Any = None
    tau_b: Any = None


@pytest.mark.parametrize(("memory", "active"), [(False, True), (True, True), (True, False)])
def test_limits_are_kept_by_another_path_where_they_are_active(
    memory: bool, active: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot with states is inverted with limits at any rate; where none is active its own motion
    remains.
    """
    found = SimpleNamespace(
        limits_active=active,
        deviation_m=2e-3,
        deviation_rad=0.04,
        programs=7,
        n_pre=10,
        period=0.01,
        name="found",
    )
    unlimited: Any = SimpleNamespace(name="unlimited")
    calls: list[str] = []

    class Bounds:
        def __init__(self, equations: Any, given: Any) -> None:
            calls.append(given)

        def are_kept(self, problem: Any, one: Any) -> bool:
            calls.append("asked")
            return kept

        def check_equilibrium(self, problem: Any) -> None:
            calls.append("rest")

    def result(one: Any) -> Result:
        calls.append(one.name)
        return Result(np.array([0.0, 1.0]), {"x": 1})

    for name, value in {
        "_Bounds": Bounds,
        "from_library": result,
        "_modify_path": lambda *given: (5, found),
        "memory_laws": lambda robot: ["hysteresis"] if memory else [],
        "bristled_motors": lambda robot: [],
        "reach": lambda equations: 0.02,
    }.items():
        monkeypatch.setattr(limits, name, value)
    problem: Any = SimpleNamespace(
        limits="limits",
        equations=SimpleNamespace(model=SimpleNamespace(output=SimpleNamespace(has_angle=False))),
        log=calls.append,
        path=SimpleNamespace(pose=True),
    )
    kept = False
    made: Any = limits.enforce_limits(problem, unlimited, 4, 1e-6)
    assert calls[0] == "limits" and ("asked" in calls) != memory and "rest" in calls
    if not active:
        assert calls[-1] == "unlimited" and made.verdict == ""
        return
    assert calls[-1] == "found" and made.status == flexgen.Status.LIMITS_ACTIVE
    assert_allclose(made.t, [-0.05, 0.95])
    assert made.preactuation == pytest.approx(0.15)
    assert (
        made.verdict
        == "the limits are active: path deviation up to 0.002 m and 0.04 rad, 7 quadratic programs"
    )
    assert made.details == {
        "x": 1,
        "deviation_max_m": 2e-3,
        "deviation_max_rad": 0.04,
        "programs": 7,
    }
    problem.path.pose = False
    found.deviation_m = found.deviation_rad = 0.0
    plain: Any = limits.enforce_limits(problem, unlimited, 4, 1e-6)
    assert plain.status == flexgen.Status.SOLVED and "up to 0 m, 7 quadratic" in plain.verdict
    for found.deviation_m, status in (
        (3e-8, flexgen.Status.LIMITS_ACTIVE),
        (1e-8, flexgen.Status.SOLVED),
    ):
        small: Any = limits.enforce_limits(problem, unlimited, 4, 1e-6)
        # 3e-8 m of a reach of 2 cm were noticed in the verification only, and refused
        assert small.status == status
    kept = True
    calls.clear()
    again: Any = limits.enforce_limits(problem, unlimited, 4, 1e-6)
    assert (calls[-1] == "unlimited") != memory and again.details["x"] == 1
