"""Executors of shards: this process and a process pool; `flexgen.base.numerics.executors` has
those of others.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterable
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from itertools import islice

from flexgen.base.calls.deadline import Deadline, check_time, interrupts_recorded
from flexgen.base.errors import SolverError
from flexgen.studies.sweeps.jobs import Rows, Shard, failed_row

Work = Callable[[Shard], Rows]
Done = Generator[tuple[Shard, Rows], None, None]

# Time [s] between two looks at the time limit and at Ctrl-C while worker processes compute.
POLL = 0.2


def in_process(shards: Iterable[Shard], work: Work) -> Done:
    """In this process, one shard after the other; Ctrl-C is kept where a solver in C++ catches
    it.
    """
    unlimited = Deadline(math.inf)
    with interrupts_recorded(unlimited):
        for shard in shards:
            rows = work(shard)
            unlimited.check(f"shard {shard.number}")
            check_time(f"shard {shard.number}")
            yield shard, rows


def in_pool(shards: Iterable[Shard], workers: int, work: Work) -> Done:
    """In a pool of processes; a case that kills its process is found and becomes a row with the
    reason.
    """
    todo = iter(shards)
    while first := list(islice(todo, 2 * workers)):
        suspects: list[Shard] = []
        with _Pool(workers) as pool:
            running = {pool.submit(work, shard): shard for shard in first}
            while running and not suspects:
                done, _ = futures.wait(running, POLL, return_when=futures.FIRST_COMPLETED)
                check_time("worker processes")
                for future in done:
                    shard = running.pop(future)
                    try:
                        rows = future.result()
                    except BrokenProcessPool:
                        suspects.append(shard)
                        continue
                    yield shard, rows
                    if not suspects:
                        running |= {pool.submit(work, more): more for more in islice(todo, 1)}
            for future, shard in running.items():  # a broken pool ends all its tasks
                if future.done() and future.exception() is None:
                    yield shard, future.result()
                else:
                    suspects.append(shard)
        for shard in suspects:
            yield shard, _run_isolated(shard, work)


class _Pool:
    """A process pool of new interpreters; after an error it is terminated at once."""

    def __init__(self, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = futures.ProcessPoolExecutor(
            workers, mp_context=context, initializer=_leave_interrupts
        )

    def submit(self, work: Work, shard: Shard) -> futures.Future[Rows]:
        """The future of a shard; where the pool is broken already, one with that error, so that a
        caller handles both alike.
        """
        try:
            return self._pool.submit(work, shard)
        except BrokenProcessPool as error:
            broken: futures.Future[Rows] = futures.Future()
            broken.set_exception(error)
            return broken

    def __enter__(self) -> _Pool:
        try:
            self._pool.submit(_start).result()
        except BrokenProcessPool:
            raise SolverError(
                "sweep: given worker processes that end at start, expected a script that they "
                "can import; put its calls below 'if __name__ == \"__main__\":', or take "
                "workers=0"
            ) from None
        return self

    def __exit__(self, kind: object, *details: object) -> None:
        if kind is None:
            self._pool.shutdown()
            return
        # running tasks are lost: do not wait for them
        processes = list((getattr(self._pool, "_processes", None) or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()


def _leave_interrupts() -> None:
    """Ignore Ctrl-C in a worker; the parent process handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _start() -> None:
    """First task of a worker: its process has started."""


def _run_isolated(shard: Shard, work: Work) -> Rows:
    """A shard that may have killed its process, in a separate process; halved until the case is
    found.
    """
    try:
        with _Pool(1) as pool:
            return pool.submit(work, shard).result()
    except BrokenProcessPool:
        pass
    if len(shard.jobs) == 1:
        job = shard.jobs[0]
        reason = failed_row(
            "the process that solved this case died: out of memory, or a fault in a library"
        )
        return Rows([job.heading | reason], [{"case": job.number}])
    middle = len(shard.jobs) // 2
    halves = [
        _run_isolated(replace(shard, jobs=jobs), work)
        for jobs in (shard.jobs[:middle], shard.jobs[middle:])
    ]
    return Rows(halves[0].results + halves[1].results, halves[0].times + halves[1].times)
