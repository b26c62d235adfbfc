"""Collisions from motor angles and torques: the residual of the generalized momentum, with
thresholds from data.

    r = w (p - p_0 - int (tau_m - f + eta^-T (M' v - c - g)_g + r) dt),
    p = eta^-T (M v)_g + J_m v_m

The residual is a low-passed estimate of the torques that the model does not explain: of contact,
and of errors of model and friction. The arm follows the motors without deflection. Thresholds are
``MARGIN`` times the largest residual of runs without contact, of robots with other load and
stiffness, and with noise. Of n such runs and one more, each is as likely to have the largest
residual of a motor: the new one is above a threshold of n_m motors with a chance of at most

    n_m/(n + 1)
    where the margin is one or more and new runs are drawn as those of `calibrate`, and are as long

Source: A. De Luca, R. Mattone, IEEE ICRA 2005 (momentum residual).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexgen.base.checks.type_checks import checked_class, checked_result
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.results import Result
from flexgen.base.spec.arguments import check_positive, is_number
from flexgen.codegen.build.c_module import c_module
from flexgen.codegen.build.model_library import library_with
from flexgen.model.abilities import check_ability
from flexgen.model.elements import RobotModel

SOURCE = Path(__file__).with_name("collision.c")
BANDWIDTH_HZ = 15.0
MARGIN = 1.2
FUNCTIONS = ("mass_matrix", "bias", "motor_friction")


@checked_result
@dataclass(frozen=True)
class Detection(Result):
    """``residual`` (n, n_m) [N m, motor side]; ``sample``: the first one above a threshold, None:
    none.

    ``false_alarms``: largest chance that a run without contact, drawn as those of
    `CollisionDetector.calibrate`, is above a threshold; 1 where that is not known.

    Examples
    --------
    >>> run = flexgen.control("elbow").nominal
    >>> detector = flexgen.CollisionDetector(flexgen.read("elbow"), sample_s=5e-4)
    >>> thresholds = detector.calibrate([(run.measured, run.tau_m)])
    >>> found = detector.detect(run.measured, run.tau_m)
    >>> print(found.sample, found.residual.shape)  # no contact; samples, motors
    None (7009, 2)
    """

    residual: np.ndarray
    sample: int | None
    false_alarms: float = 1.0

    __repr__ = short_repr


@checked_class
class CollisionDetector:
    """Finds contacts in records of a robot's motors.

    Parameters
    ----------
    model : RobotModel
    sample_s : float [s]
        Of the records.
    bandwidth_hz : float [Hz]
        Of the residual: larger is faster and noisier.

    Examples
    --------
    >>> detector = flexgen.CollisionDetector(flexgen.read("elbow"), sample_s=5e-4)
    >>> push = flexgen.Disturbance("step", "tool.z", size=-2000.0, start_s=0.5)  # N
    >>> free, pushed = (
    ...     flexgen.control("elbow").nominal,
    ...     flexgen.control("elbow", disturbances=[push]).nominal,
    ... )
    >>> thresholds = detector.calibrate([(free.measured, free.tau_m)])
    >>> detector.detect(free.measured, free.tau_m).sample is None
    True
    >>> detector.detect(pushed.measured, pushed.tau_m).sample is None
    False
    """

    def __init__(
        self, model: RobotModel, sample_s: float, bandwidth_hz: float = BANDWIDTH_HZ
    ) -> None:
        check_positive("sample_s", sample_s, "a time > 0 in s")
        if not (is_number(bandwidth_hz) and 0 < bandwidth_hz < 0.1 / sample_s):
            raise ArgumentError(
                f"bandwidth_hz: given {bandwidth_hz!r}, expected more than 0, below "
                f"{0.1 / sample_s:.4g}"
            )
        check_ability(model, "CollisionDetector")
        self.model = model
        self.sample_s = sample_s
        self.bandwidth_hz = bandwidth_hz
        self.thresholds = np.zeros(model.n_m)
        self.false_alarms = 1.0
        self._library = library_with(model, FUNCTIONS)
        self._module = c_module(SOURCE)
        self._module.flexgen_collision_run.restype = ctypes.c_int64

    def __repr__(self) -> str:
        rates = f"samples of {1e3 * self.sample_s:.4g} ms, bandwidth {self.bandwidth_hz:.4g} Hz"
        return f"<CollisionDetector {self.model.title}: {rates}>"

    def detect(self, q_m: np.ndarray, tau_m: np.ndarray) -> Detection:
        """The residual of a record ``q_m``, ``tau_m`` (n, n_m), and where it leaves the
        thresholds.

        ``tau_m`` of a sample acts until the next one.
        """
        p, driven = self._terms(q_m, tau_m)
        n_m = self.model.n_m
        memory = np.zeros(3 + 3 * n_m)
        memory[:1] = np.array([n_m, 0], np.int32).view(np.float64)
        memory[1:3] = self.sample_s, 2 * np.pi * self.bandwidth_hz
        residual = np.empty_like(p)
        pointers = [
            ctypes.c_void_p(x.ctypes.data) for x in (memory, p, driven, self.thresholds, residual)
        ]
        hit = self._module.flexgen_collision_run(
            pointers[0], ctypes.c_int64(len(p)), *pointers[1:]
        )
        return Detection(residual, None if hit < 0 else int(hit), self.false_alarms)

    def calibrate(
        self, records: Iterable[tuple[np.ndarray, np.ndarray]], margin: float = MARGIN
    ) -> np.ndarray:
        """Set the thresholds (n_m,) from records ``(q_m, tau_m)`` without contact.

        Their number gives ``false_alarms``: record 60 for 6 motors and at most one alarm in ten
        runs.
        """
        largest = np.zeros(self.model.n_m)
        count = 0
        for count, (q_m, tau_m) in enumerate(records, 1):  # noqa: B007
            largest = np.maximum(largest, np.abs(self.detect(q_m, tau_m).residual).max(axis=0))
        if not largest.any():
            raise ArgumentError("records: given none with motion, expected runs without contact")
        self.thresholds[:] = margin * largest
        self.false_alarms = min(1.0, self.model.n_m / (count + 1)) if margin >= 1.0 else 1.0
        return self.thresholds.copy()

    def _terms(self, q_m: np.ndarray, tau_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Momentum and its rate without a collision, of the motors at the samples (n, n_m) [N m s,
        N m]:

            p = eta^-T M v + J_m v_m,    p' = tau_m - f_m + eta^-T (M' v - h)

        Speeds and M' are differences of samples; the gears are taken as rigid.
        """
        model = self.model
        h = self.sample_s
        i_g = list(self.model.i_g)
        q_m = np.asarray(q_m, dtype=float)
        tau_m = np.asarray(tau_m, dtype=float)
        if q_m.shape != tau_m.shape or q_m.ndim != 2 or q_m.shape[1] != model.n_m or len(q_m) < 3:
            raise ArgumentError(
                f"record: given shapes {q_m.shape}, {tau_m.shape}, expected (n, {model.n_m}) twice"
            )
        v_m = np.diff(q_m, axis=0, prepend=q_m[:1]) / h
        to_joint = np.linalg.inv(model.eta)
        q = np.zeros((len(q_m), model.n_a))
        v = np.zeros((len(q_m), model.n_a))
        q[:, i_g] = q_m @ to_joint.T
        v[:, i_g] = v_m @ to_joint.T
        M = np.asarray(self._library.mass_matrix(q)).reshape(len(q), model.n_a, model.n_a)[:, i_g][
            :, :, i_g
        ]
        h_bias = np.asarray(self._library.bias(q, v)).reshape(len(q), -1)[:, i_g]
        friction = np.asarray(self._library.motor_friction(v_m)).reshape(v_m.shape)
        v_g = v[:, i_g]
        inertia = np.array([motor.inertia for motor in model.motors])
        changed = np.diff(M, axis=0, prepend=M[:1]) / h
        p = np.einsum("nij,nj->ni", M, v_g) @ to_joint + inertia * v_m
        arm = (np.einsum("nij,nj->ni", changed, v_g) - h_bias) @ to_joint
        return np.ascontiguousarray(p), np.ascontiguousarray(tau_m - friction + arm)
