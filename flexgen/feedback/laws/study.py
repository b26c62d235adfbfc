"""Feedforward or feedback linearization: the same six robots under five kinds of feedback, each
with its best tuning.

Robots: the model; stiffness 20 % lower, 20 % higher; 5 kg more load; lower stiffness and load; the
model with 0.5 N m on every motor from 0.1 s on and 300 N on the tool for 20 ms. Largest distance
of the tool from its path, static errors included. The state is exact, or made of measured motor
and arm angles with noise and their differences; then only tunings count whose torque noise at rest
is below a limit.

Source of the question: S. Moberg and S. Hanssen, On feedback linearization for robust tracking
control of flexible joint robots, IFAC World Congress 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_class, checked_result, checked_types
from flexgen.base.display import plain, short_repr
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Shown, Table
from flexgen.dynamics.mechanics.equations import Equations, robot_of
from flexgen.dynamics.mechanics.output_columns import unit_of
from flexgen.feedback.laws.chain import FORMS
from flexgen.feedback.laws.linearising import FeedbackLinearisation
from flexgen.feedback.laws.state_lq import LQ
from flexgen.feedback.loop.case import Case, control_case
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.interface import Controller
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.abilities import check_ability, obstacle
from flexgen.model.elements import RobotModel
from flexgen.simulation.environment.disturbances import Disturbance

ARM = Path(__file__).with_name("three_axis_arm.toml")
MOTOR_NOISE = 1e-4  # rad; that of the arm angles is in the model file
TORQUE_NOISE = 4.0  # N m, peak to peak
PLANTS = {
    "K -20 %": {"stiffness": 0.8},
    "K +20 %": {"stiffness": 1.2},
    "load +5 kg": {"payload": 5.0},
    "K -20 %, load": {"stiffness": 0.8, "payload": 5.0},
    "disturbed": {},
}
PD = "motor PD"
PID = "motor PID"
FL = "FL"
PREDICTED = "FL, predicted"
STATE_LQ = "LQ"
FAMILIES = (PD, PID, FL, PREDICTED, STATE_LQ)
REST_S = 1.0  # before the motion: torque noise is measured there


@checked_class
@dataclass(frozen=True)
class Setting:
    """Sample time and delay [s], and whether the state is exact or made of noisy angles.

    Examples
    --------
    >>> print(flexgen.Setting(sample_s=1e-3, delay_s=2e-3, exact=False))
    1 ms, 2 samples
    """

    sample_s: float
    delay_s: float
    exact: bool

    def __str__(self) -> str:
        late = (
            f"{self.delay_s / self.sample_s:g} sample{'s' if self.delay_s > self.sample_s else ''}"
        )
        return f"{1e3 * self.sample_s:g} ms, {late if self.delay_s else 'no delay'}"


SETTINGS = (
    Setting(5e-4, 0.0, True), Setting(1e-3, 1e-3, True), Setting(2e-3, 2e-3, True),
    Setting(5e-4, 0.0, False), Setting(1e-3, 1e-3, False),
)  # fmt: skip


@checked_result
@dataclass(frozen=True)
class Trial:
    """One tuning under one setting.

    ``family``: of `FAMILIES`; ``tuning``; ``error_m`` of each robot, NaN where it failed;
    ``dynamic_error_m``: the same without static errors; ``torque_noise_Nm``: largest peak-to-peak
    torque of a motor at rest; ``refused``: reason why there was no run.

    Examples
    --------
    >>> ideal = flexgen.Setting(sample_s=0.5e-3, delay_s=0.0, exact=True)
    >>> study = flexgen.feedback_study("elbow", settings=[ideal], families=["motor PD"], tunings=2)
    >>> [(trial.tuning, f"{1e3 * trial.worst_m:.2f} mm") for trial in study.trials]
    [('3 Hz', '1.02 mm'), ('64 Hz', '0.28 mm')]
    """

    setting: Setting
    family: str
    tuning: str
    error_m: tuple[float, ...]
    dynamic_error_m: tuple[float, ...]
    torque_noise_Nm: float
    refused: str = ""

    __repr__ = short_repr

    @property
    def worst_m(self) -> float:
        """Largest error of all robots [m]; infinite where one failed."""
        return (
            float(max(self.error_m))
            if self.error_m and np.isfinite(self.error_m).all()
            else float("inf")
        )


@checked_result
@dataclass(frozen=True, repr=False)
class FeedbackStudy(Result):
    """Result of `flexgen.feedback_study`.

    Attributes
    ----------
    model : RobotModel
    solution : Solution
        The feedforward.
    plants : tuple of str
        Names of the robots.
    settings : tuple of Setting
    trials : tuple of Trial
    torque_noise_Nm : float
        Limit of the torque noise, where there is any.

    Examples
    --------
    >>> ideal = flexgen.Setting(sample_s=0.5e-3, delay_s=0.0, exact=True)
    >>> study = flexgen.feedback_study("elbow", settings=[ideal], families=["motor PD"], tunings=2)
    >>> f"{1e3 * study.best(ideal, 'motor PD').worst_m:.2f} mm"
    '0.28 mm'
    """

    model: RobotModel
    solution: Solution
    plants: tuple[str, ...]
    settings: tuple[Setting, ...]
    trials: tuple[Trial, ...]
    torque_noise_Nm: float

    def __repr__(self) -> str:
        return (
            f"<FeedbackStudy {self.model.name}: {len(self.settings)} settings, "
            f"{len(self.trials)} tunings>"
        )

    def __str__(self) -> str:
        """The table."""
        return self.table

    def of(self, setting: Setting, family: str) -> tuple[Trial, ...]:
        """The tunings of a family under a setting."""
        return tuple(t for t in self.trials if t.setting == setting and t.family == family)

    def best(self, setting: Setting, family: str) -> Trial | None:
        """The tuning with the smallest worst error whose torque noise is within the limit; None:
        all failed.
        """
        good = [
            t
            for t in self.of(setting, family)
            if np.isfinite(t.worst_m)
            and (setting.exact or t.torque_noise_Nm <= self.torque_noise_Nm)
        ]
        return min(good, key=lambda t: t.worst_m, default=None)

    def ratio(self, setting: Setting) -> float:
        """Worst error of feedback linearization (the better of both kinds) over that of LQ about
        the feedforward.
        """
        found = {family: self.best(setting, family) for family in (FL, PREDICTED, STATE_LQ)}
        linearised = min(t.worst_m for t in (found[FL], found[PREDICTED]) if t is not None)
        other = found[STATE_LQ]
        return linearised / other.worst_m if other is not None else 0.0

    @property
    def table(self) -> str:
        """Worst error [mm] of each family at its best tuning, in Markdown."""
        lines = []
        for exact, title in ((True, "state exact"), (False, "measured angles")):
            chosen = [s for s in self.settings if s.exact == exact]
            if not chosen:
                continue
            lines += [
                "| " + " | ".join((title, *FAMILIES)) + " |",
                "|" + "---|" * (len(FAMILIES) + 1),
            ]
            for setting in chosen:
                cells = [self._cell(setting, family) for family in FAMILIES]
                lines.append("| " + " | ".join((str(setting), *cells)) + " |")
            lines.append("")
        return "\n".join(lines)

    def _cell(self, setting: Setting, family: str) -> str:
        trial = self.best(setting, family)
        if trial is None:
            return "none"
        noise = "" if setting.exact else f" at {trial.torque_noise_Nm:.1f} N m"
        return f"{1e3 * trial.worst_m:.2f}{noise} ({trial.tuning})"

    def content(self) -> tuple[Part, ...]:
        """Worst error of each family at its best tuning, a table for each kind of setting; all
        tunings in JSON.
        """
        tables = []
        for exact, title in ((True, "state exact"), (False, "measured angles")):
            cells = tuple(
                (str(setting), *(self._shown(setting, family) for family in FAMILIES))
                for setting in self.settings
                if setting.exact == exact
            )
            columns = (Column(title), *(Column(family, "mm") for family in FAMILIES))
            tables += [Table(columns, cells, title)] if cells else []
        return (
            Prose(f"{self.model.title}: feedback laws, worst error of the robots", is_title=True),
            Data("model", self.model.name),
            Data("move", self.solution.move.name),
            Data("plants", list(self.plants)),
            Row(
                "limit of the torque noise",
                self.torque_noise_Nm,
                "N m",
                "torque_noise_limit_Nm",
            ),
            *tables,
            Data("settings", [self._data_of(setting) for setting in self.settings]),
        )

    def _shown(self, setting: Setting, family: str) -> Shown | None:
        """The cell of a family at its best tuning; None: all failed."""
        best = self.best(setting, family)
        return None if best is None else Shown(best.worst_m, self._cell(setting, family))

    def _data_of(self, setting: Setting) -> dict[str, Any]:
        """All tunings under a setting for JSON; failed robots have None."""

        def row(trial: Trial) -> dict[str, Any]:
            return {
                "tuning": trial.tuning,
                "worst_m": plain(trial.worst_m),
                "error_m": plain(trial.error_m),
                "dynamic_error_m": plain(trial.dynamic_error_m),
                "torque_noise_Nm": plain(trial.torque_noise_Nm),
                "refused": trial.refused,
            }

        families = {}
        for family in FAMILIES:
            best = self.best(setting, family)
            families[family] = {
                "best": None if best is None else best.tuning,
                "tunings": [row(trial) for trial in self.of(setting, family)],
            }
        return {
            "sample_time_s": setting.sample_s,
            "delay_s": setting.delay_s,
            "exact_state": setting.exact,
            "families": families,
        }


@checked_types
@reported("feedback_study")
def feedback_study(
    model: str | Path | RobotModel | Equations | None = None,
    *,
    settings: Sequence[Setting] = SETTINGS,
    families: Sequence[str] = FAMILIES,
    tunings: int = 20,
    torque_noise: float = TORQUE_NOISE,
    progress: Choice = None,
) -> FeedbackStudy:
    """Compare feedback linearization with feedback around the feedforward, for six robots; see the
    module.

    Parameters
    ----------
    model : name, path or RobotModel, optional
        An arm with elastic joints and link encoders; default: axes 1-3 of the Manutec r3 with its
        wrist locked. Its first move is used.
    settings : sequence of Setting
    families : sequence of str
        Some of ``"motor PD"``, ``"motor PID"``, ``"FL"``, ``"FL, predicted"``, ``"LQ"``.
    tunings : int
        Frequencies of each family: 2 or more; twice as many weights of LQ, as both forms of
        feedback linearization have together.
    torque_noise : float [N m]
        Largest torque noise, peak to peak, where the angles are measured.
    progress : callable or bool, optional

    Returns
    -------
    FeedbackStudy

    Raises
    ------
    ArgumentError
        The model is not an arm with elastic joints, or an argument is out of range.
    SolverError
        The move has no solution.

    Examples
    --------
    >>> ideal = flexgen.Setting(sample_s=0.5e-3, delay_s=0.0, exact=True)
    >>> study = flexgen.feedback_study(
    ...     "elbow", settings=[ideal], families=["motor PD", "FL"], tunings=2
    ... )
    >>> [f"{1e3 * study.best(ideal, family).worst_m:.2f} mm" for family in ("motor PD", "FL")]
    ['0.28 mm', '0.21 mm']
    """
    tell = progress if callable(progress) else (lambda line: None)
    robot = robot_of(ARM if model is None else model)
    check_ability(robot, "feedback_study")
    if unit_of(robot) != "m":
        raise ArgumentError(
            f"feedback_study: given the model {robot.name} whose output is an angle, expected "
            "lengths"
        )
    reason = obstacle(robot, "elastic joints")
    if reason is not None:
        raise ArgumentError(f"feedback_study: {reason}")
    unknown = [family for family in families if family not in FAMILIES]
    if unknown or not settings or tunings < 2 or not torque_noise > 0:
        raise ArgumentError(
            f"feedback_study: given families {list(families)}, {len(settings)} settings, "
            f"{tunings} tunings, torque_noise {torque_noise!r}, expected some of "
            f"{', '.join(FAMILIES)}, a setting, 2 tunings and a torque > 0"
        )
    solution = solve(robot, progress=tell)
    trials: list[Trial] = []
    case = None
    for setting in settings:
        case = _case(robot, setting, solution)
        for family in families:
            tell(f"{setting}: {family}")
            trials += [_trial(case, setting, family, *law) for law in _laws(case, family, tunings)]
    assert case is not None
    return FeedbackStudy(
        robot, solution, case.plants.names, tuple(settings), tuple(trials), torque_noise
    )


def _case(robot: RobotModel, setting: Setting, solution: Solution) -> Case:
    """The case of one setting of sample time, delay and measurement: the robots `PLANTS`, and a
    disturbed one with steps of 0.5 N m on the motors at 0.1 s and a pulse of 300 N on the tool at
    0.25 s for 0.02 s.
    """
    pushes = [Disturbance("step", motor.name, 0.5, 0.1) for motor in robot.motors]
    pushes.append(Disturbance("pulse", "tool.x", 300.0, 0.25, 0.02))
    return control_case(
        robot,
        sample_time=setting.sample_s,
        delay=setting.delay_s,
        plants=PLANTS,
        disturbances={"disturbed": pushes},
        encoder_noise=0.0 if setting.exact else MOTOR_NOISE,
        exact_state=setting.exact,
        solution=solution,
        torque_limits=False,
    )


def _laws(case: Case, family: str, tunings: int) -> list[tuple[str, Any]]:
    """The tunings of a family: their names, and what `flexgen.control` takes."""
    if family == STATE_LQ:
        return [(f"rho {rho:.1e}", LQ(rho)) for rho in np.logspace(1, -9, 2 * tunings)]
    if family in (PD, PID):
        part = 0.0 if family == PD else 0.125
        return [
            (f"{f:.0f} Hz", _motor_feedback(case, f, part)) for f in np.geomspace(3, 64, tunings)
        ]
    predict = family == PREDICTED
    return [
        (f"{form}, {f:.1f} Hz", FeedbackLinearisation(f, form, predict))
        for form in FORMS for f in np.geomspace(8, 60, tunings)
    ]  # fmt: skip


def _motor_feedback(case: Case, frequency_hz: float, integral: float) -> Cascade:
    """PD control of the motors, ``k_p = w^2 J``, ``k_d = 2 w J``, as a cascade; with an integral
    part from w/8 on.
    """
    J, _ = motor_inertias(case.model, case.reference.points(np.array([0])))
    w = 2 * np.pi * frequency_hz
    one = np.ones(case.model.n_m)
    return Cascade(0.5 * w * one, 2 * w * J, integral * w * one)


def _trial(case: Case, setting: Setting, family: str, tuning: str, law: Any) -> Trial:
    """Simulate all robots with one tuning of a law.

    A design that is refused gives a trial with the reason and without errors. The noise of the
    torque [N m] is its range at rest before the motion, NaN where the nominal robot fails.
    """
    check_time("feedback_study")
    try:
        made: tuple[Controller, str] = case_controller(case, law)
    except (ArgumentError, SolverError) as error:
        return Trial(setting, family, tuning, (), (), float("nan"), str(error))
    run = run_case(case, *made)
    figures = [run.figures(r) for r in run.runs]
    at_rest = (case.reference.time > -REST_S) & (case.reference.time < case.reference.begin)
    noise = float(np.ptp(run.nominal.tau_m[at_rest], axis=0).max())
    errors = tuple(
        tuple(float(row[key]) for row in figures) for key in ("error_max_m", "dynamic_error_max_m")
    )
    return Trial(
        setting,
        family,
        tuning,
        errors[0],
        errors[1],
        noise if not run.nominal.failure else float("nan"),
    )
