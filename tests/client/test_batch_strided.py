"""Batches on parts of larger arrays: the bits of compact ones, nothing else is written, wrong
strides are refused.
"""

from __future__ import annotations

import atexit
import ctypes
import tempfile
from functools import cache

import numpy as np
import pytest
from emitted import library_of, random_states
from toolchain import needs_compiler

import flexgen
from flexgen.codegen.build.generate import GeneratedLibrary

pytestmark = needs_compiler
GUARD = -7.25
NAMES = [
    *(
        ("elbow", name)
        for name in (
            "mass_matrix",
            "inverse_dynamics",
            "forward_dynamics",
            "linearize",
            "gear_law",
        )
    ),
    *(
        ("planar5_nmp", name)
        for name in (
            "inverse_dynamics_derivatives",
            "inversion_jacobians",
            "arm_forward_derivatives",
        )
    ),
]


@cache
def made(name: str) -> GeneratedLibrary:
    """A library of the functions that are called here."""
    functions = [*(function for model, function in NAMES if model == name), "gravity"]
    folder = tempfile.TemporaryDirectory(prefix="flexgen-")
    atexit.register(folder.cleanup)
    return flexgen.generate(name, folder.name + "/made", functions=functions, progress=False)


def pointer(x: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(x.ctypes.data)


def call(name: str, function: str, n: int, stride: int, suffix: str, x: dict[str, np.ndarray]):
    """Status and outputs with their guards, arrays of `stride` points of which the first n are
    given.
    """
    lib = ctypes.CDLL(str(library_of(made(name).directory)))
    loaded = flexgen.load(made(name).directory)
    f = loaded.functions[function]
    inputs = []
    for port in f.inputs:
        # what is not asked for must not be read as a number
        wide = np.full((port.size, stride), np.nan)
        wide[:, :n] = x[port.name][:n].reshape(n, -1).T
        inputs.append(wide)
    outputs = [np.full((port.size, stride), GUARD) for port in f.outputs]
    entry = getattr(lib, f"{name}_{function}_batch{suffix}")
    work = np.zeros(getattr(lib, f"{name}_batch_work")())
    counts = [ctypes.c_int(n), *([ctypes.c_int(stride)] if suffix else [])]
    return int(
        entry(*counts, *map(pointer, inputs), *map(pointer, outputs), pointer(work))
    ), outputs


def states(name: str, n: int) -> dict[str, np.ndarray]:
    x = random_states(flexgen.read(name), n)
    x["deflection"] = 1e-3 * np.random.default_rng(2).normal(size=(n, flexgen.read(name).n_g))
    return x


@pytest.mark.parametrize(("name", "function"), NAMES, ids=str)
@pytest.mark.parametrize(
    ("n", "stride"), [(17, 17), (17, 23), (64, 72), (256, 256), (256, 264), (300, 512)]
)
def test_parts_of_arrays_give_the_bits_of_compact_ones(name, function, n, stride):
    x = states(name, n)
    status, compact = call(name, function, n, n, "", x)
    same, strided = call(name, function, n, stride, "_strided", x)
    assert status == same == 0
    for a, b in zip(compact, strided, strict=True):
        assert np.array_equal(a, b[:, :n]) and np.all(b[:, n:] == GUARD)


def test_a_point_that_fails_is_found_in_its_place():
    x = states("elbow", 40)
    x["q_a"][11, 1] = np.nan
    status, (g,) = call("elbow", "gravity", 40, 50, "_strided", x)
    assert (
        status == -2 and np.isnan(g[:, 11]).all() and np.isfinite(np.delete(g, 11, axis=1)).all()
    )


@pytest.mark.parametrize(("n", "stride"), [(9, 8), (-1, 4), (3, -3)])
def test_a_stride_below_the_number_of_points_is_refused(n, stride):
    lib = ctypes.CDLL(str(library_of(made("elbow").directory)))
    some = np.zeros(1000)
    status = lib.elbow_gravity_batch_strided(
        n, stride, pointer(some), pointer(some), pointer(some)
    )
    assert status == -4 and not some.any()


@pytest.mark.parametrize(("name", "function"), NAMES)
def test_few_points_have_the_bits_of_single_calls(name, function):
    # 1 to 20 points: whole vectors, and the points at the end that are computed one by one
    f = flexgen.load(made(name).directory).functions[function]
    x = states(name, 20)
    one_by_one = [f(*(x[port.name][k] for port in f.inputs)) for k in range(20)]
    for n in range(1, 21):
        many = f(*(x[port.name][:n] for port in f.inputs))
        for k in range(n):
            if isinstance(many, tuple):
                assert all(
                    np.array_equal(a[k], b) for a, b in zip(many, one_by_one[k], strict=True)
                )
            else:
                assert np.array_equal(many[k], one_by_one[k])


def test_a_point_that_fails_among_the_last_ones_is_found():
    x = states("elbow", 17)
    x["q_a"][16, 0] = np.nan
    status, (g,) = call("elbow", "gravity", 17, 17, "", x)
    assert status == -2 and np.isnan(g[:, 16]).all() and np.isfinite(g[:, :16]).all()
