"""Records at equal steps: errors of analytic signals, rest, gaps, clocks."""

from __future__ import annotations

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics import sampling
from flexgen.base.numerics.sampling import read_clock, resample

STEPS = (0.010, 0.012)


def unequal(count: int, seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).choice(STEPS, size=count))


def spline_error(f: float) -> float:
    """Largest error of a sine of amplitude 1 in samples at unequal steps, without both ends."""
    t = unequal(4000)
    found = resample("a", [t], [np.sin(2 * np.pi * f * t)], [True]).pieces[0]
    return float(np.abs(found.values[:, 0] - np.sin(2 * np.pi * f * found.time))[20:-20].max())


@pytest.mark.parametrize("f", [2.0, 4.0, 8.0, 12.0])
def test_the_error_of_a_sine_is_below_the_stated_bound(f: float) -> None:
    bound = 1.3 * (2 * f * max(STEPS)) ** 6
    assert spline_error(f) < bound
    assert f < 4.0 or spline_error(f) > 1e-4 * bound


def test_planted_straight_lines_are_above_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "DEGREE", 1)
    assert spline_error(4.0) > 10 * 1.3 * (2 * 4.0 * max(STEPS)) ** 6


def gain(f: float) -> float:
    """Amplitude at 250 Hz of a sine sampled at 1 kHz, in the middle of the record."""
    fast = 1e-3 * np.arange(8000)
    slow = 4e-3 * np.arange(2000)
    signals = [np.sin(2 * np.pi * f * fast), np.sin(2 * np.pi * slow)]
    found = resample("a", [fast, slow], signals, [True, True])
    assert found.step == pytest.approx(4e-3) and found.resampled
    piece = found.pieces[0]
    x = piece.values[300:-300, 0]
    t = piece.time[300:-300]
    # as which a frequency above half the rate is seen
    seen = f if f < 125.0 else 250.0 - f
    basis = np.stack([np.sin(2 * np.pi * seen * t), np.cos(2 * np.pi * seen * t)], axis=1)
    return float(np.hypot(*np.linalg.lstsq(basis, x, rcond=None)[0]))


def test_a_higher_rate_keeps_the_band_and_is_not_aliased(monkeypatch: pytest.MonkeyPatch) -> None:
    for f in (1.0, 20.0, 60.0, 87.0):  # up to 0.35 of the new rate
        assert gain(f) == pytest.approx(1.0, abs=1e-4)
    for f in (126.0, 150.0, 180.0, 240.0):
        assert gain(f) < 1.5e-4
    monkeypatch.setattr(sampling, "low_pass", lambda x, ratio: x)  # planted: no filter
    assert gain(240.0) > 0.5


def test_rest_is_kept() -> None:
    """A constant exactly up to rounding; counts of an encoder at rest within one count."""
    t = unequal(3000)
    rng = np.random.default_rng(1)
    counts = 1e-4 * rng.integers(0, 2, len(t))
    found = resample("a", [t, t], [np.full(len(t), 0.7), counts], [True, True]).pieces[0]
    assert found.values[:, 0] == pytest.approx(0.7, abs=1e-12)
    assert found.values[:, 1].min() > -1e-4 and found.values[:, 1].max() < 2e-4


def test_equal_steps_stay_bit_by_bit() -> None:
    t = 5.0 + 1e-3 * np.arange(500)
    t[77] += 1.9e-5
    x = np.random.default_rng(0).normal(size=(500, 2))
    found = resample("a", [t, t.copy()], list(x.T), [True, False])
    assert not found.resampled and not found.notes and not found.gaps
    assert np.array_equal(found.pieces[0].time, t) and np.array_equal(found.pieces[0].values, x)


@pytest.mark.parametrize("sd", [2e-5, 2e-4, 1e-3, 2e-3])
def test_the_record_decides_whether_stamps_are_instants(sd: float) -> None:
    """Equal stamps, once with samples at equal steps, once with samples at the stamps."""
    rng = np.random.default_rng(4)
    even = 8e-3 * np.arange(3000)
    stamps = even + np.clip(rng.normal(size=3000), -2, 2) * sd
    if sd < 1e-4:
        even, stamps = even / 8, even / 8 + (stamps - even)

    def signal(t: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(9 * t), 0.2 * np.cos(14 * t)], axis=1)

    for instants in (even, stamps):
        clock = read_clock("a", stamps, signal(instants))
        away = clock.time - instants
        assert np.ptp(away) < 0.2 * sd  # a common shift is left
        assert clock.note.startswith("time stamps" if instants is even else "steps of")


def test_gaps_split_a_record_and_single_samples_do_not() -> None:
    t = np.delete(unequal(3000), [100, *range(700, 760), *range(2000, 2300)])
    x = np.sin(3 * t)
    found = resample("a", [t], [x], [True])
    assert [len(piece.time) for piece in found.pieces] == pytest.approx([700, 1240, 700], abs=5)
    for piece in found.pieces:
        assert piece.values[:, 0] == pytest.approx(np.sin(3 * piece.time), abs=1e-6)
    assert len(found.gaps) == 2 and "gap of 0.6" in str(found.notes[-2])
    edges = [(piece.time[0], piece.time[-1]) for piece in found.pieces]
    for gap, (_, end), (begin, _) in zip(found.gaps, edges[:-1], edges[1:], strict=True):
        assert end <= gap.begin + 1e-9 and begin >= gap.end - 1e-9


def test_clocks_that_cannot_be_used_are_refused() -> None:
    t = 1e-3 * np.arange(1000)
    x = np.sin(9 * t)
    for bad, words in (
        (-t, "time goes from -?0 to -0.001 s at sample 0, expected times that increase"),
        (0 * t, "time goes from 0 to 0 s at sample 0"),
        (np.where(t > 0.5, t - 0.4, t), "time goes from 0.5 to 0.101 s at sample 500"),
    ):
        with pytest.raises(ArgumentError, match=words):
            resample("a", [bad], [x], [True])
    with pytest.raises(ArgumentError, match="given channels without 16 samples in common"):
        resample("a", [t, t + 1.0], [x, x], [True, True])


def test_the_step_is_a_whole_part_of_a_period() -> None:
    t = unequal(3000)
    found = resample("a", [t], [np.sin(3 * t)], [True], period=2.0)
    assert 2.0 / found.step == pytest.approx(round(2.0 / found.step), abs=1e-9)
    assert found.step == pytest.approx(0.011, rel=0.01)
