"""Controllers of the loop, each in C and once more in Python, with the same operations in the same
order.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.arguments import is_whole
from flexgen.codegen.build.c_module import c_module
from flexgen.feedback.loop.interface import Compiled, Measurement, Reference, Setup
from flexgen.model.position_servo.filters import Filter

SOURCE = Path(__file__).with_name("closed_loop.c")


def _check_numbers(name: str, value: Any, dimensions: tuple[int, ...], what: str) -> None:
    """ArgumentError unless the value is an array of finite numbers with one of these numbers of
    dimensions.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.ndim not in dimensions or not np.isfinite(array).all():
        raise ArgumentError(
            f"controller, {name}: given {show_value(value)}, expected finite numbers, {what}"
        )


@checked_class
@dataclass(frozen=True)
class Cascade:
    """A drive with position and speed control (P-PI), feedforward torque and filters of the
    feedback, motor side.

        w = v_ref + position_gain (q_ref - q) - v,
        u = tau_ff + F(z) speed_gain (w + integral_gain int w dt)

    ``position_gain`` [1/s], ``speed_gain`` [N m s/rad], ``integral_gain`` [1/s]: (n_m,) each, or
    (robots, n_m) where the robots of a simulation have other gains. The speed is the difference of
    two samples of the measured angle, and the same difference of the reference, so that a filter
    of the speed alone does not show in the error. ``filters``: F, the same for all motors.
    ``torque_max`` (n_m,) [N m]: above it the integral does not grow; None: no limit.

    Examples
    --------
    >>> # motor side
    >>> law = flexgen.Cascade(
    ...     position_gain=[20.0, 20.0], speed_gain=[5.0, 3.0], integral_gain=[2.0, 2.0]
    ... )
    >>> flexgen.control("elbow", controller=law).status
    'done'
    """

    position_gain: np.ndarray
    speed_gain: np.ndarray
    integral_gain: np.ndarray
    filters: tuple[Filter, ...] = ()
    torque_max: np.ndarray | None = None
    _state: dict[str, np.ndarray] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    __repr__ = short_repr

    def _sections(self, sample_s: float) -> np.ndarray:
        """(sections, n_m, 5)."""
        rows = [f.section(sample_s) for f in self.filters]
        return np.repeat(np.array(rows).reshape(-1, 1, 5), np.shape(self.speed_gain)[-1], axis=1)

    def compiled(self, setup: Setup) -> Compiled:
        """The controller in C, for robots that rest at ``setup.q_m``; ArgumentError where gains do
        not fit the motors.

        Memory of each robot: sizes, sample time, gains, limits and filters, which stay; then what
        changes, of which the first two of three vectors (n_m) begin at the motor angles, and
        states of the filters.
        """
        n = setup.n_m
        robots = len(setup.q_m)
        sections = self._sections(setup.sample_s)
        most = np.zeros(n) if self.torque_max is None else np.asarray(self.torque_max, dtype=float)
        gains = [
            np.asarray(x, dtype=float)
            for x in (self.position_gain, self.speed_gain, self.integral_gain)
        ]
        for name, x in zip(
            ("position_gain", "speed_gain", "integral_gain", "torque_max"),
            (*gains, most),
            strict=True,
        ):
            if x.shape not in ((n,), (robots, n)) or not np.isfinite(x).all():
                raise ArgumentError(
                    f"controller, {name}: given {x}, expected {n} finite numbers, one for each "
                    "motor"
                )
        head = np.array([n, setup.n_y, len(sections)], np.int64).view(np.float64)
        of_each = np.hstack([np.broadcast_to(x, (robots, n)) for x in (*gains, most)])
        fixed = np.concatenate([head, [setup.sample_s], of_each[0], sections.ravel()])
        memory = np.zeros((robots, len(fixed) + 3 * n + 2 * n * len(sections)))
        memory[:, : len(fixed)] = fixed
        memory[:, 4 : 4 + 4 * n] = of_each
        for k in range(2):
            memory[:, len(fixed) + k * n : len(fixed) + (k + 1) * n] = setup.q_m
        return _in_c("flexgen_loop_cascade", memory, 8 * len(fixed))

    def begin(self, sample_s: float) -> Cascade:
        """The sample time, for `step` in Python."""
        self._state["sample_s"] = np.array(sample_s)
        self._state["sections"] = self._sections(sample_s)
        return self

    def reset(self) -> None:
        """Begin at rest."""
        for name in ("q", "q_ref", "sum", "filtered"):
            self._state.pop(name, None)

    def step(self, k: int, y: Measurement, ref: Reference) -> np.ndarray:
        """Torques (n_m,) [N m] of sample ``k``; `begin` first.

        With the speed error ``w = v_ref - v + k_p (q_ref - q)``, v by differences:

            u = tau_ff + filters(k_v (w + k_i sum w h))

        At the limit of the torque the sum stops while it would grow further.
        """
        s = self._state
        n = len(self.speed_gain)
        if "q" not in s:
            s["q"] = ref.q_m.copy()
            s["q_ref"] = ref.q_m.copy()
            s["sum"] = np.zeros(n)
            s["filtered"] = np.zeros((len(self.filters), n, 2))
        h = float(s["sample_s"])
        v = (y.q_m - s["q"]) / h
        v_ref = (ref.q_m - s["q_ref"]) / h
        w = v_ref + self.position_gain * (ref.q_m - y.q_m) - v
        s["sum"] = s["sum"] + w * h
        x = self.speed_gain * (w + self.integral_gain * s["sum"])
        for f, own in zip(s["sections"], s["filtered"], strict=True):
            out = f[:, 0] * x + own[:, 0]
            own[:, 0] = f[:, 1] * x - f[:, 3] * out + own[:, 1]
            own[:, 1] = f[:, 2] * x - f[:, 4] * out
            x = out
        u: np.ndarray = ref.tau_m + x
        if self.torque_max is not None:
            full = (self.torque_max > 0) & (np.abs(u) > self.torque_max) & ((u > 0) == (w > 0))
            s["sum"] = np.where(full, s["sum"] - w * h, s["sum"])
        s["q"] = y.q_m.copy()
        s["q_ref"] = ref.q_m.copy()
        return u


