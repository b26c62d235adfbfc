"""Robots under a sampled controller, simulated in C: measure, control, limit, hold, integrate.

    y_k = Q((q_m, sensors)(t_k) + noise + bias), on request also the exact state,
    u_k = controller(k, y_k, ref_k),
    tau_m(t) = sat(u_k) + noise + disturbance(t),    t in [t_k + delay, t_(k+1) + delay)

Several robots with the same model advance together; they may have different run-time parameters.
Between samples the model's forward dynamics is integrated by the classical Runge-Kutta method in
equal steps, short enough for the fastest eigenvalue. Forces on the tool and disturbances of the
motors are constant within a step.
"""

from __future__ import annotations

import ctypes
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.checks.counts import count_of
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.limit_use import edges_of_curves
from flexgen.feedback.loop.controllers import loop_module
from flexgen.feedback.loop.hardware import DriveHardware, SensorChannels
from flexgen.feedback.loop.interface import INTERRUPTED, Controller, Setup
from flexgen.feedback.loop.robots_in_c import ARRAYS, Robots, seeds_of
from flexgen.model.elements import RobotModel
from flexgen.runtime.library import Library
from flexgen.simulation.environment.robot_function import RobotFunction

NOT_FINITE = "not finite"
TOO_LONG = "gears or frictions slip too fast for the integration steps"
STATUSES = ("done", NOT_FINITE, "controller failed", TOO_LONG)
STEP_TIMES_RATE = 1.0  # of the Runge-Kutta method
LARGEST_STEP_TIMES_RATE = 2.5  # stable below 2.78
# a sample; so many numbers of steps more than needed are tried before larger ones
MOST_STEPS = 1000
FEW = 64
MOST_DELAY = 64  # samples
TOOL = 6  # entries of a force and a torque on the tool
# of a plug-in
POLL_S = 0.05
LONGEST_STEP_S = 5.0
DELAY_ERROR = 1e-3  # of the sample time: largest difference between a delay and whole steps
# Samples of a long run between two looks at the time limit and at Ctrl-C: some 10 ms of computing.
PART = 2000

_CHANGING = ("state", "torque", "pending", "shown", "memory", "random")


