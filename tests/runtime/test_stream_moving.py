"""Streams that start in motion give what streams from rest give; the full model under their
torques.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from stream_machine import AFTER, AHEAD, PARTS, UPDATE, Machine, error
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission.interface import START_SAMPLES
from flexgen.runtime.streams.stream import Interval, Stream

pytestmark = needs_compiler

EXACT = 1e-10  # of the largest torque: 3e-14 measured, the zeros of planar5_nmp are fast
CLOSE = 2e-4  # the same with slow stable zeros (0.29 s): 3e-5 to 9e-5 measured
NAMES = ("tau_m", "q_a", "q_m")


@cache
def machine(name: str, move: str | None) -> Machine:
    return Machine(name, move)


@cache
def from_rest(
    name: str, move: str | None, hold: str = "spline"
) -> tuple[tuple[np.ndarray, ...], list[Interval]]:
    """All samples of the path, and the intervals of a stream from rest; interval k is that of
    update k + 1.
    """
    one = machine(name, move)
    n = int(np.ceil((one.path.duration + AFTER) / UPDATE)) + AHEAD
    samples = one.samples(UPDATE * np.arange(n + 1))
    stream = one.begun(hold=hold)
    return samples, [
        stream.update(*sample) for sample in zip(*(x[1:] for x in samples), strict=True)
    ]


def moving(name: str, move: str | None, first: int, **options: Any) -> Stream:
    """A stream that starts with the samples of the path from ``first`` on."""
    one = machine(name, move)
    (samples, _) = from_rest(name, move)
    y, dy, ddy = (x[first : first + AHEAD + START_SAMPLES] for x in samples)
    given: dict[str, Any] = {"intervals": AHEAD, "samples_per_interval": PARTS, **options}
    return one.library.stream(y, one.path.q_start, period=UPDATE, dy=dy, ddy=ddy, **given)


def updates(stream: Stream, name: str, move: str | None, first: int, count: int) -> list[Interval]:
    samples, _ = from_rest(name, move)
    start = first + AHEAD + START_SAMPLES
    return [stream.update(*(x[k] for x in samples)) for k in range(start, start + count)]


@pytest.mark.parametrize(
    ("name", "move", "allowed"),
    [
        ("planar5_nmp", None, EXACT),
        pytest.param("elbow", None, EXACT, marks=pytest.mark.slow),
        pytest.param("manutec_r3_24", "line", CLOSE, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("first", [0, 10, 60])
def test_a_stream_from_motion_gives_the_torques_of_one_from_rest(name, move, allowed, first):
    _, expected = from_rest(name, move)
    found = updates(moving(name, move, first), name, move, first, 10)
    largest = np.abs(np.vstack([x.tau_m for x in expected])).max(axis=0)
    for k, interval in enumerate(found, first + AHEAD + START_SAMPLES - 1):
        assert interval.converged
        assert np.abs((interval.tau_m - expected[k].tau_m) / largest).max() < allowed


@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_held_torques_from_motion_agree_with_those_from_rest(hold):
    _, expected = from_rest("planar5_nmp", None, hold)
    found = updates(moving("planar5_nmp", None, 20, hold=hold), "planar5_nmp", None, 20, 3)
    largest = np.abs(np.vstack([x.tau_m for x in expected])).max(axis=0)
    for k, interval in enumerate(found, 20 + AHEAD + START_SAMPLES - 1):
        assert np.abs((interval.tau_m - expected[k].tau_m) / largest).max() < 1e-8


@pytest.mark.parametrize(
    ("name", "move", "allowed"),
    [
        ("planar5_nmp", None, 1e-8),
        pytest.param("manutec_r3_18", "line", 1e-6, marks=pytest.mark.slow),
    ],
)
def test_the_tool_follows_where_one_stream_takes_over_from_another(name, move, allowed):
    """The torques of one stream, then those of another that starts in motion."""
    one = machine(name, move)
    first = 20
    _, before = from_rest(name, move)
    switch = first + AHEAD + START_SAMPLES - 1
    rest = len(before) - switch
    whole = before[:switch] + updates(moving(name, move, first), name, move, first, rest)
    results = {key: np.vstack([getattr(interval, key) for interval in whole]) for key in NAMES}
    t = np.arange(len(whole) * PARTS) * UPDATE / PARTS - (AHEAD - 1) * UPDATE
    assert error(one.simulation(t, results)) < allowed
    # planted: one early
    late = before[:switch] + updates(moving(name, move, first - 1), name, move, first - 1, rest)
    results = {key: np.vstack([getattr(interval, key) for interval in late]) for key in NAMES}
    assert error(one.simulation(t, results)) > 1e-4


@pytest.mark.slow
def test_a_short_horizon_is_reported():
    """An arm with a slow unstable zero: what the horizon does not contain is a torque step, or a
    residual.
    """
    first = updates(moving("planar5_nmp@soft", None, 40), "planar5_nmp@soft", None, 40, 2)
    assert not first[0].converged and not first[1].converged


def test_a_stream_from_motion_starts_at_rest_and_can_be_copied():
    samples, expected = from_rest("planar5_nmp", None)
    one = machine("planar5_nmp", None)
    y, dy, ddy = (np.repeat(x[:1], AHEAD + START_SAMPLES, axis=0) for x in samples)
    stream = one.library.stream(
        y,
        one.path.q_start,
        period=UPDATE,
        intervals=AHEAD,
        samples_per_interval=PARTS,
        dy=dy,
        ddy=ddy,
    )
    found = [stream.update(*(x[k] for x in samples)) for k in (1, 2, 3)]
    for interval, other in zip(found, expected, strict=False):
        assert np.abs(interval.tau_m - other.tau_m).max() < 1e-9


def test_invalid_starts_from_motion_are_refused():
    samples, _ = from_rest("planar5_nmp", None)
    library = machine("planar5_nmp", None).library
    q = machine("planar5_nmp", None).path.q_start
    n = AHEAD + START_SAMPLES
    y, dy, ddy = (x[:n] for x in samples)
    options: dict[str, Any] = {"period": UPDATE, "intervals": AHEAD, "samples_per_interval": PARTS}
    with pytest.raises(
        ArgumentError, match=rf"stream, dy: given shape \({n - 1}, 2\), expected \({n}, 2\)"
    ):
        library.stream(y, q, dy=dy[1:], ddy=ddy, **options)
    with pytest.raises(ArgumentError, match="stream, ddy: given"):
        library.stream(y, q, dy=dy, **options)
    with pytest.raises(ArgumentError, match="finite"):
        library.stream(np.where(y == y[9], np.nan, y), q, dy=dy, ddy=ddy, **options)
    with pytest.raises(ArgumentError, match="stream, y: given shape"):
        library.stream(y, q, **options)
