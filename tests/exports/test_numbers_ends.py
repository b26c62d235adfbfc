"""Ends of paths in views, the home pose of a robot with mechanisms in MuJoCo, and the commands of
a feedforward.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.exports.fmu import feedforward
from flexgen.exports.mujoco import mujoco
from flexgen.simulation.environment.sense import shown_angles
from flexgen.views.reports import view


class Motion(dict[str, Any]):
    """A trajectory that was made up."""

    def __init__(self, **channels: Any) -> None:
        super().__init__(channels)
        self.time = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
        self.meta = {"model": "elbow", "variant": "soft"}


def test_the_end_of_a_path_is_where_its_reference_stays() -> None:
    rows = {
        1.0: [[0, 0], [0, 0], [1, 0], [1, 2], [1, 2]],
        2.0: [[0, 0], [0, 0], [1, 0], [1, 2], [1, 3]],
        0.5: [[1, 0], [2, 0], [0, 0], [0, 0], [0, 0]],
        0.0: [[0, 1], [0, 0], [0, 0], [0, 0], [0, 0]],
    }
    for end, y in rows.items():
        made: Any = Motion(y_ref=np.array(y, float))
        assert view._end(made) == end
    still: Any = Motion(y_ref=np.ones((5, 2)))
    none: Any = Motion()
    assert view._end(still) == 0.0 and view._end(none) == 2.0


def test_the_robot_of_a_trajectory_is_named_or_given(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def derive(what: Any) -> str:
        asked.append(what)
        if what == "none":
            raise ArgumentError("there is none")
        return "equations"

    monkeypatch.setattr(view, "derive", derive)
    made: Any = Motion()
    found: Any = (view._robot_of(made, None), view._robot_of(made, "mine"))
    assert found == ("equations", "equations") and asked == ["elbow@soft", "mine"]
    made.meta = {"model": "none", "variant": ""}
    with pytest.raises(ArgumentError) as refused:
        view._robot_of(made, None)
    assert str(refused.value) == (
        "view: the trajectory is of model 'none' (there is none), expected also its model "
        "(model= in Python, --robot on the command line)"
    )


def test_a_home_pose_has_mechanisms_and_rotors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each joint of the file in its order: coordinates, sums of coordinates, angles of
    motors.
    """
    root = Element("mujoco")
    for name in ("a", "sum", "rotor.m", "b"):
        SubElement(root, "joint", name=name)
    SubElement(root, "joint")
    added: list[Any] = []
    monkeypatch.setattr(
        mujoco, "add", lambda parent, tag, **given: added.append((tag, given)) or Made()
    )  # type: ignore[func-returns-value]
    monkeypatch.setattr(mujoco, "mechanisms", lambda model: {"sum": {"a": 2.0, "b": -0.5}})
    coordinates = [Made(name="a"), Made(name="b")]
    motors = [Made(name="m")]
    own: Any = Made(model=Made(coordinates=coordinates, motors=motors))
    rest: Any = Made(q_a=np.array([0.3, 4.0]), q_m=np.array([9.0]), tau_m=np.array([1.5]))
    (writer,) = [x for x in vars(mujoco).values() if isinstance(x, type) and hasattr(x, "_home")]
    writer._home(own, root, rest)
    assert [tag for tag, _ in added] == ["keyframe", "key"]
    key = added[1][1]
    assert key["name"] == "home" and key["ctrl"] is rest.tau_m
    assert_allclose(key["qpos"], [0.3, 2 * 0.3 - 0.5 * 4.0, 9.0, 4.0])


# --- motors --------------------------------------------------------------------------------------
def test_encoders_show_their_errors() -> None:
    error = {"harmonics": [2], "cos": [1e-3], "sin": [2e-3]}
    model = flexgen.read("elbow", overrides={"motor.m2.encoder_error": error})
    q = np.array([[0.5, 0.25], [1.0, -2.0]])
    shown = q[:, 1] + 1e-3 * np.cos(2 * q[:, 1]) + 2e-3 * np.sin(2 * q[:, 1])
    assert_allclose(shown_angles(model, q), np.stack([q[:, 0], shown], axis=1), rtol=1e-15)
    assert q[0, 1] == 0.25


@pytest.mark.parametrize("integral", [(0.0, 0.0), (5.0, 0.0)])
def test_a_servo_without_integral_part_is_commanded_ahead(integral: tuple[float, float]) -> None:
    """At rest it holds the torque by ``tau / (k_p k_v)`` on the motor side; joints turn by the
    inverse of the gears.
    """
    servo: Any = Made(position_gain=(20.0, 10.0), speed_gain=(0.5, 0.25), integral_gain=integral)
    names = [Made(name=name) for name in ("m1", "m2")]
    eta = np.array([[100.0, 0.0], [25.0, 50.0]])
    model: Any = Made(
        motors=names,
        coordinates=[
            Made(name="q1", unit="rad"),
            Made(name="e", unit="m"),
            Made(name="q2", unit="m"),
        ],
        i_g=(0, 2),
        eta=eta,
    )
    held: Any = Made(
        tau_m=np.array([4.0, -2.0]), q_m=np.array([50.0, 30.0]), q_a=np.array([0.5, 0.01, 0.4])
    )
    rows = feedforward._outputs(model, held, servo)
    assert [row.name for row in rows[:4]] == [
        "motor.m1.torque",
        "motor.m2.torque",
        "motor.m1.reference_angle",
        "motor.m2.reference_angle",
    ]
    assert [row.start for row in rows[:4]] == [4.0, -2.0, 50.0, 30.0]
    found = {row.name: (row.start, row.unit) for row in rows}
    offset = np.array([4.0 / 10.0 if integral[0] == 0.0 else 0.0, -2.0 / 2.5])
    expected = np.linalg.inv(eta) @ (held.q_m + offset)
    assert found["arm.q1.command"] == (pytest.approx(expected[0]), "rad")
    assert found["arm.q2.command"] == (pytest.approx(expected[1]), "m")
    assert found["arm.e.reference_position"] == (0.01, "m") and found["arm.e.reference_speed"] == (
        0.0,
        "m/s",
    )
    assert not any(
        row.name.endswith(".command") for row in feedforward._outputs(model, held, None)
    )