@checked_class
@dataclass(frozen=True)
class Linear:
    """A linear controller about the reference, with matrices for each part of the motion.

        e = y_ref - y,    u = tau_ff + C z + D e,    z <- A z + B e

    ``A`` (parts, n_z, n_z), ``B`` (parts, n_z, n_y), ``C`` (parts, n_m, n_z), ``D`` (parts, n_m,
    n_y): in each part, of ``samples`` samples; the last one holds to the end. Without parts: (n_z,
    n_z) and so on.

    Examples
    --------
    >>> import numpy as np
    >>> one = np.eye(2)  # u = tau_ff + 100 e + 5 (e - z) / 0.0005, z: e of the last sample
    >>> law = flexgen.Linear(A=0.0 * one, B=one, C=-1e4 * one, D=1.01e4 * one)
    >>> flexgen.control("elbow", controller=law).margins()["begin"].stable
    True
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    samples: int = 1
    _state: dict[str, np.ndarray] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in "ABCD":
            _check_numbers(
                name,
                getattr(self, name),
                (2, 3),
                "shape (rows, columns) or (parts, rows, columns)",
            )
        if not is_whole(self.samples):
            raise ArgumentError(
                f"controller, samples: given {show_value(self.samples)}, expected a whole "
                "number >= 1"
            )

    @property
    def matrices(self) -> tuple[np.ndarray, ...]:
        """``A, B, C, D`` with parts."""
        return tuple(
            x[None] if x.ndim == 2 else x
            for x in map(np.asarray, (self.A, self.B, self.C, self.D))
        )

    @property
    def order(self) -> int:
        """States."""
        return int(self.matrices[0].shape[1])

    def compiled(self, setup: Setup) -> Compiled:
        """The controller in C; ArgumentError where the sizes do not fit the robot."""
        A, B, C, D = self.matrices
        n_z = A.shape[1]
        n_y = setup.n_y
        n_m = setup.n_m
        parts = len(A)
        expected = ((parts, n_z, n_z), (parts, n_z, n_y), (parts, n_m, n_z), (parts, n_m, n_y))
        for name, x, shape in zip("ABCD", (A, B, C, D), expected, strict=True):
            if x.shape != shape or not np.isfinite(x).all():
                raise ArgumentError(
                    f"controller, {name}: given shape {x.shape}, expected finite numbers "
                    f"{shape}: parts, then {n_z} states, {n_y} measured channels, {n_m} motors"
                )
        columns = [x.transpose(0, 2, 1).reshape(parts, -1) for x in (A, B, C, D)]
        table = np.ascontiguousarray(np.concatenate(columns, axis=1), float)
        head = np.array(
            [n_m, n_y, n_z, parts, max(int(self.samples), 1), table.ctypes.data], np.int64
        )
        memory = np.zeros((len(setup.q_m), len(head) + 4 * n_z + n_y + 2 * n_m))
        memory[:, : len(head)] = head.view(np.float64)
        return _in_c("flexgen_loop_linear", memory, 8 * len(head), table)

    def reset(self) -> None:
        """Begin with z = 0."""
        self._state["z"] = np.zeros(self.order)

    def step(self, k: int, y: Measurement, ref: Reference) -> np.ndarray:
        """Torques (n_m,) [N m] of sample ``k``: ``u = tau_ff + C z + D e``, then ``z = A z + B
        e``, with the error e of motor angles and sensors; the matrices are those of the part of
        the motion.
        """
        A, B, C, D = (x[min(k // self.samples, len(x) - 1)] for x in self.matrices)
        e = np.concatenate([ref.q_m - y.q_m, ref.sensors - y.sensors])
        z = self._state["z"]
        u: np.ndarray = ref.tau_m + (times(C, z) + times(D, e))
        self._state["z"] = times(A, z) + times(B, e)
        return u


def times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``A x`` summed from the first column to the last, as in C."""
    out = np.zeros(len(A))
    for column, entry in zip(A.T, x, strict=True):
        out = out + column * entry
    return out


def loop_module() -> ctypes.CDLL:
    """The loop in C; vectors of robots keep the bits, since nothing is summed over them."""
    return c_module(SOURCE, "-ftree-vectorize")


def _in_c(name: str, memory: np.ndarray, fixed: int, keep: object = None) -> Compiled:
    """A function ``name`` of the C of the loop as a compiled controller. ``memory`` (robots, m):
    start of each robot's memory; ``fixed``: its first bytes that a reset keeps; ``keep``: what
    must live as long.
    """
    module = loop_module()
    address = ctypes.cast(module[name], ctypes.c_void_p).value
    assert address is not None
    return Compiled(
        address, np.ascontiguousarray(memory).view(np.uint8), fixed, {}, (module, keep)
    )
