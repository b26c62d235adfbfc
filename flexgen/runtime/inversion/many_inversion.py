"""Inverse dynamics of many problems on all cores: `ManyInverter`, the type of
`Library.invert_many`.

Threads take chunks of problems until none is left; C solves a chunk without the interpreter's
lock, in one workspace for each thread. Which thread solves a problem, and with which others, has
no influence on its bits.
"""

from __future__ import annotations

import ctypes
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np

from flexgen.base.calls.progress import Choice, Progress, reporting
from flexgen.base.checks.counts import count_of, show_value
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of
from flexgen.runtime.inversion.inversion_arguments import (
    array_of,
    check_bounds,
    parameters_of,
    pointer,
    pointers,
)
from flexgen.runtime.inversion.path_inversion import RESULTS, Inverter
from flexgen.runtime.options import SolverOptions
from flexgen.runtime.structs import failure_of, struct_of

CHUNK = 0.05  # s: time of a chunk of problems; Ctrl-C waits for the end of those under way
POLL = 0.1  # s: from one message of progress to the next
WORKERS = 1024  # threads, at most
_FOR_GROWTH = ("q_a", "v_a", "q_m", "v_m", "tau_m")
_NOT_SOLVED = np.iinfo(np.intc).min  # in the place of a status


@dataclass(frozen=True)
class Inversions:
    """Results of many problems, or of a chunk of them; N = n_pre + n + n_post of the options.

    Parameters
    ----------
    status : ndarray (problems,)
        Of each problem, as in C: 0 success, negative an error, positive a warning; `sentence`
        explains one.
    q_a, v_a, a_a, tau_g, q_m, v_m, tau_m : ndarray (problems, N, ...) or None
        As in the result of `Library.invert`; None where it is not among the outputs, NaN where the
        status is negative. Where a motion has ``settled``, all samples after it are those of the
        equilibrium.
    residual, residual_at_samples, kinematic_mismatch, growth, torque_error : ndarray (problems,)
        As in the result of `Library.invert`.
    iterations, intervals, n_post : ndarray (problems,)
        The same.
    n_pre : int
        Samples before the path.
    period : float
        Time between two samples [s].
    first : int
        Number of the first problem, where these are those of a chunk.
    reduced : ndarray (problems, ...) or None
        What the function ``reduce`` of the options returned.
    """

    status: np.ndarray
    residual: np.ndarray
    residual_at_samples: np.ndarray
    kinematic_mismatch: np.ndarray
    growth: np.ndarray
    iterations: np.ndarray
    intervals: np.ndarray
    n_post: np.ndarray
    n_pre: int
    period: float
    q_a: np.ndarray | None = None
    v_a: np.ndarray | None = None
    a_a: np.ndarray | None = None
    tau_g: np.ndarray | None = None
    q_m: np.ndarray | None = None
    v_m: np.ndarray | None = None
    tau_m: np.ndarray | None = None
    torque_error: np.ndarray | None = None
    first: int = 0
    reduced: np.ndarray | None = None
    sentences: Mapping[int, str] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.status)

    def __repr__(self) -> str:
        counts = ", ".join(f"{number} {text}" for text, number in self.counts().items())
        return f"<Inversions: {len(self)} problems{': ' * bool(counts)}{counts}>"

    @property
    def converged(self) -> np.ndarray:
        """Which problems have the status 0: see ``converged`` of the result of
        `Library.invert`.
        """
        return self.status == 0

    def sentence(self, problem: int) -> str:
        """Meaning of the status of a problem."""
        status = int(self.status[problem])
        return self.sentences.get(status, f"unknown status {status}")

    def counts(self) -> dict[str, int]:
        """Number of problems with each status, by its sentence."""
        found = Counter(self.status.tolist())
        return {
            self.sentences.get(status, f"unknown status {status}"): number
            for status, number in found.items()
        }


@checked_class
@dataclass(frozen=True)
class InversionOptions(SolverOptions):
    """Options of `Library.invert_many`.

    Parameters
    ----------
    n_pre, n_post, samples_per_interval, tolerance, hold, delay, settled, growth
        As of `Library.invert`; the same for all problems.
    force : array (problems, n, 3 n_y) or (n, 3 n_y), optional
        Force on the output, as of `Library.invert`, with as many axes as ``y``; of a library with
        the part ``"force"``.
    workers : int, optional
        Threads; default: one for each core that this process may use.
    reduce : callable, optional
        A function of a chunk of results, an `Inversions`, that returns an array with one row for
        each problem of it. Then only these rows are kept, as ``reduced``, and a million problems
        need little memory. The workers call it, several of them at the same time; sizes and order
        of chunks are not fixed.
    progress : callable, bool or None
        Takes messages of progress; True or False: show them or not; default: on a terminal and in
        a notebook.

    Examples
    --------
    >>> flexgen.InversionOptions(n_pre=100, n_post=100, samples_per_interval=5).workers is None
    True
    """

    force: Any = None
    workers: int | None = None
    reduce: Callable[[Inversions], Any] | None = None
    progress: Choice = None


