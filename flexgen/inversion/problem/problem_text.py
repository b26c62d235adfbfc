"""Why a solution cannot be used, and what to do, as a sentence for the user."""

from __future__ import annotations

from flexgen.base.display import both_measured
from flexgen.inversion.judge.attempt import ENERGY
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.undamped import UNDAMPED
from flexgen.inversion.solution import Solution, limit_warnings
from flexgen.inversion.unverified_solution import residual_is_small


def problem_of(solution: Solution, accuracy: float) -> str:
    """Why a solution cannot be used; empty if it can.

    Parameters
    ----------
    solution : Solution
    accuracy : float [m and rad]
        The largest error that was asked of `flexgen.solve`.
    """
    if solution.status == Status.TOLERANCE_NOT_MET:
        return _inaccuracy(solution, accuracy)
    if solution.status != Status.LIMITS_EXCEEDED:
        return ""
    lines = limit_warnings(solution.model, solution.trajectory)
    lines = lines or tuple(text for text in solution.warnings if "exceeds its limit" in text)
    more = f", and {len(lines) - 1} more (see the warnings)" if len(lines) > 1 else ""
    slower = ["exceeds its limit" in line for line in lines]  # not a range: more time helps
    advice = (
        []
        if all(slower)
        else ["choose another target or path: more time does not help beyond a range"]
    )
    if any(slower):
        advice.append("give the move more time, or keep torques and speeds with --limits")
    advice.append("for studies use --ignore-limits")
    return f"{solution.status}: {lines[0]}{more}; {'; '.join(advice)}"


def _inaccuracy(solution: Solution, accuracy: float) -> str:
    """Message with the reason why a solution does not meet the ``accuracy`` [m or rad], the most
    certain one first, and what to do.
    """
    if solution.stopped:
        return f"{solution.status}: {solution.stopped}; the trajectory is the best so far"
    if held := [text for text in solution.warnings if "makes the output deviate" in text]:
        return f"{solution.status}: {held[0]}"
    if undamped := [text for text in solution.warnings if UNDAMPED in text]:
        return f"{solution.status}: {undamped[0]}"
    simulation = solution.simulation
    cause = solution.details.get("cause")
    if cause:
        return f"{solution.status}: {cause}"
    if simulation is not None and simulation.energy_error > ENERGY:
        return (
            f"{solution.status}: the energy balance of the simulation has an error of "
            f"{simulation.energy_error:.1e}, so it verifies nothing; check whether the model is "
            "too stiff"
        )
    if (
        simulation is not None
        and simulation.feedback is not None
        and not residual_is_small(solution)
    ):
        return (
            f"{solution.status}: the torques do not satisfy the equations of motion: relative "
            f"residual {solution.residual_relative:.1e}; try a finer --mesh or a smoother move"
        )
    # with active limits the plan itself deviates from the path
    aim = "path"
    errors = both_measured(solution.tool_error_max_m, solution.tool_error_max_rad)
    if solution.plan_error_max is not None:
        aim = "plan"
        errors = both_measured(solution.plan_error_max_m, solution.plan_error_max_rad)
    return (
        f"{solution.status}: the simulated output deviates from the {aim} by {errors}, more "
        f"than the accuracy {accuracy:.3g}; "
        + (
            "give the move more time or "
            if aim == "path"
            else "loosen the limits, give the move more time or "
        )
        + ("" if solution.method == "lq" else "take --method auto or lq, or ")
        + "a finer --mesh"
    )
