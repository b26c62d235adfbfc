"""Sweep: all cases of a grid, solved in shards by one process or many, with the same bits for any
number of them.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base import rows
from flexgen.base.calls.deadline import keep_best, limit_fit, part_known, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Count, CountOrZero, TimeLimit
from flexgen.base.checks.counts import CASES, count_of
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.numerics.executors import with_executor
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose
from flexgen.codegen.emission.digest import model_digest
from flexgen.model.elements import RobotModel
from flexgen.studies.sweeps.cases import Case, Grid
from flexgen.studies.sweeps.executors import Done, Work, in_pool, in_process
from flexgen.studies.sweeps.folder import Folder, default_size
from flexgen.studies.sweeps.jobs import Job, Rows, Shard
from flexgen.studies.sweeps.summary import group_reasons, summarize
from flexgen.studies.sweeps.table import RESULTS, TIMES, Table, table_of
from flexgen.studies.sweeps.version import code_version, wants_native
from flexgen.studies.sweeps.worker import run_shard

# Columns of the groups of cases by model, method and status.
GROUPS = (
    Column("model", key="model"),
    Column("method", key="method"),
    Column("status", key="status"),
    Column("cases", key="cases"),
    Column("tool error m", key="tool_error_max"),
    Column("tool error rad", key="turn_error_max"),
    Column("torque N m", key="torque_max"),
    Column("processor s", key="cpu"),
)


@checked_result
@dataclass(frozen=True, repr=False)
class SweepResult(Result):
    """Tables of a sweep, one row for each case: the results, and the times, which differ from run
    to run.

    Attributes
    ----------
    results, times : Table
    cases : int
        Of the grid.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where not all cases have a row.

    Examples
    --------
    >>> result = flexgen.sweep(
    ...     flexgen.Grid(["elbow"], moves=flexgen.random_moves(2, seed=1)), workers=1
    ... )
    >>> print(*result.results["status"])
    solved solved
    >>> [column.name for column in result.times.columns]  # seconds of each case
    ['case', 'wall', 'cpu']
    """

    results: Table
    times: Table
    cases: int = 0
    ended: str = ""

    def __repr__(self) -> str:
        early = f", {self.status}" if self.ended else ""
        return f"<SweepResult: {len(self.results)} cases, {len(self.failures)} failed{early}>"

    @property
    def status(self) -> str:
        """``done``, or why not all cases have a row, and how many have."""
        if not self.ended:
            return "done"
        return f"{self.ended}: {len(self.results)} of {self.cases} cases are done"

    @property
    def errors(self) -> dict[int, str]:
        """Reasons of the failed cases, by the number of the case."""
        rows = self.results["status"] == "failed"
        named = zip(self.results["case"][rows], self.results["error"][rows], strict=True)
        return {int(case): str(error) for case, error in named}

    def content(self) -> tuple[Part, ...]:
        """The cases by model, method and status, and the reasons of failed ones as data."""
        failed = self.failures.tolist()
        early = f"; {self.status}" if self.ended else ""
        groups = summarize(self.results, self.times)
        cells = tuple(tuple(group[column.key] for column in GROUPS) for group in groups)
        return (
            Prose(f"{len(self.results)} cases, {len(failed)} failed{early}", is_title=True),
            Data("status", self.status),
            Data("cases", len(self.results)),
            Data("failed", len(failed)),
            Data("digest", self.results.digest),
            rows.Table(GROUPS, cells, "Cases", "groups"),
            Data("failures", group_reasons(failed, list(self.errors.values()))),
        )

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
    workers: CountOrZero | None = None,
    executor: Any = None,
    shard_size: Count | None = None,
    resume: bool = False,
    in_flight: int | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> SweepResult:
    """Solve all cases of a grid.

    Parameters
    ----------
    grid : Grid
    out : str or Path, optional
        Directory for shards and tables. Finished shards, and at the end ``results.npz`` and
        ``times.npz``. Without a folder nothing is written.
    workers : int, optional
        Worker processes; 0 or 1: run in this process; default: one per core. They import the
        calling script, whose calls must be below ``if __name__ == "__main__":``.
    executor : optional
        Solves the shards instead: an object with ``submit(function, argument)`` that returns
        futures, such as the executors of concurrent.futures, or a Client of dask.distributed.
    shard_size : int, optional
        Cases per shard, the unit of work and of saved results; default: 1 to 16. At most 512 where
        they are computed in batches; an interruption may lose one.
    resume : bool
        Continue the sweep in its folder. That is ``out``.
    in_flight : int, optional
        Shards that are submitted to an executor at once.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the sweep ends with the rows of the
        finished shards, and ``ended`` says so; ``resume`` continues it. None or 0: unlimited.
    progress : callable or bool, optional
        Called with one line of text after every shard; default: messages on a terminal and in a
        notebook; False: none.

    Returns
    -------
    SweepResult
        A case that fails is a row with the reason. The bits of the results are the same for any
        number of workers, shards and interruptions.

    Raises
    ------
    ArgumentError
        An argument is wrong, or the folder contains something else.
    OutOfTime
        The time was over before the first shard.
    SolverError
        Workers cannot be started, or are lost repeatedly.

    Examples
    --------
    >>> grid = flexgen.Grid(
    ...     ["elbow"], moves=flexgen.random_moves(2, seed=1), methods=["closed-form"]
    ... )
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
    shards = shards_of(grid, missing, size, code)
    report = _Progress(
        len(grid), sum(len(_numbers(grid, number, size)) for number in missing), log
    )
    left = set(missing)
    with limit_fit("sweep", time_limit, first="shard of cases"):
        if len(missing) < count:
            part_known("shards", 0.0, len(missing))
        with (
            keep_best(),
            closing(
                _execute(
                    shards, workers, executor, in_flight, min(len(missing), 1_000_000), run_shard
                )
            ) as done,
        ):
            for shard, rows in done:
                if folder is None:
                    memory[shard.number] = rows
                else:
                    folder.keep(shard.number, rows)
                left.remove(shard.number)
                part_known("shards", 0.0, len(left))
                report.add(rows)
        ended = reason_of_end() if left else ""
    return _collect(grid, folder, memory, [k for k in range(count) if k not in left], ended)


