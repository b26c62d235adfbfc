"""Parts of a closed loop along a move: feedforward, robots, references, drives, what acts on the
robots.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.analysis.second_order import largest_rate as largest_eigenvalue
from flexgen.base.calls.deadline import check_time, each_in_time
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import check_not_negative, is_number, mapping_of, seed_of
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.hysteresis.lugre import without_states
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.hysteresis import (
    States,
    hysteretic_robots,
    largest_rate,
    split_plants,
)
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.plants import NOMINAL, LocalDynamics, Plants, plants_of
from flexgen.feedback.loop.reference import MotionReference, motion_reference, time_grid
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import Move, RobotModel
from flexgen.paths.force.process_force import CHANNEL, ProcessForce, make_force
from flexgen.paths.path import Path
from flexgen.simulation.environment.disturbances import Disturbance
from flexgen.simulation.environment.robot_function import RobotFunction
from flexgen.simulation.environment.sense import signals_of
from flexgen.simulation.environment.wall import Wall, check_start, in_world

HOLD_S = 2.0  # at rest before the motion: integral parts settle
AFTER_S = 0.5
SAMPLE_S = 5e-4
POINTS = 40  # of the reference where eigenvalues are computed
WALL_STEPS = 4.0  # times as short as the fastest eigenvalue needs
TOOL_FORCE = "forward_dynamics_tool_force"


@dataclass(frozen=True)
class Case:
    """Parts of a closed loop, ready to run with any controller.

    ``plants``, ``library``, ``equations``: of the springs and dampers; ``gears``: the robots with
    their hysteresis; ``signals``: of sensors that feel the force on the tool; ``laws``: of the
    hysteresis; ``force``: of a process, which acts on all tools.
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
    force: ProcessForce | None = None

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
            eq.model,
            eq,
            self.solution.trajectory,
            self.reference,
            self.sample_time,
            self.delay,
            self.exact_state,
            self.rate,
        )


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
    force: Any = None,
    progress: Callable[[str], None] | None = None,
) -> Case:
    """Prepare a case of `control` without a controller: solve the move, make the robots, find
    their rest positions and the reference; see `control` for the parameters.

    A delay is split into whole samples, which the loop counts, and a rest of a sample, which the
    drives have. The longest integration step follows from the fastest eigenvalue of all robots
    along the motion.
    """
    tell = progress or (lambda line: None)
    robot = robot_of(model)
    _check_times(sample_time, delay)
    seed = seed_of(seed)
    check_not_negative("encoder_noise", encoder_noise)
    check_not_negative("encoder_resolution", encoder_resolution)
    changed = mapping_of(
        "plants", {} if plants is None else plants, "the changes of each plant by its name"
    )
    if solution is None:
        tell("solving the move")
        solution = solve(robot, move, progress=progress)
        check_time("solving the move")
    chosen, laws = split_plants(robot, plants_of(robot, {NOMINAL: {}, **changed}))
    of_lane = _of_lanes(disturbances, chosen.names)
    names = tuple(p.name for p in chosen.parameters)
    trajectory = solution.trajectory
    force = trajectory if force is None and CHANNEL in trajectory else force
    forced = force is not None or any(
        d.where.startswith("tool.") for given in of_lane.values() for d in given
    )
    elastic = without_states(robot)
    felt = any(sensor.of_force for sensor in robot.sensors)
    shown = ["sensors"] if robot.sensors and not felt else []
    functions = ["forward_dynamics", *([TOOL_FORCE] if forced else []), *shown]
    library = library_with(
        elastic, functions, parameters=names, per_point=bool(names), progress=progress
    )
    nominal = derive(elastic)
    path = Path(nominal, solution.move)
    process = None if force is None else make_force(force, robot, path.duration)
    span = float(trajectory.time[0]), float(trajectory.time[-1])
    time = time_grid(*span, sample_time, HOLD_S, AFTER_S)
    check_time("reference of the move")
    local = LocalDynamics(derive(elastic, names))
    known = signals_of(nominal) if felt else None
    reference = motion_reference(trajectory, path, sample_time, delay, library, time, known)
    signals = (
        RobotFunction(signals_of(local.equations, True), chosen.values, tell) if felt else None
    )
    if CHANNEL in trajectory:
        pushed = LocalDynamics(local.equations.pushed_by(trajectory[CHANNEL][0]))
        reference = resting(reference, pushed, chosen.values[:1])
    rests = local.under(process, time[0]).rests(reference.motion, chosen.values)
    whole = int(delay / sample_time + 1e-9)
    rest = delay - whole * sample_time
    own = DriveHardware.from_model(robot) if torque_limits else DriveHardware()
    late = rest > 1e-9 * sample_time
    limits = own.torque_max_Nm, own.torque_speed
    hardware = DriveHardware(
        sample_time, rest * late, encoder_resolution, encoder_noise, 0.0, *limits
    )
    points = reference.points(
        np.unique(np.linspace(0, len(reference.time) - 1, POINTS).astype(int))
    )
    robots = each_in_time(chosen.values, "largest eigenvalues of the robots")
    gears = None
    rate = max(local.largest_rate(points, values) for values in robots)
    if laws:
        pairs = each_in_time(zip(chosen.values, laws, strict=True), "hysteresis of the robots")
        rate = max(
            largest_rate(local, points, reference.motion, values, law) for values, law in pairs
        )
        gears = hysteretic_robots(
            local.equations.pushed if forced else local.equations, chosen.values, laws, tell
        )
    case = Case(
        robot,
        solution,
        chosen,
        reference,
        hardware,
        whole,
        of_lane,
        library,
        rests,
        rate,
        seed,
        nominal,
        exact_state,
    )
    return replace(case, gears=gears, signals=signals, laws=laws, force=process)


