"""Forward simulation, and the trajectories that it is given."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.simulation.simulate import simulate


def test_simulation_from_rest_stays_at_rest() -> None:
    equations = flexgen.derive("planar5_mp")
    rest = hold_joints(equations, np.array([0.3, -1.1]))
    base = flexgen.solve(equations, verify=False).trajectory
    n = len(base.time)
    still = {name: np.zeros_like(values) for name, values in base.channels.items()}
    still |= {
        "q_a": np.tile(rest.q_a, (n, 1)),
        "q_m": np.tile(rest.q_m, (n, 1)),
        "tau_m": np.tile(rest.tau_m, (n, 1)),
    }
    moved = (
        simulate(equations, dataclasses.replace(base, channels=still)).trajectory["q_a"] - rest.q_a
    )
    assert np.abs(moved).max() < 1e-12


def test_a_trajectory_of_another_model_is_refused() -> None:
    trajectory = flexgen.solve("planar5_mp", verify=False).trajectory
    with pytest.raises(ArgumentError, match="take the model that it was written for"):
        simulate("manutec_r3", trajectory)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_trajectories_survive_a_file(tmp_path, suffix: str) -> None:
    equations = flexgen.derive("planar5_mp")
    solution = flexgen.solve(equations, verify=False)
    path = solution.trajectory.save(tmp_path / f"line.{suffix}")
    again = Trajectory.load(path)
    for name, values in solution.trajectory.channels.items():
        assert np.array_equal(again[name], values)
    assert (
        simulate(equations, path).tool_error_max_m
        == simulate(equations, solution.trajectory).tool_error_max_m
    )
    path.write_text("no trajectory")
    with pytest.raises(ArgumentError, match="not a trajectory of flexgen"):
        Trajectory.load(path)


def test_columns_are_known_by_their_labels(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A file whose columns are in another order is the same file; other units or names are
    refused.
    """
    equations = flexgen.derive("elbow")
    trajectory = flexgen.solve(equations, verify=False).trajectory
    text = trajectory.save(tmp_path / "elbow.csv").read_text().splitlines()
    header = text[1].split(",")

    def swapped_pair(lines: list[str], first: str, second: str) -> list[str]:
        one = header.index(first)
        two = header.index(second)
        rows = [line.split(",") for line in lines]
        for cells in rows:
            cells[one], cells[two] = cells[two], cells[one]
        return [",".join(cells) for cells in rows]

    def written(lines: list[str]) -> Trajectory:
        (tmp_path / "other.csv").write_text("\n".join(lines) + "\n")
        return Trajectory.load(tmp_path / "other.csv")

    swapped = [text[0], *swapped_pair(text[1:-1], "tau_m[m1] N m", "tau_m[m2] N m"), text[-1]]
    assert (
        simulate(equations, written(swapped)).tool_error_max_m
        == simulate(equations, trajectory).tool_error_max_m
    )
    again = simulate(
        equations,
        written([text[0], *swapped_pair(text[1:-1], "y_ref[x] m", "y_ref[z] m"), text[-1]]),
    )
    assert again.tool_error_max_m == simulate(equations, trajectory).tool_error_max_m
    with pytest.raises(ArgumentError, match="tau_m, column m1: given 'N', a force, expected a to"):
        simulate(equations, written([text[0], text[1].replace("] N m", "] N"), *text[2:]]))
    with pytest.raises(ArgumentError, match="q_a: given columns q1, q9, expected q1, q2"):
        simulate(equations, written([text[0], text[1].replace("q_a[q2]", "q_a[q9]"), *text[2:]]))
    with pytest.raises(ArgumentError, match="line 7: given 3 columns, expected"):
        written([*text[:6], "1,2,3", *text[7:]])
    with pytest.raises(ArgumentError, match="line 7: given text, expected numbers"):
        written([*text[:6], text[6].replace("0.", "o.", 1), *text[7:]])
    other = written([text[0].replace('"elbow"', '"shoulder"'), *text[1:]])
    assert "was written for model 'shoulder'" in simulate(equations, other).warnings[0]


def test_trajectories_are_regular_files(tmp_path) -> None:  # type: ignore[no-untyped-def]
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(ArgumentError, match="expected a regular file"):
        Trajectory.load(tmp_path / "pipe.npz")
    with pytest.raises(ArgumentError, match="expected a new name or a regular file"):
        flexgen.solve("elbow", verify=False).trajectory.save(tmp_path / "pipe.npz")


def test_speeds_of_the_start_have_their_units():
    """Were the units not looked at, deg/s would be taken as rad/s: an error of meters."""
    trajectory = flexgen.solve("elbow", verify=False, progress=False).trajectory

    def stated(unit: str, factor: float) -> Trajectory:
        port = dataclasses.replace(trajectory.ports["v_a"], unit=unit)
        channels = {**trajectory.channels, "v_a": trajectory["v_a"] / factor}
        ports = {**trajectory.ports, "v_a": port}
        return dataclasses.replace(trajectory, channels=channels, ports=ports, units={})

    with pytest.raises(ArgumentError, match=r"channel v_a, column q1: given 'gon/s', an unknown"):
        flexgen.simulate("elbow", stated("gon/s", 1.0), moving=True, progress=False)
    for given in (trajectory, stated("deg/s", np.pi / 180)):
        found = flexgen.simulate("elbow", given, moving=True, progress=False)
        assert found.tool_error_max_m < 1e-6


def test_a_clock_that_counts_from_1970_gives_the_errors_of_the_motion() -> None:
    """Its resolution is a quarter of a microsecond; the integrator failed on it, or was 55 um
    wrong.
    """
    trajectory = flexgen.solve("elbow", verify=False).trajectory
    found = flexgen.simulate(
        "elbow", dataclasses.replace(trajectory, time=trajectory.time + 1.7e9), held=0.0
    )
    assert found.tool_error_max_m is not None and found.tool_error_max_m < 5e-7
    assert found.trajectory.time[0] == 1.7e9 + trajectory.time[0]
