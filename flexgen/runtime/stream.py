"""Inverse dynamics of a loaded library on a moving horizon: `Stream`, which ``Library.stream`` begins."""

from __future__ import annotations

import copy
import ctypes
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError, BuildError, FlexgenError
from flexgen.runtime.files import AGAIN
from flexgen.runtime.path_inversion import array_of, number_of, pointer, whole_of

REPORT = 7  # numbers
INEXACT = 1  # a status
_RESULTS = ("q_a", "v_a", "tau_g", "q_m", "v_m", "tau_m")


@dataclass(frozen=True)
class StreamEntries:
    """What C offers for streams: size of the memory, start, update, limits; and what their statuses mean."""

    work: Callable[..., int]
    start: Callable[..., int]
    update: Callable[..., int]
    limits: Callable[..., int]
    failures: Mapping[int, tuple[type[FlexgenError], str]]
    again: tuple[Callable[..., Any], tuple[Any, ...]]  # these entries, found once more where a stream is unpickled


@dataclass(frozen=True)
class Interval:
    """Motion and torques of the interval that begins now, at ``parts`` samples: its start and those after it.

    Parameters
    ----------
    q_a, v_a : ndarray (parts, n_a)
        Motion of the arm [rad, m; per s].
    tau_g : ndarray (parts, n_g)
        Torques of the gears, arm side [N m, N].
    q_m, v_m, tau_m : ndarray (parts, n_m)
        Motor angles [rad], speeds [rad/s] and torques [N m], motor side.
    residual : float
        Of the equations without motor, relative to their torques at rest.
    uneven : float
        How far positions and speeds of joints and motors are from the integrals of speeds and accelerations, by
        differences at the samples, relative to the largest of these within about a horizon; or a hundred times the step
        of a motor torque from where the interval before left it, relative to its largest.
    exact : bool
        Whether ``residual`` is within the tolerance, and ``uneven`` within 2 %.
    limited : bool
        Whether limits of the motors keep the output off its path in this interval, or are passed, see `Stream.limit`.
    off_m, off_rad : float
        How far they bend the path [m, rad].
    """

    q_a: np.ndarray
    v_a: np.ndarray
    tau_g: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    tau_m: np.ndarray
    residual: float
    uneven: float
    exact: bool
    limited: bool = False
    off_m: float = 0.0
    off_rad: float = 0.0


