"""Options of a servo in a library, circles and legs of moves, outputs of an exported plant, and
rings of angles.
"""

from __future__ import annotations

import ctypes
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from flexgen.analysis.printing.trigonometric import TrigonometricRing
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.exports.fmu import plant
from flexgen.model.format import format_tasks
from flexgen.runtime.streams.servo import ServoEntry, servo_options

ENUMS = {"hold": ("spline", "zoh"), "interpolation": ("linear", "cubic")}


class Fields(ctypes.Structure):
    """A servo with a gain for each motor."""

    _fields_ = (
        ("sample_time", ctypes.c_double),
        ("delay", ctypes.c_double),
        ("position_gain", ctypes.c_void_p),
    )


class Robot(ctypes.Structure):
    """Options of a robot in C: samples of a position, and interpolation."""

    _fields_ = (("samples_per_position", ctypes.c_int), ("interpolation", ctypes.c_int))


def entry(status: int = 0) -> ServoEntry:
    """Of two motors at 4 ms with a delay of 6 ms; its positions are every second command and the
    kind of curve.
    """

    def fit(commands: Any, count: Any, robot: Any, out: Any, work: Any, size: Any) -> int:
        given = ctypes.cast(robot, ctypes.POINTER(Robot)).contents
        n = count.value
        each = given.samples_per_position
        rows = np.ctypeslib.as_array(
            ctypes.cast(commands, ctypes.POINTER(ctypes.c_double)), (n, 3)
        )
        to = np.ctypeslib.as_array(
            ctypes.cast(out, ctypes.POINTER(ctypes.c_double)), ((n - 1) // each + 1, 3)
        )
        to[:] = rows[::each] + 100 * given.interpolation + size.value
        return status

    interface: Any = Made(enums=ENUMS, structs={"robot_interface": Robot, "servo": Fields})
    work: Any = lambda n, robot: 10 * n.value  # noqa: E731, as a function of a library
    failures: Any = {-3: (SolverError, "no answer")}
    return ServoEntry(
        interface, lambda: Fields(4e-3, 6e-3, None), 2, np.dtype(float), fit, work, failures
    )


def test_options_of_a_servo_have_its_hold_and_delay() -> None:
    """In samples of the servo; its members may be others than those of the model file."""
    made = entry()
    found = made.options("invert", True, 4e-3 * (1 + 1e-10), "zoh", 0)
    assert (found["hold"], found["delay"]) == (1, pytest.approx(1.5)) and found[
        "servo"
    ].position_gain is None
    assert made.sample_time == 4e-3 and servo_options(None, "invert", None, 1.0, "spline", 0) == {}
    mine = servo_options(
        made, "invert", {"position_gain": [3.0, 5.0], "delay": 8e-3}, 4e-3, "spline", 0
    )
    assert mine["delay"] == pytest.approx(2.0) and [x.tolist() for x in mine["servo"].kept] == [
        [3.0, 5.0]
    ]
    assert np.ctypeslib.as_array(
        (ctypes.c_double * 2).from_address(mine["servo"].position_gain)
    ).tolist() == [3.0, 5.0]
    for given, period, hold, delay, text in (
        (
            True,
            4e-3,
            "foh",
            0,
            "invert, hold: given 'foh' and a delay of 0 with a servo, expected its own",
        ),
        (
            True,
            4e-3,
            "zoh",
            0.5,
            "invert, hold: given 'zoh' and a delay of 0.5 with a servo, expected its own",
        ),
        (3, 4e-3, "zoh", 0, "invert, servo: given 3, expected True or a mapping of its members"),
        ({"gain": 1.0}, 4e-3, "zoh", 0, "invert, servo: given 'gain', expected one of "),
        (
            True,
            5e-3,
            "zoh",
            0,
            "invert, period: given samples of the results 0.005 s apart, expected 0.004 s, the",
        ),
    ):
        with pytest.raises(ArgumentError) as refused:
            made.options("invert", given, period, hold, delay)
        assert str(refused.value).startswith(text)
    with pytest.raises(
        ArgumentError,
        match=r"invert, servo: given to a library without positions, expected one that",
    ):
        servo_options(None, "invert", True, 4e-3, "zoh", 0)


def test_positions_for_a_robot_are_fewer_than_the_commands() -> None:
    """One for each block of samples, the first included."""
    commands = np.arange(21.0).reshape(7, 3)
    found = entry().samples("send", commands, 3, "cubic")
    assert_allclose(found, commands[::3] + 100 + 70)
    assert entry().samples("send", commands[:6], 3, "linear").shape == (2, 3)
    with pytest.raises(
        ArgumentError, match="send: given the interpolation 'quintic', expected linear, cubic"
    ):
        entry().samples("send", commands, 3, "quintic")
    with pytest.raises(SolverError, match="send: no answer"):
        entry(-3).samples("send", commands, 3, "linear")


class Table:
    """A table of a model file that refuses by its own words."""

    def __init__(self, *keys: str) -> None:
        self.keys = keys

    def __contains__(self, key: str) -> bool:
        return key in self.keys

    def fail(self, key: str, expected: str) -> Exception:
        return ValueError(f"{key}: {expected}")

    def unit_key(self, key: str) -> str:
        return f"{key}_deg"


def test_circles_and_legs_of_moves_are_checked() -> None:
    """A center is not on the axis; the last leg has no zone; speeds need the profile of the
    move.
    """
    table: Any = Table()

    def circle(*center: float) -> None:
        here: Any = Made(values={"center": center, "axis": (0.0, 0.6, 0.8)})
        format_tasks._check_circle(table, here)

    circle(0.1, 0.0, 0.0)
    circle(0.0, 1e-8, 0.0)
    circle(3e-9, 6.0, 8.0 + 1e-7)
    for center in ((0.0, 0.0, 0.0), (0.0, 6.0, 8.0), (1e-9, 0.6, 0.8)):
        with pytest.raises(
            ValueError, match="center: a center that is not on the axis through the start"
        ):
            circle(*center)
    format_tasks._check_angle(table, Made(values={"angle": -0.1}))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="angle_deg: an angle that is not 0"):
        format_tasks._check_angle(table, Made(values={"angle": 0.0}))  # type: ignore[arg-type]
    for keys, last, outer, text in (
        (("zone",), False, {}, None),
        ((), True, {}, None),
        (("zone",), True, {}, "zone: no zone in the last leg"),
        (("speed",), False, None, None),
        (("speed",), False, {"profile": 1}, None),
        (("speed",), False, {}, "speed: no speed, or a profile of the move"),
    ):
        given: Any = Table(*keys)
        here: Any = Made(last=last, outer=outer)
        if text is None:
            format_tasks._check_leg(given, here)
            continue
        with pytest.raises(ValueError, match=text):
            format_tasks._check_leg(given, here)
    for output, check, text in (
        (
            "joint",
            format_tasks._needs_tool,
            "type: joint or output_line, because the output is not the tool's position",
        ),
        (
            "tool_pose",
            format_tasks._needs_outputs,
            "type: joint or tool_line, because the output is the tool's position",
        ),
    ):
        of_file: Any = Made(of_file=lambda key, output=output: Made(type=output))
        with pytest.raises(ValueError, match=text):
            check(given, of_file)
        kind = "joint" if output == "tool_pose" else "tool_position"
        other: Any = Made(of_file=lambda key, kind=kind: Made(type=kind))
        check(given, other)


