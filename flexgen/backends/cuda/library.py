"""A generated library whose functions run on the GPU: what `flexgen.load` returns for
``device="cuda"``.
"""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import Any

import numpy as np

from flexgen.backends.cuda.arrays import DeviceArray, Given, steps_of, stream_handle
from flexgen.backends.cuda.compiler import compile_cached
from flexgen.backends.cuda.driver import Card
from flexgen.backends.cuda.functions import functions_of
from flexgen.backends.cuda.inversion import CudaManyInverter
from flexgen.backends.cuda.sources import headers_of, inversion_text, kernel_text, read_files
from flexgen.base.errors import ArgumentError
from flexgen.runtime.identity import REALS, read_manifest
from flexgen.runtime.library import Library, library_again

_DEVICE = re.compile(r"cuda(?::(\d{1,3}))?\Z")


class CudaLibrary(Library):
    """A library whose functions take and return arrays on the GPU; all else, such as its streams,
    is on the CPU.

    Parameters
    ----------
    library : Library
        The same on the CPU.
    device : str
        ``"cuda"``, the first card, or ``"cuda:1"`` and so on.
    """

    def __init__(self, library: Library, device: str) -> None:
        named = _DEVICE.match(device)
        if named is None:
            raise ArgumentError(
                f"device: given {device!r}, expected 'cpu', 'cuda', or 'cuda:1' for the second "
                "card"
            )
        self.__dict__.update(library.__dict__)
        self.device = device
        self.card = Card(int(named[1] or 0))
        self._real = REALS[self.precision]
        self._many: CudaManyInverter | None = None
        folder, self._manifest = read_manifest(self.directory)
        self._files = read_files(folder, self._manifest)
        self._headers = headers_of(self._files)
        on_card: Any = functions_of(
            library.functions, self.card, self._real, self._load_kernel, self.per_point
        )
        self.functions = MappingProxyType(on_card)

    @property
    def invert_many(self) -> Any:
        """`invert` for many problems on the card, a thread a problem; ArgumentError where the
        library has none.
        """
        if self._many is None:
            self._many = CudaManyInverter(self.invert, self.card, self._load_inversion)
        return self._many

    def _load_inversion(self, work: int) -> Any:
        """The kernel of whole inversions with so many reals of workspace."""
        cubin = self._compile(inversion_text(self._manifest, self._files, work))
        return self.card.load(cubin, "k_invert_many")

    def _load_kernel(self, function: str) -> Any:
        """The kernel of a function, compiled where the cache does not have it."""
        return self.card.load(
            self._compile(kernel_text(self._manifest, self._files, function)), f"k_{function}"
        )

    def _compile(self, text: str) -> bytes:
        return compile_cached(self.name, text, self._headers, self.card.architecture)

    def array(self, x: Any, stream: Any = None, order: str = "F") -> DeviceArray:
        """A copy of an array on the GPU: numbers of the library's precision, in the order of
        Fortran, or of C: "C".
        """
        if order not in ("F", "C"):
            raise ArgumentError(f"array, order: given {order!r}, expected 'F' or 'C'")
        try:
            values: np.ndarray = np.asarray(x, self._real, order="F" if order == "F" else "C")
        except (TypeError, ValueError) as error:
            raise ArgumentError(
                f"array: given {error}, expected real numbers on the CPU"
            ) from error
        made = DeviceArray.empty(self.card, values.shape, self._real, stream, order)
        self.card.write(made._address, values.ctypes.data, values.nbytes, made.stream)
        return made

    def transpose(self, x: Any, stream: Any = None) -> DeviceArray:
        """Transposed view of a device array: (n, N) in the order of C becomes (N, n)."""
        if isinstance(x, DeviceArray):
            return x.T
        given = Given(self.card, "transpose", "x", x, stream_handle("transpose", stream))
        if given.dtype != self._real.str:
            raise ArgumentError(
                f"transpose, x: given numbers of type {given.dtype}, expected {self._real.name}"
            )
        steps = given.strides or steps_of(given.shape, self._real.itemsize, "C")
        return DeviceArray(
            self.card,
            given.address,
            given.shape[::-1],
            steps[::-1],
            self._real,
            stream,
            _Lent(x, given),
        )

    def __reduce__(self) -> Any:
        super().__reduce__()  # refused where closed
        return _load_again, (*self._again, self.device)

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, on {self.card.name}>"


class _Lent:
    """Memory of another package, in use here."""

    def __init__(self, owner: Any, given: Given) -> None:
        self._owner = owner
        self._given = given

    def __del__(self) -> None:
        self._given.release()


def _load_again(directory: str, sha256: str, device: str) -> CudaLibrary:
    """The library that was pickled; BuildError where another one is in its directory now."""
    return CudaLibrary(library_again(directory, sha256), device)
