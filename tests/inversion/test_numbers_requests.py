"""Requests and their answers: samples of an inversion, versions, folders, noise, digests, log
files.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.checks.types_of_values import _is_any_array
from flexgen.base.errors import ArgumentError
from flexgen.cli import main
from flexgen.codegen.recursion.dh_chain import ROUNDING, Inertia, _tidy
from flexgen.identification.experiments import operating_points
from flexgen.inversion import unverified_solution
from flexgen.inversion.judge import verification
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem import sampling
from flexgen.model import reader
from flexgen.model.elements import LinearSpring
from flexgen.studies.scenarios import scenario_file
from flexgen.studies.sweeps import folder


def problem(**more: Any) -> Any:
    """Of a path of one second, with a window of half a second before it and a quarter behind
    it.
    """
    gear = Made(rigid=False, spring=LinearSpring(1e4))
    fields: dict[str, Any] = {
        "mesh": None,
        "limits": None,
        "force": None,
        "preview": None,
        "windows": (0.5, 0.25),
    }
    fields |= {
        "path": Made(duration=1.0, segments=(1,)),
        "step": 1e-3,
        "sampling": 1e-3,
        "resolving": 1.0,
    }
    fields |= {
        "equations": Made(model=Made(coordinates=[Made(dof=None), Made(dof=Made(gear=gear))]))
    }
    return Made(**(fields | more))


def test_samples_of_an_inversion_by_hand() -> None:
    """Steps on the path, their period, steps in an interval, and steps before and behind the
    path.
    """
    assert sampling.grid(problem(), 0.01) == (1001, 1e-3, 10, 500, 250)
    assert sampling.grid(problem(), 0.004) == (2001, 5e-4, 8, 1000, 500)  # eight to an interval
    program = Made(duration=1.0, segments=(1, 2))
    # four of a program
    assert sampling.grid(problem(path=program), 0.002) == (2001, 5e-4, 4, 1000, 500)
    # as the mesh that is asked for
    assert sampling.grid(problem(mesh=100), 0.004) == (1001, 1e-3, 4, 500, 250)
    assert sampling.grid(problem(limits=1), 0.004) == (1001, 1e-3, 4, 500, 250)
    assert sampling.grid(problem(resolving=0.005), 0.01) == (1001, 1e-3, 5, 500, 250)
    assert sampling.grid(problem(resolving=1e-5), 0.01) == (1001, 1e-3, 1, 500, 250)
    assert sampling.grid(problem(preview=0.1), 0.01) == (1001, 1e-3, 10, 100, 250)
    curved = Made(model=Made(coordinates=[Made(dof=Made(gear=Made(rigid=False, spring=Made())))]))
    assert sampling.grid(problem(equations=curved), 0.01) == (2001, 5e-4, 20, 1000, 500)
    force = Made(resolving=2e-3)
    assert sampling.grid(problem(force=force), 0.02) == (4001, 2.5e-4, 8, 2000, 1000)
    # half the longest interval
    assert sampling.grid(problem(force=force), 0.005) == (8001, 1.25e-4, 8, 4000, 2000)
    assert sampling.grid(problem(force=force, mesh=50), 0.02) == (1001, 1e-3, 20, 500, 250)


def test_samples_of_an_inversion_have_a_largest_number() -> None:
    """900,000 with those before and behind the path: coarser ones, or a refusal where an interval
    has none.
    """
    long = Made(duration=2.0, segments=(1,))
    n, period, inside, before, after = sampling.grid(problem(path=long, step=1e-6), 0.01)
    assert (n, period, inside, before, after) == (654546, 2 / 654545, 3273, 163637, 81819)
    with pytest.raises(ArgumentError, match="mesh: given") as refused:
        sampling.grid(problem(path=long, mesh=1, step=3e-6), 3e-6)
    told = (
        "mesh: given 3e-06 s, which makes 9.17e+05 intervals over 2.75 s, expected at most "
        "900000; take a coarser"
    )
    assert str(refused.value).startswith(told)
    # below the number
    assert sampling.grid(problem(path=long, mesh=1, step=3.1e-6), 3.1e-6)[0] == 645163


def test_a_residual_is_small_up_to_the_bound_of_the_method() -> None:
    """A thousandth, a hundredth of the method full, any of a baseline."""
    for status, method, residual, small in (
        (Status.SOLVED, "lq", 1e-3, True),
        (Status.SOLVED, "lq", 1.001e-3, False),
        (Status.SOLVED, "full", 1e-2, True),
        (Status.SOLVED, "full", 1.001e-2, False),
        (Status.BASELINE, "rigid", 10.0, True),
    ):
        solution: Any = Made(status=status, method=method, residual_relative=residual)
        assert unverified_solution.residual_is_small(solution) is small


def test_a_combination_has_no_distance_from_its_path() -> None:
    equations: Any = Made(model=Made(output=Made(type="combination")))
    assert verification.path_distance(equations, None, None) is None  # type: ignore[arg-type]
    near: Any = Made(model=Made(output=Made(type="tool_position")), function=lambda name: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        verification.path_distance(near, None, None)  # type: ignore[arg-type]


def test_arrays_are_what_has_entries_or_a_type_of_numbers() -> None:
    arrays: list[Any] = [[1], (), np.float64(1.0), np.zeros(2), {}.values()]
    others: list[Any] = [1.0, None, "text", {}, iter(())]
    assert [_is_any_array(value) for value in arrays + others] == [True] * 5 + [False] * 5


def test_moments_of_mass_that_rounding_left_are_zero_or_alike() -> None:
    """Relative to the largest second moment, to the mass, and to the root of their product."""
    small = 0.9 * ROUNDING
    mass = 3.0
    second = np.array(
        [[4.0, 4 * small, 1e-9], [0.0, 4.0 + 4 * small, 0.0], [1e-9, 0.0, 4.0 - 4 * small]]
    )
    first = np.array([np.sqrt(12.0) * small, np.sqrt(12.0) * 1.2 * ROUNDING, -0.5])
    found = _tidy(
        Inertia(mass * small, first, second), Inertia(mass, np.zeros(3), np.diag([4.0, 4.0, 4.0]))
    )
    assert found.mass == 0.0 and found.first.tolist() == [0.0, first[1], -0.5]
    assert found.second.tolist() == [[4.0, 0.0, 1e-9], [0.0, 4.0, 0.0], [1e-9, 0.0, 4.0]]
    apart = np.diag([1.0, 1.0 + 1.5 * ROUNDING, -1.0])
    kept = _tidy(Inertia(2.0, np.ones(3), apart), Inertia(2.0, np.ones(3), np.eye(3)))
    assert kept.mass == 2.0 and np.array_equal(kept.second, apart)


def test_noise_of_drives_and_sensors_adds_up_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Angles as accelerations, ``w^2``; a sensor that is read less often counts more; torques
    through G.
    """
    sensor = Made(name="acc", channels=("acc.x", "acc.y"), sample_s=4e-3)
    model: Any = Made(sensors=[sensor])
    hardware = Made(
        encoder_noise_rad=1e-4, encoder_resolution_rad=6e-4, torque_noise_Nm=0.3, sample_s=1e-3
    )
    plan: Any = Made(hardware=hardware, motors=("m1",), samples=200, sensors=("acc.y",))
    monkeypatch.setattr(operating_points, "noises", lambda model, names: np.array([0.02]))
    monkeypatch.setattr(operating_points, "output_orders", lambda model, names: np.array([2, 0]))
    w = np.array([2.0, 3.0])
    G = np.array([[[1.0 + 1j], [2.0]], [[0.5], [1j]]])
    found = operating_points.noise_covariance(G, w, plan, model)
    for k in range(2):
        angle = (1e-8 + 36e-8 / 12) * w[k] ** 4
        by_hand = np.diag([angle, 0.02**2 * 4.0]) + 0.09 * G[k] @ G[k].conj().T
        assert_allclose(found[k], 4.0 / 200 * by_hand, rtol=1e-12)
    hardware.torque_noise_Nm = hardware.encoder_noise_rad = hardware.encoder_resolution_rad = 0.0
    still = operating_points.noise_covariance(G, w, plan, model)
    assert_allclose(still[0][0, 0], 4.0 / 200 * (1e-24 * 16 + 1e-18 * 2), rtol=1e-9)


