"""Counts and times beyond what can be computed end with a message at once, and not in hours of
work.
"""

from __future__ import annotations

from time import perf_counter

import pytest
from small_fits import small_fit
from toolchain import needs_compiler

import flexgen
from flexgen.base.checks.counts import (
    CASES,
    PERIODS,
    RANDOM_MOVES,
    ROBOTS,
    STARTS,
    count_of,
    seconds_of,
)
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.experiments.experiment import measure
from flexgen.identification.experiments.plan import excite
from flexgen.identification.responses.verdict import verdict
from flexgen.planning.fastest import minimum_time
from flexgen.studies.sweeps.cases import Grid, random_moves
from flexgen.studies.sweeps.sweep import sweep

HUGE = [10**9, 10**400, 10**5000, -1, 1.5, True, float("nan"), "5", None, b"1"]


@pytest.mark.parametrize("value", HUGE, ids=range(len(HUGE)))
def test_a_count_out_of_range_is_refused_with_a_short_message(value):
    with pytest.raises(
        ArgumentError, match=r"\An: given .*, expected a whole number from 1 to 100\Z"
    ) as caught:
        count_of("n", value, 100)
    assert len(str(caught.value)) < 200
    assert count_of("n", 100, 100) == 100 and count_of("n", 0, 100, 0) == 0


@pytest.mark.parametrize("value", [1e9, 0, -1.0, 10**400, float("inf"), "1", None, True])
def test_a_time_out_of_range_is_refused_with_a_short_message(value):
    with pytest.raises(
        ArgumentError, match=r"\At: given .*, expected a number above 0, at most 86400 s\Z"
    ):
        seconds_of("t", value)
    assert seconds_of("t", 86400) == 86400.0


CALLS = {
    "random_moves": (lambda n: random_moves(n), RANDOM_MOVES),
    "verdict": (lambda n: verdict(None, samples=n), ROBOTS),
    "periods": (lambda n: excite("elbow", periods=n), PERIODS),
    "realizations": (lambda n: excite("elbow", realizations=n), PERIODS),
    "workers": (lambda n: sweep(Grid(["elbow"]), workers=n), CASES),
    "in_flight": (lambda n: sweep(Grid(["elbow"]), in_flight=n), CASES),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("value", [10**9, 10**400, -1, 1.5])
def test_a_call_with_too_many_ends_at_once(call, value):
    function, most = CALLS[call]
    began = perf_counter()
    with pytest.raises(
        ArgumentError, match=rf"given .*, expected a whole number from \d to {most}"
    ):
        function(value)
    assert perf_counter() - began < 5.0


@pytest.mark.parametrize("period", [1e9, 1e300, 10**400, -4.0, float("nan")])
def test_a_period_of_an_excitation_beyond_ten_million_samples_is_refused(period):
    with pytest.raises(
        ArgumentError, match=r"period_s: given .*, expected a number above 0, at most 5000 s"
    ):
        excite("elbow", period_s=period)


@pytest.fixture(scope="module")
def plan():
    return excite("elbow", poses=1, period_s=0.5, lines=5, progress=False)


@pytest.mark.parametrize("steps", [-1, 0, 10**9, 10**400, 2.5])
def test_steps_of_a_measurement_out_of_range_are_refused(steps, plan):
    with pytest.raises(
        ArgumentError, match=r"steps: given .*, expected a whole number from 1 to 1000"
    ):
        measure(plan, steps=steps, progress=False)


@needs_compiler
def test_starts_of_a_fit_out_of_range_are_refused():
    fit = small_fit("responses")
    with pytest.raises(
        ArgumentError,
        match=f"starts: given 1000000000, expected a whole number from 1 to {STARTS}",
    ):
        flexgen.identify(fit.vector.model, fit.data, starts=10**9, progress=False)


@pytest.mark.slow
@needs_compiler
def test_the_search_for_the_fastest_motion_ends_at_its_time_limit():
    began = perf_counter()
    with pytest.raises(
        SolverError,
        match=r"fastest: the time limit of 0.5 s is over .*time_limit= \(--time-limit SECONDS\)",
    ):
        flexgen.fastest(
            "planar5_nmp", vibration=1e-9, coefficients=60, time_limit=0.5, progress=False
        )
    assert perf_counter() - began < 30.0
    with pytest.raises(ArgumentError, match="time_limit: given -1, expected a time >= 0"):
        flexgen.fastest("planar5_nmp", time_limit=-1)
    assert minimum_time.TIME_LIMIT == 600.0
