"""Dummy derivatives: the differentiated system, the choice of states, and what IDAS makes of
it.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from causal_cases import InitialValueCase, problem, reference, relative
from numpy.polynomial import Chebyshev

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison import reduced as dummy_derivatives
from flexgen.inversion.comparison.dummy_derivatives import Choice, DummyDerivatives
from flexgen.inversion.comparison.reduced import POOR, integrate, offsets, solve
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem import InversionProblem

TOLD = 5e-7  # m and rad: what is reached with the default tolerance
EXACT = 1e-4  # relative: torques against the exact methods
# relative: derivatives of polynomials fitted to samples, up to the fourth, against automatic ones
ALIKE = 1e-5
WINDOW = 0.02  # s: where they are fitted


def dummies_of(here: InitialValueCase) -> DummyDerivatives:
    return DummyDerivatives(here.dae, *offsets(here.dae))


@pytest.mark.parametrize(
    ("name", "freedom"),
    [
        ("planar5_mp", 2 + 2 * 1),  # n_g + 2 n_e
        ("planar5_mp@undamped", 2 * 1),  # 2 n_e
        ("four_mass@high", 1 + 2 * 2),
        ("elbow", 2),
        ("elbow@rigid", 0),
        ("manutec_r3", 3),
    ],
)
def test_degrees_of_freedom_are_those_of_the_theory(name: str, freedom: int) -> None:
    here = problem(name)
    dummies = dummies_of(here)
    U = here.dae.targets(here.path.sample(np.zeros(1)), dummies.orders)[0]
    choice = dummies.choose(dummies.at_rest(here.x_eq), U)
    assert dummies.freedom == len(choice.states) == freedom
    assert len(choice.algebraic) == sum(dummies.c) + len(dummies.c)  # as many as equations
    slopes = dummies.system(dummies.at_rest(here.x_eq), U)[1].full() * dummies.scales(here.x_eq)
    block = slopes[:, list(choice.algebraic)]
    # index 1: solvable for all else
    assert np.linalg.cond(block / np.abs(block).max(axis=1)[:, None]) < 1e12


@pytest.mark.parametrize("name", ["planar5_mp", "planar5_mp@undamped", "manutec_r3"])
def test_derivatives_of_equations_agree_with_those_of_polynomials(name: str) -> None:
    """Along some motion that solves nothing, sampled, the equations' derivatives are those of a
    fitted polynomial.
    """
    here = problem(name)
    dae = here.dae
    dummies = dummies_of(here)
    rng = np.random.default_rng(7)
    unknowns = dae.n + dae.model.n_m
    series = rng.normal(size=(unknowns, 7)) * 0.3
    signal = rng.normal(size=(dae.n_u, 7)) * 0.3
    motions = [np.polynomial.Polynomial(s) for s in series]
    targets = [np.polynomial.Polynomial(s) for s in signal]
    nodes = WINDOW * np.cos(np.pi * (np.arange(25) + 0.5) / 25)
    y, v, a = (ca.SX.sym(name, dae.n) for name in "yva")
    tau = ca.SX.sym("tau", dae.model.n_m)
    u = ca.SX.sym("u", dae.n_u)
    rows = ca.Function(
        "rows",
        [y, v, a, tau, u],
        [ca.vertcat(dae.motion_rows(y, v, a, tau), dae.output_rows(y, u))],
    )
    values = []
    for t in nodes:
        levels = [np.array([m.deriv(k)(t) if k else m(t) for m in motions]) for k in range(3)]
        at = [levels[0][: dae.n], levels[1][: dae.n], levels[2][: dae.n], levels[0][dae.n :]]
        values.append(rows(*at, np.array([p(t) for p in targets])).full()[:, 0])
    Y = np.array(
        [
            m.deriv(r)(0.0) if r else m(0.0)
            for j, m in enumerate(motions)
            for r in range(dummies.d[j] + 1)
        ]
    )
    U = np.array(
        [[p.deriv(k)(0.0) if k else p(0.0) for k in range(dummies.orders + 1)] for p in targets]
    )
    G = dummies.system(Y, U)[0].full()[:, 0]
    place = 0
    for k in range(dummies.orders + 1):
        for i in range(len(dummies.c)):
            if dummies.c[i] < k:
                continue
            fitted = Chebyshev.fit(nodes, np.array(values)[:, i], 14, domain=[-WINDOW, WINDOW])
            expected = fitted.deriv(k)(0.0) if k else fitted(0.0)
            size = max(1.0, abs(expected), np.abs(np.array(values)[:, i]).max() * 5.0**k)
            assert abs(G[place] - expected) < ALIKE * size, (k, i)
            place += 1
    assert place == len(G)


def test_a_poor_choice_is_seen() -> None:
    """Planted: states that the tool nearly determines; their dummies are badly conditioned."""
    here = problem("planar5_mp")
    dummies = dummies_of(here)
    U = here.dae.targets(here.path.sample(np.zeros(1)), dummies.orders)[0]
    rest = dummies.at_rest(here.x_eq)
    best = dummies.choose(rest, U)
    assert dummies.quality(dummies.choice([1, 3, 3, 1, 1, 0, 0]), rest, U) < POOR / 10
    assert dummies.quality(best, rest, U) > 0.5
    with pytest.raises(SolverError, match="singular"):
        dummies.choose(np.zeros(dummies.size), U)  # the stretched arm


def test_other_states_are_chosen_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: another choice than the best at the start, and a threshold that it falls below."""
    here = problem("planar5_mp")
    dummies = dummies_of(here)
    t = np.linspace(0.0, 0.2, 101)

    class Planted(DummyDerivatives):
        asked = 0

        def choose(self, Y: np.ndarray, U: np.ndarray) -> Choice:
            self.asked += 1
            return self.choice([3, 3, 1, 1, 1, 0, 0]) if self.asked == 1 else super().choose(Y, U)

    straight = integrate(dummies, here.path, t, here.x_eq)
    monkeypatch.setattr(dummy_derivatives, "POOR", 0.97)
    changed = integrate(Planted(here.dae, dummies.c, dummies.d), here.path, t, here.x_eq)
    assert straight.choices == 1 and changed.choices >= 2
    tau = [here.torques(dummies.states_of(found.Y)[0]) for found in (changed, straight)]
    assert relative(*tau) < EXACT


