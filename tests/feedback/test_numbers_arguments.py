"""Arguments at the edges of their ranges: numbers, seeds, plants of a loop, gains of a cascade,
ends of a process.
"""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.spec import arguments
from flexgen.feedback.loop import plants
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.interface import Setup
from flexgen.feedback.positions import command
from flexgen.runtime.inversion import inversion_arguments as checked
from flexgen.studies.scenarios.foreign import ForeignController


def test_numbers_are_real_and_finite() -> None:
    for value in (
        0,
        1.5,
        -2,
        np.float64(3.0),
        np.int32(4),
        np.array(5.0),
        Fraction(1, 2),
        10**300,
    ):
        assert arguments.is_number(value)
    for value in (
        True,
        np.bool_(True),
        "1",
        None,
        np.nan,
        np.inf,
        np.array([1.0]),
        1j,
        Decimal(1),
        10**400,
    ):
        assert not arguments.is_number(value)
    assert (
        arguments.is_whole(1) and arguments.is_whole(np.int64(7)) and arguments.is_whole(2**31 - 1)
    )
    for value in (0, True, 1.0, "1", 2**31, np.float64(2.0)):
        assert not arguments.is_whole(value)
    assert (
        arguments.is_whole(0, 0)
        and arguments.is_whole(3, 3, 3)
        and not arguments.is_whole(4, 3, 3)
    )


def test_bounds_of_numbers_are_named() -> None:
    arguments.check_positive("x", 1e-300)
    arguments.check_not_negative("x", 0)
    for value in (0, -1.0, "a", True, np.nan):
        with pytest.raises(ArgumentError) as caught:
            arguments.check_positive("x", value)
        assert str(caught.value) == f"x: given {value!r}, expected a number > 0"
    for value in (-1e-300, None, np.inf):
        with pytest.raises(ArgumentError) as caught:
            arguments.check_not_negative("x", value, "a size")
        assert str(caught.value) == f"x: given {value!r}, expected a size"
    assert (
        arguments.seed_of(0) == 0
        and arguments.seed_of(np.int64(5)) == 5
        and arguments.seed_of(2**63 - 1) == 2**63 - 1
    )
    for value in (-1, 1.0, True, 2**63):
        with pytest.raises(ArgumentError, match=r"^seed: given .*, expected a whole number >= 0$"):
            arguments.seed_of(value)
    given = {"a": 1}
    assert (
        arguments.mapping_of("m", given, "x") == given
        and arguments.mapping_of("m", given, "x") is not given
    )
    with pytest.raises(ArgumentError, match=r"^m: given \[1\], expected a table$"):
        arguments.mapping_of("m", [1], "a table")