def test_outputs_of_a_plant_have_the_deflections_of_all_coordinates() -> None:
    """Of an elastic gear the motor less the arm, of a rigid one zero, of a passive coordinate
    itself.
    """
    gear = [Made(rigid=False), Made(rigid=True)]
    coordinates = [Made(dof=Made(gear=gear[0])), Made(dof=None), Made(dof=Made(gear=gear[1]))]
    model: Any = Made(
        eta=np.array([[100.0, 0.0], [50.0, 20.0]]), i_g=(0, 2), coordinates=coordinates
    )
    p = ca.SX([1.0, 2.0, 3.0])
    R = ca.SX(np.arange(9.0).reshape(3, 3))
    called = {"forward_kinematics": (p, R)}.__getitem__
    q_m = ca.SX([30.0, 40.0])
    v_m = ca.SX([5.0, 6.0])
    q_a = ca.SX([0.25, 0.7, 1.2])
    found = plant._output(model, called, q_m, v_m, q_a[[0, 2]], q_a, ca.SX([7.0, 8.0, 9.0]))
    values = np.array(ca.DM(found)).ravel()
    assert values[:7].tolist() == [30.0, 40.0, 5.0, 6.0, 1.0, 2.0, 3.0]
    assert values[7:16].tolist() == list(range(9)) and values[16:19].tolist() == [7.0, 8.0, 9.0]
    assert_allclose(values[19:], [0.3 - 0.25, 0.7, 0.0], atol=1e-15)


def test_a_ring_of_angles_has_their_sums_as_another_basis() -> None:
    """Unit vectors and sines are reduced to one square less."""
    a, b, x, y = sp.symbols("a b x y", real=True)
    plain = TrigonometricRing([x, y], [a, b], [(x, y)])
    assert plain._bases == [([[1, 0], [0, 1]], [[1, 0], [0, 1]])]
    sums = TrigonometricRing([x], [a, b], (), (), (), [[1, 0], [1, 1]])
    assert sums._bases[1] == ([[1, 0], [1, 1]], [[1, 0], [-1, 1]]) and len(sums._bases) == 2
    assert len(TrigonometricRing([x], [a, b], (), (), (), [[1, 0], [0, 1]])._bases) == 1
    assert plain.reduce(plain.sin(a) ** 2) == plain.one - plain.cos(a) ** 2
    assert plain.reduce(plain.element(y) ** 2) == plain.one - plain.element(x) ** 2
    assert (
        plain.element(-3 * x) == -3 * plain.element(x)
        and plain.element(sp.Rational(2, 3)) * 3 == 2 * plain.one
    )
