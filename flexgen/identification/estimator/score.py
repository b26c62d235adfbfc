"""Score test: whether data contradict a number that a fit holds, without a further fit.

Residuals r with derivatives J, weighted such that their variance is one, and numbers with priors,
whose residuals are ``P^(1/2) (x - x_0)``. The columns A of a candidate, one number or a vector,
are changes of the residuals, C those of the residuals of the prior: a number whose value in the
file is wrong is a change of its prior. At the minimum

    B = [A; C] - [J; P^(1/2)] K,     B orthogonal to the columns of the fit,
    s = B' [r; P^(1/2) (x - x_0)],   I = B'B,     d = -I^-1 s,
    V = sum_b g_b g_b' + B_2'B_2,    g_b = B_1b' r_b of each block b,     T = s' V^-1 s

T is that of chi-square with the size of the candidate; it is stated as the z of one number with
the same probability. d is the step of the candidate, with all free numbers; ``s' I^-1 s`` is what
the objective loses with it. Blocks are parts of the data whose errors may depend on each other.

Source: C. R. Rao, Proc. Cambridge Philosophical Society 44, 1948 (score test); R. Davidson and
J. MacKinnon, Estimation and Inference in Econometrics, 1993, ch. 11 (with robust covariances).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

# Part of the information of a candidate that the free numbers leave, below which they do all that
# it does.
ABSORBED = 1e-9
LEAST_TAIL = 1e-300  # probability: the largest z is 37


@dataclass(frozen=True)
class Score:
    """Of one candidate.

    ``z``: its score in standard deviations; ``step`` (m,): d; ``sd`` (m,): deviations of the step
    from the scatter of the blocks, infinity along directions that the data do not show; ``gain``:
    decrease of the objective with the step.
    """

    z: float
    step: np.ndarray
    sd: np.ndarray
    gain: float


@dataclass(frozen=True)
class Explanation:
    """A number or vector that data contradict: ``name``; as it is ``held``, and its ``value``
    (m,) [``unit``]; its score ``z`` in standard deviations; ``share``: part of ``left``, what
    other numbers leave unexplained, that it explains.
    """

    name: str
    held: tuple[float, ...]
    value: tuple[float, ...]
    unit: str
    z: float
    share: float
    left: str

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.name} of about {_shown(self.value)}{unit} instead of {_shown(self.held)} "
            f"explains {100 * self.share:.0f} % of what {self.left} (score of {self.z:.1f} "
            "standard deviations)"
        )


def _shown(values: tuple[float, ...]) -> str:
    near_one = all(0.9 < x < 1.1 for x in values)  # scales differ by parts of a percent
    text = ", ".join(f"{x:.5g}" if near_one else f"{x:.3g}" for x in values)
    return text if len(values) == 1 else f"({text})"


@dataclass(frozen=True)
class Limit:
    """A fault that data do not show up to a size: ``name``, ``size`` [``unit``]; infinity: they
    show it in no case.
    """

    name: str
    size: float
    unit: str

    def __str__(self) -> str:
        if not np.isfinite(self.size):
            return self.name
        text = f"{100 * self.size:.2g} %" if not self.unit else f"{self.size:.2g} {self.unit}"
        return f"{self.name} by less than {text}"


class ScoreTest:
    """Scores at the minimum of a fit.

    Parameters
    ----------
    rows : array (N, n)
        J, weighted.
    gaps : array (N,)
        r, weighted.
    roots : array (n,)
        P^(1/2) of independent priors.
    away : array (n,)
        x - x_0.
    starts : sequence of int
        First row of each block; the first one is 0.
    count : int, optional
        Residuals that are measured, for the degrees of freedom; default: N.
    """

    def __init__(
        self,
        rows: np.ndarray,
        gaps: np.ndarray,
        roots: np.ndarray,
        away: np.ndarray,
        starts: Sequence[int] | np.ndarray,
        count: int | None = None,
    ) -> None:
        self.gaps = gaps
        self.starts = np.asarray(starts, int)
        self.residual = np.concatenate([gaps, roots * away])
        self.basis = np.linalg.qr(np.vstack([rows, np.diag(roots)]))[0]
        number = len(gaps) if count is None else count
        degrees = max(number - float(np.sum(self.basis[: len(gaps)] ** 2)), 1.0)
        self.larger = float(np.sqrt(number / degrees))

    def of(self, columns: np.ndarray, priors: np.ndarray | None = None) -> Score | None:
        """Score of a candidate; None: the free numbers do all that it does.

        Parameters
        ----------
        columns : array (N, m)
            A, weighted as the rows.
        priors : array (n, m), optional
            C; default: none.
        """
        n = len(self.gaps)
        m = columns.shape[1]
        other = np.zeros((len(self.residual) - n, m)) if priors is None else priors
        whole = np.vstack([columns, other])
        away = whole - self.basis @ (self.basis.T @ whole)
        away = away - self.basis @ (self.basis.T @ away)  # rounding of the first projection
        widths, axes = np.linalg.eigh(away.T @ away)
        seen = widths > ABSORBED * max(float((whole**2).sum(axis=0).max()), 1e-300)
        if not seen.any():
            return None
        widths = widths[seen]
        axes = axes[:, seen]
        away = away @ axes
        g = self.larger * np.add.reduceat(away[:n] * self.gaps[:, None], self.starts, axis=0)
        V = g.T @ g + away[n:].T @ away[n:]
        s = away.T @ self.residual
        tail = chi2.sf(float(s @ np.linalg.solve(V, s)), len(s)) / 2
        covariance = (axes / widths) @ V @ (axes / widths).T
        sd = np.sqrt(np.diag(covariance))
        if not seen.all():
            sd = np.full(m, np.inf)
        return Score(
            z=float(norm.isf(max(tail, LEAST_TAIL))),
            step=-axes @ (s / widths),
            sd=sd,
            gain=float(s @ (s / widths)),
        )
