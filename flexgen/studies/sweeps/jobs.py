"""Messages between a sweep and its workers: shards of jobs, and rows of results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flexgen.model.elements import Move, RobotModel
from flexgen.studies.sweeps.cases import Case, MoveChoice, RandomMove

Row = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A case for a worker; ``key``: of its model in `Shard.robots`, ``model``, ``parameters``: its
    labels.
    """

    number: int
    key: str
    model: str
    parameters: str
    move: MoveChoice
    method: str

    @staticmethod
    def of(case: Case, key: str) -> Job:
        """The job of a case."""
        model = case.model.name if isinstance(case.model, RobotModel) else str(case.model)
        changes = (
            json.dumps(dict(case.parameters), sort_keys=True, default=repr)
            if case.parameters
            else ""
        )
        return Job(case.number, key, model, changes, case.move, case.method)

    @property
    def heading(self) -> Row:
        """Columns of the table that describe the case."""
        move = self.move
        if isinstance(move, RandomMove):
            name = f"random{move.number}"
        else:
            name = move.name if isinstance(move, Move) else move or ""
        return {
            "case": self.number,
            "model": self.model,
            "parameters": self.parameters,
            "move": name,
            "method": self.method,
        }

    def move_of(self, robot: RobotModel) -> str | Move | None:
        """The move, for its model."""
        return self.move.of(robot) if isinstance(self.move, RandomMove) else self.move


@dataclass(frozen=True)
class Shard:
    """Cases that are solved together, with everything that a worker on another computer needs.

    ``robots``: models by key, or the reason where one could not be read. ``code``: version of the
    code that the worker must have.
    """

    number: int
    jobs: tuple[Job, ...]
    robots: Mapping[str, RobotModel | str]
    options: Mapping[str, Any]
    code: str


@dataclass(frozen=True)
class Rows:
    """Results of a shard: rows of the tables of results and of times."""

    results: list[Row]
    times: list[Row]


def failed_row(reason: str) -> Row:
    """Columns of a case without a solution."""
    return {"status": "failed", "error": reason}
