"""Bounds of numbers in annotations: the check of a public function and the type of its option on
the command line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True)
class Bound:
    """Bounds of a number, as metadata of ``Annotated``.

    Attributes
    ----------
    least : float or int
        The smallest value.
    most : float or int
        The largest value.
    excluded : bool
        The smallest value itself is refused.
    words : str
        What is expected, for the message.

    Examples
    --------
    >>> from flexgen.base.checks.bounds import Bound
    >>> Bound(0.0, 2.0, excluded=True).passes(2.0)
    True
    """

    least: float
    most: float = math.inf
    excluded: bool = False
    words: str = ""

    def passes(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        is_above = value > self.least if self.excluded else value >= self.least
        return is_above and value <= self.most


Positive = Annotated[float, Bound(0.0, excluded=True, words="a number > 0")]
NotNegative = Annotated[float, Bound(0.0, words="a finite number >= 0")]
Count = Annotated[int, Bound(1, words="a whole number >= 1")]
CountOrZero = Annotated[int, Bound(0, words="a whole number >= 0")]
Seed = Annotated[int, Bound(0, words="a whole number >= 0")]
TimeLimit = Annotated[float, Bound(0.0, words="a time >= 0 in s; None or 0: no limit")]
