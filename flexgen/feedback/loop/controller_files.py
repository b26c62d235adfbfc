"""Controllers from files: tables in TOML, classes in Python, shared libraries; systems of
python-control.

The keys of a table with the parameters of a class, such as that of a law, are the parameters.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import extension, names
from flexgen.base.spec.keys import (
    Context,
    Format,
    Key,
    Kinds,
    Type,
    list_of,
    number,
    of_class,
    read,
    vector,
)
from flexgen.base.spec.tables import Table, file_bytes, file_table
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.loop.interface import PlugIn, PythonController
from flexgen.feedback.loop.model_law import LinearDesign, ModelLaw
from flexgen.feedback.loop.python_files import LIBRARIES, is_python, object_of_file
from flexgen.model.format.format import MODEL
from flexgen.model.position_servo.keys import FILTER_KEYS, gain_keys

MOTORS = range(1, 65)  # how many there can be


def _read_gain(table: Table, key: Key, here: Context) -> np.ndarray:
    """A number for each motor, as many as of the gain that is read first."""
    first = here.values.get("position_gain")
    return np.array(
        table.vector(key.name, MOTORS if first is None else len(first), what="one for each motor")
    )


_GAIN = Type(_read_gain, vector(MOTORS).schema)


def _read_matrix(table: Table, key: Key, here: Context) -> np.ndarray:
    """A matrix; its shape follows from D, which is read first, and the rows of A."""
    expected = "a matrix of numbers, rows in brackets"
    try:
        found = np.array(table.plain(key.name, expected), dtype=float)
        n_m, n_y = np.atleast_2d(here.values.get("D", found)).shape
    except (ValueError, TypeError):
        raise table.fail(key.name, expected) from None
    n_z = len(np.atleast_1d(here.values.get("A", found)))
    shape = {"A": (n_z, n_z), "B": (n_z, n_y), "C": (n_m, n_z), "D": (n_m, n_y)}[key.name]
    if found.size != shape[0] * shape[1] or not np.isfinite(found).all():
        raise table.fail(key.name, f"{shape}, finite", f"shape {found.shape}")
    return found.reshape(shape)


def _maker(made: Any) -> Any:
    """Makes a controller of the values of its table."""

    def make(description: str, low_pass: Any = (), notch: Any = (), **own: Any) -> Any:
        return made(**own, filters=(*low_pass, *notch)) if low_pass or notch else made(**own)

    return make


_MATRIX = Type(_read_matrix, list_of(list_of(number().schema)))
_MATRICES = tuple(Key(name, _MATRIX, "matrix, rows in brackets") for name in "DABC")
_PPI = (*of_class(PPI).without("filters").keys, *FILTER_KEYS)
CONTROLLER = Kinds(
    "feedback of a closed loop",
    {
        "ppi": Format("P-PI cascade, by frequencies", _PPI, _maker(PPI)),
        "cascade": Format(
            "P-PI cascade, by gains of each motor",
            (*gain_keys(_GAIN), *FILTER_KEYS),
            _maker(Cascade),
        ),
        "linear": Format(
            "matrices from `y_ref - y` to torques, sampled", _MATRICES, _maker(Linear)
        ),
    },
    shared=(MODEL["description"],),
    strict=False,
)


def file_controller(text: str) -> Any:
    """The content of a file: a `PPI`, `Cascade`, `Linear` or law, an object of Python, a plug-in;
    None for other names.

    Raises
    ------
    ArgumentError
        The file cannot be read or holds something else.
    BuildError
        A shared library cannot be loaded.
    """
    if text.endswith(".toml"):
        path = Path(text)
        return table_controller(file_table(file_bytes(path, "controller"), path))
    if text.endswith(LIBRARIES):
        return PlugIn(text)
    if is_python(text):
        return PythonController(object_of_file(text))
    return None


def table_controller(table: Table) -> PPI | Cascade | Linear | LinearDesign | ModelLaw:
    """The controller or law of a table."""
    laws = names("laws")
    kind = table.choice("type", (*CONTROLLER.kinds, *laws))
    form = CONTROLLER
    if kind in laws:
        law = extension("laws", kind)
        own = replace(of_class(law, law.__name__), make=_maker(law)).without("model")
        form = replace(CONTROLLER, kinds={kind: own})
    made: PPI | Cascade | Linear | LinearDesign | ModelLaw = read(table, form, Context())
    return made


def system_controller(system: Any, sample_time: float) -> Linear:
    """A state-space system of python-control from ``y_ref - y`` to torques, sampled by Tustin's
    rule if continuous.
    """
    D = np.atleast_2d(np.asarray(system.D, dtype=float))
    n_z = len(np.atleast_2d(system.A)) if np.size(system.A) else 0
    A, B, C = (
        np.asarray(x, dtype=float).reshape(shape)
        for x, shape in (
            (system.A, (n_z, n_z)),
            (system.B, (n_z, D.shape[1])),
            (system.C, (D.shape[0], n_z)),
        )
    )
    if system.dt in (0, None):
        from scipy.signal import cont2discrete

        A, B, C, D, _ = (
            cont2discrete((A, B, C, D), sample_time, method="bilinear") if n_z else (A, B, C, D, 0)
        )
    elif system.dt is not True and abs(float(system.dt) - sample_time) > 1e-9 * sample_time:
        raise ArgumentError(
            f"controller: given a system with dt = {system.dt} s, expected {sample_time} s or 0"
        )
    return Linear(A, B, C, D)


def is_system(given: Any) -> bool:
    """Whether it is a state-space system of python-control."""
    return all(hasattr(given, name) for name in ("A", "B", "C", "D", "dt"))
