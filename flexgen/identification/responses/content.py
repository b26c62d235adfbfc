"""Content of fits with a parameter vector: the table of parameters, and what a fit of responses
says about itself.

``found`` is an `IdentificationResult`, or another `Estimated`; their module imports this one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.base.rows import Column, Data, Part, Prose, Row, Shown, Table
from flexgen.identification.estimator.fit_grade import SHOWN, Band, Grade
from flexgen.identification.estimator.status import FitStatus

PARAMETERS = (
    Column("parameter", key="name"),
    Column("value", key="value"),
    Column("unit", key="unit"),
    Column("sd", key="sd"),
    Column("", key="sd_is_relative", is_data=True),
    Column("start", key="start"),
    Column("change", key="change"),
    Column("", key="in_file", is_data=True),
    Column("", key="at_bound", is_data=True),
    Column("", key="weak", is_data=True),
    Column(""),
    Column("description", key="description", is_long=True),
)
BANDS = (
    Column("Hz"),
    Column("torque error, %", key="torque_error"),
    Column("misfit, median, %", key="misfit_median"),
    Column("largest, element", key="largest"),
    Column("%", key="misfit_largest"),
)


def parameter_table(found: Any) -> Table:
    """The parameters of a fit with their standard deviations and start values."""
    held = getattr(found, "at_bound", ())
    rows = []
    for unknown, number in zip(found.vector.unknowns, found.fitted, strict=True):
        change = number.value / unknown.start - 1.0 if unknown.start else None
        weak = not number.is_determined
        at_bound = number.name in held
        flag = "at its bound" if at_bound else "not determined" * weak
        rows.append(
            (
                number.name,
                number.value,
                number.unit,
                Shown(number.sd, deviation_text(number.sd, number.is_relative)),
                number.is_relative,
                unknown.start,
                None if change is None else Shown(change, f"{100 * change:+.3g} %"),
                unknown.parameter.value,
                at_bound,
                weak,
                flag,
                unknown.parameter.doc,
            )
        )
    return Table(PARAMETERS, tuple(rows), "Parameters", "parameters")


def content_of_responses(found: Any) -> tuple[Part, ...]:
    """Status and misfit of a fit of responses, its parameters, and the bands of its misfit."""
    status = found.status
    words = [f"{status.sentence} {status.advice}"]
    grade = "" if found.grade is None else f"{found.grade.sentence}."
    words += [grade[0].upper() + grade[1:]] if grade else []
    words += [" ".join(found.load_note)] if any(found.load_note) else []
    words += [f"possible cause: {cause}" for cause in found.causes]
    amplitude = amplitude_sentence(found)
    words += [f"amplitude test: {amplitude}"] if amplitude else []
    causes = [{"words": c.words, "share": c.share, "size": c.size} for c in found.causes]
    tested = [] if found.amplitude is None else [Data("amplitude", found.amplitude.to_dict())]
    return (
        Prose(f"{found.vector.model.name}: {status}", is_title=True),
        Data("model", found.vector.model.name),
        *_figures(found),
        *(Prose(line, "status") for line in words),
        parameter_table(found),
        *_bands(found),
        *(Prose(f"{line}.", "weak") for line in found.weak),
        Data("sentence", " ".join([status.sentence, found.load_note[0]]).strip()),
        Data("advice", " ".join([status.advice, found.load_note[1]]).strip()),
        Data("weak_directions", list(found.weak)),
        Data("causes", causes),
        *tested,
    )


def _figures(found: Any) -> list[Part]:
    """The figures of the fit."""
    error = found.model_error
    misfit: Part = Data("model_error", error)
    if error > 0:
        unit = "% of the responses"
        misfit = Row("misfit beyond the noise", error, unit, "model_error", text=percent(error))
    held: list[Part] = [
        Row(f"misfit of responses {k}, not fitted", part, "% of the responses", text=percent(part))
        for k, part in enumerate(found.held_out, 1)
    ]
    held += [Data("held_out", list(found.held_out))] if found.held_out else []
    return [
        Row("status", str(found.status), "", "status"),
        Row("cost", found.cost, "", "cost_per_degree_of_freedom", note="1 expected"),
        misfit,
        *held,
        Row("weights", found.weights, "", "weights"),
        Row("starts at the best cost", found.agreed, f"of {found.starts}", "starts_at_best_cost"),
        Data("starts", found.starts),
        Row("iterations", found.iterations, "", "iterations"),
        Row("poses", len(found.data.poses), "", "poses"),
        Row("frequencies", len(found.data.w), "", "frequencies"),
        Row("time of the fit", found.wall_s, "s", "wall_s"),
    ]


def _bands(found: Any) -> list[Part]:
    """Errors of the torques of the model and misfits of the elements in bands of frequency."""
    grade = found.grade
    if grade is None:
        return []
    data = Data("grade", grade.to_dict())
    if found.model_error <= 0:
        return [data]
    cells = tuple(_band(grade, band) for band in grade.bands)
    return [Table(BANDS, cells, "Misfit", "misfits"), data]


def _band(grade: Grade, band: Band) -> tuple[object, ...]:
    """The row of a band: its ends, and the errors in it."""
    i, j = np.unravel_index(int(np.argmax(band.misfit)), band.misfit.shape)
    typical = float(np.median(band.misfit))
    largest = float(band.misfit[i, j])
    return (
        f"{band.low:.4g} to {band.high:.4g}",
        Shown(band.torque_error, percent(band.torque_error)),
        Shown(typical, percent(typical)),
        f"{grade.motors[j]} -> {grade.outputs[i]}",
        Shown(largest, percent(largest)),
    )


def percent(value: float) -> str:
    """A misfit in percent; a bound below 0.1 %, which no feedforward shows."""
    if value < SHOWN:
        return f"< {100 * SHOWN:g}"
    size = 100 * value
    return f"{size:.0f}" if size >= 1e3 else f"{size:.4g}"


def deviation_text(sd: float | None, relative: bool) -> str:
    """A standard deviation for a table; a dash where there is none."""
    if sd is None:
        return "-"
    return f"{100 * sd:.2g} %" if relative else f"{sd:.2g}"


def amplitude_sentence(found: Any) -> str:
    """Result of the amplitude test in words, or advice to give a second level for a misfit without
    a known cause.
    """
    if found.amplitude is not None:
        return found.amplitude.sentence
    if found.causes or found.status != FitStatus.MODEL_ERROR:
        return ""
    return (
        "give responses at a second level (levels=, --levels), which tell whether the robot is "
        "nonlinear"
    )
