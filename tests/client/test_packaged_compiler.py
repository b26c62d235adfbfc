"""Without cc, gcc and clang on the PATH, libraries are compiled by the package ziglang, with the
same bits.
"""

from __future__ import annotations

import numpy as np
import pytest
from library_arrays import arrays
from toolchain import needs_compiler

import flexgen
from flexgen.codegen.build.compiler import find_compiler

pytest.importorskip("ziglang", reason="the package ziglang is not installed (extra compiler)")


def make(model: str, folder, **options) -> dict[str, np.ndarray]:
    parts = ["bvp"] * bool(flexgen.read(model).n_e)
    return arrays(flexgen.load(flexgen.generate(model, folder, parts=parts, **options).directory))


def differences(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> list[str]:
    assert one.keys() == other.keys()
    return [name for name in one if not np.array_equal(one[name], other[name])]


@needs_compiler
@pytest.mark.parametrize("model", ["elbow", pytest.param("planar5_nmp", marks=pytest.mark.slow)])
def test_the_package_gives_the_same_bits(model, monkeypatch, tmp_path):
    expected = make(model, tmp_path / "found")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    lines: list[str] = []
    assert (
        differences(
            make(model, tmp_path / "packaged", force=True, progress=lines.append), expected
        )
        == []
    )
    assert (
        "no cc, gcc or clang on the PATH: the C compiler is that of the package ziglang" in lines
    )
    # a planted change: products and sums contracted, as for this processor alone
    if model == "planar5_nmp" and "fma" in find_compiler(native=True).instruction_sets:
        assert differences(make(model, tmp_path / "native", native=True), expected)


def test_the_package_comes_after_the_compilers_of_the_path(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    program = tmp_path / "gcc"
    program.write_text("#!/bin/sh\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(flexgen.BuildError, match="given 'gcc' "):
        find_compiler()
    program.unlink()
    found = find_compiler(isa="native")
    assert (
        found is not None
        and found.command[1] == "cc"
        and found.archiver == (found.command[0], "ar")
    )
