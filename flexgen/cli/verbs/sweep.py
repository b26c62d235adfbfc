"""The verb ``sweep`` of the command line."""

from __future__ import annotations

from argparse import Namespace
from importlib.util import find_spec

from flexgen.base.calls.deadline import INTERRUPTED
from flexgen.cli.result import Progress, VerbResult, keywords


def sweep(args: Namespace, log: Progress) -> VerbResult:
    """Solve all cases of a grid of models, parameters, moves and methods."""
    from flexgen.base.errors import ArgumentError
    from flexgen.studies.sweeps.grid_file import read_grid
    from flexgen.studies.sweeps.sweep import sweep as sweep_grid
    from flexgen.views.reports.texts import failure_lines

    if args.parquet and find_spec("pyarrow") is None:  # checked before the sweep runs
        raise ArgumentError("--parquet: needs the package pyarrow; run: pip install pyarrow")
    grid = read_grid(args.grid)
    log(f"{len(grid)} cases; the remaining time is printed after each batch of cases")
    swept = sweep_grid(grid, args.out, **keywords(args, "grid", "out"), progress=log)
    files = [args.out / "results.npz", args.out / "times.npz"]
    if args.parquet:
        files.append(swept.results.save(args.out / "results.parquet"))
    data = swept.to_dict() | {"files": [str(file) for file in files]}
    text = "\n".join([f"{swept.to_text()}\n", *(f"wrote {file}" for file in files)])
    warnings = failure_lines(data["failures"], f"--verbose or column error of {files[0]}")
    failed = "all cases failed" if data["failed"] == data["cases"] else ""
    early = f"{swept.status}; continue with --resume" if swept.ended else ""
    problem = "; ".join(filter(None, [early, failed]))
    details = "\n".join(f"case {k}: {error}" for k, error in swept.errors.items())
    return VerbResult(
        data, text, problem, warnings, details, interrupted=swept.ended == INTERRUPTED
    )
