"""Strangeness index, a, d, v of the inverse dynamics: the theory's table, the general rule, and
refusals.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import casadi as ca
import hypothesis
import numpy as np
import pytest
from planar_family import planar_arm
from random_robots import Case, cases
from shipped_models import shipped

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.dae import strangeness_index as module
from flexgen.dynamics.dae.derivative_array import DerivativeArray
from flexgen.dynamics.dae.strangeness_index import (
    KunkelMehrmann,
    characterize,
    decide_rank,
    kunkel_mehrmann,
    kunkel_mehrmann_at_rest,
    rule,
)
from flexgen.dynamics.dae.system import InverseDae
from flexgen.dynamics.dae.taylor_array import Scales, TaylorArray, consistent, derivative_array
from flexgen.dynamics.dae.taylor_series import RULES, SeriesFunction
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.model.elements import Output
from flexgen.model.reader import model_names, read
from flexgen.paths.path import Path

GAP = 1e4  # every rank of the tables rests on singular values that lie at least so far apart
SERIES = 1e-13  # relative; recurrences against nested differentiation, both exact but for rounding
ARRAY = 1e-12  # of the largest entry
# the inertia A is singular there: the rule does not apply
FLAT = ("abb_arm", "manutec_r3_efjm", "planar5_family")
LARGE = ("manutec_r3_30",)


def numbers(
    found: KunkelMehrmann,
) -> tuple[str, int | None, int | None, int | None, int | None, int | None]:
    return found.verdict, found.mu, found.a, found.d, found.v, found.differential_index


def along(name: str) -> tuple[KunkelMehrmann, ...]:
    equations = flexgen.derive(name)
    moves = {move.name: move for move in equations.model.moves}
    # the joint move of manutec_r3 passes a singular pose of the wrist in the middle
    return kunkel_mehrmann(equations, Path(equations, moves.get("line") or equations.model.move()))


def variants(names: list[str]) -> list[str]:
    return [
        f"{name}@{variant}" if variant else name
        for name in names
        for variant in ("", *shipped(name).variants)
    ]


def is_flat(name: str) -> bool:
    return name.partition("@")[0] in FLAT[:2] or name == FLAT[2]


# --- what the theory says ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variant", "mu", "a", "d", "index"),
    [("", 3, 8, 4, 4), ("@undamped", 4, 10, 2, 5)],
    ids=["damped", "undamped"],
)
@pytest.mark.parametrize("name", ["planar5_mp", "planar5_nmp"])
def test_the_table_of_the_planar_arm(
    name: str, variant: str, mu: int, a: int, d: int, index: int
) -> None:
    for found in (kunkel_mehrmann_at_rest(flexgen.derive(name + variant)), *along(name + variant)):
        assert numbers(found) == ("regular", mu, a, d, 0, index)
        assert found.gap is not None
        assert found.gap > GAP


def has_rule(name: str) -> bool:
    """Whether the rule has the numbers of a model: its rotors turn with their gears alone."""
    return not is_flat(name) and not name.endswith("@coupled")


@pytest.mark.parametrize("name", [n for n in variants(model_names()) if has_rule(n)])
def test_the_general_rule_on_every_model_at_rest(name: str) -> None:
    equations = flexgen.derive(name)
    found = kunkel_mehrmann_at_rest(equations)
    expected = rule(equations)
    assert expected is not None
    assert (found.verdict, (found.mu, found.a, found.d), found.v) == ("regular", expected, 0)
    assert found.gap is not None
    assert found.gap > GAP
    model = equations.model
    kinds = {gear.rigid: gear.damping for gear, _ in gears(model)}
    if set(kinds) == {False}:  # all gears elastic: the rule as the theory states it
        damped = kinds[False] > 0
        n_m = model.n_m
        n_e = model.n_e
        assert expected[1:] == ((4 * n_m, model.n_g + 2 * n_e) if damped else (5 * n_m, 2 * n_e))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow if n in LARGE else ())
        for n in model_names()
        if not is_flat(n)
    ],
)
def test_the_general_rule_along_a_path(name: str) -> None:
    expected = rule(flexgen.derive(name))
    for found in along(name):
        assert (found.verdict, (found.mu, found.a, found.d), found.v) == ("regular", expected, 0)
        assert found.gap is not None
        assert found.gap > GAP


@pytest.mark.parametrize("name", model_names())
def test_d_is_the_number_of_finite_zeros(name: str) -> None:
    """Another route to d: the zero dynamics at rest have as many motions as the output has finite
    zeros.
    """
    analysis = flexgen.analyze(name)
    assert analysis.kunkel_mehrmann.d == len(analysis.zeros.zeros)
    assert analysis.kunkel_mehrmann.a == analysis.kunkel_mehrmann.n - len(analysis.zeros.zeros)


@pytest.mark.slow
@hypothesis.given(cases(coupling="simplified"))
@hypothesis.settings(max_examples=8, deadline=None, derandomize=True)
def test_the_general_rule_on_random_robots(case: Case) -> None:
    """Up to seven motors, all kinds of gears mixed, coupled motors; the output a random
    combination of coordinates.
    """
    model = case.model
    weights = np.random.default_rng(model.n_a).normal(size=(model.n_m, model.n_a))
    output = Output("combination", axes="", weights=tuple(map(tuple, weights)))
    equations = Equations(
        replace(model, output=output, home=tuple(case.states[0].q_a[list(model.i_g)]))
    )
    try:
        analysis = flexgen.analyze(equations)
    except SolverError:  # springs that gravity bends beyond balance
        hypothesis.reject()
    found = analysis.kunkel_mehrmann
    hypothesis.assume(analysis.solvability.singular_values[-1] > 1e-5)
    assert (found.verdict, (found.mu, found.a, found.d), found.v) == (
        "regular",
        rule(equations),
        0,
    )
    assert found.d == len(analysis.zeros.zeros)
    assert analysis.structure_check.holds
    assert (analysis.structure.index, analysis.structure.dof) == (
        found.differential_index,
        found.d,
    )


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        (("rigid", "rigid"), (2, 6, 2)),
        (("rigid", "damped"), (3, 7, 3)),
        (("rigid", "undamped"), (4, 8, 2)),
        (("damped", "undamped"), (4, 9, 3)),
        (("undamped", "damped"), (4, 9, 3)),
    ],
)
def test_mixtures_of_gears(kinds: tuple[str, str], expected: tuple[int, int, int]) -> None:
    changes: dict[str, object] = {}
    for (element, joint), kind in zip((("arm1", "q1"), ("arm2", "q2")), kinds, strict=True):
        if kind == "rigid":
            changes[f"element.{element}.dof.{joint}.gear"] = {"type": "rigid"}
        elif kind == "undamped":
            changes[f"element.{element}.dof.{joint}.gear.damping"] = 0.0
    equations = Equations(read("planar5_nmp", overrides=changes))
    assert rule(equations) == expected
    points = (
        kunkel_mehrmann_at_rest(equations),
        *kunkel_mehrmann(equations, Path(equations, equations.model.move())),
    )
    for found in points:
        assert (found.verdict, (found.mu, found.a, found.d), found.v) == ("regular", expected, 0)


def test_the_flat_point_has_another_index() -> None:
    """Without I_eff, D s + K is left: one motion less, one derivative more."""
    arm = planar_arm(np.random.default_rng(1), distance=0.0)
    equations = Equations(arm.model)
    assert numbers(kunkel_mehrmann_at_rest(equations)) == ("regular", 4, 9, 3, 0, 5)
    near = planar_arm(np.random.default_rng(1), distance=-1e-3)
    assert numbers(kunkel_mehrmann_at_rest(Equations(near.model))) == ("regular", 3, 8, 4, 0, 4)


@pytest.mark.parametrize(
    ("name", "expected"), [("abb_arm", (4, 5, 2)), ("manutec_r3_efjm", (5, 23, 25))]
)
def test_models_with_a_singular_inertia(name: str, expected: tuple[int, int, int]) -> None:
    found = kunkel_mehrmann_at_rest(flexgen.derive(name))
    assert (found.mu, found.a, found.d) == expected


@pytest.mark.slow
def test_a_singular_inertia_along_a_path() -> None:
    for found in along("manutec_r3_efjm"):
        assert numbers(found) == ("regular", 5, 23, 25, 0, 6)


def test_fewer_outputs_than_motors_leave_an_unknown_free() -> None:
    equations = Equations(read("planar5_mp", overrides={"output.axes": "x"}))
    found = kunkel_mehrmann_at_rest(equations)
    assert (found.verdict, found.v) == ("free", 0)
    assert found.a is not None
    assert found.d is not None
    assert found.n - found.a - found.d == 1
    assert rule(equations) is None


def test_a_repeated_output_adds_no_rank() -> None:
    model = read("four_mass@high")
    row = model.output.weights[0]
    equations = Equations(replace(model, output=replace(model.output, weights=(row, row))))
    found = kunkel_mehrmann_at_rest(equations)
    assert (found.verdict, found.v, found.d) == ("free", 1, 5)


@pytest.mark.parametrize("name", ["planar5_nmp@undamped", "urdf_arm", "abb_arm", "elbow@rigid"])
def test_eliminating_definitions_does_not_change_the_numbers(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = kunkel_mehrmann_at_rest(flexgen.derive(name))
    none = np.zeros(0, dtype=int)
    monkeypatch.setattr(module, "definitions", lambda F_x, F_dx: (none, none, none))
    long = kunkel_mehrmann_at_rest(flexgen.derive(name))
    assert numbers(short) == numbers(long)
    assert sum(rank.rank for rank in long.ranks) > sum(rank.rank for rank in short.ranks)


def chain(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Series of F_x and F_x' of x1' = x2, ..., x1 = f(t): index n, everything algebraic."""
    F_x = np.zeros((n + 1, n, n))
    F_dx = np.zeros((n + 1, n, n))
    for k in range(n - 1):
        F_dx[0, k, k] = 1.0
        F_x[0, k, k + 1] = -1.0
    F_x[0, n - 1, 0] = 1.0
    return F_x, F_dx


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_a_chain_of_integrators(n: int) -> None:
    found = characterize(*chain(n), Scales(1.0, np.ones(n), np.ones(n)))
    assert numbers(found) == ("regular", n - 1, n, 0, 0, n)


