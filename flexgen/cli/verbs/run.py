"""The verb ``run``: all steps from a model file to a loaded C library and verified motor torques."""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexgen.cli.printing import figure_rows, figures, one_line
from flexgen.cli.result import (
    Progress,
    VerbResult,
    check_report,
    derive_model,
    keywords,
    read_model,
)
from flexgen.cli.verbs.generate import library_dict
from flexgen.cli.verbs.solve import inaccuracy, problem_of
from flexgen.display import plain

if TYPE_CHECKING:
    from flexgen.inversion.solution import Solution
    from flexgen.mechanics.equations import Equations


def run(args: Namespace, log: Progress) -> VerbResult:
    """Run all steps: describe, analyze, generate and load the C library, solve, verify, write the report."""
    began = time.perf_counter()
    robot = read_model(args)
    name = robot.name + (f"_{robot.variant}" if robot.variant else "")
    directory = args.report or Path("reports", name)
    check_report(directory)

    from flexgen.analysis.analyze import analyze as analyze_model
    from flexgen.inversion.comparison import compare_methods
    from flexgen.inversion.solve import ACCURACY
    from flexgen.inversion.solve import solve as solve_move
    from flexgen.library.generate import generate as generate_library
    from flexgen.reports.html import write_report
    from flexgen.runtime import load

    log(f"describe: {robot.title}, {one_line(robot.description)}")
    equations = derive_model(args)
    log("analyze: modes, poles and zeros at the home pose")
    analysis = analyze_model(equations)
    log("generate: C library")
    generated = generate_library(robot, args.out, progress=log)
    library = load(generated.directory)
    log("solve: inverse dynamics of the move, verified by forward simulation")
    solution = solve_move(equations, **keywords(args), progress=log)
    if solution.interrupted:
        return _end_early(solution, directory)
    checked = _check_library(library, equations, solution)
    compared = compare_methods(equations, solution, log)
    log("report")
    report = write_report(equations, solution, directory, generated=generated, compared=compared)
    trajectory = solution.trajectory.save(directory / f"{solution.move.name}.npz")
    facts, solved = plain(analysis.to_dict()), solution.to_dict()
    solved["trajectory"] = str(trajectory)
    slowest = facts["unstable_time_constant_s"]
    rows: list[tuple[str, Any, str]] = [
        ("model", robot.title, ""),
        ("motors, degrees of freedom", f"{robot.n_m}, {robot.dof}", ""),
        ("lowest mode", facts["modes_hz"][0] if facts["modes_hz"] else None, "Hz"),
        ("phase of the output", facts["phase"], ""),
        ("slowest unstable zero", 1 / slowest if slowest else None, "1/s"),
        ("structural index", facts["structural_index"], ""),
        ("C functions generated", len(generated.functions), ""),
        ("C library built in", None if generated.cached else generated.seconds, "s"),
        ("C inverse_dynamics, one call from Python", checked["call_us"], "us"),
        ("difference of C and equations, largest", checked["difference_Nm"], "N m"),
        ("move", solution.move.name, ""),
        *figure_rows(solution),
        ("total time, wall", time.perf_counter() - began, "s"),
    ]
    text = figures(rows) + f"\n\nwrote {report}\nwrote {trajectory}\n"
    text += f"{'wrote' if generated.written else 'unchanged'} {generated.directory}"
    data = {
        "model": robot.name,
        "variant": robot.variant,
        "analyze": facts,
        "generate": library_dict(robot, generated),
        "load": checked,
        "solve": solved,
        "report": str(report),
        "seconds": time.perf_counter() - began,
    }
    problem, failure = problem_of(solution, ACCURACY)
    return VerbResult(data, text, problem, list(solution.warnings), failure=failure)


def _end_early(solution: Solution, directory: Path) -> VerbResult:
    """The result where Ctrl-C ended the solve: the trajectory is written, the report is not."""
    from flexgen.inversion.solve import ACCURACY

    trajectory = solution.trajectory.save(directory / f"{solution.move.name}.npz")
    data = solution.to_dict() | {"trajectory": str(trajectory)}
    text = f"{figures(figure_rows(solution))}\n\nwrote {trajectory}"
    return VerbResult({"solve": data}, text, inaccuracy(solution, ACCURACY), list(solution.warnings), interrupted=True)


def _check_library(library: Any, equations: Equations, solution: Solution) -> dict[str, float]:
    """Compare the loaded C library with the equations at the samples of the solution; measure the time of one call."""
    import numpy as np

    from flexgen.numerics.evaluate import evaluate

    trajectory = solution.trajectory
    arguments = [trajectory[channel] for channel in ("q_a", "v_a", "a_a")]
    from_c = library.inverse_dynamics(*arguments)
    expected = evaluate(equations.function("inverse_dynamics"), *arguments)[0].reshape(from_c.shape)
    first = [np.ascontiguousarray(x[0]) for x in arguments]
    calls, began = 2000, time.perf_counter()
    for _ in range(calls):
        library.inverse_dynamics(*first)
    spent = time.perf_counter() - began
    return {"difference_Nm": float(np.abs(from_c - expected).max()), "call_us": 1e6 * spent / calls}
