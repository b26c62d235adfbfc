"""Extended Kalman filter of an elastic robot's state, in C around the emitted model.

    x' = f(x, u + d) + noise,    d' = noise,    y = g(x, u + d) + noise
    x = (q_a, q_m, v_a, v_m), of the motors those behind elastic gears;  d: torque on each motor

The prediction integrates f by the classical Runge-Kutta method; its derivative F has second order
in the sample time, of the linearization at the predicted state of the sample before. Measurements
are used one after the other. Noises: of the torques of a sample, of disturbances that grow, of a
force on the tool, and of the measurements.

Source: A. Gelb (ed.), Applied Optimal Estimation, 1974, sec. 6.1.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_class, checked_result, checked_types
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.results import Result
from flexgen.base.spec.arguments import is_number
from flexgen.codegen.build.c_module import c_module
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.feedback.loop.channels import MOTORS, Channels, Noise, channels_of
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.feedback.observers.design import (
    Noises,
    allocate_aligned,
    check_observable,
    record,
    state_names,
    tool_force_noise,
    vector,
)
from flexgen.model.abilities import check_ability
from flexgen.model.elements import RobotModel
from flexgen.runtime.calls import Function

SOURCE = Path(__file__).with_name("extended_kalman.c")
STATUSES = (
    "done",
    "a number is not finite; check the measurements and torques, and the sample time",
    "the covariance is not positive any more; use larger noises, or a smaller sample time",
    "the model failed at the estimate",
)
FLAGS = "-O3 -ftree-vectorize"  # tiles of products need vectors; no sum changes its order
STEP_TIMES_RATE = 1.0  # of the Runge-Kutta method
# of the fourth order of F: an error of 3e-4 of the fastest mode, relative
TRANSITION_TIMES_RATE = 0.5
LARGEST_RATE = 2.0**10  # steps a sample
TILE = 8  # columns of a tile in C
# rad or m, rad/s or m/s, of the largest torque
START = {"position": 1e-3, "speed": 1e-2, "torque": 0.1}


@checked_result
@dataclass(frozen=True)
class Estimate(Result):
    """Estimates of one sample, or of n samples with a first axis.

    Attributes
    ----------
    q_a, v_a : arrays (n_a,) [rad, m]
    q_m, v_m : arrays (n_m,) [rad, rad/s]
        Motor side; behind rigid gears those of the arm.
    disturbance : array (n_m,) [N m]
        Torques in addition to the commanded ones; zero where the filter has none.
    innovation : array (n_y,)
        Measurement minus prediction.
    normalized : float or array
        ``nu' S^-1 nu`` of the innovation nu and its covariance S: chi-square with n_y degrees of
        freedom.
    deviation : array (n_z,)
        Standard deviations of the states, see `ExtendedKalmanFilter.states`.

    Examples
    --------
    >>> run = flexgen.control("elbow", sample_time=1e-3).nominal
    >>> found = flexgen.ExtendedKalmanFilter("elbow").run(run.measured, run.tau_m)
    >>> found.q_a.shape, found.disturbance.shape, found.innovation.shape
    ((3505, 2), (3505, 2), (3505, 2))
    """

    q_a: np.ndarray
    v_a: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    disturbance: np.ndarray
    innovation: np.ndarray
    normalized: Any
    deviation: np.ndarray

    __repr__ = short_repr


@checked_class
class ExtendedKalmanFilter:
    """Extended Kalman filter with disturbance torques; see the module.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    outputs : str or sequence of str
        Measured signals: ``"motors"``, motors and sensors of the model file by name,
        ``"tool_accelerometer"``, ``"tool_gyro"``, ``"link_encoders"``; see
        `flexgen.feedback.loop.channels`.
    sample_time : float [s]
    noise : float or mapping of str to float, optional
        Standard deviations of the measurements by the names of the outputs.
    torque_noise : float
        White noise of the torques of a sample, relative to the largest torque of the motor.
    disturbance_rate : float
        Growth of the disturbances: this times the largest torque in a second.
    tool_force : float [N]
        White noise of a force on the tool; 0: none.
    disturbances : bool
        False: the filter has no disturbance torques.
    native : bool
        Compile for this processor: about twice as fast, and the last digits depend on the
        processor.

    Attributes
    ----------
    model : RobotModel
        With the sensors that are used.
    outputs : tuple of str
        Channels in the order of the measurements.
    states : tuple of str
        ``q_a, q_m, v_a, v_m`` by name, then the disturbances.

    Raises
    ------
    ArgumentError
        An output is not known, a noise is not above zero, the outputs do not determine the state,
        or the model has hysteresis or friction with a state.

    Examples
    --------
    >>> run = flexgen.control("elbow", encoder_noise=1e-5, sample_time=1e-3)
    >>> found = flexgen.ExtendedKalmanFilter("elbow").run(run.nominal.measured, run.nominal.tau_m)
    >>> bool(abs(found.q_a[-1] - run.nominal.q_a[-1]).max() < 1e-4)  # rad
    True
    """

    def __init__(
        self,
        model: str | Path | RobotModel | Equations,
        outputs: str | Sequence[str] = MOTORS,
        *,
        sample_time: float = 1e-3,
        noise: Noise | None = None,
        torque_noise: float = 0.05,
        disturbance_rate: float = 1.0,
        tool_force: float = 50.0,
        disturbances: bool = True,
        native: bool = False,
    ) -> None:
        if not (is_number(sample_time) and 1e-6 <= sample_time <= 1.0):
            raise ArgumentError(f"sample_time: given {sample_time!r}, expected 1e-6 to 1 s")
        robot = robot_of(model)
        check_ability(robot, "ExtendedKalmanFilter")
        self.channels: Channels = channels_of(robot, outputs, noise)
        self.model = self.channels.model
        self.outputs = self.channels.names
        self.sample_time = float(sample_time)
        self.noises = Noises(robot, torque_noise, disturbance_rate, tool_force)
        self.n_d = self.model.n_m if disturbances else 0
        self.states = state_names(self.model, self.n_d > 0)
        equations = derive(self.model)
        self._local = LocalDynamics(equations)
        self._poses = PoseModels(self.model)
        self._native = native
        self._module = c_module(SOURCE, "" if native else FLAGS, native=native)
        self._module.flexgen_kalman_size.restype = ctypes.c_int64
        self._module.flexgen_kalman_run.restype = ctypes.c_int64
        functions = ["forward_dynamics", "linearize"]
        functions += ["sensors", "sensor_derivatives"] if self.model.sensors else []
        self._library = library_with(self.model, functions, native=native)
        rest = self._at_rest(self.model.eta @ np.array(self.model.home))
        check_observable(self._poses.at(rest), self.channels, self.states, self.noises, self.n_d)
        self._make(rest)
        self.reset()

    def __repr__(self) -> str:
        sizes = f"{len(self.outputs)} outputs, {len(self.states)} states"
        return (
            f"<ExtendedKalmanFilter {self.model.title}: {sizes}, samples of "
            f"{1e3 * self.sample_time:.4g} ms>"
        )

    # --- begin -----------------------------------------------------------------------------------
    def reset(
        self,
        q_m: np.ndarray | None = None,
        *,
        state: np.ndarray | None = None,
        covariance: np.ndarray | None = None,
    ) -> None:
        """Begin at rest with the motors at ``q_m`` (n_m,) [rad], or at a state.

        Parameters
        ----------
        q_m : array (n_m,), optional
            Default: the home position.
        state : array (n_z,), optional
            Instead of it; see `states`.
        covariance : array (n_z, n_z), optional
            Of the state; default: 1e-3 rad or m, 1e-2 rad/s or m/s, and a tenth of the largest
            torques.

        Raises
        ------
        ArgumentError
            A size is wrong, or the covariance is not symmetric and positive.
        SolverError
            The robot has no equilibrium there.
        """
        n_z = len(self.states)
        n = self.model.dof
        if state is None:
            angles = (
                self.model.eta @ np.array(self.model.home)
                if q_m is None
                else vector("q_m", q_m, self.model.n_m)
            )
            motion = self._at_rest(angles)
            z = np.zeros(n_z)
            z[: self.model.n_a] = motion[0][0]
            z[self.model.n_a : n] = angles[list(self.model.i_m)]
        else:
            z = vector("state", state, n_z)
            motion = self._at(z)
        if covariance is None:
            covariance = np.diag(self._start() ** 2)
        P = np.asarray(covariance, dtype=float)
        if (
            P.shape != (n_z, n_z)
            or not np.isfinite(P).all()
            or not np.allclose(P, P.T, rtol=1e-9, atol=0.0)
        ):
            raise ArgumentError(
                f"covariance: given shape {P.shape}, expected a symmetric matrix ({n_z}, {n_z})"
            )
        if (
            not np.all(np.diag(P) > 0)
            or np.linalg.eigvalsh(P / np.sqrt(np.outer(np.diag(P), np.diag(P))))[0] < -1e-9
        ):
            raise ArgumentError(
                "covariance: given a matrix with a variance <= 0, expected a positive one"
            )
        self._process[: 2 * n, : 2 * n] = tool_force_noise(
            self._poses.at(motion), self.sample_time, self.noises.tool_force
        )
        self._head.status = self._head.begun = 0
        self._z[:] = z
        self._P[:] = 0.0
        self._P[:n_z, :n_z] = (P + P.T) / 2

    def _start(self) -> np.ndarray:
        """Standard deviations (n_x + n_d,) of the estimate at the start: of positions, speeds and
        disturbances.
        """
        n = self.model.dof
        parts = [
            np.full(n, START["position"]),
            np.full(n, START["speed"]),
            START["torque"] * self.noises.largest,
        ]
        return np.concatenate(parts)[: 2 * n + self.n_d]

    # --- samples ---------------------------------------------------------------------------------
    @checked_types(own=("y", "u"))
    def step(self, y: np.ndarray, u: np.ndarray) -> Estimate:
        """The estimate after one more sample; the first one after `reset` only corrects the start.

        Parameters
        ----------
        y : array (n_y,)
            Measured now, in the order of `outputs`.
        u : array (n_m,) [N m]
            Torques that acted since the last sample.

        Returns
        -------
        Estimate
            Of one sample.

        Raises
        ------
        SolverError
            A number is not finite, or the covariance is not positive any more; `reset` begins
            again.
        """
        found = self.run(np.asarray(y, dtype=float)[None], np.asarray(u, dtype=float)[None])
        return Estimate(*(getattr(found, name)[0] for name in found.__dataclass_fields__))

    @checked_types(own=("y", "u"))
    def run(self, y: np.ndarray, u: np.ndarray) -> Estimate:
        """Estimates for a record: ``y`` (n, n_y), ``u`` (n, n_m); ``u[k]`` acted from sample k - 1
        to sample k.

        Commanded torques are late by one sample and the delay: ``u[k] = commanded[k - 1]`` without
        delay.
        """
        count = len(y)
        n_z = len(self.states)
        y = record("y", y, count, len(self.outputs))
        u = record("u", u, count, self.model.n_m)
        z = np.empty((count, n_z))
        deviation = np.empty((count, n_z))
        nu = np.empty((count, len(self.outputs)))
        squares = np.empty(count)
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (y, u, z, deviation, nu, squares)]
        done = self._module.flexgen_kalman_run(
            ctypes.c_void_p(self._memory.ctypes.data), ctypes.c_int64(count), *pointers
        )
        if done < count:
            raise SolverError(
                f"extended Kalman filter, sample {done} of {count}: {STATUSES[self._head.status]}"
            )
        return self._estimate(z, deviation, nu, squares)

    def _estimate(
        self, z: np.ndarray, deviation: np.ndarray, nu: np.ndarray, squares: np.ndarray
    ) -> Estimate:
        """The result from estimates ``z`` (k, n_x + n_d) and their standard deviations,
        innovations ``nu`` (k, n_y) and their normalized squares (k,). Motor angles follow from the
        coordinates.
        """
        n = self.model.dof
        n_a = self.model.n_a
        C = self._local._C
        d = z[:, 2 * n :] if self.n_d else np.zeros((len(z), self.model.n_m))
        return Estimate(
            z[:, :n_a],
            z[:, n : n + n_a],
            z[:, :n] @ C.T,
            z[:, n : 2 * n] @ C.T,
            d,
            nu,
            squares,
            deviation,
        )

    @property
    def status(self) -> str:
        """``done``, or why the filter stopped."""
        return STATUSES[self._head.status]

    @property
    def state(self) -> np.ndarray:
        """The estimate now (n_z,); see `states`."""
        return self._z.copy()

    @property
    def covariance(self) -> np.ndarray:
        """Of the state (n_z, n_z)."""
        n_z = len(self.states)
        return self._P[:n_z, :n_z].copy()

    def _at_rest(self, q_m: np.ndarray) -> tuple[np.ndarray, ...]:
        """The motion ``q_a v_a a_a q_m v_m a_m tau_m`` (1, ...) at rest."""
        i_g = list(self.model.i_g)
        start = np.zeros(self.model.n_a)
        start[i_g] = np.linalg.solve(self.model.eta, q_m)
        q_a, tau = self._local.rest(q_m, np.zeros(0), start)
        arm = np.zeros((1, self.model.n_a))
        motors = np.zeros((1, self.model.n_m))
        return q_a[None], arm, arm, q_m[None], motors, motors, tau[None]

    def _at(self, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """Motion ``q_a v_a a_a q_m v_m a_m tau_m`` (1, ...) with the positions of a state, at
        rest.
        """
        q_m = self._local._C @ z[: self.model.dof]
        arm = np.zeros((1, self.model.n_a))
        motors = np.zeros((1, self.model.n_m))
        return z[None, : self.model.n_a], arm, arm, q_m[None], motors, motors, motors

    # --- memory of C -----------------------------------------------------------------------------
    def _make(self, rest: tuple[np.ndarray, ...]) -> None:
        """Lay out tables and sizes for C, with steps of the integration that suit the fastest
        eigenvalue at ``rest``, a point of `PoseModels.at`.

        The rows of ``channel``: -1 - i for coordinate i itself, else the row of the sensors or,
        after these, of the motors.
        """
        model = self.model
        n = self.model.dof
        channels = self.channels
        n_x = 2 * n
        n_s = sum(len(s.channels) for s in model.sensors)
        stride = -(-max(n_x + model.n_m, n + -(-n // TILE) * TILE) // TILE) * TILE
        rate = self._local.largest_rate(rest, np.zeros(0)) * self.sample_time
        if not rate < LARGEST_RATE:
            raise ArgumentError(
                f"sample_time: given {self.sample_time} s, and the fastest eigenvalue is "
                f"{rate / self.sample_time:.3g} 1/s: expected less than {LARGEST_RATE:g} "
                "integration steps"
            )
        doublings = max(0, int(np.ceil(np.log2(rate / TRANSITION_TIMES_RATE))))
        elastic = list(model.i_m)
        rows = []
        for index in channels.index:
            if index in elastic:
                rows.append(-1 - (model.n_a + elastic.index(index)))
            else:
                rows.append(n_s + int(index) if index < model.n_m else int(index) - model.n_m)
        largest = self.noises.largest
        h = self.sample_time
        self._tables = {
            "elastic": np.array(elastic or [0], np.int32),
            "channel": np.array(rows, np.int32),
            "gears": np.ascontiguousarray(self._local._C[:, : model.n_a]),
            "noise": channels.noise**2,
            "torque": (self.noises.torque * largest) ** 2,
            "walk": (self.noises.rate * largest) ** 2 * h,
            "process": allocate_aligned(stride * stride).reshape(stride, stride),
        }
        self._process = self._tables["process"]
        head = _Kalman(
            n_a=model.n_a,
            n_m=model.n_m,
            n_e=len(elastic),
            n_d=self.n_d,
            n_y=len(rows),
            n_s=n_s,
            steps=max(1, int(np.ceil(rate / STEP_TIMES_RATE))),
            doublings=doublings,
            stride=stride,
            sample_s=h,
            accelerating=int(channels.accelerating),
            **{name: x.ctypes.data for name, x in self._tables.items()},
            **{name: _function(self._library.functions.get(f)) for name, f in _FUNCTIONS.items()},
        )
        size = self._module.flexgen_kalman_size(ctypes.byref(head))
        self._memory = allocate_aligned(size // 8)
        ctypes.memmove(self._memory.ctypes.data, ctypes.byref(head), ctypes.sizeof(head))
        self._view()

    def _view(self) -> None:
        """Parts of the memory of C as arrays."""
        self._head = _Kalman.from_buffer(self._memory.data)
        offsets = np.zeros(3, np.int64)
        self._module.flexgen_kalman_offsets(
            ctypes.c_void_p(self._memory.ctypes.data), ctypes.c_void_p(offsets.ctypes.data)
        )
        z, P = (int(x) // 8 for x in offsets[:2])
        self._z = self._memory[z : z + len(self.states)]
        stride = int(self._head.stride)
        self._P = self._memory[P : P + stride * stride].reshape(stride, stride)

    def __deepcopy__(self, memo: dict[int, Any]) -> ExtendedKalmanFilter:
        """A filter of its own in the same state, such as `flexgen.control` makes of a controller
        for each robot.
        """
        other = copy.copy(self)
        other._memory = allocate_aligned(self._memory.size)
        process = allocate_aligned(self._process.size)
        other._memory[:] = self._memory
        process[:] = self._process.ravel()
        other._process = process.reshape(self._process.shape)
        other._tables = self._tables | {"process": other._process}
        other._view()
        other._head.process = other._process.ctypes.data
        return other


_FUNCTIONS = {
    "dynamics": "forward_dynamics",
    "linearize": "linearize",
    "sensors": "sensors",
    "derivatives": "sensor_derivatives",
}


class _Function(ctypes.Structure):
    """``model_function`` of extended_kalman.c."""

    _fields_ = [("call", ctypes.c_void_p), ("work", ctypes.c_int64)]


class _Kalman(ctypes.Structure):
    """``kalman`` of extended_kalman.c."""

    _fields_ = [
        *[
            (name, ctypes.c_int32)
            for name in (
                "n_a n_m n_e n_d n_y n_s steps doublings accelerating status begun unused"
            ).split()
        ],
        ("stride", ctypes.c_int64),
        ("sample_s", ctypes.c_double),
        *[(name, _Function) for name in _FUNCTIONS],
        *[
            (name, ctypes.c_void_p)
            for name in "elastic channel gears noise torque walk process".split()
        ],
        ("normalized", ctypes.c_double),
    ]


def _function(function: Function | None) -> _Function:
    if function is None:
        return _Function(None, 0)
    address, work = function.single_address()
    return _Function(address, work.size)
