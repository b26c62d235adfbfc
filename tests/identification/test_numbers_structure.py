"""Structure search, validation and verdicts on exact or scripted data: each branch, by closed
forms.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from identification_cases import exact_responses, without_coulomb
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.time_domain import Validation
from flexgen.identification.responses import local_model, verdict
from flexgen.identification.responses import structure as searched
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import FitStatus, IdentificationResult
from flexgen.identification.responses.structure import Change, Structure
from flexgen.identification.rigid import missing_springs
from flexgen.inversion.judge.status import Status
from flexgen.model.elements import RobotModel

POSES = np.array([[0.2, 0.5], [0.6, -0.4], [-0.3, 0.9]])


def responses(model: RobotModel, lines: int, poses: int = 2) -> flexgen.Frf:
    w = 2 * np.pi * np.geomspace(3.0, 45.0, lines)
    return exact_responses(model, POSES[:poses], w, Drive(1e-3, 1e-3), 1e-2)


@pytest.mark.parametrize(("lines", "removed"), [(9, ()), (10, ("q3",))])
def test_a_stiff_spring_is_removed_from_ten_strong_evidence_on(
    lines: int, removed: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two numbers less are worth ``2 log(2 N)``, N = 8 per line: 9.94 of nine lines, 10.15 of ten;
    more than 10 counts.

    Shown to see: N, 2 N, the factor of n_p, the order of both fits, and the threshold.
    """
    monkeypatch.setattr(local_model, "FREQUENCIES", (35.0,))  # quicker
    model = without_coulomb("planar5_nmp")
    data = responses(missing_springs.without(model, "q3"), lines)
    given = missing_springs.with_spring(model, "q3", 1e9, 1e3)
    said: list[str] = []
    found = searched.structure(given, data, progress=said.append)
    assert found.removed == removed and found.added == ()
    tried = [
        *(f"add {name}" for name in ("q1_u", "q1_v", "q2_u", "q2_v", "arm3_x", "arm3_y")),
        "remove q3",
    ]
    assert said[:7] == [f"{words}: {k} of 7" for k, words in enumerate(tried, 1)]
    gain = next(change.gain for change in found.changes if change.name == "q3")
    assert gain == pytest.approx(2 * np.log(2 * 8 * lines), rel=1e-4)
    change = next(c for c in found.changes if c.name == "q3")
    assert change.kept == bool(removed) and change.held_out is None and change.kind == "remove"
    assert (
        found.model.n_e == (0 if removed else 1)
        and found.identified.vector.model.n_e == found.model.n_e
    )


def test_springs_are_changed_by_name_only() -> None:
    model = flexgen.read("planar5_nmp")
    stiff = missing_springs.with_spring(model, "q3", 123.0, 4.0)
    for before, after in zip(model.elements, stiff.elements, strict=True):
        for a, b in zip(before.dofs, after.dofs, strict=True):
            assert b == (replace(a, spring=b.spring, damping=4.0) if a.name == "q3" else a)
    assert [d.spring.stiffness for e in stiff.elements for d in e.dofs if d.name == "q3"] == [
        123.0
    ]
    names = [d.name for e in missing_springs.without(model, "q3").elements for d in e.dofs]
    assert names == ["q1", "q2"]
    now: Any = SimpleNamespace(vector=SimpleNamespace(model=missing_springs.without(model, "q3")))
    full: Any = SimpleNamespace(vector=SimpleNamespace(model=model))
    assert searched._removable(model, full, ()) == ["q3"]
    assert (
        searched._removable(model, full, ["q3"]) == []
        and searched._removable(model, now, ()) == []
    )
    data = responses(model, 3, 3)
    last = searched._part(data, slice(1, None))
    assert_allclose(last.poses, data.poses[1:])
    assert_allclose(last.G, data.G[1:])
    assert (
        last.total is None
        and searched._part(replace(data, total=data.variance), slice(0, 1)).total.shape[0] == 1
    )


