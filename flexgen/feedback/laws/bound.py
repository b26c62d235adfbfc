"""Laws that evaluate the model at every sample, bound to a motion: in C, and in Python with the
same operations.

The C (model_laws.c) and the twin call the same functions of the model's emitted library.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.c_module import c_module
from flexgen.feedback.loop.controllers import times
from flexgen.feedback.loop.interface import Compiled, Measurement, Reference, Setup
from flexgen.feedback.loop.timing import Timing
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel
from flexgen.runtime.library import Library

SOURCE = Path(__file__).with_name("model_laws.c")
LINEARISATION = "linearisation"
COMPUTED_TORQUE = "computed_torque"
JOINT_TORQUE = "joint_torque"
_FUNCTIONS = {  # of the library, in the order of the structure in C
    "motion": "flexible_joint_motion",
    "torque": "flexible_joint_torque",
    "dynamics": "forward_dynamics",
    "rows": "inversion_rows",
    "friction": "motor_friction",
    "gear": "gear_law",
}
_SCRATCH = 32  # vectors of the joints


@dataclass(frozen=True, repr=False)
class BoundLaw:
    """A law for one motion of one robot model, in C (`compiled`) and in Python (`reset`, `step`).

    Attributes
    ----------
    name : str
        Of the function in C: one of ``linearisation``, ``computed_torque``, ``joint_torque``.
    model : RobotModel
    library : Library
        With the functions that the law evaluates.
    uses : tuple of str
        Keys of the table of functions above.
    timing : Timing
    table : array (samples, columns)
        Reference of each sample; columns as in the text of the function in C.
    gains : array (4, n)
        Each law's own; see there.
    state : int
        First channel of the exact state; -1: speeds are differences of measured angles.
    channels : array (n,) of int, or None
        Of the measured arm angles, where the law needs them.
    start : array (n,) [N m]
        Torque before the first sample.
    steps_per_s : float [1/s]
        Integration steps of the prediction.
    """

    name: str
    model: RobotModel
    library: Library
    uses: tuple[str, ...]
    timing: Timing
    table: np.ndarray
    gains: np.ndarray
    state: int
    channels: np.ndarray | None
    start: np.ndarray
    steps_per_s: float
    _now: dict[str, Any] = field(default_factory=dict, init=False, compare=False)

    def _segments(self) -> tuple[list[tuple[int, float, int]], int]:
        """Age, duration [s] and steps of the torques under way, and steps of half a sample."""

        def steps(duration: float) -> int:
            return max(1, int(np.ceil(duration * self.steps_per_s)))

        parts = [(age, duration, steps(duration)) for age, duration in self.timing.segments()]
        return parts, steps(self.timing.sample_s / 2) if self.timing.predicted else 0

    @property
    def _delayed(self) -> int:
        return max((age for age, _ in self.timing.segments()), default=0)

    def compiled(self, setup: Setup) -> Compiled:
        """The law in C; ArgumentError where the loop measures other channels than those it was
        bound to.
        """
        reason = obstacle(self.model, "control laws")
        if reason is not None:
            raise ArgumentError(f"control law: {reason}")
        n = self.model.n_m
        needed = self.model.n_m
        if self.state >= 0:
            needed = self.state + 4 * n
        elif self.channels is not None:
            needed = int(self.channels.max()) + 1
        if setup.n_m != n or setup.n_y < needed:
            raise ArgumentError(
                f"controller: given a loop with {setup.n_m} motors and {setup.n_y} measured "
                f"channels, expected {n} and at least {needed}"
            )
        shared, keep = self._make_shared(setup)
        memory = np.zeros((len(setup.q_m), 1 + 2 * n + self._delayed * n))
        memory[:, :1] = np.array([ctypes.addressof(shared)], np.int64).view(np.float64)
        memory[:, 1 + 2 * n :] = np.tile(self.start, self._delayed)
        module = c_module(SOURCE)
        address = ctypes.cast(module[f"flexgen_law_{self.name}"], ctypes.c_void_p).value
        assert address is not None
        return Compiled(address, memory.view(np.uint8), 8, {}, (module, shared, keep))

    def _make_shared(self, setup: Setup) -> tuple[_Shared, tuple[Any, ...]]:
        """The C structure with tables, gains and addresses of library functions, and the Python
        objects that must live as long as it.

        Matrices are stored by columns, as C reads them; ``past``, ``durations`` [s] and ``steps``
        are the segments over which a delay is predicted.
        """
        n = self.model.n_m
        (parts, half_steps) = self._segments()
        addresses: dict[str, int] = {}
        most = 1
        for key in self.uses:
            addresses[key], work = self.library.functions[_FUNCTIONS[key]].batch_address()
            most = max(most, work.size)
        eta = np.array(self.model.eta)
        arrays: Mapping[str, np.ndarray] = {
            "table": np.ascontiguousarray(self.table, float),
            "gains": np.ascontiguousarray(self.gains, float),
            "eta": np.ascontiguousarray(eta.T),
            "inverse": np.ascontiguousarray(np.linalg.inv(eta).T),
            "back": np.ascontiguousarray(np.linalg.inv(eta)),
            "inertia": np.array([motor.inertia for motor in self.model.motors]),
            "past": np.array([age for age, _, _ in parts], np.int64),
            "steps": np.array([steps for _, _, steps in parts], np.int64),
            "durations": np.array([duration for _, duration, _ in parts], float),
            "work": np.zeros(most),
            "scratch": np.zeros(_SCRATCH * n),
        }
        channels = None if self.channels is None else np.ascontiguousarray(self.channels, np.int64)
        shared = _Shared(
            n=n,
            n_y=setup.n_y,
            state=self.state,
            samples=len(self.table),
            columns=self.table.shape[1],
            delayed=self._delayed,
            segments=len(parts),
            half_steps=half_steps,
            sample_s=self.timing.sample_s,
            channels=None if channels is None else channels.ctypes.data,
            **addresses,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        return shared, (arrays, channels, self.library)

    # --- the same in Python ----------------------------------------------------------------------

    def reset(self) -> None:
        """Begin at rest."""
        self._now.clear()
        self._now["torques"] = [self.start.copy() for _ in range(self._delayed)]

    def step(self, k: int, y: Measurement, ref: Reference) -> np.ndarray:
        """Torques (n_m,) [N m] of sample ``k`` from the measurement; `reset` first.

        The reference is row k of the law's table, not ``ref``; after its last row the last one is
        held.
        """
        x = self._read_state(k, np.concatenate([y.q_m, y.sensors]))
        d = self.table[min(k, len(self.table) - 1)]
        steps: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
            LINEARISATION: self._linearisation,
            COMPUTED_TORQUE: self._computed_torque,
            JOINT_TORQUE: self._joint_torque,
        }
        u = steps[self.name](x, d)
        if self._delayed:
            self._now["torques"] = [u.copy(), *self._now["torques"][:-1]]
        return u

    def _read_state(self, k: int, y: np.ndarray) -> np.ndarray:
        """The state ``q_a, v_a, q_m, v_m`` (4, n) [rad or m, and per s] of sample ``k``.

        It is measured where ``state`` is the first of its channels in ``y``. Otherwise speeds are
        differences of two samples, zero at the first one, and a law without link encoders gets
        ``q_a = 0``.
        """
        n = self.model.n_m
        if self.state >= 0:
            return y[self.state : self.state + 4 * n].reshape(4, n).copy()
        q_a = np.zeros(n) if self.channels is None else y[self.channels]
        q_m = y[:n].copy()
        if k == 0:
            v_a = np.zeros(n)
            v_m = np.zeros(n)
        else:
            v_a, v_m = (
                (now - self._now[name]) / self.timing.sample_s
                for now, name in ((q_a, "q_a"), (q_m, "q_m"))
            )
        self._now["q_a"] = q_a
        self._now["q_m"] = q_m
        return np.array([q_a, v_a, q_m, v_m])

    def _call(self, key: str, *arguments: np.ndarray) -> tuple[np.ndarray, ...]:
        """A function of the library for one point, as the batch function computes it."""
        found = self.library.functions[_FUNCTIONS[key]](*(x[None] for x in arguments))
        return tuple(x[0] for x in (found if isinstance(found, tuple) else (found,)))

    def _rate(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        a_a, a_m = self._call("dynamics", *x, tau)
        return np.array([x[1], a_a, x[3], a_m])

    def _integrate(self, x: np.ndarray, tau: np.ndarray, h: float, steps: int) -> np.ndarray:
        """The state x (4, n) after ``steps`` steps of length h [s] with constant motor torques tau
        [N m], by the classical method of Runge and Kutta. The order of the sums is that of the C
        code, to the bit.
        """
        for _ in range(steps):
            k1 = self._rate(x, tau)
            k2 = self._rate(x + 0.5 * h * k1, tau)
            k3 = self._rate(x + 0.5 * h * k2, tau)
            k4 = self._rate(x + h * k3, tau)
            x = x + h / 6.0 * ((k1 + k4) + 2.0 * (k2 + k3))
        return x

    def _linearisation(self, x: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Torques (n_m,) [N m] of feedback linearization at the predicted state.

        The state x (4, n) is integrated over the delay under the torques already sent. With
        ``half_steps`` it is integrated by another half sample, under the torque of the state so
        far, because the torque is held for a whole one; the reference ``d`` then has a second
        block of 5 n numbers for that instant.
        """
        parts, half_steps = self._segments()
        for age, duration, steps in parts:
            x = self._integrate(x, self._now["torques"][age - 1], duration / steps, steps)
        if half_steps:
            u = self._linearize(x, d)
            x = self._integrate(x, u, 0.5 * self.timing.sample_s / half_steps, half_steps)
            d = d[5 * self.model.n_m :]
        return self._linearize(x, d)

    def _linearize(self, x: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Torques (n_m,) [N m] with which the fourth derivative of each joint is that of a stable
        chain:

            s = s_d + g3 (j_d - j) + g2 (a_d - a) + g1 (v_d - v) + g0 (q_d - q)

        ``x``: state (4, n); ``d``: the reference ``q v a j s`` as one row, whose first 5 n numbers
        are used. Acceleration a and jerk j follow from the state by the model.
        """
        n = self.model.n_m
        g = self.gains
        q_d, v_d, a_d, j_d, s_d = d[: 5 * n].reshape(5, n)
        a, j = self._call("motion", *x)
        s = s_d + g[3] * (j_d - j) + g[2] * (a_d - a) + g[1] * (v_d - x[1]) + g[0] * (q_d - x[0])
        return self._call("torque", x[0], x[1], a, j, s, x[2], x[3])[0]

    def _computed_torque(self, x: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Torques (n_m,) [N m] of computed torque at the motors, ``a = a_d + g1 (v_d - v) + g0
        (q_d - q)``:

            u = J_m eta a + f_m(v_m) + eta^-T T(q, v, a)

        q, v: motor angles and speeds at the joints; T: torques of the rigid arm. ``x``: state (4,
        n); ``d``: ``q v a`` (3 n,) of the reference.
        """
        n = self.model.n_m
        g = self.gains
        eta = np.array(self.model.eta)
        q_d, v_d, a_d = d.reshape(3, n)
        inverse = np.linalg.inv(eta)
        q = times(inverse, x[2])
        v = times(inverse, x[3])
        a = a_d + g[1] * (v_d - v) + g[0] * (q_d - q)
        T = self._call("rows", q, v, a)[0]
        f = self._call("friction", x[3])[0]
        inertia = np.array([motor.inertia for motor in self.model.motors])
        u: np.ndarray = inertia * times(eta, a) + f + times(inverse.T, T)
        return u

    def _joint_torque(self, x: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Torques (n_m,) [N m] of feedback of motor angles and gear torques:

            u = u_d + g0 (q_d - q_m) + g1 (v_d - v_m) + g2 (T_d - T) + g3 (T'_d - T')

        T, T': torque of the gears and its rate on the motor side, from deflections by the law of
        the springs. ``x``: state (4, n); ``d``: ``u q v T T'`` (5 n,) of the reference. Without a
        gear function only the motors are fed back.
        """
        n = self.model.n_m
        g = self.gains
        inverse = np.linalg.inv(self.model.eta)
        u_d, q_d, v_d, T_d, dT_d = d.reshape(5, n)
        u: np.ndarray = u_d + g[0] * (q_d - x[2]) + g[1] * (v_d - x[3])
        if "gear" not in self.uses:
            return u
        p, dp = self._call("gear", times(inverse, x[2]) - x[0])
        rate = (times(inverse, x[3]) - x[1]) * dp
        T = times(inverse.T, p)
        dT = times(inverse.T, rate)
        return u + g[2] * (T_d - T) + g[3] * (dT_d - dT)


class _Shared(ctypes.Structure):
    """``law_shared`` of model_laws.c."""

    _fields_ = [
        *[
            (name, ctypes.c_int64)
            for name in "n n_y state samples columns delayed segments half_steps".split()
        ],
        ("sample_s", ctypes.c_double),
        *[
            (name, ctypes.c_void_p)
            for name in (
                "channels table gains eta inverse back inertia past steps durations"
            ).split()
        ],
        *[(name, ctypes.c_void_p) for name in (*_FUNCTIONS, "work", "scratch")],
    ]
