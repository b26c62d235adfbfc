"""A generated library as Python functions on numpy arrays: `load`. Needs numpy and the manifest, nothing else.

What a call costs: buffers and the arguments in C are bound once and kept in a pool, a set per call under way, so that
calls from several threads (ctypes releases the interpreter's lock) never share one.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
from collections import namedtuple
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from flexgen import errors
from flexgen.errors import ArgumentError, BuildError, FlexgenError
from flexgen.ports import Port, identifier_problem

ABI_VERSION = 1
FORMAT = 1

_LIBRARY_FILE = re.compile(r"lib[A-Za-z][A-Za-z0-9_]*-[0-9a-f]{16}\.(so|dylib)\Z")
_FLOAT = np.dtype(np.float64)
_MAX_POINTS = 2 ** (8 * ctypes.sizeof(ctypes.c_int) - 1) - 1
_AGAIN = "generate it again with flexgen.generate(..., force=True)"


class _Buffers:
    """Arrays of one call: packed inputs, outputs, workspace; views of them by port; their addresses for C."""

    def __init__(self, inputs: tuple[Port, ...], outputs: tuple[Port, ...], work: int) -> None:
        self.packed = np.zeros(sum(port.size for port in inputs))
        self.results = np.zeros(sum(port.size for port in outputs))
        self.work = np.zeros(work)
        self.inputs, where_in = _views(self.packed, inputs)
        self.outputs, where_out = _views(self.results, outputs)
        self.arguments = [ctypes.c_void_p(address) for address in (*where_in, *where_out, self.work.ctypes.data)]


def _views(memory: np.ndarray, ports: tuple[Port, ...]) -> tuple[list[np.ndarray], list[int]]:
    """Per port its part of the memory, as an array of its shape (matrices by columns), and the part's address."""
    views, addresses, start = [], [], 0
    for port in ports:
        part = memory[start : start + port.size]
        views.append(part.reshape(port.shape, order="F"))
        addresses.append(memory.ctypes.data + start * memory.itemsize)
        start += port.size
    return views, addresses