def test_what_a_digest_depends_on(tmp_path: Path) -> None:
    """Not on texts, the order of keys or the way a number is written."""
    entries = {"name": "a", "gravity": [0, 0, -9.81], "flag": True, "table": {"b": 1, "a": 2.5}}

    def canonical(entries: dict[str, Any]) -> str:
        def entry(value: Any) -> Any:
            if isinstance(value, dict):
                value = {key: entry(x) for key, x in value.items()}
            return Made(value=[entry(x) for x in value] if isinstance(value, list) else value)

        root: Any = Made(entries={key: entry(value) for key, value in entries.items()})
        return reader._canonical(root)

    text = canonical(entries)
    assert (
        json.loads(text) == entries
        and '"gravity": [0.0, 0.0, -9.81]' in text
        and '"flag": true' in text
    )
    assert text.index('"a": 2.5') < text.index('"b": 1.0')
    assert (
        canonical(
            dict(reversed(entries.items()))
            | {"description": "b", "source": "c", "uncertainty": {}}
        )
        == text
    )
    assert canonical(entries | {"name": "b"}) != text


def test_a_log_file_that_cannot_be_written_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the reason of the system, or what the error says; the computation continues."""
    told: list[str] = []
    monkeypatch.setattr(main, "_log", told.append)
    path = tmp_path / "run.log"
    for error, reason in (
        (OSError(28, "No space left"), "No space left"),
        (OSError("gone"), "gone"),
    ):

        def write(text: str, error: OSError = error) -> None:
            raise error

        log = main._Messages(
            argparse.Namespace(quiet=True, verbose=False, log=path), ["run", "a b"]
        )
        log.close()
        log._file = Made(write=write)  # type: ignore[assignment]
        log.progress("a step")
        log.progress("another")
        assert told == [f"flexgen: warning: cannot write to {path} ({reason}); the log ends here"]
        told.clear()
    lines = path.read_text().splitlines()
    assert len(lines) == 2 and all(line.endswith(": run 'a b'") for line in lines)


def test_progress_is_told_with_its_time_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All lines of it are in the log file, each with its time."""
    told: list[str] = []
    monkeypatch.setattr(main, "_log", told.append)
    for quiet, verbose, expected in (
        (False, False, ["a\nb", "c"]),
        (True, False, ["c"]),
        (False, True, None),
    ):
        path = tmp_path / f"{quiet}{verbose}.log"
        log = main._Messages(argparse.Namespace(quiet=quiet, verbose=verbose, log=path), ["run"])
        log.progress("a\nb")
        log.report("c")
        log.close()
        assert told == (expected or ["[   0.00 s] a\nb", "c"])
        told.clear()
        lines = path.read_text().splitlines()
        assert [line.partition(" ")[2] for line in lines[1:]] == ["a", "b", "c"]
        # milliseconds and the zone
        assert all(line[10] == "T" and line[23] in "+-" for line in lines)


