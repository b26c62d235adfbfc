"""Inverse kinematics by the C of a loaded library: `InverseKinematics`, the type of
`Library.inverse_kinematics`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from threading import Event
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.runtime.identity import CONFIGURATIONS_MAX, STARTS, STARTS_MAX
from flexgen.runtime.inversion.inversion_arguments import array_of, pointer
from flexgen.runtime.structs import Failures, closed_error, failure_of, interface_of

FUNCTION = "inverse_kinematics"


class InverseKinematics:
    """All joint configurations at a pose, as a function of a library:
    ``library.inverse_kinematics(p, R)``.

    Examples
    --------
    >>> import numpy as np
    >>> functions = ["forward_kinematics", "jacobian"]
    >>> library = flexgen.load(flexgen.generate("manutec_r3", functions=functions).directory)
    >>> library.inverse_kinematics([0.5, 0.6, 1.2], np.eye(3)).shape  # configurations, joints
    (4, 6)
    """

    def __init__(
        self,
        name: str,
        n_a: int,
        n_g: int,
        entry: Callable[..., int],
        work: int,
        failures: Failures,
        statuses: Mapping[str, int],
        again: tuple[Callable[..., Any], tuple[Any, ...]],
    ) -> None:
        self._name = name
        self._n_a = n_a
        self._n_g = n_g
        self._entry = entry
        self._work = work
        self._failures = failures
        self._statuses = statuses
        self._again = again
        self._closed = Event()

    def __repr__(self) -> str:
        return f"<InverseKinematics {self._name}: {self._n_g} actuated of {self._n_a} coordinates>"

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self._again

    def close(self) -> None:
        """Refuse every later call."""
        self._closed.set()

    def __call__(
        self,
        p: Any,
        R: Any,
        q_start: Any = None,
        *,
        free: Sequence[int] | None = None,
        starts: int = STARTS,
        most: int = CONFIGURATIONS_MAX,
    ) -> np.ndarray:
        """The configurations, the nearest to ``q_start`` first.

        Parameters
        ----------
        p : array (3,) [m]
            Position of the tool in the world.
        R : array (3, 3)
            Its axes as columns.
        q_start : array (n_a,) [rad or m], optional
            First start, and the values of all coordinates that are not free; default: zeros.
        free : sequence of int, optional
            Indices of the six coordinates that are found; default: those with a motor, of an arm
            with six motors.
        starts : int
            Of the search, at most; 1: only ``q_start``, in bounded time.
        most : int
            Configurations at most.

        Returns
        -------
        ndarray (k, n_a) [rad or m]
            Rotations within half a turn of ``q_start``; limits of the joints are not checked.
            Empty where the pose cannot be reached. Configurations closer than about 1e-5 rad to a
            singular one can be missing or found twice; `flexgen.kinematics` finds each of them
            once.

        Raises
        ------
        ArgumentError
            Where an argument has another shape or is out of range, or the library is closed.
        SolverError
            The arm is singular at the pose, with more than 16 configurations.
        """
        if self._closed.is_set():
            raise closed_error(self._name)
        position = array_of(FUNCTION, "p", p, (3,), np.dtype(float))
        turned = np.ascontiguousarray(array_of(FUNCTION, "R", R, (3, 3), np.dtype(float)).T)
        guess = np.zeros(self._n_a) if q_start is None else q_start
        guess = array_of(FUNCTION, "q_start", guess, (self._n_a,), np.dtype(float))
        chosen = self._free(free)
        for name, value in (("starts", starts), ("most", most)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise ArgumentError(
                    f"{FUNCTION}: {name}: given {value!r}, expected a whole number of at least 1"
                )
        starts = min(int(starts), STARTS_MAX)
        most = min(int(most), CONFIGURATIONS_MAX)
        q = np.empty((most, self._n_a))
        work = np.empty(self._work)
        count = ctypes.c_int(0)
        status = int(
            self._entry(
                pointer(position),
                pointer(turned),
                pointer(guess),
                chosen,
                ctypes.c_int(starts),
                ctypes.c_int(most),
                pointer(q),
                ctypes.byref(count),
                pointer(work),
                ctypes.c_int64(work.size),
            )
        )
        if status < 0 and status != self._statuses["UNREACHABLE"]:
            self._refuse(status)
        return q[: min(count.value, most)]

    def _free(self, free: Sequence[int] | None) -> Any:
        """The indices for C; None for an arm with six motors."""
        if free is None and self._n_g != 6:
            raise ArgumentError(
                f"{FUNCTION}: free: given none for {self._n_g} coordinates with a motor, "
                "expected six of their indices"
            )
        if free is None:
            return None
        given = list(free) if isinstance(free, Iterable) else []
        whole = all(
            isinstance(i, int | np.integer) and not isinstance(i, bool) and 0 <= i < self._n_a
            for i in given
        )
        if not whole or len(given) != 6 or len(set(given)) != 6:
            raise ArgumentError(
                f"{FUNCTION}: free: given {free!r}, expected six different indices from 0 to "
                f"{self._n_a - 1}"
            )
        return (ctypes.c_int * 6)(*map(int, given))

    def _refuse(self, status: int) -> None:
        """Raise the error of a status of C below zero, with the causes that this function
        knows.
        """
        exception, text = failure_of(self._failures, status)
        if status == self._statuses["BAD_ARGUMENT"]:
            text = (
                "R is not a rotation matrix, |q_start| > 1000, or free coordinates without a motor"
            )
        elif status == self._statuses["NOT_CONVERGED"]:
            text = f"more than {CONFIGURATIONS_MAX} configurations at this pose, which is singular"
        raise exception(f"{FUNCTION}: {text}")


def inverse_kinematics_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Failures,
    again: tuple[Callable[..., Any], tuple[Any, ...]],
) -> InverseKinematics | None:
    """Inverse kinematics of a library; None where the manifest lists none."""
    name = manifest["name"]
    sizes = manifest["sizes"]
    if not {FUNCTION, f"{FUNCTION}_work"} <= {
        row["name"] for row in manifest.get("c_functions", ())
    }:
        return None
    work = found(f"{name}_{FUNCTION}_work")
    work.restype = ctypes.c_int64
    entry = found(f"{name}_{FUNCTION}")
    statuses = interface_of(manifest).statuses
    return InverseKinematics(
        name, sizes["n_a"], sizes["n_g"], entry, int(work()), failures, statuses, again
    )