class Function:
    """One function of a library: ``f(q_a, ...)`` on arrays of one point, or of many points along a first axis.

    Inputs of one point are held for all where others have many. One output is returned as an array, several as a
    named tuple; matrices have the shape (rows, columns). Every input is checked: shape, type, finiteness.

    Parameters
    ----------
    name, summary, equation : str
        What it computes.
    inputs, outputs : tuple of Port
        The arrays.
    """

    def __init__(
        self,
        name: str,
        summary: str,
        equation: str,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        single: Callable[..., int],
        batch: Callable[..., int],
        work: int,
        failures: Mapping[int, tuple[type[FlexgenError], str]],
    ) -> None:
        self.name, self.summary, self.equation = name, summary, equation
        self.inputs, self.outputs = inputs, outputs
        self.__name__ = name
        self.__doc__ = _docstring(summary, equation, inputs, outputs)
        self._single, self._batch, self._work, self._failures = single, batch, work, failures
        self._results: Callable[..., Any] | None = None
        if len(outputs) > 1:
            self._results = namedtuple(name, [port.name for port in outputs])  # type: ignore[misc]
        self._shapes = [port.shape for port in inputs]
        self._zeros = np.zeros(sum(port.size for port in inputs))
        self._pool: list[_Buffers] = []

    def __repr__(self) -> str:
        return f"{self.name}({', '.join(port.name for port in self.inputs)})"

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Evaluate at one point or at many; see the class."""
        given = args if not named and len(args) == len(self.inputs) else self._bound(args, named)
        try:
            buffers = self._pool.pop()
        except IndexError:
            buffers = _Buffers(self.inputs, self.outputs, self._work)
        for i, x in enumerate(given):
            if type(x) is not np.ndarray or x.dtype is not _FLOAT:
                x = self._converted(i, x)
            if x.shape != self._shapes[i]:
                self._pool.append(buffers)
                return self._many(given)
            buffers.inputs[i][...] = x
        if buffers.packed.dot(self._zeros) != 0.0:  # NaN where an entry is not finite, and only there
            self._refuse_not_finite(given)
        status = self._single(*buffers.arguments)
        if status:
            self._fail(status)
        if self._results is None:
            result = buffers.outputs[0].copy()
        else:
            result = self._results(*[view.copy() for view in buffers.outputs])
        self._pool.append(buffers)
        return result

    def _bound(self, args: tuple[Any, ...], named: dict[str, Any]) -> list[Any]:
        """Arguments in the order of the inputs."""
        names = [port.name for port in self.inputs]
        given = dict(zip(names, args, strict=False))
        double = [name for name in named if name in given]
        unknown = [name for name in named if name not in names]
        given.update(named)
        missing = [name for name in names if name not in given]
        if len(args) > len(names) or double or unknown or missing:
            told = f"{len(args)} arguments" + (f" and {', '.join(named)}" if named else "")
            raise ArgumentError(f"{self.name}: given {told}, expected {', '.join(names)}")
        return [given[name] for name in names]

    def _converted(self, i: int, x: Any) -> np.ndarray:
        """The argument as an array of doubles; ArgumentError where it does not hold real numbers."""
        port = self.inputs[i]
        try:
            array = np.asarray(x)
        except ValueError as error:
            raise ArgumentError(f"{self.name}, {port.name}: given {error}, expected real numbers") from error
        if array.dtype.kind not in "iuf":
            raise ArgumentError(f"{self.name}, {port.name}: given entries of type {array.dtype}, expected real numbers")
        return array.astype(_FLOAT)

    def _refuse_not_finite(self, given: Any) -> None:
        for i, port in enumerate(self.inputs):
            x = self._converted(i, given[i])
            if not np.isfinite(x).all():
                at = tuple(int(k) for k in np.argwhere(~np.isfinite(x))[0])
                where = ", ".join(map(str, at))
                raise ArgumentError(f"{self.name}, {port.name}[{where}]: given {x[at]}, expected finite numbers")

    def _fail(self, status: int, point: int | None = None) -> None:
        exception, text = self._failures.get(status, (BuildError, f"unknown status {status}; {_AGAIN}"))
        where = "" if point is None else f", point {point}"
        raise exception(f"{self.name}{where}: {text}")

    def _many(self, given: Any) -> Any:
        """Evaluate at many points: at least one input has a first axis more than its port."""
        arrays = [self._converted(i, x) for i, x in enumerate(given)]
        count: int | None = None
        for port, x in zip(self.inputs, arrays, strict=True):
            if x.shape == port.shape:
                continue
            if x.shape[1:] != port.shape or x.ndim != len(port.shape) + 1:
                many = ", ".join(map(str, ("N", *port.shape)))
                raise ArgumentError(
                    f"{self.name}, {port.name}: given shape {x.shape}, expected {port.shape} or ({many}) [{port.unit}]"
                )
            if count is not None and x.shape[0] != count:
                raise ArgumentError(
                    f"{self.name}, {port.name}: given {x.shape[0]} points, expected {count} as in the inputs before"
                )
            count = x.shape[0]
        assert count is not None
        if count > _MAX_POINTS:
            raise ArgumentError(f"{self.name}: given {count} points, expected at most {_MAX_POINTS}")
        self._refuse_not_finite(arrays)
        # In memory: point after point, each by columns; so a matrix is stored transposed.
        stored = []
        for port, x in zip(self.inputs, arrays, strict=True):
            full = np.broadcast_to(x, (count, *port.shape))
            stored.append(np.ascontiguousarray(full if len(port.shape) == 1 else full.transpose(0, 2, 1)))
        results = [np.empty((count, *reversed(port.shape))) for port in self.outputs]
        work = np.empty(self._work)
        status = self._batch(count, *(ctypes.c_void_p(x.ctypes.data) for x in (*stored, *results, work)))
        if status:
            bad = [~np.isfinite(x.reshape(count, -1)).all(axis=1) for x in results]
            self._fail(status, int(np.argmax(np.logical_or.reduce(bad))))
        shaped = [
            x if len(port.shape) == 1 else np.ascontiguousarray(x.transpose(0, 2, 1))
            for port, x in zip(self.outputs, results, strict=True)
        ]
        return shaped[0] if self._results is None else self._results(*shaped)


class Library:
    """A loaded library: its functions are attributes, such as ``library.mass_matrix(q_a)``.

    Parameters
    ----------
    name : str
        The model's name, with its variant.
    directory : Path
        Where it was loaded from.
    digest : str
        SHA-256 of the model's data, as the library itself says.
    functions : mapping of str to Function
        By name, in the order of the header.
    sizes : mapping of str to int
        ``n_a``, ``n_g``, ``n_e``, ``n_m``, ``n_x``.
    coordinates, units, motors, states : tuple of str
        Names and units of ``q_a``, names of ``q_m``, meaning of the state of ``linearize``.
    """

    def __init__(self, directory: Path, manifest: dict[str, Any], functions: dict[str, Function]) -> None:
        self.name: str = manifest["name"]
        self.directory = directory
        self.digest: str = manifest["model_digest"]
        self.functions: Mapping[str, Function] = MappingProxyType(functions)
        self.sizes: Mapping[str, int] = MappingProxyType(dict(manifest["sizes"]))
        self.coordinates: tuple[str, ...] = tuple(c["name"] for c in manifest["coordinates"])
        self.units: tuple[str, ...] = tuple(c["unit"] for c in manifest["coordinates"])
        self.motors: tuple[str, ...] = tuple(manifest["motors"])
        self.states: tuple[str, ...] = tuple(manifest["states"])

    @property
    def ports(self) -> dict[str, tuple[tuple[Port, ...], tuple[Port, ...]]]:
        """Inputs and outputs of every function."""
        return {name: (f.inputs, f.outputs) for name, f in self.functions.items()}

    def __getattr__(self, name: str) -> Function:
        functions = self.__dict__.get("functions", {})
        if name in functions:
            return functions[name]
        raise AttributeError(f"given {name!r}, expected one of the library's functions: {', '.join(functions)}")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.functions})

    def __repr__(self) -> str:
        return f"<Library {self.name}: {', '.join(self.functions)}>"


def load(directory: str | os.PathLike[str]) -> Library:
    """Load a generated library.

    Before the first call the library's file, ABI version, model digest and sizes are compared with the manifest.

    Parameters
    ----------
    directory : str or Path
        What `flexgen.generate` wrote.

    Returns
    -------
    Library

    Raises
    ------
    ArgumentError
        Where the directory is no path.
    BuildError
        Where there is no library, or not the one that the manifest describes.
    """
    if not isinstance(directory, str | os.PathLike) or not isinstance(os.fspath(directory), str):
        raise ArgumentError(f"directory: given {directory!r}, expected the path of what flexgen.generate wrote")
    folder = Path(directory)
    manifest = _read(folder)
    try:
        file, recorded = manifest["build"]["library"], manifest["build"]["sha256"]
        if not _LIBRARY_FILE.match(file):
            raise BuildError(
                f"{folder}: given the library's file name {file!r}, expected lib<name>-<hash>.so; {_AGAIN}"
            )
        path = (folder / file).resolve()
        given = hashlib.sha256(path.read_bytes()).hexdigest()
        if given != recorded:
            raise BuildError(f"{path.name}: given SHA-256 {given[:16]}..., expected {recorded[:16]}...; {_AGAIN}")
        library = ctypes.CDLL(str(path))
        _verify(library, manifest)
        failures = {
            status["code"]: (_exception(status["exception"]), status["text"])
            for status in manifest["statuses"]
            if status["code"] != 0
        }
        functions = {f["name"]: _function(library, manifest["name"], f, failures) for f in manifest["functions"]}
        return Library(folder, manifest, functions)
    except OSError as error:
        raise BuildError(f"{folder}: given a library that cannot be loaded ({error}); {_AGAIN}") from error
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, FlexgenError):
            raise BuildError(f"{folder}: {error}; {_AGAIN}") from error
        raise BuildError(f"{folder / 'manifest.json'}: given an incomplete manifest ({error!r}); {_AGAIN}") from error


def _read(folder: Path) -> dict[str, Any]:
    """The manifest of a folder that holds a compiled library."""
    path = folder / "manifest.json"
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BuildError(f"{folder}: given no readable manifest.json, expected what flexgen.generate writes") from error
    except ValueError as error:
        if "\0" in str(folder):
            raise ArgumentError(f"directory: given {str(folder)!r}, expected the path of a folder") from None
        raise BuildError(f"{path}: given text that is not JSON ({error}); {_AGAIN}") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise BuildError(f"{path}: given another format, expected format {FORMAT}; {_AGAIN}")
    if not manifest.get("build"):
        raise BuildError(
            f"{folder}: given sources only, expected a compiled library; generate it without build=False (--no-build)"
        )
    return manifest


def _verify(library: ctypes.CDLL, manifest: dict[str, Any]) -> None:
    """Compare what the library says of itself with the manifest and this Python; BuildError where they differ."""
    name = manifest["name"]
    if identifier_problem(name) is not None:
        raise BuildError(f"name of the library: given {name!r}, expected {identifier_problem(name)}; {_AGAIN}")
    said: dict[str, Any] = {}
    for key in ("digest", "interface"):
        function = getattr(library, f"{name}_{key}")
        function.restype, function.argtypes = ctypes.c_char_p, []
        said[key] = function().decode("ascii")
    expected: dict[str, Any] = {
        "digest": manifest["model_digest"],
        "interface": hashlib.sha256("".join(map(_signature, manifest["functions"])).encode()).hexdigest(),
        "abi_version": ABI_VERSION,
        "sizeof_real": ctypes.sizeof(ctypes.c_double),
        "sizeof_int": ctypes.sizeof(ctypes.c_int),
        **manifest["sizes"],
    }
    for key in expected:
        if key not in said:
            said[key] = _number(library, f"{name}_{key}")
        if said[key] != expected[key]:
            raise BuildError(f"{name}_{key}: given {said[key]}, expected {expected[key]}; {_AGAIN}")


def _signature(described: dict[str, Any]) -> str:
    """Names and shapes of a function in one line, as the library hashes them: ``mass_matrix(q_a[3])(M[3,3])``."""

    def listed(ports: list[dict[str, Any]]) -> str:
        return "".join(f"{port['name']}[{','.join(map(str, port['shape']))}]" for port in ports)

    return f"{described['name']}({listed(described['inputs'])})({listed(described['outputs'])})\n"


def _number(library: ctypes.CDLL, symbol: str) -> int:
    """The result of ``int symbol(void)``."""
    function = getattr(library, symbol)
    function.restype, function.argtypes = ctypes.c_int, []
    return int(function())


def _exception(name: str) -> type[FlexgenError]:
    found = getattr(errors, name, None)
    if not (isinstance(found, type) and issubclass(found, FlexgenError)):
        raise ValueError(f"given the exception {name!r}, expected a class of flexgen.errors")
    return found


def _function(
    library: ctypes.CDLL, prefix: str, described: dict[str, Any], failures: Mapping[int, tuple[type[FlexgenError], str]]
) -> Function:
    """One function of the library with its C entry points."""
    name = described["name"]
    if identifier_problem(name) is not None:
        raise ValueError(f"given the function name {name!r}, expected {identifier_problem(name)}")
    inputs, outputs = (
        tuple(Port(p["name"], tuple(p["shape"]), p["unit"], p["doc"]) for p in described[key])
        for key in ("inputs", "outputs")
    )
    single, batch = getattr(library, f"{prefix}_{name}"), getattr(library, f"{prefix}_{name}_batch")
    pointers = [ctypes.c_void_p] * (len(inputs) + len(outputs) + 1)
    single.restype, batch.restype = ctypes.c_int, ctypes.c_int
    single.argtypes, batch.argtypes = pointers, [ctypes.c_int, *pointers]
    work = _number(library, f"{prefix}_{name}_work")
    return Function(name, described["summary"], described["equation"], inputs, outputs, single, batch, work, failures)


def _docstring(summary: str, equation: str, inputs: tuple[Port, ...], outputs: tuple[Port, ...]) -> str:
    def rows(ports: tuple[Port, ...]) -> str:
        return "".join(f"{p.name} : array {p.shape} [{p.unit}]\n    {p.doc}\n" for p in ports)

    return f"{summary}\n\n    {equation}\n\nParameters\n----------\n{rows(inputs)}\nReturns\n-------\n{rows(outputs)}"