def test_a_new_spring_is_searched_from_three_frequencies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stiffness ``J w^2`` and 3 % damping, J: inertia that the spring carries, all others
    stiff.
    """
    model = without_coulomb("elbow")
    data = responses(model, 3)
    dof, changed = next((d, m) for d, m in missing_springs.additions(model) if d.name == "q2_v")
    tried = []

    def fit(model: RobotModel, data: flexgen.Frf) -> Any:
        new = next(d for e in model.elements for d in e.dofs if d.name == dof.name)
        tried.append((new.spring.stiffness, new.damping))
        if len(tried) == 1:
            raise SolverError("none")
        return SimpleNamespace(
            cost=[9.0, 2.0, 1.0][len(tried) - 1],
            status=[None, "x", FitStatus.NOT_CONVERGED][len(tried) - 1],
        )

    monkeypatch.setattr(searched, "_fit", fit)
    best = searched._find_best(changed, dof.name, data)
    local = LocalModel(missing_springs.with_spring(changed, dof.name, 1e12, 1e6), ())
    inertia = local.matrices(local.values, data.poses[:1])[0][0][2, 2]
    w = 2 * np.pi * np.array([12.0, 35.0, 90.0])
    assert_allclose([k for k, _ in tried], inertia * w**2, rtol=1e-6)
    assert_allclose([d for _, d in tried], 2 * 0.03 * inertia * w, rtol=1e-6)
    # the first has no equilibrium, the third did not converge
    assert best is not None and best.cost == 2.0


def test_the_search_keeps_what_is_better_elsewhere_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scripted gains: the best change must also be better at poses that were held out; then it
    begins again.
    """
    model = without_coulomb("planar5_nmp")
    data = responses(model, 2)
    worth = {
        "": 100.0,
        "q1_u": 40.0,
        "q1_v": 60.0,
        "q2_u": 95.0,
        "q2_v": 101.0,
        "arm3_x": 96.0,
        "arm3_y": 97.0,
        "-q3": 85.0,
    }

    def fake(model: RobotModel, name: str) -> Any:
        return SimpleNamespace(vector=SimpleNamespace(model=model), model=model, name=name)

    def find(changed: RobotModel, new: str | None, _: flexgen.Frf) -> Any:
        return None if new == "q2_v" else fake(changed, new or "-q3")

    def hold_out(before: RobotModel, after: RobotModel, _: flexgen.Frf) -> float:
        names = [d.name for e in after.elements for d in e.dofs]
        return 1.0 if "q1_u" in names else 0.5 if "q1_v" in names else 0.2

    rounds = []

    def criterion(found: Any) -> float:
        if found.name == "":
            rounds.append(found)
        return worth[found.name]

    monkeypatch.setattr(searched, "_fit", lambda model, data: fake(model, ""))
    monkeypatch.setattr(searched, "_find_best", find)
    monkeypatch.setattr(searched, "_hold_out", hold_out)
    monkeypatch.setattr(searched, "criterion", criterion)
    monkeypatch.setattr(searched, "identify", lambda model, data, **_: fake(model, "final"))
    found = searched.structure(model, data)
    tried = {change.name: change for change in found.changes}
    assert found.added == ("q1_v",) and found.changes[0] == Change("add", "q1_v", 40.0, 0.5, True)
    assert "q1_u" not in tried or not tried["q1_u"].kept  # better by 60, and as bad at other poses
    assert all(not change.kept for change in found.changes[1:]) and "q2_v" not in tried
    assert [c.gain for c in found.changes[1:]] == sorted(
        (c.gain for c in found.changes[1:]), reverse=True
    )
    both = Structure(
        model, found.identified, (*found.changes, Change("remove", "q3", 20.0, None, True))
    )
    assert both.added == ("q1_v",) and both.removed == ("q3",)
    with pytest.raises(
        ArgumentError,
        match="structure: given data at one pose, expected two or more: some are held out",
    ):
        searched.structure(model, responses(model, 2, 1))


