"""Starts of plans: guesses of solutions, and rows that hold where the arm rests."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.planning.fastest.time_search import TimeSearch
from flexgen.planning.optimal import start
from flexgen.planning.optimal.guesses import from_solution


def test_a_guess_is_the_motion_of_a_solution() -> None:
    """From the beginning of its path to the end of it; of a trajectory alone all of it."""
    equations = derive("elbow")
    solution = flexgen.solve("elbow", progress=False)
    trajectory = solution.trajectory
    guess = from_solution(equations, solution)
    assert guess.duration == pytest.approx(solution.move.duration)
    whole = from_solution(equations, trajectory)
    assert whole.duration == pytest.approx(trajectory.time[-1] - trajectory.time[0])
    t = np.array([0.3, 0.9])
    y, dy, ddy, tau = guess.at(t)
    found = trajectory.at(t)
    assert_allclose(y, np.hstack([found["q_a"], found["q_m"]]))
    assert_allclose(dy, np.hstack([found["v_a"], found["v_m"]]))
    assert_allclose(ddy, np.hstack([found["a_a"], found["a_m"]]))
    assert_allclose(tau, found["tau_m"])
    assert_allclose(
        whole.at(t)[0], np.hstack([(x := trajectory.at(t + trajectory.time[0]))["q_a"], x["q_m"]])
    )
    with pytest.raises(
        SolverError,
        match=r"^guess: given a trajectory of elbow, expected one of planar5_nmp with the ch",
    ):
        from_solution(derive("planar5_nmp"), trajectory)


def row(name: str, value: Any, low: float, high: float, slack: float | None = None) -> Any:
    """A row of a plan, or a bound: its value is that of symbols."""
    return SimpleNamespace(
        name=name, value=value, lower=np.array([low]), upper=np.array([high]), slack=slack
    )


def test_rows_of_a_plan_hold_where_the_arm_rests() -> None:
    """Speeds are zero there, unknown symbols are left out, and a millionth of a value is
    forgiven.
    """
    y = ca.SX.sym("y", 3)
    dy = ca.SX.sym("dy", 3)
    free = ca.SX.sym("free")
    rows: dict[str, list[Any]] = {"path": [], "start": [], "end": []}
    phase: Any = SimpleNamespace(
        signals=SimpleNamespace(y=y, dy=dy), content=SimpleNamespace(rows=rows, bands={})
    )
    at = np.array([2.0, 3.0])
    rows["path"] = [
        row("sum", y[0] + y[1] + 7 * dy[0], -np.inf, 5.0),
        row("unknown", free, 1.0, 2.0),
    ]
    rows["end"] = [row("far", y[0], 9.0, 10.0)]
    start.check_rest(phase, at, "start")
    start.check_rest(phase, at + np.array([0.0, 4e-6]), "start")
    with pytest.raises(
        SolverError,
        match=r"^plan: 'sum' is violated by 6e-06 at the start, where the arm is at rest; ch",
    ):
        start.check_rest(phase, at + np.array([0.0, 6e-6]), "start")
    with pytest.raises(
        SolverError, match=r"^plan: 'far' is violated by 7 at the end, where the arm is at rest"
    ):
        start.check_rest(phase, at, "end")
    phase.content.bands = {"q": row("q", y[1], 3.5, 4.0)}
    with pytest.raises(SolverError, match=r"^plan: 'bound of q' is violated by 0\.5 at the start"):
        start.check_rest(phase, at, "start")
    phase.content.bands = {}
    rows["path"] = [row("path", y[2], -1.0, 0.25)]  # the path parameter
    start.check_rest(phase, at, "start", 0.25)
    with pytest.raises(SolverError, match=r"^plan: 'path' is violated by 0\.25 at the start"):
        start.check_rest(phase, at, "start", 0.5)
    rows["path"] = [row("root", ca.sqrt(y[0] - 3.0), 0.0, 1.0)]
    with pytest.raises(
        ArgumentError,
        match=r"^plan: 'root' is NaN or infinite at the start, expected a finite number$",
    ):
        start.check_rest(phase, at, "start")


def test_a_fast_motion_is_inverted_on_as_many_intervals_as_a_slow_one() -> None:
    """Intervals of 5 ms are a sixth of a motion of 30 ms: its fastest time law was 2.3 times as
    long as needed.
    """
    search: Any = SimpleNamespace(_resolving=np.inf)
    meshes = [TimeSearch.mesh(search, duration) for duration in (0.02, 0.1, 0.2, 1.0, 60.0)]
    assert_allclose(meshes, [5e-4, 2.5e-3, 5e-3, 5e-3, 5e-3])
