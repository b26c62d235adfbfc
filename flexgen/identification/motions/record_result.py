"""Result of `flexgen.compare_record`: scores of each channel, with and without a lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Row, Shown, Table
from flexgen.model.elements import RobotModel

SMALL = "small motions: not predicted"


@dataclass(frozen=True)
class Channel:
    """A signal that is compared: its name and unit."""

    name: str
    unit: str


@dataclass(frozen=True)
class Score:
    """Score of a channel, in its unit; None: it is not judged.

    ``signal``: root mean square of the record in the window, without its mean; ``noise``: that of
    its noise. ``r2``, ``rms``, ``largest``: of the residual without its mean, without a lag;
    ``r2_lag``, ``rms_lag``, ``largest_lag``: with it. ``offset``: mean of record less model.
    """

    channel: Channel
    signal: float
    noise: float
    r2: float | None = None
    rms: float | None = None
    largest: float | None = None
    r2_lag: float | None = None
    rms_lag: float | None = None
    largest_lag: float | None = None
    offset: float | None = None

    @property
    def is_predicted(self) -> bool:
        """Whether the signal is large enough to be judged."""
        return self.r2 is not None


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class RecordComparison(Result):
    """A model compared with a record of motion.

    Attributes
    ----------
    model : RobotModel
    source : str
        Of the record.
    scores : tuple of Score
        One for each channel: torques of the joints from their measured angles, or a moment.
    lag_s : float or None [s]
        Time by which the record is later than the model; None: no channel is judged, or no lag
        within 0.05 s fits best.
    is_lag_fitted : bool
        The lag is that of this record, else a given one.
    window_s : tuple of two floats [s]
    limit_hz : float [Hz]
        Of the low pass of the measured angles; torques are not filtered.
    time : array (n,) [s]
    measured, predicted : arrays (n, k) [N m or N]
        Of each channel in the window, predicted with the lag.

    Examples
    --------
    >>> import numpy as np
    >>> time = 0.001 * np.arange(2000)
    >>> angle, torque = np.zeros((2, 2000, 2))
    >>> angle[:, 0] = 0.2 * np.sin(np.pi * np.clip(time - 0.5, 0.0, 0.5)) ** 4  # rad
    >>> record = flexgen.JointRecord(time, angle, torque, ("q1", "q2"))
    >>> print(flexgen.compare_record("elbow", record).to_dict()["channels"][0]["r2"])
    None
    """

    model: RobotModel
    source: str
    scores: tuple[Score, ...]
    lag_s: float | None
    is_lag_fitted: bool
    window_s: tuple[float, float]
    limit_hz: float
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray

    def __repr__(self) -> str:
        judged = [one for one in self.scores if one.is_predicted]
        return (
            f"<RecordComparison {self.model.title}, {self.source}: {len(judged)} of "
            f"{len(self.scores)} channels judged>"
        )

    def content(self) -> tuple[Part, ...]:
        """Scores of each channel; a channel below its noise has none."""
        lag = "fitted to this record" if self.is_lag_fitted else "given"
        columns = (
            Column("channel", key="channel"),
            Column("unit", key="unit"),
            Column("signal", key="signal_rms"),
            Column("noise", key="noise_rms"),
            Column("R2", key="r2"),
            Column("rms", key="rms"),
            Column("largest", key="largest"),
            Column("R2, lag", key="r2_lag"),
            Column("rms, lag", key="rms_lag"),
            Column("largest, lag", key="largest_lag"),
            Column("offset", key="offset"),
        )
        begin, end = self.window_s
        return (
            Prose(f"{self.model.title}, {self.source}: joint torques from joint angles", "", True),
            Row("window, begin", begin, "s", "window_begin_s"),
            Row("window, end", end, "s", "window_end_s"),
            Row("low pass of the angles", self.limit_hz, "Hz", "limit_hz"),
            Row("lag of the record", self.lag_s, "s", "lag_s", note=lag),
            Table(columns, tuple(_cells(one) for one in self.scores), "Channels", "channels"),
            *self._small(),
            Data("lag_fitted", self.is_lag_fitted),
        )

    def _small(self) -> tuple[Prose, ...]:
        """A line with the channels that are not judged."""
        names = [one.channel.name for one in self.scores if not one.is_predicted]
        return (Prose(f"{SMALL}: {', '.join(names)}"),) if names else ()


def _cells(score: Score) -> tuple[object, ...]:
    """The cells of a channel."""
    figures = (
        *(score.r2, score.rms, score.largest),
        *(score.r2_lag, score.rms_lag, score.largest_lag, score.offset),
    )
    cells = [Shown(x, "-" if x is None else f"{x:.3g}") for x in figures]
    sizes = [Shown(x, f"{x:.3g}") for x in (score.signal, score.noise)]
    return score.channel.name, score.channel.unit, *sizes, *cells
