"""Results of closed loops and benchmarks as text with tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from flexgen.base.display import Scales, choose_scales, figure_rows
from flexgen.base.registry import provides
from flexgen.views.reports.text_tables import number, paragraph, table

if TYPE_CHECKING:
    from flexgen.feedback.loop.feedforward import FeedforwardComparison
    from flexgen.feedback.loop.margins import Margins
    from flexgen.feedback.loop.result import ControlRun
    from flexgen.paths.accuracy.figures import PathAccuracy
    from flexgen.studies.scenarios.scenario import Scenario
    from flexgen.studies.scenarios.score import Score

ERRORS = ("error_max", "dynamic_error_max", "error_end")  # keys of `ControlRun.figures`


def lengths_of_run(run: ControlRun) -> list[tuple[float | None, str]]:
    """Errors and figures of accuracy of the robots that have them, with their units."""
    from flexgen.feedback.loop.result import UNITS

    found = [
        (run.figures(r)[f"{key}_{u}"], u)
        for r in run.runs
        if not r.failure
        for u in UNITS
        for key in ERRORS
    ]
    return [*found, *(run.accuracy().lengths() if has_accuracy(run) else [])]


def lengths_of_comparison(compared: FeedforwardComparison) -> list[tuple[float | None, str]]:
    """Errors with no, rigid and elastic feedforward, with their units."""
    return [(row[name], row["unit"]) for row in compared.rows() for name in compared.runs]


def has_accuracy(run: ControlRun) -> bool:
    """Whether the figures of ISO 9283 have a meaning: a robot came to rest, no loop is
    unstable.
    """
    return any(not r.failure for r in run.runs) and not run.unstable


@provides("ControlRun.to_text")
def text_of_control(
    run: ControlRun,
    margins: Mapping[str, Margins] | None = None,
    scales: Scales | None = None,
) -> str:
    """Errors and torques of the robots, their loads, and the stability margins.

    ``margins``: where they are known; ``scales``: units of lengths and angles of a report with
    more of them.
    """
    from flexgen.dynamics.mechanics.output_columns import columns_in
    from flexgen.feedback.loop.result import UNITS

    scales = choose_scales((), *lengths_of_run(run)) if scales is None else scales
    units = [u for u in UNITS if columns_in(run.model, u)]
    touched = any(r.contact is not None for r in run.runs)
    rows = []
    for r in run.runs:
        f = run.figures(r)
        lengths = [scales[u].cell(f[f"{key}_{u}"]) for u in units for key in ERRORS]
        force = [f["contact_max_N"]] if touched else []
        rows.append([r.name, *lengths, f["torque_max_Nm"], *force, r.saturated, r.failure])
    errors = (
        f"{what}, {scales[u].unit}" for u in units for what in ("error", "dynamic", "at the end")
    )
    margins = run.margins() if margins is None else margins
    unstable = ", ".join(pose for pose, m in (margins or {}).items() if not m.stable)
    lines = [
        f"{run.model.name}, move {run.solution.move.name}: {run.status}, controller "
        f"{run.controller}, sample time {number(1e3 * run.hardware.sample_s)} ms, delay "
        f"{number(1e3 * run.delay_s)} ms",
        *(
            [f"the loop is unstable ({unstable}): errors grow, also after this run"]
            if unstable
            else []
        ),
        *run.force_lines(),
        "",
        table(
            rows,
            (
                "robot",
                *errors,
                "torque, N m",
                *["wall, N"] * touched,
                "samples at the limit",
                "failure",
            ),
        ),
        *(f"{r.name}: load {r.load}" for r in run.runs if r.load),
    ]
    if has_accuracy(run):
        lines += ["", accuracy_text(run.accuracy(), scales)]
    if margins:
        lines += ["", margins_text(margins, "pose")]
    return "\n".join(lines)


def margins_text(margins: Mapping[str, Margins], what: str) -> str:
    """A table of stability margins with their frequencies."""
    head = (
        what,
        "stable",
        "gain margin",
        "dB",
        "at Hz",
        "phase margin, deg",
        "at Hz",
        "delay margin, ms",
    )
    rows = [
        [
            name,
            "yes" if m.stable else "no",
            _found(m.gain),
            _found(m.gain_db),
            _found(m.gain_hz),
            _found(m.phase_deg),
            _found(m.phase_hz),
            _found(1e3 * m.delay_s),
        ]
        for name, m in margins.items()
    ]
    return table(rows, head)


def _found(value: float) -> float | str:
    """A number, or a dash for one that was not found."""
    return value if math.isfinite(value) else "-"


def feedforward_text(compared: FeedforwardComparison, scales: Scales | None = None) -> str:
    """The errors of one move with no, rigid and elastic feedforward, and what is missing."""
    names = [*compared.runs]
    scales = choose_scales((), *lengths_of_comparison(compared)) if scales is None else scales
    rows = [
        [
            row["robot"],
            f"{row['what']}, {scales[row['unit']].unit}",
            *(
                "failed" if row[name] is None else scales[row["unit"]].cell(row[name])
                for name in names
            ),
        ]
        for row in compared.rows()
    ]
    title = "feedforward compared, the same feedback: none, of the rigid robot, "
    lines = [
        f"{title}and elastic ({compared.elastic.solution.method})",
        "",
        table(rows, ("robot", "largest", *names)),
    ]
    unstable = [
        f"{name}: {run.status}" for name, run in compared.runs.items() if run.status != "done"
    ]
    missing = [f"{name}: not compared: {reason}" for name, reason in compared.missing.items()]
    return "\n".join([*lines, *unstable, *missing])


def accuracy_text(found: PathAccuracy, scales: Scales) -> str:
    """Figures of ISO 9283 of the robots together, and those of each."""
    title = (
        f"ISO 9283, over {len(found.robots)} robots"
        if len(found.robots) > 1
        else "ISO 9283, one robot"
    )
    columns, rows = found.robot_table(scales)
    shown = figure_rows(found.figures(), scales)
    return "\n".join([table(shown, (title, "")), "", table(rows, columns)])


def scores_text(scenario: Scenario, scores: Sequence[Score]) -> str:
    """Scores of controllers, the best first, with rules and reasons; of one controller also all
    measures.
    """
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
    if len(scores) == 1 and scores[0].accepted:
        columns = ("measure", "unit", "weight", "reference", "nominal", *sets)
        parts.append(table([[row[key] for key in columns] for row in scores[0].table], columns))
    return "\n\n".join(parts)