def test_costs_of_poses_that_were_held_out_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fitted at the first half, judged at the second one; exact models have no cost."""
    model = without_coulomb("planar5_nmp")
    data = responses(model, 4)
    wrong = missing_springs.without(model, "q3")
    assert (
        searched._hold_out(wrong, model, data)
        < 1e-6
        < 1e3
        < searched._hold_out(model, wrong, data)
    )
    asked = []

    def fit(model: RobotModel, part: flexgen.Frf) -> Any:
        asked.append(part.poses)
        raise SolverError("none")

    monkeypatch.setattr(searched, "_fit", fit)
    with np.errstate(invalid="ignore"):
        assert np.isnan(searched._hold_out(model, wrong, data))
    assert_allclose(asked, [data.poses[:1]] * 2)
    found: Any = SimpleNamespace(data=SimpleNamespace(G=np.zeros(50)), vector=range(4), cost=1.5)
    assert searched.criterion(found) == pytest.approx(2 * 1.5 * 48 + 4 * np.log(100))
    found.data.G = np.zeros(2)
    assert searched.criterion(found) == pytest.approx(2 * 1.5 * 1 + 4 * np.log(4))


def test_validation_compares_spectra_of_other_experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit in percent, mean square and whiteness of scripted residuals; which experiments are
    simulated.
    """
    rng = np.random.default_rng(0)
    r = rng.normal(size=(2, 40, 2)) + 1j * rng.normal(size=(2, 40, 2))
    r[:, :, 1] = np.cos(0.05 * np.arange(40))[None]  # not white
    sd = rng.uniform(0.1, 0.2, (1, 40, 2))
    measured = rng.normal(size=(2, 40, 2)) + 3j
    asked = []

    class Simulated:
        def __init__(self, vector: Any, experiment: Any, runs: Any, tell: Any) -> None:
            asked.append(runs)
            self.sd = sd
            self.measured = measured

        def use_noise(self, x: Any) -> None:
            asked.append("noise")

        def residual(self, x: Any) -> np.ndarray:
            return r

    monkeypatch.setattr(time_domain, "Simulated", Simulated)
    plan = SimpleNamespace(experiments=2, realizations=2, poses=np.zeros((2, 2)))
    found: Any = SimpleNamespace(vector=None, x=None)
    experiment: Any = SimpleNamespace(plan=plan)
    checked = time_domain.validate(found, experiment, used=1)
    assert asked == [[(0, 0, 1), (1, 1, 0)], "noise"]
    for j in range(2):
        away = np.sqrt(
            (np.abs(r[..., j] * sd[..., j]) ** 2).sum() / (np.abs(measured[..., j]) ** 2).sum()
        )
        assert checked.fit_percent[j] == pytest.approx(100 * (1 - away))
        power = (np.abs(r[..., j]) ** 2).sum()
        lags = [
            abs(sum((a[k:] * a[:-k].conj()).sum().real for a in r[..., j])) / power
            for k in range(1, 21)
        ]
        assert checked.white[j] == pytest.approx(np.mean(np.array(lags) < 2.58 / np.sqrt(2 * 80)))
    assert checked.white[0] > 0.85 > 0.5 > checked.white[1]
    assert checked.cost == pytest.approx((np.abs(r) ** 2).mean())
    time_domain.validate(found, experiment, used=3)
    assert asked[2] == [(0, 1, 1), (1, 0, 0)]
    with pytest.raises(
        ArgumentError, match="used: given 4, expected fewer than the 4 experiments at each pose"
    ):
        time_domain.validate(found, experiment, used=4)


