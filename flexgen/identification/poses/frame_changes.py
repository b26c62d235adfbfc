"""A frame of the measurement that moved between two poses: the tracker, or the base of the robot.

From pose k on all positions are off by the same vector d. Of the residuals r of a fit, with the
weights of its loss, the step explains at most

    gain = max_k  n_1 n_2 / (n_1 + n_2) |m_2 - m_1|^2,      d = m_2 - m_1,

m_1, m_2: means of the n_1 poses before k and of the n_2 others. Three gains of one step in noise
of the deviation s are chi-square; of N steps the largest one counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

FEWEST = 5  # poses before the step and after it
# Part of the squared residuals that a step explains at least: a frame that drifts, or poses in an
# order of their own, have steps, too.
LEAST = 0.5


@dataclass(frozen=True)
class FrameChange:
    """From ``row`` (from 1) on all positions are off by ``shift`` (3,) [m]; ``share`` of the
    squared residuals that it explains, and its ``score`` in standard deviations.
    """

    row: int
    shift: np.ndarray
    share: float
    score: float


def find_frame_change(residuals: np.ndarray, false_alarms: float) -> FrameChange | None:
    """The step that explains most of the residuals (N, k, 3) [m], in the order in which the poses
    were measured; None: there is none.

    Parameters
    ----------
    residuals : array (N, k, 3) [m]
        nan: not seen.
    false_alarms : float
        Probability that noise has a step.
    """
    seen = np.isfinite(residuals).all(axis=2)
    if not seen.any():
        return None
    residuals = residuals - residuals[seen].mean(axis=0)
    count = seen.sum(axis=1)
    sums = np.where(seen[..., None], residuals, 0.0).sum(axis=1)
    total = float(np.nansum(residuals**2))
    if total <= 0.0 or len(residuals) < 2 * FEWEST:
        return None
    rows = np.arange(FEWEST, len(residuals) - FEWEST + 1)
    before = count.cumsum()[rows - 1]
    after = count.sum() - before
    usable = (before > 0) & (after > 0)
    rows = rows[usable]
    if not len(rows):
        return None
    before = before[usable]
    after = after[usable]
    first = sums.cumsum(axis=0)[rows - 1]
    shift = (sums.sum(axis=0) - first) / after[:, None] - first / before[:, None]
    gains = before * after / (before + after) * (shift**2).sum(axis=1)
    k = int(np.argmax(gains))
    gain = float(gains[k])
    variance = max(total - gain, 1e-300) / max(3 * int(count.sum()) - 6, 1)
    tail = float(chi2.logsf(gain / variance, 3)) - np.log(false_alarms / len(rows))
    share = gain / total
    if share < LEAST or tail > 0.0:
        return None
    score = float(norm.isf(max(chi2.sf(gain / variance, 3), 1e-300) / 2))
    return FrameChange(int(rows[k]) + 1, shift[k], share, score)
