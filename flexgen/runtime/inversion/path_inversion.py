"""Inverse dynamics of a loaded library along a whole path: `Inverter`, the type of
`Library.invert` and `Library.bvp`.

The path is given by samples of the output and of its first two derivatives. The result has
additional samples before the path and after it, because unactuated coordinates move there too.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of
from flexgen.runtime.identity import TOLERANCES
from flexgen.runtime.inversion.inversion_arguments import (
    array_of,
    parameters_of,
    pointer,
    pointers,
    samples_of,
    tolerance_of,
)
from flexgen.runtime.options import SolverOptions
from flexgen.runtime.streams.servo import ServoEntry, servo_entry, servo_options
from flexgen.runtime.structs import Failures, closed_error, failure_of, interface_of, struct_of

TOLERANCE = TOLERANCES["double"]
RESULTS = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m")


@dataclass(frozen=True)
class Inversion:
    """Motion and torques for exact tracking of the path, at N = n_pre + n + n_post samples.

    Parameters
    ----------
    q_a, v_a, a_a : ndarray (N, n_a)
        Motion of the arm [rad, m; per s; per s^2].
    tau_g : ndarray (N, n_g)
        Gear torques, arm side [N m, N].
    q_m, v_m, tau_m : ndarray (N, n_m)
        Motor angles [rad], speeds [rad/s] and torques [N m], motor side.
    n_pre, n_post : int
        Samples before the path and after it; with ``settled`` those after it until the
        equilibrium.
    period : float
        Time between two samples [s].
    residual, residual_at_samples : float
        Residual of the unactuated rows, relative to their torques at equilibrium: on the mesh, and
        at the samples.
    kinematic_mismatch : float
        Largest difference between velocities and accelerations and the numerical derivatives of
        positions and velocities at the samples, relative to their largest value.
    iterations, intervals : int
        Newton iterations; intervals of the mesh.
    unstable_zeros_start, unstable_zeros_end : int
        Of `Library.bvp`: number of unstable zeros at the start and at the end; of
        `Library.invert` 0.
    converged : bool
        Whether ``residual_at_samples`` is within 100 tolerances (in single precision within the
        tolerance), ``kinematic_mismatch`` below 0.02 (0.25), and ``torque_error`` within 0.005 (or
        ``residual_at_samples`` within the tolerance; with Fourier sums of motor angles within a
        hundredth of it): then the output is off by at most 10 tolerances, 1e-5 rad or m for each
        meter of reach by default, the accuracy of `flexgen.solve`. If not, use a shorter period of
        the mesh: fewer samples per interval, or a shorter sampling period. Without unactuated
        coordinates the residual is zero, and only the mismatch is checked.
    deviation_m, deviation_rad : float
        Of `Library.invert_limited`: largest distance [m] and angle [rad] from the given path;
        else 0.
    limit_excess : float
        Of `Library.invert_limited`: largest violation of a limit, relative to it; else 0.
    programs : int
        Of `Library.invert_limited`: quadratic programs; else 0.
    limits_active : bool
        Of `Library.invert_limited`: whether the path was modified.
    growth : float
        With ``growth=True``: largest growth of a perturbation along the motion, see
        `Library.growth`; where it is above about 100, only feedback keeps the robot on its path.
        Else NaN.
    torque_error : float
        Of `Library.invert`: estimate of the largest error of a motor torque by the mesh, relative
        to the largest torque of this motor, from differences of what accelerates its rotor over
        quarters of an interval.
    deviation : ndarray (n, n_y) or None
        Of `Library.invert_limited`: deviation from the path at its samples [m, rad].
    command_m, command_g : ndarray (N, n_m), (N, n_g) or None
        With ``servo``: positions to send, motor side [rad], and of the joints [rad, m].
    """

    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    tau_g: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    tau_m: np.ndarray
    n_pre: int
    n_post: int
    period: float
    residual: float
    residual_at_samples: float
    kinematic_mismatch: float
    iterations: int
    intervals: int
    converged: bool
    unstable_zeros_start: int = 0
    unstable_zeros_end: int = 0
    deviation_m: float = 0.0
    deviation_rad: float = 0.0
    limit_excess: float = 0.0
    programs: int = 0
    limits_active: bool = False
    growth: float = math.nan
    torque_error: float = math.nan
    deviation: np.ndarray | None = None
    command_m: np.ndarray | None = None
    command_g: np.ndarray | None = None

    @property
    def t(self) -> np.ndarray:
        """Time of the samples [s], zero at the first sample of the path."""
        return (np.arange(len(self.q_a)) - self.n_pre) * self.period


class Inverter:
    """``library.invert(y, dy, ddy, period=..., q_start=...)``, or ``bvp``: inverse dynamics along
    a whole path.

    It may be called from several threads. Every call uses its own workspace, which is kept for
    later calls.

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow").directory)
    >>> path = flexgen.plan("elbow", "line")
    >>> y, dy, ddy = path.sample([0.005 * k for k in range(201)]).y.transpose(2, 0, 1)[:3]
    >>> found = library.invert(y, dy, ddy, period=0.005, q_start=path.q_start)
    >>> found.tau_m.shape  # N m
    (201, 2)
    """

    _fewest = "at least 2 samples"

    def __init__(
        self,
        manifest: Mapping[str, Any],
        entry: Callable[..., int],
        work: Callable[..., int],
        failures: Failures,
        again: tuple[Callable[..., Any], tuple[Any, ...]],
        function: str,
        parameters: np.ndarray,
    ) -> None:
        self._name = manifest["name"]
        self._sizes = manifest["sizes"]
        self._interface = interface_of(manifest)
        self.structs = self._interface.structs
        self._parameters = parameters
        self._real = parameters.dtype
        self._rows = manifest.get("parameters", ())
        self._entry = entry
        self._work = work
        self._failures = failures
        self._function = function
        self._can_settle = function != "bvp"
        self._takes_force = any(name == "force" for name, *_ in self.structs["samples"]._fields_)
        self._grows = False  # with the function growth in the library
        self.servo: ServoEntry | None = None  # of a library with positions to send
        self.entry_many: Callable[..., int] | None = None  # of many problems
        self._pool: list[np.ndarray] = []
        self._again = again
        self._closed = False

    def __copy__(self) -> Inverter:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Inverter:
        return self

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        self._refuse_closed()
        return self._again

    def __repr__(self) -> str:
        defaults = (type(self).__call__.__kwdefaults__ or {}) | {
            "tolerance": tolerance_of(self._real)
        }
        shown = {
            name: repr(x) if isinstance(x, bool | str | None) else f"{x:g}"
            for name, x in defaults.items()
        }
        absent = {"force": not self._takes_force, "servo": self.servo is None}
        shown = {name: x for name, x in shown.items() if not absent.get(name, False)}
        options = [
            f"{name}={x}"
            for name, x in shown.items()
            if name != "parameters" or self._parameters.size
        ]
        return f"{self._function}(y, dy, ddy, *, period, q_start, {', '.join(options)})"

    def close(self) -> None:
        """Refuse every call from now on; calls under way end as usual."""
        self._closed = True
        self._pool = []

    def _refuse_closed(self) -> None:
        if self._closed:
            raise closed_error(self._name)

    def __call__(
        self,
        y: Any,
        dy: Any,
        ddy: Any,
        *,
        period: float,
        q_start: Any,
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
        """Motion and torques for exact tracking of a path.

        Parameters
        ----------
        y : array (n, n_t)
            Output at the samples; for a pose the position [m], then the rotation matrix by
            columns.
        dy, ddy : array (n, n_y)
            Its first and second time derivative; for a pose linear and angular velocity [m/s,
            rad/s] in world axes, and their derivatives. Zero at the first and the last sample: the
            path begins and ends at rest.
        period : float
            Time between two samples [s].
        q_start : array (n_a,)
            Initial guess of the arm's equilibrium at the first sample [rad, m].
        n_pre, n_post : int
            Samples before the path and after it.
        samples_per_interval : int
            Samples per interval of the solver's mesh.
        tolerance : float, optional
            Largest residual of the unactuated rows on the mesh, relative to the torques of a
            deflection of 0.01 rad or 0.01 m (1e-6: equivalent to a deflection error of 1e-8 rad or
            m); at the samples 100 times as much is ``converged``. The default is 1e-6, that of
            `flexgen.solve`; in single precision it is 1e-3.
        hold : str
            Torque of the drive between two samples: ``"spline"``, ``"linear"`` or ``"zoh"``;
            ``tau_m`` are the values to send.
        delay : float
            From a sample until the motor has its torque, in samples, 0 to 4.
        settled : float
            Once the residual motion after the path changes the output by less than this [m or
            rad], the results end, with the equilibrium; 0: they have all ``n_post`` samples. Not
            of ``bvp``.
        growth : bool
            Whether to compute ``growth`` too, which takes 0.3 to 2 times as long as the rest. Not
            of ``bvp``.
        parameters : array (n_p,), optional
            Run-time parameters, where the library has any; default: those of the model file.
        force : array (n, 3 n_y), optional
            Force on the output at the samples, dual to ``dy``: of a pose force [N], then torque [N
            m] on the tool, in world axes; then its first and its second time derivative. Of a
            library with the part ``"force"``.
        servo : True or mapping, optional
            The positions to send too, at samples of the servo, with its hold and delay: that of
            the model file, or with other members, such as ``{"position_gain": [30.0, 25.0]}``. Of
            a library with the part ``"position"``.

        Returns
        -------
        Inversion

        Raises
        ------
        ArgumentError
            Where an argument has another shape or is out of range.
        SolverError
            Where the path leaves the workspace or passes a singular pose, or the iteration did not
            converge.
        """
        self._refuse_closed()
        function = self._function
        given = self._samples((y, dy, ddy), force)
        q = array_of(function, "q_start", q_start, (self._sizes["n_a"],), self._real)
        period = number_of(function, "period", period)
        asked = SolverOptions(
            n_pre, n_post, samples_per_interval, tolerance, hold, delay, settled, growth
        )
        options = self._members(asked)
        options |= servo_options(self.servo, function, servo, period, hold, delay)
        values = parameters_of(function, parameters, self._parameters, self._rows)
        return self._invert(given, values, q, period, options)

    @checked_types(own=("period",))
    def positions(
        self, found: Inversion | np.ndarray, *, period: float, interpolation: str = "linear"
    ) -> np.ndarray:
        """Positions for an interface of this period, whose interpolation is closest to commands.

        Parameters
        ----------
        found : Inversion or array (n, n_g)
            With ``servo``, at rest at both ends. Or 2 or more commands of a stream, one sample
            time of the servo of the model file apart: the position in the middle is right where
            there are 8 on either side.
        period : float [s]
            Between two positions: a multiple of the time between two samples.
        interpolation : str
            Of the robot: ``"linear"``, ``"cubic"`` or ``"hold"``.

        Returns
        -------
        ndarray (m, n_g) [rad, m]
            Of the joints; the first acts at the first sample.

        Raises
        ------
        ArgumentError
            The inversion has no commands, or the period or the interpolation is another one.
        """
        self._refuse_closed()
        commands, step = (
            (found.command_g, found.period) if isinstance(found, Inversion) else (found, None)
        )
        if self.servo is None or commands is None:
            raise ArgumentError(
                "positions: given an inversion without commands, expected one with servo=True"
            )
        commands = array_of("positions", "found", commands, None, self._real)
        if commands.ndim != 2 or commands.shape[1] != self._sizes["n_g"] or len(commands) < 2:
            raise ArgumentError(
                f"positions: given commands of shape {commands.shape}, expected (n, "
                f"{self._sizes['n_g']})"
            )
        step = self.servo.sample_time if step is None else step
        each = number_of("positions", "period", period) / step
        if not (each >= 1.0 - 1e-6 and abs(each - round(each)) <= 1e-6 * each):
            raise ArgumentError(
                f"positions, period: given {period:g} s, expected a multiple of {step:g} s"
            )
        return self.servo.samples("positions", commands, round(each), interpolation)

    def _members(self, options: SolverOptions) -> dict[str, Any]:
        """Members of the options in C, checked."""
        return options.members(
            self._function,
            self._interface,
            self._real,
            settles=self._can_settle,
            grows=self._grows,
        )

    def _invert(
        self,
        given: dict[str, np.ndarray],
        parameters: np.ndarray,
        q_start: np.ndarray,
        period: float,
        options: dict[str, Any],
        *limits: ctypes.Structure,
    ) -> Inversion:
        """Call C with checked arguments; ``limits``: a further structure behind the options.
        Results have the samples that C has used after the path.
        """
        structs = self.structs
        n = len(given["y"])
        counts = {name: options[name] for name in ("n_pre", "n_post", "samples_per_interval")}
        filled_options = struct_of(structs["inversion_options"], **options)
        further = tuple(ctypes.byref(x) for x in (filled_options, *limits))
        work = self._workspace(self._work_size(n, further, counts))
        total = n + counts["n_pre"] + counts["n_post"]
        out = self._results(total)
        if "servo" in options:
            out |= {
                f"command_{side}": np.empty((total, self._sizes[f"n_{side}"]), self._real)
                for side in "mg"
            }
        path = struct_of(structs["samples"], n=n, period=period, **given)
        motion = struct_of(structs["motion"], **out)
        info = structs[f"{self._function}_info"](residual=np.nan)
        status = int(
            self._entry(
                ctypes.byref(path),
                *pointers(parameters),
                pointer(q_start),
                *further,
                ctypes.byref(motion),
                ctypes.byref(info),
                pointer(work),
                ctypes.c_int64(work.size),
            )
        )
        self._pool.append(work)
        reported: dict[str, Any] = {key: getattr(info, key) for key, *_ in info._fields_}
        self._check_status(status, reported)
        reported.setdefault("n_post", counts["n_post"])
        rows = counts["n_pre"] + n + reported["n_post"]
        active = status == self._interface.statuses["LIMITS_ACTIVE"]
        return Inversion(
            **{key: x[:rows] for key, x in out.items()},
            n_pre=counts["n_pre"],
            period=period,
            converged=status == 0 or active,
            limits_active=active,
            **reported,
        )

    def _check_status(self, status: int, reported: dict[str, Any]) -> None:
        """The exception of a negative status."""
        if status < 0:
            exception, text = failure_of(self._failures, status)
            residual = reported["residual"]
            iterations = reported["iterations"]
            reached = (
                ""
                if np.isnan(residual)
                else f" (residual {residual:.3g} after {iterations} iterations)"
            )
            raise exception(f"{self._function}: {text}{reached}")

    def _samples(
        self, path: Sequence[Any], force: Any = None, name: str = ""
    ) -> dict[str, np.ndarray]:
        """The samples of the path and of the force on it, checked; ``name``: of the function for
        many problems.
        """
        to = self._takes_force, bool(name)
        return samples_of(name or self._function, path, force, self._sizes, self._real, *to)

    def _results(self, total: int) -> dict[str, Any]:
        """Arrays for the results at all samples."""
        return {key: np.empty((total, width), self._real) for key, width in self._widths().items()}

    def _widths(self) -> dict[str, int]:
        """Numbers of a sample of each result."""
        n_a, n_g, n_m = (self._sizes[key] for key in ("n_a", "n_g", "n_m"))
        return dict(zip(RESULTS, (n_a, n_a, n_a, n_g, n_m, n_m, n_m), strict=True))

    def _work_size(self, n: int, options: tuple[Any, ...], counts: dict[str, int]) -> int:
        """Size of the workspace of ``n`` samples, in numbers; ArgumentError where one of the
        ``counts`` is out of range.
        """
        size = int(self._work(ctypes.c_int(n), *options))
        if size < 0:
            listed = ", ".join(f"{key} {value}" for key, value in counts.items())
            raise ArgumentError(
                f"{self._function}: given {n} samples, {listed}; expected {self._fewest}, n_pre "
                "and n_post at least 0, samples_per_interval at least 1, all at most a million"
            )
        return size

    def _workspace(self, size: int) -> np.ndarray:
        """Memory of at least that many numbers, that no other call uses."""
        try:
            kept = self._pool.pop()
        except IndexError:
            kept = np.empty(0, self._real)
        return kept if kept.size >= size else np.empty(size, self._real)


def inverter_of(
    manifest: Mapping[str, Any],
    found: Callable[[str], Any],
    failures: Failures,
    again: tuple[Callable[..., Any], tuple[Any, ...]],
    function: str,
    parameters: np.ndarray,
    form: type[Inverter],
) -> Inverter | None:
    """The `Inverter` of a library; None where the manifest lists none.

    ``found``: entry point by name; ``again``: how to load the library again, for pickling;
    ``function``: "invert", "bvp" or another one; ``form``: its class.
    """
    name = manifest["name"]
    offered = {row["name"] for row in manifest.get("c_functions", ())}
    if not {function, f"{function}_work"} <= offered:
        return None
    work = found(f"{name}_{function}_work")
    work.restype = ctypes.c_int64
    entry = found(f"{name}_{function}")
    made = form(manifest, entry, work, failures, again, function, parameters)
    made._grows = "growth" in offered and made._can_settle
    made.servo = servo_entry(manifest, found, failures, parameters.dtype)
    made.entry_many = found(f"{name}_{function}_many") if f"{function}_many" in offered else None
    return made
