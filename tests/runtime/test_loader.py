"""Invalid libraries are refused by the loader, each with its own message, none with a crash;
handles are pickled, copied and closed.
"""

from __future__ import annotations

import copy
import json
import os
import pickle
import shutil
import stat
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from handmade import DIGEST, VALUES, compiled, install, twist
from toolchain import CC, needs_compiler

import flexgen.runtime.files
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.runtime import load

pytestmark = needs_compiler
posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX permissions")
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs ELF")
Q = np.array([0.5, -2.0])
K = np.array([[1.0, 2.0], [3.0, 4.0]])


@pytest.fixture
def folder(tmp_path) -> Path:
    return install(tmp_path / "hand", compiled())


def library_file(folder: Path) -> Path:
    return next(path for path in folder.iterdir() if path.suffix in (".so", ".dylib"))


def change(folder: Path, **changes) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def python(program: str, *args: object) -> subprocess.CompletedProcess[str]:
    """Run a program in a separate process, which may crash."""
    command = [sys.executable, "-W", "error", "-c", program, *map(str, args)]
    paths = os.pathsep.join([str(Path(__file__).parents[2]), str(Path(__file__).parent)])
    environment = {**os.environ, "PYTHONPATH": paths}
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=60, env=environment
    )


# --- what the library says of itself -------------------------------------------------------------
@pytest.mark.parametrize(
    ("built", "told_to", "message"),
    [
        (
            {"abi": 1},
            {},
            r"hand_abi_version: given 1, expected 6 \(another version of the interface",
        ),
        (
            {},
            {"abi_version": 1},
            (
                "given ABI version 1, expected 6: the library was written by another version of "
                "flexgen"
            ),
        ),
        ({"sizeof_int": "8"}, {}, r"hand_sizeof_int: given 8, expected 4 \(bytes of an int"),
        (
            {"real": "float"},
            {},
            r"hand_sizeof_real: given 4, expected 8 \(bytes of a number: another precision",
        ),
        (
            {},
            {"precision": "single"},
            r"hand_sizeof_real: given 8, expected 4 \(bytes of a number: another precision",
        ),
        ({}, {"precision": "half"}, "precision: given 'half', expected double or single"),
        (
            {"digest": "e" * 64},
            {},
            r"hand_digest: given eee.*, expected ddd.* \(the library of another model\)",
        ),
        ({}, {"sizes": {"n_a": 3, "n_p": 2}}, "hand_n_a: given 2, expected 3"),
        ({}, {"sizes": {"square": 0}}, "given the size 'square', expected n_a"),
        (
            {},
            {"sizes": {"n_a": 2}},
            r"given \(2,\) as the shape of twist's parameters, expected \(0,\)",
        ),
        ({"name": "arm"}, {}, "hand_abi_version: given a library without it"),
    ],
)
def test_a_library_that_differs_from_its_manifest_is_refused(tmp_path, built, told_to, message):
    with pytest.raises(BuildError, match=message):
        load(install(tmp_path / "hand", compiled(**built), **told_to))


def test_every_refusal_has_an_advice(tmp_path):
    with pytest.raises(BuildError, match="generate it again"):
        load(install(tmp_path / "hand", compiled(abi=1)))


def test_a_file_name_with_the_hash_of_another_content_is_refused(folder):
    file = library_file(folder)
    renamed = file.rename(folder / f"libhand-{'0' * 16}{file.suffix}")
    change(
        folder,
        build={
            **json.loads((folder / "manifest.json").read_text())["build"],
            "library": renamed.name,
        },
    )
    with pytest.raises(BuildError, match="file name 'libhand-0000000000000000"):
        load(folder)
    change(folder, name="arm")
    with pytest.raises(BuildError, match=r"file name 'libhand-.*', expected libarm-"):
        load(folder)


def test_an_invalid_manifest_is_refused(folder):
    for text in (
        "{",
        "[" * 100_000,
        "[]",
        "\xff",
        "{}",
        '{"format": 1, "abi_version": 2, "build": 5}',
    ):
        (folder / "manifest.json").write_text(text, encoding="latin-1")
        with pytest.raises(BuildError):
            load(folder)