def test_versions_of_benchmarks_by_name_and_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """The newest by default; a version that the name states, too, is the same."""
    monkeypatch.setattr(scenario_file, "parse_table", lambda path, data, known: (path.name, known))
    found: Any = scenario_file.scenario
    for name, version, number in (
        ("four_mass", None, 2),
        ("four_mass@1", None, 1),
        ("four_mass@1", 1, 1),
    ):
        assert found(name, version) == (f"four_mass-{number}.toml", ("four_mass", number))
    for name, version, given in (
        ("four_mass@99", None, 99),
        ("four_mass@x", None, -1),
        ("four_mass@0001", None, -1),
        ("four_mass@2", 1, 1),
        ("four_mass@01", None, 1),
        ("four_mass", 99, 99),
        ("four_mass", True, True),
    ):
        with pytest.raises(ArgumentError) as refused:
            found(name, version)
        assert str(refused.value) == f"version of {name}: given {given}, expected one of 1, 2"
    with pytest.raises(
        ArgumentError,
        match=r"scenario: given 'five_mass', expected .* or the path of a \.toml file",
    ):
        found("five_mass")
    with pytest.raises(
        ArgumentError,
        match=r"version: given 1 with the file a\.toml, expected none: the file states",
    ):
        found("a.toml", 1)


def test_a_sweep_needs_an_empty_folder(tmp_path: Path) -> None:
    """Hidden files do not count."""

    class Grid:
        digest = "digest"

        def __len__(self) -> int:
            return 7

        def describe(self) -> dict[str, Any]:
            return {"models": ["arm"]}

    grid: Any = Grid()

    def made(path: Path, size: int | None = 3) -> Any:
        return folder.Folder(path, grid, "code", size, False, lambda line: None)

    file = tmp_path / "file"
    full = tmp_path / "full"
    file.write_text("x")
    with pytest.raises(
        ArgumentError, match=r"sweep: given .*file', which is a file, expected a folder"
    ):
        made(file)
    full.mkdir()
    (full / ".hidden").write_text("x")
    assert made(full).shard_size == 3
    about = json.loads((full / "sweep.json").read_text())
    assert (
        about["cases"] == 7
        and about["shard_size"] == 3
        and about["grid"] == "digest"
        and about["code"] == "code"
    )
    other = tmp_path / "other"
    other.mkdir()
    (other / "seen").write_text("x")
    with pytest.raises(
        ArgumentError, match="which contains other files, expected an empty or a new folder; take"
    ):
        made(other)
