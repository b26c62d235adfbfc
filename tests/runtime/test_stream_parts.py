"""An update of a stream in parts has the bits of one that is done at once, wherever it is
interrupted.
"""

from __future__ import annotations

import copy
import ctypes
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from emitted import library_of, made
from stream_machine import PARTS, UPDATE, Machine
from toolchain import needs_compiler

from flexgen.codegen.emission import stream_layout
from flexgen.runtime import load
from flexgen.runtime.inversion.path_inversion import pointer
from flexgen.runtime.streams.stream import Stream

pytestmark = needs_compiler
PLANAR = "planar5_nmp"
OK = 0
NULL_ARGUMENT = -1
INPUT_NOT_FINITE = -2
BAD_ARGUMENT = -5
UNREACHABLE = -7
NOT_STARTED = -9
AHEAD = 40  # long enough for limits
NOTHING = stream_layout.Contents(0, False, False, False, False, False, (0, 0, 0))


@cache
def machine(name: str) -> Machine:
    return Machine(name, "line", load(made(name).directory))


@cache
def entries(name: str) -> ctypes.CDLL:
    return ctypes.CDLL(str(library_of(Path(made(name).directory))))


def entry(name: str, what: str):
    return entries(name)[f"{name}_stream_{what}"]


def results(stream: Stream) -> list[np.ndarray]:
    info = bytes(stream._info)
    return [*(x.copy() for x in stream._outputs), np.frombuffer(info, np.uint8).copy()]


def in_parts(name: str, stream: Stream, sample: tuple[np.ndarray, ...], shares: list[int]) -> int:
    """An update in parts on the stream's own memory; its status."""
    memory, y, dy, ddy, motion, info = stream._arguments
    for own, x in zip(stream._inputs, sample, strict=True):
        own[...] = x
    status = entry(name, "begin")(memory, y, dy, ddy)
    for parts in shares:
        status = status or entry(name, "advance")(memory, parts)
    return status or entry(name, "finish")(memory, motion, info)


def sampled(name: str, n: int) -> list[tuple[np.ndarray, ...]]:
    t = UPDATE * np.arange(1, n + 1)
    return list(zip(*machine(name).samples(t), strict=True))


@pytest.mark.parametrize("hold", ["spline", "zoh"])
@pytest.mark.parametrize("name", [PLANAR, "elbow"])
def test_the_bits_are_those_of_one_call(name: str, hold: str) -> None:
    whole = machine(name).begun(AHEAD, PARTS, hold=hold)
    streams = {shares: copy.copy(whole) for shares in (0, 1, 3, 5, 200)}
    for k, sample in enumerate(sampled(name, 130)):
        if k == 50:  # within limits from here on
            most = 0.9 * np.abs(np.array([whole._outputs[5]])).max(axis=(0, 1)) + 1.0
            for stream in (whole, *streams.values()):
                stream.limit(torque=most)
        whole.update(*sample)
        for shares, stream in streams.items():
            assert in_parts(name, stream, sample, list(range(shares, 0, -1))) >= OK
            assert all(
                np.array_equal(a, b) for a, b in zip(results(stream), results(whole), strict=True)
            ), (k, shares)


def test_a_stream_may_be_copied_within_an_update() -> None:
    one = machine(PLANAR).begun(AHEAD)
    sample = sampled(PLANAR, 30)
    for each in sample[:-1]:
        one.update(*each)
    other = copy.copy(one)
    memory, y, dy, ddy, _, _ = one._arguments
    for own, x in zip(one._inputs, sample[-1], strict=True):
        own[...] = x
    assert (
        entry(PLANAR, "begin")(memory, y, dy, ddy) == OK
        and entry(PLANAR, "advance")(memory, 3) == OK
    )
    moved = copy.copy(one)
    memory, _, _, _, motion, info = moved._arguments
    assert entry(PLANAR, "finish")(memory, motion, info) == OK
    other.update(*sample[-1])
    assert all(np.array_equal(a, b) for a, b in zip(results(moved), results(other), strict=True))


def test_calls_out_of_order_are_refused_and_change_nothing() -> None:
    stream = machine(PLANAR).begun(AHEAD)
    sample = sampled(PLANAR, 3)
    memory, y, dy, ddy, motion, info = stream._arguments
    begin, advance, finish, update, limits = (
        entry(PLANAR, what) for what in ("begin", "advance", "finish", "update", "limits")
    )
    for own, x in zip(stream._inputs, sample[0], strict=True):
        own[...] = x
    before = stream._memory.copy()
    assert advance(memory, 5) == NOT_STARTED and finish(memory, motion, info) == NOT_STARTED
    assert begin(memory, None, dy, ddy) == NULL_ARGUMENT and advance(None, 1) == NULL_ARGUMENT
    stream._inputs[0][0] = np.nan
    assert begin(memory, y, dy, ddy) == INPUT_NOT_FINITE
    stream._inputs[0][0] = 50.0
    assert begin(memory, y, dy, ddy) == UNREACHABLE
    head = stream_layout.StreamLayout({"n_e": 1}, "double", NOTHING, 0).head_size
    assert stream._memory[:head].tobytes() == before[:head].tobytes()  # nothing has begun
    stream._inputs[0][...] = sample[0][0]
    assert begin(memory, y, dy, ddy) == OK
    begun = stream._memory.copy()
    bounds = pointer(np.full(2, 10.0))
    assert begin(memory, y, dy, ddy) == BAD_ARGUMENT and advance(memory, 0) == BAD_ARGUMENT
    assert update(memory, y, dy, ddy, motion, info) == BAD_ARGUMENT
    assert limits(memory, bounds, bounds, ctypes.c_double(0.1)) == BAD_ARGUMENT
    assert finish(memory, None, info) == NULL_ARGUMENT
    assert stream._memory.tobytes() == begun.tobytes()
    assert finish(memory, motion, info) == OK
    assert update(memory, y, dy, ddy, motion, info) >= OK


def test_a_skipped_part_of_an_update_changes_the_result() -> None:
    """Planted: the update skips a part, here the residual of the first points."""
    whole, planted = (machine(PLANAR).begun(AHEAD) for _ in range(2))
    part = stream_layout.StreamLayout({"n_e": 1}, "double", NOTHING, 0).head["part"]
    integers = planted._memory.view(np.int32)
    for k, sample in enumerate(sampled(PLANAR, 20)):
        whole.update(*sample)
        memory, y, dy, ddy, motion, info = planted._arguments
        for own, x in zip(planted._inputs, sample, strict=True):
            own[...] = x
        assert entry(PLANAR, "begin")(memory, y, dy, ddy) == OK
        assert integers[part // 4] == 1
        if k == 15:
            integers[part // 4] = 6  # the step, without residuals and factors of this update
        assert entry(PLANAR, "finish")(memory, motion, info) >= OK
    assert not np.array_equal(results(whole)[5], results(planted)[5])
