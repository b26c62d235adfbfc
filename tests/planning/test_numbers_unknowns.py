"""Unknowns of plans and of DAEs: which are bound at rest, their sizes, where a search starts;
bounds of files.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.files import array_files, npz_files
from flexgen.base.files.npz_files import NpzError, read_npz
from flexgen.codegen.build import directory
from flexgen.dynamics.dae import strangeness_index
from flexgen.planning.learning import learn
from flexgen.planning.optimal import problem as problem_module
from flexgen.planning.optimal.problem import Parameter
from flexgen.planning.optimal.start import scales
from flexgen.planning.optimal.transcribe import Layout


def layout_of(problem: flexgen.PlanProblem) -> Layout:
    return Layout(
        tuple(problem.phases), tuple(parameter.symbol for parameter in problem.parameters)
    )


def test_a_plan_rests_at_the_ends_that_are_stated() -> None:
    """Two phases: the problem begins and ends at rest; the rest between them is stated once or
    twice alike.
    """
    problem = flexgen.plan_problem("planar5_nmp", mesh=4)
    model = problem.equations.model
    rests = problem._rests()
    assert [(number, where, s) for number, where, _, s in rests] == [
        (0, "start", None),
        (0, "end", None),
    ]
    assert (
        rests[0][2] is problem.y_start
        and rests[1][2] is problem.y_end
        and rests[0][2].shape == (model.dof,)
    )
    later = problem.then(0.5, mesh=3)
    assert [(number, where) for number, where, *_ in problem._rests()] == [
        (0, "start"),
        (1, "end"),
    ]
    middle = np.zeros(model.n_a)
    middle[list(model.i_g)] = [0.3, -0.9]
    problem.end_at(middle)
    assert [(number, where) for number, where, *_ in problem._rests()] == [
        (0, "start"),
        (0, "end"),
        (1, "end"),
    ]
    later.start_at(middle)
    assert len(problem._rests()) == 3
    problem.end_at(None)
    assert [(number, where) for number, where, *_ in problem._rests()] == [
        (0, "start"),
        (1, "start"),
        (1, "end"),
    ]
    problem.end_at(middle + 0.1)
    with pytest.raises(
        ArgumentError,
        match=r"^start_at: given another start of phase 1 than the end of phase 0; state ",
    ):
        problem._rests()
    free = flexgen.plan_problem("planar5_nmp", mesh=4, timing="free")
    assert [(number, where, s) for number, where, _, s in free._rests()] == [
        (0, "start", 0.0),
        (0, "end", 1.0),
    ]
    free.then(0.5, mesh=3)
    assert [(number, where, s) for number, where, _, s in free._rests()] == [
        (0, "start", 0.0),
        (1, "end", 1.0),
    ]
    free.end_at(middle)
    free.phases[1].start_at(None)
    assert [s for *_, s in free._rests()] == [0.0, None, 1.0]


@pytest.mark.parametrize("timing", ["given", "free"])
def test_bounds_of_a_plan_hold_it_at_rest_and_its_numbers_in_their_ranges(timing: Any) -> None:
    """Coordinates and speeds at both ends; in the middle the path parameter is free."""
    problem = flexgen.plan_problem("planar5_nmp", mesh=4, timing=timing)
    later = problem.then(0.5, mesh=3)
    later.free_time(0.2, 0.9)
    problem.parameter("mass", 1.0, 3.0, 2.0)
    middle = np.zeros(problem.equations.model.n_a)
    problem.end_at(middle)
    layout = layout_of(problem)
    rests = problem._rests()
    scale = np.linspace(1.0, 2.0, layout.size)
    low, high = (x * scale for x in problem._bounds(layout, scale, rests))
    n = problem.equations.model.dof
    y = np.concatenate([rests[0][2], [0.0] if timing == "free" else []])
    assert_allclose(low[layout.node(0, 0)], np.concatenate([y, 0 * y]), atol=1e-12)
    assert_allclose(high[layout.node(0, 0)], low[layout.node(0, 0)])
    end = layout.node(0, -1).reshape(2, -1)
    assert_allclose(low[end[:, :n]], [rests[1][2], 0 * rests[1][2]], atol=1e-12)
    assert np.isinf(low[end[:, n:]]).all() and end.shape[1] - n == (timing == "free")
    last = np.concatenate([rests[2][2], [1.0] if timing == "free" else []])
    assert_allclose(low[layout.node(1, 3)], np.concatenate([last, 0 * last]), atol=1e-12)
    T = problem.path.duration
    assert_allclose(low[layout.theta], [T, 0.2, 1.0])
    assert_allclose(high[layout.theta], [T, 0.9, 3.0])
    bound = np.isfinite(low)
    assert bound.sum() == 2 * (len(y) + n + len(last)) + 3 and np.isinf(high[~bound]).all()


def test_sizes_of_unknowns_follow_from_the_start() -> None:
    """Motors by their ratios, accelerations by a rate, torques by the largest of each, at least a
    part of all.
    """
    problem = flexgen.plan_problem("planar5_nmp", mesh=3)
    problem.parameter("mass", guess=-4.0)
    problem.parameter("small", guess=0.1)
    layout = layout_of(problem)
    mesh = problem.mesh
    model = problem.equations.model
    start = np.zeros(layout.size)
    tau = np.zeros((3 * mesh.s, model.n_m))
    tau[2, 0] = -6.0
    tau[4, 0] = 5.0
    n = mesh.n
    start[: mesh.size] = mesh.pack(
        np.zeros((4, 2 * n)), np.zeros((3, mesh.s, n)), tau.reshape(3, mesh.s, model.n_m)
    )
    found = scales(layout, problem.parameters, start)
    y, dy, ddy, torque = mesh.unpack(found[: mesh.size])
    ratio = np.abs(model.eta).max(axis=1)[list(model.i_m)]
    side = np.concatenate([np.ones(model.n_a), ratio])
    assert_allclose(y, np.tile(side, (4, 1)))
    assert_allclose(dy, y)
    assert_allclose(ddy, np.broadcast_to(ddy[0, 0, 0] * side, ddy.shape))
    assert_allclose(torque[..., 0], 6.0)
    assert 0.0 < torque[0, 0, 1] < 1.0 and np.ptp(torque[..., 1]) == 0.0
    assert_allclose(found[layout.theta], [problem.given_duration, 4.0, 1.0])
    assert problem.parameters[0] == Parameter(*vars(problem.parameters[0]).values())
    nothing = scales(layout, [], 0 * start)
    assert_allclose(mesh.unpack(nothing[: mesh.size])[3], 1e-6)


def test_a_free_time_is_clipped_into_its_bounds() -> None:
    problem = flexgen.plan_problem("planar5_nmp", mesh=3)
    T = problem.given_duration
    problem.free_time(0.5 * T, 0.8 * T)
    assert problem.given_duration == 0.8 * T and problem.duration_bounds == (0.5 * T, 0.8 * T)
    problem.free_time(1.0, 2.0, 1.5)
    assert problem.given_duration == 1.5
    problem.free_time(1.0, 1.0)
    assert problem.duration_bounds == (1.0, 1.0)
    for wrong in ((0.0, 1.0, None), (1.0, -2.0, None), (1.0, 2.0, 0.0)):
        with pytest.raises(
            ArgumentError, match=r"^free_time: given .*, expected a positive time in s$"
        ):
            problem.free_time(*wrong)
    with pytest.raises(
        ArgumentError,
        match=r"^free_time: given 2\.0 to 1\.0 s, expected a lower bound below the upper ",
    ):
        problem.free_time(2.0, 1.0)


# --- files ---------------------------------------------------------------------------------------
def test_a_file_of_arrays_has_at_most_a_thousand_of_them(tmp_path: Path) -> None:
    """And as many bytes as are allowed, packed and unpacked."""
    for count in (1000, 1001):
        file = tmp_path / f"{count}.npz"
        np.savez(file, **{f"a{k}": np.zeros(1, np.int8) for k in range(count)})
    assert len(read_npz(tmp_path / "1000.npz", 10**9)) == 1000
    with pytest.raises(NpzError, match=r"^given 1001 arrays, expected at most 1000$"):
        read_npz(tmp_path / "1001.npz", 10**9)
    file = tmp_path / "zeros.npz"
    np.savez_compressed(file, a=np.zeros(10_000, np.int8))
    with zipfile.ZipFile(file) as archive:
        size = archive.infolist()[0].file_size
    assert read_npz(file, size)["a"].shape == (10_000,)
    with pytest.raises(
        NpzError, match=rf"^given arrays of {size} bytes, expected at most {size - 1}$"
    ):
        read_npz(file, size - 1)
    packed = file.stat().st_size
    with pytest.raises(
        NpzError, match=rf"^given a file of {packed} bytes, expected at most {packed - 1}$"
    ):
        read_npz(file, packed - 1)
    assert (npz_files.MEMBERS, npz_files.DIRECTORY, npz_files.HEADER) == (1000, 10**6, 10**4)


def test_files_of_instances_are_as_large_as_half_a_gigabyte(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(array_files, "read_npz", lambda path, most: asked.append(most) or {})
    with pytest.raises(
        ArgumentError,
        match=r"^thing .*x\.npz: given a file with no text 'meta', expected the kind 'thi",
    ):
        array_files.load(tmp_path / "x.npz", "thing", ["a"])
    assert asked == [500_000_000]


def test_the_filter_of_learning_is_below_the_sampling_frequency(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And by default 0.7 of the lowest natural frequency, or of 10 Hz where there is none."""
    commanded: Any = SimpleNamespace(period=2e-3, time=np.zeros(1))
    reference = SimpleNamespace(points=lambda at: "motion")
    case = SimpleNamespace(reference=reference, model="m", equations=SimpleNamespace(model="m"))
    asked: list[float] = []

    def iterate(*given: Any) -> Any:
        asked.append(given[6])
        raise SolverError("enough")

    replaced = {
        "control_case": lambda *given, **more: case,
        "CommandedPath": lambda *given: commanded,
        "_iterate": iterate,
        "controller_of": lambda *given: ("law", "title"),
        "lowest_locked_hz": lambda model, motion: lowest,
    }
    for name, value in replaced.items():
        monkeypatch.setattr(learn, name, value)
    lowest: float | None = 20.0
    for hz in (None, 100.0, 224.9):
        with pytest.raises(SolverError, match=r"^enough$"):
            learn.learn("elbow", frequency_hz=hz, progress=False)
    lowest = None
    with pytest.raises(SolverError, match=r"^enough$"):
        learn.learn("elbow", progress=False)
    assert_allclose(asked, [14.0, 100.0, 224.9, 7.0])
    for wrong in (225.0, 0.0, -1.0):
        with pytest.raises(
            ArgumentError,
            match=rf"^frequency_hz: given {wrong}, expected more than 0, below 225 Hz$",
        ):
            learn.learn("elbow", frequency_hz=wrong, progress=False)
    with pytest.raises(ArgumentError, match=r"^iterations: given 1001, expected 1 to 1000$"):
        learn.learn("elbow", iterations=1001, progress=False)
    for gain in (0.0, 2.1):
        with pytest.raises(
            ArgumentError, match=rf"^gain: given {gain}, expected more than 0, at most 2$"
        ):
            learn.learn("elbow", gain=gain, progress=False)


