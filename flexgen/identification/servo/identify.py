"""Gains of a position servo from a record of commands and angles: least squares on the simulated
closed loop.

    min sum |q(t_k; p) - q_k|^2,
    p = log k_p, log k_v, log k_i of each motor, speed feedforward, d, latency

Of a filter with the time constant T, d = h/(exp(h/T) - 1) is the delay of a slow signal: unlike T
it is smooth at zero. Robots with one number changed each are simulated side by side in C, so that
a step costs one run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import is_over, keep_best, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import derive, robot_of
from flexgen.feedback.loop.closed_loop import MOST_STEPS, TOO_LONG, ClosedLoop
from flexgen.feedback.loop.control import FINER
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.hysteresis import hysteretic_robots, largest_rate, split_plants
from flexgen.feedback.loop.plants import NOMINAL, LocalDynamics, plants_of
from flexgen.feedback.positions.samples import Interpolation, basis
from flexgen.feedback.positions.servo import Servo, filter_reference, servo_of
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.estimator.layout import Layout
from flexgen.identification.estimator.minimize import Search, minimize
from flexgen.identification.estimator.problem import Linearization, Prior, Problem, Squares
from flexgen.identification.servo.fit_result import ServoFit
from flexgen.identification.servo.record import ServoRecord
from flexgen.model.elements import RobotModel
from flexgen.runtime.library import Library
from flexgen.simulation.environment.robot_function import RobotFunction

# the command rests for so long at the begin, up to this part of its range
STILL_S = 0.05
STILL = 1e-3
STILL_PERIODS = 12.5  # of a quicker interface, instead
# Steps of a search, at most, and the part of the sum of squares that the last one gains.
STEPS = 40
CLOSE = 1e-6
# Change of a delay, in sample times of the servo, that counts as much as a factor e of a gain.
DELAY_UNIT = 10.0
LOWER = 1.5, 2.5  # factors of the gains where searches begin again
SMALL = 1e-4  # of the lag: less is not seen as noise
FARTHEST = 5.0  # largest motion of a joint, in motions of its command
COMMON = ("speed_feedforward", "reference_filter_s", "latency_s")
# differences for derivatives
MOVED = {"speed_feedforward": 1e-3, "reference_filter_s": 1e-5, "latency_s": 1e-5}
LOG_MOVED = 1e-3
LARGEST = {"speed_feedforward": 2.0, "reference_filter_s": 0.19, "latency_s": 0.2}  # least: zero
FIRST_FILTER = 4  # sample times
# over the least position gain: residuals depend on each other within it; blocks at least
BLOCK = 6.0
BLOCKS = 20
POSES = 20  # of the record, where eigenvalues are computed


@checked_types(own=("record",))
@reported("identify_servo")
def identify_servo(
    model: str | FilePath | RobotModel,
    record: ServoRecord | str | FilePath,
    *,
    servo: Any = None,
    interpolation: Interpolation = "linear",
    columns: Sequence[str] | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> ServoFit:
    """Identify the position servo of a robot from some seconds of commands and measured angles.

    Parameters
    ----------
    model : name, path or RobotModel
        Inertias, frictions and springs as they are: `flexgen.identify` finds them.
    record : ServoRecord or str
        CSV file of commands and angles: ``time_s``, then ``JOINT_command_deg`` and ``JOINT_deg``
        of each joint. Or a record; in each a move of the robot that begins at rest, see
        `flexgen.identification.servo.record`.
    servo : Servo, Cascade, PPI, or str, optional
        Where the search begins: ``"ppi"`` (proposed gains) or a ``.toml`` file; default: that of
        the model file. ``"ppi"`` where it has none. Its sample time, delay and torque filters
        stay, and gains that are zero.
    interpolation : str
        Of the robot between two positions.
    columns : sequence of str, optional
        Names of the columns of a file without a header. Such as ``t ms,q1_command,q1``; without
        unit in SI units.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the result is the best step so far;
        its ``ended`` says so. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    ServoFit

    Raises
    ------
    ArgumentError
        The record does not fit the model, moves at its begin, or moves too little.
    SolverError
        The loop is unstable wherever the search begins.

    Examples
    --------
    >>> import numpy as np
    >>> # a robot that is sent the planned motor angles
    >>> run = flexgen.command_positions("elbow").today
    >>> joints = np.linalg.inv(run.model.eta).T
    >>> sent, measured = run.reference.motion["q_m"] @ joints, run.nominal.measured @ joints
    >>> found = flexgen.identify_servo(
    ...     "elbow", flexgen.ServoRecord(run.reference.time, sent, measured)
    ... )
    >>> f"{found.explained:.3f}"
    '1.000'
    """
    tell: Callable[[str], None] = progress if callable(progress) else lambda line: None
    robot = robot_of(model)
    if not isinstance(record, ServoRecord):
        record = ServoRecord.read(record, robot, columns)
    check_record(record, robot)
    with limit_fit("identify_servo", time_limit, tell):
        fit = RecordedLoop.begin(robot, record, servo_of(servo, robot), interpolation, tell)
        best = _search(fit, fit.start(), tell)
        for lower in LOWER:
            if is_over() or best.is_explained:
                break
            with suppress(SolverError), keep_best():  # unstable there
                found = _search(fit, fit.start(lower), tell)
                best = min(best, found, key=lambda one: one.left)
        reason = reason_of_end()
        return replace(best, ended=reason) if reason else best


def _search(fit: RecordedLoop, start: np.ndarray, tell: Callable[[str], None]) -> ServoFit:
    """The servo of least squares, from parameters p (n,)."""
    runs = _Runs(fit)
    units = fit.units

    def tell_step(step: int, here: Linearization) -> None:
        rms = np.sqrt((runs.residual(here.x) ** 2).mean())
        tell(f"step {step}: {1e6 * rms:.3g} urad of the motors' angles unexplained")

    lower, upper = fit.bounds
    problem = Problem(
        runs.residual,
        runs.jacobian,
        Prior.nothing(fit.layout.size),
        (lower / units, upper / units),
        Squares(_rms),
    )
    search = Search(gain=CLOSE, steps=STEPS, stage="identify_servo", tell=tell_step)
    found = minimize(problem, start / units, search)
    e, J = runs.at(found.x)
    return fit.result(found.x * units, e, J, found.converged)


def _rms(e: np.ndarray) -> float:
    return max(float(np.sqrt((e**2).mean())), np.finfo(float).tiny)


def check_record(record: ServoRecord, robot: RobotModel) -> None:
    """ArgumentError where a record does not fit the robot, or does not begin at rest."""
    where = record.source or "record"
    if record.command.shape[1] != robot.n_g:
        raise ArgumentError(
            f"{where}: given {record.command.shape[1]} joints, expected {robot.n_g} as of "
            f"{robot.title}"
        )
    rest = min(STILL_S, STILL_PERIODS * record.period)
    size = np.ptp(record.command, axis=0)
    count = max(int(np.ceil(rest / record.period)), 2)
    if not (size > 0.0).all():
        names = [
            robot.coordinates[i].name for i, x in zip(robot.i_g, size, strict=True) if x == 0.0
        ]
        raise ArgumentError(
            f"{where}: given commands that do not move {', '.join(names)}, expected that every "
            "joint moves"
        )
    for i, x, command, angle in zip(
        robot.i_g, size, record.command.T, record.angle.T, strict=True
    ):
        name = robot.coordinates[i].name
        dof = robot.coordinates[i].dof
        low, high = (None, None) if dof is None else (dof.lower, dof.upper)
        if (
            low is not None
            and high is not None
            and max(low - command.max(), command.min() - high) > 0.0
        ):
            raise ArgumentError(
                f"{where}: given commands of {name} from {command.min():.4g} to "
                f"{command.max():.4g} {robot.coordinates[i].unit}, all beyond its limits, "
                "expected some within; the unit of its columns?"
            )
        if np.ptp(angle) > FARTHEST * x:
            raise ArgumentError(
                f"{where}: given angles of {name} that move {np.ptp(angle) / x:.4g} times as "
                "far as its commands, expected angles of the joint: those of the motor over "
                "the gear ratio, in the unit of the column"
            )
    moved = np.abs(record.command[:count] - record.command[0]).max(axis=0) / size
    if moved.max() > STILL:
        raise ArgumentError(
            f"{where}: given a command that moves within the first {1e3 * rest:.3g} ms, "
            "expected that it begins at rest"
        )


def delay_of_filter(T: float, h: float) -> float:
    """Delay [s] of a slow signal in the filter of a reference with time constant T [s], sampled at
    h [s].
    """
    return float(h / np.expm1(h / T))


def filter_of_delay(delay: float, h: float) -> float:
    """Time constant [s] of the filter of a reference with this delay of a slow signal [s], sampled
    at h [s].
    """
    return float(h / np.log1p(h / delay)) if delay > 0.0 else 0.0


@dataclass(frozen=True)
class Numbers(Layout):
    """Parameters p: logarithms of gains, then the numbers `COMMON`, the filter by its delay."""

    gains: slice
    speed_feedforward: slice
    reference_filter_s: slice
    latency_s: slice


class _Runs:
    """Residuals and Jacobian in units of the parameters; both come from one run, and that of the
    last x is kept.
    """

    def __init__(self, fit: RecordedLoop) -> None:
        self.fit = fit
        self._x = np.zeros(0)
        self._found: tuple[np.ndarray, np.ndarray] | None = None

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n,) and Jacobian (n, parameters) in the parameters p.

        Raises
        ------
        SolverError
            The loop is unstable.
        """
        if not np.array_equal(self._x, x):
            self._x = x.copy()
            self._found = self.fit.run(x * self.fit.units)
        if self._found is None:
            raise SolverError("identify_servo: the loop is unstable")
        return self._found

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Residuals (n,)."""
        return self.at(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives in x (n, parameters)."""
        return self.at(x)[1] * self.fit.units


