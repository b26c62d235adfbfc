"""A move in the closed loop: feedforward by inverse dynamics, a sampled controller, robots that differ from the model.

Every robot starts at rest with the motors where the move begins, at its own equilibrium, and holds this position before
the motion. The static part of the output error is that at rest before and after the motion; between them it changes in
proportion to time along the path. The dynamic part is the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from time import perf_counter
from typing import Any

import numpy as np

from flexgen.analysis.second_order import largest_rate as largest_eigenvalue
from flexgen.deadline import check_time
from flexgen.environment.disturbances import Disturbance, disturbance_table
from flexgen.environment.robot_function import RobotFunction
from flexgen.environment.sense import signals_of
from flexgen.environment.wall import Wall, check_start, contact_force, in_world, numbers_of, wall_force
from flexgen.errors import ArgumentError
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.library.model_library import library_with
from flexgen.loop.closed_loop import ClosedLoop
from flexgen.loop.controllers import Linear
from flexgen.loop.hardware import DriveHardware, SensorChannels
from flexgen.loop.hysteresis import States, hysteretic_robots, largest_rate, split_plants, without_states
from flexgen.loop.interface import Controller
from flexgen.loop.law_motion import LawMotion
from flexgen.loop.model_law import ModelLaw
from flexgen.loop.named_controllers import controller_of
from flexgen.loop.plants import NOMINAL, LocalDynamics, Plants, plants_of
from flexgen.loop.reference import MotionReference, motion_reference, time_grid
from flexgen.loop.result import ControlRun, PlantRun, output_errors
from flexgen.mechanics.equations import Equations, derive, robot_of
from flexgen.model.elements import Move, RobotModel
from flexgen.numerics.evaluate import evaluate
from flexgen.paths.path import Path
from flexgen.progress import Choice, reported
from flexgen.spec.arguments import check_not_negative, is_number, mapping_of, seed_of
from flexgen.type_checks import checked_types

HOLD_S = 2.0  # at rest before the motion: integral parts settle
AFTER_S = 0.5
SAMPLE_S = 5e-4
CHUNK = 2000  # samples between two progress messages
POINTS = PARTS = 40  # of the reference where eigenvalues are computed, and parts with gains of their own
WALL_STEPS = 4.0  # times as short as the fastest eigenvalue needs
TOOL_FORCE = "forward_dynamics_tool_force"


@dataclass(frozen=True)
class Case:
    """Parts of a closed loop, ready to run with any controller.

    ``plants``, ``library``, ``equations``: of the springs and dampers; ``gears``: the robots with their hysteresis;
    ``signals``: of sensors that feel the force on the tool; ``laws``: of the hysteresis.
    """

    model: RobotModel
    solution: Solution
    plants: Plants
    reference: MotionReference
    hardware: DriveHardware
    delay_samples: int
    disturbances: Mapping[int, Sequence[Disturbance]]
    library: Any
    rests: tuple[tuple[np.ndarray, np.ndarray], ...]
    rate: float
    seed: int
    equations: Equations
    exact_state: bool = False
    gears: RobotFunction | None = None
    signals: RobotFunction | None = None
    laws: tuple[States, ...] = ()
    wall: Wall | None = None

    @property
    def sample_time(self) -> float:
        """Of the controller [s]."""
        return self.hardware.sample_s

    @property
    def delay(self) -> float:
        """From the measurement to the torque [s]."""
        return self.delay_samples * self.hardware.sample_s + self.hardware.delay_s

    def law_motion(self) -> LawMotion:
        """The planned motion for laws that evaluate the model."""
        eq = self.equations
        return LawMotion(
            eq.model, eq, self.solution.trajectory, self.reference, self.sample_time, self.delay, self.exact_state,
            self.rate,
        )  # fmt: skip


@checked_types(own=("plants",))
@reported("control")
def control(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    controller: Any = "ppi",
    sample_time: float = SAMPLE_S,
    delay: float = 0.0,
    plants: Mapping[str, Mapping[str, float]] | None = None,
    disturbances: Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]] = (),
    encoder_noise: float = 0.0,
    encoder_resolution: float = 0.0,
    torque_limits: bool = True,
    exact_state: bool = False,
    seed: int = 0,
    solution: Solution | None = None,
    wall: Wall | None = None,
    progress: Choice = None,
) -> ControlRun:
    """Simulate a move under a sampled controller with feedforward torques, for the model and for robots that differ.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move of the model file; default: its first.
    controller : str or object
        ``"ppi"`` (P-PI cascade, the default), ``"ppi_notch"``, ``"lqg"``, ``"none"`` (feedforward only), a path of a
        ``.toml`` or ``.py`` file (``file.py:Class``) or of a shared library, a `Cascade` or `Linear`, a law that
        evaluates the model (`flexgen.FeedbackLinearisation`, `ComputedTorque`, `TomeiPD`, `JointTorqueFeedback`, `LQ`),
        an object with ``reset()`` and ``step(k, y, ref) -> u``, or a system of python-control.
    sample_time : float [s]
    delay : float [s]
        From the measurement to the torque.
    plants : mapping of str to changes, optional
        Other robots by name, such as ``{"soft": {"stiffness": 0.8}, "loaded": {"payload": 5.0}}``: see
        `flexgen.loop.plants`. The model itself is simulated too.
    disturbances : sequence of Disturbance, or mapping from plants' names to them
        On all robots, or on those named.
    encoder_noise, encoder_resolution : float [rad]
        Standard deviation of white noise, and smallest difference, of the motor angles.
    torque_limits : bool
        The torques are limited to those of the model file.
    exact_state : bool
        The controller measures the state ``q_a, v_a, q_m, v_m`` without noise too, after the sensors: for studies.
    seed : int
        Of the noise.
    solution : Solution, optional
        The move solved before; default: `flexgen.solve` with its default method.
    wall : Wall, optional
        That the tools touch; its force on the tool of a robot is ``contact`` of its `PlantRun`.
    progress : callable or bool, optional

    Returns
    -------
    ControlRun

    Raises
    ------
    ArgumentError
        An argument is out of range, or the controller does not fit.
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
    case = control_case(
        model, move, sample_time=sample_time, delay=delay, plants=plants, disturbances=disturbances,
        encoder_noise=encoder_noise, encoder_resolution=encoder_resolution, torque_limits=torque_limits,
        exact_state=exact_state, seed=seed, solution=solution, progress=tell,
    )  # fmt: skip
    if wall is not None:
        case = with_wall(case, wall, tell)
    chosen, name = case_controller(case, controller)
    return run_case(case, chosen, name, progress=tell)


