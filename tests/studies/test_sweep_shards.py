"""Sweeps: the same bits for any number of shards and interruptions; one bad case stops nothing."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sweep_grids import ONE, QUICK, batch_grid, real_grid, sources_stay

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.codegen.build.compiler import Compiler
from flexgen.model.elements import Move
from flexgen.model.reader import read
from flexgen.studies.sweeps import folder as folders
from flexgen.studies.sweeps import sweep as sweeps
from flexgen.studies.sweeps import version as versions
from flexgen.studies.sweeps.cases import Grid
from flexgen.studies.sweeps.jobs import Rows, Shard
from flexgen.studies.sweeps.sweep import sweep
from flexgen.studies.sweeps.table import Table
from flexgen.studies.sweeps.version import code_version, find_version, wants_native
from flexgen.studies.sweeps.worker import WrongCode, run_shard


@pytest.mark.slow
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
    shards = sweeps.shards_of

    def reversed_shards(*args):
        for shard in shards(*args):
            jobs = shard.jobs[::-1]
            yield replace(
                shard,
                jobs=tuple(
                    replace(b, number=a.number) for a, b in zip(shard.jobs, jobs, strict=True)
                ),
            )

    with monkeypatch.context() as patch:
        patch.setattr(sweeps, "shards_of", reversed_shards)
        assert sweep(grid, workers=0, shard_size=2).results.digest != right

    def careless(shard: Shard) -> Rows:
        rows = run_shard(shard)
        for row in rows.results:
            row["torque_max"] = float(
                np.nextafter(row["torque_max"], 0.0 if len(shard.jobs) == 2 else 1e9)
            )
        return rows

    monkeypatch.setattr(sweeps, "run_shard", careless)
    assert len({sweep(grid, workers=0, shard_size=size).results.digest for size in (2, 3)}) == 2


# --- shards on disk ------------------------------------------------------------------------------


class Stop:
    """Ctrl-C after some shards."""

    def __init__(self, shards: int) -> None:
        self.shards = shards
        self.lines = []

    def __call__(self, line: str) -> None:
        self.lines.append(line)
        if len(self.lines) == self.shards:
            raise KeyboardInterrupt


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_an_interruption_loses_what_was_running_and_nothing_else(tmp_path, workers) -> None:
    grid = batch_grid(7)
    out = tmp_path / "out"
    with sources_stay():
        ended = sweep(grid, out, workers=workers, shard_size=2, progress=Stop(2))
    kept = {file.name: file.read_bytes() for file in (out / "shards").iterdir()}
    assert len(kept) == 2 and ended.ended == "interrupted"
    cases = ended.results["case"].tolist()
    assert len(cases) in (3, 4) and cases == sorted(set(cases))
    assert Table.load(out / "results.npz").digest == ended.results.digest
    with pytest.raises(ArgumentError, match="continue it with resume=True"):
        sweep(grid, out, workers=0)
    lines: list[str] = []
    with sources_stay():
        swept = sweep(grid, out, workers=workers, resume=True, progress=lines.append)
    assert lines[0].startswith(("4 of 7 cases are finished", "3 of 7 cases are there"))
    assert len(lines) == 3 and "7 of 7 cases, 0 failed" in lines[-1] and "remaining" in lines[-1]
    assert all((out / "shards" / name).read_bytes() == content for name, content in kept.items())
    assert swept.results.digest == sweep(grid, workers=0).results.digest
    again = sweep(grid, out, workers=0, resume=True)  # nothing is left to do
    assert (
        again.results.digest == swept.results.digest and again.times.digest == swept.times.digest
    )


def test_progress_tells_the_rate_and_the_time_that_remains(tmp_path, monkeypatch) -> None:
    """A clock that advances by 50 s with each shard of two cases; the first shard is there."""
    grid = batch_grid(7)
    out = tmp_path / "out"
    sweep(grid, out, workers=0, shard_size=2)
    for number in (1, 2, 3):
        (out / "shards" / f"{number:06d}.json").unlink()
    seconds = itertools.count(0.0, 50.0)
    monkeypatch.setattr(sweeps, "time", SimpleNamespace(perf_counter=lambda: next(seconds)))
    lines: list[str] = []
    sweep(grid, out, workers=0, resume=True, progress=lines.append)
    assert lines == [
        "2 of 7 cases are finished already",
        "4 of 7 cases, 0 failed, 0.04 cases/s, 75 s remaining",
        "6 of 7 cases, 0 failed, 0.04 cases/s, 25 s remaining",
        "7 of 7 cases, 0 failed, 0.0333 cases/s, 0 s remaining",
    ]


def test_damaged_shards_are_computed_again(tmp_path) -> None:
    grid = batch_grid(6)
    out = tmp_path / "out"
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
        assert (
            sweep(grid, out, workers=0, resume=True, progress=lines.append).results.digest == right
        )
        assert (
            "000001.json: damaged" in lines[0]
            and "4 of 6 cases are finished" in lines[1]
            and len(lines) == 3
        )
    assert [len(file.read_bytes()) for file in shards[::2]] == [len(text) for text in whole[::2]]


def test_a_folder_with_hidden_files_is_empty(tmp_path) -> None:
    (tmp_path / ".kept").write_text("")
    sweep(batch_grid(2), tmp_path, workers=0)
    assert (tmp_path / "sweep.json").exists()


def test_what_belongs_to_another_sweep_is_refused(tmp_path, monkeypatch) -> None:
    grid = batch_grid(4)
    out = tmp_path / "out"
    other = tmp_path / "other"
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
    monkeypatch.setattr(sweeps, "code_version", lambda native: "0+other")
    with pytest.raises(ArgumentError, match="computed by other code"):
        sweep(grid, out, workers=0, resume=True)
    (out / "sweep.json").write_text("{", encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"unreadable sweep\.json"):
        sweep(grid, out, workers=0, resume=True)
    (out / "sweep.json").unlink()
    with pytest.raises(ArgumentError, match="which contains other files"):
        sweep(grid, out, workers=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="which is a file"):
        sweep(grid, tmp_path / "file", workers=0)


def test_a_file_appears_whole_or_not_at_all(tmp_path, monkeypatch) -> None:
    file = tmp_path / "shard.json"

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        ArgumentError, match=rf"given '{file}', which cannot be written \(No space .* free space"
    ):
        folders.write_text(file, "text")
    with pytest.raises(ArgumentError, match="which cannot be written"):
        sweep(batch_grid(2), tmp_path / "out", workers=0)
    assert not file.exists() and not list((tmp_path / "out" / "shards").iterdir())


@pytest.mark.parametrize(
    "content",
    [
        [],
        5,
        {},
        {"results": 5, "times": 5},
        {"results": [5, 6], "times": [{}, {}]},
        {"results": [], "times": []},
        {
            "results": [{"case": 0, "samples": 2**70}, {"case": 1}],
            "times": [{"case": 0}, {"case": 1}],
        },
        {
            "results": [{"case": 0, "torque_max": "x"}, {"case": 1}],
            "times": [{"case": 0}, {"case": 1}],
        },
        {
            "results": [{"case": 0, "samples": [1]}, {"case": 1}],
            "times": [{"case": 0}, {"case": 1}],
        },
    ],
)
def test_a_shard_with_a_right_checksum_and_wrong_content_is_computed_again(
    tmp_path, content
) -> None:
    grid = batch_grid(4)
    out = tmp_path / "out"
    right = sweep(grid, out, workers=0, shard_size=2).results.digest
    file = out / "shards" / "000000.json"
    about = json.loads(file.read_text().partition("\n")[2])
    if isinstance(content, dict):
        content = {k: v for k, v in about.items() if k not in ("results", "times")} | content
    body = json.dumps(content)
    file.write_text(f"{hashlib.sha256(body.encode()).hexdigest()}\n{body}")
    told: list[str] = []
    again = sweep(grid, out, workers=0, resume=True, progress=told.append)
    assert again.results.digest == right and any(
        "damaged; it is computed again" in line for line in told
    )


@pytest.mark.parametrize("size", ["1e999", "0", "-1", '"2"', "1" * 5000, "null"])
def test_a_damaged_description_of_a_sweep_is_an_error_that_names_the_folder(
    tmp_path, size
) -> None:
    grid = batch_grid(4)
    out = tmp_path / "out"
    sweep(grid, out, workers=0, shard_size=2)
    head = out / "sweep.json"
    head.write_text(head.read_text().replace('"shard_size": 2', f'"shard_size": {size}'))
    with pytest.raises(ArgumentError, match=rf"given the folder '{out}' with .* sweep.json"):
        sweep(grid, out, workers=0, resume=True)


def test_workers_with_other_code_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(sweeps, "code_version", lambda native: "0+other")
    with pytest.raises(WrongCode, match=r"expected 0\+other"):
        sweep(batch_grid(1), workers=0)
    assert code_version().partition("+")[2]


def test_the_code_is_sources_packages_and_compiler(tmp_path, monkeypatch) -> None:
    package = tmp_path / "flexgen"
    (package / "codegen").mkdir(parents=True)
    for name in ("__init__.py", "codegen/invert.c", "codegen/lq.h", "notes.txt"):
        (package / name).write_text("1", encoding="utf-8")
    monkeypatch.setattr(versions.flexgen, "__file__", str(package / "__init__.py"))
    found = [code_version.__wrapped__()]
    (package / "notes.txt").write_text("2", encoding="utf-8")
    assert code_version.__wrapped__() == found[0]  # nothing is computed by it
    for name in ("__init__.py", "codegen/invert.c", "codegen/lq.h"):
        (package / name).write_text("2", encoding="utf-8")
        found.append(code_version.__wrapped__())
    with monkeypatch.context() as patch:
        patch.setattr(
            versions,
            "find_version",
            lambda package: "0" if package == "scipy" else find_version(package),
        )
        found.append(code_version.__wrapped__())

    def unusable(**_: object) -> None:
        raise BuildError("C compiler: given 'nothing'")

    same = Compiler(("cc",), "cc 1.0", (), "identity")
    for finder in (lambda **_: None, unusable, lambda **_: same):
        monkeypatch.setattr(versions, "find_compiler", finder)
        found.append(code_version.__wrapped__())
    monkeypatch.setattr(
        versions,
        "find_compiler",
        lambda native=False, **_: replace(same, identity=f"this one, {native}"),
    )
    found += [code_version.__wrapped__(), code_version.__wrapped__(True)]
    assert len(set(found)) == len(found)


def test_a_worker_without_a_compiler_is_refused(monkeypatch) -> None:
    """`auto` would take another method there."""
    shard = next(sweeps.shards_of(batch_grid(1), [0], 1, code_version.__wrapped__()))
    assert run_shard(shard).results[0]["status"] == "solved"
    monkeypatch.setattr(versions, "find_compiler", lambda **_: None)
    code_version.cache_clear()
    try:
        if code_version() == shard.code:
            pytest.skip("no C compiler here either")
        with pytest.raises(WrongCode, match=r"C compiler \(or none\)"):
            run_shard(shard)
    finally:
        code_version.cache_clear()


def test_native_libraries_bind_a_sweep_to_its_processor() -> None:
    assert wants_native({"options": {"native": True}})
    assert not any(
        wants_native(options)
        for options in ({}, {"options": None}, {"options": {"native": False}})
    )


@pytest.mark.slow
def test_one_failing_case_stops_nothing(monkeypatch) -> None:
    unreachable = Move("far", "tool_line", (0.0, 0.5), 1.0, 5, displacement=(9.0, 0.0, 0.0))
    grid = Grid(["elbow", "nowhere"], (None, unreachable, "no such move"), options=QUICK)
    lines: list[str] = []
    table = sweep(grid, workers=0, shard_size=4, progress=lines.append).results
    assert list(table["status"]) == ["solved"] + 5 * ["failed"]
    assert (
        all(table["error"][1:])
        and "no such move" in table["error"][2]
        and "nowhere" in table["error"][4]
    )
    assert "4 of 6 cases, 3 failed" in lines[0] and "6 of 6 cases, 5 failed" in lines[1]

    def broken(*args: object, **named: object) -> None:
        raise ZeroDivisionError("division by zero")

    import flexgen.studies.sweeps.worker as work

    monkeypatch.setattr(work, "solve", broken)
    assert (
        sweep(Grid(["elbow"]), workers=0).results["error"][0]
        == "ZeroDivisionError: division by zero"
    )


def test_parameters_of_a_model_that_was_read_are_refused_in_the_row() -> None:
    table = sweep(Grid([read("elbow")], parameters=[{"motor.m1.inertia": 1.0}]), workers=0).results
    assert "given parameters for the RobotModel" in table["error"][0]
