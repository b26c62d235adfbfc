"""The end of a solution: what decays like an exponential ends where it is small enough.

The inversion is replaced by a motion of a real arm whose deflection decays with one time constant;
the displacement of its output is computed from differences of the output.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from inversion_cases import question
from numpy.testing import assert_allclose, assert_array_equal

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.statics import Equilibrium, equilibrium_at, gear_lag_times
from flexgen.inversion.judge import settling
from flexgen.inversion.judge.settling import invert_until_settled, slow_gears
from flexgen.inversion.judge.undamped import UndampedMotion
from flexgen.inversion.problem.problem import HELD, LAGS, InversionProblem
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import Inversion

PERIOD = 0.01
BEFORE = 10  # samples before the end of the path
SHORT = 1e-3  # s: a time constant that has decayed within a sample


@cache
def arm() -> Equations:
    """Gears without damping, and a damped joint without a motor."""
    model = flexgen.read("planar5_mp")
    gears = {
        f"element.{one.name}.dof.{dof.name}.gear.damping": 0.0
        for one in model.elements
        for dof in one.dofs
        if dof.gear is not None
    }
    return derive(flexgen.read("planar5_mp", overrides=gears))


@cache
def final() -> tuple[Equilibrium, float]:
    """Where the arm rests, and the displacement [m] of its output for a deflection of one.

    That of the output itself, or that which the inertia leaves while the torques are held.
    """
    equations = arm()
    model = equations.model
    end = equilibrium_at(equations, Path(equations, model.move()).q_start)
    h = 1e-6
    output = equations.function("output")
    W = np.column_stack(
        [
            np.array(output(end.q_a + h * e) - output(end.q_a - h * e)).ravel() / (2 * h)
            for e in np.eye(model.n_a)
        ]
    )
    M = evaluate(equations.function("mass_matrix"), end.q_a)[0].reshape(model.n_a, model.n_a)
    g = list(model.i_g)
    e = list(model.i_e)
    drift = W[:, g] @ np.linalg.solve(M[np.ix_(g, g)], M[np.ix_(g, e)]) - W[:, e]
    return end, float(max(np.linalg.norm(W[:, e]), np.linalg.norm(drift)))


def motion(n_post: int, decay: float, size: float, moves: str = "v_a") -> Inversion:
    """Speeds, or deflections, that move the output by ``size`` [m] at the end of the path.

    The end is where the arm is at the last sample; speeds move it for the time that the last
    torque is held.
    """
    end, lever = final()
    t = PERIOD * np.arange(1, n_post + 1)
    decaying = size / lever * np.concatenate([np.ones(BEFORE), np.exp(-t / decay)])[:, None]
    free = np.isin(np.arange(len(end.q_a)), arm().model.i_e)
    still = np.zeros((BEFORE + n_post, 1)) + 0.0 * end.q_a
    q_a = end.q_a + (decaying * free if moves == "q_a" else still)
    v_a = decaying / HELD * free if moves == "v_a" else still
    ones = np.ones((BEFORE + n_post, len(end.q_m)))
    return Inversion(
        *(q_a, v_a, v_a, 3.0 * ones, 2.0 * ones, ones, 4.0 * ones),
        *(0, n_post, PERIOD, 0, 0, 0, 0, 0, 0, 0, True),
    )


def case(decay: float, **more: Any) -> tuple[InversionProblem, list[str]]:
    """The problem of an arm with one slowest zero, and what it logs; the accuracy is 1e-3."""
    lines: list[str] = []
    problem = InversionProblem(
        arm(), Path(arm(), arm().model.move()), accuracy=1e-3, progress=lines.append
    )
    zeros = np.array([-1.0 / decay, 30.0], dtype=complex)
    fixed = {"gear_settling": 0.0, "undamped": None, "windows": (0.5, 5.0)}
    vars(problem).update({**fixed, "zeros": [(0.0, zeros)], **more})
    return problem, lines


def settled(
    decay: float, n_post: int = 500, moves: str = "v_a", **more: Any
) -> tuple[Inversion, tuple[str, ...], list[int], list[str]]:
    """The end, its warnings, the numbers of samples that were asked for, and the log."""
    problem, lines = case(decay, **more)
    asked: list[int] = []

    def invert(n: int) -> Inversion:
        asked.append(n)
        return motion(n, decay, 0.01, moves)

    return *invert_until_settled(problem, invert, n_post), asked, lines


def last_moving(decay: float, size: float = 0.01) -> int:
    """The last sample whose motion moves the output by a thousandth of the accuracy."""
    return int(np.floor(decay * np.log(size / 1e-6) / PERIOD))


def check_end(found: Inversion, n_post: int) -> None:
    """The last of the samples is the equilibrium, those before it are kept."""
    end, _ = final()
    assert found.n_post == n_post
    assert {len(getattr(found, name)) for name in ("q_a", "a_a", "tau_m")} == {BEFORE + n_post}
    for name in ("q_a", "q_m", "tau_m", "tau_g"):
        assert_allclose(getattr(found, name)[-1], getattr(end, name), atol=1e-9)
    assert not any(getattr(found, name)[-1].any() for name in ("v_a", "a_a", "v_m"))


@pytest.mark.parametrize("moves", ["q_a", "v_a"])
@pytest.mark.parametrize(
    ("decay", "n_post", "more", "kept"),
    [
        (0.05, 100, {}, last_moving(0.05) + 1),
        (SHORT, 100, {}, 5),  # 50 ms at least
        (SHORT, 100, {"gear_settling": 0.304}, 31),
        (SHORT, 20, {"gear_settling": 0.304}, 20),
    ],
    ids=["moves", "shortest", "gears", "all"],
)
def test_a_motion_ends_after_the_last_sample_that_moves(
    decay: float, n_post: int, more: dict[str, Any], kept: int, moves: str
) -> None:
    found, warnings, asked, _ = settled(decay, n_post, moves, **more)
    check_end(found, kept)
    assert warnings == () and asked == [n_post]
    before = motion(n_post, decay, 0.01, moves)
    assert_array_equal(found.v_a[:-1], before.v_a[: BEFORE + kept - 1])


def test_a_planted_accuracy_moves_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settling, "SETTLED", 1.1e-3)
    assert settled(0.05, n_post=100)[0].n_post != last_moving(0.05) + 1


def test_without_samples_after_the_path_nothing_is_changed() -> None:
    found, warnings, _, _ = settled(1.0, n_post=0)
    assert_array_equal(found.q_a, motion(0, 1.0, 0.01).q_a)
    assert warnings == ()


def test_a_motion_that_needs_more_time_gets_it() -> None:
    """By its slowest zero, a tenth more than to a thousandth of the accuracy."""
    found, warnings, asked, lines = settled(1.0)
    longer = 5.0 + 1.1 * np.log(0.01 * np.exp(-5.0) / 1e-6)
    assert asked == [500, int(longer / PERIOD)] and warnings == ()
    assert lines[-1].endswith(
        f"vibrations decay with 1 s: inverting until {longer:.3g} s after the path"
    )
    check_end(found, last_moving(1.0) + 1)


def test_what_is_left_where_the_zeros_need_less_time_fades_out() -> None:
    """It is rounding; `fade_to_equilibrium` has a test of its own."""
    found, warnings, asked, _ = settled(1.0, windows=(0.5, 4.9))
    assert asked == [500] and found.n_post == 500 and warnings == ()
    before = motion(500, 1.0, 0.01)
    half = BEFORE + 250
    assert_array_equal(found.v_a[:half], before.v_a[:half])
    assert found.v_a[half].any() and not found.v_a[-1].any()


def test_a_motion_that_does_not_decay_is_told() -> None:
    found, (warning,), asked, _ = settled(500.0)
    assert asked == [500] and found.n_post == 500 and found.v_a[-1].any()
    assert warning == (
        "the motion has not decayed 5 s after the path: the deflections still move the output "
        f"by about {0.01 * np.exp(-5.0 / 500):.1e} m, with a time constant of 500 s; the "
        "simulated error covers 0.5 s with the last torque held; damp the springs that are not "
        "actuated, or excite them less by a slower or smoother move"
    )


@pytest.mark.parametrize(
    ("decay", "size", "again"), [(80.0, 0.005, True), (90.0, 0.005, False), (80.0, 0.02, False)]
)
def test_more_time_is_taken_where_it_helps(decay: float, size: float, again: bool) -> None:
    """A tenth may be left of what is extended to 200 s, and no more than the accuracy."""
    problem, lines = case(decay)
    asked: list[int] = []

    def invert(n: int) -> Inversion:
        asked.append(n)
        return motion(n, decay if len(asked) == 1 else SHORT, size)

    found, warnings = invert_until_settled(problem, invert, 500)
    assert (len(asked), len(warnings)) == ((2, 0) if again else (1, 1))
    assert (found.n_post == 5) == again and (not lines) != again


@pytest.mark.parametrize("lags", [1.01 * LAGS, LAGS, 0.99 * LAGS])
def test_deflections_of_slow_gears_are_told(lags: float) -> None:
    """The slowest gear counts, with D / K."""
    model = flexgen.read("elbow")
    elements = tuple(
        replace(
            one, dofs=tuple(replace(d, gear=replace(d.gear, damping=k + 1.0)) for d in one.dofs)
        )
        for k, one in enumerate(model.elements)
    )
    problem = question(replace(model, elements=elements))
    slowest = float(gear_lag_times(problem.equations).max())
    vars(problem)["gear_settling"] = lags * slowest
    found = slow_gears(problem)
    assert bool(found) == (lags < LAGS)
    assert all(f"decays with D/K = {slowest:.3g} s and has not" in text for text in found)
    # the other branch: an arm whose coordinates have motors is cut nowhere
    n = len(problem.path.q_start)
    end = equilibrium_at(problem.equations, problem.path.q_start)
    still = np.tile(end.q_a, (15, 1))
    run = Inversion(
        *(still, 0 * still, 0 * still, np.ones((15, n)), still, 0 * still, np.ones((15, n))),
        *(0, 5, PERIOD, 0, 0, 0, 0, 0, 0, 0, True),
    )
    cut, warnings = invert_until_settled(problem, lambda n_post: run, 5)
    assert cut.n_post == 5 and warnings == found
    assert_array_equal(cut.tau_m[-1], end.tau_m)


@pytest.mark.parametrize(
    ("hertz", "n_post", "asked"), [(0.5, 20, [20, 200]), (10.0, 20, [20, 50]), (0.5, 200, [200])]
)
def test_a_swing_that_nothing_damps_is_shown_for_a_period(
    hertz: float, n_post: int, asked: list[int]
) -> None:
    """Or for the time that the last torque is held, and is told."""
    swing = UndampedMotion((hertz,), False, ("q3",))
    found, warnings, tried, _ = settled(500.0, n_post, undamped=swing)
    assert tried == asked and found.n_post == asked[-1]
    assert len(warnings) == 1 and "q3" in warnings[0] and found.v_a[-1].any()
