"""Sweep: all cases of a grid, solved in shards by one process or many, with the same bits for any number of them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.codegen.digest import model_digest
from flexgen.counts import CASES, count_of
from flexgen.errors import ArgumentError, FlexgenError
from flexgen.model.elements import RobotModel
from flexgen.numerics.executors import with_executor
from flexgen.progress import Choice, reported
from flexgen.results import Result
from flexgen.sweeps.cases import Case, Grid
from flexgen.sweeps.executors import Done, Work, in_pool, in_process
from flexgen.sweeps.folder import Folder, default_size
from flexgen.sweeps.jobs import Job, Rows, Shard
from flexgen.sweeps.summary import group_reasons, summarize
from flexgen.sweeps.table import RESULTS, TIMES, Table, table_of
from flexgen.sweeps.version import code_version, wants_native
from flexgen.sweeps.worker import run_shard
from flexgen.type_checks import checked_result, checked_types


@checked_result
@dataclass(frozen=True, repr=False)
class SweepResult(Result):
    """Tables of a sweep, one row for each case: the results, and the times, which differ from run to run.

    Examples
    --------
    >>> result = flexgen.sweep(flexgen.Grid(["elbow"], moves=flexgen.random_moves(2, seed=1)), workers=1)
    >>> print(*result.results["status"])
    solved solved
    >>> [column.name for column in result.times.columns]  # seconds of each case
    ['case', 'wall', 'cpu']
    """

    results: Table
    times: Table

    def __repr__(self) -> str:
        return f"<SweepResult: {len(self.results)} cases, {len(self.failures)} failed>"

    def to_dict(self) -> dict[str, Any]:
        """Figures by model, method and status, and the reasons of failed cases, as JSON types."""
        failed = self.failures.tolist()
        return {
            "cases": len(self.results),
            "failed": len(failed),
            "digest": self.results.digest,
            "groups": summarize(self.results, self.times),
            "failures": group_reasons(failed, [str(self.results["error"][k]) for k in failed]),
        }

    @property
    def failures(self) -> np.ndarray:
        """Numbers of the cases without a solution."""
        return np.asarray(self.results["case"][self.results["status"] == "failed"])


@checked_types(own=("grid", "workers", "shard_size", "in_flight"))
@reported("sweep")
def sweep(
    grid: Grid,
    out: str | Path | None = None,
    *,
    workers: int | None = None,
    executor: Any = None,
    shard_size: int | None = None,
    resume: bool = False,
    in_flight: int | None = None,
    progress: Choice = None,
) -> SweepResult:
    """Solve all cases of a grid.

    Parameters
    ----------
    grid : Grid
    out : str or Path, optional
        Folder for finished shards, and for the tables ``results.npz`` and ``times.npz`` at the end. Without a folder
        nothing is written, and an interruption loses all results.
    workers : int, optional
        Processes on this computer; 0 or 1: this process only; default: one for each core. They import the calling
        script, whose calls must be below ``if __name__ == "__main__":``.
    executor : optional
        Solves the shards instead: an object with ``submit(function, argument)`` that returns futures, such as the
        executors of concurrent.futures, or a Client of dask.distributed.
    shard_size : int, optional
        Cases of a shard, the unit of work that an interruption may lose; default: at most 16, or 512 where they are
        computed in batches.
    resume : bool
        Continue the sweep in ``out``.
    in_flight : int, optional
        Shards that are submitted to an executor at once.
    progress : callable or bool, optional
        Called with one line of text after every shard; default: messages on a terminal and in a notebook; False: none.

    Returns
    -------
    SweepResult
        A case that fails is a row with the reason. The bits of the results are the same for any number of workers,
        shards and interruptions.

    Raises
    ------
    ArgumentError
        An argument is wrong, or the folder contains something else.
    SolverError
        Workers cannot be started, or are lost repeatedly.

    Examples
    --------
    >>> grid = flexgen.Grid(["elbow"], moves=flexgen.random_moves(2, seed=1), methods=["closed-form"])
    >>> result = flexgen.sweep(grid, workers=1)
    >>> print(*result.results["status"])
    solved solved
    """
    _check_arguments(grid, out, workers, executor, shard_size, resume, in_flight)
    log = progress if callable(progress) else (lambda line: None)
    code = code_version(wants_native(grid.options))
    folder = None if out is None else Folder(out, grid, code, shard_size, resume, log)
    size = (shard_size or default_size(grid)) if folder is None else folder.shard_size
    memory: dict[int, Rows] = {}
    count = -(-len(grid) // size)
    if folder is None:
        missing = list(range(count))
    else:
        missing = [number for number in range(count) if folder.rows(number) is None]
    shards = _shards(grid, missing, size, code)
    report = _Progress(len(grid), sum(len(_numbers(grid, number, size)) for number in missing), log)
    with closing(
        _execute(shards, workers, executor, in_flight, min(len(missing), 1_000_000), run_shard)
    ) as done:
        for shard, rows in done:
            if folder is None:
                memory[shard.number] = rows
            else:
                folder.keep(shard.number, rows)
            report.add(rows)
    found = SweepResult(
        table_of(RESULTS, (row for k in range(count) for row in _rows(folder, memory, k).results)),
        table_of(TIMES, (row for k in range(count) for row in _rows(folder, memory, k).times)),
    )
    if folder is not None:
        found.results.save(folder.path / "results.npz")
        found.times.save(folder.path / "times.npz")
    return found


def _check_arguments(
    grid: Grid,
    out: str | Path | None,
    workers: int | None,
    executor: Any,
    shard_size: int | None,
    resume: bool,
    in_flight: int | None,
) -> None:
    """ArgumentError where an argument of `sweep` has a wrong type or value."""
    if not isinstance(grid, Grid):
        raise ArgumentError(f"grid: given {grid!r}, expected a Grid")
    for name, value, least in (
        ("workers", workers, 0),
        ("shard_size", shard_size, 1),
        ("in_flight", in_flight, 1),
    ):
        if value is not None:
            count_of(name, value, CASES, least)
    if executor is not None and workers is not None:
        raise ArgumentError("workers: given together with an executor, expected one of the two")
    if (
        executor is not None
        and not hasattr(executor, "submit")
        and not hasattr(executor, "get_executor")
    ):
        raise ArgumentError(
            f"executor: given {executor!r}, expected an object with submit(function, argument)"
        )
    if resume and out is None:
        raise ArgumentError(
            "resume: given without a folder, expected out= with the folder to resume"
        )


def _execute(
    shards: Iterator[Shard],
    workers: int | None,
    executor: Any,
    in_flight: int | None,
    count: int,
    work: Work,
) -> Done:
    if executor is not None:
        return with_executor(shards, executor, in_flight, work)
    if workers is None:
        workers = (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else os.cpu_count() or 1
        )
    workers = min(workers, count)
    return in_process(shards, work) if workers < 2 else in_pool(shards, workers, work)


def _numbers(grid: Grid, shard: int, size: int) -> range:
    """Numbers of the cases of a shard."""
    return range(shard * size, min((shard + 1) * size, len(grid)))


def _rows(folder: Folder | None, memory: dict[int, Rows], number: int) -> Rows:
    if folder is None:
        return memory[number]
    rows = folder.rows(number)
    if rows is None:
        raise ArgumentError(
            f"{folder.path}: shard {number} was removed while the sweep ran; resume the sweep"
        )
    return rows


def _shards(grid: Grid, numbers: list[int], size: int, code: str) -> Iterator[Shard]:
    """Shards with everything that a worker needs, one after the other."""
    read: dict[tuple[int, int], tuple[str, RobotModel | str]] = {}
    for number in numbers:
        jobs, robots = [], {}
        for k in _numbers(grid, number, size):
            case = grid[k]
            label = id(case.model), id(case.parameters)  # the grid holds both
            if label not in read:
                read.clear()  # models change slowest: earlier ones are not needed again
                read[label] = _read(case)
            key, robot = read[label]
            robots[key] = robot
            jobs.append(Job.of(case, key))
        yield Shard(number, tuple(jobs), robots, dict(grid.options), code)


def _read(case: Case) -> tuple[str, RobotModel | str]:
    """The model of a case with its key, or the reason why it cannot be read."""
    try:
        robot = case.robot()
    except Exception as error:  # a wrong value in one parameter set must not lose the others
        reason = (
            str(error) if isinstance(error, FlexgenError) else f"{type(error).__name__}: {error}"
        )
        return f"unreadable: {reason}", reason
    return model_digest(robot), robot


class _Progress:
    """Reports the progress of a sweep."""

    def __init__(self, cases: int, missing: int, log: Callable[[str], None]) -> None:
        self._cases, self._missing, self._log = cases, missing, log
        self._done, self._failed, self._began = 0, 0, time.perf_counter()
        if missing < cases:
            log(f"{cases - missing} of {cases} cases are finished already")

    def add(self, rows: Rows) -> None:
        """Report one more finished shard."""
        self._done += len(rows.results)
        self._failed += sum(row["status"] == "failed" for row in rows.results)
        rate = self._done / max(time.perf_counter() - self._began, 1e-9)
        left = (self._missing - self._done) / rate
        self._log(
            f"{self._cases - self._missing + self._done} of {self._cases} cases, {self._failed} failed, "
            f"{rate:.3g} cases/s, {_span(left)} remaining"
        )


def _span(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
