"""Time limits and interrupts of fits: the best step is kept once there is one."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest

from flexgen.base.calls.deadline import (
    INTERRUPTED,
    TIME_LIMIT,
    OutOfTime,
    best_known,
    check_time,
    is_over,
    keep_best,
    limit_call,
    limit_fit,
    reason_of_end,
    running,
)
from flexgen.base.errors import ArgumentError
from flexgen.identification.estimator.minimize import Minimum, minimize
from flexgen.identification.estimator.problem import Prior, Problem


def search(count: list[int], stop: int, event: str) -> Minimum:
    """Rosenbrock's valley; at an evaluation the time is over, or Ctrl-C is pressed."""

    def residual(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count[0] += 1
        if count[0] == stop and event == "interrupt":
            signal.raise_signal(signal.SIGINT)
        if count[0] == stop and event == "time":
            time.sleep(0.12)
        r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        return r, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])

    def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        r, J = residual(x)
        return float(r @ r), J.T @ r, J.T @ J

    start = np.array([-1.2, 1.0])
    wide = np.full(2, 1e6)
    prior = Prior.of_sd(start, wide)
    return minimize(Problem.of_sums(sums, lambda x: sums(x)[0], prior, (-wide, wide)), start)


@pytest.mark.parametrize(("event", "reason"), [("interrupt", INTERRUPTED), ("time", TIME_LIMIT)])
@pytest.mark.parametrize("stop", [2, 5, 9])
def test_a_search_ends_with_its_best_step(event: str, reason: str, stop: int) -> None:
    count = [0]
    with limit_fit("fit", 0.1):
        found = search(count, stop, event)
        assert reason_of_end() == reason and is_over()
        check_time("what follows is not ended")
    assert not found.converged and stop <= count[0] <= stop + 2
    x = found.x
    assert found.cost == pytest.approx(100 * (x[1] - x[0] ** 2) ** 2 + (1 - x[0]) ** 2)
    assert found.cost <= 24.2 + 1e-9
    assert reason_of_end() == ""


def test_a_search_to_its_end_has_no_reason() -> None:
    with limit_fit("fit", 60.0):
        found = search([0], 10**9, "")
        assert reason_of_end() == ""
    assert found.converged and found.x == pytest.approx([1.0, 1.0], abs=1e-4)


def test_before_the_first_step_the_call_ends() -> None:
    with pytest.raises(KeyboardInterrupt), limit_fit("fit", None):
        search([0], 1, "interrupt")
    with (
        pytest.raises(OutOfTime, match=r"^fit: the time limit of 1e-09 s was over before"),
        limit_fit("fit", 1e-9),
    ):
        check_time("reading")


def test_a_second_interrupt_ends_the_call() -> None:
    with pytest.raises(KeyboardInterrupt), limit_fit("fit", None):
        best_known()
        signal.raise_signal(signal.SIGINT)
        assert is_over()
        signal.raise_signal(signal.SIGINT)


def test_a_fit_within_a_fit_tells_the_outer_one() -> None:
    with limit_fit("outer", None):
        best_known()
        with keep_best(), limit_fit("inner", None):
            search([0], 3, "interrupt")
            assert reason_of_end() == INTERRUPTED
        assert reason_of_end() == INTERRUPTED


def test_other_calls_end_with_the_reason() -> None:
    text = r"^predict: the time limit of 1e-09 s is over \(draws\)"
    with pytest.raises(OutOfTime, match=text), limit_call("predict", 1e-9):
        check_time("draws")
    for wrong in (-1.0, float("nan"), float("inf"), True):
        with pytest.raises(ArgumentError, match="time_limit: given"), limit_fit("fit", wrong):
            pass


def test_an_estimate_is_told_after_the_first_step() -> None:
    lines: list[str] = []
    with limit_fit("fit", 100.0, lines.append):
        best_known(2.0)
        best_known(2.0)
    assert lines == ["a step takes 2 s, a search of 5 to 20 steps about 10 to 40 s; limit 100 s"]


def test_a_limit_within_another_one_states_the_limit_that_was_given() -> None:
    """The remaining time may be negative: of two limits the shorter one is stated."""
    with running(1e-9):
        time.sleep(1e-3)
        with running(60.0) as inner:
            assert inner.left < 0.0 and inner.limit == 1e-9
    with running(60.0), running(5.0) as inner:
        assert inner.limit == 5.0
    with running(60.0), running(None) as inner:
        assert inner.limit == 60.0 and inner.left < 60.0
