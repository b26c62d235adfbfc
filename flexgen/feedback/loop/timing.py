"""When a sampled law measures and acts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """When a law measures and acts.

    ``sample_s``, ``delay_s`` [s]; ``predicted``: the state is predicted to the middle of the
    interval in which the torque acts; ``differences``: the odd derivatives of the measurement are
    differences of two samples.
    """

    sample_s: float
    delay_s: float = 0.0
    predicted: bool = False
    differences: bool = False

    @property
    def whole(self) -> int:
        """Whole samples of the delay."""
        return int(self.delay_s / self.sample_s + 1e-9)

    @property
    def rest_s(self) -> float:
        """The rest of the delay [s]."""
        rest = self.delay_s - self.whole * self.sample_s
        return rest if rest > 1e-9 * self.sample_s else 0.0

    @property
    def ahead_s(self) -> float:
        """From the measurement to the state that the law is computed for [s]."""
        return self.delay_s + self.sample_s / 2 if self.predicted else 0.0

    def segments(self) -> list[tuple[int, float]]:
        """Torques under way over the delay: how many samples old each is, and how long it acts
        [s].
        """
        if not self.predicted:
            return []
        parts = [(self.whole + 1, self.rest_s)] if self.rest_s else []
        return parts + [(k, self.sample_s) for k in range(self.whole, 0, -1)]
