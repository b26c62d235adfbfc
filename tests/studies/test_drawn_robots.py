"""Robots drawn from tolerances, and their error in the loop."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

from flexgen.studies.tolerances import in_loop
from flexgen.studies.tolerances.sources import PAYLOAD


def test_drawn_robots_have_names_and_factors_of_their_sources(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of `flexgen.studies.tolerances.in_loop`: 1 and the error, and what is added to the payload,
    counted from one.
    """
    model: Any = Made(uncertainty="table")
    sources = Made(
        root=np.zeros((2, 3)),
        added=np.array([False, True]),
        owner=[0, 0, 1],
        parameters=[Made(name=name) for name in ("q1.stiffness", "q2.stiffness", PAYLOAD)],
        errors=lambda z: np.column_stack([z[:, 0], 10.0 + z[:, 1]]),
    )
    monkeypatch.setattr(in_loop, "sources_of", lambda robot, table: sources)
    found = in_loop.draw_plants(model, 2, seed=5)
    z = np.random.default_rng(5).standard_normal((2, 3))
    for k in (0, 1):
        expected = {
            "q1.stiffness": 1.0 + z[k, 0],
            "q2.stiffness": 1.0 + z[k, 0],
            "payload": 10.0 + z[k, 1],
        }
        assert found[f"drawn_{k + 1}"] == pytest.approx(expected)
    assert list(found) == ["drawn_1", "drawn_2"]


@pytest.mark.parametrize(("failures", "error"), [(0, 2.0), (1, 2.1), (2, None)])
def test_an_error_in_the_loop_is_what_twenty_robots_of_twenty_one_keep(
    failures: int, error: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {f"r{k}": {} for k in range(21)}
    robots = {
        name: Made(name=name, failure="x" * (k < failures), size=0.1 * (k + 1))
        for k, name in enumerate(reversed(names))
    }
    figures = lambda robot: {"error_max_m": robot.size, "error_max_rad": None}  # noqa: E731
    found = Made(runs=[Made(name="model", size=0.0), *robots.values()], figures=figures, ended="")
    monkeypatch.setattr(in_loop, "draw_plants", lambda model: names)
    monkeypatch.setattr(in_loop, "control", lambda model, **given: found)
    run: Any = Made(model=Made(uncertainty=Made(delay=1e-3)), solution="solution")
    result = in_loop.error_in_loop(run)
    assert (result["robots"], result["failed"], result["without_delay"]) == (21, failures, True)
    assert (
        result["error_m"] == (None if error is None else pytest.approx(error))
        and result["error_rad"] is None
    )
