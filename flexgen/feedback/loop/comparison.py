"""A solution compared with simpler methods, and on robots that differ from the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import duration
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Heading, Part, Prose, Table
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.robustness import CONTROLS, PLANTS, compare_plants
from flexgen.inversion.comparison.comparison import compare_methods, error_rows
from flexgen.inversion.solution import Solution

# time of a simulation of another robot, relative to the verification, whose tolerance is tighter
RUN = 0.25
UNITS = ("m", "rad")
WORDS = {"m": "distance", "rad": "angle"}
MEANING = {
    "feedback": "torque feedforward with cascaded motor position and speed control",
    "feedforward": "torque only, open loop",
}
BY_METHOD = (
    "Largest distance (or angle) between the path and the tool of the full model, simulated open "
    "loop with the torques of simpler models: rigid (all springs rigid), fjm (only elastic "
    "gears), quasistatic (deflections without dynamics); of a robot in complete motor coupling "
    "they leave that out, as simplified (exact but for it) does. Every simulation starts in the "
    "equilibrium of the full model with the tool at the start of the path; the static sag that a "
    "simpler model neglects is not part of this error."
)
BY_ROBOT = (
    "Largest distance (or angle) between the path and the tool on robots whose parameters differ "
    "from the model. Every simulation starts in equilibrium with the motors at the first angles "
    "of the method. The static sag that rigid and fjm neglect is part of this error, so the "
    "values for the nominal robot are larger than those by method."
)


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

    def content(self) -> tuple[Part, ...]:
        """Tool errors by method; where asked for, those on robots that differ from the model."""
        rows = error_rows(self.solutions)
        units = [unit for unit in UNITS if any(f"largest_{unit}" in row for row in rows)]
        columns = (
            Column("method", "", "method"),
            Column("status", "", "status"),
            *(Column("at the start", unit, f"start_{unit}") for unit in units),
            *(Column(f"largest {WORDS[unit]}", unit, f"largest_{unit}") for unit in units),
        )
        cells = tuple(tuple(row.get(column.key) for column in columns) for row in rows)
        title = (
            f"{self.solution.model.title}, move {self.solution.move.name}: tool error by method"
        )
        return (
            Prose(title, is_title=True),
            Table(columns, cells, "Tool error by method, start on the path", "comparison"),
            Prose(BY_METHOD if cells else "no method is compared: the solution is not verified"),
            *self._robots(),
        )

    def _robots(self) -> tuple[Part, ...]:
        """Tables of the largest tool errors, static sag included: a row for each robot, a column
        for each method, a table for each control and unit.
        """
        if self.robustness is None:
            return ()
        keys = sorted({row["control"] for row in self.robustness})
        tables = [
            self._table_of_robots(
                [row for row in self.robustness if row["control"] == control], control, unit
            )
            for control in keys
            for unit in UNITS
        ]
        data = Data("robustness", self.robustness)
        title = Heading("Robustness: tool error including static sag")
        return title, Prose(BY_ROBOT), *(each for each in tables if each.cells), data

    @staticmethod
    def _table_of_robots(rows: list[dict[str, Any]], control: str, unit: str) -> Table:
        """The errors under one control; without rows where the output has no such part."""
        key = f"error_max_{unit}"
        known = [row for row in rows if row[key] is not None]
        methods = [*dict.fromkeys(row["method"] for row in known)]
        errors = {(row["plant"], row["method"]): row[key] for row in known}
        cells = tuple(
            (plant, *(errors.get((plant, method)) for method in methods))
            for plant in dict.fromkeys(row["plant"] for row in known)
        )
        title = f"{control}, largest {WORDS[unit]}: {MEANING[control]}"
        columns = (Column(control), *(Column(method, unit) for method in methods))
        return Table(columns, cells, title)


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
