"""Wheel and sdist: what they contain, that their bytes repeat, and that the wheel works in an
empty environment.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest
from installations import built, clone_at, environment_at, install, need_setuptools

import flexgen

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, so that nothing is left in the clone."""
    need_setuptools()
    folder = tmp_path_factory.mktemp("wheel")
    return built(clone_at(folder / "clone"), folder / "dist")


def examples() -> set[str]:
    """All files of examples/ that are part of the project."""
    files = (path for path in (ROOT / "examples").rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts}


def test_it_contains_all_that_is_in_the_packages(wheel: Path) -> None:
    assert wheel.name.startswith(f"flexgen_robotics-{flexgen.__version__}-")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    expected = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "flexgen").rglob("*")
        if path.is_file()
    }
    expected = {name for name in expected if "__pycache__" not in name}
    expected |= {
        f"flexgen/model/shipped/{path.name}"
        for path in (ROOT / "models").iterdir()
        if path.is_file()
    }
    data = f"flexgen_robotics-{flexgen.__version__}.data/data/share/flexgen/"
    expected |= {data + name for name in examples()}
    assert {
        name for name in names if not name.partition("/")[0].endswith(".dist-info")
    } == expected
    assert "flexgen/py.typed" in names and "flexgen/model/shipped/elbow.toml" in names
    assert any(name.startswith("flexgen/codegen/clib/") and name.endswith(".c") for name in names)


def test_the_sdist_contains_all_that_the_wheel_needs(wheel: Path) -> None:
    (archive,) = wheel.parent.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    with zipfile.ZipFile(wheel) as made:
        packaged = {
            name
            for name in made.namelist()
            if name.startswith("flexgen/") and "/models/" not in name
        }
    assert (
        packaged
        | examples()
        | {"pyproject.toml", "LICENSE", "README.md", "flexgen/model/shipped/elbow.toml"}
        <= names
    )


def test_the_bytes_of_both_repeat(wheel: Path) -> None:
    """From sources with other times, by a user with another umask, in another folder."""
    other = wheel.parents[1] / "elsewhere" / "clone"
    shutil.copytree(wheel.parents[1] / "clone", other, symlinks=True)
    for path in other.rglob("*"):
        os.utime(path, (1.6e9, 1.6e9))
    again = built(other, other.parent / "dist", 0o077)
    for first, second in zip(
        sorted(wheel.parent.iterdir()), sorted(again.parent.iterdir()), strict=True
    ):
        assert first.name == second.name and first.read_bytes() == second.read_bytes()
    source = other / "flexgen" / "base" / "errors.py"
    source.write_text(source.read_text("utf-8") + "\n", "utf-8")  # planted: another source
    changed = built(other, other.parent / "changed", 0o022)
    assert changed.read_bytes() != again.read_bytes()


def test_it_works_in_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    """Only the dependencies are lent to the environment."""
    place = tmp_path / "empty"
    python = environment_at(place)
    install(python, wheel)
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}

    def call(*words: object) -> str:
        command = [str(word) for word in words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert Path(
        call(python, "-c", "import flexgen; print(flexgen.__file__)").strip()
    ).is_relative_to(place)
    command = place / "bin" / "flexgen"
    assert call(command, "--version").split() == ["flexgen", flexgen.__version__]
    assert "elbow" in call(command, "models")
    solved = json.loads(call(command, "solve", "elbow", "--json"))
    assert solved["status"] == "solved"
    call(command, "generate", "elbow", "--no-build")
    made = tmp_path / "generated" / "elbow"
    assert {"elbow.h", "manifest.json"} <= {path.name for path in made.iterdir()}
    shared = place / "share" / "flexgen"
    installed = {
        path.relative_to(shared).as_posix() for path in shared.rglob("*") if path.is_file()
    }
    assert {name for name in installed if "__pycache__" not in name} == examples()
    output = call(
        python, shared / "examples" / "gallery" / "flexible_link.py", tmp_path / "pictures"
    )
    assert "12.365" in output and (tmp_path / "pictures" / "flexible_link.svg").exists()
