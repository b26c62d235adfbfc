"""Robots under a sampled controller, simulated in C: measure, control, limit, hold, integrate.

    y_k = Q(q_m(t_k) + noise),    u_k = controller(k, y_k, ref_k),    tau_m(t) = sat(u_k) + noise,
    t in [t_k + delay, t_(k+1) + delay)

Several robots with the same model advance together. Between samples the model's forward dynamics is integrated by the
classical Runge-Kutta method in equal steps, short enough for the fastest eigenvalue.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.build.c_module import c_module
from flexgen.errors import ArgumentError, SolverError
from flexgen.model.elements import RobotModel
from flexgen.runtime.library import Library

SOURCE = Path(__file__).with_name("closed_loop.c")
STATUSES = ("done", "not finite", "controller failed")
STEP_TIMES_RATE, LARGEST_STEP_TIMES_RATE = 1.0, 2.5  # of the Runge-Kutta method; stable below 2.78
MOST_STEPS = 1000  # a sample
DELAY_ERROR = 1e-3  # of the sample time: largest difference between a delay and whole steps


@dataclass(frozen=True)
class Cascade:
    """A drive with position and speed control (P-PI) and feedforward torque, motor side.

        w = v_ref + position_gain (q_ref - q) - v,    u = tau_ff + speed_gain (w + integral_gain int w dt)

    ``position_gain`` [1/s], ``speed_gain`` [N m s/rad], ``integral_gain`` [1/s]: (n_m,) each. The speed is the
    difference of two samples of the measured angle, and the same difference of the reference.
    """

    position_gain: np.ndarray
    speed_gain: np.ndarray
    integral_gain: np.ndarray

    @property
    def fixed_memory(self) -> int:
        """Bytes of the memory that the controller does not change: sizes and gains."""
        return 8 * (2 + 3 * len(self.speed_gain))

    def memory(self, q_m: np.ndarray, sample_s: float) -> np.ndarray:
        """Memory of the controllers in C, (lanes, bytes), for robots that rest at ``q_m`` (lanes, n_m)."""
        n = q_m.shape[1]
        head = np.zeros((len(q_m), 2 + 6 * n))
        head[:, 0] = np.array([n], np.int64).view(np.float64)[0]
        head[:, 1] = sample_s
        for k, gains in enumerate((self.position_gain, self.speed_gain, self.integral_gain)):
            head[:, 2 + k * n : 2 + (k + 1) * n] = gains
        head[:, 2 + 3 * n : 2 + 4 * n] = q_m
        head[:, 2 + 4 * n : 2 + 5 * n] = q_m
        return head.view(np.uint8)


@dataclass(frozen=True)
class DriveHardware:
    """Sampling, sensors and limits of the drives, motor side.

    Parameters
    ----------
    sample_s : float [s]
    delay_s : float [s]
        From the measurement to the torque; below ``sample_s``, and simulated by whole integration steps.
    encoder_resolution_rad, encoder_noise_rad : float [rad]
        Smallest difference that the encoders show, and standard deviation of white noise before it; 0: none.
    torque_noise_Nm : float [N m]
        Standard deviation of white noise on the torque of each interval; 0: none.
    torque_max_Nm : tuple of float [N m]
        Limits of the motors; empty: none.
    """

    sample_s: float = 5e-4
    delay_s: float = 0.0
    encoder_resolution_rad: float = 0.0
    encoder_noise_rad: float = 0.0
    torque_noise_Nm: float = 0.0
    torque_max_Nm: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sample_s) and self.sample_s > 0):
            raise ArgumentError(f"sample_s: given {self.sample_s!r}, expected a time > 0 in s")
        if not 0 <= self.delay_s < self.sample_s:
            raise ArgumentError(f"delay_s: given {self.delay_s!r}, expected >= 0, below sample_s = {self.sample_s}")
        for name in ("encoder_resolution_rad", "encoder_noise_rad", "torque_noise_Nm"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ArgumentError(f"{name}: given {value!r}, expected a number >= 0")


@dataclass(frozen=True)
class Samples:
    """Measured angles ``q_m`` and commanded torques ``tau_m`` (samples, lanes, n_m), motor side.

    ``motion``: None, or (samples, 2 n_a + 3 n_m, lanes): q_a, v_a, q_m, v_m and the torque that acts just before the
    new one.
    """

    q_m: np.ndarray
    tau_m: np.ndarray
    motion: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of a `ClosedLoop` at a sample."""

    sample: int
    arrays: dict[str, np.ndarray]


