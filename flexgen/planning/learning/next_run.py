"""The next run of a real robot that learns a move, from the measured error of its last one.

    d <- d - gain Q e,        (q_m, tau)(t) = inverse dynamics of the path y + d

e is the measured error of the tool, Q a low pass in a window (`window.py`). The whole corrected
path is inverted with the elastic model, so that torques and references of the motors change
together: to first order by the inverse of the model linearised along the move. In the model the
robot follows this change without feedback, and any linear feedback of the motors, whatever its
gains, stays silent on it: they do not enter the correction. They decide how a robot that differs
from its model follows it, and with that up to which frequency learning converges (`band.py`).

Where only motor angles are measured, their error e_m is corrected alike:

    r <- r - gain Q e_m,      q_m + r,  tau + (the torques that move the motors by r)

with the arm that the motors swing (`motor_reaction.py`). What happens behind the gears is not seen
then: deflections, and the tool.

Source: cf. S. Arimoto et al., J. Robotic Systems 1(2), 1984; D. Bristow et al., IEEE Control
Systems Magazine 26(3), 2006.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import NotNegative, Positive
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import format_size
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Shown, Table
from flexgen.base.spec.arguments import is_number
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.feedback.loop.case import SAMPLE_S
from flexgen.feedback.loop.sampled_model import output_jacobian
from flexgen.inversion.problem.sampling import time_derivative
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.force.process_force import CHANNEL, make_force
from flexgen.paths.path import Path, find_move
from flexgen.planning.learning.alignment import Alignment, align
from flexgen.planning.learning.band import learning_band
from flexgen.planning.learning.corrected import DEGREE, CorrectedPath
from flexgen.planning.learning.history import (
    ENDED,
    GREW,
    KEY,
    LearningFolder,
    LearningRun,
    best_of,
    judge,
    read_folder,
    scatter_of,
    write_folder,
)
from flexgen.planning.learning.learn import Gain
from flexgen.planning.learning.measured_run import (
    MeasuredRun,
    SharedAxes,
    axes_in_output,
    read_run,
)
from flexgen.planning.learning.motor_reaction import LinearisedArm
from flexgen.planning.learning.window import MOST, learned_part, low_pass
from flexgen.runtime.inversion.path_inversion import Inversion

CORRECTION = "correction"  # channel of the corrections of the path, d
MOTOR_CORRECTION = "motor_correction"  # channel of those of the motors, r
MOTION = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
# Errors are reported up to this many times the frequency of the low pass: above are vibrations
# that no correction reaches, and the noise of the tracker.
REPORTED = 5.0
# Largest distance between the output of a trajectory and the corrected path, over the size of the
# path: a trajectory of another move or of another model is not corrected.
SAME_PATH = 1e-2
SOFTER = 0.1  # change of all springs of which the hidden error is stated
BAND_AT = 0.0, 0.5, 0.8  # parts of the path at which the band of learning is computed
# Angle of a joint by which friction holds its motor back [rad], and the part of the largest speed
# below which it does so less.
HELD = 2e-4
SLOW = 0.02
REFINED = 3  # times that the clock is fitted with the expected errors
HALF = 0.5  # of the frequency after which the error grew
CHANGED = 1e-2  # of the largest torque: a difference by which the model is another one
LARGEST_MOTOR = 0.2  # motor error over the motion of the motor: a record of another move
SLOPE = 0.05  # difference of a measured motion of a motor from its reference
OLDEST_S = 0.3  # largest offset of the clock of a record of motors from the path's begin


@checked_result
@dataclass(frozen=True, repr=False)
class NextRun(Result):
    """Result of `flexgen.next_run`: the corrected torques and references of the next run.

    Attributes
    ----------
    model, move : str
    runs : tuple of LearningRun
        All measured runs, the last one too.
    iteration : int
        Number of the trajectory for the next run; that of the best run where learning ended.
    file : str
        The trajectory.
    trajectory : Trajectory
        Its content: ``q_a v_a a_a q_m v_m a_m tau_m``, the corrections, ``y_ref``.
    time : array (n,) [s]
        Of the measured error, zero where the path begins.
    error : array (n, k) [m; of motors rad]
        Measured minus wanted positions of the tool, or angles of the motors.
    clock_s : float [s]
        Reading of the record's clock where the path begins.
    frame : tuple of float
        Pose of the tracker in the base: position [m], rotation vector [rad]; empty for motors.
    hidden_m, soft_m : float or None [m]
        Of the error that 10 % softer springs make, largest: what the estimates of clock and frame
        hide, and all of it. None for motors.
    notes : tuple of str
        What was done to the record, and what it does not show.

    Examples
    --------
    >>> flexgen.NextRun.__name__
    'NextRun'
    """

    model: str
    move: str
    runs: tuple[LearningRun, ...]
    iteration: int
    file: str
    trajectory: Trajectory
    time: np.ndarray
    error: np.ndarray
    clock_s: float
    frame: tuple[float, ...]
    hidden_m: float | None
    soft_m: float | None
    notes: tuple[str, ...] = ()

    @property
    def last(self) -> LearningRun:
        """The run that was measured last."""
        return self.runs[-1]

    @property
    def stopped(self) -> str:
        """Why learning ended, with what to do; empty while it goes on."""
        best = next(run for run in self.runs if run.iteration == self.iteration or not self._ended)
        error = format_size(best.rms, best.unit)
        if self.last.state == GREW:
            return (
                f"the error grew after iteration {self.iteration}, whose trajectory (rms error "
                f"{error}) is that of the next run; learn from it up to a lower frequency, such as "
                f"{HALF * self.last.frequency_hz:.3g} Hz, or with half of the gain"
            )
        if self.last.state == ENDED:
            return (
                f"the error no longer falls; the best trajectory is that of iteration "
                f"{self.iteration}, rms error {error}"
            )
        return ""

    @property
    def _ended(self) -> bool:
        return self.last.state in (ENDED, GREW)

    def __repr__(self) -> str:
        error = format_size(self.last.largest, self.last.unit)
        return (
            f"<NextRun {self.model}, move {self.move}: iteration {self.last.iteration}, largest "
            f"error {error}>"
        )

    def content(self) -> tuple[Part, ...]:
        """The last run, all runs, and what the record does not show."""
        last = self.last
        u = last.unit
        columns = (
            Column("iteration", key="iteration"),
            Column("rms error", u, f"rms_{u}"),
            Column("largest error", u, f"largest_{u}"),
            Column("learned from 0 to, Hz", key="frequency_hz"),
            Column("the error", key="state"),
        )
        own = [run for run in self.runs if run.measured == last.measured]
        cells = tuple(
            (
                run.iteration,
                run.rms,
                run.largest,
                Shown(run.frequency_hz, f"{run.frequency_hz:.3g}"),
                run.state,
            )
            for run in own
        )
        what = "tool" if u == "m" else "motors"
        hidden = self.hidden_m
        return (
            Prose(
                f"{self.model}, move {self.move}: run of iteration {last.iteration}, measured "
                f"error of the {what}",
                is_title=True,
            ),
            Data("model", self.model),
            Data("move", self.move),
            Data("measured", last.measured),
            Row("rms error", last.rms, u, f"rms_{u}"),
            Row("largest error", last.largest, u, f"largest_{u}"),
            Row("scatter of the rms error", last.scatter or None, u, f"scatter_{u}"),
            Row("clock of the record where the path begins", self.clock_s, "s", "clock_s"),
            Row(
                "frame of the tracker in the base, x y z [m], rotation vector [rad]",
                " ".join(f"{x:.6g}" for x in self.frame),
            ),
            Data("frame", list(self.frame)),
            Row(
                f"error of springs {SOFTER:.0%} softer, largest",
                self.soft_m,
                "m",
                "soft_m",
                note="at slow motion, from the model",
            ),
            Row("of it along what the estimates of clock and frame hide", hidden, "m", "hidden_m"),
            Table(columns, cells, "Runs", "runs"),
            *(Prose(f"note: {text}", "notes") for text in self.notes),
            Data("notes", list(self.notes)),
            *([Prose(self.stopped)] if self.stopped else []),
            Data("stopped", self.stopped),
            Data("next_iteration", self.iteration),
            Prose(f"next run: {self.file}, iteration {self.iteration}"),
            Data("file", self.file),
        )

    @property
    def problem(self) -> str:
        """That the error grew; else empty."""
        return "the error grew" if self.last.state == GREW else ""


@checked_types(own=("frequency_hz", "frame"))
@reported("learn")
@needs("learn")
def next_run(
    model: str | FilePath | RobotModel | Equations,
    folder: str | FilePath,
    measured: str | FilePath,
    move: str | Move | None = None,
    *,
    frequency_hz: Positive | None = None,
    gain: Gain = 1.0,
    controller: Any = "ppi",
    sample_time: Positive = SAMPLE_S,
    delay: NotNegative = 0.0,
    clock: float | None = None,
    frame: Sequence[float] | None = None,
    progress: Choice = None,
) -> NextRun:
    """Correct torques and references of a move by the measured error of its last run on the real
    robot, and write those of the next run.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    folder : str or Path
        Folder of the move, with ``trajectory.csv`` or ``.npz``: the torques and references of
        the last run, from `flexgen.solve` or from this function, which replaces them by those of
        the next run. The earlier ones stay there as ``command_0.csv``, ..., the errors of all
        runs in ``history.csv``.
    measured : str or Path
        Record of the last run: positions of the tool from a tracker, angles of all motors, or
        both; see `flexgen.planning.learning.measured_run`.
    move : str or Move, optional
        Default: the move of the trajectory.
    frequency_hz : float, optional [Hz]
        Up to which the error is learned; default: that of the last run, half of it where the
        error grew, at first the one up to which robots with springs 20 % softer and 25 % stiffer
        converge with the feedback of the robot.
    gain : float
        Of the correction. 0.5 learns more slowly and bears larger differences from the model.
    controller, sample_time, delay
        Feedback of the robot, as for `flexgen.control`: for the default frequency.
    clock : float, optional [s]
        Reading of the record's clock where the path begins; default: estimated from the record.
    frame : sequence of float, optional
        Pose of the tracker in the base of the robot, position [m] and rotation vector [rad], six
        numbers; default: estimated from the record. Six zeros: it measures in the base.
    progress : callable or bool, optional

    Returns
    -------
    NextRun

    Raises
    ------
    ArgumentError
        The folder has no trajectory of this move and model; the record cannot be that of this
        run, or was used before. Nothing is written then.
    SolverError
        The corrected path has no inverse. Nothing is written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> trajectory = flexgen.solve("elbow", "line").trajectory
    >>> _ = trajectory.save(folder / "trajectory.csv")
    >>> time = np.arange(-0.2, 1.5, 0.002)
    >>> y = flexgen.plan("elbow", "line").sample(time).y[:, :, 0] + [[3e-4, -1e-4]]
    >>> table = np.column_stack([time, 1e3 * y])
    >>> np.savetxt(folder / "run.csv", table, delimiter=",", header="time_s,x_mm,z_mm", comments="")
    >>> run = flexgen.next_run("elbow", folder, folder / "run.csv", clock=0.0, frame=[0.0] * 6)
    >>> f"{1e6 * run.last.rms:.0f} um", run.iteration
    ('316 um', 1)
    """
    tell = progress if callable(progress) else (lambda line: None)
    robot = robot_of(model)
    place = read_folder(folder)
    record = read_run(measured, robot)
    _check_new(record, place)
    motion = _own_move(robot, place, move)
    elastic = derive(without_states(robot))
    last = place.trajectory
    path = Path(elastic, motion)
    force = make_force(last, robot, path.duration) if CHANNEL in last else None
    tell("inverse dynamics of the path")
    corrected = CorrectedPath(elastic, path.move, robot, force, tell)
    given = _corrections(last, corrected)
    _check_trajectory(place, corrected, given[0])
    seen = _seen(record, robot, corrected, last, clock, frame)
    rate = 1.0 / record.step
    feedback = controller, sample_time, delay
    low = _frequency(frequency_hz, place.runs, corrected, last, rate, feedback)
    run = _judged(seen, record, place, low, float(gain))
    runs = (*place.runs, run)
    same = [r for r in runs if r.measured == run.measured]
    notes = [*record.notes, *seen.notes]
    if run.state in (ENDED, GREW):
        iteration = best_of(same)
        trajectory = Trajectory.load(place.command(iteration)) if iteration else None
        if trajectory is None:
            first = place.command(0)
            trajectory = Trajectory.load(first) if first.is_file() else last
        file = write_folder(place, runs, None, iteration)
    else:
        iteration = place.next_iteration
        tell(f"inverse dynamics of iteration {iteration}")
        trajectory = _corrected_trajectory(
            seen, low, float(gain), given, corrected, last, iteration
        )
        notes += _changed_model(corrected, given, last)
        file = write_folder(place, runs, trajectory, iteration)
    notes += _start_notes(trajectory, last)
    return NextRun(
        robot.name,
        motion.name,
        runs,
        iteration,
        str(file),
        trajectory,
        seen.time,
        seen.error,
        seen.clock_s,
        seen.frame,
        seen.hidden_m,
        seen.soft_m,
        tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """The measured error of a run.

    ``time`` (n,) [s], zero where the path begins; ``error`` (n, k): of the tool at the ``rows`` of
    the output [m], or of the motors [rad] where ``rows`` is None.
    """

    time: np.ndarray
    error: np.ndarray
    rows: list[int] | None
    clock_s: float
    frame: tuple[float, ...]
    hidden_m: float | None
    soft_m: float | None
    notes: tuple[str, ...]


def _check_new(record: MeasuredRun, place: LearningFolder) -> None:
    """ArgumentError where a record was used before."""
    for run in place.runs:
        if run.digest == record.digest:
            raise ArgumentError(
                f"measured: given {record.source}, the record of the run of iteration "
                f"{run.iteration}, which was used, expected that of the run of iteration "
                f"{place.iteration}: run {place.path / ('trajectory' + place.ending)} and measure "
                f"it; where an earlier call was broken off, the newest command_* is its result"
            )


def _own_move(robot: RobotModel, place: LearningFolder, move: str | Move | None) -> Move:
    """The move of a folder; ArgumentError where it is another one than the given one, or of
    another model.
    """
    meta = place.trajectory.meta
    where = place.path / f"trajectory{place.ending}"
    own = meta.get("move")
    if meta.get("model") not in (None, robot.name):
        raise ArgumentError(
            f"{where}: given a trajectory of model {meta['model']}, expected one of {robot.name}"
        )
    asked = find_move(robot, own if move is None and isinstance(own, str) else move)
    if isinstance(own, str) and asked.name != own:
        raise ArgumentError(
            f"{where}: given a trajectory of move {own}, expected one of move {asked.name}"
        )
    missing = [name for name in MOTION if name not in place.trajectory]
    if missing:
        raise ArgumentError(
            f"{where}: given a trajectory without {', '.join(missing)}, expected motion and "
            "torques as flexgen solve writes them without --hold"
        )
    return asked


def _corrections(last: Trajectory, corrected: CorrectedPath) -> tuple[np.ndarray, np.ndarray]:
    """Corrections of path (n, n_y) [m, rad] and motors (n, n_m) [rad] of a trajectory, at the
    instants of the corrected path; zero where it has none.
    """
    found = []
    widths = corrected.outputs, last["tau_m"].shape[1]
    for name, width in zip((CORRECTION, MOTOR_CORRECTION), widths, strict=True):
        if name not in last:
            found.append(np.zeros((len(corrected.time), width)))
            continue
        inside = np.clip(corrected.time, last.time[0], last.time[-1])
        found.append(np.asarray(make_interp_spline(last.time, last[name], k=5)(inside)))
    return found[0], found[1]


def _check_trajectory(
    place: LearningFolder, corrected: CorrectedPath, correction: np.ndarray
) -> None:
    """ArgumentError where the tool of a trajectory does not follow the corrected path."""
    model = corrected.equations.model
    last = place.trajectory
    if model.output.type == "combination":
        return
    p = evaluate(corrected.equations.function("forward_kinematics"), last["q_a"])[0]
    p = p.reshape(len(last.time), 3)
    rows = list(range(3)) if model.output.type == "tool_pose" else list(model.output.tool_rows)
    wanted = corrected.path.sample(last.time).y[:, : len(rows), 0]
    d = np.stack([np.interp(last.time, corrected.time, x) for x in correction.T], axis=1)
    away = np.abs(p[:, rows] - wanted - d[:, : len(rows)]).max()
    size = float(np.ptp(wanted, axis=0).max())
    if away > SAME_PATH * size:
        raise ArgumentError(
            f"{place.path}: given a trajectory whose tool is up to {away:.3g} m away from the path "
            f"of move {corrected.path.move.name}, expected the inverse dynamics of this move with "
            "this model: write it anew with flexgen solve"
        )


def _seen(
    record: MeasuredRun,
    robot: RobotModel,
    corrected: CorrectedPath,
    last: Trajectory,
    clock: float | None,
    frame: Sequence[float] | None,
) -> _Seen:
    """The error of a record: of the tool where a tracker measured it, else of the motors."""
    if not record.axes:
        if frame is not None:
            raise ArgumentError(
                "frame: given with a record without a tracker, expected none: angles of motors "
                "have no frame"
            )
        time, error, at = _motor_error(record, corrected, last, clock)
        return _Seen(time, error, None, at, (), None, None, _blind_notes(robot))
    given = None
    if frame is not None:
        given = np.asarray(frame, dtype=float)
        if given.shape != (6,) or not np.isfinite(given).all():
            raise ArgumentError(
                f"frame: given {frame!r}, expected six numbers: position [m] and rotation vector "
                "[rad] of the tracker in the base"
            )
    by_motors = clock is None and record.motors is not None
    known = _motor_error(record, corrected, last, None)[2] if by_motors else clock
    rows = axes_in_output(record.axes, robot)
    curve = _positions_of(corrected.path, record.axes, rows)
    found = align(
        record.source,
        record.time,
        record.position,
        curve,
        corrected.path.duration,
        clock_s=known,
        frame=given,
    )
    at, expected = _expected_errors(corrected, last, rows)
    for _ in range(REFINED):
        time = record.time - found.clock_s
        error = found.positions(record.position) - curve(time)
        inside = (time >= at[0]) & (time <= at[-1])
        shapes = np.array([_resampled(x, at, time[inside]) for x in expected])
        found = found.refined(error[inside], time[inside], curve, shapes)
    time = record.time - found.clock_s
    error = (found.positions(record.position) - curve(time))[:, rows.tracker]
    soft, hidden = _hidden(found, at, curve, expected, len(expected) - robot.n_m)
    notes = [] if not by_motors else ["the clock of the record follows from its motor angles"]
    return _Seen(
        time,
        error,
        rows.output,
        found.clock_s,
        tuple(map(float, found.frame)),
        hidden,
        soft,
        (*notes, *_estimate_notes(found)),
    )


def _estimate_notes(found: Alignment) -> list[str]:
    """Which errors cannot be seen, since clock or frame were estimated from the record."""
    parts = ["a constant offset of the tool and a tilt of the whole path"] * found.frame_fitted
    parts += ["a constant delay along the path"] * found.clock_fitted
    if not parts:
        return []
    stated = [name for name, fitted in (("frame", found.frame_fitted),
                                        ("clock", found.clock_fitted)) if fitted]  # fmt: skip
    return [
        f"{' and '.join(stated)} are estimated from this record: {' and '.join(parts)} are not "
        f"seen, and not learned; state {' and '.join(f'the {name}' for name in stated)} to see them"
    ]


def _blind_notes(robot: RobotModel) -> tuple[str, ...]:
    """What angles of motors do not show."""
    return (
        f"only motors are measured: deflections of the gears and springs of {robot.name} and the "
        "error of the tool behind them are not seen, and not learned",
    )


def _positions_of(path: Path, axes: str, rows: SharedAxes) -> Callable[[np.ndarray], np.ndarray]:
    """Positions (k, len(axes)) [m] of a path at instants (k,) [s]; zero along an axis of the
    tracker that the output does not have.
    """

    def curve(t: np.ndarray) -> np.ndarray:
        found = np.zeros((len(t), len(axes)))
        found[:, rows.tracker] = path.sample(t).y[:, rows.output, 0]
        return found

    return curve


def _motor_error(
    record: MeasuredRun, corrected: CorrectedPath, last: Trajectory, clock: float | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Instants (n,) [s] on the path, motor angles minus wanted ones (n, n_m) [rad], and the
    reading of the clock where the path begins [s].
    """
    assert record.motors is not None
    wanted = last["q_m"] - (last[MOTOR_CORRECTION] if MOTOR_CORRECTION in last else 0.0)
    curve = make_interp_spline(last.time, wanted, k=5)

    def reference(t: np.ndarray) -> np.ndarray:
        return np.asarray(curve(np.clip(t, last.time[0], last.time[-1])))

    near = np.linspace(0.0, corrected.path.duration, 400)
    _check_motors(record, reference(near), last)
    scale = np.maximum(np.ptp(reference(near), axis=0), 1e-9)
    found = align_motors(record, lambda t: reference(t) / scale, scale, corrected, clock)
    time = record.time - found
    error = record.motors - reference(time)
    inside = (time >= 0.0) & (time <= corrected.path.duration)
    worst = np.abs(error[inside]).max(axis=0) / scale
    # A motor that hardly moves is compared with the others on its own side.
    moving = scale > 1e-2 * scale.max()
    if (worst[moving] > LARGEST_MOTOR).any():
        j = int(np.argmax(np.where(moving, worst, 0.0)))
        raise ArgumentError(
            f"{record.source}: given angles of motor {last.labels['q_m'][j]} up to "
            f"{worst[j] * scale[j]:.3g} rad away from those of the trajectory, which moves by "
            f"{scale[j]:.3g} rad, expected a record of this run: another move, another side of "
            "the gear, or another zero of the encoder"
        )
    return time, error, found


