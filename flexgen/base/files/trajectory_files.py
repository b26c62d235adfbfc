"""Trajectories in files: ``.npz`` with all data, ``.csv`` with one column for each scalar,
``.mat`` for MATLAB.

A csv file has four parts: a comment with the meta data in JSON, the names of the columns
(``name[label] unit``, first ``time s``), a row of numbers for each instant, and a comment with the
number of rows, by which a file that was cut is recognized. ``pandas.read_csv(file, comment="#")``
and ``numpy.genfromtxt(file, delimiter=",", skip_header=2)`` read it. A table that is not from
flexgen has the names and the rows alone.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

from flexgen.base.checks.counts import number_in
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import Port
from flexgen.base.spec.tables import open_file

LARGEST = 2**30  # bytes of a file, and of the numbers in it, at most
LINE = 100_000  # characters of a line, at most
CHANNELS = 1000  # at most
NAME = 200  # characters of the name of a column, at most

_ROWS = re.compile(r"#\s*rows:\s*([0-9]{1,12})\s*\Z")
_COLUMN = re.compile(r"([^\[\]]+)\[([^\[\]]*)\] (.+)\Z", re.DOTALL)
_WRITE = "write one with 'flexgen solve MODEL --out FILE'"


@dataclass(frozen=True)
class Content:
    """Contents of the file of a trajectory; the fields are those of
    `flexgen.base.motion.trajectory.Trajectory`.
    """

    time: np.ndarray
    channels: dict[str, np.ndarray]
    ports: dict[str, Port]
    labels: dict[str, tuple[str, ...]]
    meta: dict[str, Any]
    units: dict[str, tuple[str, ...]]


def common_unit(units: Iterable[str]) -> str:
    """The unit of a channel from those of its columns: ``"rad"``, or ``"rad or m"`` where they
    differ.
    """
    return " or ".join(dict.fromkeys(units)) or "-"


def column_names(
    labels: Mapping[str, tuple[str, ...]], units: Mapping[str, tuple[str, ...]]
) -> list[str]:
    """Names of the columns of a table: ``name[label] unit``."""
    return [
        f"{name}[{label}] {unit}"
        for name, words in labels.items()
        for label, unit in zip(words, units[name], strict=True)
    ]


def write(
    path: Path,
    time: np.ndarray,
    channels: Mapping[str, np.ndarray],
    ports: Mapping[str, Port],
    labels: Mapping[str, tuple[str, ...]],
    meta: Mapping[str, Any],
    units: Mapping[str, tuple[str, ...]],
) -> None:
    """Write a trajectory; the old file stays as it was where the new one cannot be written.

    Raises
    ------
    ArgumentError
        The name has another ending, the path is not a regular file, or it cannot be written.
    """
    from flexgen.base.files.atomic_files import atomic_file

    if path.suffix not in (".npz", ".csv", ".mat"):
        raise ArgumentError(
            f"trajectory file: given {path.name!r}, expected a name that ends in .npz, .csv or "
            ".mat"
        )
    if os.path.exists(path) and not path.is_file():
        raise ArgumentError(
            f"trajectory file: given {str(path)!r}, expected a new name or a regular file"
        )
    with atomic_file(path) as stream:
        if path.suffix == ".mat":
            _write_mat(stream, time, {k: channels[k] for k in ports}, labels, units, meta)
            return
        if path.suffix == ".npz":
            head = {
                "meta": dict(meta),
                "ports": {k: [list(p.shape), p.unit, p.doc] for k, p in ports.items()},
                "labels": {k: list(v) for k, v in labels.items()},
                "units": {k: list(v) for k, v in units.items()},
            }
            arrays: dict[str, Any] = {name: channels[name] for name in ports}
            np.savez_compressed(stream, time=time, head=np.array(json.dumps(head)), **arrays)
            return
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
        text.write("# " + json.dumps(dict(meta)) + "\n")
        writer = csv.writer(text)
        writer.writerow(["time s", *column_names({k: labels[k] for k in ports}, units)])
        table = np.column_stack([time, *(channels[k] for k in ports)])
        writer.writerows([[repr(float(x)) for x in row] for row in table])
        text.write(f"# rows: {len(table)}\n")
        text.detach()


def _write_mat(
    stream: BinaryIO,
    time: np.ndarray,
    channels: Mapping[str, np.ndarray],
    labels: Mapping[str, tuple[str, ...]],
    units: Mapping[str, tuple[str, ...]],
    meta: Mapping[str, Any],
) -> None:
    """Write a MAT file (version 5) for MATLAB and Octave.

    ``time`` (n, 1) [s], each channel (n, width) under its name, ``labels`` and ``units``:
    structures of cell arrays of the columns by channel, ``meta``: the meta data in JSON.
    """
    from scipy.io import savemat

    def cells(words: Mapping[str, tuple[str, ...]]) -> dict[str, np.ndarray]:
        out = {}
        for name in channels:
            out[name] = np.empty((1, len(words[name])), dtype=object)
            out[name][0, :] = words[name]
        return out

    data = {
        "time": np.asarray(time)[:, None],
        **channels,
        "labels": cells(labels),
        "units": cells(units),
    }
    savemat(
        stream,
        {**data, "meta": json.dumps(dict(meta))},
        do_compression=True,
        long_field_names=True,
    )


def read(path: Path) -> Content:
    """Read what `write` wrote.

    Raises
    ------
    ArgumentError
        There is no such file, or it is not a trajectory, damaged, or too large; the text names the
        file.
    """
    from flexgen.base.files.npz_files import NpzError

    if not os.path.exists(path):
        raise ArgumentError(f"trajectory: given {str(path)!r}, which does not exist; {_WRITE}")
    if not path.is_file():
        raise ArgumentError(
            f"trajectory: given {str(path)!r}, expected a regular file that ends in .npz or .csv"
        )
    if path.stat().st_size > LARGEST:
        raise ArgumentError(
            f"trajectory: given {str(path)!r} of {path.stat().st_size} bytes, expected at most "
            f"{LARGEST}"
        )
    try:
        return _read_csv(path) if path.suffix == ".csv" else _read_npz(path)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from None
    except NpzError as error:
        raise ArgumentError(
            f"{path}: given a file that is not a trajectory of flexgen ({error.given}), "
            f"expected {error.expected}"
        ) from None
    except OSError as error:
        raise ArgumentError(
            f"trajectory: given {str(path)!r}, which cannot be read ({error.strerror or error})"
        ) from None
    except (ValueError, TypeError, KeyError, csv.Error, RecursionError) as error:
        raise ArgumentError(
            f"{path}: given a file that is not a trajectory of flexgen ({type(error).__name__}), "
            "expected a file that 'flexgen solve MODEL --out FILE' wrote"
        ) from error


# --- npz -----------------------------------------------------------------------------------------


def _read_npz(path: Path) -> Content:  # noqa: C901
    """The content of an .npz file with a trajectory, each part of its header checked;
    ArgumentError names the part that is wrong.
    """
    from flexgen.base.files.npz_files import read_npz

    def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        """Refuse an array by its header, before it is read: type of numbers, and shape of ``head``
        and ``time``.
        """
        if name == "head":
            if dtype.kind != "U" or shape:
                raise ArgumentError(f"head: given {dtype} of shape {shape}, expected a text")
        elif dtype.kind not in "fiu":
            raise ArgumentError(
                f"channel {name}: given numbers of type {dtype}, expected real numbers"
            )
        elif name == "time" and len(shape) != 1:
            raise ArgumentError(f"time: given shape {shape}, expected one column")

    arrays = read_npz(path, LARGEST, check)
    for name in ("head", "time"):
        if name not in arrays:
            raise ArgumentError(f"given no array {name}, expected a trajectory; {_WRITE}")
    head = _object("head", json.loads(str(arrays.pop("head"))))
    given, labels, meta = (_object(name, head.get(name)) for name in ("ports", "labels", "meta"))
    if len(given) > CHANNELS:
        raise ArgumentError(f"given {len(given)} channels, expected at most {CHANNELS}")
    ports = {}
    for name, (shape, unit, doc) in given.items():
        if name not in arrays:
            raise ArgumentError(f"channel {name}: given no array of this name, expected one")
        if not (
            isinstance(unit, str) and isinstance(doc, str) and all(type(n) is int for n in shape)
        ):
            raise ArgumentError(
                f"channel {name}: invalid port description, expected [shape, unit, meaning]"
            )
        ports[name] = Port(name, tuple(shape), unit, doc)
    units = _object("units", head.get("units", {}))
    for what, lists in (("labels", labels), ("units", units)):
        for name, words in lists.items():
            if not (isinstance(words, list) and all(isinstance(word, str) for word in words)):
                raise ArgumentError(
                    f"channel {name}: given {what} that are not a list of texts, expected one"
                )
    numbers = {name: np.asarray(values, dtype=float) for name, values in arrays.items()}
    channels = {k: numbers[k] for k in ports}
    texts = [{k: tuple(v) for k, v in lists.items()} for lists in (labels, units)]
    return Content(numbers["time"], channels, ports, texts[0], meta, texts[1])


def _object(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ArgumentError(f"{name}: given {type(value).__name__}, expected an object of JSON")
    return value


# --- csv -----------------------------------------------------------------------------------------


def _line(stream: IO[str], number: int) -> str:
    """The next line of a file, of at most `LINE` characters; ``number``: for the error."""
    line = stream.readline(LINE + 1)
    if len(line) > LINE:
        raise ArgumentError(
            f"line {number}: given more than {LINE} characters, expected a row of a trajectory"
        )
    return line


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])


def _read_csv(path: Path) -> Content:
    # a table of a spreadsheet may have the mark
    """The content of a CSV file: meta data, names with units, rows, and the number of rows, by
    which a file that was cut is found. A table of another program may lack the first and the last
    of these.
    """
    with open_file(path, encoding="utf-8-sig", newline="") as stream:
        first = _line(stream, 1)
        plain = not first.startswith("#")
        if plain and not first.startswith("time"):
            raise ArgumentError(
                "line 1: given a file that is not a trajectory of flexgen (no comment), "
                "expected '# {...}' with meta data in JSON, or the names of the columns, the "
                "first of them 'time s'"
            )
        meta = {} if plain else _object("line 1", json.loads(first.removeprefix("#")))
        top = 1 if plain else 2
        header = _cells(first if plain else _line(stream, 2))
        second = _time_factor(header, top)
        numbers = array("d")
        count = 0
        stated = None
        number = top
        while line := _line(stream, number + 1):
            number += 1
            if stated is not None:
                raise ArgumentError(
                    f"line {number}: given a row after the last line, expected the end of the file"
                )
            if line.startswith("#"):
                stated = _parse_row_count(line, number)
                continue
            row = _cells(line)
            if len(row) != len(header):
                raise ArgumentError(
                    f"line {number}: given {len(row)} columns, expected {len(header)}"
                )
            try:
                numbers.extend([number_in(x) for x in row])
            except ValueError:
                raise ArgumentError(f"line {number}: given text, expected numbers") from None
            if 8 * len(numbers) > LARGEST:
                raise ArgumentError(
                    f"line {number}: given more than {LARGEST // 8} numbers, expected fewer"
                )
            count += 1
    if stated != count and not (plain and stated is None):
        last = (
            "no last line '# rows: N'"
            if stated is None
            else f"{count} rows, where the last line states {stated}"
        )
        raise ArgumentError(
            f"given {last}, expected a complete file: it was cut or changed; write or copy it "
            "again"
        )
    table = np.frombuffer(numbers, dtype=float).reshape(count, len(header)).copy()
    if second != 1.0:
        table[:, 0] *= second
    return _content(header, table, meta, top)


def _time_factor(header: list[str], number: int) -> float:
    """Factor to seconds of the first column; ArgumentError where it is not a time with its
    unit.
    """
    from flexgen.base.spec.units import FACTORS, factor_of

    if not header:
        raise ArgumentError(f"line {number}: given nothing, expected the names of the columns")
    name, _, unit = header[0].partition(" ")
    factor = factor_of(unit, "s") if name == "time" and unit else None
    if factor is None:
        raise ArgumentError(
            f"line {number}: given the first column {header[0][:60]!r}, expected 'time s', or "
            f"time in {', '.join(list(FACTORS['s'])[1:])}"
        )
    return factor


def _parse_row_count(line: str, number: int) -> int:
    """The number of a comment ``# rows: N``; ArgumentError with the line's ``number`` for another
    text.
    """
    found = _ROWS.match(line)
    if found is None:
        raise ArgumentError(
            f"line {number}: given the comment {line.strip()[:60]!r}, expected '# rows: N'"
        )
    return int(found[1])


def _content(header: list[str], table: np.ndarray, meta: dict[str, Any], number: int) -> Content:
    """The channels of a table: neighboring columns ``name[label] unit`` of the same name.
    ``header``: of all columns, the time first; ``number``: line of the header, for errors.
    """
    names: dict[str, list[str]] = {}
    units: dict[str, list[str]] = {}
    channels: dict[str, np.ndarray] = {}
    last = ""
    for k, column in enumerate(header[1:], 1):
        found = _COLUMN.match(column) if len(column) <= NAME else None
        if found is None:
            raise ArgumentError(
                f"line {number}: given the column {column[:60]!r}, expected 'name[label] unit'"
            )
        name, label, unit = found.groups()
        if name in names and name != last:
            raise ArgumentError(
                f"channel {name}: given columns that are not adjacent, expected adjacent columns"
            )
        names.setdefault(name, []).append(label)
        units.setdefault(name, []).append(unit)
        channels[name] = table[:, k + 1 - len(names[name]) : k + 1]
        last = name
    ports = {
        k: Port(k, (len(v),), common_unit(units[k]), "read from csv") for k, v in names.items()
    }
    texts = [{k: tuple(v) for k, v in lists.items()} for lists in (names, units)]
    return Content(table[:, 0], channels, ports, texts[0], meta, texts[1])
