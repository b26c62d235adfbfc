"""Results of a sweep: tables that keep every bit, as files, and texts of the command line."""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import io
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.cli.argument_parser import UsageError
from flexgen.cli.parser import parse
from flexgen.cli.verbs.sweep import sweep as run
from flexgen.studies.sweeps.summary import group_reasons, summarize
from flexgen.studies.sweeps.sweep import span_text
from flexgen.studies.sweeps.table import RESULTS, TIMES, Column, Table, are_rows, table_of

ROWS = [
    {"case": 0, "status": "solved", "torque_max": 0.1, "iterations": 3},
    {
        "case": 1,
        "status": "failed",
        "error": "ä" * 1000,
        "torque_max": None,
        "energy": -np.float64(np.nan),
    },
]


def test_tables_keep_every_bit(tmp_path) -> None:
    table = table_of(RESULTS, ROWS)
    assert (
        len(table) == 2
        and table["iterations"].tolist() == [3, -1]
        and np.isnan(table["torque_max"][1])
    )
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
    assert (
        table_of([Column("case", "int", "s", "")], ROWS).digest
        != table_of(RESULTS[:1], ROWS).digest
    )
    with pytest.raises(ArgumentError, match=r"ends in \.npz"):
        table.save(tmp_path / "a.csv")
    with pytest.raises(ArgumentError, match="does not exist"):
        Table.load(tmp_path / "c.npz")
    (tmp_path / "c.npz").write_text("no table")
    with pytest.raises(ArgumentError, match=r"no \.npz file"):
        Table.load(tmp_path / "c.npz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz", "c.npz"]


def test_the_digest_is_of_texts_as_json_and_of_the_bits_of_numbers() -> None:
    """SHA-256 of the lines that `Table.digest` states, computed here."""
    columns = Column("model", "text", "", ""), Column("tool_error_max", "float", "m", "")
    values = {"model": np.array(["elbow", "ä"]), "tool_error_max": np.array([1e-9, -0.0])}
    content = b"model text  2\n" + json.dumps(["elbow", "ä"]).encode()
    content += b"tool_error_max float m 2\n" + struct.pack("=2d", 1e-9, -0.0)
    assert Table(columns, values).digest == hashlib.sha256(content).hexdigest()


KINDS = (
    Column("case", "int", "1", ""),
    Column("x", "float", "1", ""),
    Column("t", "text", "", ""),
)
ROW_LISTS = {
    "rows": ([{"case": 0, "x": 1.5, "t": "a"}, {"case": 1, "x": None, "more": []}], True),
    "whole numbers": ([{"case": 0, "x": -(2**63)}, {"case": 1, "x": 2**63 - 1}], True),
    "a text for a number": ([{"case": 0}, {"case": 1, "x": "a"}], False),
    "a large number": ([{"case": 0, "x": 2**63}, {"case": 1}], False),
    "a small number": ([{"case": 0, "x": -(2**63) - 1}, {"case": 1}], False),
    "half a case": ([{"case": 0}, {"case": 1.0, "x": 0.0}], False),
    "another case": ([{"case": 0}, {"case": 2}], False),
    "a row too few": ([{"case": 0}], False),
    "no row": ([{"case": 0}, 7], False),
    "no list": ("x", False),
}


@pytest.mark.parametrize("name", ROW_LISTS)
def test_rows_of_a_file_are_checked(name: str) -> None:
    rows, good = ROW_LISTS[name]
    assert are_rows(rows, KINDS, range(2)) == good