def _check_motors(record: MeasuredRun, wanted: np.ndarray, last: Trajectory) -> None:
    """ArgumentError where the size of the motion of a motor is another one: wrong unit, side or
    sign.
    """
    assert record.motors is not None
    moved = np.ptp(record.motors, axis=0)
    size = np.ptp(wanted, axis=0)
    for j, name in enumerate(last.labels["q_m"]):
        if size[j] > 1e-2 * size.max() and abs(moved[j] / size[j] - 1.0) > LARGEST_MOTOR:
            raise ArgumentError(
                f"{record.source}: motor {name}: given a motion of {moved[j]:.4g} rad, "
                f"{moved[j] / size[j]:.4g} times that of the trajectory, expected the same: a "
                "wrong unit in the name of the column, another side of the gear, or another move"
            )


def align_motors(
    record: MeasuredRun,
    reference: Callable[[np.ndarray], np.ndarray],
    scale: np.ndarray,
    corrected: CorrectedPath,
    clock: float | None,
) -> float:
    """Reading of a record's clock [s] where the path begins, from motor angles over their motion
    ``scale`` (n_m,) [rad].
    """
    assert record.motors is not None
    from scipy.optimize import minimize_scalar

    q = record.motors / scale
    duration = corrected.path.duration

    def squares(at: float) -> float:
        return float(((q - reference(record.time - at)) ** 2).mean())

    first, last = record.time[0] - OLDEST_S, record.time[-1] - duration + OLDEST_S
    steps = np.arange(first, max(last, first + 1e-6), max(2e-3, record.step))
    guess = float(steps[int(np.argmin([squares(float(s)) for s in steps]))])
    width = 2.0 * max(2e-3, record.step)
    options = {"xatol": 1e-7}
    bounds = guess - width, guess + width
    found = float(minimize_scalar(squares, bounds=bounds, method="bounded", options=options).x)
    slack = 2.0 * record.step
    if record.time[0] > found + slack or record.time[-1] < found + duration - slack:
        raise ArgumentError(
            f"{record.source}: given a record from {record.time[0] - found:.4g} to "
            f"{record.time[-1] - found:.4g} s of the path, expected one of all of it, 0 to "
            f"{duration:.4g} s: start the record before the robot moves"
        )
    if clock is None:
        return found
    if abs(clock - found) > max(0.05, slack):
        raise ArgumentError(
            f"clock: given {clock:.6g} s, but the motors of {record.source} fit the trajectory "
            f"with {found:.6g} s, expected the reading of its clock where the path begins; leave "
            "it out, and it is estimated"
        )
    return clock


