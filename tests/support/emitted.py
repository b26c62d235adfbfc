"""Generated libraries for the tests: made once, compiled by the compiler that is there, compared
with CasADi.
"""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from flexgen.codegen.build.generate import GeneratedLibrary, generate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.model.reader import read
from flexgen.runtime import Library, load

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-ffp-contract=off"]
ROOT = Path(__file__).resolve().parents[2]
SMALL = ["elbow", "planar5_nmp"]


@cache
def _folder() -> Path:
    folder = tempfile.mkdtemp(prefix="flexgen-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def made(name: str, *parts: str) -> GeneratedLibrary:
    """The library of a model, with optional parts; not to be changed. Each choice of the compiler
    has its own.
    """
    return _made(name, parts, os.environ.get("CC"))


@cache
def _made(name: str, parts: tuple[str, ...], compiler: str | None) -> GeneratedLibrary:
    folder = "-".join([name, *parts, *(["chosen"] if compiler else [])])
    return generate(name, _folder() / folder, parts=parts)


def loaded(name: str, *parts: str) -> Library:
    return load(made(name, *parts).directory)


def library_of(folder: Path) -> Path:
    return next(path for path in folder.iterdir() if path.suffix in (".so", ".dylib"))


def run(*command, folder: Path, expected: int = 0) -> str:
    answer = subprocess.run(
        [str(word) for word in command], cwd=folder, capture_output=True, text=True, check=False
    )
    assert answer.returncode == expected, answer.stderr[:4000]
    return answer.stdout


def paths_library(equations: Equations, *solvers: str) -> Library:
    """A library with these solvers; of models whose whole library other tests need, that one."""
    name = equations.model.name
    whole = name in SMALL and equations.model == read(name)
    return loaded(name) if whole else inversion_library(equations, "test", solvers)


def sources(folder: Path) -> list[Path]:
    return sorted((folder / "src").glob("*.c"))


def random_states(model, n: int) -> dict[str, np.ndarray]:
    """Moderate states: gears deflected by some mrad, motors moving with their joints."""
    rng = np.random.default_rng(20240229)
    i_g = list(model.i_g)
    # loops close, and gas springs stay in their strokes, around home only
    spread = 0.01 if model.loops or model.lines else 0.7
    x = {"q_a": spread * rng.normal(size=(n, model.n_a)), "v_a": rng.normal(size=(n, model.n_a))}
    if model.loops or model.lines:
        x["q_a"][:, i_g] += model.home
    x["a_a"] = 5.0 * rng.normal(size=(n, model.n_a))
    x["q_m"] = (x["q_a"][:, i_g] + 1e-3 * rng.normal(size=(n, len(i_g)))) @ model.eta.T
    x["v_m"] = (x["v_a"][:, i_g] + 1e-2 * rng.normal(size=(n, len(i_g)))) @ model.eta.T
    x["a_m"] = x["a_a"][:, i_g] @ model.eta.T
    x["tau_m"] = 10.0 * rng.normal(size=(n, model.n_m))
    x["tau_a"] = 100.0 * rng.normal(size=(n, model.n_a))
    x["tau_a"] = 10.0 * rng.normal(size=(n, model.n_a))
    x["f_tool"] = 100.0 * rng.normal(size=(n, 6))
    x["target"] = rng.normal(size=(n, model.output.target_size))
    x["deflection"] = 1e-3 * rng.normal(size=(n, model.n_g))
    x["j_a"] = 50.0 * rng.normal(size=(n, model.n_a))
    x["s_a"] = 500.0 * rng.normal(size=(n, model.n_a))
    return x


def machine(function: ca.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    """Every output of CasADi's virtual machine at every point, shape (N, rows, columns)."""
    buffer, trigger = function.buffer()
    out = [np.zeros(function.size_out(i), order="F") for i in range(function.n_out())]
    for i, array in enumerate(out):
        buffer.set_res(i, memoryview(array.reshape(-1, order="F")))
    results: list[list[np.ndarray]] = [[] for _ in out]
    for k in range(inputs[0].shape[0]):
        point = [np.ascontiguousarray(x[k]) for x in inputs]
        for i, x in enumerate(point):
            buffer.set_arg(i, memoryview(x))
        trigger()
        for i, array in enumerate(out):
            results[i].append(array.copy())
    return [np.array(r) for r in results]
