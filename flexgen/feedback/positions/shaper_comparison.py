"""Vibration that remains after a move of a robot whose motors follow positions: without and with
input shapers, whose frequency may be off.

The positions are those of the move without deflections. Each shaper delays their end; from then on
the free coordinates - gears, bearings, links, a payload - are simulated for some periods, and
their largest distance from rest is compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Positive
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.joint_motion import JointMotion
from flexgen.base.results import Result
from flexgen.base.rows import Column, Part, Prose, Row, Shown, Table
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.feedback.positions.shapers import NAMES, Damping, Shaper
from flexgen.inversion.solve import solve
from flexgen.model.abilities import needs
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.path import Path as PathOfMove
from flexgen.simulation.driven_joints import DrivenRobot, drive_motors

STEP_S = 1e-3  # of the simulation, at most, and
SAMPLES = 40.0  # in a period of the mode, at least
BEFORE_S = 0.05  # at rest before the motion
PERIODS = 6.0  # of the mode, after the commands, in which the vibration is looked for
DEGREE = 7  # of the spline of the positions
DETUNING = (0.9, 1.0, 1.1)  # frequency of the shaper over that of the mode
OVERDAMPED = 1e-9  # of a rate: a smaller imaginary part is none of a vibration


@dataclass(frozen=True)
class ShapedRun:
    """A move with a shaper: ``shaper`` by its name, ``detuning``: its frequency over that of the
    mode; ``duration_s`` [s] of the commands, ``vibration`` [rad or m]: largest distance from rest
    after them of the coordinate of the comparison.
    """

    shaper: str
    detuning: float
    duration_s: float
    vibration: float


@checked_result
@dataclass(frozen=True, repr=False)
class ShaperComparison(Result):
    """Result of `flexgen.compare_shapers`.

    Attributes
    ----------
    model : RobotModel
    move : Move
    coordinate : str
        The one whose vibration is compared.
    unit : str
        Its unit, rad or m.
    frequency_hz : float [Hz]
        Natural frequency of the mode of the shapers, motors locked at the end of the move.
    damping : float
        Damping ratio of the mode.
    runs : tuple of ShapedRun

    Examples
    --------
    >>> found = flexgen.compare_shapers("planar5_nmp", detuning=[1.0])
    >>> plain, zv, zvd = (run.vibration for run in found.runs)
    >>> zv < 0.2 * plain, zvd < zv
    (True, True)
    """

    model: RobotModel
    move: Move
    coordinate: str
    unit: str
    frequency_hz: float
    damping: float
    runs: tuple[ShapedRun, ...]

    def __repr__(self) -> str:
        return (
            f"<ShaperComparison {self.model.title}, move {self.move.name}: {len(self.runs)} runs>"
        )

    def content(self) -> tuple[Part, ...]:
        """Mode of the shapers, then duration and vibration of each."""
        columns = (
            Column("shaper", key="shaper"),
            Column("its frequency over that of the mode", key="detuning"),
            Column("duration", "s", "duration_s"),
            Column("vibration", self.unit, f"vibration_{self.unit}"),
        )
        cells = tuple(
            (
                run.shaper,
                Shown(run.detuning, "" if run.shaper == NAMES[0] else f"{run.detuning:g}"),
                run.duration_s,
                run.vibration,
            )
            for run in self.runs
        )
        title = f"{self.model.title}, move {self.move.name}: vibration of {self.coordinate}"
        return (
            Prose(title, "", True),
            Row("coordinate", self.coordinate, "", "coordinate"),
            Row("natural frequency, motors locked", self.frequency_hz, "Hz", "frequency_hz"),
            Row("damping ratio", self.damping, "", "damping"),
            Table(columns, cells, "Shapers", "runs"),
        )


@checked_types
@reported("compare_shapers")
@needs("compare_shapers")
def compare_shapers(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    coordinate: str | None = None,
    detuning: Sequence[float] = DETUNING,
    frequency_hz: Positive | None = None,
    damping: Damping | None = None,
    progress: Choice = None,
) -> ShaperComparison:
    """Vibration after a move with input shapers and without, of a robot that follows positions.

    Baselines for `flexgen.command_positions` and `flexgen.fastest`: a shaper needs one frequency
    and one damping ratio, and no other number of the robot, but makes each move longer.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
        Its motors follow the positions exactly.
    move : str or Move, optional
        A move of the model file; default: the first.
    coordinate : str, optional
        Whose vibration is compared; default: of the free coordinates, those without motor and
        those behind elastic gears, the one that vibrates most without a shaper.
    detuning : sequence of float
        Frequencies of the shapers over that of the mode: what a wrong frequency costs.
    frequency_hz : float, optional [Hz]
        Natural frequency of the shapers; default: the lowest one with motors locked at the end
        of the move.
    damping : float, optional
        Damping ratio of the shapers; default: that of this mode.
    progress : callable or bool, optional

    Returns
    -------
    ShaperComparison

    Raises
    ------
    ArgumentError
        The robot has no elastic coordinates, or none of this name; an argument is out of range.
    SolverError
        The move has no joints without deflections.

    Examples
    --------
    >>> found = flexgen.compare_shapers("planar5_nmp", coordinate="q2", detuning=[1.0])
    >>> [run.shaper for run in sorted(found.runs, key=lambda run: run.vibration)]
    ['zvd', 'zv', 'none']
    """
    factors = [float(x) for x in detuning]
    if not factors or not all(0.1 <= x <= 10.0 for x in factors):
        raise ArgumentError(f"detuning: given {list(detuning)}, expected numbers from 0.1 to 10")
    tell = progress if callable(progress) else None
    equations = model if isinstance(model, Equations) else derive(model)
    robot = DrivenRobot(equations, through_gears=True)
    names = [equations.model.coordinates[i].name for i in robot.free]
    if not names:
        raise ArgumentError(
            f"compare_shapers: given {equations.model.title}, which has no elastic coordinates, "
            "expected an elastic gear, bearing, link or payload"
        )
    if coordinate is not None and coordinate not in names:
        raise ArgumentError(
            f"coordinate: given {coordinate!r}, expected one of {', '.join(names)}, which are "
            "free while the motors follow positions"
        )
    planned = solve(equations.model, move, "rigid", verify=False, progress=tell)
    duration = PathOfMove(equations, planned.move).duration
    trajectory = planned.trajectory
    inner = (trajectory.time > 0.0) & (trajectory.time < duration)
    time = np.concatenate([[0.0], trajectory.time[inner], [duration]])
    joints = trajectory.at(time)["q_a"][:, list(equations.model.i_g)]
    own_hz, own_damping = _slowest(robot, joints[-1])
    mode = frequency_hz or own_hz, own_damping if damping is None else damping
    cases = [(NAMES[0], 1.0), *((name, x) for name in NAMES[1:] for x in factors)]
    found = []
    for name, factor in cases:
        shaper = Shaper.of_mode(name, mode[0] * factor, mode[1])
        motion = _shape_path(shaper, time, joints, own_hz)
        end = duration + shaper.delay_s
        found.append((name, factor, end, _vibration(robot, motion, end)))
    sizes = found[0][3]
    chosen = int(np.argmax(sizes)) if coordinate is None else names.index(coordinate)
    runs = tuple(
        ShapedRun(name, factor, end, float(sizes[chosen])) for name, factor, end, sizes in found
    )
    return ShaperComparison(
        model=equations.model,
        move=planned.move,
        coordinate=names[chosen],
        unit=equations.model.coordinates[robot.free[chosen]].unit,
        frequency_hz=mode[0],
        damping=mode[1],
        runs=runs,
    )


def _slowest(robot: DrivenRobot, q_g: np.ndarray) -> tuple[float, float]:
    """Natural frequency [Hz] and damping ratio of the lowest mode with the motors at a pose."""
    rates = robot.rates(q_g)
    swinging = rates[np.abs(rates.imag) > OVERDAMPED * np.abs(rates)]
    if not len(swinging):
        raise ArgumentError(
            f"compare_shapers: given {robot.model.title}, whose modes are overdamped, expected a "
            "robot that vibrates; look at its damping with 'flexgen analyze'"
        )
    slowest = swinging[0]
    return float(np.abs(slowest)) / (2 * np.pi), float(-slowest.real / np.abs(slowest))


def _shape_path(
    shaper: Shaper, time: np.ndarray, joints: np.ndarray, frequency: float
) -> JointMotion:
    """The shaped positions, from rest before the motion until some periods after it."""
    planned = make_interp_spline(time, joints, DEGREE)
    step = min(STEP_S, 1.0 / (SAMPLES * frequency))
    begin = float(time[0]) - BEFORE_S
    last = float(time[-1]) + shaper.delay_s + (PERIODS + 1.0) / frequency
    fine = begin + step * np.arange(int((last - begin) / step) + 1)
    shaped = np.zeros((len(fine), joints.shape[1]))
    for at, amplitude in zip(shaper.times, shaper.amplitudes, strict=True):
        shaped += amplitude * planned(np.clip(fine - at, time[0], time[-1]))
    spline = make_interp_spline(fine, shaped, DEGREE)
    return JointMotion(spline, begin, float(fine[-1]), step, BEFORE_S / 2)


def _vibration(robot: DrivenRobot, motion: JointMotion, end: float) -> np.ndarray:
    """Largest distance from rest of the free coordinates after the commands (n_free,)."""
    driven = drive_motors(robot.equations, motion)
    rest = robot.rest(motion.at(np.array([motion.end]))[0][0])
    after = driven.time >= end
    return np.asarray(np.abs(driven.q_a[after][:, robot.free] - rest).max(axis=0))
