"""Arrays on the GPU: those of other packages, as they are given, and `DeviceArray`, what functions
return.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexgen.backends.cuda import dlpack
from flexgen.backends.cuda.driver import Card
from flexgen.base.errors import ArgumentError, FlexgenError

_LEGACY = 1  # what the protocols call the default stream, whose handle is 0


def stream_handle(function: str, stream: Any) -> int:
    """The handle of a stream: an int, or an object of cuda.core, CuPy or PyTorch; None: the
    default stream.
    """
    if stream is None:
        return 0
    if hasattr(stream, "__cuda_stream__"):
        protocol = stream.__cuda_stream__
        return int((protocol() if callable(protocol) else protocol)[1])
    for name in ("cuda_stream", "ptr"):  # PyTorch; CuPy
        stream = getattr(stream, name, stream)
    if isinstance(stream, bool) or not isinstance(stream, int) or stream < 0:
        raise ArgumentError(
            f"{function}, stream: given {stream!r}, expected a stream of CuPy, PyTorch or "
            "cuda.core, or its handle"
        )
    return stream


def steps_of(shape: Sequence[int], itemsize: int, order: str) -> tuple[int, ...]:
    """Strides in bytes of an array without gaps, in the order of C or Fortran."""
    steps = []
    step = itemsize
    for extent in shape if order == "F" else reversed(shape):
        steps.append(step)
        step *= extent
    return tuple(steps if order == "F" else reversed(steps))


class DeviceArray:
    """An array on the GPU, that other packages use without a copy: ``cupy.asarray(x)``,
    ``torch.from_dlpack(x)``.

    Its memory is given back with the last object that uses it. Its numbers are there once the work
    of its stream is done; packages that take it know that.

    Parameters
    ----------
    address : int
        Of the first number.
    shape, strides : tuple of int
        Entries and bytes.
    dtype : dtype
    """

    def __init__(
        self,
        card: Card,
        address: int,
        shape: tuple[int, ...],
        strides: tuple[int, ...],
        dtype: np.dtype[Any],
        stream: Any,
        owner: Any = None,
    ) -> None:
        self._card = card
        self._address = address
        self._owner = owner
        self.shape = shape
        self.strides = strides
        self.dtype = dtype
        self._stream = stream

    @classmethod
    def empty(
        cls,
        card: Card,
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
        stream: Any,
        order: str = "F",
    ) -> DeviceArray:
        """New memory on a card without values, in the order of Fortran ("F") or of C ("C"); it is
        freed with the array, in the order of the ``stream``.
        """
        address = card.allocate(math.prod(shape) * dtype.itemsize, stream_handle("empty", stream))
        made = cls(card, address, shape, steps_of(shape, dtype.itemsize, order), dtype, stream)
        made._owner = _Memory(card, address, stream)
        return made

    @property
    def stream(self) -> int:
        """Handle of the stream whose work gives the array its values."""
        return stream_handle("stream", self._stream)

    @property
    def T(self) -> DeviceArray:  # the name of NumPy
        """Transposed view of the same memory: (N, n) in Fortran order is (n, N) in C order."""
        return DeviceArray(
            self._card,
            self._address,
            self.shape[::-1],
            self.strides[::-1],
            self.dtype,
            self._stream,
            self._owner,
        )

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (self._address, False),
            "strides": self.strides,
            "version": 3,
            "stream": self.stream or _LEGACY,
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        return dlpack.CUDA, self._card.ordinal

    def __dlpack__(self, *, stream: Any = None, **options: Any) -> Any:
        if options.get("copy"):
            raise BufferError(
                "given copy=True, expected None or False: copy the array that you take"
            )
        if options.get("dl_device") not in (None, self.__dlpack_device__()):
            raise BufferError(
                f"given the device {options['dl_device']}, expected {self.__dlpack_device__()}"
            )
        if stream != -1:
            handle = 0 if stream in (None, _LEGACY) else int(stream)
            if handle != self.stream:
                self._card.wait(handle, self.stream)
        return dlpack.give(
            self._owner,
            self._address,
            self.shape,
            self.strides,
            self.dtype.itemsize,
            self._card.ordinal,
        )

    def numpy(self) -> np.ndarray:
        """A copy on the CPU, once the work of the stream is done."""
        order = sorted(range(len(self.shape)), key=lambda axis: self.strides[axis])
        memory = np.empty([self.shape[axis] for axis in reversed(order)], self.dtype)
        self._card.read(self._address, memory.ctypes.data, memory.nbytes, self.stream)
        return memory.transpose([list(reversed(order)).index(axis) for axis in range(len(order))])

    def __repr__(self) -> str:
        return f"<DeviceArray {self.shape}, {self.dtype}, cuda:{self._card.ordinal}>"


class _Memory:
    """Memory of the GPU, given back on its stream."""

    def __init__(self, card: Card, address: int, stream: Any) -> None:
        self._card = card
        self._address = address
        self._stream = stream

    def __del__(self) -> None:
        with contextlib.suppress(FlexgenError, TypeError):  # also where the interpreter ends
            self._card.free(self._address, stream_handle("free", self._stream))


class Given:
    """An array of a caller on the card, readable for work on a stream; `release` ends its use.

    ArgumentError where it is none, or in another memory.
    """

    def __init__(self, card: Card, function: str, name: str, x: Any, stream: int) -> None:
        self._where = f"{function}, {name}"
        self.release = _nothing
        self.strides: tuple[int, ...] | None
        if isinstance(x, np.ndarray | np.generic | list | tuple | float | int):
            raise ArgumentError(
                f"{self._where}: given {type(x).__name__} on the CPU, expected an array on "
                f"cuda:{card.ordinal}; copy it with library.array(x), cupy.asarray(x) or "
                "torch.as_tensor(x, device='cuda')"
            )
        try:
            if hasattr(x, "__dlpack__") and not isinstance(x, DeviceArray):
                self._take_capsule(card, x, stream)
            elif hasattr(x, "__cuda_array_interface__"):
                self._take_interface(card, x, stream)
            else:
                raise ArgumentError(
                    f"{self._where}: given {type(x).__name__}, expected an array with "
                    "__dlpack__ or __cuda_array_interface__, such as those of CuPy, PyTorch "
                    "and JAX"
                )
        except (
            BufferError,
            RuntimeError,
            TypeError,
            ValueError,
            KeyError,
            AttributeError,
        ) as error:
            if isinstance(error, FlexgenError):
                raise
            raise ArgumentError(
                f"{self._where}: given {type(x).__name__} that does not give its memory "
                f"({error}), expected one that does; for a tensor with gradients: x.detach()"
            ) from error
        if self.strides is not None and len(self.strides) != len(self.shape):
            raise ArgumentError(
                f"{self._where}: given strides {self.strides} for shape {self.shape}, expected "
                "as many"
            )

    def _take_capsule(self, card: Card, x: Any, stream: int) -> None:
        kind, number = (int(part) for part in x.__dlpack_device__())
        self._refuse_elsewhere(card, None if kind not in (dlpack.CUDA, dlpack.MANAGED) else number)
        taken = dlpack.take(x.__dlpack__(stream=stream or _LEGACY))
        self.address, self.shape, self.strides, self.dtype, self.release = taken

    def _take_interface(self, card: Card, x: Any, stream: int) -> None:
        """Address, shape, strides and type from the ``__cuda_array_interface__`` of an array; work
        of its stream is waited for.
        """
        told = x.__cuda_array_interface__
        self.address = int(told["data"][0])
        self.shape = tuple(told["shape"])
        self.strides = told.get("strides")
        self.dtype = str(told["typestr"])
        other = told.get("stream")
        if told.get("mask") is not None:
            raise ArgumentError(
                f"{self._where}: given an array with masked entries, expected real numbers"
            )
        if math.prod(self.shape):
            self._refuse_elsewhere(card, card.ordinal_of(self.address))
        if other is not None and (0 if other == _LEGACY else int(other)) != stream:
            card.wait(stream, 0 if other == _LEGACY else int(other))

    def _refuse_elsewhere(self, card: Card, number: int | None) -> None:
        """Refuse an array on another card, ``number``, or on the CPU: None."""
        if number != card.ordinal:
            place = "the memory of the CPU" if number is None else f"the memory of cuda:{number}"
            raise ArgumentError(
                f"{self._where}: given an array in {place}, expected one on "
                f"cuda:{card.ordinal}, where the library is; copy the array, or load the "
                "library on the array's device"
            )

    def demand(self, shape: tuple[int | None, ...], real: np.dtype[Any], order: str) -> None:
        """Refuse another shape (None: any extent), type of numbers, or order of the numbers."""
        fits = len(shape) == len(self.shape) and all(
            wanted in (None, extent) for wanted, extent in zip(shape, self.shape, strict=True)
        )
        if not fits:
            expected = ", ".join("N" if extent is None else str(extent) for extent in shape)
            raise ArgumentError(f"{self._where}: given shape {self.shape}, expected ({expected})")
        if self.dtype != real.str:
            raise ArgumentError(
                f"{self._where}: given numbers of type {self.dtype}, expected {real.name}; a "
                "library has the precision that it was generated with"
            )
        wanted = steps_of(self.shape, real.itemsize, order)
        given = self.strides or steps_of(self.shape, real.itemsize, "C")
        rows = zip(self.shape, wanted, given, strict=True)
        if math.prod(self.shape) and any(extent > 1 and a != b for extent, a, b in rows):
            advice = (
                "the order of Fortran, with points next to each other: cupy.asfortranarray(x), "
                "for PyTorch x.T.contiguous().T, for JAX library.transpose(y) of an array y "
                "with the axes in reverse"
                if order == "F"
                else "rows without gaps: the order of C"
            )
            raise ArgumentError(
                f"{self._where}: given strides {given} of bytes, expected {wanted}: {advice}"
            )
        if self.address % real.itemsize:
            raise ArgumentError(
                f"{self._where}: given address {self.address:#x}, expected one for {real.name}"
            )


def _nothing() -> None:
    """Nothing is to be released."""
