"""Time laws: as many derivatives vanish at both ends as their smoothness says, and the next one
does not.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import betainc

from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.paths.timing.time_laws import SplineLaw, TimeLaw

LAWS = [*(TimeLaw(0.8, k) for k in range(6)), SplineLaw(0.8, (0.2, 0.5, 0.8))]


def order_at_start(law) -> float:
    """The power p of s(t) ~ t^p just after the start, from two values of the distance."""
    near, far = law(np.array([1e-3, 2e-3]), 0)[:, 0]
    return float(np.log2(far / near))


def order_at_end(law) -> float:
    end = law.duration
    near, far = law.length - law(np.array([end - 0.02, end - 0.04]), 0)[:, 0]
    return float(np.log2(far / near))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: f"{type(law).__name__}-{law.smoothness}")
def test_smoothness_is_the_number_of_derivatives_that_vanish_at_both_ends(law):
    assert order_at_start(law) == pytest.approx(law.smoothness + 1, abs=0.15)
    assert order_at_end(law) == pytest.approx(law.smoothness + 1, abs=0.5)


@pytest.mark.parametrize("smoothness", range(10))
def test_the_shortest_polynomial_is_the_incomplete_beta_function(smoothness: int) -> None:
    """The docstring states the integral, up to the smoothness 9 that model files may have."""
    u = np.linspace(0.0, 1.0, 41)
    found = TimeLaw(0.8, smoothness, 3.0)(0.8 * u, 0)[:, 0]
    assert np.abs(found - 3.0 * betainc(smoothness + 1, smoothness + 1, u)).max() < 1e-10


@pytest.mark.parametrize("smoothness", [-1, 10])
def test_smoother_or_rougher_polynomials_are_refused(smoothness: int) -> None:
    with pytest.raises(
        ArgumentError,
        match=f"smoothness: given {smoothness}, expected 0 to 9 continuous derivatives",
    ):
        TimeLaw(0.8, smoothness)


@pytest.mark.parametrize("exact", [False, True])
def test_speeds_are_differences_where_the_state_is_not_measured_exactly(exact):
    motion = LawMotion(None, None, None, None, 1e-3, 5e-4, exact, 100.0)
    assert motion.timing().differences is not exact
    x = np.arange(12.0).reshape(3, 2, 2) ** 2
    differences = np.diff(x[:, 0], axis=0) / 1e-3
    kept = motion.difference(x)
    assert np.array_equal(kept, x) if exact else np.array_equal(kept[1:, 1], differences)
