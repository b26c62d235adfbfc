"""Iterative learning of a path: the commanded path is corrected by the measured error, and
inverted again.

    y_cmd <- y_cmd - gain Q e,      e = y - y_ref of the robot, Q a low pass forwards and backwards

Every iteration inverts the whole corrected path with the model: feedforward torques and references
of the motors change together. The window of learning begins before the path and ends after it,
since the motion of elastic robots does. Q is blended to constants at both ends of the window,
where the robot is at rest. A correction beyond the natural frequencies of the robot makes learning
diverge: the default frequency of Q is 0.7 of the lowest one of the model with locked motors. The
best iteration is kept; learning ends when the error grows.

The error is measured by a tracker of the tool, or estimated from accelerometers and motor angles
by a smoother along the path. Estimates are noisy: the gain of iteration k is divided by k + 1, so
that all of them are averaged. Accelerometers do not show the error that the robot has at rest
before the path, the sag of its springs.

Source: cf. S. Arimoto et al., J. Robotic Systems 1(2), 1984; S. Moberg, Modeling and Control of
Flexible Manipulators, 2010.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import numpy as np

from flexgen.base.calls.deadline import (
    MOST_STEPS,
    best_known,
    is_over,
    keep_best,
    limit_fit,
    reason_of_end,
)
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Bound, NotNegative, Positive, Seed, TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import choose_scale, format_size
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.results import Result
from flexgen.base.spec.arguments import is_number, mapping_of, seed_of
from flexgen.dynamics.mechanics.equations import Equations, robot_of
from flexgen.feedback.loop.case import SAMPLE_S, Case, control_case
from flexgen.feedback.loop.channels import ACCELEROMETER as TOOL_ACCELEROMETER
from flexgen.feedback.loop.channels import MOTORS, Channels, channels_of
from flexgen.feedback.loop.control import run_case
from flexgen.feedback.loop.gains import lowest_locked_hz
from flexgen.feedback.loop.named_controllers import controller_of
from flexgen.feedback.loop.plants import PlantChanges
from flexgen.feedback.loop.result import ControlRun, output_errors
from flexgen.inversion.solution import Solution
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.planning.learning.commanded import CommandedPath
from flexgen.planning.learning.smoother import PathSmoother, acting

ITERATIONS = 6
Iterations = Annotated[int, Bound(1, 1000, words="1 to 1000")]
Gain = Annotated[float, Bound(0.0, 2.0, excluded=True, words="more than 0, at most 2")]
SHARE = 0.7  # of the lowest locked frequency
GROWS = 1.05  # an error that is that much larger than the best ends learning
TRACKER = "tracker"
ACCELEROMETER = "accelerometer"
MeasuredBy = Literal["tracker", "accelerometer"]
SETTLED = 2e-2  # of the error before learning: changes below it are noise


@checked_result
@dataclass(frozen=True, repr=False)
class LearningResult(Result):
    """Result of `flexgen.learn`.

    Attributes
    ----------
    runs : tuple of ControlRun
        Of each iteration, the first without correction.
    corrections : tuple of arrays (n, n_y)
        Of the commanded path in each iteration [m, rad], at ``time``.
    time : array (n,) [s]
        Zero where the path begins.
    best : int
        The iteration with the smallest error.
    frequency_hz, gain : float
        Of Q, and of the correction.
    plant : str
    stopped : str
        Reason for early termination, or empty.
    measured_by : str
        ``"tracker"`` or ``"accelerometer"``.
    measured_errors : tuple of float
        Largest measured error of each iteration, in `unit`; of the tracker ``errors``. It decides
        on the best iteration.

    Examples
    --------
    >>> learned = flexgen.learn("elbow", plant={"stiffness": 0.8}, iterations=1)
    >>> learned.best, learned.errors[1] < learned.errors[0]
    (1, True)
    """

    runs: tuple[ControlRun, ...]
    corrections: tuple[np.ndarray, ...]
    time: np.ndarray
    best: int
    frequency_hz: float
    gain: float
    plant: str
    stopped: str
    measured_by: str
    measured_errors: tuple[float, ...]

    @property
    def unit(self) -> str:
        """Unit of the errors: ``"m"``, or ``"rad"`` where the output has no lengths."""
        return self.runs[0].unit

    @property
    def dynamic_errors(self) -> tuple[float, ...]:
        """Largest dynamic errors: static errors at both ends subtracted, in `unit`."""
        found = [
            run.figures(run[self.plant])[f"dynamic_error_max_{self.unit}"] for run in self.runs
        ]
        return tuple(float(x) if np.isfinite(x) else float("inf") for x in found)

    @property
    def errors(self) -> tuple[float, ...]:
        """Largest error of each iteration, at rest included, in `unit`."""
        return tuple(_largest(run, self.plant) for run in self.runs)

    @property
    def errors_m(self) -> tuple[float, ...]:
        """``errors`` [m]; empty where the output has no lengths."""
        return self.errors if self.unit == "m" else ()

    @property
    def dynamic_errors_m(self) -> tuple[float, ...]:
        """``dynamic_errors`` [m]; empty where the output has no lengths."""
        return self.dynamic_errors if self.unit == "m" else ()

    @property
    def measured_m(self) -> tuple[float, ...]:
        """``measured_errors`` [m]; empty where the output has no lengths."""
        return self.measured_errors if self.unit == "m" else ()

    @property
    def problem(self) -> str:
        """The failure of the robot without correction, or empty."""
        return "the robot fails without correction" if self.errors[0] == float("inf") else ""

    def __repr__(self) -> str:
        errors = self.errors
        scale = choose_scale(errors, self.unit)
        first, best = (scale.text(e) for e in (errors[0], errors[self.best]))
        return f"<LearningResult {self.runs[0].model.name}: {first} -> {best}>"

    def __str__(self) -> str:
        """The errors of all iterations."""
        each = [*self.errors, *self.dynamic_errors, *self.measured_errors]
        scale = choose_scale(each, self.unit)
        rows = [
            f"  {k}: {scale.text(e)}{' (best)' * (k == self.best)}"
            for k, e in enumerate(self.errors)
        ]
        if self.measured_by != TRACKER:
            parts = zip(self.dynamic_errors, self.measured_errors, strict=True)
            more = [f", dynamic {scale.text(d)}, estimated {scale.text(e)}" for d, e in parts]
            rows = [row + text for row, text in zip(rows, more, strict=True)]
        head = (
            f"{self.runs[0].model.name}, move {self.runs[0].solution.move.name}: largest error of "
            f"each iteration, Q {self.frequency_hz:.3g} Hz, gain {self.gain:g}"
        )
        load = self.runs[0][self.plant].load
        head += f", load {load}" if load else ""
        return "\n".join([head, *rows, *([f"  {self.stopped}"] if self.stopped else [])])

    @property
    def trajectory(self) -> Trajectory:
        """Motion and torques of the best iteration, of the robot that learned."""
        return self.runs[self.best].trajectory(self.plant)

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON types, SI units."""
        return {
            "model": self.runs[0].model.name,
            "move": self.runs[0].solution.move.name,
            "plant": self.plant,
            "load": self.runs[0][self.plant].load,
            "controller": self.runs[0].controller,
            "frequency_hz": self.frequency_hz,
            "gain": self.gain,
            "measured_by": self.measured_by,
            f"errors_max_{self.unit}": list(self.errors),
            f"dynamic_errors_max_{self.unit}": list(self.dynamic_errors),
            f"measured_errors_max_{self.unit}": list(self.measured_errors),
            "best": self.best,
            "stopped": self.stopped,
        }


