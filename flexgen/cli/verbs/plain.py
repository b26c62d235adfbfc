"""Verbs that only call their public function."""

from __future__ import annotations

from argparse import Namespace

from flexgen.base.display import as_json
from flexgen.base.display import plain as as_plain
from flexgen.cli.result import (
    Progress,
    VerbResult,
    call,
    check_model_file,
    is_interrupted,
    read_model,
    with_files,
    written,
)


def plain(args: Namespace, log: Progress) -> VerbResult:
    """Call the public function of the row; print its result, and write it where ``--out`` and
    ``--report`` ask.
    """
    given = () if args.row.takes_model == "none" else (read_model(args),)
    check_model_file(args, *given)
    result = call(args, log, *given)
    if not hasattr(result, "to_text"):
        return VerbResult({"result": as_plain(result)}, as_json(as_plain(result)))
    notes = [text for text in getattr(result, "warnings", ()) if isinstance(text, str)]
    details = result.all_findings() if hasattr(result, "all_findings") else ""
    return with_files(
        result.to_text(),
        result.to_dict(),
        written(args, result),
        result.problem,
        warnings=notes,
        details=details,
        interrupted=is_interrupted(result),
    )
