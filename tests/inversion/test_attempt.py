"""Verdicts on made-up attempts of a method, without a robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexgen.inversion.judge import attempt as attempts
from flexgen.inversion.judge.attempt import (
    ATTEMPTS,
    ENERGY,
    NEAR,
    Attempt,
    Measured,
    Verdict,
    is_worth_a_simulation,
    judge,
)
from flexgen.inversion.problem.problem import ACCURACY, HELPS

LAST = ATTEMPTS - 1
GOOD = Measured(ACCURACY)
BAD = Measured(1.01 * NEAR * ACCURACY)
CLOSE = Measured(NEAR * ACCURACY)
# within the accuracy, but only under a feedback
GUIDED = Measured(ACCURACY, unguided_error=1.01 * ACCURACY)
ROUGH = Attempt(measured=GOOD, ripple=0.1)
MISSED = Attempt(measured=BAD)

# Branch, attempt, its verdict; then what is changed of it, and the verdict of the changed attempt.
BRANCHES: dict[str, tuple[Attempt, str, dict[str, Any], str]] = {
    "an error within the accuracy": (
        Attempt(measured=GOOD),
        "accept",
        {"measured": Measured(1.01 * ACCURACY)},
        "refine",
    ),
    "the energy balance": (
        Attempt(measured=Measured(0.0, ENERGY)),
        "accept",
        {"measured": Measured(0.0, 1.01 * ENERGY)},
        "refine",
    ),
    "an error that is not a number": (
        Attempt(measured=GOOD),
        "accept",
        {"measured": Measured(np.nan)},
        "refine",
    ),
    "a feedback, and residuals that it may hide": (
        Attempt(measured=GUIDED),
        "accept",
        {"small_residual": False},
        "refine",
    ),
    "residuals that do nothing without the feedback": (
        Attempt(measured=GUIDED, small_residual=False),
        "refine",
        {"measured": Measured(ACCURACY, unguided_error=ACCURACY)},
        "accept",
    ),
    "torques that ripple": (Attempt(measured=GOOD), "accept", {"ripple": 1e-6}, "refine"),
    "a baseline": (Attempt(measured=BAD, baseline=True), "accept", {"baseline": False}, "refine"),
    "a failure": (Attempt(failure=ValueError()), "refine", {"number": LAST}, "stop"),
    "a failure after an accepted mesh": (
        Attempt(number=1, failure=ValueError(), before=ROUGH),
        "stop",
        {"before": MISSED},
        "refine",
    ),
    "no simulation, a small residual": (
        Attempt(verified=False),
        "accept",
        {"small_residual": False},
        "refine",
    ),
    "no simulation, the last mesh": (
        Attempt(verified=False, small_residual=False),
        "refine",
        {"number": LAST},
        "stop",
    ),
    "a simulation that is left out": (
        Attempt(small_residual=False, slow=True),
        "refine",
        {"measured": GOOD},
        "accept",
    ),
    "a mesh that helps": (
        Attempt(number=1, measured=GOOD, ripple=0.1 * HELPS, before=ROUGH),
        "refine",
        {"ripple": 0.101 * HELPS},
        "stop",
    ),
    "the last mesh": (Attempt(number=LAST - 1, measured=BAD), "refine", {"number": LAST}, "stop"),
    "a given mesh": (Attempt(measured=BAD), "refine", {"planned": 1}, "stop"),
    "one more mesh near convergence": (
        Attempt(number=LAST, measured=CLOSE, converging=True),
        "refine",
        {"measured": BAD},
        "stop",
    ),
    "one more mesh of a converging method": (
        Attempt(number=LAST, measured=CLOSE, converging=True),
        "refine",
        {"converging": False},
        "stop",
    ),
    "one more mesh after a hidden error": (
        Attempt(number=LAST, measured=GUIDED, small_residual=False),
        "refine",
        {"number": LAST + 1},
        "stop",
    ),
    "no more mesh of a given one": (
        Attempt(number=LAST, measured=CLOSE, converging=True),
        "refine",
        {"number": 0, "planned": 1},
        "stop",
    ),
    "no more mesh after an accepted one": (
        Attempt(number=LAST, measured=CLOSE, converging=True, before=MISSED),
        "refine",
        {"before": replace(ROUGH, ripple=1.0)},
        "stop",
    ),
    "one more mesh after a failure near convergence": (
        Attempt(
            number=LAST,
            failure=ValueError(),
            before=Attempt(measured=CLOSE, converging=True),
        ),
        "refine",
        {"before": MISSED},
        "stop",
    ),
}


@pytest.mark.parametrize("branch", BRANCHES)
def test_each_branch_of_the_judge_has_its_verdict(branch: str) -> None:
    """One changed figure turns it into another verdict."""
    attempt, verdict, changed, other = BRANCHES[branch]
    assert judge(attempt).value == verdict
    assert judge(replace(attempt, **changed)).value == other


def wrong_verdicts() -> int:
    """Branches, as stated and changed, whose verdict is not the stated one."""
    found = 0
    for attempt, verdict, changed, other in BRANCHES.values():
        found += judge(attempt).value != verdict
        found += judge(replace(attempt, **changed)).value != other
    return found


@pytest.mark.parametrize(
    ("place", "planted"),
    [
        ("ENERGY", 1.0),
        ("NEAR", 1.0),
        ("HELPS", 1.0),
        ("RETRIES", 0),
        ("Attempt.accepted", property(lambda attempt: attempt.measured is not None)),
        ("Attempt.hidden", property(lambda attempt: False)),
        ("Attempt.near", property(lambda attempt: attempt.measured is not None)),
        ("Attempt.fallback", property(lambda attempt: None)),
        ("Attempt.idle", property(lambda attempt: False)),
    ],
)
def test_a_planted_wrong_verdict_is_found(
    place: str, planted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert wrong_verdicts() == 0
    owner, _, name = place.rpartition(".")
    monkeypatch.setattr(getattr(attempts, owner) if owner else attempts, name, planted)
    assert wrong_verdicts() > 0


def test_slow_simulations_and_hidden_errors_wait_for_a_small_residual() -> None:
    """A slow one until the last planned mesh, one that hid an error one mesh longer."""
    slow = Attempt(small_residual=False, slow=True)
    for number, worth in ((0, False), (LAST - 1, False), (LAST, True)):
        assert is_worth_a_simulation(replace(slow, number=number)) is worth
    assert is_worth_a_simulation(replace(slow, small_residual=True))
    assert is_worth_a_simulation(replace(slow, slow=False))
    assert is_worth_a_simulation(replace(slow, planned=1))
    hidden = Attempt(measured=GUIDED, small_residual=False)
    after = Attempt(number=LAST, small_residual=False, before=hidden)
    assert not is_worth_a_simulation(after)
    assert is_worth_a_simulation(replace(after, number=LAST + 1))
    assert is_worth_a_simulation(replace(after, before=MISSED))
    # a failed mesh between them changes nothing
    failed = Attempt(number=1, failure=ValueError(), before=hidden)
    assert not is_worth_a_simulation(replace(after, before=failed))


def referee(drawn: list[Attempt]) -> tuple[list[str], int | None]:
    """Verdicts on the drawn attempts until one ends the search, and the number of the best.

    The state machine of five variables that `judge` replaces, written out.
    """
    verdicts: list[str] = []
    best: int | None = None
    least: tuple[bool, float] = (True, np.inf)
    hidden = near = False
    for k, one in enumerate(drawn):
        run = one.measured
        if one.failure is not None and not least[0]:
            return [*verdicts, "stop"], best
        if one.failure is None and run is not None:
            within = run.error <= one.accuracy and run.energy_error <= ENERGY
            near = one.converging and run.error <= NEAR * one.accuracy
            unguided = run.unguided_error
            exact = unguided is None or one.small_residual or unguided <= one.accuracy
            accepted = within and exact
            hidden = within and not exact
            rough = one.ripple if accepted else run.error
            if accepted and rough == 0.0:
                return [*verdicts, "accept"], k
            if best is not None and not least[0] and rough > HELPS * least[1]:
                return [*verdicts, "stop"], best
            if best is None or (not accepted, rough) < least:
                best = k
                least = (not accepted, rough)
        following = k + 1
        if following >= one.planned and (not least[0] or not (hidden or near)):
            return [*verdicts, "stop"], best
        if following >= one.planned + (1 if one.planned > 1 else 0):
            return [*verdicts, "stop"], best
        verdicts.append("refine")
    raise AssertionError("the search has no end")


def draw(rng: np.random.Generator) -> list[Attempt]:
    """Attempts of one method with figures on both sides of every bound."""
    planned = int(rng.choice([1, ATTEMPTS, ATTEMPTS, ATTEMPTS]))
    converging = bool(rng.integers(2))
    found: list[Attempt] = []
    for number in range(ATTEMPTS + 2):
        unguided = [None, 0.9 * ACCURACY, 2 * ACCURACY, np.inf][rng.integers(4)]
        error = ACCURACY * float(rng.choice([0.5, 1.0, 1.1, 40.0, NEAR, 2 * NEAR]))
        run = Measured(error, ENERGY * float(rng.choice([0.1, 0.1, 10.0])), unguided)
        one = Attempt(
            number=number,
            planned=planned,
            converging=converging,
            small_residual=bool(rng.integers(2)),
            ripple=float(rng.choice([0.0, 0.2, 0.1, 0.04, 1e-6])),
        )
        kind = rng.integers(6)
        if kind == 0:
            one = replace(one, failure=ValueError())
        elif kind > 1:
            one = replace(one, measured=run)
        found.append(one)
    return found


def searched(drawn: list[Attempt]) -> tuple[list[str], int | None]:
    """Verdicts of `judge` on the drawn attempts, each with those before it."""
    verdicts: list[str] = []
    before: Attempt | None = None
    for one in drawn:
        attempt = replace(one, before=before)
        verdict = judge(attempt)
        verdicts.append(verdict.value)
        if verdict is Verdict.ACCEPT:
            return verdicts, attempt.number
        if verdict is Verdict.STOP:
            return verdicts, None if attempt.best is None else attempt.best.number
        before = attempt
    raise AssertionError("the search has no end")


def test_drawn_searches_end_as_those_of_a_referee(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the best attempt is the last one."""
    rng = np.random.default_rng(71)
    cases = [draw(rng) for _ in range(1000)]
    assert [searched(case) for case in cases] == [referee(case) for case in cases]
    monkeypatch.setattr(Attempt, "best", property(lambda attempt: attempt.last_measured))
    assert [searched(case) for case in cases] != [referee(case) for case in cases]


def test_a_missed_attempt_states_its_reason() -> None:
    """The first cause that explains it."""
    hidden = replace(Attempt(measured=GUIDED), small_residual=False)
    assert hidden.missed.startswith("the equations of motion do not hold between the samples")
    assert replace(hidden, cause="steep friction").missed.endswith("is off; steep friction")
    energy = Attempt(measured=Measured(ACCURACY, 2 * ENERGY))
    assert energy.missed == (
        f"the energy balance of the simulation is off by {2 * ENERGY:.1e}, allowed are "
        f"{ENERGY:.0e}"
    )
    off = Attempt(measured=Measured(1.01 * ACCURACY, 2 * ENERGY), cause="steep friction")
    assert off.missed == (
        "verified error 1.01e-05 is above 1e-05 [rad, and m for each meter of reach]; "
        "steep friction"
    )
    assert ROUGH.missed == "torques are off by about 1e-01 of the largest"
    assert Attempt(residual=0.012).missed == "relative residual 1.2e-02"
