"""A solution in words: the effect of the torques, how it was verified, and the conditions."""

from __future__ import annotations

from flexgen.base.display import both_measured, format_size
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.simulation.result import growth_text

NUMERICAL = 1e-7  # m or rad: smaller errors are those of the computation, no accuracy of a robot

_BEGIN = {
    Status.SOLVED: "These motor torques move {what} along {path}",
    Status.LIMITS_ACTIVE: "These motor torques keep the limits, and {what} leaves {path} for them",
    Status.LIMITS_EXCEEDED: (
        "The robot cannot give these motor torques: {reason}; with them {what} would follow {path}"
    ),
    Status.BASELINE: (
        "These motor torques come from a simplified model (method {method}), and {what} leaves "
        "{path}"
    ),
    Status.TOLERANCE_NOT_MET: (
        "Do not use these motor torques: they were not found to move {what} along {path}"
    ),
}


def in_words(solution: Solution) -> str:
    """One paragraph: what the motor torques do, by how much the output is off, with which
    feedback, for which robot.
    """
    model = solution.model
    what = f"the {'output' if model.output.type == 'combination' else 'tool'} of {model.title}"
    path = f"the move {solution.move.name} of {solution.move.duration:.4g} s"
    reason = (
        " ".join(solution.warnings[0].split()).rstrip(".")
        if solution.warnings
        else "limits are exceeded"
    )
    begin = _BEGIN[solution.status].format(
        what=what, path=path, reason=reason, method=solution.method
    )
    other = (
        "This holds for a robot with the numbers of the model file: another one needs feedback, "
        "and has larger errors."
    )
    return f"{begin}. {_evidence(solution)} {other}"


def _evidence(solution: Solution) -> str:
    """Method of the verification, and the largest error."""
    run = solution.simulation
    if solution.status == Status.TOLERANCE_NOT_MET and solution.held_simulation is not None:
        run = solution.held_simulation
    if run is None:
        size = f"{solution.residual_max_Nm:.3g} N m"
        return (
            f"They fulfil the equations of motion to {size}, but no simulation has verified them."
        )
    errors = both_measured(run.tool_error_max_m, run.tool_error_max_rad)
    if solution.status == Status.LIMITS_ACTIVE and solution.path_distance_max_m is not None:
        errors = format_size(solution.path_distance_max_m, "m")
    worst = max(run.tool_error_max_m or 0.0, run.tool_error_max_rad or 0.0)
    size = f"at most {errors}" + " (numerical)" * (worst < NUMERICAL)
    where = "In a simulation of the full model"
    if run.feedback is None:
        until = f" until {run.held_s:g} s after the end" if run.held_s else ""
        return f"{where} under these torques alone, without feedback, the error is {size}{until}."
    growth = (
        ""
        if run.growth is None
        else f"; without it small errors grow {growth_text(run.growth, run.growth_whole)}"
    )
    return (
        f"{where} the error is {size} together with motor feedback ({run.feedback.title}){growth}."
    )
