"""Pools of processes that break, and poses that are proposed: made-up pools, differences, and
searches by hand.
"""

from __future__ import annotations

import tomllib
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.poses.parameters import Priors, unknowns_of
from flexgen.identification.poses.result import FRAME, Calibration
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.studies.sweeps import executors
from flexgen.studies.sweeps.jobs import Job, Rows, Shard


def shard(number: int, *cases: int) -> Shard:
    jobs = tuple(Job(case, "k", "arm", "", "line", "lq") for case in cases)
    return Shard(number, jobs, {}, {}, "code")


def solved(part: Shard) -> Rows:
    rows = [{"case": job.number, "status": "solved"} for job in part.jobs]
    return Rows(rows, [{"case": job.number, "s": 1.0} for job in part.jobs])


class Pool:
    """A pool that is broken for good by a deadly case; it counts those that were begun, and how
    they end.
    """

    deadly: frozenset[int] = frozenset()
    made: list[int] = []  # noqa: RUF012
    ends: list[Any] = []  # noqa: RUF012
    sent: list[int] = []  # noqa: RUF012

    def __init__(self, workers: int) -> None:
        self.broken = False
        Pool.made.append(workers)

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: object, *details: object) -> None:
        Pool.ends.append(kind)

    def submit(self, work: Any, part: Shard) -> Future[Rows]:
        future: Future[Rows] = Future()
        Pool.sent.append(part.number)
        self.broken = self.broken or any(job.number in Pool.deadly for job in part.jobs)
        if self.broken:
            future.set_exception(BrokenProcessPool("died"))
        else:
            future.set_result(work(part))
        return future


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> type[Pool]:
    monkeypatch.setattr(executors, "_Pool", Pool)
    Pool.deadly = frozenset()
    Pool.made = []
    Pool.ends = []
    Pool.sent = []
    return Pool


def test_a_pool_solves_all_shards_and_takes_more_as_they_end(pool: type[Pool]) -> None:
    """Two for each worker at once, then one for each that is done."""
    shards = [shard(k, 2 * k, 2 * k + 1) for k in range(11)]
    taken: list[int] = []

    def given() -> Any:
        for one in shards:
            taken.append(one.number)
            yield one

    found = executors.in_pool(given(), 2, solved)
    assert next(found)[1].results[0]["status"] == "solved" and len(taken) == 4
    rest = list(found)
    assert len(rest) == 10 and sorted(pool.sent) == list(range(11)) and set(pool.made) == {2}
    assert all(kind is None for kind in pool.ends)


def test_a_case_that_kills_its_process_becomes_a_row(pool: type[Pool]) -> None:
    """Shards of the broken pool are solved again, each alone, halved until the case is found;
    nothing is lost.
    """
    pool.deadly = frozenset({7})
    shards = [
        shard(0, 0, 1),
        shard(1, 2, 3, 4),
        shard(2, 5, 6, 7, 8),
        shard(3, 9),
        shard(4, 10, 11),
    ]
    found = {part.number: rows for part, rows in executors.in_pool(shards, 1, solved)}
    assert sorted(found) == [0, 1, 2, 3, 4]
    cases = {row["case"]: row for rows in found.values() for row in rows.results}
    assert sorted(cases) == list(range(12)) and [row["case"] for row in found[2].results] == [
        5,
        6,
        7,
        8,
    ]
    assert [row["case"] for row in found[2].times] == [5, 6, 7, 8] and found[2].times[2] == {
        "case": 7
    }
    died = cases.pop(7)
    reason = "the process that solved this case died: out of memory, or a fault in a library"
    heading = {"case": 7, "model": "arm", "parameters": "", "move": "line", "method": "lq"}
    assert died == heading | {"status": "failed", "error": reason}
    assert all(row["status"] == "solved" for row in cases.values())
    assert executors._run_isolated(shard(9, 7), solved).results == [died]
    assert [row["case"] for row in executors._run_isolated(shard(9, 6, 7, 8), solved).results] == [
        6,
        7,
        8,
    ]


