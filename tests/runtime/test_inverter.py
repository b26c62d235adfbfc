"""Inverse dynamics of a loaded library along paths, from Python: what it takes, gives and
refuses.
"""

from __future__ import annotations

import copy
import ctypes
import json
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from emitted import library_of, loaded, made
from inversion_cases import EVERY, MODEL, PERIOD, given, samples
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.runtime import load
from flexgen.runtime.inversion.path_inversion import pointer
from flexgen.runtime.structs import struct_of, structs_of

pytestmark = needs_compiler

# Between the mesh points the elastic coordinates are quintics: on a mesh of 5 ms they leave the
# equations by about 1e-6 of the torques at rest.
BETWEEN = 1e-5


@pytest.fixture(scope="module")
def library():
    return loaded(MODEL)


@pytest.fixture(scope="module")
def answer(library):
    return library.invert(**given())


BEYOND = 6  # samples after the last one, for the derivatives there


# --- whole paths ---------------------------------------------------------------------------------
def test_a_path_is_inverted(library, answer):
    n = len(samples()["y"])
    assert (
        answer.q_a.shape == (n + 200, 3)
        and answer.tau_m.shape == (n + 200, 2)
        and answer.tau_g.shape == (n + 200, 2)
    )
    assert (answer.n_pre, answer.n_post, answer.period) == (100, 100, PERIOD)
    assert answer.t[0] == pytest.approx(-0.1) and answer.t[100] == 0.0
    assert answer.residual < 1e-9 and answer.residual_at_samples < BETWEEN
    assert answer.iterations >= 1 and answer.intervals == -(-(n + 199 + BEYOND) // EVERY)
    # the output is on the path, and the motion is its own derivative
    p, _ = library.forward_kinematics(answer.q_a[100:-100])
    assert np.abs(p[:, :2] - samples()["y"]).max() < 1e-9
    dy = (answer.q_a[2:] - answer.q_a[:-2]) / (2 * PERIOD)
    assert np.abs(dy - answer.v_a[1:-1]).max() < 1e-2 * np.abs(answer.v_a).max()
    assert not answer.v_a[0].any() or np.abs(answer.v_a[0]).max() < 1e-9


def test_the_torques_are_those_of_the_arm(library, answer):
    tau_g, row = library.inversion_rows(answer.q_a, answer.v_a, answer.a_a)
    assert np.abs(tau_g - answer.tau_g).max() < 1e-9 * np.abs(tau_g).max()
    assert np.abs(row).max() < BETWEEN * np.abs(tau_g).max()


def test_repeated_and_parallel_calls_give_the_same_bits(library, answer):
    with ThreadPoolExecutor(4) as pool:
        for other in pool.map(lambda _: library.invert(**given()), range(8)):
            assert np.array_equal(other.tau_m, answer.tau_m)


def test_an_inverter_survives_pickling(answer):
    invert = pickle.loads(pickle.dumps(loaded(MODEL).invert))
    assert np.array_equal(invert(**given()).tau_m, answer.tau_m)
    assert copy.copy(invert) is invert and copy.deepcopy(invert) is invert
    assert repr(invert) == (
        "invert(y, dy, ddy, *, period, q_start, n_pre=0, n_post=0, samples_per_interval=1, "
        "tolerance=1e-06, hold='spline', delay=0, settled=0, growth=False)"
    )


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"y": np.zeros(4)}, ArgumentError, r"y: given shape \(4,\), expected \(n, 2\)"),
        ({"y": "here"}, ArgumentError, "y: given"),
        ({"dy": np.zeros((3, 2))}, ArgumentError, "dy: given shape"),
        ({"q_start": np.zeros(2)}, ArgumentError, "q_start: given shape"),
        ({"q_start": np.full(3, np.nan)}, ArgumentError, "an input is not finite"),
        (
            {"y": np.full((5, 2), np.inf), "dy": np.zeros((5, 2)), "ddy": np.zeros((5, 2))},
            ArgumentError,
            "finite",
        ),
        ({"period": 0.0}, ArgumentError, "a size, a time"),
        ({"period": "1"}, ArgumentError, "period: given '1', expected a number"),
        ({"tolerance": -1.0}, ArgumentError, "a size, a time"),
        ({"n_pre": -1}, ArgumentError, "n_pre and n_post at least 0"),
        ({"n_pre": 1.5}, ArgumentError, "n_pre: given 1.5, expected a whole number"),
        ({"samples_per_interval": 0}, ArgumentError, "samples_per_interval at least 1"),
        ({"n_post": 2**31}, ArgumentError, "n_post: given"),
    ],
)
def test_invalid_paths_and_options_are_refused(library, changes, error, words):
    with pytest.raises(error, match=words):
        library.invert(**given(**changes))