def case_controller(case: Case, controller: Any) -> tuple[Controller, str]:
    """The controller for a case from what `control` takes, and its name."""
    samples = -(-len(case.reference.time) // PARTS)
    parts = case.reference.parts(samples)
    chosen, name = controller_of(controller, case.equations.model, case.sample_time, case.delay, parts, samples)
    if isinstance(chosen, ModelLaw):
        return chosen.bound(case.law_motion()), chosen.title
    if case.exact_state and isinstance(chosen, Linear):
        chosen = _beside_the_state(chosen, case.model)
    return chosen, name


def _beside_the_state(controller: Linear, model: RobotModel) -> Linear:
    """A linear controller of motor angles and sensors, in a loop that measures the exact state after them."""
    A, B, C, D = controller.matrices
    used, states = model.n_m + sum(len(s.channels) for s in model.sensors), 2 * (model.n_a + model.n_m)
    if not B.shape[-1] == D.shape[-1] == used:
        return controller
    B, D = (np.concatenate([x, np.zeros((*x.shape[:2], states))], axis=2) for x in (B, D))
    return Linear(A, B, C, D, controller.samples)


def control_case(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    sample_time: float = SAMPLE_S,
    delay: float = 0.0,
    plants: Mapping[str, Mapping[str, float]] | None = None,
    disturbances: Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]] = (),
    encoder_noise: float = 0.0,
    encoder_resolution: float = 0.0,
    torque_limits: bool = True,
    exact_state: bool = False,
    seed: int = 0,
    solution: Solution | None = None,
    progress: Callable[[str], None] | None = None,
) -> Case:
    """The same without a controller: solve the move, make the robots, find their rest positions; see `control`."""
    tell = progress or (lambda line: None)
    robot = robot_of(model)
    _check_times(sample_time, delay)
    seed = seed_of(seed)
    check_not_negative("encoder_noise", encoder_noise)
    check_not_negative("encoder_resolution", encoder_resolution)
    changed = mapping_of("plants", {} if plants is None else plants, "the changes of each plant by its name")
    if solution is None:
        tell("solving the move")
        solution = solve(robot, move, progress=progress)
    chosen, laws = split_plants(robot, plants_of(robot, {NOMINAL: {}, **changed}))
    of_lane = _of_lanes(disturbances, chosen.names)
    names = tuple(p.name for p in chosen.parameters)
    forced = any(d.where.startswith("tool.") for given in of_lane.values() for d in given)
    elastic = without_states(robot)
    felt = any(sensor.of_force for sensor in robot.sensors)
    shown = ["sensors"] if robot.sensors and not felt else []
    functions = ["forward_dynamics", *([TOOL_FORCE] if forced else []), *shown]
    library = library_with(elastic, functions, parameters=names, per_point=bool(names), progress=progress)
    nominal = derive(elastic)
    path = Path(nominal, solution.move)
    trajectory = solution.trajectory
    span = float(trajectory.time[0]), float(trajectory.time[-1])
    time = time_grid(*span, sample_time, HOLD_S, AFTER_S)
    local = LocalDynamics(derive(elastic, names))
    known = signals_of(nominal) if felt else None
    reference = motion_reference(trajectory, path, sample_time, delay, library, time, known)
    signals = RobotFunction(signals_of(local.equations, True), chosen.values, tell) if felt else None
    start, at = reference.motion["q_m"][0], reference.motion["q_a"][0]
    rests = tuple(local.rest(start, values, at) for values in chosen.values)
    limits = tuple(m.torque_max or 0.0 for m in robot.motors) if torque_limits else ()
    whole = int(delay / sample_time + 1e-9)
    rest = delay - whole * sample_time
    hardware = DriveHardware(
        sample_time, rest if rest > 1e-9 * sample_time else 0.0, encoder_resolution, encoder_noise, 0.0, limits
    )
    points = reference.points(np.unique(np.linspace(0, len(reference.time) - 1, POINTS).astype(int)))
    rate, gears = max(local.largest_rate(points, values) for values in chosen.values), None
    if laws:
        pairs = zip(chosen.values, laws, strict=True)
        rate = max(largest_rate(local, points, reference.motion, values, law) for values, law in pairs)
        gears = hysteretic_robots(local.equations.pushed if forced else local.equations, chosen.values, laws, tell)
    case = Case(
        robot, solution, chosen, reference, hardware, whole, of_lane, library, rests, rate, seed, nominal, exact_state
    )
    return replace(case, gears=gears, signals=signals, laws=laws)


