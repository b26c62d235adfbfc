"""The solution of a method's result, before its verification: channels, residuals, warnings."""

from __future__ import annotations

import numpy as np

from flexgen.base.calls.deadline import check_time
from flexgen.base.errors import SolverError
from flexgen.base.files.trajectory_files import common_unit
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.solution import (
    Solution,
    limit_warnings,
    relative_residual,
    residual_rows,
)
from flexgen.simulation.simulate import HELD_KEY

# Largest relative residual of a result that is not verified.
RESIDUAL = 1e-3
# The same for the method "full", whose torque may ripple between the Gauss points.
RIPPLE = 1e-2


def residual_is_small(solution: Solution) -> bool:
    """Whether the residual between the samples is small enough for a result that is not
    verified.
    """
    return solution.status == Status.BASELINE or solution.residual_relative <= (
        RIPPLE if solution.method == "full" else RESIDUAL
    )


def _trajectory(problem: InversionProblem, method: str, result: MethodResult) -> Trajectory:
    """The result of a method as a trajectory with units and labels: motion of arm and motors,
    torques, reference output, and where they exist the force on the tool and torques of hysteresis
    and bristles.
    """
    path = problem.path
    robot = problem.equations.model
    t = result.t
    d = result.motors
    sample = path.sample_orders(t, 2)
    names_a = tuple(c.name for c in robot.coordinates)
    names_m = tuple(m.name for m in robot.motors)
    names_g = tuple(names_a[i] for i in robot.i_g)
    reference = output_labels(robot)
    of_a = tuple(c.unit for c in robot.coordinates)
    of_g = tuple("N m" if of_a[i] == "rad" else "N" for i in robot.i_g)
    rows: list[tuple[str, np.ndarray, str | tuple[str, ...], str, tuple[str, ...]]] = [
        ("q_a", result.q, of_a, "arm coordinates", names_a),
        ("v_a", result.v, tuple(f"{u}/s" for u in of_a), "their speeds", names_a),
        ("a_a", result.a, tuple(f"{u}/s^2" for u in of_a), "their accelerations", names_a),
        ("q_m", d.q_m, "rad", "motor angles, motor side", names_m),
        ("v_m", d.v_m, "rad/s", "motor speeds, motor side", names_m),
        ("a_m", d.a_m, "rad/s^2", "motor accelerations, motor side", names_m),
        ("tau_m", d.tau_m, "N m", "motor torques, motor side", names_m),
        ("tau_g", result.tau_g, of_g, "gear torques, arm side", names_g),
        ("y_ref", sample.y[:, :, 0], output_units(robot), "reference output", reference["y_ref"]),
    ]
    if sample.R is not None:
        matrix = sample.R.reshape(len(t), 9)
        doc = "reference orientation, rows of the matrix"
        rows.append(("R_ref", matrix, "-", doc, reference["R_ref"]))
    if problem.force is not None:
        rows.append(problem.force.channel(t))
    if result.tau_h is not None:
        rows.append(
            ("tau_h", result.tau_h, of_g, "torques of the gears' hysteresis, arm side", names_g)
        )
    if result.tau_b is not None:
        rows.append(
            (
                "tau_b",
                result.tau_b,
                "N m",
                "torques of the bristles of the motors' friction",
                names_m,
            )
        )
    units = {
        name: (unit,) * len(labels) if isinstance(unit, str) else unit
        for name, _, unit, _, labels in rows
    }
    return Trajectory(
        t,
        {name: values for name, values, *_ in rows},
        {
            name: Port(name, (values.shape[1],), common_unit(units[name]), doc)
            for name, values, _, doc, _ in rows
        },
        {name: labels for name, *_, labels in rows},
        {
            "model": robot.name,
            "variant": robot.variant,
            "move": path.move.name,
            "kind": "solution",
            "torque": "smooth" if problem.limits is None else "limited",
            HELD_KEY: result.held if result.status != Status.BASELINE else 0.0,
        },
        units,
    )


def make_solution(problem: InversionProblem, method: str, result: MethodResult) -> Solution:
    """The solution of a problem from the result of a method, not verified yet.

    SolverError where it is not finite. Where its samples do not resolve the steps of the friction
    at reversals, it gets more samples there.
    """
    check_time(f"residuals of method {method}")
    solution = _make_solution(problem, method, result)
    if (
        solution.residual_relative <= RESIDUAL
        or problem.limits is not None
        or result.status == Status.BASELINE
    ):
        return solution
    from flexgen.inversion.judge.reversals import with_reversals

    check_time("samples around the reversals of motors")
    finer = with_reversals(problem.equations, result, problem.force)
    if finer is None:
        return solution
    found = _make_solution(problem, method, finer)
    return found if found.residual_relative < solution.residual_relative else solution


def _make_solution(problem: InversionProblem, method: str, result: MethodResult) -> Solution:
    """The solution of a method's result, with residuals and warnings, before its simulation;
    SolverError where it is not finite.

    Times are zero: the caller measures them.
    """
    equations = problem.equations
    path = problem.path
    trajectory = _trajectory(problem, method, result)
    rows = residual_rows(equations, trajectory)
    if not np.isfinite(rows).all():
        raise SolverError(
            f"method {method}: the result is not finite; try another --mesh or a smoother move"
        )
    return Solution(
        model=equations.model,
        move=path.move,
        method=method,
        status=result.status,
        verdict=result.verdict,
        trajectory=trajectory,
        residual_max_Nm=float(rows.max()),
        residual_relative=relative_residual(equations, trajectory, rows),
        iterations=result.iterations,
        wall_s=0.0,
        cpu_s=0.0,
        preactuation_s=result.preactuation,
        simulation=None,
        warnings=(
            *limit_warnings(equations.model, trajectory),
            *problem.too_rough,
            *result.warnings,
        ),
        intervals=result.intervals,
        details={**result.details, **problem.notes},
    )