@pytest.mark.parametrize(
    ("changes", "complete"),
    [
        ({}, True),
        ({"build": None}, True),
        ({"build": ...}, False),
        ({"files": {}}, True),
        ({"files": {"a.c": 1}}, False),
        ({"files": {"../a.c": "x"}}, False),
        ({"files": ["a.c"]}, False),
        ({"functions": {}}, False),
        ({"functions": [{"name": 1}]}, False),
        ({"functions": ["f"]}, False),
        ({"functions": []}, True),
        ({"digest": 3}, False),
        ({"build": {"library": "a.so"}}, False),
        ({"build": {"library": "a.so", "static": "../a.a"}}, False),
        ({"build": ["a.so", "a.a"]}, False),
    ],
)
def test_a_manifest_is_complete_with_what_is_read_of_it(
    changes: dict[str, Any], complete: bool
) -> None:
    manifest: dict[str, Any] = {
        "files": {"a.c": "abc", "src/b.c": "def"},
        "functions": [{"name": "f"}, {"name": "g"}],
        "digest": "x",
        "build": {"library": "liba.so", "static": "liba.a"},
    }
    manifest = {name: value for name, value in (manifest | changes).items() if value is not ...}
    assert directory._is_complete(manifest) is complete
    if complete:
        assert directory.libraries(manifest) == (
            ["liba.so", "liba.a"] if manifest["build"] else []
        )
    assert directory.libraries(None) == []