class ClosedLoop:
    """Robots under cascaded drives, in C.

    Parameters
    ----------
    model : RobotModel
    library : Library
        With ``forward_dynamics``, of this model.
    hardware : DriveHardware
    controller : Cascade
    q_a, q_m : arrays (lanes, n_a), (lanes, n_m)
        Where the robots rest at the start.
    rate : float [1/s]
        Largest size of an eigenvalue of the closed loop; it determines the integration step.
    seed : int
        Of the noise.
    steps : int, optional
        Integration steps in a sample; default: from ``rate``.
    parameters : array (n_p,), optional
        Run-time parameters, where the library has any; default: those of the model file.

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
        controller: Cascade,
        q_a: np.ndarray,
        q_m: np.ndarray,
        rate: float,
        *,
        seed: int = 0,
        steps: int | None = None,
        parameters: np.ndarray | None = None,
    ) -> None:
        lanes, n_m, n_a = len(q_m), model.n_m, model.n_a
        if q_a.shape != (lanes, n_a) or q_m.shape != (lanes, n_m):
            raise ArgumentError(
                f"q_a, q_m: given shapes {q_a.shape}, {q_m.shape}, expected (lanes, {n_a}), (lanes, {n_m})"
            )
        if library.precision != "double" or library.sizes["n_a"] != n_a:
            raise ArgumentError(f"library: given {library!r}, expected one of {model.name} in double precision")
        used = np.array(library.parameters if parameters is None else parameters, dtype=float)
        if used.shape != (len(library.parameter_names),) or not np.isfinite(used).all():
            raise ArgumentError(f"parameters: given {used.shape}, expected ({len(library.parameter_names)},), finite")
        self.model, self.hardware, self.lanes = model, hardware, lanes
        self.steps = steps or integration_steps(hardware, rate)
        if self.steps > MOST_STEPS or rate * hardware.sample_s / self.steps > LARGEST_STEP_TIMES_RATE:
            raise ArgumentError(
                f"steps: {self.steps} integration steps a sample of {hardware.sample_s} s, and the fastest eigenvalue "
                f"is {rate:.3g} 1/s: expected at most {MOST_STEPS} and a step below {LARGEST_STEP_TIMES_RATE} over the "
                "eigenvalue; use a smaller sample time, or smooth the friction (smaller beta)"
            )
        self.sample = 0
        n = n_a + n_m
        delay = round(hardware.delay_s / hardware.sample_s * self.steps)
        if abs(delay / self.steps * hardware.sample_s - hardware.delay_s) > DELAY_ERROR * hardware.sample_s:
            raise ArgumentError(
                f"delay_s: given {hardware.delay_s}, expected a whole number of integration steps of "
                f"{hardware.sample_s / self.steps:.3g} s; take a multiple of a fraction of the sample time"
            )
        plant, work = library.forward_dynamics.batch_address()
        most = np.array(hardware.torque_max_Nm or (0.0,) * n_m)
        if most.shape != (n_m,):
            raise ArgumentError(f"torque_max_Nm: given {len(most)} numbers, expected one for each of {n_m} motors")
        self._arrays = {
            "work": work,
            "parameters": used,
            "memory": np.ascontiguousarray(controller.memory(q_m, hardware.sample_s)),
            "resolution": np.full(n_m, hardware.encoder_resolution_rad),
            "angle_noise": np.full(n_m, hardware.encoder_noise_rad),
            "torque_noise": np.full(n_m, hardware.torque_noise_Nm),
            "torque_max": most,
            "state": np.vstack([q_a.T, np.zeros((n_a, lanes)), q_m.T, np.zeros((n_m, lanes))]).copy(),
            "torque": np.zeros((n_m, lanes)),
            "scratch": np.zeros((10 * n + n_m, lanes)),
            "random": _seeds(seed, lanes),
            "status": np.zeros(lanes, np.int32),
            "saturated": np.zeros(lanes, np.int64),
        }
        self._module = c_module(SOURCE)
        a = {name: ctypes.c_void_p(array.ctypes.data) for name, array in self._arrays.items()}
        self._robots = _Robots(
            lanes, n_a, n_m, 2 * n_m, self.steps, delay, hardware.sample_s, plant,
            a["parameters"] if len(used) else None, a["work"],
            ctypes.cast(self._module.flexgen_loop_cascade, ctypes.c_void_p), a["memory"],
            self._arrays["memory"].shape[1], a["resolution"], a["angle_noise"], a["torque_noise"], a["torque_max"],
            a["state"], a["torque"], a["scratch"], a["random"], a["status"], a["saturated"], None,
        )  # fmt: skip
        self._fixed_memory = controller.fixed_memory
        self._library = library  # it must live as long as the address of its function

    def hold(self, tau_m: np.ndarray) -> None:
        """The torque (lanes, n_m) that acts before the first sample."""
        self._arrays["torque"][:] = tau_m.T

    @property
    def state(self) -> tuple[np.ndarray, ...]:
        """``q_a, v_a, q_m, v_m`` now, (lanes, n) each."""
        n_a, n_m = self.model.n_a, self.model.n_m
        return tuple(x.T.copy() for x in np.split(self._arrays["state"], [n_a, 2 * n_a, 2 * n_a + n_m]))

    def snapshot(self) -> Snapshot:
        """All that changes in a run, for `restore`."""
        return Snapshot(
            self.sample, {name: self._arrays[name].copy() for name in ("state", "torque", "memory", "random")}
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go on where another loop was; parameters of the robots and gains stay those of this one."""
        self.sample = snapshot.sample
        fixed = self._fixed_memory
        for name, array in snapshot.arrays.items():
            if name == "memory":
                self._arrays[name][:, fixed:] = array[:, fixed:]
            else:
                self._arrays[name][:] = array

    @property
    def saturated(self) -> np.ndarray:
        """Number of samples at a torque limit so far, (lanes,)."""
        return self._arrays["saturated"].copy()

    def run(self, reference: np.ndarray, samples: int, *, motion: bool = False) -> Samples:
        """Go on for some samples.

        Parameters
        ----------
        reference : array (period, lanes, 2 n_m)
            Angles [rad] and feedforward torques [N m] of the motors at each sample, repeated periodically; sample 0 is
            the first of the whole run.
        motion : bool
            Also the motion at each sample.

        Raises
        ------
        SolverError
            A robot's state is not finite, or its controller failed.
        """
        n_m = self.model.n_m
        reference = np.ascontiguousarray(reference, dtype=float)
        if reference.ndim != 3 or reference.shape[1:] != (self.lanes, 2 * n_m) or not np.isfinite(reference).all():
            raise ArgumentError(
                f"reference: given shape {reference.shape}, expected finite numbers (period, {self.lanes}, {2 * n_m})"
            )
        q_m, tau_m = (np.empty((samples, self.lanes, n_m)) for _ in range(2))
        recorded = np.empty((samples, 2 * self.model.n_a + 3 * n_m, self.lanes)) if motion else None
        self._robots.record = None if recorded is None else recorded.ctypes.data
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (reference, q_m, tau_m)]
        failed = self._module.flexgen_loop_run(
            ctypes.byref(self._robots), ctypes.c_int64(self.sample), ctypes.c_int64(samples), pointers[0],
            ctypes.c_int64(len(reference)), pointers[1], pointers[2],
        )  # fmt: skip
        self.sample += samples
        if failed:
            lane = int(np.flatnonzero(self._arrays["status"])[0])
            raise SolverError(
                f"closed loop: robot {lane + 1} of {self.lanes}: {STATUSES[self._arrays['status'][lane]]} before "
                f"t = {self.sample * self.hardware.sample_s:.3f} s; lower the gains or the excitation, or take more "
                f"integration steps a sample than {self.steps}"
            )
        return Samples(q_m, tau_m, recorded)

    def periods(self, reference: np.ndarray, count: int, *, motion: bool = False) -> Iterator[Samples]:
        """One period of the reference after the other."""
        for _ in range(count):
            yield self.run(reference, len(reference), motion=motion)


