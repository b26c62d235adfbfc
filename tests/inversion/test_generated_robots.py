"""Robots that were not chosen for these solvers: solved, and confirmed by Pinocchio and numpy.

`make robots` runs the 200 moves of 40 robots. ``FLEXGEN_ROBOTS=10-20`` runs robots 10 to 19 only;
the file ``FLEXGEN_ROBOTS_RESULTS`` keeps the results, and those in it are not computed again.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import inverted_in_c
import numpy as np
import pytest
from clib_planted import plant_in_c
from generated_robots import FAMILIES, KINDS, MOVES, generated_robot, kind_of, robots_folder
from generated_runs import LIMIT, run
from inverted_in_c import inversion_in_c

import flexgen
from flexgen.base.errors import SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.reader import read

try:
    from claimed_error import claim_holds, claimed_error, false_claims, simulated_error
    from confirmation import confirm, holds, is_false
except ModuleNotFoundError:
    pytest.skip("the Python package pin is not installed", allow_module_level=True)

ROBOTS = 40
SOLVED = 0.98  # least share of the moves
FOLDER = robots_folder()
needs_robots = pytest.mark.skipif(
    FOLDER is None, reason="the Python package example-robot-data is not installed"
)


@needs_robots
def test_a_seed_gives_one_robot(tmp_path: Path) -> None:
    assert FOLDER is not None
    one, same, other = (
        generated_robot(number, FOLDER, tmp_path / str(k)).read_text(encoding="utf-8")
        for k, number in enumerate((4, 4, 29))
    )
    assert one == same and one != other
    assert kind_of(4)[0] == kind_of(29)[0] == "finger"


@needs_robots
@pytest.mark.slow
def test_the_robots_cover_every_kind_of_element(tmp_path: Path) -> None:
    """The share of solved moves is worth what the robots contain."""
    assert FOLDER is not None
    numbers = range(0, ROBOTS, 3)
    models = [read(generated_robot(number, FOLDER, tmp_path)) for number in numbers]
    assert {kind_of(number)[0] for number in range(ROBOTS)} == set(FAMILIES)
    assert {kind_of(number)[1] for number in range(ROBOTS)} == set(KINDS)
    assert all(len(model.moves) == MOVES for model in models)
    assert {model.output.type for model in models} == {"tool_pose", "tool_position", "combination"}
    assert {move.type for model in models for move in model.moves} == {
        "tool_line",
        "joint",
        "output_line",
    }
    assert {0, 1, 2} <= {model.n_e for model in models}
    assert all(model.inversion_obstacle() is None for model in models)


@needs_robots
@pytest.mark.slow
def test_a_generated_robot_is_solved_and_confirmed(tmp_path: Path) -> None:
    """And the confirmation sees a torque or a motion that is wrong by a thousandth."""
    assert FOLDER is not None
    equations = flexgen.derive(generated_robot(11, FOLDER, tmp_path))
    trajectory = flexgen.solve(equations, "m1").trajectory
    assert holds(confirm(equations.model, trajectory))
    for name in ("tau_m", "q_a", "v_a", "q_m"):
        wrong = {
            **trajectory.channels,
            name: trajectory[name] * np.where(trajectory.time > 0.1, 1.001, 1.0)[:, None],
        }
        assert not holds(
            confirm(equations.model, dataclasses.replace(trajectory, channels=wrong))
        ), name
        wrong = {
            **wrong,
            name: trajectory[name] * np.where(trajectory.time > 0.1, 1.1, 1.0)[:, None],
        }
        assert is_false(
            confirm(equations.model, dataclasses.replace(trajectory, channels=wrong))
        ), name


@needs_robots
@pytest.mark.slow
@pytest.mark.parametrize(("number", "move"), [(11, "m0"), (6, "m1"), (4, "m1")])
def test_stated_errors_are_those_of_an_independent_simulation(
    number: int, move: str, tmp_path: Path
) -> None:
    """With motor feedback (growth 5e3) and without; a torque that is 2 % off has a larger
    error.
    """
    assert FOLDER is not None
    solution = flexgen.solve(
        flexgen.derive(generated_robot(number, FOLDER, tmp_path)), move, ignore_limits=True
    )
    assert solution.simulation is not None and (solution.simulation.feedback is not None) == (
        number == 6
    )
    assert false_claims(solution) == []
    off = {**solution.trajectory.channels, "tau_m": 1.02 * solution.trajectory["tau_m"]}
    wrong = simulated_error(solution, dataclasses.replace(solution.trajectory, channels=off))
    assert not claim_holds(claimed_error(solution), wrong) and wrong > 1e-7


@needs_robots
@pytest.mark.slow
@pytest.mark.parametrize("number", [4, 6])
def test_the_growth_of_invert_in_c_is_that_of_solve(number: int, tmp_path: Path) -> None:
    """However long the motion is at rest after the path: 4/m1 differed by 240."""
    assert FOLDER is not None
    equations = derive(read(generated_robot(number, FOLDER, tmp_path)))
    for move in equations.model.moves[:2]:
        simulation = flexgen.solve(equations, move, ignore_limits=True).simulation
        assert simulation is not None and simulation.growth is not None
        found = inversion_in_c(equations, move.name)
        assert 0.5 < found.growth / simulation.growth < 2.0  # the closed form begins with the path


@needs_robots
@pytest.mark.robots
def test_generated_robots() -> None:
    """At least 98 % of the moves are solved and confirmed, none falsely, none takes longer than
    the limit.

    Confirmed includes the claimed error, by an independent simulation of the whole move where that
    is fast enough.
    """
    first, last = map(int, os.environ.get("FLEXGEN_ROBOTS", f"0-{ROBOTS}").split("-"))
    results = os.environ.get("FLEXGEN_ROBOTS_RESULTS")
    rows = run(first, last, Path(results) if results else None, MOVES)
    named = [
        f"{row['robot']}/m{row['move']}: {row['outcome']} {row.get('reason', '')}" for row in rows
    ]
    bad = [
        text
        for text, row in zip(named, rows, strict=True)
        if row["outcome"] in ("wrong", "doubted", "crash", "time")
    ]
    assert len(rows) == MOVES * (last - first)
    assert not [text for text in bad if ": wrong" in text], bad
    checked = [row for row in rows if row.get("false") is not None]
    assert len(checked) > len(rows) / 2, f"{len(checked)} of {len(rows)} claims were checked"
    assert max(row.get("wall_s", 0.0) for row in rows) <= LIMIT
    assert sum(row["outcome"] == "confirmed" for row in rows) >= SOLVED * len(rows), [
        text for text, row in zip(named, rows, strict=True) if row["outcome"] != "confirmed"
    ]


@needs_robots
@pytest.mark.slow
@pytest.mark.parametrize("number", [7, 10])
def test_moves_that_solve_verifies_have_status_ok_in_c(number: int, tmp_path: Path) -> None:
    """With its default tolerance, on the grid of solve."""
    assert FOLDER is not None
    equations = derive(read(generated_robot(number, FOLDER, tmp_path)))
    doubted = []
    for move in equations.model.moves:
        try:
            found = inversion_in_c(equations, move.name)
        except SolverError as error:
            with pytest.raises(SolverError):
                flexgen.solve(equations, move, "lq")
            assert "workspace" in str(error)
            continue
        if not found.converged:
            doubted.append(move.name)
    assert doubted == []


@needs_robots
@pytest.mark.slow
def test_a_small_residual_does_not_hide_wrong_torques(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the reduced inertia is singular at a pose of the path; planted: a residual of 1e-8 is
    enough for OK.
    """
    assert FOLDER is not None
    model = read(generated_robot(82, FOLDER, tmp_path))
    monkeypatch.setattr(inverted_in_c, "MESH", 1.25e-3)
    found = inversion_in_c(derive(model), "m1")
    assert found.torque_error > 0.1 and found.residual_at_samples < 1e-8 and not found.converged
    rule = "exact_tolerances = PRECISE({}, 1.0)"
    plant_in_c(monkeypatch, "whole_path.h", rule.format("0.0"), rule.format("1e-2"))
    assert inversion_in_c(derive(dataclasses.replace(model, name="other")), "m1").converged
