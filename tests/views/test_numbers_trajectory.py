"""Trajectories: what their constructor refuses, channels by name, tables of other packages; the
verb `run`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from verb_arguments import arguments

import flexgen
from flexgen.base.errors import ArgumentError, ChannelError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.cli.verbs import run as verb


def made(**changes: Any) -> Trajectory:
    """Two channels, one of them of an angle and a length."""
    given: dict[str, Any] = {
        "time": np.array([0.0, 0.5, 2.0]),
        "channels": {"tau_m": np.arange(6.0).reshape(3, 2), "q_a": np.ones((3, 2))},
        "ports": {
            "tau_m": Port("tau_m", (2,), "N m", "torques"),
            "q_a": Port("q_a", (2,), "rad or m", "coordinates"),
        },
        "labels": {"tau_m": ("m1", "m2"), "q_a": ("q1", "s")},
        "meta": {"model": "arm", "kind": "made up"},
        "units": {"q_a": ("rad", "m")},
    }
    return Trajectory(**(given | changes))


def test_wrong_parts_of_a_trajectory_are_refused() -> None:
    grid = (
        "trajectory: given a time grid that does not increase, expected at least 2 increasing "
        "instants"
    )
    other = Port("tau_m", (1,), "N m", "torques")
    named = (
        "trajectory: given channels, ports and labels with different names, expected the same "
        "names"
    )
    channels = made().channels
    ports = made().ports
    labels = made().labels
    for changes, text in (
        ({"time": np.array([0.0, 0.5, 0.5])}, grid),
        ({"time": np.array([0.0, np.nan, 1.0])}, grid),
        ({"time": np.array([0.0])}, grid),
        ({"time": np.zeros((3, 1))}, grid),
        ({"channels": {"tau_m": channels["tau_m"]}}, named),
        ({"labels": {"tau_m": ("m1", "m2")}}, named),
        (
            {"labels": {**labels, "tau_m": ("m1",)}},
            "trajectory channel tau_m: given 1 labels, expected 2",
        ),
        (
            {"channels": {**channels, "tau_m": np.zeros((3, 1))}},
            "trajectory channel tau_m: given shape (3, 1), expected (3, 2)",
        ),
        (
            {"time": np.array([0.0, 1.0])},
            "trajectory channel tau_m: given shape (3, 2), expected (2, 2)",
        ),
        (
            {"units": {"q_a": ("rad", "m", "rad")}},
            "trajectory channel q_a: given 3 units, expected 2",
        ),
        (
            {"ports": {**ports, "tau_m": other}},
            "trajectory channel tau_m: given 2 labels, expected 1",
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            made(**changes)
        assert str(caught.value) == text
    assert made(time=np.array([0.0, 1e-9, 2.0])).time[1] == 1e-9
    assert made(units={}).units["q_a"] == ("rad or m", "rad or m") and made().units["tau_m"] == (
        "N m",
        "N m",
    )
    # of the port, where they differ from it
    assert made(units={"tau_m": ("N", "N")}).units["tau_m"] == ("N m", "N m")


def test_channels_that_are_not_there_are_told_with_those_that_are() -> None:
    trajectory = made()
    for name, text in (
        ("tau", "trajectory channel: given 'tau', expected tau_m (there are: tau_m, q_a)"),
        (
            "time",
            (
                "trajectory channel: given 'time', expected one of tau_m, q_a; the time is the "
                "attribute .time"
            ),
        ),
        (3, "trajectory channel: given 3, expected one of tau_m, q_a"),
        ([1], "trajectory channel: given [1], expected one of tau_m, q_a"),
    ):
        with pytest.raises(ChannelError) as caught:
            trajectory[name]  # type: ignore[index]
        assert caught.value.args[0] == text
    assert (
        list(trajectory) == list(trajectory.keys()) == ["tau_m", "q_a"]
        and "q_a" in trajectory
        and "t" not in trajectory
    )
    assert repr(trajectory) == "<Trajectory arm: 3 samples from 0 to 2 s, tau_m q_a>"
    assert repr(made(meta={})) == "<Trajectory: 3 samples from 0 to 2 s, tau_m q_a>"
    assert trajectory.columns() == ["tau_m[m1] N m", "tau_m[m2] N m", "q_a[q1] rad", "q_a[s] m"]


def test_tables_of_other_packages_have_units_and_labels(monkeypatch: pytest.MonkeyPatch) -> None:
    trajectory = made()
    packages: Any = {
        "pandas": Made(
            DataFrame=lambda table, **more: (table, more), Index=lambda x, name: (x, name)
        ),
        "xarray": Made(Dataset=lambda variables, **more: (variables, more)),
    }
    for name, package in packages.items():
        monkeypatch.setitem(sys.modules, name, package)
    table, more = trajectory.to_dataframe()
    assert np.array_equal(table, np.hstack([trajectory["tau_m"], trajectory["q_a"]]))
    assert more["index"][1] == "time s" and more["columns"] == trajectory.columns()
    variables, more = trajectory.to_xarray()
    dims, values, attributes = variables["tau_m"]
    assert dims == ("time", "tau_m_column") and values is trajectory["tau_m"]
    assert attributes == {"units": "N m", "long_name": "torques"} and variables["q_a"][2][
        "units"
    ] == ["rad", "m"]
    assert more["coords"]["q_a_column"] == ["q1", "s"] and more["coords"]["time"][2] == {
        "units": "s"
    }
    assert more["attrs"] == {"model": "arm", "kind": "made up"}
    for name, call in (("pandas", trajectory.to_dataframe), ("xarray", trajectory.to_xarray)):
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(ArgumentError) as caught:
            call()
        text = f"{call.__name__}: the package {name} is not installed; run: pip install {name}"
        assert str(caught.value) == text


# --- the verb run --------------------------------------------------------------------------------
@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("variant", ["", "stiff"])
def test_the_verb_run_tells_each_step(
    interrupted: bool, variant: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    steps: dict[str, Any] = {}
    trajectory = Made(save=lambda path: steps.setdefault("saved", path))
    solution = Made(
        move=Made(name="line"),
        interrupted=interrupted,
        trajectory=trajectory,
        warnings=("beware",),
        status=flexgen.Status.LIMITS_EXCEEDED,
        to_dict=lambda: {"status": "solved"},
    )
    robot = Made(name="arm", variant=variant, title="an arm", description="two  links\nin a plane")
    generated = Made(directory=Path("lib"), written=variant != "", to_dict=lambda: {"digest": "d"})
    monkeypatch.setattr(verb, "read_model", lambda args: robot)
    monkeypatch.setattr(verb, "derive_model", lambda args: "equations")
    monkeypatch.setattr(
        "flexgen.analysis.analyze.analyze",
        lambda equations: Made(to_dict=lambda: {"modes": [1.0]}),
    )
    monkeypatch.setattr(
        "flexgen.codegen.build.generate.generate", lambda robot, out, progress: generated
    )
    monkeypatch.setattr("flexgen.runtime.load", lambda directory: f"library of {directory}")
    monkeypatch.setattr("flexgen.inversion.solve.solve", lambda equations, **more: solution)
    monkeypatch.setattr(
        "flexgen.inversion.problem.problem_text.problem_of",
        lambda solution, accuracy: f"not within {accuracy:g}",
    )
    monkeypatch.setattr(
        "flexgen.codegen.build.agreement.compare_library", lambda library, *_: {"loaded": library}
    )
    monkeypatch.setattr(
        "flexgen.inversion.comparison.comparison.compare_methods", lambda *_: "compared"
    )
    monkeypatch.setattr(
        "flexgen.views.reports.html.write_report",
        lambda equations, solution, directory, **more: directory / "i.html",
    )
    monkeypatch.setattr("flexgen.views.reports.texts.figure_rows", lambda solution: [])
    monkeypatch.setattr("flexgen.views.reports.texts.figures", lambda rows: "figures")
    monkeypatch.setattr(
        "flexgen.views.reports.texts.steps_text", lambda *given: f"{len(given)} parts"
    )
    lines: list[str] = []
    answer = verb.run(arguments("solve"), lines.append)
    folder = Path("reports", "arm_stiff" if variant else "arm")
    assert lines[0] == "describe: an arm, two links in a plane" and answer.warnings == ["beware"]
    assert lines[1:3] == [
        "analyze: modes, poles and zeros at the home pose",
        "generate: C library",
    ]
    assert answer.problem == f"not within {1e-5:g}" and answer.interrupted == interrupted
    if interrupted:
        assert answer.text == f"figures\n\nwrote {folder / 'line.npz'}" and "report" not in lines
        assert answer.data == {
            "solve": {"status": "solved", "trajectory": str(folder / "line.npz")}
        }
        return
    assert lines[-1] == "report" and steps["saved"] == folder / "line.npz" and answer.failure == 3
    word = "wrote" if variant else "unchanged"
    assert (
        answer.text
        == f"5 parts\n\nwrote {folder / 'i.html'}\nwrote {folder / 'line.npz'}\n{word} lib"
    )
    seconds = answer.data.pop("seconds")
    assert 0 <= seconds < 60 and answer.data == {
        "model": "arm",
        "variant": variant,
        "analyze": {"modes": [1.0]},
        "generate": {"model": "arm", "variant": variant, "digest": "d"},
        "load": {"loaded": "library of lib"},
        "solve": {"status": "solved", "trajectory": str(folder / "line.npz")},
        "report": str(folder / "i.html"),
    }
