"""Corrected paths of a move and their feedforward, as `learn.py` commands them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.case import AFTER_S, HOLD_S, Case, resting
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.feedback.loop.reference import motion_reference, time_grid, trajectory_of
from flexgen.feedback.loop.result import ControlRun
from flexgen.inversion.judge.status import Status
from flexgen.planning.learning.corrected import CorrectedPath
from flexgen.simulation.environment.sense import signals_of

BLEND_S = 0.1  # both ends of the window, where Q becomes constant [s]


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
        move = case.solution.move
        self._corrected = CorrectedPath(
            case.equations, move, case.solution.model, case.force, tell
        )
        self.outputs = self._corrected.outputs
        self.path = self._corrected.path
        self.period = self._corrected.period
        self.time = self._corrected.time
        robots = LocalDynamics(
            derive(self.equations.model, tuple(p.name for p in case.plants.parameters))
        )
        self._local = robots.under(case.force, case.reference.time[0])
        first, last = self._corrected.span
        before = self.sample_s * np.ceil(HOLD_S / self.sample_s)
        self._grid = time_grid(first, last, self.sample_s, before, AFTER_S)
        self._signals = None if case.signals is None else signals_of(self.equations)

    def case(self, correction: np.ndarray, iteration: int) -> Case:
        """The case with the feedforward of a corrected path, and other noise in each iteration;
        its errors are those from the path itself.
        """
        case = self._case
        found = self._corrected.invert(correction)
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
