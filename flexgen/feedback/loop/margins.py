"""Stability margins of a linear controller at poses: the sampled loop as a linear system.

largest gain      of the whole feedback, from 1 on, before an eigenvalue of the loop leaves the
                  unit circle
largest delay     in addition to the existing one [s]
largest lag       of all motors at all frequencies: the gain exp(-i phi)
L(z)              loop gain from torques to torques; Nyquist: det(1 + L) circles the origin as
                  often as L has unstable poles
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexgen.analysis.second_order import motor_rows
from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class, checked_result
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result
from flexgen.base.spec.arguments import is_number
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels
from flexgen.feedback.sampled_plant import sampled_plant
from flexgen.model.elements import RobotModel

LARGEST_FACTOR = 1e9  # of the loop gain that is tested
LARGEST_GAIN = 100.0
GAINS = 60
LARGEST_DELAY = 32.0  # samples
DELAYS = 128  # in steps of a quarter
LAGS = 36
"""Lags up to 180 degrees that are tested one after another."""

MOST_LATE = 256  # samples of a delay, each of which is a state
BISECTIONS = 20
FREQUENCIES = 600
LEAST_HZ = 1e-6
Arrays = Sequence[np.ndarray]


@checked_result
@dataclass(frozen=True)
class Margins(Result):
    """Margins of the loop at a pose.

    ``stable``; ``largest_eigenvalue``: of the sampled loop; ``gain``: largest factor, ``delay_s``:
    largest delay more [s], ``phase_deg``: largest lag of all motors together [deg]; infinite where
    none was found, zero for an unstable loop. ``gain_hz``, ``phase_hz``: frequencies at which the
    loop oscillates at these margins [Hz]; NaN: none.

    Examples
    --------
    >>> margins = flexgen.control("elbow").margins()["begin"]
    >>> margins.stable, f"gain {margins.gain:.1f}, delay {1e3 * margins.delay_s:.1f} ms"
    (True, 'gain 7.1, delay 2.1 ms')
    >>> f"{margins.gain_db:.1f} dB, {margins.phase_deg:.0f} deg"
    '17.0 dB, 58 deg'
    """

    stable: bool
    largest_eigenvalue: float
    gain: float
    delay_s: float
    gain_hz: float = float("nan")
    phase_deg: float = float("nan")
    phase_hz: float = float("nan")

    @property
    def gain_db(self) -> float:
        """The gain margin in dB; infinite: none was found; minus infinity: unstable."""
        with np.errstate(divide="ignore"):
            return float(20.0 * np.log10(self.gain))

    def to_dict(self) -> dict[str, Any]:
        """The fields and ``gain_db``; None for a margin that was not found."""
        found = {name: getattr(self, name) for name in self.__dataclass_fields__}
        numbers = found | {"gain_db": self.gain_db}
        return {
            name: None if isinstance(x, float) and not np.isfinite(x) else x
            for name, x in numbers.items()
        }


@dataclass(frozen=True)
class LoopResponse:
    """``hz`` (k,); ``gains`` (k, n_m): singular values of the loop gain; ``nyquist`` (k,): det(1 +
    L).
    """

    hz: np.ndarray
    gains: np.ndarray
    nyquist: np.ndarray


def as_linear(controller: Any, sample_s: float, n_y: int) -> Linear | None:
    """A cascade, or a linear controller of its first part, as ``A, B, C, D`` from ``y_ref - y`` to
    torques, with ``n_y`` channels at a sample time ``sample_s`` [s]; None for others.

    The speed feedforward of a cascade and its torque limits are left out.
    """
    if isinstance(controller, Linear):
        A, B, C, D = (x[0] for x in controller.matrices)
        return Linear(A, B, C, D)
    if not isinstance(controller, Cascade):
        return None
    n = len(controller.speed_gain)
    sections = [f.section(sample_s) for f in controller.filters]
    own = 2 + 2 * len(sections)  # states of a motor: last error, integral, filters
    A = np.zeros((n * own, n * own))
    B = np.zeros((n * own, n_y))
    C = np.zeros((n, n * own))
    D = np.zeros((n, n_y))
    for j in range(n):
        k_p, k_v, k_i = (
            float(x[j])
            for x in (controller.position_gain, controller.speed_gain, controller.integral_gain)
        )
        at = slice(j * own, (j + 1) * own)
        # Rows in the states of this motor and its error e: the speed error w, the integral, the
        # feedback.
        last, total, error = np.eye(own + 1)[[0, 1, own]]
        w = (error - last) / sample_s + k_p * error
        total = total + w * sample_s
        x = k_v * (w + k_i * total)
        rows = np.zeros((own, own + 1))
        rows[0] = error
        rows[1] = total
        for i, (b0, b1, b2, a1, a2) in enumerate(sections):
            s1, s2 = np.eye(own + 1)[[2 + 2 * i, 3 + 2 * i]]
            out = b0 * x + s1
            rows[2 + 2 * i] = b1 * x - a1 * out + s2
            rows[3 + 2 * i] = b2 * x - a2 * out
            x = out
        A[at, at] = rows[:, :own]
        B[at, j] = rows[:, own]
        C[j, at] = x[:own]
        D[j, j] = x[own]
    return Linear(A, B, C, D)


@checked_class
class LoopAtPose:
    """The sampled loop of a robot at a pose under a linear controller.

    Examples
    --------
    >>> loop = flexgen.control("elbow").loops()["middle"]
    >>> f"{loop.largest_eigenvalue():.4f}", f"{loop.largest_eigenvalue(gain=8.0):.2f}"
    ('0.9960', '1.06')
    """

    def __init__(
        self,
        model: PoseModel,
        controller: Linear,
        sample_s: float,
        delay_s: float,
        late: np.ndarray | None = None,
    ) -> None:
        self.model = model
        self.controller = controller
        self.sample_s = sample_s
        self.delay_s = delay_s
        self.late = late  # samples by which each signal is, None: 0
        # the last one, by the delay that is added
        self._plants: dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def __repr__(self) -> str:
        sizes = (
            f"{len(self.model.A)} states of the robot, {self.controller.order} of the controller"
        )
        return (
            f"<LoopAtPose: {sizes}, samples of {1e3 * self.sample_s:.4g} ms, delay "
            f"{1e3 * self.delay_s:.4g} ms>"
        )

    def largest_eigenvalue(self, gain: float = 1.0, more_delay_s: float = 0.0) -> float:
        """Largest absolute eigenvalue of the closed loop with the controller times ``gain`` and
        ``more_delay_s`` [s] of additional delay; below 1: stable.
        """
        if not (is_number(more_delay_s) and 0 <= more_delay_s <= MOST_LATE * self.sample_s):
            raise ArgumentError(
                f"more_delay_s: given {show_value(more_delay_s)}, expected 0 to "
                f"{MOST_LATE * self.sample_s} s"
            )
        if not (is_number(gain) and abs(gain) <= LARGEST_FACTOR):
            raise ArgumentError(
                f"gain: given {show_value(gain)}, expected a number from -{LARGEST_FACTOR} to "
                f"{LARGEST_FACTOR}"
            )
        return float(np.abs(self._eigenvalues(gain, more_delay_s)).max())

    def _eigenvalues(self, gain: complex, more_delay_s: float = 0.0) -> np.ndarray:
        """Of the closed loop whose feedback has another gain: ``exp(-i phi)`` is a lag of phi."""
        F, G, Y = self._plant(more_delay_s)
        A, B, C, D = (x[0] for x in self.controller.matrices)
        loop = np.block([[F - gain * G @ D @ Y, gain * G @ C], [-B @ Y, A]])
        return np.asarray(np.linalg.eigvals(loop))

    def lag_is_stable(self, degrees: float) -> bool:
        """Whether the loop is stable with this lag of all motors at all frequencies."""
        lag = np.exp(-1j * np.radians(degrees))
        return bool(np.abs(self._eigenvalues(complex(lag))).max() < 1.0)

    def _critical_hz(self, gain: complex) -> float:
        """Frequency [Hz] of the largest eigenvalue; NaN where the gain is not finite."""
        if not np.isfinite(gain):
            return float("nan")
        found = self._eigenvalues(gain)
        worst = found[np.argmax(np.abs(found))]
        return float(abs(np.angle(worst)) / (2.0 * np.pi * self.sample_s))

    def _plant(self, more_delay_s: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The sampled plant ``F, G, Y`` with ``more_delay_s`` [s] of additional delay; the last
        one is kept, since a search for a gain asks for it again and again.
        """
        if more_delay_s not in self._plants:
            m = self.model
            delay_s = self.delay_s + more_delay_s
            self._plants = {
                more_delay_s: sampled_plant(m.A, m.B, m.C, m.D, self.sample_s, delay_s, self.late)
            }
        return self._plants[more_delay_s]

    def margins(self) -> Margins:
        """Gain, phase and delay margin."""
        largest = self.largest_eigenvalue()
        if not largest < 1.0:
            return Margins(False, largest, 0.0, 0.0, phase_deg=0.0)
        gains = np.geomspace(1.0, LARGEST_GAIN, GAINS)
        delays = self.sample_s * LARGEST_DELAY * np.arange(1, DELAYS + 1) / DELAYS
        gain = _find_largest(lambda x: self.largest_eigenvalue(x) < 1.0, 1.0, gains[1:])
        delay = _find_largest(lambda x: self.largest_eigenvalue(1.0, x) < 1.0, 0.0, delays)
        phase = _find_largest(self.lag_is_stable, 0.0, np.linspace(0.0, 180.0, LAGS + 1)[1:])
        lag = np.exp(-1j * np.radians(phase)) if np.isfinite(phase) else complex("inf")
        hz = self._critical_hz(gain), self._critical_hz(complex(lag))
        return Margins(True, largest, gain, delay, hz[0], phase, hz[1])

    def response(self, low_hz: float) -> LoopResponse:
        """Singular values and ``det(I + L)`` of the loop gain L = controller times plant, at
        frequencies from ``low_hz`` to half the sample rate [Hz].
        """
        h = self.sample_s
        if not (is_number(low_hz) and LEAST_HZ <= low_hz < 0.499 / h):
            raise ArgumentError(
                f"low_hz: given {show_value(low_hz)}, expected {LEAST_HZ:g} to {0.499 / h:.4g} Hz"
            )
        hz = np.geomspace(low_hz, 0.499 / h, FREQUENCIES)
        z = np.exp(2j * np.pi * hz * h)[:, None, None]
        F, G, Y = self._plant()
        plant = Y @ np.linalg.solve(
            z * np.eye(len(F)) - F, np.broadcast_to(G.astype(complex), (len(hz), *G.shape))
        )
        A, B, C, D = (x[0] for x in self.controller.matrices)
        feedback = np.broadcast_to(D.astype(complex), (len(hz), *D.shape))
        if len(A):
            right = np.broadcast_to(B.astype(complex), (len(hz), *B.shape))
            feedback = feedback + C @ np.linalg.solve(z * np.eye(len(A)) - A, right)
        loop = feedback @ plant
        return LoopResponse(
            hz, np.linalg.svd(loop, compute_uv=False), np.linalg.det(np.eye(loop.shape[1]) + loop)
        )