def integration_steps(hardware: DriveHardware, rate: float) -> int:
    """Integration steps in a sample: short enough for the fastest eigenvalue, and the delay a whole number of them."""
    least = max(1, math.ceil(rate * hardware.sample_s / STEP_TIMES_RATE))
    part = hardware.delay_s / hardware.sample_s
    errors = {n: abs(round(part * n) / n - part) for n in range(least, least + 64)}
    return next((n for n, error in errors.items() if error < DELAY_ERROR / 10), min(errors, key=errors.__getitem__))


class _Robots(ctypes.Structure):
    """``loop_robots`` of closed_loop.c."""

    _fields_ = [
        *[(name, ctypes.c_int32) for name in ("lanes", "n_a", "n_m", "n_ref", "steps", "delay_steps")],
        ("sample_s", ctypes.c_double),
        *[(name, ctypes.c_void_p) for name in ("plant", "parameters", "plant_work", "controller", "memory")],
        ("memory_size", ctypes.c_int64),
        *[
            (name, ctypes.c_void_p)
            for name in (
                "resolution angle_noise torque_noise torque_max state torque scratch random status saturated "
                "record".split()
            )
        ],
    ]


def _seeds(seed: int, lanes: int) -> np.ndarray:
    """Start of the random numbers of each robot, (lanes, 4): SplitMix64 of the seed and the robot."""
    out = np.empty((lanes, 4), np.uint64)
    mask, x = 2**64 - 1, (seed * 0x9E3779B97F4A7C15 + 0x2545F4914F6CDD1D) & (2**64 - 1)
    for lane in range(lanes):
        for k in range(4):
            x = (x + 0x9E3779B97F4A7C15) & mask
            z = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & mask
            z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
            out[lane, k] = z ^ (z >> 31)
    return out