@dataclass(frozen=True)
class _Job:
    """Inputs of C for all problems, as checked arrays."""

    problems: int
    samples: Mapping[str, np.ndarray]
    parameters: np.ndarray
    q_start: np.ndarray
    period: float
    own: Mapping[str, bool]  # which inputs differ from problem to problem
    options: Mapping[str, Any]
    outputs: tuple[str, ...]


class ManyInverter:
    """``library.invert_many(y, dy, ddy, period=..., q_start=..., parameters=...)``:
    `Library.invert` for many problems.

    It may be called from several threads.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow", parameters=["payload"]).directory)
    >>> path = flexgen.plan("elbow", "line")
    >>> y, dy, ddy = path.sample([0.005 * k for k in range(201)]).y.transpose(2, 0, 1)[:3]
    >>> # mass [kg] and its place [m]
    >>> loads = library.parameters + [[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]]
    >>> many = library.invert_many(
    ...     y, dy, ddy, period=0.005, q_start=path.q_start, parameters=loads
    ... )
    >>> many.tau_m.shape, many.status.tolist()
    ((2, 201, 2), [0, 0])
    """

    def __init__(self, inverter: Inverter) -> None:
        self._inverter = inverter

    def __repr__(self) -> str:
        known = ", parameters=None" * bool(self._inverter._parameters.size)
        return (
            f"invert_many(y, dy, ddy, *, period, q_start{known}, outputs=('tau_m',), options=None)"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._inverter,)

    @checked_types(own=("outputs",))
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
        """Motion and torques of many problems: paths, run-time parameters and starts that differ
        or are shared.

        Each problem has the bits of `Library.invert` and its own status: one that fails affects no
        other.

        Parameters
        ----------
        y : array (problems, n, n_t), or (n, n_t) for all problems
            Outputs at the samples, as of `Library.invert`.
        dy, ddy : array (problems, n, n_y) or (n, n_y)
            Their first and second time derivatives, with as many axes as ``y``.
        period : float
            Time between two samples [s].
        q_start : array (problems, n_a) or (n_a,)
            Initial guess of the arm's equilibrium at the first sample [rad, m].
        parameters : array (problems, n_p) or (n_p,), optional
            Run-time parameters, where the library has any; default: those of the model file.
        outputs : sequence of str
            Which of ``q_a``, ``v_a``, ``a_a``, ``tau_g``, ``q_m``, ``v_m``, ``tau_m`` are kept for
            each problem.
        options : InversionOptions, optional

        Returns
        -------
        Inversions

        Raises
        ------
        ArgumentError
            An argument has another shape or is out of range. Numbers that are not finite are a
            status of their problem.
        """
        inverter = self._inverter
        chosen = options or InversionOptions()
        inverter._refuse_closed()
        job = self._job((y, dy, ddy), period, q_start, parameters, outputs, chosen)
        workers = (
            count_cores()
            if chosen.workers is None
            else count_of("invert_many, workers", chosen.workers, WORKERS)
        )
        found = _Collected(inverter, job, chosen.reduce)
        with reporting(chosen.progress, "invert_many") as progress:
            _in_threads(found.solve, job.problems, workers, progress)
        return found.result()

    def _job(
        self,
        path: Any,
        period: Any,
        q_start: Any,
        parameters: Any,
        outputs: Any,
        options: InversionOptions,
    ) -> _Job:
        """The arguments of many problems, checked: path, start and parameters may each be the same
        for all or differ, with one number of problems.
        """
        inverter = self._inverter
        name = "invert_many"
        real = self._inverter._real
        sizes = inverter._sizes
        given = inverter._samples(path, options.force, name)
        y = given["y"]
        starts = _rows(name, "q_start", q_start, sizes["n_a"], real)
        count = inverter._parameters.size
        many = parameters is not None and count > 0
        values = (
            _rows(name, "parameters", parameters, count, real)
            if many
            else parameters_of(name, parameters, inverter._parameters)
        )
        check_bounds(name, values, inverter._rows if many else ())
        own = {
            "own_path": y.ndim == 3,
            "own_parameters": values.ndim == 2,
            "own_q_start": starts.ndim == 2,
        }
        lengths = {
            key: len(x) for key, x in zip(own, (y, values, starts), strict=True) if own[key]
        }
        if len(set(lengths.values())) != 1:
            words = ", ".join(
                f"{number} of {key.removeprefix('own_')}" for key, number in lengths.items()
            )
            raise ArgumentError(
                f"{name}: given {words or 'one path, one q_start and one set of parameters'}, "
                "expected the same number of problems in at least one of y (problems, n, n_t), "
                "parameters (problems, n_p) and q_start (problems, "
                f"n_a){'' if lengths else '; for one problem call invert'}"
            )
        period = number_of(name, "period", period)
        tolerance = options.tolerance
        if not 0 < period < 1e6:
            raise ArgumentError(
                f"{name}, period: given {period:g}, expected a number above 0, below 1e6 s"
            )
        if tolerance is not None and not 0 < tolerance < 1:
            raise ArgumentError(
                f"{name}, tolerance: given {tolerance:g}, expected a number from 0 to 1"
            )
        if isinstance(outputs, str) or not set(outputs) <= set(RESULTS):
            raise ArgumentError(
                f"{name}, outputs: given {show_value(outputs)}, expected some of "
                f"{', '.join(RESULTS)}"
            )
        kept = tuple(key for key in RESULTS if key in outputs)
        return _Job(
            next(iter(lengths.values())),
            given,
            values,
            starts,
            period,
            own,
            inverter._members(options),
            kept,
        )