@checked_types(own=("frequency_hz",))
@reported("learn")
@needs("learn")
def learn(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    plant: PlantChanges | None = None,
    iterations: Iterations = ITERATIONS,
    gain: Gain = 1.0,
    frequency_hz: Positive | None = None,
    measured_by: MeasuredBy = "tracker",
    controller: Any = "ppi",
    sample_time: Positive = SAMPLE_S,
    delay: NotNegative = 0.0,
    encoder_noise: NotNegative = 0.0,
    seed: Seed = 0,
    solution: Solution | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> LearningResult:
    """Learn the path of a robot that differs from its model, in simulation, from its measured tool
    error.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    plant : mapping, optional
        The robot; default: as the model. Changes such as ``{"stiffness": 0.8}``, see
        `flexgen.feedback.loop.plants`.
    iterations : int
        At most.
    gain : float
        Of the correction. 0.5 learns more slowly and bears larger differences.
    frequency_hz : float, optional [Hz]
        Of the low pass; default: 0.7 of the lowest natural frequency with locked motors. That of
        the model.
    measured_by : str
        The tool error: by a ``"tracker"``, or estimated from accelerometers and motor angles,
        which do not show errors at rest. A tracker is without error; ``"accelerometer"``: those of
        the model file, or one at the tool with noise of 0.05 m/s^2, and motor angles. The errors
        at rest are not learned then.
    controller, sample_time, delay, encoder_noise, seed, solution
        As for `flexgen.control`; every iteration has other noise. Corrected paths are inverted
        with the model and the force of the solution.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the result has the iterations so far;
        its ``stopped`` says so. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    LearningResult

    Raises
    ------
    ArgumentError
        An argument is out of range, or the model has no inversion in C.
    SolverError
        The move has no solution. If the robot fails, ``stopped`` states it instead.

    Examples
    --------
    >>> learned = flexgen.learn("elbow", plant={"stiffness": 0.8}, iterations=1)
    >>> [f"{1e6 * error:.0f} um" for error in learned.errors]
    ['242 um', '0 um']
    """
    tell = progress if callable(progress) else (lambda line: None)
    seed = seed_of(seed)
    name = "robot"
    channels = (
        _accelerometers(robot_of(model), encoder_noise) if measured_by == ACCELEROMETER else None
    )
    case = control_case(
        model if channels is None else channels.model,
        move,
        sample_time=sample_time,
        delay=delay,
        plants={
            name: mapping_of(
                "plant", {} if plant is None else plant, "changes such as {'stiffness': 0.8}"
            )
        },
        encoder_noise=encoder_noise,
        seed=seed,
        solution=solution,
        progress=progress if callable(progress) else None,
    )
    commanded = CommandedPath(case, sample_time, delay, tell)
    motion = case.reference.points(np.array([0]))
    low = (
        frequency_hz
        if frequency_hz is not None
        else SHARE * (lowest_locked_hz(case.model, motion) or 10.0)
    )
    if not (is_number(low) and 0 < low < 0.45 / commanded.period):
        most = 0.45 / commanded.period
        raise ArgumentError(
            f"frequency_hz: given {low!r}, expected more than 0, below {most:.4g} Hz"
        )
    law, title = controller_of(controller, case.equations.model, sample_time, delay, motion)
    seen = _plain if channels is None else _Smoothed(case, channels, name)
    with limit_fit("learn", time_limit, tell):
        runs, corrections, best, stopped, shown = _iterate(
            commanded,
            lambda corrected: run_case(corrected, law, title),
            seen,
            name,
            iterations,
            gain,
            low,
            tell,
        )
    return LearningResult(
        runs,
        corrections,
        commanded.time,
        best,
        float(low),
        float(gain),
        name,
        stopped,
        measured_by,
        shown,
    )


def _iterate(
    commanded: CommandedPath,
    run: Callable[[Case], ControlRun],
    seen: Callable[[ControlRun], ControlRun],
    name: str,
    iterations: int,
    gain: float,
    low: float,
    tell: Callable[[str], None],
) -> tuple[tuple[ControlRun, ...], tuple[np.ndarray, ...], int, str, tuple[float, ...]]:
    """Runs, corrections, best iteration, reason for early termination, and measured errors."""
    runs: list[ControlRun] = []
    errors: list[float] = []
    corrections = [np.zeros((len(commanded.time), commanded.outputs))]
    best = 0
    stopped = ""
    noisy = seen is not _plain
    with keep_best():
        for k in range(iterations + 1):
            if k and is_over():
                break
            began = time.perf_counter()
            try:
                corrected = commanded.case(corrections[-1], k)
            except FlexgenError as failure:
                if k == 0:
                    raise
                stopped = f"iteration {k}: the corrected path cannot be inverted ({failure})"
                break
            done = run(corrected)
            shown = seen(done)
            runs.append(done)
            errors.append(_largest(shown, name))
            best_known((time.perf_counter() - began) * iterations / MOST_STEPS)
            tell(f"iteration {k}: largest error {format_size(errors[-1], runs[-1].unit)}")
            if k == 0 and not np.isfinite(errors[0]):
                stopped = "the robot fails without correction"
                break
            if errors[-1] < errors[best]:
                best = k
            grown = (
                errors[-1] > GROWS * errors[0]
                if noisy
                else errors[-1] - GROWS * errors[best] > SETTLED * errors[0]
            )
            if not np.isfinite(errors[-1]) or grown:
                stopped = f"iteration {k}: the error grows; the best iteration is {best}"
                break
            if k < iterations:
                error = commanded.error(shown, name)
                share = gain / (k + 1) if noisy else gain
                corrections.append(corrections[-1] - share * commanded.filter(error, low))
    if reason := reason_of_end():
        stopped = stopped or f"{reason} after iteration {len(runs) - 1}; the best one is {best}"
    return tuple(runs), tuple(corrections[: len(runs)]), best, stopped, tuple(errors)


def _accelerometers(model: RobotModel, encoder_noise: float) -> Channels:
    """Motor angles and all accelerometers of a model; one at the tool where it has none."""
    own = [sensor.name for sensor in model.sensors if sensor.type == "accelerometer"]
    noise = {MOTORS: encoder_noise} if encoder_noise > 0 else {}
    found = channels_of(model, (MOTORS, *(own or [TOOL_ACCELEROMETER])), noise)
    return found if not own else replace(found, model=model, index=_places(model, found))


def _places(model: RobotModel, channels: Channels) -> np.ndarray:
    """Numbers of the channels among motors and all sensors of a model."""
    names = [
        *(m.name for m in model.motors),
        *(channel for sensor in model.sensors for channel in sensor.channels),
    ]
    return np.array([names.index(name) for name in channels.names])


def _plain(run: ControlRun) -> ControlRun:
    """Measurement of a tracker of the tool: the error itself."""
    return run


class _Smoothed:
    """Measurement of the error by the sensors of the robot instead of a tracker of the tool.

    Learning corrects the error that it measures after each run. A simulation knows the true motion
    of the arm, a real robot does not: it has motor encoders and accelerometers. This class hides
    the true motion behind the estimate of a `PathSmoother` from these signals.

    ``case``: the motion and its hardware; ``channels``: the measured signals; ``name``: the robot
    of a run whose motion is estimated.
    """

    def __init__(self, case: Case, channels: Channels, name: str) -> None:
        self._case = case
        self._channels = channels
        self._name = name
        self._smoother = PathSmoother(channels, case.reference, case.hardware.sample_s)

    def __call__(self, run: ControlRun) -> ControlRun:
        """The run with estimates in place of the robot's arm motion and output error.

        Replaced are the arm coordinates ``q_a`` (n, n_a) [rad or m], the error of the output
        ``error`` (n, n_y) [m or rad], and ``turn`` (n,) [rad], the angle between the orientations
        of tool and reference, None where the output has no orientation. All else, and the run of
        a robot that failed, is unchanged.
        """
        robot = run[self._name]
        reference = run.reference
        hardware = run.hardware
        if robot.failure:
            return run
        # measured signals minus those planned: motor angles (n, n_m), then all sensors (n, n_s)
        dy = np.hstack([robot.measured - reference.motion["q_m"], robot.sensors - reference.y_s])
        # Torques minus the feedforward (n, n_m) [N m], when they reach the motors: the delay is a
        # number of whole samples, and a part of one in the hardware.
        delay_part = hardware.delay_s / hardware.sample_s
        du = acting(robot.tau_m - reference.held, run.delay_samples, delay_part)
        q_a = reference.motion["q_a"] + self._smoother.deviation(dy[:, self._channels.index], du)
        error, turn = output_errors(self._case.equations, reference, np.ascontiguousarray(q_a))
        estimated = replace(robot, q_a=q_a, error=error, turn=turn)
        return replace(run, runs=tuple(estimated if r is robot else r for r in run.runs))


def _largest(run: ControlRun, plant: str) -> float:
    """Largest error of a robot [m, or rad where the output has no lengths]; infinite where it
    failed.
    """
    found = run.figures(run[plant])[f"error_max_{run.unit}"]
    return float(found) if np.isfinite(found) else float("inf")