def fitted(
    model: RobotModel, status: FitStatus = FitStatus.FITTED, **changes: Any
) -> IdentificationResult:
    """A result with scripted numbers."""
    vector = ParameterVector(
        model,
        ["q1.stiffness", "q2.stiffness", "q3.damping"],
        ties={"q3.stiffness": "q1.stiffness"},
    )
    covariance = np.diag([0.01, 0.04, 1.0]) + 0.012 * (np.eye(3)[::-1] - np.diag([0.0, 1.0, 0.0]))
    values: dict[str, Any] = {
        "vector": vector,
        "x": vector.start + np.array([0.1, -0.2, 0.3]),
        "formal_covariance": covariance,
        "status": status,
        "cost": 1.25,
        "model_error": 0.0,
        "starts": 3,
        "agreed": 2,
        "iterations": 5,
        "at_bound": (),
        "weak": (),
        "data": responses(model, 2),
        "variance": np.zeros(1),
        "deflection_sd": np.zeros((2, 0)),
        "weights": "nls",
        "wall_s": 0.0,
    }
    return IdentificationResult(**{**values, **changes})


@pytest.mark.parametrize(
    ("cost", "fit", "fails"), [(2.1, 99.8, True), (1.9, 99.8, False), (2.1, 99.95, False)]
)
def test_a_validation_fails_by_cost_and_by_percent(cost: float, fit: float, fails: bool) -> None:
    model = flexgen.read("planar5_nmp")
    for status in (FitStatus.FITTED, FitStatus.AT_BOUND):
        checked = Validation((fit, 100.0), cost, (1.0, 1.0))
        after = time_domain.validate_on_others(fitted(model, status), checked).status
        assert after == (
            FitStatus.POORLY_VALIDATED if fails and status == FitStatus.FITTED else status
        )


def test_frictions_of_a_refinement_are_those_of_the_file() -> None:
    model = flexgen.read("planar5_nmp")
    first, second = model.motors
    motors = (
        replace(first, friction=replace(first.friction, viscous=1.0, coulomb=2.0, beta=3.0)),
        replace(
            second,
            friction=replace(second.friction, viscous=0.0, coulomb=0.0, stribeck=0.0, beta=3.0),
        ),
    )
    other = replace(model, motors=motors)
    names = time_domain.frictions_of(fitted(other))
    joints = [name for name in names if name[0] == "q"]
    assert [name for name in names if name not in joints] == [
        "m1.viscous",
        "m1.coulomb",
        "m1.beta",
    ]


def test_figures_of_a_result_and_robots_drawn_from_it() -> None:
    """Weak parameters (sd of the logarithm above a half) keep the value of the file; the others
    have the covariance.
    """
    model = flexgen.read("planar5_nmp")
    found = fitted(model)
    assert (
        repr(found)
        == "<IdentificationResult planar5_nmp: fitted, 3 parameters, cost 1.25, 2 of 3 starts>"
    )
    assert [found.is_weak(name) for name in found.vector.names] == [False, False, True]
    at_edge = fitted(model, formal_covariance=np.diag([0.24, 0.26, 0.25]))
    assert [at_edge.is_weak(name) for name in at_edge.vector.names] == [False, True, False]
    sd = np.sqrt(np.diag(found.formal_covariance))
    assert_allclose(found.correlation, found.formal_covariance / sd[:, None] / sd)
    assert found.sd == pytest.approx(dict(zip(found.vector.names, sd, strict=True)))
    start = found.vector.start
    used = found.used()
    assert used == pytest.approx(
        {
            "q1.stiffness": np.exp(start[0] + 0.1),
            "q2.stiffness": np.exp(start[1] - 0.2),
            "q3.stiffness": found.vector._tied["q3.stiffness"] * np.exp(0.1),
        }
    )
    robots = verdict.draw_robots(found, 600, 3)
    drawn = np.array(
        [
            [c.dof.gear.spring.stiffness for c in r.coordinates if c.dof and c.dof.gear]
            for r in robots
        ]
    )
    logs = np.log(drawn) - found.x[:2]
    assert_allclose(np.cov(logs.T), np.diag([0.01, 0.04]), atol=0.004)
    assert np.abs(logs.mean(axis=0)).max() < 0.02
    dampings = {c.dof.damping for r in robots for c in r.coordinates if c.name == "q3" and c.dof}
    assert dampings == {c.dof.damping for c in model.coordinates if c.name == "q3" and c.dof}
    with pytest.raises(
        ArgumentError,
        match="given a result with the status model error, which has no covariance to draw",
    ):
        verdict.draw_robots(fitted(model, FitStatus.MODEL_ERROR), 1, 0)
    rows = {row["name"]: row for row in found.to_dict()["parameters"]}
    assert [row["weak"] for row in rows.values()] == [False, False, True] and rows["q1.stiffness"][
        "sd_is_relative"
    ]
    with pytest.warns(
        DeprecationWarning, match=r"given figures\(\), expected its new name, to_dict\(\)"
    ):
        assert found.figures() == found.to_dict()


