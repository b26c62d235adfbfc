"""Torques at standstill are taken out of filtered samples, against filters of whole records."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from flexgen.analysis.rests_of_motors import Rests
from flexgen.numerics.low_pass import LowPass

STEP, LIMIT = 2e-3, 4.0  # s, Hz


def taken(still: np.ndarray) -> tuple[Rests, LowPass]:
    low = LowPass(STEP, LIMIT)
    return Rests(still, LIMIT * STEP, low, low.every, 2 * low.half + low.every), low


def test_any_torque_at_standstill_is_taken_out_and_others_are_kept() -> None:
    """Random torques, with jumps at the ends of rests; of a motion with none, all is kept."""
    rng, n = np.random.default_rng(0), 3000
    still = np.zeros(n, bool)
    for first, last in ((0, 200), (701, 760), (1200, 2100), (2301, 2380), (2950, n)):
        still[first:last] = True
    rests, low = taken(still)
    smooth = np.cumsum(rng.normal(size=(n, 3)), axis=0) / 20 + rng.uniform(-5, 5, 3)
    before = low(still[:, None] * smooth)
    assert np.abs(rests.project(before)).max() < 2e-3 * np.abs(before).max()
    ends = np.zeros(n)
    ends[[701, 2379]] = 10.0
    assert np.abs(rests.project(low(ends))).max() < 0.05 * np.abs(low(ends)).max()
    moving = low(np.where(still, 0.0, np.sin(0.013 * np.arange(n))))
    left = rests.project(moving)
    assert 0.3 < (left**2).sum() / (moving**2).sum() < 0.95
    assert_allclose(left @ low(still * smooth[:, 0]), 0.0, atol=1e-3 * np.abs(moving).max() * np.abs(before).sum())
    x = rng.normal(size=(len(before), 2, 2))
    assert_allclose(rests.project(x)[:, 1, 0], rests.project(x[:, 1, 0]), atol=1e-12)
    none, _ = taken(np.zeros(n, bool))
    assert none.project(moving) is moving


def test_reversals_are_no_standstill() -> None:
    """A quarter of 1 / limit, 31.25 samples, and a little more."""
    still = np.zeros(2000, bool)
    still[800:831] = True
    x = np.ones(3)
    assert taken(still)[0].project(x) is x
    still[800:832] = True
    rests, low = taken(still)
    assert np.abs(rests.project(low(still))).max() < 1e-3 * low(still).max()


def test_a_motor_at_rest_for_a_whole_record_has_no_information() -> None:
    rests, low = taken(np.ones(2500, bool))
    x = low(np.cumsum(np.random.default_rng(1).normal(size=2500)))
    assert np.abs(rests.project(x)).max() < 1e-3 * np.abs(x).max()
