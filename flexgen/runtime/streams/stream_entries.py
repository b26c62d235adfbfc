"""The C functions of streams of a loaded library."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexgen.runtime.inversion.inversion_arguments import Rows
from flexgen.runtime.streams.servo import ServoEntry, servo_entry
from flexgen.runtime.structs import Failures, Interface, closed_error, interface_of


@dataclass(frozen=True)
class StreamEntries:
    """The C functions of streams: size of the memory, start, update, limits, parameters; structs
    and statuses.

    ``name``: of the library; ``model_parameters``: the run-time parameters of the model file;
    ``rows``: of them in the manifest; ``closed``: set where the library is closed.
    """

    name: str

    interface: Interface
    work: Callable[..., int]
    start: Callable[..., int]
    start_moving: Callable[..., int]
    update: Callable[..., int]
    limits: Callable[..., int]
    all_limits: Callable[..., int] | None
    change: Callable[..., int] | None
    model_parameters: np.ndarray
    failures: Failures
    # these entries, found once more where a stream is unpickled
    again: tuple[Callable[..., Any], tuple[Any, ...]]
    push: Callable[..., int] | None = None  # takes forces on the output
    servo: ServoEntry | None = None  # that is sent positions
    rows: Rows = ()
    closed: threading.Event = field(default_factory=threading.Event)

    @property
    def real(self) -> np.dtype[Any]:
        """The type of the library's numbers."""
        return self.model_parameters.dtype

    @property
    def structs(self) -> Mapping[str, type[ctypes.Structure]]:
        """The structs of the interface."""
        return self.interface.structs

    def refuse_closed(self) -> None:
        """ArgumentError where the library is closed."""
        if self.closed.is_set():
            raise closed_error(self.name)


def streams_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Failures,
    again: tuple[Callable[..., Any], tuple[Any, ...]],
    parameters: np.ndarray,
) -> StreamEntries | None:
    """Entry points of a library for streams, found by name; None where the manifest lists none."""
    names = (
        "stream_work",
        "stream_start",
        "stream_start_moving",
        "stream_update",
        "stream_limits",
    )
    offered = {row["name"] for row in manifest.get("c_functions", ())}
    if not set(names) <= offered:
        return None
    work, start, moving, update, limits = (found(f"{manifest['name']}_{name}") for name in names)
    work.restype = ctypes.c_int64
    change = found(f"{manifest['name']}_stream_parameters") if parameters.size else None
    return StreamEntries(
        manifest["name"],
        interface_of(manifest),
        work,
        start,
        moving,
        update,
        limits,
        found(f"{manifest['name']}_stream_all_limits") if "stream_all_limits" in offered else None,
        change,
        parameters,
        failures,
        again,
        found(f"{manifest['name']}_stream_force") if "stream_force" in offered else None,
        servo_entry(manifest, found, failures, parameters.dtype),
        manifest.get("parameters", ()),
    )