class Stream:
    """Inverse dynamics on a moving horizon: every update takes a sample of the path and gives torques for now.

    The sample is reached ``intervals`` updates later: by so much the path has to be known ahead. A sample that is
    refused changes nothing. A copy is another stream with the same past; pickled, it goes on where it was. Two threads
    must not update one stream at the same time.

    Made by ``Library.stream``.

    Parameters
    ----------
    intervals, parts : int
        Intervals of the horizon; samples of the results in each.
    period : float
        From update to update [s].
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        entries: StreamEntries,
        place: Any,
        q_start: Any,
        *,
        period: float,
        intervals: int,
        parts: int,
        tolerance: float,
    ) -> None:
        self.intervals, self.parts = whole_of("stream", "intervals", intervals), whole_of("stream", "parts", parts)
        self.period = number_of("stream", "period", period)
        self._sizes, self._entries = dict(sizes), entries
        counts = ctypes.c_int(self.intervals), ctypes.c_int(self.parts)
        size = int(entries.work(*counts))
        if size < 0:
            raise ArgumentError(
                f"stream: given {self.intervals} intervals and {self.parts} parts, expected 1 to 10000 and 1 to 1000"
            )
        at = array_of("stream", "place", place, (self._sizes["n_t"],))
        q = array_of("stream", "q_start", q_start, (self._sizes["n_a"],))
        self._memory = np.zeros(size)
        status = entries.start(
            pointer(self._memory),
            ctypes.c_int64(size),
            *counts,
            ctypes.c_double(self.period),
            ctypes.c_double(number_of("stream", "tolerance", tolerance)),
            pointer(at),
            pointer(q),
        )
        self._refuse(int(status))
        self._bind()

    def _bind(self) -> None:
        """Memory of the arguments of an update, and their addresses."""
        n_a, n_g, n_m = (self._sizes[key] for key in ("n_a", "n_g", "n_m"))
        self._inputs = [np.zeros(self._sizes[key]) for key in ("n_t", "n_y", "n_y")]
        self._outputs = [np.zeros((self.parts, n)) for n in (n_a, n_a, n_g, n_m, n_m, n_m)]
        self._report = np.zeros(REPORT)
        bound = (self._memory, *self._inputs, *self._outputs, self._report)
        self._arguments = tuple(pointer(x) for x in bound)
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        return f"<Stream of {self.intervals} intervals of {self.period:g} s, {self.parts} samples each>"

    def __copy__(self) -> Stream:
        other = object.__new__(type(self))
        other.intervals, other.parts, other.period = self.intervals, self.parts, self.period
        other._sizes, other._entries, other._memory = self._sizes, self._entries, self._memory.copy()
        other._bind()
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Stream:
        return copy.copy(self)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        made, which = self._entries.again
        return stream_again, (made, which, self._sizes, self.intervals, self.parts, self.period, self._memory)

    def update(self, place: Any, rate: Any, rate2: Any) -> Interval:
        """Take the next sample of the path, give the interval that begins now.

        Parameters
        ----------
        place : array (n_t,)
            Output at the end of the horizon; for a pose the position [m] and the rotation matrix by columns.
        rate, rate2 : array (n_y,)
            Its first and second derivative; for a pose linear and angular velocity, world axes, and their derivatives.

        Returns
        -------
        Interval

        Raises
        ------
        ArgumentError
            Where the sample is not finite, no rotation, or too far from the one before: refused, nothing has changed;
            or where the stream has failed.
        SolverError
            Where the sample cannot be reached (nothing has changed), or the solver failed: then the stream is over.
        """
        for name, memory, x in zip(("place", "rate", "rate2"), self._inputs, (place, rate, rate2), strict=True):
            if type(x) is np.ndarray and x.shape == memory.shape and x.dtype == memory.dtype:
                continue
            array_of("stream", name, x, memory.shape)
        if not self._lock.acquire(blocking=False):
            raise ArgumentError("stream: given an update while another is under way, expected one after the other")
        try:
            for memory, x in zip(self._inputs, (place, rate, rate2), strict=True):
                memory[...] = x
            status = int(self._entries.update(*self._arguments))
            self._refuse(status)
            results = [x.copy() for x in self._outputs]
            told = self._report.copy()
        finally:
            self._lock.release()
        named = dict(zip(_RESULTS, results, strict=True))
        return Interval(
            **named,
            residual=float(told[0]),
            uneven=float(told[1]),
            exact=status != INEXACT,
            limited=told[6] > 0.0,  # INEXACT hides LIMITED, this does not
            off_m=float(told[4]),
            off_rad=float(told[5]),
        )

    def limit(self, *, torque: Any = None, speed: Any = None, bend: float = 0.05) -> None:
        """Let the motors keep bounds from the next update on: where they would be passed, the path ahead is bent.

        It is bent only where the motion that is under way need not know of it yet: some intervals ahead, as far as the
        unstable zeros look. The horizon must have half as many beyond them, better as many, and be long enough to brake
        in: bends are as quick as it is short. Compare torques and speeds with the bounds.

        Parameters
        ----------
        torque, speed : array (n_m,), optional
            Largest torques [N m] and speeds [rad/s] of the motors; None, or infinity, where there is no bound.
        bend : float
            Largest deviation of each output [m, rad]: what would need more passes the bounds.

        Raises
        ------
        ArgumentError
            Where a bound is not positive, the horizon is too short, or the stream has failed.
        """
        n_m = self._sizes["n_m"]
        both = [
            array_of("stream", name, np.full(n_m, np.inf) if x is None else x, (n_m,))
            for name, x in (("torque", torque), ("speed", speed))
        ]
        if not self._lock.acquire(blocking=False):
            raise ArgumentError("stream: given limits while an update is under way, expected one after the other")
        try:
            most = ctypes.c_double(number_of("stream", "bend", bend))
            self._refuse(int(self._entries.limits(pointer(self._memory), *(pointer(x) for x in both), most)))
        finally:
            self._lock.release()

    def _refuse(self, status: int) -> None:
        """Raise what a negative status means."""
        if status < 0:
            exception, text = self._entries.failures.get(status, (BuildError, f"unknown status {status}; {AGAIN}"))
            raise exception(f"stream: {text}")


def streams_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Mapping[int, tuple[type[FlexgenError], str]],
    again: tuple[Callable[..., Any], tuple[Any, ...]],
) -> StreamEntries | None:
    """What a library offers for streams, whose entry points are found by name; None where the manifest lists none."""
    names = ("stream_work", "stream_start", "stream_update", "stream_limits")
    if not set(names) <= {core["name"] for core in manifest.get("cores", ())}:
        return None
    work, start, update, limits = (found(f"{manifest['name']}_{name}") for name in names)
    work.restype = ctypes.c_int64
    return StreamEntries(work, start, update, limits, failures, again)


def stream_again(
    made: Callable[..., StreamEntries],
    which: tuple[Any, ...],
    sizes: dict[str, int],
    intervals: int,
    parts: int,
    period: float,
    memory: np.ndarray,
) -> Stream:
    """The stream that was pickled."""
    stream = object.__new__(Stream)
    stream.intervals, stream.parts, stream.period = intervals, parts, period
    stream._sizes, stream._entries, stream._memory = sizes, made(*which), memory.copy()
    stream._bind()
    return stream
