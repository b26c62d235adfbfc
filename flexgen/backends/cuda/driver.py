"""All calls of the CUDA driver: one card, its memory, streams and kernels.

The primary context of the card is used, that of CuPy, PyTorch and JAX, so that their memory and
their streams are valid here. Nothing else in flexgen calls the driver; tests replace `bindings` by
one that runs kernels on the CPU.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator, Sequence
from typing import Any

from flexgen.base.errors import ArgumentError, BuildError, SolverError

_MAJOR = 75  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR
_MINOR = 76  # _MINOR
_SMALLEST = (7, 5)  # compute capability that NVRTC of CUDA 13 compiles for
_ORDINAL = 9  # CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL
_OUT_OF_MEMORY = 2
_NO_DEVICE = 100
_LAUNCH_RESOURCES = 701
_BLOCK = 128  # threads
_MOST_BLOCKS = 2**31 - 1


def bindings() -> Any:
    """The bindings of the driver; BuildError where the package is missing."""
    try:
        from cuda.bindings import driver
    except ImportError as error:
        raise BuildError(
            f"device: given 'cuda' without the package cuda-bindings ({error}), expected it; "
            "install what the GPU needs: pip install 'flexgen-robotics[cuda]'"
        ) from error
    return driver


class Card:
    """One GPU; BuildError where there is none of this number, or no driver.

    Parameters
    ----------
    ordinal : int
        Its number, from 0.
    """

    def __init__(self, ordinal: int) -> None:
        self._api = bindings()
        try:
            self._call("cuInit", 0)
        except RuntimeError as error:  # the package does not find the driver's library
            raise BuildError(
                f"device: given 'cuda' where no NVIDIA driver is ({error}), expected one; use "
                "device='cpu' here"
            ) from error
        count = self._call("cuDeviceGetCount")
        if not 0 <= ordinal < count:
            has = (
                "no GPU" if count == 0 else f"GPU 0 to {count - 1}" if count > 1 else "GPU 0 only"
            )
            raise BuildError(
                f"device: given 'cuda:{ordinal}' on a computer with {has}, expected one that is "
                "there"
            )
        self.ordinal = ordinal
        device = self._call("cuDeviceGet", ordinal)
        self.name: str = (
            self._call("cuDeviceGetName", 128, device).decode(errors="replace").strip("\0")
        )
        capability = tuple(
            self._call("cuDeviceGetAttribute", key, device)
            for key in self._attributes(_MAJOR, _MINOR)
        )
        if capability < _SMALLEST:
            had = ".".join(map(str, capability))
            raise BuildError(
                f"device: given {self.name} of compute capability {had}, expected 7.5 or newer"
            )
        self.architecture = f"sm_{capability[0]}{capability[1]}"
        self._context = self._call("cuDevicePrimaryCtxRetain", device)

    def _attributes(self, *numbers: int) -> list[Any]:
        kind = getattr(self._api, "CUdevice_attribute", int)
        return [kind(x) for x in numbers]

    def _call(self, function: str, *arguments: Any) -> Any:
        """The value of a call of the driver; an error of flexgen where it failed."""
        status, *values = getattr(self._api, function)(*arguments)
        if int(status) == 0:
            return values[0] if values else None
        _, text = self._api.cuGetErrorString(status)
        said = (
            f"{getattr(status, 'name', int(status))}: {text.decode() if text else 'unknown error'}"
        )
        if int(status) in (_OUT_OF_MEMORY, _LAUNCH_RESOURCES):
            raise SolverError(
                f"{self._where()}: given more than its memory holds ({function}: {said}), "
                "expected a smaller call; give fewer points or problems at once, or free "
                "memory of other programs on the card"
            )
        if int(status) == _NO_DEVICE:
            raise BuildError(
                "device: given 'cuda' on a computer without a GPU, expected one; use "
                "device='cpu' here"
            )
        raise BuildError(
            f"{self._where()}: given an error of the driver ({function}: {said}), expected success"
        )

    def _where(self) -> str:
        return f"cuda:{getattr(self, 'ordinal', 0)}"

    @contextlib.contextmanager
    def _current(self) -> Iterator[None]:
        """With the context of this card; the caller's is current again afterwards."""
        self._call("cuCtxPushCurrent", self._context)
        try:
            yield
        finally:
            self._call("cuCtxPopCurrent")

    def load(self, cubin: bytes, kernel: str) -> Any:
        """A kernel of a cubin; it stays loaded until the process ends."""
        with self._current():
            try:
                module = self._call("cuModuleLoadData", cubin)
            except BuildError as error:
                raise BuildError(
                    f"{error}; where the driver is older than NVRTC, update it, or install the "
                    "packages of its version: pip install 'cuda-bindings<13' "
                    "nvidia-cuda-nvrtc-cu12"
                ) from error
            return self._call("cuModuleGetFunction", module, kernel.encode())

    def launch(
        self, kernel: Any, threads: int, arguments: Sequence[Any], stream: int, block: int = _BLOCK
    ) -> None:
        """Start a kernel with a thread for each of `threads`; the arguments are objects of ctypes,
        passed by value.
        """
        blocks = -(-threads // block)
        if blocks > _MOST_BLOCKS:
            raise ArgumentError(
                f"{self._where()}: given {threads} points, expected at most {block * _MOST_BLOCKS}"
            )
        where = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(x) for x in arguments))
        with self._current():
            self._call(
                "cuLaunchKernel",
                kernel,
                blocks,
                1,
                1,
                block,
                1,
                1,
                0,
                stream,
                ctypes.addressof(where),
                0,
            )

    def allocate(self, size: int, stream: int) -> int:
        """Address of new memory, valid for work on the stream from now on; 0 for no bytes."""
        with self._current():
            return int(self._call("cuMemAllocAsync", size, stream)) if size else 0

    def free(self, address: int, stream: int) -> None:
        """Give memory back after the work that the stream has now."""
        if address:
            with self._current():
                self._call("cuMemFreeAsync", address, stream)

    def fill(self, address: int, value: int, size: int, stream: int) -> None:
        """Set bytes."""
        with self._current():
            self._call("cuMemsetD8Async", address, value, size, stream)

    def read(self, address: int, to: int, size: int, stream: int) -> None:
        """Copy to the CPU, after the work of the stream; wait for it."""
        with self._current():
            if size:
                self._call("cuMemcpyDtoHAsync", to, address, size, stream)
            self._call("cuStreamSynchronize", stream)

    def write(self, address: int, source: int, size: int, stream: int) -> None:
        """Copy from the CPU, and wait for it."""
        with self._current():
            if size:
                self._call("cuMemcpyHtoDAsync", address, source, size, stream)
            self._call("cuStreamSynchronize", stream)

    def wait(self, stream: int, other: int) -> None:
        """Let a stream wait for the work that another one has now."""
        with self._current():
            event = self._call("cuEventCreate", 2)  # CU_EVENT_DISABLE_TIMING
            try:
                self._call("cuEventRecord", event, other)
                self._call("cuStreamWaitEvent", stream, event, 0)
            finally:
                self._call("cuEventDestroy", event)

    def ordinal_of(self, address: int) -> int | None:
        """Number of the card whose memory an address is in; None where the driver does not know
        it.
        """
        kind = getattr(self._api, "CUpointer_attribute", int)
        with self._current():
            status, *values = self._api.cuPointerGetAttribute(kind(_ORDINAL), address)
        return int(values[0]) if int(status) == 0 else None