def test_a_path_out_of_reach_has_an_error_status(library):
    with pytest.raises(
        SolverError, match="leaves the workspace of the robot or passes a singular pose"
    ):
        library.invert(**given(y=10.0 * samples()["y"]))


def test_c_refuses_null_pointers_and_too_little_memory(library):
    directory = made(MODEL).directory
    c = ctypes.CDLL(str(library_of(directory)))
    structs = structs_of(json.loads((directory / "manifest.json").read_text()))
    s = samples()
    n = len(s["y"])
    arrays = {key: np.ascontiguousarray(s[key]) for key in ("y", "dy", "ddy")}
    q = np.ascontiguousarray(s["q_start"])
    work = np.zeros(10)
    options = struct_of(
        structs["inversion_options"], n_pre=100, n_post=100, samples_per_interval=5, tolerance=1e-9
    )
    motion = structs["motion"]()
    info = structs["invert_info"]()

    def status(null: int | None = None, member: str = "") -> int:
        path = struct_of(
            structs["samples"],
            n=n,
            period=PERIOD,
            **{k: None if k == member else x for k, x in arrays.items()},
        )
        where = [
            ctypes.byref(path),
            pointer(q),
            ctypes.byref(options),
            ctypes.byref(motion),
            ctypes.byref(info),
        ]
        where.append(pointer(work))
        if null is not None:
            where[null] = ctypes.c_void_p(None)
        return c.planar5_nmp_invert(*where, ctypes.c_int64(len(work)))

    assert status() == -6  # WORK_TOO_SMALL
    assert {status(null) for null in range(6)} == {status(member=name) for name in arrays} == {-1}
    wanted = c.planar5_nmp_invert_work
    wanted.restype = ctypes.c_int64
    assert wanted(1, ctypes.byref(options)) == -1 and wanted(n, ctypes.byref(options)) > 10
    work = np.zeros(wanted(n, ctypes.byref(options)))
    assert status() == 0  # members of the motion may be null
    for n_post in range(100, 108):  # whatever is in the workspace, and wherever its arrays end
        options.n_post = n_post
        tau_m = np.empty((100 + n + n_post, 2))
        work = np.full(wanted(n, ctypes.byref(options)), 1e300)
        motion = struct_of(structs["motion"], tau_m=tau_m)
        assert status() == 0
        expected = library.invert(**given(n_pre=100, n_post=n_post, tolerance=1e-9))
        assert (
            tau_m == expected.tau_m
        ).all() and info.kinematic_mismatch == expected.kinematic_mismatch


def test_a_library_without_inversion_raises_an_error_that_names_it(tmp_path):
    from flexgen.codegen.build.generate import generate

    few = load(generate(MODEL, tmp_path / "few", functions=["gravity"]).directory)
    with pytest.raises(ArgumentError, match="without invert, expected one with all functions"):
        _ = few.invert
    with pytest.raises(ArgumentError, match="without streams"):
        few.stream(np.zeros(2), np.zeros(3), period=5e-3, intervals=10)


def test_a_closed_inverter_refuses_calls():
    mine = load(made(MODEL).directory)
    invert = mine.invert
    mine.close()
    with pytest.raises(ArgumentError, match="closed"):
        invert(**given())
    with pytest.raises(ArgumentError, match="closed"):
        pickle.dumps(invert)
    with pytest.raises(ArgumentError, match="closed"):
        mine.stream(np.zeros(2), np.zeros(3), period=5e-3, intervals=10)


