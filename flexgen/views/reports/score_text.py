"""Scores of several controllers as text with tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from flexgen.views.reports.row_views import text_of_rows
from flexgen.views.reports.text_tables import paragraph, table

if TYPE_CHECKING:
    from flexgen.studies.scenarios.scenario import Scenario
    from flexgen.studies.scenarios.score import Score


def scores_text(scenario: Scenario, scores: Sequence[Score]) -> str:
    """Scores of controllers, the best first, with rules and reasons; of one its content."""
    if len(scores) == 1:
        return text_of_rows(scores[0].content())
    sets = list(scenario.sets)
    draws = scenario.plan.draws if scenario.plan is not None else 1
    drawn = ("worst draw", "spread") if draws > 1 else ()
    rows = [
        [
            s.controller,
            *(
                [s.total, *([s.worst, s.spread] if drawn else []), *s.parts.values()]
                if s.accepted
                else ["refused"]
            ),
            *([] if s.accepted else [""] * (1 + len(sets) + len(drawn))),
        ]
        for s in sorted(scores, key=lambda s: s.total if s.accepted else float("inf"))
    ]
    parts = [
        paragraph(scenario.title_line),
        table(rows, ("controller", "V", *drawn, "nominal", *sets)),
    ]
    if drawn:
        parts.append(paragraph(f"V: mean of {draws} draws, spread: standard deviation."))
    parts += [paragraph(f"{s.controller}: {s.rule}") for s in scores if s.rule]
    parts += [paragraph(f"{s.controller}: {s.status}.") for s in scores if s.ended]
    parts += [
        "\n".join(f"{s.controller} is refused: {reason}" for reason in s.refused)
        for s in scores
        if s.refused
    ]
    return "\n\n".join(parts)