def test_consistent_values_are_found_again() -> None:
    here = problem("planar5_mp")
    dummies = dummies_of(here)
    t = np.array([0.0, 0.05, 0.1, 0.15, 0.2])
    Y = integrate(dummies, here.path, t, here.x_eq).Y[-1]
    U = here.dae.targets(here.path.sample(t), dummies.orders)[-1]
    choice = dummies.choose(Y, U)
    scale = dummies.scales(here.x_eq)
    moved = Y + 1e-4 * scale * np.random.default_rng(3).normal(size=len(Y))
    moved[list(choice.states)] = Y[list(choice.states)]
    found, iterations = dummies.consistent(choice, moved, U, scale)
    assert np.abs((found - Y) / scale).max() < 1e-7 and iterations < 10
    with pytest.raises(SolverError, match="leaves the workspace"):
        far = U.copy()
        far[:, 0] = 10.0  # ten meters away
        dummies.consistent(choice, Y, far, scale)


@pytest.mark.parametrize(
    "name", ["planar5_mp", "planar5_mp@undamped", "four_mass@high", "elbow", "elbow@rigid"]
)
def test_the_answer_agrees_and_is_verified(name: str) -> None:
    solution = flexgen.solve(name, method="reduced")
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 0.0) < TOLD
    t = solution.trajectory.time
    on_path = (t >= 0) & (t <= problem(name).path.duration)
    assert relative(solution.trajectory["tau_m"][on_path], reference(name)(t[on_path])) < EXACT


@pytest.mark.slow
@pytest.mark.parametrize("move", ["line", "joints"])
def test_six_axes(move: str) -> None:
    solution = flexgen.solve("manutec_r3", move, method="reduced")
    assert solution.status == Status.SOLVED
    assert (solution.tool_error_max_m or 1) < TOLD and (solution.tool_error_max_rad or 1) < TOLD


@pytest.mark.slow
def test_a_wrong_derivative_of_the_path_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: the third derivative of the target is one percent off."""
    right = InverseDae.targets

    def wrong(self: InverseDae, sample: object, orders: int) -> np.ndarray:
        out = right(self, sample, orders)  # type: ignore[arg-type]
        out[..., 3:] *= 1.01
        return out

    monkeypatch.setattr(InverseDae, "targets", wrong)
    here = problem("planar5_mp")
    t = np.linspace(0.0, here.path.duration, 251)
    found = dummies_of(here)
    tau = here.torques(found.states_of(integrate(found, here.path, t, here.x_eq, 1e-9).Y)[0])
    assert relative(tau, reference("planar5_mp")(t)) > 5 * EXACT  # type: ignore[operator]


@pytest.mark.slow
def test_the_error_falls_with_the_tolerance() -> None:
    here = problem("planar5_mp")
    exact = reference("planar5_mp")
    t = np.linspace(0.0, here.path.duration, 251)
    found = dummies_of(here)
    errors = []
    for rtol in (1e-6, 1e-10):
        Y = integrate(found, here.path, t, here.x_eq, rtol).Y
        errors.append(relative(here.torques(found.states_of(Y)[0]), exact(t)))
    assert errors[1] < EXACT and errors[1] < errors[0] / 100


def test_where_the_structure_hides_the_index_another_method_is_named() -> None:
    """The arm's output does not depend on the accelerations of its elastic coordinate: a zero is
    at infinity.
    """
    with pytest.raises(
        ArgumentError, match=r"does not apply to model abb_arm.*use kunkel-mehrmann or lq"
    ):
        flexgen.solve("abb_arm", method="reduced")


@pytest.mark.parametrize("rtol", [1e-20, 1.0, "tight"])
def test_wrong_options_are_refused(rtol: object) -> None:
    given = problem("planar5_mp").problem
    with pytest.raises(ArgumentError, match="rtol"):
        solve(InversionProblem(given.equations, given.path, options={"rtol": rtol}), 5e-3)
