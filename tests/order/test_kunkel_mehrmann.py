"""The regularized DAE: the derivative array, its ranks, consistent points, and the order of its
integration.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from causal_cases import observed_order, problem, reference, relative
from numpy.polynomial import Chebyshev, Polynomial

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.tableaus import Tableau, radau
from flexgen.dynamics.dae.derivative_array import DerivativeArray
from flexgen.inversion.comparison.kunkel_mehrmann import Regular, integrate, regularize, solve
from flexgen.inversion.comparison.strangeness_free import StrangenessFree
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem import InversionProblem

ORDER = 2 * 3 - 1  # of Radau IIA with three stages
# by how much an observed order may miss it: the zeros are fast, and the steps are not yet small
# for them
NEAR = 0.7
TOLD = 1e-8  # m and rad: what is reached with steps of a millisecond
EXACT = 1e-5  # relative: torques against the exact methods
ZERO = 1e-11  # products that vanish, in units of the scales
ALIKE = 1e-5  # relative: derivatives of polynomials fitted to samples against automatic ones
WINDOW = 0.02  # s: where they are fitted


@cache
def system(name: str) -> StrangenessFree:
    here = problem(name)
    return regularize(here.dae, here.x_eq)


@cache
def marched(name: str, steps: int, duration: float) -> Regular:
    here = problem(name)
    return integrate(system(name), here.path, np.linspace(0.0, duration, steps + 1), here.x_eq)


@pytest.mark.parametrize(
    ("name", "mu", "a", "d"),
    [
        ("planar5_mp", 3, 8, 4),  # a = 4 n_m, d = n_g + 2 n_e
        ("planar5_mp@undamped", 4, 10, 2),  # a = 5 n_m, d = 2 n_e
        ("planar5_nmp", 3, 8, 4),
        ("four_mass@high", 3, 4, 5),
        ("elbow", 3, 8, 2),
        ("elbow@rigid", 2, 6, 0),  # a = 3 n_m: index 3
        ("abb_arm", 4, 5, 2),  # one more than the structure shows: a zero is at infinity
    ],
)
def test_ranks_are_those_of_the_theory(name: str, mu: int, a: int, d: int) -> None:
    found = system(name)
    assert (found.mu, found.a, found.d) == (mu, a, d) and found.gap > 1e8


def test_too_short_an_array_does_not_satisfy_the_hypothesis() -> None:
    here = problem("planar5_mp")
    with pytest.raises(SolverError, match="order 2 does not make the DAE regular"):
        _ = StrangenessFree(here.dae, 2, here.x_eq).a


@pytest.mark.parametrize("name", ["planar5_mp", "manutec_r3"])
def test_the_array_holds_the_derivatives_of_the_equations(name: str) -> None:
    """Along some motion that solves nothing: F and its derivatives, and the slopes by automatic
    differentiation.
    """
    here = problem(name)
    dae = here.dae
    rng = np.random.default_rng(11)
    mu = 3
    motions = [Polynomial(s) for s in rng.normal(size=(dae.n_x, 7)) * 0.3]
    targets = [Polynomial(s) for s in rng.normal(size=(dae.n_u, 7)) * 0.3]

    def at(curves: list[Polynomial], t: float, k: int) -> np.ndarray:
        return np.array([p.deriv(k)(t) if k else p(t) for p in curves])

    nodes = WINDOW * np.cos(np.pi * (np.arange(25) + 0.5) / 25)
    values = np.array(
        [
            dae.rows(at(motions, t, 0), at(motions, t, 1), at(targets, t, 0))[0].full()[:, 0]
            for t in nodes
        ]
    )
    X = np.stack([at(motions, 0.0, k) for k in range(mu + 2)], axis=1)
    U = np.stack([at(targets, 0.0, k) for k in range(mu + 1)], axis=1)
    array = DerivativeArray(dae, mu)
    F, N, M = (z.full() for z in array.function(X, U))
    assert np.array_equal(array.rows(X, U).full(), F)
    for i in range(dae.n_x):
        fitted = Chebyshev.fit(nodes, values[:, i], 14, domain=[-WINDOW, WINDOW])
        for k in range(mu + 1):
            expected = fitted.deriv(k)(0.0) if k else fitted(0.0)
            size = max(1.0, abs(expected), np.abs(values[:, i]).max() * 5.0**k)
            assert abs(F[k * dae.n_x + i, 0] - expected) < ALIKE * size, (i, k)
    if name == "planar5_mp":
        x = ca.SX.sym("X", *X.shape)
        u = ca.SX.sym("U", *U.shape)
        slopes = ca.Function("slopes", [x, u], [ca.jacobian(array.function(x, u)[0], ca.vec(x))])(
            X, U
        ).full()
        assert np.allclose(np.hstack([N, M]), slopes, rtol=1e-12, atol=1e-9 * np.abs(slopes).max())


def test_the_split_selects_the_stated_equations() -> None:
    here = problem("planar5_mp")
    found = system("planar5_mp")
    t = np.linspace(0.0, 0.25, 126)
    state = marched("planar5_mp", 125, 0.25)
    U = here.dae.targets(here.path.sample(t), found.mu)[-1]
    X = np.zeros((found.n, found.mu + 2))
    X[:, 0] = state.x[-1]
    X[:, 1] = state.dx[-1]
    X = found.consistent(X, U)
    assert np.abs((X[:, 0] - state.x[-1]) / found.unit).max() < 1e-9  # it was consistent
    assert np.abs(found.rows(X, U)).max() < ZERO
    split = found.split(X, U)
    _, M = found._jacobians(X, U)
    assert (
        np.abs(split.Z2.T @ M).max() < ZERO
        and np.abs(split.Z2.T @ split.N @ split.T2).max() < ZERO
    )
    for basis in (split.Z1, split.Z2, split.T2):
        assert np.allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-12)
    assert np.linalg.cond(split.Z1.T @ split.E @ split.T2) < 1e6
    assert np.linalg.matrix_rank(split.Z2.T @ split.N, tol=1e-9) == found.a


def test_without_freedom_the_path_alone_determines_everything() -> None:
    """A rigid arm has no state of its own: a consistent point at any instant holds the torque."""
    here = problem("elbow@rigid")
    found = system("elbow@rigid")
    t = 0.4 * here.path.duration
    U = here.dae.targets(here.path.sample(np.array([t])), found.mu)[0]
    X = np.zeros((found.n, found.mu + 2))
    X[:, 0] = here.x_eq
    torque = here.torques(found.consistent(X, U)[:, 0][None])[0]
    assert np.allclose(torque, reference("elbow@rigid")(t), rtol=1e-6)  # type: ignore[operator]
    U[:, 0] = 50.0  # out of reach
    with pytest.raises(SolverError, match="leaves the workspace"):
        found.consistent(X, U)


# with damping the zeros at -1000 1/s want small steps before the order shows, without it rounding
# comes early
COUNTS = {"planar5_mp": (50, 100, 200), "planar5_mp@undamped": (25, 50, 100)}


@pytest.mark.parametrize("name", list(COUNTS))
def test_the_declared_order(name: str) -> None:
    assert observed_order(coordinate_errors(name)) == pytest.approx(ORDER, abs=NEAR)


def coordinate_errors(name: str, table: Tableau | None = None) -> list[float]:
    """Errors of the non-actuated coordinates, with 50 to 200 steps or half as many."""
    here = problem(name)
    i_e = list(here.dae.model.i_e)
    T = here.path.duration
    finest = 4 * COUNTS[name][-1]
    exact = marched(name, finest, T).x[:, i_e]
    out = []
    for n in COUNTS[name]:
        t = np.linspace(0.0, T, n + 1)
        found = (
            integrate(system(name), here.path, t, here.x_eq, table).x
            if table
            else marched(name, n, T).x
        )
        out.append(float(np.abs(found[:, i_e] - exact[:: finest // n]).max()))
    return out


def test_a_wrong_coefficient_is_seen() -> None:
    """Planted bug: one entry of the tableau is wrong in the fourth digit."""
    right = radau(3)
    A = right.A.copy()
    A[1, 0] *= 1.001
    wrong = SimpleNamespace(c=right.c, A=A)
    assert observed_order(coordinate_errors("planar5_mp@undamped", wrong)) < ORDER - 2 * NEAR
    assert observed_order(coordinate_errors("planar5_mp@undamped", radau(2))) < ORDER - NEAR


@pytest.mark.parametrize(
    "name",
    ["planar5_mp", "planar5_mp@undamped", "four_mass@high", "abb_arm", "elbow", "elbow@rigid"],
)
def test_the_answer_agrees_and_is_verified(name: str) -> None:
    solution = flexgen.solve(name, method="kunkel-mehrmann")
    # it turns by 10 rad, and is light: rounding is what is seen
    scale = 10 * 10 if name == "abb_arm" else 1
    assert solution.status == Status.SOLVED
    assert (solution.tool_error_max_m or 0.0) < TOLD and (
        solution.tool_error_max_rad or 0.0
    ) < scale * TOLD
    t = solution.trajectory.time
    on_path = (t >= 0) & (t <= problem(name).path.duration)
    expected = reference(name)(t[on_path])  # type: ignore[operator]
    assert relative(solution.trajectory["tau_m"][on_path], expected) < scale * EXACT


@pytest.mark.full
def test_six_axes() -> None:
    solution = flexgen.solve("manutec_r3", "line", method="kunkel-mehrmann")
    assert solution.status == Status.SOLVED
    assert (solution.details["a"], solution.details["d"]) == (21, 3)
    assert (solution.tool_error_max_m or 1) < TOLD and (solution.tool_error_max_rad or 1) < TOLD


def test_options_are_reported() -> None:
    given = problem("planar5_mp").problem
    with pytest.raises(ArgumentError, match="'order', expected none"):
        solve(InversionProblem(given.equations, given.path, options={"order": 3}), 5e-3)
