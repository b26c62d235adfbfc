"""Numbers of flexgen/base/numerics by other routes: closed forms, NumPy, SciPy and small cases by
hand.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_are
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from flexgen.base.errors import SolverError
from flexgen.base.numerics import nlp, trust_region
from flexgen.base.numerics.evaluate import Evaluator, _is_dense, evaluate
from flexgen.base.numerics.riccati import riccati
from flexgen.base.numerics.tableaus import Tableau, gauss, lobatto, radau
from flexgen.base.numerics.transcription import Transcription, motion_at
from flexgen.base.numerics.trust_region import _step, minimize
from flexgen.codegen.emission.clib_files import read_clib
from flexgen.dynamics.mechanics.output_columns import turn_angle


def test_known_tableaus_of_gauss_radau_and_lobatto() -> None:
    """Butcher tables from the literature, and the double integrals by exact integration of
    monomials.
    """
    two = gauss(2)
    r = np.sqrt(3) / 6
    assert (two.name, two.order) == ("Gauss 2", 4)
    assert_allclose(two.c, [0.5 - r, 0.5 + r], rtol=1e-14)
    assert_allclose(two.A, [[0.25, 0.25 - r], [0.25 + r, 0.25]], rtol=1e-13)
    three = radau(2)
    assert (three.name, three.order) == ("Radau IIA 2", 3)
    assert_allclose(three.A, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], rtol=1e-13)
    simpson = lobatto()
    assert (simpson.name, simpson.order) == ("Lobatto IIIA 3", 4)
    assert_allclose(
        simpson.A, [[0, 0, 0], [5 / 24, 1 / 3, -1 / 24], [1 / 6, 2 / 3, 1 / 6]], atol=1e-15
    )
    theta = np.array([0.0, 0.3, 0.8, 1.0])
    for table in (two, three, simpson, gauss(3)):
        once, twice = table.weights(theta)
        values = table.lagrange(theta)
        for k in range(len(table.c)):
            f = table.c**k
            assert_allclose(values @ f, theta**k, atol=1e-13)
            assert_allclose(once @ f, theta ** (k + 1) / (k + 1), atol=1e-13)
            assert_allclose(twice @ f, theta ** (k + 2) / (k + 1) / (k + 2), atol=1e-13)
            assert_allclose(table.AA @ f, table.c ** (k + 2) / (k + 1) / (k + 2), atol=1e-13)
            assert_allclose(
                [table.b @ f, table.bb @ f], [1 / (k + 1), 1 / (k + 1) / (k + 2)], rtol=1e-12
            )


@pytest.mark.parametrize(
    ("name", "allowed"), [("c", 3e-16), ("b", 3e-16), ("A", 1e-13), ("AA", 3e-16)]
)
def test_the_tables_in_c_are_those_of_three_gauss_points(name: str, allowed: float) -> None:
    """A wrong digit would be an error of the motion that no law shows; A[0][2] has one of 6e-14,
    less than rounding.
    """
    found = re.search(rf"gauss_{name}\b[^=;]*= (\{{[^;]*);", read_clib()["inversion_common.h"])
    assert found is not None
    numbers = [
        float(a) / float(b or 1) for a, b in re.findall(r"(-?\d\.\d+)(?: / (\d+\.\d+))?", found[1])
    ]
    assert_allclose(numbers, np.ravel(getattr(gauss(3), name)), rtol=0, atol=allowed)


@pytest.mark.parametrize(("which", "size"), [("b", 1e-9), ("A", 1e-4), ("order", 1)])
def test_a_tableau_that_breaks_an_order_condition_is_refused(which: str, size: float) -> None:
    good = gauss(2)
    parts = {name: getattr(good, name) for name in ("name", "c", "A", "b", "AA", "bb", "order")}
    Tableau(**parts)
    with pytest.raises(AssertionError, match=r"Gauss 2: (order condition|stage order)"):
        Tableau(**{**parts, which: parts[which] + size})


def test_angles_between_rotations_from_tiny_to_half_a_turn() -> None:
    angles = np.array([1e-9, 0.4, 2.0, np.pi - 1e-7])
    axis = np.array([[1, 2, 3], [3, -1, 2], [0, 0, 1], [1, 1, 0]]) / np.sqrt(
        [[14], [14], [1], [2]]
    )
    start = Rotation.from_rotvec([[0.3, 1.1, -0.4]] * 4).as_matrix()
    R = Rotation.from_rotvec(axis * angles[:, None]).as_matrix() @ start
    assert_allclose(turn_angle(R, start), angles, rtol=1e-6)


def test_the_riccati_equation_holds_and_a_hopeless_one_is_reported() -> None:
    F = np.array([[1.1, 0.2], [0.0, 0.9]])
    G = np.array([[0.0], [1.0]])
    Q = np.diag([1.0, 2.0])
    R = np.array([[0.5]])
    assert_allclose(riccati(F, G, Q, R), solve_discrete_are(F, G, Q, R), rtol=1e-14)
    with pytest.raises(SolverError, match="use other weights, or other sensors"):
        riccati(np.diag([2.0, 3.0]), np.zeros((2, 1)), Q, R)


def test_functions_are_evaluated_at_many_points_as_one_by_one() -> None:
    """Outputs: a matrix, a column and a scalar; inputs with and without points, a matrix, one
    without elements.
    """
    x = ca.SX.sym("x", 3)
    A = ca.SX.sym("A", 2, 3)
    s = ca.SX.sym("s")
    none = ca.SX.sym("e", 0)
    function = ca.Function("f", [x, A, s, none], [s * A + 1, A @ x, ca.sumsqr(x)])
    chance = np.random.default_rng(1)
    X = chance.normal(size=(4, 3))
    B = chance.normal(size=(2, 3))
    found = evaluate(function, X, B, 2.5 * np.ones(4)[:, None], np.zeros((4, 0)))
    assert [y.shape for y in found] == [(4, 2, 3), (4, 2), (4, 1)]
    assert_allclose(found[0], np.repeat(2.5 * B[None] + 1, 4, axis=0), rtol=1e-14)
    assert_allclose(found[1], X @ B.T, rtol=1e-13)
    assert_allclose(found[2][:, 0], (X**2).sum(axis=1), rtol=1e-13)
    many = evaluate(function, X[0], np.stack([B, 2 * B]), np.array([[1.0], [3.0]]), np.zeros(0))
    assert_allclose(many[0], [B + 1, 6 * B + 1], rtol=1e-14)
    one = evaluate(function, X[1], B, [1.5], [])
    assert [y.shape for y in one] == [(1, 2, 3), (1, 2), (1, 1)]
    assert_allclose(one[1][0], B @ X[1], rtol=1e-14)


def test_functions_with_structural_zeros_are_not_dense_and_have_the_same_values() -> None:
    x = ca.SX.sym("x", 2)
    D = ca.SX.sym("D", ca.Sparsity.diag(2))
    outputs = ca.Function("f", [x], [ca.diag(x), x * 3])
    assert not _is_dense(outputs) and not _is_dense(ca.Function("g", [D, x], [ca.mtimes(D, x)]))
    assert _is_dense(ca.Function("h", [x], [x * 2]))
    X = np.array([[1.0, 2.0], [3.0, 4.0]])
    found = evaluate(outputs, X)
    assert_array_equal(found[0], [np.diag(row) for row in X])
    assert_array_equal(found[1], 3 * X)
    single = ca.Function("single", [x], [ca.diag(x)])
    assert_array_equal(evaluate(single, X[0])[0], [np.diag(X[0])])


def test_an_evaluator_keeps_no_result_of_an_earlier_call() -> None:
    A = ca.SX.sym("A", 2, 3)
    none = ca.SX.sym("e", 0)
    call = Evaluator(ca.Function("f", [A, none], [A.T, ca.SX(0, 1)]))
    B = np.arange(6.0).reshape(2, 3)
    first = call(B, np.zeros(0))
    second = call(-B, np.zeros(0))
    assert_array_equal(first[0], B.T)
    assert_array_equal(second[0], -B.T)
    with pytest.raises(ValueError, match="zip"):
        call(B)


MESH = np.array([0.0, 0.2, 0.5, 0.9])


def mesh(n: int = 2, n_w: int = 1) -> Transcription:
    return Transcription(MESH, gauss(3), n, n_w)


def test_collocation_is_exact_for_polynomials_of_its_degree() -> None:
    """y = t^4 and -2 t^3: continuity, motion at all instants, places in the vector of unknowns."""
    of = mesh()
    assert (of.N, of.s, of.n_nodes, of.n_inner, of.size) == (3, 3, 16, 9, 16 + 27)
    t = MESH[:, None]
    u = of.times[:, None]
    states = np.hstack([t**4, -2 * t**3, 4 * t**3, -6 * t**2])
    accelerations = np.hstack([12 * u**2, -12 * u])
    w = np.sin(u)
    x = of.pack(states, accelerations, w)
    assert x.shape == (of.size,)
    y, dy, ddy, back = of.unpack(x)
    assert_allclose(np.hstack([y, dy]), states)
    assert_allclose(ddy.reshape(-1, 2), accelerations)
    assert_allclose(back.reshape(-1, 1), w)
    assert_allclose(of.continuity @ x, 0.0, atol=1e-13)
    assert of.continuity.shape == (12, of.size)
    assert abs(of.continuity @ (x + 0.1 * np.arange(of.size))).min() > 1e-3
    z, row, h, motion, own = of.instant()
    at = ca.Function("at", [z, row, h], [*motion, own])
    rows, lengths = of.parameters
    own_a, own_w = of.own
    assert_allclose(x[own_a], accelerations)
    assert_allclose(x[own_w], w)
    for k in range(9):
        found = [np.array(v).ravel() for v in at(x[of.where[k]], rows[:, k], lengths[:, k])]
        s = u[k, 0]
        expected = [[s**4, -2 * s**3], [4 * s**3, -6 * s**2], [12 * s**2, -12 * s], [np.sin(s)]]
        for one, other in zip(found, expected, strict=True):
            assert_allclose(one, other, atol=1e-13)


def test_the_assembled_jacobian_is_that_of_the_assembled_constraints() -> None:
    """Also: every row of the instants is scaled by the largest scaled entry among five
    instants.
    """
    of = mesh(1, 1)
    z, row, h, (y, dy, ddy), w = of.instant()
    p = ca.SX.sym("p")
    rows = ca.vertcat(ddy + p * y**2 - w, dy * w)
    x = ca.MX.sym("x", of.size)
    chance = np.random.default_rng(2)
    scale_x = chance.uniform(0.5, 2.0, of.size)
    x0 = chance.normal(size=of.size)
    extra = np.arange(1.0, 10.0)[None]
    g, jacobian, scale = of.constraints(
        x, rows, [z, row, h, p], [*of.parameters, extra], scale_x, x0
    )
    at = ca.Function("at", [x], [g, jacobian, ca.jacobian(g, x)])
    point = chance.normal(size=of.size)
    values, assembled, differentiated = (np.array(v) for v in at(point))
    assert_allclose(assembled, differentiated, atol=1e-12)
    true = scale_x * point
    here = ca.Function("rows", [z, row, h, p], [rows])
    local = [
        np.array(here(true[of.where[k]], *[v[:, k] for v in [*of.parameters, extra]])).ravel()
        for k in range(9)
    ]
    between = of.continuity @ true / np.tile(scale_x[:2], of.N)
    assert_allclose(
        values.ravel(), np.r_[(np.array(local) * scale).ravel(), between], rtol=1e-11, atol=1e-13
    )
    slope = ca.Function("slope", [z, row, h, p], [ca.jacobian(rows, z)])
    sizes = []
    for k in (0, 2, 4, 6, 8):
        block = np.array(slope(x0[of.where[k]], *[v[:, k] for v in [*of.parameters, extra]]))
        sizes.append(np.abs(block * scale_x[of.where[k]]).max(axis=1))
    assert_allclose(scale, 1 / np.max(sizes, axis=0), rtol=1e-13)


def test_motion_at_an_instant_is_the_taylor_polynomial_for_constant_acceleration() -> None:
    z = ca.SX([2.0, -1.0, 0.5, 3.0, 4.0, -6.0, 4.0, -6.0])
    h = ca.SX(0.5)
    table = gauss(2)
    i = 1
    row = ca.SX(np.r_[table.c[i], table.A[i], table.AA[i], np.eye(2)[i]])
    y, dy, ddy = (np.array(ca.DM(v)).ravel() for v in motion_at(z, row, h, 2, 2))
    t = 0.5 * table.c[i]
    assert_allclose(ddy, [4.0, -6.0])
    assert_allclose(dy, [0.5 + 4 * t, 3.0 - 6 * t])
    assert_allclose(y, [2.0 + 0.5 * t + 2 * t**2, -1.0 + 3 * t - 3 * t**2])


def linear(J: np.ndarray, d: np.ndarray) -> tuple:
    def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        r = J @ x - d
        return float(r @ r), J.T @ r, J.T @ J

    return sums, lambda x: float(np.sum((J @ x - d) ** 2))


def test_a_linear_fit_with_prior_and_bounds_is_that_of_scipy() -> None:
    chance = np.random.default_rng(3)
    J = chance.normal(size=(8, 3))
    d = 4 * chance.normal(size=8)
    center = np.array([0.5, -0.3, 0.2])
    sd = np.array([0.7, 2.0, 5.0])
    whole = np.vstack([J, np.diag(1 / sd)]), np.r_[d, center / sd]
    free = np.linalg.lstsq(*whole, rcond=None)[0]
    for bounds in (
        (np.full(3, -9.0), np.full(3, 9.0)),
        (np.array([free[0] + 0.3, -9, -9]), np.array([9, 9, 9.0])),
        (np.full(3, -9.0), np.array([9, free[1] - 0.2, 9.0])),
    ):
        fit = minimize(
            *linear(J, d), np.array([20.0, -20.0, 0.0]), center, sd, bounds, distance=1e-9
        )
        expected = lsq_linear(*whole, bounds, method="bvls").x
        assert fit.converged and 2 <= fit.iterations < 20
        assert_allclose(fit.x, expected, atol=1e-8)
        assert_allclose(fit.cost, np.sum((J @ expected - d) ** 2), rtol=1e-8)
        assert_allclose(
            fit.objective, fit.cost + np.sum(((expected - center) / sd) ** 2), rtol=1e-8
        )
        held = (fit.x <= bounds[0]) | (fit.x >= bounds[1])
        assert_array_equal(fit.at_bound, held)
        assert_allclose(fit.A, J.T @ J, rtol=1e-14)


def test_a_fit_at_a_corner_ends_at_once() -> None:
    sums, cost = linear(np.eye(2), np.array([-5.0, 5.0]))
    fit = minimize(
        sums, cost, np.zeros(2), np.zeros(2), np.full(2, 1e3), (np.zeros(2), np.zeros(2))
    )
    assert fit.converged and fit.iterations == 1 and fit.at_bound.all() and fit.cost == 50.0


def test_the_trust_region_follows_the_curved_valley_and_refuses_bad_steps() -> None:
    """Rosenbrock's function; where the model has no solution (y > 1.2) the step is made
    shorter.
    """
    asked: list[np.ndarray] = []
    steps: list[np.ndarray] = []

    def residual(x: np.ndarray) -> np.ndarray:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        steps.append(x.copy())
        r = residual(x)
        J = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
        return float(r @ r), J.T @ r, J.T @ J

    def cost(x: np.ndarray) -> float:
        asked.append(x.copy())
        if x[1] > 1.2:
            raise SolverError("none")
        return float(np.sum(residual(x) ** 2))

    bounds = np.full(2, -4.0), np.full(2, 4.0)
    fit = minimize(sums, cost, np.array([-1.2, 1.0]), np.zeros(2), np.full(2, 1e6), bounds)
    assert fit.converged and fit.iterations == len(asked) + 1
    assert_allclose(fit.x, 1.0, atol=1e-5)
    assert len(steps) - 1 < len(asked)  # some were refused
    values = [float(np.sum(residual(x) ** 2)) for x in steps]
    assert np.all(np.diff(values) < 0)
    moved = [float(np.linalg.norm(b - a)) for a, b in pairwise(steps)]
    assert max(moved) <= trust_region.LARGEST_RADIUS and moved[0] <= trust_region.RADIUS * 1.06
    # measured: the rules of the radius decide these numbers
    assert (fit.iterations, len(steps)) == (17, 14)


def test_a_search_with_a_wrong_model_stops_where_it_gains_little() -> None:
    """Rosenbrock's function and a residual that nothing explains; where that is noise, the search
    goes to its end.
    """

    def fitted(unexplained: float) -> trust_region.Fit:
        def residual(x: np.ndarray) -> np.ndarray:
            return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0], unexplained])

        def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
            r = residual(x)
            J = np.array([[-20 * x[0], 10.0], [-1.0, 0.0], [0.0, 0.0]])
            return float(r @ r), J.T @ r, J.T @ J

        def cost(x: np.ndarray) -> float:
            return float(np.sum(residual(x) ** 2))

        bounds = (np.full(2, -4.0), np.full(2, 4.0))
        start = np.array([-1.2, 1.0])
        return minimize(sums, cost, start, np.zeros(2), np.full(2, 1e6), bounds, count=3)

    wrong = fitted(100.0)
    right = fitted(1.0)
    assert wrong.wrong and not wrong.converged and wrong.iterations < right.iterations
    assert right.converged and not right.wrong
    assert_allclose(right.x, 1.0, atol=1e-5)


def test_the_radius_grows_on_a_long_way_and_stays_below_its_limit() -> None:
    sums, cost = linear(np.eye(2), np.array([30.0, 40.0]))
    visited: list[np.ndarray] = []

    def noted(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        visited.append(x.copy())
        return sums(x)

    bounds = np.full(2, -99.0), np.full(2, 99.0)
    fit = minimize(noted, cost, np.zeros(2), np.zeros(2), np.full(2, 1e9), bounds)
    lengths = np.array([np.linalg.norm(b - a) for a, b in pairwise(visited)])
    expected = [0.5, 1.0, 2.0, *[3.0] * 15]
    assert_allclose(lengths[:-1], expected[: len(lengths) - 1], rtol=0.051)
    assert_allclose(fit.x, [30.0, 40.0], atol=1e-6)


def test_a_cost_that_never_falls_ends_the_fit_and_says_whether_it_converged() -> None:
    """The gradient is wrong: no step lowers the cost, the radius becomes a quarter each time until
    the fit ends.
    """
    calls = []

    def cost(x: np.ndarray) -> float:
        calls.append(x)
        return 1.0 + float(np.abs(x).sum())

    def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        return 1.0, np.array([1.0]), np.array([[1.0]])

    bounds = np.array([-9.0]), np.array([9.0])
    fit = minimize(sums, cost, np.zeros(1), np.zeros(1), np.array([1e9]), bounds)
    assert fit.x == 0.0 and fit.cost == 1.0
    assert_allclose([float(x[0]) for x in calls[:3]], [-0.5, -0.125, -0.03125], rtol=0.06)
    assert not fit.converged or abs(calls[-1][0]) < 1e-8


@pytest.mark.parametrize("radius", [0.01, 0.3, 5.0, 1e3])
def test_a_step_is_the_minimum_within_the_sphere(radius: float) -> None:
    """Optimal: (A + shift I) s = -g with shift >= 0, and on the sphere (within 5 %) where
    shift > 0.
    """
    chance = np.random.default_rng(4)
    B = chance.normal(size=(4, 4))
    A = B @ B.T + 0.05 * np.eye(4)
    g = chance.normal(size=4) * 3
    step = _step(A, g, radius)
    rest = -(A @ step + g)
    shift = float(rest @ step / (step @ step))
    assert_allclose(rest, shift * step, atol=1e-9 * max(1, np.abs(rest).max()))
    full = np.linalg.solve(A, -g)
    if np.linalg.norm(full) <= radius:
        assert_allclose(step, full, rtol=1e-9)
    else:
        assert shift > 0 and abs(np.linalg.norm(step) / radius - 1) <= 0.05


def test_directions_without_curvature_do_not_make_a_step_infinite() -> None:
    step = _step(np.diag([4.0, 0.0]), np.array([2.0, 0.0]), 1.0)
    assert_allclose(step, [-0.5, 0.0], atol=1e-12)


def test_the_largest_violation_of_bounds() -> None:
    lower = np.array([-1.0, 0.0, 2.0])
    upper = np.array([1.0, 0.0, 5.0])
    assert nlp._violation(np.array([0.5, 0.0, 2.0]), lower, upper) == 0.0
    assert nlp._violation(np.array([0.5, -0.25, 2.0]), lower, upper) == 0.25
    assert nlp._violation(np.array([1.75, 0.0, 2.5]), lower, upper) == 0.75
    assert nlp._violation(np.array([-3.0, 0.0, 9.0]), lower, upper) == 4.0
    assert nlp._violation(np.zeros(0), np.zeros(0), np.zeros(0)) == 0.0


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
