"""A solution compared with simpler methods, and on robots that differ from the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import duration
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.robustness import CONTROLS, PLANTS, compare_plants
from flexgen.inversion.comparison.comparison import compare_methods, error_rows
from flexgen.inversion.solution import Solution

# time of a simulation of another robot, relative to the verification, whose tolerance is tighter
RUN = 0.25


@checked_result
@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """Result of `flexgen.compare`; `report` writes the report of the solution with its tables.

    Attributes
    ----------
    solution : Solution
    solutions : tuple of Solution
        Solutions of the same move by simpler methods, the simplest first, then ``solution``;
        without such methods for forces on the tool, hysteresis, friction with a state and Fourier
        sums; empty where it was not verified.
    robustness : list of dict or None
        One row for each robot, control and method, see
        `flexgen.feedback.loop.robustness.compare_plants`.

    Examples
    --------
    >>> comparison = flexgen.compare(flexgen.solve("elbow"))
    >>> comparison
    <Comparison elbow, move line: rigid, closed-form>
    >>> comparison.solutions[0].tool_error_max_m < 1e-3
    True
    """

    solution: Solution
    solutions: tuple[Solution, ...]
    robustness: list[dict[str, Any]] | None = None

    def __repr__(self) -> str:
        names = ", ".join(one.method for one in self.solutions)
        return (
            f"<Comparison {self.solution.model.title}, move {self.solution.move.name}: "
            f"{names or 'not verified'}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """``comparison``: tool errors by method, m and rad; ``robustness``, where asked for: by
        robot too.
        """
        rows = {} if self.robustness is None else {"robustness": self.robustness}
        return {"comparison": error_rows(self.solutions), **rows}


@checked_types
@reported("compare")
def compare(
    solution: Solution, *, robustness: bool = False, progress: Choice = None
) -> Comparison:
    """Compare a solution with simpler methods: simulated tool errors of the same move on the full
    model.

    Parameters
    ----------
    solution : Solution
        Verified; without verification there is nothing to compare but its robustness.
    robustness : bool
        Also simulate robots whose stiffness differs by 5 and 20 %, or masses by 5 %, with and
        without feedback.
    progress : callable, bool, optional
        Called with a line of text; True, False: show it on the terminal or not; default: there and
        in a notebook.

    Returns
    -------
    Comparison

    Raises
    ------
    ArgumentError
        The solution is interrupted.

    Examples
    --------
    >>> comparison = flexgen.compare(flexgen.solve("elbow"))
    >>> [(row["method"], row["largest_m"] < 1e-6) for row in comparison.to_dict()["comparison"]]
    [('rigid', False), ('closed-form', True)]
    """
    if solution.interrupted:
        raise ArgumentError(
            "solution: given one that was interrupted, expected a solution of the whole move"
        )
    equations = derive(solution.model)
    log = progress if callable(progress) else None
    compared = () if solution.simulation is None else compare_methods(equations, solution, log)
    if not robustness:
        return Comparison(solution, compared)
    named = {one.method: one for one in (compared or (solution,))}
    runs = len(PLANTS) * len(CONTROLS) * len(named)
    if log is not None:
        took = (
            ""
            if solution.simulation is None
            else f", about {duration(RUN * runs * solution.simulation.wall_s)}"
        )
        log(f"robustness: {runs} simulations{took}")
    return Comparison(solution, compared, compare_plants(equations, named, progress=log))