@dataclass(frozen=True)
class RecordedLoop:
    """A record, and the loop that is compared with it; for parameters p, see `Numbers`."""

    robot: RobotModel
    record: ServoRecord
    servo: Servo
    cascade: Cascade
    interpolation: str
    library: Library
    rest: tuple[np.ndarray, np.ndarray]
    rate: float
    time: np.ndarray
    measured: np.ndarray
    gears: RobotFunction | None

    @classmethod
    def begin(
        cls,
        given: RobotModel,
        record: ServoRecord,
        servo: Servo,
        interpolation: str,
        tell: Callable[[str], None],
    ) -> RecordedLoop:
        """The loop at rest where the record begins; elements with a state, of gears and frictions,
        begin at zero.
        """
        robot = without_states(given)
        laws = split_plants(given, plants_of(given, {NOMINAL: {}}))[1]
        local = LocalDynamics(derive(robot))
        n_a = robot.n_a
        motors = record.command @ robot.eta.T
        arm = np.zeros((POSES, n_a))
        arm[:, list(robot.i_g)] = record.command[
            np.linspace(0, len(motors) - 1, POSES).astype(int)
        ]
        at, tau = local.rest(motors[0], np.zeros(0), arm[0])
        still = np.zeros((POSES, n_a))
        quiet = np.zeros((POSES, robot.n_m))
        motion = (arm, still, still, arm[:, list(robot.i_g)] @ robot.eta.T, quiet, quiet, quiet)
        cascade = servo.feedback
        if isinstance(cascade, PPI):
            late = servo.sample_time + servo.delay
            cascade = cascade.cascade(robot, late, [x[:1] for x in motion])
        steps = int(np.floor((record.time[-1] - record.time[0]) / servo.sample_time + 1e-9)) + 1
        time = record.time[0] + servo.sample_time * np.arange(steps)
        library = library_with(robot, ["forward_dynamics"])
        measured = (record.angle - record.angle[0] + record.command[0]) @ robot.eta.T
        rate = local.largest_rate(motion, np.zeros(0))
        gears = None
        if laws:
            v_m = np.gradient(measured, record.time, axis=0)
            speeds = {"v_a": np.zeros((len(v_m), n_a)), "v_m": v_m}
            speeds["v_a"][:, list(robot.i_g)] = v_m @ np.linalg.inv(robot.eta).T
            rate = largest_rate(local, motion, speeds, np.zeros(0), laws[0])
            lanes = 1 + _numbers(robot).size
            gears = hysteretic_robots(local.equations, np.zeros((lanes, 0)), laws * lanes, tell)
        return cls(
            robot,
            record,
            servo,
            cascade,
            interpolation,
            library,
            (at, tau),
            rate,
            time,
            measured,
            gears,
        )

    @property
    def layout(self) -> Numbers:
        """Entries of p; a gain that is zero where the search begins stays zero."""
        return _numbers(self.robot)

    @property
    def units(self) -> np.ndarray:
        """Sizes of changes of p that are alike (n,)."""
        delay = DELAY_UNIT * self.servo.sample_time
        return self.layout.join(
            gains=1.0, speed_feedforward=1.0, reference_filter_s=delay, latency_s=delay
        )

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest p (n,)."""
        lower = self.layout.join(gains=-np.inf)
        upper = self.layout.join(gains=np.inf, **LARGEST)
        return lower, upper

    @property
    def first_gains(self) -> np.ndarray:
        """Position, speed and integral gains (3, n_m) where the search begins."""
        known = self.cascade
        return np.array([known.position_gain, known.speed_gain, known.integral_gain], float)

    def gains_of(self, p: np.ndarray) -> np.ndarray:
        """Gains (..., 3, n_m) of parameters (..., gains and others)."""
        first = self.first_gains
        return np.where(
            first > 0.0,
            np.exp(p[..., self.layout.gains]).reshape(*p.shape[:-1], *first.shape),
            0.0,
        )

    def start(self, lower: float = 1.0) -> np.ndarray:
        """Parameters where the search begins, its gains ``lower`` by a factor; still lower where
        the loop is unstable.

        Raises
        ------
        SolverError
            It is unstable with these, too.
        """
        h = self.servo.sample_time
        first = self.first_gains.ravel() / lower
        p = self.layout.join(
            gains=np.log(np.where(first > 0.0, first, 1.0)),
            speed_feedforward=self.servo.speed_feedforward,
            reference_filter_s=delay_of_filter(
                max(self.servo.reference_filter_s, FIRST_FILTER * h), h
            ),
            latency_s=h,
        )
        p = np.clip(p, *self.bounds)
        for _ in range(6):
            if self.run(p) is not None:
                return p
            p[self.layout.gains] -= np.log(1.5)
        raise SolverError(
            "identify_servo: the loop is unstable with the gains of the servo and with lower ones"
        )

    def servo_of(self, p: np.ndarray) -> Servo:
        """The servo with these parameters."""
        at = self.layout
        delay = p[at.reference_filter_s].item()
        return replace(
            self.servo,
            speed_feedforward=p[at.speed_feedforward].item(),
            reference_filter_s=filter_of_delay(delay, self.servo.sample_time),
        )

    def run(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Residuals (n,) and Jacobian (n, parameters) by simulation of a robot for each parameter;
        None: unstable.
        """
        n_m = self.robot.n_m
        moved = self.layout.join(gains=LOG_MOVED, **MOVED)
        sets = np.vstack([p, p + np.diag(moved)])
        lanes = len(sets)
        gains = self.gains_of(sets).transpose(1, 0, 2)
        rows = np.empty((len(self.time), lanes, 2 * n_m))
        rows[:, :, n_m:] = self.rest[1]
        known = self.record.command @ self.robot.eta.T
        late_s = sets[:, self.layout.latency_s].ravel().tolist()
        plain = {late: self._late(late) @ known for late in set(late_s)}
        for lane, own in enumerate(sets):
            rows[:, lane, :n_m] = filter_reference(
                self.servo_of(own), plain[late_s[lane]], gains[0, lane]
            )
        hardware = DriveHardware(self.servo.sample_time, self._rest_of_delay, 0.0, 0.0, 0.0, ())
        drives = self.robot, self.library, hardware, self._with_gains(gains)
        at_rest = np.tile(self.rest[0], (lanes, 1)), np.tile(known[0], (lanes, 1))
        late = int(self.servo.delay / self.servo.sample_time + 1e-9)
        steps = None
        for finer in (*FINER, 1):
            loop = ClosedLoop(
                *drives,
                *at_rest,
                self.rate,
                delay_samples=late,
                parameters=self.gears,
                steps=steps,
            )
            loop.hold(np.tile(self.rest[1], (lanes, 1)))
            q = loop.run(rows, len(rows), check=False).q_m
            if TOO_LONG not in loop.failures:
                break
            steps = min(finer * loop.steps, MOST_STEPS)
        if any(loop.failures):
            return None
        at = np.clip((self.record.time - self.time[0]) / self.servo.sample_time, 0, len(q) - 1)
        j = np.minimum(at.astype(int), len(q) - 2)
        q = q[j] + (at - j)[:, None, None] * (q[j + 1] - q[j])
        apart = q - self.measured[:, None]
        # zeros of the angles are not known
        flat = (apart - apart.mean(axis=0)).transpose(1, 0, 2).reshape(lanes, -1)
        return flat[0], ((flat[1:] - flat[0]) / moved[:, None]).T

    def _late(self, late: float) -> Any:
        """Weights of the commands in the reference with a latency [s]; `hold` acts at samples,
        mixed between.
        """
        edges = self.record.time
        h = self.servo.sample_time
        if self.interpolation != "hold":
            return basis(self.time - late, edges, self.interpolation)
        whole = np.floor(late / h + 1e-9)
        part = max(late / h - whole, 0.0)
        before, after = (basis(self.time - (whole + k) * h, edges, "hold") for k in (0, 1))
        return (1.0 - part) * before + part * after

    def _with_gains(self, gains: np.ndarray) -> Cascade:
        """The cascade with position, speed and integral gains (3, n_m), or of each robot (3,
        robots, n_m).
        """
        return replace(
            self.cascade, position_gain=gains[0], speed_gain=gains[1], integral_gain=gains[2]
        )

    @property
    def _rest_of_delay(self) -> float:
        h = self.servo.sample_time
        rest = self.servo.delay - int(self.servo.delay / h + 1e-9) * h
        return rest if rest > 1e-9 * h else 0.0

    def _deviations(self, p: np.ndarray, e: np.ndarray, J: np.ndarray) -> np.ndarray:
        """Standard deviations of the parameters, from blocks of the record; zero of a gain that
        stayed zero.
        """
        n = len(self.record.time)
        length = BLOCK / max(self.gains_of(p)[0].min(), 1e-9) / self.record.period
        starts = range(0, n, max(round(min(length, n / BLOCKS)), 1))
        shape = (n, self.robot.n_m)
        rows = (J / _rms(e)).reshape(*shape, -1)
        errors = (e / _rms(e)).reshape(shape)
        found = block_covariance(rows, errors, starts, np.zeros((J.shape[1], J.shape[1])))
        return np.sqrt(np.diag(found))

    def result(self, p: np.ndarray, e: np.ndarray, J: np.ndarray, converged: bool) -> ServoFit:
        """The servo with standard deviations, whose residuals may depend on each other within a
        block.
        """
        n_m = self.robot.n_m
        n = len(self.record.time)
        sd = self._deviations(p, e, J)
        feedback = self._with_gains(self.gains_of(p))
        found = replace(self.servo_of(p), feedback=feedback)
        lag = (self.record.command - self.record.angle) @ self.robot.eta.T
        unexplained = np.sqrt((e.reshape(n, n_m) ** 2).mean(axis=0))
        # of white noise: all of it
        quick = np.sqrt((np.diff(e.reshape(n, n_m), 3, axis=0) ** 2).mean(axis=0) / 20)
        of_all = max(float(1.0 - (e**2).sum() / max(((lag - lag[0]) ** 2).sum(), 1e-300)), 0.0)
        at = self.layout
        h = self.servo.sample_time
        common = {name: sd[at.parts[name]].item() for name in COMMON}
        delayed = p[at.reference_filter_s].item()
        off = common["reference_filter_s"]
        near = [filter_of_delay(max(delayed + x, 0.0), h) for x in (-off, 0.0, off)]
        common["reference_filter_s"] = float(np.abs(np.diff(near)).max())
        return ServoFit(
            servo=found,
            latency_s=p[at.latency_s].item(),
            gain_sd=sd[at.gains].reshape(3, n_m),
            common_sd=common,
            unexplained=unexplained,
            noise=np.maximum(quick, SMALL * np.sqrt(((lag - lag[0]) ** 2).mean(axis=0))),
            explained=of_all,
            converged=converged,
            motors=tuple(motor.name for motor in self.robot.motors),
            record=self.record,
            interpolation=self.interpolation,
            model=self.robot.title,
        )


def _numbers(robot: RobotModel) -> Numbers:
    return Numbers.of(gains=3 * robot.n_m, speed_feedforward=1, reference_filter_s=1, latency_s=1)
