"""Options of learning from measured errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flexgen.base.checks.bounds import NotNegative, Positive
from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.case import SAMPLE_S
from flexgen.planning.learning.learn import Gain


@checked_class
@dataclass(frozen=True)
class LearningOptions:
    """Options of `flexgen.next_run`.

    Parameters
    ----------
    frequency_hz : float, optional [Hz]
        Up to which the error is learned; default: that of the last run, half of it where the
        error grew, at first the one up to which robots with springs 20 % softer and 25 % stiffer
        converge with the feedback of the robot.
    gain : float
        Of the correction. 0.5 learns more slowly and bears larger differences from the model.
    controller, sample_time, delay
        Feedback of the robot, as for `flexgen.control`: for the default frequency.
    clock : float, optional [s]
        Reading of the record's clock where the path begins; default: estimated from the record.
    clock_of : {"record", "drives"}
        What `clock` is read from: ``"record"``, the one clock of all columns; ``"drives"``, that
        of the motor angles, while the tracker in the same rows has another one. Its offset is
        estimated with the motor angles, which tell where the tool is expected.
    frame : sequence of float, optional
        Pose of the tracker in the base of the robot, position [m] and rotation vector [rad], six
        numbers; default: that of ``poses``, or estimated from the record. Six zeros: it measures
        in the base.
    poses : str or Path, optional
        Static poses that the tracker measured from the same place, a file as for
        `flexgen.calibrate`: they give its frame.

    Examples
    --------
    >>> flexgen.LearningOptions(frequency_hz=8.0, clock=0.0).gain
    1.0
    """

    frequency_hz: Positive | None = None
    gain: Gain = 1.0
    controller: Any = "ppi"
    sample_time: Positive = SAMPLE_S
    delay: NotNegative = 0.0
    clock: float | None = None
    clock_of: Literal["record", "drives"] = "record"
    frame: Sequence[float] | None = None
    poses: str | Path | None = None

    def __post_init__(self) -> None:
        if self.pose is not None and not (
            self.pose.shape == (6,) and np.isfinite(self.pose).all()
        ):
            raise ArgumentError(
                f"frame: given {self.frame!r}, expected six numbers: position [m] and rotation "
                "vector [rad] of the tracker in the base"
            )

        if self.frame is not None and self.poses is not None:
            raise ArgumentError("poses: given with frame, expected one of the two")

    @property
    def pose(self) -> np.ndarray | None:
        """The frame as an array (6,); None: estimated."""
        return None if self.frame is None else np.asarray(self.frame, dtype=float)
