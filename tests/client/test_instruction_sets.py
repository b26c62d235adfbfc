"""A library has the same bits for each instruction set: point functions, batches, whole paths and
streams.
"""

from __future__ import annotations

import json
import platform
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from library_arrays import POINTS, arrays
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build.compiler import ISAS, find_compiler
from flexgen.runtime import processor
from flexgen.runtime.library import Library

pytestmark = [
    needs_compiler,
    pytest.mark.skipif(
        platform.machine().lower() not in ("x86_64", "amd64"),
        reason="an x86-64 processor is needed",
    ),
]

LARGE = "manutec_r3_18"  # a minute of compilation for each instruction set
MODELS = ["planar5_nmp", "elbow", "beam_arm", LARGE]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    def make(model: str, isa: str, **options: bool) -> Library:
        compiler = find_compiler(isa=isa)
        assert compiler is not None
        missing = processor.missing_instruction_sets(compiler.instruction_sets)
        if missing:
            pytest.skip(f"this processor has no {', '.join(missing)}")
        parts = ["bvp"] * bool(flexgen.read(model).n_e)
        made = flexgen.generate(
            model, tmp_path_factory.mktemp("isa") / model, isa=isa, parts=parts, **options
        )
        return flexgen.load(made.directory)

    return make


@pytest.fixture(scope="module")
def baseline(library):
    return cache(lambda model: arrays(library(model, "native")))  # what other tests have compiled


@pytest.mark.parametrize(
    ("model", "isa"),
    [
        pytest.param(model, isa, marks=[pytest.mark.full] * (model == LARGE))
        for model in MODELS
        for isa in ISAS
        if isa != "native"
    ],
)
def test_every_instruction_set_gives_the_bits_of_the_baseline(library, baseline, model, isa):
    expected = baseline(model)
    found = arrays(library(model, isa))
    assert expected.keys() == found.keys()
    assert [
        key for key, x in expected.items() if not np.array_equal(x, found[key], equal_nan=True)
    ] == []


def test_planted_contraction_changes_the_bits(tmp_path):
    """Planted: a library whose products and sums are contracted has other bits."""
    compiler = find_compiler()
    if compiler is None or "fma" not in compiler.instruction_sets:
        pytest.skip("a processor with fused multiply-add is needed")
    given = np.random.default_rng(1).normal(size=(3, POINTS, 2))
    found = []
    for native in (False, True):
        made = flexgen.generate(
            "elbow", tmp_path / f"{native}", functions=["inverse_dynamics"], native=native
        )
        found.append(flexgen.load(made.directory).inverse_dynamics(*given))
    assert not np.array_equal(*found)


def test_a_library_for_another_processor_is_refused(tmp_path, monkeypatch):
    made = flexgen.generate("elbow", tmp_path / "elbow", functions=["gravity"], isa="x86-64-v3")
    manifest = json.loads((Path(made.directory) / "manifest.json").read_text())
    assert (
        "avx2" in manifest["build"]["instruction_sets"] and manifest["build"]["isa"] == "x86-64-v3"
    )
    monkeypatch.setattr(
        "flexgen.runtime.processor.instruction_sets", lambda: frozenset({"pni", "ssse3"})
    )
    with pytest.raises(
        BuildError,
        match=r"avx2.* which this processor does not have; generate it on this computer",
    ):
        flexgen.load(made.directory)


def test_an_instruction_set_of_the_compiler_of_the_user_has_priority(monkeypatch):
    monkeypatch.setenv("CC", "gcc -march=x86-64-v2")
    compiler = find_compiler()
    assert compiler is not None and [
        flag for flag in compiler.flags if flag.startswith("-march")
    ] == ["-march=x86-64-v2"]


def test_an_unknown_instruction_set_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="isa: given 'avx9', expected one of native, x86-64"):
        flexgen.generate("elbow", tmp_path, isa="avx9")
