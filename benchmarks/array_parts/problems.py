"""Problems of the benchmark of arrays, ways to solve them on the CPU, and their times."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples

SAMPLES = 501
BEFORE = 20
AFTER = 50
EACH = 20
SECONDS = 0.2  # of the single calls in a round
ROUNDS = 60  # rounds
SPREAD = 0.1  # of each parameter, relative


@dataclass(frozen=True)
class Problems:
    """Problems of one robot: one path, parameters of each."""

    robot: str
    library: flexgen.Library
    path: dict[str, Any]
    parameters: np.ndarray

    def first(self, count: int) -> Problems:
        """The first of them."""
        return Problems(self.robot, self.library, self.path, self.parameters[:count])


def problems_of(robot: str, folder: Path, most: int = 20_000) -> Problems:
    """The library of a model with stiffness and payload as run-time parameters, and its line."""
    equations = flexgen.derive(robot)
    names = [name for name in INVERSION if name != "inversion_jacobians" or equations.model.n_e]
    made = flexgen.generate(
        robot, folder / robot, parameters=["stiffness", "payload"], functions=names
    )
    path = flexgen.plan(equations, "line")
    period = path.duration / (SAMPLES - 1)
    y, dy, ddy = samples(Reduction(equations), path, period, SAMPLES)
    library = flexgen.load(made.directory)
    drawn = np.random.default_rng(0).uniform(
        1 - SPREAD, 1 + SPREAD, (most, library.parameters.size)
    )
    given = {"y": y, "dy": dy, "ddy": ddy, "period": period, "q_start": path.q_start}
    return Problems(robot, library, given, library.parameters * drawn)


def call_one_by_one(p: Problems) -> np.ndarray:
    """The largest motor torques of all problems by single calls."""
    counts = {"n_pre": BEFORE, "n_post": AFTER, "samples_per_interval": EACH}
    found = [
        p.library.invert(**p.path, **counts, parameters=values).tau_m for values in p.parameters
    ]
    return np.array([np.abs(tau_m).max() for tau_m in found])


def call_many(p: Problems, workers: int | None = None) -> np.ndarray:
    """The largest motor torques of all problems by one call of `invert_many`."""
    options = flexgen.InversionOptions(
        n_pre=BEFORE,
        n_post=AFTER,
        samples_per_interval=EACH,
        workers=workers,
        reduce=largest,
        progress=False,
    )
    found = p.library.invert_many(**p.path, parameters=p.parameters, options=options)
    assert found.reduced is not None
    return found.reduced


def largest(chunk: Any) -> np.ndarray:
    """The largest motor torque of each problem."""
    return np.array([np.abs(tau_m).max() for tau_m in chunk.tau_m])


def shortest(ways: list[Callable[[], np.ndarray]]) -> np.ndarray:
    """The shortest time and processor time [s] of each of these ways, in turns; all must give the
    same bits.
    """
    best = np.full((len(ways), 2), np.inf)
    for _ in range(ROUNDS):
        results = []
        for i, way in enumerate(ways):
            began = np.array([time.perf_counter(), time.process_time()])
            results.append(way())
            best[i] = np.minimum(
                best[i], np.array([time.perf_counter(), time.process_time()]) - began
            )
        if not all(np.array_equal(x, results[0], equal_nan=True) for x in results):
            raise RuntimeError("the ways differ in their bits")
    return best
