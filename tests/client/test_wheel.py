"""The wheel: what it contains, and that it works in an empty environment."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import flexgen

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = 77  # the oldest that pyproject.toml accepts


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, so that nothing is left in the clone."""
    if int(version("setuptools").partition(".")[0]) < SETUPTOOLS:
        pytest.skip(f"setuptools is older than {SETUPTOOLS}; run: make setup-test")
    folder = tmp_path_factory.mktemp("wheel")
    clone = folder / "clone"
    hidden = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("flexgen", "models"):
        shutil.copytree(ROOT / name, clone / name, ignore=hidden)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, clone)
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, "-w", folder, clone], check=True)
    (made,) = folder.glob("*.whl")
    return made


def test_it_contains_all_that_is_in_the_packages(wheel: Path) -> None:
    assert wheel.name.startswith(f"flexgen_robotics-{flexgen.__version__}-")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    expected = {path.relative_to(ROOT).as_posix() for path in (ROOT / "flexgen").rglob("*") if path.is_file()}
    expected = {name for name in expected if "__pycache__" not in name}
    expected |= {f"flexgen/models/{path.name}" for path in (ROOT / "models").iterdir() if path.is_file()}
    assert {name for name in names if not name.partition("/")[0].endswith(".dist-info")} == expected
    assert "flexgen/py.typed" in names and "flexgen/models/elbow.toml" in names
    assert any(name.startswith("flexgen/clib/") and name.endswith(".c") for name in names)


def test_it_works_in_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    """Only the dependencies are lent to the environment."""
    place = tmp_path / "empty"
    venv.create(place, symlinks=True)
    python = place / "bin" / "python"
    options = ["--no-deps", "--no-index", "--quiet"]
    subprocess.run([sys.executable, "-m", "pip", "--python", python, "install", *options, wheel], check=True)
    (packages,) = place.glob("lib/python*/site-packages")
    (packages / "dependencies.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}

    def call(*words: object) -> str:
        command = [str(word) for word in words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert Path(call(python, "-c", "import flexgen; print(flexgen.__file__)").strip()).is_relative_to(place)
    command = place / "bin" / "flexgen"
    assert call(command, "--version").split() == ["flexgen", flexgen.__version__]
    assert "elbow" in call(command, "models")
    solved = json.loads(call(command, "solve", "elbow", "--json"))
    assert solved["status"] == "solved"
    call(command, "generate", "elbow", "--no-build")
    made = tmp_path / "generated" / "elbow"
    assert {"elbow.h", "manifest.json"} <= {path.name for path in made.iterdir()}
