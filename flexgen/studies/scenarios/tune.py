"""Tuning of a controller on the score of a benchmark, without derivatives.

The numbers of a cascade and its filters are changed in logarithms by the simplex method of Nelder
and Mead, from several starts, which other processes can take; a refused controller counts as worse
the more robots fail.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.optimize import minimize

from flexgen.base.calls.deadline import (
    MOST_STEPS,
    OutOfTime,
    best_known,
    check_time,
    is_over,
    keep_best,
    limit_fit,
    reason_of_end,
)
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Bound, Seed, TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.numerics.executors import with_executor
from flexgen.base.results import Result
from flexgen.base.rows import Data, Part, Prose, Row, Table
from flexgen.base.spec.arguments import seed_of
from flexgen.base.spec.toml_text import toml
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.studies.scenarios.bench import Bench
from flexgen.studies.scenarios.leaderboard import scenario_controller
from flexgen.studies.scenarios.measures import measures_of
from flexgen.studies.scenarios.scenario import Scenario
from flexgen.studies.scenarios.scenario_file import scenario
from flexgen.studies.scenarios.score import (
    Score,
    draw_totals,
    reference_measures,
    robot_scores,
    score,
)

REFUSED = 10.0  # value of a refused controller, and more for every reason
SPREAD = 0.6  # of the logarithms: distance of other starts
FIRST = 0.25  # size of the first simplex
Evaluations = Annotated[int, Bound(1, 20_000, words="1 to 20000")]
Starts = Annotated[int, Bound(1, 1000, words="1 to 1000")]
Workers = Annotated[int, Bound(1, 512, words="1 to 512")]


@checked_result
@dataclass(frozen=True, repr=False)
class TuningResult(Result):
    """A tuned controller: ``controller``, its ``score``, and that of the start; ``history``: best
    value so far.

    ``evaluations``: how often the score was computed; ``ended``: "time limit" or "interrupted"
    where the search was ended from outside, else empty.

    Examples
    --------
    >>> tuned = flexgen.tune("four_mass", version=1, evaluations=3)
    >>> tuned.score.total < tuned.start.total
    True
    """

    controller: Cascade
    score: Score
    start: Score
    history: tuple[float, ...]
    evaluations: int
    ended: str = ""

    def __repr__(self) -> str:
        return (
            f"<TuningResult {self.score.scenario.name}: {self.evaluations} evaluations, score "
            f"{self.score.total:.4f}>"
        )

    def __str__(self) -> str:
        before = "refused" if not self.start.accepted else f"{self.start.total:.4f}"
        early = f"; {self.ended}: the best so far" if self.ended else ""
        return f"{self.score}\n  from {before} in {self.evaluations} evaluations{early}"

    def content(self) -> tuple[Part, ...]:
        """The score after the tuning, that before, and the effort."""
        shown = [part for part in self.score.content() if not isinstance(part, Data)]
        before = self.start.total if self.start.accepted else "refused"
        ended = f"{self.ended}: the controller is the best so far"
        return (
            *(replace(part, key="") if isinstance(part, Row | Table) else part for part in shown),
            Row("score V before", before),
            Row("evaluations", self.evaluations, "", "evaluations"),
            *([Prose(ended)] if self.ended else []),
            *self._data("evaluations"),
        )

    def save(self, path: str | Path) -> Path:
        """Write the controller as a table in TOML, which `flexgen.score` takes."""
        target = Path(path)
        write_text(
            target, cascade_table(self.controller, f"tuned on {self.score.scenario.title_line}")
        )
        return target


@checked_types
@reported("tune")
def tune(
    name: str | Path | Scenario,
    controller: Any = "reference",
    *,
    version: int | None = None,
    evaluations: Evaluations = 200,
    starts: Starts = 1,
    workers: Workers = 1,
    executor: Any = None,
    seed: Seed = 0,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> TuningResult:
    """Improve the numbers of a cascade on the score of a benchmark.

    Parameters
    ----------
    name : str, Path or Scenario
    controller : str or object
        The start: a P-PI cascade with filters, see `flexgen.score`.
    version : int, optional
        Of the benchmark; default: the newest.
    evaluations : int
        Of the score, from each start.
    starts : int
        Number of starts. Simplices: the first begins at the controller, the others at random
        points near it.
    workers : int
        Number of processes.
    executor : optional
        Computes the starts in place of own processes, as in `flexgen.sweep`: one of
        concurrent.futures, or a Client of dask.distributed.
    seed : int
        Of the other starts.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the result is the best so far; its
        ``ended`` says so. Both scores of the result are computed after that. 0: no limit.
    progress : callable or bool, optional

    Returns
    -------
    TuningResult

    Raises
    ------
    ArgumentError
        The controller is not a cascade, a number is out of range, or the executor has no
        ``submit``.

    Examples
    --------
    >>> tuned = flexgen.tune("four_mass", version=1, evaluations=3)
    >>> tuned.score.total < tuned.start.total
    True
    """
    tell = progress if callable(progress) else None
    if (
        executor is not None
        and not hasattr(executor, "submit")
        and not hasattr(executor, "get_executor")
    ):
        raise ArgumentError(
            f"executor: given {executor!r}, expected an object with submit(function, argument)"
        )
    chosen = name if isinstance(name, Scenario) else scenario(name, version)
    bench = Bench(chosen)
    made, _ = scenario_controller(controller, chosen, bench.motion)
    if not isinstance(made, Cascade):
        raise ArgumentError(
            f"controller: given {type(made).__name__}, expected a P-PI cascade with its filters "
            "to tune"
        )
    x = numbers_of(made)
    if not len(x):
        raise ArgumentError(
            "controller: given a cascade whose gains are all zero and that has no filter, "
            "expected one to tune"
        )
    rng = np.random.default_rng(seed_of(seed))
    begins = [x, *(x + SPREAD * rng.standard_normal(len(x)) for _ in range(starts - 1))]
    jobs = [
        _Job(k, chosen, made, begin, evaluations, time_limit) for k, begin in enumerate(begins)
    ]
    with limit_fit("tune", time_limit, tell):
        if executor is None and min(workers, starts) == 1:
            found = [jobs[0].search(tell)]
            found += [job.search(tell) for job in jobs[1:] if not is_over()]
        else:
            found = _in_parallel(jobs, min(workers, starts), executor, tell)
        ended = reason_of_end()
    # Outside of the time limit: the result of a search that was ended has whole scores, too.
    best = min(found, key=lambda f: f[1])
    controller = with_numbers(made, best[0])
    done = replace(score(chosen, controller, progress=False), controller="tuned")
    begun = score(chosen, made, progress=False)
    return TuningResult(controller, done, begun, tuple(best[2]), sum(f[3] for f in found), ended)


# best numbers, their value, the history, evaluations
Found = tuple[np.ndarray, float, list[float], int]


@dataclass(frozen=True)
class _Job:
    """One start."""

    number: int
    scenario: Scenario
    controller: Cascade
    begin: np.ndarray
    evaluations: int
    time_limit: float | None = None

    def search(self, tell: Callable[[str], None] | None) -> Found:
        return _search(self.scenario, self.controller, self.begin, self.evaluations, tell)


def _work(job: _Job) -> Found:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with limit_fit("tune", job.time_limit):
        return job.search(None)


def _in_parallel(
    jobs: list[_Job], workers: int, executor: Any, tell: Callable[[str], None] | None
) -> list[Found]:
    """The starts in the order of their numbers, in other processes."""
    found: dict[int, Found] = {}
    with ExitStack() as stack:
        if executor is None:
            executor = stack.enter_context(
                ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
            )
        for job, result in stack.enter_context(
            closing(with_executor(jobs, executor, None, _work))
        ):
            found[job.number] = result
            if tell is not None:
                tell(
                    f"{len(found)} of {len(jobs)} starts, best "
                    f"{min(f[1] for f in found.values()):.4f}"
                )
    return [found[job.number] for job in jobs]


def _search(
    chosen: Scenario,
    made: Cascade,
    begin: np.ndarray,
    evaluations: int,
    tell: Callable[[str], None] | None,
) -> Found:
    """The best numbers that a simplex finds from ``begin`` in a number of evaluations, their
    value, the best value after each evaluation, and how many there were.
    """
    bench = Bench(chosen)
    units = reference_measures(chosen, chosen.seed)
    measures = measures_of(chosen)
    history: list[float] = []
    best = begin
    least = math.inf

    def value(x: np.ndarray) -> float:
        """Mean score of the draws; a refused controller has `REFUSED` more, and the share of draws
        that refuse it, so that the simplex leaves them.
        """
        nonlocal best, least
        check_time("tune")
        began = time.perf_counter()
        try:
            trial = bench.run(with_numbers(made, x), parts=False)
        except OutOfTime:
            raise
        except FlexgenError:  # a filter beyond half the sample rate
            result = 10 * REFUSED
        else:
            each = robot_scores(measures, trial.values, units)
            result = float(
                draw_totals(chosen, np.nan_to_num(each, nan=REFUSED, posinf=REFUSED)).mean()
            )
            result += (REFUSED + len(trial.refused) / len(bench.draws)) if trial.refused else 0.0
        if result < least:
            best = x.copy()
            least = result
        history.append(least)
        best_known((time.perf_counter() - began) * evaluations / MOST_STEPS)
        if tell is not None:
            tell(f"{len(history)} of {evaluations} evaluations, best {least:.4f}")
        return result

    simplex = np.vstack([begin, begin + FIRST * np.eye(len(begin))])
    with keep_best():
        minimize(
            value,
            begin,
            method="Nelder-Mead",
            options={
                "maxfev": evaluations,
                "initial_simplex": simplex,
                "xatol": 1e-3,
                "fatol": 1e-4,
                "adaptive": True,
            },
        )
    return best, least, history, len(history)


def numbers_of(cascade: Cascade) -> np.ndarray:
    """Logarithms of the numbers that are tuned: gains above zero of all motors, then those of the
    filters.
    """
    gains = [x for part in _gains(cascade) for x in part if x > 0]
    return np.log(np.array([*gains, *(x for f in cascade.filters for x in _fields(f))]))


def with_numbers(cascade: Cascade, x: np.ndarray) -> Cascade:
    """The cascade with other numbers, the inverse of `numbers_of`."""
    values = iter(np.exp(np.clip(x, -50, 50)).tolist())
    gains = [
        np.array([next(values) if old > 0 else old for old in part]) for part in _gains(cascade)
    ]
    filters = tuple(type(f)(*(next(values) for _ in _fields(f))) for f in cascade.filters)
    return Cascade(gains[0], gains[1], gains[2], filters, cascade.torque_max)


def _gains(cascade: Cascade) -> list[np.ndarray]:
    """Gains of position, speed and integral, (n_m) each."""
    return [
        np.asarray(x, float)
        for x in (cascade.position_gain, cascade.speed_gain, cascade.integral_gain)
    ]


def _fields(f: LowPass | Notch) -> Sequence[float]:
    return [getattr(f, name) for name in f.__dataclass_fields__]


def cascade_table(cascade: Cascade | Linear, description: str) -> str:
    """A controller as a table in TOML."""

    def row(values: Any) -> str:
        return "[" + ", ".join(repr(float(x)) for x in values) + "]"

    lines = [f"description = {toml(description)}"]
    if isinstance(cascade, Linear):
        lines.append('type = "linear"')
        for name, x in zip("ABCD", cascade.matrices, strict=True):
            lines.append(f"{name} = [{', '.join(row(line) for line in x[0])}]")
        return "\n".join(lines) + "\n"
    lines.append('type = "cascade"')
    for name, part in zip(
        ("position_gain", "speed_gain", "integral_gain"), _gains(cascade), strict=True
    ):
        lines.append(f"{name} = {row(part)}")
    for f in cascade.filters:
        lines += ["", "[[low_pass]]" if isinstance(f, LowPass) else "[[notch]]"]
        lines += [f"{name} = {getattr(f, name)!r}" for name in f.__dataclass_fields__]
    return "\n".join(lines) + "\n"
