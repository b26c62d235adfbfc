"""The report of a solution: one self-contained HTML page with tables and plots."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from flexgen.analysis.analyze import Analysis, analyze
from flexgen.analysis.content import dynamics_parts
from flexgen.base.display import NOISE, SPEED, Scales, UnitScale, choose_scales
from flexgen.base.errors import SolverError
from flexgen.base.files.atomic_files import write_text
from flexgen.base.registry import provides
from flexgen.base.rows import Row
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.feedback.loop.comparison import Comparison
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.model.elements import Friction, Motor, RobotModel
from flexgen.paths.accuracy.figures import PathAccuracy
from flexgen.views.plots import solution as plots
from flexgen.views.reports.folder import PAGE, check_folder, foot
from flexgen.views.reports.html_tables import html_table, number
from flexgen.views.reports.motion import write_motion
from flexgen.views.reports.pictures import Picture, pictures
from flexgen.views.reports.row_views import html_of_rows, lengths_of
from flexgen.views.reports.sentence import in_words

_CSS = """
body { font: 16px/1.5 "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; color: #222; \
background: #fff;
  max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; } h2 { font-size: 1.2rem; margin: 2.2rem 0 .5rem; }
.sub { color: #555; margin: 0 0 1rem; } .source { color: #555; font-size: .85rem; white-space: \
pre-line; }
.status { display: inline-block; padding: .05rem .6rem; border-radius: .3rem; color: #fff; \
background: #00694d; }
.status.bad { background: #b34700; }
.warn { border-left: 4px solid #D55E00; background: #fdf3ec; padding: .5rem .9rem; margin: 1rem \
0; }
.warn ul { margin: 0; padding-left: 1.1rem; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .2rem 1.1rem .2rem 0; border-bottom: 1px solid #ddd; \
vertical-align: top; }
th { font-weight: 600; border-bottom: 2px solid #888; } td.n, th.n { text-align: right; \
white-space: nowrap; }
figure { margin: 1.4rem 0 2rem; break-inside: avoid; } figure svg { max-width: 100%; height: \
auto; display: block; }
figcaption { font-size: .9rem; color: #444; max-width: 46rem; margin-top: .3rem; }
sup { line-height: 0; }
.wide { overflow-x: auto; } footer { color: #777; font-size: .8rem; margin-top: 3rem; border-top: \
1px solid #ddd; }
@media print { body { margin: 0; max-width: none; font-size: 11pt; } tr { break-inside: avoid; } }
"""


def scales_of_page(
    figures: Iterable[Row], *more: tuple[float | None, str]
) -> dict[str, UnitScale]:
    """`choose_scales` with the names of units that a page has: the micro sign for u."""
    scales = choose_scales(figures, *more)
    named = {unit: scale.unit.replace("u", "\N{MICRO SIGN}") for unit, scale in scales.items()}
    return {unit: scale._replace(unit=named[unit]) for unit, scale in scales.items()}


def length(scale: UnitScale, value: float | None, digits: int = 3) -> str:
    """A length or angle [SI] as HTML, in the unit of the report."""
    cell = scale.cell(value)
    if isinstance(cell, str):
        return number(None) if cell == "-" else html.escape(cell)
    return number(cell, digits)


def _summary(solution: Solution, scales: Scales) -> str:
    """Table of the figures of a solution as HTML, those without a value left out."""
    t = solution.trajectory.time
    rows = [
        _summary_row(figure, scales)
        for figure in solution.figures()
        if figure.value not in (None, "")
    ]
    if solution.simulation is None:
        rows.append(("verification", "not done", ""))
    rows += [
        ("duration of the path", number(solution.move.duration), "s"),
        ("samples of the trajectory", f"{len(t)} from {number(t[0])} to {number(t[-1])} s", ""),
    ]
    note = (
        "<p>The limits keep the motion off the path. The error from the modified path shows how "
        "well this torque tracks the planned motion.</p>\n"
    )
    return html_table(("quantity", "value", "unit"), rows, (1,)) + (
        note if solution.plan_error_max is not None else ""
    )


def accuracy_tables(found: PathAccuracy, scales: Scales) -> str:
    """Path accuracy, repeatability, settling and speed of robots together, and those of each of
    several.
    """
    rows = [_summary_row(figure, scales) for figure in found.figures() if figure.value is not None]
    columns, of_robots = found.robot_table(scales)
    each = [tuple(map(html.escape, row)) for row in of_robots] if len(of_robots) > 1 else []
    return (
        "<h2>Accuracy in the sense of ISO 9283</h2>\n"
        + html_table(("quantity", "value", "unit"), rows, (1,))
        + (html_table(columns, each, range(1, len(columns))) if each else "")
    )


def _summary_row(figure: Row, scales: Scales) -> tuple[str, str, str]:
    """A row of the summary; status as a colored label, lengths and angles in their units."""
    label, value, unit, key = figure
    if key == "status":
        bad = "" if value == Status.SOLVED else " bad"
        return label, f'<span class="status{bad}">{html.escape(str(value))}</span>', ""
    if isinstance(value, float) and unit in scales:
        return label, length(scales[unit], value), scales[unit].unit
    if isinstance(value, float) and key.startswith(SPEED) and 0.0 < abs(value) < NOISE:
        return label, html.escape(f"< {NOISE:.0e}"), unit
    if isinstance(value, float):
        return label, number(value), unit
    return label, html.escape(str(value)), unit


def _friction(f: Friction) -> str:
    """The terms of a friction in words, those that are zero left out."""
    named = [
        ("viscous", f.viscous),
        ("Coulomb", f.coulomb),
        ("Stribeck", f.stribeck),
        ("offset", f.offset),
    ]
    named += [
        (f"{kind} by load", getattr(f, f"load_{kind.lower()}", 0.0))
        for kind in ("Coulomb", "Stribeck")
    ]
    return ", ".join(f"{name} {number(value)}" for name, value in named if value) or "none"


def _motors(model: RobotModel, solution: Solution, limits: Limits) -> str:
    """Table of the motors as HTML: data, largest torque and speed with their limits, and rms
    torque.
    """
    tau = solution.trajectory["tau_m"]
    v = solution.trajectory["v_m"]

    def row(j: int, motor: Motor) -> tuple[str, ...]:
        """Cells of motor ``j``; limits that were given take precedence over those of the file."""
        drives = ", ".join(
            f"{html.escape(name)} ({number(ratio)})"
            for name, ratio in zip(motor.drives, motor.ratio, strict=True)
        )
        torque = motor.torque_max if limits.torque is None else limits.torque[j]
        speed = motor.speed_max if limits.speed is None else limits.speed[j]
        peaks = [(tau, torque), (v, speed)]
        cells = [f"{number(np.abs(x[:, j]).max())} / {number(limit)}" for x, limit in peaks]
        rms = float(
            np.sqrt(
                trapezoid(tau[:, j] ** 2, solution.trajectory.time)
                / np.ptp(solution.trajectory.time)
            )
        )
        return (
            html.escape(motor.name),
            drives,
            number(motor.inertia),
            _friction(motor.friction),
            cells[0],
            number(rms),
            cells[1],
        )

    head = (
        "motor",
        "drives (ratio)",
        "inertia, kg m²",
        "friction",
        "torque / limit, N m",
        "rms torque, N m",
        "speed / limit, rad/s",
    )
    return html_table(head, (row(j, motor) for j, motor in enumerate(model.motors)), (2, 4, 5, 6))


def _library_table(generated: Any) -> str:
    """Table of the C library; empty if there is none."""
    if generated is None:
        return ""
    rows = [
        ("functions", html.escape(", ".join(generated.functions))),
        ("files", html.escape(", ".join(Path(file).name for file in generated.files))),
        ("digest", f"<code>{html.escape(generated.digest[:16])}</code>"),
    ]
    return "<h2>C library</h2>\n" + html_table(("quantity", "value"), rows)


def write_report(
    equations: Equations,
    solution: Solution,
    directory: str | Path,
    analysis: Analysis | None = None,
    generated: Any = None,
    *,
    limits: Limits | None = None,
    compared: tuple[Solution, ...] = (),
    robustness: list[dict[str, Any]] | None = None,
) -> Path:
    """Write the report of a solution: a self-contained ``index.html``, and each plot as an svg
    file.

    Parameters
    ----------
    equations : Equations
        Of the model of the solution.
    solution : Solution
        With or without verification.
    directory : str or Path
        Created if it does not exist.
    analysis : Analysis, optional
        Default: at the start of the move.
    generated : GeneratedLibrary, optional
        The C library to list.
    limits : Limits, optional
        Limits of the solution; default: those of the model file.
    compared : tuple of Solution
        Solutions of the same move by several methods, this one among them, from
        `flexgen.inversion.comparison.comparison.compare_methods`.
    robustness : list of dict, optional
        Rows from `flexgen.feedback.loop.robustness.compare_plants`.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    directory = Path(directory)
    check_folder(directory)
    model = equations.model
    analysis = analysis if analysis is not None else _analysis_at_start(equations, solution)
    verified = tuple(one for one in compared if one.simulation is not None)
    drawn = pictures(equations, solution, analysis, limits or Limits(), verified)
    check_folder(directory, (PAGE, *(f"{picture.name}.svg" for picture in drawn)))
    motion = write_motion(
        equations, solution.trajectory, solution.simulation, directory, solution.move.duration
    )
    accuracy = solution.accuracy() if solution.simulation is not None else None
    table = Comparison(solution, verified if len(verified) > 1 else (), robustness)
    compared_parts = table.content() if table.solutions or robustness else ()
    scales = scales_of_page(
        solution.figures(),
        *(accuracy.lengths() if accuracy is not None else []),
        *lengths_of(compared_parts),
    )
    title = f"{model.title}, move {solution.move.name}"
    parts = [
        head(title),
        _introduction(title, model, solution),
        "<h2>Summary</h2>\n",
        _summary(solution, scales),
        accuracy_tables(accuracy, scales) if accuracy is not None else "",
        "<h2>Plots</h2>\n",
        ""
        if motion is None
        else f'<p><a href="{motion.name}">The moving robot</a> (an animation)</p>\n',
        *(figure_element(picture, directory) for picture in drawn),
        html_of_rows(compared_parts, is_page=True, scales=scales),
        "<h2>Motors</h2>\n",
        _motors(model, solution, limits or Limits()),
        "<h2>Dynamics at the start of the move</h2>\n"
        + html_of_rows(dynamics_parts(analysis), is_page=True)
        if analysis is not None
        else "",
        _library_table(generated),
        (
            "<h2>Source of the model</h2>\n"
            f'<p class="source">{html.escape(model.source.strip())}</p>\n'
        )
        if model.source
        else "",
        foot(),
    ]
    return write_text(directory / PAGE, "".join(parts))


def _analysis_at_start(equations: Equations, solution: Solution) -> Analysis | None:
    """Analysis at the start of the move; None if there is no equilibrium."""
    try:
        return analyze(equations, solution.move.start)
    except SolverError:
        return None


def head(title: str) -> str:
    """Start of the page: its head with title and style."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n"
    )


def _introduction(title: str, model: RobotModel, solution: Solution) -> str:
    """Title, description of the model and warnings."""
    counts = (
        f"{model.n_m} motors, {model.n_g} actuated and {model.n_e} non-actuated coordinates, "
        f"{model.dof} degrees of freedom"
    )
    warnings = "".join(f"<li>{html.escape(line)}</li>" for line in solution.warnings)
    return (
        f"<h1>{html.escape(title)}</h1>\n"
        f'<p class="sub">{html.escape(model.description)}. {html.escape(counts)}.</p>\n'
        f"<p>{html.escape(in_words(solution))}</p>\n"
    ) + (f'<div class="warn"><ul>{warnings}</ul></div>\n' if warnings else "")


def figure_element(picture: Picture, directory: Path) -> str:
    """Write a picture to its svg file; return its HTML element, whose title does not repeat that
    of the page.
    """
    plots.save(picture.figure, directory / f"{picture.name}.svg")
    caption = html.escape(picture.caption)
    title = picture.figure.get_suptitle()
    for text in picture.figure.texts:
        if text.get_text() == title:
            short = title.partition(": ")[2] or title
            text.set_text(short[:1].upper() + short[1:])
    drawing = re.sub(
        r"^<svg ",
        f'<svg role="img" aria-label="{caption}" ',
        plots.svg(picture.figure, f"{picture.name}-"),
    )
    return (
        f'<figure id="{picture.name}">\n{drawing}<figcaption>{caption}</figcaption>\n</figure>\n'
    )


@provides("Solution.report")
def report_solution(solution: Solution, folder: str | Path) -> Path:
    """Write the report of a solution, see `flexgen.Solution.report`."""
    return write_report(derive(solution.model), solution, folder)


@provides("Comparison.report")
def report_comparison(comparison: Comparison, folder: str | Path) -> Path:
    """Write the report of a solution with the tables of a comparison, see `flexgen.compare`."""
    solution = comparison.solution
    rows = comparison.robustness
    return write_report(
        derive(solution.model), solution, folder, compared=comparison.solutions, robustness=rows
    )