def resting(
    reference: MotionReference, local: LocalDynamics, nominal: np.ndarray
) -> MotionReference:
    """The reference with the torque of the equilibrium before the motion, since under a force a
    solution begins with another one.

    ``local``: the dynamics under that force; ``nominal`` (1, n_p): run-time parameters of the
    model. Only the samples in which the held torque has not yet changed are replaced.
    """
    (_, tau) = local.rests(reference.motion, nominal)[0]
    before = reference.time < reference.begin
    before &= (reference.held == reference.held[0]).all(axis=1)
    return replace(reference, held=np.where(before[:, None], tau, reference.held))


def with_wall(case: Case, wall: Wall, progress: Callable[[str], None] | None) -> Case:
    """The case of robots whose tools touch a wall, with integration steps that are short enough
    for it.

    The fastest rate is that of the robots pressed on the wall: its stiffness and damping along the
    normal are added to K and D at `POINTS` points of the motion.
    """
    for q_a, _ in case.rests:
        check_start(wall, case.equations, q_a)
    tell = progress or (lambda line: None)
    names = tuple(p.name for p in case.plants.parameters)
    elastic = case.equations.model
    functions = dict.fromkeys((*case.library.functions, TOOL_FORCE))
    library = library_with(
        elastic, [*functions], parameters=names, per_point=bool(names), progress=progress
    )
    local = LocalDynamics(derive(elastic, names))
    reference = case.reference
    points = reference.points(
        np.unique(np.linspace(0, len(reference.time) - 1, POINTS).astype(int))
    )
    normal = np.zeros((len(points[0]), elastic.dof))
    jacobians = evaluate(case.equations.function("jacobian"), points[0])[0].reshape(
        -1, 6, elastic.n_a
    )
    normal[:, : elastic.n_a] = np.einsum("i,kij->kj", in_world(wall, elastic)[1], jacobians[:, :3])
    pushing = normal[:, :, None] * normal[:, None]
    rate = 0.0
    for values in case.plants.values:
        M, D, K, _ = local.matrices(points, values)
        rate = max(
            rate, largest_eigenvalue(M, D + wall.damping * pushing, K + wall.stiffness * pushing)
        )
    gears = (
        hysteretic_robots(local.equations.pushed, case.plants.values, case.laws, tell)
        if case.laws
        else case.gears
    )
    return replace(
        case, library=library, rate=WALL_STEPS * np.hypot(rate, case.rate), gears=gears, wall=wall
    )


def _of_lanes(
    given: Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]], names: Sequence[str]
) -> dict[int, tuple[Disturbance, ...]]:
    """Disturbances of each robot by its number: the given ones for all, or by name of the robots
    ``names``, of which the others have none.
    """
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in names]
        if unknown:
            raise ArgumentError(
                f"disturbances: given plant {unknown[0]!r}, expected one of {', '.join(names)}"
            )
        return {k: _check_disturbances(given.get(name, ())) for k, name in enumerate(names)}
    return dict.fromkeys(range(len(names)), _check_disturbances(given))


def _check_disturbances(given: Iterable[Disturbance]) -> tuple[Disturbance, ...]:
    """Disturbances as a tuple; ArgumentError for something else."""
    found = tuple(given) if isinstance(given, Iterable) else (None,)
    if not all(isinstance(each, Disturbance) for each in found):
        raise ArgumentError(
            f"disturbances: given {given!r}, expected objects of flexgen.Disturbance"
        )
    return found


def _check_times(sample_time: float, delay: float) -> None:
    """ArgumentError where the times of a controller are out of range."""
    if not (is_number(sample_time) and 1e-6 <= sample_time <= 1.0):
        raise ArgumentError(f"sample_time: given {sample_time!r}, expected 1e-6 to 1 s")
    if not (is_number(delay) and 0 <= delay <= 64 * sample_time):
        raise ArgumentError(f"delay: given {delay!r}, expected 0 to 64 samples of {sample_time} s")
