"""Controllers from files: tables in TOML, classes in Python, shared libraries; systems of python-control.

A table has a ``type``:

ppi           ``position_hz``, ``speed_hz``, ``integral_hz``, and filters ``[[low_pass]]``, ``[[notch]]``
cascade       the same with ``position_gain`` [1/s], ``speed_gain`` [N m s/rad], ``integral_gain`` [1/s] of each motor
loop_shaping  ``crossover_hz``, ``integral_hz``, ``low_pass_hz``, ``factor``: H-infinity loop shaping
linear        matrices ``A``, ``B``, ``C``, ``D`` from ``y_ref - y`` to torques, sampled; rows in brackets

and the laws of `flexgen.laws.catalogue`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.loop.controllers import Cascade, Filter, Linear, LowPass, Notch
from flexgen.loop.gains import PPI
from flexgen.loop.interface import PlugIn, PythonController
from flexgen.loop.model_law import FLAG, GAINS, NUMBER, TEXT, LinearDesign, ModelLaw
from flexgen.loop.python_files import LIBRARIES, is_python, object_of_file
from flexgen.registry import extension, names
from flexgen.spec.arguments import is_number
from flexgen.spec.toml_lines import TextError, plain_table

TABLES = ("ppi", "cascade", "linear")
LARGEST_FILE = 2**24  # bytes
_FREQUENCIES = ("position_hz", "speed_hz", "integral_hz")
_GAINS = ("position_gain", "speed_gain", "integral_gain")


def file_controller(text: str) -> Any:
    """The content of a file: a `PPI`, `Cascade`, `Linear` or law, an object of Python, a plug-in; None for other names.

    Raises
    ------
    ArgumentError
        The file cannot be read or holds something else.
    BuildError
        A shared library cannot be loaded.
    """
    if text.endswith(".toml"):
        path = Path(text)
        table = read_table(path)
        return table_controller(table, path)
    if text.endswith(LIBRARIES):
        return PlugIn(text)
    if is_python(text):
        return PythonController(object_of_file(text))
    return None


def read_table(path: Path) -> dict[str, Any]:
    """A TOML file as a table; ArgumentError where it cannot be read."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ArgumentError(f"{path}: given {path.stat().st_size} bytes, expected at most {LARGEST_FILE}")
        return plain_table(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, TextError) as error:
        raise ArgumentError(f"{path}: cannot be read as TOML: {error}") from error


def table_controller(table: Mapping[str, Any], path: Path) -> PPI | Cascade | Linear | LinearDesign | ModelLaw:
    """The controller or law of a table; see the text of this module."""
    kind = table.get("type")
    if isinstance(kind, str) and kind in names("laws"):
        return law_of_table(table, path)
    if kind == "ppi":
        _only(table, {"type", *_FREQUENCIES, "low_pass", "notch", "description"}, path)
        numbers = {key: _number(table[key], path, key) for key in _FREQUENCIES if key in table}
        return PPI(**numbers, filters=_filters(table, path))
    if kind == "cascade":
        _only(table, {"type", *_GAINS, "low_pass", "notch", "description"}, path)
        gains = [_numbers(table, key, path) for key in _GAINS]
        if len({len(x) for x in gains}) != 1:
            raise ArgumentError(f"{path}: given gains of different lengths, expected one for each motor")
        return Cascade(gains[0], gains[1], gains[2], _filters(table, path))
    if kind == "linear":
        return _linear(table, path)
    raise ArgumentError(f"{path}, type: given {kind!r}, expected one of {', '.join((*TABLES, *names('laws')))}")


def _filters(table: Mapping[str, Any], path: Path) -> tuple[Filter, ...]:
    filters: list[Filter] = []
    for key, made in (("low_pass", LowPass), ("notch", Notch)):
        rows = table.get(key, [])
        if not isinstance(rows, list):
            raise ArgumentError(f"{path}, {key}: given {rows!r}, expected tables [[{key}]]")
        for row in rows:
            if not isinstance(row, Mapping):
                raise ArgumentError(f"{path}, {key}: given {row!r}, expected a table")
            _only(row, set(made.__dataclass_fields__), path)
            if "frequency_hz" not in row:
                raise ArgumentError(f"{path}, {key}: expected the key frequency_hz")
            filters.append(made(**{k: _number(v, path, f"{key}.{k}") for k, v in row.items()}))
    return tuple(filters)


