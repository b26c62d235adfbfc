"""Measures of a run: peak to peak, RMS and settling of an output in a window, peak, largest and RMS torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.motion_control.benchmarks.scenario import Scenario

LAST_S = 0.1  # the mean of this end of a window is what an output settles to


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
    for window in scenario.windows:
        for kind, weight in window.weights.items():
            label = f"{window.name}, {_WORDS[kind]}"
            if kind.startswith("torque"):
                out.append(Measure(label, "N m", weight))
                continue
            for output in scenario.outputs:
                unit = "s" if kind == "settling" else output.unit
                out.append(Measure(f"{label} of {output.name}" if several else label, unit, weight))
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


def measured(scenario: Scenario, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Values of the measures (k,) from outputs z (n, outputs) and commanded torques u (n, n_m) less those at rest.

    Torques of several motors count in their largest one, and in the root of the sum of squares.
    """
    values: list[float] = []
    for window in scenario.windows:
        inside = _samples(scenario, window.begin, window.end)
        own, torque = z[inside], u[inside]
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
    if kind == "peak":
        return float(np.ptp(z))
    if kind == "rms":
        return float(np.sqrt(np.mean((z - z.mean()) ** 2)))
    rest = z[-round(LAST_S / scenario.sample_s) :].mean()
    outside = np.flatnonzero(np.abs(z - rest) > scenario.tolerance)
    return scenario.sample_s * float(outside[-1]) if len(outside) else 0.0


def at_rest(scenario: Scenario, z: np.ndarray) -> np.ndarray:
    """Largest peak to peak of the outputs in the last window of torque noise, or the last twentieth of the run (1,)."""
    windows: Sequence[tuple[float, float]] = [(w.begin, w.end) for w in scenario.windows if "torque_peak" in w.weights]
    begin, end = windows[-1] if windows else (0.95 * scenario.duration_s, scenario.duration_s)
    return np.atleast_1d(np.ptp(z[_samples(scenario, begin, end)], axis=0).max())
