"""Function blocks for PLCs: their variables have the sizes of the robot and of its stream."""

from __future__ import annotations

import ctypes
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from toolchain import CC, needs_compiler

from flexgen.base.errors import ArgumentError
from flexgen.exports.c_code.emitted import Emitted, emit
from flexgen.exports.c_code.plcopen.blocks import blocks, stream_size, struct
from flexgen.exports.c_code.plcopen.export import export_plcopen


@pytest.fixture(scope="module")
def library() -> Emitted:
    return emit("elbow", streams=True)


def test_blocks_have_the_sizes_of_the_robot(library: Emitted) -> None:
    """Of two motors, and the samples of one interval of the stream."""
    first, stream = blocks(library, True)
    assert (first.name, first.memory) == ("FB_elbow_inverse_dynamics", ())
    assert [(v.name, v.type, v.size) for v in first.inputs] == [
        (name, "LREAL", 2) for name in ("q_a", "v_a", "a_a")
    ]
    assert first.inputs[1].doc.startswith("[rad/s] ")
    assert [v.name for v in first.outputs] == ["tau_a", "valid", "error", "status"]
    options = library.stream
    assert options is not None
    n = 2 * options.samples_per_interval
    sizes = {v.name: v.size for v in (*stream.inputs, *stream.outputs, *stream.memory)}
    assert sizes == {
        **{"enable": 0, "start_output": 2, "q_start": 2, "y": 2, "dy": 2, "ddy": 2},
        **{"tau_m": n, "q_m": n, "v_m": n, "valid": 0, "error": 0, "status": 0},
        "memory": stream_size(library, options.intervals, options.samples_per_interval),
        "started": 0,
    }
    told = f"horizon of {options.intervals} intervals. Call it every {options.period!r} s"
    assert stream.name == "FB_elbow_stream" and told in stream.doc
    assert [keyword for keyword, _ in first.sections] == ["VAR_INPUT", "VAR_OUTPUT"]
    assert [keyword for keyword, _ in stream.sections] == ["VAR_INPUT", "VAR_OUTPUT", "VAR"]
    lines = struct(first).splitlines()
    assert (lines[0], lines[-1]) == ("typedef struct {", "} fb_elbow_inverse_dynamics;")
    assert lines[2].strip() == "double q_a[2];" and lines[-2].strip().endswith(" status;")


@needs_compiler
def test_the_memory_of_a_stream_is_that_of_its_macro(library: Emitted, tmp_path: Path) -> None:
    """Evaluated by the compiler, for several horizons."""
    (tmp_path / "elbow.h").write_text(library.header, encoding="ascii")
    source = '#include "elbow.h"\nlong long size(int n, int k) { return ELBOW_STREAM_SIZE(n, k); }'
    (tmp_path / "size.c").write_text(source)
    made = tmp_path / "size.so"
    subprocess.run([CC, "-shared", "-fPIC", tmp_path / "size.c", "-o", made], check=True)
    size = ctypes.CDLL(str(made)).size
    size.restype = ctypes.c_longlong
    for intervals, samples in ((1, 1), (20, 4), (7, 10)):
        assert stream_size(library, intervals, samples) == size(intervals, samples)


def test_a_library_without_a_stream_has_one_block(library: Emitted) -> None:
    assert len(blocks(library, False)) == 1
    bare = replace(library, header="")
    with pytest.raises(ArgumentError, match=r"^model elbow: given a home pose at which no stream"):
        blocks(bare, True)


@needs_compiler
def test_the_bodies_call_the_functions_that_the_library_declares(tmp_path: Path) -> None:
    """By the compiler: as many arguments, of the same types."""
    folder = export_plcopen("elbow", tmp_path / "plc").directory
    words = [CC, "-std=c99", "-Wall", "-Werror", "-fsyntax-only", "elbow_fb.c"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:1000]
