"""The structs of a loaded library as ctypes structures, made from its manifest: one statement of their layout."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from flexgen.runtime.arguments import address

_KINDS: dict[str, Any] = {"int": ctypes.c_int, "int64_t": ctypes.c_int64}
REAL: dict[str, Any] = {"double": ctypes.c_double, "single": ctypes.c_float}  # the type of a number in C
_POINTERS = ("const real *", "real *")


def structs_of(manifest: Mapping[str, Any]) -> dict[str, type[ctypes.Structure]]:
    """Structures by name; ValueError for a member of an unknown type."""
    real = manifest.get("precision", "double")
    return {
        struct["name"]: _structure(real, struct["name"], tuple((f["name"], f["kind"]) for f in struct["fields"]))
        for struct in manifest.get("structs", ())
    }


@cache
def _structure(precision: str, name: str, fields: tuple[tuple[str, str], ...]) -> type[ctypes.Structure]:
    kinds = {**_KINDS, "real": REAL[precision]}
    for _, kind in fields:
        if kind not in kinds and kind not in _POINTERS:
            raise ValueError(f"given a member of type {kind!r} in struct {name}, expected a number or an array")
    members = [(field, kinds.get(kind, ctypes.c_void_p)) for field, kind in fields]
    return type(name, (ctypes.Structure,), {"_fields_": members})


def filled(structure: type[ctypes.Structure], **members: Any) -> ctypes.Structure:
    """A structure with these members; arrays become pointers, so the caller must keep them."""
    return structure(**{key: address(x) if isinstance(x, np.ndarray) else x for key, x in members.items()})
