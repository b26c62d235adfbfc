"""Contents of caches: compiled modules up to their limits, kernels by the text of all that they
depend on.
"""

from __future__ import annotations

import contextlib
import inspect
import os
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import pytest

from flexgen.backends.cuda import compiler
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build import c_module
from flexgen.inversion.solution import Solution


def test_modules_that_were_used_least_lately_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond a number or a size of all; never the newest, and nothing that is not a module."""
    suffix = c_module.library_suffix()

    def files(sizes: list[int]) -> list[Path]:
        out = []
        for k, size in enumerate(sizes):
            out.append(tmp_path / f"{k}.{suffix}")
            out[-1].write_bytes(b"x" * size)
            os.utime(out[-1], (1000 + k, 1000 + k))
        return out

    def left() -> list[str]:
        return sorted(path.stem for path in tmp_path.glob(f"*.{suffix}"))

    (tmp_path / "note.txt").write_text("x" * 1000)
    monkeypatch.setattr(c_module, "MOST", 3)
    monkeypatch.setattr(c_module, "LIMIT", 100)
    for sizes, newest, expected in (
        ([10, 10, 10], 2, ["0", "1", "2"]),
        ([10, 10, 10, 10], 3, ["1", "2", "3"]),
        ([10, 10, 10, 10, 10], 0, ["0", "3", "4"]),  # the oldest is the newest that was made
        ([40, 30, 30], 2, ["0", "1", "2"]),
        ([41, 30, 30], 2, ["1", "2"]),
        ([90, 60, 50], 2, ["2"]),
    ):
        for path in tmp_path.glob(f"*.{suffix}"):
            path.unlink()
        c_module._prune(tmp_path, files(sizes)[newest])
        assert left() == expected, sizes
    assert (tmp_path / "note.txt").exists()


class Nvrtc:
    """The compiler of kernels: it keeps what it was asked, and answers with what it is told."""

    def __init__(self, status: int = 0) -> None:
        self.status = status
        self.asked = list[Any]()
        self.version = (0, 13, 1)

    def nvrtcVersion(self) -> tuple[int, ...]:
        return self.version

    def nvrtcCreateProgram(self, *given: Any) -> tuple[int, str]:
        self.asked.append(given)
        return 0, "program"

    def nvrtcCompileProgram(self, *given: Any) -> tuple[int]:
        self.asked.append(given)
        return (self.status,)

    def nvrtcGetProgramLogSize(self, program: str) -> tuple[int, int]:
        return 0, 8

    def nvrtcGetProgramLog(self, program: str, log: bytearray) -> None:
        log[:] = b" said \n\0"

    def nvrtcGetCUBINSize(self, program: str) -> tuple[int, int]:
        return 0, 5

    def nvrtcGetCUBIN(self, program: str, cubin: bytearray) -> tuple[int]:
        cubin[:] = b"cubin"
        return (0,)

    def nvrtcDestroyProgram(self, program: str) -> None:
        self.asked.append("destroyed")


def test_a_kernel_is_compiled_with_its_headers_and_options(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The log is told where it fails; the program is always given back."""
    options = compiler.options_of("arm", "sm_90")
    assert options == [
        "--gpu-architecture=sm_90",
        "-fmad=false",
        "-default-device",
        "-DARM_NO_VECTORS",
    ]
    made = Nvrtc()
    monkeypatch.setattr(compiler, "nvrtc", lambda: made)
    assert compiler.compile_text("text", {"a.h": "A", "b.h": "B"}, options) == (b"cubin", "said")
    assert made.asked[0] == (b"text", b"kernel.cu", 2, [b"A", b"B"], [b"a.h", b"b.h"])
    assert (
        made.asked[1] == ("program", 4, [x.encode() for x in options])
        and made.asked[2] == "destroyed"
    )
    made.status = 6
    with pytest.raises(
        BuildError,
        match="NVRTC: given C that it does not compile for --gpu-architecture=sm_90: said",
    ):
        compiler.compile_text("text", {}, options)
    assert made.asked[-1] == "destroyed"


def test_a_kernel_is_compiled_again_where_something_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The text, a header or its name, the architecture, or the version of the compiler without its
    status.
    """
    made = Nvrtc()
    cache = dict[str, bytes]()
    compiled = list[str]()

    def compile_text(text: str, headers: Any, options: list[str]) -> tuple[bytes, str]:
        compiled.append(text)
        return f"cubin {len(compiled)}".encode(), ""

    def keep(folder: Path, entry: str, data: bytes) -> None:
        cache[entry] = data

    folder: list[Path | None] = [tmp_path]
    monkeypatch.setattr(compiler, "nvrtc", lambda: made)
    monkeypatch.setattr(compiler, "compile_text", compile_text)
    monkeypatch.setattr(compiler, "cache_folder", lambda: folder[0])
    monkeypatch.setattr(compiler, "one_at_a_time", lambda folder, entry: contextlib.nullcontext())
    monkeypatch.setattr(compiler, "fetch_entry", lambda folder, entry: cache.get(entry))
    monkeypatch.setattr(compiler, "keep_entry", keep)
    first: tuple[str, str, dict[str, str], str] = (
        "arm",
        "text",
        {"a.h": "A", "b.h": "B"},
        "sm_90",
    )
    assert compiler.compile_cached(*first) == b"cubin 1" == compiler.compile_cached(*first)
    assert compiler.compile_cached("arm", "text", {"b.h": "B", "a.h": "A"}, "sm_90") == b"cubin 1"
    for k, other in enumerate(
        (
            ("leg", "text", first[2], "sm_90"),
            ("arm", "texts", first[2], "sm_90"),
            ("arm", "text", {"a.h": "A", "b.h": "C"}, "sm_90"),
            ("arm", "text", {"a.h": "A", "c.h": "B"}, "sm_90"),
            ("arm", "text", first[2], "sm_100"),
        ),
        2,
    ):
        assert (
            compiler.compile_cached(*other)
            == f"cubin {k}".encode()
            == compiler.compile_cached(*other)
        )
    for version, number in (((7, 13, 1), 1), ((0, 12, 1), 7), ((0, 13, 2), 8)):
        made.version = version
        assert compiler.compile_cached(*first) == f"cubin {number}".encode()
    folder[0] = None
    assert compiler.compile_cached(*first) != compiler.compile_cached(*first) and len(cache) == 8


@pytest.mark.parametrize("simulation", [None, Made(trajectory={"q_a": 1})])
def test_a_solution_without_errors_has_no_accuracy(simulation: Any) -> None:
    """Neither without a simulation, nor with one that did not compare."""
    solution: Any = Made(simulation=simulation)
    solution._unverified = Solution._unverified.fget(solution)  # type: ignore[attr-defined]
    with pytest.raises(
        ArgumentError,
        match="accuracy: given a solution without verification, expected one with verify",
    ):
        inspect.unwrap(Solution.accuracy)(solution)
