"""Work in any executor with ``submit``, such as one of a cluster."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable
from concurrent import futures
from itertools import islice
from typing import Any, Protocol, TypeVar

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import FlexgenError, SolverError

JobT = TypeVar("JobT", bound="Numbered")
ResultT = TypeVar("ResultT")

IN_FLIGHT = 32  # jobs submitted at once to an executor of unknown size
ATTEMPTS = 2  # of a job whose worker was lost
POLL = 0.05  # s: interval of polling futures that are not of concurrent.futures

# Time [s] between two looks at the time limit and at Ctrl-C while the jobs run.
CHECK = 0.2


class Numbered(Protocol):
    """Protocol of submitted jobs: each has a number."""

    @property
    def number(self) -> int:
        """For messages."""
        ...


def with_executor(
    shards: Iterable[JobT], executor: Any, in_flight: int | None, work: Callable[[JobT], ResultT]
) -> Generator[tuple[JobT, ResultT], None, None]:
    """Pairs of shard and result of ``work``, as they are done, by an ``executor`` whose ``submit``
    returns futures with ``done``, ``result`` and ``cancel``.

    At most ``in_flight`` shards at a time, default twice its workers. A shard that is lost with
    its worker is tried again, up to `ATTEMPTS` times; SolverError then.
    """
    if hasattr(executor, "get_executor"):  # a Client of dask.distributed
        executor = executor.get_executor()
    most = in_flight or 2 * (getattr(executor, "_max_workers", None) or IN_FLIGHT // 2)
    todo = iter(shards)
    running: dict[Any, tuple[JobT, int]] = {}
    try:
        while True:
            running |= {
                executor.submit(work, shard): (shard, 1)
                for shard in islice(todo, most - len(running))
            }
            if not running:
                return
            for future in _wait_for_first(list(running)):
                shard, attempt = running.pop(future)
                try:
                    rows = future.result()
                except FlexgenError:
                    raise
                except Exception as error:  # the worker or its result is lost
                    if attempt == ATTEMPTS or isinstance(error, futures.BrokenExecutor):
                        raise SolverError(
                            f"sweep: shard {shard.number} was lost {attempt} times "
                            f"({type(error).__name__}: {error}); finished shards are kept; "
                            "check the workers, then resume"
                        ) from error
                    running[executor.submit(work, shard)] = (shard, attempt + 1)
                    continue
                yield shard, rows
    finally:
        for future in running:
            future.cancel()


def _wait_for_first(running: list[Any]) -> list[Any]:
    """The futures that are done; waits for at least one."""
    if all(isinstance(future, futures.Future) for future in running):
        done: set[futures.Future[Any]] = set()
        while not done:
            done = futures.wait(running, CHECK, return_when=futures.FIRST_COMPLETED).done
            check_time("executor")
        return [future for future in running if future in done]
    while True:
        check_time("executor")
        found = [future for future in running if future.done()]
        if found:
            return found
        time.sleep(POLL)
