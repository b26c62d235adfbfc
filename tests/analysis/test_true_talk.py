"""Texts of verbs say each thing once, with its unit, and no number that is not known."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.analysis.compliance import ToolCompliance
from flexgen.cli.main import main

CRANE = """
name = "crane"
gravity = [0, 0, -9.81]
home_rad = [0.0]
[[element]]
name = "trolley"
body = { mass = 20.0, com = [0, 0, 0], inertia = [0.1, 0.1, 0.1] }
[[element.dof]]
name = "x"
type = "translation"
axis = [1, 0, 0]
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 9e5 }, damping = \
600.0 }
[[element]]
name = "load"
body = { mass = 5.0, com = [0, 0, -1.0], inertia = [0.01, 0.01, 0.01] }
[[element.dof]]
name = "swing"
type = "rotation"
axis = [0, 1, 0]
spring = { type = "linear", stiffness = 0.0 }
damping = DAMPING
[[motor]]
name = "m1"
drives = "x"
ratio = 50.0
inertia = 1e-4
[tool]
position = [0, 0, -1.0]
[output]
type = "tool_position"
axes = "x"
"""


def crane(folder: Path, damping: float) -> str:
    file = folder / "crane.toml"
    file.write_text(CRANE.replace("DAMPING", repr(damping)))
    return str(file)


def test_a_mode_without_damping_has_no_number_for_it(tmp_path: Path) -> None:
    """The rounding error of a damping of zero gave 1e-11, and a compliance of 1.8e11 um/N."""
    found = flexgen.analyze(crane(tmp_path, 0.0))
    text = found.to_text()
    assert "< 1e-07" in text and "not bounded: a mode without damping" in text
    assert not re.search(r"e-1\d\b|e\+1\d um", text)
    assert found.to_dict()["compliance"]["resonance_m_per_N"] is None
    # m l^2 and m g l of the pendulum: the largest response of a damped one is known
    damped = flexgen.analyze(crane(tmp_path, 0.5)).to_text()
    assert "not bounded" not in damped and "< 1e-07" not in damped


def test_a_small_damping_is_a_number() -> None:
    """The ratio of 1e-4 gives half of its inverse; that of zero gives infinity."""
    J = np.zeros((6, 1))
    J[0] = 1.0
    M = np.array([[2.0]])
    K = np.array([[200.0]])
    peak = ToolCompliance(M, np.array([[4e-3]]), K, J).resonance()
    assert peak is not None and peak[1] == pytest.approx(1 / 200 / 2e-4, rel=1e-3)
    peak = ToolCompliance(M, np.zeros((1, 1)), K, J).resonance()
    assert peak is not None and peak[1] == np.inf


def test_the_advice_at_a_flat_point_is_the_method_that_is_taken(tmp_path: Path) -> None:
    note = flexgen.analyze(crane(tmp_path, 0.0)).to_text().rpartition("note: ")[2]
    assert "near a flat point" in note and "tries lq and then spline" in note
    assert "use lq" not in note


def test_check_prints_each_finding_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "elbow", "--set", "motor.m1.inertia=1.0"]) == 0
    out = capsys.readouterr().out
    found = flexgen.check(flexgen.read("elbow", overrides={"motor.m1.inertia": 1.0}))
    assert found.warnings
    for one in found.warnings:
        assert out.count(f"{one.quantity}: {one.value}, usual {one.usual}") == 1
        assert out.count(one.advice) == sum(other.advice == one.advice for other in found.warnings)
    assert out.count("unusual:") == len(found.warnings)


def test_an_unstable_loop_has_no_figures_of_accuracy() -> None:
    """Planted: the same run, said to be unstable; its figures have no meaning then."""
    run = flexgen.control("elbow")
    assert not run.unstable
    assert "ISO 9283" in run.to_text()
    vars(run)["unstable"] = {"nominal": "an eigenvalue of 1.2"}
    text = run.to_text()
    assert "ISO 9283" not in text and "unstable" in text


def test_the_deviation_of_a_smooth_path_is_a_note_with_its_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.linspace(0.0, 2.0, 201)
    s = t / 2.0
    u = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    rows = zip(t, np.round(0.3 + 0.5 * u, 4), np.round(-1.1 + 0.3 * u, 4), strict=True)
    text = "\n".join(",".join(f"{x:.6g}" for x in row) for row in rows)
    (tmp_path / "s.csv").write_text(f"t,q1,q2\n{text}\n")
    model = (Path(flexgen.__file__).parent / "model" / "shipped" / "planar5_nmp.toml").read_text()
    move = '[[move]]\nname = "rec"\ntype = "sampled"\nfile = "s.csv"\nsmooth = 1e-4\n'
    file = tmp_path / "arm.toml"
    file.write_text(model.replace("[[move]]", f"{move}\n[[move]]", 1))
    assert main(["plan", str(file), "--move", "rec"]) == 0
    planned = capsys.readouterr()
    assert main(["solve", str(file), "--move", "rec"]) == 0
    solved = capsys.readouterr()
    for told in (planned, solved):
        assert re.search(
            r"note: .*at most \S+ rad from the samples \(smooth = 0.0001 rad\)", told.out
        )
        assert "warning" not in told.err