def test_a_summary_has_the_largest_figures_of_each_group() -> None:
    """By loops over random rows of two models, methods and statuses."""
    rng = np.random.default_rng(1)
    rows = [
        {
            "case": k,
            "model": "ab"[rng.integers(2)],
            "method": "lq",
            "status": ("solved", "failed")[rng.integers(2)],
            "torque_max": rng.choice([rng.random(), None]),
            "tool_error_max": rng.random(),
        }
        for k in range(20)
    ]
    times = [{"case": k, "cpu": rng.choice([1.0 + k, None])} for k in range(20)]
    found = summarize(table_of(RESULTS, rows), table_of(TIMES, times))
    groups = {(r["model"], r["method"], r["status"]) for r in rows}
    assert [(r["model"], r["method"], r["status"]) for r in found] == sorted(groups)
    for group in found:
        own = [r for r in rows if all(r[k] == group[k] for k in ("model", "method", "status"))]
        assert group["cases"] == len(own)
        for name in ("torque_max", "tool_error_max", "turn_error_max"):
            values = [r[name] for r in own if r.get(name) is not None]
            assert group[name] == (max(values) if values else None)
        assert group["cpu"] == sum(times[r["case"]]["cpu"] or 0.0 for r in own)


def test_reasons_that_differ_in_numbers_only_are_one() -> None:
    groups = group_reasons([4, 5, 6, 7], ["x 1", "at 3.1 s", "at 1e-5 s", "at 2 s"])
    assert groups == [{"reason": "at 3.1 s", "cases": [5, 6, 7]}, {"reason": "x 1", "cases": [4]}]


SPANS = {99.4: "99 s", 100.0: "2 min", 5999.0: "100 min", 6000.0: "1.7 h"}


@pytest.mark.parametrize("seconds", SPANS)
def test_the_time_that_remains_has_a_readable_unit(seconds: float) -> None:
    assert span_text(seconds) == SPANS[seconds]


HEAD = [["case", "int", "1", ""], ["x", "float", "m", ""]]
DAMAGED = {
    "a column without array": (HEAD, {"case": np.arange(2)}),
    "columns of different length": (HEAD, {"case": np.arange(2), "x": np.zeros(3)}),
    "an array without dimension": (HEAD, {"case": np.array(1), "x": np.array(1.0)}),
    "numbers for texts": ([["x", "text", "", ""]], {"x": np.zeros(2)}),
    "an unknown kind": ([["x", "real", "", ""]], {"x": np.zeros(2)}),
    "a column of five": ([["x", "float", "", "", ""]], {"x": np.zeros(2)}),
    "columns that are not a list": (5, {"x": np.zeros(2)}),
    "no column": ([], {}),
    "a name that is not text": ([[5, "float", "", ""]], {"x": np.zeros(2)}),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_table_is_an_error_that_names_the_file(tmp_path, damage) -> None:
    head, arrays = DAMAGED[damage]
    path = tmp_path / "a.npz"
    np.savez(path, columns=np.array(json.dumps(head)), **arrays)
    with pytest.raises(
        ArgumentError,
        match=rf"{path}: given a file that is not a table of flexgen \(.*\), expected a table",
    ):
        Table.load(path)


def test_each_changed_byte_of_a_table_is_read_or_refused(tmp_path) -> None:
    path = table_of(RESULTS, ROWS).save(tmp_path / "a.npz")
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    for at in rng.integers(len(whole), size=150):
        path.write_bytes(
            whole[:at] + bytes([whole[at] ^ (1 << rng.integers(8))]) + whole[at + 1 :]
        )
        try:
            assert len(Table.load(path)) == 2
        except ArgumentError as error:
            assert str(path) in str(error)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("pyarrow") is None, reason="no pyarrow; run: make setup-test"
)
def test_parquet_has_types_and_units(tmp_path) -> None:
    from pyarrow import parquet

    table = table_of(RESULTS, ROWS)
    found = parquet.read_table(table.save(tmp_path / "a.parquet"))
    assert found.column_names == [column.name for column in RESULTS]
    assert found.schema.field("torque_max").metadata[b"unit"] == b"N m"
    assert str(found.schema.field("case").type) == "int64" and found["status"].to_pylist() == [
        "solved",
        "failed",
    ]