def with_wall(case: Case, wall: Wall, progress: Callable[[str], None] | None) -> Case:
    """The case of robots whose tools touch a wall, with integration steps that are short enough for it."""
    for q_a, _ in case.rests:
        check_start(wall, case.equations, q_a)
    tell, names = progress or (lambda line: None), tuple(p.name for p in case.plants.parameters)
    elastic = case.equations.model
    functions = dict.fromkeys((*case.library.functions, TOOL_FORCE))
    library = library_with(elastic, [*functions], parameters=names, per_point=bool(names), progress=progress)
    local, reference = LocalDynamics(derive(elastic, names)), case.reference
    points = reference.points(np.unique(np.linspace(0, len(reference.time) - 1, POINTS).astype(int)))
    normal = np.zeros((len(points[0]), elastic.dof))
    jacobians = evaluate(case.equations.function("jacobian"), points[0])[0].reshape(-1, 6, elastic.n_a)
    normal[:, : elastic.n_a] = np.einsum("i,kij->kj", in_world(wall, elastic)[1], jacobians[:, :3])
    pushing, rate = normal[:, :, None] * normal[:, None], 0.0
    for values in case.plants.values:
        M, D, K, _ = local.matrices(points, values)
        rate = max(rate, largest_eigenvalue(M, D + wall.damping * pushing, K + wall.stiffness * pushing))
    gears = hysteretic_robots(local.equations.pushed, case.plants.values, case.laws, tell) if case.laws else case.gears
    return replace(case, library=library, rate=WALL_STEPS * np.hypot(rate, case.rate), gears=gears, wall=wall)


