"""Run-time parameters in invert, bvp and stream: the results of a library in which the same values
are constants.
"""

from __future__ import annotations

import copy
import pickle
from pathlib import Path as FilePath

import numpy as np
import pytest
from inversion_cases import MODEL, PERIOD, given, samples
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples as path_samples
from flexgen.paths.path import Path
from flexgen.runtime.library import Library

pytestmark = needs_compiler

CHANGES = {
    "payload": {"mass": 6.0, "com": [0.05, -0.02, 0.0]},
    "element.arm1.dof.q1.gear.spring.stiffness": 3.2e5,
    "element.arm2.dof.q2.gear.damping": 350.0,
    "element.arm3.dof.q3.damping": 120.0,
}
KEPT = 1e-10  # of the largest torque: rounding, times what the horizon makes of it
# of the largest value: the operations are in another order, and Newton's method stops at 1e-6
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> FilePath:
    return tmp_path_factory.mktemp("parameters")


@pytest.fixture(scope="module")
def flexible(folder: FilePath) -> Library:
    flexgen.generate(
        MODEL,
        directory=folder / "flexible",
        parameters=["payload", "stiffness", "damping"],
        parts=["bvp"],
    )
    return flexgen.load(folder / "flexible")


@pytest.fixture(scope="module")
def baked(folder: FilePath) -> Library:
    flexgen.generate(
        flexgen.read(MODEL, overrides=CHANGES), directory=folder / "baked", parts=["bvp"]
    )
    return flexgen.load(folder / "baked")


@pytest.fixture(scope="module")
def values(flexible: Library) -> np.ndarray:
    model = flexgen.read(MODEL, overrides=CHANGES)
    derived = flexgen.derive(model, parameters=["payload", "stiffness", "damping"])
    found = {p.name: p.value for p in derived.parameters}
    return np.array([found[name] for name in flexible.parameter_names])


def stream_torques(library: Library, renewed: bool = False, **options) -> np.ndarray:
    """Torques of a move; ``renewed``: the same parameters are set before each update, so that it
    keeps no factor.
    """
    path = samples()
    each = 5
    stream = library.stream(
        path["y"][0],
        path["q_start"],
        period=each * PERIOD,
        intervals=20,
        samples_per_interval=each,
        **options,
    )
    last = len(path["y"]) - 1
    found = []
    for k in range(each, last + 20 * each, each):
        at = min(k, last)
        moves = float(k <= last)
        if renewed:
            stream.set_parameters(library.parameters)
        found.append(
            stream.update(path["y"][at], moves * path["dy"][at], moves * path["ddy"][at]).tau_m
        )
    return np.concatenate(found)


@pytest.mark.full
def test_six_axes(tmp_path):
    """The payload of manutec_r3_24 as a run-time parameter and as a constant."""
    model = flexgen.read("manutec_r3_24", overrides={"payload.mass": 12.0})
    flexgen.generate("manutec_r3_24", directory=tmp_path / "flexible", parameters=["payload"])
    flexgen.generate(model, directory=tmp_path / "baked")
    flexible, baked = (flexgen.load(tmp_path / name) for name in ("flexible", "baked"))
    values = np.array(flexible.parameters)
    values[flexible.parameter_names.index("payload.mass")] = 12.0
    equations = flexgen.derive("manutec_r3_24")
    path = Path(equations, equations.model.move())
    y = path_samples(Reduction(equations), path, PERIOD, 1001)
    more = {
        "period": PERIOD,
        "q_start": path.q_start,
        "n_pre": 150,
        "n_post": 300,
        "samples_per_interval": 10,
    }
    want = baked.invert(*y, **more)
    other = flexible.invert(*y, **more)
    found = flexible.invert(*y, **more, parameters=values)
    size = np.abs(want.tau_m).max()
    assert (
        np.abs(found.tau_m - want.tau_m).max()
        < 1e-8 * size
        < 1e-3 * size
        < np.abs(other.tau_m - want.tau_m).max()
    )


@pytest.mark.parametrize("solver", ["invert", "bvp"])
def test_whole_paths(flexible, baked, values, solver):
    expected = getattr(baked, solver)(**given())
    found = getattr(flexible, solver)(**given(), parameters=values)
    for name in ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m"):
        want = getattr(expected, name)
        assert np.abs(getattr(found, name) - want).max() < ROUNDING * np.abs(want).max(), name
    other = getattr(flexible, solver)(**given())
    assert np.abs(other.tau_m - expected.tau_m).max() > 1e-2 * np.abs(expected.tau_m).max()


def test_without_values_the_model_file_holds(flexible):
    again = flexible.invert(**given(), parameters=flexible.parameters)
    assert np.array_equal(flexible.invert(**given()).tau_m, again.tau_m)


def test_streams(flexible, baked, values):
    expected = stream_torques(baked)
    found = stream_torques(flexible, parameters=values)
    assert np.abs(found - expected).max() < ROUNDING * np.abs(expected).max()
    assert np.abs(stream_torques(flexible) - expected).max() > 1e-2 * np.abs(expected).max()


def test_factors_that_a_stream_keeps_do_not_change_its_torques(flexible):
    """Updates that keep most factors of the update before, and updates that compute all of them
    again.
    """
    kept = stream_torques(flexible)
    renewed = stream_torques(flexible, renewed=True)
    assert not np.array_equal(kept, renewed)
    assert np.abs(kept - renewed).max() < KEPT * np.abs(renewed).max()


