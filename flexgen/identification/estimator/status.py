"""Status of an estimation: how far its numbers can be used."""

from __future__ import annotations

from collections.abc import Mapping

from flexgen.base.spec.explained_status import OUT_OF_TIME, STOPPED, ExplainedStatus


class FitStatus(ExplainedStatus):
    """Status of an estimation.

    ``sentence`` and ``advice`` are those of a fit of measured responses; other fits have a table
    of their own where another cause is likely, see `texts`.
    """

    FITTED = (
        "fitted",
        "The model agrees with the measurement within the noise.",
        "Use the new model file. Masses and payload are not checked by a fit: what is wrong "
        "there is hidden in the other parameters.",
    )
    MODEL_ERROR = (
        "model error",
        "The model differs from the measurement by more than the noise.",
        "Look at the report: a missing spring, a wrong mass or payload, an unknown delay, the "
        "wrong hold of the torques, or friction. Standard deviations are not given: the errors "
        "of the parameters may be many times those that noise causes.",
    )
    SMALL_ERROR = (
        "small error",
        "The model agrees with the measurement to 0.1 % of the motion or the responses; the "
        "rest is more than the noise.",
        (
            "Use the new model file. Standard deviations are not given: noise causes only a "
            "part of the errors."
        ),
    )
    NOT_CHECKED = (
        "not checked",
        "The fit was not compared with motions that were left out.",
        "Validate it with other recordings before it is used.",
    )
    NOISE_TOO_LARGE = (
        "noise too large",
        (
            "The model agrees with the measurement better than its noise allows: the variances "
            "of the data are too large."
        ),
        (
            "Check how the variances were estimated: periods that differ by drift or by a "
            "transient make them large."
        ),
    )
    POORLY_VALIDATED = (
        "poorly validated",
        "The model does not predict recordings that were not fitted.",
        "Do not use the new model file where the robot moves as there: fit recordings of both "
        "kinds, fit fewer parameters, or look for what the model lacks.",
    )
    AT_BOUND = (
        "at a bound",
        "At least one parameter is at its bound.",
        "Check the start values and the bounds of the parameters that the table marks.",
    )
    NOT_CONVERGED = (
        "not converged",
        "The search for the best parameters did not come to an end; the values are those of its "
        "best step.",
        (
            "Do not use the values; begin nearer to the truth, fix parameters that are weak, or "
            "take more starts."
        ),
    )
    TIME_LIMIT = OUT_OF_TIME
    INTERRUPTED = STOPPED

    @property
    def ended_early(self) -> bool:
        """Whether the search was ended from outside, by the time limit or by Ctrl-C."""
        return self in (FitStatus.TIME_LIMIT, FitStatus.INTERRUPTED)

    @property
    def agrees(self) -> bool:
        """Whether the new model file can be used."""
        return self in (FitStatus.FITTED, FitStatus.SMALL_ERROR)

    @property
    def has_deviations(self) -> bool:
        """Whether the standard deviations from the residuals are those of the parameters.

        They are not where the model is wrong, as the fitted or other recordings show, where a
        bound holds a parameter, and where the search did not end.
        """
        return self in (FitStatus.FITTED, FitStatus.NOT_CHECKED, FitStatus.NOISE_TOO_LARGE)

    def texts(self, own: Mapping[FitStatus, tuple[str, str]]) -> tuple[str, str]:
        """Sentence and advice, from a table of one kind of fit where that has them."""
        return own.get(self, (self.sentence, self.advice))


def status_of_end(status: FitStatus, reason: str) -> FitStatus:
    """The status of a fit; of a search that was ended from outside, the reason of the end.

    See `flexgen.base.calls.deadline.reason_of_end`.
    """
    return FitStatus.of_value(reason) if reason else status
