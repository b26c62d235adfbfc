"""The hint to ``flexgen check`` where a verb fails for a model with implausible numbers."""

from __future__ import annotations

from argparse import Namespace

from flexgen.base.errors import FlexgenError
from flexgen.cli.result import derive_model

# verbs that compute with all numbers
HINTED = ("analyze", "solve", "simulate", "run", "control", "fastest", "learn")


def implausible(args: Namespace, problem: str) -> str:
    """The worst error that `check` finds in the model of a verb that failed, as the end of a
    message; else empty.
    """
    if args.verb not in HINTED or "implausible" in problem:
        return ""
    from flexgen.studies.check.check import implausible_number

    try:
        found = implausible_number(derive_model(args))
    except FlexgenError:
        return ""
    return found and f"{found} (see 'flexgen check {args.model}')"
