"""The digest of the sources of a library: what changes it, and that old C is not kept."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import flexgen
from flexgen.codegen.build.source_digest import emission_files, package_version, sources_digest

SOURCE = Path(flexgen.__file__).resolve().parent
ABOVE = (
    "cli/main.py",
    "exports/urdf/urdf.py",
    "inversion/solve.py",
    "paths/path.py",
    "views/plots/__init__.py",
    "simulation/simulate.py",
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources of flexgen, to be changed and changed back."""
    target = tmp_path_factory.mktemp("copied") / "flexgen"
    return Path(shutil.copytree(SOURCE, target, ignore=shutil.ignore_patterns("__pycache__")))


def test_a_change_in_each_room_that_the_emission_imports_changes_the_digest(copy: Path) -> None:
    """One file of each folder, the one that is listed last; and none of the rooms above."""
    files = {name.rpartition("/")[0]: name for name in emission_files(copy)}
    folders = {"dynamics/hysteresis", "model/position_servo", "base/spec", "base/numerics"}
    assert folders | {"codegen/clib", "codegen/recursion"} <= set(files)
    before = sources_digest(copy)
    assert before == sources_digest()

    def changed(name: str) -> str:
        text = (copy / name).read_bytes()
        (copy / name).write_bytes(text + b"\n")
        sources_digest.cache_clear()
        after = sources_digest(copy)
        (copy / name).write_bytes(text)
        sources_digest.cache_clear()
        return after

    digests = [changed(name) for name in files.values()]
    assert len({before, *digests}) == len(files) + 1
    assert {changed(name) for name in ABOVE} == {before}
    assert sources_digest(copy) == before


def test_a_new_module_is_covered_as_soon_as_it_is_imported(copy: Path) -> None:
    """By each way to import it: of a package, below a function, by its name in a text."""
    importer = copy / "dynamics" / "hysteresis" / "lugre.py"
    text = importer.read_text()
    (importer.parent / "planted.py").write_text("")
    for way in (
        "from flexgen.dynamics.hysteresis import planted\n",
        "from flexgen.dynamics.hysteresis import (\n    lugre,\n    planted,\n)\n",
        "def late():\n    import flexgen.dynamics.hysteresis.planted as p\n",
        'LATE = "flexgen.dynamics.hysteresis.planted:function"\n',
        'LATE = f"flexgen.dynamics.hysteresis.{1}"\n',
    ):
        importer.write_text(text)
        assert "dynamics/hysteresis/planted.py" not in emission_files(copy)
        importer.write_text(text + way)
        assert "dynamics/hysteresis/planted.py" in emission_files(copy), way
    importer.write_text(text)
    (importer.parent / "planted.py").unlink()


@pytest.mark.parametrize(
    "file", ["dynamics/hysteresis/lugre.py", "model/position_servo/filters.py"]
)
def test_old_sources_do_not_stay_after_a_change(copy: Path, file: str, tmp_path: Path) -> None:
    program = (
        "import json, flexgen\n"
        "made = flexgen.generate('elbow', build=False, functions=['gravity'])\n"
        "print(json.dumps([flexgen.__file__, made.written]))"
    )

    def write() -> bool:
        told = subprocess.run(
            [sys.executable, "-c", program],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(copy.parent)},
            capture_output=True,
            text=True,
            check=True,
        )
        where, written = json.loads(told.stdout)
        assert Path(where).parent == copy
        return bool(written)

    assert [write(), write()] == [True, False]
    text = (copy / file).read_text()
    (copy / file).write_text(text + "\n# a change\n")
    assert [write(), write()] == [True, False]
    (copy / file).write_text(text)


def test_the_version_of_a_package_that_is_not_installed_is_unknown() -> None:
    assert package_version("a_package_that_nobody_has") == "unknown"
    assert package_version("numpy")[0].isdigit()
