"""Code that flexgen loads: refused where another user could have changed or exchanged it; a
private copy is loaded.
"""

from __future__ import annotations

import ast
import os
import py_compile
import re
import subprocess
from collections.abc import Callable
from importlib.util import cache_from_source
from pathlib import Path

import casadi as ca
import pytest
from toolchain import CC, needs_compiler

import flexgen.runtime.files
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build.c_module import compile_module, load_module
from flexgen.codegen.build.casadi_module import casadi_module, external
from flexgen.codegen.build.object_cache import Objects, cache_folder
from flexgen.feedback.loop.controller_files import file_controller
from flexgen.feedback.loop.interface import HEADER, PlugIn

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="needs POSIX permissions"),
    needs_compiler,
]
SOURCE = Path(flexgen.runtime.files.__file__).parents[1]
OTHER = 65534
PLUG_IN = """#include "flexgen_controller.h"
int flexgen_controller_abi(void) { return 1; }
size_t flexgen_controller_size(const flexgen_controller_setup *setup) { (void)setup; return 8; }
int flexgen_controller_reset(void *memory, const flexgen_controller_setup *setup) { return memory \
== 0 || setup == 0; }
int flexgen_controller_step(void *memory, int64_t k, const double *y, const double *ref, double \
*u) {
    (void)memory; (void)k; (void)y; (void)ref; (void)u; return 0; }
"""
ANSWER = '__attribute__((visibility("default"))) int answer(void) { return %d; }'
PYTHON = "class Mine:\n    def reset(self): ...\n    def step(self, k, y, ref): return ref.tau_m\n"


@pytest.fixture
def give(monkeypatch, tmp_path) -> Callable[[Path], None]:
    """Give a folder to another user: truly as root, else in what its stat says."""

    def give_away(path: Path) -> None:
        assert path.is_relative_to(tmp_path)
        if os.geteuid() == 0:
            os.chown(path, OTHER, -1)
            return
        real = Path.stat

        def stat(self: Path, **options: bool) -> os.stat_result:
            found = real(self, **options)
            return os.stat_result((*found[:4], OTHER, *found[5:])) if self == path else found

        monkeypatch.setattr(Path, "stat", stat)

    return give_away


def made(folder: Path, kind: str) -> tuple[Path, Callable[[], object]]:
    """A file of loaded code in a folder, and what loads it."""
    folder.mkdir(parents=True)
    os.environ["FLEXGEN_CACHE"] = str(folder.parent)
    if kind == "plug-in":
        (folder / "mine.c").write_text(PLUG_IN)
        path = folder / "mine.so"
        command = [
            str(CC),
            "-shared",
            "-fPIC",
            f"-I{HEADER.parent}",
            "-o",
            str(path),
            str(folder / "mine.c"),
        ]
        subprocess.run(command, check=True)
        return path, lambda: PlugIn(path)
    if kind == "python":
        path = folder / "mine.py"
        path.write_text(PYTHON)
        return path, lambda: file_controller(str(path))
    x = ca.SX.sym("x")
    module = casadi_module(ca.Function("square", [x], [x * x]))
    loads = {
        "ctypes": lambda: load_module(module).square,
        "casadi": lambda: external("square", module)(3.0),
    }
    return module, loads[kind]


KINDS = pytest.mark.parametrize("kind", ["plug-in", "python", "ctypes", "casadi"])
NAMED = {
    "plug-in": BuildError,
    "python": ArgumentError,
    "ctypes": BuildError,
    "casadi": BuildError,
}


@pytest.fixture
def path_and_load(tmp_path, kind, monkeypatch):
    monkeypatch.setenv("FLEXGEN_CACHE", "")  # restored after the test
    return made(tmp_path / "above" / "modules", kind)


@KINDS
def test_code_below_a_folder_of_another_user_is_refused(path_and_load, kind, give):
    path, load = path_and_load
    load()
    give(path.parents[1])
    with pytest.raises(
        NAMED[kind], match=f"{path.parents[1]}: given a folder of the owner {OTHER}"
    ):
        load()


@KINDS
def test_code_of_another_user_or_open_to_every_user_is_refused(path_and_load, kind, monkeypatch):
    path, load = path_and_load
    path.chmod(0o777)
    with pytest.raises(
        NAMED[kind], match=rf"{path}: given mode 777, which lets every user write it"
    ):
        load()
    path.chmod(0o700)
    real = os.fstat
    monkeypatch.setattr(
        os, "fstat", lambda fd: os.stat_result((*real(fd)[:4], OTHER, *real(fd)[5:]))
    )
    with pytest.raises(
        NAMED[kind],
        match=f"{path}: given the owner {OTHER}, expected the user {os.geteuid()} or root",
    ):
        load()


