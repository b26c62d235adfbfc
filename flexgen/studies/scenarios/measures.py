"""Measures of a run: peak to peak, RMS and settling of an output in a window, peak, largest and
RMS torque.

Settling of version 1 is the last instant outside a band about the value that the output settles
to; it jumps by half a period where a peak just touches the band. Version 2 is the mean of this
time over all bands from 0.5 to 1.5 times the tolerance: with the envelope E(t) = max |z - rest|
from t on,

    T = int clip(E(t)/tolerance - 0.5, 0, 1) dt

which changes by no more than the window's length times the largest change of z over the tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.studies.scenarios.scenario import Scenario, Window

# the mean of this end of a window is what an output settles to; rest in the end of a run
LAST_S = 0.1
REST_S = 1.0


@dataclass(frozen=True)
class Measure:
    """A number of a run that counts in the score: its name, unit and weight."""

    name: str
    unit: str
    weight: float


def measures_of(scenario: Scenario) -> tuple[Measure, ...]:
    """The measures of a scenario; the weights sum to one."""
    out = []
    several = len(scenario.outputs) > 1
    for window in scenario.measured:
        for kind, weight in window.weights.items():
            label = f"{window.name}, {_WORDS[kind]}"
            if kind.startswith("torque"):
                out.append(Measure(label, "N m", weight))
                continue
            for output in scenario.outputs:
                unit = "s" if kind == "settling" else output.unit
                out.append(
                    Measure(f"{label} of {output.name}" if several else label, unit, weight)
                )
    total = sum(measure.weight for measure in out)
    return tuple(Measure(m.name, m.unit, m.weight / total) for m in out)


_WORDS = {
    "peak": "peak to peak",
    "rms": "RMS",
    "settling": "settling time",
    "torque_peak": "torque, peak to peak",
    "torque_max": "largest torque",
    "torque_rms": "RMS torque",
}


def compute_measures(
    scenario: Scenario, windows: Sequence[Window], z: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """Values of the measures (k,) from outputs z (n, outputs) and commanded torques u (n, n_m)
    less those at rest.

    ``windows``: those of the draw. Torques of several motors count in their largest one, and in
    the root of the sum of squares.
    """
    values: list[float] = []
    for window in windows:
        inside = _samples(scenario, window.begin, window.end)
        own = z[inside]
        torque = u[inside]
        for kind in window.weights:
            if kind == "torque_peak":
                values.append(float(np.ptp(torque, axis=0).max()))
            elif kind == "torque_max":
                values.append(float(np.abs(torque).max()))
            elif kind == "torque_rms":
                values.append(float(np.sqrt((torque**2).sum(axis=1).mean())))
            else:
                values += [_of_output(kind, own[:, k], scenario) for k in range(z.shape[1])]
    return np.array(values)


def _samples(scenario: Scenario, begin: float, end: float) -> slice:
    """The samples of a part of the run."""
    first, last = (int(np.ceil(t / scenario.sample_s - 1e-6)) for t in (begin, end))
    return slice(first, last)


def _of_output(kind: str, z: np.ndarray, scenario: Scenario) -> float:
    """One measure of an output z (n,) in a window: ``"peak"`` to peak or ``"rms"`` about the mean,
    in its unit; else the time [s] until it stays within the tolerance of its mean at the end.

    Version 2 of the measures counts the share of the tolerance that the rest of z keeps to,
    between a half and one and a half of it: a smooth time.
    """
    if kind == "peak":
        return float(np.ptp(z))
    if kind == "rms":
        return float(np.sqrt(np.mean((z - z.mean()) ** 2)))
    rest = z[-round(LAST_S / scenario.sample_s) :].mean()
    if scenario.measures_version > 1:
        envelope = np.maximum.accumulate(np.abs(z - rest)[::-1])
        return scenario.sample_s * float(
            np.clip(envelope / scenario.tolerance - 0.5, 0.0, 1.0).sum()
        )
    outside = np.flatnonzero(np.abs(z - rest) > scenario.tolerance)
    return scenario.sample_s * float(outside[-1]) if len(outside) else 0.0


def at_rest(scenario: Scenario, windows: Sequence[Window], z: np.ndarray) -> np.ndarray:
    """Peak to peak of each output (outputs,), in its unit, where it should rest.

    With draws the last second of the run; else the last window of torque noise, or the last
    twentieth of the run.
    """
    if scenario.plan is not None:
        begin = scenario.duration_s - REST_S
        end = scenario.duration_s
    else:
        spans = [(w.begin, w.end) for w in windows if "torque_peak" in w.weights]
        begin, end = spans[-1] if spans else (0.95 * scenario.duration_s, scenario.duration_s)
    return np.asarray(np.ptp(z[_samples(scenario, begin, end)], axis=0))
