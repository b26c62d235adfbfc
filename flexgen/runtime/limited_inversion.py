"""Inverse dynamics of a loaded library within limits: `LimitedInverter`, the type of `Library.invert_limited`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from flexgen.errors import ArgumentError, SolverError
from flexgen.runtime.arguments import number_of, whole_of
from flexgen.runtime.inversion_arguments import array_of, parameters_of
from flexgen.runtime.path_inversion import Inversion, Inverter
from flexgen.runtime.servo import servo_options
from flexgen.runtime.structs import struct_of


class LimitsInfeasibleError(SolverError):
    """The limits cannot be kept; ``excess``: the largest violation that is left, relative to the limit."""

    def __init__(self, message: str, excess: float) -> None:
        super().__init__(message)
        self.excess = excess


class LimitedInverter(Inverter):
    """``library.invert_limited(y, dy, ddy, period=..., q_start=..., torque_max=...)``: inverse dynamics within limits.

    It may be called from several threads, as `Inverter`.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow").directory)
    >>> path = flexgen.plan("elbow", "line")
    >>> y, dy, ddy = path.sample([0.005 * k for k in range(201)]).y.transpose(2, 0, 1)[:3]
    >>> given = {"period": 0.005, "q_start": path.q_start, "torque_max": [18.0, 18.0]}
    >>> found = library.invert_limited(y, dy, ddy, **given)
    >>> found.limits_active, bool(abs(found.tau_m).max() <= 18.0)
    (True, True)
    """

    _fewest = "at least 9 knots on the path (knot_samples)"

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
        settled: float = 0.0,
        growth: bool = False,
        parameters: Any = None,
        force: Any = None,
        servo: Any = None,
    ) -> Inversion:
        """Motion and torques within limits, for the path itself or the smallest deviation from it.

        Parameters
        ----------
        y, dy, ddy, period, q_start, n_pre, n_post, samples_per_interval, tolerance, hold, delay, settled, growth
            As of `Library.invert`, like ``parameters``, ``force`` and ``servo``. The deviation is zero at the first and
            the last sample: repeat these at rest where the motion may take longer than the path.
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
        given = self._samples(y, dy, ddy, force)
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
        options = self._options(n_pre, n_post, samples_per_interval, tolerance, hold, delay, settled, growth)
        options |= servo_options(self.servo, function, servo, period, hold, delay)
        deviation = np.zeros_like(given["dy"])
        knot_samples = whole_of(function, "knot_samples", knot_samples)
        bounds = struct_of(self._structs["inversion_limits"], knot_samples=knot_samples, deviation=deviation, **limits)
        values, period = parameters_of(function, parameters, self._parameters), number_of(function, "period", period)
        return replace(self._invert(given, values, q, period, options, bounds), deviation=deviation)

    def _check_status(self, status: int, reported: dict[str, Any]) -> None:
        if status == self._interface.statuses["LIMITS_INFEASIBLE"]:
            excess = reported["limit_excess"]
            text = f"{self._failures[status][1]} (a limit is exceeded by {excess:.2g} of its value)"
            raise LimitsInfeasibleError(f"{self._function}: {text}", excess)
        super()._check_status(status, reported)
