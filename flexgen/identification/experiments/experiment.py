"""`measure`: a simulated experiment. Robots under their drives follow the references of a plan;
spectra are kept.

Raw samples of an experiment take megabytes for each second of robot; the spectra at the excited
lines are all that the frequency responses need, see `flexgen.identification.responses.spectra`.
Raw samples are kept on demand, in the form in which recordings of real robots are read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from flexgen.analysis import second_order
from flexgen.base.calls.deadline import (
    has_limit,
    is_over,
    keep_best,
    limit_fit,
    part_known,
    reason_of_end,
)
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Seed, TimeLimit
from flexgen.base.checks.counts import count_of
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.results import ArrayResult
from flexgen.base.rows import Column, Part, Table
from flexgen.base.spec.arguments import seed_of
from flexgen.codegen.build.model_library import library_with
from flexgen.codegen.emission.digest import model_digest
from flexgen.feedback.loop.closed_loop import ClosedLoop, Samples, integration_steps
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.experiments.sensor_simulation import SensorSignals
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_outputs import output_orders
from flexgen.identification.responses.spectra import (
    SPECTRA_BESIDE,
    checked_beside,
    records_beside,
    spectra_beside,
    spectrum,
)
from flexgen.model.abilities import check_ability
from flexgen.model.elements import RobotModel
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.model.reader import read

LARGEST = 1e100  # of a spectrum in a file
HOLDS = ("zoh", "none")
# Numbers of pose, realization and experiment.
Run = tuple[int, int, int]
# Called with a run, and its angles, torques and signals.
Raw = Callable[[int, int, int, np.ndarray, np.ndarray, np.ndarray], None]
LANES = 48  # robots that are simulated together
FINER = 16.0  # than in other simulations: the step shifts a resonance by less than noise does


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class Experiment(ArrayResult):
    """Spectra of an experiment.

    Parameters
    ----------
    plan : Plan
    tau_m : complex array (k, realizations, experiments, periods, lines, n_m) [N m]
        Of the torques, motor side.
    q_m : complex array, the same shape [rad]
        Of the measured motor angles.
    speed_sd : array (k, n_m) [rad/s]
        Standard deviation of the speeds of the motors.
    saturated : array (k,)
        Samples with a torque at its limit.
    source : str
        Where it comes from.
    hold : str
        Of the torques between samples: ``"zoh"`` or ``"none"``.
    signals : complex array (k, realizations, experiments, periods, lines, channels) or None
        Of the sensor channels ``plan.sensors``, SI units.
    offsets : array (offsets,) or None
        Of the lines of ``beside`` from those of the plan; None: not kept.
    beside : array (k, realizations, experiments, offsets, lines, 2 n_m + channels) or None
        Spectra of torques, angles and signals of the whole record beside the lines, see `spectra`;
        None: not kept.
    offsets_later, beside_later : the same
        Of the record without its first period, for a transient there; None: fewer than three
        periods are left.
    orders : tuple of int or None
        Time derivatives from each sensor channel to an acceleration.
    periodic : bool
        False: the periods are windowed segments of a motion without period.
    references : array (k, realizations, experiments, samples, n_m) or None
        One period of the reference angles of recordings [rad], motor side; None: those of the
        plan.
    lines_by_torque : bool
        The lines are those where the torques are large: lines of distortion can be among them.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where poses of the plan were not measured:
        they are left out.

    Examples
    --------
    >>> experiment = flexgen.measure(
    ...     flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    ... )
    >>> experiment.q_m.shape  # poses, realizations, experiments, periods, frequencies, motors
    (1, 1, 2, 4, 10, 2)
    """

    KIND = "experiment"
    ARRAYS = "poses lines amplitudes phases tau_m q_m speed_sd saturated"

    plan: Plan
    tau_m: np.ndarray
    q_m: np.ndarray
    speed_sd: np.ndarray
    saturated: np.ndarray
    source: str = ""
    hold: str = "zoh"
    signals: np.ndarray | None = None
    offsets: np.ndarray | None = None
    beside: np.ndarray | None = None
    orders: tuple[int, ...] | None = None
    periodic: bool = True
    references: np.ndarray | None = None
    lines_by_torque: bool = False
    offsets_later: np.ndarray | None = None
    beside_later: np.ndarray | None = None
    ended: str = ""

    def content(self) -> tuple[Part, ...]:
        """Speeds of the motors at the poses, and all fields as data."""
        motors = self.plan.motors
        columns = (Column("pose"), *(Column(name, "rad/s rms") for name in motors))
        cells = tuple((k, *speed) for k, speed in enumerate(self.speed_sd.tolist(), 1))
        return Table(columns, cells, "Speeds"), *self._data()

    def reference(self, pose: int, realization: int, experiment: int) -> np.ndarray:
        """Reference of the motor angles over one period [rad], (samples, n_m)."""
        pose = count_of("pose", pose, len(self.plan.poses) - 1, 0)
        realization = count_of("realization", realization, self.plan.realizations - 1, 0)
        experiment = count_of("experiment", experiment, self.plan.experiments - 1, 0)
        if self.references is not None:
            return np.asarray(self.references[pose, realization, experiment])
        return np.asarray(self.plan.poses[pose] + self.plan.reference(realization, experiment))

    def __repr__(self) -> str:
        return f"<Experiment {self.source or self.plan.model}: {self.plan!r}>"

    def data(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and other data of a file."""
        arrays, meta = self.plan.data()
        own = {
            "tau_m": self.tau_m,
            "q_m": self.q_m,
            "speed_sd": self.speed_sd,
            "saturated": self.saturated,
        }
        more = {name: getattr(self, name) for name in ("signals", "references", *SPECTRA_BESIDE)}
        own |= {name: x for name, x in more.items() if x is not None}
        return arrays | own, {
            **meta,
            "periodic": self.periodic,
            "lines_by_torque": self.lines_by_torque,
            "orders": None if self.orders is None else list(self.orders),
            "filters": [
                [type(f).__name__, *vars(f).values()] for f in self.plan.controller.filters
            ],
            "source": self.source,
            "hold": self.hold,
            **({"ended": self.ended} if self.ended else {}),
            "units": {"tau_m": "N m", "q_m": "rad"},
            "side": "motor",
        }

    @classmethod
    def from_data(cls, arrays: dict[str, np.ndarray], meta: dict[str, Any]) -> Experiment:
        """The experiment with these data; the inverse of `data`."""
        tau_m, q_m, speed_sd, saturated = (
            arrays[name] for name in ("tau_m", "q_m", "speed_sd", "saturated")
        )
        plan = Plan.from_data(arrays, meta)
        k = len(plan.poses)
        n = len(plan.motors)
        lines = len(plan.lines)
        given = (k, *tau_m.shape[1:4], lines, n)
        if (
            tau_m.shape != given
            or q_m.shape != given
            or speed_sd.shape != (k, n)
            or saturated.shape != (k,)
        ):
            raise ValueError("arrays of different sizes")
        if tau_m.shape[3] != plan.periods or meta["hold"] not in HOLDS or tau_m.size == 0:
            raise ValueError(
                f"periods and hold: expected {plan.periods} and one of {', '.join(HOLDS)}"
            )
        for name in ("tau_m", "q_m", "signals", *SPECTRA_BESIDE[1::2]):
            if name in arrays and np.abs(arrays[name]).max(initial=0.0) > LARGEST:
                raise ValueError(f"{name}: expected numbers up to {LARGEST:g}")
        signals = arrays.get("signals")
        c = len(plan.sensors)
        if (signals is None) != (c == 0) or (
            signals is not None and signals.shape != (*given[:-1], c)
        ):
            raise ValueError(f"signals: expected those of {c} sensor channels")
        orders = tuple(map(int, meta.get("orders") or ())) or None
        if (0 if orders is None else len(orders)) != c or not set(orders or ()) <= {0, 1, 2}:
            raise ValueError(f"orders: expected {c} numbers from 0 to 2")
        kept = checked_beside(arrays, given[:3], (lines, 2 * n + c))
        references = arrays.get("references")
        if references is not None and references.shape != (*given[:3], plan.samples, n):
            raise ValueError("references: expected a period of each experiment")
        kinds = {kind.__name__: kind for kind in (LowPass, Notch)}
        filters = tuple(kinds[str(f[0])](*map(float, f[1:])) for f in meta.get("filters", ()))
        plan = replace(plan, controller=replace(plan.controller, filters=filters))
        return cls(
            plan,
            tau_m,
            q_m,
            speed_sd,
            saturated,
            str(meta["source"]),
            str(meta["hold"]),
            signals,
            orders=orders,
            periodic=bool(meta.get("periodic", True)),
            references=references,
            lines_by_torque=bool(meta.get("lines_by_torque", False)),
            ended=str(meta.get("ended", "")),
            **kept,
        )


