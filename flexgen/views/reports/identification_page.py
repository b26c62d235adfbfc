"""The report of an identification: one self-contained HTML page with tables and plots."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from flexgen.analysis.linear import linearize, modes, poles
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.result import IdentificationResult, deviation_text
from flexgen.model.elements import RobotModel
from flexgen.views.plots import identification as plots
from flexgen.views.reports.html import head
from flexgen.views.reports.html_tables import html_table, number
from flexgen.views.reports.identification_texts import amplitude_sentence, percent
from flexgen.views.reports.pictures import Picture
from flexgen.views.reports.result_page import write_page

CORRELATED = 0.5  # correlations from here on are listed
MOST_POSES = 12  # response grids in a page


def write_identification(identified: IdentificationResult, directory: str | Path) -> Path:
    """Write ``index.html`` with the fit, its parameters and pictures; each plot also as svg and
    png file.

    Raises
    ------
    ArgumentError
        The folder has files of another program under these names, or cannot be written.
    """
    model = identified.vector.model
    drawn = [
        Picture(
            f"responses_{k + 1}",
            plots.response_grid(identified.data, identified, k),
            "Amplitude from each motor's torque (column) to each motor's acceleration (row). "
            "Points: measured, with the 95 % band of their noise; grey: model at the start; "
            "red: identified model.",
        )
        for k in range(min(len(identified.data.poses), MOST_POSES))
    ]
    drawn[1:1] = [
        Picture(
            "parameters",
            plots.parameter_plot(identified),
            "Identified parameters over those of the model file"
            + (", with two standard deviations" if identified.status.has_deviations else "")
            + ". Grey: not determined by the data; the new model keeps the value of the file.",
        ),
        Picture(
            "residuals",
            plots.residual_plot(identified),
            "Differences between identified model and measurement over their standard "
            "deviations, all poses. Where noise is the only difference, half of the points are "
            "below the black line and 95 % below the red one. More in a band of frequencies: "
            "something is missing in the model there.",
        ),
        Picture(
            "correlations",
            plots.correlation_plot(identified),
            "Correlations of the identified parameters.",
        ),
    ]
    title = f"{model.title}: identification"
    parts = [
        head(title),
        f'<h1>{html.escape(title)}</h1>\n<p class="sub">{html.escape(model.description)}.</p>\n',
        "<h2>Fit</h2>\n",
        _summary(identified),
        "<h2>Parameters</h2>\n",
        _parameters(identified),
        _weak(identified),
        "<h2>Natural frequencies at home</h2>\n",
        _modes(model, identified.model),
    ]
    return write_page(Path(directory), parts, drawn)


def write_responses(data: Frf, directory: str | Path) -> Path:
    """Write ``index.html`` with measured frequency responses; each plot also as svg and png
    file.
    """
    drawn = [
        Picture(
            f"responses_{k + 1}",
            plots.response_grid(data, None, k),
            "Amplitude from each motor's torque (column) to each motor's acceleration (row), "
            "with the 95 % band of the noise.",
        )
        for k in range(min(len(data.poses), MOST_POSES))
    ]
    title = f"{data.model}: frequency responses"
    rows = [
        ("poses", f"{len(data.poses)}", ""),
        ("lines", f"{len(data.w)}", ""),
        (
            "lowest and highest frequency",
            f"{number(data.w[0] / 2 / np.pi)}, {number(data.w[-1] / 2 / np.pi)}",
            "Hz",
        ),
        ("periods averaged", f"{data.periods}", ""),
        ("experiments at each pose", f"{data.experiments}", ""),
        ("median standard deviation by noise", f"{100 * data.relative_sd():.2g}", "%"),
    ]
    parts = [
        head(title),
        f"<h1>{html.escape(title)}</h1>\n",
        html_table(("quantity", "value", "unit"), rows, (1,)),
    ]
    return write_page(Path(directory), parts, drawn)


def _summary(identified: IdentificationResult) -> str:
    status = identified.status
    bad = "" if status.agrees else " bad"
    error = identified.model_error
    misfit = html.escape(percent(error)) if error > 0 else "none"
    rows = [
        ("status", f'<span class="status{bad}">{html.escape(str(status))}</span>', ""),
        ("mean square of the weighted residuals", number(identified.cost), "1 expected"),
        ("weights", identified.weights, ""),
        ("misfit beyond the noise", misfit, "% of the response" if error > 0 else ""),
        *([("grade", identified.grade.sentence, "")] if identified.grade is not None else []),
        ("starts at the best cost", f"{identified.agreed} of {identified.starts}", ""),
        ("poses", f"{len(identified.data.poses)}", ""),
        ("frequencies", f"{len(identified.data.w)}", ""),
        ("time of the fit", number(identified.wall_s), "s"),
    ]
    words = f"<p>{html.escape(status.sentence)} {html.escape(status.advice)}</p>\n"
    words += "".join(
        f"<p>Possible cause: {html.escape(str(cause))}.</p>\n" for cause in identified.causes
    )
    if sentence := amplitude_sentence(identified):
        words += f"<p>Amplitude test: {html.escape(sentence)}.</p>\n"
    return html_table(("quantity", "value", "unit"), rows, (1,)) + words


def _parameters(identified: IdentificationResult) -> str:
    rows = []
    for row in identified.to_dict()["parameters"]:
        sd = deviation_text(row["sd"], row["sd_is_relative"])
        change = f"{100 * (row['value'] / row['start'] - 1):+.3g} %" if row["start"] else ""
        flag = (
            "at its bound"
            if row["at_bound"]
            else "not determined: file's value kept"
            if row["weak"]
            else ""
        )
        cells = (
            row["name"],
            number(row["value"], 6),
            row["unit"],
            sd,
            number(row["start"], 6),
            change,
            flag,
        )
        rows.append(tuple(html.escape(str(cell)) for cell in (*cells, row["description"])))
    names = ("parameter", "value", "unit", "sd", "start", "change", "flag", "description")
    return html_table(names, rows, (1, 3, 4, 5))


def _weak(identified: IdentificationResult) -> str:
    """Weak directions and large correlations in words."""
    lines = [html.escape(f"{line}.") for line in identified.weak]
    names = identified.vector.names
    correlation = identified.correlation
    pairs = [(abs(correlation[i, k]), i, k) for i in range(len(names)) for k in range(i)]
    for size, i, k in sorted(pairs, reverse=True)[:20]:
        if size > CORRELATED:
            lines.append(
                html.escape(f"{names[k]} and {names[i]}: correlation {correlation[i, k]:+.2f}.")
            )
    hidden = (
        "Masses, payload and lengths were taken from the model file: errors there are hidden in "
        "the parameters."
    )
    return f"<ul>{''.join(f'<li>{line}</li>' for line in [*lines, hidden])}</ul>\n"


def _modes(before: RobotModel, after: RobotModel) -> str:
    tables = []
    for model in (before, after):
        equations = derive(model)
        tables.append(
            modes(poles(linearize(equations, hold_joints(equations, np.array(model.home)))))
        )
    if len(tables[0]) != len(tables[1]):
        return "<p>The numbers of oscillatory modes differ before and after.</p>\n"
    rows = [
        (f"{k}", number(a[0]), number(100 * a[1]), number(b[0]), number(100 * b[1]))
        for k, (a, b) in enumerate(zip(*tables, strict=True), 1)
    ]
    names = ("mode", "before, Hz", "damping, %", "after, Hz", "damping, %")
    return html_table(names, rows, (0, 1, 2, 3, 4))
