"""The search of a time law: its constraints by `solve`, its linear programs by SciPy's solver, and
closed forms of what it finds.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import linprog
from toolchain import needs_compiler

import flexgen
from flexgen.base.calls.deadline import OutOfTime
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.limit_use import uses_of_limits
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.paths.path import Path
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.planning.fastest import minimum_time, time_search
from flexgen.planning.fastest.rigid_time import (
    joint_motion,
    largest_squared_speed,
    next_squared_speed,
    shortest_time,
)
from flexgen.planning.fastest.time_search import TimeSearch

pytestmark = needs_compiler
LIMITS = Limits(torque=(5.0, 4.0), speed=(120.0, 90.0), torque_rate=(400.0, 300.0), tool_speed=0.5)


@pytest.fixture(scope="module")
def default() -> flexgen.Solution:
    return flexgen.solve("elbow", verify=False, progress=False)


@pytest.fixture(scope="module")
def real(default: flexgen.Solution) -> TimeSearch:
    path = Path(flexgen.derive("elbow"), default.move)
    return TimeSearch(path, default, LIMITS, None, 8, lambda line: None)


def toy(real: TimeSearch, n: int = 2, **replaced: Any) -> Any:
    """The search with other constraints."""
    made = copy.copy(real)
    vars(made).update({"n": n, "programs": 0, "inversions": 0} | replaced)
    return made


# --- of a robot ----------------------------------------------------------------------------------
def test_constraints_are_the_limits_of_the_motion(real: TimeSearch) -> None:
    """The largest part of a limit along the solution of the same time law; three times as fine as
    in the search all of it counts.
    """
    x = real.start()
    x[0] *= 0.8
    timed = real.move(x)
    found = flexgen.solve("elbow", timed, verify=False, ignore_limits=True, progress=False)
    path = found.trajectory
    uses = uses_of_limits(found.model, LIMITS, path.__getitem__, path.time)
    most = max(use.part for use in uses)
    assert np.abs(real.constraints(x)).max() == pytest.approx(most, rel=0.01)
    assert real.excess(x) == pytest.approx(most - 1.0, abs=0.01)
    assert len(real.constraints(x)) == len(real.constraints(0.7 * x))
    assert len(real.constraints(x, 3)) > 1.4 * len(real.constraints(x))
    assert (timed.duration, timed.timing, timed.smoothness) == (x[0], tuple(x[1:]), 5)


def test_the_first_law_is_the_polynomial_a_little_slower(real: TimeSearch) -> None:
    x = real.start()
    T = real.path.duration
    assert x[0] == pytest.approx(1.02 * T) and len(x) == 9
    assert (np.diff(x[1:]) >= 0).all() and x[1] >= 0.0 and x[-1] <= 1.0
    t = np.linspace(0, x[0], 50)
    length = real.path.segments[0].law(np.array([1e9]), 0)[0, 0]
    wanted = length * TimeLaw(float(x[0]), 5)(t, 0)[:, 0]
    assert_allclose(real.law(x)(t, 0)[:, 0], wanted, atol=0.02 * length)
    timed = real.retime(x)
    assert timed.duration == x[0] and real.path.duration == T


def test_vibrations_are_sizes_over_the_allowed_one(real: TimeSearch) -> None:
    """Of the last inversion, of robots with less and more stiffness, as `vibrations` states it of
    the solution.
    """
    x = real.start()
    x[0] *= 0.3
    real.constraints(x)
    sizes = real.swing(x)
    made = toy(real, 8, swings=2e-5, found=real.found)
    assert_allclose(made.swing(x), sizes / 2e-5)
    solution = flexgen.solve("elbow", real.move(x), verify=False, progress=False)
    stated = real.vibrations(solution)
    assert list(stated) == ["soft", "stiff"]
    halves = sizes.reshape(2, -1).max(axis=1)
    assert_allclose(halves, list(stated.values()), rtol=0.05)


# --- closed forms --------------------------------------------------------------------------------
def test_the_search_ends_at_the_shortest_time_within_the_limits(real: TimeSearch) -> None:
    """g = ((T0/T)^2 (1 + (c - c0)^2), ...): the least T is T0 with c = c0."""
    best = np.array([0.4, 0.7])

    def constraints(x: np.ndarray, finer: int = 1) -> np.ndarray:
        return np.r_[(1.5 / x[0]) ** 2 * (1 + 4 * (x[1:] - best) ** 2).sum() / 2, -0.1]

    made = toy(real, constraints=constraints)
    x, history = made.run(np.array([3.0, 0.2, 0.5]))
    assert_allclose(x, [1.5, *best], atol=0.02)
    assert history[0] == 3.0 and (np.diff(history) < 1e-3).all()
    assert made.programs < time_search.MOST
    assert np.abs(constraints(x)).max() <= 1 + time_search.KEPT


def lost(x: np.ndarray, finer: int = 1) -> np.ndarray:
    raise SolverError("the path passes a singular pose")


@pytest.mark.parametrize(
    ("constraints", "text"),
    [
        (
            lost,
            r"the first time law cannot be inverted \(the path passes a singular pose\); .*joint",
        ),
        (lambda x, finer=1: np.array([np.nan]), r"cannot be inverted \(a torque is not finite\)"),
    ],
)
def test_laws_that_cannot_be_are_refused(
    real: TimeSearch, constraints: Callable[..., np.ndarray], text: str
) -> None:
    with pytest.raises(SolverError, match=text):
        toy(real, constraints=constraints).run(np.array([3.0, 0.2, 0.5]))


def test_limits_that_hold_at_rest_are_kept_at_no_speed(real: TimeSearch) -> None:
    made = toy(real, constraints=lambda x, finer=1: np.array([2.0]))
    with pytest.raises(SolverError, match=r"at any speed; .* needs 2 of a limit"):
        made._slow_down(np.array([1.0, 0.5]))


def test_slopes_are_differences_and_go_back_where_a_step_fails(real: TimeSearch) -> None:
    G = np.array([[2.0, -1.0, 0.5], [0.3, 0.7, -4.0]])

    def constraints(x: np.ndarray, finer: int = 1) -> np.ndarray:
        if x[1] > 0.5:
            raise SolverError("none")
        return G @ x if x[2] < 0.9 else np.array([np.nan, 0.0])

    made = toy(real, constraints=constraints)
    x = np.array([3.0, 0.5, 0.6])
    found = [np.zeros(2) if g is None else (g - G @ x) / h for _, h, g in made.differences(x)]
    assert_allclose(np.array(found).T, G, rtol=1e-9)
    for wrong in ([3.0, 0.6, 0.1], [3.0, 0.1, 0.95]):
        assert made.try_constraints(np.array(wrong)) is None


def test_a_search_begins_as_fast_as_the_limits_allow(real: TimeSearch) -> None:
    """By eight halves; where nothing helps with the law as it is."""
    made = toy(real, start=lambda: np.array([4.0, 0.3]))
    made.try_constraints = lambda x: None if x[0] < 0.5 else np.array([-1.7 / x[0]])
    found = made.quick_start()
    assert found[1] == 0.3 and 1.7 <= found[0] < 1.7 + 4.0 / 256
    made.try_constraints = lambda x: np.array([9.0])
    assert made.quick_start()[0] == 4.0
    assert_allclose(made.slower(np.array([2.0, 0.3]), np.array([0.1, 0.5])), [2.3, 0.3])
    assert made.slower(np.array([2.0, 0.3]), 0.0)[0] == pytest.approx(2.0 * (1 + 1e-4))
    assert made.windows(found) == [(-np.inf, np.inf)]


@pytest.mark.parametrize(
    ("duration", "resolving", "mesh"),
    [(8.0, 0.1, 5e-3), (0.1, 0.1, 2.5e-3), (1.2, 4e-3, 4.8e-3), (0.5, 4e-3, 2e-3)],
)
def test_the_mesh_of_a_search_is_a_part_of_the_duration(
    real: TimeSearch, duration: float, resolving: float, mesh: float
) -> None:
    """At most 5 ms, a fortieth of it, and what resolves the force."""
    assert toy(real, _resolving=resolving).mesh(duration) == pytest.approx(mesh)


def test_the_linear_program_of_a_step(real: TimeSearch) -> None:
    """min dT + 5 sigma + 1e-3 |dc|, rows near a limit only; the order of the coefficients
    stays.
    """
    made = toy(real)
    x = np.array([2.0, 0.3, 0.6])
    trust = 0.08
    g = np.array([0.9, -0.95, 0.2])
    G = np.array([[-0.6, 0.5, 0.0], [0.4, 0.1, -0.7], [-99.0, 0.0, 0.0]])
    step = made._program(x, g, G, trust, 2.0)
    A = G[:2] * [2.0, 1.0, 1.0]
    e = np.eye(2)
    none = np.zeros((2, 1))
    rows = np.vstack(
        [
            np.c_[A, -np.ones(2), np.zeros((2, 2))],
            np.c_[-A, -np.ones(2), np.zeros((2, 2))],
            [[0, -1, 0, 0, 0, 0], [0, 1, -1, 0, 0, 0], [0, 0, 1, 0, 0, 0]],
            np.c_[none, e, none, -e],
            np.c_[none, -e, none, -e],
        ]
    )
    right = np.r_[1 - g[:2], 1 + g[:2], 0.3, 0.3, 0.4, np.zeros(4)]
    bounds = [(-trust, trust)] * 3 + [(0, None)] * 3
    expected = linprog([1, 0, 0, 5, 1e-3, 1e-3], rows, right, bounds=bounds).x[:3] * [2.0, 1, 1]
    assert_allclose(step, expected, atol=1e-9)
    assert step[0] < 0


def test_the_linear_program_of_less_vibration(real: TimeSearch) -> None:
    """Of the largest size, and thirty times the excess of rows near a limit."""
    trust = 0.1
    x = np.array([2.0, 0.3, 0.6])
    g = np.array([0.95, -0.99, 0.1])
    s = np.array([1.5, -1.2])
    G = np.array([[0.5, 0.1], [0.2, 0.4], [9.0, 9.0], [-2.0, 1.0], [1.0, 3.0]])
    step = toy(real)._calm_program(x, g, s, G, trust)
    one = np.ones((2, 1))
    none = np.zeros((2, 1))
    parts = [np.c_[sign * G[:2], none, -one] for sign in (1, -1)]
    parts += [np.c_[sign * G[3:], -one, none] for sign in (1, -1)]
    rows = np.vstack([*parts, [[-1, 0, 0, 0], [1, -1, 0, 0], [0, 1, 0, 0]]])
    right = np.r_[1 - g[:2], 1 + g[:2], -s, s, 0.3, 0.3, 0.4]
    bounds = [(-trust, trust)] * 2 + [(0, None)] * 2
    expected = linprog([0, 0, 1, 30.0], rows, right, bounds=bounds).x[:2]
    assert_allclose(step, expected, atol=1e-9)


def calming(real: TimeSearch, allowed: float) -> Any:
    """Vibration falls with the duration and with c near 0.5; limits hold for c <= 0.8."""

    def swing(x: np.ndarray) -> np.ndarray:
        return np.array([(1 + 20 * (x[1] - 0.5) ** 2) / x[0] ** 4, -0.1]) / allowed

    return toy(
        real,
        1,
        constraints=lambda x, finer=1: np.array([x[1] / 0.8, -0.3]),
        swing=swing,
        swings=allowed,
    )


def test_less_vibration_takes_the_shortest_of_the_longer_durations(real: TimeSearch) -> None:
    made = calming(real, 0.8)
    x = made.calm(np.array([1.0, 0.2]), [2.0, 1.0])
    assert x[0] == pytest.approx(1.06)  # 1.06^-4 = 0.79 <= 0.8 < 1.045^-4 = 0.84
    assert 0.4 < x[1] < 0.6 and made.programs > 2
    text = r"vibration stays above 0\.01 m with 2 times the shortest duration; allow more"
    with pytest.raises(SolverError, match=text):
        calming(real, 0.01).calm(np.array([1.0, 0.5]), [1.0])
    x, worst = calming(real, 10.0)._calmest(np.array([1.0, 0.2]))
    assert_array_equal(x, [1.0, 0.2])  # nothing to do
    assert worst == pytest.approx((1 + 20 * 0.09) / 10)
    x, worst = calming(real, 1e-3)._calmest(np.array([1.0, 0.2]))
    assert x[1] == pytest.approx(0.5, abs=0.05) and worst == pytest.approx(1e3, rel=0.05)


def test_a_law_that_is_slowed_down_keeps_the_bound_of_the_vibration(real: TimeSearch) -> None:
    """Between its samples a limit allows 1.2 s or more; robots vibrate between 1.15 and 1.25 s."""
    made = toy(
        real,
        1,
        constraints=lambda x, finer=1: np.array([(1.2 if finer > 1 else 0.5) / x[0]]),
        swing=lambda x: np.array([1.5 if 1.15 < x[0] < 1.25 else 0.5]),
        swings=1.0,
    )
    assert made.calm(np.array([1.0, 0.5]), [1.0])[0] == pytest.approx(1.3)


# --- rigid robots --------------------------------------------------------------------------------
@pytest.mark.parametrize(("weight", "top"), [(0.0, np.inf), (0.0, 0.49), (1.5, np.inf)])
def test_the_shortest_time_of_a_mass_is_bang_bang(weight: float, top: float) -> None:
    """2 sqrt(L m / F); with a largest speed v: L / v + m v / F; with weight the force that lifts
    is smaller.
    """
    s = np.linspace(0.0, 2.0, 201)
    ones = np.ones((201, 1))
    found = shortest_time(s, 3 * ones, 0 * ones, weight * ones, np.array([6.0]), np.full(201, top))
    up = (6 - weight) / 3
    down = (6 + weight) / 3
    peak = np.sqrt(2 * 2.0 * up * down / (up + down))
    v = min(peak, np.sqrt(top))
    way = v * v / 2 * (1 / up + 1 / down)
    assert found == pytest.approx(v / up + v / down + (2.0 - way) / v, rel=5e-3)


def test_a_weight_above_the_torque_has_no_time() -> None:
    s = np.linspace(0.0, 2.0, 11)
    ones = np.ones((11, 1))
    free = np.full(11, np.inf)
    assert np.isnan(shortest_time(s, 0 * ones, 0 * ones, 7 * ones, np.array([6.0]), free))
    with pytest.raises(SolverError, match="the rigid robot cannot leave a point of the path"):
        shortest_time(s, 3 * ones, 0 * ones, 7 * ones, np.array([6.0]), free)


def test_the_next_squared_speed_is_that_of_the_weakest_motor() -> None:
    """Against a linear program over the acceleration, random torques of either sign."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, b, g = rng.normal(size=(3, 3))
        a[2] = 0.0
        x = rng.uniform(0.0, 3.0)
        right = np.r_[5.0 - g - b * x, 5.0 + g + b * x][[0, 1, 3, 4]]
        most = linprog([-1.0], np.r_[a[:2], -a[:2]][:, None], right, bounds=[(None, None)])
        expected = max(x + 2 * 0.25 * most.x[0], 0.0)
        assert next_squared_speed(a, b, g, np.full(3, 5.0), x, 0.25) == pytest.approx(expected)


