"""Inverse dynamics of a loaded library along a whole path: `Inverter`, which `Library.invert` and `Library.bvp` are.

The path is given by samples of the output and of its first two derivatives; the answer has as many samples more as the
arm moves before the path and after it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError, BuildError, FlexgenError
from flexgen.runtime.arguments import address
from flexgen.runtime.files import AGAIN

REPORTS = {"invert": 5, "bvp": 7}  # numbers that each of them reports
_RESULTS = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")


@dataclass(frozen=True)
class Inversion:
    """Motion and torques that keep the output on its path, at N = lead + n + tail samples.

    Parameters
    ----------
    q_a, v_a, a_a : ndarray (N, n_a)
        Motion of the arm [rad, m; per s; per s^2].
    tau_g : ndarray (N, n_g)
        Torques of the gears, arm side [N m, N].
    q_m, v_m, tau_m : ndarray (N, n_m)
        Motor angles [rad], speeds [rad/s] and torques [N m], motor side.
    lead, tail : int
        Samples before the path and after it.
    period : float
        From sample to sample [s].
    residual, residual_between : float
        Of the equations without motor, relative to their torques at rest: on the mesh, and at the samples.
    iterations, intervals : int
        Steps of the solver; intervals of its mesh.
    uneven : float
        How far positions and speeds are from the integrals of speeds and accelerations, by differences at the samples,
        relative to the largest of these.
    exact : bool
        Whether ``residual_between`` is within the tolerance, and ``uneven`` within 2 %: no more. Where every
        coordinate has a motor there is no residual: motion and its derivatives agree to 2 % at the samples.
    unstable : tuple of int
        Of `Library.bvp`: number of unstable zeros of the elastic coordinates at the start and at the end.
    """

    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    tau_g: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    tau_m: np.ndarray
    lead: int
    tail: int
    period: float
    residual: float
    residual_between: float
    iterations: int
    intervals: int
    uneven: float
    exact: bool
    unstable: tuple[int, ...] = ()

    @property
    def t(self) -> np.ndarray:
        """Instants of the samples [s], zero at the first one of the path."""
        return (np.arange(len(self.q_a)) - self.lead) * self.period


class Inverter:
    """``library.invert(place, rate, rate2, period=..., q_start=...)``, or ``bvp``: inverse dynamics along a whole path.

    It may be called from several threads; every call under way has its own workspace, which is kept for later calls.
    """

    def __init__(
        self,
        name: str,
        sizes: Mapping[str, int],
        entry: Callable[..., int],
        work: Callable[..., int],
        failures: Mapping[int, tuple[type[FlexgenError], str]],
        again: tuple[Callable[..., Any], tuple[Any, ...]],
        function: str = "invert",
    ) -> None:
        self._name, self._sizes, self._entry, self._work, self._failures = name, sizes, entry, work, failures
        self._function = function
        self._pool: list[np.ndarray] = []
        self._again, self._closed = again, False

    def __copy__(self) -> Inverter:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Inverter:
        return self

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        self._refuse_closed()
        return self._again

    def __repr__(self) -> str:
        return f"{self._function}(place, rate, rate2, *, period, q_start, lead=0, tail=0, every=1, tolerance=1e-9)"

    def close(self) -> None:
        """Refuse every call from now on; calls under way end as usual."""
        self._closed, self._pool = True, []

    def _refuse_closed(self) -> None:
        if self._closed:
            raise ArgumentError(f"{self._name}: given a library that was closed, expected an open one; load it again")

    def __call__(
        self,
        place: Any,
        rate: Any,
        rate2: Any,
        *,
        period: float,
        q_start: Any,
        lead: int = 0,
        tail: int = 0,
        every: int = 1,
        tolerance: float = 1e-9,
    ) -> Inversion:
        """Motion and torques that keep the output on a path.

        Parameters
        ----------
        place : array (n, n_t)
            Output at the samples; for a pose the position [m] and the rotation matrix by columns.
        rate, rate2 : array (n, n_y)
            Its first and second derivative; for a pose linear and angular velocity [m/s, rad/s], world axes, and
            their derivatives. Zero at the first and the last sample: the path begins and ends at rest.
        period : float
            From sample to sample [s].
        q_start : array (n_a,)
            Guess of the arm's coordinates at rest at the first sample.
        lead, tail : int
            Samples that the arm may move before the path and after it.
        every : int
            Samples per interval of the solver's mesh.
        tolerance : float
            Of the equations without motor, relative to their torques at rest.

        Returns
        -------
        Inversion

        Raises
        ------
        ArgumentError
            Where an argument has another shape or is not allowed.
        SolverError
            Where the path leaves the workspace or passes a singular pose, or no motion was found.
        """
        self._refuse_closed()
        function = self._function
        n_y, n_t, n_a = (self._sizes[key] for key in ("n_y", "n_t", "n_a"))
        n = len(place) if np.ndim(place) == 2 else -1
        given = {
            "place": array_of(function, "place", place, (n, n_t)),
            "rate": array_of(function, "rate", rate, (n, n_y)),
            "rate2": array_of(function, "rate2", rate2, (n, n_y)),
            "q_start": array_of(function, "q_start", q_start, (n_a,)),
        }
        counts = [
            whole_of(function, key, value)
            for key, value in (("n", n), ("lead", lead), ("tail", tail), ("every", every))
        ]
        numbers = [number_of(function, key, value) for key, value in (("period", period), ("tolerance", tolerance))]
        size = int(self._work(*(ctypes.c_int(x) for x in counts)))
        if size < 0:
            raise ArgumentError(
                f"{function}: given {n} samples, lead {lead}, tail {tail}, every {every}; expected at least 2 samples, "
                "no negative lead or tail, every at least 1, none above a million"
            )
        total = n + counts[1] + counts[2]
        widths = [n_a, n_a, n_a, self._sizes["n_g"], *([self._sizes["n_m"]] * 3)]
        out = [np.empty((total, width)) for width in widths]
        report = np.full(REPORTS[function], np.nan)
        work = self._workspace(size)
        pointers = [pointer(x) for x in given.values()]
        whole = [ctypes.c_int(x) for x in counts]
        status = int(
            self._entry(
                whole[0],
                ctypes.c_double(numbers[0]),
                *pointers,
                *whole[1:],
                ctypes.c_double(numbers[1]),
                *(pointer(x) for x in (*out, report, work)),
                ctypes.c_int64(work.size),
            )
        )
        self._pool.append(work)
        if status < 0:
            exception, text = self._failures.get(status, (BuildError, f"unknown status {status}; {AGAIN}"))
            told = "" if np.isnan(report[0]) else f" (residual {report[0]:.3g} after {int(report[2])} steps)"
            raise exception(f"{function}: {text}{told}")
        return Inversion(
            **dict(zip(_RESULTS, out, strict=True)),
            lead=counts[1],
            tail=counts[2],
            period=numbers[0],
            residual=float(report[0]),
            residual_between=float(report[1]),
            iterations=int(report[2]),
            intervals=int(report[3]),
            uneven=float(report[-1]),
            exact=status == 0,
            unstable=tuple(int(x) for x in report[4:-1]),
        )

    def _workspace(self, size: int) -> np.ndarray:
        """Memory of at least that many numbers, that no other call uses."""
        try:
            kept = self._pool.pop()
        except IndexError:
            kept = np.empty(0)
        return kept if kept.size >= size else np.empty(size)


def inverter_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Mapping[int, tuple[type[FlexgenError], str]],
    again: tuple[Callable[..., Any], tuple[Any, ...]],
    function: str = "invert",
) -> Inverter | None:
    """The `Inverter` of a library whose entry points are found by name; None where the manifest lists none."""
    name = manifest["name"]
    if not {function, f"{function}_work"} <= {core["name"] for core in manifest.get("cores", ())}:
        return None
    work = found(f"{name}_{function}_work")
    work.restype = ctypes.c_int64
    return Inverter(name, manifest["sizes"], found(f"{name}_{function}"), work, failures, again, function)


def array_of(function: str, name: str, x: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An argument as C reads it: double precision, row after row."""
    try:
        array = np.asarray(x)
    except (ValueError, TypeError) as error:
        raise ArgumentError(f"{function}, {name}: given {error}, expected real numbers") from error
    if array.dtype.kind not in "iuf":
        raise ArgumentError(f"{function}, {name}: given entries of type {array.dtype}, expected real numbers")
    if array.shape != shape:
        expected = ("n", *shape[1:]) if shape[0] < 0 else shape
        raise ArgumentError(
            f"{function}, {name}: given shape {array.shape}, expected ({', '.join(map(str, expected))})"
        )
    return np.ascontiguousarray(array, dtype=np.float64)


def whole_of(function: str, name: str, x: Any) -> int:
    """An argument that is an int in C."""
    if isinstance(x, bool) or not isinstance(x, int | np.integer) or not -(2**31) <= int(x) < 2**31:
        raise ArgumentError(f"{function}, {name}: given {x!r}, expected a whole number")
    return int(x)


def number_of(function: str, name: str, x: Any) -> float:
    """An argument that is a double in C."""
    if isinstance(x, bool) or not isinstance(x, int | float | np.integer | np.floating):
        raise ArgumentError(f"{function}, {name}: given {x!r}, expected a number")
    return float(x)


def pointer(x: np.ndarray) -> ctypes.c_void_p:
    """Where an array begins, for C."""
    return ctypes.c_void_p(address(x))
