"""Executors of shards: this process, a process pool, or any executor with ``submit``, such as one of a cluster."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from itertools import islice
from typing import Any, Protocol, TypeVar

from flexgen.errors import FlexgenError, SolverError
from flexgen.sweeps.jobs import Rows, Shard, failed

Work = Callable[[Shard], Rows]
Done = Generator[tuple[Shard, Rows], None, None]
JobT = TypeVar("JobT", bound="Numbered")
ResultT = TypeVar("ResultT")

IN_FLIGHT = 32  # shards submitted at once to an executor of unknown size
ATTEMPTS = 2  # of a shard whose worker was lost
POLL = 0.05  # s: interval of polling futures that are not of concurrent.futures


def in_process(shards: Iterable[Shard], work: Work) -> Done:
    """In this process, one shard after the other; Ctrl-C is kept where a solver in C++ catches it."""
    with _Interrupts() as interrupts:
        for shard in shards:
            rows = work(shard)
            if interrupts.noted:
                raise KeyboardInterrupt
            yield shard, rows


def in_pool(shards: Iterable[Shard], workers: int, work: Work) -> Done:
    """In a pool of processes; a case that kills its process is found and becomes a row with the reason."""
    todo = iter(shards)
    while first := list(islice(todo, 2 * workers)):
        suspects: list[Shard] = []
        with _Pool(workers) as pool:
            running = {pool.submit(work, shard): shard for shard in first}
            while running and not suspects:
                done, _ = futures.wait(running, return_when=futures.FIRST_COMPLETED)
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
            yield shard, _isolated(shard, work)


class Numbered(Protocol):
    """What is submitted: it has a number."""

    @property
    def number(self) -> int:
        """For messages."""
        ...


def with_executor(
    shards: Iterable[JobT], executor: Any, in_flight: int | None, work: Callable[[JobT], ResultT]
) -> Generator[tuple[JobT, ResultT], None, None]:
    """With ``executor.submit(work, shard)``, which returns futures with ``done``, ``result`` and ``cancel``."""
    if hasattr(executor, "get_executor"):  # a Client of dask.distributed
        executor = executor.get_executor()
    most = in_flight or 2 * (getattr(executor, "_max_workers", None) or IN_FLIGHT // 2)
    todo = iter(shards)
    running: dict[Any, tuple[JobT, int]] = {}
    try:
        while True:
            running |= {executor.submit(work, shard): (shard, 1) for shard in islice(todo, most - len(running))}
            if not running:
                return
            for future in _first(list(running)):
                shard, attempt = running.pop(future)
                try:
                    rows = future.result()
                except FlexgenError:
                    raise
                except Exception as error:  # the worker or its result is lost
                    if attempt == ATTEMPTS or isinstance(error, futures.BrokenExecutor):
                        raise SolverError(
                            f"sweep: shard {shard.number} was lost {attempt} times ({type(error).__name__}: {error}); "
                            "finished shards are kept; check the workers, then resume"
                        ) from error
                    running[executor.submit(work, shard)] = (shard, attempt + 1)
                    continue
                yield shard, rows
    finally:
        for future in running:
            future.cancel()


def _first(running: list[Any]) -> list[Any]:
    """The futures that are done; waits for at least one."""
    if all(isinstance(future, futures.Future) for future in running):
        done = futures.wait(running, return_when=futures.FIRST_COMPLETED).done
        return [future for future in running if future in done]
    while True:
        found = [future for future in running if future.done()]
        if found:
            return found
        time.sleep(POLL)


class _Pool:
    """A process pool of new interpreters; after an error it is terminated at once."""

    def __init__(self, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = futures.ProcessPoolExecutor(workers, mp_context=context, initializer=_leave_interrupts)

    def submit(self, work: Work, shard: Shard) -> futures.Future[Rows]:
        try:
            return self._pool.submit(work, shard)
        except BrokenProcessPool as error:
            broken: futures.Future[Rows] = futures.Future()
            broken.set_exception(error)
            return broken

    def __enter__(self) -> _Pool:
        try:
            self._pool.submit(_started).result()
        except BrokenProcessPool:
            raise SolverError(
                "sweep: given worker processes that end at start, expected a script that they can import; "
                "put its calls below 'if __name__ == \"__main__\":', or take workers=0"
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


def _started() -> None:
    """First task of a worker: its process has started."""


def _isolated(shard: Shard, work: Work) -> Rows:
    """A shard that may have killed its process, in a separate process; halved until the case is found."""
    try:
        with _Pool(1) as pool:
            return pool.submit(work, shard).result()
    except BrokenProcessPool:
        pass
    if len(shard.jobs) == 1:
        job = shard.jobs[0]
        reason = failed("the process that solved this case died: out of memory, or a fault in a library")
        return Rows([job.heading | reason], [{"case": job.number}])
    middle = len(shard.jobs) // 2
    halves = [_isolated(replace(shard, jobs=jobs), work) for jobs in (shard.jobs[:middle], shard.jobs[middle:])]
    return Rows(halves[0].results + halves[1].results, halves[0].times + halves[1].times)


class _Interrupts:
    """Records Ctrl-C and passes it to the previous handler; only in the main thread."""

    def __enter__(self) -> _Interrupts:
        self.noted = False
        self._other: Any = None
        if threading.current_thread() is threading.main_thread():
            other = signal.getsignal(signal.SIGINT)
            if callable(other):
                self._other = other
                signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *error: object) -> None:
        if self._other is not None:
            signal.signal(signal.SIGINT, self._other)

    def _note(self, number: int, frame: Any) -> None:
        self.noted = True
        self._other(number, frame)
