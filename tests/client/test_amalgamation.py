"""The library as one header and one C file: the same functions and bits; clean for strict C and
C++ compilers.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from emitted import _folder, made, random_states, run
from toolchain import CC, STRICT, STRICT_CPP, needs_compiler, tool

from flexgen.codegen.build.generate import GeneratedLibrary, generate
from flexgen.model.reader import read
from flexgen.runtime import load
from flexgen.runtime.library import Library

pytestmark = needs_compiler

SMALL = ["elbow", "planar5_nmp"]


@cache
def merged(name: str, precision: str = "double", build: bool = False) -> GeneratedLibrary:
    """The amalgamated library of a model; not to be changed."""
    folder = _folder() / f"{name}_merged_{precision}_{build}"
    return generate(name, folder, amalgamate=True, precision=precision, build=build)


def equal(a, b) -> bool:
    """Whether two results have the same bits; arrays, or tuples of them."""
    if isinstance(a, tuple):
        return all(map(equal, a, b))
    return np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes()


def inverted(library: Library, name: str) -> list[np.ndarray]:
    """Results of invert, and of a stream, for a smooth motion of the output from rest to rest."""
    model = read(name)
    t = np.linspace(0.0, 1.0, 101)
    q = np.zeros(model.n_a)
    q[list(model.i_g)] = model.home
    zero = np.zeros(model.n_a)
    target = np.zeros(library.sizes["n_t"])
    y = (
        library.output_constraint(q, zero, target)[0]
        + 0.05 * (t**3 * (10 - 15 * t + 6 * t**2))[:, None]
    )
    dy = np.repeat((0.05 * 30 * t**2 * (1 - t) ** 2 / 0.4)[:, None], y.shape[1], axis=1)
    ddy = np.repeat((0.05 * 60 * t * (1 - t) * (1 - 2 * t) / 0.16)[:, None], y.shape[1], axis=1)
    found = library.invert(
        y, dy, ddy, period=4e-3, q_start=q, n_pre=50, n_post=50, samples_per_interval=2
    )
    stream = library.stream(y[0], q, period=4e-3, intervals=20, samples_per_interval=2)
    updates = [
        stream.update(*sample).tau_m for sample in zip(y[1:30], dy[1:30], ddy[1:30], strict=True)
    ]
    return [found.q_a, found.tau_m, np.array(updates)]


@pytest.mark.parametrize("name", SMALL)
def test_one_file_gives_the_bits_of_many(name):
    many = load(made(name).directory)
    one = load(merged(name, build=True).directory)
    assert list(one.functions) == list(many.functions) and one.sizes == many.sizes
    x = random_states(read(name), 11)
    x["deflection"] = 1e-3 * np.random.default_rng(2).normal(size=(11, many.sizes["n_g"]))
    for f in many.functions.values():
        given = [x[port.name] for port in f.inputs]
        assert equal(one.functions[f.name](*given), f(*given)), f.name
        assert equal(one.functions[f.name](*(v[3] for v in given)), f(*(v[3] for v in given))), (
            f.name
        )
    assert all(map(equal, inverted(one, name), inverted(many, name)))


def test_the_folder_holds_one_header_and_one_source():
    folder = merged("planar5_nmp").directory
    names = {path.name for path in folder.iterdir() if not path.name.startswith("libplanar5_nmp")}
    assert names == {
        "planar5_nmp.h",
        "planar5_nmp.c",
        "example.c",
        "CMakeLists.txt",
        "planar5_nmp.pc",
        "manifest.json",
    }
    included = [
        line
        for line in (folder / "planar5_nmp.c").read_text().splitlines()
        if line.startswith('#include "')
    ]
    assert included == ['#include "planar5_nmp.h"']


def test_the_example_compiles_with_one_file(tmp_path):
    folder = merged("elbow").directory
    run(
        CC,
        *STRICT,
        f"-I{folder}",
        folder / "example.c",
        folder / "elbow.c",
        "-lm",
        "-o",
        "example",
        folder=tmp_path,
    )
    assert "stream: success" in run(tmp_path / "example", folder=tmp_path)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_strict_compilers_have_no_warning(precision, tmp_path):
    folder = merged("planar5_nmp", precision).directory
    run(CC, *STRICT, f"-I{folder}", "-fsyntax-only", folder / "planar5_nmp.c", folder=tmp_path)
    run(
        tool("g++"),
        *STRICT_CPP,
        f"-I{folder}",
        "-fsyntax-only",
        folder / "planar5_nmp.c",
        folder=tmp_path,
    )


def test_both_forms_replace_each_other_in_a_folder(tmp_path):
    generate("elbow", tmp_path, functions=["gravity"], build=False)
    assert (tmp_path / "src").is_dir() and not (tmp_path / "elbow.c").exists()
    made_now = generate("elbow", tmp_path, functions=["gravity"], build=False, amalgamate=True)
    assert made_now.written and (tmp_path / "elbow.c").exists() and not (tmp_path / "src").exists()
    assert not generate(
        "elbow", tmp_path, functions=["gravity"], build=False, amalgamate=True
    ).written
    generate("elbow", tmp_path, functions=["gravity"], build=False)
    assert (tmp_path / "src").is_dir() and not (tmp_path / "elbow.c").exists()