@KINDS
def test_code_in_a_folder_that_every_user_may_write_is_refused(path_and_load, kind):
    path, load = path_and_load
    path.parents[1].chmod(0o777)
    with pytest.raises(NAMED[kind], match=r"a folder that every user may write \(mode 777\)"):
        load()
    path.parents[1].chmod(0o1777)
    load()


@pytest.mark.parametrize("kind", ["plug-in", "ctypes", "casadi"])
def test_a_cut_library_is_refused_without_a_crash(path_and_load, kind):
    path, load = path_and_load
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(BuildError, match=r"given a cut or garbled library"):
        load()


def test_a_module_that_is_exchanged_after_the_check_does_not_run(tmp_path, monkeypatch):
    """The stranger's code is put in place between the check and the load: what was checked
    runs.
    """
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path))
    ours, strangers = (compile_module("answer", ANSWER % k) for k in (1, 2))
    real = flexgen.runtime.files.load_copy

    def exchanged(name: str, content: bytes):
        os.replace(strangers, ours)
        return real(name, content)

    monkeypatch.setattr(flexgen.runtime.files, "load_copy", exchanged)
    assert load_module(ours).answer() == 1


def test_a_module_in_the_cache_that_cannot_be_trusted_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path))
    text = ANSWER % 3
    path = compile_module("answer", text)
    whole = path.read_bytes()
    for spoil in (lambda: path.write_bytes(whole[:2000]), lambda: path.chmod(0o777)):
        spoil()
        assert (
            compile_module("answer", text) == path
            and path.read_bytes() == whole
            and path.stat().st_mode & 0o77 == 0
        )


def test_modules_are_the_users_alone_whatever_the_umask(tmp_path, monkeypatch):
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path))
    old = os.umask(0)
    try:
        path = compile_module("answer", ANSWER % 4)
    finally:
        os.umask(old)
    assert path.stat().st_mode & 0o777 == 0o700 and load_module(path).answer() == 4


def test_a_cache_below_a_folder_of_another_user_is_refused(tmp_path, monkeypatch, give):
    (tmp_path / "other").mkdir()
    give(tmp_path / "other")
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path / "other" / "cache"))
    with pytest.raises(
        BuildError, match=f"FLEXGEN_CACHE: given .*of the owner {OTHER}.* choose another"
    ):
        cache_folder()
    monkeypatch.delenv("FLEXGEN_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    assert cache_folder() is None
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "other"))
    assert cache_folder() is None
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == (tmp_path / ".cache" / "flexgen").resolve()


def test_an_object_of_another_user_is_not_taken_from_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path / "cache"))
    source = tmp_path / "a.c"
    source.write_text("int a;\n")
    source.with_suffix(".o").write_bytes(b"object")
    objects = Objects("compiler", {})
    objects.keep(source)
    assert objects.fetch(source)
    (entry,) = (path for path in (tmp_path / "cache").iterdir() if path.suffix == ".o")
    entry.chmod(0o666)
    assert not objects.fetch(source)
    entry.chmod(0o600)
    if os.geteuid() == 0:
        os.chown(entry, OTHER, -1)
        assert not objects.fetch(source)


@pytest.mark.parametrize("kind", ["python"])
def test_a_planted_cache_of_bytecode_does_not_run(path_and_load, tmp_path):
    """Python would run what ``__pycache__`` holds, also where another user wrote it."""
    path, load = path_and_load
    stranger = tmp_path / "stranger.py"
    stranger.write_text("raise SystemExit('the code of a stranger')\n")
    unchecked = py_compile.PycInvalidationMode.UNCHECKED_HASH
    py_compile.compile(str(stranger), cache_from_source(str(path)), invalidation_mode=unchecked)
    assert type(load().controller).__name__ == "Mine"


def loads_of(text: str) -> list[str]:
    """Calls in a source that load code from a file."""
    wanted = re.compile(
        r".*(CDLL|LoadLibrary|dlopen|\bexternal|exec_module|run_path|load_dynamic)"
    )
    # the tree of all of flexgen takes two seconds
    if not any(wanted.match(line) for line in text.splitlines()):
        return []
    calls = [
        ast.unparse(node.func) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)
    ]
    return [call for call in calls if wanted.fullmatch(call) and call != "external"]


def test_all_code_is_loaded_in_one_place():
    found = {
        str(path.relative_to(SOURCE)): calls
        for path in SOURCE.rglob("*.py")
        if (calls := loads_of(path.read_text()))
    }
    assert found == {
        "runtime/files.py": ["ctypes.CDLL"],
        "codegen/build/casadi_module.py": ["ca.external"],
    }
    assert loads_of("ctypes.CDLL(str(path))") == ["ctypes.CDLL"]  # the planted breach
