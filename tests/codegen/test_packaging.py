"""The distribution: its name and version, the data files of the package, the extras of the
Makefile.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import subprocess
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import flexgen

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def unpacked(settings: dict) -> list[str]:
    """Files of the packages, other than modules, that no pattern of package-data takes along."""
    tools = settings["tool"]["setuptools"]
    left = []
    for package in tools["packages"]:
        folder = ROOT / package.replace(".", "/")
        patterns = ["*.py", *tools["package-data"].get(package, ())]
        files = [path for path in folder.iterdir() if path.is_file()]
        left += [
            f"{package}: {file.name}"
            for file in files
            if not any(fnmatch(file.name, p) for p in patterns)
        ]
    return left


def test_name_and_version():
    project = SETTINGS["project"]
    assert project["name"] == "flexgen-robotics" and project["scripts"] == {
        "flexgen": "flexgen.cli.main:main"
    }
    assert "version" not in project and SETTINGS["tool"]["setuptools"]["dynamic"] == {
        "version": {"attr": "flexgen.base.version.__version__"}
    }
    assert re.fullmatch(r"\d+\.\d+\.\d+", flexgen.__version__)


def test_every_file_of_the_packages_is_in_the_wheel():
    assert unpacked(SETTINGS) == []
    assert (ROOT / "flexgen" / "py.typed").exists()


def test_a_file_without_a_pattern_is_seen():
    data = SETTINGS["tool"]["setuptools"]["package-data"]
    settings = {
        "tool": {
            "setuptools": {
                **SETTINGS["tool"]["setuptools"],
                "package-data": {**data, "flexgen": []},
            }
        }
    }
    assert sorted(unpacked(settings)) == ["flexgen: __init__.pyi", "flexgen: py.typed"]


def test_extras_are_those_of_the_makefile():
    """Running needs no extra; tests and lint install their own."""
    assert set(SETTINGS["project"]["optional-dependencies"]) == {
        *(
            "parquet",
            "distributed",
            "pandas",
            "xarray",
            "control",
            "docs",
            "notebooks",
            "fmi",
            "compiler",
            "jax",
            "cuda",
            "torch",
        ),
        *("test", "lint", "dev"),
    }
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert set(re.findall(r"'\.\[(\w+)\]'", makefile)) == {"test", "docs", "lint", "compiler"}
    for heavy in ("mujoco", "pin", "dask", "pyarrow", "pytest", "ruff", "mypy"):
        assert not any(
            re.match(rf"{heavy}\b", word) for word in SETTINGS["project"]["dependencies"]
        )


def test_every_example_is_in_the_sdist_and_the_wheel():
    data = SETTINGS["tool"]["setuptools"]["data-files"]
    taken = {
        path for patterns in data.values() for pattern in patterns for path in ROOT.glob(pattern)
    }
    there = {
        path
        for path in (ROOT / "examples").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert sorted(path.relative_to(ROOT).as_posix() for path in there ^ taken) == []
    for folder, patterns in data.items():  # an example stays in its folder
        assert {f"share/flexgen/{pattern.rpartition('/')[0]}" for pattern in patterns} == {folder}


def test_the_container_copies_what_the_wheel_needs():
    """The image is not built here: every file that it copies exists, and its parts are named as in
    the Makefile.
    """
    text = (ROOT / ".devcontainer" / "Dockerfile").read_text(encoding="utf-8")
    copied = {
        word
        for line in re.findall(r"^COPY (.*) \S+$", text, re.MULTILINE)
        for word in line.split()
    }
    assert all((ROOT / name).exists() for name in copied)
    assert {"pyproject.toml", "README.md", "LICENSE", "flexgen", "models", "examples"} <= copied
    settings = json.loads(
        (ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8")
    )
    assert settings["build"]["target"] in re.findall(r"^FROM \S+ AS (\w+)$", text, re.MULTILINE)
    (target,) = re.findall(r"^make ([\w-]+)$", settings["postCreateCommand"])
    assert f"\n{target}:" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_help_lists_every_target():
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    (targets,) = re.findall(r"^\.PHONY:(.*)$", text, re.MULTILINE)
    out = subprocess.run(
        ["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert sorted(
        line.split()[1] for line in out.splitlines() if line.startswith("make ")
    ) == sorted(targets.split())


def test_the_recipe_of_the_conda_package_is_that_of_the_sdist(tmp_path):
    spec = importlib.util.spec_from_file_location("conda", ROOT / ".ci" / "conda.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    with pytest.raises(SystemExit, match=r"0 archives \.tar\.gz, expected one; make dist"):
        script.write(tmp_path)
    archive = tmp_path / f"flexgen_robotics-{flexgen.__version__}.tar.gz"
    archive.write_bytes(b"sources")
    recipe = json.loads(script.write(tmp_path).read_text(encoding="utf-8"))
    assert recipe["package"] == {"name": "flexgen-robotics", "version": flexgen.__version__}
    assert recipe["source"] == {
        "path": archive.name,
        "sha256": hashlib.sha256(b"sources").hexdigest(),
    }
    python, *run = map(Requirement, recipe["requirements"]["run"])
    assert f"{python.name}{python.specifier}" == f"python{SETTINGS['project']['requires-python']}"
    assert run == list(map(Requirement, SETTINGS["project"]["dependencies"]))
    assert recipe["build"]["python"]["entry_points"] == ["flexgen = flexgen.cli.main:main"]
    for name in recipe["about"]["license_file"]:
        assert (ROOT / name).is_file()
