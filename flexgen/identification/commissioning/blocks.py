"""Blocks of residuals of a joint fit: each kind of record gives rows of residuals and of their
Jacobian in the same vector of unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Channel:
    """Residuals of one kind in one record, whose weight follows from their own size.

    Parameters
    ----------
    title : str
        Such as ``"torque of m1"``.
    residual : array (N,)
        Model minus record, in ``unit``; zero where the record has no information.
    jacobian : array (N, n), or empty where it was not asked for
    piece : array of int (N,)
        Part of the record: residuals of different parts are independent.
    told : array of bool (N,)
        Rows that count.
    size : float
        Root mean square of the recorded signal, in ``unit``.
    unit : str
    neighbors : int
        Rows between one instant and the next: 1 of a torque, 3 of positions; 0: all rows are
        independent.
    """

    title: str
    residual: np.ndarray
    jacobian: np.ndarray
    piece: np.ndarray
    told: np.ndarray
    size: float
    unit: str
    neighbors: int = 1

    @property
    def rms(self) -> float:
        """Root mean square of the residuals that count."""
        return float(np.sqrt(np.mean(self.residual[self.told] ** 2))) if self.told.any() else 0.0

    def count_correlated(self) -> float:
        """Residuals for one that is independent: 1 + 2 sum of their autocorrelations, up to the
        first one below a tenth.

        What a model lacks is the same over many samples, so that samples overstate a record.
        """
        if not self.neighbors:
            return 1.0
        r = np.where(self.told, self.residual, 0.0).reshape(-1, self.neighbors)
        power = float((r**2).sum())
        if power <= 0.0:
            return 1.0
        total = 1.0
        for lag in range(1, len(r) // 2):
            part = float((r[lag:] * r[:-lag]).sum()) / power
            if part < LEAST_CORRELATION:
                break
            total += 2.0 * part
        return total


LEAST_CORRELATION = 0.1


class Block(Protocol):
    """One record of a joint fit."""

    name: str
    kind: str

    def channels(self, x: np.ndarray, derivatives: bool) -> list[Channel]:
        """Residuals at x, and their derivatives."""
        ...

    def set_free(self, free: np.ndarray) -> None:
        """Derivatives in other unknowns (n,) than these may be left out."""
        ...

    def relinearize(self, x: np.ndarray) -> None:
        """Take anew at x what changes little from step to step: weights and derivatives."""
        ...
