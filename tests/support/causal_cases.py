"""Cases of the initial-value methods: problems, their DAEs, and torques to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison.initial_value import dae_of
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.reader import read
from flexgen.paths.path import Path


@dataclass(frozen=True)
class InitialValueCase:
    """A problem, its DAE and its equilibrium."""

    problem: InversionProblem
    dae: InverseDae
    x_eq: np.ndarray

    @property
    def path(self) -> Path:
        return self.problem.path

    def torques(self, x: np.ndarray) -> np.ndarray:
        """Motor torques of states x (n, n_x)."""
        return x[:, 2 * self.dae.n :]


@cache
def problem(name: str, smoothness: int | None = None, move: str | None = None) -> InitialValueCase:
    """The problem of a model's move, its first by default."""
    model = read(name)
    if smoothness is not None:
        model = read(name, overrides={f"move.{model.move(move).name}.smoothness": smoothness})
    equations = flexgen.derive(model)
    problem = InversionProblem(equations, Path(equations, model.move(move)))
    dae = dae_of(problem)
    return InitialValueCase(problem, dae, dae.pack(problem.equilibrium))


@cache
def reference(name: str, smoothness: int | None = None, move: str | None = None) -> object:
    """Motor torques of the same move by a method of exact tracking, as a spline in time."""
    here = problem(name, smoothness, move)
    method = "collocation" if here.problem.equations.model.n_e else "closed-form"
    mesh = None if method == "closed-form" else 2e-3
    solution = flexgen.solve(here.problem.equations, move, method=method, mesh=mesh, verify=False)
    return make_interp_spline(solution.trajectory.time, solution.trajectory["tau_m"], k=5)


def relative(tau: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference of two torques (n, n_m), for each motor relative to the largest of it."""
    return float((np.abs(tau - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())


def observed_order(errors: list[float], factor: float = 2.0) -> float:
    """The order that errors show, each at a step ``factor`` times smaller than the one before."""
    steps = np.arange(len(errors)) * np.log(factor)
    return float(-np.polyfit(steps, np.log(errors), 1)[0])
