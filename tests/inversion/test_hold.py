"""Torques that a controller sends: values for its hold, verified with it, confirmed by Pinocchio
from edge to edge.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from held_referee import confirmed_error
from measured_numbers import check_numbers
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion import hold as hold_module
from flexgen.inversion.hold import Hold, torque_command
from flexgen.inversion.judge.status import Status
from flexgen.simulation.integration.hold import TorqueCommand, hold_torque
from flexgen.simulation.simulate import simulate

ROBOTS = Path(__file__).parents[1] / "support" / "robots"
MEASURABLE = 1e-8  # m: below it a simulation by Pinocchio measures its own tolerance
T = 1e-3  # s
AFTER = 0.1  # s: the error covers this time after the last sample


@pytest.fixture(scope="module")
def planar() -> tuple[Equations, flexgen.Solution]:
    equations = flexgen.derive("planar5_nmp")
    return equations, flexgen.solve(equations)


def with_samples(solution: flexgen.Solution, hold: Hold) -> TorqueCommand:
    """The command of a controller that sends samples of the continuous torque: what most
    controllers do.
    """
    command = torque_command(solution.trajectory, hold)
    curve = make_interp_spline(solution.trajectory.time, solution.trajectory["tau_m"], k=5)
    at = np.clip(command.time, solution.trajectory.time[0], solution.trajectory.time[-1])
    return dataclasses.replace(command, values=curve(at))


def error_of(problem: tuple[Equations, flexgen.Solution], command: TorqueCommand) -> float:
    """Largest tool error [m] that the verification finds under a command."""
    found = simulate(
        problem[0], problem[1].trajectory, held=AFTER, command=command
    ).tool_error_max_m
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("hold", "samples"),
    [
        (Hold("zoh", T), True),
        (Hold("zoh", T), False),
        (Hold("zoh", 8 * T, 5.3 * T), False),
        (Hold("zoh", 4 * T, 1.3 * T), True),
        (Hold("linear", 8 * T, 2.6 * T), False),
        (Hold("linear", 4 * T), True),
        (Hold("spline", 16 * T, 20.5 * T), False),
    ],
)
def test_the_verified_error_is_confirmed_by_pinocchio(
    planar: tuple[Equations, flexgen.Solution], hold: Hold, samples: bool
) -> None:
    solution = planar[1]
    command = (
        with_samples(solution, hold) if samples else torque_command(solution.trajectory, hold)
    )
    claimed = error_of(planar, command)
    assert claimed == pytest.approx(
        confirmed_error(solution, command, AFTER), rel=0.05, abs=MEASURABLE
    )


def test_a_held_sample_is_half_a_sample_late_and_the_values_to_send_are_not(
    planar: tuple[Equations, flexgen.Solution],
) -> None:
    zoh = Hold("zoh", T)
    late = error_of(planar, with_samples(planar[1], zoh))
    right = error_of(planar, torque_command(planar[1].trajectory, zoh))
    assert late == pytest.approx(785e-6, rel=0.01)
    assert right < 1e-9 and late > 100 * right


@pytest.mark.parametrize("kind", ["zoh", "linear"])
def test_means_and_chords_leave_errors_that_the_values_to_send_do_not(
    planar: tuple[Equations, flexgen.Solution], kind: str
) -> None:
    """At 4 ms: means of the torque and samples with straight lines between them are a thousand
    times worse.
    """
    trajectory = planar[1].trajectory
    hold = Hold(kind, 4 * T)
    command = torque_command(trajectory, hold)
    plain = with_samples(planar[1], hold)
    if kind == "zoh":
        _, means = hold_torque(trajectory.time, trajectory["tau_m"], kind, 4 * T, limited=False)
        curve = make_interp_spline(trajectory.time, trajectory["tau_m"], k=5).antiderivative()
        edges = np.minimum(command.edges, trajectory.time[-1])
        means[:-1] = np.diff(curve(edges), axis=0) / np.diff(edges)[:, None]
        plain = dataclasses.replace(command, values=means)
    assert 10e-6 < error_of(planar, plain) < 30e-6
    assert error_of(planar, command) < 20e-9


def test_the_error_falls_with_the_fourth_power_of_the_sample_time(
    planar: tuple[Equations, flexgen.Solution],
) -> None:
    trajectory = planar[1].trajectory
    for kind in ("zoh", "linear"):
        long, short = (
            error_of(planar, torque_command(trajectory, Hold(kind, s * T))) for s in (16, 8)
        )
        assert long / short > 10


def test_a_delay_shifts_the_ticks_and_not_the_torque_of_the_motors() -> None:
    """With a delay of whole samples the values are the same; with any delay they are those of a
    shifted torque.
    """
    t = np.linspace(0.0, 0.1, 101)
    tau = np.stack([np.sin(20 * t) ** 4, t**3], axis=1)
    for kind in ("zoh", "linear", "spline"):
        time, values = hold_torque(t, tau, kind, T)
        later, same = hold_torque(t, tau, kind, T, 3 * T)
        assert later + 3 * T == pytest.approx(time, abs=1e-15) and same == pytest.approx(
            values, abs=1e-14
        )
        ticks, shifted = hold_torque(t, tau, kind, 2 * T, 0.7 * T)
        assert ticks / (2 * T) == pytest.approx(np.round(ticks / (2 * T)), abs=1e-12)
        assert ticks[0] + 0.7 * T <= t[0] < ticks[1] + 0.7 * T
        assert ticks[-1] + 0.7 * T >= t[-1] and (shifted[-1] == tau[-1]).all()
        curve = make_interp_spline(ticks + 0.7 * T, shifted, k=3)
        assert curve(t[10:-10]) == pytest.approx(tau[10:-10], abs=0.05)


def test_values_of_limited_torques_are_means_within_their_range() -> None:
    """A torque with a corner: each value is the integral by scipy, and straight lines do not
    exceed the torque.
    """
    t = np.linspace(0.0, 0.1, 101)
    tau = np.minimum(200 * t, 7.03)[:, None]
    time, values = hold_torque(t, tau, "zoh", 3 * T, 0.4 * T, limited=True)
    arrivals = time + 0.4 * T
    for k in range(len(time) - 1):
        a, b = arrivals[k : k + 2]
        exact = quad(
            lambda s: min(200 * min(max(s, 0.0), 0.1), 7.03), a, b, points=[0.0, 0.03515, 0.1]
        )[0] / (b - a)
        assert values[k, 0] == pytest.approx(exact, abs=5e-2 if a < 0.036 < b + T else 1e-9)
    for kind in ("zoh", "linear"):
        _, values = hold_torque(t, tau, kind, 3 * T, limited=True)
        assert values.max() <= tau.max() and values.min() >= tau.min()
        # each motor for itself
        both = hold_torque(t, np.hstack([tau, -2 * tau]), kind, 3 * T, limited=True)[1]
        assert both == pytest.approx(np.hstack([values, -2 * values]), abs=1e-12)


def test_straight_lines_are_the_nearest_ones() -> None:
    """The difference from the torque is orthogonal to a change of each inner value."""
    t = np.linspace(0.0, 0.1, 101)
    tau = np.sin(60 * t)[:, None] ** 2
    time, values = hold_torque(t, tau, "linear", 4.1 * T)
    curve = make_interp_spline(t, tau[:, 0], k=5)
    fine = np.linspace(time[0], time[-1], 200_001)
    miss = np.interp(fine, time, values[:, 0]) - curve(np.minimum(fine, t[-1]))
    for k in range(1, len(time) - 1):
        hat = np.clip(1 - np.abs(fine - time[k]) / (4.1 * T), 0.0, None)
        assert abs(np.trapezoid(miss * hat, fine)) < 1e-9 * 4.1 * T


def test_a_drive_that_gets_the_samples_exceeds_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: the status is not "solved", and a warning has the error."""

    def samples(
        t: np.ndarray, tau: np.ndarray, *arguments: object, **options: object
    ) -> tuple[np.ndarray, np.ndarray]:
        time, values = hold_torque(t, tau, *arguments, **options)  # type: ignore[arg-type]
        return time, make_interp_spline(t, tau, k=5)(np.clip(time, t[0], t[-1])) + 0 * values

    good = flexgen.solve("planar5_nmp", hold="zoh")
    assert good.status == Status.SOLVED and not good.warnings
    monkeypatch.setattr(hold_module, "hold_torque", samples)
    bad = flexgen.solve("planar5_nmp", hold="zoh")
    assert bad.status == Status.TOLERANCE_NOT_MET and bad.tool_error_max_m == good.tool_error_max_m
    assert "zero-order hold at 1 ms makes the output deviate by 785 um" in bad.warnings[-1]