def _linear(table: Mapping[str, Any], path: Path) -> Linear:
    _only(table, {"type", "A", "B", "C", "D", "description"}, path)
    found = {}
    for name in "ABCD":
        try:
            found[name] = np.array(table[name], dtype=float)
        except (KeyError, ValueError, TypeError) as error:
            raise ArgumentError(f"{path}, {name}: expected a matrix of numbers, rows in brackets ({error})") from error
    D = np.atleast_2d(found["D"])
    n_m, n_y = D.shape
    n_z = len(found["A"])
    shapes = {"A": (n_z, n_z), "B": (n_z, n_y), "C": (n_m, n_z)}
    for name, shape in shapes.items():
        if found[name].size != shape[0] * shape[1] or not np.isfinite(found[name]).all():
            raise ArgumentError(f"{path}, {name}: given shape {found[name].shape}, expected {shape}, finite")
    A, B, C = (found[name].reshape(shapes[name]) for name in "ABC")
    return Linear(A, B, C, D)


def _only(table: Mapping[str, Any], known: set[str], path: Path) -> None:
    for key in table:
        if key not in known:
            raise ArgumentError(f"{path}: given the key {key!r}, expected some of {', '.join(sorted(known))}")


def _number(value: Any, path: Path, key: str) -> float:
    if not is_number(value):
        raise ArgumentError(f"{path}, {key}: given {value!r}, expected a finite number")
    return float(value)


def _numbers(table: Mapping[str, Any], key: str, path: Path) -> np.ndarray:
    values = table.get(key)
    if not isinstance(values, list):
        raise ArgumentError(f"{path}, {key}: given {values!r}, expected numbers in brackets, one for each motor")
    return np.array([_number(x, path, key) for x in values])


def system_controller(system: Any, sample_time: float) -> Linear:
    """A state-space system of python-control from ``y_ref - y`` to torques, sampled by Tustin's rule if continuous."""
    D = np.atleast_2d(np.asarray(system.D, dtype=float))
    n_z = len(np.atleast_2d(system.A)) if np.size(system.A) else 0
    A, B, C = (
        np.asarray(x, dtype=float).reshape(shape)
        for x, shape in ((system.A, (n_z, n_z)), (system.B, (n_z, D.shape[1])), (system.C, (D.shape[0], n_z)))
    )
    if system.dt in (0, None):
        from scipy.signal import cont2discrete

        A, B, C, D, _ = cont2discrete((A, B, C, D), sample_time, method="bilinear") if n_z else (A, B, C, D, 0)
    elif system.dt is not True and abs(float(system.dt) - sample_time) > 1e-9 * sample_time:
        raise ArgumentError(f"controller: given a system with dt = {system.dt} s, expected {sample_time} s or 0")
    return Linear(A, B, C, D)


def is_system(given: Any) -> bool:
    """Whether it is a state-space system of python-control."""
    return all(hasattr(given, name) for name in ("A", "B", "C", "D", "dt"))


def law_of_table(table: Mapping[str, Any], path: Path) -> LinearDesign | ModelLaw:
    """The law of a table; ArgumentError where a key is unknown or a value is of another kind."""
    made: type[LinearDesign | ModelLaw] = extension("laws", table["type"])
    kinds = made.KEYS
    arguments = {}
    for key, value in table.items():
        if key in ("type", "description"):
            continue
        if key not in kinds:
            raise ArgumentError(f"{path}: given the key {key!r}, expected some of {', '.join(kinds)}")
        if not _fits(value, kinds[key]):
            raise ArgumentError(f"{path}, {key}: given {value!r}, expected {kinds[key]}")
        arguments[key] = value
    return made(**arguments)


def _fits(value: Any, kind: str) -> bool:
    if kind == FLAG:
        return isinstance(value, bool)
    if kind == TEXT:
        return isinstance(value, str)
    if kind == GAINS:
        return isinstance(value, list) and all(_fits(x, NUMBER) for x in value)
    return isinstance(value, int | float) and not isinstance(value, bool)
