"""The kinds of the verb export, the schema of model files, and the robot in the browser."""

from __future__ import annotations

import json
from argparse import Namespace

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.files.atomic_files import write_text
from flexgen.cli.result import Progress, VerbResult, call, keywords, read_model
from flexgen.views.reports.text_tables import paragraph, table


def export(args: Namespace, log: Progress) -> VerbResult:
    """Call the public function of the row, or an exporter of another package, and print what it
    wrote.
    """
    robot = read_model(args)
    made = (
        call(args, log, robot, args.out)
        if args.row.function
        else flexgen.export(args.kind, robot, args.out)
    )
    text = made.summary()
    if made.path.is_dir():
        text = f"{robot.title}: {made.kind} in {made.path}\n\n{text}"
    if "variables" in made.details:
        shown = [v for v in made.details["variables"] if v.causality != "local"]
        rows = [[v.name, v.causality, v.unit or "-", v.text] for v in shown]
        text = f"{paragraph(text)}\n\n{table(rows, ('variable', 'causality', 'unit', 'meaning'))}"
    return VerbResult(made.to_dict() | {"out": str(made)}, text)


def schema(args: Namespace, log: Progress) -> VerbResult:
    """Print the JSON schema of model files, for completion and explanations in an editor."""
    data = flexgen.schema(args.kind)
    text = json.dumps(data, indent=1)
    if args.out is None:
        return VerbResult(data, text)
    path = write_text(args.out, text + "\n")
    return VerbResult(
        {"kind": args.kind, "out": str(path)},
        f"wrote {path}; first line of a model file: #:schema {path}",
    )


def view(args: Namespace, log: Progress) -> VerbResult:
    """Show robot, move and deflections in the browser (one HTML file), or in a video."""
    of_file = str(args.model).endswith((".npz", ".csv"))
    if args.set and of_file:
        raise ArgumentError(
            "--set: given with a trajectory, expected a model (or --robot MODEL for a trajectory)"
        )
    what = args.model if of_file else read_model(args)
    flexgen.view(what, args.out, model=args.robot, **keywords(args), progress=log)
    paths = {
        key: str(path)
        for key, path in (("out", args.out), ("video", args.video))
        if path is not None
    }
    return VerbResult(paths, "\n".join(f"wrote {path}" for path in paths.values()))