# --- damaged files -------------------------------------------------------------------------------
def test_one_byte_or_a_cut_changes_the_hash(folder):
    file = library_file(folder)
    whole = file.read_bytes()
    rng = np.random.default_rng(5)
    for at in rng.integers(len(whole), size=10):
        edited = bytearray(whole)
        edited[at] ^= 1
        file.write_bytes(edited)
        with pytest.raises(BuildError, match=r"given SHA-256 .*expected .*generate it again"):
            load(folder)
    for length in (0, 5, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:length])
        with pytest.raises(BuildError, match="given SHA-256"):
            load(folder)
    file.write_bytes(whole)
    assert load(folder).sizes["n_a"] == 2


LOAD_ALL = """
import sys
from pathlib import Path
import flexgen.runtime.files as files
from flexgen.base.errors import BuildError
from flexgen.runtime import load
if sys.argv[1] == "blind":
    files._elf_problem = lambda content: None
for folder in sys.argv[2:]:
    try:
        load(folder)
        print("loaded")
    except BuildError as error:
        print(error)
"""


@linux
def test_cut_and_garbled_libraries_with_a_matching_hash_do_not_crash(tmp_path):
    whole = compiled()
    loads = [
        struct.unpack_from("<IIQQQQQQ", whole, 64 + 56 * k)
        for k in range(struct.unpack_from("<H", whole, 56)[0])
    ]
    end = max(fields[2] + fields[5] for fields in loads)  # of all segments; section headers follow
    lengths = [0, 3, 4, 16, 20, 63, 64, 100, 400, 4096, end // 2, 4 * end // 5, end - 1]
    cases = [whole[:length] for length in lengths]
    rng = np.random.default_rng(6)
    cases += [
        rng.bytes(5000),
        b"\x7fELF" + rng.bytes(5000),
        whole[:16] + bytes(5000),
        whole[:64] + rng.bytes(5000),
    ]
    cases += [
        b"#!/bin/sh\n",
        whole[:4] + bytes([1]) + whole[5:],
        whole[:18] + b"\xff\xff" + whole[20:],
    ]
    (tmp_path / "one.c").write_text("int one(void) { return 1; }\n")
    subprocess.run([str(CC), "-c", "one.c"], cwd=tmp_path, check=True)
    cases += [(tmp_path / "one.o").read_bytes(), Path("/proc/self/exe").resolve().read_bytes()]
    folders = [install(tmp_path / str(k), content) for k, content in enumerate(cases)]
    answer = python(LOAD_ALL, "checked", *folders)
    assert answer.returncode == 0, answer.stderr
    told = answer.stdout.splitlines()
    assert len(told) == len(cases) and not any(line == "loaded" for line in told)
    for line in told[: len(lengths)]:
        assert "missing or cut" in line or "a cut or garbled library" in line
    for words in ("other addresses or byte order", "ELF machine 65535", "an ELF file of kind 1"):
        assert any(words in line for line in told)
    # the planted bug: no check
    assert python(LOAD_ALL, "blind", folders[lengths.index(end // 2)]).returncode != 0


# --- files that others may change ----------------------------------------------------------------
@posix
def test_files_that_every_user_may_write_are_refused(folder):
    for path in (folder, folder / "manifest.json", library_file(folder)):
        mode = stat.S_IMODE(path.stat().st_mode)
        path.chmod(mode | stat.S_IWOTH)
        with pytest.raises(
            BuildError, match=rf"{path.name}: given mode .* lets every user write .* chmod o-w"
        ):
            load(folder)
        path.chmod(mode | stat.S_IWGRP)  # a group is chosen
        load(folder)
        path.chmod(mode)


@posix
def test_a_folder_above_that_every_user_may_write_is_refused_without_its_sticky_bit(folder):
    folder.parent.chmod(0o777)
    with pytest.raises(BuildError, match=r"a folder that every user may write \(mode 777\)"):
        load(folder)
    folder.parent.chmod(0o1777)
    load(folder)
    folder.parent.chmod(0o700)


@posix
def test_files_of_another_user_are_refused(folder, monkeypatch):
    if os.geteuid() == 0:
        for path in (folder, folder / "manifest.json", library_file(folder)):
            os.chown(path, 12345, -1)
            with pytest.raises(
                BuildError,
                match=rf"{path.name}: given the owner 12345, expected the user 0 or root",
            ):
                load(folder)
            os.chown(path, 0, -1)
        load(folder)
    else:
        user = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: user + 1)
        with pytest.raises(
            BuildError, match=rf"given the owner {user}, expected the user {user + 1} or root"
        ):
            load(folder)


@posix
def test_symbolic_links_are_refused_but_to_folders(folder, tmp_path):
    (tmp_path / "link").symlink_to(folder)
    load(tmp_path / "link")
    for name in ("manifest.json", library_file(folder).name):
        # out of the folder, and within it
        for target in (tmp_path / name, folder / f"other-{name}"):
            (folder / name).rename(target)
            (folder / name).symlink_to(target)
            with pytest.raises(
                BuildError, match=f"{name}: given a symbolic link, expected the file itself"
            ):
                load(folder)
            (folder / name).unlink()
            target.rename(folder / name)
    load(folder)


@posix
def test_pipes_and_devices_are_refused_without_blocking(folder):
    for name in (library_file(folder).name, "manifest.json"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
        with pytest.raises(BuildError, match=f"{name}: given no regular file"):
            load(folder)
        (folder / name).unlink()
        (folder / name).mkdir()
        with pytest.raises(BuildError, match=f"{name}: given no regular file"):
            load(folder)
        (folder / name).rmdir()
        install(folder, compiled())


def test_a_file_that_is_swapped_after_the_check_is_not_loaded(folder, monkeypatch, tmp_path):
    """Another user swaps the file, or the whole folder, between the check and the load: what was
    checked is loaded.
    """
    monkeypatch.setattr(flexgen.runtime.files, "LOADED", {})
    stranger = tmp_path / "stranger"
    install(stranger, compiled(digest="e" * 64), model_digest="e" * 64)
    real = flexgen.runtime.files.load_copy

    def swapped(name: str, content: bytes):
        folder.rename(tmp_path / "away")
        shutil.copytree(stranger, folder)
        shutil.copy(library_file(stranger), folder / name)
        return real(name, content)

    monkeypatch.setattr(flexgen.runtime.files, "load_copy", swapped)
    # the digest that the code itself returns is compared with that of the first manifest
    library = load(folder)
    assert library.digest == DIGEST


@pytest.mark.parametrize("in_memory", [True, False])
def test_many_libraries_are_distinguished(folder, monkeypatch, in_memory):
    """Descriptors are used again, and the system's loader knows libraries by name."""
    if not in_memory:
        monkeypatch.delattr(os, "memfd_create", raising=False)
    monkeypatch.setattr(flexgen.runtime.files, "LOADED", {})
    for letter in "abcdef":
        install(folder, compiled(digest=letter * 64), model_digest=letter * 64)
        assert load(folder).digest == letter * 64
    assert len(flexgen.runtime.files.LOADED) == 6


@posix
def test_a_folder_above_of_another_user_is_refused(folder, monkeypatch):
    """Its owner could swap the folder between the check and the load."""
    real = Path.stat
    above = folder.resolve().parent

    def owned(path: Path, **options: object) -> os.stat_result:
        found = real(path, **options)
        return os.stat_result((*found[:4], 12345, *found[5:])) if path == above else found

    monkeypatch.setattr(Path, "stat", owned)
    with pytest.raises(BuildError, match=rf"{above}: given a folder of the owner 12345"):
        load(folder)


def test_a_library_replaced_while_the_old_one_is_loaded(folder):
    old = load(folder)
    library_file(folder).unlink()
    other = "e" * 64
    install(folder, compiled(digest=other), model_digest=other)
    new = load(folder)
    assert (old.digest, new.digest) == (DIGEST, other)
    assert np.array_equal(old.square(Q), new.square(Q))
    install(folder, compiled())  # and back: two libraries in the folder, the manifest tells which
    assert load(folder).digest == DIGEST


# --- handles: pickled, copied, closed, used by threads and children ------------------------------
def test_libraries_and_functions_survive_pickling(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    library = load("hand")  # a relative path
    kept = [
        pickle.dumps(x, protocol)
        for x in (library, library.twist)
        for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1)
    ]
    monkeypatch.chdir("/")
    expected = library.twist(Q, K)
    for data in kept:
        again = pickle.loads(data)
        found = getattr(again, "twist", again)(Q, K)
        assert np.array_equal(found.s, expected.s) and np.array_equal(found.S, expected.S)
    results = pickle.loads(pickle.dumps(expected))
    assert type(results) is type(expected) and np.array_equal(results.S, expected.S)


def test_unpickling_refuses_another_library(folder):
    kept = [pickle.dumps(x) for x in (load(folder), load(folder).square)]
    library_file(folder).unlink()
    install(folder, compiled(digest="e" * 64), model_digest="e" * 64)
    for data in kept:
        with pytest.raises(BuildError, match="which was pickled; pickle again what is there now"):
            pickle.loads(data)
    shutil.rmtree(folder)
    for data in kept:
        with pytest.raises(BuildError, match="no readable manifest"):
            pickle.loads(data)


def test_copies_are_the_same_handle(folder):
    library = load(folder)
    for x in (library, library.square):
        assert copy.copy(x) is x and copy.deepcopy({"here": x})["here"] is x


def test_a_closed_library_refuses_every_call(folder):
    with load(folder) as library:
        assert np.array_equal(library.square(Q), Q * Q) and not library.closed
        square = library.square
    other = load(folder)
    library.close()  # twice does no harm
    assert library.closed and "closed" in repr(library)
    for call in (
        lambda: square(Q),
        lambda: square([0.0, 1.0]),
        lambda: square(np.zeros((5, 2))),
        lambda: square(np.zeros((0, 2))),
        lambda: square(Q, out=np.zeros(2)),
        lambda: library.twist(Q, K),
        lambda: pickle.dumps(library),
        lambda: pickle.dumps(square),
    ):
        with pytest.raises(
            ArgumentError, match="hand: given a library that was closed, expected an open one"
        ):
            call()
    assert np.array_equal(other.square(Q), Q * Q)  # loaded on its own


def test_closing_under_calls_of_other_threads_ends_them_with_an_error(folder):
    library = load(folder)
    points = np.asfortranarray(np.random.default_rng(1).normal(size=(2000, 2)))
    started = threading.Barrier(5)
    ends = []

    def work() -> None:
        started.wait()
        try:
            while True:
                assert np.array_equal(library.square(points), points * points)
        except ArgumentError as error:
            ends.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    started.wait()
    library.close()
    for thread in threads:
        thread.join()
    assert len(ends) == 4 and all("closed" in text for text in ends)


CHILDREN = """
import os, pickle, sys, warnings
import numpy as np
from flexgen.runtime import load
warnings.simplefilter("ignore", DeprecationWarning)  # of forks where numpy has started threads
library = load(sys.argv[1])
q = np.array([0.5, -2.0])
library.square(q)
pid = os.fork()
if pid == 0:
    many = library.square(np.tile(q, (1000, 1)))
    os._exit(0 if (many == q * q).all() and (library.square(q) == q * q).all() else 1)
assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
assert (library.square(q) == q * q).all()
import multiprocessing
if __name__ == "__main__":
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found = pool.starmap(library.twist, [(k * q, np.eye(2)) for k in range(6)])
    assert [tuple(x.s) for x in found] == [tuple(2.25 * k * q) for k in range(6)]
"""


@posix
def test_children_use_the_library(folder):
    answer = python(CHILDREN, folder)
    assert answer.returncode == 0, answer.stderr


def test_values_are_those_of_the_same_in_numpy(folder):
    library = load(folder)
    assert library.precision == "double" and np.array_equal(library.parameters, VALUES)
    assert library.parameter_names == ("first", "second")
    assert library.sizes == {"n_a": 2, "n_p": 2} and library.coordinates == ("one", "two")
    s, S = library.twist(Q, K)
    assert np.array_equal(s, twist(Q, K)[0]) and np.array_equal(S, twist(Q, K)[1])
    with pytest.raises(ValueError, match="read-only"):
        library.parameters[0] = 1.0
