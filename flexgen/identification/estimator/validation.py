"""Validation of an estimate on parts of the data that were left out of the fit.

A model that is fitted to motions which do not excite it can be wrong elsewhere by any factor; that
shows where a part of the data is left out of the fit.

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, ch. 17
(cross-validation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from flexgen.base.calls.deadline import is_over

# Errors on data that were not fitted over those of the fit, from which on the model fails there.
WORSE = 2.0
# Number of a recording, and its samples.
Piece = tuple[int, slice]
Part = TypeVar("Part")
Found = TypeVar("Found")


@dataclass(frozen=True)
class Errors:
    """Errors of each output: ``rms`` (n,), in its unit, and ``relative`` (n,), over the size of
    its motion.
    """

    rms: np.ndarray
    relative: np.ndarray


def validate(
    parts: Sequence[Part],
    fit: Callable[[list[Part]], Found],
    errors: Callable[[Found, Part], np.ndarray],
    tell: Callable[[str], None] | None = None,
) -> list[np.ndarray] | None:
    """Errors on each part of the fit to all others; None: the time was over before.

    Parameters
    ----------
    parts : sequence
        Of the data; each is left out once.
    fit : callable
        Fits the other parts.
    errors : callable
        Of the fit, on the part that was left out.
    tell : callable, optional
        Is told which part is left out.

    Examples
    --------
    >>> import numpy as np
    >>> from flexgen.identification.estimator.validation import validate
    >>> data = [np.array([1.0, 2.0]), np.array([3.0]), np.array([5.0])]  # fitted by their mean
    >>> found = validate(
    ...     data, lambda kept: np.concatenate(kept).mean(), lambda mean, part: part - mean
    ... )
    >>> [error.tolist() for error in found]
    [[-3.0, -2.0], [0.3333333333333335], [3.0]]
    """
    out = []
    for k, part in enumerate(parts):
        if is_over():
            return None
        if tell is not None:
            tell(f"cross-validation {k + 1} of {len(parts)}")
        others = [other for j, other in enumerate(parts) if j != k]
        out.append(errors(fit(others), part))
    return out


def fails_elsewhere(fitted: Errors, there: Errors, small: float) -> np.ndarray:
    """Whether each output (n,) is predicted much worse on data that were not fitted.

    Worse by its size and relative to the motion: larger motions have larger errors, smaller ones
    more noise; and by more than the ``small`` part of the motion.
    """
    worse = there.rms > WORSE * fitted.rms
    return np.asarray(
        worse & (there.relative > WORSE * fitted.relative) & (there.relative > small)
    )


def parts_of(lengths: Sequence[int], parts: int) -> list[Piece]:
    """Every recording in ``parts`` pieces: number of the recording and its samples."""
    return [
        (run, slice(k * length // parts, (k + 1) * length // parts))
        for run, length in enumerate(lengths)
        for k in range(parts)
    ]
