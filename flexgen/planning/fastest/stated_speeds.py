"""Speed limits stated by the steps of a path, which every time law keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.model.moves import Move, MoveJ, MoveL, Program
from flexgen.paths.geometry.blended_curve import BlendedCurve
from flexgen.paths.geometry.jets import JET
from flexgen.paths.timing.time_laws import Law
from flexgen.paths.timing.timed_segments import POINTS, TimedSegment, derivative_norms

INSTANTS = 2001  # of a law
NEWTON = 3  # to find the instants of points of the path
CHECKED = 40  # points of a section


def stated_speeds(move: Move) -> list[tuple[float | None, ...]]:
    """For each motion from rest to rest of a move the speeds of its steps [m/s, rad/s]; None: not
    stated.
    """
    steps: tuple[MoveJ | MoveL, ...] = move.steps if isinstance(move, Program) else move.legs
    out: list[tuple[float | None, ...]] = []
    group: list[float | None] = []
    for step in steps:
        group.append(step.speed)
        if step.zone == 0:
            out.append(tuple(group))
            group = []
    return out or [()]


@dataclass(frozen=True)
class StatedSpeeds:
    """Points ``s`` (n,) of a path, and the largest ds/dt there, ``most`` (n,)."""

    s: np.ndarray
    most: np.ndarray

    @classmethod
    def of(
        cls, segment: TimedSegment, speeds: tuple[float | None, ...], radius: float
    ) -> StatedSpeeds:
        """Of a curve whose parts have these speeds [m/s], None: any; in a corner the lower one of
        both holds.

        ``radius`` [m]: length that a rotation of the tool counts as, per rad. Points and the
        largest rate of the curve's parameter at them.
        """
        points = [np.zeros(0)]
        most = [np.zeros(0)]
        curve = segment.curve
        if isinstance(curve, BlendedCurve) and any(speed is not None for speed in speeds):
            each = [np.inf if speed is None else speed for speed in speeds]
            starts = np.concatenate(
                [[0.0], np.cumsum([section.length for section in curve.sections])]
            )
            for k, section in enumerate(curve.sections):
                cap = min(each[section.segment : section.segment + 1 + section.corner])
                if np.isfinite(cap):
                    s = np.linspace(starts[k], starts[k + 1], CHECKED)
                    jet = np.zeros((POINTS, JET))
                    jet[:, 0] = np.linspace(starts[k], starts[k + 1], POINTS)
                    jet[:, 1] = 1.0
                    points.append(s)
                    largest = derivative_norms(segment.space, *curve(jet), radius)[:, 0].max()
                    most.append(np.full(len(s), cap / max(float(largest), 1e-300)))
        return cls(np.concatenate(points), np.concatenate(most))

    def parts(self, law: Law) -> np.ndarray:
        """Speeds under a time law over the stated ones (n,)."""
        if not len(self.s):
            return np.zeros(0)
        t = np.linspace(0.0, law.duration, INSTANTS)
        at = np.interp(self.s, law(t, 1)[:, 0], t)
        for _ in range(NEWTON):
            s, rate = law(at, 1).T
            at = np.clip(
                at - np.where(rate > 0, (s - self.s) / np.where(rate > 0, rate, 1.0), 0.0),
                0.0,
                law.duration,
            )
        return np.asarray(law(at, 1)[:, 1] / self.most)