def test_the_search_of_a_plan_begins_at_the_scaled_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """And so does the check that all is finite there."""
    problem = flexgen.plan_problem("planar5_nmp", mesh=3)
    seen: list[np.ndarray] = []

    def solve_nlp(made: Any, x: np.ndarray, **given: Any) -> Any:
        seen.append(x)
        raise SolverError("enough")

    start = np.linspace(1.0, 2.0, layout_of(problem).size)
    monkeypatch.setattr(problem_module, "solve_nlp", solve_nlp)
    monkeypatch.setattr(problem_module, "check_finite", lambda made, x: seen.append(x))
    monkeypatch.setattr(problem, "_start", lambda layout, guess: start)
    with pytest.raises(SolverError, match=r"^enough$"):
        problem.solve(progress=False)
    expected = start / scales(layout_of(problem), [], start)
    assert len(seen) == 2
    assert_allclose(seen[0], expected)
    assert_allclose(seen[1], expected)


def test_files_of_a_library_are_marked_at_their_top(tmp_path: Path) -> None:
    """By the program and the name; a file that is not there is neither marked nor the same."""
    file = tmp_path / "arm.h"
    none = tmp_path / "none.h"
    file.write_bytes(b"/* arm: " + directory._MARK + b" */\n")
    assert directory._is_marked(file, "arm") is True and directory._is_marked(file, "leg") is False
    assert directory._is_marked(none, "arm") is False
    file.write_bytes(b" " * directory._HEAD + b"arm " + directory._MARK)
    assert directory._is_marked(file, "arm") is False
    assert (
        directory._has_bytes(file, file.read_bytes()) is True
        and directory._has_bytes(file, b"x") is False
    )
    assert directory._has_bytes(file, b"x" * file.stat().st_size) is False
    assert directory._has_bytes(none, b"") is False


