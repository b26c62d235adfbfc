"""Results of identifications as text with tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.base.display import choose_scales
from flexgen.views.reports.text_tables import number, paragraph, table

if TYPE_CHECKING:
    from flexgen.identification.experiments.excitation import Plan
    from flexgen.identification.experiments.experiment import Experiment
    from flexgen.identification.motions.motion_fit import MotionFit
    from flexgen.identification.motions.time_domain import Validation
    from flexgen.identification.responses.frequency_response import Frf
    from flexgen.identification.responses.result import IdentificationResult
    from flexgen.identification.responses.structure import Structure
    from flexgen.identification.responses.verdict import Verdict
    from flexgen.identification.rigid.rigid_file import RigidIdentification
    from flexgen.model.elements import RobotModel

PARAMETERS = ("parameter", "value", "unit", "sd", "start", "")


def plan_text(plan: Plan, robot: RobotModel) -> str:
    """The poses of a plan, and the accuracy that is expected of its experiments."""
    joints = enumerate(plan.joints(robot).tolist(), 1)
    return "\n".join(
        [
            f"{robot.name}: {len(plan.poses)} poses, {plan.realizations * plan.experiments} "
            f"experiments each, {len(plan.lines)} lines from {number(plan.frequencies[0])} to "
            f"{number(plan.frequencies[-1])} Hz",
            f"time of the robot: {number(plan.duration_s)} s",
            "",
            table(
                [[k, *q] for k, q in joints],
                ("pose", *(robot.coordinates[i].name for i in robot.i_g)),
            ),
            "",
            table(
                [[name, 100 * sd] for name, sd in plan.predicted.items()],
                ("parameter", "expected standard deviation, %"),
            ),
        ]
    )


def text_of_experiment(experiment: Experiment) -> str:
    """Speeds of the motors at the poses of an experiment."""
    rows = [[k, *speed] for k, speed in enumerate(experiment.speed_sd.tolist(), 1)]
    return table(rows, ("pose", *(f"{name}, rad/s rms" for name in experiment.plan.motors)))


def text_of_responses(data: Frf) -> str:
    """Size and accuracy of frequency responses."""
    return (
        f"{data.model}: {len(data.poses)} poses, {len(data.w)} lines, {len(data.outputs)} x "
        f"{len(data.motors)}\n"
        f"median standard deviation by noise: {number(100 * data.relative_sd())} %"
    )


def text_of_identification(found: IdentificationResult, *more: str) -> str:
    """The parameters of a fit with their accuracy, further texts, and the directions that the data
    do not determine.
    """
    from flexgen.identification.responses.result import deviation_text

    data = found.to_dict()
    rows = [
        [
            row["name"],
            row["value"],
            row["unit"],
            deviation_text(row["sd"], row["sd_is_relative"]),
            row["start"],
            "at its bound" if row["at_bound"] else "not determined" if row["weak"] else "",
        ]
        for row in data["parameters"]
    ]
    lines = [
        f"{data['model']}: {found.status}, cost {number(found.cost)} (1 expected), reached by "
        f"{found.agreed} of {found.starts} starts, {number(found.wall_s)} s",
        *(
            [f"misfit beyond the noise: {percent(found.model_error)} % of the responses"]
            if found.model_error > 0
            else []
        ),
        *([found.grade.sentence] if found.grade is not None else []),
        paragraph(f"{found.status.sentence} {found.status.advice}"),
        *(f"possible cause: {cause}" for cause in found.causes),
        *([f"amplitude test: {amplitude_sentence(found)}"] if amplitude_sentence(found) else []),
    ]
    graded = grade_table(found) if found.model_error > 0 else ""
    return _join("\n".join(lines), table(rows, PARAMETERS), graded, *more, _sentences(found.weak))


def percent(value: float) -> str:
    """A misfit in percent; a bound below 0.1 %, which no feedforward shows."""
    from flexgen.identification.estimator.fit_grade import SHOWN

    return number(100 * value) if value >= SHOWN else f"< {100 * SHOWN:g}"


def grade_table(found: IdentificationResult) -> str:
    """Errors of the torques of the model and misfits of the elements in bands of frequency.

    Empty without a grade.
    """
    if found.grade is None:
        return ""
    rows = []
    for band in found.grade.bands:
        i, j = np.unravel_index(int(np.argmax(band.misfit)), band.misfit.shape)
        element = f"{found.grade.motors[j]} -> {found.grade.outputs[i]}"
        span = f"{number(band.low)} to {number(band.high)}"
        typical = float(np.median(band.misfit))
        largest = float(band.misfit[i, j])
        rows.append(
            [span, percent(band.torque_error), percent(typical), element, percent(largest)]
        )
    return table(rows, ("Hz", "torque error, %", "misfit, median, %", "largest, element", "%"))


def amplitude_sentence(found: IdentificationResult) -> str:
    """Result of the amplitude test in words, or advice to give a second level for a misfit without
    a known cause.
    """
    from flexgen.identification.responses.result import FitStatus

    if found.amplitude is not None:
        return found.amplitude.sentence
    if found.causes or found.status != FitStatus.MODEL_ERROR:
        return ""
    return (
        "give responses at a second level (levels=, --levels), which tell whether the robot is "
        "nonlinear"
    )


def validation_text(checked: Validation, motors: Sequence[str]) -> str:
    """Validation of a fit by experiments that were not used, as text."""
    columns = zip(motors, checked.fit_percent, checked.white, strict=True)
    rows = [[name, fit, 100 * white] for name, fit, white in columns]
    title = (
        f"simulation of experiments that were not used: cost {number(checked.cost)} (1 expected)"
    )
    return f"{title}\n\n{table(rows, ('motor', 'fit, %', 'white lags, %'))}"


def verdict_text(verdict: Verdict) -> str:
    """Tool errors of feedforward before and after an identification."""
    robots = "x the robot of --truth" if verdict.known else "robots drawn from the covariance"
    kinds = [
        unit for unit in ("m", "rad") if getattr(verdict.rows[0], f"error_{unit}") is not None
    ]
    quantiles = [(unit, part) for unit in kinds for part in (0.5, 0.95)]
    found = [{key: row.quantile(key[1], key[0]) for key in quantiles} for row in verdict.rows]
    scales = choose_scales((), *((row[key], key[0]) for row in found for key in quantiles))
    rows = [
        [one.model, *(scales[key[0]].cell(row[key]) for key in quantiles)]
        for one, row in zip(verdict.rows, found, strict=True)
    ]
    head = (
        "torques of the model",
        *(f"{what}, {scales[u].unit}" for u in kinds for what in ("median", "95 %")),
    )
    title = (
        f"largest tool error of the move {verdict.move} with motor feedback, {verdict.robots} "
        f"{robots}:"
    )
    return f"{title}\n\n{table(rows, head)}"


def structure_text(found: Structure) -> str:
    """The springs that were added and removed, and the tables of the new ones for the model
    file.
    """
    rows = [
        [
            c.kind,
            c.name,
            c.gain,
            "" if c.held_out is None else c.held_out,
            "kept" if c.kept else "",
        ]
        for c in found.changes
    ]
    fit = found.identified
    lines = [
        f"{fit.vector.model.name}: added {', '.join(found.added) or 'nothing'}, "
        f"removed {', '.join(found.removed) or 'nothing'}",
        f"fit of the result: {fit.status}, cost {number(fit.cost)} (1 expected)",
        "",
        table(
            rows,
            ("change", "coordinate", "gain of the criterion", "cost at held-out poses, ratio", ""),
        ),
    ]
    for element, dof in (
        (e, dof) for e in found.model.elements for dof in e.dofs if dof.name in found.added
    ):
        lines += [
            "",
            (
                f"for the model file, in the element {element.name} behind the joint "
                f"{dof.name.rpartition('_')[0]}:"
            ),
            "",
            "[[element.dof]]",
            f'name = "{dof.name}"',
            'type = "rotation"',
            f"axis = [{', '.join(f'{x:.6g}' for x in dof.axis)}]",
            (
                'spring = { type = "linear", stiffness = '
                f"{getattr(dof.spring, 'stiffness', 0.0):.6g} }}"
            ),
            f"damping = {dof.damping:.6g}",
        ]
    return "\n".join(lines)


def text_of_rigid(found: RigidIdentification) -> str:
    """Frictions and rotors of a rigid arm with their standard deviations and errors; gears and
    counterbalances.
    """
    fit = found.fit
    numbers = found.numbers
    sd = found.deviations

    def both(name: str) -> str:
        return (
            f"{number(numbers[name])} +- {sd[name]:.2g}"
            if name in sd
            else number(numbers.get(name, 0.0))
        )

    kinds = {"inertia": "kg m^2", "viscous": "N m s/rad", "coulomb": "N m", "offset": "N m"}
    if fit.fades.any():
        kinds |= {"stribeck": "N m", "alpha": "s/rad"}
    rows: list[list[Any]] = []
    for j, motor in enumerate(fit.model.motors):
        cells: list[Any] = [motor.name, *(both(f"{motor.name}.{kind}") for kind in kinds)]
        rows.append(cells + [100 * run[j] for runs in found.errors.values() for run in runs])
    head = ["motor", *(f"{kind}, {unit}" for kind, unit in kinds.items())]
    head += [
        f"{name} {k}, error %"
        for name, runs in found.errors.items()
        for k in range(1, len(runs) + 1)
    ]
    balance = [[name, both(name)] for name in numbers if ".counterbalance_" in name]
    lags = [
        [name, unit, value, "" if sd_ is None else sd_] for name, unit, value, sd_ in found.lags
    ]
    below = (
        f"below {number(fit.limit_hz)} Hz"
        if fit.limit_hz < float("inf")
        else "through the filter of the motion"
    )
    gears = "\n".join(
        f"  {name}: {deflection.sentence}" for name, deflection in found.gears.items()
    )
    return _join(
        (
            f"{fit.model.name}: {fit.status}, {fit.base_parameters} base parameters of "
            f"{len(fit.pi)} numbers\n"
        )
        + paragraph(" ".join(fit.texts)),
        paragraph(f"One mistake can be the reason: {fit.mistake.sentence}") if fit.mistake else "",
        f"errors: rms over the standard deviation of the torque, {below}, of samples that move; "
        "left out: on quarters of the recordings, of the fit to the others",
        table(rows, tuple(head)),
        paragraph(
            "Compliances of gears that the model file does not have, and the delay of torques "
            "after angles:"
        ),
        table(lags, ("lag", "unit", "value", "+-")),
        _springs(found),
        table(balance, ("counterbalance", "N m, arm side")) if balance else "",
        "stiffness of the gears from the link encoders, arm side, 90 % interval:" if gears else "",
        gears,
        _sentences(found.notes),
    )


def _springs(found: RigidIdentification) -> str:
    """A sentence on gears that deflect otherwise than in the model file; empty: the recordings
    show none.
    """
    other = [
        name.partition(".")[0]
        for name, _, value, sd in found.lags[:-1]
        if sd is not None and abs(value) > 3 * sd
    ]
    if not other:
        return ""
    return paragraph(
        f"Gears of {', '.join(other)} deflect otherwise than in the model file. The numbers "
        "above take that into account, the springs of the new file do not: identify them from "
        "frequency responses."
    )


def text_of_motion_fit(found: MotionFit, segment_s: float | None = None) -> str:
    """The parameters of a fit in segments (of this length, where it is known), and how it explains
    the outputs.
    """
    from flexgen.identification.responses.result import deviation_text

    values = found.values
    sd = found.sd
    length = "" if segment_s is None else f" of {number(segment_s)} s"
    rows = [
        [
            u.name,
            values[u.name],
            u.parameter.unit,
            deviation_text(sd[u.name], u.scale == "log"),
            u.start,
            "not determined" if found.is_weak(u.name) else "",
        ]
        for u in found.vector.unknowns
    ]
    model = found.vector.model
    outputs = [motor.name for motor in model.motors]
    outputs += [f"link encoder {k}" for k in range(1, len(found.rms) - len(outputs) + 1)]
    columns = [outputs, found.rms, found.fit_percent, [100 * white for white in found.white]]
    columns += [found.held_out_percent] if found.held_out_percent else []
    head = ["output", "residual rms", "fit, %", "white lags, %"] + ["held out, %"] * bool(
        found.held_out_percent
    )
    return _join(
        f"{model.name}: {found.status}, {found.segments} segments{length}, "
        f"{number(found.wall_s)} s\n"
        + paragraph(f"{found.status.sentence} {found.status.advice}"),
        table(rows, PARAMETERS),
        table([[*row] for row in zip(*columns, strict=True)], tuple(head)),
        _sentences(found.weak),
        _sentences(found.notes),
    )


def _sentences(lines: Sequence[str]) -> str:
    return "\n".join(f"{line}." for line in lines)


def _join(*parts: str) -> str:
    """The parts that are not empty, with an empty line between them."""
    return "\n\n".join(part for part in parts if part)