def test_a_solution_has_the_command_and_its_error_in_figures_and_texts() -> None:
    solution = flexgen.solve("planar5_nmp", hold="zoh", sample_time=2e-3, delay=1e-3)
    command = solution.torque_command
    run = solution.held_simulation
    assert command is not None and run is not None and run.tool_error_max_m is not None
    assert command.title() == "zero-order hold at 2 ms, delay 1 ms"
    found = {figure.key: figure for figure in solution.figures()}
    assert found["held_error_max_m"].value == run.tool_error_max_m > solution.tool_error_max_m
    assert (
        found["held_error_max_m"].label == f"simulated tool error with {command.title()}, largest"
    )
    assert command.title() in str(solution) and command.title() in solution._repr_html_()
    check_numbers(
        "held", found=solution.to_dict(), held=run.trajectory["q_a"], tau=run.trajectory["tau_m"]
    )
    assert [solution.to_dict()[key] for key in ("hold", "sample_time_s", "delay_s")] == [
        "zoh",
        2e-3,
        1e-3,
    ]
    assert (run.trajectory["tau_m"] == command.at(solution.trajectory.time)).all()
    default = flexgen.solve("planar5_nmp")
    assert default.torque_command is None and default.held_simulation is None
    assert (default.trajectory["tau_m"] == solution.trajectory["tau_m"]).all()
    unverified = flexgen.solve("planar5_nmp", hold="linear", verify=False)
    assert unverified.torque_command is not None and unverified.held_simulation is None


