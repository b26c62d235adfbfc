"""Whether a library is the one that its manifest describes: its version, model, functions, sizes
and numbers.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import BuildError
from flexgen.runtime.files import AGAIN, read_verified, verify_folder

ABI_VERSION = 6  # of the interface between Python and C
FORMAT = 3  # of the manifest
# of whole paths and streams: residual of a deflection of 1e-8 rad or m
TOLERANCES = {"double": 1e-6, "single": 1e-3}
CONFIGURATIONS_MAX = 16  # of an arm with six rotations, away from singularities
STARTS = 1536  # of the search of all of them: recommended
STARTS_MAX = 1_000_000  # at most
REALS: dict[str, np.dtype[Any]] = {"double": np.dtype(np.float64), "single": np.dtype(np.float32)}

_SIZES = ("n_a", "n_g", "n_e", "n_m", "n_x", "n_y", "n_t", "n_s", "n_p", "n_packed")
_MEANING = {
    "abi_version": "another version of the interface between Python and C",
    "digest": "the library of another model",
    "interface": "functions of other names or shapes",
    "sizeof_real": "bytes of a number: another precision than the manifest's",
    "sizeof_int": "bytes of an int in C",
}


def verify(library: ctypes.CDLL, manifest: dict[str, Any]) -> None:
    """Compare what the library says of itself with the manifest and this Python; BuildError where
    they differ.
    """
    name = manifest["name"]
    precision = manifest.get("precision", "double")
    if precision not in REALS:
        raise BuildError(f"precision: given {precision!r}, expected double or single; {AGAIN}")
    for size in manifest["sizes"]:
        if size not in _SIZES:
            raise ValueError(f"given the size {size!r}, expected {', '.join(_SIZES)}")
    expected: dict[str, Any] = {
        "abi_version": ABI_VERSION,
        "sizeof_real": REALS[precision].itemsize,
        "sizeof_int": ctypes.sizeof(ctypes.c_int),
        "digest": manifest["model_digest"],
        "interface": hashlib.sha256("".join(_signatures(manifest)).encode()).hexdigest(),
        **manifest["sizes"],
    }
    for key, value in expected.items():
        entry = entry_of(library, f"{name}_{key}")
        if key in ("digest", "interface"):
            entry.restype = ctypes.c_char_p
            said = entry().decode("ascii", "replace")
        else:
            said = int(entry())
        if said != value:
            meaning = f" ({_MEANING[key]})" if key in _MEANING else ""
            raise BuildError(f"{name}_{key}: given {said}, expected {value}{meaning}; {AGAIN}")


def entry_of(library: ctypes.CDLL, symbol: str) -> Any:
    """A function of the library that returns an int; BuildError where it is missing.

    Types of arguments are not declared: all calls pass objects of ctypes and small numbers, and
    looking declarations up would cost time in every one.
    """
    try:
        return library[symbol]
    except AttributeError:
        raise BuildError(
            f"{symbol}: given a library without it, expected the one that the manifest "
            f"describes; {AGAIN}"
        ) from None


def read_parameters(library: ctypes.CDLL, manifest: dict[str, Any]) -> np.ndarray:
    """The run-time parameters' values in the model file, as the library says; empty where it has
    none.
    """
    values = np.zeros(manifest["sizes"].get("n_p", 0), REALS[manifest.get("precision", "double")])
    if values.size:
        entry = entry_of(library, f"{manifest['name']}_parameters")
        entry.restype = None
        entry(ctypes.c_void_p(values.ctypes.data))
    values.flags.writeable = False
    return values


def _signatures(manifest: dict[str, Any]) -> list[str]:
    """The lines that the library hashes: those of its functions, its structs and its fixed
    functions.
    """
    fixed = [
        f"{row['signature']}\n"
        for key in ("structs", "c_functions")
        for row in manifest.get(key, ())
    ]
    each = ["parameters for each point\n"] if manifest.get("per_point") else []
    return [*map(_signature, manifest["functions"]), *each, *fixed]


def _signature(described: dict[str, Any]) -> str:
    """Names and shapes of a function in one line, as the library hashes them:
    ``mass_matrix(q_a[3])(M[3,3])``.
    """

    def join(ports: list[dict[str, Any]]) -> str:
        return "".join(f"{port['name']}[{','.join(map(str, port['shape']))}]" for port in ports)

    return f"{described['name']}({join(described['inputs'])})({join(described['outputs'])})\n"


def read_manifest(folder: Path) -> tuple[Path, dict[str, Any]]:
    """A folder that holds a compiled library, without symbolic links, and its manifest."""
    path = folder / "manifest.json"
    try:
        trusted = verify_folder(folder)
        manifest = json.loads(read_verified(trusted / path.name))
    except OSError as error:
        raise BuildError(
            f"{folder}: given no readable manifest.json, expected what flexgen.generate writes"
        ) from error
    except (ValueError, RecursionError) as error:
        raise BuildError(f"{path}: given text that is not JSON ({error}); {AGAIN}") from error
    if not isinstance(manifest, dict):
        raise BuildError(f"{path}: given another format, expected format {FORMAT}; {AGAIN}")
    if manifest.get("abi_version") != ABI_VERSION:
        raise BuildError(
            f"{path}: given ABI version {manifest.get('abi_version')}, expected {ABI_VERSION}: "
            "the library was written by another version of flexgen "
            f"({manifest.get('generator')}), whose C interface differs; {AGAIN}"
        )
    if manifest.get("format") != FORMAT:
        raise BuildError(f"{path}: given another format, expected format {FORMAT}; {AGAIN}")
    if not manifest.get("build"):
        raise BuildError(
            f"{folder}: given sources only, expected a compiled library; generate it without "
            "build=False (--no-build)"
        )
    return trusted, manifest
