"""Smoothness reports: every jump is found where it was put, and the cost is that of a
simulation.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.moves import Move, MoveL, Program
from flexgen.paths.geometry.smoothness import SmoothnessReport, smoothness_report
from flexgen.paths.path import Path
from flexgen.paths.timing.time_laws import TimeLaw

# Estimates of the linear machine at one pose, compared with a simulation that moves on along the
# path.
FACTOR = 2.0


@pytest.fixture(scope="module")
def arm():
    return flexgen.derive("planar5_nmp")


def drift(report: SmoothnessReport) -> float:
    """Drift of the tool by all jumps together [m]."""
    return sum(jump.tool or 0.0 for jump in report.jumps)


@pytest.mark.parametrize("smoothness", [0, 1, 2, 3, 4])
def test_jumps_of_a_polynomial_are_found_with_their_size(arm, smoothness: int) -> None:
    move = replace(arm.model.move("line"), smoothness=smoothness)
    report = smoothness_report(arm, Path(arm, move))
    size = np.linalg.norm(move.displacement) * abs(
        TimeLaw(0.5, smoothness)(np.array([1e-12]), 6)[0, smoothness + 1]
    )
    assert [jump.time for jump in report.jumps] == [0.0, 0.5]
    assert [jump.order for jump in report.jumps] == [smoothness + 1] * 2
    assert [jump.size for jump in report.jumps] == pytest.approx([size] * 2, rel=1e-5)
    assert (
        report.required == 3
        and report.sufficient == (smoothness >= 3)
        and len(report.torque_jumps) == (0 if report.sufficient else 2)
    )


def test_smooth_paths_have_no_jumps(arm) -> None:
    for smoothness in (5, 7):
        report = smoothness_report(
            arm, Path(arm, replace(arm.model.move("line"), smoothness=smoothness))
        )
        assert report.jumps == () and report.sufficient and drift(report) == 0.0


def path_error(solution: flexgen.Solution) -> float:
    """Largest error of the output up to the end of the trajectory [m]: the estimate does not cover
    a hold after it.
    """
    assert solution.simulation is not None
    return float(np.linalg.norm(solution.simulation.trajectory["error"], axis=1).max())


@pytest.mark.parametrize("name", ["planar5_nmp", "planar5_mp"])
def test_the_cost_is_that_of_a_simulation(name: str) -> None:
    """C2: the torque jumps, and the open loop drifts by millimetres."""
    equations = flexgen.derive(name)
    move = replace(equations.model.move("line"), smoothness=2)
    report = smoothness_report(equations, Path(equations, move))
    solution = flexgen.solve(equations, move, "collocation", mesh=0.01)
    assert 1 / FACTOR < drift(report) / path_error(solution) < FACTOR
    assert drift(report) > 1e-3
    tau = solution.trajectory["tau_m"]
    steps = np.abs(np.diff(tau, axis=0)).max()  # the jump, spread over one or two samples
    assert 1 / FACTOR < report.jumps[0].torque / steps < FACTOR
    assert (
        "the torque jumps by about" in report.lines()[0]
        and "the tool drifts by about" in report.lines()[0]
    )


@needs_compiler
@pytest.mark.parametrize("smoothness", [2, 3])
@pytest.mark.parametrize("method", ["lq", "bvp"])
def test_lq_and_bvp_drift_less_than_estimated(arm, method: str, smoothness: int) -> None:
    """Their torque is found by differences over the samples; the report names it."""
    move = replace(arm.model.move("line"), smoothness=smoothness)
    report = smoothness_report(arm, Path(arm, move))
    assert flexgen.solve(arm, move, method).tool_error_max_m < drift(report) / 20
    assert "(less with methods lq, bvp and closed-form)" in report.lines()[0]


@pytest.mark.slow
def test_kinks_of_the_torque_are_reported(monkeypatch) -> None:
    """C3 with 1 ms: the corners of the torque fall between its samples; the exact derivatives
    there drift.
    """
    robot = flexgen.derive("manutec_r3")
    start = robot.model.move("line").start
    bounds = (1.7, 8.0, 140.0, 5000.0)
    move = Move("swing", "joint", start, 0.0, 0, end=tuple(q + 0.1 for q in start), profile=bounds)
    report = smoothness_report(robot, Path(robot, move))
    assert report.sufficient and len(report.lines()) == 1 and "kinks" in report.lines()[0]
    assert path_error(flexgen.solve(robot, move, "closed-form")) < drift(report) / 20
    monkeypatch.setattr(SmoothnessReport, "has_kinks", False)
    assert 1 / 5 < drift(report) / path_error(flexgen.solve(robot, move, "closed-form")) < 5


def test_trapezoids_jump_at_their_knots(arm) -> None:
    bounds = (0.5, 5.0, 100.0)
    move = Move("fast", "tool_line", (0.3, -1.1), 0.0, 0, (-0.2, 0.21, 0.0), profile=bounds)
    path = Path(arm, move)
    report = smoothness_report(arm, path)
    assert (
        path.smoothness == report.smoothness == 2
        and len(report.jumps) == 8
        and not report.sufficient
    )
    assert all(
        jump.order == 3 and jump.size == pytest.approx(100.0, rel=1e-6) for jump in report.jumps
    )
    assert np.abs(np.array([jump.time for jump in report.jumps]) - path.breaks).max() < 1e-12
    crackle = smoothness_report(arm, Path(arm, replace(move, profile=(*bounds, 4000.0))))
    assert (
        crackle.sufficient
        and len(crackle.jumps) == 16
        and all(jump.order == 4 for jump in crackle.jumps)
    )


def test_rounded_corners_are_smooth_and_splines_jump_at_their_knots(
    arm, tmp_path: FilePath
) -> None:
    legs = (MoveL((-0.1, 0, 0), zone=0.03), MoveL((0, 0.1, 0)))
    corner = Path(arm, Move("corner", "tool_polyline", (0.3, -1.1), 0.5, 6, legs=legs))
    assert corner.smoothness == 5 and smoothness_report(arm, corner).jumps == ()
    u = np.linspace(0, 1, 8)
    p = corner.reference.tool_pose((0.3, -1.1))[0]
    rows = np.column_stack([p[0] - 0.1 * u, p[1] + 0.05 * np.sin(3 * u), 0 * u])
    file = tmp_path / "track.csv"
    file.write_text(
        "x,y,z\n" + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows)
    )
    spline = Path(arm, Move("track", "sampled", (0.3, -1.1), 0.5, 6, file=str(file), degree=5))
    report = smoothness_report(arm, spline)
    assert spline.smoothness == 4 and report.sufficient and report.jumps
    assert all(jump.order == 5 and 0 < jump.time < 0.5 for jump in report.jumps)


def test_samples_that_begin_or_end_in_motion_are_a_warning(arm, tmp_path: FilePath) -> None:
    """A part of a recorded motion; the speed at 0.355 of it is (0.355 0.645 / 0.25)^3 of the
    largest.
    """
    t = np.linspace(0.0, 0.5, 101)
    s = t / 0.5
    p = arm.model.move("line").displacement
    start = Path(arm, Move("corner", "tool_line", (0.3, -1.1), 0.5, 5, p)).reference.tool_pose(
        (0.3, -1.1)
    )[0]
    rows = np.column_stack([t, start + np.outer(s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3), p)])
    found = []
    for part in (slice(0, 101), slice(35, 101), slice(0, 66)):
        file = tmp_path / f"part{part.start}_{part.stop}.csv"
        np.savetxt(file, rows[part], delimiter=",", header="t,x,y,z", comments="")
        move = Move("part", "sampled", (0.3, -1.1), 0.0, 0, file=str(file))
        found.append(InversionProblem(arm, Path(arm, move)).too_rough)
    assert found[0] == ()
    assert found[1] == (
        (
            "move part: its samples begin at 77 % of their largest speed, the path at rest: add "
            "samples from rest"
        ),
    )
    assert found[2] == (
        (
            "move part: its samples end at 77 % of their largest speed, the path at rest: add "
            "samples until rest"
        ),
    )


def test_turns_of_the_tool_jump_too() -> None:
    robot = flexgen.derive("manutec_r3")
    start = robot.model.move("line").start
    program = Program(
        "p",
        start=start,
        profile=(0.5, 5.0, 100.0),
        steps=(MoveL((0.0, 0.0, 0.0), rotation=(0, 0, 0.2)),),
        radius=0.5,
    )
    report = smoothness_report(robot, Path(robot, program))
    assert not report.sufficient
    assert all(
        jump.size < 1e-6 and jump.rotation == pytest.approx(200.0, rel=1e-4)
        for jump in report.jumps
    )
    assert all(jump.torque > 0 for jump in report.jumps)


def test_a_planted_jump_at_a_break_is_found(arm, monkeypatch) -> None:
    path = Path(arm, replace(arm.model.move("line"), smoothness=2))
    right = path.sample

    def planted(t):
        sample = right(t)
        sample.y[np.asarray(t) > 0.5, 0, 2] += 0.5
        return sample

    monkeypatch.setattr(path, "sample", planted)
    last = smoothness_report(arm, path).jumps[-1]
    assert last.order == 2 and last.size == pytest.approx(0.5, rel=1e-3)
