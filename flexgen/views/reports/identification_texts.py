"""Results of identifications as text with tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from flexgen.base.display import choose_scales
from flexgen.base.rows import Row
from flexgen.views.reports.row_views import text_of_rows
from flexgen.views.reports.text_tables import number, table

if TYPE_CHECKING:
    from flexgen.identification.experiments.excitation import Plan
    from flexgen.identification.motions.motion_fit import MotionFit
    from flexgen.identification.motions.time_domain import Validation
    from flexgen.identification.responses.result import IdentificationResult
    from flexgen.identification.responses.structure import Structure
    from flexgen.identification.responses.verdict import Verdict
    from flexgen.model.elements import RobotModel


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


def text_of_identification(found: IdentificationResult, *more: str) -> str:
    """A fit, and further texts."""
    return _join(text_of_rows(found.content()), *more)


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


def text_of_motion_fit(found: MotionFit, segment_s: float) -> str:
    """A fit in segments of this length."""
    length = f"of {number(segment_s)} s"
    return text_of_rows(
        replace(part, note=length) if isinstance(part, Row) and part.key == "segments" else part
        for part in found.content()
    )


def _join(*parts: str) -> str:
    """The parts that are not empty, with an empty line between them."""
    return "\n\n".join(part for part in parts if part)
