"""Inverse dynamics of a loaded library within limits: `LimitedInverter`, the type of
`Library.invert_limited`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.curve import TORQUE_SPEED, points_of
from flexgen.runtime.arguments import number_of, whole_of
from flexgen.runtime.inversion.inversion_arguments import array_of, parameters_of
from flexgen.runtime.inversion.path_inversion import Inversion, Inverter
from flexgen.runtime.options import SolverOptions
from flexgen.runtime.streams.servo import servo_options
from flexgen.runtime.structs import struct_of

SIZES = {
    "torque_max": "n_m",
    "speed_max": "n_m",
    "torque_rate_max": "n_m",
    "deflection_max": "n_e",
    "gear_torque_max": "n_g",
    "joint_speed_max": "n_g",
    "joint_acceleration_max": "n_g",
}
OF_TOOL = ("tool_speed_max", "tool_acceleration_max")
NO_CURVE = ((0.0, 1e30), (1e30, 1e30))  # of a motor without a curve: rad/s, N m


def limit_members(
    function: str, given: Mapping[str, Any], sizes: Mapping[str, int], real: np.dtype[Any]
) -> dict[str, Any]:
    """Members of the limits in C from arguments by name, those of `LimitedInverter`; None is left
    out.

    Raises
    ------
    ArgumentError
        An argument is unknown, has another shape or is not positive.
    """
    out = dict[str, Any]()
    for name, x in given.items():
        if x is None:
            continue
        if name in SIZES:
            out[name] = array_of(function, name, x, (sizes[SIZES[name]],), real)
            if not (out[name] > 0).all():
                raise ArgumentError(
                    f"{function}, {name}: given {out[name]}, expected positive numbers"
                )
        elif name in OF_TOOL:
            out[name] = number_of(function, name, x)
            if not out[name] >= 0.0:
                raise ArgumentError(
                    f"{function}, {name}: given {show_value(x)}, expected a number >= 0"
                )
        elif name != "torque_speed":
            known = ", ".join((*SIZES, *OF_TOOL, "torque_speed"))
            raise ArgumentError(
                f"{function}: given the limit {show_value(name)}, expected some of {known}"
            )
        else:
            listed = isinstance(x, list | tuple) or (isinstance(x, np.ndarray) and x.ndim > 0)
            found = [points_of(one) for one in x] if listed else []
            curves = [one if len(one) else np.array(NO_CURVE) for one in found if one is not None]
            if not len(curves) == len(found) == sizes["n_m"]:
                raise ArgumentError(
                    f"{function}, torque_speed: given {show_value(x)}, expected for each of "
                    f"{sizes['n_m']} motors {TORQUE_SPEED}; or nothing for a motor"
                )
            most = max(map(len, curves))
            same = [[*curve, *[curve[-1]] * (most - len(curve))] for curve in curves]
            out |= {"torque_speed": np.array(same, dtype=real), "torque_speed_points": most}
    return out


class LimitsInfeasibleError(SolverError):
    """The limits cannot be kept; ``excess``: the largest violation that is left, relative to the
    limit.
    """

    def __init__(self, message: str, excess: float) -> None:
        super().__init__(message)
        self.excess = excess


class LimitedInverter(Inverter):
    """``library.invert_limited(y, dy, ddy, period=..., q_start=..., torque_max=...)``: inverse
    dynamics within limits.

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
        gear_torque_max: Any = None,
        torque_rate_max: Any = None,
        joint_speed_max: Any = None,
        joint_acceleration_max: Any = None,
        tool_speed_max: float = 0.0,
        tool_acceleration_max: float = 0.0,
        torque_speed: Any = None,
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
        y, dy, ddy, period, q_start, n_pre, n_post, samples_per_interval, tolerance, hold, delay
            As of `Library.invert`, like ``settled``, ``growth``, ``parameters``, ``force`` and
            ``servo``. The deviation is zero at the first and the last sample: repeat these at rest
            where the motion may take longer than the path.
        torque_max, speed_max, torque_rate_max : array (n_m,), optional
            Largest motor torques [N m], motor speeds [rad/s], and rates of the torques between
            samples [N m/s].
        deflection_max : array (n_e,), optional
            Largest deflections of the unactuated coordinates [rad or m].
        gear_torque_max, joint_speed_max, joint_acceleration_max : array (n_g,), optional
            Largest torques of the gears, arm side, and speeds and accelerations of their joints
            [SI units].
        tool_speed_max, tool_acceleration_max : float
            Of a path of the tool: its largest speed [m/s] and acceleration [m/s^2]; 0: no limit.
        torque_speed : sequence of arrays (points, 2), optional
            For each motor points [rad/s, N m] of its largest torque over the speed: a convex
            region; () for none.
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
        function = self._function
        sizes = self._sizes
        given = self._samples((y, dy, ddy), force)
        q = array_of(function, "q_start", q_start, (sizes["n_a"],), self._real)
        arrays = [torque_max, speed_max, torque_rate_max, deflection_max, gear_torque_max]
        arrays += [joint_speed_max, joint_acceleration_max]
        named = dict(zip(SIZES, arrays, strict=True)) | {"torque_speed": torque_speed}
        named |= {"tool_speed_max": tool_speed_max, "tool_acceleration_max": tool_acceleration_max}
        limits = limit_members(function, named, sizes, self._real)
        asked = SolverOptions(
            n_pre, n_post, samples_per_interval, tolerance, hold, delay, settled, growth
        )
        options = self._members(asked)
        options |= servo_options(self.servo, function, servo, period, hold, delay)
        deviation = np.zeros_like(given["dy"])
        knot_samples = whole_of(function, "knot_samples", knot_samples)
        bounds = struct_of(
            self.structs["inversion_limits"],
            knot_samples=knot_samples,
            deviation=deviation,
            **limits,
        )
        values = parameters_of(function, parameters, self._parameters, self._rows)
        period = number_of(function, "period", period)
        return replace(
            self._invert(given, values, q, period, options, bounds), deviation=deviation
        )

    def _check_status(self, status: int, reported: dict[str, Any]) -> None:
        """Raise the error of a status of C; where no path keeps the limits with the relative
        excess.
        """
        if status == self._interface.statuses["LIMITS_INFEASIBLE"]:
            excess = reported["limit_excess"]
            text = (
                f"{self._failures[status][1]} (a limit is exceeded by {excess:.2g} of its value)"
            )
            raise LimitsInfeasibleError(f"{self._function}: {text}", excess)
        super()._check_status(status, reported)
