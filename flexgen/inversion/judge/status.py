"""Status: how far a solution of inverse dynamics can be relied on."""

from __future__ import annotations

from flexgen.base.spec.explained_status import ExplainedStatus


class Status(ExplainedStatus):
    """Status of a solution.

    Examples
    --------
    >>> status = flexgen.solve("elbow").status
    >>> print(status, "-", status.advice)
    solved - Use the trajectory; read the warnings first if there are any.
    >>> status is flexgen.Status.SOLVED
    True
    """

    SOLVED = (
        "solved",
        (
            "The equations of motion hold, and the verification, where it is on, found no error "
            "above the tolerance."
        ),
        "Use the trajectory; read the warnings first if there are any.",
    )
    LIMITS_ACTIVE = (
        "limits active",
        "The limits keep the tool off the path; the motion satisfies the equations of motion.",
        (
            "Compare the tool error with what the task allows; to reduce it, give the move more "
            "time or loosen the limits."
        ),
    )
    LIMITS_EXCEEDED = (
        "limits exceeded",
        "The equations of motion hold and the verification found no error, but limits of the "
        "model file or given ones are exceeded.",
        "The robot cannot do this move. Beyond the range of a coordinate: choose another target "
        "or path. Beyond a torque, speed or acceleration: give it more time, or keep the limits "
        "with --limits. For studies use --ignore-limits.",
    )
    BASELINE = (
        "baseline",
        "The torques come from a simplified model; the tool error is measured, not bounded.",
        "Use the solution for comparison only; for exact tracking use another method.",
    )
    TOLERANCE_NOT_MET = (
        "tolerance not met",
        (
            "The verification found an error above the tolerance, or the computation was ended "
            "before it was complete."
        ),
        "Do not use the torques; take --method auto or lq, else a smoother or slower move, a "
        "finer --mesh, a longer --preview, or more time with --time-limit.",
    )
