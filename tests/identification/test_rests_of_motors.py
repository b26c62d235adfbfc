"""Torques at standstill are taken out of filtered samples, against filters of whole records."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from flexgen.base.numerics.low_pass import LowPass
from flexgen.identification.rigid.rests_of_motors import Rests

STEP = 2e-3  # s
LIMIT = 4.0  # Hz


def taken(speed: np.ndarray, least: float = 0.0) -> tuple[Rests, LowPass]:
    low = LowPass(STEP, LIMIT)
    return Rests(speed, least, LIMIT * STEP, low, low.every, 2 * low.half + low.every), low


def test_any_torque_at_standstill_is_taken_out_and_others_are_kept() -> None:
    """Random torques, with jumps at the ends of rests; of a motion with none, all is kept."""
    rng = np.random.default_rng(0)
    n = 3000
    still = np.zeros(n, bool)
    for first, last in ((0, 200), (701, 760), (1200, 2100), (2301, 2380), (2950, n)):
        still[first:last] = True
    rests, low = taken(np.where(still, 0.0, 1.0))
    smooth = np.cumsum(rng.normal(size=(n, 3)), axis=0) / 20 + rng.uniform(-5, 5, 3)
    before = low(still[:, None] * smooth)
    assert np.abs(rests.project(before)).max() < 2e-3 * np.abs(before).max()
    ends = np.zeros(n)
    ends[[701, 2379]] = 10.0
    assert np.abs(rests.project(low(ends))).max() < 0.05 * np.abs(low(ends)).max()
    moving = low(np.where(still, 0.0, np.sin(0.013 * np.arange(n))))
    left = rests.project(moving)
    assert 0.3 < (left**2).sum() / (moving**2).sum() < 0.95
    assert_allclose(
        left @ low(still * smooth[:, 0]),
        0.0,
        atol=1e-3 * np.abs(moving).max() * np.abs(before).sum(),
    )
    x = rng.normal(size=(len(before), 2, 2))
    assert_allclose(rests.project(x)[:, 1, 0], rests.project(x[:, 1, 0]), atol=1e-12)
    none, _ = taken(np.ones(n))
    assert none.project(moving) is moving


def test_a_short_pass_through_zero_is_kept() -> None:
    """A quarter of 1 / limit, 31.25 samples, and a little more; on the way forward only."""
    speed = np.ones(2000)
    x = np.ones(3)
    speed[800:831] = 0.0
    assert taken(speed)[0].project(x) is x
    speed[800:832] = 0.0
    rests, low = taken(speed)
    assert np.abs(rests.project(low(1.0 - speed))).max() < 1e-3 * low(1.0 - speed).max()


def test_friction_turns_late_after_a_reversal() -> None:
    """By a distance s: 2 F exp(-x / s) is missing after a travel x; one number for all reversals
    of a record.
    """
    t = STEP * np.arange(5000)
    w = 2 * np.pi * np.array([0.3, 0.8])
    size = np.array([0.5, 0.3])
    speed = (size * w * np.cos(w * t[:, None])).sum(axis=1)
    travel = 1e9
    sign = 1.0
    x = np.zeros(len(t))
    for k, v in enumerate(speed):
        travel = abs(v) * STEP if v * sign < 0 else travel + abs(v) * STEP
        sign = np.sign(v)
        x[k] = travel
    missing = -2 * np.sign(speed) * np.exp(-x / 2e-4)
    rests, low = taken(speed, 0.01 * np.abs(speed).max())
    before = low(missing)
    assert np.sqrt(np.mean(rests.project(before) ** 2)) < 0.14 * np.sqrt(np.mean(before**2))
    others = np.random.default_rng(0).normal(size=(len(before), 5))
    assert np.linalg.matrix_rank(rests.project(others) - others, tol=1e-5) == 1


def test_a_motor_at_rest_for_a_whole_record_has_no_information() -> None:
    rests, low = taken(np.zeros(2500))
    x = low(np.cumsum(np.random.default_rng(1).normal(size=2500)))
    assert np.abs(rests.project(x)).max() < 1e-3 * np.abs(x).max()
