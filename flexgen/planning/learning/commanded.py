"""Corrected paths of a move and their feedforward, as `learn.py` commands them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.feedback.loop.case import AFTER_S, HOLD_S, Case, resting
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.feedback.loop.reference import motion_reference, time_grid, trajectory_of
from flexgen.feedback.loop.result import ControlRun
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import grid, time_derivative
from flexgen.paths.path import Path
from flexgen.simulation.environment.sense import signals_of

# begin of the window before the path; its ends, where Q becomes constant
EARLY_S = 0.15
BLEND_S = 0.1
LATE_S = 1.5  # end of the window after the path: integral parts have settled under another load
DEGREE = 7  # of the spline through the corrections
MESH_S = 1e-2  # of the inversion


class CommandedPath:
    """Corrected paths of a move and their feedforward."""

    def __init__(
        self, case: Case, sample_s: float, delay_s: float, tell: Callable[[str], None]
    ) -> None:
        if case.solution.status == Status.LIMITS_ACTIVE:
            raise ArgumentError(
                "solution: given one whose path limits changed, expected one that follows its move"
            )
        self._case = case
        self.sample_s = sample_s
        self.delay_s = delay_s
        self.equations = case.equations
        self.outputs = case.model.output.size
        self.path = Path(self.equations, case.solution.move)
        problem = InversionProblem(self.equations, self.path, force=case.force)
        _, self.period, self.samples_per_interval, self.n_pre, self.n_post = grid(problem, MESH_S)
        solvers = () if case.force is None else ("invert", "force")
        self.library = inversion_library(
            Equations(case.solution.model), "lq", solvers, memory=True, progress=tell
        )
        count = int(np.ceil((self.path.duration + EARLY_S + LATE_S) / self.period)) + 1
        self.time = -EARLY_S + self.period * np.arange(count)
        self._reduction = Reduction(self.equations)
        sample = self.path.sample(self.time)
        self._y = self._reduction.targets(sample)
        self._rates = sample.derivative(1), sample.derivative(2)
        self._R = sample.R
        robots = LocalDynamics(
            derive(self.equations.model, tuple(p.name for p in case.plants.parameters))
        )
        self._local = robots.under(case.force, case.reference.time[0])
        first = self.time[0] - self.n_pre * self.period
        last = self.time[-1] + self.n_post * self.period
        before = self.sample_s * np.ceil(HOLD_S / self.sample_s)
        self._grid = time_grid(first, last, self.sample_s, before, AFTER_S)
        self._force = None if case.force is None else case.force.on_output(case.model, self.time)
        self._signals = None if case.signals is None else signals_of(self.equations)

    def case(self, correction: np.ndarray, iteration: int) -> Case:
        """The case with the feedforward of a corrected path, and other noise in each iteration;
        its errors are those from the path itself.
        """
        case = self._case
        y, dy, ddy = self._correct(correction)
        found = self.library.invert(
            y,
            dy,
            ddy,
            period=self.period,
            q_start=self.path.q_start,
            n_pre=self.n_pre,
            n_post=self.n_post,
            samples_per_interval=self.samples_per_interval,
            force=self._force,
        )
        pushing = None if case.force is None else case.force.at(found.t + self.time[0])
        trajectory = trajectory_of(found, self.time[0], case.model.name, pushing)
        reference = motion_reference(
            trajectory,
            self.path,
            self.sample_s,
            self.delay_s,
            case.library,
            self._grid,
            self._signals,
        )
        if case.force is not None:
            reference = resting(reference, self._local, case.plants.values[:1])
        rests = self._local.rests(reference.motion, case.plants.values)
        return replace(case, reference=reference, rests=rests, seed=case.seed + iteration)

    def _correct(self, correction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples of the corrected path and of its rates."""
        zero = [(order, np.zeros(correction.shape[1])) for order in range(1, (DEGREE + 1) // 2)]
        spline = make_interp_spline(self.time, correction, k=DEGREE, bc_type=(zero, zero))
        d, dd, ddd = (np.asarray(spline(self.time, order)) for order in range(3))
        dy, ddy = self._rates
        if self._R is None:
            moved = self._y + d, dy + dd, ddy + ddd
            return tuple(np.ascontiguousarray(x) for x in moved)  # type: ignore[return-value]
        turn = Rotation.from_rotvec(d[:, 3:])
        R = turn.as_matrix() @ self._R
        w = angular_velocity(d[:, 3:], dd[:, 3:]) + turn.apply(dy[:, 3:])
        y = np.hstack([self._y[:, :3] + d[:, :3], R.transpose(0, 2, 1).reshape(len(R), 9)])
        dw = time_derivative(w, self.period)
        return (
            np.ascontiguousarray(y),
            np.ascontiguousarray(np.hstack([dy[:, :3] + dd[:, :3], w])),
            np.ascontiguousarray(np.hstack([ddy[:, :3] + ddd[:, :3], dw])),
        )

    def error(self, run: ControlRun, plant: str) -> np.ndarray:
        """Error of a robot's output at the samples of the path (n, n_y); of a pose the rotation
        vector too.
        """
        r = run[plant]
        e = r.error
        if run.reference.R_ref is not None:
            R = evaluate(self.equations.function("forward_kinematics"), r.q_a)[1]
            off = R @ run.reference.R_ref.reshape(-1, 3, 3).transpose(0, 2, 1)
            e = np.hstack([e, Rotation.from_matrix(off).as_rotvec()])
        return np.stack([np.interp(self.time, run.reference.time, x) for x in e.T], axis=1)

    def filter(self, error: np.ndarray, frequency_hz: float) -> np.ndarray:
        """``Q e``: low pass forwards and backwards, constant at both ends of the window."""
        b, a = butter(2, 2 * frequency_hz * self.period)
        pad = min(len(error) - 1, round(1.0 / (frequency_hz * self.period)))
        smooth = filtfilt(b, a, error, axis=0, padlen=pad)
        blend = max(2, round(BLEND_S / self.period))
        ramp = np.linspace(0.0, 1.0, blend)
        ramp = ramp**4 * (35 - 84 * ramp + 70 * ramp**2 - 20 * ramp**3)
        weight = np.ones(len(error))
        weight[:blend] = ramp
        weight[-blend:] = ramp[::-1]
        first = error[: blend // 2].mean(axis=0)
        last = error[-(blend // 2) :].mean(axis=0)
        ends = np.where((np.arange(len(error)) < len(error) // 2)[:, None], first, last)
        return np.asarray(weight[:, None] * smooth + (1 - weight[:, None]) * ends)


def angular_velocity(r: np.ndarray, dr: np.ndarray) -> np.ndarray:
    """Angular velocity (n, 3) in the fixed frame of the rotation with rotation vector r and its
    rate dr (n, 3).
    """
    angle = np.linalg.norm(r, axis=1)[:, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    once = np.cross(r, dr)
    return dr + a * once + b * np.cross(r, once)
