"""Installations of flexgen in empty environments: editable as `make setup` does, and from the
wheel.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = 77  # the oldest that pyproject.toml accepts


def need_setuptools() -> None:
    """Skip the test where setuptools is too old to build."""
    if int(version("setuptools").partition(".")[0]) < SETUPTOOLS:
        pytest.skip(f"setuptools is older than {SETUPTOOLS}; run: make setup-test")


def clone_at(folder: Path) -> Path:
    """A copy of what an installation needs, so that nothing is left in the clone."""
    hidden = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("flexgen", "models", "examples", ".ci"):
        shutil.copytree(ROOT / name, folder / name, ignore=hidden, symlinks=True)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    return folder


def built(clone: Path, folder: Path, umask: int = 0o022) -> Path:
    """The wheel that `.ci/dist.py` writes, in addition to the sdist."""
    environment = os.environ | {"SOURCE_DATE_EPOCH": "1700000000"}
    command = [sys.executable, clone / ".ci" / "dist.py", folder]
    done = subprocess.run(
        command, env=environment, umask=umask, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl")
    return made


def environment_at(place: Path) -> Path:
    """An empty environment to which only the dependencies are lent; its interpreter."""
    venv.create(place, symlinks=True)
    (packages,) = place.glob("lib/python*/site-packages")
    (packages / "dependencies.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    return place / "bin" / "python"


def install(python: Path, *what: str | Path) -> None:
    """Install into an environment, without an index."""
    options = ["--no-deps", "--no-index", "--no-build-isolation", "--quiet"]
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    command = [sys.executable, "-m", "pip", "--python", python, "install", *options, *what]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