def test_closing_a_library_closes_its_streams():
    mine = load(made(MODEL).directory)
    other = load(made(MODEL).directory)
    stream = begun(mine)
    open_stream = begun(other)
    stored = pickle.dumps(stream)
    path = samples()
    sample = (path["y"][0], 0 * path["dy"][0], 0 * path["ddy"][0])
    before = stream.update(*sample)
    mine.close()
    for call in (
        lambda: stream.update(*sample),
        lambda: copy.copy(stream).update(*sample),
        stream.limit,
        lambda: pickle.dumps(stream),
    ):
        with pytest.raises(
            ArgumentError, match=r"planar5_nmp: given a library that was closed.*load it again"
        ):
            call()
    for running in (open_stream, pickle.loads(stored)):
        assert np.array_equal(running.update(*sample).tau_m, before.tau_m)


# --- streams -------------------------------------------------------------------------------------
HORIZON = 40


def begun(library):
    s = samples()
    return library.stream(
        s["y"][0],
        s["q_start"],
        period=EVERY * PERIOD,
        intervals=HORIZON,
        samples_per_interval=EVERY,
    )


def updates(stream, first: int, last: int):
    """Updates number first ... last - 1: samples of the path, then rest at its end."""
    s = {key: samples()[key][::EVERY] for key in ("y", "dy", "ddy")}
    out = []
    for k in range(first, last):
        at = min(k, len(s["y"]) - 1)
        moving = float(k < len(s["y"]))
        out.append(stream.update(s["y"][at], moving * s["dy"][at], moving * s["ddy"][at]))
    return out


def test_a_stream_gives_the_torques_of_the_path(library):
    """The stream sees 0.2 s ahead, the whole path all of it; both follow it exactly, and so
    agree.
    """
    n = len(samples()["y"][::EVERY])
    intervals = updates(begun(library), 1, n + HORIZON + 20)
    assert all(x.converged for x in intervals) and max(x.residual for x in intervals) < 1e-6
    assert intervals[0].tau_m.shape == (EVERY, 2) and intervals[0].q_a.shape == (EVERY, 3)
    tau = np.vstack([x.tau_m for x in intervals])
    whole = library.invert(**given(n_pre=EVERY * (HORIZON - 1), n_post=100))
    count = len(whole.tau_m) - 50  # (the end of the whole motion is free)
    assert np.abs(tau[:count] - whole.tau_m[:count]).max() < 1e-3 * np.abs(whole.tau_m).max()


def test_a_copied_stream_is_independent(library):
    stream = begun(library)
    updates(stream, 1, 30)
    others = [copy.copy(stream), copy.deepcopy(stream), pickle.loads(pickle.dumps(stream))]
    expected = updates(stream, 30, 40)[-1].tau_m
    for other in others:
        assert np.array_equal(updates(other, 30, 40)[-1].tau_m, expected)


def test_a_refused_sample_changes_nothing(library):
    stream = begun(library)
    other = begun(library)
    updates(stream, 1, 20)
    updates(other, 1, 20)
    s = samples()
    for y, error in ((np.full(2, np.nan), ArgumentError), (10.0 * s["y"][0], SolverError)):
        with pytest.raises(error):
            stream.update(y, np.zeros(2), np.zeros(2))
    with pytest.raises(ArgumentError, match="dy: given shape"):
        stream.update(s["y"][0], np.zeros(3), np.zeros(2))
    assert np.array_equal(updates(stream, 20, 30)[-1].tau_m, updates(other, 20, 30)[-1].tau_m)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"intervals": 0}, "given 0 intervals"),
        ({"samples_per_interval": 1001}, "1001 samples per interval"),
        ({"intervals": 2.5}, "intervals: given 2.5, expected a whole number"),
        ({"period": -1.0}, "a size, a time"),
        ({"tolerance": 2.0}, "a size, a time"),
    ],
)
def test_invalid_calls_of_a_stream_are_refused(library, changes, words):
    s = samples()
    with pytest.raises(ArgumentError, match=words):
        library.stream(s["y"][0], s["q_start"], **{"period": 5e-3, "intervals": 10, **changes})
