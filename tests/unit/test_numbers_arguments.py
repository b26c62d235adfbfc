"""Arguments at the edges of their ranges: numbers, seeds, plants of a loop, gains of a cascade, ends of a process."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.benchmarks.foreign import ForeignController
from flexgen.errors import ArgumentError
from flexgen.loop import plants
from flexgen.loop.controllers import Cascade
from flexgen.loop.interface import Setup
from flexgen.model.overlay import _Overlay
from flexgen.servo import command
from flexgen.spec import arguments


def test_numbers_are_real_and_finite() -> None:
    for value in (0, 1.5, -2, np.float64(3.0), np.int32(4), np.array(5.0), Fraction(1, 2), 10**300):
        assert arguments.is_number(value)
    for value in (True, np.bool_(True), "1", None, np.nan, np.inf, np.array([1.0]), 1j, Decimal(1), 10**400):
        assert not arguments.is_number(value)
    assert arguments.is_whole(1) and arguments.is_whole(np.int64(7)) and arguments.is_whole(2**31 - 1)
    for value in (0, True, 1.0, "1", 2**31, np.float64(2.0)):
        assert not arguments.is_whole(value)
    assert arguments.is_whole(0, 0) and arguments.is_whole(3, 3, 3) and not arguments.is_whole(4, 3, 3)


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
        arguments.seed_of(0) == 0 and arguments.seed_of(np.int64(5)) == 5 and arguments.seed_of(2**63 - 1) == 2**63 - 1
    )
    for value in (-1, 1.0, True, 2**63):
        with pytest.raises(ArgumentError, match=r"^seed: given .*, expected a whole number >= 0$"):
            arguments.seed_of(value)
    given = {"a": 1}
    assert arguments.mapping_of("m", given, "x") == given and arguments.mapping_of("m", given, "x") is not given
    with pytest.raises(ArgumentError, match=r"^m: given \[1\], expected a table$"):
        arguments.mapping_of("m", [1], "a table")


def test_numbers_of_plants_are_factors_and_added_loads() -> None:
    """Of a kind all forces of it; of a payload what is added, down to none, and where it is."""
    model = flexgen.read("manutec_r3")
    found = plants.plants_of(model, {"a": {"stiffness": 0.8, "payload": -15.0}, "b": {}, "c": {"q1.stiffness": 2.0}})
    names = [p.name for p in found.parameters]
    nominal = {p.name: p.value for p in found.parameters}
    assert found.names == ("a", "b", "c") and found.values.shape == (3, len(names))
    assert nominal["payload.mass"] == 15.0 and {"q1.stiffness", "q2.stiffness", "q3.stiffness"} <= set(names)
    rows = [dict(zip(names, row, strict=True)) for row in found.values.tolist()]
    assert rows[0]["payload.mass"] == 0.0 and rows[1] == nominal
    assert_allclose([rows[0][x] / nominal[x] for x in ("q1.stiffness", "q3.stiffness")], 0.8)
    assert rows[2]["q1.stiffness"] == 2 * nominal["q1.stiffness"] and rows[2]["q2.stiffness"] == nominal["q2.stiffness"]
    place = ", ".join(f"{x:g}" for x in model.payload.com)
    where = "tool" if model.payload.com == model.tool.position else "center of mass of the payload"
    assert found.loads == (f"-15 kg at the {where}, [{place}] m in the frame of the last tip", "", "")
    for com, words in (((0.0, 0.0, 0.5), "at the tool"), ((0.0, 0.0, 0.4), "at the center of mass of the payload")):
        arm: Any = SimpleNamespace(payload=SimpleNamespace(com=com), tool=SimpleNamespace(position=(0.0, 0.0, 0.5)))
        assert plants._load(arm, 2.5) == f"+2.5 kg {words}, [0, 0, {com[2]:g}] m in the frame of the last tip"
    for changes, message in (
        ({"payload": -15.1}, "plant a, payload: given -15.1 kg, expected -15 to 100000 kg to add to the payload"),
        ({"payload": 1.1e5}, "plant a, payload: given 110000.0 kg, expected -15 to 100000 kg to add to the payload"),
        ({"stiffness": -0.1}, "plant a, stiffness: given the factor -0.1, expected 0 to 100"),
        ({"stiffness": 100.1}, "plant a, stiffness: given the factor 100.1, expected 0 to 100"),
        ({"stiffness": "x"}, "plant a, stiffness: given 'x', expected a number"),
        ({"lost_motion": 2.0}, "plant a, lost_motion: the model manutec_r3 has no number of this kind"),
    ):
        with pytest.raises(ArgumentError) as caught:
            plants.plants_of(model, {"a": changes})
        assert str(caught.value) == message
    edges = plants.plants_of(model, {"a": {"stiffness": 100.0, "payload": 1e5}, "b": {"damping": 0.0}})
    assert edges.values.max() > 0 and edges.loads[0].startswith("+100000 kg ")
    with pytest.raises(
        ArgumentError, match=r"^plant a, payload.mass: the model elbow has no number of this kind but 0$"
    ):
        plants.plants_of(flexgen.read("elbow"), {"a": {"payload.mass": 50.0}})  # a factor on it changes nothing
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
    each = compiled(speed_gain=np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), torque_max=np.array([7.0, 8.0]))
    rows = np.ascontiguousarray(each.memory).view(float).reshape(3, -1)
    assert_allclose(rows[:, 6:8], [[1, 2], [3, 4], [5, 6]])
    assert_allclose(rows[:, 10:12], np.tile([7, 8], (3, 1)))
    for name in ("position_gain", "speed_gain", "integral_gain", "torque_max"):
        for wrong in (np.ones(3), np.ones((2, 2)), np.ones((3, 3))):
            with pytest.raises(
                ArgumentError, match=rf"(?s)^controller, {name}: given .*, expected 2 finite numbers, one for"
            ):
                compiled(**{name: wrong})


def test_limits_that_commands_reach_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Speeds by first differences, accelerations by second ones; where one is reached the samples are fitted again."""
    samples = np.array([[0.0, 0.0], [1.0, 0.5], [3.0, 1.0], [4.0, 1.5]])
    monkeypatch.setattr(command, "fit_samples", lambda B, r: samples)
    monkeypatch.setattr(command, "fit_within", lambda B, r, period, limits: samples + 1.0)
    names, h, B = ["q1", "q2"], 0.5, None

    def fit(speed: Any, acceleration: Any) -> tuple[bool, tuple[str, ...]]:
        limits = (None if speed is None else np.array(speed), None if acceleration is None else np.array(acceleration))
        found, active = command._fit(B, samples, h, limits, names)  # type: ignore[arg-type]
        return bool(found[0, 0]), active

    assert fit(None, None) == (False, ()) and fit([4.0, 1.0], [4.0, 1e-9]) == (False, ())
    assert fit([3.9, 0.9], None) == (True, ("speed of q1", "speed of q2"))
    assert fit([4.0, 1.0], [3.9, 1.0]) == (True, ("acceleration of q1",))
    assert fit([3.0, 9.0], [3.0, 9.0]) == (True, ("speed of q1", "acceleration of q1"))


