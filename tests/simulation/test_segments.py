"""Motions in C under recorded inputs: a linear system by its exponential; order of the steps."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from toolchain import needs_compiler

from flexgen.base.errors import SolverError
from flexgen.simulation.integration.segments import Segments

pytestmark = needs_compiler

A = np.array([[0.0, 1.0], [-40.0, -0.8]])
B = np.array([[0.0], [2.0]])
SAMPLE = 0.05
SAMPLES = 20
ROWS = np.array([[3.0, 0.0], [1.0, -2.0], [0.0, 0.5]])


def rate() -> ca.Function:
    """``x' = p A x + B u``."""
    x = ca.SX.sym("x", 2)
    u = ca.SX.sym("u", 1)
    p = ca.SX.sym("p", 1)
    return ca.Function("oscillator", [x, u, p], [p * (ca.DM(A) @ x) + ca.DM(B) @ u])


def held(steps: int, levels: np.ndarray) -> np.ndarray:
    """Inputs (sets, steps, 3, 1) that are constant."""
    return np.tile(levels[:, None, None, None], (1, SAMPLES * steps, 3, 1))


def exact(start: np.ndarray, u: float, p: float) -> np.ndarray:
    """States at the samples under a constant input."""
    rest = np.linalg.solve(p * A, -B[:, 0] * u)
    states = [rest + expm(p * A * SAMPLE * k) @ (start - rest) for k in range(SAMPLES + 1)]
    return np.array(states)


LEVELS = np.array([1.5, -4.0])
STARTS = np.random.default_rng(0).normal(size=(5, 2))
SETS = np.array([0, 1, 1, 0, 1])
OFFSETS = np.linspace(-1.0, 1.0, 5)[:, None]
FACTORS = np.linspace(0.5, 1.5, 5)[:, None]


def simulated(segments: Segments, steps: int, **more: Any) -> np.ndarray:
    return segments(STARTS, held(steps, LEVELS), SETS, OFFSETS, FACTORS, **more)


def test_each_robot_has_its_start_input_offset_and_parameters() -> None:
    """Outputs are rows times the state, or a function; states are there where they are asked
    for.
    """
    expected = np.array(
        [
            exact(STARTS[k], LEVELS[SETS[k]] + OFFSETS[k, 0], FACTORS[k, 0])
            for k in range(len(STARTS))
        ]
    )
    made = Segments(rate(), ROWS, SAMPLE, 40)
    states = simulated(made, 40, states=True)
    assert states.shape == (5, SAMPLES + 1, 2)
    assert_allclose(states, expected, atol=1e-7)
    assert_allclose(simulated(made, 40), expected @ ROWS.T, atol=1e-6)
    x, u, p = (ca.SX.sym(name, n) for name, n in (("x", 2), ("u", 1), ("p", 1)))
    shown = ca.Function("shown", [x, u, p], [ca.DM(ROWS) @ x])
    assert_allclose(
        simulated(Segments(rate(), shown, SAMPLE, 40), 40), expected @ ROWS.T, atol=1e-6
    )


def test_the_error_falls_with_the_fourth_power_of_the_step() -> None:
    made = Segments(rate(), ROWS, SAMPLE, 2)
    fine = simulated(made.with_steps(16), 16, states=True)
    errors = [np.abs(simulated(made.with_steps(n), n, states=True) - fine).max() for n in (2, 4)]
    assert made.steps == 2 and errors[0] / errors[1] == pytest.approx(16.0, rel=0.2)


def test_states_that_are_not_finite_are_an_error() -> None:
    made = Segments(rate(), ROWS, SAMPLE, 2)
    start = STARTS.copy()
    start[3, 0] = np.nan
    with pytest.raises(SolverError, match="segments: the simulated motion is not finite"):
        made(start, held(2, LEVELS), SETS, OFFSETS, FACTORS)
