"""Streams: inverse dynamics on a moving horizon, judged by simulating the full model forward; the
example in C.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from emitted import ROOT, made, run, sources
from inversion_cases import last_joint
from stream_machine import AFTER, AHEAD, PARTS, UPDATE, Machine, error
from toolchain import CC, STRICT, needs_compiler, tool

from flexgen.analysis.zero_dynamics.zeros_along_path import zero_path
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.model.elements import SmoothSpring
from flexgen.model.reader import read

pytestmark = needs_compiler

PLANAR = "planar5_nmp"
SIX_AXES = "manutec_r3_18"
# m and rad: 1e-10 and 1e-9 were measured; a user is promised 1 and 5 um
PLANAR_ERROR = 1e-8
SIX_AXES_ERROR = 1e-7
# What one sample per update leaves of the torque's second derivative: measured 0.12 um, with two
# samples 5 nm.
ONE_PART_ERROR = 1e-6
# Torque of the stream and of the whole path, relative to the largest: their motions agree to 1e-12
# rad, their derivatives, by differences, to 6e-6.
AGREES = 2e-5
# the same for gears that stiffen, whose deflection is integrated: measured 7e-6
STIFF_AGREES = 1e-4
MOST = 22.0  # N m: a bound that the path would pass by a tenth
SOFT = (1 / 300, 1 / 17)  # factors of stiffness and damping of the passive joint
MICROMETER = 1e-6
STILL = 1e-9  # N m and rad/s: what changes at rest is rounding


@cache
def machine(name: str = PLANAR, move: str | None = None) -> Machine:
    return Machine(name, move)


# --- judged by the full model --------------------------------------------------------------------
@pytest.mark.parametrize(
    ("samples_per_interval", "allowed"),
    [(1, ONE_PART_ERROR), (5, PLANAR_ERROR), (10, PLANAR_ERROR)],
)
def test_the_tool_of_a_planar_arm_follows(samples_per_interval, allowed):
    assert (
        error(machine().simulation(*machine().followed(samples_per_interval=samples_per_interval)))
        < allowed
    )


@pytest.mark.parametrize(
    ("name", "samples_per_interval", "hold", "delay", "allowed", "samples_held"),
    [
        (PLANAR, 5, "zoh", 0.0, PLANAR_ERROR, 785e-6),
        (PLANAR, 5, "zoh", 1.4, PLANAR_ERROR, 785e-6 * 2 * 1.9),
        (PLANAR, 10, "zoh", 0.0, PLANAR_ERROR, 785e-6 / 2),
        (PLANAR, 5, "linear", 2.7, PLANAR_ERROR, 785e-6 * 2 * 2.7),
        (PLANAR, 5, "spline", 0.6, PLANAR_ERROR, 785e-6 * 2 * 0.6),
        ("manutec_r3_24", 10, "zoh", 0.0, 0.05 * MICROMETER, 239e-6),
    ],
)
def test_the_tool_follows_where_the_drive_holds_the_torques_of_a_stream(
    name, samples_per_interval, hold, delay, allowed, samples_held
):
    """Samples that are held are late by the delay and by half a sample."""
    one = machine(name, "line" if name != PLANAR else None)
    t, results = one.followed(samples_per_interval=samples_per_interval, hold=hold, delay=delay)
    assert error(one.simulation(t, results, hold, delay)) < allowed
    _, late = one.followed(samples_per_interval=samples_per_interval)
    assert error(one.simulation(t, late, hold, delay)) == pytest.approx(samples_held, rel=0.05)


def test_torques_that_come_late_are_seen():
    t, results = machine().followed()
    results["tau_m"] = np.vstack([results["tau_m"][:PARTS], results["tau_m"][:-PARTS]])
    assert error(machine().simulation(t, results)) > 1e5 * PLANAR_ERROR


@pytest.mark.slow
@pytest.mark.parametrize("move", ["line", "turning_line"])
def test_the_tool_of_six_axes_with_six_elasticities_follows(move):
    assert (
        error(machine(SIX_AXES, move).simulation(*machine(SIX_AXES, move).followed()))
        < SIX_AXES_ERROR
    )


@cache
def soft_machine() -> tuple[Machine, float]:
    """An arm with a slow unstable zero, and the preview [s] that its analysis requires."""
    model = last_joint(read(PLANAR), *SOFT)
    found = Machine(model, None)
    return found, zero_path(found.equations, found.path).preview_s


@pytest.mark.slow
def test_the_preview_of_the_analysis_is_enough_for_a_stream():
    soft, preview = soft_machine()
    assert 0.15 < preview < 0.5  # the unstable zero is near 50 1/s
    enough = error(soft.simulation(*soft.followed(ahead=int(np.ceil(preview / UPDATE)))))
    short = error(
        soft.simulation(*soft.followed(ahead=int(np.ceil(0.36 * preview / UPDATE)), checked=False))
    )
    assert enough < MICROMETER < short  # five time constants were called enough


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.2, 0.36, 0.5])
def test_a_short_horizon_is_reported_with_its_error(share: float) -> None:
    soft, preview = soft_machine()
    ahead = int(np.ceil(share * preview / UPDATE))
    intervals = soft.updates(ahead)
    estimate = sum(interval.output_step_m for interval in intervals)
    found = error(soft.simulation(*soft.followed(ahead, checked=False)))
    assert found / 2 < estimate < 2 * found
    causes = {interval.cause for interval in intervals}
    assert "horizon" in causes <= {"", "horizon", "residual"} and all(
        (interval.cause == "") == interval.converged for interval in intervals
    )


@pytest.mark.slow
def test_steps_of_a_sufficient_horizon_do_not_estimate_the_error() -> None:
    """Errors of mesh and samples are not in the steps of the output, as the documentation says."""
    soft, preview = soft_machine()
    ahead = int(np.ceil(1.3 * preview / UPDATE))
    steps = sum(interval.output_step_m for interval in soft.updates(ahead))
    assert error(soft.simulation(*soft.followed(ahead))) > 10 * steps


@pytest.mark.slow
@pytest.mark.parametrize("ahead", [20, 30])
def test_near_rest_no_warning_is_reported(ahead: int) -> None:
    """A polynomial of degree 9: its fifth derivative jumps at both ends."""
    model = read("manutec_r3_24")
    slow = Machine(replace(model, moves=(replace(model.move("line"), smoothness=4),)), "line")
    assert {interval.cause for interval in slow.updates(ahead)} == {""}


# --- against the whole path ----------------------------------------------------------------------
@cache
def whole_path() -> tuple[np.ndarray, np.ndarray]:
    """Instants and torques of the planar arm's whole path, the motion before and behind it
    included.
    """
    planar = machine()
    fine = UPDATE / PARTS
    found = planar.library.invert(
        *samples(
            Reduction(planar.equations), planar.path, fine, round(planar.path.duration / fine) + 1
        ),
        period=fine,
        q_start=planar.path.q_start,
        n_pre=AHEAD * PARTS,
        n_post=round(2 * AFTER / fine),
        samples_per_interval=PARTS,
    )
    return found.t, found.tau_m


def away_from_the_whole_path(ahead: int) -> float:
    """Largest difference of the torque to that of the whole path, relative to the largest
    torque.
    """
    t, results = machine().followed(ahead)
    instants, torque = whole_path()
    both = (t > instants[0]) & (t < instants[-1] - AFTER)  # the end of the whole motion is free
    at = np.round((t[both] - instants[0]) / (UPDATE / PARTS)).astype(int)
    assert np.count_nonzero(both) > 500 and np.abs(instants[at] - t[both]).max() < 1e-9
    return float(np.abs(results["tau_m"][both] - torque[at]).max() / np.abs(torque).max())


def test_a_long_look_ahead_gives_what_the_whole_path_gives():
    assert away_from_the_whole_path(100) < AGREES and away_from_the_whole_path(10) < AGREES


def test_a_short_look_ahead_does_not():
    """One interval, some four time constants of the unstable zero; and that there are too few
    samples is told.
    """
    stream = machine().begun(1)
    (outputs, rates, rates2) = machine().samples(UPDATE * np.arange(1, 51))
    given = [stream.update(*sample) for sample in zip(outputs, rates, rates2, strict=True)]
    assert not any(interval.converged for interval in given[10:])
    assert away_from_the_whole_path(1) > 10 * AGREES


@pytest.mark.parametrize("samples_per_interval", [1, 10])
def test_the_motion_does_not_depend_on_the_samples_asked_for(samples_per_interval):
    _, few = machine().followed(samples_per_interval=samples_per_interval)
    _, some = machine().followed(samples_per_interval=PARTS)
    for name in ("q_a", "v_a", "tau_g"):
        assert (
            np.abs(few[name][::samples_per_interval] - some[name][::PARTS]).max()
            < 1e-9 * np.abs(some[name]).max()
        )
    # motors follow by differences of samples
    assert (
        np.abs(few["tau_m"][::samples_per_interval] - some["tau_m"][::PARTS]).max()
        < 1e-3 * np.abs(some["tau_m"]).max()
    )


# --- gears ---------------------------------------------------------------------------------------
@cache
def stiffening() -> Machine:
    """The elbow with gears that stiffen; in some poses they are so stiff that they all but follow
    at once.
    """
    model = read("elbow")
    spring = SmoothSpring(1e6, 8e6, 1.6e-3)
    elements = tuple(
        replace(
            e,
            dofs=(replace(e.dofs[0], gear=replace(e.dofs[0].gear, spring=spring, damping=20.0)),),
        )
        for e in model.elements
    )
    return Machine(replace(model, name="stiffening", elements=elements), "joints")


# deciding anew at each update was 8e4 and 8e-3 off
@pytest.mark.parametrize("samples_per_interval", [2, 5])
@pytest.mark.slow
def test_gears_that_stiffen_are_the_same_in_a_stream(samples_per_interval):
    one = stiffening()
    fine = UPDATE / samples_per_interval
    t, results = one.followed(samples_per_interval=samples_per_interval)
    n = round(one.path.duration / fine) + 1
    whole = one.library.invert(
        *samples(Reduction(one.equations), one.path, fine, n),
        period=fine,
        q_start=one.path.q_start,
        n_post=round(AFTER / fine),
    )
    both = (t > whole.t[0]) & (t < whole.t[-1])
    at = np.round((t[both] - whole.t[0]) / fine).astype(int)
    off = np.abs(results["tau_m"][both] - whole.tau_m[at]).max() / np.abs(whole.tau_m).max()
    assert np.count_nonzero(both) > 400 and off < STIFF_AGREES


# --- limits --------------------------------------------------------------------------------------
def test_active_limits_are_reported_with_an_unmet_tolerance():
    """With a tolerance that no step reaches every interval is inexact, and those that pass a bound
    are limited, too.
    """
    one = machine()
    all_samples = list(zip(*one.samples(UPDATE * np.arange(1, 121)), strict=True))
    y = one.samples(np.zeros(1))[0][0]
    told = []
    for tolerance in (1e-3, 1e-300):
        stream = one.library.stream(
            y,
            one.path.q_start,
            period=UPDATE,
            intervals=AHEAD,
            samples_per_interval=PARTS,
            tolerance=tolerance,
        )
        stream.limit(torque=np.full(2, MOST))
        told.append([stream.update(*sample) for sample in all_samples])
    for some, others in zip(*told, strict=True):
        assert some.limits_active == others.limits_active and some.converged >= others.converged
        assert some.limits_active or np.abs(some.tau_m).max() <= MOST
    assert any(x.limits_active and not x.converged for x in told[1]) and not all(
        x.limits_active for x in told[1]
    )


# --- rest, refusals, end -------------------------------------------------------------------------
def test_a_stream_starts_at_rest_and_holds_at_the_end():
    stream = machine().begun()
    y = machine().samples(np.array([machine().path.duration]))[0][0]
    still = np.zeros(2)
    begin = machine().samples(np.zeros(1))[0][0]
    first = [stream.update(begin, still, still) for _ in range(5)]
    n = round(machine().path.duration / UPDATE)
    for sample in zip(*machine().samples(UPDATE * np.arange(1, n + 1)), strict=True):
        stream.update(*sample)
    for _ in range(2 * AHEAD):
        stream.update(y, still, still)
    for held in (first, [stream.update(y, still, still) for _ in range(20)]):
        torque = np.vstack([x.tau_m for x in held])
        assert np.ptp(torque, axis=0).max() < STILL
        assert (
            max(np.abs(x.v_a).max() for x in held) < STILL
            and max(np.abs(x.v_m).max() for x in held) < STILL
        )
        # and it is the torque that statics ask for
        tau_g, row = machine().library.inversion_rows(held[-1].q_a[-1], np.zeros(3), np.zeros(3))
        ratio = np.linalg.inv(machine().equations.model.eta)
        assert np.abs(ratio.T @ tau_g - torque[-1]).max() < STILL and np.abs(row).max() < STILL


def test_a_refused_sample_does_not_change_later_torques():
    refused = machine().begun()
    spared = machine().begun()
    all_samples = list(zip(*machine().samples(UPDATE * np.arange(1, 61)), strict=True))
    wrong = [
        (np.full(2, np.nan), np.zeros(2), np.zeros(2), ArgumentError),
        (all_samples[0][0], np.array([0.0, np.inf]), np.zeros(2), ArgumentError),
        (all_samples[0][0], np.zeros(2), np.full(2, -np.inf), ArgumentError),
        (np.array([1e3, 0.0]), np.zeros(2), np.zeros(2), SolverError),
        (np.zeros(3), np.zeros(2), np.zeros(2), ArgumentError),
    ]
    for k, sample in enumerate(all_samples):
        *values, kind = wrong[k % len(wrong)]
        with pytest.raises(kind):
            refused.update(*values)
        one = refused.update(*sample)
        other = spared.update(*sample)
        for name in ("q_a", "v_a", "tau_g", "q_m", "v_m", "tau_m", "residual"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), (k, name)


@pytest.mark.parametrize("samples_per_interval", [1, PARTS, 2 * PARTS])
@pytest.mark.parametrize("name", [PLANAR, "elbow"])
def test_a_jump_of_the_path_is_reported_as_not_converged(name, samples_per_interval):
    """No torque follows it. What comes of it fades, and the stream is exact again at the new y."""
    stream = machine(name).begun(samples_per_interval=samples_per_interval)
    still = np.zeros(2)
    y = machine(name).samples(np.zeros(1))[0][0]
    stream.update(y, still, still)
    y = y - np.array([1e-3, 0.0])
    given = [stream.update(y, still, still) for _ in range(4 * AHEAD)]
    verdicts = [interval.converged for interval in given]
    assert not all(verdicts) and all(verdicts[-AHEAD:])
    held = np.abs(given[-1].tau_m[-1])
    assert all(
        interval.converged is False
        for interval in given
        if (np.abs(interval.tau_m - held) > 10 * held).any()
    )


# --- the example in C ----------------------------------------------------------------------------
@pytest.mark.slow
def test_the_stream_of_the_example_drives_a_robot(tmp_path):
    folder = made(PLANAR).directory
    files = [ROOT / "examples" / "stream.c", *sources(folder)]
    run(CC, *STRICT, "-O0", f"-I{folder}", *files, "-lm", "-o", "stream", folder=tmp_path)
    runs: dict[str, list[str]] = {}
    for line in run(tmp_path / "stream", folder=tmp_path).splitlines():
        if not line.startswith(" "):
            runs[line] = told = []
        else:
            told.append(line)
    assert list(runs) == ["stream", "late", "refused", "jump"]
    strays = {name: float(told[-1].split(" um")[0].split()[-1]) for name, told in runs.items()}
    # A torque held for a millisecond leaves 1.6 um, a quarter of the cycle a sixteenth of it.
    assert 0.1 < strays["stream"] < 2.0 and strays["refused"] == strays["stream"]
    assert strays["late"] > 100.0 * strays["stream"]
    assert (
        len(runs["stream"]) == 1
        and "t = 0.250 s refused: the path leaves the workspace" in runs["refused"][0]
    )
    # what was sent at 0.25 s and after it is known before the tool gets there: it is stopped while
    # still on its path
    assert runs["jump"][0].endswith("stopping") and strays["jump"] < 2.0
    assert float(runs["jump"][-1].split()[-2]) < 1e-2


@pytest.mark.slow
def test_the_example_sees_memory_that_is_too_small(tmp_path):
    folder = made(PLANAR).directory
    text = (ROOT / "examples" / "stream.c").read_text(encoding="ascii")
    few = text.replace("MEMORY = (int)PLANAR5_NMP_STREAM_SIZE(INTERVALS, PARTS)", "MEMORY = 512")
    assert few != text
    (tmp_path / "few.c").write_text(few, encoding="ascii")
    run(
        tool("cc"),
        "-std=c99",
        "-O0",
        f"-I{folder}",
        "few.c",
        *sources(folder),
        "-lm",
        "-o",
        "few",
        folder=tmp_path,
    )
    run(tmp_path / "few", folder=tmp_path, expected=1)
