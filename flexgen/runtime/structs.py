"""The C interface of a loaded library, as its manifest states it: structs, enums, limits and
statuses.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, BuildError, FlexgenError
from flexgen.runtime.arguments import address
from flexgen.runtime.files import AGAIN

_KINDS: dict[str, Any] = {"int": ctypes.c_int, "int64_t": ctypes.c_int64}
# the type of a number in C
REAL: dict[str, Any] = {"double": ctypes.c_double, "single": ctypes.c_float}
_POINTERS = ("const real *", "real *", "const servo *")

# exception and text of each negative status
Failures = Mapping[int, tuple[type[FlexgenError], str]]


def closed_error(library: str) -> ArgumentError:
    """The error of a call of a library that was closed."""
    return ArgumentError(
        f"{library}: given a library that was closed, expected an open one; load it again"
    )


def failure_of(failures: Failures, status: int) -> tuple[type[FlexgenError], str]:
    """Exception and text of a negative status."""
    return failures.get(status, (BuildError, f"unknown status {status}; {AGAIN}"))


@dataclass(frozen=True)
class Interface:
    """Description of the C interface, from the manifest.

    Parameters
    ----------
    structs : mapping of str to type
        ctypes structures by name.
    enums : mapping of str to tuple of str
        Names of the members, at their numbers.
    limits : mapping of str to int
        Bounds of arguments; in C macros of the same names.
    statuses : mapping of str to int
        Numbers by name.
    sentences : mapping of int to str
        What a status means, by its number.
    """

    structs: Mapping[str, type[ctypes.Structure]]
    enums: Mapping[str, tuple[str, ...]]
    limits: Mapping[str, int]
    statuses: Mapping[str, int]
    sentences: Mapping[int, str]


def interface_of(manifest: Mapping[str, Any]) -> Interface:
    """The interface of a library; ValueError for a member of an unknown type."""
    enums = {name: tuple(members) for name, members in manifest.get("enums", {}).items()}
    statuses = {status["name"]: int(status["code"]) for status in manifest["statuses"]}
    sentences = {int(status["code"]): str(status["text"]) for status in manifest["statuses"]}
    return Interface(
        structs_of(manifest), enums, dict(manifest.get("limits", {})), statuses, sentences
    )


def structs_of(manifest: Mapping[str, Any]) -> dict[str, type[ctypes.Structure]]:
    """Structures by name; ValueError for a member of an unknown type."""
    real = manifest.get("precision", "double")
    enums = manifest.get("enums", {})

    def kind(field: Mapping[str, str]) -> str:
        return "int" if field["kind"] in enums else field["kind"]

    return {
        struct["name"]: _structure(
            real, struct["name"], tuple((f["name"], kind(f)) for f in struct["fields"])
        )
        for struct in manifest.get("structs", ())
    }


@cache
def _structure(
    precision: str, name: str, fields: tuple[tuple[str, str], ...]
) -> type[ctypes.Structure]:
    """The structure ``name`` of C as a class of ctypes; ``fields``: pairs of member and type, of
    the precision of the library.
    """
    kinds = {**_KINDS, "real": REAL[precision]}
    for _, kind in fields:
        if kind not in kinds and kind not in _POINTERS:
            raise ValueError(
                f"given a member of type {kind!r} in struct {name}, expected a number, an array "
                "or a servo"
            )
    members = [(field, kinds.get(kind, ctypes.c_void_p)) for field, kind in fields]
    return type(name, (ctypes.Structure,), {"_fields_": members})


def struct_of(structure: type[ctypes.Structure], **members: Any) -> ctypes.Structure:
    """A structure with these members; arrays and structures become pointers, so the caller must
    keep them.
    """

    def member(x: Any) -> Any:
        if isinstance(x, ctypes.Structure):
            return ctypes.addressof(x)
        return address(x) if isinstance(x, np.ndarray) else x

    return structure(**{key: member(x) for key, x in members.items()})
