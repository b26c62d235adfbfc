"""Structure search and verdicts: each branch on exact responses or scripted solutions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from identification_cases import exact_responses, without_coulomb
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.responses import local_model, verdict
from flexgen.identification.responses import structure as searched
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import FitStatus, IdentificationResult
from flexgen.identification.responses.structure import criterion, structure
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
    """
    monkeypatch.setattr(local_model, "FREQUENCIES", (35.0,))  # quicker
    model = without_coulomb("planar5_nmp")
    data = responses(missing_springs.without(model, "q3"), lines)
    given = missing_springs.with_spring(model, "q3", 1e9, 1e3)
    said: list[str] = []
    found = structure(given, data, progress=said.append)
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
    springs = [d.spring for e in stiff.elements for d in e.dofs if d.name == "q3"]
    assert [spring.stiffness for spring in springs] == [123.0]
    names = [d.name for e in missing_springs.without(model, "q3").elements for d in e.dofs]
    assert names == ["q1", "q2"]


def test_a_missing_spring_is_added_where_it_is_better_at_other_poses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(local_model, "FREQUENCIES", (35.0,))  # quicker
    model = without_coulomb("planar5_nmp")
    lacks = missing_springs.without(model, "q3")
    data = responses(model, 4, 3)
    found = structure(lacks, data)
    first, *others = found.changes
    assert found.added == ("arm3_z",) and found.removed == () and found.model.n_e == 1
    assert (first.kind, first.name, first.kept) == ("add", "arm3_z", True)
    assert first.gain > 500 and first.held_out is not None and first.held_out < 1e-2
    gains = [change.gain for change in others]
    assert gains == sorted(gains, reverse=True) and not any(change.kept for change in others)
    assert found.identified.vector.model.n_e == 1


def test_springs_that_are_fixed_stay_and_one_pose_is_not_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(searched, "additions", lambda model: [])
    model = without_coulomb("planar5_nmp")
    data = responses(missing_springs.without(model, "q3"), 10)
    stiff = missing_springs.with_spring(model, "q3", 1e9, 1e3)
    assert structure(stiff, data, fixed=["q3"]).changes == ()
    with pytest.raises(ArgumentError, match="given data at one pose, expected two or more"):
        structure(model, responses(model, 2, 1))


def test_the_criterion_counts_residuals_and_parameters() -> None:
    found = fitted(without_coulomb("planar5_nmp"))
    N = found.data.G.size
    assert criterion(found) == pytest.approx(2 * 1.25 * (N - 1.5) + 3 * np.log(2 * N))
    few = replace(found, data=replace(found.data, G=found.data.G.reshape(-1)[:2]))
    assert criterion(few) == pytest.approx(2 * 1.25 * 1.0 + 3 * np.log(4))


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
    springs = {p.name: p.value for p in select(model, ["stiffness"])}
    assert used == pytest.approx(
        {
            "q1.stiffness": np.exp(start[0] + 0.1),
            "q2.stiffness": np.exp(start[1] - 0.2),
            "q3.stiffness": springs["q3.stiffness"] * np.exp(0.1),
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

    def solve(equations: Any, move: Any, method: str, **more: Any) -> Any:
        asked.append((stiffness(equations), method))
        assert more["verify"] == (method == "auto")
        moved = {"move": SimpleNamespace(name="line"), "status": Status.SOLVED}
        return SimpleNamespace(**moved, from_=stiffness(equations))

    def errors(robot: Any, before: Any, solution: Any, control: str) -> dict[str, float | None]:
        assert (
            stiffness(before) == stiffness(SimpleNamespace(model=model)) and control == "feedback"
        )
        return {"error_max_m": abs(stiffness(robot) - solution.from_), "error_max_rad": None}

    monkeypatch.setattr(verdict, "solve", solve)
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


@pytest.mark.parametrize("status", Status)
def test_a_move_without_torques_has_no_verdict(
    status: Status, monkeypatch: pytest.MonkeyPatch
) -> None:
    solved = SimpleNamespace(status=status, move=SimpleNamespace(name="line"))
    errors = {"error_max_m": 1.0, "error_max_rad": None}
    monkeypatch.setattr(verdict, "solve", lambda *given, **more: solved)
    monkeypatch.setattr(verdict, "tool_errors", lambda *given: errors)
    model = flexgen.read("planar5_nmp")
    if status in (Status.SOLVED, Status.BASELINE, Status.LIMITS_EXCEEDED):
        assert verdict.verdict(fitted(model), truth=model)["fjm"].error_m == (1.0,)
        return
    with pytest.raises(SolverError, match=f"verdict: planar5_nmp, line: {status}"):
        verdict.verdict(fitted(model), truth=model)


def test_a_written_file_has_the_covariance_of_relative_errors(tmp_path: Path) -> None:
    """Of logarithms as they are, of others over their values; tied numbers as theirs."""
    model = flexgen.read("planar5_nmp")
    names = ["q1.stiffness", "arm2.com_x", "delay"]
    vector = ParameterVector(model, names, ties={"q2.stiffness": "q1.stiffness"})
    root = np.array([[0.02, 0.0, 0.0], [1e-3, 2e-3, 0.0], [1e-5, 0.0, 1e-5]])
    covariance = root @ root.T
    found = fitted(model, vector=vector, x=vector.start, formal_covariance=covariance)
    kept = flexgen.read(found.write(tmp_path / "new.toml")).uncertainty
    assert kept is not None
    assert tuple(kept.parameters) == ("q1.stiffness", "q2.stiffness", "arm2.com_x")
    place = model.elements[1].body.com[0]
    slopes = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1 / place, 0.0]])
    expected = slopes @ covariance @ slopes.T
    sd = np.sqrt(np.diag(expected))
    assert_allclose(kept.sd, sd, rtol=1e-3)
    assert_allclose(kept.correlation, (expected / np.outer(sd, sd)).ravel(), atol=2e-3)


def test_structures_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file without the spring becomes one with it and the numbers of the fit; a variant that has
    numbers of the same element is refused.
    """
    monkeypatch.setattr(local_model, "FREQUENCIES", (35.0,))  # quicker
    model = without_coulomb("planar5_nmp")
    text = Path(model.file).read_text(encoding="utf-8")
    lines = text.partition("[variant.soft]")[0].splitlines()
    third = lines.index('name = "q3"') - 1
    end = next(k for k in range(third + 1, len(lines)) if lines[k].startswith("["))
    file = tmp_path / "lacks.toml"
    file.write_text("\n".join(lines[:third] + lines[end:]), encoding="utf-8")
    found = structure(file, responses(model, 4, 3))
    assert found.added == ("arm3_z",)
    again = flexgen.read(f"{found.write(tmp_path / 'found.toml')}@identified")
    springs = {d.name: d.spring for e in again.elements for d in e.dofs if d.spring is not None}
    fitted = found.identified.vector.named(found.identified.x)
    assert springs["arm3_z"].stiffness == pytest.approx(fitted["arm3_z.stiffness"])
    (true,) = [d.spring for e in model.elements for d in e.dofs if d.name == "q3"]
    assert springs["arm3_z"].stiffness == pytest.approx(true.stiffness, rel=0.02)