def _collect(
    grid: Grid, folder: Folder | None, memory: dict[int, Rows], finished: list[int], ended: str
) -> SweepResult:
    """The tables of the finished shards, from the folder or ``memory``, written to the folder;
    ``ended``: why the sweep ended early.
    """
    found = SweepResult(
        table_of(RESULTS, (row for k in finished for row in _rows(folder, memory, k).results)),
        table_of(TIMES, (row for k in finished for row in _rows(folder, memory, k).times)),
        len(grid),
        ended,
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
    """The rows of shards as they are done: by the given ``executor`` (``in_flight``: shards at
    once), in this process, or in a pool of ``workers`` (default: processors; at most ``count``
    shards).
    """
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
    """Rows of a finished shard, from the folder or ``memory``; ArgumentError where its file has
    gone.
    """
    if folder is None:
        return memory[number]
    rows = folder.rows(number)
    if rows is None:
        raise ArgumentError(
            f"{folder.path}: shard {number} was removed while the sweep ran; resume the sweep"
        )
    return rows


def shards_of(grid: Grid, numbers: list[int], size: int, code: str) -> Iterator[Shard]:
    """Shards with everything that a worker needs, one after the other; ``size``: cases of one,
    ``code``: version that computes them. A model is read once for cases in a row.
    """
    read: dict[tuple[int, int], tuple[str, RobotModel | str]] = {}
    for number in numbers:
        jobs = []
        robots = {}
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
        """``missing``: cases that are not finished yet, of ``cases``."""
        self._cases = cases
        self._missing = missing
        self._log = log
        self._done = 0
        self._failed = 0
        self._began = time.perf_counter()
        if missing < cases:
            log(f"{cases - missing} of {cases} cases are finished already")

    def add(self, rows: Rows) -> None:
        """Report one more finished shard."""
        self._done += len(rows.results)
        self._failed += sum(row["status"] == "failed" for row in rows.results)
        rate = self._done / max(time.perf_counter() - self._began, 1e-9)
        left = (self._missing - self._done) / rate
        self._log(
            f"{self._cases - self._missing + self._done} of {self._cases} cases, {self._failed} "
            f"failed, {rate:.3g} cases/s, {span_text(left)} remaining"
        )


def span_text(seconds: float) -> str:
    """A time in the unit in which it has two or three digits."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
