"""The kind fmu of the verb export."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from flexgen.cli.printing import paragraph, table
from flexgen.cli.result import Progress, VerbResult, check_writable, keywords, read_model

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
        controller=given,
        **keywords(args, "controller"),
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
