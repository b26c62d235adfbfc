"""A GPU for tests without one: the calls of the CUDA driver that flexgen makes, on memory and
kernels of the CPU.

Kernels are the same texts, compiled by g++ with an empty ``__global__`` and with ``threadIdx`` and
``blockIdx`` as variables. A stream is a list of work that is done when it is waited for, as late
as CUDA allows; memory has other values before it is written, and after it was given back. Handles
and addresses that a card would refuse are refused.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

_HEAD = """\
#include <float.h>
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <tuple>
#include <utility>
#define __global__
static struct { unsigned x; } threadIdx, blockIdx, blockDim;
static inline void atomicMin(unsigned long long *least, unsigned long long x)
{
    *least = x < *least ? x : *least;
}
"""
_TAIL = """
struct call {
    virtual void run() = 0;
    virtual ~call() {}
};
template <class... A> struct call_of : call {
    void (*kernel)(A...);
    std::tuple<A...> given;
    call_of(void (*k)(A...), A... x) : kernel(k), given(x...) {}
    void run() override { std::apply(kernel, given); }
};
template <class... A, std::size_t... I>
static call *bound(void (*kernel)(A...), void **given, std::index_sequence<I...>)
{
    return new call_of<A...>(kernel, *static_cast<A *>(given[I])...);
}
template <class... A> static call *bound(void (*kernel)(A...), void **given)
{
    return bound(kernel, given, std::index_sequence_for<A...>());
}
extern "C" void *bind_arguments(void **given)
{
    return bound(@, given);
}
extern "C" void run(void *given, unsigned blocks, unsigned threads)
{
    call *const kernel = static_cast<call *>(given);
    blockDim.x = threads;
    for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x) {
        for (threadIdx.x = 0; threadIdx.x < threads; ++threadIdx.x) {
            kernel->run();
        }
    }
    delete kernel;
}
"""


def compile_on_cpu(text: str, headers: Mapping[str, str], options: list[str]) -> tuple[bytes, str]:
    """In place of `flexgen.backends.cuda.compiler.compile_text`: a shared object of the kernel, by
    g++.
    """
    defines = [option for option in options if option.startswith("-D")]
    kernel = text.rpartition("void k_")[2].partition("(")[0]
    with tempfile.TemporaryDirectory() as folder:
        for name, content in headers.items():
            if "/" not in name and name not in (
                "float.h",
                "limits.h",
                "math.h",
                "stddef.h",
                "stdint.h",
            ):
                Path(folder, name).write_text(content.replace('#include "../', '#include "'))
        Path(folder, "kernel.cpp").write_text(_HEAD + text + _TAIL.replace("@", f"k_{kernel}"))
        flags = [
            "-O2",
            "-ffp-contract=off",
            "-fno-tree-vectorize",
            "-w",
            "-std=c++17",
            "-shared",
            "-fPIC",
            "-I",
            folder,
            *defines,
        ]
        command = ["g++", *flags, "kernel.cpp", "-o", "kernel.so"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
        return Path(folder, "kernel.so").read_bytes(), ""


class Status(IntEnum):
    SUCCESS = 0
    INVALID_VALUE = 1
    OUT_OF_MEMORY = 2
    INVALID_CONTEXT = 201
    INVALID_HANDLE = 400
    ILLEGAL_ADDRESS = 700


class FakeDriver:
    """The functions of `cuda.bindings.driver` that `flexgen.backends.cuda.driver` calls.

    Parameters
    ----------
    cards : int
        How many there are.
    memory : int
        Bytes that each has.
    """

    def __init__(
        self, cards: int = 2, memory: int = 2**28, capability: tuple[int, int] = (9, 0)
    ) -> None:
        self.cards = cards
        self.free = [memory] * cards
        self.capability = capability
        self.contexts: list[int] = []
        self.streams: dict[int, list[Callable[[], None]]] = {0: []}
        self.blocks: dict[int, tuple[int, np.ndarray]] = {}  # card and memory by address
        self.kernels: dict[int, Any] = {}
        self.events: dict[int, tuple[int, int]] = {}
        self.done: dict[int, int] = {}
        self.launched: list[tuple[int, int]] = []  # card and stream

    def new_stream(self) -> SimpleNamespace:
        """A stream as CuPy has them."""
        handle = 0x5000 + 16 * len(self.streams)
        self.streams[handle] = []
        return SimpleNamespace(ptr=handle)

    # --- the functions of the driver
    def cuGetErrorString(self, status: int) -> Any:
        return Status.SUCCESS, Status(status).name.lower().replace("_", " ").encode()

    def cuInit(self, flags: int) -> Any:
        return (Status.SUCCESS if flags == 0 else Status.INVALID_VALUE,)

    def cuDeviceGetCount(self) -> Any:
        return Status.SUCCESS, self.cards

    def cuDeviceGet(self, ordinal: int) -> Any:
        return Status.SUCCESS, ordinal

    def cuDeviceGetName(self, size: int, device: int) -> Any:
        return Status.SUCCESS, b"a card on the CPU".ljust(size, b"\0")

    def cuDeviceGetAttribute(self, key: int, device: int) -> Any:
        return Status.SUCCESS, self.capability[key - 75]

    def cuDevicePrimaryCtxRetain(self, device: int) -> Any:
        return Status.SUCCESS, device

    def cuCtxPushCurrent(self, context: int) -> Any:
        self.contexts.append(context)
        return (Status.SUCCESS,)

    def cuCtxPopCurrent(self) -> Any:
        return Status.SUCCESS, self.contexts.pop()

    def cuModuleLoadData(self, image: bytes) -> Any:
        with tempfile.NamedTemporaryFile(suffix=".so") as file:
            file.write(image)
            file.flush()
            return Status.SUCCESS, ctypes.CDLL(file.name)

    def cuModuleGetFunction(self, module: Any, name: bytes) -> Any:
        assert name.startswith(b"k_") and hasattr(module, name.decode()), name
        module.bind_arguments.restype = ctypes.c_void_p
        return Status.SUCCESS, module

    def cuMemAllocAsync(self, size: int, stream: int) -> Any:
        card = self.contexts[-1]
        if size > self.free[card]:
            return Status.OUT_OF_MEMORY, 0
        if stream not in self.streams:
            return Status.INVALID_HANDLE, 0
        self.free[card] -= size
        block = np.full(size, 0xA5, np.uint8)
        self.blocks[block.ctypes.data] = card, block
        return Status.SUCCESS, block.ctypes.data

    def cuMemFreeAsync(self, address: int, stream: int) -> Any:
        def give_back() -> None:
            card, block = self.blocks.pop(address)
            block[:] = 0x5A
            self.free[card] += block.size

        return (
            self._queue(stream, give_back) if address in self.blocks else (Status.INVALID_VALUE,)
        )

    def cuMemsetD8Async(self, address: int, value: int, size: int, stream: int) -> Any:
        return self._queue(stream, lambda: ctypes.memset(address, value, size), (address, size))

    def cuMemcpyDtoHAsync(self, to: int, address: int, size: int, stream: int) -> Any:
        return self._queue(stream, lambda: ctypes.memmove(to, address, size), (address, size))

    def cuMemcpyHtoDAsync(self, address: int, source: int, size: int, stream: int) -> Any:
        return self._queue(stream, lambda: ctypes.memmove(address, source, size), (address, size))

    def cuLaunchKernel(self, kernel: Any, *given: Any) -> Any:
        x, y, z, threads, ty, tz, shared, stream, arguments, extra = given
        assert (y, z, ty, tz, shared, extra) == (1, 1, 1, 1, 0, 0)
        call = ctypes.c_void_p(kernel.bind_arguments(ctypes.c_void_p(arguments)))
        self.launched.append((self.contexts[-1], stream))
        return self._queue(stream, lambda: kernel.run(call, x, threads))

    def cuEventCreate(self, flags: int) -> Any:
        if flags != 2:  # events with times are slower, and no time is read
            return (Status.INVALID_VALUE,)
        self.events[len(self.events)] = 0, 0
        return Status.SUCCESS, len(self.events) - 1

    def cuEventRecord(self, event: int, stream: int) -> Any:
        if stream not in self.streams:
            return (Status.INVALID_HANDLE,)
        self.events[event] = stream, self.done.get(stream, 0) + len(self.streams[stream])
        return (Status.SUCCESS,)

    def cuStreamWaitEvent(self, stream: int, event: int, flags: int) -> Any:
        assert flags == 0
        other, until = self.events[event]
        return self._queue(stream, lambda: self._work(other, until))

    def cuEventDestroy(self, event: int) -> Any:
        return (Status.SUCCESS,)

    def cuStreamSynchronize(self, stream: int) -> Any:
        if stream not in self.streams:
            return (Status.INVALID_HANDLE,)
        self._work(stream, self.done.get(stream, 0) + len(self.streams[stream]))
        return (Status.SUCCESS,)

    def cuPointerGetAttribute(self, key: int, address: int) -> Any:
        found = self._block(address)
        return (Status.INVALID_VALUE, 0) if found is None else (Status.SUCCESS, found[0])

    # --- how they do it
    def _block(self, address: int) -> tuple[int, np.ndarray] | None:
        for begin, found in self.blocks.items():
            if begin <= address < begin + found[1].size:
                return found
        return None

    def _queue(
        self, stream: int, work: Callable[[], Any], span: tuple[int, int] | None = None
    ) -> Any:
        if stream not in self.streams:
            return (Status.INVALID_HANDLE,)
        if span is not None:
            found = self._block(span[0])
            if found is None or span[0] + span[1] > found[1].ctypes.data + found[1].size:
                return (Status.ILLEGAL_ADDRESS,)
        self.streams[stream].append(work)
        return (Status.SUCCESS,)

    def _work(self, stream: int, until: int) -> None:
        """Do the work of a stream up to a number of pieces since its start."""
        while self.done.get(stream, 0) < until:
            work = self.streams[stream].pop(0)
            self.done[stream] = self.done.get(stream, 0) + 1
            work()


class Foreign:
    """An array of another package on the card: the interfaces of a `DeviceArray`, one of them or
    both.
    """

    def __init__(self, x: Any, dlpack: bool = True, **changes: Any) -> None:
        self._x = x
        if dlpack:
            self.__dlpack_device__ = x.__dlpack_device__
            self.__dlpack__ = x.__dlpack__
        else:
            self.__cuda_array_interface__ = x.__cuda_array_interface__ | changes