def test_numbers_of_plants_are_factors_and_added_loads() -> None:
    """Of a kind all forces of it; of a payload what is added, down to none, and where it is."""
    model = flexgen.read("manutec_r3")
    found = plants.plants_of(
        model, {"a": {"stiffness": 0.8, "payload": -15.0}, "b": {}, "c": {"q1.stiffness": 2.0}}
    )
    names = [p.name for p in found.parameters]
    nominal = {p.name: p.value for p in found.parameters}
    assert found.names == ("a", "b", "c") and found.values.shape == (3, len(names))
    assert nominal["payload.mass"] == 15.0 and {
        "q1.stiffness",
        "q2.stiffness",
        "q3.stiffness",
    } <= set(names)
    rows = [dict(zip(names, row, strict=True)) for row in found.values.tolist()]
    assert rows[0]["payload.mass"] == 0.0 and rows[1] == nominal
    assert_allclose([rows[0][x] / nominal[x] for x in ("q1.stiffness", "q3.stiffness")], 0.8)
    assert (
        rows[2]["q1.stiffness"] == 2 * nominal["q1.stiffness"]
        and rows[2]["q2.stiffness"] == nominal["q2.stiffness"]
    )
    place = ", ".join(f"{x:g}" for x in model.payload.com)
    where = "tool" if model.payload.com == model.tool.position else "center of mass of the payload"
    assert found.loads == (
        f"-15 kg at the {where}, [{place}] m in the frame of the last tip",
        "",
        "",
    )
    for com, words in (
        ((0.0, 0.0, 0.5), "at the tool"),
        ((0.0, 0.0, 0.4), "at the center of mass of the payload"),
    ):
        arm: Any = SimpleNamespace(
            payload=SimpleNamespace(com=com), tool=SimpleNamespace(position=(0.0, 0.0, 0.5))
        )
        assert (
            plants._load(arm, 2.5)
            == f"+2.5 kg {words}, [0, 0, {com[2]:g}] m in the frame of the last tip"
        )
    for changes, message in (
        (
            {"payload": -15.1},
            "plant a, payload: given -15.1 kg, expected -15 to 100000 kg to add to the payload",
        ),
        (
            {"payload": 1.1e5},
            "plant a, payload: given 110000.0 kg, expected -15 to 100000 kg to add to the payload",
        ),
        ({"stiffness": -0.1}, "plant a, stiffness: given the factor -0.1, expected 0 to 100"),
        ({"stiffness": 100.1}, "plant a, stiffness: given the factor 100.1, expected 0 to 100"),
        ({"stiffness": "x"}, "plant a, stiffness: given 'x', expected a number"),
        (
            {"lost_motion": 2.0},
            "plant a, lost_motion: the model manutec_r3 has no number of this kind",
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            plants.plants_of(model, {"a": changes})
        assert str(caught.value) == message
    edges = plants.plants_of(
        model, {"a": {"stiffness": 100.0, "payload": 1e5}, "b": {"damping": 0.0}}
    )
    assert edges.values.max() > 0 and edges.loads[0].startswith("+100000 kg ")
    with pytest.raises(
        ArgumentError,
        match=r"^plant a, payload.mass: the model elbow has no number of this kind but 0$",
    ):
        # a factor on it changes nothing
        plants.plants_of(flexgen.read("elbow"), {"a": {"payload.mass": 50.0}})
    with pytest.raises(ArgumentError, match=r"^plant a: given 3, expected changes such as "):
        plants.plants_of(model, {"a": 3})  # type: ignore[dict-item]


def test_gains_of_a_cascade_are_one_for_each_motor() -> None:
    """Or one for each robot and motor."""
    setup = Setup(np.zeros((3, 2)), 1e-3, 2, 4, 8)
    good = np.array([1.0, 2.0])

    def compiled(**changes: Any) -> Any:
        gains = {"position_gain": good, "speed_gain": good, "integral_gain": good} | changes
        return Cascade(**gains).compiled(setup)

    plain = compiled()
    memory = np.ascontiguousarray(plain.memory).view(float).reshape(3, -1)
    assert_allclose(memory[:, 4:12], np.tile([1, 2, 1, 2, 1, 2, 0, 0], (3, 1)))
    each = compiled(
        speed_gain=np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), torque_max=np.array([7.0, 8.0])
    )
    rows = np.ascontiguousarray(each.memory).view(float).reshape(3, -1)
    assert_allclose(rows[:, 6:8], [[1, 2], [3, 4], [5, 6]])
    assert_allclose(rows[:, 10:12], np.tile([7, 8], (3, 1)))
    for name in ("position_gain", "speed_gain", "integral_gain", "torque_max"):
        for wrong in (np.ones(3), np.ones((2, 2)), np.ones((3, 3))):
            with pytest.raises(
                ArgumentError,
                match=rf"(?s)^controller, {name}: given .*, expected 2 finite numbers, one for",
            ):
                compiled(**{name: wrong})


def test_limits_that_commands_reach_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Speeds by first differences, accelerations by second ones; where one is reached the samples
    are fitted again.
    """
    samples = np.array([[0.0, 0.0], [1.0, 0.5], [3.0, 1.0], [4.0, 1.5]])
    monkeypatch.setattr(command, "fit_samples", lambda B, r: samples)
    monkeypatch.setattr(command, "fit_within", lambda B, r, period, limits: 0.5 * samples + 1.0)
    names = ["q1", "q2"]
    h = 0.5
    B = None

    def fit(speed: Any, acceleration: Any) -> tuple[bool, tuple[str, ...]]:
        limits = (
            None if speed is None else np.array(speed),
            None if acceleration is None else np.array(acceleration),
        )
        found, active = command._fit(B, samples, h, limits, names)  # type: ignore[arg-type]
        return bool(found[0, 0]), active

    assert fit(None, None) == (False, ()) and fit([4.0, 1.0], [4.0, 1e-9]) == (False, ())
    assert fit([3.9, 0.9], None) == (True, ("speed of q1", "speed of q2"))
    assert fit([4.0, 1.0], [3.9, 1.0]) == (True, ("acceleration of q1",))
    assert fit([3.0, 9.0], [3.0, 9.0]) == (True, ("speed of q1", "acceleration of q1"))


def test_the_end_of_a_process_is_described() -> None:
    made: Any = object.__new__(ForeignController)
    made._failure = "late"
    made._process = None
    assert made._describe_end() == "late"
    made._failure = ""
    assert made._describe_end() == "the controller's process ended"
    made._process = SimpleNamespace(poll=lambda: 3, wait=lambda seconds: 3)
    assert made._describe_end() == "the controller's process ended with code 3"
    made._process = SimpleNamespace(poll=lambda: None, wait=lambda seconds: 1 / 0)
    assert made._describe_end() == "the controller's process ended"


# --- of an inversion -----------------------------------------------------------------------------
MASS = {"name": "payload.mass", "unit": "kg", "bound": ">= 0"}
SPRING = {"name": "q1.stiffness", "unit": "N m/rad", "bound": "> 0"}
CENTER = {"name": "payload.com.x", "unit": "m"}
SIZES = {"n_t": 12, "n_y": 6}


def test_parameters_of_an_inversion_are_those_of_the_model_or_checked() -> None:
    own = np.array([1.0, 2.0, 3.0])
    rows = (MASS, SPRING, CENTER)
    assert checked.parameters_of("invert", None, own, rows) is own
    found = checked.parameters_of("invert", [0, 1, -5], own, rows)
    assert found.dtype == float and found.tolist() == [0.0, 1.0, -5.0]
    single = checked.parameters_of("invert", [0.5, 1, 2], own.astype(np.float32), rows)
    assert single.dtype == np.float32
    for values, text in (
        (
            [-1.0, 1.0, 0.0],
            "invert, parameters: given -1 kg as payload.mass, expected a number >= 0",
        ),
        (
            [1.0, 0.0, 0.0],
            "invert, parameters: given 0 N m/rad as q1.stiffness, expected a number > 0",
        ),
        (
            [1.0, -2.5, 0.0],
            "invert, parameters: given -2.5 N m/rad as q1.stiffness, expected a number > 0",
        ),
        ([1.0, 2.0], "invert, parameters: given shape (2,), expected (3)"),
        ([1.0, 2.0, "a"], "invert, parameters: given entries of type <U32, expected real numbers"),
        (
            [True, True, True],
            "invert, parameters: given entries of type bool, expected real numbers",
        ),
        ([1.0, [2.0], 3.0], "invert, parameters: given setting an array element with a sequence."),
    ):
        with pytest.raises(ArgumentError) as caught:
            checked.parameters_of("invert", values, own, rows)
        assert str(caught.value).startswith(text)
    with pytest.raises(ArgumentError) as caught:
        checked.parameters_of("invert", [1.0], np.zeros(0), ())
    assert str(caught.value).startswith(
        "invert, parameters: given to a library without run-time parameters, expected"
    )
    many = np.array([[1.0, 2.0, 0.0], [4.0, 3.0, 0.0], [0.0, 1e-9, -1.0]])
    checked.check_bounds("invert_many", many, rows)
    checked.check_bounds("invert_many", many[:0], rows)
    many[1, 1] = 0.0
    with pytest.raises(
        ArgumentError, match=r"^invert_many, parameters: given 0 N m/rad as q1\.stiffness"
    ):
        checked.check_bounds("invert_many", many, rows)


def test_samples_of_a_path_have_as_many_rows_each() -> None:
    """One path, or one for each of several problems; forces have three columns for each row of
    dy.
    """
    y = np.zeros((5, 12))
    dy = np.ones((5, 6))
    push = np.full((5, 18), 2.0)
    real = np.dtype(float)
    found = checked.samples_of("invert", (y.tolist(), dy, dy.astype(int)), push, SIZES, real, True)
    assert {name: x.shape for name, x in found.items()} == {
        "y": (5, 12),
        "dy": (5, 6),
        "ddy": (5, 6),
        "force": (5, 18),
    }
    assert all(x.dtype == float and x.flags.c_contiguous for x in found.values())
    assert sorted(checked.samples_of("invert", (y, dy, dy), None, SIZES, real, False)) == [
        "ddy",
        "dy",
        "y",
    ]
    several = tuple(np.tile(x, (3, 1, 1)) for x in (y, dy, dy))
    many = checked.samples_of("invert_many", several, None, SIZES, real, False, problems=True)
    assert many["y"].shape == (3, 5, 12) and many["ddy"].shape == (3, 5, 6)
    assert checked.samples_of("invert_many", (y, dy, dy), None, SIZES, real, False, problems=True)[
        "y"
    ].shape == (5, 12)
    for path, force, several_problems, text in (
        ((y, dy[:4], dy), None, False, "f, dy: given shape (4, 6), expected (5, 6)"),
        ((y, dy, dy[:, :5]), None, False, "f, ddy: given shape (5, 5), expected (5, 6)"),
        ((y[:, :3], dy, dy), None, False, "f, y: given shape (5, 3), expected (5, 12)"),
        ((y[0], dy, dy), None, False, "f, y: given shape (12,), expected (n, 12)"),
        (several, None, False, "f, y: given shape (3, 5, 12), expected (n, 12)"),
        (
            (y[0], dy, dy),
            None,
            True,
            "f, y: given shape (12,), expected (problems, n, 12) or (n, ...)",
        ),
        ((several[0], dy, dy), None, True, "f, dy: given shape (5, 6), expected (3, 5, 6)"),
        ((y, dy, dy), push[:, :6], False, "f, force: given shape (5, 6), expected (5, 18)"),
    ):
        with pytest.raises(ArgumentError) as caught:
            checked.samples_of("f", path, force, SIZES, real, True, several_problems)
        assert str(caught.value) == text
    with pytest.raises(
        ArgumentError,
        match=r'^f, force: given to a library without forces, expected .*parts=\["force"\]',
    ):
        checked.samples_of("f", (y, dy, dy), push, SIZES, real, False)
    huge = checked.array_of("f", "y", [1e300, -1e39], None, np.dtype(np.float32))
    assert huge.dtype == np.float32 and huge.tolist() == [np.inf, -np.inf]


def test_holds_of_an_inversion_have_a_number_and_a_delay() -> None:
    interface: Any = SimpleNamespace(
        enums={"hold": ("spline", "zoh", "linear")}, limits={"HOLD_DELAY_MAX": 64}
    )
    assert checked.hold_of(interface, "f", "spline", 0) == {"hold": 0, "delay": 0.0}
    assert checked.hold_of(interface, "f", "linear", 64) == {"hold": 2, "delay": 64.0}
    for hold, delay, text in (
        ("cubic", 0.0, "f, hold: given 'cubic', expected one of spline, zoh, linear"),
        (
            "zoh",
            -0.1,
            (
                "f, delay: given -0.1 samples, expected 0 to 64; for a longer delay give the "
                "path earlier"
            ),
        ),
        (
            "zoh",
            64.5,
            (
                "f, delay: given 64.5 samples, expected 0 to 64; for a longer delay give the "
                "path earlier"
            ),
        ),
        ("zoh", np.nan, "f, delay: given nan samples, expected 0 to 64"),
        ("zoh", "1", "f, delay: given '1', expected a number"),
    ):
        with pytest.raises(ArgumentError) as caught:
            checked.hold_of(interface, "f", hold, delay)
        assert str(caught.value).startswith(text)
