"""Messages: printable, short, without internal errors for strange paths and environments."""

from __future__ import annotations

import os
import pickle
import stat
import subprocess
import sys

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, ChannelError, ModelError, SolverError, message_of
from flexgen.base.files.atomic_files import follow_links, write_text
from flexgen.cli.main import main


@pytest.mark.parametrize("kind", [ArgumentError, ChannelError, SolverError])
def test_an_error_escapes_control_characters_and_shortens_what_was_given(kind):
    error = kind(
        f"key: given '\x1b[31m{'x' * 5000}\u202e', expected a name; choose another one\n"
        "\tsecond line"
    )
    text = str(error)
    assert text.startswith(r"key: given '\x1b[31mxxx") and text.endswith(
        ", expected a name; choose another one\n\tsecond line"
    )
    assert len(text) < 800 and "characters) ..." in text and not set(text) & {"\x1b", "\u202e"}
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind and str(again) == text


def test_messages_of_usual_length_are_unchanged():
    expected = (
        f"a.toml:3:x: given 'y', expected one of {', '.join(f'name{k}' for k in range(300))}"
    )
    assert message_of(expected) == expected and message_of("äöü ώ \t\n") == "äöü ώ \t\n"
    assert len(message_of("y" * 10**6)) < 4000
    assert message_of(message_of("given " * 10**4)) == message_of("given " * 10**4)
    assert len(str(ModelError("a.toml", 3, "x", "z" * 9000, "a number"))) < 800


@pytest.mark.parametrize(
    "words", [["describe", "z" * 5000], ["describe", "elbow", "--set", "x=" + "y" * 5000]]
)
def test_the_command_line_does_not_repeat_long_input(words, capfd):
    assert main(words) in (1, 2)
    told = capfd.readouterr().err
    assert "expected" in told and len(told) < 1500


def test_the_command_line_prints_no_control_characters(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    name = "\x1b[31mred\x07\x9b.h"
    assert main(["plan", "elbow", "--out", name]) == 0
    assert (
        main(["--json", "describe", "\x1b[31m"]) == 2
        and main(["describe", "a\x1b]0;title\x07"]) == 1
    )
    told = capfd.readouterr()
    assert (tmp_path / name).exists() and r"\x1b[31mred\x07\x9b.h" in told.out
    assert not set(told.out + told.err) & {"\x1b", "\x07", "\x9b"}


@pytest.mark.parametrize(
    "verb", [["derive", "elbow", "--latex"], ["generate", "elbow", "--no-build"]]
)
def test_a_path_of_2000_parts_is_refused_with_a_message(verb, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main([*verb, "--out", "a/" * 2000 + "x"]) == 1
    told = capfd.readouterr().err
    assert (
        "given a path of 2001 parts, expected at most 256" in told
        and list(tmp_path.iterdir()) == []
    )
    assert follow_links(tmp_path / ("a/" * 200)).name == "a"


def test_a_wrong_backend_of_matplotlib_is_named():
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    command = [sys.executable, "-c", "import flexgen.views.plots.canvas"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, timeout=100
    )
    assert (
        "ArgumentError: MPLBACKEND: given 'nonsense', which matplotlib refuses; unset it"
        in done.stderr
    )


def test_a_path_header_does_not_replace_a_file_of_the_user(tmp_path, capfd):
    own = write_text(tmp_path / "notes.h", "my notes\n")
    words = ["plan", "elbow", "--out"]
    assert main([*words, str(own)]) == 1 and own.read_text() == "my notes\n"
    assert "a file that flexgen did not write" in capfd.readouterr().err
    new = tmp_path / "line.h"
    assert (
        main([*words, str(new)]) == main([*words, str(new)]) == 0
        and "Written by flexgen" in new.read_text()
    )


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
@needs_compiler
def test_a_library_generated_under_umask_000_can_be_loaded(tmp_path):
    old = os.umask(0)
    try:
        made = flexgen.generate(
            "elbow", tmp_path / "new" / "elbow", functions=["gravity"], progress=False
        )
    finally:
        os.umask(old)
    written = [tmp_path / "new", *(tmp_path / "new").rglob("*")]
    assert not any(stat.S_IMODE(path.stat().st_mode) & stat.S_IWOTH for path in written)
    assert np.isfinite(flexgen.load(made.directory).gravity([0.1, 0.2])).all()
