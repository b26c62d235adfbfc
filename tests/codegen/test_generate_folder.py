"""The directory of a library: what flexgen did not write there stays; killed runs leave nothing
for ever.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from toolchain import needs_compiler

from flexgen.base.errors import BuildError
from flexgen.base.files.atomic_files import FOLDER, GRACE
from flexgen.codegen.build.directory import read_manifest
from flexgen.codegen.build.generate import generate
from flexgen.runtime import load

ROOT = Path(__file__).resolve().parents[2]


def sources(folder: Path, *functions: str, model: str = "elbow", **options) -> None:
    generate(model, folder, functions=functions or ["gravity"], build=False, **options)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize(
    "name", "elbow.h src/elbow.c CMakeLists.txt example.c src/elbow_gravity.c libelbow.a".split()
)
def test_files_of_others_are_not_replaced(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine\n")
    (tmp_path / "notes.txt").write_text("mine, too\n")
    before = contents(tmp_path)
    for force in (False, True):
        with pytest.raises(
            BuildError,
            match=rf"files that flexgen did not write \({name}\), .* choose another folder",
        ):
            sources(tmp_path, force=force)
    assert contents(tmp_path) == before
    (tmp_path / name).unlink()
    sources(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine, too\n"


def test_a_file_next_to_the_library_is_not_replaced_later(tmp_path):
    """The manifest lists what is flexgen's: a file that comes later under the name of one more
    source is not.
    """
    sources(tmp_path)
    (tmp_path / "src" / "elbow_bias.c").write_text("mine\n")
    before = contents(tmp_path)
    with pytest.raises(BuildError, match=r"did not write \(src/elbow_bias\.c\)"):
        sources(tmp_path, "gravity", "bias")
    assert contents(tmp_path) == before
    # this one is listed: written anew
    (tmp_path / "src" / "elbow_gravity.c").write_text("changed\n")
    (tmp_path / "src" / "elbow_bias.c").unlink()
    sources(tmp_path, "gravity", "bias")
    assert b"changed" not in (tmp_path / "src" / "elbow_gravity.c").read_bytes()


def test_the_sources_of_another_model_are_not_deleted(tmp_path):
    sources(tmp_path, model="planar5_nmp")
    before = contents(tmp_path)
    for model in ("elbow", "planar5_nmp@undamped"):
        with pytest.raises(
            BuildError,
            match=r"a folder with the library 'planar5_nmp', expected an empty one or one of",
        ):
            sources(tmp_path, model=model, force=True)
    assert contents(tmp_path) == before
    sources(tmp_path, "gravity", "bias", model="planar5_nmp")


@pytest.mark.parametrize(
    "text", ['{"files": {"main.c": "0"}}', "{}", "[]", "{", '{"name": "elbow", "generator": 5}']
)
def test_the_manifest_of_another_program_is_not_replaced(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    (tmp_path / "main.c").write_text("mine\n")
    before = contents(tmp_path)
    with pytest.raises(BuildError, match=r"manifest\.json: given .*choose another folder"):
        sources(tmp_path)
    assert contents(tmp_path) == before


def test_a_lost_or_damaged_manifest_is_written_anew(tmp_path):
    sources(tmp_path, "gravity", "bias")
    whole = contents(tmp_path)
    manifest = json.loads(whole["manifest.json"])
    damaged = [b"{", None, b"\xff", json.dumps({**manifest, "files": 3}).encode()]
    damaged += [
        json.dumps({**manifest, key: value}).encode()
        for key, value in (("functions", [1]), ("build", 7))
    ]
    for text in damaged:
        if text is None:
            (tmp_path / "manifest.json").unlink()
        else:
            (tmp_path / "manifest.json").write_bytes(text)
        assert read_manifest(tmp_path, "elbow") is None
        (tmp_path / "src" / "elbow.c").write_text("/* elbow, written by flexgen long ago */\n")
        sources(tmp_path, "gravity", "bias")
        assert contents(tmp_path) == whole


@needs_compiler
def test_a_lost_manifest_of_a_compiled_library(tmp_path):
    generate("elbow", tmp_path, functions=["gravity"])
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "libelbow-0123456789abcdef.so").write_text("mine: the name is not its hash\n")
    made = generate("elbow", tmp_path, functions=["gravity"], native=True)
    load(tmp_path)
    names = {tmp_path / name for name in contents(tmp_path)}
    assert names == {*made.files, tmp_path / "libelbow-0123456789abcdef.so"}


def test_a_full_disk_leaves_the_directory(tmp_path, monkeypatch):
    sources(tmp_path / "old")
    before = contents(tmp_path / "old")
    real = Path.write_text

    def full(self, *args, **options):
        if self.name == "elbow_bias.c":
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(self, *args, **options)

    monkeypatch.setattr(Path, "write_text", full)
    for folder in ("old", "new"):
        with pytest.raises(
            BuildError,
            match=r"cannot be written \(No space left on device\); .* free space or choose",
        ):
            sources(tmp_path / folder, "gravity", "bias")
    assert contents(tmp_path / "old") == before and not (tmp_path / "new").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_the_staging_folder_of_a_killed_run_is_removed_by_the_next(tmp_path):
    program = (
        "import sys, time\n"
        "from flexgen.codegen.build import generate as module\n"
        "module.install = lambda *given: (print('ready', flush=True), time.sleep(100))\n"
        "module.generate('elbow', sys.argv[1], functions=['gravity'], build=False)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline() == b"ready\n"
        (left,) = tmp_path.iterdir()
        assert left.name.startswith(FOLDER) and (left / "elbow.h").exists()
        then = time.time() - GRACE - 10
        os.utime(left, (then, then))
        sources(tmp_path)  # another process: its folder is in use
        assert (left / "elbow.h").exists()
        process.send_signal(signal.SIGKILL)
        process.wait()
    os.utime(left, (then, then))
    sources(tmp_path)  # nothing has changed, and the folder goes all the same
    assert not left.exists()
