"""The table ``[uncertainty]`` in the text of a model file, from the covariance of identified
numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from flexgen.base.registry import provides

LARGEST = 5.0  # relative standard deviation that a model file may have; beyond it nothing is known
DIGITS = 12


@provides("Estimated.uncertainty")
def with_uncertainty(text: str, names: Sequence[str], covariance: np.ndarray) -> str:
    """The text of a model file with standard deviations and correlations of numbers.

    Parameters
    ----------
    text : str
        An earlier table keeps its other keys.
    names : sequence of str (n,)
    covariance : array (n, n)
        Of the relative errors of the numbers.
    """
    sd = np.sqrt(np.diag(covariance))
    correlation = np.round(covariance / np.outer(sd, sd), DIGITS)
    correlation = (correlation + correlation.T) / 2 + 0.0  # (no zeros with a sign)
    np.fill_diagonal(correlation, 1.0)
    rows = ",\n".join(f"  {', '.join(f'{c:.{DIGITS}g}' for c in row)}" for row in correlation)
    quoted = ", ".join(f'"{name}"' for name in names)
    lines = (
        f"parameters = [{quoted}]\n"
        f"sd = [{', '.join(f'{s:.6g}' for s in np.minimum(sd, LARGEST))}]\n"
        f"correlation = [\n{rows},\n]\n"
    )
    header = re.search(r"^\[uncertainty\][^\n]*\n", text, re.MULTILINE)
    if header is None:
        return f"{text.rstrip()}\n\n[uncertainty]\n{lines}"
    rest = text[header.end() :]
    end = re.search(r"^\[(?!\s*$)[^\n]*\]", rest, re.MULTILINE)
    own, after = (rest, "") if end is None else (rest[: end.start()], rest[end.start() :])
    own = re.sub(
        r"^(?:parameters|sd|correlation) *= *\[[^\]]*\][^\n]*\n", "", own, flags=re.MULTILINE
    )
    return f"{text[: header.end()]}{lines}{own}{after}"