@pytest.mark.slow
def test_an_unstable_open_loop_is_verified_under_feedback_with_its_hold() -> None:
    solution = flexgen.solve(ROBOTS / "upright.toml", hold="zoh")
    run = solution.held_simulation
    assert run is not None and run.feedback is not None and solution.status == Status.SOLVED
    assert run.feedback.title in str(solution)


def test_invalid_holds_and_delays_are_refused(planar: tuple[Equations, flexgen.Solution]) -> None:
    for options, text in (
        ({"hold": "foh"}, "hold: given 'foh', expected one of spline, linear, zoh"),
        (
            {"hold": "zoh", "sample_time": 0.0},
            "sample_time: given 0.0, expected a positive time in s",
        ),
        ({"hold": "zoh", "sample_time": "1 ms"}, "sample_time: given '1 ms'"),
        (
            {"hold": "zoh", "delay": -1e-3},
            "delay: given -0.001, expected zero or a positive time in s",
        ),
        ({"hold": "zoh", "delay": np.nan}, "delay: given nan"),
        (
            {"hold": "zoh", "sample_time": 1e-8},
            "ticks, expected at most 1000000; take a longer sample time",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            flexgen.solve(planar[0], verify=False, **options)  # type: ignore[arg-type]
    command = torque_command(planar[1].trajectory, Hold("zoh"))
    for wrong in (
        dataclasses.replace(command, labels=("a", "b")),
        dataclasses.replace(command, values=command.values[:-1]),
        dataclasses.replace(command, values=command.values * np.nan),
        dataclasses.replace(command, time=command.time[::-1]),
    ):
        with pytest.raises(ArgumentError, match="command: given"):
            simulate(planar[0], planar[1].trajectory, command=wrong)


def test_the_command_line_writes_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "line.csv"
    words = [
        "solve",
        "planar5_nmp",
        "--hold",
        "zoh",
        "--sample-time",
        "2e-3",
        "--delay",
        "1e-3",
        "--out",
        str(out),
    ]
    assert main([*words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    command = flexgen.Trajectory.load(tmp_path / "line_command.csv")
    assert data["torque_command"] == str(tmp_path / "line_command.csv") and data["hold"] == "zoh"
    assert 0 < data["held_error_max_m"] < 1e-8
    assert (
        command.meta["hold"] == "zoh"
        and command.meta["sample_time"] == 2e-3
        and command.meta["delay"] == 1e-3
    )
    assert np.diff(command.time) == pytest.approx(2e-3) and command.columns() == [
        "tau_m[m1] N m",
        "tau_m[m2] N m",
    ]
    assert main(["solve", "planar5_nmp", "--out", str(out)]) == 0
    assert "zero-order" not in capsys.readouterr().out
