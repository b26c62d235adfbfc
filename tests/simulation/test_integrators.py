"""Laws, referees and refused input of `flexgen.simulation.integration.integrators`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

from flexgen.base.errors import SolverError
from flexgen.simulation.integration import integrators

A = np.array([[0.0, 1.0], [-4.0, -0.3]])


def linear(matrix: np.ndarray, compiled: Any = None) -> integrators.Rates:
    return integrators.Rates(lambda t, x: matrix @ x, lambda t, x: matrix, compiled, None)


def test_linear_motions_are_exponentials_and_stiff_ones_change_the_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    t = np.linspace(0.5, 2.5, 9)
    x = np.array([1.0, -2.0])
    found = integrators.integrate(linear(A), x, t, 1e-11, np.full(2, 1e-12))
    assert_allclose(found.states, [expm(A * (s - 0.5)) @ x for s in t], atol=1e-9)
    assert found.method == "DOP853" and 50 < found.evaluations < 5000
    monkeypatch.setattr(integrators, "BLOCK", 50)
    monkeypatch.setattr(integrators, "RATE", 100.0)
    stiff = np.array([[-1.0, 0.0], [0.0, -400.0]])
    lines: list[str] = []
    clock = iter(np.arange(0.0, 1e5, 2.0))
    monkeypatch.setattr(integrators.time, "perf_counter", lambda: float(next(clock)))
    found = integrators.integrate(linear(stiff), x, t, 1e-11, np.full(2, 1e-12), lines.append)
    assert found.method == "LSODA"
    assert_allclose(found.states, [expm(stiff * (s - 0.5)) @ x for s in t], atol=1e-8)
    assert (
        lines[0].startswith("simulation: t = ")
        and "of 2.500 s, " in lines[0]
        and lines[-1].endswith("LSODA")
    )
    dense = np.linspace(0.5, 2.5, 2001)  # a step for each instant is not stiff
    assert (
        integrators.integrate(linear(stiff), x, dense, 1e-11, np.full(2, 1e-12)).method == "DOP853"
    )
    assert_allclose(
        integrators.integrate(linear(A), x, t[:1], 1e-11, np.full(2, 1e-12)).states, [x]
    )
    monkeypatch.setattr(integrators, "EVALUATIONS", 60)
    monkeypatch.setattr(integrators, "LONG", 30.0)
    with pytest.raises(
        SolverError, match=r"stopped at t = \S+ of 2\.5 s after \d+ evaluations; check the units"
    ):
        integrators.integrate(linear(stiff), x, t, 1e-11, np.full(2, 1e-12))


def test_a_motion_that_is_not_finite_names_its_instant() -> None:
    loop = integrators.Rates(
        lambda t, x: x * (np.nan if t > 1.0 else 1.0), lambda t, x: np.eye(1), None, None
    )  # type: ignore[arg-type]
    with pytest.raises(
        SolverError,
        match=r"simulation: failed at t = \S+ s \(.+\); check the torque, and the numbers",
    ):
        integrators.integrate(loop, np.ones(1), np.linspace(0.0, 2.0, 5), 1e-8, np.ones(1))


@pytest.mark.parametrize(
    ("limit", "value", "words"),
    [
        ("ADVANCE", 1e3, "evaluations of the implicit method: the equations of motion are stiff"),
        ("EVALUATIONS_STIFF", 400, "evaluations of the implicit method"),
        ("ADVANCE", 1e-9, None),
    ],
)
def test_the_implicit_method_has_to_advance_within_its_patience(
    limit: str, value: float, words: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between two checks it may ask for so many evaluations, and has to advance by a part of
    all.
    """
    for name, changed in (("BLOCK", 50), ("RATE", 100.0), ("PATIENCE", 100), (limit, value)):
        monkeypatch.setattr(integrators, name, changed)
    stiff = np.array([[-1.0, 0.0], [0.0, -4000.0]])
    t = np.linspace(0.5, 2.5, 9)
    x = np.array([1.0, -2.0])
    if words is None:
        found = integrators.integrate(linear(stiff), x, t, 1e-11, np.full(2, 1e-12))
        assert_allclose(found.states[-1, 0], np.exp(-2.0), rtol=1e-8)
        return
    with pytest.raises(SolverError, match=words):
        integrators.integrate(linear(stiff), x, t, 1e-11, np.full(2, 1e-12))