@checked_types(own=("steps",))
@reported("measure")
def measure(
    plan: Plan,
    truth: RobotModel | str | Path | None = None,
    *,
    seed: Seed = 0,
    steps: int | None = None,
    beside: bool = False,
    raw: Callable[[int, int, int, np.ndarray, np.ndarray, np.ndarray], None] | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Experiment:
    """Simulate the experiment of a plan.

    Parameters
    ----------
    plan : Plan
    truth : RobotModel, str or Path, optional
        The robot that is measured; default: the model of the plan.
    seed : int
        Of the noise.
    steps : int, optional
        Integration steps in a sample; default: at most 1/16 over the fastest eigenvalue.
    beside : bool
        An error where there are too few periods for the spectra beside the lines, which remove
        transients. See `frf`.
    raw : callable, optional
        Called with pose, realization, experiment, angles and torques (samples, n_m) and sensor
        signals (samples, channels) of the measured periods.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the experiment is that of the poses
        which are done, and ``ended`` says so. With a limit one pose is simulated after the other;
        then the noise of sensors is another one. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    Experiment

    Raises
    ------
    ArgumentError
        The robot has other motors than the plan, or not its sensors.
    OutOfTime
        The time was over before the first pose was done.
    SolverError
        The loop is unstable.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> robot = flexgen.read(
    ...     "elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 6e6}
    ... )
    >>> experiment = flexgen.measure(plan, robot)
    >>> experiment.tau_m.shape  # poses, realizations, experiments, periods, frequencies, motors
    (1, 1, 2, 4, 10, 2)
    """
    tell = progress if callable(progress) else None
    seed = seed_of(seed)
    robot = _robot(plan, truth)
    with limit_fit("measure", time_limit, tell, first="pose"):
        return _measure(plan, robot, seed, steps, beside, raw, tell)


@dataclass(frozen=True)
class _Simulation:
    """Robots of an experiment: where they rest, and how their closed loops are simulated."""

    plan: Plan
    robot: RobotModel
    library: Any
    rest_a: np.ndarray
    tau_m: np.ndarray
    rate: float
    seed: int
    steps: int

    def start(self, group: list[Run], first: int) -> tuple[ClosedLoop, np.ndarray]:
        """The loop of some runs, and its reference; ``first``: number of the first run."""
        at = [k for k, _, _ in group]
        n_m = self.robot.n_m
        plan = self.plan
        whole = first // LANES * LANES
        loop = ClosedLoop(
            self.robot, self.library, plan.hardware, plan.controller, self.rest_a[at],
            plan.poses[at], self.rate, seed=self.seed * 1_000_003 + whole, steps=self.steps,
            first_robot=first - whole,
        )  # fmt: skip
        loop.hold(self.tau_m[at])
        reference = np.empty((plan.samples, len(group), 2 * n_m))
        for lane, (k, r, e) in enumerate(group):
            reference[:, lane, :n_m] = plan.poses[k] + plan.reference(r, e)
            reference[:, lane, n_m:] = self.tau_m[k]
        return loop, reference


def _measure(
    plan: Plan,
    robot: RobotModel,
    seed: int,
    steps: int | None,
    beside: bool,
    raw: Raw | None,
    tell: Callable[[str], None] | None,
) -> Experiment:
    """The experiment, of the poses that were done before the end of the time."""
    library = library_with(robot, ("forward_dynamics",), progress=tell)
    local = LocalModel(robot, ())
    rest = local.rest(local.values, plan.poses)
    rate = largest_rate(local, plan.poses)
    steps = integration_steps(plan.hardware, FINER * rate) if steps is None else steps
    rest_a = rest.y[:, : robot.n_a]
    simulation = _Simulation(plan, robot, library, rest_a, rest.tau_m, rate, seed, steps)
    sensors = SensorSignals(robot, plan, library, seed) if plan.sensors else None
    kept = _Spectra(plan, robot, sensors, beside)
    saturated = np.zeros(len(plan.poses), np.int64)
    groups, each = _groups(plan)
    runs = len(plan.poses) * each
    done = 0
    for group in groups:
        began = perf_counter()
        with keep_best():
            loop, reference = simulation.start(group, done)
            settle(loop, reference, plan.transients)
            recorded = []
            periods = loop.periods(reference, plan.periods, motion=kept.sensors is not None)
            for period, samples in enumerate(periods):
                recorded.append(kept.add(group, period, samples, keep=raw is not None))
                if tell is not None:
                    part = (done + len(group) * (period + 1) / plan.periods) / runs
                    tell(f"measure: {100 * part:.0f} % of {plan.duration_s:.0f} s of robot")
            np.add.at(saturated, [k for k, _, _ in group], loop.saturated)
            if raw is not None:
                _write_raw(raw, group, recorded)
            done += len(group)
        if done >= each:
            took_s = (perf_counter() - began) * each / len(group)
            part_known("poses", took_s, (runs - done) // each)
        if is_over():
            break
    ended = reason_of_end() if done < runs else ""
    orders = None
    if plan.sensors:
        orders = tuple(output_orders(robot, plan.sensors)[robot.n_m :].tolist())
    poses = slice(None, done // each)
    w = 2 * np.pi * plan.frequencies
    speed = np.sqrt(
        (np.abs(w[:, None] * kept.q_m[poses]) ** 2).sum(axis=-2).mean(axis=(1, 2, 3)) / 2
    )
    near = {name: x[poses] if name.startswith("beside") else x for name, x in kept.beside.items()}
    signals = None if kept.signals is None else kept.signals[poses]
    if ended:
        # the expected accuracy was that of all poses
        plan = replace(plan, poses=plan.poses[poses], predicted={})
    return Experiment(
        plan, kept.tau_m[poses], kept.q_m[poses], speed, saturated[poses],
        f"simulation of {robot.name}", "zoh", signals, orders=orders, ended=ended, **near,
    )  # fmt: skip


def _write_raw(raw: Raw, group: list[Run], recorded: Sequence[tuple[np.ndarray, ...]]) -> None:
    """Give the samples of all periods of each run to ``raw``."""
    for lane, run in enumerate(group):
        q_m, tau_m, signals = (
            np.concatenate([part[i][:, lane] for part in recorded]) for i in range(3)
        )
        raw(*run, q_m, tau_m, signals)


def _groups(plan: Plan) -> tuple[list[list[Run]], int]:
    """Runs that are simulated together, and how many runs a pose has; with a limit those of a
    pose.

    A group begins at the latest where one begins without a limit: the noise is the same.
    """
    each = plan.realizations * plan.experiments
    runs = [
        (k, r, e)
        for k in range(len(plan.poses))
        for r in range(plan.realizations)
        for e in range(plan.experiments)
    ]
    begins = set(range(0, len(runs), LANES))
    if has_limit():
        begins |= set(range(0, len(runs), each))
    ends = [*sorted(begins)[1:], len(runs)]
    return [runs[a:b] for a, b in zip(sorted(begins), ends, strict=True)], each


class _Spectra:
    """The spectra of an experiment, filled period by period; names as in `Experiment`."""

    def __init__(
        self, plan: Plan, robot: RobotModel, sensors: SensorSignals | None, beside: bool
    ) -> None:
        self.plan = plan
        self.sensors = sensors
        runs = (len(plan.poses), plan.realizations, plan.experiments)
        n = robot.n_m
        c = len(plan.sensors)
        shape = (*runs, plan.periods, len(plan.lines))
        self.tau_m = np.empty((*shape, n), complex)
        self.q_m = np.empty((*shape, n), complex)
        self.signals = np.empty((*shape, c), complex) if c else None
        self._records: dict[str, tuple[int, np.ndarray]] = {}
        try:
            if sensors is not None and max(sensors.steps) > 1:
                raise ArgumentError(
                    "transients: given sensors that are slower than the drives, expected none "
                    "of them"
                )
            self._records = records_beside(plan.lines, plan.periods)
        except ArgumentError:
            if beside:
                raise
        last = len(plan.lines), 2 * n + c
        self.beside: dict[str, Any] = {
            f"offsets{end}": at for end, (_, at) in self._records.items()
        }
        self.beside |= {
            f"beside{end}": np.zeros((*runs, len(at), *last), complex)
            for end, (_, at) in self._records.items()
        }
        late = np.zeros(0) if sensors is None else sensors.delays
        self._turn = np.exp(-2j * np.pi * plan.frequencies[:, None] * late)

    def add(
        self, group: list[tuple[int, int, int]], period: int, samples: Samples, keep: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One period of some runs; its samples of angles, torques and signals where they are
        kept.
        """
        lines = self.plan.lines
        empty = np.zeros((*samples.q_m.shape[:2], 0))
        signals = empty
        if self.sensors is not None and samples.motion is not None:
            signals = self.sensors(samples.motion)
        for lane, run in enumerate(group):
            self.tau_m[*run, period] = spectrum(samples.tau_m[:, lane], lines)
            self.q_m[*run, period] = spectrum(samples.q_m[:, lane], lines)
            if self.sensors is not None and self.signals is not None:
                for c, step in enumerate(self.sensors.steps):
                    self.signals[*run, period, :, c] = spectrum(
                        signals[::step, lane, c : c + 1], lines
                    )[:, 0]
                self.signals[*run, period] *= self._turn
            x = np.hstack([samples.tau_m[:, lane], samples.q_m[:, lane], signals[:, lane]])
            for end, (first, offsets) in self._records.items():
                if period >= first:
                    found = spectra_beside(
                        x, lines, offsets, period - first, self.plan.periods - first
                    )
                    found[..., x.shape[1] - signals.shape[2] :] *= self._turn
                    self.beside[f"beside{end}"][run] += found
        return (samples.q_m, samples.tau_m, signals) if keep else (empty, empty, empty)


def _robot(plan: Plan, truth: RobotModel | str | Path | None) -> RobotModel:
    """The robot that is simulated; ArgumentError where it is not the one of the plan."""
    given = plan.model if truth is None else truth
    robot = given if isinstance(given, RobotModel) else read(given)
    if truth is None and model_digest(robot) != plan.digest:
        raise ArgumentError(
            f"truth: given none, and {plan.model} is another model than the one of the plan; "
            "name the robot to simulate"
        )
    check_ability(robot, "measure")
    motors = tuple(motor.name for motor in robot.motors)
    if motors != plan.motors:
        raise ArgumentError(
            f"truth: given the motors {', '.join(motors)}, expected {', '.join(plan.motors)}"
        )
    return robot


def settle(loop: ClosedLoop, reference: np.ndarray, periods: int) -> None:
    """Run periods that are not measured: the reference (samples, lanes, 2 n_m) fades in over the
    first one.
    """
    if periods == 0:
        return
    loop.run_in_parts(fade_in(reference), len(reference))
    for _ in loop.periods(reference, periods - 1):
        pass


def fade_in(reference: np.ndarray) -> np.ndarray:
    """A period of the reference (samples, lanes, 2 n_m) that begins at rest, smooth at both
    ends.
    """
    n_m = reference.shape[2] // 2
    ramp = np.linspace(0.0, 1.0, len(reference))
    weight = (ramp**3 * (10 - 15 * ramp + 6 * ramp**2))[:, None, None]
    poses = reference[:, :, :n_m].mean(axis=0)
    out = reference.copy()
    out[:, :, :n_m] = poses + weight * (reference[:, :, :n_m] - poses)
    return out


def largest_rate(local: LocalModel, poses: np.ndarray) -> float:
    """Largest size of an eigenvalue [1/s] at the poses (k, n_m); friction as steep as at rest."""
    return second_order.largest_rate(*local.matrices(local.values, poses)[:3])
