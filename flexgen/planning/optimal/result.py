"""From the unknowns of the nonlinear program to a verified Solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import casadi as ca
import numpy as np

from flexgen.base.display import both_measured
from flexgen.base.errors import SolverError
from flexgen.base.files.trajectory_files import common_unit
from flexgen.base.motion.torque_curve import POLYNOMIALS, SAMPLES
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.nlp import NlpResult
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.dynamics.mechanics.statics import reach
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.verification import path_distance, plan_error
from flexgen.inversion.problem.motor_side import MotorMotion, gear_torques
from flexgen.inversion.solution import Solution, limit_warnings, relative_residual
from flexgen.paths.force import tool_force
from flexgen.paths.path import Path
from flexgen.planning.optimal import reference_curve
from flexgen.planning.optimal.blocks import Program
from flexgen.planning.optimal.force import PlanForce
from flexgen.planning.optimal.phase import Phase
from flexgen.planning.optimal.transcribe import Layout
from flexgen.simulation.integration.hold import command_in
from flexgen.simulation.simulate import simulate

# relative: largest error of the energy balance of a simulation that verifies something
ENERGY = 1e-7
# relative, between the collocation points: largest of a solution that is not simulated
RESIDUAL = 1e-2
# of a bound, of the range of what is bounded: largest excess between the points
EXCESS = 1e-2
RANGE = 1e-3
MOVING = 1e-9  # of the largest speed: below it the motion starts at rest
# of what a row changes by where the unknowns change by their scales: a change that does not matter
SMALL = 1e-6
# s: distance of the instants at which a solution is checked; most on an interval
CLOSE = 1e-3
MOST = 1000
FAR = 1.5  # times the accuracy: a larger distance from the reference is stated as a status


class Problem(Protocol):
    """Data of the problem for its solution; see `flexgen.planning.optimal.problem.PlanProblem`."""

    equations: Equations
    path: Path
    timing: str
    push: PlanForce | None

    @property
    def tracks(self) -> bool:
        """Whether the user tracks the reference."""
        ...

    @property
    def keeps_model_limits(self) -> bool:
        """Whether the limits of the model file are bounds."""
        ...

    def reference_at(self, phase: Phase) -> Callable[[np.ndarray], np.ndarray]:
        """Targets of the output at relative times of a phase."""
        ...


@dataclass(frozen=True)
class Samples:
    """A planned motion at n instants: coordinates and derivatives (n, mesh.n), torques (n, n_m),
    theta.
    """

    t: np.ndarray
    y: np.ndarray
    dy: np.ndarray
    ddy: np.ndarray
    tau: np.ndarray
    theta: np.ndarray


def samples(layout: Layout, phase: Phase, x: np.ndarray, places: np.ndarray) -> Samples:
    """The motion of a phase at the relative ``places`` (p,) of each interval, in SI units, from
    the unknowns x: accelerations and torques are polynomials on an interval, and integrated.
    """
    mesh = phase.mesh
    number = phase.number
    theta = x[layout.theta]
    T = theta[number]
    begin = float(theta[:number].sum())
    y, dy, ddy, tau = mesh.unpack(x[layout.first[number] : layout.first[number] + mesh.size])
    once, twice = mesh.table.weights(places)
    lagrange = mesh.table.lagrange(places)
    h = mesh.h[:, None, None]
    at = (
        y[:-1, None]
        + h * places[:, None] * dy[:-1, None]
        + h**2 * np.einsum("pj,njk->npk", twice, ddy)
    )
    rate = dy[:-1, None] + h * np.einsum("pj,njk->npk", once, ddy)
    rows = [
        at,
        rate / T,
        np.einsum("pj,njk->npk", lagrange, ddy) / T**2,
        np.einsum("pj,njk->npk", lagrange, tau),
    ]
    t = begin + T * (mesh.nodes[:-1, None] + mesh.h[:, None] * places)
    y, dy, ddy, tau = (row.reshape(len(t) * len(places), -1) for row in rows)
    return Samples(t.ravel(), y, dy, ddy, tau, theta)


def _join(parts: list[Samples]) -> Samples:
    t, y, dy, ddy, tau = (
        np.concatenate([getattr(p, x) for p in parts]) for x in ("t", "y", "dy", "ddy", "tau")
    )
    return Samples(t, y, dy, ddy, tau, parts[0].theta)


def _all_motors(equations: Equations, part: np.ndarray) -> np.ndarray:
    """Angles (k, n_m) of all motors, or their derivatives, from those of the coordinates (k, dof):
    geared motors follow the arm.
    """
    model = equations.model
    out = part[:, list(model.i_g)] @ model.eta.T
    out[:, list(model.i_m)] = part[:, model.n_a : model.dof]
    return np.asarray(out)


def make_solution(
    problem: Problem,
    layout: Layout,
    made: Program,
    found: NlpResult,
    x: np.ndarray,
    accuracy: float,
    verify: bool,
    progress: Callable[[str], None] | None,
) -> Solution:
    """The solution of a problem, simulated where IPOPT converged; its times are zero."""
    if not np.isfinite(x).all():
        worst = describe_worst(made, found, x, layout)
        raise SolverError(
            f"plan: IPOPT ended with {found.status!r} and numbers that are not finite; {worst}"
        )
    equations = problem.equations
    phases = layout.phases
    places = np.arange(SAMPLES) / SAMPLES
    parts = [samples(layout, phase, x, places) for phase in phases]
    last = samples(layout, phases[-1], x, np.ones(1))
    end = Samples(last.t[-1:], last.y[-1:], last.dy[-1:], last.ddy[-1:], last.tau[-1:], last.theta)
    motion = _join([*parts, end])
    trajectory, tracked = _trajectory(problem, layout, motion)
    between = _join(
        [samples(layout, phase, x, _between(phase, x[layout.theta])) for phase in phases]
    )
    residual = _residual(equations, between, problem.push)
    command = command_in(
        trajectory.time, trajectory["tau_m"], trajectory.labels["tau_m"], trajectory.meta
    )
    total = float(motion.t[-1])
    solution = Solution(
        model=equations.model,
        move=replace(problem.path.move, duration=total),
        method="plan",
        status=Status.SOLVED if found.success else Status.TOLERANCE_NOT_MET,
        verdict=found.status
        if found.success
        else f"{found.status}; {describe_worst(made, found, x, layout)}",
        trajectory=trajectory,
        residual_max_Nm=float(residual.max()),
        residual_relative=relative_residual(equations, trajectory, residual),
        iterations=found.iterations,
        wall_s=0.0,
        cpu_s=0.0,
        preactuation_s=0.0,
        simulation=None,
        warnings=limit_warnings(equations.model, trajectory) if problem.keeps_model_limits else (),
        intervals=sum(phase.mesh.N for phase in phases),
        torque_command=command,
        details=_details(problem, layout, x, found, made),
    )
    if found.success:
        solution = _check_bounds(problem, layout, made, between, solution)
        solution = _verify(problem, solution, accuracy, verify, tracked, progress)
    return solution


def _between(phase: Phase, theta: np.ndarray) -> np.ndarray:
    """Relative places on each interval at which a solution is checked, `CLOSE` in time."""
    longest = float(theta[phase.number] * phase.mesh.h.max())
    count = int(np.clip(np.ceil(longest / CLOSE), SAMPLES, MOST))
    return (np.arange(count) + 0.5) / count


def _residual(equations: Equations, at: Samples, push: PlanForce | None) -> np.ndarray:
    """Largest residual of each equation of motion (dof,) between the collocation points, by the
    Lagrangian.
    """
    n_a = equations.model.n_a
    i_m = list(equations.model.i_m)
    motion = [
        x for part in (at.y, at.dy, at.ddy) for x in (part[:, :n_a], _all_motors(equations, part))
    ]
    q_a, q_m, v_a, v_m, a_a, a_m = motion
    force = [] if push is None else [push.at(at.y[:, -1])]
    pushed = equations if push is None else equations.pushed
    r_a, r_m = evaluate(pushed.function("residual"), q_a, v_a, a_a, q_m, v_m, a_m, at.tau, *force)
    n = len(at.t)
    return np.asarray(
        np.abs(np.hstack([r_a.reshape(n, -1), r_m.reshape(n, -1)[:, i_m]])).max(axis=0)
    )


def describe_worst(made: Program, found: NlpResult, x: np.ndarray, layout: Layout) -> str:
    """The sentence with the largest violated constraint by name."""
    excess = np.maximum(np.maximum(made.lower - found.g, found.g - made.upper), 0.0)
    k = int(np.argmax(np.where(np.isfinite(excess), excess, np.inf)))
    if excess[k] <= 1e-9:
        return (
            "all constraints hold, the cost is not at its minimum; raise max_iterations or "
            "change the guess"
        )
    when = ""
    if np.isfinite(made.times[k]).all():
        number = int(made.times[k, 0])
        sigma = made.times[k, 1]
        theta = x[layout.theta]
        when = f" at t = {theta[:number].sum() + theta[number] * sigma:.4g} s"
    return (
        f"the largest violated constraint is {made.names[k]!r}, by "
        f"{excess[k] / made.scale[k]:.3g}{when}"
    )


def _details(
    problem: Problem, layout: Layout, x: np.ndarray, found: NlpResult, made: Program
) -> dict[str, Any]:
    """Numbers of a solution for `Solution.details`: durations [s], parameters, cost, sizes of the
    program, scheme.
    """
    theta = x[layout.theta]
    count = len(layout.phases)
    names = [symbol.name().removeprefix("p:") for symbol in layout.parameters]
    return {
        "durations_s": [float(T) for T in theta[:count]],
        "parameters": dict(zip(names, map(float, theta[count:]), strict=True)),
        "cost": float(ca.Function("cost", [made.x], [made.cost])(found.x)) / made.cost_scale,
        "unknowns": len(found.x),
        "constraints": len(found.g),
        "scheme": layout.phases[0].mesh.table.name,
    }


def _trajectory(problem: Problem, layout: Layout, motion: Samples) -> tuple[Trajectory, bool]:
    """The trajectory, and whether its reference is one that the user tracks."""
    equations = problem.equations
    robot = problem.equations.model
    t = motion.t
    n_a = robot.n_a
    i_g = list(robot.i_g)
    arm = [part[:, :n_a] for part in (motion.y, motion.dy, motion.ddy)]
    q_m, v_m, a_m = (_all_motors(equations, part) for part in (motion.y, motion.dy, motion.ddy))
    motors = MotorMotion(q_m, v_m, a_m, motion.tau)
    tau_g = gear_torques(equations, arm[0], arm[1], arm[2], motors)
    y = evaluate(equations.function("output"), arm[0])[0].reshape(len(t), -1)
    R = evaluate(equations.function("forward_kinematics"), arm[0])[1].reshape(len(t), 9)
    tracked = problem.tracks
    if tracked:
        if problem.timing == "free":
            target = reference_curve.targets_at(problem.path, motion.y[:, -1])
        else:
            target = _targets(problem, layout, motion)
        y = target[:, : y.shape[1]]
        R = (
            target[:, 3:].reshape(-1, 3, 3).transpose(0, 2, 1).reshape(-1, 9)
            if target.shape[1] == 12
            else R
        )
    names_a = tuple(c.name for c in robot.coordinates)
    names_m = tuple(m.name for m in robot.motors)
    of_a = tuple(c.unit for c in robot.coordinates)
    of_g = tuple(robot.coordinates[i].unit for i in i_g)
    labels = output_labels(robot)
    rows: list[tuple[str, np.ndarray, tuple[str, ...], str, tuple[str, ...]]] = [
        (f"{x}_a", value, tuple(u + end for u in of_a), "arm coordinates, planned", names_a)
        for x, value, end in zip("qva", arm, ("", "/s", "/s^2"), strict=True)
    ]
    rows += [
        (f"{x}_m", value, ("rad" + end,) * robot.n_m, "motor angles, motor side", names_m)
        for x, value, end in zip(
            "qva", (motors.q_m, motors.v_m, motors.a_m), ("", "/s", "/s^2"), strict=True
        )
    ]
    force = tuple("N m" if u == "rad" else "N" for u in of_g)
    rows.append(
        ("tau_m", motors.tau_m, ("N m",) * robot.n_m, "motor torques, motor side", names_m)
    )
    rows.append(("tau_g", tau_g, force, "gear torques, arm side", tuple(names_a[i] for i in i_g)))
    rows.append(("y_ref", y, output_units(robot), "reference output", labels["y_ref"]))
    if "R_ref" in labels:
        rows.append(
            ("R_ref", R, ("-",) * 9, "reference orientation, rows of the matrix", labels["R_ref"])
        )
    if problem.push is not None:
        doc = "force and torque on the tool, world axes"
        rows.append(
            (
                tool_force.CHANNEL,
                problem.push.at(motion.y[:, -1]),
                tool_force.UNITS,
                doc,
                tool_force.LABELS,
            )
        )
    units = {name: unit for name, _, unit, _, _ in rows}
    meta = {
        "model": robot.name,
        "variant": robot.variant,
        "move": problem.path.move.name,
        "kind": "plan",
    }
    torque = {"torque": "limited", POLYNOMIALS: layout.phases[0].mesh.s - 1}
    return Trajectory(
        t,
        {name: value for name, value, *_ in rows},
        {
            name: Port(name, (value.shape[1],), common_unit(units[name]), doc)
            for name, value, _, doc, _ in rows
        },
        {name: label for name, *_, label in rows},
        {**meta, **torque},
        units,
    ), tracked


def _targets(problem: Problem, layout: Layout, motion: Samples) -> np.ndarray:
    """Targets (k, n_t) of the output at the instants of ``motion``, by the time law of the move,
    stretched where a duration is free.
    """
    out = []
    begin = 0.0
    theta = motion.theta
    for phase in layout.phases:
        T = float(theta[phase.number])
        last = phase is layout.phases[-1]
        inside = (motion.t >= begin) & ((motion.t < begin + T * (1 - 1e-12)) | last)
        out.append(problem.reference_at(phase)((motion.t[inside] - begin) / T))
        begin += T
    return np.vstack(out)


def _check_bounds(
    problem: Problem, layout: Layout, made: Program, at: Samples, solution: Solution
) -> Solution:
    """The solution, "tolerance not met" where a constraint is violated between the collocation
    points.
    """
    begin = 0
    unit: dict[str, float] = {}
    for name, scale in zip(made.names, made.scale, strict=True):
        unit[name] = max(unit.get(name, 0.0), 1 / scale)
    for phase in layout.phases:
        rows = [(r.name, r.value, r.lower, r.upper, r.slack) for r in phase.content.rows["path"]]
        rows += [
            (f"bound of {b.name}", b.value, b.lower, b.upper, None)
            for b in phase.content.bands.values()
        ]
        places = _between(phase, at.theta)
        count = phase.mesh.N * len(places)
        part = slice(begin, begin + count)
        begin += count
        if not rows:
            continue
        symbols = [
            *phase.signals.symbols,
            *(p.duration for p in layout.phases),
            *layout.parameters,
        ]
        sigma = (phase.mesh.nodes[:-1, None] + phase.mesh.h[:, None] * places).ravel()
        reference = np.zeros((count, phase.signals.reference.numel()))
        if ca.depends_on(ca.veccat(*[row[1] for row in rows]), phase.signals.reference):
            reference = problem.reference_at(phase)(sigma)
        function = ca.Function("bounded", symbols, [ca.densify(value) for _, value, *_ in rows])
        values = evaluate(
            function,
            at.y[part],
            at.dy[part],
            at.ddy[part],
            at.tau[part],
            at.t[part][:, None],
            reference,
            *(np.full((count, 1), x) for x in at.theta),
        )
        for (name, _, low, high, slack), value in zip(rows, values, strict=True):
            value = value.reshape(count, -1)
            allowed = np.full(value.shape[1], slack or 0.0)
            if slack is None:
                bounds = [np.where(np.isfinite(x), np.abs(x), 0.0) for x in (low, high)]
                extent = np.ptp(value, axis=0)
                allowed = np.maximum(
                    EXCESS * np.maximum(*bounds),
                    RANGE * np.where(np.isfinite(extent), extent, 0.0),
                )
                allowed = np.maximum(allowed, SMALL * unit.get(name, 0.0))
            below = np.where(np.isfinite(low), low - value, -np.inf)
            above = np.where(np.isfinite(high), value - high, -np.inf)
            excess = np.maximum(below, above).max(axis=0)
            if not (excess <= allowed).all():  # NaN counts as a violation
                k = int(np.argmax(excess - allowed))
                text = (
                    f"{name!r} is violated by {excess[k]:.3g} between the collocation points; "
                    "take a finer mesh or a margin"
                )
                solution = replace(
                    solution, status=Status.TOLERANCE_NOT_MET, warnings=(*solution.warnings, text)
                )
    return solution


def _verify(
    problem: Problem,
    solution: Solution,
    accuracy: float,
    verify: bool,
    tracked: bool,
    progress: Callable[[str], None] | None,
) -> Solution:
    """The solution with its simulation, and the status that follows from it."""
    equations = problem.equations
    status = solution.status
    if not verify:
        if solution.residual_relative > RESIDUAL:
            status = Status.TOLERANCE_NOT_MET
        return replace(solution, status=status)
    speed = np.abs(np.hstack([solution.trajectory["v_a"], solution.trajectory["v_m"]]))
    simulation = simulate(
        equations, solution.trajectory, command=solution.torque_command,
        moving=bool(speed[0].max() > MOVING * speed.max()), progress=progress,
    )  # fmt: skip
    solution = replace(
        solution, simulation=simulation, warnings=(*solution.warnings, *simulation.warnings)
    )
    size = min(1.0, reach(equations))
    in_m, in_rad = plan_error(equations, solution, simulation)
    error = max((in_m or 0.0) / size, in_rad or 0.0)
    if not (error <= accuracy and simulation.energy_error <= ENERGY):
        status = Status.TOLERANCE_NOT_MET
        text = (
            f"the simulated output is up to {both_measured(in_m, in_rad)} from the planned one "
            f"(energy error {simulation.energy_error:.1e}); a finer mesh brings it closer"
        )
        solution = replace(solution, warnings=(*solution.warnings, text))
    solution = replace(solution, plan_error_max_m=in_m, plan_error_max_rad=in_rad)
    if tracked:
        off = max(
            (simulation.tool_error_max_m or 0.0) / size, simulation.tool_error_max_rad or 0.0
        )
        if status == Status.SOLVED and off > FAR * accuracy:
            status = Status.LIMITS_ACTIVE
        solution = replace(
            solution, path_distance_max_m=path_distance(equations, solution, simulation)
        )
    return replace(solution, status=status)
