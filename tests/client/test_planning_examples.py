"""The scripts of planned motions: short, they run, print their table and write a picture."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = {
    "minimum_energy": "least losses",
    "minimum_time": "planned, free time law",
    "soft_tracking": "limits active",
    "obstacle_avoidance": "clearance of the tool",
}


def run(name: str, folder: Path) -> str:
    script = ROOT / "examples" / f"{name}.py"
    assert len(script.read_text(encoding="utf-8").splitlines()) <= 40
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    found = subprocess.run(
        [sys.executable, str(script)],
        cwd=folder,
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert (folder / f"{name}.png").stat().st_size > 10_000
    assert SCRIPTS[name] in found.stdout
    return found.stdout


@pytest.mark.slow
def test_minimum_energy(tmp_path):
    out = run("minimum_energy", tmp_path)
    line, plan = (float(row.split()[2]) for row in out.splitlines()[1:3])
    assert plan < 0.6 * line and out.rstrip().endswith("solved")


@pytest.mark.slow
def test_minimum_time(tmp_path):
    out = run("minimum_time", tmp_path)
    given, fastest, planned, rigid = map(float, re.findall(r"(\d\.\d{4}) s\b", out))
    assert rigid < planned < 1.01 * fastest < given and out.rstrip().endswith("solved")


@pytest.mark.slow
def test_soft_tracking(tmp_path):
    out = run("soft_tracking", tmp_path)
    off = [float(row.split()[1]) for row in out.splitlines()[2:5]]
    assert off[0] < 0.1 < off[1] < off[2]  # mm: weaker motors, larger errors


@pytest.mark.full
def test_obstacle_avoidance_with_18_degrees_of_freedom(tmp_path):
    out = run("obstacle_avoidance", tmp_path)
    straight, planned = (float(row.split()[-2]) for row in out.splitlines()[1:3])
    assert straight < -50.0 and planned > -0.1  # mm
    assert "\nsolved, " in out