def _expected_errors(
    corrected: CorrectedPath, last: Trajectory, rows: SharedAxes
) -> tuple[np.ndarray, np.ndarray]:
    """Instants (k,) [s] along the path, and errors of the tracked point (m, k, d) [m] that the
    model expects: of each spring that is softer, at slow motion, then of each motor that friction
    holds back.
    """
    equations = corrected.equations
    model = equations.model
    inside = np.flatnonzero((last.time >= 0.0) & (last.time <= corrected.path.duration))
    at = inside[np.unique(np.linspace(0, len(inside) - 1, 200).astype(int))]
    motion = [last[name][at] for name in MOTION]
    library = library_with(model, ["inverse_dynamics"])
    torque = np.asarray(library.inverse_dynamics(*(np.ascontiguousarray(x) for x in motion[:3])))
    step = float(last.time[at[1]] - last.time[at[0]])
    arm = LinearisedArm(equations, motion, step)
    moved = [
        arm.softer(torque * (np.arange(model.n_a) == i), SOFTER) for i in arm.free if i < model.n_a
    ]
    twist = np.linalg.inv(model.eta)
    for j in range(model.n_m):
        held = np.zeros((len(at), model.n_a))
        speed = motion[4][:, j] / max(float(np.abs(motion[4][:, j]).max()), 1e-12)
        held[:, list(model.i_g)] = HELD * np.tanh(speed / SLOW)[:, None] * np.sign(twist[:, j])
        held[:, list(model.i_g)] *= np.abs(twist[:, j]) > 0.0
        moved.append(held)
    W = evaluate(output_jacobian(equations), motion[0])[0].reshape(len(at), -1, model.n_a)
    found = np.zeros((len(moved), len(at), len(rows.axes)))
    for k, dq in enumerate(moved):
        found[k][:, rows.tracker] = np.einsum("nij,nj->ni", W, dq)[:, rows.output]
    return last.time[at], found