def test_the_end_of_a_process_is_described() -> None:
    made: Any = object.__new__(ForeignController)
    made._failure, made._process = "late", None
    assert made._describe_end() == "late"
    made._failure = ""
    assert made._describe_end() == "the controller's process ended"
    made._process = SimpleNamespace(poll=lambda: 3, wait=lambda seconds: 3)
    assert made._describe_end() == "the controller's process ended with code 3"
    made._process = SimpleNamespace(poll=lambda: None, wait=lambda seconds: 1 / 0)
    assert made._describe_end() == "the controller's process ended"


def test_a_mimic_of_a_urdf_file_counts_where_the_overlay_has_no_gear_or_spring() -> None:
    made: Any = object.__new__(_Overlay)
    segment: Any = SimpleNamespace(joint=SimpleNamespace(name="j"))
    made.urdf = SimpleNamespace(mimic=lambda joint: found, file="arm.urdf")
    made._find_name = lambda kind, name: f"{kind} {name}"
    found: Any = (7, "other", 2.0)

    class Table(dict[str, Any]):
        entries = {"mimic": "own"}  # noqa: RUF012

    for table, expected in ((None, True), (Table(), True), (Table(gear=1), False), (Table(spring=1), False)):
        made.joints = {} if table is None else {"j": table}
        entry = made._mimic(segment)
        assert (entry is not None) == expected
        if entry is not None:
            assert {k: v.value for k, v in entry.value.items()} == {"joint other": 2.0} and entry.line == 7
    made.joints = {"j": Table(mimic=1, gear=1)}
    assert made._mimic(segment) == "own"
    made.joints, found = {}, None
    assert made._mimic(segment) is None
