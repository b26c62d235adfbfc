"""Samples that are lost while their times have no gap."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.numerics.records import skipped_samples
from flexgen.identification.records.description import check_skipped

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FLEXGEN_DATA", ROOT.parent / "shared" / "data"))
T = 1e-3 * np.arange(4000)
RATES = np.array([0.7, 1.1, 1.9])  # Hz
NOISE = 2e-6  # rad


def angles(seed: int) -> np.ndarray:
    """Three axes that move by 0.5 rad, with noise."""
    noise = NOISE * np.random.default_rng(seed).standard_normal((len(T), 3))
    return 0.5 * np.sin(2 * np.pi * RATES * T[:, None]) + noise


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_lost_sample_is_found_where_the_axes_move(count):
    x = angles(0)
    for k in (137, 905, 2222, 3100):
        kept = np.delete(x, range(k + 1, k + 1 + count), axis=0)
        assert skipped_samples(T[: len(kept)], kept) == [(k, count)]


def test_right_records_have_none():
    """With noise, counts of an encoder, rests, abrupt starts, and steps that double in one axis
    only.
    """
    x = angles(1)
    start = np.where(T[:, None] < 1.0, 0.0, T[:, None] - 1.0) * [0.3, 0.5, 0.2]
    one = x.copy()
    one[1500:, 0] += x[1500, 0] - x[1499, 0]
    counts = 1e-4 * np.round(x / 1e-4)
    alone = np.delete(x[:, :1], 905, axis=0)
    for record in (x, start, one, counts, alone, np.zeros_like(x), x[:6]):
        assert skipped_samples(T[: len(record)], record) == []


def test_a_gap_in_the_times_is_not_a_hidden_loss():
    x = np.delete(angles(2), range(905, 908), axis=0)
    assert skipped_samples(np.delete(T, range(905, 908)), x) == []


def test_records_with_a_loss_are_refused():
    x = np.delete(angles(3), [905], axis=0)
    t = [T[: len(x)]] * 3
    with pytest.raises(flexgen.ArgumentError, match=r"log: at t = 0.904 s .* a sample were lost"):
        check_skipped("log", t, list(x.T))
    check_skipped("log", [T[: len(x)], T[: len(x)] + 1e-4, T[: len(x)]], list(x.T))


@pytest.mark.parametrize("run", ["A", "B"])
def test_a_real_arm_has_none_and_planted_ones_are_found(run):
    """A KUKA KR300: samples taken out while it moves are found at 80 % of the places, at least."""
    file = DATA / "kr300" / f"kr300_run_{run}.npz"
    if not file.exists():
        pytest.skip("no recordings kr300: KUKA KR300 of TU Kaiserslautern")
    data = np.load(file)
    t = data["t"]
    x = data["q_mot_deg"].T
    assert skipped_samples(t, x) == []
    speed = np.abs(np.diff(x, axis=0)).max(axis=1)
    fast = np.flatnonzero(speed[20:-20] > 0.3 * speed.max()) + 20
    drawn = np.random.default_rng(0).choice(fast, 40, replace=False).tolist()
    found = [skipped_samples(t[:-1], np.delete(x, k + 1, axis=0)) for k in drawn]
    hits = sum((k, 1) in places for k, places in zip(drawn, found, strict=True))
    assert hits >= 32
    assert all(abs(k - at) < 3 for k, places in zip(drawn, found, strict=True) for at, _ in places)
