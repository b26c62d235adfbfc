"""Shards in this process, pools, threads and executors of any kind give the same bits, and lose
nothing.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import importlib.util
import os
import signal
import threading
import time

import pytest
from sweep_grids import batch_grid, sources_stay

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.executors import with_executor
from flexgen.studies.sweeps import sweep as sweeps
from flexgen.studies.sweeps.executors import in_pool, in_process
from flexgen.studies.sweeps.jobs import Job, Rows, Shard
from flexgen.studies.sweeps.sweep import sweep
from flexgen.studies.sweeps.version import code_version
from flexgen.studies.sweeps.worker import run_shard


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="no dask.distributed; run: make setup-test",
)
def test_dask_gives_the_same_bits(tmp_path) -> None:
    import distributed

    grid = batch_grid(6)
    with (
        sources_stay(),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", local_directory=tmp_path
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        far = sweep(grid, executor=client, shard_size=2).results
    assert far.digest == sweep(grid, workers=0).results.digest


def test_threads_give_the_same_bits() -> None:
    grid = batch_grid(6)
    with concurrent.futures.ThreadPoolExecutor(3) as executor:
        near = sweep(grid, executor=executor, shard_size=1).results
    assert near.digest == sweep(grid, workers=0).results.digest


def shards_of(count: int, size: int) -> list[Shard]:
    jobs = [Job(k, "", "m", "", None, "auto") for k in range(count)]
    return [
        Shard(k, tuple(jobs[k * size : (k + 1) * size]), {}, {}, "")
        for k in range(-(-count // size))
    ]


def echo(shard: Shard) -> Rows:
    return Rows([job.heading | {"status": "solved"} for job in shard.jobs], [])


def deadly(shard: Shard) -> Rows:
    """Case 1 takes its process with it."""
    if any(job.number == 1 for job in shard.jobs):
        os._exit(9)
    return echo(shard)


@pytest.mark.slow
def test_a_case_that_kills_its_process_becomes_a_row() -> None:
    rows = [row for _, done in in_pool(shards_of(3, 2), 2, deadly) for row in done.results]
    assert sorted(row["case"] for row in rows) == [0, 1, 2]
    assert {row["case"]: "died" in row.get("error", "") for row in rows} == {
        0: False,
        1: True,
        2: False,
    }


@pytest.mark.slow
def test_an_interruption_that_a_solver_swallows_is_not_lost() -> None:
    def swallow(shard: Shard) -> Rows:
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(10)
        return echo(shard)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        list(in_process(shards_of(2, 1), swallow))
    assert signal.getsignal(signal.SIGINT) is before


class Future:
    """Future of an executor of another kind."""

    def __init__(self, call) -> None:
        self.call = call
        self.asked = 0

    def done(self) -> bool:
        self.asked += 1
        return self.asked > 1

    def result(self) -> Rows:
        return self.call()

    def cancel(self) -> None:
        pass


class Executor:
    """Counts what is under way, and loses the first ``losses`` of it."""

    def __init__(self, losses: int = 0) -> None:
        self.now = 0
        self.most = 0
        self.losses = losses

    def submit(self, function, argument) -> Future:
        self.now += 1
        self.most = max(self.most, self.now)
        return Future(lambda: self.finish(function, argument))

    def finish(self, function, argument) -> Rows:
        self.now -= 1
        if self.losses:
            self.losses -= 1
            raise ConnectionError("worker lost")
        return function(argument)


def test_executors_of_any_kind() -> None:
    made = 0

    def lazily():
        nonlocal made
        for shard in shards_of(20, 1):
            made += 1
            yield shard

    executor = Executor(losses=1)
    for count, _ in enumerate(with_executor(lazily(), executor, 3, echo)):
        assert made <= count + 4  # shards are made when there is room for them
    assert made == 20 == count + 1 and executor.most == 3
    with pytest.raises(SolverError, match=r"lost 2 times .*resume"):
        list(with_executor(shards_of(1, 1), Executor(losses=2), None, echo))


def test_equations_are_built_by_one_thread_at_a_time() -> None:
    """Two threads of one worker do their shards one after the other."""
    grid = batch_grid(2)
    shards = list(sweeps.shards_of(grid, [0, 1], 1, code_version()))
    found: list[Rows] = []
    threads = [
        threading.Thread(target=lambda s=shard: found.append(run_shard(s))) for shard in shards
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(rows.results[0]["case"] for rows in found) == [0, 1]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"workers": -1}, "workers: given -1"),
        ({"workers": True}, "workers: given True"),
        ({"shard_size": 0}, "shard_size: given 0"),
        ({"in_flight": 1.5}, "in_flight: given 1.5"),
        ({"workers": 1, "executor": Executor()}, "one of the two"),
        ({"executor": 3}, "an object with submit"),
        ({"resume": True}, "without a folder"),
    ],
)
def test_wrong_arguments_are_refused(arguments, text) -> None:
    with pytest.raises(ArgumentError, match=text):
        sweep(batch_grid(1), **arguments)
    with pytest.raises(ArgumentError, match="expected a Grid"):
        sweep("grid.toml")
