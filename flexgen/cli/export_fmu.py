"""The kind fmu of the verb export."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flexgen.cli.argument_types import file_path, positive
from flexgen.cli.printing import paragraph, table
from flexgen.cli.verbs import Progress, VerbResult, check_writable, read_model

BLOCKS = ("plant", "feedforward", "controller")
VERSIONS = ("2.0", "3.0")
METHODS = ("rk4", "sdirk4")
OF_BLOCK = {
    "method": "plant",
    "step": "plant",
    "controller": "controller",
    "sample_time": "controller",
    "look_ahead": "feedforward",
}


def add_fmu(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add the parser of ``flexgen export fmu MODEL``."""
    parser = add_verb(kinds, "fmu", fmu)
    content, options, files = parser.section("content"), parser.section("options of a block"), parser.section("files")
    content.add_argument("--block", choices=BLOCKS, metavar="NAME", default="plant", help=(
        "plant (default): the elastic robot; feedforward: inverse dynamics on a moving horizon; "
        "controller: a P-PI cascade"
    ))  # fmt: skip
    content.add_argument(
        "--fmi", choices=VERSIONS, metavar="VERSION", default="2.0", help="version of FMI: 2.0 (default) or 3.0"
    )
    files.add_argument(
        "--out", metavar="FILE", type=file_path, help="write to this file (.fmu); default: generated/MODEL.fmu"
    )
    files.add_argument("--sources-only", action="store_true", help="without a binary for this platform")
    options.add_argument("--method", choices=METHODS, metavar="NAME", help=(
        "plant in Co-Simulation: rk4 (default), explicit, or sdirk4, implicit and L-stable, for stiff springs"
    ))  # fmt: skip
    options.add_argument(
        "--step", metavar="S", type=positive, help="its largest step [s]; default: from the fastest pole at home"
    )
    options.add_argument(
        "--controller", metavar="FILE", help="of type ppi or cascade (.toml); default: PPI for the model"
    )
    options.add_argument(
        "--sample-time", metavar="S", type=positive, help="sample time of the controller [s]; default: 0.001"
    )
    options.add_argument(
        "--look-ahead",
        metavar="S",
        type=positive,
        help="horizon of the feedforward [s]; default: from the unstable zeros",
    )


def fmu(args: Namespace, log: Progress) -> VerbResult:
    """Write a Functional Mock-up Unit (FMI 2.0 or 3.0) for simulation programs."""
    check_writable(args.out)
    from flexgen.errors import ArgumentError
    from flexgen.exports.fmu.export import export_fmu

    for option, block in OF_BLOCK.items():
        if getattr(args, option) is not None and args.block != block:
            raise ArgumentError(
                f"--{option.replace('_', '-')}: given with --block {args.block}, expected with --block {block} only"
            )
    given: Any = None
    if args.block == "controller":
        from flexgen.loop.controller_files import file_controller
        from flexgen.loop.gains import PPI

        if args.controller is not None and not Path(args.controller.partition(".py:")[0]).exists():
            raise ArgumentError(f"--controller: given {args.controller!r}, which does not exist, expected a file .toml")
        given = PPI() if args.controller is None else file_controller(args.controller)
        if given is None:
            raise ArgumentError(
                f"--controller: given {args.controller!r}, expected a file .toml of type ppi or cascade"
            )
    written = export_fmu(
        read_model(args),
        args.out,
        version=args.fmi,
        block=args.block,
        binary=not args.sources_only,
        method=args.method,
        step=args.step,
        controller=given,
        sample_time=args.sample_time,
        look_ahead=args.look_ahead,
        progress=log,
    )
    rows = [[v.name, v.causality, v.unit or "-", v.text] for v in written.variables if v.causality not in ("local",)]
    binary = f"binary for {written.binary}" if written.binary else "sources only"
    head = f"wrote {written.path}: FMI {written.version}, {written.block}, Model Exchange and Co-Simulation, {binary}"
    data = {
        "path": str(written.path),
        "block": written.block,
        "version": written.version,
        "token": written.token,
        "binary": written.binary,
        "variables": [
            {"name": v.name, "reference": v.reference, "causality": v.causality, "unit": v.unit, "start": v.start}
            for v in written.variables
        ],
    }
    return VerbResult(data, f"{paragraph(head)}\n\n{table(rows, ('variable', 'causality', 'unit', 'meaning'))}")
