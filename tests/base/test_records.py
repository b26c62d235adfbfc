"""Records: lost samples and transients against simulated ones, with noise, coarse encoders, and
none.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.numerics.records import first_period_excess, lost_samples, slow_transients

TIME = 5e-4 * np.arange(4000)
ANGLE = sum(0.02 * np.sin(2 * np.pi * f * TIME + f) for f in (3.0, 7.0, 11.0, 23.0))


def hold(x: np.ndarray, count: int, burst: int) -> np.ndarray:
    """The samples with bursts that repeat the one before."""
    kept = np.arange(len(x))
    for first in np.random.default_rng(7).integers(1, len(x) - burst, count):
        kept[first : first + burst] = first - 1
    return x[kept]


@pytest.mark.parametrize(
    ("noise", "count"), [(0.0, 0.0), (1e-5, 0.0), (1e-5, 2e-5), (1e-4, 2e-5), (0.0, 1e-4)]
)
def test_lost_samples_are_found_and_friction_is_not_one(noise: float, count: float) -> None:
    """Bursts of five are found with noise and with coarse encoders; an axis that sticks where it
    turns is not.
    """

    def seen(x: np.ndarray) -> np.ndarray:
        x = x + noise * np.random.default_rng(1).normal(size=len(x))
        return np.round(x / count) * count if count else x

    sticking = np.sign(ANGLE) * np.minimum(np.abs(ANGLE), 0.5 * np.abs(ANGLE).max())
    assert len(lost_samples(seen(ANGLE))) == 0 and len(lost_samples(seen(sticking))) <= 2
    assert 25 <= len(lost_samples(hold(seen(ANGLE), 40, 5))) <= 40


def spectra(transient: float, periods: int = 4, seed: int = 0) -> np.ndarray:
    """Noise, and a mode that decays by a factor of e in each period, in the first of two
    channels.
    """
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(8, periods, 40, 2)) + 1j * rng.normal(size=(8, periods, 40, 2))
    X[..., 0] += transient * np.exp(-np.arange(periods))[:, None] / (1 + 0.1j * np.arange(40))
    return X


def test_a_transient_is_found_and_noise_is_not_one() -> None:
    """None of 300 records of noise, also where few lines have most of it; each with a transient,
    in its channel.
    """
    assert all((first_period_excess(spectra(0.0, seed=k)) == 1.0).all() for k in range(300))
    colored = np.r_[np.full(3, 30.0), np.ones(37)][:, None]
    assert all(
        (first_period_excess(colored * spectra(0.0, seed=k)) == 1.0).all() for k in range(300)
    )
    assert (first_period_excess(1e9 + 1e3 * spectra(8.0)) == 1.0).all()  # too small to matter
    for k in range(20):
        first, second = first_period_excess(spectra(8.0, seed=k))
        assert first > 1.4 and second == 1.0


def test_a_slow_transient_is_in_all_periods() -> None:
    """A mode that decays by a factor in each of four periods; the others are seen in the first
    period alone.
    """
    for factor, slow in ((0.999, True), (0.9, True), (0.7, True), (0.2, False), (0.005, False)):
        X = 0.01 * spectra(0.0) + 3.0
        turned = factor * np.exp(2.1j)  # of a vibration whose frequency is between the lines
        X[..., 1] += 5.0 * (turned ** np.arange(4))[:, None] / (1 + 0.1j * np.arange(40))
        assert slow_transients(X).tolist() == [False, slow]
        # the slowest one is in all periods alike
        assert first_period_excess(X)[1] > 1.4 or factor > 0.8
        # in the second one, too
        assert (first_period_excess(X[:, 1:])[1] > 1.4) == (0.01 < factor < 0.9)
        assert not slow_transients(1e6 + X).any()  # too small to matter
    assert not any(slow_transients(spectra(0.0, seed=k)).any() for k in range(300))
    colored = np.r_[np.full(3, 30.0), np.ones(37)][:, None]
    assert not any(slow_transients(colored * spectra(0.0, seed=k)).any() for k in range(300))
    assert not slow_transients(spectra(9.0)[:, :2]).any()  # two periods show nothing


def test_counts_of_an_encoder_at_rest_are_not_lost_samples() -> None:
    """Rest and one count of noise, at steps of 10 and 12 ms, and interpolated to 10 ms."""
    rng = np.random.default_rng(3)
    count = 1.2e-5
    for rest in (0.0, 3.0, 20.0):
        t = np.cumsum(rng.choice([0.010, 0.012], size=2600, p=[0.67, 0.33]))
        s = np.clip(t - rest, 0.0, None)
        x = np.clip(s / 3, 0, 1) ** 3 * 0.6 * np.sin(2 * np.pi * 0.25 * s)
        seen = count * np.round(x / count + 0.5 * rng.normal(size=len(t)))
        at = np.arange(t[0], t[-1], 0.01)
        resampled = np.interp(at, t, seen)
        assert len(lost_samples(seen)) == len(lost_samples(resampled)) == 0
        moving = np.flatnonzero(at > rest + 1.0)
        for k in moving[:: len(moving) // 20]:  # the motion continues, the samples do not
            resampled[k : k + 6] = resampled[k]
        assert len(lost_samples(resampled)) >= 10


@pytest.mark.parametrize(("factor", "seen"), [(0.98, False), (1.02, True)])
def test_a_transient_is_one_beyond_six_deviations_of_the_ratio(factor: float, seen: bool) -> None:
    """All lines of the same power: the ratio of two means of ``count`` real numbers scatters by
    sqrt(4 / count).
    """
    lines = 50
    records = 3
    count = 2 * records * lines
    ratio = 1.0 + factor * 6.0 * np.sqrt(4 / count)
    X = (
        np.cumsum(
            np.stack([np.zeros((records, lines, 1)), *[np.ones((records, lines, 1))] * 3], axis=1),
            axis=1,
        )
        + 0j
    )
    X[:, 0] = X[:, 1] - np.sqrt(ratio)
    expected = ratio if seen else 1.0
    assert_allclose(first_period_excess(X), [expected])
    assert_allclose(first_period_excess(X[:, :2]), [1.0])