def test_a_pool_that_does_not_start_names_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks of a broken pool are futures with the error; after an error processes are ended, else
    waited for.
    """

    class Broken:
        calls: list[Any] = []  # noqa: RUF012

        def __init__(self, workers: int, mp_context: Any, initializer: Any) -> None:
            assert workers == 3 and mp_context.get_start_method() == "spawn"
            self._processes = {1: SimpleNamespace(terminate=lambda: Broken.calls.append("ended"))}

        def submit(self, *given: Any) -> Any:
            raise BrokenProcessPool("died")

        def shutdown(self, **given: Any) -> None:
            Broken.calls.append(given)

    monkeypatch.setattr(executors.futures, "ProcessPoolExecutor", Broken)
    made = executors._Pool(3)
    with pytest.raises(BrokenProcessPool):
        made.submit(solved, shard(0, 1)).result()
    with pytest.raises(
        SolverError,
        match=r"^sweep: given worker processes that end at start, expected a script that ",
    ):
        made.__enter__()
    made.__exit__(None)
    assert Broken.calls == [{}]
    made.__exit__(ValueError)
    assert Broken.calls[1:] == [{"wait": False, "cancel_futures": True}, "ended"]


# --- calibration ---------------------------------------------------------------------------------
TRACKERS = [
    {"name": "a", "type": "tracker", "unit": "m", "position": [0.1, 0.0, 0.05]},
    {"name": "b", "type": "tracker", "unit": "m", "element": "upper", "position": [0.0, 0.1, 0.0]},
]


class Commands:
    """Poses whose positions do not matter."""

    source = "poses.csv"
    is_measured = True

    def __init__(self, commands: np.ndarray) -> None:
        self.commands = commands

    def __len__(self) -> int:
        return len(self.commands)


def made_up(**more: Any) -> Calibration:
    """A calibration of the robot elbow whose numbers are known."""
    model = flexgen.read("elbow", overrides={"sensor": TRACKERS})
    tree = Tree(model)
    unknowns = tuple(unknowns_of(tree, ("zeros",), (), Priors()))
    x = np.array([u.start for u in unknowns])
    rng = np.random.default_rng(5)
    x = x + 0.01 * rng.standard_normal(len(x))
    root = np.diag(rng.uniform(0.5, 2.0, len(x))) * 1e-3
    commands = rng.uniform([-1.0, -0.5], [0.5, 1.5], (12, 2))
    found = object.__new__(Calibration)
    fields = {
        "nominal": model,
        "unknowns": unknowns,
        "x": x,
        "covariance": root @ root,
        "poses": Commands(commands),
        "errors": np.full((12, 2), 2e-4),
        "errors_before": np.full((12, 2), 1e-3),
        "errors_held_out": None,
        "converged": True,
    }
    for name, value in (fields | more).items():
        object.__setattr__(found, name, value)
    return found


def test_proposed_poses_are_those_of_the_largest_determinants() -> None:
    """One after the other among candidates, with derivatives by differences of the predicted
    positions.
    """
    found = made_up()
    candidates = np.random.default_rng(1).uniform(-1.5, 1.5, (15, 2))
    chosen = found.propose_poses(3, candidates)
    tree = Tree(found.nominal)
    statics = Statics(tree, candidates)
    h = 1e-6
    slopes = []
    for k in range(len(found.x)):
        more, less = (
            statics.rest(
                Numbers.of(tree, found.unknowns, found.x + s * h * (np.arange(len(found.x)) == k))
            ).measured
            for s in (1.0, -1.0)
        )
        slopes.append((more - less).reshape(15, -1) / (2 * h))
    J = np.stack(slopes, axis=2) / 2e-4
    information = np.linalg.inv(found.covariance)
    expected = []
    for _ in range(3):
        gains = [
            np.linalg.slogdet(information + j.T @ j)[1] if k not in expected else -np.inf
            for k, j in enumerate(J)
        ]
        expected.append(int(np.argmax(gains)))
        information = information + J[expected[-1]].T @ J[expected[-1]]
    assert_allclose(chosen, candidates[expected])
    before = found.covariance.copy()
    drawn = found.propose_poses(2)
    assert drawn.shape == (2, 2) and np.array_equal(found.covariance, before)
    low = found.poses.commands.min(axis=0)
    high = found.poses.commands.max(axis=0)
    assert (
        (drawn >= low).all()
        and (drawn <= high).all()
        and not np.array_equal(drawn, found.propose_poses(2, seed=3))
    )
    with pytest.raises(
        ArgumentError, match=r"^candidates: given shape \(15, 1\), expected \(m, 2\)$"
    ):
        found.propose_poses(1, candidates[:, :1])
    with pytest.raises(
        ArgumentError, match=r"^count: given 16, expected 1 to 15, the number of candidates$"
    ):
        found.propose_poses(16, candidates)
    assert len(found.propose_poses(15, candidates)) == 15


def test_numbers_and_words_of_a_calibration(tmp_path: Path) -> None:
    found = made_up()
    frame = [found.values[f"{FRAME}.{name}"] for name in ("x", "y", "z", "rx", "ry", "rz")]
    assert_allclose(found.frame, frame)
    tree = Tree(found.nominal)
    commands = np.array([[0.1, 0.2], [0.3, -0.4]])
    expected = Statics(tree, commands).rest(Numbers.of(tree, found.unknowns, found.x)).measured
    assert_allclose(found.predict(commands), expected)
    count = len(found.unknowns)
    assert found.sentence == f"12 poses, {count} numbers; mean error 1 mm before, 0.2 mm after"
    assert found.problem == "" and "did not end" in made_up(converged=False).problem
    sd = np.sqrt(np.diag(found.covariance))
    assert_allclose(list(found.sd.values()), sd)
    determined = [s < 0.3 * u.sd for s, u in zip(sd, found.unknowns, strict=True)]
    assert list(found.determined.values()) == determined
    with pytest.raises(
        ArgumentError, match=r"^world: given 'none', expected 'robot' or 'measurement'$"
    ):
        found.write(tmp_path / "a.toml", "none")
    with pytest.raises(
        ArgumentError, match=r"^path: given '.*a\.json', expected a name that ends in \.toml$"
    ):
        found.write(tmp_path / "a.json")
    written = found.write(tmp_path / "a.toml")
    variant = tomllib.loads(written.read_text())["variant"]["calibrated"]
    assert (
        variant["set"] == found.changes
        and variant["description"] == f"poses.csv: {found.sentence}"
    )
    # the trackers are overrides: the new file has them, and so has the calibrated model
    again = flexgen.read(f"{written}@calibrated")
    assert again.sensors == found.model.sensors
    for before, after in zip(found.nominal.sensors, again.sensors, strict=True):
        place = [found.values[f"{before.name}.{axis}"] for axis in "xyz"]
        assert replace(after, position=before.position) == before
        assert_allclose(after.position, place, rtol=0, atol=1e-15)
    moved = found.write(tmp_path / "b.toml", "measurement")
    assert tomllib.loads(moved.read_text())["variant"]["calibrated"]["set"] != variant["set"]