def test_an_unbounded_speed_is_very_large() -> None:
    one = np.ones(1)
    assert largest_squared_speed(0 * one, 0 * one, 0 * one, one, np.inf, 0.1, 1e9) >= 1e8


@pytest.mark.parametrize("move", ["joints", "line"])
def test_joints_along_a_path_have_the_derivatives_of_their_differences(move: str) -> None:
    """Moves of the joints and of the tool; they begin at the start of the path."""
    path = flexgen.plan("elbow", move)
    s = np.linspace(0.2, 0.8, 5) * path.duration
    h = 1e-4
    q, dq, ddq = joint_motion(path, s)
    more, less = (joint_motion(path, s + x)[0] for x in (h, -h))
    assert_allclose(dq, (more - less) / (2 * h), rtol=1e-5, atol=1e-6)
    assert_allclose(ddq, (more - 2 * q + less) / h**2, rtol=1e-3, atol=1e-3)
    first = joint_motion(path, np.array([1e-6, 0.1]))[0][0]
    assert_allclose(first, path.q_start[list(path.equations.model.i_g)], atol=1e-6)


# --- limits and margins --------------------------------------------------------------------------
def test_limits_are_those_given_then_of_the_model_then_the_torques_of_the_move(
    default: flexgen.Solution,
) -> None:
    own = {"motor.m1.torque_max": 5.0, "motor.m2.speed_max": 7.0, "motor.m1.torque_rate_max": 80.0}
    model = flexgen.read("elbow", overrides=own)
    tau = default.trajectory["tau_m"]
    largest = float(np.abs(tau[:, 1]).max())
    rates = 0.5 * np.abs(np.gradient(tau, default.trajectory.time, axis=0)).max(axis=0)
    found = minimum_time.limits_of(model, None, None, default)
    assert found == Limits((5.0, largest), (np.inf, 7.0), torque_rate=(80.0, np.inf))
    given = Limits(torque=(1.0, 2.0), speed=(3.0, 4.0), tool_speed=0.5, reserve=0.1)
    expected = replace(given, torque_rate=(80.0, np.inf))
    assert minimum_time.limits_of(model, given, None, default) == expected
    found = minimum_time.limits_of(model, Limits(speed=(3.0, 4.0)), 0.5, default)
    assert found.torque_rate == pytest.approx((min(80.0, rates[0]), rates[1]))


