"""Forces in plans: the quintic spline of SciPy, and forces that change too quickly."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import BSpline

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.planning.optimal import force as planned

RNG = np.random.default_rng(6)


def test_the_spline_of_a_force_is_the_quintic_one_with_equal_knots() -> None:
    """Against SciPy's; in a plan it is an expression of the path parameter."""
    count = 25
    coefficients = RNG.normal(size=(30, 6))
    spline = BSpline((np.arange(36) - 5.0) / count, coefficients, 5)
    s = np.linspace(0.0, 1.0, 77)
    made = planned.PlanForce(coefficients, None)  # type: ignore[arg-type]
    assert_allclose(made.at(s), spline(s), atol=1e-12)
    place = ca.SX.sym("s")
    at = ca.Function("at", [place], [made.of(place)])
    assert_allclose([np.array(at(x)).ravel() for x in s], spline(s), atol=1e-12)
    assert not made.constant
    held = planned.PlanForce(coefficients[:1], None)  # type: ignore[arg-type]
    assert held.constant and held_everywhere(held, s, coefficients[0])
    equations: Any = Made(pushed_by=lambda force: force)
    pushed: Any = [made.pushing(equations, 0.4), held.pushing(equations, None)]
    assert_allclose(pushed, [spline(0.4), coefficients[0]], atol=1e-12)
    with pytest.raises(
        ArgumentError, match=r"^bound: given within a problem whose force depends on the place"
    ):
        made.pushing(equations, None, "bound")


def held_everywhere(held: Any, s: np.ndarray, value: np.ndarray) -> bool:
    return (
        bool((held.at(s) == value).all())
        and np.array(ca.DM(held.of(None))).ravel().tolist() == value.tolist()
    )


def test_forces_that_change_quickly_are_refused_in_a_plan() -> None:
    """Waves along the path: with as many intervals as they need, up to a hundred."""
    equations = derive("elbow")
    s = np.linspace(0.0, 1.0, 801)
    intervals = []
    for waves in (1, 6, 14):
        wave = np.outer(np.sin(2 * np.pi * waves * s), [30.0, 0.0, 20.0])
        found = planned.make_plan_force(wave, equations, True)
        intervals.append(len(found.coefficients) - 5)
        assert_allclose(found.at(s)[:, :3], wave, atol=0.06)
    assert intervals == sorted(set(intervals))
    with pytest.raises(
        ArgumentError, match=r"changes too quickly: a spline of 100 intervals .*, expected 0\.001"
    ):
        planned.make_plan_force(
            np.outer(np.sin(2 * np.pi * 40 * s), [30.0, 0.0, 20.0]), equations, True
        )
    with pytest.raises(
        ArgumentError, match="which the motion need not follow with timing='given'"
    ):
        planned.make_plan_force(wave, equations, False)
    assert planned.make_plan_force([3.0, 0.0, 1.0], equations, False).constant
