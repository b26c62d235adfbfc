"""Sweeps: the same bits for any number of workers, shards and interruptions; one bad case stops nothing."""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import importlib.util
import json
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flexgen.errors import ArgumentError, SolverError
from flexgen.model.elements import Move
from flexgen.model.reader import read
from flexgen.sweeps import folder as folders
from flexgen.sweeps import sweep as sweeps
from flexgen.sweeps.cases import Grid, RandomMove, combinations, random_moves
from flexgen.sweeps.command import add_arguments, run
from flexgen.sweeps.crews import in_pool, in_process, with_executor
from flexgen.sweeps.grid_file import read_grid
from flexgen.sweeps.jobs import Job, Rows, Shard
from flexgen.sweeps.sweep import sweep
from flexgen.sweeps.table import RESULTS, Column, Table, table_of
from flexgen.sweeps.version import code_version
from flexgen.sweeps.work import WrongCode, run_shard

ROBOTS = Path(__file__).parent / "robots"
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "sweep.toml"
ONE = str(ROBOTS / "one.toml")
QUICK = {"verify": False}


def real_grid() -> Grid:
    """Seven cases: real solves of six machines, and a key that does not exist."""
    changes = combinations({"motor.m1.inertia": [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4]})
    quick = Grid([ONE], (None,), ["collocation"], changes, QUICK)
    return replace(quick, parameters=(*changes, {"motor.m1.speed": 1.0}))


@contextlib.contextmanager
def sources_stay():
    """Processes that start while somebody edits the sources are refused, and rightly so."""
    try:
        yield
    except WrongCode:
        if code_version.__wrapped__() == code_version():
            raise
        pytest.skip("the sources of flexgen changed while the test ran")


def batch_grid(count: int) -> Grid:
    """Cases of which a hundred take no time."""
    return Grid(["elbow"], random_moves(count), ["closed-form"], options=QUICK | {"batch": True})


# --- grids ------------------------------------------------------------------------------------------------------------


def test_cases_have_one_order() -> None:
    grid = Grid(["a", "b"], ("x", "y"), ["m", "n"], [{"k": 1}, {"k": 2}])
    assert len(grid) == 16 == len(list(grid))
    assert [(c.model, c.parameters["k"], c.move, c.method) for c in (grid[0], grid[1], grid[2], grid[4], grid[8])] == [
        ("a", 1, "x", "m"),
        ("a", 1, "x", "n"),
        ("a", 1, "y", "m"),
        ("a", 2, "x", "m"),
        ("b", 1, "x", "m"),
    ]
    assert [case.number for case in grid] == list(range(16))
    with pytest.raises(IndexError):
        grid[16]
    assert combinations({"p": [1, 2], "q": [3, 4]}) == (
        {"p": 1, "q": 3},
        {"p": 1, "q": 4},
        {"p": 2, "q": 3},
        {"p": 2, "q": 4},
    )


def test_the_digest_is_of_the_content(tmp_path) -> None:
    text = (ROBOTS / "one.toml").read_text(encoding="utf-8")
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "one.toml").write_text(text, encoding="utf-8")
    grid = real_grid()
    assert grid.digest == real_grid().digest
    same = replace(grid, models=(read(ONE),))
    assert same.describe()["models"][0]["digest"] == grid.describe()["models"][0]["digest"]
    changed = text.replace("inertia = 1e-4", "inertia = 1.1e-4").replace("inertia = 1.0e-4", "inertia = 1.1e-4")
    digests = {grid.digest}
    (tmp_path / "first" / "one.toml").write_text(changed, encoding="utf-8")
    other = [
        replace(grid, models=(str(tmp_path / "first" / "one.toml"),)),
        replace(grid, models=(str(tmp_path / "second" / "one.toml"),)),  # it has the same content, but another name
        replace(grid, methods=("auto",)),
        replace(grid, moves=(None, RandomMove(4))),
        replace(grid, options={}),
        replace(grid, parameters=grid.parameters[:1]),
    ]
    digests |= {one.digest for one in other}
    assert len(digests) == 7
    contents = [one.describe()["models"][0]["digest"] for one in other[:2]]
    assert changed != text and contents[0] != contents[1] == grid.describe()["models"][0]["digest"]


