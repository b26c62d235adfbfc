"""Torques for a drive that holds them, from C: those of Python, on whole paths and in a stream."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from emitted import loaded
from inversion_cases import MODEL, PERIOD, given, samples
from scipy.interpolate import BarycentricInterpolator
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.runtime.inversion.path_inversion import Inversion, pointer
from flexgen.runtime.structs import struct_of
from flexgen.simulation.integration.hold import TorqueCommand, hold_torque
from flexgen.simulation.simulate import simulate

pytestmark = needs_compiler

CASES = [
    ("zoh", 0.0),
    ("zoh", 0.4),
    ("zoh", 1.0),
    ("zoh", 4.0),
    ("linear", 0.0),
    ("linear", 2.7),
    ("spline", 0.3),
    ("spline", 3.0),
]
SAME = 1e-6  # of the largest torque: a spline through all samples, and a polynomial through six
ROUNDING = 1e-13  # of the largest torque
BAD_ARGUMENT = -5
CHANNELS = ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m")


@pytest.fixture(scope="module")
def library() -> flexgen.runtime.library.Library:
    return loaded(MODEL)


@pytest.fixture(scope="module")
def plain(library) -> Inversion:
    return library.invert(**given())


def expected(
    t: np.ndarray, tau: np.ndarray, hold: str, delay: float, limited: bool = False
) -> np.ndarray:
    """Torques that Python sends at the samples."""
    time, values = hold_torque(t, tau, hold, PERIOD, delay * PERIOD, limited=limited)
    first = int(np.argmin(np.abs(time - t[0])))
    found = values[first : first + len(t)]
    return np.concatenate([found, np.repeat(tau[-1:], len(t) - len(found), axis=0)])


def locally(tau: np.ndarray, hold: str, delay: float) -> np.ndarray:
    """Torques sent, from polynomials through six samples, integrated by Gauss points."""
    n = len(tau)
    far = 12
    more = int(delay)
    long = np.concatenate([np.repeat(tau[:1], far, axis=0), tau, np.repeat(tau[-1:], far, axis=0)])
    x = delay - more
    near = np.arange(-2, 4)
    points, weights = np.polynomial.legendre.leggauss(4)

    def mean(k: int, begin: float, end: float) -> np.ndarray:
        curve = BarycentricInterpolator(near, long[k + near])
        return (end - begin) / 2 * weights @ curve(begin + (end - begin) * (points + 1) / 2)

    values = np.zeros_like(long)
    for k in range(2, len(long) - 4):
        zoh = hold == "zoh"
        values[k] = (
            mean(k, x, 1) + mean(k + 1, 0, x)
            if zoh
            else BarycentricInterpolator(near, long[k + near])(x)
        )
    second = np.diff(values, 2, axis=0)
    sent = values[2:-2].copy()
    if hold != "spline":
        sent -= second[1:-1] / 12
    if hold == "linear":
        sent += 7 / 720 * np.diff(second, 2, axis=0)
    sent = sent[far - 2 + more : far - 2 + more + n]
    sent[np.arange(n) + delay >= n - 1] = tau[-1]
    return sent


def stream_of(
    library, updates: int = 160, each: int = 5, **options: Any
) -> tuple[np.ndarray, Any]:
    """Motor torques of a stream along the model's move, and the stream."""
    path = samples()
    stream = library.stream(
        path["y"][0],
        path["q_start"],
        period=each * PERIOD,
        intervals=max(20, 100 // each),
        samples_per_interval=each,
        **options,
    )
    tau = []
    ends = len(path["y"]) - 1
    for k in range(1, updates + 1):
        at = min(k * each, ends)
        inside = 1.0 if k * each <= ends else 0.0
        tau.append(
            stream.update(path["y"][at], inside * path["dy"][at], inside * path["ddy"][at]).tau_m
        )
    return np.concatenate(tau), stream


@pytest.mark.parametrize(("hold", "delay"), CASES)
def test_invert_gives_the_torques_of_python(library, plain, hold, delay):
    found = library.invert(**given(), hold=hold, delay=delay)
    size = np.abs(plain.tau_m).max()
    assert np.abs(found.tau_m - locally(plain.tau_m, hold, delay)).max() < ROUNDING * size
    assert np.abs(found.tau_m - expected(plain.t, plain.tau_m, hold, delay)).max() < SAME * size
    assert np.abs(found.tau_m - plain.tau_m).max() > 1e3 * SAME * size or (hold, delay) == (
        "linear",
        0.0,
    )
    assert (found.tau_m[-1] == plain.tau_m[-1]).all()
    for name in CHANNELS:
        assert np.array_equal(getattr(found, name), getattr(plain, name))


def test_a_spline_without_delay_changes_no_bit(library, plain):
    assert np.array_equal(library.invert(**given(), hold="spline", delay=0.0).tau_m, plain.tau_m)
    assert np.array_equal(stream_of(library, hold="spline", delay=0.0)[0], stream_of(library)[0])


@pytest.mark.slow
def test_bvp_gives_held_torques(plain):
    found, same = (
        loaded(MODEL, "bvp").bvp(**given(), **options).tau_m
        for options in ({"hold": "zoh", "delay": 0.5}, {})
    )
    size = np.abs(same).max()
    assert np.abs(found - expected(plain.t, same, "zoh", 0.5)).max() < SAME * size


@pytest.mark.parametrize("each", [1, 2, 5])
@pytest.mark.parametrize(("hold", "delay"), CASES[:6])
def test_a_stream_gives_the_torques_of_python(library, hold, delay, each):
    """Steps of 2e-4 from plan to plan are allowed; here they are smaller."""
    tau, _ = stream_of(library, 800 // each, each)
    held, _ = stream_of(library, 800 // each, each, hold=hold, delay=delay)
    size = np.abs(tau).max()
    late = 12
    wanted = expected(np.arange(len(tau)) * PERIOD, tau, hold, delay)
    assert np.abs(held - wanted)[:-late].max() < 1e-5 * size
    assert hold == "linear" or np.abs(held - tau)[:-late].max() > 1e-3 * size


def test_a_stream_with_limits_does_not_take_the_second_difference(library):
    """Infinite limits modify nothing; the held torques are the means, which keep any limit."""
    path = samples()
    options = {"period": 5 * PERIOD, "intervals": 40, "samples_per_interval": 5}
    streams = [
        library.stream(path["y"][0], path["q_start"], **options, **more)
        for more in ({}, {"hold": "zoh"})
    ]
    found: list[list[np.ndarray]] = [[], []]
    for stream, results in zip(streams, found, strict=True):
        stream.limit()
        for k in range(5, 500, 5):
            results.append(stream.update(path["y"][k], path["dy"][k], path["ddy"][k]).tau_m)
    tau, held = (np.concatenate(results) for results in found)
    size = np.abs(tau).max()
    t = np.arange(len(tau)) * PERIOD
    means = expected(t, tau, "zoh", 0.0, limited=True)
    assert np.abs(held - means)[:-12].max() < 1e-5 * size
    # steps from plan to plan are as large as the second difference, but rare
    other = expected(t, tau, "zoh", 0.0)
    near, far = (np.sqrt(np.mean((held - x)[:-12] ** 2)) for x in (means, other))
    assert near < 0.2 * far


@pytest.mark.parametrize(("hold", "largest"), [("zoh", 1e-8), ("linear", 1e-8)])
def test_the_tool_follows_under_the_torques_of_c(library, plain, hold, largest):
    """At 1 kHz: below 10 nm with the torques of ``invert``, 785 um with samples that are held."""
    solution = flexgen.solve(MODEL, verify=False)
    found = library.invert(**given(), hold=hold)
    names = solution.trajectory.labels["tau_m"]
    channels = {name: getattr(plain, name) for name in ("q_a", "q_m", "tau_m")}
    channels["y_ref"] = samples()["y"][
        np.clip(np.arange(len(plain.t)) - 100, 0, len(samples()["y"]) - 1)
    ]
    trajectory = flexgen.Trajectory(
        plain.t,
        channels,
        {name: solution.trajectory.ports[name] for name in channels},
        {name: solution.trajectory.labels[name] for name in channels},
        {"model": MODEL},
        {name: solution.trajectory.units[name] for name in channels},
    )
    errors = []
    for tau in (found.tau_m, plain.tau_m):
        command = TorqueCommand(plain.t, tau, names, hold, PERIOD, 0.0, {})
        errors.append(simulate(MODEL, trajectory, command=command).tool_error_max_m)
    assert errors[0] < largest and errors[1] > 100 * errors[0]
    assert hold == "linear" or errors[1] == pytest.approx(785e-6, rel=0.01)
    later = plain.t + 1e6  # a robot does not know the time
    command = TorqueCommand(later, plain.tau_m, names, hold, PERIOD, 0.0, {})
    found = simulate(MODEL, replace(trajectory, time=later), command=command)
    assert found.tool_error_max_m == pytest.approx(errors[1], rel=1e-3)
    assert found.trajectory.time[0] == pytest.approx(later[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hold": "foh"}, "hold: given 'foh', expected one of spline, linear, zoh"),
        ({"hold": "zoh", "delay": -0.1}, "delay: given -0.1 samples, expected 0 to 4"),
        ({"hold": "zoh", "delay": 4.5}, "for a longer delay give the path earlier"),
        ({"hold": "zoh", "delay": float("nan")}, "delay: given nan samples"),
        ({"hold": "zoh", "delay": "1"}, "delay: given '1', expected a number"),
    ],
)
def test_invalid_holds_and_delays_are_refused(library, changes, words):
    with pytest.raises(ArgumentError, match=words):
        library.invert(**given(), **changes)
    with pytest.raises(ArgumentError, match=words):
        stream_of(library, 1, **changes)


INVALID = pytest.mark.parametrize(
    ("hold", "delay"),
    [
        (-1, 0.0),
        (3, 0.0),
        (7, 0.0),
        (2**31 - 1, 0.0),
        (2, -1e-9),
        (2, 4.001),
        (1, 1e300),
        (0, float("nan")),
        (2, float("nan")),
        (2, float("inf")),
        (0, -float("inf")),
    ],
)


@INVALID
def test_a_stream_in_c_refuses_invalid_holds_and_delays(library, hold, delay):
    """A status, and nothing is written."""
    entries = library.streams
    options = {"intervals": 20, "samples_per_interval": 5, "period": 5e-3, "tolerance": 1e-6}
    accepted = struct_of(entries.structs["stream_options"], **options, hold=2, delay=4.0)
    refused = struct_of(entries.structs["stream_options"], **options, hold=hold, delay=delay)
    size = entries.work(ctypes.byref(accepted))
    assert entries.work(ctypes.byref(refused)) == -1 < size
    path = samples()
    memory = np.full(size, -7.25)
    stream = struct_of(entries.structs["stream"], memory=memory, size=size)
    start = [ctypes.byref(stream), ctypes.byref(refused)]
    assert (
        entries.start(*start, pointer(path["y"][0].copy()), pointer(path["q_start"]))
        == BAD_ARGUMENT
    )
    assert (memory == -7.25).all()


@INVALID
@pytest.mark.parametrize("name", ["invert", pytest.param("bvp", marks=pytest.mark.slow)])
def test_a_solver_in_c_refuses_invalid_holds_and_delays(name, hold, delay):
    library = loaded(MODEL, *["bvp"] * (name == "bvp"))
    entries = library.streams
    sizes = library.sizes
    path = samples()
    tau = np.full((len(path["y"]), sizes["n_m"]), -7.25)
    arrays = {key: np.ascontiguousarray(path[key]) for key in ("y", "dy", "ddy", "q_start")}
    given_path = {key: arrays[key].ctypes.data for key in ("y", "dy", "ddy")}
    whole = {
        "n_pre": 0,
        "n_post": 0,
        "samples_per_interval": 5,
        "tolerance": 1e-6,
        "hold": hold,
        "delay": delay,
    }
    inversion_options = struct_of(entries.structs["inversion_options"], **whole)
    inverter = getattr(library, name)
    room = np.zeros(inverter._work(ctypes.c_int(len(tau)), ctypes.byref(inversion_options)))
    status = inverter._entry(
        ctypes.byref(
            struct_of(entries.structs["samples"], n=len(tau), period=PERIOD, **given_path)
        ),
        pointer(arrays["q_start"]),
        ctypes.byref(inversion_options),
        ctypes.byref(struct_of(entries.structs["motion"], tau_m=tau)),
        ctypes.byref(entries.structs[f"{name}_info"]()),
        pointer(room),
        ctypes.c_int64(len(room)),
    )
    assert status == BAD_ARGUMENT and (tau == -7.25).all()


@pytest.mark.parametrize("hold", ["spline", "linear", "zoh"])
@pytest.mark.parametrize("intervals", [1, 3, 5, 8, 16])
def test_a_delay_beyond_the_horizon_is_reported(library, intervals, hold):
    """One sample per interval, and a delay of four: with 15 samples ahead the torques depend on
    known samples only.
    """
    path = samples()
    stream = library.stream(
        path["y"][0], path["q_start"], period=PERIOD, intervals=intervals, hold=hold, delay=4.0
    )
    zero = 0 * path["dy"][0]
    rest = [stream.update(path["y"][0], zero, zero) for _ in range(20)]
    assert all(interval.converged for interval in rest)
    assert np.ptp([interval.tau_m for interval in rest], axis=0).max() < 1e-9
    moving = [
        stream.update(*(path[key][k] for key in ("y", "dy", "ddy")))
        for k in range(1, len(path["y"]) - 1)
    ]
    assert {interval.converged for interval in moving[50:-50]} == {intervals > 15}
    assert np.isfinite([interval.tau_m for interval in moving]).all()
