"""The fastest time law: against closed forms, published optima, exact limits, and robots that
swing.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_numbers import check_numbers
from scipy.optimize import linprog
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.paths import path as paths
from flexgen.paths.timing.time_laws import SplineLaw
from flexgen.planning.fastest import residual_vibration, time_search
from flexgen.planning.fastest.rigid_time import largest_squared_speed, rigid_time

pytestmark = needs_compiler

TWO_MASS = Path(__file__).resolve().parents[1] / "support" / "robots" / "two_mass.toml"


@pytest.fixture(scope="module")
def planar():
    return flexgen.fastest("planar5_nmp", progress=False)


def test_the_planar_arm_is_as_fast_as_its_torques_allow(planar):
    """0.36 s instead of 0.5 s within the largest torques of the given law; verified by
    simulation.
    """
    torque = np.abs(planar.solution.trajectory["tau_m"]).max(axis=0)
    given = np.abs(planar.default.trajectory["tau_m"]).max(axis=0)
    assert planar.duration_s <= 0.36 and planar.excess <= 5e-4
    assert np.all(torque <= given * (1 + 5e-4))
    assert planar.solution.status.value == "solved" and planar.solution.tool_error_max_m < 1e-7
    assert planar.rigid_s < planar.duration_s
    check_numbers("fastest", 1e-5, found=planar.to_dict())
    assert planar.vibration_m["soft"] > 10 * planar.default_vibration_m["soft"]  # the price


@pytest.mark.slow
def test_robots_in_other_units_of_time_are_as_fast():
    """16 and 32 times as quick as `planar5_nmp`: all numbers of the search but rounding are the
    same.
    """

    def duration(factor: float) -> float:
        gears = [
            f"element.arm{k}.dof.q{k}.{gear}" for k, gear in ((1, "gear."), (2, "gear."), (3, ""))
        ]
        changes = {
            f"{gear}spring.stiffness": x
            for gear, x in zip(gears, (4e5, 2.5e5, 1.5e5), strict=True)
        }
        changes = {key: x * factor**2 for key, x in changes.items()} | {
            "move.line.duration": 0.5 / factor
        }
        changes |= {
            f"{gear}damping": x * factor
            for gear, x in zip(gears, (400.0, 250.0, 150.0), strict=True)
        }
        changes |= {f"motor.m{k}.friction.viscous": 20e-4 * factor for k in (1, 2)}
        robot = flexgen.read(
            "planar5_nmp", overrides=changes | {"gravity": [0.0, -9.81 * factor**2, 0.0]}
        )
        limits = Limits(torque=(25.0 * factor**2, 12.0 * factor**2))
        return factor * flexgen.fastest(robot, "line", limits=limits, progress=False).duration_s

    assert duration(16.0) == pytest.approx(duration(32.0), rel=1e-6)


@pytest.mark.slow
def test_two_masses_against_their_minimum_time():
    """Torques that jump need 0.098881 s (closed form), a rigid shaft 0.096954 s; continuous ones a
    tenth more.
    """
    found = flexgen.fastest(TWO_MASS, progress=False)
    J = 0.047
    y = 0.5
    u = 10.0
    assert found.rigid_s == pytest.approx(2 * np.sqrt(y * J / u), rel=1e-6)
    assert 0.098881 < found.duration_s < 1.1 * 0.098881
    assert found.excess <= 5e-4


@pytest.mark.slow
def test_a_rigid_robot_needs_the_time_of_the_closed_form():
    """A speed limit: acceleration, constant speed, deceleration."""
    model = flexgen.read(TWO_MASS)
    path = paths.Path(
        derive(model), model.moves["turn"] if isinstance(model.moves, dict) else model.moves[0]
    )
    J = 0.047
    y = 0.5
    u = 10.0
    v = 6.0
    expected = y / v + v * J / u
    assert rigid_time(path, np.array([u]), np.array([v])) == pytest.approx(expected, rel=2e-3)
    heavy = flexgen.read("elbow")
    weak = paths.Path(derive(heavy), heavy.moves[0])
    assert np.isnan(rigid_time(weak, np.full(2, 0.1), np.full(2, np.inf)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["manutec_r3_18", "manutec_r3_24"])
def test_six_axes_save_more_than_a_quarter(name):
    default = flexgen.solve(name, progress=False)
    limits = Limits(torque=tuple(np.abs(default.trajectory["tau_m"]).max(axis=0)))
    found = flexgen.fastest(name, limits=limits, progress=False)
    assert found.duration_s <= 0.72 and found.excess <= 5e-4
    assert found.solution.tool_error_max_m < 1e-6


@pytest.mark.slow
def test_less_vibration_costs_a_little_time(planar):
    """A third of the vibration of soft robots for at most 8 % more time; seen by another
    simulation.
    """
    allowed = planar.vibration_m["soft"] / 3
    found = flexgen.fastest("planar5_nmp", vibration=allowed, progress=False)
    assert found.duration_s <= 1.08 * planar.duration_s and found.excess <= 5e-4
    assert max(found.vibration_m.values()) <= 1.05 * allowed
    swings = []
    for solution in (planar.solution, found.solution):
        run = flexgen.control(
            "planar5_nmp", plants={"soft": {"stiffness": 0.9}}, solution=solution, progress=False
        )
        after = run.reference.time >= run.reference.path_end
        error = run["soft"].error - run["soft"].error[-1]
        swings.append(np.linalg.norm(error[after], axis=1).max())
    assert swings[1] <= 0.45 * swings[0]


@pytest.mark.slow
def test_a_bound_of_the_rates_is_kept_and_costs_time(planar):
    """Between the samples of the result too: on the mesh that `solve` begins with, its torques
    ripple.
    """
    found = flexgen.fastest("planar5_nmp", torque_rate=1.5, progress=False)
    path = found.solution.trajectory
    bound = np.array(found.limits.torque_rate)
    t = np.linspace(path.time[0], path.time[-1], 8 * len(path.time))
    rate = np.abs(np.diff(path.at(t)["tau_m"], axis=0)).max(axis=0) / (t[1] - t[0])
    given = found.default.trajectory
    assert bound == pytest.approx(
        1.5 * np.abs(np.gradient(given["tau_m"], given.time, axis=0)).max(axis=0)
    )
    assert 0.99 < (rate / bound).max() <= 1.0 + 5e-4 and found.duration_s > planar.duration_s


@pytest.mark.slow
def test_solve_with_fastest_warns_and_takes_the_fastest_time_law(planar):
    with pytest.warns(DeprecationWarning, match="expected the move of flexgen.fastest") as caught:
        solution = flexgen.solve("planar5_nmp", fastest=True, progress=False)
    assert [Path(warning.filename).name for warning in caught] == [Path(__file__).name]
    assert solution.status == flexgen.Status.SOLVED and solution.move.timing == planar.move.timing


def test_a_spline_law_is_at_rest_at_both_ends():
    law = SplineLaw(0.7, tuple(np.linspace(0.1, 0.9, 9)), 2.0)
    ends = law(np.array([0.0, 1e-9, 0.7 - 1e-9, 0.7, 1.0]))
    assert (
        np.allclose(ends[:, 0], [0, 0, 2, 2, 2], atol=1e-12) and np.abs(ends[:, 1:5]).max() < 1e-6
    )
    assert np.abs(ends[:, 5]).max() < 1e-6 * np.abs(law(np.linspace(0, 0.7, 99))[:, 5]).max()
    t = np.linspace(0.05, 0.65, 7)
    h = 1e-6
    numeric = (law(t + h)[:, :5] - law(t - h)[:, :5]) / (2 * h)
    assert np.allclose(law(t)[:, 1:], numeric, rtol=1e-5, atol=1e-4)
    with pytest.raises(ArgumentError, match="timing: given 0 coefficients"):
        SplineLaw(1.0, ())


def test_a_move_with_a_timing_is_a_move_like_others(planar):
    """A solve of the fastest move yields its torques again; it has no table for the sampler."""
    mesh = time_search.MESH_S / time_search.FINER
    again = flexgen.solve(
        "planar5_nmp", planar.move, mesh=mesh, ignore_limits=True, progress=False
    )
    assert np.array_equal(again.trajectory["tau_m"], planar.solution.trajectory["tau_m"])
    with pytest.raises(ArgumentError, match="spline as time law"):
        flexgen.plan("planar5_nmp", planar.move).table()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"coefficients": 2}, "coefficients: given 2"),
        ({"torque_rate": -1.0}, "torque_rate: given -1.0"),
        ({"vibration": 0.0}, "vibration: given 0.0"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.fastest("planar5_nmp", progress=False, **arguments)


@pytest.mark.slow
def test_limits_below_the_weight_are_refused():
    with pytest.raises(SolverError, match="cannot be kept on this path at any speed"):
        flexgen.fastest("planar5_nmp", limits=Limits(torque=(2.0, 2.0)), progress=False)


def test_the_largest_speed_at_a_point_is_that_of_a_linear_program():
    """Random torques with and without a solution; the largest squared speeds are between 0 and
    100, most below 1.
    """
    rng = np.random.default_rng(4)
    found = []
    for _ in range(25):
        a, b, g = rng.normal(size=(3, 3))
        b = 10 ** rng.uniform(-1, 2) * b
        torque = rng.uniform(0.5, 2.0, 3)
        after = float(rng.uniform(0.1, 5.0))
        rows = np.array([*np.stack([a, b], 1), *np.stack([-a, -b], 1), [0.2, 1.0], [-0.2, -1.0]])
        right = np.concatenate([torque - g, torque + g, [after, 0.0]])
        best = linprog([0.0, -1.0], A_ub=rows, b_ub=right, bounds=[(None, None), (0.0, 100.0)])
        own = largest_squared_speed(a, b, g, torque, 100.0, 0.1, after)
        assert (own is None) == (best.x is None)
        if own is not None:
            assert own == pytest.approx(best.x[1], rel=1e-6, abs=1e-9)
            found.append(own)
    assert 5 < len(found) < 25 and 0.0 < min(found) < 0.1


def test_vibrations_after_a_move_are_those_of_robots_with_other_springs() -> None:
    """Of `flexgen.planning.fastest.residual_vibration`: the static part is left out; without
    motion there is none.
    """
    solution = flexgen.solve("planar5_nmp", verify=False, progress=False)
    made = residual_vibration.ResidualVibration(derive("planar5_nmp"), lambda line: None)
    found = made(solution.trajectory, solution.move.duration)
    assert found.shape == (2, 200, 2)
    late = slice(150, None)
    assert np.abs(found[:, late].mean(axis=1)).max() < 0.1 * np.abs(found).max()
    check_numbers("vibration", 1e-4, found=found, rate=made._rate)
    channels = {
        name: np.repeat(x[:1], 3, axis=0) for name, x in solution.trajectory.channels.items()
    }
    rest = replace(solution.trajectory, time=np.array([0.0, 0.5, 1.0]), channels=channels)
    assert np.abs(made(rest, 1.0)).max() < 1e-3 * np.abs(found).max()


@pytest.mark.slow
def test_vibration_does_not_include_what_hysteresis_holds_at_rest() -> None:
    """The tool comes to rest 0.15 mm from where the springs alone would hold it; it vibrates as
    without hysteresis.
    """
    gears = {
        f"element.arm{k}.dof.q{k}.gear.hysteresis": {"lost_motion": 2.9e-4, "stiffness": 4e5}
        for k in (1, 2)
    }
    found = []
    for model in (flexgen.read("planar5_nmp"), flexgen.read("planar5_nmp", overrides=gears)):
        solution = flexgen.solve(model, verify=False, progress=False)
        made = residual_vibration.ResidualVibration(derive(model), lambda line: None)
        found.append(np.linalg.norm(made(solution.trajectory, solution.move.duration), axis=2))
    assert found[1].max() < found[0].max() < 1e-5  # m
    assert found[1][:, -1].max() < 1e-7  # 1.5e-4 with the rest of the springs


def test_a_fast_move_in_words(planar):
    """Durations, limits as of the given move, what a rigid robot needs, and the vibration."""
    lines = str(planar).splitlines()
    change = 100 * (planar.duration_s / planar.default_s - 1)
    assert lines[0] == "planar5_nmp, move line"
    assert f"  duration of the path: {planar.duration_s:.4g} s ({change:+.0f} %)" in lines
    assert f"  duration as given: {planar.default_s:.4g} s" in lines
    largest = np.abs(planar.default.trajectory["tau_m"]).max(axis=0)
    assert planar.assumed == pytest.approx({"m1": largest[0], "m2": largest[1]})
    limit = f"  torque limit of m1, as of the move as given: {largest[0]:.4g} N m"
    rigid = f"  duration of a rigid robot whose torques may jump: {planar.rigid_s:.4g} s"
    assert limit in lines and rigid in lines
    slow = replace(planar, duration_s=1.22 * planar.default_s)
    assert "(+22 %)" in str(slow)
    assert repr(planar).startswith(f"<FastestMove planar5_nmp: {planar.default_s:.4g} -> ")
    assert any(line.startswith("soft ") for line in planar.to_text().splitlines())
