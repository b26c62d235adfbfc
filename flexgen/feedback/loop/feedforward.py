"""One move with no, rigid and elastic feedforward, under one controller and on the same robots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.results import Result
from flexgen.base.rows import Part
from flexgen.feedback.loop.content import content_of_feedforwards
from flexgen.feedback.loop.control import control
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.result import UNITS, ControlRun
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve

RIGID = "rigid"
NAMES = ("none", RIGID, "elastic")
KINDS = (("error", "error_max"), ("dynamic error", "dynamic_error_max"))


@checked_result
@dataclass(frozen=True, repr=False)
class FeedforwardComparison(Result):
    """Runs of the same move that differ in the feedforward.

    ``runs``: by ``none`` (feedback alone, which begins with the torque at rest), ``rigid``
    (inverse dynamics of the rigid robot) and ``elastic`` (that of `flexgen.control`); ``missing``:
    reasons why one is not there.

    Examples
    --------
    >>> found = flexgen.compare_feedforward(flexgen.control("elbow"))
    >>> dynamic = found.rows()[1]
    >>> dynamic["elastic"] < dynamic["rigid"] < dynamic["none"]
    True
    """

    runs: dict[str, ControlRun]
    missing: dict[str, str]

    def __repr__(self) -> str:
        return f"<FeedforwardComparison {self.elastic.model.name}: {', '.join(self.runs)}>"

    @property
    def elastic(self) -> ControlRun:
        """The run that is compared."""
        return self.runs["elastic"]

    def rows(self) -> list[dict[str, Any]]:
        """Largest errors: ``robot``, ``what``, ``unit``, and each feedforward; None: failed."""
        out = []
        computed = min(len(run.runs) for run in self.runs.values())
        for k, robot in enumerate(self.elastic.runs[:computed]):
            figures = {name: run.figures(run.runs[k]) for name, run in self.runs.items()}
            for what, key in KINDS:
                for unit in UNITS:
                    found = {name: each[f"{key}_{unit}"] for name, each in figures.items()}
                    if found["elastic"] is None:
                        continue
                    numbers = {name: x if np.isfinite(x) else None for name, x in found.items()}
                    out.append({"robot": robot.name, "what": what, "unit": unit, **numbers})
        return out

    def content(self) -> tuple[Part, ...]:
        """A table of the errors, and what is missing."""
        return content_of_feedforwards(self)


@checked_types
@reported("compare_feedforward")
def compare_feedforward(
    run: ControlRun, options: Mapping[str, Any] | None = None, *, progress: Choice = None
) -> FeedforwardComparison:
    """Compare a closed loop with the same one without feedforward, and with that of a rigid robot.

    Controller, robots, noise and reference of the tool are the same. In both other runs the motors
    follow the reference of the rigid robot: without deflections.

    Parameters
    ----------
    run : ControlRun
    options : mapping, optional
        The keyword arguments that `flexgen.control` was called with: ``plants``, ``disturbances``,
        ...; sample time and delay are those of ``run``.
    progress : callable or bool, optional

    Returns
    -------
    FeedforwardComparison

    Raises
    ------
    ArgumentError
        An option does not fit, or has other robots than the run.

    Examples
    --------
    >>> options = {"plants": {"soft": {"stiffness": 0.8}}}
    >>> found = flexgen.compare_feedforward(flexgen.control("elbow", **options), options)
    >>> [f"{1e3 * row['rigid']:.2f} mm" for row in found.rows() if row["what"] == "error"]
    ['0.97 mm', '1.21 mm']
    """
    tell = progress if callable(progress) else None
    given = {
        key: value
        for key, value in (options or {}).items()
        if key not in ("solution", "method", "progress", "move")
    }
    given |= {"sample_time": run.hardware.sample_s, "delay": run.delay_s, "progress": tell}
    if isinstance(run.law, Cascade):
        given["controller"] = run.law
    move = run.solution.move
    runs = {}
    missing = {}
    try:
        rigid = solve(run.model, move, RIGID, verify=False, progress=tell)
    except (ArgumentError, SolverError) as error:
        return FeedforwardComparison({"elastic": run}, dict.fromkeys(NAMES[:2], str(error)))
    for name, solution in (("none", _without_torque(rigid)), (RIGID, rigid)):
        try:
            given.pop("assumed_force", None)
            runs[name] = control(run.model, move, solution=solution, **given)
        except (ArgumentError, SolverError) as error:
            missing[name] = str(error)
            continue
        _check_robots(runs[name], run)
    return FeedforwardComparison({**runs, "elastic": run}, missing)


def _check_robots(made: ControlRun, run: ControlRun) -> None:
    """Refuse options with other robots than those of the run that is compared."""
    names = [robot.name for robot in made.runs]
    expected = [robot.name for robot in run.runs]
    if names != expected[: len(names)] or (len(names) < len(expected) and not made.ended):
        raise ArgumentError(
            f"options: given robots {', '.join(names)}, expected those of the run, "
            f"{', '.join(expected)}; pass the plants that flexgen.control was called with"
        )


def _without_torque(solution: Solution) -> Solution:
    """A solution whose torque stays that at its start, where the robot rests."""
    trajectory = solution.trajectory
    channels = dict(trajectory.channels)
    channels["tau_m"] = np.tile(trajectory["tau_m"][:1], (len(trajectory.time), 1))
    return replace(solution, trajectory=replace(trajectory, channels=channels))
