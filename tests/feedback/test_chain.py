"""Sampled chains of integrators: the loop as a simulation, its largest frequency, and refusals."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws import chain
from flexgen.feedback.loop.timing import Timing

H = 0.01
GAINS = np.array([200.0, 90.0, 15.0])


def move(x: np.ndarray, s: float, h: float) -> np.ndarray:
    """Exact motion of three integrators under a constant input."""
    whole = expm(np.diag(np.ones(3), 1) * h)
    return whole[:3, :3] @ x + whole[:3, 3] * s


def simulated(timing: Timing, z: np.ndarray) -> np.ndarray:
    """One sample of the chain, whose state is x, the last x, and the inputs, the newest first."""
    x = z[:3]
    inputs = list(z[6:])
    seen = x.copy()
    if timing.differences:
        seen[1] = (x[0] - z[3]) / H
    whole = int(timing.delay_s / H + 1e-9)
    rest = timing.delay_s - whole * H
    if timing.predicted:
        for at in np.arange(0.0, timing.delay_s - 1e-9, H / 10):
            age = int(np.ceil((timing.delay_s - at) / H - 1e-9))
            seen = move(seen, inputs[age - 1], H / 10)
    new = -GAINS @ seen
    if timing.predicted:
        new = -GAINS @ move(seen, new, H / 2)
    sent = [new, *inputs]
    moved = move(move(x, sent[whole + 1], rest), sent[whole], H - rest)
    return np.r_[moved, x, sent[: whole + 2]]


@pytest.mark.parametrize(
    ("delay", "predicted", "differences"),
    list(product([0.0, 0.004, 0.01, 0.014], [False, True], [False, True])),
)
def test_the_matrix_of_the_loop_is_its_simulation(
    delay: float, predicted: bool, differences: bool
) -> None:
    timing = Timing(H, delay, predicted, differences)
    loop = chain.chain_loop(GAINS, timing)
    for z in np.random.default_rng(1).normal(size=(3, len(loop))):
        assert_allclose(loop @ z, simulated(timing, z), rtol=1e-9, atol=1e-9)
    radius = np.abs(np.linalg.eigvals(loop)).max()
    assert chain.largest_eigenvalue(GAINS, timing) == pytest.approx(radius, rel=1e-6)
    assert timing.ahead_s == (delay + H / 2 if predicted else 0.0)


def test_continuous_gains_are_those_of_the_polynomial() -> None:
    w = 2 * np.pi * 1.5
    assert_allclose(chain.chain_gains(1.5, 4, "continuous", H), np.poly([-w] * 4)[:0:-1])


@pytest.mark.parametrize("form", chain.FORMS)
def test_gains_are_stable_up_to_the_largest_frequency(form: chain.FormName) -> None:
    timing = Timing(H, 0.004, differences=True)
    largest = chain.largest_frequency(2, form, timing)
    for factor in (0.999, 1.001):
        gains = chain.chain_gains(factor * largest, 2, form, H)
        radius = np.abs(np.linalg.eigvals(chain.chain_loop(gains, timing))).max()
        assert (radius < 1.0) == (factor < 1.0)
    assert_array_equal(chain.stable_gains(1.001 * largest, 2, form, timing, True), gains)
    found = chain.stable_gains(0.999 * largest, 2, form, timing)
    assert_allclose(found, chain.chain_gains(0.999 * largest, 2, form, H))
    text = (
        f"given {1.001 * largest:g} Hz, with which a chain of 2 integrators is unstable at 10 ms "
        f"and a delay of 4 ms, speeds by differences .*expected at most {largest:.4g} Hz"
    )
    with pytest.raises(ArgumentError, match=text):
        chain.stable_gains(1.001 * largest, 2, form, timing)
    with pytest.raises(ArgumentError, match=r"a delay of 4 ms \(largest"):
        chain.stable_gains(40.0, 2, "continuous", replace(timing, differences=False))


@pytest.mark.parametrize(
    ("timing", "segments"),
    [
        (Timing(1e-3, 2.25e-3, True), [(3, 0.25e-3), (2, 1e-3), (1, 1e-3)]),
        (Timing(1e-3, 3e-3, True), [(3, 1e-3), (2, 1e-3), (1, 1e-3)]),
        (Timing(1e-3, 2e-3), []),
    ],
)
def test_segments_are_the_torques_under_way(
    timing: Timing, segments: list[tuple[int, float]]
) -> None:
    assert timing.segments() == [(age, pytest.approx(s)) for age, s in segments]
