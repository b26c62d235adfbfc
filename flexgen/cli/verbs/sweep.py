"""The verb ``sweep`` of the command line: its arguments and its printed result."""

from __future__ import annotations

from argparse import Namespace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from flexgen.cli.result import Progress, VerbResult, keywords

if TYPE_CHECKING:
    pass

SHOWN = 5  # reasons of failures that are printed, and cases that are named for each


def sweep(args: Namespace, log: Progress) -> VerbResult:
    """Solve all cases of a grid of models, parameters, moves and methods."""
    from flexgen.errors import ArgumentError
    from flexgen.sweeps.grid_file import read_grid
    from flexgen.sweeps.sweep import sweep as sweep_grid

    if args.parquet and find_spec("pyarrow") is None:  # checked before the sweep runs
        raise ArgumentError("--parquet: needs the package pyarrow; run: pip install pyarrow")
    grid = read_grid(args.grid)
    log(f"{len(grid)} cases; the remaining time is printed after each batch of cases")
    swept = sweep_grid(grid, args.out, **keywords(args, "grid", "out"), progress=log)
    files = [args.out / "results.npz", args.out / "times.npz"]
    if args.parquet:
        files.append(swept.results.save(args.out / "results.parquet"))
    data = swept.to_dict() | {"files": [str(file) for file in files]}
    warnings = [_reason_text(group) for group in data["failures"][:SHOWN]]
    if len(data["failures"]) > SHOWN:
        more = sum(len(group["cases"]) for group in data["failures"][SHOWN:])
        warnings.append(f"{more} more cases failed for other reasons; see --verbose or column error of {files[0]}")
    problem = "all cases failed" if data["failed"] == data["cases"] else ""
    details = "\n".join(f"case {k}: {swept.results['error'][k]}" for k in swept.failures)
    return VerbResult(data, _text(data), problem, warnings, details)


def _reason_text(group: dict[str, Any]) -> str:
    """One line: how many cases failed, which, and why."""
    cases = group["cases"]
    if len(cases) == 1:
        return f"case {cases[0]} failed: {group['reason']}"
    names = ", ".join(map(str, cases[:SHOWN])) + (", ..." if len(cases) > SHOWN else "")
    return f"{len(cases)} cases failed ({names}), for example case {cases[0]}: {group['reason']}"


def _text(data: dict[str, Any]) -> str:
    from flexgen.cli.printing import table

    head = ("model", "method", "status", "cases", "tool error m", "tool error rad", "torque N m", "processor s")
    keys = ("model", "method", "status", "cases", "tool_error_max", "turn_error_max", "torque_max", "cpu")
    rows = [[group[key] for key in keys] for group in data["groups"]]
    files = "\n".join(f"wrote {file}" for file in data["files"])
    return f"{data['cases']} cases, {data['failed']} failed\n\n{table(rows, head)}\n\n{files}"
