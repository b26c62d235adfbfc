"""The verbs of a model: models, describe, derive, analyze."""

from __future__ import annotations

import time
from argparse import Namespace
from typing import TYPE_CHECKING, Any

from flexgen.atomic_files import write_text
from flexgen.cli.printing import analysis_text, description_text, one_line, paragraph, roots, table
from flexgen.cli.result import Progress, VerbResult, derive_model
from flexgen.display import plain
from flexgen.errors import ArgumentError

if TYPE_CHECKING:
    from flexgen.analysis.analyze import Analysis
    from flexgen.model.elements import RobotModel


def models(args: Namespace, log: Progress) -> VerbResult:
    """List the models by name."""
    from flexgen.model.catalogue import models as list_models

    broken: dict[str, str] = {}
    rows = list_models(broken)
    head = ("name", "motors", "actuated", "elastic", "dof", "description")
    text = table([[r["name"], r["n_m"], r["n_g"], r["n_e"], r["dof"], one_line(r["description"])] for r in rows], head)
    variants = [f"{row['name']}@{name}" for row in rows for name in row["variants"]]
    if variants:
        text += "\n\n" + paragraph("variants: " + ", ".join(variants))
    data: dict[str, Any] = {"models": rows}
    if broken:
        data["broken"] = broken
    return VerbResult(data, text, warnings=[f"model {name} is left out: {reason}" for name, reason in broken.items()])


def describe(args: Namespace, log: Progress) -> VerbResult:
    """Describe a model: coordinates, motors, moves, variants."""
    from flexgen.model.catalogue import describe as describe_model

    data = describe_model(args.model, overrides=dict(args.set or ()))
    return VerbResult(data, description_text(data))


def derive(args: Namespace, log: Progress) -> VerbResult:
    """Derive the equations of motion and print them; of large models, print the sizes of the functions."""
    form = "latex" if args.latex else "text" if args.text else ""
    if not form and args.out is not None:
        form = "latex" if args.out.suffix == ".tex" else "text"
    began = time.perf_counter()
    equations = derive_model(args)
    robot = equations.model
    functions = {name: int(equations.function(name).n_instructions()) for name in _function_names(robot)}
    data: dict[str, Any] = {
        "model": robot.name,
        "variant": robot.variant,
        "seconds": time.perf_counter() - began,
        "functions": functions,
    }
    sizes = table([list(row) for row in functions.items()], ("function", "instructions"))
    warnings: list[str] = []
    text = ""
    if form or not args.json:
        from flexgen.equations_text.equations import symbolic

        try:
            sheet = symbolic(robot)
            text = sheet.latex() if form == "latex" else sheet.text()
        except ArgumentError as error:
            if form:
                raise
            warnings.append(f"the equations are not printed ({error}); the table shows the sizes of the functions")
    if form:
        data[form] = text
    if args.out is not None:
        write_text(args.out, text)
        data["out"] = str(args.out)
        text = f"wrote {args.out}"
    return VerbResult(data, text.rstrip("\n") or sizes, warnings=warnings)


def _function_names(robot: RobotModel) -> list[str]:
    """The functions that the equations of a model have."""
    from flexgen.mechanics.equations import BUILDERS
    from flexgen.mechanics.signatures import FUNCTIONS, INVERSION, offered_functions

    missing = {*INVERSION, *FUNCTIONS} - set(offered_functions(robot))
    return [name for name in BUILDERS if name not in missing]


def analyze(args: Namespace, log: Progress) -> VerbResult:
    """Analyze the robot at rest at a pose: modes, poles, zeros, phase, structural index."""
    from flexgen.analysis.analyze import analyze as analyze_model

    equations, path = derive_model(args), None
    if args.move is not None:
        from flexgen.paths.path import Path as ToolPath
        from flexgen.paths.path import find_move

        path = ToolPath(equations, find_move(equations.model, args.move))
    analysis = analyze_model(equations, args.pose, path)
    data = analysis.to_dict()
    text = analysis.model.title + " in equilibrium\n\n" + _analysis_text(analysis)
    if args.report is not None:
        from flexgen.reports.analysis_page import write_analysis

        page = write_analysis(analysis, args.report)
        data["report"] = str(page)
        text += f"\n\nwrote {page}"
    poles = "poles, 1/s: " + ", ".join(roots(plain(data["poles"])))
    return VerbResult(data, text, details=paragraph(poles))


def _analysis_text(analysis: Analysis) -> str:
    coordinates = [(c.name, c.unit) for c in analysis.model.coordinates]
    return analysis_text(plain(analysis.to_dict()), coordinates, [motor.name for motor in analysis.model.motors])
