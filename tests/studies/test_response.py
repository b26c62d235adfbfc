"""Responses of robots with errors: the same equations by another method of integration, and by
steps half as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hysteretic import BENT, with_elements
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.motor_feedback import MotorFeedback
from flexgen.studies.tolerances.response import (
    Along,
    Response,
    knots_of,
    linear_response,
    linearize,
    response,
)
from flexgen.studies.tolerances.sources import sources_of

END = 0.4
C = np.array([[0.0, 0.0, 3.0, 0.0], [0.0, 0.0, 0.0, 2.0]])  # motors behind springs of two masses
B = np.vstack([np.zeros((2, 2)), np.diag([3.0, 2.0])])
K_S = np.array([2.0, 1.5])
K_P = np.array([12.0, 9.0])
K_I = np.array([7.0, 5.0])
SPRINGS = np.array(
    [[400.0, -100.0, -300.0, 0.0], [-100.0, 350.0, 0.0, -250.0], [-300.0, 0.0, 300.0, 0.0]]
)
SPRINGS = np.vstack([SPRINGS, [0.0, -250.0, 0.0, 250.0]])
W = np.array([[1.0, 0.4, 0.0, 0.0], [0.0, 1.0, 0.1, 0.0], [0.2, 0.0, 0.0, 1.0]])
TWIST = np.array([[1.0, 0.0, -1.0, 0.0]])


def of_time(t: float) -> Any:
    """M, D and K of the model at an instant."""
    M = np.diag([2.0 + t, 1.5, 0.5, 0.4]) + 0.2 * np.cos(3 * t) * (
        np.eye(4, k=1) + np.eye(4, k=-1)
    )
    return M, 0.02 * SPRINGS * (1 + t), SPRINGS + 40 * t * np.eye(4)


def forces(t: float) -> np.ndarray:
    """Of two sources."""
    return np.array(
        [[np.sin(7 * t) + 1.0, t, 0.5, -0.3], [np.cos(5 * t), 0.2, -t, 1.0 + np.sin(t)]]
    )


def late(t: float, errors: np.ndarray) -> np.ndarray:
    return np.outer(errors[:, 0] * 0.7, [0.0, 0.3, np.sin(9 * t), 1.0])


CONSTANT = tuple(0.1 * s * np.array([np.eye(4), np.zeros((4, 4))]) for s in (1.0, 20.0, 300.0))
VARYING = (0.05, 2.0, 60.0)  # of the second source, times t and a matrix


def along(steps: int, stiffer: float = 0.0, states: tuple[Any, ...] = ()) -> Along:
    """The equations in equal steps; ``stiffer``: a spring [N m/rad] more on the first mass."""
    t = np.linspace(0.0, END, steps + 1)
    M, D, K = (np.array(x) for x in zip(*(of_time(x) for x in t), strict=True))
    K[:, 0, 0] += stiffer
    grown = t[:, None, None] * np.diag([1.0, 2.0, 1.0, 0.5])
    return Along(
        t=t,
        M=M,
        D=D,
        K=K,
        B=np.tile(B, (len(t), 1, 1)),
        force=np.array([forces(x) for x in t]).transpose(1, 0, 2),
        constant=CONSTANT,
        varying={1: (VARYING[0] * grown, VARYING[1] * grown, VARYING[2] * grown)},
        squares={},
        feedback=MotorFeedback(C, K_P, K_S, K_I, {}),
        W=np.tile(W, (len(t), 1, 1)),
        units=("m", "m", "m"),
        twist=TWIST,
        springs=("q1",),
        motors=("m1", "m2"),
        motion={},
        states=states,
        linear=np.array([True, True]),
        late=lambda errors: np.array([late(x, errors) for x in t]),
    )


def exact(errors: np.ndarray, first_order: bool) -> Any:
    """Errors, torques and deflections at the end of each twentieth of the time, of one robot."""

    def matrices(t: float) -> Any:
        if first_order:
            return of_time(t)
        changes = [
            errors[0] * x[0] + errors[1] * s * t * np.diag([1.0, 2.0, 1.0, 0.5])
            for x, s in zip(CONSTANT, VARYING, strict=True)
        ]
        return tuple(x + y for x, y in zip(of_time(t), changes, strict=True))

    def force(t: float) -> np.ndarray:
        return np.asarray(errors @ forces(t) + (0.0 if first_order else late(t, errors[None])[0]))

    def torque(x: np.ndarray) -> np.ndarray:
        d = x[:4]
        v = x[4:8]
        total = x[8:]
        return np.asarray(K_S * (-K_P * (C @ d) - C @ v + K_I * total))

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        M, D, K = matrices(t)
        d = x[:4]
        v = x[4:8]
        return np.concatenate(
            [
                v,
                np.linalg.solve(M, B @ torque(x) - force(t) - D @ v - K @ d),
                -K_P * (C @ d) - C @ v,
            ]
        )

    rest = np.linalg.solve(
        np.block([[matrices(0.0)[2], -B], [C, np.zeros((2, 2))]]),
        np.concatenate([-force(0.0), [0, 0]]),
    )
    begin = np.concatenate([rest[:4], np.zeros(4), rest[4:] / (K_S * K_I)])
    x = solve_ivp(
        rate,
        (0.0, END),
        begin,
        t_eval=np.linspace(0.0, END, 21),
        method="DOP853",
        rtol=1e-7,
        atol=1e-10,
    ).y.T
    return x[:, :4] @ W.T, np.array([torque(row) for row in x]), x[:, :4] @ TWIST.T


def assert_second_order(found: list[Response], robot: int, expected: Any) -> None:
    """Of 100 and 200 steps: near, and with a quarter of the error where the step is half as
    long.
    """
    for name, right in zip(("error", "tau_m", "deflection"), expected, strict=True):
        coarse, fine = (getattr(x, name)[:: len(x.error) // 20, robot] for x in found)
        size = np.abs(right).max()
        assert np.abs(coarse - right).max() <= 8e-3 * size
        assert np.abs(fine - right).max() <= 0.3 * np.abs(coarse - right).max() + 1e-9


def test_responses_of_robots_are_those_of_their_own_equations() -> None:
    errors = np.array([[0.3, -0.5], [-0.2, 0.4]])
    found = [response(along(steps), errors) for steps in (100, 200)]
    for robot, error in enumerate(errors):
        assert_second_order(found, robot, exact(error, False))


def test_responses_to_first_order_are_those_of_the_model() -> None:
    found = [linear_response(along(steps)) for steps in (100, 200)]
    for source in range(2):
        assert_second_order(found, source, exact(np.eye(2)[source], True))


class Spring:
    """A spring on the first mass as an element with a state."""

    def __init__(self) -> None:
        self.kept: list[np.ndarray] = []

    def linear(self) -> Spring:
        return self

    def start(self, d: np.ndarray) -> None:
        self.kept.append(d)

    def at(self, k: int, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        K = 90.0 * np.diag([1.0, 0.0, 0.0, 0.0])
        return d @ K, np.tile(K, (len(d), 1, 1))

    def keep(self, k: int, d: np.ndarray) -> None:
        assert k == len(self.kept)
        self.kept.append(d)


def test_an_element_with_a_state_acts_with_its_torque_and_its_slope() -> None:
    """Stiffness as in the matrices; at rest the spring is not bent."""
    spring = Spring()
    with_state = along(100, states=(spring,))
    stiffer = along(100, stiffer=90.0)
    for made in (with_state, stiffer):
        made.force[:, 0, :] = 0.0
    found, expected = (linear_response(x) for x in (with_state, stiffer))
    assert_allclose(found.error, expected.error, rtol=1e-9, atol=1e-12)
    assert_allclose(found.tau_m, expected.tau_m, rtol=1e-9, atol=1e-12)
    assert len(spring.kept) == 101 and not spring.kept[0].any()


def test_instants_of_matrices_are_denser_where_the_arm_moves() -> None:
    """One of four parts of the weight is for the time, three for the speed; the ends are among
    them.
    """
    speed = np.zeros((1001, 2))
    speed[500:, 1] = -2.0
    found = knots_of(speed)
    assert found[0] == 0 and found[-1] == 1000 and len(found) == 60
    still = np.diff(found[found < 500])
    moving = np.diff(found[found >= 500])
    assert np.median(still) == pytest.approx(4 * np.median(moving), rel=0.15)
    assert knots_of(np.zeros((5, 1))).tolist() == [0, 1, 2, 3, 4]


def test_gears_with_hysteresis_follow_the_deflections_of_the_motion() -> None:
    """The motor less the joint on the arm side, in the steps of the response."""
    robot = with_elements("elbow", BENT, uncertainty={"stiffness": 0.1, "lost_motion": 0.3})
    equations = derive(robot)
    motion = flexgen.solve("elbow", "joints", verify=False, progress=False).trajectory
    found = linearize(equations, motion, sources_of(robot, robot.uncertainty))
    (gears,) = found.states
    given = motion.at(found.t)
    ratio = np.array([motor.ratio[0] for motor in robot.motors])
    twist = given["q_m"] / ratio - given["q_a"]
    assert_allclose(gears.p, twist, rtol=1e-9, atol=1e-12)
    assert_allclose(gears.rows, np.hstack([-np.eye(2), np.diag(1 / ratio)]))
    assert_allclose(found.motion["deflection"], twist, rtol=1e-9, atol=1e-12)