@pytest.mark.parametrize(("orders", "found_at"), [([3], 3), ([3, 4, 5], 5), ([3, 4, 5, 6], 6)])
def test_the_strangeness_index_is_searched_until_all_points_have_one(
    orders: list[int], found_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the structural index on, up to the highest."""
    asked: list[int] = []

    def consistent(series: Any, reference: Any, instants: np.ndarray, order: int) -> Any:
        asked.append(order)
        return "x", [order, order]

    def characterize(F_x: Any, F_dx: Any, scale: int) -> Any:
        known = scale >= found_at and (F_x == 0 or found_at < 6)
        return SimpleNamespace(verdict="found" if known else "not found", order=scale)

    series = SimpleNamespace(jacobians=lambda x: ([0, 1], [0, 1]))
    replaced = {
        "TaylorArray": lambda dae: series,
        "InverseDae": lambda equations: None,
        "consistent": consistent,
        "characterize": characterize,
        "structural_index": lambda equations: SimpleNamespace(index=3),
    }
    for name, value in replaced.items():
        monkeypatch.setattr(strangeness_index, name, value)
    reference: Any = SimpleNamespace(duration=1.0)
    function: Any = strangeness_index.kunkel_mehrmann
    found = function(None, reference, [0.2, 0.4], highest=6)
    assert asked == orders and len(found) == 2 and found[0].order == orders[-1]
    for wrong in ([0.4, 0.2], [0.2, 0.2], [], [np.nan], [[0.1]]):
        with pytest.raises(
            ArgumentError, match=r"^times: given .*, expected rising instants in s$"
        ):
            function(None, reference, wrong)
