"""Options of the servo of a library, and positions for the robot, by an entry that is made up."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError, SolverError
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


OWN = "with a servo, expected its own"
REFUSED: dict[str, tuple[Any, float, str, float, str]] = {
    "hold": (True, 4e-3, "foh", 0, f"hold: given 'foh' and a delay of 0 {OWN}"),
    "delay": (True, 4e-3, "zoh", 0.5, f"hold: given 'zoh' and a delay of 0.5 {OWN}"),
    "a number": (3, 4e-3, "zoh", 0, "servo: given 3, expected True or a mapping of its members"),
    "a member": ({"gain": 1.0}, 4e-3, "zoh", 0, "servo: given 'gain', expected one of "),
    "period": (
        True,
        5e-3,
        "zoh",
        0,
        "period: given samples of the results 0.005 s apart, expected 0.004 s, the",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_options_that_a_servo_does_not_have(name: str) -> None:
    *given, text = REFUSED[name]
    with pytest.raises(ArgumentError) as refused:
        entry().options("invert", *given)
    assert str(refused.value).startswith(f"invert, {text}")


def test_a_library_without_positions_has_no_servo() -> None:
    text = "invert, servo: given to a library without positions, expected one that"
    with pytest.raises(ArgumentError, match=text):
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