@dataclass(frozen=True)
class Found:
    """A fastest move with a margin of its torques."""

    solution: np.ndarray
    limits: Any
    margin: tuple[float, ...] = ()


LARGEST = np.array([10.0, 4.0])


@pytest.mark.parametrize(
    ("excess", "margins"),
    [
        ([0.0099, 0.0039], [None]),
        ([0.0101, 0.0], [None, [0.0101, 0.0]]),
        ([-5.0, 0.0041], [None, [0.0, 0.0041]]),
        ([2.0, 1.0], [None, [2.0, 1.0]]),
    ],
)
def test_a_margin_for_the_feedback_grows_by_what_torques_exceed(
    monkeypatch: pytest.MonkeyPatch, excess: list[float], margins: list[Any]
) -> None:
    """Of both signs, of the worst instant of each motor; up to a thousandth of the limit is
    accepted.
    """
    asked: list[Any] = []

    def find(margin: np.ndarray | None = None) -> Found:
        asked.append(None if margin is None else margin.tolist())
        own = np.zeros(2) if margin is None else margin
        return Found(own, SimpleNamespace(torque=LARGEST.tolist()))

    def torques(margin: np.ndarray, progress: Any) -> tuple[np.ndarray, np.ndarray]:
        top = LARGEST + excess - margin
        return np.array([-top, 0 * top]), np.array([0 * top, top * [1.0, 0.2]])

    monkeypatch.setattr(minimum_time, "find_function", lambda name: torques)
    found: Any = minimum_time.with_margin(find, None)  # type: ignore[arg-type]
    assert asked[0] is None and len(asked) == len(margins)
    assert found.margin == pytest.approx(margins[-1] or (0.0, 0.0))
    never = [np.array([LARGEST + 0.5])] * 2
    monkeypatch.setattr(minimum_time, "find_function", lambda name: lambda *_, **__: never)
    with pytest.raises(SolverError, match=r"95 % of the robots needs \[2.5, 2.5\] N m or more"):
        minimum_time.with_margin(find, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"coefficients": 3}, "coefficients: given 3, expected 4 to 60"),
        ({"coefficients": 61}, "coefficients: given 61, expected 4 to 60"),
        ({"torque_rate": 0.0}, "torque_rate: given 0.0, expected a number > 0"),
        ({"vibration": 0.0}, "vibration: given 0.0, expected a size > 0 in m, or rad where the"),
        ({"time_limit": -1.0}, "time_limit: given -1.0, expected a time >= 0 in s; None or 0: no"),
        ({"against": "90 %"}, "against: given '90 %', expected '95 %' or None"),
        ({"against": "95 %"}, "against: given elbow without a table .uncertainty., expected one"),
        ({"against": "95 %", "force": np.zeros((5, 3))}, "against: given with a force, expected"),
    ],
)
def test_arguments_of_fastest_have_bounds(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.fastest("elbow", **given)


def test_a_margin_is_not_known_over_the_speed() -> None:
    curves = {"motor.m1.torque_speed": [[0.0, 9.0], [300.0, 3.0]]}
    robot = flexgen.read("elbow", overrides={"uncertainty": {"stiffness": 0.1}} | curves)
    with pytest.raises(ArgumentError, match="against: given with torque-speed curves, expected"):
        flexgen.fastest(robot, against="95 %")


def test_a_search_for_the_fastest_move_ends_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def find(*given: Any) -> None:
        raise OutOfTime("in the middle")

    monkeypatch.setattr(minimum_time, "derive", find)
    text = r"fastest: the time limit of 2.5 s is over \(in the middle\); allow more with time_lim"
    with pytest.raises(SolverError, match=text):
        flexgen.fastest("elbow", time_limit=2.5)
