"""What travels between a sweep and its workers: shards of jobs one way, rows the other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flexgen.model.elements import Move, RobotModel
from flexgen.sweeps.cases import Case, MoveChoice, RandomMove

Row = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A case on its way to a worker; ``key``: of its model in `Shard.robots`, ``model``, ``parameters``: its labels."""

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
        changes = json.dumps(dict(case.parameters), sort_keys=True, default=repr) if case.parameters else ""
        return Job(case.number, key, model, changes, case.move, case.method)

    @property
    def heading(self) -> Row:
        """What the table says of it before it is done."""
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
        """The move on its model."""
        return self.move.of(robot) if isinstance(self.move, RandomMove) else self.move


@dataclass(frozen=True)
class Shard:
    """Cases that are done in one go, with all that a worker on another machine needs.

    ``robots``: models by key, or, where one could not be read, the reason. ``code``: what the worker's own version of
    the code must be.
    """

    number: int
    jobs: tuple[Job, ...]
    robots: Mapping[str, RobotModel | str]
    options: Mapping[str, Any]
    code: str


@dataclass(frozen=True)
class Rows:
    """What came out of a shard: rows of the tables of results and of times."""

    results: list[Row]
    times: list[Row]


def failed(reason: str) -> Row:
    """What the table says of a case without a solution."""
    return {"status": "failed", "error": reason}
