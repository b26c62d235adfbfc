"""The end of a solution with the inversion replaced: what decays like an exponential ends where it
is small enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.inversion.judge import settling

PERIOD = 0.01
until_settled: Any = settling.invert_until_settled


@dataclass(frozen=True)
class Motion:
    """A motion of ten samples before, and some after the path, whose deflection decays there."""

    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    tau_g: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    tau_m: np.ndarray
    n_post: int
    period: float = PERIOD


def motion(n_post: int, decay: float, size: float) -> Motion:
    t = PERIOD * np.arange(1, n_post + 1)
    x = np.concatenate([np.full(10, size), size * np.exp(-t / decay)])[:, None]
    arm = np.hstack([np.ones_like(x), x])
    return Motion(arm, -arm / decay, arm / decay**2, x + 3.0, x + 2.0, -x, x + 4.0, n_post)


END = Made(
    q_a=np.array([1.0, 0.0]), tau_g=np.array([3.0]), q_m=np.array([2.0]), tau_m=np.array([4.0])
)


@pytest.fixture
def case(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """The output moves by as much as the deflection; the accuracy is 1e-3."""
    monkeypatch.setattr(settling, "equilibrium_at", lambda forces, q_a: END)
    monkeypatch.setattr(settling, "slow_gears", lambda problem: ("gears",))
    monkeypatch.setattr(settling, "output_units", lambda model: ["rad", "m", "m"])

    def remaining(problem: Any, found: Motion, end: Any) -> np.ndarray:
        return np.abs(found.q_a[-found.n_post :, 1])

    monkeypatch.setattr(settling, "_measure_remaining", remaining)

    def made(
        decay: float,
        size: float = 0.01,
        *,
        known: float | None = None,
        window: float = 5.0,
        **more: Any,
    ) -> Any:
        lines: list[str] = []
        asked: list[int] = []
        zeros = np.array([-1.0 / (known or decay), 30.0])
        model = Made(n_e=1, motors=[Made(inertia=0.5)])
        problem = Made(
            at_rest=lambda t: None,
            path=Made(duration=1.0),
            equations=Made(model=model),
            accuracy=1e-3,
        )
        vars(problem).update(
            {
                "gear_settling": 0.0,
                "undamped": None,
                "windows": (0.5, window),
                "zeros": [(0.0, zeros)],
                "log": lines.append,
            }
        )
        vars(problem).update(more)

        def invert(n_post: int) -> Motion:
            asked.append(n_post)
            return motion(n_post, decay, size)

        return problem, invert, lines, asked

    return made


def kept(found: Motion, n_post: int) -> None:
    """The last of the samples is the equilibrium."""
    assert found.n_post == n_post and all(
        len(getattr(found, f.name)) == 10 + n_post for f in fields(found)[:7]
    )
    assert_allclose(found.q_a[-1], END.q_a)
    assert not found.v_a[-1].any() and not found.a_a[-1].any() and not found.v_m[-1].any()
    assert (found.tau_g[-1], found.q_m[-1], found.tau_m[-1]) == (3.0, 2.0, 4.0)


def test_a_motion_ends_after_the_last_sample_that_moves(case: Callable[..., Any]) -> None:
    """0.01 exp(-t/T) is below a thousandth of the accuracy from T ln(1e4) on; 50 ms after the path
    at least.
    """
    problem, invert, _, asked = case(0.05)
    found, warnings = until_settled(problem, invert, 100)
    last = int(np.floor(0.05 * np.log(1e4) / PERIOD))  # that still moves
    kept(found, last + 1)
    assert warnings == ("gears",) and asked == [100] and found.q_a[-2, 1] > 1e-6
    kept(until_settled(*case(1e-3)[:2], 100)[0], 5)
    problem, invert, _, _ = case(1e-3, gear_settling=0.304)
    kept(until_settled(problem, invert, 100)[0], 31)
    kept(until_settled(problem, invert, 20)[0], 20)
    still, invert, _, _ = case(1e-3)
    still.equations.model.n_e = 0
    kept(until_settled(still, invert, 100)[0], 100)
    found, warnings = until_settled(still, lambda n: motion(0, 1.0, 0.0), 0)
    assert found.n_post == 0 and warnings == ()


def test_a_motion_that_needs_more_time_gets_it(case: Callable[..., Any]) -> None:
    """By its slowest zero, a tenth more than to a thousandth of the accuracy."""
    problem, invert, lines, asked = case(1.0)
    found, warnings = until_settled(problem, invert, 500)
    longer = 5.0 + 1.1 * np.log(0.01 * np.exp(-5.0) / 1e-6)
    assert asked == [500, int(longer / PERIOD)] and warnings == ("gears",)
    assert lines == [f"vibrations decay with 1 s: inverting until {longer:.3g} s after the path"]
    kept(found, int(np.floor(np.log(1e4) / PERIOD)) + 1)
    # where its zeros need less: what is left is rounding
    problem, invert, _, asked = case(1.0, window=4.9)
    found, _ = until_settled(problem, invert, 500)
    assert asked == [500] and found.n_post == 500
    before = motion(500, 1.0, 0.01)
    u = np.linspace(0.0, 1.0, 250)
    assert_allclose(found.q_a[:260], before.q_a[:260])
    w = 1 - 35 * u**4 + 84 * u**5 - 70 * u**6 + 20 * u**7
    assert_allclose(found.q_a[260:, 1], w * before.q_a[260:, 1], atol=1e-15)
    assert_allclose(found.tau_g[260:, 0] - 3.0, w * (before.tau_g[260:, 0] - 3.0), atol=1e-15)
    deviation = before.q_m[260:, 0] - 2.0
    slope, bend = (
        np.gradient(x, u * 249 * PERIOD, edge_order=2)
        for x in (w, np.gradient(w, u * 249 * PERIOD))
    )
    torque = w * deviation + 0.5 * (2 * slope * before.v_m[260:, 0] + bend * deviation)
    assert_allclose(found.tau_m[260:, 0] - 4.0, torque, atol=2e-3 * np.abs(torque).max())


def test_a_motion_that_does_not_decay_is_told(case: Callable[..., Any]) -> None:
    problem, invert, _, asked = case(500.0)
    found, warnings = until_settled(problem, invert, 500)
    assert asked == [500] and found.n_post == 500 and found.q_a[-1, 1] > 0.0
    size = 0.01 * np.exp(-5.0 / 500)
    assert warnings == (
        "the motion has not decayed 5 s after the path: the deflections still move the output "
        f"by about {size:.1e} m or rad, with a time constant of 500 s; the simulated error "
        "covers 0.5 s with the last torque held; damp the springs that are not actuated, or "
        "excite them less by a slower or smoother move",
    )
    # a tenth may be left of what is extended to 200 s, and no more than the accuracy
    for decay, size, again in ((80.0, 0.005, True), (90.0, 0.005, False), (80.0, 0.02, False)):
        problem, invert, lines, asked = case(decay, size)
        first = invert(500)
        until_settled(
            problem, lambda n, first=first: first if n == 500 else motion(n, 0.01, 0.01), 500
        )
        assert len(asked) == 1 and len(lines) == again


def test_deflections_of_slow_gears_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    lag = [0.2]
    monkeypatch.setattr(settling, "gear_lag_times", lambda equations: np.array([0.01, lag[0]]))
    problem: Any = Made(equations=None, gear_settling=4.0)
    assert settling.slow_gears(problem) == ()
    lag[0] = 0.201
    assert settling.slow_gears(problem) == (
        "the deflection of a damped gear decays with D/K = 0.201 s and has not decayed 4 s "
        "after the path; the simulated error covers 0.5 s with the last torque held; check the "
        "stiffness and the damping of the gear",
    )
    monkeypatch.setattr(settling, "gear_lag_times", lambda equations: np.zeros(0))
    assert settling.slow_gears(problem) == ()
