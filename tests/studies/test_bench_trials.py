"""Trials of a controller in a benchmark: robots with margins of gain and delay, and refusals."""

from __future__ import annotations

from types import SimpleNamespace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.studies.scenarios import bench, draws
from flexgen.studies.scenarios.bench import Bench
from flexgen.studies.scenarios.tune import TuningResult


def trial(draws: int, monkeypatch: pytest.MonkeyPatch, **more: Any) -> Any:
    """Two robots, and the nominal one with another gain and another delay; measures are the
    largest outputs.
    """
    outputs = [Made(name="tool", unit="m"), Made(name="elbow", unit="rad")][
        : more.pop("outputs", 1)
    ]
    accept = Made(gain=1.5, delay_s=2e-3, rest=1e-3, torque_noise_Nm=0.5)
    made: Any = object.__new__(Bench)
    made.scenario = Made(
        plants=Made(names=["nominal", "soft"]), accept=accept, delay_s=1e-3, outputs=outputs
    )
    made.draws = [Made(windows=k) for k in range(draws)]
    monkeypatch.setattr(
        bench, "compute_measures", lambda s, windows, z, u: np.array([z.max(), u.max()])
    )
    monkeypatch.setattr(bench, "at_rest", lambda s, windows, z: np.abs(z[-1]))
    names = [Made(name="tool error"), Made(name="torque, peak to peak")]
    monkeypatch.setattr(bench, "measures_of", lambda s: names)
    asked: list[Any] = []

    def simulate(
        controller: Any, lanes: Any, gains: np.ndarray, delays: np.ndarray, draw: Any, tell: Any
    ) -> Any:
        asked.append((lanes, gains.tolist(), delays.tolist(), draw))
        if tell:
            tell("step")
        z = np.zeros((5, 4, len(outputs)))
        u = np.full((5, 4, 1), 0.4)
        z[2] = 0.1 * np.arange(4)[:, None]
        u[2] = 0.5
        for k, value in more.get("last", {}).items():
            z[-1, k, -1] = value
        u[3, 0] = more.get("noise", 0.0)
        return z, u, more.get("failures", ["", "", "", ""])

    monkeypatch.setattr(made, "simulate", simulate)
    return made, asked


def test_robots_of_a_benchmark_have_margins_of_gain_and_delay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, asked = trial(1, monkeypatch)
    lines: list[str] = []
    found = made.run("controller", lines.append)
    assert asked == [([0, 1, 0, 0], [1.0, 1.0, 1.5, 1.0], [1e-3, 1e-3, 1e-3, 2e-3], made.draws[0])]
    assert_allclose(found.values, [[[0.0, 0.5], [0.1, 0.5]]])
    assert found.refused == () and lines == ["step"]
    made, asked = trial(2, monkeypatch, last={1: 2e-3, 3: np.nan}, noise=0.75)
    found = made.run("controller", lines.append)
    reasons = (
        "soft: not at rest in the end: 0.002 m peak to peak, expected 0.001 m",
        "nominal, delay 2 ms: not at rest in the end: nan m peak to peak, expected 0.001 m",
        "nominal: torque noise of 0.75 N m peak to peak, expected at most 0.5 N m",
    )
    assert found.refused == tuple(f"draw {k} of 2, {reason}" for k in (1, 2) for reason in reasons)
    assert lines == ["step", "draw 1 of 2, step", "draw 2 of 2, step"] and found.values.shape == (
        2,
        2,
        2,
    )
    made, _ = trial(1, monkeypatch, last={2: 5e-3, 0: np.nan}, outputs=2)
    text = (
        "nominal, gain 1.5 times as large: elbow not at rest in the end: 0.005 rad peak to "
        "peak, expected 0.001 rad"
    )
    assert (
        text in made.run("controller").refused
        and "nominal: tool error is not a finite number" in made.run("c").refused
    )
    made, _ = trial(
        1, monkeypatch, last={1: np.nan}, failures=["", "soft fell", "", ""], noise=0.75
    )
    assert made.run("controller").refused == ("soft: soft fell", reasons[-1])


def test_a_tuned_controller_tells_where_it_began() -> None:
    class Scored(SimpleNamespace):
        def __str__(self) -> str:
            return "score of it"

    score = Scored(total=1.25, accepted=True, scenario=SimpleNamespace(name="two_link-1"))
    made = object.__new__(TuningResult)
    for name, value in {
        "score": score,
        "start": Scored(total=2.5, accepted=True),
        "evaluations": 40,
    }.items():
        object.__setattr__(made, name, value)
    assert repr(made) == "<TuningResult two_link-1: 40 evaluations, score 1.2500>"
    assert str(made) == "score of it\n  from 2.5000 in 40 evaluations"
    made.start.accepted = False
    assert str(made) == "score of it\n  from refused in 40 evaluations"
    seeds = {draws.secret_seed() for _ in range(40)}
    assert len(seeds) == 40 and all(0 <= x < 2**62 for x in seeds) and max(seeds) > 2**57
