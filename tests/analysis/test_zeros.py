"""Zeros of pencils and state spaces: roots of polynomials, and of determinants in 60 digits."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.analysis.linear import LinearModel, linearize
from flexgen.analysis.zero_dynamics import zeros
from flexgen.dynamics.mechanics.statics import hold_joints


def exact_zeros(at: LinearModel, count: int) -> np.ndarray:
    """The ``count`` zeros, from the determinant at count + 1 points, a polynomial, in 60
    digits.
    """
    with mpmath.workdps(60):
        M, D, K, B, W = (mpmath.matrix(x.tolist()) for x in (at.M, at.D, at.K, at.B, at.W))
        n, m = at.B.shape

        def determinant(s: Any) -> Any:
            pencil = mpmath.zeros(n + m)
            pencil[:n, :n] = M * s**2 + D * s + K
            pencil[:n, n:] = B
            pencil[n:, :n] = W
            return mpmath.det(pencil)

        points = [mpmath.mpf(300 * k) for k in range(count + 1)]
        powers = mpmath.matrix([[p ** (count - k) for k in range(count + 1)] for p in points])
        values = [determinant(p) for p in points]
        polynomial = list(mpmath.lu_solve(powers, mpmath.matrix(values)))
        further = mpmath.mpf(-777)
        assert mpmath.polyval(polynomial, further) == pytest.approx(
            determinant(further), rel=1e-30
        )
        return np.array([complex(r) for r in mpmath.polyroots(polynomial, 500, extraprec=500)])


@pytest.mark.parametrize(
    ("name", "phase"),
    [("planar5_mp", "minimum phase"), ("planar5_nmp", "non-minimum phase")],
)
def test_zeros_of_robots_whose_rotors_turn_with_the_arm_are_those_of_the_pencil(
    name: str, phase: str
) -> None:
    """Roots of det [[M s^2 + D s + K, B], [W, 0]] in 60 digits.

    A double one is accurate to the root of rounding. They do not depend on a library of linear
    algebra: an eigenvalue solver for this pencil is off by 1.5e-5 with the kernels of some
    processors.
    """
    turning: dict[str, Any] = {"motor_coupling": "complete"}
    for motor, carrier in (("m1", "base"), ("m2", "arm1")):
        turning |= {f"motor.{motor}.carrier": carrier, f"motor.{motor}.axis": [0, 0, 1]}
    equations = flexgen.derive(flexgen.read(name, overrides=turning))
    rest = hold_joints(equations, np.array(equations.model.home))
    at = linearize(equations, rest)
    report = zeros.zero_report(equations, at, rest)
    roots = exact_zeros(at, 4)
    assert len(report.zeros) == 4 and report.phase == phase
    for root in roots:
        others = np.delete(roots, np.abs(roots - root).argmin())
        double = np.abs(others - root).min() < 1e-9 * abs(root)
        assert np.abs(report.zeros - root).min() < (1e-5 if double else 1e-8) * abs(root)
    unstable = roots.real.max() if phase.startswith("non") else np.inf
    assert report.unstable_time_constant_s == pytest.approx(1 / unstable, rel=1e-6)
    assert report.preview_s == pytest.approx(np.log(1e6) / unstable, rel=1e-6)


@pytest.mark.parametrize("scale", [1.0, 1e9])
def test_roots_of_a_pencil_are_those_of_its_polynomials(scale: float) -> None:
    """Also with a singular leading matrix; the polynomials are hidden by changes of rows and
    columns.
    """
    rng = np.random.default_rng(4)
    T, S = rng.normal(size=(2, 3, 3))
    polynomials = [(2.0, 0.4, 50.0), (0.0, 3.0, -12.0), (1e-6, 1e-3, 5.0)]
    A, D, K = (scale * T @ np.diag(x) @ S for x in zip(*polynomials, strict=True))
    expected = np.concatenate([np.roots(np.trim_zeros(p, "f")) for p in polynomials])
    found = zeros.pencil_zeros(A, D, K)
    assert found is not None
    assert_allclose(np.sort_complex(found), np.sort_complex(expected), rtol=1e-7)


@pytest.mark.parametrize(
    ("coefficients", "roots"),
    [
        ((0.0, 1.0, 0.0), [0.0]),
        ((1.0, 0.0, 0.0), [0.0, 0.0]),
        ((0.0, 0.0, 1.0), []),
        ((0.0, 0.0, 0.0), None),
    ],
)
def test_pencils_with_zero_matrices_have_the_zeros_that_remain(
    coefficients: tuple[float, float, float], roots: list[float] | None
) -> None:
    found = zeros.pencil_zeros(*(np.array([[x]]) for x in coefficients))
    assert (found is None) == (roots is None)
    if roots is not None:
        assert_allclose(found, roots, atol=1e-9)


@pytest.mark.parametrize(
    ("numerator", "roots"), [([1.0, -1.0, -6.0], [-2.0, 3.0]), ([0.0, 0.0, 1.0], [])]
)
def test_zeros_of_a_state_space_are_those_of_its_transfer_function(
    numerator: list[float], roots: list[float]
) -> None:
    """(s + 2)(s - 3) / ((s + 1)(s + 4)(s + 5) s) in controller form, hidden by a change of states
    and of units.
    """
    A = np.diag(np.ones(3), -1)
    A[0] = [-10.0, -29.0, -20.0, 0.0]
    T = np.random.default_rng(4).normal(size=(4, 4)) @ np.diag([1.0, 100.0, 0.1, 1.0])
    back = np.linalg.inv(T)
    C = np.array([[0.0, *numerator]])
    found = zeros.transmission_zeros(T @ A @ back, T @ np.eye(4)[:, :1], C @ back, 5.0)
    assert found is not None
    # rounding of the change of states and of its inverse
    bound = np.finfo(float).eps * np.linalg.cond(T) ** 2 * np.linalg.norm(A)
    assert_allclose(np.sort_complex(found), roots, rtol=0, atol=bound)


def test_outputs_that_depend_on_each_other_have_no_zeros() -> None:
    A, B = np.random.default_rng(4).normal(size=(2, 4, 4))
    C = np.array([[1.0, 2.0, 0.0, 0.0], [-3.0, -6.0, 0.0, 0.0]])
    assert zeros.transmission_zeros(A, B[:, :2], C) is None
