"""The verbs of a model: models, describe, derive, analyze."""

from __future__ import annotations

import time
from argparse import Namespace
from typing import Any

from flexgen.base.calls.progress import throttle
from flexgen.base.display import plain, roots
from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import write_text
from flexgen.cli.result import Progress, VerbResult, derive_model, with_files
from flexgen.views.reports.text_tables import paragraph, table


def models(args: Namespace, log: Progress) -> VerbResult:
    """List the models by name."""
    from flexgen.model.catalogue.catalogue import models as list_models
    from flexgen.views.reports.texts import models_text

    broken: dict[str, str] = {}
    rows = list_models(broken)
    data: dict[str, Any] = {"models": rows} | ({"broken": broken} if broken else {})
    warnings = [f"model {name} is left out: {reason}" for name, reason in broken.items()]
    return VerbResult(data, models_text(rows), warnings=warnings)


def describe(args: Namespace, log: Progress) -> VerbResult:
    """Describe a model: coordinates, motors, moves, variants."""
    from flexgen.model.catalogue.catalogue import describe as describe_model
    from flexgen.views.reports.texts import description_text

    data = describe_model(args.model, overrides=dict(args.set or ()))
    return VerbResult(data, description_text(data))


def derive(args: Namespace, log: Progress) -> VerbResult:
    """Derive the equations of motion and print them; of large models, print the sizes of the
    functions.
    """
    form = "latex" if args.latex else "text" if args.text else ""
    if not form and args.out is not None:
        form = "latex" if args.out.suffix == ".tex" else "text"
    began = time.perf_counter()
    equations = derive_model(args)
    robot = equations.model
    functions = equations.sizes(throttle(log))
    data: dict[str, Any] = {
        "model": robot.name,
        "variant": robot.variant,
        "seconds": time.perf_counter() - began,
        "functions": functions,
    }
    warnings: list[str] = []
    text = ""
    if form or not args.json:
        from flexgen.analysis.printing.equations import symbolic

        try:
            sheet = symbolic(robot)
            text = sheet.latex() if form == "latex" else sheet.text()
        except ArgumentError as error:
            if form:
                raise
            warnings.append(
                f"the equations are not printed ({error}); the table shows the sizes of the "
                "functions"
            )
    if form:
        data[form] = text
    if args.out is not None:
        data["out"] = str(write_text(args.out, text))
        text = f"wrote {args.out}"
    sizes = table([list(row) for row in functions.items()], ("function", "instructions"))
    return VerbResult(data, text.rstrip("\n") or sizes, warnings=warnings)


def analyze(args: Namespace, log: Progress) -> VerbResult:
    """Analyze the robot at rest at a pose: modes, poles, zeros, phase, structural index."""
    from flexgen.analysis.analyze import analyze as analyze_model

    equations = derive_model(args)
    path = None
    if args.move is not None:
        from flexgen.paths.path import Path as ToolPath
        from flexgen.paths.path import find_move

        path = ToolPath(equations, find_move(equations.model, args.move))
    log(f"analyzing {equations.model.name}: modes, zeros, index")
    analysis = analyze_model(equations, args.pose, path)
    data = analysis.to_dict()
    if args.report is not None:
        log("drawing and writing the report")
    files = {} if args.report is None else {"report": analysis.report(args.report)}
    poles = paragraph("poles, 1/s: " + ", ".join(roots(plain(data["poles"]))))
    return with_files(analysis.to_text(), data, files, details=poles)
