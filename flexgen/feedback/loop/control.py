"""A move in the closed loop: feedforward by inverse dynamics, a sampled controller, robots that
differ from the model.

Every robot starts at rest with the motors where the move begins, at its own equilibrium, and holds
this position before the motion. The static part of the output error is that at rest before and
after the motion; between them it changes in proportion to time along the path. The dynamic part is
the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from time import perf_counter
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import (
    check_time,
    is_over,
    keep_best,
    limit_fit,
    part_known,
    reason_of_end,
)
from flexgen.base.calls.progress import Choice, Progress, reported
from flexgen.base.checks.bounds import NotNegative, Positive, Seed, TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.arguments import check_not_negative, is_number
from flexgen.dynamics.mechanics.equations import Equations, robot_of
from flexgen.feedback.loop.case import SAMPLE_S, Case, control_case, with_wall
from flexgen.feedback.loop.closed_loop import MOST_STEPS, TOO_LONG, TOOL, ClosedLoop
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.hardware import SensorChannels
from flexgen.feedback.loop.interface import Controller
from flexgen.feedback.loop.model_law import ModelLaw
from flexgen.feedback.loop.named_controllers import controller_of
from flexgen.feedback.loop.result import ControlRun, PlantRun, output_errors
from flexgen.inversion.methods.method_table import AUTO, MethodName
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.force.process_force import scale_force
from flexgen.simulation.environment.disturbances import Disturbance, disturbance_table
from flexgen.simulation.environment.robot_function import RobotFunction
from flexgen.simulation.environment.wall import Wall, contact_force, numbers_of, wall_force

CHUNK = 2000  # samples between two progress messages
PARTS = 40  # of the reference with gains of their own
# more steps, one after the other, where gears or frictions slip faster than in the planned motion
FINER = (4, 4, 4)
# Robots in addition to the model that are simulated together where the time is limited: a vector
# unit computes so many at once.
TOGETHER = 8


@checked_types(own=("plants", "force", "assumed_force"))
@reported("control")
def control(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    method: MethodName = AUTO,
    controller: Any = "ppi",
    sample_time: Positive = SAMPLE_S,
    delay: NotNegative = 0.0,
    plants: Mapping[str, Mapping[str, float]] | None = None,
    disturbances: Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]] = (),
    encoder_noise: NotNegative = 0.0,
    encoder_resolution: NotNegative = 0.0,
    torque_limits: bool = True,
    exact_state: bool = False,
    seed: Seed = 0,
    solution: Solution | None = None,
    wall: Wall | None = None,
    force: np.ndarray
    | Callable[[np.ndarray], np.ndarray]
    | Trajectory
    | str
    | FilePath
    | None = None,
    assumed_force: float
    | np.ndarray
    | Callable[[np.ndarray], np.ndarray]
    | Trajectory
    | str
    | FilePath
    | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> ControlRun:
    """Simulate a move under a sampled controller with feedforward torques, for the model and for
    robots that differ.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    method : str
        Method of inverse dynamics. Of the feedforward, as of `flexgen.solve`; ``"rigid"``: that of
        a rigid robot.
    controller : str or object
        ``"ppi"`` (P-PI cascade, the default), ``"ppi_notch"``, ``"none"`` (feedforward only). Also
        the name of a law such as ``"lqg"``, a path of a ``.toml`` or ``.py`` file
        (``file.py:Class``) or of a shared library, a `PPI`, `PID`, `Cascade`, `Linear` or law such
        as `flexgen.LQG`, an object with ``reset()`` and ``step(k, y, ref) -> u``, or a system of
        python-control.
    sample_time : float [s]
        Of the controller.
    delay : float [s]
        From a measurement to its torque.
    plants : mapping of str to changes, optional
        Another robot. Several have names, such as ``{"soft": {"stiffness": 0.8}, "loaded":
        {"payload": 5.0}}``: see `flexgen.feedback.loop.plants`. The model itself is simulated too.
    disturbances : sequence of Disturbance, or mapping from plants' names to them
        Forces and torques on all robots. Or on those named, see `Disturbance`.
    encoder_noise : float [rad]
        Of the motor angles. Standard deviation of white noise.
    encoder_resolution : float [rad]
        Of the motor angles. Smallest difference.
    torque_limits : bool
        The torques are limited. False: do not limit the torques to those of the model file.
    exact_state : bool
        The controller measures angles and speeds of arm and motors exactly. The state ``q_a, v_a,
        q_m, v_m`` without noise too, after the sensors: for studies.
    seed : int
        Of the noise.
    solution : Solution, optional
        The move solved before; default: `flexgen.solve` with its default method.
    wall : Wall, optional
        A wall that pushes the tool. Those of all robots; its force on the tool of a robot is
        ``contact`` of its `PlantRun`.
    force : array (n, 3), callable, Trajectory or file, optional [N]
        Force of a process on the tool along the move: a trajectory with the channel ``force``
        (.csv, .npz). On all tools along the path, as `flexgen.solve` takes it; default: that of
        ``solution``.
    assumed_force : float, or as ``force``, optional
        What the feedforward assumes of it: a factor, such as 0.8 (0: none), or a file with another
        force; default: the same. Also what ``force`` may be.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the run has the robots that are done,
        the model first, and its ``status`` says so. None or 0: unlimited; then all robots are
        simulated together.
    progress : callable or bool, optional

    Returns
    -------
    ControlRun

    Raises
    ------
    ArgumentError
        An argument is out of range, or the controller does not fit.
    OutOfTime
        The time was over before the model was simulated.
    SolverError
        The move has no solution, or a robot no equilibrium.

    Examples
    --------
    >>> run = flexgen.control("elbow", plants={"soft": {"stiffness": 0.8}})
    >>> print(run.status, [robot.name for robot in run.runs])
    done ['nominal', 'soft']
    >>> f"{1e6 * run.distance(run['soft']).max():.0f} um"
    '242 um'
    """
    tell = progress if callable(progress) else None
    with limit_fit("control", time_limit, tell, first="robot"):
        solution = _solve_assuming(model, move, method, force, assumed_force, solution, tell)
        case = control_case(
            model, move, sample_time=sample_time, delay=delay, plants=plants,
            disturbances=disturbances, encoder_noise=encoder_noise,
            encoder_resolution=encoder_resolution, torque_limits=torque_limits,
            exact_state=exact_state, seed=seed, solution=solution, force=force, progress=tell,
        )  # fmt: skip
        check_time("robots")
        if wall is not None:
            case = with_wall(case, wall, tell)
        chosen, name = case_controller(case, controller)
        return _run_groups(case, chosen, name, bool(time_limit), tell)


def _run_groups(
    case: Case, controller: Controller, name: str, limited: bool, progress: Progress | None
) -> ControlRun:
    """Simulate all robots of a case together, or with ``limited`` time one group after the other,
    the model first, so that the time can end between groups.

    ``name``: of the controller. Robots whose integration steps turn out too long are repeated in
    finer ones. At the end of the time the result has the robots that are done.
    """
    robots = len(case.plants.names)
    groups = [slice(0, robots)]
    if limited and robots > 1:
        begins = range(1, robots, TOGETHER)
        groups = [slice(0, 1), *(slice(k, min(k + TOGETHER, robots)) for k in begins)]
    done: list[ControlRun] = []
    for group in groups:
        with keep_best():
            run = _run(case, controller, name, None, progress, group)
            if any(robot.failure == TOO_LONG for robot in run.runs):
                run = _run_finer(case, controller, name, run, progress, group)
            done.append(run)
        if len(done) == len(groups) or is_over():
            break
        part_known("robots", run.wall_s / len(run.runs), robots - group.stop)
    runs = tuple(robot for run in done for robot in run.runs)
    ended = reason_of_end() if len(runs) < robots else ""
    seconds = sum(run.wall_s for run in done)
    steps = max(run.steps for run in done)
    return replace(done[0], runs=runs, steps=steps, wall_s=seconds, ended=ended)


def _solve_assuming(
    model: Any,
    move: str | Move | None,
    method: str,
    force: Any,
    assumed: Any,
    solution: Solution | None,
    progress: Progress | None,
) -> Solution | None:
    """The solution whose torques are the feedforward; None: `control` solves the move itself.

    It is needed where a method is chosen, or where a ``force`` acts on the tool. ``assumed``: the
    force that the feedforward knows, a force or a factor of the one that acts; default: the same.
    ArgumentError for arguments that exclude each other.
    """
    if solution is not None and method != AUTO:
        raise ArgumentError(
            f"method: given {method!r} with a solution, which has its own, expected one of both"
        )
    if force is None and assumed is None:
        if method == AUTO:
            return solution
        if progress is not None:
            progress(f"solving the move, method {method}")
        return solve(model, move, method, verify=False, progress=progress)
    if force is None:
        raise ArgumentError(
            "assumed_force: given without a force, expected also force: the one that acts"
        )
    if solution is not None:
        if assumed is not None:
            raise ArgumentError(
                "assumed_force: given with a solution, expected one of both: a solution states "
                "its own"
            )
        return solution
    if isinstance(assumed, float) or is_number(assumed):  # also NaN
        check_not_negative("assumed_force", assumed)
        assumed = scale_force(force, robot_of(model), assumed)
    return solve(
        model, move, method, force=force if assumed is None else assumed, progress=progress
    )


def case_controller(case: Case, controller: Any) -> tuple[Controller, str]:
    """The controller for a case from what `control` takes, and its name."""
    samples = -(-len(case.reference.time) // PARTS)
    parts = case.reference.parts(samples)
    chosen, name = controller_of(
        controller, case.equations.model, case.sample_time, case.delay, parts, samples
    )
    if isinstance(chosen, ModelLaw):
        return chosen.bound(case.law_motion()), chosen.title
    if case.exact_state and isinstance(chosen, Linear):
        chosen = _beside_the_state(chosen, case.model)
    return chosen, name


def _beside_the_state(controller: Linear, model: RobotModel) -> Linear:
    """A linear controller of motor angles and sensors, in a loop that measures the exact state
    after them.
    """
    A, B, C, D = controller.matrices
    used = model.n_m + sum(len(s.channels) for s in model.sensors)
    states = 2 * (model.n_a + model.n_m)
    if not B.shape[-1] == D.shape[-1] == used:
        return controller
    B, D = (np.concatenate([x, np.zeros((*x.shape[:2], states))], axis=2) for x in (B, D))
    return Linear(A, B, C, D, controller.samples)


def run_case(
    case: Case,
    controller: Controller,
    name: str,
    *,
    steps: int | None = None,
    progress: Progress | None = None,
) -> ControlRun:
    """Simulate all robots of a case under a controller, in ``steps`` a sample, by default as many
    as they need.
    """
    run = _run(case, controller, name, steps, progress)
    return run if steps is not None else _run_finer(case, controller, name, run, progress)


def _run_finer(
    case: Case,
    controller: Controller,
    name: str,
    run: ControlRun,
    progress: Progress | None,
    group: slice = slice(None),
) -> ControlRun:
    """Repeat a run with more integration steps, by the factors `FINER`, while those of a robot are
    too long.
    """
    for finer in FINER:
        if any(robot.failure == TOO_LONG for robot in run.runs):
            steps = min(finer * run.steps, MOST_STEPS)
            run = _run(case, controller, name, steps, progress, group)
    return run


def _run(
    case: Case,
    controller: Controller,
    name: str,
    steps: int | None,
    progress: Progress | None,
    group: slice = slice(None),
) -> ControlRun:
    """Simulate the robots of a group; each has the noise that it has in a run of all.

    ``name``: of the controller; ``steps``: integration steps in a sample, None: by the fastest
    eigenvalue. Disturbances are computed for parts of `CHUNK` samples, so that a long run fits in
    memory.
    """
    reference = case.reference
    robot = case.model
    everyone = len(case.plants.names)
    n = len(reference.time)
    named = case.plants.names[group]
    lanes = len(named)
    first_robot = group.indices(everyone)[0]
    q_a, tau = (np.array(x) for x in zip(*case.rests[group], strict=True))
    q_m = np.tile(reference.motion["q_m"][0], (lanes, 1))
    numbers = case.plants.values[group] if case.plants.parameters else None
    sensors = None
    if robot.sensors:
        felt = None if case.signals is None else case.signals.of_robots(group)
        sensors = _channels(robot, case.hardware.sample_s, felt)
    loop = ClosedLoop(
        robot,
        case.library,
        case.hardware,
        controller,
        q_a,
        q_m,
        case.rate,
        seed=case.seed,
        steps=steps,
        parameters=numbers if case.gears is None else case.gears.of_robots(group),
        sensors=sensors,
        delay_samples=case.delay_samples,
        arm_reference=True,
        exact_state=case.exact_state,
        first_robot=first_robot,
    )
    loop.hold(tau)
    if case.wall is not None:
        numbers = np.tile(numbers_of(case.wall, case.model), (lanes, 1))
        loop.touch(
            RobotFunction(wall_force(case.equations), numbers, progress or (lambda line: None))
        )
    known = reference.rows(case.exact_state)
    rows = np.ascontiguousarray(np.broadcast_to(known[:, None], (n, lanes, loop.setup.n_ref)))
    step_s = case.hardware.sample_s / loop.steps
    motions = []
    torques = []
    shown = []
    signals = []
    began = perf_counter()
    for first in range(0, n, CHUNK):
        check_time("control")
        count = min(CHUNK, n - first)
        instants = reference.time[first] + step_s * (np.arange(count * loop.steps) + 0.5)
        names = [m.name for m in robot.motors]
        table = disturbance_table(case.disturbances, names, instants, everyone, case.seed)
        if table is not None and table.shape[2] > 1:
            table = np.ascontiguousarray(table[:, :, group])
        if case.force is not None:
            table = np.zeros((len(instants), robot.n_m + TOOL, 1)) if table is None else table
            table[:, robot.n_m :] += case.force.held(instants, step_s)[:, :, None]
        found = loop.run(rows, count, motion=True, disturbances=table, check=False)
        assert found.motion is not None
        motions.append(found.motion)
        torques.append(found.tau_m)
        shown.append(found.q_m)
        signals.append(found.sensors if found.sensors is not None else np.zeros((count, lanes, 0)))
        if progress is not None:
            progress(
                f"simulating {lanes} robot{'s' * (lanes > 1)}, {100 * (first + count) / n:.0f} "
                f"% of {n * case.hardware.sample_s:.1f} s"
            )
    seconds = perf_counter() - began
    motion, tau_m, q_m, y_s = (np.concatenate(x) for x in (motions, torques, shown, signals))
    ends = np.cumsum([robot.n_a, robot.n_a, robot.n_m, robot.n_m])
    runs = []
    for lane, plant in enumerate(named):
        arm, speeds, motors, _, _ = np.split(motion[:, :, lane], ends, axis=1)
        error, turn = output_errors(case.equations, reference, np.ascontiguousarray(arm))
        stopped = int(loop.saturated[lane]), loop.failures[lane]
        seen = q_m[:, lane], y_s[:, lane]
        touched = (
            None if case.wall is None else contact_force(case.wall, case.equations, arm, speeds)
        )
        load = case.plants.loads[first_robot + lane]
        runs.append(
            PlantRun(
                plant, arm, motors, tau_m[:, lane], error, turn, *stopped, *seen, load, touched
            )
        )
    return ControlRun(
        robot,
        case.solution,
        name,
        controller,
        reference,
        case.hardware,
        case.delay_samples,
        tuple(runs),
        loop.steps,
        seconds,
        None if case.force is None else case.force.at(reference.time),
        case.plants,
    )


def _channels(
    robot: RobotModel, sample_s: float, signals: RobotFunction | None = None
) -> SensorChannels:
    """Noise and delays of the sensors of the model file at a sample time ``sample_s`` [s];
    ``signals``: their values, where these depend on a force on the tool.

    Raises
    ------
    ArgumentError
        A sensor has another sample time, or a delay that is not a multiple of it.
    """
    noise: list[float] = []
    late: list[int] = []
    for sensor in robot.sensors:
        if sensor.sample_s is not None and abs(sensor.sample_s - sample_s) > 1e-9 * sample_s:
            raise ArgumentError(
                f"sensor {sensor.name}: given sample_s = {sensor.sample_s} s, expected "
                f"{sample_s} s as the controller"
            )
        whole = round(sensor.delay_s / sample_s)
        if abs(whole * sample_s - sensor.delay_s) > 1e-6 * sample_s:
            raise ArgumentError(
                f"sensor {sensor.name}: given delay_s = {sensor.delay_s} s, expected a multiple "
                f"of {sample_s} s"
            )
        noise += sensor.noises
        late += [whole] * len(sensor.channels)
    none = np.zeros(len(noise))
    return SensorChannels(np.array(noise), none, none, np.array(late, int), signals)
