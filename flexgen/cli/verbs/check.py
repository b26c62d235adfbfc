"""The verb ``check``, and the hint to it where a verb fails for a model with implausible numbers."""

from __future__ import annotations

from argparse import Namespace

from flexgen.cli.result import Progress, VerbResult, derive_model
from flexgen.errors import FlexgenError

HINTED = ("analyze", "solve", "simulate", "run", "control", "fastest", "learn")  # verbs that compute with all numbers


def check(args: Namespace, log: Progress) -> VerbResult:
    """Compare the numbers of a model with those of real robots: wrong units, powers of ten, moves beyond limits."""
    from flexgen.plausibility.check import check as check_model

    found = check_model(derive_model(args))
    problem = f"{len(found.errors)} errors, the worst: {found.worst}" if found.worst is not None else ""
    return VerbResult(found.to_dict(), found.to_text(), problem)


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
