"""The program of docs/in_a_controller.md sends, cycle by cycle, the torques of `flexgen.solve`
with a hold.
"""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.cli.main import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "in_a_controller.md"
# The program prints four decimals; stream and whole path differ by the tolerance 1e-6 of a torque
# of 25 N m.
TOLERANCE_NM = 2e-4


def differences(lines: list[str], cycles: int) -> np.ndarray:
    """Torques of printed lines less those to send, ``cycles`` of 1 ms later [N m]."""
    command = flexgen.solve(
        "planar5_nmp", "line", hold="zoh", sample_time=1e-3, progress=False
    ).torque_command
    assert command is not None
    rows = np.array([[float(x) for x in re.findall(r"-?\d+\.\d+", line)] for line in lines])
    at = np.rint(1e3 * (rows[:, 0] - command.time[0])).astype(int) + cycles
    inside = (at >= 0) & (at < len(command.time))
    assert inside.sum() >= 5
    return np.abs(rows[inside, 1:] - command.values[at[inside]])


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_cycle_sends_the_torques_of_the_solution(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    (code,) = re.findall(r"```c\n(.*?)```", text, re.DOTALL)
    (command,) = re.findall(r"^    (cc .*)$", text, re.MULTILINE)
    (tmp_path / "reports").mkdir()
    with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()):
        for line in re.findall(r"^flexgen ((?:generate|path) .*)$", text, re.MULTILINE):
            assert main([*line.split(), "--quiet"]) == 0
        (tmp_path / "reports" / "cycle.c").write_text(code)
        subprocess.run(
            command.replace("cc ", "cc -Wall -Wextra -Wpedantic -Werror ", 1),
            shell=True,
            check=True,
        )
        done = subprocess.run(["reports/cycle"], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()[1:]
    assert differences(lines, 0).max() < TOLERANCE_NM
    assert differences(lines, 1).max() > 100 * TOLERANCE_NM  # planted: one cycle late
