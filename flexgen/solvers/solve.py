"""Solve: from a model and a move to motor torques, verified by simulating the full model forward."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from pathlib import Path as FilePath

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.analysis.index import structural_index
from flexgen.analysis.linear import linearise
from flexgen.analysis.zeros import inner_zeros, time_constants
from flexgen.errors import ArgumentError, SolverError
from flexgen.mechanics.equations import Equations, derive
from flexgen.mechanics.evaluate import evaluate
from flexgen.mechanics.statics import Equilibrium, at_rest, reach
from flexgen.model.elements import Move, RobotModel
from flexgen.ports import Port
from flexgen.problems.path import Path, PathSample
from flexgen.simulation import Simulation, output_labels, simulate, turn_angle
from flexgen.solvers.collocation import collocate
from flexgen.solvers.drives import Drives, drives
from flexgen.solvers.full import Limits, collocate_full
from flexgen.solvers.reduction import Motion, Reduction
from flexgen.solvers.solution import Solution, exceeded, has_kinks, relative_residual, residual_max
from flexgen.solvers.tableaus import gauss
from flexgen.trajectory import Trajectory

METHODS = ("auto", "closed-form", "collocation", "full")
ACCURACY = 1e-5  # m and rad: a verified error above this is refined, then called inaccurate
STEP = 1e-3  # s: the torque is sampled at least as finely, and 400 times along a short move
LONGEST = 5e-3  # s: of the intervals of a mesh, unless the move lasts for minutes
STAGES = 3
INTERVALS = 20_000  # of a mesh: more do not fit into memory for large machines
SAMPLES = 200_000  # of a closed form
DECAY = 15.0  # time constants before the path: exp(-15) of the pre-actuation is cut off
SETTLE = 6.0  # time constants after the path, for the picture only
ENERGY = 1e-7  # relative: a simulation that misses the energy balance by more proves nothing
RESIDUAL = 1e-3  # of the largest torque in its row: above it an answer is called wrong, whatever the solver says
RIPPLE = 1e-2  # the same for the full method, whose torque may ripple between the Gauss points unfelt by the tool


def solve(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    method: str = "auto",
    *,
    preview: float | None = None,
    mesh: float | None = None,
    limits: Limits | None = None,
    verify: bool = True,
    accuracy: float = ACCURACY,
    progress: Callable[[str], None] | None = None,
) -> Solution:
    """Find the motor torques that make the output follow a move.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move of the model file; default: its first.
    method : str
        ``"closed-form"`` (no non-actuated coordinates), ``"collocation"`` (optimal control on the reduced problem,
        exact path), ``"full"`` (optimal control on the full model, with limits and for complete motor coupling), or
        ``"auto"``: the first that applies, and "full" for gears whose spring has a kink or where the verification
        rejects the others.
    preview : float, optional [s]
        How long before the path the motion may begin; default: fifteen time constants of the slowest unstable zero, at
        least 4 % of the move (of half a second, if it is longer) and at most 2 s.
    mesh : float, optional [s]
        Length of the collocation intervals; default: a hundredth of the move, at most 5 ms.
    limits : Limits, optional
        Bounds on motor torque and speed; only with method "full" (which "auto" then picks).
    verify : bool
        Simulate the full model forward and measure the error; meshes that miss ``accuracy`` are refined.
    accuracy : float [rad, and m for each metre of reach, at most m]
        What the verified error of a solved move may be.
    progress : callable, optional
        Called with one line of text now and then.

    Returns
    -------
    Solution

    Raises
    ------
    ArgumentError
        Unknown move or method, or one that does not apply.
    SolverError
        No solution: the text says what happened and what to try.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    equations = model if isinstance(model, Equations) else derive(model)
    robot = equations.model
    chosen = move if isinstance(move, Move) else _find(robot, move)
    if method not in METHODS:
        raise ArgumentError(f"method: given {method!r}, expected one of {', '.join(METHODS)}")
    for name, value in (("preview", preview), ("mesh", mesh), ("accuracy", accuracy)):
        if value is None or (name == "preview" and value == 0):
            continue
        if not isinstance(value, Real) or isinstance(value, bool) or not (np.isfinite(value) and value > 0):
            what = {"preview": "zero or a positive time in s", "mesh": "a positive time in s"}.get(
                name, "a positive length"
            )
            raise ArgumentError(f"{name}: given {value!r}, expected {what}")
    if limits is not None and not isinstance(limits, Limits):
        raise ArgumentError(f"limits: given {limits!r}, expected flexgen.Limits(torque=..., speed=...)")
    if not isinstance(chosen, Move):
        raise ArgumentError(f"move: given {chosen!r}, expected the name of a move or a flexgen.Move")
    choose = method == "auto"
    if choose:
        needs_full = limits is not None or robot.motor_coupling != "simplified" or has_kinks(robot)
        method = "full" if needs_full else ("closed-form" if robot.n_e == 0 else "collocation")
    if limits is not None and method != "full":
        raise ArgumentError(
            f"limits: method {method!r} follows the path exactly and cannot respect them, expected 'full'"
        )
    if method == "closed-form" and robot.n_e:
        raise ArgumentError(
            f"method closed-form: model {robot.name} has {robot.n_e} non-actuated coordinates, use collocation"
        )
    path = Path(equations, chosen)
    ask = _Question(equations, path, preview, mesh, limits, verify, accuracy, progress)
    solution = _refined(ask, method)
    if choose and solution.status == "inaccurate" and method != "full":
        ask.tell(f"method {method} missed the path: trying the full model")
        try:
            other = _refined(ask, "full")
            solution = other if other.status != "inaccurate" else solution
        except SolverError as error:  # what was found before is worth more than nothing
            ask.tell(f"the full model did not help: {error}")
    return replace(solution, wall_s=time.perf_counter() - wall, cpu_s=time.process_time() - cpu)


