"""Disturbances of a closed loop: torques on motors, forces and torques on the tool, as functions
of time.

=========== =======================================================================================
step        ``size`` from ``start_s`` on, for ``length_s``; without a length to the end
pulse       ``size`` for ``length_s``
ramp        from 0 to ``size`` within ``length_s``, then ``size``
chirp       ``size sin(phase)``, frequency from ``frequency_hz[0]`` to ``frequency_hz[1]``,
            exponential in time
noise       white noise in the band ``frequency_hz``, standard deviation ``size``
=========== =======================================================================================

A disturbance is constant within an integration step: its value in the middle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError

DISTURBANCES = ("step", "pulse", "ramp", "chirp", "noise")
TOOL_AXES = ("tool.x", "tool.y", "tool.z", "tool.rx", "tool.ry", "tool.rz")
LINES = 200  # of band noise, at most


@checked_class
@dataclass(frozen=True)
class Disturbance:
    """A disturbance; see the table of the module.

    Parameters
    ----------
    kind : str
    where : str
        Name of a motor (motor side), ``tool.x`` .. ``tool.z`` (force, world axes) or ``tool.rx``
        .. (torque).
    size : float [N m, N]
    start_s : float [s]
        From the begin of the path; negative: before it.
    length_s : float or None [s]
    frequency_hz : tuple (2,), optional [Hz]

    Examples
    --------
    >>> push = flexgen.Disturbance("step", "tool.z", size=-500.0, start_s=0.5)  # N
    >>> run = flexgen.control("elbow", disturbances=[push])
    >>> f"{1e3 * run.distance(run.nominal).max():.1f} mm"
    '0.6 mm'
    """

    kind: str
    where: str
    size: float
    start_s: float = 0.0
    length_s: float | None = None
    frequency_hz: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.kind not in DISTURBANCES:
            raise ArgumentError(
                f"disturbance: given kind {self.kind!r}, expected one of {', '.join(DISTURBANCES)}"
            )
        what = f"disturbance {self.kind} on {self.where}"
        for name in ("size", "start_s"):
            if not math.isfinite(getattr(self, name)):
                raise ArgumentError(
                    f"{what}, {name}: given {getattr(self, name)!r}, expected a finite number"
                )
        if self.length_s is None and self.kind != "step":
            raise ArgumentError(f"{what}, length_s: given none, expected a time > 0 in s")
        if self.length_s is not None and not (math.isfinite(self.length_s) and self.length_s > 0):
            raise ArgumentError(
                f"{what}, length_s: given {self.length_s!r}, expected a time > 0 in s"
            )
        swept = self.kind in ("chirp", "noise")
        f = self.frequency_hz
        if swept and (f is None or len(f) != 2 or not 0 < f[0] < f[1] < math.inf):
            raise ArgumentError(
                f"{what}, frequency_hz: given {f!r}, expected two increasing frequencies in Hz"
            )
        if not swept and f is not None:
            raise ArgumentError(f"{what}, frequency_hz: given {f!r}, expected none for this kind")

    @property
    def end_s(self) -> float:
        """When it ends; infinite for a step without a length and for a ramp."""
        return (
            math.inf
            if self.length_s is None or self.kind == "ramp"
            else self.start_s + self.length_s
        )

    def values(self, t: np.ndarray, seed: int = 0) -> np.ndarray:
        """The disturbance at instants t (n,)."""
        since = t - self.start_s
        on = (since >= 0) & (t < self.end_s)
        length = math.inf if self.length_s is None else self.length_s
        if self.kind in ("step", "pulse"):
            shape = np.ones_like(t)
        elif self.kind == "ramp":
            shape = np.clip(since / length, 0.0, 1.0)
        elif self.kind == "chirp":
            assert self.frequency_hz is not None
            low, high = self.frequency_hz
            growth = math.log(high / low) / length
            shape = np.sin(
                2 * np.pi * low / growth * np.expm1(growth * np.clip(since, 0.0, length))
            )
        else:
            shape = np.zeros_like(t)
            shape[on] = self._noise(since[on], seed)
        return np.where(on, self.size * shape, 0.0)

    def _noise(self, since: np.ndarray, seed: int) -> np.ndarray:
        """Band noise of unit variance: sines with random phases, equally spaced in frequency."""
        assert self.frequency_hz is not None and self.length_s is not None
        low, high = self.frequency_hz
        lines = int(np.clip((high - low) * self.length_s, 1, LINES))
        frequencies = low + (high - low) * (np.arange(lines) + 0.5) / lines
        phases = 2 * np.pi * np.random.default_rng(seed).random(lines)
        total = np.zeros_like(since)
        for frequency, phase in zip(frequencies, phases, strict=True):
            total += np.sin(2 * np.pi * frequency * since + phase)
        return total * math.sqrt(2 / lines)


def rows_of(where: str, motors: Sequence[str]) -> int:
    """Row of a disturbance: motors first, then the tool; ArgumentError for a place that does not
    exist.
    """
    places = (*motors, *TOOL_AXES)
    if where not in places:
        raise ArgumentError(
            f"disturbance: given the place {where!r}, expected one of {', '.join(places)}"
        )
    return places.index(where)


def disturbance_table(
    given: Mapping[int, Sequence[Disturbance]],
    motors: Sequence[str],
    t: np.ndarray,
    lanes: int,
    seed: int = 0,
) -> np.ndarray | None:
    """Disturbances of all robots at the steps t (n,), (n, n_m + 6, lanes); None where there are
    none.

    ``given``: by lane. One lane is returned where all have the same.
    """
    if not any(given.values()):
        return None
    same = all(tuple(given.get(lane, ())) == tuple(given.get(0, ())) for lane in range(lanes))
    out = np.zeros((len(t), len(motors) + len(TOOL_AXES), 1 if same else lanes))
    for lane in range(out.shape[2]):
        for k, disturbance in enumerate(given.get(lane, ())):
            out[:, rows_of(disturbance.where, motors), lane] += disturbance.values(t, seed + k)
    return out