def test_random_moves_keep_the_limits() -> None:
    model = read("manutec_r3")
    moves = [move.of(model) for move in random_moves(50, seed=2, duration=0.7, smoothness=4)]
    assert moves == [move.of(model) for move in random_moves(50, seed=2, duration=0.7, smoothness=4)]
    assert len({move.start for move in moves}) == 50
    from flexgen.problems.timing import TimeLaw

    s = np.abs(TimeLaw(0.7, 4)(np.linspace(0, 0.7, 501), 2)).max(axis=0)
    ways = np.abs([np.subtract(move.end, move.start) for move in moves])
    dofs = [c.dof for c in model.coordinates if c.dof is not None]
    speeds, accelerations = ([getattr(dof, name) for dof in dofs] for name in ("speed_max", "acceleration_max"))
    assert (ways * s[1] < speeds).all() and (ways * s[2] < accelerations).all()
    assert (np.maximum(ways * s[1] / speeds, ways * s[2] / accelerations).max(axis=0) > 0.8).all()  # and use them
    narrow = read("elbow", overrides={"element.upper.dof.q1.lower_rad": 0.0, "element.upper.dof.q1.upper_rad": 1.0})
    ends = np.array([move.of(narrow).end[0] for move in random_moves(50)])
    assert (ends >= 0).all() and (ends <= 1).all() and np.ptp(ends) > 0.5


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"models": []}, "one or more names"),
        ({"models": "elbow"}, "expected a sequence"),
        ({"methods": [1]}, "one or more names"),
        ({"moves": [3]}, "names, moves or None"),
        ({"parameters": {"a": 1}}, "expected a sequence"),
        ({"options": {"speed": 1}}, "expected some of preview"),
    ],
)
def test_grids_that_make_no_sense(change, text) -> None:
    with pytest.raises(ArgumentError, match=text):
        Grid(**({"models": ["elbow"]} | change))


def test_grid_files(tmp_path) -> None:
    file = tmp_path / "grid.toml"
    file.write_text(
        'models = ["elbow"]\nmoves = ["line"]\nmethods = ["auto", "full"]\n[random]\ncount = 2\nseed = 7\n'
        '[parameters]\n"motor.m1.inertia" = [1e-3, 2e-3]\n[options]\nverify = false\n',
        encoding="utf-8",
    )
    grid = read_grid(file)
    assert grid.moves == ("line", *random_moves(2, 7)) and len(grid) == 12
    assert grid[6].parameters == {"motor.m1.inertia": 2e-3} and grid.options == {"verify": False}
    file.write_text('models = ["a"]\n[parameters]\na.b = [1, 2]\n', encoding="utf-8")
    assert read_grid(file).parameters == ({"a.b": 1}, {"a.b": 2})
    file.write_text('models = ["a"]\n[[set]]\n"a.b" = 1\n[[set]]\n"a.b" = 2\nc = 3\n', encoding="utf-8")
    assert read_grid(file).parameters == ({"a.b": 1}, {"a.b": 2, "c": 3})
    example = read_grid(EXAMPLE)
    assert len(example) == 18 and all(case.robot().name == case.model for case in example)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("models = [", "no TOML"),
        ('models = ["a"]\nspeed = 1', "the key 'speed'"),
        ("methods = []", "models"),
        ('models = ["a"]\nrandom = 3', "a table with count"),
        ('models = ["a"]\n[random]\ncount = 1.5', "a whole number"),
        ('models = ["a"]\n[random]\ncount = 1\nduration = -1', "a positive number"),
        ('models = ["a"]\n[random]\ncount = 1\ncolour = 1', "the key 'colour'"),
        ('models = ["a"]\n[parameters]\n"x" = 3', "a list of values"),
        ('models = ["a"]\nparameters = 3', "expected a table"),
        ('models = ["a"]\n[parameters]\nx = [3]\n[[set]]\nx = 1', "one of them"),
        ('models = ["a"]\nset = 3', "expected a sequence"),
        ('models = ["a"]\nmoves = 3', "expected a sequence"),
    ],
)
def test_wrong_grid_files_are_told(tmp_path, text, reason) -> None:
    file = tmp_path / "grid.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ArgumentError, match=reason) as error:
        read_grid(file)
    assert str(file) in str(error.value)
    with pytest.raises(ArgumentError, match="cannot be read"):
        read_grid(tmp_path)


# --- the same bits ----------------------------------------------------------------------------------------------------