@dataclass(frozen=True)
class _Question:
    """What `solve` was asked, checked."""

    equations: Equations
    path: Path
    preview: float | None
    mesh: float | None
    limits: Limits | None
    verify: bool
    accuracy: float
    progress: Callable[[str], None] | None

    @cached_property
    def windows(self) -> tuple[float, float]:
        """How long before the path to begin and after it to end [s]."""
        return windows(self.equations, self.path)

    @cached_property
    def too_rough(self) -> tuple[str, ...]:
        """A warning where the time law is not smooth enough for a continuous torque."""
        index, move = structural_index(self.equations).index, self.path.move
        if index is None or move.smoothness >= index - 1:
            return ()
        return (
            f"move {move.name}: smoothness {move.smoothness} makes the torque jump at its ends; "
            f"a continuous torque needs {index - 1} (structural index less one)",
        )

    @cached_property
    def rest(self) -> Equilibrium:
        """Where the machine rests before it begins, by statics alone."""
        equations, model = self.equations, self.equations.model
        if self.path.move.type == "joint" and model.n_e == 0:
            return at_rest(equations, self.path.q_start)
        simple = Equations(replace(model, motor_coupling="simplified"))
        return at_rest(equations, Reduction(simple).start(self.path).q_a)

    def tell(self, text: str) -> None:
        if self.progress is not None:
            self.progress(text)


def _refined(ask: _Question, method: str) -> Solution:
    """One method, on finer meshes until its answer is verified."""
    duration = ask.path.duration
    h = max(min(duration / 100, LONGEST), duration / (INTERVALS / 4)) if ask.mesh is None else float(ask.mesh)
    attempts = 1 if (ask.mesh is not None or method == "closed-form" or not ask.verify) else 3
    for attempt in range(attempts):
        solution = _once(ask, method, h / 2**attempt)
        if not ask.verify:
            _judge(solution)
            return solution
        simulation = simulate(ask.equations, solution.trajectory, start=ask.rest, progress=ask.progress)
        plan = _plan_error(ask.equations, solution, simulation) if solution.status == "limited" else None
        size = min(1.0, reach(ask.equations))
        worst = max((simulation.tool_error_max_m or 0.0) / size, simulation.tool_error_max_rad or 0.0)
        worst = worst if plan is None else plan / size
        right = worst <= ask.accuracy and simulation.energy_error <= ENERGY
        status = solution.status if right else "inaccurate"
        solution = replace(solution, simulation=simulation, status=status, plan_error_max=plan)
        if right:
            break
        if attempt + 1 < attempts:
            ask.tell(f"verified error {worst:.2e} is above {ask.accuracy:.0e}: halving the mesh")
    return solution


def _plan_error(equations: Equations, solution: Solution, simulation: Simulation) -> float:
    """How far the simulated output is from the planned one, which limits keep off the reference [m or rad]."""
    both = (solution.trajectory, simulation.trajectory)
    planned, found = (evaluate(equations.function("output"), t["q_a"])[0] for t in both)
    worst = float(np.abs(planned - found).max())
    if equations.model.output.type == "tool_pose":
        R, S = (evaluate(equations.function("forward_kinematics"), t["q_a"])[1] for t in both)
        worst = max(worst, float(turn_angle(S, R).max()))
    return worst


