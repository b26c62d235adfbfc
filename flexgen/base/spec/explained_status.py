"""Statuses that are texts with a sentence and an advice."""

from __future__ import annotations

from enum import StrEnum
from typing import Self

from flexgen.base.calls.deadline import INTERRUPTED, TIME_LIMIT

# Members of the statuses of fits, for searches that were ended from outside:
# value, sentence, advice.
OUT_OF_TIME = (
    TIME_LIMIT,
    "The time limit ended the search; the values are those of its best step.",
    "Allow more with --time-limit SECONDS (time_limit=), begin nearer to the robot, or fit fewer "
    "numbers.",
)
STOPPED = (
    INTERRUPTED,
    "Ctrl-C ended the search; the values are those of its best step.",
    "Run it again to the end before the values are used.",
)


class ExplainedStatus(StrEnum):
    """Base of statuses; a member is a string: ``str(status)`` and JSON give its value.

    Attributes
    ----------
    sentence : str
        What the status means.
    advice : str
        What to do next.
    """

    sentence: str
    advice: str

    def __new__(cls, value: str, sentence: str, advice: str) -> Self:
        """A member with its texts."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        member.advice = advice
        return member

    @classmethod
    def of_value(cls, value: str) -> Self:
        """The member with a value, such as one that `flexgen.base.calls.deadline.reason_of_end`
        gives.
        """
        return next(member for member in cls if member.value == value)