# --- planted bugs --------------------------------------------------------------------------------


def test_gear_damping_that_is_ignored_is_seen() -> None:
    equations = flexgen.derive("planar5_nmp")
    dae = InverseDae(equations)
    series = TaylorArray(dae)
    whole = series.jacobians

    def undamped(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        F_x, F_dx = whole(x)
        motors = dae.rate[equations.model.n_a :]
        F_x[:, :, dae.dynamic[:2, None], motors] = 0.0
        F_x[:, :, dae.dynamic[:2, None], dae.rate[:2]] = 0.0
        return F_x, F_dx

    x = np.zeros((1, 10, dae.n_x))
    x[0, 0] = dae.pack(flexgen.analyze(equations).equilibrium)
    F_x, F_dx = undamped(x)
    assert numbers(characterize(F_x[0], F_dx[0], series.scales(x[0, 0])))[1:4] == (4, 10, 2)


def nested_array(
    dae: InverseDae, path: Path, t: float, jets: np.ndarray, mu: int
) -> tuple[np.ndarray, np.ndarray]:
    """F_mu and its Jacobian by CasADi's own nested differentiation, in derivatives of x (not
    Taylor coefficients).
    """
    equations = dae.equations
    model = dae.model
    levels = [ca.SX.sym(f"x{k}", dae.n_x) for k in range(mu + 2)]
    x, dx = levels[:2]
    n_a = model.n_a
    n = model.dof
    q = x[:n_a]
    q_m = x[n_a:n]
    v = x[n : n + n_a]
    v_m = x[n + n_a : 2 * n]
    r_a, r_m = equations.function("residual")(
        q, v, dx[n : n + n_a], q_m, v_m, dx[n + n_a : 2 * n], x[2 * n :]
    )
    rows = [dx[:n] - x[n : 2 * n], r_a, r_m, equations.function("output")(q)]
    F = [ca.vertcat(*rows)]
    for _ in range(mu):
        F.append(ca.jtimes(F[-1], ca.vertcat(*levels[:-1]), ca.vertcat(*levels[1:])))
    sample = path.sample(np.array([t]))
    values = [jets[k] * math.factorial(k) for k in range(mu + 2)]
    both = ca.Function(
        "F", levels, [ca.vertcat(*F), ca.jacobian(ca.vertcat(*F), ca.vertcat(*levels))]
    )
    found, slope = (np.array(y) for y in both(*values))
    found = found.reshape(mu + 1, dae.m)
    for k in range(mu + 1):
        found[k, dae.output] -= sample.y[0, :, k]
    return found, slope


@pytest.mark.parametrize("name", ["planar5_nmp", "planar5_soft@undamped", "four_mass", "elbow"])
def test_the_array_against_nested_differentiation(name: str) -> None:
    equations = flexgen.derive(name)
    dae = InverseDae(equations)
    path = Path(equations, equations.model.move())
    mu = 3
    series = TaylorArray(dae)
    t = 0.37 * path.duration
    x, scales = consistent(series, path, np.array([t]), mu)
    found, slope = nested_array(dae, path, t, x[0], mu)
    units = np.concatenate(
        [scales[0].rows * scales[0].time ** k / math.factorial(k) for k in range(mu + 1)]
    )
    assert np.abs(found.ravel() * units).max() < 1e-9  # a consistent point by this route, too
    ones = Scales(1.0, np.ones(dae.n_x), np.ones(dae.m))
    F_x, F_dx = (J[0] for J in series.jacobians(x))
    taylor = np.concatenate([np.full(dae.n_x, math.factorial(k)) for k in range(mu + 2)])
    rows = np.concatenate([np.full(dae.m, math.factorial(k)) for k in range(mu + 1)])

    def difference(F_x: np.ndarray) -> float:
        array = derivative_array(F_x, F_dx, mu, ones) * rows[:, None] / taylor
        size = np.abs(slope).max(axis=1, keepdims=True) + 1e-300
        return float(np.abs((array - slope) / size).max())

    assert difference(F_x) < ARRAY
    wrong = F_x.copy()
    wrong[:, dae.dynamic[0]] *= -1  # planted bug: a row with the wrong sign
    assert difference(wrong) > 0.1
    late = F_x.copy()
    late[1:] = 0.0  # planted bug: derivatives of the Jacobian left out
    assert difference(late) > ARRAY or name == "four_mass"  # which is linear there


@pytest.mark.parametrize("name", ["planar5_nmp", "elbow"])
def test_both_evaluators_have_the_same_array(name: str) -> None:
    """The Jacobian by Taylor series against the CasADi functions, in derivatives of x at a
    consistent point.
    """
    equations = flexgen.derive(name)
    dae = InverseDae(equations)
    path = Path(equations, equations.model.move())
    mu = 3
    series = TaylorArray(dae)
    t = np.array([0.37 * path.duration])
    x, scales = consistent(series, path, t, mu)
    factorials = np.array([math.factorial(k) for k in range(mu + 2)])
    X = (x[0] * factorials[:, None]).T
    U = dae.targets(path.sample(t), mu)[0]
    F, N, M = (z.full() for z in DerivativeArray(dae, mu).function(X, U))
    units = np.concatenate(
        [scales[0].rows * scales[0].time ** k / math.factorial(k) for k in range(mu + 1)]
    )
    assert np.abs(F.ravel() * units).max() < 1e-9
    F_x, F_dx = (J[0] for J in series.jacobians(x))
    ones = Scales(1.0, np.ones(dae.n_x), np.ones(dae.m))
    array = derivative_array(F_x, F_dx, mu, ones)
    array *= np.repeat(factorials[: mu + 1], dae.m)[:, None] / np.repeat(factorials, dae.n_x)
    expected = np.hstack([N, M])
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert np.abs((array - expected) / size).max() < ARRAY
    array[dae.dynamic[0]] *= -1  # planted bug
    assert np.abs((array - expected) / size).max() > 0.1


@pytest.mark.parametrize("name", ["planar5_nmp", "kr300", "manutec_r3_18"])
def test_a_consistent_point_follows_the_path(name: str) -> None:
    """The Taylor polynomial of the coordinates, put into the forward kinematics, against the path
    itself.
    """
    equations = flexgen.derive(name)
    series = TaylorArray(InverseDae(equations))
    path = Path(equations, equations.model.move())
    order = 4
    t = 0.37 * path.duration
    x, _ = consistent(series, path, np.array([t]), order)
    n_a = equations.model.n_a

    def error(ahead: float) -> float:
        q = sum(x[0, k, :n_a] * ahead**k for k in range(order + 1))
        sample = path.sample(np.array([t + ahead]))
        found = evaluate(equations.function("output"), q)[0][0]
        worst = np.abs(found - sample.y[0, :, 0]).max()
        if sample.R is not None:
            worst = max(
                worst,
                np.abs(evaluate(equations.function("forward_kinematics"), q)[1] - sample.R).max(),
            )
        return float(worst)

    step = 4e-3 * path.duration
    assert error(0.0) < 1e-12
    assert error(step) < 1e-6
    # the first term that is left out is of order + 1: half the step, one thirty-second of the
    # error
    assert 20 < error(2 * step) / error(step) < 48


# --- ranks, series, refusals ---------------------------------------------------------------------


def test_a_rank_without_a_gap_is_undecided() -> None:
    clear = decide_rank([np.diag([1.0, 1e-3, 1e-15])])
    assert (clear.rank, clear.decided) == (2, True)
    assert clear.gap > 1e11
    blurred = np.diag([1.0, 1e-3, 1e-12])
    assert not decide_rank([blurred]).decided
    # a scaling that hides it does not help
    assert not decide_rank([blurred, np.diag([1.0, 1e-3, 1e-16])]).decided
    seen = decide_rank([blurred, np.diag([1.0, 1e-2, 1e-9])])  # one that shows it does
    assert (seen.rank, seen.decided) == (3, True)
    for nothing in (np.zeros((2, 2)), np.zeros((0, 3))):
        assert (decide_rank([nothing]).rank, decide_rank([nothing]).decided) == (0, True)


def test_an_almost_flat_arm_is_undecided() -> None:
    arm = planar_arm(np.random.default_rng(1), distance=1e-7)
    found = kunkel_mehrmann_at_rest(Equations(arm.model))
    assert (found.verdict, found.mu, found.differential_index) == ("undecided", None, None)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["verdict"] == "undecided"


def test_not_found_below_the_index() -> None:
    found = kunkel_mehrmann_at_rest(flexgen.derive("planar5_nmp"), highest=2)
    assert (found.verdict, found.mu) == ("not found", None)


@pytest.mark.parametrize("times", [[], [0.2, 0.1], [float("nan")], [[0.1]]])
def test_wrong_instants_are_refused(times: list[float]) -> None:
    equations = flexgen.derive("planar5_nmp")
    with pytest.raises(ArgumentError, match="rising instants"):
        kunkel_mehrmann(equations, Path(equations, equations.model.move()), times)


def test_a_path_out_of_reach_is_refused() -> None:
    equations = flexgen.derive("planar5_nmp")
    far = replace(equations.model.move(), displacement=(3.0, 0.0, 0.0))
    with pytest.raises(SolverError, match=r"no static equilibrium|singular pose"):
        kunkel_mehrmann(equations, Path(equations, far))


def test_series_of_every_operation() -> None:
    x = ca.SX.sym("x", 4)
    t = ca.SX.sym("t")
    a, b, c, d = ca.vertsplit(x)
    terms = [
        a * b + c,
        a - b / c,
        ca.sin(a) * ca.cos(b) + ca.tan(c),
        ca.sinh(a) - ca.cosh(b) * ca.tanh(c),
        ca.exp(a) * ca.log(c) + ca.sqrt(c) + 1 / b + ca.atan(a) - ca.asinh(b),
        c**2.5 + c**a + a**3 + a**2,
        ca.fabs(d) * ca.sign(d)
        + ca.if_else(a <= b, c, d)
        + ca.if_else(ca.logic_and(a < b, c > d), a * b, -c),
        ca.fmin(a, b) * ca.fmax(c, d)
        + ca.if_else(ca.logic_or(a == b, ca.logic_not(c != d)), a, b),
        2 * a,
    ]
    function = ca.Function("f", [x], [ca.vertcat(*terms), ca.SX(ca.horzcat(a, 0, b))])
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    assert used - {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST} <= set(RULES)
    rng = np.random.default_rng(5)
    order = 6
    curves = 0.4 * rng.normal(size=(2, order + 1, 4))
    curves[:, 0] = [[0.3, 0.8, 1.5, -0.4], [0.9, 0.5, 0.7, 0.2]]
    found, table = SeriesFunction(function)(curves)
    assert table.shape == (2, order + 1, 1, 3)
    assert np.array_equal(table[:, :, 0, 2], curves[:, :, 1])
    for curve, series in zip(curves, found, strict=True):
        y = function(
            ca.vertcat(
                *[sum(float(curve[k, i]) * t**k for k in range(order + 1)) for i in range(4)]
            )
        )[0]
        for k in range(order + 1):
            expected = np.array(ca.Function("y", [t], [y])(0.0))[:, 0] / math.factorial(k)
            assert np.abs(series[k] - expected).max() < SERIES * (1 + np.abs(expected).max())
            y = ca.jacobian(y, t)
    with pytest.raises(ArgumentError, match="no series rule"):
        SeriesFunction(ca.Function("f", [x], [ca.erf(x[0])]))
