"""The quadratic program of limited whole paths in C, against OSQP and the conditions of
optimality.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import osqp
import pytest
import scipy.sparse as sp
from clib_sections import section
from clib_shim import SHIM
from toolchain import needs_compiler

from flexgen.codegen.build.compiler import find_compiler

pytestmark = needs_compiler
CLOSE = 1e-6  # of OSQP with tolerances of 1e-9, relative
PRICE = 1e5  # above all multipliers of the programs here
# vectors of four numbers, as the kernel has them
VECTORS = """\
#include <stddef.h>
enum { LANES = 4, BLOCK = 8 };
typedef real lanes __attribute__((vector_size(32), aligned(8), may_alias));
static inline lanes splat_v(real x) { return (lanes){x, x, x, x}; }
static inline lanes load_v(const real *x) { return *(const lanes *)x; }
static inline void store_v(real *x, lanes v) { *(lanes *)x = v; }
"""
CALL = """\
#include "model_interior_point.h"
int run(int n, int rows, int stride, real *H, real *g, real *A, real *x, int *range, real price, \
real *z, real *K,
    real *step, real *of_rows)
{
    const int m = rows + 1;
    interior_point p = {n, rows, stride, H, g, A, x, range, price, z, K, step, of_rows, of_rows + \
m, of_rows + 2 * m,
        of_rows + 3 * m, of_rows + 4 * m, of_rows + 5 * m};
    return solve_interior_point(&p);
}
"""
BUG = ("sums[k] += load_v(a + j + k * LANES)", "sums[k] += 1.01 * load_v(a + j + k * LANES)")


@pytest.fixture(scope="module")
def program(
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[bool], Callable[..., np.ndarray]]:
    """The program in C, compiled by itself; True: with a planted bug in the factorization."""

    @cache
    def made(wrong: bool) -> Callable[..., np.ndarray]:
        folder: Path = tmp_path_factory.mktemp("program")
        text = section("invert_limited.c", "A quadratic program")
        assert text.count(BUG[0]) == 1
        (folder / "model_inversion_common.h").write_text(
            SHIM + VECTORS + "static inline real sum_v(lanes v)\n{\n"
            "    return v[0] + v[1] + v[2] + v[3];\n}\n"
        )
        qp = section("limits.h", "A small quadratic program")
        text = "\n".join(
            ['#include "model_inversion_common.h"', qp, text.replace(*BUG) if wrong else text]
        )
        (folder / "model_interior_point.h").write_text(text)
        (folder / "call.c").write_text(CALL)
        compiler = find_compiler()
        assert compiler is not None
        command = [
            *compiler.command,
            "-std=gnu99",
            "-O2",
            "-shared",
            "-fPIC",
            "call.c",
            "-lm",
            "-o",
            "call.so",
        ]
        subprocess.run(command, cwd=folder, check=True)
        run = ctypes.CDLL(str(folder / "call.so")).run

        def solved(
            H: np.ndarray, g: np.ndarray, A: np.ndarray, x: np.ndarray
        ) -> tuple[int, np.ndarray, float]:
            rows, n = A.shape
            stride = (n + 1 + 7) // 8 * 8
            padded = np.zeros((rows + 1, stride))
            padded[:rows, :n] = A
            nonzero = [np.flatnonzero(row) for row in A]
            ends = [(int(at[0]), int(at[-1]) + 1) if len(at) else (0, 0) for at in nonzero]
            span = np.array([*ends, (0, 0)], dtype=np.intc)
            z = np.zeros(stride)
            step = np.zeros(stride)
            memory = [np.ascontiguousarray(H), np.array(g), padded, np.array(x), span]
            others = [z, np.zeros((stride, stride)), step, np.zeros(6 * (rows + 1))]
            pointers = [
                [ctypes.c_void_p(m.ctypes.data) for m in part] for part in (memory, others)
            ]
            ok = run(n, rows, stride, *pointers[0], ctypes.c_double(PRICE), *pointers[1])
            return ok, z[:n].copy(), float(z[n])

        return solved

    return made


def problem(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A random program whose rows act on a part of the unknowns, and whose limits a known point
    keeps.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 60))
    rows = int(rng.integers(5, 150))
    B = rng.normal(size=(n, n)) * np.logspace(0, -1, n)
    A = rng.normal(size=(rows, n))
    first = rng.integers(0, n, rows)
    width = rng.integers(1, n + 1, rows)
    for k in range(rows):
        A[k, : first[k]] = 0.0
        A[k, first[k] + width[k] :] = 0.0
    A[0] = 0.0  # a limit that does not depend on the unknowns
    return (
        B @ B.T + 1e-2 * np.eye(n),
        3 * rng.normal(size=n),
        A,
        1.0 - A @ rng.normal(size=n) - rng.uniform(0, 0.5, rows),
    )


@pytest.mark.parametrize("seed", range(12))
def test_the_solution_is_that_of_osqp(program, seed: int) -> None:
    H, g, A, x = problem(seed)
    solver = osqp.OSQP()
    solver.setup(
        sp.csc_matrix(np.triu(H)), g, sp.csc_matrix(A), np.full(len(x), -np.inf), 1 - x,
        verbose=False, eps_abs=1e-9, eps_rel=1e-9, max_iter=200_000, polishing=True,
    )  # fmt: skip
    expected = solver.solve(raise_error=True).x
    ok, z, exceeded = program(False)(H, g, A, x)
    assert ok == 1 and exceeded < 1e-7
    assert np.abs(z - expected).max() < CLOSE * (1 + np.abs(expected).max())
    assert (x + A @ z).max() <= 1.0 + 1e-7


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_factorization_is_seen(program, seed: int) -> None:
    """Planted: products with an error of a hundredth. It does not converge, or to another
    point.
    """
    H, g, A, x = problem(seed)
    ok, z, exceeded = program(True)(H, g, A, x)
    right = program(False)(H, g, A, x)
    assert ok == 0 or exceeded > 1e-3 or np.abs(z - right[1]).max() > CLOSE


def test_limits_that_exclude_each_other_are_exceeded_alike(program) -> None:
    # z <= -1 and z >= 1 at once: both are exceeded by one, whatever z costs
    ok, z, exceeded = program(False)(
        np.eye(1), np.array([-0.25]), np.array([[1.0], [-1.0]]), np.array([2.0, 2.0])
    )
    assert ok == 1
    assert exceeded == pytest.approx(1.0, abs=1e-5) and z[0] == pytest.approx(0.0, abs=1e-5)
