"""Npz files of arrays with a JSON text ``meta`` that says what they are.

Complex arrays are stored as pairs of real and imaginary part, along a last axis of length two.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import atomic_file
from flexgen.base.files.npz_files import NpzError, read_npz

T = TypeVar("T")

FORMAT = 1
SIZE_MAX = 500_000_000  # bytes


def save(path: str | Path, kind: str, arrays: dict[str, np.ndarray], meta: dict[str, Any]) -> Path:
    """Write arrays, and ``meta`` as JSON, to an .npz file of this ``kind``, completely or not at
    all; complex arrays as pairs of real and imaginary parts.
    """
    pairs = [name for name, array in arrays.items() if np.iscomplexobj(array)]
    arrays = {
        name: _split_complex(array) if name in pairs else array for name, array in arrays.items()
    }
    text = json.dumps(
        {"kind": kind, "format": FORMAT, "complex": pairs, **meta},
        ensure_ascii=True,
        allow_nan=False,
    )
    with atomic_file(path) as stream:
        np.savez_compressed(stream, meta=np.array(text), **arrays)  # type: ignore[arg-type]
    return Path(path)


def load_instance(kind_of: type[T], path: str | Path, kind: str, names: str) -> T:
    """The instance in a file; ``names``: the arrays that it must have.

    Raises
    ------
    ArgumentError
        See `load`; or the arrays do not fit together.
    """
    arrays, meta = load(path, kind, names.split())
    try:
        return kind_of.from_data(arrays, meta)  # type: ignore[attr-defined]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ArgumentError(
            f"{kind} {path}: damaged or incomplete ({error}), expected a file of flexgen"
        ) from None


def load(
    path: str | Path, kind: str, names: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays and the other data of a file.

    Raises
    ------
    ArgumentError
        The file cannot be read, is of another kind, or lacks one of the arrays ``names``.
    """
    shown = f"{kind} {path}"
    try:
        arrays = read_npz(Path(path), SIZE_MAX)
    except OSError as error:
        raise ArgumentError(
            f"{shown}: cannot be read ({error.strerror}), expected a file of flexgen"
        ) from None
    except NpzError as error:
        raise ArgumentError(f"{shown}: {error}") from None
    text = arrays.pop("meta", None)
    try:
        meta = json.loads(str(text)) if text is not None and text.ndim == 0 else {}
    except ValueError:
        meta = {}
    if not isinstance(meta, dict) or meta.get("kind") != kind:
        found = (
            repr(meta.get("kind"))
            if isinstance(meta, dict) and "kind" in meta
            else "no text 'meta'"
        )
        raise ArgumentError(f"{shown}: given a file with {found}, expected the kind {kind!r}")
    if meta.get("format") != FORMAT:
        raise ArgumentError(f"{shown}: given the format {meta.get('format')!r}, expected {FORMAT}")
    for name in names:
        if name not in arrays:
            raise ArgumentError(f"{shown}: given no array {name!r}, expected {', '.join(names)}")
        numeric = np.issubdtype(arrays[name].dtype, np.number)
        if not numeric or not np.isfinite(arrays[name]).all():
            raise ArgumentError(f"{shown}: array {name!r} has a value that is not a finite number")
    for name in meta.get("complex", ()):
        array = arrays.get(name)
        if array is None or array.dtype != np.float64 or array.ndim == 0 or array.shape[-1] != 2:
            raise ArgumentError(
                f"{shown}: array {name!r}: expected pairs of real and imaginary part"
            )
        arrays[name] = array[..., 0] + 1j * array[..., 1]
    return arrays, meta


def _split_complex(array: np.ndarray) -> np.ndarray:
    """A complex array as pairs of real and imaginary part, (..., 2)."""
    return np.stack([array.real, array.imag], axis=-1)
