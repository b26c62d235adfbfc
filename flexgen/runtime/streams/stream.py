"""Inverse dynamics of a loaded library on a moving horizon: `Stream`, which ``Library.stream``
begins.
"""

from __future__ import annotations

import copy
import ctypes
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.runtime.arguments import number_of
from flexgen.runtime.inversion.inversion_arguments import (
    array_of,
    parameters_of,
    pointer,
    pointers,
)
from flexgen.runtime.inversion.limited_inversion import limit_members
from flexgen.runtime.options import StreamOptions
from flexgen.runtime.streams.head import head_offsets
from flexgen.runtime.streams.servo import servo_options
from flexgen.runtime.streams.stream_entries import StreamEntries
from flexgen.runtime.structs import REAL, failure_of, struct_of

# In words, of a tolerance that is not met; by members of the enum of C.
_CAUSES = {
    "none": "",
    "residual": "residual",
    "mismatch": "kinematic mismatch",
    "torque_step": "horizon",
}
_RESULTS = ("q_a", "v_a", "tau_g", "q_m", "v_m", "tau_m")


@dataclass(frozen=True)
class Interval:
    """Motion and torques of the interval that starts now, at ``samples_per_interval`` samples from
    its start on.

    Parameters
    ----------
    q_a, v_a : ndarray (samples_per_interval, n_a)
        Motion of the arm [rad, m; per s].
    tau_g : ndarray (samples_per_interval, n_g)
        Gear torques, arm side [N m, N].
    q_m, v_m, tau_m : ndarray (samples_per_interval, n_m)
        Motor angles [rad], speeds [rad/s] and torques [N m], motor side.
    residual : float
        Residual of the unactuated rows, relative to their torques at equilibrium.
    kinematic_mismatch : float
        Largest difference between velocities and accelerations and the numerical derivatives of
        positions and velocities at the samples, relative to their largest value within about a
        horizon; its limit is 0.02 (in single precision 0.25).
    torque_step : float
        Largest step of a motor torque from the interval before, relative to its largest value; its
        limit is 2e-4 (in single precision 5e-3).
    output_step_m, output_step_rad : float
        Step by which the output leaves the plan of the update before because the horizon is too
        short [m, rad]. No estimate of the error where the horizon is long enough: the errors of
        mesh, samples and hold are not in it, and larger by orders of magnitude; `flexgen.simulate`
        measures them.
    converged : bool
        Whether ``residual``, ``kinematic_mismatch`` and ``torque_step`` are within their limits.
    cause : str
        Why it is not converged: "residual", "kinematic mismatch" (samples too far apart, or a path
        that is not smooth) or "horizon" (too short for the unstable zeros: the torque steps); else
        empty.
    limits_active : bool
        Whether limits of the motors modify the path in this interval, or are exceeded, see
        `Stream.limit`.
    deviation_m, deviation_rad : float
        Deviation of the modified path from the given one [m, rad].
    command_m, command_g : ndarray (samples_per_interval, n_m), (samples_per_interval, n_g) or None
        With the part ``"position"``: positions to send, motor side [rad], of the joints [rad, m];
        NaN without servo.
    """

    q_a: np.ndarray
    v_a: np.ndarray
    tau_g: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    tau_m: np.ndarray
    residual: float
    kinematic_mismatch: float
    torque_step: float
    output_step_m: float
    output_step_rad: float
    converged: bool
    cause: str = ""
    limits_active: bool = False
    deviation_m: float = 0.0
    deviation_rad: float = 0.0
    command_m: np.ndarray | None = None
    command_g: np.ndarray | None = None


