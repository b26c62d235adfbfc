"""Tuning of the P-PI cascade of a robot on a set of robots, with required stability margins.

The numbers of the cascade are changed in logarithms by the simplex method of Nelder and Mead:
first a common factor for all position, speed and integral gains, then every number. The value is
the root mean square over the robots of their largest dynamic errors. A controller without the
margins, at any pose of any robot, is refused before it is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.optimize import minimize

from flexgen.base.calls.deadline import OutOfTime, check_time, running
from flexgen.base.calls.progress import Choice, Progress, reported
from flexgen.base.checks.bounds import Bound, NotNegative, Positive, Seed, TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Shown, Table
from flexgen.base.spec.arguments import check_not_negative
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.feedback.loop.case import SAMPLE_S, Case, control_case
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.margins import LoopAtPose, Margins, as_linear
from flexgen.feedback.loop.result import ControlRun
from flexgen.model.elements import Move, RobotModel
from flexgen.simulation.environment.disturbances import Disturbance
from flexgen.studies.scenarios.tune import Evaluations, cascade_table, numbers_of, with_numbers

GainMargin = Annotated[float, Bound(0.0, 40.0, words="0 to 40")]
PhaseMargin = Annotated[float, Bound(0.0, 170.0, words="0 to 170")]

PLANTS = {"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.2}}
"""The robots next to the model where none are given: stiffness known within 20 %."""

GAIN_MARGIN_DB = 6.0
"""Required gain margin [dB] of every robot: twice the gain."""

PHASE_MARGIN_DEG = 30.0
"""Required lag [deg] of all motors together: the usual lower bound."""

REFUSED = 100.0
"""Value of a controller without the margins, in multiples of that of the start."""

FIRST = 0.3
"""Size of the first simplex in the logarithms of the gains: 35 %."""

COMMON = 0.4
"""Part of the evaluations for the three common factors."""

TUNED = "tuned"
OVER = "time limit"
INTERRUPTED = "interrupted"


MARGINS = (
    Column("smallest margins of all robots and poses"),
    Column("stable"),
    Column("gain margin"),
    Column("dB"),
    Column("at Hz"),
    Column("phase margin, deg"),
    Column("at Hz"),
    Column("delay margin, ms"),
)


def _gain_columns() -> tuple[Column, ...]:
    """Columns of the gains of the motors, before and after."""
    titles = {
        "position_gain": "position gain, 1/s",
        "speed_gain": "speed gain, N m s/rad",
        "speed_hz": "speed, Hz",
        "integral_gain": "integral gain, 1/s",
    }
    found = [Column("motor", key="motor")]
    for key, title in titles.items():
        found += [Column(title, key=f"{key}_before"), Column("after", key=f"{key}_after")]
    return tuple(found)


def _error_columns(unit: str) -> tuple[Column, ...]:
    """Columns of the errors of the robots [unit], before and after."""
    return (
        Column("robot", key="robot"),
        Column("", key="unit", is_data=True),
        Column("dynamic error", unit, "dynamic_error_max_before"),
        Column("after", unit, "dynamic_error_max_after"),
        Column("error", unit, "error_max_before"),
        Column("after", unit, "error_max_after"),
    )


def _table_of(
    rows: list[dict[str, Any]], columns: tuple[Column, ...], heading: str, key: str
) -> Table:
    """A table of rows by key; what is not known failed."""
    cells = tuple(
        tuple(
            Shown(None, "failed") if row[column.key] is None else row[column.key]
            for column in columns
        )
        for row in rows
    )
    return Table(columns, cells, heading, key)


@checked_result
@dataclass(frozen=True, repr=False)
class CascadeTuning(Result):
    """A tuned cascade: ``controller`` and its ``run``; before: ``start``, ``start_run``.

    ``margins``, ``start_margins``: the smallest over all robots and poses; ``required``:
    ``gain_db``, ``phase_deg``. ``inertias`` (n_m,) [kg m^2]: of the motors with stiff springs;
    ``status``: ``tuned``, ``time limit`` or ``interrupted``; ``history``: best value so far, 1 for
    the start; ``evaluations``.

    Examples
    --------
    >>> tuned = flexgen.tune_cascade("elbow", evaluations=6)
    >>> tuned.history[-1] <= 1.0, tuned.margins.gain_db > 5.9
    (True, True)
    """

    controller: Cascade
    start: Cascade
    run: ControlRun
    start_run: ControlRun
    margins: Margins
    start_margins: Margins
    required: dict[str, float]
    inertias: np.ndarray
    status: str
    history: tuple[float, ...]
    evaluations: int

    def __repr__(self) -> str:
        return (
            f"<CascadeTuning {self.run.model.name}: {self.status}, {self.evaluations} evaluations>"
        )

    @property
    def robust(self) -> bool:
        """Whether the tuned controller has the required margins."""
        return _has_margins(self.margins, self.required)

    def gains(self) -> list[dict[str, Any]]:
        """For each motor: gains and their frequencies [Hz], before and after."""
        rows = []
        for k, motor in enumerate(self.run.model.motors):
            row: dict[str, Any] = {"motor": motor.name}
            for when, cascade in (("before", self.start), ("after", self.controller)):
                speed = float(cascade.speed_gain[k])
                row[f"position_gain_{when}"] = float(cascade.position_gain[k])
                row[f"speed_gain_{when}"] = speed
                row[f"integral_gain_{when}"] = float(cascade.integral_gain[k])
                row[f"speed_hz_{when}"] = speed / (2.0 * math.pi * float(self.inertias[k]))
            rows.append(row)
        return rows

    def errors(self) -> list[dict[str, Any]]:
        """For each robot: largest dynamic and whole errors, before and after."""
        rows = []
        unit = self.run.unit
        for before, after in zip(self.start_run.runs, self.run.runs, strict=True):
            row: dict[str, Any] = {"robot": after.name, "unit": unit}
            for when, run, robot in (
                ("before", self.start_run, before),
                ("after", self.run, after),
            ):
                figures = run.figures(robot)
                for name in ("dynamic_error_max", "error_max"):
                    value = figures[f"{name}_{unit}"]
                    row[f"{name}_{when}"] = value if np.isfinite(value) else None
            rows.append(row)
        return rows

    def content(self) -> tuple[Part, ...]:
        """Gains, errors and margins, before and after."""
        saved = 100.0 * (1.0 - self.history[-1]) if self.history else 0.0
        move = self.run.solution.move.name
        required = self.required
        return (
            Prose(
                f"{self.run.model.name}, move {move}: {self.status}, {self.evaluations} "
                f"controllers, root mean square of the dynamic errors {saved:.4g} % smaller",
                is_title=True,
            ),
            Data("model", self.run.model.name),
            Data("move", move),
            Data("status", self.status),
            Data("evaluations", self.evaluations),
            _table_of(self.gains(), _gain_columns(), "Gains", "gains"),
            _table_of(self.errors(), _error_columns(self.run.unit), "Errors", "errors"),
            self._margins(),
            Prose(
                f"required: {required['gain_db']:.4g} dB, {required['phase_deg']:.4g} deg",
                "required",
            ),
            Data("margins_before", self.start_margins.to_dict()),
            Data("margins_after", self.margins.to_dict()),
            Data("required", required),
            Data("robust", self.robust),
            Data("history", list(self.history)),
        )

    def _margins(self) -> Table:
        """The smallest margins before and after; a dash for one that was not found."""
        cells = []
        for when, found in (("before", self.start_margins), ("after", self.margins)):
            data = found.to_dict()
            delay = data["delay_s"]
            row = ("gain", "gain_db", "gain_hz", "phase_deg", "phase_hz")
            late = None if delay is None else 1e3 * delay
            cells.append((when, found.stable, *(data[key] for key in row), late))
        return Table(MARGINS, tuple(cells), "Margins")

    def save(self, path: str | Path) -> Path:
        """Write the controller as a table in TOML, which `flexgen.control` takes."""
        target = Path(path)
        about = f"tuned for {self.run.model.name}, move {self.run.solution.move.name}"
        write_text(target, cascade_table(self.controller, about))
        return target


@checked_types(own=("plants",))
@reported("tune")
def tune_cascade(
    model: str | Path | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    controller: Any = "ppi",
    plants: Mapping[str, Mapping[str, float]] | None = None,
    disturbances: Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]] = (),
    sample_time: Positive = SAMPLE_S,
    delay: NotNegative = 0.0,
    encoder_noise: NotNegative = 0.0,
    gain_margin_db: GainMargin = GAIN_MARGIN_DB,
    phase_margin_deg: PhaseMargin = PHASE_MARGIN_DEG,
    evaluations: Evaluations = 120,
    time_limit: TimeLimit | None = None,
    seed: Seed = 0,
    progress: Choice = None,
) -> CascadeTuning:
    """Tune the P-PI cascade of a robot for a move, on the model and robots that differ from it.

    The feedforward is that of `flexgen.control`. All robots keep the margins at the begin, middle
    and end of the move.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    controller : str or object
        The start: a cascade as for `flexgen.control`.
    plants : mapping, optional
        Another robot, as for 'flexgen control'; default: those of [uncertainty], or stiffness=0.8
        and 1.2. Here without ``[uncertainty]``.
    disturbances : sequence of Disturbance, or mapping from plants' names to them
        As for 'flexgen control'.
    sample_time : float [s]
        Of the controller.
    delay : float [s]
        From a measurement to its torque.
    encoder_noise : float [rad]
        Of the motor angles.
    gain_margin_db : float [dB]
        Required of all robots.
    phase_margin_deg : float [deg]
        Required of all robots.
    evaluations : int
        Largest number of controllers that are tried.
    time_limit : float, optional [s]
        Then the best controller so far is returned; default: none.
    seed : int
        Of the noise.
    progress : callable or bool, optional

    Returns
    -------
    CascadeTuning
        ``robust`` states whether its controller has the margins.

    Raises
    ------
    ArgumentError
        The controller is not a cascade, or a number is out of range.
    SolverError
        The move has no solution.

    Examples
    --------
    >>> tuned = flexgen.tune_cascade("elbow", evaluations=6)
    >>> flexgen.control("elbow", controller=tuned.controller).status
    'done'
    """
    tell = progress if callable(progress) else None
    required = {"gain_db": float(gain_margin_db), "phase_deg": float(phase_margin_deg)}
    if time_limit is not None:
        check_not_negative("time_limit", time_limit)
    case = control_case(
        model,
        move,
        sample_time=sample_time,
        delay=delay,
        plants=PLANTS if plants is None else plants,
        disturbances=disturbances,
        encoder_noise=encoder_noise,
        seed=seed,
        progress=tell,
    )
    start, _ = case_controller(case, controller)
    if not isinstance(start, Cascade) or not len(numbers_of(start)):
        raise ArgumentError(
            f"controller: given {type(start).__name__}, expected a P-PI cascade with gains to tune"
        )
    search = _Search(case, start, required, evaluations, tell)
    status = search.run(time_limit or None)
    return search.result(status)


def _has_margins(margins: Margins, required: Mapping[str, float]) -> bool:
    """Whether the margins are large enough, up to the bisection by which they are found."""
    return (
        margins.stable
        and margins.gain_db >= required["gain_db"] - 1e-3
        and margins.phase_deg >= required["phase_deg"] - 1e-3
    )


@dataclass
class _Search:
    """The search on one case."""

    case: Case
    start: Cascade
    required: dict[str, float]
    evaluations: int
    tell: Progress | None
    best: Cascade = field(init=False)
    least: float = field(init=False, default=math.inf)
    unit: float = field(init=False, default=1.0)
    history: list[float] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.best = self.start
        self.start_run = run_case(self.case, self.start, "start")
        self.poses = self._poses()
        spread = self._spread(self.start_run)
        self.unit = spread if math.isfinite(spread) and spread > 0 else 1.0
        self.saturated = max(robot.saturated for robot in self.start_run.runs)

    def _poses(self) -> list[list[Any]]:
        """The linear models of each robot at its poses."""
        run = self.start_run
        found = []
        for robot in run.runs:
            found.append([loop.model for loop in run.loops(robot.name).values()])
        return found

    def _loops(self, cascade: Cascade) -> list[list[LoopAtPose]]:
        """The loops of a controller, for each robot at each pose."""
        hardware = self.case.hardware
        late = self.start_run.loops()["begin"].late
        sample_s = hardware.sample_s
        linear = as_linear(cascade, sample_s, len(self.poses[0][0].C))
        assert linear is not None
        delay = self.start_run.delay_s
        return [
            [LoopAtPose(pose, linear, sample_s, delay, late) for pose in poses]
            for poses in self.poses
        ]

    def run(self, time_limit: float | None) -> str:
        """Search; the status."""
        try:
            with running(time_limit):
                self._value(self.start)
                self._common()
                self._single()
        except OutOfTime:
            return OVER
        except KeyboardInterrupt:
            return INTERRUPTED
        return TUNED

    def _common(self) -> None:
        """A factor for all position, speed and integral gains."""
        base = self.start

        def change(x: np.ndarray) -> Cascade:
            a, b, c = np.exp(np.clip(x, -10.0, 10.0))
            gains = base.position_gain * a, base.speed_gain * b, base.integral_gain * c
            return Cascade(*gains, base.filters, base.torque_max)

        self._minimize(change, np.zeros(3), int(COMMON * self.evaluations))

    def _single(self) -> None:
        """Every number of the cascade, from the best one."""
        base = self.best
        left = self.evaluations - len(self.history)
        self._minimize(lambda x: with_numbers(base, x), numbers_of(base), left)

    def _minimize(
        self, change: Callable[[np.ndarray], Cascade], begin: np.ndarray, most: int
    ) -> None:
        """A simplex with at most ``most`` evaluations of ``change(x)``, from ``begin`` on; `best`
        keeps what it finds.
        """
        if most < 1:
            return
        simplex = np.vstack([begin, begin + FIRST * np.eye(len(begin))])
        options = {"maxfev": most, "initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-3}
        minimize(
            lambda x: self._value(change(x)),
            begin,
            method="Nelder-Mead",
            options={**options, "adaptive": True},
        )

    def _value(self, cascade: Cascade) -> float:
        """Value of a controller in multiples of that of the start, `REFUSED` or more without the
        margins; the best one and the history are kept.
        """
        check_time("tune")
        missing = self._missing(cascade)
        value = REFUSED * (1.0 + missing)
        if missing == 0.0:
            value = self._simulate(cascade)
        if value < self.least:
            self.best = cascade
            self.least = value
        self.history.append(self.least)
        if self.tell is not None:
            shown = "none with the margins yet" if self.least >= REFUSED else f"{self.least:.3f}"
            self.tell(f"{len(self.history)} of {self.evaluations} controllers, best {shown}")
        return value

    def _missing(self, cascade: Cascade) -> float:
        """Excess of the largest eigenvalue of the worst loop over 1, as it is and with the
        required gain margin; 0: it has the margins.

        Where only the required phase [deg] is missing, the excess is 1e-6.
        """
        factor = 10.0 ** (self.required["gain_db"] / 20.0)
        lag = self.required["phase_deg"]
        worst = 0.0
        for loops in self._loops(cascade):
            for loop in loops:
                sizes = loop.largest_eigenvalue(), loop.largest_eigenvalue(factor)
                worst = max(worst, *(size - 1.0 for size in sizes))
                if worst <= 0.0 and lag and not loop.lag_is_stable(lag):
                    worst = max(worst, 1e-6)
        return max(worst, 0.0)

    def _simulate(self, cascade: Cascade) -> float:
        """Value of a controller from a simulation, in multiples of the start's; `REFUSED` where it
        fails, or a motor is at its limit longer than at the start.
        """
        try:
            run = run_case(self.case, cascade, "trial")
        except OutOfTime:
            raise
        except FlexgenError:
            return REFUSED
        if any(robot.saturated > self.saturated for robot in run.runs):
            return REFUSED
        spread = self._spread(run)
        return spread / self.unit if math.isfinite(spread) else REFUSED

    def _spread(self, run: ControlRun) -> float:
        """Root mean square of the largest dynamic errors of the robots."""
        key = f"dynamic_error_max_{run.unit}"
        errors = [float(run.figures(robot)[key]) for robot in run.runs]
        return float(np.sqrt(np.mean(np.square(errors))))

    def _margins(self, cascade: Cascade) -> Margins:
        """The smallest margins over all robots and poses, each with its frequency."""
        found = [loop.margins() for loops in self._loops(cascade) for loop in loops]
        gain = min(found, key=lambda m: m.gain)
        phase = min(found, key=lambda m: m.phase_deg)
        return Margins(
            all(m.stable for m in found),
            max(m.largest_eigenvalue for m in found),
            gain.gain,
            min(m.delay_s for m in found),
            gain.gain_hz,
            phase.phase_deg,
            phase.phase_hz,
        )

    def result(self, status: str) -> CascadeTuning:
        """The best controller, and what it changes."""
        if self.tell is not None:
            self.tell("stability margins of all robots, before and after")
        points = self.case.reference.points(np.array([0]))
        stiff, _ = motor_inertias(self.case.model, points)
        run = run_case(self.case, self.best, "tuned")
        return CascadeTuning(
            self.best,
            self.start,
            run,
            self.start_run,
            self._margins(self.best),
            self._margins(self.start),
            self.required,
            stiff,
            status,
            tuple(self.history),
            len(self.history),
        )
