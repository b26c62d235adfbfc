"""Responses of robots with errors: the same equations by another method of integration, and by
steps half as long.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from flexgen.studies.tolerances import response as responses

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


def along(steps: int) -> Any:
    t = np.linspace(0.0, END, steps + 1)
    M, D, K = (np.array(x) for x in zip(*(of_time(x) for x in t), strict=True))
    feedback = Made(rows=C, speed_gain=K_S, position_gain=K_P, integral_gain=K_I)
    varying = {1: tuple(s * t[:, None, None] * np.diag([1.0, 2.0, 1.0, 0.5]) for s in VARYING)}
    made = Made(
        t=t,
        M=M,
        D=D,
        K=K,
        B=np.tile(B, (len(t), 1, 1)),
        feedback=feedback,
        states=(),
        constant=CONSTANT,
    )
    made.force = np.array([forces(x) for x in t]).transpose(1, 0, 2)
    made.W = np.tile(W, (len(t), 1, 1))
    made.twist = TWIST
    made.varying = varying
    made.linear = np.array([True, True])
    made.late = lambda errors: np.array([late(x, errors) for x in t])
    return made


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


def test_responses_of_robots_are_those_of_their_own_equations() -> None:
    """The error of the method falls with the square of the step."""
    errors = np.array([[0.3, -0.5], [-0.2, 0.4]])
    found = [responses.response(along(steps), errors) for steps in (100, 200)]
    for robot, error in enumerate(errors):
        for name, expected in zip(
            ("error", "tau_m", "deflection"), exact(error, False), strict=True
        ):
            coarse, fine = (
                getattr(x, name)[:: n // 20, robot] for x, n in zip(found, (100, 200), strict=True)
            )
            size = np.abs(expected).max()
            assert np.abs(coarse - expected).max() <= 8e-3 * size
            assert np.abs(fine - expected).max() <= 0.3 * np.abs(coarse - expected).max() + 1e-9


def test_responses_to_first_order_are_those_of_the_model() -> None:
    found = [responses.linear_response(along(steps)) for steps in (100, 200)]
    for source in range(2):
        for name, expected in zip(
            ("error", "tau_m", "deflection"), exact(np.eye(2)[source], True), strict=True
        ):
            coarse, fine = (
                getattr(x, name)[:: n // 20, source]
                for x, n in zip(found, (100, 200), strict=True)
            )
            assert np.abs(coarse - expected).max() <= 8e-3 * np.abs(expected).max()
            assert np.abs(fine - expected).max() <= 0.3 * np.abs(coarse - expected).max() + 1e-9


def test_an_element_with_a_state_acts_with_its_torque_and_its_slope() -> None:
    """A spring on the first mass as such an element: the same as in the matrices."""

    class Spring:
        def __init__(self) -> None:
            self.kept: list[np.ndarray] = []

        def start(self, d: np.ndarray) -> None:
            self.kept.append(d)

        def at(self, k: int, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            K = 90.0 * np.diag([1.0, 0.0, 0.0, 0.0])
            return d @ K, np.tile(K, (len(d), 1, 1))

        def keep(self, k: int, d: np.ndarray) -> None:
            assert k == len(self.kept)
            self.kept.append(d)

    made = along(100)
    stiffer = along(100)
    spring = Spring()
    made.force[:, 0, :] = stiffer.force[:, 0, :] = 0.0  # at rest the spring is not bent
    made.states = (Made(linear=lambda: spring),)
    stiffer.K = stiffer.K + 90.0 * np.diag([1.0, 0.0, 0.0, 0.0])
    found, expected = (responses.linear_response(x) for x in (made, stiffer))
    assert_allclose(found.error, expected.error, rtol=1e-9, atol=1e-12)
    assert_allclose(found.tau_m, expected.tau_m, rtol=1e-9, atol=1e-12)
    assert len(spring.kept) == 101 and not spring.kept[0].any()