def _judge(solution: Solution) -> None:
    """Without a verification the residual alone decides; SolverError where it is too large to be believed."""
    worst = solution.residual_relative
    if not worst <= (RIPPLE if solution.method == "full" else RESIDUAL):
        raise SolverError(
            f"method {solution.method}: the answer does not satisfy the equations of motion between its samples: "
            f"residual {solution.residual_max_Nm:.3g} N m, in one row {worst:.1e} of the torque there; "
            "verify it, or try a finer --mesh or a smoother move"
        )


def _find(robot: RobotModel, name: str | None) -> Move:
    try:
        return robot.move(name)
    except KeyError:
        names = ", ".join(m.name for m in robot.moves) or "none"
        raise ArgumentError(f"move: given {name!r}, model {robot.name} has: {names}") from None


def _once(ask: _Question, method: str, h: float) -> Solution:
    """One method on one mesh, not verified."""
    equations, path, limits, progress = ask.equations, ask.path, ask.limits, ask.progress
    robot = equations.model
    if method == "full":
        lead, nodes = _nodes(ask, 2 * h)
        answer = collocate_full(equations, path, nodes, limits, progress=progress)
        trajectory = _trajectory(ask, answer.t, answer.motion, answer.drives)
        status = "limited" if answer.limited else "solved"
        return _solution(ask, method, status, answer.nlp.status, answer.nlp.iterations, lead, trajectory)
    if method == "closed-form":
        n = int(min(np.ceil(path.duration / _step(path)), SAMPLES))
        t = np.linspace(0.0, path.duration, n + 1)
        sample = path.sample(t)
        reduction = Reduction(equations)
        if sample.q_g is not None:
            motion = reduction.joint_motion(sample.q_g)
        else:
            q = reduction.close(reduction.follow(path, t, reduction.start(path).q_a), reduction.targets(sample))
            found, _ = reduction.motion(sample, q, np.zeros((len(t), 0)))
            if found is None:
                raise SolverError(f"move {path.move.name}: the path passes a singular pose; choose another path")
            motion = found
        trajectory = _trajectory(ask, t, motion)
        return _solution(ask, method, "solved", "", 0, 0.0, trajectory)
    reduction = Reduction(equations)
    lead, nodes = _nodes(ask, h)
    answer_r = collocate(reduction, path, nodes, stages=STAGES, progress=progress)
    parts = max(1, int(np.ceil(np.diff(nodes).max() / _step(path) - 1e-9)))
    t, q_e, v_e, guess = answer_r.dense(gauss(STAGES), parts)
    sample = path.sample(t)
    guess[:, list(robot.i_e)] = q_e
    q = reduction.close(guess, reduction.targets(sample))
    nlp = answer_r.nlp
    found, doubtful = reduction.motion(sample, q, v_e)
    answers = []
    for candidate in (found, _read_off(reduction, sample, t, q, nodes, answer_r.q_e) if doubtful else None):
        if candidate is not None:
            trajectory = _trajectory(ask, t, candidate)
            answers.append(_solution(ask, method, "solved", nlp.status, nlp.iterations, lead, trajectory))
    return min(answers, key=lambda answer: answer.residual_max_Nm)


def _step(path: Path) -> float:
    """The sampling interval of the torque [s]."""
    return min(STEP, path.duration / 400)


def _read_off(
    reduction: Reduction, sample: PathSample, t: np.ndarray, q: np.ndarray, nodes: np.ndarray, q_e: np.ndarray
) -> Motion:
    """The motion with the derivatives of the non-actuated coordinates read off the solution itself, by a spline."""
    # it was at rest before: without samples from then a spline's derivatives are poor at its end
    before = nodes[0] - (nodes[1] - nodes[0]) * np.arange(8, 0, -1)
    smooth = make_interp_spline(np.r_[before, nodes], np.vstack([np.tile(q_e[0], (len(before), 1)), q_e]), k=7)
    q = q.copy()
    q[:, reduction.i_e] = smooth(t)
    return reduction.motion_through(
        sample, reduction.close(q, reduction.targets(sample)), [smooth(t, k) for k in (1, 2, 3, 4)]
    )


def windows(equations: Equations, path: Path) -> tuple[float, float]:
    """How long before the path to begin and after it to end [s], from the zeros at five poses along the path.

    Rotors that turn with their carriers move the zeros a little; for this estimate they do not turn.
    """
    scale = min(path.duration, 0.5)
    if equations.model.n_e == 0:
        return 0.1 * scale, 0.1 * scale
    if equations.model.motor_coupling != "simplified":
        equations = Equations(replace(equations.model, motor_coupling="simplified"))
    reduction = Reduction(equations)
    before, after = 0.0, 0.0
    poses = reduction.follow(path, np.linspace(0.0, path.duration, 65), reduction.start(path).q_a)
    for q in poses[::16]:
        rest = at_rest(equations, q)
        unstable, stable = time_constants(inner_zeros(equations, linearise(equations, rest), rest))
        before, after = max(before, unstable), max(after, stable)
    lead, settle = np.clip(DECAY * before, 0.04 * scale, 2.0), np.clip(SETTLE * after, 0.1 * scale, 0.6 * scale)
    return float(lead), float(settle)