def test_real_solves_give_the_same_bits_for_any_workers_and_shards(tmp_path) -> None:
    grid = real_grid()
    made = {}
    for name, workers, shard_size in (("one", 0, 7), ("two", 0, 4), ("seven", 2, 1)):
        with sources_stay():
            swept = sweep(grid, tmp_path / name, workers=workers, shard_size=shard_size)
        made[name] = (tmp_path / name / "results.npz").read_bytes()
        assert swept.results.digest == Table.load(tmp_path / name / "results.npz").digest
    assert len(set(made.values())) == 1
    results = swept.results
    assert list(results["status"]) == 6 * ["solved"] + ["failed"]
    assert "motor.m1.speed" in results["error"][6] and np.isnan(results["torque_max"][6])
    assert len(set(results["torque_max"][:6])) == 6 and (results["iterations"][:6] > 0).all()
    assert set(results["move"][:6]) == {read(ONE).moves[0].name}
    assert np.isfinite(swept.times["wall"]).all()


def test_planted_bugs_change_the_bits(monkeypatch) -> None:
    """A wrong order of the cases, and a worker whose answer depends on the shard."""
    grid = batch_grid(6)
    right = sweep(grid, workers=0, shard_size=2).results.digest
    shards = sweeps._shards

    def reversed_shards(*args):
        for shard in shards(*args):
            jobs = shard.jobs[::-1]
            yield replace(shard, jobs=tuple(replace(b, number=a.number) for a, b in zip(shard.jobs, jobs, strict=True)))

    with monkeypatch.context() as patch:
        patch.setattr(sweeps, "_shards", reversed_shards)
        assert sweep(grid, workers=0, shard_size=2).results.digest != right

    def careless(shard: Shard) -> Rows:
        rows = run_shard(shard)
        for row in rows.results:
            row["torque_max"] = float(np.nextafter(row["torque_max"], 0.0 if len(shard.jobs) == 2 else 1e9))
        return rows

    monkeypatch.setattr(sweeps, "run_shard", careless)
    assert len({sweep(grid, workers=0, shard_size=size).results.digest for size in (2, 3)}) == 2


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask.distributed is not installed")
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


# --- shards on disk ---------------------------------------------------------------------------------------------------


class Stop:
    """Ctrl-C after some shards."""

    def __init__(self, shards: int) -> None:
        self.shards, self.lines = shards, []

    def __call__(self, line: str) -> None:
        self.lines.append(line)
        if len(self.lines) == self.shards:
            raise KeyboardInterrupt


@pytest.mark.parametrize("workers", [0, 2])
def test_an_interruption_loses_what_was_running_and_nothing_else(tmp_path, workers) -> None:
    grid, out = batch_grid(7), tmp_path / "out"
    with sources_stay(), pytest.raises(KeyboardInterrupt):
        sweep(grid, out, workers=workers, shard_size=2, progress=Stop(2))
    kept = {file.name: file.read_bytes() for file in (out / "shards").iterdir()}
    assert len(kept) == 2 and not (out / "results.npz").exists()
    with pytest.raises(ArgumentError, match="continue it with resume=True"):
        sweep(grid, out, workers=0)
    lines: list[str] = []
    with sources_stay():
        swept = sweep(grid, out, workers=workers, resume=True, progress=lines.append)
    assert lines[0].startswith(("4 of 7 cases are there", "3 of 7 cases are there"))
    assert len(lines) == 3 and "7 of 7 cases, 0 failed" in lines[-1] and "to go" in lines[-1]
    assert all((out / "shards" / name).read_bytes() == content for name, content in kept.items())
    assert swept.results.digest == sweep(grid, workers=0).results.digest
    again = sweep(grid, out, workers=0, resume=True)  # nothing is left to do
    assert again.results.digest == swept.results.digest and again.times.digest == swept.times.digest