@dataclass(frozen=True)
class Samples:
    """Measured angles ``q_m`` and commanded torques ``tau_m`` (samples, lanes, n_m), motor side;
    signals of the sensors ``sensors`` (samples, lanes, n_s).

    ``motion``: None, or (samples, 2 n_a + 3 n_m, lanes): q_a, v_a, q_m, v_m and the torque that
    acts just before the new one.
    """

    q_m: np.ndarray
    tau_m: np.ndarray
    motion: np.ndarray | None = None
    sensors: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of a `ClosedLoop` at a sample."""

    sample: int
    arrays: dict[str, np.ndarray]


class ClosedLoop:
    """Robots under sampled controllers, in C.

    Parameters
    ----------
    model : RobotModel
    library : Library
        With ``forward_dynamics``, of this model; also ``forward_dynamics_tool_force`` where forces
        act on the tool, and ``sensors``.
    hardware : DriveHardware
    controller : Controller
    q_a, q_m : arrays (lanes, n_a), (lanes, n_m)
        Where the robots rest at the start.
    rate : float [1/s]
        Largest size of an eigenvalue of the closed loop; it determines the integration step.
    seed : int
        Of the noise.
    steps : int, optional
        Integration steps in a sample; default: from ``rate``.
    parameters : array (n_p,) or (lanes, n_p), or RobotFunction, optional
        Run-time parameters, where the library has any: for all robots, or for each where the
        library was made so; default: those of the model file. Or the rate of robots whose gears
        have hysteresis, and a library without it.
    sensors : SensorChannels, optional
        The robot's sensors are measured too; the library has ``sensors``, or the channels have
        their ``function``.
    delay_samples : int or array (lanes,)
        Whole samples from a measurement to its torque, in addition to ``hardware.delay_s``.
    arm_reference : bool
        References hold ``v_m, q_a, v_a`` too.
    gain : array (lanes,), optional
        Factor of the feedback of each robot: torque minus feedforward; default: 1.
    exact_state : bool
        The controller measures ``q_a, v_a, q_m, v_m`` without noise too, as the last channels.

    Raises
    ------
    ArgumentError
        Arrays have wrong sizes, the step would be unstable, or the library is another one.
    """

    def __init__(
        self,
        model: RobotModel,
        library: Library,
        hardware: DriveHardware,
        controller: Controller,
        q_a: np.ndarray,
        q_m: np.ndarray,
        rate: float,
        *,
        seed: int = 0,
        steps: int | None = None,
        parameters: np.ndarray | RobotFunction | None = None,
        sensors: SensorChannels | None = None,
        delay_samples: int | np.ndarray = 0,
        arm_reference: bool = False,
        gain: np.ndarray | None = None,
        exact_state: bool = False,
        first_robot: int = 0,
    ) -> None:
        lanes = len(q_m)
        n_m = model.n_m
        n_a = model.n_a
        if q_a.shape != (lanes, n_a) or q_m.shape != (lanes, n_m):
            raise ArgumentError(
                f"q_a, q_m: given shapes {q_a.shape}, {q_m.shape}, expected (lanes, {n_a}), "
                f"(lanes, {n_m})"
            )
        if library.precision != "double" or library.sizes["n_a"] != n_a:
            raise ArgumentError(
                f"library: given {library!r}, expected one of {model.name} in double precision"
            )
        self.model = model
        self.hardware = hardware
        self.lanes = lanes
        self.steps = (
            integration_steps(hardware, rate)
            if steps is None
            else count_of("steps", steps, MOST_STEPS)
        )
        self._check_steps(rate)
        self.sample = 0
        self._first_robot = first_robot
        delay = round(hardware.delay_s / hardware.sample_s * self.steps)
        if (
            abs(delay / self.steps * hardware.sample_s - hardware.delay_s)
            > DELAY_ERROR * hardware.sample_s
        ):
            raise ArgumentError(
                f"delay_s: given {hardware.delay_s}, expected a whole number of integration "
                f"steps of {hardware.sample_s / self.steps:.3g} s; take a multiple of a "
                "fraction of the sample time"
            )
        whole, delay = divmod(delay, self.steps)
        late = np.broadcast_to(np.asarray(delay_samples, np.int32), (lanes,)) + np.int32(whole)
        if np.any(late < whole) or np.any(late > MOST_DELAY):
            raise ArgumentError(
                f"delay_s, delay_samples: given {hardware.delay_s:g} s and {delay_samples!r} "
                f"samples, expected 0 to {MOST_DELAY} samples of {hardware.sample_s:g} s"
            )
        self.channels = SensorChannels.ideal(0) if sensors is None else sensors
        if len(self.channels.noise) != (library.sizes.get("n_s", 0) if sensors is not None else 0):
            raise ArgumentError(
                f"sensors: given {len(self.channels.noise)} channels, expected "
                f"{library.sizes.get('n_s', 0)}"
            )
        self.states = 2 * (n_a + n_m) if exact_state else 0
        n_y = n_m + len(self.channels.noise) + self.states
        self.setup = Setup(
            q_m, hardware.sample_s, n_a, n_y, n_y + n_m + ((n_m + 2 * n_a) if arm_reference else 0)
        )
        self._controller = controller.compiled(self.setup)
        self._gears = parameters if isinstance(parameters, RobotFunction) else None
        self._states = (
            0 if self._gears is None else self._gears.function.size1_in(0) - 2 * (n_a + n_m)
        )
        numbers = None if isinstance(parameters, RobotFunction) else parameters
        self._arrays = self._memory(q_a, self._parameters(library, numbers), seed, late)
        self._arrays["gain"][:] = 1.0 if gain is None else gain
        self._functions: list[Any] = []
        self._library = library  # it must live as long as the addresses of its functions
        self._module = loop_module()
        self._robots = self._structure(library, delay)

    def _check_steps(self, rate: float) -> None:
        """Refuse integration steps that are too long for the fastest eigenvalue, ``rate`` [1/s],
        and more of them than a sample may have.
        """
        hardware = self.hardware
        if (
            self.steps > MOST_STEPS
            or rate * hardware.sample_s / self.steps > LARGEST_STEP_TIMES_RATE
        ):
            raise ArgumentError(
                f"steps: {self.steps} integration steps a sample of {hardware.sample_s} s, and "
                f"the fastest eigenvalue is {rate:.3g} 1/s: expected at most {MOST_STEPS} and a "
                f"step below {LARGEST_STEP_TIMES_RATE} over the eigenvalue; use a smaller "
                "sample time, or smooth the friction (smaller beta)"
            )

    def _parameters(self, library: Library, given: np.ndarray | None) -> np.ndarray:
        """The run-time parameters as the library reads them: (n_p,) for all robots, or (n_p,
        lanes) of a library that takes them at each point. None: those of the library.
        """
        n_p = len(library.parameter_names)
        used = np.array(library.parameters if given is None else given, dtype=float)
        each = library.per_point
        if (
            used.shape not in (((self.lanes, n_p), (n_p,)) if each else ((n_p,),))
            or not np.isfinite(used).all()
        ):
            raise ArgumentError(f"parameters: given {used.shape}, expected ({n_p},), finite")
        return np.ascontiguousarray(np.broadcast_to(used, (self.lanes, n_p)).T) if each else used

    def _memory(
        self, q_a: np.ndarray, parameters: np.ndarray, seed: int, late: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Arrays that the loop in C reads and writes, by the names of its structure.

        Parameters
        ----------
        q_a : array (lanes, n_a) [rad or m]
            Arm coordinates at the start, at rest.
        parameters : array
            From `_parameters`.
        seed : int
            Of the noise.
        late : array (lanes,)
            Delay of the torques in whole samples.
        """
        model = self.model
        hardware = self.hardware
        lanes = self.lanes
        channels = self.channels
        n_m = model.n_m
        n_a = model.n_a
        n_y = self.setup.n_y
        most = np.array(hardware.torque_max_Nm or (0.0,) * n_m)
        curves = hardware.torque_speed or ((),) * n_m
        if sizes := {
            name: n
            for name, n in (("torque_max_Nm", len(most)), ("torque_speed", len(curves)))
            if n != n_m
        }:
            raise ArgumentError(
                f"drives: given sizes {sizes}, expected one for each of {n_m} motors"
            )
        own = (
            np.full(n_m, hardware.encoder_noise_rad),
            np.full(n_m, hardware.encoder_resolution_rad),
        )
        exact = np.zeros(self.states)
        delays = np.concatenate([np.zeros(n_m), channels.delay_samples, exact]).astype(np.int32)
        if delays.max() > MOST_DELAY:
            raise ArgumentError(
                f"sensors, delay_samples: given {delays.max()}, expected at most {MOST_DELAY}"
            )
        n = n_a + n_m
        n_z = self._states
        rows = 10 * n + 5 * n_z + n_m + len(model.i_g) + n_y + 2 * TOOL
        return {
            "parameters": parameters,
            "memory": self._controller.memory,
            "resolution": np.concatenate([own[1], channels.resolution, exact]),
            "noise": np.concatenate([own[0], channels.noise, exact]),
            "bias": np.concatenate([np.zeros(n_m), channels.bias, exact]),
            "late": delays,
            "gain": np.ones(lanes),
            "torque_noise": np.full(n_m, hardware.torque_noise_Nm),
            "torque_max": most,
            "state": np.vstack(
                [q_a.T, np.zeros((n_a, lanes)), self.setup.q_m.T, np.zeros((n_m + n_z, lanes))]
            ).copy(),
            "torque": np.zeros((n_m, lanes)),
            "delay": late,
            "pending": np.zeros((int(late.max()) + 1, n_m, lanes)),
            "shown": np.zeros((int(delays.max()) + 1, n_y, lanes)),
            "scratch": np.zeros((rows, lanes)),
            "random": seeds_of(seed, self._first_robot + lanes)[self._first_robot :],
            "status": np.zeros(lanes, np.int32),
            "saturated": np.zeros(lanes, np.int64),
            "encoder_error": _encoder_terms(model),
            "torque_edges": edges_of_curves(curves),
        }

    def _structure(self, library: Library, delay: int) -> Robots:
        """The structure of the loop in C: sizes, addresses of arrays, of functions of the library
        and of the controller. ``delay``: of the torques within a sample, in integration steps.
        """
        names = ["forward_dynamics", "forward_dynamics_tool_force", "sensors"]
        entries: list[int | None] = []
        work = np.zeros(1)
        for name in names:
            function = library.functions.get(name)
            address, own = function.batch_address() if function is not None else (None, work)
            entries.append(address)
            work = own if own.size > work.size else work
        if entries[0] is None:
            raise ArgumentError(f"library: given {library!r}, expected one with forward_dynamics")
        self._arrays["work"] = work
        # a single robot without parameters: the function for one point is faster
        one = None
        one_work = None
        if self.lanes == 1 and not library.parameter_names:
            one, own = library.forward_dynamics.single_address()
            self._arrays["one_work"] = own
            one_work = own.ctypes.data if own.size else None
        at = {name: array.ctypes.data for name, array in self._arrays.items()}
        # the robots do not need them
        if all(port.name != "parameters" for port in library.forward_dynamics.inputs):
            at["parameters"] = 0
        kept = {name: at[name] or None for name in ARRAYS}
        terms = self._arrays["encoder_error"]
        made = Robots(
            lanes=self.lanes,
            n_a=self.model.n_a,
            n_m=self.model.n_m,
            n_g=len(self.model.i_g),
            n_y=self.setup.n_y,
            n_ref=self.setup.n_ref,
            states=self.states,
            steps=self.steps,
            delay_steps=delay,
            slots=len(self._arrays["pending"]),
            history=len(self._arrays["shown"]) - 1,
            disturbed=0,
            sample_s=self.hardware.sample_s,
            plant=entries[0],
            pushed=entries[1],
            sensors=entries[2] if len(self.channels.noise) else None,
            plant_work=at["work"],
            one=one,
            one_work=one_work,
            controller=self._controller.address,
            memory_size=self._controller.memory.shape[1],
            together=self._controller.together or None,
            **kept,
        )
        if self._gears is not None:
            made.n_z = self._states
            made.hysteresis = self._address(self._gears)
        if self.channels.function is not None:
            made.signals = self._address(self.channels.function)
        made.encoder_terms = len(terms)
        made.encoder_error = terms.ctypes.data
        made.n_edges = len(self._arrays["torque_edges"])
        made.torque_edges = at["torque_edges"]
        return made

    def _address(self, function: RobotFunction) -> int:
        """The address of a function of each robot for C, which lives as long as the loop."""
        made = function.in_loop(self.lanes)
        self._functions.append((function, made))
        return ctypes.addressof(made)

    def touch(self, wall: RobotFunction) -> None:
        """Let the tools touch a wall: force and torque (6,) on a tool from q_a, v_a and the
        numbers of its robot.
        """
        if not self._robots.pushed:
            raise ArgumentError(
                "wall: a force on the tool needs a library with forward_dynamics_tool_force"
            )
        self._robots.wall = self._address(wall)

    def hold(self, tau_m: np.ndarray) -> None:
        """The torque (lanes, n_m) that acts before the first sample."""
        self._arrays["torque"][:] = tau_m.T
        self._arrays["pending"][:] = tau_m.T

    @property
    def state(self) -> tuple[np.ndarray, ...]:
        """``q_a, v_a, q_m, v_m`` and the states of gears and motors z/W now, (lanes, n) each."""
        ends = np.cumsum([self.model.n_a, self.model.n_a, self.model.n_m, self.model.n_m])
        return tuple(x.T.copy() for x in np.split(self._arrays["state"], ends))

    def snapshot(self) -> Snapshot:
        """All that changes in a run, for `restore`."""
        return Snapshot(self.sample, {name: self._arrays[name].copy() for name in _CHANGING})

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from the state of another loop; parameters of the robots and gains stay those
        of this one.
        """
        self.sample = snapshot.sample
        fixed = self._controller.fixed
        for name, array in snapshot.arrays.items():
            if name == "memory":
                self._arrays[name][:, fixed:] = array[:, fixed:]
            else:
                self._arrays[name][:] = array

    @property
    def saturated(self) -> np.ndarray:
        """Number of samples at a torque limit so far, (lanes,)."""
        return self._arrays["saturated"].copy()

    @property
    def failures(self) -> tuple[str, ...]:
        """Reason why each robot stopped early, or empty."""
        return tuple(
            "" if status == 0 else self._controller.errors.get(lane, STATUSES[status])
            for lane, status in enumerate(self._arrays["status"])
        )

    def run(
        self,
        reference: np.ndarray,
        samples: int,
        *,
        motion: bool = False,
        disturbances: np.ndarray | None = None,
        check: bool = True,
    ) -> Samples:
        """Run some more samples.

        Parameters
        ----------
        reference : array (period, lanes, n_ref)
            Angles [rad], signals of the sensors and feedforward torques [N m] at each sample, see
            `flexgen.feedback.loop.interface.Reference`, repeated periodically; sample 0 is the
            first of the whole run.
        motion : bool
            Also the motion at each sample.
        disturbances : array (samples * steps, n_m + 6, 1 or lanes), optional
            In each integration step: torques on the motors [N m], force [N] and torque [N m] on
            the tool, world axes.
        check : bool
            False: no error where a robot fails, see `failures`.

        Raises
        ------
        SolverError
            A robot's state is not finite, or its controller failed.
        """
        n_m = self.model.n_m
        n_ref = self.setup.n_ref
        n_y = self.setup.n_y
        reference = np.ascontiguousarray(reference, dtype=float)
        if (
            reference.ndim != 3
            or reference.shape[1:] != (self.lanes, n_ref)
            or not np.isfinite(reference).all()
        ):
            raise ArgumentError(
                f"reference: given shape {reference.shape}, expected finite numbers (period, "
                f"{self.lanes}, {n_ref})"
            )
        y = np.empty((samples, self.lanes, n_y))
        tau_m = np.empty((samples, self.lanes, n_m))
        recorded = (
            np.empty((samples, 2 * self.model.n_a + 3 * n_m, self.lanes)) if motion else None
        )
        self._robots.record = None if recorded is None else recorded.ctypes.data
        kept = self._disturb(disturbances, samples)
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (reference, y, tau_m)]
        arguments = (
            ctypes.byref(self._robots),
            ctypes.c_int64(self.sample),
            ctypes.c_int64(samples),
            pointers[0],
            ctypes.c_int64(len(reference)),
            pointers[1],
            pointers[2],
        )
        used = (reference, y, tau_m, recorded, kept)
        if self._controller.foreign:
            failed = self._run_in_thread(arguments, used)
        else:
            failed = self._module.flexgen_loop_run(*arguments)
        self.sample += samples
        if INTERRUPTED in self._controller.errors.values():
            raise KeyboardInterrupt
        if failed and check:
            lane = next(lane for lane, reason in enumerate(self.failures) if reason)
            raise SolverError(
                f"closed loop: robot {lane + 1} of {self.lanes}: {self.failures[lane]} before t "
                f"= {self.sample * self.hardware.sample_s:.3f} s; lower the gains or the "
                f"excitation, or take more integration steps a sample than {self.steps}"
            )
        return Samples(y[:, :, :n_m], tau_m, recorded, y[:, :, n_m:])

    def _run_in_thread(self, arguments: tuple[Any, ...], used: tuple[Any, ...]) -> int:
        """The run in a separate thread: a controller that does not return is left there, with all
        arrays ``used``.
        """
        result: list[int] = []

        def run(kept: tuple[Any, ...] = (self, used)) -> None:  # they live as long as the thread
            result.append(self._module.flexgen_loop_run(*arguments))

        thread = threading.Thread(target=run, name="controller", daemon=True)
        thread.start()
        seen = -1
        since = time.monotonic()
        try:
            while thread.is_alive():
                thread.join(POLL_S)
                if self._robots.now != seen:
                    seen = self._robots.now
                    since = time.monotonic()
                elif time.monotonic() - since > LONGEST_STEP_S and thread.is_alive():
                    raise SolverError(
                        f"closed loop: the plug-in has not returned from its step {seen} for "
                        f"{LONGEST_STEP_S:g} s; its thread cannot be stopped and continues "
                        "until this program ends"
                    )
        except BaseException:  # Ctrl-C too
            self._robots.stop = 1
            thread.join(POLL_S)
            raise
        return result[0]

    def _disturb(self, given: np.ndarray | None, samples: int) -> tuple[np.ndarray, ...]:
        """Give the disturbances of the next ``samples`` samples to C: (samples * steps, n_m + 6, 1
        or lanes), torques of the motors [N m] and the wrench on the tool [N, N m] in each
        integration step, for all robots or each.

        Returns
        -------
        tuple of arrays
            They must live as long as the run.

        Raises
        ------
        ArgumentError
            Another shape, numbers that are not finite, or a library without the function for
            forces.
        """
        self._robots.disturbed = 0
        if given is None:
            return ()
        rows = self.model.n_m + TOOL
        d = np.ascontiguousarray(given, dtype=float)
        if (
            d.ndim != 3
            or d.shape[:2] != (samples * self.steps, rows)
            or d.shape[2] not in (1, self.lanes)
        ):
            raise ArgumentError(
                f"disturbances: given shape {d.shape}, expected ({samples * self.steps}, "
                f"{rows}, 1 or {self.lanes})"
            )
        if not np.isfinite(d).all():
            raise ArgumentError(
                "disturbances: given entries that are not finite, expected numbers"
            )
        pushing = np.ascontiguousarray(d[:, self.model.n_m :].any(axis=(1, 2)).astype(np.uint8))
        if pushing.any() and not self._robots.pushed:
            raise ArgumentError(
                "disturbances: a force on the tool needs a library with "
                "forward_dynamics_tool_force"
            )
        self._robots.disturbed = d.shape[2]
        self._robots.disturbances = d.ctypes.data
        self._robots.pushing = pushing.ctypes.data
        return d, pushing

    def periods(
        self, reference: np.ndarray, count: int, *, motion: bool = False
    ) -> Iterator[Samples]:
        """One period of the reference after the other."""
        for _ in range(count):
            yield self.run_in_parts(reference, len(reference), motion=motion)

    def run_in_parts(
        self, reference: np.ndarray, samples: int, *, motion: bool = False
    ) -> Samples:
        """Run ``samples`` more samples as `run` does, in parts between which the time limit and
        Ctrl-C end it. ``reference``: as of `run`; ``motion``: also keep the states.
        """
        parts = []
        for first in range(0, samples, PART):
            check_time("closed loop")
            parts.append(self.run(reference, min(PART, samples - first), motion=motion))
        if len(parts) == 1:
            return parts[0]
        names = ("q_m", "tau_m", "sensors", *(["motion"] if motion else []))
        return Samples(**{n: np.concatenate([getattr(x, n) for x in parts]) for n in names})


def _encoder_terms(model: RobotModel) -> np.ndarray:
    """Terms of the errors of all encoders, rows of motor, harmonic, coefficient of the cosine and
    of the sine.
    """
    sums = [
        (j, motor.encoder_error)
        for j, motor in enumerate(model.motors)
        if motor.encoder_error is not None
    ]
    rows = [(j, *term) for j, e in sums for term in zip(e.harmonics, e.cos, e.sin, strict=True)]
    return np.array(rows, dtype=float).reshape(len(rows), 4)


def integration_steps(hardware: DriveHardware, rate: float) -> int:
    """Integration steps in a sample: short enough for the fastest eigenvalue, ``rate`` [1/s], and
    so many that the delay of the drives is a whole number of them.

    An exact number among the few smallest is preferred, then the smallest with an error below
    `DELAY_ERROR`, then the best of the few.
    """
    least = max(1, math.ceil(rate * hardware.sample_s / STEP_TIMES_RATE))
    part = hardware.delay_s / hardware.sample_s
    few = range(least, least + FEW)
    errors = {
        n: abs(round(part * n) / n - part)
        for n in (*few, *range(few.stop, max(MOST_STEPS // 2, few.stop)))
    }
    exact = (n for n in few if errors[n] < DELAY_ERROR / 10)
    near = (n for n, error in errors.items() if error < DELAY_ERROR)
    return next(exact, next(near, min(few, key=errors.__getitem__)))
