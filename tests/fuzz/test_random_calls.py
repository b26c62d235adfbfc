"""Random calls of the public interface: only errors of flexgen and TypeErrors leave it, and
nonsense does not enter.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from public_entrances import Entrance, entrances, unchecked
from random_calls import accepted, call_at_random, callables, known_objects, more_objects

import flexgen
from flexgen.base.checks.type_checks import checks_of
from flexgen.base.errors import ArgumentError

# Objects of these classes take minutes to make, or have the methods of all results only; their
# methods are checked, and not called here.
NOT_MADE = {
    *(
        "Comparison",
        "Configuration",
        "Detection",
        "Equilibrium",
        "Estimate",
        "Exported",
        "GeneratedLibrary",
        "Load",
    ),
    *(
        "FeedbackLinearisation",
        "FeedbackStudy",
        "InverseKinematics",
        "JointTorqueFeedback",
        "LQ",
        "LearningResult",
    ),
    "Passivity",
    *(
        "LimitedInverter",
        "MotionFit",
        "Phase",
        "Simulation",
        "SweepResult",
        "TorqueCommand",
        "TuningResult",
    ),
}


@pytest.fixture(autouse=True)
def quiet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder below another one, for the files of calls that succeed; warnings are not
    results.
    """
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    monkeypatch.chdir(folder)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield folder


@pytest.fixture(scope="module")
def objects() -> dict[type, Any]:
    return known_objects()


def test_500_random_calls_raise_errors_of_flexgen_or_type_errors(objects) -> None:
    outcome = call_at_random(0, 500, 4.0, objects)
    assert outcome.leaks == {}
    assert outcome.refused > 0.5 * outcome.calls > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_10000_random_calls_raise_errors_of_flexgen_or_type_errors(quiet, seed: int) -> None:
    things = more_objects(quiet / "library")
    called = {each.name for each in callables(things)}
    assert {
        each.name.partition(".")[0] for each in entrances() if each.name not in called
    } == NOT_MADE
    outcome = call_at_random(seed, 10_000, 120.0, things)
    assert outcome.leaks == {}
    assert outcome.refused > 0.5 * outcome.calls > 0


@pytest.mark.slow
def test_values_of_wrong_types_are_refused_by_every_parameter_of_every_entrance(quiet) -> None:
    things = more_objects(quiet / "library")
    assert [line for each in callables(things) for line in accepted(each, things)] == []


def test_values_of_wrong_types_are_refused_by_constructors_of_few_arguments(objects) -> None:
    few = [
        each
        for each in callables(objects)
        if each.is_constructor and len(checks_of(each.call)) in (1, 2, 3)
    ]
    assert len(few) > 10 and [line for each in few for line in accepted(each, objects)] == []


def test_every_public_entrance_is_checked() -> None:
    assert unchecked() == []
    assert len(list(entrances())) > 250


@pytest.mark.parametrize(
    "name", ["plan", "Limits.deflections", "Notch.__init__", "Trajectory.load"]
)
def test_a_planted_entrance_without_check_is_seen(monkeypatch, name: str) -> None:
    owner, _, method = name.rpartition(".")
    holder = getattr(flexgen, owner) if owner else flexgen
    bare = inspect.unwrap(getattr(holder, method))
    monkeypatch.setattr(
        holder, method, staticmethod(bare) if name == "Trajectory.load" else bare, raising=False
    )
    assert unchecked() == [name.removesuffix(".__init__")]


def test_a_planted_function_that_raises_an_attribute_error_is_seen(monkeypatch, objects) -> None:
    def schema(kind: str = "model") -> str:
        return kind.nosuch  # type: ignore[attr-defined]

    monkeypatch.setattr(flexgen, "schema", schema, raising=False)
    outcome = call_at_random(
        0, 50, 4.0, {}, [each for each in callables({}) if each.name in ("schema", "Notch")]
    )
    assert [leak.partition(" at ")[0] for leak in outcome.leaks] == ["schema: AttributeError"]


def test_a_planted_constructor_that_accepts_nonsense_is_seen(objects) -> None:
    class Filter:
        def __init__(self, hz: float, fast: bool = False) -> None:
            self.hz = hz

    lines = list(accepted(Entrance("Filter", Filter, Filter), objects))
    assert [line.partition(":")[0] for line in lines] == ["Filter, hz", "Filter, fast"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: flexgen.Notch(None),
            r"filter, frequency_hz: given None, expected a finite number",
        ),
        (
            lambda: flexgen.Cascade(None, (1.0,), (1.0,)),
            r"Cascade, position_gain: given None, expected an array",
        ),
        (lambda: flexgen.PID(None, (1.0,), (1.0,)), r"PID, k_p: given None, expected"),
        (
            lambda: flexgen.RandomMove(None),
            r"RandomMove, number: given None, expected a whole number",
        ),
        (
            lambda: flexgen.PoseTarget(None, None),
            r"PoseTarget, position: given None, expected a sequence",
        ),
        (
            lambda: flexgen.DriveHardware("x"),
            r"DriveHardware, \w+: given 'x', expected a finite number",
        ),
        (
            lambda: flexgen.Setting(None, None),
            r"Setting, sample_s: given None, expected a finite number",
        ),
        (
            lambda: flexgen.plan("elbow").sample([np.nan]),
            r"t: given \[nan\], expected instants in s",
        ),
        (
            lambda: flexgen.solve("elbow", verify="no"),
            "verify: given 'no', expected True or False",
        ),
        (lambda: flexgen.solve("elbow", verify=1), "verify: given 1, expected True or False"),
        (
            lambda: flexgen.control("elbow", seed=10**400),
            r"seed: given 1000.*000 \.\.\. .*, expected a whole number",
        ),
        (lambda: flexgen.generate("elbow", build=1), "build: given 1, expected True or False"),
        (
            lambda: flexgen.read("elbow", overrides={1: 2}),
            "overrides: given {1: 2}, expected a mapping of dotted",
        ),
        (
            lambda: flexgen.solve("elbow", hold="cubic"),
            "hold: given 'cubic', expected one of spline, linear, zoh",
        ),
    ],
)
def test_invalid_values_are_refused_with_what_was_given_and_expected(call, message: str) -> None:
    with pytest.raises(ArgumentError, match=f"^{message}"):
        call()


def test_messages_of_long_values_are_short() -> None:
    with pytest.raises(ArgumentError) as caught:
        flexgen.read("elbow", overrides="x" * 5000)
    assert len(str(caught.value)) < 200
