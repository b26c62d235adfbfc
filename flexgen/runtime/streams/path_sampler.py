"""Samples of planned paths by the C of a loaded library: `PathSampler`, the type of
`Library.path_sampler`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of
from flexgen.runtime.inversion.inversion_arguments import (
    array_of,
    parameters_of,
    pointer,
    pointers,
)
from flexgen.runtime.structs import Failures, closed_error, failure_of


@dataclass(frozen=True)
class SamplerEntries:
    """The C functions of the path sampler, and what they need; ``closed``: set when the library is
    closed.
    """

    name: str
    sizes: Mapping[str, int]
    start: Callable[..., int]
    sample: Callable[..., int]
    work: int
    model_parameters: np.ndarray
    failures: Failures
    again: tuple[Callable[..., Any], tuple[Any, ...]]
    closed: Event = field(default_factory=Event)

    def refuse_closed(self) -> None:
        """ArgumentError where the library is closed."""
        if self.closed.is_set():
            raise closed_error(self.name)


class PathSampler:
    """A planned path in C, ``sampler(t)``: output, first and second derivative at an instant.

    Attributes
    ----------
    duration : float [s]
    q_start : ndarray (n_a,)
        Arm coordinates at the start, without deflections: the initial guess of a stream.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow").directory)
    >>> sampler = library.path_sampler(flexgen.plan("elbow", "line").table())
    >>> y, dy, ddy = sampler(0.5)
    >>> y.round(3)  # m
    array([1.647, 0.63 ])
    """

    def __init__(self, entries: SamplerEntries, table: Any, parameters: Any = None) -> None:
        entries.refuse_closed()
        self._entries = entries
        real = entries.model_parameters.dtype
        function = "path_sampler"
        size = np.size(table) if np.ndim(table) == 1 else -1
        self._table = array_of(function, "table", table, (size,), real)
        self._parameters = parameters_of(function, parameters, entries.model_parameters)
        duration = np.zeros(1, real)
        self.q_start = np.zeros(entries.sizes["n_a"], real)
        self._refuse(entries.start(*self._given, pointer(duration), pointer(self.q_start)))
        self.duration = float(duration[0])

    def __repr__(self) -> str:
        return f"<PathSampler {self._entries.name}: {self.duration:.4g} s>"

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        self._entries.refuse_closed()
        made, which = self._entries.again
        return sampler_again, (
            made,
            which,
            self._table,
            self._parameters if self._parameters.size else None,
        )

    @property
    def _given(self) -> tuple[Any, ...]:
        return pointer(self._table), ctypes.c_int64(self._table.size)

    def __call__(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The sample at an instant.

        Parameters
        ----------
        t : float
            Time since the start of the path [s].

        Returns
        -------
        y : ndarray (n_t,)
            Output; for a pose the position, then the rotation matrix by columns.
        dy, ddy : ndarray (n_y,)
            Its time derivatives; for a pose linear and angular, world axes.
        """
        entries = self._entries
        sizes = self._entries.sizes
        real = self._table.dtype
        entries.refuse_closed()
        t = number_of("path_sampler", "t", t)
        out = [np.empty(sizes[size], real) for size in ("n_t", "n_y", "n_y")]
        work = np.empty(entries.work, real)
        of_real = ctypes.c_double if real == np.float64 else ctypes.c_float
        self._refuse(
            entries.sample(
                *self._given,
                *pointers(self._parameters),
                of_real(t),
                *(pointer(x) for x in out),
                pointer(work),
                ctypes.c_int64(work.size),
            )
        )
        return out[0], out[1], out[2]

    def _refuse(self, status: int) -> None:
        """Raise what a negative status means."""
        if status < 0:
            exception, text = failure_of(self._entries.failures, status)
            if exception is ArgumentError:
                text += "; the table must be that of a path of this model (Path.table())"
            raise exception(f"path_sampler: {text}")


def samplers_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Failures,
    again: tuple[Callable[..., Any], tuple[Any, ...]],
    parameters: np.ndarray,
) -> SamplerEntries | None:
    """Entry points of a library for samples of paths; None where the manifest lists none."""
    names = ("path_start", "path_sample", "path_work")
    if not set(names) <= {row["name"] for row in manifest.get("c_functions", ())}:
        return None
    start, sample, work = (found(f"{manifest['name']}_{name}") for name in names)
    work.restype = ctypes.c_int64
    return SamplerEntries(
        manifest["name"],
        manifest["sizes"],
        start,
        sample,
        int(work()),
        parameters,
        failures,
        again,
    )


def sampler_again(
    made: Callable[..., SamplerEntries], which: tuple[Any, ...], table: np.ndarray, parameters: Any
) -> PathSampler:
    """The sampler that was pickled."""
    return PathSampler(made(*which), table, parameters)
