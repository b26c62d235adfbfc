"""Inverse dynamics of many problems on the GPU: `CudaManyInverter`, a thread a problem."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np

from flexgen.backends.cuda.arrays import DeviceArray, Given, stream_handle
from flexgen.backends.cuda.driver import Card
from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of
from flexgen.runtime.inversion.many_inversion import InversionOptions, Inversions
from flexgen.runtime.inversion.path_inversion import RESULTS, Inverter
from flexgen.runtime.structs import struct_of

LARGEST = 300_000  # bytes of workspace of a problem: larger ones need several threads a problem
_BLOCK = 32  # threads: problems are few and long, and spread over the card


def workspace_of(reals: int) -> int:
    """Reals of the local array for a workspace: at most an eighth more, so that few sizes are
    compiled.
    """
    step = max(1, 2 ** max(0, reals.bit_length() - 4))
    return -(-reals // step) * step


class CudaManyInverter:
    """``library.invert_many(...)`` as on the CPU, on device arrays in the order of C: a thread
    solves a problem.

    The results of the motion stay on the card; statuses and what the solver reports are on the
    CPU, so that a call waits for its end.

    Parameters
    ----------
    inverter : Inverter
        The same on the CPU, for one problem.
    load : callable
        The kernel for so many reals of workspace.
    """

    def __init__(self, inverter: Inverter, card: Card, load: Callable[[int], Any]) -> None:
        """``load``: compiles the kernel for a workspace of this many reals, at the first call that
        needs it.
        """
        self._inverter = inverter
        self._card = card
        self._load = load
        self._stream: Any = None
        self._kernels: dict[int, Any] = {}
        self._lock = Lock()

    def __repr__(self) -> str:
        known = ", parameters=None" * bool(self._inverter._parameters.size)
        return (
            f"invert_many(y, dy, ddy, *, period, q_start{known}, outputs=('tau_m',), options=None)"
        )

    def on(self, stream: Any) -> CudaManyInverter:
        """Copy on a stream of the caller; default: the default stream."""
        stream_handle("invert_many", stream)
        made = copy(self)
        made._stream = stream
        return made

    def __call__(
        self,
        y: Any,
        dy: Any,
        ddy: Any,
        *,
        period: float,
        q_start: Any,
        parameters: Any = None,
        outputs: Sequence[str] = ("tau_m",),
        options: InversionOptions | None = None,
    ) -> Inversions:
        """Motion and torques of many problems: as `Library.invert_many` on the CPU."""
        chosen = options or InversionOptions()
        handle = stream_handle("invert_many", self._stream)
        self._inverter._refuse_closed()
        _refuse_options(chosen)
        period = number_of("invert_many, period", "period", period)
        if not 0 < period < 1e6:
            raise ArgumentError(
                f"invert_many, period: given {period:g}, expected a number above 0, below 1e6 s"
            )
        if isinstance(outputs, str) or not set(outputs) <= set(RESULTS):
            raise ArgumentError(
                f"invert_many, outputs: given {show_value(outputs)}, expected some of "
                f"{', '.join(RESULTS)}"
            )
        many = self._inverter._parameters.size > 0
        if parameters is not None and not many:
            raise ArgumentError(
                "invert_many, parameters: given to a library without run-time parameters"
            )
        if parameters is None and many:
            parameters = self._on_card(self._inverter._parameters, handle)
        arrays = {"y": y, "dy": dy, "ddy": ddy, "q_start": q_start} | (
            {"parameters": parameters} if many else {}
        )
        given: dict[str, Given] = {}
        try:
            for name, x in arrays.items():
                given[name] = Given(self._card, "invert_many", name, x, handle)
            own, problems = self._demand(given)
            kept = tuple(key for key in RESULTS if key in outputs)
            return self._solve(given, own, problems, period, kept, chosen)
        finally:
            for array in given.values():
                array.release()

    def _on_card(self, x: np.ndarray, stream: int) -> DeviceArray:
        """A copy of an array on the card, in the order of C."""
        values = np.ascontiguousarray(x)
        made = DeviceArray.empty(self._card, values.shape, values.dtype, stream, "C")
        self._card.write(made._address, values.ctypes.data, values.nbytes, stream)
        return made

    def _demand(self, given: Mapping[str, Given]) -> tuple[dict[str, int], int]:
        """Which inputs differ from problem to problem, and how many problems there are; refused
        where they differ.
        """
        sizes = self._inverter._sizes
        real = self._inverter._real
        widths = {
            "y": sizes["n_t"],
            "dy": sizes["n_y"],
            "ddy": sizes["n_y"],
            "q_start": sizes["n_a"],
        }
        axes = {"y": 2, "dy": 2, "ddy": 2, "q_start": 1, "parameters": 1}
        own = {}
        lengths = {}
        for name, x in given.items():
            each = len(x.shape) > axes[name]
            like = (
                given["y"].shape[:-1]
                if name in ("dy", "ddy")
                else ((None,) * each + (None,) * (axes[name] - 1))
            )
            x.demand((*like, widths.get(name, self._inverter._parameters.size)), real, "C")
            if each:
                lengths[name] = x.shape[0]
            own[name] = int(each)
        if len(set(lengths.values())) != 1:
            told = ", ".join(f"{count} of {name}" for name, count in lengths.items())
            raise ArgumentError(
                "invert_many: given "
                f"{told or 'one path, one q_start and one set of parameters'}, expected the "
                "same number of problems in at least one of y (problems, n, n_t), parameters "
                "(problems, n_p) and q_start (problems, n_a)"
            )
        of_path = own["y"]
        of_parameters = own.get("parameters", 0)
        return {
            "own_path": of_path,
            "own_parameters": of_parameters,
            "own_q_start": own["q_start"],
        }, lengths.popitem()[1]

    def _solve(
        self,
        given: Mapping[str, Given],
        own: Mapping[str, int],
        problems: int,
        period: float,
        kept: Sequence[str],
        chosen: InversionOptions,
    ) -> Inversions:
        """Run the kernel with checked arguments."""
        inverter = self._inverter
        card = self._card
        stream = self._stream
        handle = stream_handle("invert_many", stream)
        structs = inverter.structs
        n = given["y"].shape[-2]
        checked = inverter._members(replace(chosen, growth=False))
        options = struct_of(structs["inversion_options"], **checked)
        counts = {key: checked[key] for key in ("n_pre", "n_post", "samples_per_interval")}
        work = workspace_of(inverter._work_size(n, (ctypes.byref(options),), counts))
        if work * inverter._real.itemsize > LARGEST:
            raise ArgumentError(
                f"invert_many: given problems that need {work * inverter._real.itemsize} bytes "
                f"of workspace each, expected at most {LARGEST} on the card; invert them on the "
                "CPU (device='cpu'), or give fewer samples or more samples_per_interval"
            )
        total = n + counts["n_pre"] + counts["n_post"]
        widths = inverter._widths()
        arrays = {
            key: DeviceArray.empty(
                card, (problems, total, widths[key]), inverter._real, stream, "C"
            )
            for key in kept
        }
        info = np.zeros(problems, np.dtype(structs["invert_info"]))
        status = np.zeros(problems, np.intc)
        on_card = [
            DeviceArray.empty(card, (x.nbytes,), np.dtype(np.uint8), stream)
            for x in (info, status)
        ]
        if problems:
            where = {name: x.address for name, x in given.items()}
            arguments = [
                structs["problems"](count=problems, **own),
                structs["samples"](
                    n=n, period=period, y=where["y"], dy=where["dy"], ddy=where["ddy"]
                ),
                *(
                    ctypes.c_void_p(where[name])
                    for name in ("parameters", "q_start")
                    if name in where
                ),
                options,
                structs["motion"](**{key: x._address for key, x in arrays.items()}),
                *(ctypes.c_void_p(x._address) for x in on_card),
            ]
            card.launch(self._kernel(work), problems, arguments, handle, block=_BLOCK)
            for x, to in zip(on_card, (info, status), strict=True):
                card.read(x._address, to.ctypes.data, to.nbytes, handle)
        results: dict[str, Any] = dict(arrays)
        return Inversions(
            status=status,
            **{key: info[key] for key in info.dtype.names or ()},
            n_pre=counts["n_pre"],
            period=period,
            **results,
            sentences=inverter._interface.sentences,
        )

    def _kernel(self, work: int) -> Any:
        """The kernel with so many reals of workspace, compiled where the cache does not have
        it.
        """
        with self._lock:
            if work not in self._kernels:
                self._kernels[work] = self._load(work)
            return self._kernels[work]


def _refuse_options(chosen: InversionOptions) -> None:
    """Refuse what is for the CPU only."""
    for name, usual in (("force", None), ("workers", None), ("reduce", None), ("growth", False)):
        if getattr(chosen, name) is not usual:
            raise ArgumentError(
                f"invert_many, {name}: given {show_value(getattr(chosen, name))} on the card, "
                f"expected {usual}; use it on the CPU (device='cpu')"
            )
