"""Nonlinear programs: optimality of the solution, own derivatives, warm starts."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.numerics import nlp


def test_a_nonlinear_program_with_all_that_can_be_given() -> None:
    """min (x - 2)^2 + y^2 with x y = 1 and x <= 1.5, with own derivatives, then warm from its
    solution.
    """
    x = ca.MX.sym("x", 2)
    cost = (x[0] - 2) ** 2 + x[1] ** 2
    g = x[0] * x[1]
    lines: list[str] = []

    def hessian(lam_f: ca.MX, lam_g: ca.MX) -> ca.MX:
        return ca.triu(lam_f * ca.DM([[2, 0], [0, 2]]) + lam_g * ca.DM([[0, 1], [1, 0]]))

    plain = nlp.NonlinearProgram(x=x, cost=cost, g=g, lower=1.0, upper=1.0)
    arguments = dict(bounds_x=(np.array([-9.0, -9.0]), np.array([1.5, 9.0])))
    slope = ca.horzcat(x[1], x[0])
    found = nlp.solve_nlp(
        replace(plain, jacobian=slope, hessian=hessian, gradient=ca.gradient(cost, x).T),
        np.array([1.0, 1.0]),
        progress=lines.append,
        **arguments,
    )
    y = found.x
    assert found.success and found.status == "Solve_Succeeded" and found.violation < 1e-9
    assert_allclose(y[0] * y[1], 1.0, atol=1e-9)
    bound, equality = found.multipliers
    assert_allclose(2 * (y - [2, 0]) + equality * y[::-1] + bound, 0.0, atol=1e-7)
    assert_allclose(found.g, [1.0], atol=1e-9)
    assert len(lines) == found.iterations + 1 and lines[0].startswith(
        "IPOPT iteration   0: cost  2.000e+00"
    )
    assert "constraints  0.00e+00" in lines[0] and lines[-1].startswith(
        f"IPOPT iteration {found.iterations:3d}"
    )
    warm = nlp.solve_nlp(plain, y, multipliers=found.multipliers, **arguments)
    assert warm.success and warm.iterations < found.iterations
    assert_allclose(warm.x, y, atol=1e-8)
    short = nlp.solve_nlp(plain, np.array([1.0, 5.0]), max_iterations=1, **arguments)
    assert (
        not short.success
        and short.status == "Maximum_Iterations_Exceeded"
        and short.iterations == 1
    )
    free = nlp.solve_nlp(
        nlp.NonlinearProgram(x=x, cost=cost, g=x[1] - 3, hessian=2 * ca.DM.eye(2)), np.zeros(2)
    )
    assert_allclose(free.x, [2.0, 3.0], atol=1e-8)


@pytest.mark.parametrize(
    ("start", "violation"),
    [([0.5, 0.0, 2.0], 0.0), ([0.5, -0.25, 2.0], 0.25), ([-3.0, 0.0, 9.0], 4.0)],
)
def test_the_violation_of_a_program_without_iterations_is_that_of_its_start(
    start: list[float], violation: float
) -> None:
    x = ca.MX.sym("x", 3)
    lower = np.array([-1.0, 0.0, 2.0])
    upper = np.array([1.0, 0.0, 5.0])
    program = nlp.NonlinearProgram(x=x, cost=ca.sumsqr(x), g=x, lower=lower, upper=upper)
    found = nlp.solve_nlp(program, np.array(start), max_iterations=0)
    assert found.violation == pytest.approx(violation, abs=1e-12)


def test_own_derivatives_give_the_iterations_of_differentiated_ones() -> None:
    """A Hessian of other multipliers would need other iterations."""
    x = ca.MX.sym("x", 2)
    cost = (x[0] - 2) ** 4 + x[1] ** 2
    g = x[0] * x[1]

    def hessian(lam_f: ca.MX, lam_g: ca.MX) -> ca.MX:
        return ca.triu(ca.hessian(lam_f * cost + lam_g * g, x)[0])

    plain = nlp.NonlinearProgram(x=x, cost=cost, g=g, lower=1.0, upper=1.0)
    start = np.array([1.0, 5.0])
    automatic = nlp.solve_nlp(plain, start)
    own = nlp.solve_nlp(replace(plain, hessian=hessian), start)
    assert own.iterations == automatic.iterations > 3
    assert_allclose(own.x, automatic.x, rtol=1e-9)


@pytest.mark.parametrize(("start", "printed"), [(1.5, "0.00e+00"), (0.75, "2.50e-01")])
def test_progress_tells_the_violation_of_unequal_bounds(start: float, printed: str) -> None:
    lines: list[str] = []
    x = ca.MX.sym("x")
    program = nlp.NonlinearProgram(x=x, cost=x**2, g=x, lower=1.0, upper=2.0)
    nlp.solve_nlp(program, np.array([start]), progress=lines.append)
    assert f"constraints  {printed}" in lines[0]