class _Collected:
    """Calls C for chunks of problems, and keeps what is asked for."""

    def __init__(
        self, inverter: Inverter, job: _Job, reduce: Callable[[Inversions], Any] | None
    ) -> None:
        if inverter.entry_many is None:
            raise ArgumentError(
                "invert_many: given a library without invert_many, expected one that is "
                "generated again"
            )
        self._inverter = inverter
        self._entry = inverter.entry_many
        self._job = job
        self._reduce = reduce
        structs = self._inverter.structs
        n = job.samples["y"].shape[-2]
        self._options = struct_of(structs["inversion_options"], **job.options)
        counts = {key: job.options[key] for key in ("n_pre", "n_post", "samples_per_interval")}
        self._work = self._inverter._work_size(n, (ctypes.byref(self._options),), counts)
        self._total = n + counts["n_pre"] + counts["n_post"]
        self._status = np.full(job.problems, _NOT_SOLVED, np.intc)
        self._info = np.zeros(job.problems, np.dtype(structs["invert_info"]))
        self._kept = {} if reduce else self._arrays(job.outputs, job.problems)
        self._reduced: np.ndarray | None = None
        self._lock = Lock()

    def _arrays(self, names: Sequence[str], problems: int) -> dict[str, np.ndarray]:
        """Memory for these results of so many problems."""
        widths = self._inverter._widths()
        try:
            return {
                key: np.empty((problems, self._total, widths[key]), self._inverter._real)
                for key in names
            }
        except (MemoryError, ValueError) as error:
            raise ArgumentError(
                f"invert_many: given {problems} problems of {self._total} samples, whose "
                f"results do not fit in memory ({error}); expected fewer outputs, or the option "
                "reduce"
            ) from error

    def solve(self, begin: int, end: int) -> None:
        """Solve the problems from ``begin`` to ``end``, by one call of C; an error that concerns
        all of them is raised, others are kept as status. Called in threads.
        """
        inverter = self._inverter
        job = self._job
        structs = self._inverter.structs
        count = end - begin
        names = {
            *(job.outputs if self._reduce else ()),
            *(_FOR_GROWTH if job.options["growth"] else ()),
        }
        arrays = self._arrays(
            [key for key in RESULTS if key in names and key not in self._kept], count
        )
        arrays |= {key: x[begin:end] for key, x in self._kept.items()}
        part = {key: x[begin:end] if job.own["own_path"] else x for key, x in job.samples.items()}
        values = job.parameters[begin:end] if job.own["own_parameters"] else job.parameters
        starts = job.q_start[begin:end] if job.own["own_q_start"] else job.q_start
        problems = structs["problems"](count=count, **{key: int(x) for key, x in job.own.items()})
        samples = struct_of(structs["samples"], n=part["y"].shape[-2], period=job.period, **part)
        motion = struct_of(structs["motion"], **arrays)
        work = inverter._workspace(self._work)
        status = self._entry(
            ctypes.byref(problems),
            ctypes.byref(samples),
            *pointers(values),
            pointer(starts),
            ctypes.byref(self._options),
            ctypes.byref(motion),
            pointer(self._info[begin:end]),
            pointer(self._status[begin:end]),
            pointer(work),
            ctypes.c_int64(work.size),
        )
        inverter._pool.append(work)
        if count and self._status[begin] == _NOT_SOLVED:
            exception, text = failure_of(inverter._failures, int(status))
            raise exception(f"invert_many: {text}")
        if self._reduce is not None:
            self._keep(self._reduce(self._results(begin, end, arrays)), begin, end)

    def _keep(self, rows: Any, begin: int, end: int) -> None:
        """Keep the rows of ``reduce`` for a chunk of problems."""
        try:
            array = np.asarray(rows)
            if array.ndim < 1 or len(array) != end - begin:
                raise ValueError(f"shape {array.shape}")
            with self._lock:
                if self._reduced is None:
                    self._reduced = np.empty((self._job.problems, *array.shape[1:]), array.dtype)
            if self._reduced.shape[1:] != array.shape[1:]:
                raise ValueError(
                    f"shape {array.shape} after {self._reduced.shape[1:]} for a problem"
                )
        except (ValueError, TypeError) as error:
            raise ArgumentError(
                f"invert_many, reduce: given a function that returned {error}, expected an "
                f"array with one row of the same shape for each of its {end - begin} problems"
            ) from error
        self._reduced[begin:end] = array

    def _results(self, begin: int, end: int, arrays: Mapping[str, np.ndarray]) -> Inversions:
        """The results of the problems from ``begin`` to ``end``, with these arrays of motion and
        torques.
        """
        info = self._info[begin:end]
        job = self._job
        return Inversions(
            status=self._status[begin:end],
            **{key: info[key] for key in info.dtype.names or ()},
            n_pre=job.options["n_pre"],
            period=job.period,
            **{key: x for key, x in arrays.items() if key in job.outputs},
            first=begin,
            reduced=self._reduced,
            sentences=self._inverter._interface.sentences,
        )

    def result(self) -> Inversions:
        """The results of all problems."""
        return self._results(0, self._job.problems, self._kept)