def run_case(
    case: Case,
    controller: Controller,
    name: str,
    *,
    steps: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> ControlRun:
    """Simulate all robots of a case under a controller."""
    reference, robot = case.reference, case.model
    lanes, n = len(case.plants.names), len(reference.time)
    q_a, tau = (np.array(x) for x in zip(*case.rests, strict=True))
    q_m = np.tile(reference.motion["q_m"][0], (lanes, 1))
    loop = ClosedLoop(
        robot, case.library, case.hardware, controller, q_a, q_m, case.rate, seed=case.seed, steps=steps,
        parameters=case.gears or (case.plants.values if case.plants.parameters else None),
        sensors=_channels(robot, case.hardware.sample_s, case.signals) if robot.sensors else None,
        delay_samples=case.delay_samples, arm_reference=True, exact_state=case.exact_state,
    )  # fmt: skip
    loop.hold(tau)
    if case.wall is not None:
        numbers = np.tile(numbers_of(case.wall, case.model), (lanes, 1))
        loop.touch(RobotFunction(wall_force(case.equations), numbers, progress or (lambda line: None)))
    known = reference.rows(case.exact_state)
    rows = np.ascontiguousarray(np.broadcast_to(known[:, None], (n, lanes, loop.setup.n_ref)))
    step_s = case.hardware.sample_s / loop.steps
    motions, torques, shown, signals = [], [], [], []
    began = perf_counter()
    for first in range(0, n, CHUNK):
        check_time("control")
        count = min(CHUNK, n - first)
        instants = reference.time[first] + step_s * (np.arange(count * loop.steps) + 0.5)
        names = [m.name for m in robot.motors]
        table = disturbance_table(case.disturbances, names, instants, lanes, case.seed)
        found = loop.run(rows, count, motion=True, disturbances=table, check=False)
        assert found.motion is not None
        motions.append(found.motion)
        torques.append(found.tau_m)
        shown.append(found.q_m)
        signals.append(found.sensors if found.sensors is not None else np.zeros((count, lanes, 0)))
        if progress is not None:
            progress(
                f"simulating {lanes} robots, {100 * (first + count) / n:.0f} % of {n * case.hardware.sample_s:.1f} s"
            )
    seconds = perf_counter() - began
    motion, tau_m, q_m, y_s = (np.concatenate(x) for x in (motions, torques, shown, signals))
    ends = np.cumsum([robot.n_a, robot.n_a, robot.n_m, robot.n_m])
    runs = []
    for lane, plant in enumerate(case.plants.names):
        arm, speeds, motors, _, _ = np.split(motion[:, :, lane], ends, axis=1)
        error, turn = output_errors(case.equations, reference, np.ascontiguousarray(arm))
        stopped = int(loop.saturated[lane]), loop.failures[lane]
        seen = q_m[:, lane], y_s[:, lane]
        touched = None if case.wall is None else contact_force(case.wall, case.equations, arm, speeds)
        load = case.plants.loads[lane]
        runs.append(PlantRun(plant, arm, motors, tau_m[:, lane], error, turn, *stopped, *seen, load, touched))
    return ControlRun(
        robot, case.solution, name, controller, reference, case.hardware, case.delay_samples, tuple(runs), loop.steps,
        seconds,
    )  # fmt: skip


def _channels(robot: RobotModel, sample_s: float, signals: RobotFunction | None = None) -> SensorChannels:
    """The sensors of the model file; ArgumentError where one is slower than the drives."""
    noise: list[float] = []
    late: list[int] = []
    for sensor in robot.sensors:
        if sensor.sample_s is not None and abs(sensor.sample_s - sample_s) > 1e-9 * sample_s:
            raise ArgumentError(
                f"sensor {sensor.name}: given sample_s = {sensor.sample_s} s, expected {sample_s} s as the controller"
            )
        whole = round(sensor.delay_s / sample_s)
        if abs(whole * sample_s - sensor.delay_s) > 1e-6 * sample_s:
            raise ArgumentError(
                f"sensor {sensor.name}: given delay_s = {sensor.delay_s} s, expected a multiple of {sample_s} s"
            )
        noise += sensor.noises
        late += [whole] * len(sensor.channels)
    none = np.zeros(len(noise))
    return SensorChannels(np.array(noise), none, none, np.array(late, int), signals)


def _of_lanes(
    given: Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]], names: Sequence[str]
) -> dict[int, tuple[Disturbance, ...]]:
    """Disturbances of each robot by its number."""
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in names]
        if unknown:
            raise ArgumentError(f"disturbances: given plant {unknown[0]!r}, expected one of {', '.join(names)}")
        return {k: _check_disturbances(given.get(name, ())) for k, name in enumerate(names)}
    return dict.fromkeys(range(len(names)), _check_disturbances(given))


def _check_disturbances(given: Iterable[Disturbance]) -> tuple[Disturbance, ...]:
    """Disturbances as a tuple; ArgumentError for something else."""
    found = tuple(given) if isinstance(given, Iterable) else (None,)
    if not all(isinstance(each, Disturbance) for each in found):
        raise ArgumentError(f"disturbances: given {given!r}, expected objects of flexgen.Disturbance")
    return found


def _check_times(sample_time: float, delay: float) -> None:
    """ArgumentError where the times of a controller are out of range."""
    if not (is_number(sample_time) and 1e-6 <= sample_time <= 1.0):
        raise ArgumentError(f"sample_time: given {sample_time!r}, expected 1e-6 to 1 s")
    if not (is_number(delay) and 0 <= delay <= 64 * sample_time):
        raise ArgumentError(f"delay: given {delay!r}, expected 0 to 64 samples of {sample_time} s")