def test_a_verdict_compares_four_torques(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which model and method make the torques, which robots they are sent to, and the largest
    errors of each.
    """
    model = flexgen.read("planar5_nmp")
    found = fitted(model)
    asked: list[tuple[float, str]] = []

    def stiffness(equations: Any) -> float:
        return float(equations.model.coordinates[0].dof.gear.spring.stiffness)

    def solve(equations: Any, move: Any, method: str) -> Any:
        asked.append((stiffness(equations), method))
        return SimpleNamespace(move=SimpleNamespace(name="line"), from_=stiffness(equations))

    def errors(robot: Any, before: Any, solution: Any, control: str) -> dict[str, float | None]:
        assert (
            stiffness(before) == stiffness(SimpleNamespace(model=model)) and control == "feedback"
        )
        return {"error_max_m": abs(stiffness(robot) - solution.from_), "error_max_rad": None}

    monkeypatch.setattr(verdict, "_solve", solve)
    monkeypatch.setattr(verdict, "tool_errors", errors)
    said: list[str] = []
    made = verdict.verdict(found, truth=found.model, progress=said.append)
    old = stiffness(SimpleNamespace(model=model))
    new = found.used()["q1.stiffness"]
    assert asked == [(old, "auto"), (new, "auto"), (new, "rigid"), (new, "fjm")]
    assert (
        made.known
        and made.robots == 1
        and made.move == "line"
        and said[1] == "model file: robot 1 of 1"
    )
    assert made["file"].error_m == (pytest.approx(new - old),) and made["identified"].error_m == (
        0.0,
    )
    assert made["file"].error_rad is None and made["file"].quantile(0.5, "rad") is None
    drawn = verdict.verdict(found, samples=3)
    assert not drawn.known and drawn.robots == 3 and len(drawn["fjm"].error_m) == 3
    row = verdict.VerdictRow("file", (1.0, 2.0, 4.0), (0.5, 0.5, 1.5))
    assert (
        row.quantile(0.5) == 2.0 and row.quantile(1.0) == 4.0 and row.quantile(0.75, "rad") == 1.0
    )
    table = verdict.Verdict(
        "line", "feedback", 3, False, (row, verdict.VerdictRow("fjm", None, None))
    )
    assert repr(table) == "<Verdict of line, feedback: file 2.0 m>"
    assert verdict._values([{"a": 1.0}, {"a": None}], "a") is None and verdict._values(
        [{"a": 1}], "a"
    ) == (1.0,)


def test_a_move_without_torques_has_no_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    equations: Any = SimpleNamespace(model=SimpleNamespace(name="robot"))
    for status in Status:
        solved = SimpleNamespace(status=status, move=SimpleNamespace(name="line"))
        asked = []
        monkeypatch.setattr(
            verdict, "solve", lambda *given, s=solved, a=asked, **more: a.append(more) or s
        )
        if status in (Status.SOLVED, Status.BASELINE, Status.LIMITS_EXCEEDED):
            assert verdict._solve(equations, None, "auto") is solved and asked[0]["verify"]
            verdict._solve(equations, None, "rigid")
            assert not asked[1]["verify"]
        else:
            with pytest.raises(SolverError, match=f"verdict: robot, line: {status}"):
                verdict._solve(equations, None, "auto")
