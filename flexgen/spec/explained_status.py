"""Statuses that are texts with a sentence and an advice."""

from __future__ import annotations

from enum import StrEnum
from typing import Self


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
        member.sentence, member.advice = sentence, advice
        return member
