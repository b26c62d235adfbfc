"""The verb ``run``: its steps, what it prints and writes, and where it ends early."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from emitted import made
from toolchain import needs_compiler

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.cli.main import main
from flexgen.inversion.solution import INTERRUPTED
from flexgen.inversion.solve import solve

pytestmark = needs_compiler
STEPS = ("describe: ", "analyze: ", "generate: ", "solve: ", "report")


@pytest.fixture
def ran(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Any:
    """Runs the verb with a library that is built already, and changes of the solution: status,
    standard output, standard error.
    """
    monkeypatch.chdir(tmp_path)

    def run(model: str, written: bool, *words: str, **changes: Any) -> tuple[int, str, str]:
        library = replace(made("elbow"), written=written)
        monkeypatch.setattr(
            "flexgen.codegen.build.generate.generate", lambda *given, **more: library
        )
        monkeypatch.setattr(
            "flexgen.inversion.solve.solve",
            lambda *given, **more: replace(solve(*given, **more), **changes),
        )
        status = main(["run", model, *words])
        return status, *capsys.readouterr()

    return run


@pytest.mark.usefixtures("undrawn")
def test_each_step_is_told_and_its_results_are_printed_and_written(ran: Any) -> None:
    status, text, log = ran("elbow", True)
    told = [line for line in log.splitlines() if line.startswith(STEPS)]
    assert [line.partition(":")[0] for line in told] == [x.partition(":")[0] for x in STEPS]
    assert told[0] == f"describe: elbow, {' '.join(flexgen.read('elbow').description.split())}"
    folder = Path("reports", "elbow")
    lines = text.splitlines()
    assert status == 0 and lines[-3:] == [
        f"wrote {folder / 'index.html'}",
        f"wrote {folder / 'line.npz'}",
        f"wrote {made('elbow').directory}",
    ]
    rows = dict(line.split("  ", 1) for line in lines if "  " in line)
    solution = flexgen.solve("elbow")
    largest = abs(solution.trajectory["tau_m"]).max()
    assert float(rows["motor torque, largest"].split()[0]) == pytest.approx(largest, rel=1e-3)
    assert "<svg" in (folder / "index.html").read_text(encoding="utf-8")
    assert (Trajectory.load(folder / "line.npz")["tau_m"] == solution.trajectory["tau_m"]).all()


@pytest.mark.usefixtures("undrawn")
def test_a_solution_beyond_its_limits_has_a_status_and_its_warnings(ran: Any) -> None:
    status, text, log = ran("elbow", False, "--json", "--set", "motor.m1.torque_max=5")
    data = json.loads(text)
    assert status == 3 and "flexgen: warning: motor m1: torque" in log
    assert data["load"]["difference_Nm"] < 1e-9 and 0.0 <= data["seconds"] < 300.0
    assert data["solve"]["trajectory"] == str(Path("reports", "elbow", "line.npz"))
    assert (data["model"], data["generate"]["model"]) == ("elbow", "elbow")
    assert data["analyze"]["modes_hz"][0] > 0.0 and "limits" in data["error"]


def test_after_an_interruption_the_best_motion_is_written_without_a_report(ran: Any) -> None:
    status, text, log = ran("elbow@payload", True, stopped=INTERRUPTED)
    folder = Path("reports", "elbow_payload")
    assert status == 130 and "the result is the best so far" in log
    assert text.splitlines()[-1] == f"wrote {folder / 'line.npz'}" and "report" not in log.split()
    assert [x.name for x in folder.iterdir()] == ["line.npz"]
