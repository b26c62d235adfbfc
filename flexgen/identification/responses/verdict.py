"""Tool error of feedforward with the identified model.

The torques of a move are computed with several models and sent to a robot whose motors are
controlled. The robot is the true one, where it is known (a simulated experiment), or robots that
are drawn from the covariance of the identified parameters: then the distribution of the error is
predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.calls.progress import Choice, reported, silent
from flexgen.base.checks.counts import ROBOTS, count_of
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.registry import provides
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.feedback.loop.robustness import ControlName, tool_errors
from flexgen.identification.responses.result import WEAK, IdentificationResult
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move
from flexgen.model.reader import read

BASELINES = ("rigid", "fjm")


@dataclass(frozen=True)
class VerdictRow:
    """Tool errors of feedforward with one model.

    ``model``: ``"file"``, ``"identified"`` (both by exact inversion), ``"rigid"``, ``"fjm"``
    (simpler torques of the identified model). ``error_m``, ``error_rad``: largest errors of the
    tool, one for each robot, or None where the output has no such part.
    """

    model: str
    error_m: tuple[float, ...] | None
    error_rad: tuple[float, ...] | None

    def quantile(self, part: float, unit: str = "m") -> float | None:
        """Quantile of the errors over the robots; ``unit``: "m" or "rad"."""
        values = self.error_m if unit == "m" else self.error_rad
        return None if values is None else float(np.quantile(values, part))


@dataclass(frozen=True, repr=False)
class Verdict:
    """Tool errors before and after an identification.

    ``move``, ``control``; ``robots``: number of robots; ``known``: whether the robot is the true
    one; ``rows``.
    """

    move: str
    control: str
    robots: int
    known: bool
    rows: tuple[VerdictRow, ...]

    def __repr__(self) -> str:
        words = [
            f"{row.model} {row.quantile(0.5)} m" for row in self.rows if row.error_m is not None
        ]
        return f"<Verdict of {self.move}, {self.control}: {', '.join(words)}>"

    def __getitem__(self, model: str) -> VerdictRow:
        return next(row for row in self.rows if row.model == model)


@provides("IdentificationResult.verdict")
@reported("verdict")
def verdict(
    identified: IdentificationResult,
    move: str | Move | None = None,
    *,
    truth: RobotModel | str | Path | None = None,
    samples: int = 10,
    control: ControlName = "feedback",
    seed: int = 0,
    progress: Choice = None,
) -> Verdict:
    """Tool errors of feedforward with the model before and after identification, and with simpler
    torques.

    Parameters
    ----------
    identified : IdentificationResult
    move : str or Move, optional
        Default: the first move of the model.
    truth : RobotModel, str or Path, optional
        The true robot; default: ``samples`` robots from the covariance of the parameters.
    samples : int
    control : str
        ``"feedback"``: the motors are controlled in position and speed; ``"feedforward"``: torque
        alone.
    seed : int
    progress : callable or bool, optional

    Raises
    ------
    ArgumentError
        Neither ``truth`` nor a covariance: a model error has none.
    SolverError
        The move cannot be solved with one of the models.
    """
    tell = progress if callable(progress) else silent
    count_of("samples", samples, ROBOTS)
    before = Equations(identified.vector.model)
    after = Equations(identified.model)
    if truth is not None:
        robots = [Equations(truth if isinstance(truth, RobotModel) else read(truth))]
    else:
        robots = [Equations(robot) for robot in draw_robots(identified, samples, seed)]
    torques = {"file": (before, "auto"), "identified": (after, "auto")}
    torques |= {name: (after, name) for name in BASELINES}
    rows = []
    name_of_move = ""
    for name, (equations, method) in torques.items():
        tell(f"torques of the model {name}")
        solution = _solve(equations, move, method)
        name_of_move = solution.move.name
        found: list[dict[str, Any]] = []
        for k, robot in enumerate(robots):
            tell(f"model {name}: robot {k + 1} of {len(robots)}")
            found.append(tool_errors(robot, before, solution, control))
        rows.append(
            VerdictRow(name, _values(found, "error_max_m"), _values(found, "error_max_rad"))
        )
    return Verdict(name_of_move, control, len(robots), truth is not None, tuple(rows))


def draw_robots(identified: IdentificationResult, count: int, seed: int) -> list[RobotModel]:
    """Robots whose parameters are drawn from the covariance; weak ones keep the values of the
    file.

    Raises
    ------
    ArgumentError
        The result has no covariance.
    """
    if identified.covariance is None:
        raise ArgumentError(
            f"verdict: given a result with the status {identified.status!s}, which has no "
            "covariance to draw robots from; give the true robot (truth=, --truth), or mend "
            "the model or the data first"
        )
    vector = identified.vector
    rng = np.random.default_rng(seed)
    used = set(identified.used())
    known = np.array([not identified.is_weak(name) for name in vector.names])
    covariance = identified.covariance * np.outer(known, known)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.clip(values, 0.0, WEAK**2 * len(vector)))
    out = []
    for _ in range(count):
        named = vector.named(identified.x + root @ rng.standard_normal(len(vector)))
        out.append(
            with_values(
                vector.model, {name: value for name, value in named.items() if name in used}
            )
        )
    return out


def _solve(equations: Equations, move: str | Move | None, method: str) -> Solution:
    solution = solve(equations, move, method, verify=method == "auto", progress=False)
    if solution.status not in (Status.SOLVED, Status.BASELINE, Status.LIMITS_EXCEEDED):
        raise SolverError(
            f"verdict: {equations.model.name}, {solution.move.name}: {solution.status}"
        )
    return solution


def _values(rows: list[dict[str, Any]], key: str) -> tuple[float, ...] | None:
    values = [row[key] for row in rows]
    return (
        None if any(value is None for value in values) else tuple(float(value) for value in values)
    )