def _find_largest(
    stable: Callable[[float], bool], start: float, values: Sequence[float] | np.ndarray
) -> float:
    """Largest value up to which the loop is stable, from ``start``, where it is, along rising
    ``values``, then by bisection; infinite where it is stable at all of them.
    """
    low = start
    for value in values:
        if not stable(float(value)):
            high = float(value)
            for _ in range(BISECTIONS):
                middle = (low + high) / 2
                low, high = (middle, high) if stable(middle) else (low, middle)
            return low
        low = float(value)
    return float("inf")


def state_rows(model: RobotModel) -> np.ndarray:
    """The channels ``q_a, v_a, q_m, v_m`` of the exact state from dx = (dy, dy'), y as in
    `motor_rows`.
    """
    angles = (np.eye(model.n_a, model.dof), motor_rows(model))
    return np.vstack([np.kron(part, rows) for rows in angles for part in np.eye(2)[:, None]])


def loops_at(
    model: RobotModel,
    controller: Any,
    sample_s: float,
    delay_s: float,
    motion: Arrays,
    samples: np.ndarray,
    poses: PoseModels | None = None,
) -> list[LoopAtPose]:
    """The linear loops at points of a motion; empty where the controller is not linear.

    Parameters
    ----------
    controller : Linear, Cascade or another
    sample_s, delay_s : float [s]
    motion : arrays (k, ...)
        Points, as of `PoseModels.at`.
    samples : array (k,)
        Their samples, by which the part of a controller is chosen.
    poses : PoseModels, optional
        Of a robot that differs from the model.
    """
    poses = poses or PoseModels(model)
    out = []
    late = [0] * model.n_m + [
        round(x.delay_s / sample_s) for x in model.sensors for _ in x.channels
    ]
    for k in range(len(motion[0])):
        at = poses.at([x[k : k + 1] for x in motion])
        linear = as_linear(controller, sample_s, len(at.C))
        if linear is None:
            return []
        if isinstance(controller, Linear):
            A, B, C, D = (
                x[min(int(samples[k]) // controller.samples, len(x) - 1)]
                for x in controller.matrices
            )
            linear = Linear(A, B, C, D)
            if D.shape[1] > len(at.C):
                exact = state_rows(model)
                at = replace(
                    at,
                    C=np.vstack([at.C, exact]),
                    D=np.vstack([at.D, np.zeros((len(exact), model.n_m))]),
                )
        out.append(
            LoopAtPose(at, linear, sample_s, delay_s, np.pad(late, (0, len(at.C) - len(late))))
        )
    return out