def test_parquet_without_pyarrow_is_an_error_that_names_it(tmp_path, monkeypatch) -> None:
    import flexgen.studies.sweeps.table as tables

    def missing(name: str) -> None:
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(tables, "import_module", missing)
    with pytest.raises(ArgumentError, match="pip install pyarrow"):
        table_of(RESULTS, ROWS).save(tmp_path / "a.parquet")


def arguments(*words: str) -> argparse.Namespace:
    return parse(["sweep", *words])


def test_the_command_line(tmp_path) -> None:
    file = tmp_path / "grid.toml"
    out = tmp_path / "out"
    file.write_text(
        'models = ["elbow", "nowhere"]\nmethods = ["closed-form"]\n[random]\ncount = 3\n'
        "[options]\nverify = false\nbatch = true\n",
        encoding="utf-8",
    )
    found = run(
        arguments(str(file), "--out", str(out), "--workers", "0", "--shard-size", "2"),
        lambda line: None,
    )
    data = found.data
    text = found.text
    warnings = found.warnings
    details = found.details
    assert (data["cases"], data["failed"], found.problem) == (6, 3, "") and len(
        details.splitlines()
    ) == 3
    (failure,) = data["failures"]
    assert (
        len(failure["cases"]) == 3
        and len(warnings) == 1
        and warnings[0].startswith("3 cases failed (3, 4, 5)")
    )
    assert json.dumps(data) and [group["cases"] for group in data["groups"]] == [3, 3]
    assert (
        "6 cases, 3 failed" in text
        and "closed-form" in text
        and f"wrote {out / 'results.npz'}" in text
    )
    assert data["digest"] == Table.load(out / "results.npz").digest
    again = run(
        arguments(str(file), "--out", str(out), "--workers", "0", "--resume"), lambda line: None
    )
    assert again.data["digest"] == data["digest"]
    file.write_text('models = ["nowhere"]\n', encoding="utf-8")
    assert (
        run(arguments(str(file), "--out", str(tmp_path / "bad"), "--workers", "0"), print).problem
        == "all cases failed"
    )
    for wrong in (("--workers", "-1"), ("--workers", "two"), ("--shard-size", "0")):
        with pytest.raises(UsageError):
            arguments("grid.toml", "--out", "x", *wrong)


def bomb(path: Path, rows: int, characters: int) -> Path:
    """A table of one column of texts that are empty: a thousandth of their size on the disk."""
    head = json.dumps([["a", "text", "", "of nothing"]])
    dtype = np.dtype(f"<U{characters}")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, shape, content in (
            ("columns", (), np.array(head)),
            ("a", (rows,), np.zeros(1, dtype)),
        ):
            header = io.BytesIO()
            facts = {"descr": content.dtype.str, "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(header, facts)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                member.write(header.getvalue())
                for _ in range(rows if name == "a" else 1):
                    member.write(content.tobytes())
    return path


@pytest.mark.parametrize(
    ("rows", "characters", "told"),
    [(300, 300_000, "bytes, expected at most"), (20, 1_000_000, "texts of 1000000 characters")],
)
def test_a_small_file_does_not_take_large_memory(
    tmp_path: Path, rows: int, characters: int, told: str
) -> None:
    path = bomb(tmp_path / "table.npz", rows, characters)
    tracemalloc.start()
    try:
        with pytest.raises(ArgumentError, match=told):
            Table.load(path)
        assert tracemalloc.get_traced_memory()[1] < 1e7  # bytes
    finally:
        tracemalloc.stop()


def test_a_table_is_read_in_its_own_size(tmp_path: Path) -> None:
    path = bomb(tmp_path / "table.npz", 20_000, 400)
    size = 20_000 * 400 * 4  # bytes
    tracemalloc.start()
    try:
        assert len(Table.load(path)) == 20_000
        assert tracemalloc.get_traced_memory()[1] < 1.2 * size
    finally:
        tracemalloc.stop()
