"""Which states the outputs of an observer determine: two masses and a spring, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexgen.base.errors import ArgumentError
from flexgen.feedback.observers.design import check_observable, record, vector

STATES = ("q", "m", "v_q", "v_m", "d_m")  # arm and motor, their speeds, and a torque on the motor


def check(
    outputs: list[list[float]],
    stiffness: float = 50.0,
    ground: float = 0.0,
    damping: float = 0.1,
    torques: int = 1,
) -> None:
    """Two masses of 1 with a spring between them, another one from the arm to the ground, and
    dampers.
    """
    M = np.eye(2)
    K = np.array([[stiffness + ground, -stiffness], [-stiffness, stiffness]])
    D = damping * np.array([[1.0, -1.0], [-1.0, 1.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    at: Any = SimpleNamespace(A=A, B=np.array([[0.0], [0.0], [0.0], [1.0]]), C=np.array(outputs))
    model = SimpleNamespace(n_a=1, eta=np.array([[1.0]]), i_m=(0,))
    names = tuple(f"y{k}" for k in range(len(outputs)))
    channels: Any = SimpleNamespace(model=model, index=np.arange(len(outputs)), names=names)
    noises: Any = SimpleNamespace(largest=np.array([20.0]))
    check_observable(at, channels, STATES, noises, torques)


def test_a_motor_angle_determines_the_arm_behind_its_spring() -> None:
    check([[0.0, 1.0, 0.0, 0.0]])
    check([[0.0, 1.0, 0.0, 0.0]], ground=30.0)
    check([[1.0, 0.0, 0.0, 0.0]])
    check([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])  # another output that shows nothing
    check([[0.0, 1.0, 0.0, 0.0]], torques=0)


def test_states_that_no_output_shows_are_named() -> None:
    """An arm without a spring; places where speeds alone are seen; a torque that a spring to the
    ground hides.
    """
    with pytest.raises(
        ArgumentError,
        match=r"^outputs: given y0, which do not determine q; measure more, such as all m",
    ):
        check([[0.0, 1.0, 0.0, 0.0]], stiffness=0.0, damping=0.0)
    with pytest.raises(
        ArgumentError, match=r"^outputs: given y0, y1, which do not determine q, m; measure more"
    ):
        check([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], torques=0)
    with pytest.raises(ArgumentError, match=r"which do not determine q, m, d_m; measure more"):
        check([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], ground=30.0)


def test_what_decays_by_itself_need_not_be_seen() -> None:
    """An arm that its own spring and damper bring to rest, without a connection to the motor."""
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2, 0] = -400.0
    A[2, 2] = -30.0
    model = SimpleNamespace(n_a=1, eta=np.array([[100.0]]), i_m=(0,))
    channels: Any = SimpleNamespace(model=model, index=np.array([0]), names=("motor",))
    noises: Any = SimpleNamespace(largest=np.array([20.0]))
    at: Any = SimpleNamespace(
        A=A, B=np.array([[0.0], [0.0], [0.0], [1.0]]), C=np.array([[0.0, 1.0, 0.0, 0.0]])
    )
    check_observable(at, channels, STATES, noises, 1)
    A[2, 2] = 0.0
    with pytest.raises(ArgumentError, match=r"which do not determine q, v_q; measure more"):
        check_observable(at, channels, STATES, noises, 1)


def test_arguments_of_observers_have_their_shapes() -> None:
    assert vector("x", [1, 2], 2).tolist() == [1.0, 2.0] and record(
        "y", [[1, 2]], 1, 2
    ).tolist() == [[1.0, 2.0]]
    for wrong in ([1.0], [[1.0, 2.0]], [1.0, np.inf]):
        with pytest.raises(
            ArgumentError, match=r"^x: given shape \(.*\), expected \(2,\), finite numbers$"
        ):
            vector("x", wrong, 2)
    with pytest.raises(ArgumentError, match=r"^y: given shape \(2,\), expected \(1, 2\)$"):
        record("y", [1.0, 2.0], 1, 2)
