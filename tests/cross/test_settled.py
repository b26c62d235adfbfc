"""A motion that ends where it has settled: until then it is the same, what is left out moves the
output no more.

How much a motion that is left out moves the output is computed here with the mass matrix and the
constraint of the definition, at every sample; the C does it with inverse dynamics, at the nodes of
its mesh.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from claimed_error import claimed_error, false_claims
from inversion_cases import last_joint
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.emission import clib_files
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.statics import Equilibrium, equilibrium_at
from flexgen.inversion.judge import settling
from flexgen.inversion.judge.settling import SHORTEST, fade_to_equilibrium
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.problem import HELD, LAGS
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.model.elements import Output
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import Inversion
from flexgen.runtime.library import Library, load

pytestmark = needs_compiler

# s, samples; samples of an interval
PERIOD = 1e-3
N = 401
PRE = 20
AFTER = 6000
EACH = 5
# of stiffness and damping of a joint: zeros that decay in 0.35 s
SLOW = {"tool": (0.1, 0.02), "joints": (0.1, 0.3)}
ALLOWED = 1e-7  # m or rad
SOLVERS = ("invert", "invert_limited")  # one library for all tests


def test_the_c_has_the_times_of_solve() -> None:
    """Constants in C are those of `solve`: hold time of the last torque, shortest motion after the
    path [s], and lags of the gears.
    """
    files = clib_files.read_clib()
    assert (
        f"held_time = {HELD:g};" in files["invert.c"]
        and f"shortest_end = {SHORTEST:g};" in files["whole_path.h"]
    )
    assert f"lags = {LAGS:.1f};" in files["motors.h"]


def test_a_motion_that_fades_obeys_its_derivatives() -> None:
    """Cubics before; after it products of polynomials, and torques with the inertia of the rotors
    in them.
    """
    model = read("elbow")
    # the fade takes the last n samples
    period = 0.01
    count = 60
    n = 20
    u = period * (np.arange(count) - (count - n))[:, None]  # time of the fade [s]
    fade = np.polynomial.Polynomial([1, 0, 0, 0, -35, 84, -70, 20], [0, 1], [0, 1])
    w = fade(np.polynomial.Polynomial([0, 1 / (period * (n - 1))]))
    motion = [np.polynomial.Polynomial([0.3, -0.2, 0.5, k]) for k in (1, -2)]
    last = np.array([0.1, -0.4])
    curves = [np.hstack([p.deriv(k)(u) if k else p(u) for p in motion]) for k in range(3)]
    inertia = np.array([motor.inertia for motor in model.motors])
    gears = np.hstack([np.sin(u), np.cos(u)])
    held = np.array([2.0, -3.0])
    tau = inertia * curves[2] + gears
    before = Inversion(
        *curves, gears, *curves[:2], tau, 0, 2 * n, period, 0, 0, 0, 0, 0, 0, 0, True
    )
    end = Equilibrium(last, last, held, held)
    after = fade_to_equilibrium(SimpleNamespace(equations=derive(model)), before, end)
    faded = [w * (p - x) + x for p, x in zip(motion, last, strict=True)]
    q, v, a = (np.hstack([p.deriv(k)(u) if k else p(u) for p in faded])[-n:] for k in range(3))
    share = w(u)[-n:]
    expected = {
        "q_a": q,
        "v_a": v,
        "a_a": a,
        "q_m": q,
        "v_m": v,
        "tau_g": held + share * (gears[-n:] - held),
    }
    expected["tau_m"] = inertia * a + expected["tau_g"]
    for name, values in expected.items():
        assert np.abs(getattr(after, name)[-n:] - values).max() < 1e-9 * np.abs(values).max()
        assert np.array_equal(getattr(after, name)[:-n], getattr(before, name)[:-n])
    assert np.array_equal(after.q_a[-1], last) and np.array_equal(after.tau_m[-1], held)


def arm(output: str) -> Equations:
    """The planar arm with a slow passive joint; its output is the tool, or the joints that have
    motors.
    """
    model = last_joint(read("planar5_mp"), *SLOW[output])
    if output == "joints":
        model = replace(
            model, output=Output("combination", "", ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "rad")
        )
    return derive(model)


def arguments(equations: Equations) -> dict[str, Any]:
    """Of a move between poses."""
    move = next(move for move in equations.model.moves if move.name == "joints")
    path = Path(equations, replace(move, duration=(N - 1) * PERIOD))
    y, dy, ddy = samples(Reduction(equations), path, PERIOD, N)
    given = {"y": y, "dy": dy, "ddy": ddy, "q_start": path.q_start, "period": PERIOD}
    return {**given, "n_pre": PRE, "n_post": AFTER, "samples_per_interval": EACH}


def left_over(equations: Equations, found: Inversion) -> np.ndarray:
    """Change of the output [m or rad] by the residual motion at the samples after the path."""
    model = equations.model
    q = found.q_a[-1]
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    W = evaluate(
        equations.function("output_constraint"), q, 0 * q, np.zeros(model.output.target_size)
    )[1]
    W = W.reshape(-1, model.n_a)
    M = evaluate(equations.function("mass_matrix"), q)[0].reshape(model.n_a, model.n_a)
    drift = W[:, i_g] @ np.linalg.solve(M[np.ix_(i_g, i_g)], M[np.ix_(i_g, i_e)]) - W[:, i_e]
    rest = equilibrium_at(equations, q).q_a
    after = slice(PRE + N, None)
    moved = [(found.q_a[after] - rest)[:, i_e], HELD * found.v_a[after][:, i_e]]
    return np.max(
        [np.linalg.norm(x @ X.T, axis=1) for x in moved for X in (W[:, i_e], drift)], axis=0
    )


def check_end(size: np.ndarray, n_post: int) -> None:
    """The motion ends with the interval in which half of what is allowed is left, the phase of a
    vibration aside.
    """
    assert size[n_post:].max() < ALLOWED, "it ends too early"
    assert size[n_post - 3 * EACH : n_post].max() > 0.4 * ALLOWED, "it ends too late"


@pytest.mark.parametrize("output", ["tool", pytest.param("joints", marks=pytest.mark.slow)])
def test_the_motion_ends_where_it_has_settled(output: str) -> None:
    equations = arm(output)
    given = arguments(equations)
    library = inversion_library(equations, "lq", SOLVERS)
    whole = library.invert(**given)
    found = library.invert(**given, settled=ALLOWED)
    rows = PRE + N + found.n_post
    assert whole.n_post == AFTER and found.n_post < AFTER / 2 and found.q_a.shape == (rows, 3)
    assert found.converged and found.intervals < 0.6 * whole.intervals
    for name in ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m"):
        one = getattr(whole, name)[: rows - 1]
        other = getattr(found, name)[:-1]
        assert np.abs(one - other).max() < 1e-8 * np.abs(one).max(), name
    size = left_over(equations, whole)
    check_end(size, found.n_post)
    with pytest.raises(AssertionError, match="too early"):
        check_end(size, found.n_post - 60 * EACH)
    with pytest.raises(AssertionError, match="too late"):
        check_end(size, found.n_post + 60 * EACH)


def test_the_last_sample_and_all_after_it_are_the_equilibrium() -> None:
    equations = arm("tool")
    found = inversion_library(equations, "lq", SOLVERS).invert(
        **arguments(equations), settled=ALLOWED
    )
    rest = equilibrium_at(equations, found.q_a[-1])
    for name in ("q_a", "tau_g", "q_m", "tau_m"):
        last = getattr(found, name)[-1]
        expected = getattr(rest, name)
        assert np.abs(last - expected).max() < 1e-10 * (1 + np.abs(expected).max()), name
    assert not found.v_a[-1].any() and not found.a_a[-1].any() and not found.v_m[-1].any()
    for name in ("q_a", "v_a", "a_a", "tau_g", "q_m", "v_m", "tau_m"):
        written = getattr(found, name).base  # what C was given
        assert len(written) == PRE + N + AFTER
        assert (written[PRE + N + found.n_post :] == getattr(found, name)[-1]).all(), name


def test_a_motion_that_does_not_settle_has_all_samples() -> None:
    equations = arm("tool")
    given = {**arguments(equations), "n_post": 300}
    library = inversion_library(equations, "lq", SOLVERS)
    whole = library.invert(**given)
    found = library.invert(**given, settled=ALLOWED)
    assert found.n_post == 300 and len(found.q_a) == PRE + N + 300
    assert (found.tau_m == whole.tau_m).all()


def test_the_torque_that_is_held_is_that_of_the_equilibrium() -> None:
    equations = arm("tool")
    given = arguments(equations)
    library = inversion_library(equations, "lq", SOLVERS)
    whole = library.invert(**given, hold="zoh", delay=1.5)
    found = library.invert(**given, hold="zoh", delay=1.5, settled=ALLOWED)
    kept = PRE + N + found.n_post - 8  # the torque of a held sample depends on later ones
    assert np.abs(whole.tau_m[:kept] - found.tau_m[:kept]).max() < 1e-8 * np.abs(whole.tau_m).max()


def test_limits_that_are_not_active_settle_too() -> None:
    equations = arm("tool")
    given = {**arguments(equations), "n_post": 4000}
    library = inversion_library(equations, "lq", SOLVERS)
    found = library.invert(**given, settled=ALLOWED)
    limited = library.invert_limited(**given, torque_max=1e4 * np.ones(2), settled=ALLOWED)
    assert limited.n_post == found.n_post < 4000 and not limited.limits_active
    assert (limited.tau_m == found.tau_m).all()


def planted(
    output: str,
    file: str,
    right: str,
    wrong: str,
    folder: FilePath,
    monkeypatch: pytest.MonkeyPatch,
) -> Library:
    """The library with an error in one of its files."""
    texts = dict(clib_files.read_clib())
    assert texts[file].count(right) == 1
    monkeypatch.setattr(
        clib_files, "read_clib", lambda: texts | {file: texts[file].replace(right, wrong)}
    )
    return load(flexgen.generate(arm(output).model, folder / "wrong").directory)


@pytest.mark.slow
def test_an_end_that_later_steps_show_to_be_early_is_corrected(tmp_path, monkeypatch) -> None:
    """The first step is made to end the motion where fifty times too much is left."""
    cut = "cut_mesh(m, o->samples_per_interval, end);"
    early = f"end->allowed *= 50.0;\n            {cut}\n            end->allowed /= 50.0;"
    equations = arm("tool")
    # before the error is there
    given = arguments(equations)
    right = inversion_library(equations, "lq", SOLVERS)
    wrong = planted("tool", "invert.c", cut, early, tmp_path, monkeypatch)
    found = wrong.invert(**given, settled=ALLOWED)
    expected = right.invert(**given, settled=ALLOWED)
    assert found.n_post == expected.n_post and found.intervals > expected.intervals
    assert np.abs(found.tau_m - expected.tau_m).max() < 1e-8 * np.abs(expected.tau_m).max()


@pytest.mark.slow
def test_the_momentum_of_joints_whose_torque_is_held_counts(tmp_path, monkeypatch) -> None:
    """A planted error: where the joints are the output, only their momentum after the motion moves
    it.
    """
    wrong = planted(
        "joints",
        "invert.c",
        "s->X[NY + i][j] += ",
        "s->X[NY + i][j] += 0.0 * ",
        tmp_path,
        monkeypatch,
    )
    equations = arm("joints")
    given = arguments(equations)
    size = left_over(equations, wrong.invert(**given))
    with pytest.raises(AssertionError, match="too early"):
        check_end(size, wrong.invert(**given, settled=ALLOWED).n_post)


@pytest.mark.parametrize("settled", [-1e-9, 1.0, np.nan, np.inf])
def test_an_invalid_size_is_refused(settled: float) -> None:
    equations = arm("tool")
    with pytest.raises(ArgumentError, match="settled: given"):
        inversion_library(equations, "lq", SOLVERS).invert(**arguments(equations), settled=settled)


def test_bvp_refuses_the_option_settled() -> None:
    equations = derive("planar5_nmp")
    library = inversion_library(equations, "bvp")
    with pytest.raises(
        ArgumentError, match="settled: given 1e-07, expected 0: all samples are computed"
    ):
        library.bvp(**arguments(equations), settled=ALLOWED)


@pytest.mark.slow
def test_solve_computes_few_samples_that_it_does_not_return() -> None:
    solution = flexgen.solve(last_joint(read("planar5_mp"), *SLOW["tool"]), "joints", "lq")
    assert solution.simulation is not None and solution.simulation.tool_error_max_m is not None
    assert solution.simulation.tool_error_max_m < 1e-6
    length = solution.trajectory.time[-1] - solution.trajectory.time[0]
    assert solution.intervals * 10e-3 < 1.3 * length  # most of what is computed is in the solution


@pytest.mark.slow
def test_vibrations_that_decay_slowly_are_followed_until_they_have_decayed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A zero with a time constant of 1.8 s, which needs more than the usual 5 s after the path."""
    model = last_joint(read("planar5_mp"), 0.1, 0.004)
    move = replace(model.moves[0], duration=0.2)
    lines: list[str] = []
    found = flexgen.solve(model, move, progress=lines.append)
    assert any("vibrations decay with" in line for line in lines)
    assert found.status == flexgen.Status.SOLVED and not any(
        "not decayed" in text for text in found.warnings
    )
    assert (
        10.0 < found.trajectory.time[-1] < 40.0
        and claimed_error(found) < 1e-8
        and false_claims(found) == []
    )
    monkeypatch.setattr(settling, "LONGEST_DECAY", 5.0)  # planted: the usual time
    cut = flexgen.solve(model, move, method="lq", mesh=4e-3)
    (text,) = [text for text in cut.warnings if "not decayed" in text]
    assert "move the output by about 9.7e-05 m, with a time constant of 1.76 s" in text
