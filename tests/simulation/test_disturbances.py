"""Disturbances: closed forms over the time, and their places in the table of all robots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.errors import ArgumentError
from flexgen.simulation.environment.disturbances import (
    LINES,
    Disturbance,
    disturbance_table,
    rows_of,
)

T = np.linspace(0.0, 2.0, 2001)
START = 0.5
LENGTH = 0.75


def made(kind: str, **changes: Any) -> Disturbance:
    """On the motor ``m1``, of size 3."""
    given = {"size": 3.0, "start_s": START, "length_s": LENGTH} | changes
    return Disturbance(kind, "m1", **given)


@pytest.mark.parametrize(
    ("kind", "length", "end"),
    [
        ("step", None, np.inf),
        ("step", LENGTH, START + LENGTH),
        ("pulse", LENGTH, START + LENGTH),
        ("ramp", LENGTH, np.inf),
    ],
)
def test_steps_pulses_and_ramps(kind: str, length: float | None, end: float) -> None:
    """A ramp stays at its size; the others end after their length, if they have one."""
    given = made(kind, length_s=length)
    on = (T >= START) & (end > T)
    rise = np.clip((T - START) / LENGTH, 0.0, 1.0) if kind == "ramp" else 1.0
    assert_allclose(given.values(T), 3.0 * on * rise)
    assert given.end_s == end


def test_the_frequency_of_a_chirp_grows_by_one_factor_in_equal_times() -> None:
    """The phase by integration: ``f = f_0 (f_1 / f_0)^(t / length)``."""
    low = 2.0
    high = 30.0
    given = made("chirp", frequency_hz=(low, high))
    since = np.linspace(0.0, LENGTH, 20001)
    rate = 2 * np.pi * low * (high / low) ** (since / LENGTH)
    phase = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(since))])
    found = given.values(START + since[:-1])
    assert_allclose(found, 3.0 * np.sin(phase[:-1]), atol=1e-4)
    assert not given.values(np.array([START - 1e-9, START + LENGTH])).any()


@pytest.mark.parametrize("band", [(5.0, 40.0), (2.0, 900.0)])
def test_noise_has_its_variance_and_its_band(band: tuple[float, float]) -> None:
    """Power outside of the band is that of the window; another seed gives another signal."""
    length = 20.0
    given = made("noise", length_s=length, frequency_hz=band, start_s=0.0)
    t = np.arange(40000) / 2000.0
    x = given.values(t, seed=1)
    assert np.std(x) == pytest.approx(3.0, rel=0.05)
    assert_array_equal(x, given.values(t, seed=1))
    assert np.abs(x - given.values(t, seed=2)).max() > 1.0
    power = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2
    f = np.fft.rfftfreq(len(x), 1 / 2000.0)
    inside = (f > band[0] - 0.5) & (f < band[1] + 0.5)
    assert power[inside].sum() > 0.999 * power.sum()
    lines = min((band[1] - band[0]) * length, LINES)
    spacing = (band[1] - band[0]) / lines
    peaks = f[np.flatnonzero(power > 0.2 * power.max())]
    assert np.diff(peaks).max() < 2 * spacing + 0.5
    assert not given.values(np.array([-1e-9, length])).any()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"kind": "wave"}, "given kind 'wave', expected one of step, pulse, ramp, chirp, noise"),
        ({"size": np.inf}, "on m1, size: given inf, expected a finite number"),
        ({"start_s": np.inf}, "on m1, start_s: given inf, expected a finite number"),
        ({"kind": "pulse", "length_s": None}, "length_s: given none, expected a time > 0 in s"),
        ({"length_s": 0.0}, r"length_s: given 0\.0, expected a time > 0 in s"),
        ({"length_s": np.inf}, "length_s: given inf, expected a time > 0 in s"),
        ({"frequency_hz": (1.0, 2.0)}, "frequency_hz: given .*, expected none for this kind"),
        ({"kind": "chirp"}, "frequency_hz: given None, expected two increasing frequencies"),
        ({"kind": "noise", "frequency_hz": (2.0, 2.0)}, "expected two increasing frequencies"),
        ({"kind": "noise", "frequency_hz": (0.0, 2.0)}, "expected two increasing frequencies"),
    ],
)
def test_disturbances_that_are_refused(changes: dict[str, Any], text: str) -> None:
    given = dict(changes)
    with pytest.raises(ArgumentError, match=f"^disturbance.*{text}"):
        made(given.pop("kind", "step"), **given)


def test_the_table_has_motors_then_the_tool() -> None:
    """Disturbances at one place add up, each noise with a seed of its own; one lane where all
    robots have the same.
    """
    motors = ("m1", "m2")
    assert [rows_of(x, motors) for x in ("m1", "m2", "tool.x", "tool.rz")] == [0, 1, 2, 7]
    with pytest.raises(ArgumentError, match=r"given the place 'm3', expected one of m1, m2, tool"):
        rows_of("m3", motors)
    push = Disturbance("step", "tool.z", 5.0, 1.0)
    noise = [made("noise", frequency_hz=(5.0, 40.0), size=s) for s in (1.0, 2.0)]
    table = disturbance_table({0: [push, *noise], 2: [push]}, motors, T, 3, seed=7)
    assert table is not None and table.shape == (len(T), 8, 3)
    assert_allclose(table[:, 4, 0], push.values(T))
    assert_allclose(table[:, 0, 0], noise[0].values(T, 8) + noise[1].values(T, 9))
    assert not table[:, :, 1].any() and not table[:, 0, 2].any()
    assert_allclose(table[:, 4, 2], push.values(T))
    same = disturbance_table({lane: [push] for lane in range(3)}, motors, T, 3)
    assert same is not None and same.shape == (len(T), 8, 1)
    assert disturbance_table({0: [], 1: []}, motors, T, 2) is None
