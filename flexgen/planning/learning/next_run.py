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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import format_size
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Shown, Table
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.inversion.solution import limit_warnings
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.force.process_force import CHANNEL, make_force
from flexgen.paths.path import Path, find_move
from flexgen.planning.learning.band import learning_band
from flexgen.planning.learning.corrected import CorrectedPath
from flexgen.planning.learning.frame_of_poses import frame_of_poses
from flexgen.planning.learning.history import (
    ENDED,
    GREW,
    LearningFolder,
    LearningRun,
    best_of,
    judge,
    read_folder,
    scatter_of,
    write_folder,
)
from flexgen.planning.learning.measured_run import (
    MeasuredRun,
    read_run,
)
from flexgen.planning.learning.next_trajectory import (
    MOTION,
    corrections_of,
    make_trajectory,
    note_changed_model,
    start_notes,
)
from flexgen.planning.learning.options import LearningOptions
from flexgen.planning.learning.seen_error import SHOWN_SOFTER, SeenError, see_error
from flexgen.planning.learning.window import MOST, WIDE, learned_part, low_pass

# Largest distance between the output of a trajectory and the corrected path, over the size of the
# path: a trajectory of another move or of another model is not corrected.
SAME_PATH = 1e-2
# Begin of the corrected motion before the path [s]: a low pass of some Hz has settled there.
EARLY_S = 0.5
BAND_AT = 0.0, 0.5, 0.8  # parts of the path at which the band of learning is computed
LOWER = 0.8  # of the frequency, where the corrected path has no inverse
TRIES = 8
HALF = 0.5  # of the frequency after which the error grew


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
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> trajectory = flexgen.solve("elbow", "line").trajectory
    >>> _ = trajectory.save(folder / "trajectory.csv")
    >>> time = np.arange(-0.2, 1.5, 0.002)
    >>> y = flexgen.plan("elbow", "line").sample(time).y[:, :, 0] + [[3e-4, -1e-4]]
    >>> table = np.column_stack([time, 1e3 * y])
    >>> names = "time_s,x_mm,z_mm"
    >>> np.savetxt(folder / "run.csv", table, delimiter=",", header=names, comments="")
    >>> options = flexgen.LearningOptions(clock=0.0, frame=[0.0] * 6)
    >>> found = flexgen.next_run("elbow", folder, folder / "run.csv", options=options)
    >>> found.last.state, found.iteration
    ('learns', 1)
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
        """Why learning ended, with what to do; empty where it continues."""
        own = [run for run in self.runs if run.iteration == self.iteration]
        if not own:
            return ""
        error = format_size(float(np.mean([run.rms for run in own])), self.last.unit)
        if self.last.state == GREW:
            return (
                f"the error grew after iteration {self.iteration}, whose trajectory (rms error "
                f"{error}) is that of the next run; learn from it up to a lower frequency, such "
                f"as {HALF * self.last.frequency_hz:.3g} Hz, or with half of the gain"
            )
        if self.last.state == ENDED:
            return (
                f"the error no longer falls; the best trajectory is that of iteration "
                f"{self.iteration}, rms error {error}; {self.above:.0%} of the last run's is "
                f"above {self.last.frequency_hz:.3g} Hz"
            )
        return ""

    @property
    def above(self) -> float:
        """Part of the last run's rms error, from 0 to 1, that is above the learned frequencies."""
        last = self.last
        shown = low_pass(self.time, self.error, WIDE * last.frequency_hz)
        left = shown - low_pass(self.time, self.error, last.frequency_hz)
        return float(np.sqrt((left**2).sum() / max((shown**2).sum(), 1e-300)))

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
            Row("part of it above the learned frequencies", self.above, "relative", "above"),
            Row("scatter of the rms error", last.scatter or None, u, f"scatter_{u}"),
            Row("clock of the record where the path begins", self.clock_s, "s", "clock_s"),
            Row(
                "frame of the tracker in the base, x y z [m], rotation vector [rad]",
                " ".join(f"{x:.6g}" for x in self.frame),
            ),
            Data("frame", list(self.frame)),
            Row(
                f"error of springs {SHOWN_SOFTER:.0%} softer, largest",
                self.soft_m,
                "m",
                "soft_m",
                note="from the model",
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


@checked_types
@reported("learn")
@needs("learn")
def next_run(
    model: str | FilePath | RobotModel | Equations,
    folder: str | FilePath,
    measured: str | FilePath,
    move: str | Move | None = None,
    *,
    options: LearningOptions | None = None,
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
        Record of the last run: positions of the tool from a tracker, or angles of all motors.
        Names of columns: `flexgen.planning.learning.measured_run`.
    move : str or Move, optional
        Default: the move of the trajectory.
    options : LearningOptions, optional
        Frequency and gain of learning, feedback of the robot, clock and frame of the tracker.
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
    >>> import numpy as np
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> trajectory = flexgen.solve("elbow", "line").trajectory
    >>> _ = trajectory.save(folder / "trajectory.csv")
    >>> time = np.arange(-0.2, 1.5, 0.002)
    >>> y = flexgen.plan("elbow", "line").sample(time).y[:, :, 0] + [[3e-4, -1e-4]]
    >>> table = np.column_stack([time, 1e3 * y])
    >>> names = "time_s,x_mm,z_mm"
    >>> np.savetxt(folder / "run.csv", table, delimiter=",", header=names, comments="")
    >>> options = flexgen.LearningOptions(clock=0.0, frame=[0.0] * 6)
    >>> run = flexgen.next_run("elbow", folder, folder / "run.csv", options=options)
    >>> f"{1e6 * run.last.rms:.0f} um", run.iteration
    ('316 um', 1)
    """
    tell = progress if callable(progress) else (lambda line: None)
    robot = robot_of(model)
    chosen, frame_notes = _with_frame(options or LearningOptions(), robot)
    place = read_folder(folder)
    record = read_run(measured, robot)
    _check_new(record, place)
    motion = _own_move(robot, place, move)
    elastic = derive(without_states(robot))
    last = place.trajectory
    path = Path(elastic, motion)
    force = make_force(last, robot, path.duration) if CHANNEL in last else None
    tell("inverse dynamics of the path")
    corrected = CorrectedPath(elastic, path.move, robot, force, tell, EARLY_S)
    given = corrections_of(last, corrected)
    _check_trajectory(place, corrected, given[0])
    is_first = not any(run.measured == "tool" for run in place.runs)
    seen = see_error(record, robot, corrected, last, chosen, is_first=is_first)
    low = _frequency(chosen, place.runs, corrected, last, 1.0 / record.step)
    run = _judge_run(seen, record, place, low, float(chosen.gain))
    runs = (*place.runs, run)
    same = [r for r in runs if r.measured == run.measured]
    notes = [*record.notes, *frame_notes, *seen.notes]
    if run.state in (ENDED, GREW):
        iteration = best_of(same)
        file_of = place.command(iteration)
        trajectory = Trajectory.load(file_of) if file_of.is_file() else last
        file = write_folder(place, runs, None, iteration)
    else:
        iteration = place.next_iteration
        tell(f"inverse dynamics of iteration {iteration}")
        trajectory, used = _correct(seen, given, corrected, last, iteration, low, chosen)
        if used < low:
            notes.append(
                f"learned up to {used:.3g} Hz: with {low:.3g} Hz the corrected path has no inverse"
            )
            run = _judge_run(seen, record, place, used, float(chosen.gain))
            runs = (*place.runs, run)
        notes += note_changed_model(corrected, given, last)
        file = write_folder(place, runs, trajectory, iteration)
    notes += start_notes(trajectory, last)
    notes += limit_warnings(robot, trajectory)
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


def _correct(
    seen: SeenError,
    given: tuple[np.ndarray, np.ndarray],
    corrected: CorrectedPath,
    last: Trajectory,
    iteration: int,
    low: float,
    options: LearningOptions,
) -> tuple[Trajectory, float]:
    """The trajectory of the next run, and the frequency up to which it learns [Hz]: the given one,
    or where it was not asked for one at which the corrected path has an inverse.
    """
    tries = (low,) if options.frequency_hz is not None else low * LOWER ** np.arange(TRIES)
    for frequency in tries:
        of_path, of_motors = (x.copy() for x in given)
        learned = options.gain * learned_part(seen.time, seen.error, corrected.time, frequency)
        if seen.rows is None:
            of_motors -= learned
        else:
            of_path[:, seen.rows] -= learned
        try:
            found = make_trajectory((of_path, of_motors), corrected, last, iteration)
        except SolverError:
            if frequency == tries[-1]:
                raise
        else:
            break
    return found, float(frequency)


def _with_frame(options: LearningOptions, robot: RobotModel) -> tuple[LearningOptions, list[str]]:
    """Options with the frame that static poses show, where they are given, and a note on it."""
    if options.poses is None:
        return options, []
    frame, rms, count = frame_of_poses(options.poses, robot)
    note = (
        f"frame of the tracker from {count} points of {FilePath(options.poses).name}, which fit "
        f"the model to {format_size(rms, 'm')} rms"
    )
    return replace(options, frame=tuple(map(float, frame)), poses=None), [note]


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
            f"{place.path}: given a trajectory whose tool is up to {away:.3g} m away from the "
            f"path of move {corrected.path.move.name}, expected the inverse dynamics of this move "
            "with this model: write it anew with flexgen solve"
        )


def _frequency(
    options: LearningOptions,
    runs: Sequence[LearningRun],
    corrected: CorrectedPath,
    last: Trajectory,
    rate: float,
) -> float:
    """Frequency of the low pass [Hz]; ArgumentError where the record has too few samples."""
    found = options.frequency_hz
    most = MOST * rate
    if found is None and runs:
        found = runs[-1].frequency_hz * (HALF if runs[-1].state == GREW else 1.0)
    if found is None:
        parts = np.array(BAND_AT) * corrected.path.duration
        at = np.searchsorted(last.time, parts).clip(0, len(last.time) - 1)
        motion = [last[name][at] for name in MOTION]
        feedback = options.controller, options.sample_time, options.delay
        found = min(learning_band(corrected.equations, motion, *feedback), most)
    if not (is_number(found) and 0.0 < found <= most):
        raise ArgumentError(
            f"frequency_hz: given {found!r}, expected more than 0, at most {most:.4g} Hz, "
            f"{MOST:g} of the rate of the record"
        )
    return float(found)


def _judge_run(
    seen: SeenError, record: MeasuredRun, place: LearningFolder, low: float, gain: float
) -> LearningRun:
    """The run of a record, with what its error did."""
    shown = low_pass(seen.time, seen.error, WIDE * low)
    noise = seen.error - shown
    sizes = np.linalg.norm(shown, axis=1) if seen.rows is not None else np.abs(shown).max(axis=1)
    rms = float(np.sqrt((sizes**2).mean()))
    largest = float(sizes.max())
    measured = "motors" if seen.rows is None else "tool"
    before = [run for run in place.runs if run.measured == measured]
    part = min(2.0 * WIDE * low * record.step, 1.0)
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