class Stream:
    """Inverse dynamics on a moving horizon: every update takes a sample of the path and returns
    the current torques.

    The output reaches the sample ``intervals`` updates later: the path must be known that far
    ahead. A sample that is refused changes nothing. A copy is a second stream with the same past;
    a pickled stream continues where it was. Two threads must not update one stream at the same
    time. ``Library.close`` closes its streams.

    Made by ``Library.stream``.

    Parameters
    ----------
    intervals, samples_per_interval : int
        Intervals of the horizon; samples of the results in each.
    period : float
        Time between two updates [s].

    Examples
    --------
    >>> library = flexgen.load(flexgen.generate("elbow").directory)
    >>> path = flexgen.plan("elbow", "line")
    >>> y, dy, ddy = path.sample([0.005 * k for k in range(201)]).y.transpose(2, 0, 1)[:3]
    >>> stream = library.stream(y[0], path.q_start, period=0.005, intervals=20)
    >>> # of 20 samples before
    >>> torques = [stream.update(y[k], dy[k], ddy[k]).tau_m for k in range(1, 201)]
    >>> torques[-1].shape
    (1, 2)
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        entries: StreamEntries,
        y: Any,
        q_start: Any,
        *,
        period: float,
        intervals: int,
        samples_per_interval: int,
        tolerance: float | None = None,
        hold: str = "spline",
        delay: float = 0.0,
        parameters: Any = None,
        dy: Any = None,
        ddy: Any = None,
        servo: Any = None,
        force: Any = None,
    ) -> None:
        asked = StreamOptions(intervals, samples_per_interval, period, tolerance, hold, delay)
        asked = asked.resolve(entries.real)
        self.intervals = asked.intervals
        self.samples_per_interval = asked.samples_per_interval
        self.period = asked.period
        self._sizes = dict(sizes)
        self._entries = entries
        real = entries.real
        if servo is not None and dy is not None:
            raise ArgumentError(
                "stream, servo: given a stream in motion, expected one at rest: the state of "
                "the servo is not known"
            )
        own = asked.members(entries.interface)
        own |= servo_options(entries.servo, "stream", servo, asked.sample_time, hold, delay)
        if force is not None:
            self._refuse_force()
        if force is not None and dy is None and ddy is None:
            own["force"] = array_of("stream", "force", force, (self._sizes["n_y"],), real)
        options = struct_of(entries.structs["stream_options"], **own)
        limits = entries.interface.limits
        size = int(entries.work(ctypes.byref(options)))
        if size < 0:
            raise ArgumentError(
                f"stream: given {self.intervals} intervals and {self.samples_per_interval} "
                f"samples per interval, expected 1 to {limits['STREAM_INTERVALS_MAX']} and 1 to "
                f"{limits['STREAM_SAMPLES_MAX']}"
            )
        q = array_of("stream", "q_start", q_start, (self._sizes["n_a"],), real)
        held = parameters_of("stream", parameters, entries.model_parameters, entries.rows)
        self._memory = np.zeros(size, real)
        handle = self._handle()
        memory = (ctypes.byref(handle), ctypes.byref(options))
        if dy is None and ddy is None:
            at = array_of("stream", "y", y, (self._sizes["n_t"],), real)
            status = entries.start(*memory, pointer(at), *pointers(held), pointer(q))
        else:
            arrays = self._samples(y, dy, ddy, force)
            path = struct_of(
                entries.structs["samples"], n=len(arrays["y"]), period=self.period, **arrays
            )
            status = entries.start_moving(*memory, ctypes.byref(path), *pointers(held), pointer(q))
        self._refuse(int(status))
        self._bind()

    def _samples(self, y: Any, dy: Any, ddy: Any, force: Any) -> dict[str, np.ndarray]:
        """The samples of the path of a stream that starts in motion, and of the force on it,
        checked.
        """
        n = self.intervals + self._entries.interface.limits["STREAM_MORE_SAMPLES"]
        n_t = self._sizes["n_t"]
        n_y = self._sizes["n_y"]
        columns = {"y": (y, n_t), "dy": (dy, n_y), "ddy": (ddy, n_y)}
        if force is not None:
            columns["force"] = (force, 3 * n_y)
        return {
            key: array_of("stream", key, x, (n, width), self._entries.real)
            for key, (x, width) in columns.items()
        }

    def _refuse_force(self) -> None:
        if self._entries.push is None:
            raise ArgumentError(
                "stream: given a force, expected a library that was generated with "
                "parts=['force'] (--with force)"
            )

    def _handle(self) -> ctypes.Structure:
        """The stream in C; its memory is that of this object."""
        return struct_of(
            self._entries.structs["stream"], memory=self._memory, size=self._memory.size
        )

    def _bind(self) -> None:
        """Memory of the arguments of an update, and their addresses."""
        n_a, n_g, n_m = (self._sizes[key] for key in ("n_a", "n_g", "n_m"))
        real = self._entries.real
        self._inputs = [np.zeros(self._sizes[key], real) for key in ("n_t", "n_y", "n_y")]
        self._outputs = [
            np.zeros((self.samples_per_interval, n), real) for n in (n_a, n_a, n_g, n_m, n_m, n_m)
        ]
        structs = self._entries.structs
        has_commands = self._entries.servo is not None
        self._names = (*_RESULTS, *("command_m", "command_g")[: 2 * has_commands])
        if has_commands:
            self._outputs += [np.zeros((self.samples_per_interval, n), real) for n in (n_m, n_g)]
        self._motion = struct_of(
            structs["motion"], **dict(zip(self._names, self._outputs, strict=True))
        )
        self._info = structs["stream_info"]()
        self._stream = self._handle()
        bound = tuple(pointer(x) for x in self._inputs)
        self._arguments = (
            ctypes.byref(self._stream),
            *bound,
            ctypes.byref(self._motion),
            ctypes.byref(self._info),
        )
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        each = f"{self.samples_per_interval} samples in each"
        return f"<Stream of {self.intervals} intervals of {self.period:g} s, {each}>"

    def __copy__(self) -> Stream:
        other = object.__new__(type(self))
        other.intervals = self.intervals
        other.period = self.period
        other.samples_per_interval = self.samples_per_interval
        other._sizes = self._sizes
        other._entries = self._entries
        other._memory = self._memory.copy()
        other._bind()
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Stream:
        return copy.copy(self)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        self._entries.refuse_closed()
        made, which = self._entries.again
        return stream_again, (
            made,
            which,
            self._sizes,
            self.intervals,
            self.samples_per_interval,
            self.period,
            self._memory,
        )

    def update(self, y: Any, dy: Any, ddy: Any) -> Interval:
        """Take the next sample of the path, give the interval that starts now.

        Parameters
        ----------
        y : array (n_t,)
            Output at the end of the horizon; for a pose the position [m], then the rotation matrix
            by columns.
        dy, ddy : array (n_y,)
            Its first and second time derivative; for a pose linear and angular velocity in world
            axes, and their derivatives.

        Returns
        -------
        Interval

        Raises
        ------
        ArgumentError
            Where the sample is not finite, not a rotation matrix, or too far from the one before:
            it is refused, nothing has changed; or where the stream has failed or its library was
            closed.
        SolverError
            Where the sample cannot be reached (nothing has changed), or the solver failed: then
            the stream has failed.
        """
        self._entries.refuse_closed()
        given = [y, dy, ddy]
        for i, (name, memory) in enumerate(zip(("y", "dy", "ddy"), self._inputs, strict=True)):
            x = given[i]
            if type(x) is np.ndarray and x.shape == memory.shape and x.dtype == memory.dtype:
                continue
            given[i] = array_of("stream", name, x, memory.shape, memory.dtype)
        if not self._lock.acquire(blocking=False):
            raise ArgumentError(
                "stream: given an update while another one runs, expected one after the other"
            )
        try:
            for memory, x in zip(self._inputs, given, strict=True):
                memory[...] = x
            status = int(self._entries.update(*self._arguments))
            self._refuse(status)
            info = self._info
            interface = self._entries.interface
            results: dict[str, Any] = dict(
                zip(self._names, (x.copy() for x in self._outputs), strict=True)
            )
            return Interval(
                **results,
                residual=info.residual,
                kinematic_mismatch=info.kinematic_mismatch,
                torque_step=info.torque_step,
                output_step_m=info.output_step_m,
                output_step_rad=info.output_step_rad,
                cause=_CAUSES[interface.enums["cause"][info.cause]],
                converged=status != interface.statuses["TOLERANCE_NOT_MET"],
                limits_active=bool(info.limits_active),
                deviation_m=info.deviation_m,
                deviation_rad=info.deviation_rad,
            )
        finally:
            self._lock.release()

    @checked_types
    def limit(self, *, torque: Any = None, speed: Any = None, deviation: float = 0.05) -> None:
        """Set limits of the motors: from the next update on the path ahead is modified where one
        would be exceeded.

        The path is modified only where less than a thousandth of a change reaches the present
        motion: beyond 7 time constants of the slowest unstable zero. The horizon must contain half
        as much again, better twice as much, and enough time to brake. Compare torques and speeds
        with the limits.

        Parameters
        ----------
        torque, speed : array (n_m,), optional
            Largest torques [N m] and speeds [rad/s] of the motors; None, or infinity, where there
            is no limit.
        deviation : float
            Deviation of each output [m, rad], weighed against the limits: both are exceeded where
            these need more.

        Raises
        ------
        ArgumentError
            Where a limit is not positive, the horizon is too short, the stream has failed, or its
            library was closed.
        """
        self._entries.refuse_closed()
        n_m = self._sizes["n_m"]
        both = [
            array_of(
                "stream",
                name,
                np.full(n_m, np.inf) if x is None else x,
                (n_m,),
                self._entries.real,
            )
            for name, x in (("torque", torque), ("speed", speed))
        ]
        self._limit(self._entries.limits, [pointer(x) for x in both], deviation)

    @checked_types
    def limit_all(self, *, deviation: float = 0.05, **limits: Any) -> None:
        """Set limits of motors, gears, deflections, joints and tool, of a library with the part
        ``"limits"``.

        They replace those of `limit`, and are kept in the same way, at the ends of the intervals:
        the rate of a torque is its change from one to the next over the period, without that of
        the friction of the motor, which changes at once where it reverses.

        Parameters
        ----------
        deviation : float
            Deviation of each output [m, rad], weighed against the limits: both are exceeded where
            these need more.
        **limits
            ``torque_max``, ``speed_max``, ``torque_rate_max``, ``deflection_max``,
            ``gear_torque_max``, ``joint_speed_max``, ``joint_acceleration_max``,
            ``tool_speed_max``, ``tool_acceleration_max`` and ``torque_speed`` as of
            `Library.invert_limited`, such as those of `Limits.for_library`.

        Raises
        ------
        ArgumentError
            Where a limit is unknown or not positive, a curve has more than 21 points, the horizon
            is too short, the stream has failed, its library was closed or was generated without
            the part.

        Examples
        --------
        >>> library = flexgen.load(
        ...     flexgen.generate("elbow", "reports/limited", parts=["limits"]).directory
        ... )
        >>> path = flexgen.plan("elbow", "line")
        >>> stream = library.stream(
        ...     path.sample([0.0]).y[0, :, 0], path.q_start, period=0.005, intervals=40
        ... )
        >>> limits = flexgen.Limits(torque=(20.0, 20.0), gear_torque=(900.0, 700.0))
        >>> stream.limit_all(**limits.for_library("elbow"), deviation=0.01)
        """
        self._entries.refuse_closed()
        entry = self._entries.all_limits
        if entry is None:
            raise ArgumentError(
                f"stream: given limits of all kinds, but library {self._entries.name} has no "
                f"part limits; generate it "
                'with parts=["limits"] (--with limits)'
            )
        members = limit_members("stream", limits, self._sizes, self._entries.real)
        self._limit(
            entry,
            [ctypes.byref(struct_of(self._entries.structs["inversion_limits"], **members))],
            deviation,
        )

    def _limit(self, entry: Callable[..., int], given: list[Any], deviation: float) -> None:
        """Call the function ``entry`` of C with limits, as its arguments, and the largest
        ``deviation`` from the path; refused while an update runs.
        """
        if not self._lock.acquire(blocking=False):
            raise ArgumentError(
                "stream: given limits while an update runs, expected one after the other"
            )
        try:
            real = REAL["double" if self._entries.real == np.float64 else "single"]
            most = real(number_of("stream", "deviation", deviation))
            self._refuse(int(entry(ctypes.byref(self._stream), *given, most)))
        finally:
            self._lock.release()

    def set_parameters(self, parameters: Any) -> None:
        """Change the run-time parameters, such as the payload; they hold from the next update on.

        Where the path rests in the whole horizon and the arm rests, the stream is in the new
        equilibrium at once, as a new one. Elsewhere the deflections of the gears change at once,
        and updates are not ``converged`` until the motion has settled; their torques would move
        the motors so fast, do not send them.

        Parameters
        ----------
        parameters : array (n_p,)

        Raises
        ------
        ArgumentError
            Where the library has no run-time parameters, their number is another one, one is not
            finite or no number of a model file, such as a negative mass (C does not check that),
            or the stream has failed.
        """
        self._entries.refuse_closed()
        values = parameters_of(
            "stream", parameters, self._entries.model_parameters, self._entries.rows
        )
        if not self._lock.acquire(blocking=False):
            raise ArgumentError(
                "stream: given parameters while an update runs, expected one after the other"
            )
        try:
            assert self._entries.change is not None  # the library has parameters
            self._refuse(int(self._entries.change(ctypes.byref(self._stream), pointer(values))))
        finally:
            self._lock.release()

    def set_force(self, force: Any) -> None:
        """Set the force on the output at the next sample of the path, and at those after it until
        it is set again.

        A stream has the force of its start until then. Set the force of each sample before its
        update; one that has a step cannot be followed exactly.

        Parameters
        ----------
        force : array (3 n_y,)
            Dual to ``dy``: of a pose force [N], then torque [N m] on the tool, in world axes; then
            its first and its second time derivative.

        Raises
        ------
        ArgumentError
            Where the library was generated without the part ``"force"``, or a number is not
            finite.
        """
        self._entries.refuse_closed()
        self._refuse_force()
        assert self._entries.push is not None
        values = array_of("stream", "force", force, (3 * self._sizes["n_y"],), self._entries.real)
        if not self._lock.acquire(blocking=False):
            raise ArgumentError(
                "stream: given a force while an update runs, expected one after the other"
            )
        try:
            self._refuse(int(self._entries.push(ctypes.byref(self._stream), pointer(values))))
        finally:
            self._lock.release()

    def _refuse(self, status: int) -> None:
        """Raise what a negative status means."""
        if status < 0:
            exception, text = failure_of(self._entries.failures, status)
            raise exception(f"stream: {text}")


def stream_again(
    made: Callable[..., StreamEntries],
    which: tuple[Any, ...],
    sizes: dict[str, int],
    intervals: int,
    samples_per_interval: int,
    period: float,
    memory: np.ndarray,
) -> Stream:
    """The stream that was pickled; ArgumentError where the memory has other sizes."""
    integers = memory.view(np.int32)
    offsets = head_offsets(memory.itemsize)[0]
    held = [integers[offsets[name] // 4] for name in ("intervals", "samples_per_interval")]
    if held != [intervals, samples_per_interval]:
        raise ArgumentError(
            f"stream: given {intervals} intervals and {samples_per_interval} samples per interval "
            "with the memory of another stream, expected what was pickled"
        )
    stream = object.__new__(Stream)
    stream.intervals = intervals
    stream.samples_per_interval = samples_per_interval
    stream.period = period
    stream._sizes = sizes
    stream._entries = made(*which)
    stream._memory = memory.copy()
    stream._bind()
    return stream