def _nodes(ask: _Question, h: float) -> tuple[float, np.ndarray]:
    """How long before the path the mesh begins [s], and its nodes."""
    lead, settle = ask.windows
    early = max(2 * lead / DECAY, h / 5)  # two time constants of what grows there
    if ask.preview is not None:
        lead = float(ask.preview)
    return lead, _mesh(lead, early, ask.path.duration, settle, h)


def _mesh(lead: float, early: float, duration: float, settle: float, h: float) -> np.ndarray:
    """Nodes, the ends of the path among them: intervals of h on it, 2 h after it, 2 h or ``early`` before it."""
    spans = [(-lead, 0.0, min(2 * h, early)), (0.0, duration, h), (duration, duration + settle, 2 * h)]
    counts = [max(1, int(np.ceil((b - a) / d - 1e-9))) if b > a else 0 for a, b, d in spans]
    if sum(counts) > INTERVALS:
        raise ArgumentError(
            f"mesh: given {h:.3g} s, which makes {sum(counts)} intervals over {lead + duration + settle:.3g} s, "
            f"expected at most {INTERVALS}; take a coarser --mesh, a shorter --preview or a shorter move"
        )
    parts = [np.linspace(a, b, n + 1) for (a, b, _), n in zip(spans, counts, strict=True) if n]
    return np.unique(np.concatenate(parts))


def _trajectory(ask: _Question, t: np.ndarray, motion: Motion, motors: Drives | None = None) -> Trajectory:
    equations, path = ask.equations, ask.path
    robot = equations.model
    d = motors or drives(equations, t, motion.q, motion.v, motion.a, motion.tau_g)
    sample = path.sample(t)
    names_a = tuple(c.name for c in robot.coordinates)
    names_m = tuple(m.name for m in robot.motors)
    names_g = tuple(names_a[i] for i in robot.i_g)
    output = robot.output
    unit = output.unit if output.type == "combination" else "m"
    reference = output_labels(robot)
    rows: list[tuple[str, np.ndarray, str, str, tuple[str, ...]]] = [
        ("q_a", motion.q, "rad or m", "arm coordinates", names_a),
        ("v_a", motion.v, "rad/s or m/s", "their speeds", names_a),
        ("a_a", motion.a, "rad/s^2 or m/s^2", "their accelerations", names_a),
        ("q_m", d.q_m, "rad", "motor angles, motor side", names_m),
        ("v_m", d.v_m, "rad/s", "motor speeds, motor side", names_m),
        ("a_m", d.a_m, "rad/s^2", "motor accelerations, motor side", names_m),
        ("tau_m", d.tau_m, "N m", "motor torques, motor side", names_m),
        ("tau_g", motion.tau_g[:, :, 0], "N m", "gear torques, arm side", names_g),
        ("y_ref", sample.y[:, :, 0], unit, "reference output", reference["y_ref"]),
    ]
    if sample.R is not None:
        matrix, doc = sample.R.reshape(len(t), 9), "reference orientation, rows of the matrix"
        rows.append(("R_ref", matrix, "-", doc, reference["R_ref"]))
    return Trajectory(
        t,
        {name: values for name, values, *_ in rows},
        {name: Port(name, (values.shape[1],), unit, doc) for name, values, unit, doc, _ in rows},
        {name: labels for name, *_, labels in rows},
        {
            "model": robot.name,
            "variant": robot.variant,
            "move": path.move.name,
            "kind": "solution",
            "torque": "smooth" if ask.limits is None else "limited",
        },
    )


def _solution(
    ask: _Question, method: str, status: str, verdict: str, iterations: int, lead: float, trajectory: Trajectory
) -> Solution:
    equations, path = ask.equations, ask.path
    residual = residual_max(equations, trajectory)
    if not np.isfinite(residual):
        raise SolverError(f"method {method}: the answer is not finite; try another --mesh or a smoother move")
    return Solution(
        model=equations.model,
        move=path.move,
        method=method,
        status=status,
        verdict=verdict,
        trajectory=trajectory,
        residual_max_Nm=residual,
        residual_relative=relative_residual(equations, trajectory),
        iterations=iterations,
        wall_s=0.0,
        cpu_s=0.0,
        lead_s=lead,
        simulation=None,
        warnings=(*exceeded(equations.model, trajectory), *ask.too_rough),
    )
