"""Trajectories: named channels over one time grid, saved as npz or csv without loss."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.ports import Port

LARGEST = 2**30  # bytes of a file, at most


@dataclass(frozen=True)
class Trajectory:
    """Channels sampled on one time grid.

    Parameters
    ----------
    time : array, shape (n,) [s]
        Strictly increasing.
    channels : mapping from name to array, shape (n, width)
    ports : mapping from name to Port
        Shape ``(width,)``, unit and meaning of each channel.
    labels : mapping from name to tuple of str
        One label for each column (the name of the coordinate or motor).
    meta : dict
        JSON types only: ``model``, ``variant``, ``move``, ``kind``; ``torque`` is ``"limited"`` where limits may be
        active and an interpolation must not exceed them.
    """

    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    ports: Mapping[str, Port]
    labels: Mapping[str, tuple[str, ...]]
    meta: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.time)
        if np.ndim(self.time) != 1 or n < 2 or not np.isfinite(self.time).all() or not np.all(np.diff(self.time) > 0):
            raise ArgumentError(
                "trajectory: given a time grid that does not increase, expected at least 2 increasing instants"
            )
        if not self.ports.keys() == self.channels.keys() == self.labels.keys():
            raise ArgumentError(
                "trajectory: given channels, ports and labels with different names, expected the same names"
            )
        for name, port in self.ports.items():
            if len(self.labels[name]) != port.size:
                raise ArgumentError(
                    f"trajectory channel {name}: given {len(self.labels[name])} labels, expected {port.size}"
                )
            shape = np.shape(self.channels[name])
            if shape != (n, *port.shape):
                raise ArgumentError(f"trajectory channel {name}: given shape {shape}, expected {(n, *port.shape)}")

    def __getitem__(self, name: str) -> np.ndarray:
        return self.channels[name]

    def save(self, path: str | Path) -> Path:
        """Write to ``path``: ``.npz`` with all data, ``.csv`` with a column for each scalar, ``name[label] unit``."""
        path = Path(path)
        if path.suffix not in (".npz", ".csv"):
            raise ArgumentError(f"trajectory file: given {path.name!r}, expected a name that ends in .npz or .csv")
        if path.exists() and not path.is_file():
            raise ArgumentError(f"trajectory file: given {str(path)!r}, expected a new name or a regular file")
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".npz":
            head = {
                "meta": self.meta,
                "ports": {k: [list(p.shape), p.unit, p.doc] for k, p in self.ports.items()},
                "labels": {k: list(v) for k, v in self.labels.items()},
            }
            arrays: dict[str, Any] = {name: self.channels[name] for name in self.ports}
            np.savez_compressed(path, time=self.time, head=np.array(json.dumps(head)), **arrays)
            return path
        with path.open("w", newline="") as stream:
            stream.write("# " + json.dumps(self.meta) + "\n")
            writer = csv.writer(stream)
            columns = [f"{k}[{label}] {p.unit}" for k, p in self.ports.items() for label in self.labels[k]]
            writer.writerow(["time s", *columns])
            table = np.column_stack([self.time, *(self.channels[k] for k in self.ports)])
            writer.writerows([[repr(float(x)) for x in row] for row in table])
        return path

    @staticmethod
    def load(path: str | Path) -> Trajectory:
        """Read a file that `save` wrote; ArgumentError where the file is no trajectory."""
        path = Path(path)
        if not path.exists():
            raise ArgumentError(
                f"trajectory: given {str(path)!r}, which does not exist; "
                "write one with 'flexgen solve MODEL --out FILE'"
            )
        if not path.is_file():
            raise ArgumentError(f"trajectory: given {str(path)!r}, expected a regular file that ends in .npz or .csv")
        if path.stat().st_size > LARGEST:
            raise ArgumentError(
                f"trajectory: given {str(path)!r} of {path.stat().st_size} bytes, expected at most {LARGEST}"
            )
        try:
            return _load_csv(path) if path.suffix == ".csv" else _load_npz(path)
        except ArgumentError as error:
            raise ArgumentError(f"{path}: {error}") from None
        except Exception as error:  # numpy, zipfile and json raise different errors
            raise ArgumentError(
                f"{path}: given a file that is no trajectory of flexgen ({type(error).__name__}), "
                "expected a file that 'flexgen solve MODEL --out FILE' wrote"
            ) from error


def _load_npz(path: Path) -> Trajectory:
    with np.load(path, allow_pickle=False) as data:
        head = json.loads(str(data["head"]))
        ports = {k: Port(k, tuple(s), unit, doc) for k, (s, unit, doc) in head["ports"].items()}
        labels = {k: tuple(v) for k, v in head["labels"].items()}
        return Trajectory(
            _real("time", data["time"]), {k: _real(k, data[k]) for k in ports}, ports, labels, head["meta"]
        )


def _real(name: str, values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "fiu":
        raise ArgumentError(f"channel {name}: given numbers of type {values.dtype}, expected real numbers")
    return np.asarray(values, dtype=float)


def _load_csv(path: Path) -> Trajectory:
    with path.open(newline="") as stream:
        meta = json.loads(stream.readline().removeprefix("#"))
        rows = csv.reader(stream)
        header = next(rows)
        numbers = []
        for row in rows:
            if len(row) != len(header):
                raise ArgumentError(f"line {rows.line_num + 1}: given {len(row)} columns, expected {len(header)}")
            try:
                numbers.append([float(x) for x in row])
            except ValueError:
                raise ArgumentError(f"line {rows.line_num + 1}: given text, expected numbers") from None
    if len(numbers) < 2:
        raise ArgumentError(f"given {len(numbers)} samples, expected at least 2")
    table = np.array(numbers)
    names: dict[str, list[str]] = {}
    units: dict[str, str] = {}
    for column in header[1:]:
        name, label_and_unit = column.split("[", 1)
        label, unit = label_and_unit.rsplit("] ", 1)
        names.setdefault(name, []).append(label)
        if units.setdefault(name, unit) != unit:
            raise ArgumentError(f"channel {name}: given columns in {units[name]} and in {unit}, expected one unit")
    channels, at = {}, 1
    for name, columns in names.items():
        if [c.split("[", 1)[0] for c in header[at : at + len(columns)]] != [name] * len(columns):
            raise ArgumentError(f"channel {name}: given columns that are not adjacent, expected adjacent columns")
        channels[name] = table[:, at : at + len(columns)]
        at += len(columns)
    ports = {k: Port(k, (len(v),), units[k], "read from csv") for k, v in names.items()}
    return Trajectory(table[:, 0], channels, ports, {k: tuple(v) for k, v in names.items()}, meta)
