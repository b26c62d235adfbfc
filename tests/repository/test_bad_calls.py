"""Calls of methods and constructors with invalid arguments: an ArgumentError that names the
expected value.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError

LONG = "x" * 5000
NAN = np.full((2, 2), np.nan)
INFINITE = np.full((2, 2), np.inf)
GOOD = np.eye(2)


@pytest.fixture(scope="module")
def robot():
    return flexgen.read("elbow")


@pytest.fixture(scope="module")
def given(robot):
    """Objects whose methods are called."""
    solution = flexgen.solve(robot, verify=False)
    return {
        "robot": robot,
        "bare": replace(robot, moves=(), programs=()),
        "path": flexgen.plan(robot),
        "trajectory": solution.trajectory,
        "problem": flexgen.plan_problem(robot),
    }


CALLS = {
    "deflections": (
        lambda x: flexgen.Limits().deflections(2**31),
        r"given 2147483648, expected 0 to 10000",
    ),
    "arrays": (
        lambda x: flexgen.Limits().arrays(-1),
        r"torque bounds: given -1, expected 0 to 10000",
    ),
    "notch at 0": (
        lambda x: flexgen.Notch(5.0).section(0),
        r"sample_s: given 0, expected a time > 0 in s",
    ),
    "low-pass at a text": (
        lambda x: flexgen.LowPass(5.0).section("1"),
        r"sample_s: given '1', expected a time > 0",
    ),
    "move": (
        lambda x: x["robot"].move("lime"),
        r"given 'lime', expected one of model elbow: .*; did you mean 'line'",
    ),
    "move by number": (
        lambda x: x["robot"].move(3),
        r"given 3, expected one of model elbow: line, joints",
    ),
    "no moves": (
        lambda x: x["bare"].move("line"),
        r"given 'line', but model elbow has no moves; write \[\[move\]\]",
    ),
    "sample": (
        lambda x: x["path"].sample(np.zeros((2, 2))),
        r"t: given shape \(2, 2\), expected instants in s, shape",
    ),
    "sample of one": (
        lambda x: x["path"].sample(0.5),
        r"t: given 0\.5, expected instants in s, shape \(n,\)",
    ),
    "sample of a text": (lambda x: x["path"].sample("x"), r"t: given 'x', expected instants in s"),
    "sample of digits": (
        lambda x: x["path"].sample([10**5000]),
        r"t: given .*, expected instants in s",
    ),
    "at": (
        lambda x: x["trajectory"].at(10**400),
        r"t: given 1000.*, expected one or more instants from 0 to 1\.\d+ s",
    ),
    "at digits": (
        lambda x: x["trajectory"].at(10**5000),
        r"t: given an integer of .* bits, expected one or more",
    ),
    "load": (lambda x: flexgen.Trajectory.load(LONG), r"given 'x+.*, which does not exist"),
    "save": (
        lambda x: x["trajectory"].save(LONG + ".npz"),
        r"given a path of 5004 characters, .* choose a shorter one",
    ),
    "simulate": (lambda x: flexgen.simulate("elbow", LONG + ".npz"), r"which does not exist"),
    "generate": (lambda x: flexgen.generate("elbow", LONG), r"given a path of 5000 characters"),
    "export": (
        lambda x: flexgen.export_selftest("elbow", LONG),
        r"given a path of 5000 characters",
    ),
    "combinations": (
        lambda x: flexgen.combinations("x"),
        r"values: given 'x', expected a mapping of names to lists",
    ),
    "error_of": (
        lambda x: x["problem"].error_of("x"),
        r"phase: given 'x', expected a flexgen\.Phase",
    ),
    "reference_at": (
        lambda x: x["problem"].reference_at(None),
        r"phase: given None, expected a flexgen\.Phase",
    ),
    "Notch": (
        lambda x: flexgen.Notch(None),
        r"filter, frequency_hz: given None, expected a finite number",
    ),
    "LowPass": (
        lambda x: flexgen.LowPass(5.0, damping=np.nan),
        r"filter, damping: given nan, expected a finite number",
    ),
    "Linear, nan": (
        lambda x: flexgen.Linear(NAN, GOOD, GOOD, GOOD),
        r"controller, A: given array.*, expected finite",
    ),
    "Linear, inf": (
        lambda x: flexgen.Linear(GOOD, GOOD, GOOD, INFINITE),
        r"controller, D: given array.*expected finite",
    ),
    "Linear, number": (
        lambda x: flexgen.Linear(GOOD, 1.0, GOOD, GOOD),
        r"controller, B: given 1\.0, expected finite",
    ),
    "Linear, samples": (
        lambda x: flexgen.Linear(*[GOOD] * 4, samples=0),
        r"controller, samples: given 0, expected a",
    ),
    "Limits": (
        lambda x: flexgen.Limits(torque=b"x"),
        r"limits: given torque b'x', expected a sequence of numbers",
    ),
    "Limits, number": (
        lambda x: flexgen.Limits(speed=True),
        r"limits: given speed True, expected .* for each motor",
    ),
    "Limits, texts": (
        lambda x: flexgen.Limits(deflection=("a",)),
        r"deflection \('a',\), expected .* coordinate",
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_bad_arguments_are_refused_with_what_was_expected(name, given, tmp_path, monkeypatch):
    call, expected = CALLS[name]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=f"(?s){expected}"):
        call(given)
    assert not list(tmp_path.iterdir())


def test_good_arguments_at_the_edge_are_taken(given):
    assert given["robot"].move("line") is given["robot"].move()
    assert given["path"].sample([]).y.shape == (0, 2, 6) and given["path"].sample(
        (0, 1)
    ).y.shape == (2, 2, 6)
    assert flexgen.Limits(torque=np.array([1, 2])).arrays(2)[0].tolist() == [1.0, 2.0]
    assert np.isinf(flexgen.Limits(speed=(1, np.inf)).arrays(2)[0]).all()
    assert (
        flexgen.Limits().deflections(0).shape == (0,)
        and len(flexgen.Notch(np.float32(5), 0).section(1e-3)) == 5
    )
    assert flexgen.Linear([[0.5]], [[1.0]], [[1.0]], [[0.0]]).order == 1
    problem = given["problem"]
    assert problem.error_of(problem.phases[0]).shape == (2, 1)
