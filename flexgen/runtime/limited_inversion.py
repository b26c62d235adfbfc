"""Inverse dynamics of a loaded library within limits: `LimitedInverter`, the type of `Library.invert_limited`."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError, SolverError
from flexgen.runtime.path_inversion import (
    Inversion,
    Inverter,
    array_of,
    hold_of,
    number_of,
    parameters_of,
    pointer,
    pointers,
    tolerance_of,
    whole_of,
)
from flexgen.runtime.structs import filled

_LIMITS_ACTIVE, _LIMITS_INFEASIBLE = 2, -14  # statuses of the C


class LimitsInfeasibleError(SolverError):
    """The limits cannot be kept; ``excess``: the largest violation that is left, relative to the limit."""

    def __init__(self, message: str, excess: float) -> None:
        super().__init__(message)
        self.excess = excess


class LimitedInverter(Inverter):
    """``library.invert_limited(y, dy, ddy, period=..., q_start=..., torque_max=...)``: inverse dynamics within limits.

    It may be called from several threads, as `Inverter`.
    """

    def __call__(
        self,
        y: Any,
        dy: Any,
        ddy: Any,
        *,
        period: float,
        q_start: Any,
        torque_max: Any = None,
        speed_max: Any = None,
        deflection_max: Any = None,
        knot_samples: int = 0,
        n_pre: int = 0,
        n_post: int = 0,
        samples_per_interval: int = 1,
        tolerance: float | None = None,
        hold: str = "spline",
        delay: float = 0.0,
        parameters: Any = None,
    ) -> Inversion:
        """Motion and torques within limits, for the path itself or the smallest deviation from it.

        Parameters
        ----------
        y, dy, ddy, period, q_start, n_pre, n_post, samples_per_interval, tolerance, hold, delay, parameters
            As of `Library.invert`. The deviation is zero at the first and the last sample: repeat these at rest where
            the motion may take longer than the path.
        torque_max : array (n_m,), optional
            Largest motor torques [N m].
        speed_max : array (n_m,), optional
            Largest motor speeds [rad/s].
        deflection_max : array (n_e,), optional
            Largest deflections of the unactuated coordinates [rad or m].
        knot_samples : int
            Samples between two knots of the deviation; 0: a thirtieth of the path.

        Returns
        -------
        Inversion
            With ``limits_active`` and the deviation.

        Raises
        ------
        ArgumentError
            An argument has another shape or is out of range.
        SolverError
            The limits cannot be kept, or the path cannot be inverted.
        """
        self._refuse_closed()
        function, sizes = self._function, self._sizes
        given = self._samples(y, dy, ddy)
        q = array_of(function, "q_start", q_start, (sizes["n_a"],), self._real)
        limits: dict[str, Any] = {}
        for name, x, size in (
            ("torque_max", torque_max, sizes["n_m"]),
            ("speed_max", speed_max, sizes["n_m"]),
            ("deflection_max", deflection_max, sizes["n_e"]),
        ):
            if x is not None:
                limits[name] = array_of(function, name, x, (size,), self._real)
                if not (limits[name] > 0).all():
                    raise ArgumentError(f"{function}, {name}: given {limits[name]}, expected positive numbers")
        counts = {"n_pre": n_pre, "n_post": n_post, "samples_per_interval": samples_per_interval}
        counts = {key: whole_of(function, key, value) for key, value in counts.items()}
        tolerance = tolerance_of(self._real) if tolerance is None else tolerance
        options = {**counts, **hold_of(function, hold, delay), "tolerance": number_of(function, "tolerance", tolerance)}
        values = parameters_of(function, parameters, self._parameters)
        return self._limited(
            given,
            values,
            q,
            number_of(function, "period", period),
            options,
            limits,
            whole_of(function, "knot_samples", knot_samples),
        )

    def _limited(
        self,
        given: dict[str, np.ndarray],
        values: np.ndarray,
        q_start: np.ndarray,
        period: float,
        options: dict[str, Any],
        limits: dict[str, np.ndarray],
        knot_samples: int,
    ) -> Inversion:
        """Call C with checked arguments."""
        structs, n = self._structs, len(given["y"])
        deviation = np.zeros((n, self._sizes["n_y"]), self._real)
        chosen = filled(structs["inversion_options"], **options)
        bounds = filled(structs["inversion_limits"], knot_samples=knot_samples, deviation=deviation, **limits)
        size = int(self._work(ctypes.c_int(n), ctypes.byref(chosen), ctypes.byref(bounds)))
        if size < 0:
            raise ArgumentError(
                f"{self._function}: given {n} samples, knot_samples {knot_samples} and {options}; expected at least 9 "
                "knots on the path, n_pre and n_post at least 0, samples_per_interval at least 1, all at most a million"
            )
        work = self._workspace(size)
        out = self._results(n + options["n_pre"] + options["n_post"])
        path, motion = filled(structs["path"], n=n, period=period, **given), filled(structs["motion"], **out)
        info = structs["inversion_info"](residual=np.nan)
        status = int(
            self._entry(
                ctypes.byref(path),
                *pointers(values),
                pointer(q_start),
                ctypes.byref(chosen),
                ctypes.byref(bounds),
                ctypes.byref(motion),
                ctypes.byref(info),
                pointer(work),
                ctypes.c_int64(work.size),
            )
        )
        self._pool.append(work)
        reported: dict[str, Any] = {key: getattr(info, key) for key, *_ in structs["inversion_info"]._fields_}
        if status == _LIMITS_INFEASIBLE:
            raise LimitsInfeasibleError(
                f"{self._function}: {self._failures[status][1]} (a limit is exceeded by {reported['limit_excess']:.2g} "
                "of its value)",
                reported["limit_excess"],
            )
        self._check_status(status, reported)
        active = status == _LIMITS_ACTIVE
        found = Inversion(
            **out,
            n_pre=options["n_pre"],
            n_post=options["n_post"],
            period=period,
            converged=status == 0 or active,
            **reported,
        )
        return replace(found, limits_active=active, deviation=deviation)
