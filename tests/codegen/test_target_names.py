"""Names of targets, what is refused, and what each platform as a host would get, by faking the
platform.
"""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import flexgen
from flexgen.cli.main import main
from flexgen.codegen.build import compiler as compilers
from flexgen.codegen.build import object_cache
from flexgen.codegen.build.directory import is_unchanged
from flexgen.runtime.inversion.targets import TARGETS, library_suffix, this_target


@pytest.mark.parametrize(
    ("system", "machine", "name", "suffix"),
    [
        ("linux", "x86_64", "x86_64-linux", "so"),
        ("linux", "aarch64", "aarch64-linux", "so"),
        ("win32", "AMD64", "x86_64-windows", "dll"),
        ("darwin", "x86_64", "x86_64-macos", "dylib"),
        ("darwin", "arm64", "aarch64-macos", "dylib"),
        ("win32", "ARM64", None, "dll"),
        ("freebsd14", "amd64", None, "so"),
    ],
)
def test_this_computer_as_another(system, machine, name, suffix, monkeypatch):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    here = this_target()
    assert (None if here is None else here.name) == name and library_suffix() == suffix


def test_names_in_fmi():
    expected = {
        "x86_64-linux": ("linux64", "x86_64-linux"),
        "aarch64-linux": ("aarch64-linux", "aarch64-linux"),
        "x86_64-windows": ("win64", "x86_64-windows"),
        "x86_64-macos": ("darwin64", "x86_64-darwin"),
        "aarch64-macos": ("aarch64-darwin", "aarch64-darwin"),
    }
    assert {
        name: (t.fmi_name("2.0"), t.fmi_name("3.0")) for name, t in TARGETS.items()
    } == expected


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": "sparc"}, "target: given 'sparc', expected .*x86_64-windows"),
        (
            {"target": "x86_64-linux", "native": True},
            "native: given with target 'x86_64-linux', expected it for this",
        ),
        ({"target": "x86_64-linux", "openmp": True}, "openmp: given with target 'x86_64-linux'"),
        (
            {"target": "aarch64-macos", "isa": "x86-64-v3"},
            "isa: given 'x86-64-v3' with target 'aarch64-macos'",
        ),
    ],
)
def test_what_a_target_excludes(options, message, tmp_path):
    with pytest.raises(flexgen.ArgumentError, match=message):
        flexgen.generate("elbow", tmp_path / "elbow", **options)
    assert not list(tmp_path.iterdir())


def test_a_target_without_the_package(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(compilers, "packaged_compiler", lambda: None)
    compilers._find_compiler.cache_clear()
    sentence = (
        "target: given 'x86_64-windows', for which the package ziglang compiles, and it is not "
        "installed"
    )
    with pytest.raises(flexgen.BuildError, match=sentence):
        flexgen.generate("elbow", tmp_path / "elbow", target="x86_64-windows")
    assert (
        main(["export", "fmu", "elbow", "--platforms", "win64", "--out", str(tmp_path / "a.fmu")])
        != 0
    )
    assert sentence in " ".join(capsys.readouterr().err.split()) and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"platforms": "win32"},
            "platforms: given 'win32', expected all or one or more of linux64, .*win64",
        ),
        (
            {"platforms": ["win64", "sun"], "version": "3.0"},
            "given 'sun', expected all or .*x86_64-windows",
        ),
        ({"platforms": []}, r"platforms: given \[\], expected all"),
        ({"platforms": "all", "binary": False}, "platforms: given for an FMU without binary"),
    ],
)
def test_wrong_platforms_of_an_fmu(options, message, tmp_path):
    with pytest.raises(flexgen.ArgumentError, match=message):
        flexgen.export_fmu("four_mass", tmp_path / "robot.fmu", **options)
    assert not list(tmp_path.iterdir())


def test_files_of_windows_are_known_in_a_directory(tmp_path):
    (tmp_path / "libelbow-0123456789abcdef.dll").write_bytes(b"x")
    assert is_unchanged(
        tmp_path, {"libelbow-0123456789abcdef.dll": hashlib.sha256(b"x").hexdigest()}
    )
    assert not is_unchanged(
        tmp_path, {"libelbow-0123456789abcdef.exe": hashlib.sha256(b"x").hexdigest()}
    )


# --- Windows as a host, faked --------------------------------------------------------------------
class FakeLocks:
    """The module msvcrt: locks of the first byte of files, of which another process may have
    some.
    """

    LK_NBLCK = 2
    LK_UNLCK = 0

    def __init__(self, held: int) -> None:
        self.held = held
        self.calls = []

    def locking(self, descriptor: int, mode: int, size: int) -> None:
        assert os.lseek(descriptor, 0, os.SEEK_CUR) == 0 and size == 1
        self.calls.append(mode)
        if mode == self.LK_NBLCK and self.held:
            self.held -= 1
            raise PermissionError(errno.EACCES, "locked")


@pytest.mark.parametrize("held", [0, 3])
def test_windows_locks_the_first_byte(held, monkeypatch, tmp_path):
    locks = FakeLocks(held)
    lines = []
    monkeypatch.setattr(object_cache, "fcntl", None)
    monkeypatch.setattr(object_cache, "msvcrt", locks)
    monkeypatch.setattr(object_cache, "_PAUSE", 0.0)
    with object_cache.one_at_a_time(tmp_path, "elbow", lines.append):
        assert locks.calls == [locks.LK_NBLCK] * (held + 1)
    assert locks.calls[-1] == locks.LK_UNLCK
    assert lines == ["waiting for another process that compiles elbow"] * bool(held)


def test_the_cache_of_windows_is_below_localappdata(monkeypatch, tmp_path):
    monkeypatch.delattr(os, "geteuid")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    monkeypatch.delenv("FLEXGEN_CACHE", raising=False)
    assert object_cache.cache_folder() == tmp_path.resolve() / "flexgen"
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    assert object_cache.cache_folder() is None


def test_cc_of_windows_keeps_its_backslashes(monkeypatch):
    monkeypatch.setenv("CC", r'"C:\Program Files\LLVM\clang.exe" -O2')
    monkeypatch.setattr(compilers.shutil, "which", lambda word, path=None: word)
    monkeypatch.setattr(compilers, "os", SimpleNamespace(name="nt", environ=os.environ))
    assert compilers._choose_command() == [r"C:\Program Files\LLVM\clang.exe", "-O2"]


def test_no_file_is_opened_with_the_encoding_of_the_terminal():
    """On Windows that is cp1252: every text file has its encoding stated."""
    root = Path(flexgen.__file__).parent
    found = [
        f"{path.name}: {line.strip()}"
        for path in sorted(root.rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if ".read_text()" in line or ".write_text(text)" in line
    ]
    assert found == []