def test_parameters_of_a_stream_change_at_rest(flexible, baked, values):
    """After a payload is gripped the stream has the torques of a stream that started with it."""
    path = samples()
    each = 5

    def stream_at_rest(library: Library, **options):
        return library.stream(
            path["y"][0],
            path["q_start"],
            period=each * PERIOD,
            intervals=20,
            samples_per_interval=each,
            **options,
        )

    def updates(stream, count: int) -> np.ndarray:
        zero = np.zeros_like(path["dy"][0])
        return np.concatenate(
            [stream.update(path["y"][0], zero, zero).tau_m for _ in range(count)]
        )

    stream = stream_at_rest(flexible)
    with_payload = stream_at_rest(flexible, parameters=values)
    before = updates(stream, 5)
    for twin in (copy.copy(stream), pickle.loads(pickle.dumps(stream))):
        twin.set_parameters(values)
        # at once
        after = updates(twin, 2)
        held = updates(with_payload, 1)[-1]
        assert (
            np.abs(after - held).max()
            < ROUNDING * np.abs(held).max()
            < np.abs(held - before[-1]).max()
        )
    assert np.abs(updates(stream, 1)[-1] - before[-1]).max() < 1e-9


def test_the_move_after_a_changed_payload_is_that_of_a_new_stream(flexible, values):
    """A stream that rests is in the new equilibrium; one with a motion ahead is not, and its
    updates state it.
    """
    path = samples()
    each = 5
    options = {"period": each * PERIOD, "intervals": 20, "samples_per_interval": each}
    resting, moving, new = (
        flexible.stream(path["y"][0], path["q_start"], **options, **given)
        for given in ({}, {}, {"parameters": values})
    )
    resting.set_parameters(values)
    last = len(path["y"]) - 1
    worst = 0.0
    largest = 0.0
    stated = []
    for k in range(each, last + 20 * each, each):
        at = min(k, last)
        moves = float(k <= last)
        sample = path["y"][at], moves * path["dy"][at], moves * path["ddy"][at]
        own = resting.update(*sample)
        wanted = new.update(*sample)
        assert own.converged
        worst = max(worst, np.abs(own.tau_m - wanted.tau_m).max())
        largest = max(largest, np.abs(wanted.tau_m).max())
        if k == 20 * each:  # the motion begins in the horizon
            moving.set_parameters(values)
        stated.append(moving.update(*sample).converged)
    assert worst < ROUNDING * largest and not all(stated)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("payload.mass", -5.0, "given -5 kg as payload.mass, expected a number >= 0"),
        ("q1.stiffness", 0.0, "number > 0"),
    ],
)
def test_numbers_that_no_model_file_may_have_are_refused(flexible, values, name, value, words):
    path = samples()
    bad = np.array(values)
    bad[flexible.parameter_names.index(name)] = value
    one = {key: x for key, x in given().items() if key in ("y", "dy", "ddy", "period", "q_start")}
    stream = flexible.stream(path["y"][0], path["q_start"], period=5e-3, intervals=20)
    for call in (
        lambda: stream.set_parameters(bad),
        lambda: flexible.stream(
            path["y"][0], path["q_start"], period=5e-3, intervals=20, parameters=bad
        ),
        lambda: flexible.invert(**given(), parameters=bad),
        lambda: flexible.invert_many(**one, parameters=np.stack([values, bad])),
    ):
        with pytest.raises(ArgumentError, match=words):
            call()
    stream.set_parameters(values)


def test_invalid_sets_of_parameters_are_refused(flexible, baked, values):
    for bad, words in (
        (values[:-1], "parameters: given shape"),
        (["a"] * len(values), "parameters: given"),
    ):
        with pytest.raises(ArgumentError, match=words):
            flexible.invert(**given(), parameters=bad)
    with pytest.raises(ArgumentError, match="not finite"):
        flexible.invert(**given(), parameters=values * np.nan)
    with pytest.raises(ArgumentError, match="given to a library without run-time parameters"):
        baked.invert(**given(), parameters=values)
    path = samples()
    with pytest.raises(ArgumentError, match="not finite"):
        flexible.stream(
            path["y"][0], path["q_start"], period=5e-3, intervals=20, parameters=values + np.inf
        )


def test_a_stream_of_a_closed_library_is_closed(folder, flexible):
    library = flexgen.load(folder / "flexible")
    path = samples()
    stream = library.stream(path["y"][0], path["q_start"], period=5e-3, intervals=20)
    library.close()
    zero = np.zeros_like(path["dy"][0])
    for call in (
        lambda: stream.update(path["y"][0], zero, zero),
        stream.limit,
        lambda: stream.set_parameters(library.parameters),
    ):
        with pytest.raises(ArgumentError, match="library that was closed"):
            call()


def test_generate_names_missing_functions(tmp_path, capfd):
    model = ["generate", "planar5_nmp", "--no-build"]
    assert main([*model, "--single", "--with", "bvp", "--out", str(tmp_path / "single")]) != 0
    assert "given 'bvp', but it is in double precision only" in " ".join(
        capfd.readouterr().err.split()
    )
    assert main([*model, "--functions", "gravity", "--out", str(tmp_path / "few")]) == 0
    assert "invert and stream, because they need the functions" in " ".join(
        capfd.readouterr().out.split()
    )