def _resampled(x: np.ndarray, at: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Samples (k, d) at other instants (n,), linear between them."""
    return np.stack([np.interp(time, at, column) for column in x.T], axis=1)


def _hidden(
    found: Alignment,
    at: np.ndarray,
    curve: Callable[[np.ndarray], np.ndarray],
    expected: np.ndarray,
    springs: int,
) -> tuple[float, float]:
    """Largest error of the tool with softer springs at slow motion [m], and how much of it the
    estimates of clock and frame hide; the first ``springs`` of the expected errors are theirs.
    """
    error = expected[:springs].sum(axis=0)
    hidden = found.hidden(error, at, curve)
    sizes = [float(np.linalg.norm(x, axis=1).max()) for x in (error, hidden)]
    return sizes[0], sizes[1]


def _frequency(
    given: float | None,
    runs: Sequence[LearningRun],
    corrected: CorrectedPath,
    last: Trajectory,
    rate: float,
    feedback: tuple[Any, float, float],
) -> float:
    """Frequency of the low pass [Hz]; ArgumentError where the record has too few samples for it."""
    found = given
    most = MOST * rate
    if found is None and runs:
        found = runs[-1].frequency_hz * (HALF if runs[-1].state == GREW else 1.0)
    if found is None:
        parts = np.array(BAND_AT) * corrected.path.duration
        at = np.searchsorted(last.time, parts).clip(0, len(last.time) - 1)
        motion = [last[name][at] for name in MOTION]
        found = min(learning_band(corrected.equations, motion, *feedback), most)
    if not (is_number(found) and 0.0 < found <= most):
        raise ArgumentError(
            f"frequency_hz: given {found!r}, expected more than 0, at most {most:.4g} Hz, "
            f"{MOST:g} of the rate of the record"
        )
    return float(found)


def _judged(
    seen: _Seen, record: MeasuredRun, place: LearningFolder, low: float, gain: float
) -> LearningRun:
    """The run of a record, with what its error did."""
    shown = low_pass(seen.time, seen.error, REPORTED * low)
    noise = seen.error - shown
    sizes = np.linalg.norm(shown, axis=1) if seen.rows is not None else np.abs(shown).max(axis=1)
    rms = float(np.sqrt((sizes**2).mean()))
    largest = float(sizes.max())
    measured = "motors" if seen.rows is None else "tool"
    before = [run for run in place.runs if run.measured == measured]
    part = min(2.0 * REPORTED * low * record.step, 1.0)
    own = float(np.sqrt((noise**2).sum(axis=1).mean() * part / len(noise)))
    scatter = max(scatter_of(before, place.iteration, rms), own)
    state = judge(before, place.iteration, rms, largest, scatter)
    return LearningRun(
        place.iteration,
        measured,
        rms,
        largest,
        scatter,
        low,
        gain,
        state,
        record.source,
        record.digest,
    )


def _corrected_trajectory(
    seen: _Seen,
    low: float,
    gain: float,
    given: tuple[np.ndarray, np.ndarray],
    corrected: CorrectedPath,
    last: Trajectory,
    iteration: int,
) -> Trajectory:
    """The trajectory of the next run."""
    of_path, of_motors = (x.copy() for x in given)
    learned = gain * learned_part(seen.time, seen.error, corrected.time, low)
    if seen.rows is None:
        of_motors -= learned
    else:
        of_path[:, seen.rows] -= learned
    found = corrected.invert(of_path)
    time = found.t + corrected.time[0]
    channels = {name: getattr(found, name) for name in ("q_a", "v_a", "a_a", "q_m", "v_m")}
    channels |= {"a_m": time_derivative(found.v_m, found.period), "tau_m": found.tau_m}
    if of_motors.any():
        moved = _spline(corrected.time, of_motors, time)
        arm = LinearisedArm(corrected.equations, [channels[x] for x in MOTION], found.period)
        channels["tau_m"] = channels["tau_m"] + arm.torque(*moved)
        for name, x in zip(("q_m", "v_m", "a_m"), moved, strict=True):
            channels[name] = channels[name] + x
    channels["tau_g"] = found.tau_g
    channels[CORRECTION] = _spline(corrected.time, of_path, time)[0]
    channels[MOTOR_CORRECTION] = _spline(corrected.time, of_motors, time)[0]
    return _with_labels(channels, time, corrected, last, iteration)


def _spline(
    grid: np.ndarray, values: np.ndarray, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (n, k) of a correction at rest at both ends and of its rates, at other instants."""
    zero = [(order, np.zeros(values.shape[1])) for order in range(1, (DEGREE + 1) // 2)]
    spline = make_interp_spline(grid, values, k=DEGREE, bc_type=(zero, zero))
    inside = np.clip(time, grid[0], grid[-1])
    moving = ((time >= grid[0]) & (time <= grid[-1]))[:, None]
    return (
        np.asarray(spline(inside)),
        np.where(moving, spline(inside, 1), 0.0),
        np.where(moving, spline(inside, 2), 0.0),
    )


def _with_labels(
    channels: dict[str, np.ndarray],
    time: np.ndarray,
    corrected: CorrectedPath,
    last: Trajectory,
    iteration: int,
) -> Trajectory:
    """Channels as a trajectory with the labels and units of the last one."""
    sample = corrected.path.sample(time)
    channels["y_ref"] = sample.y[:, :, 0]
    if sample.R is not None:
        channels["R_ref"] = sample.R.reshape(len(time), 9)
    if CHANNEL in last:
        channels[CHANNEL] = last.at(np.clip(time, last.time[0], last.time[-1]))[CHANNEL]
    labels = {}
    ports = {}
    units = {}
    output = "y_ref" if corrected.equations.model.output.type != "tool_pose" else None
    for name, x in channels.items():
        source = {CORRECTION: output, MOTOR_CORRECTION: "q_m"}.get(name, name)
        if source is not None and source in last:
            labels[name] = last.labels[source]
            units[name] = last.units[source]
            unit = last.ports[source].unit
        else:
            labels[name] = tuple(map(str, range(x.shape[1])))
            units[name] = ("m",) * 3 + ("rad",) * 3
            unit = "rad or m"
        doc = "learned correction" if source != name else last.ports[name].doc
        ports[name] = Port(name, (x.shape[1],), unit, doc)
    meta = dict(last.meta) | {"kind": "learned", "torque": "smooth", KEY: iteration}
    meta = {key: meta[key] for key in meta if key not in ("errors", "torque_degree")}
    return Trajectory(time, channels, ports, labels, meta, units)


def _changed_model(
    corrected: CorrectedPath, given: tuple[np.ndarray, np.ndarray], last: Trajectory
) -> list[str]:
    """A note where the torques of the last run are not those of the model: it was changed."""
    if given[1].any():
        return []
    found: Inversion = corrected.invert(given[0])
    time = found.t + corrected.time[0]
    inside = (time >= last.time[0]) & (time <= last.time[-1])
    away = float(np.abs(found.tau_m[inside] - last.at(time[inside])["tau_m"]).max())
    if away <= CHANGED * np.abs(last["tau_m"]).max():
        return []
    return [
        f"the torques of the last run differ by up to {away:.3g} N m from those of the model along "
        "its path: the model was changed since; the next run has those of the new model"
    ]


def _start_notes(new: Trajectory, last: Trajectory) -> list[str]:
    """A note where the next run begins at other motor angles than the last one."""
    away = np.abs(new["q_m"][0] - last["q_m"][0])
    j = int(np.argmax(away))
    if away[j] < 1e-6:
        return []
    return [
        f"the next run begins at other motor angles, by up to {away[j]:.3g} rad "
        f"({new.labels['q_m'][j]}): move there first"
    ]
