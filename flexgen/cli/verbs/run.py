"""The verb ``run``: all steps from a model file to a loaded C library and verified motor
torques.
"""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from flexgen.base.display import plain
from flexgen.cli.result import (
    Progress,
    VerbResult,
    check_report,
    derive_model,
    keywords,
    read_model,
)
from flexgen.cli.verbs.solve import failure_of
from flexgen.views.reports.text_tables import one_line


def run(args: Namespace, log: Progress) -> VerbResult:
    """Run all steps: describe, analyze, generate and load the C library, solve, verify, write the
    report.
    """
    began = time.perf_counter()
    robot = read_model(args)
    name = robot.name + (f"_{robot.variant}" if robot.variant else "")
    directory = args.report or Path("reports", name)
    check_report(directory)

    from flexgen.analysis.analyze import analyze as analyze_model
    from flexgen.codegen.build.agreement import compare_library
    from flexgen.codegen.build.generate import generate as generate_library
    from flexgen.inversion.comparison.comparison import compare_methods
    from flexgen.inversion.problem.problem_text import problem_of
    from flexgen.inversion.solve import ACCURACY
    from flexgen.inversion.solve import solve as solve_move
    from flexgen.runtime import load
    from flexgen.views.reports.html import write_report
    from flexgen.views.reports.texts import figure_rows, figures, steps_text

    log(f"describe: {robot.title}, {one_line(robot.description)}")
    equations = derive_model(args)
    log("analyze: modes, poles and zeros at the home pose")
    analysis = analyze_model(equations)
    log("generate: C library")
    generated = generate_library(robot, args.out, progress=log)
    library = load(generated.directory)
    log("solve: inverse dynamics of the move, verified by forward simulation")
    solution = solve_move(equations, **keywords(args), progress=log)
    problem = problem_of(solution, ACCURACY)
    trajectory = directory / f"{solution.move.name}.npz"
    if solution.interrupted:  # without the report
        data: dict[str, Any] = {
            "solve": solution.to_dict() | {"trajectory": str(solution.trajectory.save(trajectory))}
        }
        text = f"{figures(figure_rows(solution))}\n\nwrote {trajectory}"
        return VerbResult(data, text, problem, list(solution.warnings), interrupted=True)
    checked = compare_library(library, equations, solution.trajectory)
    compared = compare_methods(equations, solution, log)
    log("report")
    report = write_report(equations, solution, directory, generated=generated, compared=compared)
    solution.trajectory.save(trajectory)
    seconds = time.perf_counter() - began
    text = (
        f"{steps_text(analysis, generated, checked, solution, seconds)}\n"
        "\n"
        f"wrote {report}\n"
        f"wrote {trajectory}\n"
    )
    text += f"{'wrote' if generated.written else 'unchanged'} {generated.directory}"
    data = {
        "model": robot.name,
        "variant": robot.variant,
        "analyze": plain(analysis.to_dict()),
        "generate": {"model": robot.name, "variant": robot.variant, **generated.to_dict()},
        "load": checked,
        "solve": solution.to_dict() | {"trajectory": str(trajectory)},
        "report": str(report),
        "seconds": seconds,
    }
    return VerbResult(data, text, problem, list(solution.warnings), failure=failure_of(solution))