def _rows(function: str, name: str, x: Any, width: int, real: np.dtype[Any]) -> np.ndarray:
    """An array of this width: one row for all problems, or one for each."""
    array = array_of(function, name, x, None, real)
    if array.ndim not in (1, 2) or array.shape[-1] != width:
        raise ArgumentError(
            f"{function}, {name}: given shape {array.shape}, expected ({width},) or (problems, "
            f"{width})"
        )
    return array


def count_cores() -> int:
    """Cores that this process may use."""
    return (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )


def _in_threads(
    solve: Callable[[int, int], None],
    problems: int,
    workers: int,
    progress: Progress | None = None,
) -> None:
    """Call ``solve(begin, end)`` in ``workers`` threads until all problems are solved; an
    exception ends all of them.

    The size of a chunk is doubled until it takes about `CHUNK` [s], and falls at the end, so that
    the threads end together.
    """
    lock = Lock()
    taken = 0
    solved = 0
    stopped = False

    def work() -> None:
        """Take the next problems and solve them until none is left or a thread has stopped all;
        the number taken at once grows until it takes `CHUNK` [s].
        """
        nonlocal taken, solved
        size = 1
        while not stopped:
            with lock:
                begin = taken
                end = taken = min(
                    problems, begin + min(size, -(-(problems - begin) // (2 * workers)))
                )
            if begin == end:
                return
            began = time.perf_counter()
            solve(begin, end)
            spent = time.perf_counter() - began
            size = max(1, min(2 * size, int((end - begin) * CHUNK / max(spent, 1e-9))))
            with lock:
                solved += end - begin

    workers = min(workers, problems)
    with ThreadPoolExecutor(max(workers, 1), "invert_many") as pool:
        try:
            left = {pool.submit(copy_context().run, work) for _ in range(workers)}
            while left:
                done, left = wait(left, POLL, FIRST_EXCEPTION)
                for future in done:
                    future.result()
                if progress is not None and left:
                    progress(f"{solved} of {problems} problems")
        finally:
            stopped = True
