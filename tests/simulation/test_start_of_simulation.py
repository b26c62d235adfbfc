"""Laws, referees and refused input of `flexgen.simulation.start`."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.simulation import start


def test_speeds_of_the_start_come_from_the_first_sample_or_are_zero() -> None:
    robot = flexgen.read("elbow")
    names_a = [c.name for c in robot.coordinates]
    names_m = [robot.motors[j].name for j in robot.i_m]

    def data(unit: str = "rad/s", value: float = 2.0, names: list[str] = names_a[::-1]) -> Any:
        labels = {"v_a": tuple(names), "v_m": tuple(names_m)}
        columns = {
            "v_a": np.array([[float(k), value] for k in (1, 5)]),
            "v_m": np.full((2, len(names_m)), 9.0),
        }
        ports = {
            k: Port(k, (len(x),), unit if k == "v_a" else "rad/s", "") for k, x in labels.items()
        }
        return Trajectory(np.array([0.0, 1.0]), columns, ports, labels, {})

    given = {"q_a": np.array([[0.1, 0.2]]), "q_m": np.array([[3.0, 4.0]])}

    def speeds(trajectory: Trajectory, moving: bool) -> list[float]:
        return start.start_state(robot, trajectory, given, None, moving)[robot.dof :].tolist()

    assert speeds(data(), False) == [0.0] * robot.dof
    assert speeds(data(), True) == [2.0, 1.0] + [9.0] * len(names_m)
    assert speeds(data("rad/s or m/s"), True)[:2] == [2.0, 1.0]
    for wrong, words in (
        (data("deg/s"), rf"moving: given v_a in deg/s, expected rad/s \(column {names_a[0]}\)"),
        (data(value=np.inf), "moving: given speeds that are not finite, expected finite numbers"),
        (
            data(names=["a", "b"]),
            f"moving: the trajectory has no channel v_a of {robot.name}, expected its speeds",
        ),
    ):
        with pytest.raises(ArgumentError, match=words):
            speeds(wrong, True)
    rest: Any = Made(q_a=np.array([7.0, 8.0]), q_m=np.array([5.0, 6.0]))
    i_m = list(robot.i_m)
    assert start.start_state(robot, data(), given, None, False).tolist()[: robot.dof] == [
        0.1,
        0.2,
        *given["q_m"][0][i_m],
    ]
    assert start.start_state(robot, data(), given, rest, False).tolist()[: robot.dof] == [
        7.0,
        8.0,
        *rest.q_m[i_m],
    ]
