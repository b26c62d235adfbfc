"""Steps of BDF on a small robot: the equations are evaluated again with its differences."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from causal_cases import problem
from inversion_cases import question
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.errors import SolverError
from flexgen.inversion.comparison import bdf

ELBOW = "elbow"  # two coordinates, two damped gears


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_states_of_bdf_satisfy_the_equations_with_its_differences(order: int) -> None:
    """The first steps see equal states before the start; F is measured by the torque that would
    remove it.
    """
    case = problem(ELBOW)
    c = bdf.COEFFICIENTS[order]
    t = np.linspace(0.0, case.path.duration, 21)
    found = bdf.march(case.dae, case.path, t, case.x_eq, order)
    h = t[1]
    u = case.dae.targets(case.path.sample(t), 0)[:, :, 0]
    assert_array_equal(found.x[0], case.x_eq)
    assert not found.dx[0].any() and 2 * 20 <= found.iterations <= 8 * 20
    x = np.vstack([np.tile(case.x_eq, (4, 1)), found.x])
    for k in (1, 2, 3, 9, 20):
        rate = sum(c[j] * x[4 + k - j] for j in range(order + 1)) / h
        assert_allclose(found.dx[k], rate, atol=1e-9 * np.abs(rate).max())
        F, A, E = (np.array(z) for z in case.dae.rows(found.x[k], rate, u[k]))
        size = np.abs((A + c[0] / h * E) * found.x[k]).max(axis=1) + 1e-3
        assert np.all(np.abs(F[:, 0]) <= 1e-11 * size)
    other = bdf.march(case.dae, case.path, t, case.x_eq, 1, {1: (1.0, -1.01)})
    # given coefficients are used
    assert np.abs(other.x - bdf.march(case.dae, case.path, t, case.x_eq).x).max() > 1e-3


def test_iterations_of_bdf_are_the_equations_that_newtons_method_solves() -> None:
    case = problem(ELBOW)
    seen = []

    def rows(*x: np.ndarray) -> list[ca.DM]:
        seen.append(x)
        return case.dae.rows(*x)

    names = ("n", "n_x", "targets", "scales")
    counted: Any = SimpleNamespace(**{name: getattr(case.dae, name) for name in names}, rows=rows)
    assert (
        bdf.march(counted, case.path, np.linspace(0.0, 0.4, 6), case.x_eq, 2).iterations
        == len(seen)
        > 10
    )


def test_extrapolation_removes_the_leading_error() -> None:
    case = problem(ELBOW)
    t = np.linspace(0.0, 0.4, 6)
    coarse = bdf.march(case.dae, case.path, t, case.x_eq, 2)
    fine = bdf.march(case.dae, case.path, np.linspace(0.0, 0.4, 11), case.x_eq, 2)
    found = bdf.extrapolate(case.dae, case.path, t, case.x_eq, 2)
    assert_allclose(found.x, (4 * fine.x[::2] - coarse.x) / 3, rtol=1e-12, atol=1e-12)
    assert_allclose(found.dx, (4 * fine.dx[::2] - coarse.dx) / 3, rtol=1e-12, atol=1e-9)
    assert found.iterations == coarse.iterations + fine.iterations
    assert_array_equal(found.t, t)
    first = bdf.extrapolate(case.dae, case.path, t, case.x_eq)
    plain, finer = (
        bdf.march(case.dae, case.path, s, case.x_eq, 1) for s in (t, np.linspace(0.0, 0.4, 11))
    )
    assert_allclose(first.x, 2 * finer.x[::2] - plain.x, atol=1e-12)


def test_bdf_names_the_instant_where_newton_fails_and_where_the_equations_are_singular() -> None:
    case = problem(ELBOW)
    t = np.linspace(0.0, 0.5, 6)

    def altered(rows: Callable) -> SimpleNamespace:
        names = ("n", "n_x", "targets", "scales")
        return SimpleNamespace(**{name: getattr(case.dae, name) for name in names}, rows=rows)

    def singular(*x: np.ndarray) -> list[ca.DM]:
        F, A, E = case.dae.rows(*x)
        return [F, 0 * A, 0 * E]

    with pytest.raises(
        SolverError, match=r"singular at t = 0\.1 s, a singular pose; choose another path"
    ):
        bdf.march(altered(singular), case.path, t, case.x_eq)
    noise = iter(np.random.default_rng(0).uniform(1, 2, 999))
    with pytest.raises(
        SolverError,
        match=r"does not converge at t = 0\.1 s, last correction .* rad or m; try a finer",
    ):
        bdf.march(
            altered(
                lambda *x: [
                    case.dae.rows(*x)[0] * next(noise) + next(noise),
                    *case.dae.rows(*x)[1:],
                ]
            ),
            case.path,
            t,
            case.x_eq,
        )


@pytest.mark.parametrize("richardson", [False, True])
def test_extrapolation_is_an_option(richardson: bool) -> None:
    """The steps are a fifth of the given one."""
    given = question(ELBOW, options={"order": 2, "richardson": richardson})
    vars(given)["step"] = np.inf
    found = bdf.solve(given, 0.1)
    dae = problem(ELBOW).dae
    run = bdf.extrapolate if richardson else bdf.march
    x = run(dae, given.path, found.t, dae.pack(given.equilibrium), 2).x
    assert_allclose(np.diff(found.t), 0.02)
    assert_allclose(found.motors.tau_m, x[:, 2 * dae.n :], rtol=1e-9, atol=1e-9)
