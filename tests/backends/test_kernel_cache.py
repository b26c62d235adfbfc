"""Compiled kernels: kept by the text of all that they depend on, and nothing left of a failure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from flexgen.backends.cuda import compiler
from flexgen.base.errors import BuildError

GIVEN: tuple[str, str, dict[str, str], str] = ("arm", "text", {"a.h": "A", "b.h": "B"}, "sm_90")


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Any]:
    """Sources given to a compiler whose answer is its number; the version is replaced."""
    monkeypatch.setenv("FLEXGEN_CACHE", str(tmp_path))
    use_version(monkeypatch, 0, 13, 1)
    asked: list[Any] = []

    def compile_text(text: str, headers: Mapping[str, str], options: list[str]) -> Any:
        asked.append((text, headers, options))
        return f"cubin {len(asked)}".encode(), ""

    monkeypatch.setattr(compiler, "compile_text", compile_text)
    return asked


def use_version(monkeypatch: pytest.MonkeyPatch, *version: int) -> None:
    monkeypatch.setattr(compiler, "nvrtc", lambda: SimpleNamespace(nvrtcVersion=lambda: version))


@pytest.mark.parametrize(
    "other",
    [
        ("leg", *GIVEN[1:]),
        ("arm", "texts", *GIVEN[2:]),
        (*GIVEN[:2], {"a.h": "A", "b.h": "C"}, "sm_90"),
        (*GIVEN[:2], {"a.h": "A", "c.h": "B"}, "sm_90"),
        (*GIVEN[:3], "sm_100"),
    ],
    ids=["name", "text", "header", "name of a header", "architecture"],
)
def test_a_kernel_is_compiled_again_where_something_differs(
    other: tuple[Any, ...], compiled: list[Any]
) -> None:
    first = compiler.compile_cached(*GIVEN)
    assert compiler.compile_cached(*GIVEN) == first and len(compiled) == 1
    assert compiled[0] == (*GIVEN[1:3], compiler.options_of("arm", "sm_90"))
    turned = dict(reversed(GIVEN[2].items()))
    assert compiler.compile_cached(*GIVEN[:2], turned, GIVEN[3]) == first
    assert compiler.compile_cached(*other) == compiler.compile_cached(*other) != first
    assert len(compiled) == 2


@pytest.mark.parametrize(("version", "count"), [((7, 13, 1), 1), ((0, 12, 1), 2), ((0, 13, 2), 2)])
def test_another_version_of_the_compiler_compiles_again(
    version: tuple[int, ...],
    count: int,
    compiled: list[Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first number is the status of the call, not of the version."""
    compiler.compile_cached(*GIVEN)
    use_version(monkeypatch, *version)
    compiler.compile_cached(*GIVEN)
    assert len(compiled) == count


def test_without_a_cache_each_kernel_is_compiled(
    compiled: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    compiler.compile_cached(*GIVEN)
    compiler.compile_cached(*GIVEN)
    assert len(compiled) == 2


def test_the_program_is_given_back_also_where_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Headers are found by their names, and the options reach the compiler."""
    bindings = pytest.importorskip("cuda.bindings.nvrtc", reason="no NVRTC")
    given_back: list[Any] = []

    class Counted:
        def __getattr__(self, name: str) -> Any:
            return getattr(bindings, name)

        def nvrtcDestroyProgram(self, program: Any) -> Any:
            given_back.append(program)
            return bindings.nvrtcDestroyProgram(program)

    monkeypatch.setattr(compiler, "nvrtc", Counted)
    options = compiler.options_of("arm", "sm_90")
    assert "-fmad=false" in options
    text = '#include "a.h"\n#include "b.h"\n#ifndef ARM_NO_VECTORS\n#error vectors\n#endif\nA B;'
    cubin, _ = compiler.compile_text(text, {"a.h": "#define A int", "b.h": "#define B x"}, options)
    assert cubin.startswith(b"\x7fELF") and len(given_back) == 1
    with pytest.raises(BuildError, match=r"for --gpu-architecture=sm_90: .*error"):
        compiler.compile_text("int x = y;", {}, options)
    assert len(given_back) == 2