def test_damaged_shards_are_computed_again(tmp_path) -> None:
    grid, out = batch_grid(6), tmp_path / "out"
    right = sweep(grid, out, workers=0, shard_size=2).results.digest
    shards = [out / "shards" / f"{k:06d}.json" for k in range(3)]
    whole = [file.read_bytes() for file in shards]
    for damage in (
        lambda text: text[: len(text) // 2],
        lambda text: b"",
        lambda text: text.replace(b'"torque_max": ', b'"torque_max": 1', 1),
        lambda text: b"\xff\xfe" + text,
    ):
        shards[1].write_bytes(damage(whole[1]))
        lines: list[str] = []
        assert sweep(grid, out, workers=0, resume=True, progress=lines.append).results.digest == right
        assert "000001.json: damaged" in lines[0] and "4 of 6 cases are there" in lines[1] and len(lines) == 3
    assert [len(file.read_bytes()) for file in shards[::2]] == [len(text) for text in whole[::2]]


def test_what_belongs_to_another_sweep_is_refused(tmp_path, monkeypatch) -> None:
    grid, out, other = batch_grid(4), tmp_path / "out", tmp_path / "other"
    sweep(grid, out, workers=0, shard_size=2)
    sweep(batch_grid(5), other, workers=0, shard_size=2)
    with pytest.raises(ArgumentError, match="of another grid"):
        sweep(batch_grid(5), out, workers=0, resume=True)
    with pytest.raises(ArgumentError, match="with shards of 2 cases"):
        sweep(grid, out, workers=0, resume=True, shard_size=3)
    name = "shards/000000.json"
    (out / name).write_bytes((other / name).read_bytes())
    with pytest.raises(ArgumentError, match=r"a shard of another sweep .*remove the file"):
        sweep(grid, out, workers=0, resume=True)
    (out / name).write_bytes((out / "shards/000001.json").read_bytes())
    with pytest.raises(ArgumentError, match="number 1"):
        sweep(grid, out, workers=0, resume=True)
    (out / name).unlink()
    monkeypatch.setattr(sweeps, "code_version", lambda: "0+other")
    with pytest.raises(ArgumentError, match="computed by other code"):
        sweep(grid, out, workers=0, resume=True)
    (out / "sweep.json").write_text("{", encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"unreadable sweep\.json"):
        sweep(grid, out, workers=0, resume=True)
    (out / "sweep.json").unlink()
    with pytest.raises(ArgumentError, match="something that is no sweep"):
        sweep(grid, out, workers=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="which is a file"):
        sweep(grid, tmp_path / "file", workers=0)


def test_a_file_appears_whole_or_not_at_all(tmp_path, monkeypatch) -> None:
    file = tmp_path / "shard.json"

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(folders.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        folders._write(file, "text")
    assert list(tmp_path.iterdir()) == []


def test_workers_with_other_code_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(sweeps, "code_version", lambda: "0+other")
    with pytest.raises(WrongCode, match=r"expected 0\+other"):
        sweep(batch_grid(1), workers=0)
    assert code_version().partition("+")[2]


# --- crews ------------------------------------------------------------------------------------------------------------


def shards_of(count: int, size: int) -> list[Shard]:
    jobs = [Job(k, "", "m", "", None, "auto") for k in range(count)]
    return [Shard(k, tuple(jobs[k * size : (k + 1) * size]), {}, {}, "") for k in range(-(-count // size))]


def echo(shard: Shard) -> Rows:
    return Rows([job.heading | {"status": "solved"} for job in shard.jobs], [])


def deadly(shard: Shard) -> Rows:
    """Case 1 takes its process with it."""
    if any(job.number == 1 for job in shard.jobs):
        os._exit(9)
    return echo(shard)


def test_a_case_that_kills_its_process_becomes_a_row() -> None:
    rows = [row for _, done in in_pool(shards_of(3, 2), 2, deadly) for row in done.results]
    assert sorted(row["case"] for row in rows) == [0, 1, 2]
    assert {row["case"]: "died" in row.get("error", "") for row in rows} == {0: False, 1: True, 2: False}


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
    """What an executor of another kind may return."""

    def __init__(self, call) -> None:
        self.call, self.asked = call, 0

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
        self.now, self.most, self.losses = 0, 0, losses

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
    shards = list(sweeps._shards(grid, [0, 1], 1, code_version()))
    found: list[Rows] = []
    threads = [threading.Thread(target=lambda s=shard: found.append(run_shard(s))) for shard in shards]
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
def test_wrong_arguments_are_told(arguments, text) -> None:
    with pytest.raises(ArgumentError, match=text):
        sweep(batch_grid(1), **arguments)
    with pytest.raises(ArgumentError, match="expected a Grid"):
        sweep("grid.toml")


# --- cases that fail, tables, the command line ------------------------------------------------------------------------


def test_one_failing_case_stops_nothing(monkeypatch) -> None:
    unreachable = Move("far", "tool_line", (0.0, 0.5), 1.0, 5, displacement=(9.0, 0.0, 0.0))
    grid = Grid(["elbow", "nowhere"], (None, unreachable, "no such move"), options=QUICK)
    lines: list[str] = []
    table = sweep(grid, workers=0, shard_size=4, progress=lines.append).results
    assert list(table["status"]) == ["solved"] + 5 * ["failed"]
    assert all(table["error"][1:]) and "no such move" in table["error"][2] and "nowhere" in table["error"][4]
    assert "4 of 6 cases, 3 failed" in lines[0] and "6 of 6 cases, 5 failed" in lines[1]

    def broken(*args: object, **named: object) -> None:
        raise ZeroDivisionError("division by zero")

    import flexgen.sweeps.work as work

    monkeypatch.setattr(work, "solve", broken)
    assert sweep(Grid(["elbow"]), workers=0).results["error"][0] == "ZeroDivisionError: division by zero"


def test_parameters_of_a_model_that_was_read_are_refused_in_the_row() -> None:
    table = sweep(Grid([read("elbow")], parameters=[{"motor.m1.inertia": 1.0}]), workers=0).results
    assert "which was read before" in table["error"][0]


ROWS = [
    {"case": 0, "status": "solved", "torque_max": 0.1, "iterations": 3},
    {"case": 1, "status": "failed", "error": "ä" * 1000, "torque_max": None, "energy": -np.float64(np.nan)},
]


def test_tables_keep_every_bit(tmp_path) -> None:
    table = table_of(RESULTS, ROWS)
    assert len(table) == 2 and table["iterations"].tolist() == [3, -1] and np.isnan(table["torque_max"][1])
    assert len(table["error"][1]) == 400
    assert table.digest == table_of(RESULTS, [ROWS[0], ROWS[1] | {"energy": np.nan}]).digest
    assert table_of(RESULTS, [{"error": "\udcff"}])["error"][0] == "\\udcff"
    files = [table.save(tmp_path / name) for name in ("a.npz", "b.npz")]
    assert files[0].read_bytes() == files[1].read_bytes()
    again = Table.load(files[0])
    assert again.digest == table.digest and again.columns == table.columns
    units = {column.name: column.unit for column in again.columns}
    assert units["torque_max"] == "N m" and units["energy"] == "J"
    assert table_of(RESULTS, ROWS[::-1]).digest != table.digest
    assert table_of([Column("case", "int", "s", "")], ROWS).digest != table_of(RESULTS[:1], ROWS).digest
    with pytest.raises(ArgumentError, match=r"ends in \.npz"):
        table.save(tmp_path / "a.csv")
    with pytest.raises(ArgumentError, match="does not exist"):
        Table.load(tmp_path / "c.npz")
    (tmp_path / "c.npz").write_text("no table")
    with pytest.raises(ArgumentError, match="no table of flexgen"):
        Table.load(tmp_path / "c.npz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz", "c.npz"]


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow is not installed")
def test_parquet_has_types_and_units(tmp_path) -> None:
    from pyarrow import parquet

    table = table_of(RESULTS, ROWS)
    found = parquet.read_table(table.save(tmp_path / "a.parquet"))
    assert found.column_names == [column.name for column in RESULTS]
    assert found.schema.field("torque_max").metadata[b"unit"] == b"N m"
    assert str(found.schema.field("case").type) == "int64" and found["status"].to_pylist() == ["solved", "failed"]


def test_parquet_without_pyarrow_is_told(tmp_path, monkeypatch) -> None:
    import flexgen.sweeps.table as tables

    def missing(name: str) -> None:
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(tables, "import_module", missing)
    with pytest.raises(ArgumentError, match=r"install flexgen\[parquet\]"):
        table_of(RESULTS, ROWS).save(tmp_path / "a.parquet")


def arguments(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(words)


def test_the_command_line(tmp_path) -> None:
    file, out = tmp_path / "grid.toml", tmp_path / "out"
    file.write_text(
        'models = ["elbow", "nowhere"]\nmethods = ["closed-form"]\n[random]\ncount = 3\n'
        "[options]\nverify = false\nbatch = true\n",
        encoding="utf-8",
    )
    data, text, problem, warnings = run(
        arguments(str(file), "--out", str(out), "--workers", "0", "--shard-size", "2"), lambda line: None
    )
    assert (data["cases"], data["failed"], problem) == (6, 3, "") and len(warnings) == 3
    assert json.dumps(data) and [group["cases"] for group in data["groups"]] == [3, 3]
    assert "6 cases, 3 failed" in text and "closed-form" in text and f"wrote {out / 'results.npz'}" in text
    assert data["digest"] == Table.load(out / "results.npz").digest
    again = run(arguments(str(file), "--out", str(out), "--workers", "0", "--resume"), lambda line: None)
    assert again[0]["digest"] == data["digest"]
    file.write_text('models = ["nowhere"]\n', encoding="utf-8")
    assert run(arguments(str(file), "--out", str(tmp_path / "bad"), "--workers", "0"), print)[2] == "all cases failed"
    for wrong in (("--workers", "-1"), ("--workers", "two"), ("--shard-size", "0")):
        with pytest.raises(SystemExit):
            arguments("grid.toml", "--out", "x", *wrong)
