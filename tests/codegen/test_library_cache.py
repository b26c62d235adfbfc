"""The libraries that the solvers keep in the user's cache: bounded, rebuilt where they are
missing, never torn away.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError
from flexgen.codegen.build import c_module, library_cache
from flexgen.codegen.build import model_library as inverters
from flexgen.codegen.build.library_cache import IN_USE, mark_used, prune
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.problem.model_library import inversion_library


def kept(folder: Path, ages: list[float], size: int = 10) -> list[Path]:
    """Libraries that were used so long ago [s]."""
    out = []
    for k, age in enumerate(ages):
        library = folder / f"robot{k}"
        library.mkdir(parents=True)
        (library / "library.so").write_bytes(bytes(size))
        used = time.time() - age
        os.utime(library, (used, used))
        out.append(library)
    return out


OLD = [IN_USE + 600.0 - 60.0 * k for k in range(6)]  # the first one was used least lately


def test_too_many_libraries_go_least_lately_used_first(tmp_path, monkeypatch) -> None:
    libraries = kept(tmp_path, OLD)
    prune(tmp_path)
    assert all(path.exists() for path in libraries)
    monkeypatch.setattr(library_cache, "MOST", 3)
    mark_used(libraries[0])
    prune(tmp_path)
    assert sorted(tmp_path.iterdir()) == [libraries[0], *libraries[4:]]


def test_too_large_libraries_go(tmp_path, monkeypatch) -> None:
    libraries = kept(tmp_path, OLD, size=100)
    monkeypatch.setattr(library_cache, "LIMIT", 250)
    prune(tmp_path)
    assert sorted(tmp_path.iterdir()) == libraries[4:]


@pytest.mark.parametrize(("count", "size"), [(2, 2**28), (64, 1)])
def test_64_libraries_and_512_mib_stay(tmp_path: Path, count: int, size: int) -> None:
    """One byte or library more, and the one used least lately goes; the files are sparse."""
    folder = tmp_path / "libraries"
    *libraries, newest = kept(folder, [IN_USE + 600.0 - k for k in range(count + 1)], size=0)
    for library in libraries:
        os.truncate(library / "library.so", size)
    aside = newest.rename(tmp_path / "newest")
    prune(folder)
    assert all(path.exists() for path in libraries)
    os.truncate(aside / "library.so", 1)
    aside.rename(newest)
    prune(folder)
    assert sorted(folder.iterdir()) == sorted([*libraries[1:], newest])


def test_libraries_in_use_and_other_files_stay(tmp_path, monkeypatch) -> None:
    kept(tmp_path, [1.0, IN_USE - 60.0, IN_USE + 60.0])
    elsewhere = kept(tmp_path / "elsewhere" / "far", [IN_USE + 999.0])[0]
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(elsewhere)
    monkeypatch.setattr(library_cache, "MOST", 0)
    prune(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "elsewhere",
        "file",
        "link",
        "robot0",
        "robot1",
    ]
    assert elsewhere.exists()
    prune(tmp_path / "missing")
    mark_used(tmp_path / "missing")


def test_a_library_marked_as_used_during_its_removal_is_restored(tmp_path, monkeypatch) -> None:
    library = kept(tmp_path, OLD[:1])[0]
    rename = Path.rename

    def late(path: Path, target: Path) -> Path:
        if path == library:
            mark_used(library)
        return rename(path, target)

    monkeypatch.setattr(library_cache, "MOST", 0)
    monkeypatch.setattr(Path, "rename", late)
    prune(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["robot0"] and (
        library / "library.so"
    ).exists()


def test_another_process_that_prunes_does_no_harm(tmp_path, monkeypatch) -> None:
    libraries = kept(tmp_path, OLD)
    rename = Path.rename

    def late(path: Path, target: Path) -> Path:
        shutil.rmtree(path)
        return rename(path, target)

    monkeypatch.setattr(library_cache, "MOST", 0)
    monkeypatch.setattr(Path, "rename", late)
    prune(tmp_path)
    assert not any(path.exists() for path in libraries)


# --- with a solver's library ---------------------------------------------------------------------


@pytest.fixture
def forgotten():
    """No library is loaded before, nor later from this folder."""
    inverters.library_holder.cache_clear()
    yield
    inverters.library_holder.cache_clear()


@pytest.mark.slow
@needs_compiler
def test_a_library_is_pruned_rebuilt_and_usable_all_the_while(
    tmp_path, monkeypatch, forgotten
) -> None:
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "libraries"
    others = kept(folder, OLD[:2])
    monkeypatch.setattr(library_cache, "MOST", 1)
    equations = derive("elbow")
    first = inversion_library(equations, "lq")
    assert list(folder.iterdir()) == [first.directory] and not any(
        path.exists() for path in others
    )
    before = first.motor_friction(np.array([0.1, 0.2]))

    os.utime(first.directory, (1e9, 1e9))
    # used: marked
    assert inversion_library(equations, "lq") is first and first.directory.stat().st_mtime > 1e9
    os.utime(first.directory, (1e9, 1e9))
    monkeypatch.setattr(library_cache, "MOST", 0)
    prune(folder)
    assert not first.directory.exists()
    assert (first.motor_friction(np.array([0.1, 0.2])) == before).all()  # what is loaded stays

    inverters.library_holder.cache_clear()
    again = inversion_library(equations, "lq")
    assert (
        again.directory == first.directory
        and (again.motor_friction(np.array([0.1, 0.2])) == before).all()
    )


@pytest.mark.slow
@needs_compiler
def test_a_library_that_vanishes_while_it_is_loaded_is_rebuilt(
    tmp_path, monkeypatch, forgotten
) -> None:
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path / "cache"))
    equations = derive("elbow")
    first = inversion_library(equations, "lq")
    inverters.library_holder.cache_clear()
    load = inverters.load
    calls = []

    def late(directory: Path):
        calls.append(directory)
        if len(calls) == 1:
            shutil.rmtree(directory)
        return load(directory)

    monkeypatch.setattr(inverters, "load", late)
    assert inversion_library(equations, "lq").directory == first.directory and len(calls) == 2


@needs_compiler
@pytest.mark.parametrize(("method", "solver"), [("lq", "invert"), ("bvp", "bvp")])
def test_the_library_of_a_method_has_the_solver_that_it_calls_and_no_other(method, solver) -> None:
    """The others would be most of what a first solution waits for."""
    library = inversion_library(derive("planar5_nmp"), method)
    solvers = {f"planar5_nmp_{name}.c" for name in ("inversion", "invert_limited", "path_sampler")}
    assert {path.name for path in library.directory.glob("src/*.c")} & solvers == {
        "planar5_nmp_inversion.c"
    }
    text = (library.directory / "src" / "planar5_nmp_inversion.c").read_text()
    assert set(re.findall(r"#ifndef PLANAR5_NMP_WITHOUT_(\w+)", text)) == {solver.upper()}
    assert getattr(library, solver) is not None
    with pytest.raises(ArgumentError, match="given a library without streams"):
        library.stream(np.zeros(2), np.zeros(5), period=5e-3, intervals=10)


@needs_compiler
def test_the_objects_of_one_choice_of_solvers_are_those_of_another() -> None:
    """Sources of a solver do not depend on other solvers: its object is in the cache."""
    equations = derive("planar5_nmp")
    choices = (["invert"], ["invert", "invert_limited"])
    folders = [inversion_library(equations, "lq", solvers).directory for solvers in choices]
    texts = [
        {path.name: path.read_bytes() for path in folder.rglob("*.[ch]")} for folder in folders
    ]
    # the digest of all; not compiled
    both = (set(texts[0]) & set(texts[1])) - {"planar5_nmp.c", "example.c"}
    assert {"planar5_nmp_inversion.c", "planar5_nmp_inversion.h", "planar5_nmp.h"} <= both
    assert {name for name in both if texts[0][name] != texts[1][name]} == set()


def test_a_link_in_the_cache_counts_with_its_own_size(tmp_path):
    (tmp_path / "large").write_bytes(bytes(100_000))
    folder = tmp_path / "library"
    folder.mkdir()
    (folder / "file").write_bytes(bytes(10))
    (folder / "link").symlink_to(tmp_path / "large")
    assert library_cache._size(folder) == 10 + (folder / "link").lstat().st_size < 1000


def test_a_library_is_in_use_for_an_hour_after_its_last_use_and_where_it_cannot_be_seen(tmp_path):
    for age, used in ((3500.0, True), (3700.0, False)):
        os.utime(tmp_path, (time.time() - age,) * 2)
        assert library_cache._in_use(tmp_path) == used
    assert library_cache._in_use(tmp_path / "nothing")


@needs_compiler
@pytest.mark.parametrize(
    ("most", "limit", "left"), [(3, 1e9, "234"), (9, 1e9, "01234"), (9, 2.5, "34"), (9, 0.5, "4")]
)
def test_modules_that_were_used_least_lately_go(
    most: int, limit: float, left: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond a number or a size of all, in modules; never the newest, nor another file."""
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path))

    def compiled(k: int) -> Path:
        return c_module.compile_module(f"m{k}", f"int f(void) {{ return {k}; }}")

    made = [compiled(k) for k in range(4)]
    note = made[0].with_name("note.txt")
    note.write_text("x" * 10**6)
    for k, path in enumerate(made):
        os.utime(path, (1000 + k, 1000 + k))
    monkeypatch.setattr(c_module, "MOST", most)
    monkeypatch.setattr(c_module, "LIMIT", limit * made[0].stat().st_size)
    made.append(compiled(4))
    assert "".join(str(k) for k, path in enumerate(made) if path.exists()) == left
    assert note.exists()
