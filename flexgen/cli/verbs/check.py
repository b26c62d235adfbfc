"""The hint to ``flexgen check`` where a verb fails for a model with implausible numbers."""

from __future__ import annotations

from argparse import Namespace

from flexgen.cli.result import derive_model
from flexgen.errors import FlexgenError

HINTED = ("analyze", "solve", "simulate", "run", "control", "fastest", "learn")  # verbs that compute with all numbers


def implausible(args: Namespace) -> str:
    """The worst error that `check` finds in the model of a verb that failed, as the end of a message; else empty."""
    if args.verb not in HINTED:
        return ""
    from flexgen.plausibility.check import check as check_model

    try:
        found = check_model(derive_model(args), motions=False)
    except (FlexgenError, ArithmeticError, ValueError):
        return ""
    if found.worst is None:
        return ""
    return f"; numbers of the model are implausible: {found.worst} (see 'flexgen check {args.model}')"
