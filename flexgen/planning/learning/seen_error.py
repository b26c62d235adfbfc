"""The measured error of a run: of the tool by a tracker, or of the motors.

Where the record has a tracker, its motor angles are not learned from. Where the clock that is
stated is that of the drives, they tell where the model expects the tool, `planned_motion.py`, and
with that the clock of the tracker; without it a lag of the motors looks like a later clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from flexgen.base.display import format_size
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.model.elements import RobotModel
from flexgen.paths.path import Path
from flexgen.planning.learning.alignment import Alignment, align
from flexgen.planning.learning.corrected import CorrectedPath
from flexgen.planning.learning.measured_run import MeasuredRun, SharedAxes, axes_in_output
from flexgen.planning.learning.next_trajectory import MOTOR_CORRECTION
from flexgen.planning.learning.options import LearningOptions
from flexgen.planning.learning.planned_motion import SOFTER, PlannedMotion
from flexgen.planning.learning.window import MOST, low_pass

LARGEST_MOTOR = 0.2  # motor error over the motion of the motor: a record of another move
MOVES = 1e-2  # motion of a motor over the largest one: motors with less are not compared
EARLIEST_S = 0.3  # the path begins at most so long before a record of motors
COARSE_S = 2e-3  # step of the first search for the clock of motors [s]
SHOWN_HZ = 60.0  # of the measured motors: up to which they move the tool
SHOWN_SOFTER = 0.1  # change of all springs of which the hidden error is stated
AROUND_S = 0.3  # of a record before and after the path: compared with the expected errors
REFINED = 3  # times that the clock is fitted with the expected errors


@dataclass(frozen=True, eq=False)
class SeenError:
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


def see_error(
    record: MeasuredRun,
    robot: RobotModel,
    corrected: CorrectedPath,
    last: Trajectory,
    options: LearningOptions,
    *,
    is_first: bool = True,
) -> SeenError:
    """The error of a record: of the tool where a tracker measured it, else of the motors.

    ``is_first``: no error of the tool was learned before. Later the tool is near the path, and a
    clock that is estimated is that with which it is: what the first record told of it stays.
    """
    if not record.axes:
        if options.frame is not None:
            raise ArgumentError(
                "frame: given with a record without a tracker, expected none: angles of motors "
                "have no frame"
            )
        time, error, at = _motor_error(record, corrected, last, options.clock)
        return SeenError(time, error, None, at, (), None, None, _blind_notes(robot))
    rows = axes_in_output(record.axes, robot)
    curve = _positions_of(corrected.path, record.axes, rows)
    by_motors = options.clock_of == "drives"
    motion = PlannedMotion(corrected, last, record.time[-1] - record.time[0], rows)
    reached = curve
    if by_motors and is_first:
        lag_time, lag = _motor_lag(record, corrected, last, options.clock, robot)
        reached = motion.tool_path(lag_time, lag)
    found = align(
        record.source,
        record.time,
        record.position,
        reached,
        corrected.path.duration,
        clock_s=None if by_motors else options.clock,
        frame=options.pose,
    )
    grid, expected, springs = motion.list_errors(by_motors)
    used = (grid >= -AROUND_S) & (grid <= corrected.path.duration + AROUND_S)
    grid = grid[used]
    expected = expected[:, used]
    for _ in range(REFINED):
        time = record.time - found.clock_s
        error = found.positions(record.position) - reached(time)
        inside = (time >= grid[0]) & (time <= grid[-1])
        shapes = np.array([_resample(x, grid, time[inside]) for x in expected])
        found = found.refine(error[inside], time[inside], reached, shapes)
    time = record.time - found.clock_s
    error = (found.positions(record.position) - curve(time))[:, rows.tracker]
    along = (grid >= 0.0) & (grid <= corrected.path.duration)
    soft, hidden = _hidden(found, grid[along], curve, expected[:springs, along])
    return SeenError(
        time,
        error,
        rows.output,
        found.clock_s,
        tuple(map(float, found.frame)),
        hidden,
        soft,
        tuple(_estimate_notes(found, _speed(curve, corrected.path.duration))),
    )


def _speed(curve: Callable[[np.ndarray], np.ndarray], duration: float) -> float:
    """Largest speed along the path [m/s]."""
    time = np.linspace(0.0, duration, 400)
    steps = np.diff(curve(time), axis=0)
    return float(np.linalg.norm(steps, axis=1).max() / (time[1] - time[0]))


def _estimate_notes(found: Alignment, speed: float) -> list[str]:
    """Notes on errors that cannot be seen, since clock or frame were estimated from the record;
    ``speed``: largest one along the path [m/s].
    """
    parts = ["a constant offset of the tool and a tilt of the whole path"] * found.frame_fitted
    delay = f"a constant delay along the path, {format_size(1e-4 * speed, 'm')} for each 0.1 ms"
    if found.clock_sd_s is not None:
        delay += f", with a standard deviation of {format_size(found.clock_sd_s, 's')}"
    parts += [delay] * found.clock_fitted
    if not parts:
        return []
    fitted = (("frame", found.frame_fitted), ("clock", found.clock_fitted))
    stated = [name for name, is_fitted in fitted if is_fitted]
    return [
        f"estimated from this record: {' and '.join(stated)} of the tracker; not seen, and not "
        f"learned: {' and '.join(parts)}; {' and '.join(f'--{name}' for name in stated)} with the "
        "true numbers show them"
    ]


def _blind_notes(robot: RobotModel) -> tuple[str, ...]:
    """Errors that angles of motors do not show, as a note."""
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
    wanted = last["q_m"] - last.channels.get(MOTOR_CORRECTION, 0.0)
    curve = make_interp_spline(last.time, wanted, k=5)

    def reference(t: np.ndarray) -> np.ndarray:
        return np.asarray(curve(np.clip(t, last.time[0], last.time[-1])))

    near = np.linspace(0.0, corrected.path.duration, 400)
    _check_motors(record, reference(near), last)
    scale = np.maximum(np.ptp(reference(near), axis=0), 1e-9)
    found = _align_motors(record, lambda t: reference(t) / scale, scale, corrected, clock)
    time = record.time - found
    error = record.motors - reference(time)
    inside = (time >= 0.0) & (time <= corrected.path.duration)
    worst = np.abs(error[inside]).max(axis=0) / scale
    # A motor that hardly moves is compared with the others on its own side.
    moving = scale > MOVES * scale.max()
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
        if size[j] > MOVES * size.max() and abs(moved[j] / size[j] - 1.0) > LARGEST_MOTOR:
            raise ArgumentError(
                f"{record.source}: motor {name}: given a motion of {moved[j]:.4g} rad, "
                f"{moved[j] / size[j]:.4g} times that of the trajectory, expected the same: a "
                "wrong unit in the name of the column, another side of the gear, or another move"
            )


def _align_motors(
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
    q = record.motors / scale
    duration = corrected.path.duration

    def squares(at: float) -> float:
        return float(((q - reference(record.time - at)) ** 2).mean())

    first = record.time[0] - EARLIEST_S
    last = record.time[-1] - duration + EARLIEST_S
    steps = np.arange(first, max(last, first + 1e-6), max(COARSE_S, record.step))
    guess = float(steps[int(np.argmin([squares(float(s)) for s in steps]))])
    width = 2.0 * max(COARSE_S, record.step)
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


def _motor_lag(
    record: MeasuredRun,
    corrected: CorrectedPath,
    last: Trajectory,
    clock: float | None,
    robot: RobotModel,
) -> tuple[np.ndarray, np.ndarray]:
    """Instants (n,) [s] on the path, and motor angles minus wanted ones (n, n_m) [rad]."""
    if record.motors is None:
        raise ArgumentError(
            f"clock_of: given 'drives' with {record.source}, which has no motor angles, expected "
            f"them in columns such as 'q_m[{robot.motors[0].name}] rad'; a tracker alone has the "
            "clock of the record: clock_of 'record'"
        )
    time, error, _ = _motor_error(record, corrected, last, clock)
    return time, low_pass(time, error, min(SHOWN_HZ, MOST / record.step))


def _resample(x: np.ndarray, at: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Samples (k, d) at other instants (n,), linear between them."""
    return np.stack([np.interp(time, at, column) for column in x.T], axis=1)


def _hidden(
    found: Alignment,
    at: np.ndarray,
    curve: Callable[[np.ndarray], np.ndarray],
    softer: np.ndarray,
) -> tuple[float, float]:
    """Largest error of the tool with all springs softer [m], and how much of it the estimates of
    clock and frame hide.
    """
    error = SHOWN_SOFTER / SOFTER * softer.sum(axis=0)
    hidden = found.hidden(error, at, curve)
    sizes = [float(np.linalg.norm(x, axis=1).max()) for x in (error, hidden)]
    return sizes[0], sizes[1]
