"""Every script in benchmarks/ runs in its shortest form; a script without one is found.

Numbers are not judged here: times are those of one machine. A script that stops, because a name it
uses has gone, would be noticed at the next release only.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 1800.0  # s of wall time: a shortest form takes about a minute on an idle core
# The file of results of some scripts is made in a folder of its own.
RESULTS = "RESULTS.json"
# So is the folder of records.
FOLDER = "FOLDER"

# Script -> its words in the shortest form: prints, and writes no page.
SHORTEST = {
    "arrays.py": ["elbow"],
    "autodiff/measure.py": ["--quick"],
    "batches/measure.py": ["elbow", "--quick"],
    "claims/claims.py": [RESULTS, "--quick"],
    "closed_form_sweep.py": ["20"],
    "commissioning/coverage.py": [FOLDER, "--seeds", "3"],
    "commissioning/faults.py": [FOLDER, "--only", "exchanged"],
    "commissioning/trial.py": [FOLDER, "--quick"],
    "compilers/compilers.py": ["elbow"],
    "control.py": ["--quick"],
    "feedback_study.py": ["--quick"],
    "coupling/coupling.py": ["--quick"],
    "forces/hysteresis.py": ["--quick"],
    "forces/milling.py": ["--quick"],
    "identification.py": ["--quick"],
    "identification_faults/identification_faults.py": [RESULTS, "none, elbow"],
    "inversion.py": ["--quick", "--robots", "planar5_nmp"],
    "kernel.py": ["gcc"],
    "loops/loops.py": ["--quick"],
    "models.py": ["elbow"],
    "peers.py": ["--quick", "--robots", "ur5"],
    "planning.py": ["--quick"],
    "redundancy/redundancy.py": ["--quick"],
    "reversals/reversals.py": [RESULTS, "--quick"],
    "sizes.py": ["elbow"],
    "trees/trees.py": ["--quick"],
    "uncertainty/coverage.py": ["planar5_nmp"],
    "uncertainty/intervals.py": ["--draws", "4", "1"],
}
# Those that end within a minute or two run with the slow tests, the others with `make test-full`.
QUICK = {
    "closed_form_sweep.py",
    "forces/hysteresis.py",
    "forces/milling.py",
    "inversion.py",
    "kernel.py",
    "loops/loops.py",
    "models.py",
    "reversals/reversals.py",
    "trees/trees.py",
    "uncertainty/coverage.py",
}
# What they need in addition to flexgen, its packages for tests, and a C compiler.
NEEDS = {
    "arrays.py": ["jax", "torch"],
    "autodiff/measure.py": ["jax", "torch"],
    "sizes.py": ["arm-none-eabi-gcc", "aarch64-linux-gnu-gcc", "qemu-system-arm", "objdump"],
    "peers.py": ["g++", "pkg-config"],
}
# Scripts that other scripts start, and what no machine of the tests has.
OTHERS = {
    "array_parts/gpu.py": "needs a GPU",
    "commissioning/flexible_joints.py": "started on the folder of commissioning/trial.py",
    "commissioning/learning.py": "started on a model for the folder of commissioning/trial.py",
    "inversion_opty.py": "started by inversion.py, with an interpreter that has opty",
    "planning_peers/opty_rest_to_rest.py": "started by planning.py, as inversion_opty.py",
}


def scripts(texts: Mapping[str, str]) -> list[str]:
    """Those of the files that can be started."""
    return sorted(name for name, text in texts.items() if re.search(r"^if __name__", text, re.M))


def read_scripts() -> dict[str, str]:
    folder = ROOT / "benchmarks"
    return {
        path.relative_to(folder).as_posix(): path.read_text(encoding="utf-8")
        for path in folder.rglob("*.py")
    }


def test_every_script_has_a_shortest_form() -> None:
    found = read_scripts()
    assert scripts(found) == sorted({**SHORTEST, **OTHERS})
    for script, words in SHORTEST.items():
        if "--quick" in words:
            assert "--quick" in found[script], script
    planted = {**found, "new.py": 'if __name__ == "__main__":\n    main()\n'}
    assert set(scripts(planted)) - {*SHORTEST, *OTHERS} == {"new.py"}


def test_names_that_scripts_import_from_flexgen_are_there() -> None:
    """Without running them: modules and names of all import statements, in functions too."""
    pattern = re.compile(r"^[ \t]*from (flexgen[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
    wanted = {
        (module, name.split(" as ")[0].strip())
        for text in read_scripts().values()
        for module, names in pattern.findall(text)
        for name in re.sub(r"#[^\n]*", "", names).strip("()").split(",")
        if name.strip()
    }
    lines = [f"from {module} import {name}" for module, name in sorted(wanted)]
    optional = [line for line in lines if "torch" in line or "jax" in line or "cuda" in line]
    checked = [line for line in lines if line not in optional]
    assert len(checked) > 60
    for line in checked:
        exec(line, {})


@pytest.mark.slow
@pytest.mark.parametrize(
    "script",
    [pytest.param(name, marks=[] if name in QUICK else pytest.mark.full) for name in SHORTEST],
)
def test_the_shortest_form_runs(script: str, tmp_path: Path) -> None:
    """To its end, with something printed, and no page of the repository changed."""
    for need in NEEDS.get(script, []):
        if shutil.which(need) is None and find_spec(need) is None:
            pytest.skip(f"no {need}")
    folder = ROOT / "benchmarks"
    before = {
        path: path.stat().st_mtime_ns for path in folder.rglob("*.*") if path.suffix != ".pyc"
    }
    words = [
        str(tmp_path / word) if word in (RESULTS, FOLDER) else word for word in SHORTEST[script]
    ]
    done = subprocess.run(
        [sys.executable, str(folder / script), *words],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip()
    after = {
        path: path.stat().st_mtime_ns for path in folder.rglob("*.*") if path.suffix != ".pyc"
    }
    assert after == before
