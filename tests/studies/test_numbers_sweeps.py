"""Numbers of flexgen/studies/sweeps and flexgen/dynamics/dae: batches against flexgen's functions,
series against derivatives.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import replace
from inspect import unwrap
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae import block_form, taylor_array, taylor_series
from flexgen.dynamics.dae.strangeness_index import (
    decide_rank,
    definitions,
    rule,
    without_definitions,
)
from flexgen.dynamics.dae.structure import smallest_ratio
from flexgen.dynamics.dae.system import InverseDae, _hat
from flexgen.dynamics.dae.taylor_series import SeriesFunction
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.force_laws import friction_torque
from flexgen.model.elements import Friction
from flexgen.model.moves import Move
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.studies.sweeps import batches, cases, closed_form_batch, folder, summary, sweep
from flexgen.studies.sweeps.closed_form_batch import (
    JointMoves,
    Peaks,
    friction,
    friction_derivatives,
)
from flexgen.studies.sweeps.jobs import Job
from flexgen.studies.sweeps.table import RESULTS, TIMES, Column, Table, are_rows, table_of

FRICTION = Friction(viscous=0.3, coulomb=0.8, stribeck=0.4, alpha=2.0, beta=5.0, offset=0.1)


@pytest.mark.parametrize("law", [FRICTION, Friction(viscous=0.5), Friction(coulomb=0.7, beta=9.0)])
def test_friction_of_batches_is_that_of_the_model_with_two_derivatives(law: Friction) -> None:
    w = ca.SX.sym("w")
    torque = friction_torque(law, w)
    first = ca.jacobian(torque, w)
    of = ca.Function("f", [w], [torque, first, ca.jacobian(first, w)])
    speeds = np.array([-3.0, -0.2, 0.0, 0.15, 1.3])
    expected = [np.array(x).ravel() for x in of.map(5)(speeds[None])]
    assert_allclose(friction(law, speeds), expected[0], rtol=1e-12, atol=1e-14)
    for found, other in zip(friction_derivatives(law, speeds), expected, strict=True):
        assert_allclose(found, other, rtol=1e-10, atol=1e-12)
    assert np.isfinite(friction(FRICTION, np.array([1e4, -1e4]))).all()


def test_parts_of_batches_by_hand() -> None:
    s = np.random.default_rng(1).normal(size=(3, 6))
    found = closed_form_batch._taylor(s, 0.2)
    for k in range(3):
        terms = [s[:, k + i] * 0.2**i / [1, 1, 2, 6, 24][i] for i in range(5 - k)]
        assert_allclose(found[k], sum(terms))
    A = np.array([[2.0, 0.0], [1.0, -3.0]])
    x = np.random.default_rng(2).normal(size=(2, 3, 4))
    assert_allclose(closed_form_batch._multiply(A, x), np.einsum("ij,jkl->ikl", A, x))
    assert_array_equal(closed_form_batch._largest(x), np.abs(x).max(axis=1))
    t = 0.1 * np.arange(3)
    assert_allclose(closed_form_batch._integral(x, t), np.trapezoid(x, t, axis=1))


def test_torques_of_a_batch_are_the_inverse_dynamics_of_the_elastic_robot() -> None:
    """The gear torque, its second derivative by differences of the exact function, and the motors,
    at five instants.
    """
    equations = flexgen.derive("elbow")
    model = equations.model
    law = TimeLaw(0.8, 6)
    moves = JointMoves(equations, law, step=2e-3)
    starts = np.array([[0.1, 0.4], [0.5, -0.3], [0.2, 0.9]])
    ends = np.array([[0.6, 0.2], [0.1, 0.8], [0.2, 0.1]])
    tau = moves.torques(starts, ends)
    peaks = moves.peaks(starts, ends)
    t = moves.t
    inverse = np.linalg.inv(model.eta)
    h = 1e-4
    function = equations.function("inverse_dynamics")
    stiffness = [c.dof.gear.spring.stiffness for c in model.coordinates]
    damping = [c.dof.gear.damping for c in model.coordinates]
    side = [
        1.0 if c.dof.gear.side == "arm" else abs(model.eta[k, k])
        for k, c in enumerate(model.coordinates)
    ]
    K = np.array(stiffness) * np.square(side)
    D = np.array(damping) * np.square(side)

    def needed(k: int, at: float) -> np.ndarray:
        s = law(np.array([at]), 2)[0]
        q = starts[k] + (ends[k] - starts[k]) * s[0]
        v = (ends[k] - starts[k]) * s[1]
        a = (ends[k] - starts[k]) * s[2]
        return np.array(function(q, v, a)).ravel(), v, a

    for k in (0, 1, 2):
        for i in np.searchsorted(t, [0.2, 0.35, 0.5]):
            torques = np.array([needed(k, t[i] + j * h)[0] for j in (-2, -1, 0, 1, 2)])
            rate = (torques[3] - torques[1]) / (2 * h)
            bend = (torques[3] - 2 * torques[2] + torques[1]) / h**2
            jolt = (torques[4] - 2 * torques[3] + 2 * torques[1] - torques[0]) / (2 * h**3)
            lag = D / K  # deflection with a weak damper: d = tau/K - (D/K) d' + ...
            d1 = rate / K - lag * bend / K
            d2 = bend / K - lag * jolt / K
            _, v, a = needed(k, t[i])
            v_m = model.eta @ (v + d1)
            a_m = model.eta @ (a + d2)
            motor = np.array(equations.function("motor_friction")(v_m)).ravel()
            expected = inverse.T @ torques[2] + [m.inertia for m in model.motors] * a_m + motor
            assert_allclose(tau[k, i], expected, rtol=2e-2, atol=2e-2 * np.abs(expected).max())
    assert_allclose(peaks.torque_max, np.abs(tau).max(axis=1), rtol=1e-12)
    assert_allclose(peaks.torque_rms, np.sqrt(np.trapezoid(tau**2, t, axis=1) / t[-1]), rtol=1e-9)
    s = np.abs(law(t, 2)).max(axis=0)
    assert_allclose(peaks.speed, np.abs(ends - starts) * s[1])
    assert_allclose(peaks.acceleration, np.abs(ends - starts) * s[2])
    moved = (model.eta @ (ends - starts).T).T
    assert_allclose(peaks.speed_max, np.abs(moved) * s[1], rtol=0.01, atol=3.0)
    alone = moves.torques(starts[1:2], ends[1:2])
    assert_array_equal(alone[0], tau[1])
    for bad, text in (
        (
            (starts[:, :1], ends),
            r"joint moves: given starts \(3, 1\) and ends \(3, 2\), expected \(N, 2\) for both",
        ),
        ((starts * np.nan, ends), "not finite, expected finite numbers"),
    ):
        with pytest.raises(ArgumentError, match=text):
            moves.torques(*bad)

    def broken(q: np.ndarray, v: np.ndarray, a: np.ndarray, out: np.ndarray) -> None:
        out[...] = np.nan

    with pytest.raises(SolverError, match="joint moves 0 to 2: the torques are not finite"):
        JointMoves(equations, law, broken, 2e-3).torques(starts, ends)
    with pytest.raises(
        ArgumentError,
        match=r"a time constant of 0\.00015 s, much less than a sample of 0\.05 s; use flexgen",
    ):
        JointMoves(equations, law, step=0.05)
    with pytest.raises(
        ArgumentError,
        match=r"batch of joint moves: model .* coordinates without motor .*; use flexgen.solve",
    ):
        JointMoves(flexgen.derive("planar5_nmp"), law)


def test_limits_of_a_batch() -> None:
    dof = SimpleNamespace(speed_max=2.0, acceleration_max=None, lower=-1.0, upper=1.5)
    robot = SimpleNamespace(
        i_g=(0, 1),
        coordinates=[SimpleNamespace(dof=dof), SimpleNamespace(dof=None)],
        motors=[
            SimpleNamespace(torque_max=5.0, speed_max=None),
            SimpleNamespace(torque_max=None, speed_max=9.0),
        ],
    )
    one = np.ones((1, 2))

    def beyond(start: float = 0.0, end: float = 1.0, **more: tuple[float, float]) -> bool:
        parts = {name: np.array([more.get(name, (1.0, 1.0))]) for name in Peaks.__annotations__}
        return bool(batches._beyond(robot, Peaks(**parts), start * one, end * one)[0])

    cases_ = [
        {},
        {"torque_max": (5.0, 99)},
        {"torque_max": (5.1, 1)},
        {"speed_max": (99, 9.0)},
        {"speed_max": (1, 9.1)},
        {"speed": (2.0, 99)},
        {"speed": (2.1, 1)},
        {"acceleration": (99, 99)},
        {"end": 1.6},
        {"start": -1.1},
        {"start": -1.0},
    ]
    assert [beyond(**x) for x in cases_] == [0, 0, 1, 0, 1, 0, 1, 0, 1, 1, 0]


def test_a_batch_that_fails_is_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def figures(robot: object, mover: object, starts: np.ndarray, ends: np.ndarray) -> list[dict]:
        asked.append(len(starts))
        if 3.0 in starts:
            raise SolverError("three")
        return [{"x": float(x[0])} for x in starts]

    monkeypatch.setattr(batches, "figures", figures)
    found = batches.figures_or_reasons(None, None, np.arange(5.0)[:, None], np.zeros((5, 1)))
    assert found == [
        {"x": 0.0},
        {"x": 1.0},
        {"x": 2.0},
        {"status": "failed", "error": "three"},
        {"x": 4.0},
    ]
    assert asked == [5, 2, 3, 1, 2, 1, 1]


def test_random_moves_are_within_the_limits() -> None:
    """Draws of NumPy's generator for (seed, number), the way bounded by position, speed and
    acceleration.
    """
    made = cases.RandomMove(3, 5, 0.5, 4)
    unlimited = SimpleNamespace(
        dof=SimpleNamespace(lower=None, upper=None, speed_max=None, acceleration_max=None),
        unit="m",
    )
    tight = SimpleNamespace(
        dof=SimpleNamespace(lower=-1.0, upper=2.0, speed_max=0.4, acceleration_max=None),
        unit="rad",
    )
    slow = SimpleNamespace(
        dof=SimpleNamespace(lower=-1.0, upper=2.0, speed_max=99.0, acceleration_max=0.3),
        unit="rad",
    )
    move = unwrap(cases.RandomMove.of)(
        made, SimpleNamespace(n_g=3, i_g=(0, 1, 2), coordinates=[unlimited, tight, slow])
    )
    draw = np.random.default_rng([5, 3]).random((2, 3))
    s = np.abs(TimeLaw(1.0, 4)(np.linspace(0, 1, 2001), 2)).max(axis=0)
    ways = [1.0, 0.999 * 0.4 * 0.5 / s[1], 0.999 * 0.3 * 0.25 / s[2]]
    for k, (low, high) in enumerate([(-0.5, 0.5), (-1, 2), (-1, 2)]):
        start = low + (high - low) * draw[0, k]
        first = max(low, start - ways[k])
        last = min(high, start + ways[k])
        assert move.start[k] == pytest.approx(start) and move.end[k] == pytest.approx(
            first + (last - first) * draw[1, k]
        )
    assert (move.name, move.duration, move.smoothness, move.type) == ("random3", 0.5, 4, "joint")
    default = cases.RandomMove(7)
    assert (default.seed, default.duration, default.smoothness) == (0, 1.0, 5)
    assert [m.number for m in cases.random_moves(3, 1, 2.0, 6)] == [
        0,
        1,
        2,
    ] and cases.random_moves(0) == ()


def test_a_grid_counts_models_slowest_and_methods_fastest() -> None:
    grid = cases.Grid(["elbow", "planar5_nmp"], ["a", None, "b"], ["x", "y"], [{}, {"k": 1}])
    assert len(grid) == 24 and [c.number for c in grid] == list(range(24))
    for k in (0, 1, 2, 6, 13, 23):
        m = k // 12
        p = k // 6 % 2
        v = k // 2 % 3
        w = k % 2
        case = grid[k]
        expected = (grid.models[m], grid.parameters[p], grid.moves[v], grid.methods[w])
        assert (case.model, case.parameters, case.move, case.method) == expected
    for k in (-1, 24):
        with pytest.raises(IndexError, match=f"case {k} of 24"):
            grid[k]
    assert folder.default_size(grid) == 1 and folder.default_size(cases.Grid(["x"] * 640)) == 10
    assert folder.default_size(cases.Grid(["x"] * 6400)) == 16
    assert folder.default_size(cases.Grid(["x"] * 64_000, options={"batch": True})) == 512
    assert list(sweep._numbers(grid, 2, 10)) == [20, 21, 22, 23] and list(
        sweep._numbers(grid, 1, 10)
    ) == list(range(10, 20))
    assert cases.combinations({"a": [1, 2], "b": ["x"]}) == (
        {"a": 1, "b": "x"},
        {"a": 2, "b": "x"},
    )
    for bad, text in (
        ({"models": "elbow"}, "models"),
        ({"models": []}, "one or more"),
        ({"models": ["x"], "moves": [3]}, "moves"),
        ({"models": ["x"], "options": {"mush": 1}}, "options: given 'mush'"),
    ):
        with pytest.raises(ArgumentError, match=text):
            cases.Grid(**bad)
    with pytest.raises(ArgumentError, match="given parameters for the RobotModel elbow"):
        cases.Case(0, flexgen.read("elbow"), {"a": 1}, None, "auto").robot()
    job = Job.of(cases.Case(4, "elbow", {"b": 1, "a": 2}, cases.RandomMove(9), "auto"), "key")
    assert job.heading == {
        "case": 4,
        "model": "elbow",
        "parameters": '{"a": 2, "b": 1}',
        "move": "random9",
        "method": "auto",
    }
    named = Job.of(
        cases.Case(0, "elbow", {}, Move("m", "joint", (0.0,), 1.0, 5, end=(1.0,)), "lq"), "key"
    )
    assert (
        named.heading["move"] == "m"
        and Job.of(cases.Case(0, "x", {}, None, "lq"), "k").heading["move"] == ""
    )


def test_tables_and_their_summary() -> None:
    rows = [
        {
            "case": 0,
            "model": "a",
            "method": "lq",
            "status": "solved",
            "torque_max": 3.0,
            "tool_error_max": 1e-6,
        },
        {
            "case": 1,
            "model": "a",
            "method": "lq",
            "status": "solved",
            "torque_max": 7.0,
            "tool_error_max": None,
        },
        {"case": 2, "model": "b", "method": "lq", "status": "failed", "error": "at 3.1 s"},
    ]
    results = table_of(RESULTS, rows)
    times = table_of(
        TIMES, [{"case": k, "cpu": 1.5 + k, "wall": 9.0} for k in range(2)] + [{"case": 2}]
    )
    first, second = summary.summarize(results, times)
    assert first == {
        "model": "a",
        "method": "lq",
        "status": "solved",
        "cases": 2,
        "tool_error_max": 1e-6,
        "turn_error_max": None,
        "torque_max": 7.0,
        "cpu": 4.0,
    }
    assert second["cases"] == 1 and second["torque_max"] is None and second["cpu"] == 0.0
    groups = summary.group_reasons([4, 5, 6, 7], ["x 1", "at 3.1 s", "at 1e-5 s", "at 2 s"])
    assert groups == [{"reason": "at 3.1 s", "cases": [5, 6, 7]}, {"reason": "x 1", "cases": [4]}]
    assert (
        results["iterations"].tolist() == [-1] * 3
        and np.isnan(results["energy"]).all()
        and results["warnings"][0] == ""
    )
    assert (
        len(results) == 3
        and table_of(RESULTS, rows).digest == results.digest != table_of(RESULTS, rows[:2]).digest
    )
    text = Column("t", "text", "", "")
    assert len(table_of((text,), [{"t": "x" * 500}])["t"][0]) == 400
    columns = (Column("case", "int", "1", ""), Column("x", "float", "1", ""), text)
    good = [{"case": 0, "x": 1.5, "t": "a"}, {"case": 1, "x": None, "more": []}]
    assert (
        are_rows(good, columns, range(2))
        and not are_rows(good, columns, range(3))
        and not are_rows("x", columns, [])
    )
    for bad in ({"case": 1, "x": "a"}, {"case": 1, "x": 2**63}, {"case": 1.0}, {"case": 2}, 7):
        assert not are_rows([good[0], bad], columns, range(2))
    assert are_rows([{"case": -(2**63)}], columns, [-(2**63)]) and not are_rows(
        [{"case": 2**63}], columns, [2**63]
    )
    assert [sweep._span(x) for x in (99.4, 100.0, 5999.0, 6000.0)] == [
        "99 s",
        "2 min",
        "100 min",
        "1.7 h",
    ]
    lines: list[str] = []
    report = sweep._Progress(10, 4, lines.append)
    report.add(
        SimpleNamespace(results=[{"status": "failed"}, {"status": "solved"}, {"status": "solved"}])
    )
    assert lines[0] == "6 of 10 cases are finished already" and lines[1].startswith(
        "9 of 10 cases, 1 failed, "
    )


def test_wrong_arguments_of_a_sweep() -> None:
    grid = cases.Grid(["elbow"])
    none = [None] * 5
    sweep._check_arguments(grid, "x", 0, None, 1, True, 1)
    for given, text in (
        ((5, *none[:4], False, None), "grid: given 5, expected a Grid"),
        ((grid, None, -1, None, None, False, None), "workers"),
        ((grid, None, None, None, 0, False, None), "shard_size"),
        ((grid, None, None, None, None, False, 0), "in_flight"),
        ((grid, None, 1, object(), None, False, None), "together with"),
        ((grid, None, None, 7, None, False, None), "executor: given 7"),
        ((grid, None, None, None, None, True, None), "resume"),
    ):
        with pytest.raises(ArgumentError, match=text):
            sweep._check_arguments(*given)


UNARY = {
    "sqrt": ca.sqrt,
    "exp": ca.exp,
    "log": ca.log,
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "atan": ca.atan,
    "asinh": ca.asinh,
    "fabs": ca.fabs,
    "inverse": lambda x: 1 / x,
    "square": lambda x: x * x,
    "negative": lambda x: -x,
    "twice": lambda x: x + x,
    "cube": lambda x: x**3,
    "power": lambda x: x**1.7,
    "sign": ca.sign,
    "least": lambda x: ca.fmin(x, 2.0),
    "most": lambda x: ca.fmax(x, 2.0),
    "quotient": lambda x: (x + 1) / (2 + x * x),
    "switch": lambda x: ca.if_else(x > 1, x * x, x),
    "power of": lambda x: x**x,
    "logic": lambda x: (
        x * ca.logic_and(x > 0, x <= 1) + ca.logic_or(x == 1, x != 2) - ca.logic_not(x) + (x < 3)
    ),
}


@pytest.mark.parametrize("name", list(UNARY))
def test_series_of_an_operation_are_its_derivatives_along_a_curve(name: str) -> None:
    """x(t) = x0 + 0.7 t - 0.4 t^2 + 0.9 t^3 - 0.2 t^4 at two points; derivatives in t by CasADi,
    over the factorial.
    """
    x = ca.SX.sym("x")
    t = ca.SX.sym("t")
    found = SeriesFunction(ca.Function("f", [x], [UNARY[name](x)]))
    start = np.array([0.6, 1.4])
    more = [0.7, -0.4, 0.9, -0.2]
    series = np.stack([start, *(np.full(2, c) for c in more)], axis=1)[:, :, None]
    value = found(series)[0]
    y = UNARY[name](x)
    y = ca.substitute(y, x, x + sum(c * t ** (k + 1) for k, c in enumerate(more)))
    for k in range(5):
        at = ca.Function("at", [x, t], [y])
        expected = [float(at(s, 0.0)) for s in start]
        assert_allclose(value[:, k, 0], expected, rtol=1e-11, atol=1e-12)
        y = ca.jacobian(y, t) / (k + 1)


def test_series_of_functions_with_many_entries() -> None:
    x = ca.SX.sym("x", 2)
    y = ca.SX.sym("y")
    function = ca.Function("f", [x, y], [ca.vertcat(x[0] * y, 3.0), ca.diag(x * y)])
    series = (
        np.random.default_rng(4).normal(size=(3, 2, 2)),
        np.random.default_rng(5).normal(size=(3, 2, 1)),
    )
    column, square = SeriesFunction(function)(*series)
    product = [
        series[0][:, 0] * series[1][:, 0],
        series[0][:, 0] * series[1][:, 1] + series[0][:, 1] * series[1][:, 0],
    ]
    assert_allclose(column[:, :, 0], np.stack([p[:, 0] for p in product], axis=1))
    assert_allclose(column[:, :, 1], [[3.0, 0.0]] * 3)
    for k in range(2):
        assert_allclose(square[:, k], [np.diag(row) for row in product[k]])
    with pytest.raises(ArgumentError, match=r"function f: operation \d+ has no series rule"):
        SeriesFunction(ca.Function("f", [y], [ca.erf(y)]))
    a = np.random.default_rng(6).normal(size=(1, 3, 1))
    assert_array_equal(taylor_series._one(a)[0, :, 0], [1, 0, 0])


def test_targets_of_a_pose_are_the_derivatives_of_its_rotation() -> None:
    """R = exp(hat(w t + b t^2)) about one axis: derivatives by CasADi of cosine and sine."""
    axis = np.array([2.0, -1.0, 2.0]) / 3
    hat = _hat(axis[None])[0]
    assert_allclose(hat @ [1.0, 5.0, -2.0], np.cross(axis, [1.0, 5.0, -2.0]))
    t = ca.SX.sym("t")
    angle = 0.3 + 0.8 * t + 0.5 * t**2
    R = ca.DM.eye(3) + ca.sin(angle) * ca.DM(hat) + (1 - ca.cos(angle)) * ca.DM(hat @ hat)
    expected = []
    rate = R
    for _ in range(4):
        expected.append(np.array(ca.Function("R", [t], [rate])(0.0)))
        rate = ca.reshape(ca.jacobian(ca.vec(rate), t), 3, 3)
    assert_allclose(expected[0], Rotation.from_rotvec(0.3 * axis).as_matrix(), atol=1e-12)
    speed = np.stack([0.8 * axis, 1.0 * axis, 0 * axis], axis=1)[None]
    y = np.random.default_rng(7).normal(size=(1, 3, 5))
    sample = SimpleNamespace(y=y, R=expected[0][None], w=speed, q_g=None)
    made = object.__new__(InverseDae)
    made.joints = False
    found = made.targets(sample, 3)
    assert found.shape == (1, 12, 4)
    assert_allclose(found[0, :3], y[0, :, :4])
    for k in range(4):
        assert_allclose(found[0, 3:, k], expected[k].T.ravel(), atol=1e-12)
    with pytest.raises(
        ArgumentError, match="path: given derivatives up to order 4, expected up to order 5"
    ):
        made.targets(sample, 5)
    made.joints = True
    with pytest.raises(
        ArgumentError, match="given derivatives none of the joints, expected up to order 1"
    ):
        made.targets(sample, 1)


def test_rows_and_scales_of_the_dae_at_an_equilibrium() -> None:
    equations = flexgen.derive("planar5_nmp")
    dae = InverseDae(equations)
    model = equations.model
    assert (dae.n, dae.n_x, dae.m, dae.n_u) == (model.dof, 2 * model.dof + 2, 2 * model.dof + 2, 2)
    chance = np.random.default_rng(8)
    x, dx = 0.2 * chance.normal(size=(2, dae.n_x))
    F, A, E = (np.array(z) for z in dae.rows(x, dx, np.array([0.1, 0.2])))
    assert_allclose(F[dae.kinematic, 0], dx[dae.y] - x[dae.rate])
    assert_allclose(F[dae.output, 0], dae.target_at(x) - [0.1, 0.2], atol=1e-12)
    step = chance.normal(size=dae.n_x)
    for J, move in ((A, (1, 0)), (E, (0, 1))):
        ahead, back = (
            np.array(
                dae.rows(x + s * move[0] * step, dx + s * move[1] * step, np.array([0.1, 0.2]))[0]
            )
            for s in (1e-6, -1e-6)
        )
        slope = (ahead - back)[:, 0] / 2e-6
        assert_allclose(J @ step, slope, atol=1e-5 * np.abs(slope).max())
    state = dae.unpack(x[None])
    assert_array_equal(state["q_m"][0][list(model.i_m)], x[model.n_a : dae.n])
    assert_array_equal(state["tau_m"][0], x[dae.torque])


def test_block_forms_of_small_patterns() -> None:
    upper = np.array([[1, 1, 0], [0, 1, 1], [0, 0, 1]], bool)
    form = block_form.block_form(upper)
    assert form.blocks == (((2,), (2,)), ((1,), (1,)), ((0,), (0,)))
    assert not any(form.surplus + form.deficit)
    loop = np.array([[1, 1, 0], [1, 1, 0], [1, 0, 1]], bool)
    assert block_form.block_form(loop).blocks == (((0, 1), (0, 1)), ((2,), (2,)))
    tall = block_form.block_form(np.array([[1, 0], [1, 0], [0, 1]], bool))
    assert tall.surplus == ((0, 1), (0,)) and tall.blocks == (((2,), (1,)),)
    wide = block_form.block_form(np.array([[1, 1, 0], [0, 0, 1]], bool))
    assert wide.deficit == ((0,), (0, 1)) and wide.blocks == (((1,), (2,)),)
    none = block_form.block_form(np.zeros((2, 1), bool))
    assert none.surplus == ((0, 1), ()) and none.deficit == ((), (0,)) and none.blocks == ()


def test_ranks_and_what_they_rest_on() -> None:
    Q = np.linalg.qr(np.random.default_rng(9).normal(size=(4, 4)))[0]
    found = decide_rank([Q @ np.diag([2.0, 1.0, 1e-3, 0.0])], "M")
    assert (found.rank, found.decided, found.matrix) == (3, True, "M")
    assert found.above == pytest.approx(5e-4) and found.below < 1e-15 and found.gap > 1e11
    doubtful = decide_rank([Q @ np.diag([1.0, 1.0, 1e-12, 0.0])])
    assert (doubtful.rank, doubtful.decided) == (2, False) and doubtful.below == pytest.approx(
        1e-12, rel=1e-3
    )
    best = decide_rank([Q @ np.diag([1.0, 1.0, 1e-12, 0.0]), Q @ np.diag([1.0, 1.0, 0.1, 0.0])])
    assert (best.rank, best.decided) == (3, True)
    empty = decide_rank([np.zeros((2, 2))])
    assert (empty.rank, empty.decided, empty.gap) == (0, True, 1 / 2.2e-16)
    full = decide_rank([np.eye(2)])
    assert (full.rank, full.below) == (2, 0.0) and full.gap == pytest.approx(1 / 2.2e-16)


def test_without_the_equations_that_only_name_a_rate_ranks_are_smaller_by_their_number() -> None:
    """x0' = x1 and a second equation: rows of order 0 and 1."""
    F_x = np.array([[[0.0, -1.0], [2.0, 3.0]], [[0.0, 0.0], [1.0, 0.5]]])
    F_dx = np.array([[[1.0, 0.0], [0.0, 4.0]], [[0.0, 0.0], [0.0, 1.0]]])
    named = definitions(F_x, F_dx)
    assert [x.tolist() for x in named] == [[0], [0], [1]]
    scales = taylor_array.Scales(0.5, np.array([2.0, 3.0]), np.array([1.0, 0.25]))
    array = taylor_array.derivative_array(F_x, F_dx, 1, scales)
    factors = np.outer(scales.rows, scales.x)
    A = [F_x[k] * factors * 0.5**k for k in range(2)]
    E = [F_dx[k] * factors * 0.5**k / 0.5 for k in range(2)]
    none = np.zeros((2, 2))
    assert_allclose(array, np.block([[A[0], E[0], none], [A[1], E[1] + A[0], 2 * E[0]]]))
    less = without_definitions(array, 2, 2, named)
    assert less.shape == (2, 4) and np.linalg.matrix_rank(less) == np.linalg.matrix_rank(array) - 2


def test_scales_and_ratios_of_blocks() -> None:
    scales = taylor_array.choose_scales(
        np.diag([1e6, 1e-3]), np.array([[0.0, 2e2], [5e4, 0.0]]), 0.1, np.ones(2)
    )
    whole = np.maximum(np.abs(np.diag([1e6, 1e-3])), np.array([[0.0, 2e3], [5e5, 0.0]]))
    scaled = whole * scales.rows[:, None] * scales.x
    assert_allclose(scaled.max(axis=1), 1.0, rtol=0.5)
    assert scaled.max() < 2 and scales.time == 0.1
    A = np.diag([1e8, 1.0]) @ np.array([[1.0, 0.5], [0.5, 1.0]]) @ np.diag([1e-5, 1e3])
    assert smallest_ratio(A) == pytest.approx(1 / 3, rel=1e-6)
    assert (
        smallest_ratio(np.array([[1.0, 0.0], [1.0, 0.0]])) == 0.0
        and smallest_ratio(np.array([[-0.2]])) == 0.2
    )
    assert smallest_ratio(np.array([[7.0]])) == 1.0 and smallest_ratio(np.array([[1e-301]])) == 0.0
    x = taylor_array._solve_least_norm(np.array([[1.0, 2.0, 2.0]]), np.array([9.0]))
    assert_allclose(x, [1.0, 2.0, 2.0])
    doubled = taylor_array._solve_least_norm(
        np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([2.0, 4.0])
    )
    assert_allclose(doubled, [3.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("rows", [[[0.1, 0.2], [0.3, 0.6]], [[1.0, 0.1], [3.0, 0.3]]])
def test_rows_that_depend_on_each_other_but_for_rounding_are_solved_by_least_squares(
    rows: list[list[float]],
) -> None:
    """Rows r and 3 r with the right side (1, 4): x = 1.3 r / |r|^2. Neither array is singular in
    its last digit: one factorization has a residual of 0.4, the other one a solution of 2e16.
    """
    found = taylor_array._solve_least_norm(np.array(rows), np.array([1.0, 4.0]))
    assert_allclose(found, 1.3 * np.array(rows[0]) / np.dot(rows[0], rows[0]), rtol=1e-9)


@pytest.mark.parametrize(("name", "expected"), [("elbow", (3, 8, 2)), ("planar5_nmp", (3, 8, 4))])
def test_the_rule_of_gears(name: str, expected: tuple[int, int, int]) -> None:
    assert rule(derive(flexgen.read(name))) == expected


def test_a_move_of_a_batch_is_warned_of_each_limit_that_it_exceeds() -> None:
    """The second of two moves exceeds everything but the limits of its second joint."""
    robot = flexgen.read("elbow")
    joints = [
        {"lower": -1.0, "upper": 1.0, "speed_max": 2.0, "acceleration_max": 10.0},
        {"upper": 9.0},
    ]
    elements = tuple(
        replace(e, dofs=(replace(e.dofs[0], **limits),))
        for e, limits in zip(robot.elements, joints, strict=True)
    )
    motors = tuple(replace(m, torque_max=5.0, speed_max=100.0) for m in robot.motors)
    robot = replace(robot, elements=elements, motors=motors)
    inside = np.array([[4.0, 5.0]])
    above = np.array([[5.5, 5.0]])
    two = np.vstack([inside, above])
    peaks = Peaks(
        two,
        two,
        20 * two,
        two,
        np.array([[2.0, 3.0], [2.5, 3.0]]),
        np.array([[9.0, 99.0], [10.5, 99.0]]),
    )
    starts = np.array([[-1.0, 0.0], [-1.5, 0.0]])
    ends = np.array([[1.0, 9.0], [1.25, 9.0]])
    assert batches._warnings(robot, peaks, starts, ends, 0) == ()
    names = [motor.name for motor in robot.motors], [c.name for c in robot.coordinates]
    assert batches._warnings(robot, peaks, starts, ends, 1) == (
        f"motor {names[0][0]}: torque 5.5 N m exceeds its limit 5 N m",
        f"motor {names[0][0]}: speed 110 rad/s exceeds its limit 100 rad/s",
        f"coordinate {names[1][0]}: -1.5 rad is below its limit -1 rad",
        f"coordinate {names[1][0]}: 1.25 rad is above its limit 1 rad",
        f"coordinate {names[1][0]}: 2.5 rad/s exceeds its limit 2 rad/s",
        f"coordinate {names[1][0]}: 10.5 rad/s^2 exceeds its limit 10 rad/s^2",
    )


def test_the_digest_of_a_table_is_of_texts_as_json_and_of_the_bits_of_numbers() -> None:
    """SHA-256 of the lines that `Table.digest` states, computed here."""
    columns = Column("model", "text", "", ""), Column("tool_error_max", "float", "m", "")
    values = {
        "model": np.array(["elbow", "planar5_nmp"]),
        "tool_error_max": np.array([1e-9, -0.0]),
    }
    content = b"model text  2\n" + b'["elbow", "planar5_nmp"]' + b"tool_error_max float m 2\n"
    content += struct.pack("=2d", 1e-9, -0.0)
    assert Table(columns, values).digest == hashlib.sha256(content).hexdigest()


FIRST = "element.upper.dof.q1"


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"motor.m1.torque_max": 5.0, "motor.m2.speed_max": 100.0}, ""),
        ({f"{FIRST}.friction": {"viscous": 3.0, "coulomb": 2.0, "beta": 9.0}}, ""),
        ({f"{FIRST}.gear": {"type": "rigid"}}, ""),
        (
            {f"{FIRST}.gear.spring": {"type": "cubic", "stiffness": 7e6, "cubic": 1e9}},
            ": given springs that are not linear (q1), expected linear ones",
        ),
        (
            {
                "motor.m2.friction": {
                    "type": "gear",
                    "viscous": 0.1,
                    "viscous_share": 0.5,
                    "viscous_decay": 20.0,
                }
            },
            " has a friction law GearFriction",
        ),
        (
            {f"{FIRST}.gear.hysteresis": {"lost_motion": 3e-4, "stiffness": 1e5}},
            "the gear of q1 has hysteresis, whose torque depends on the motion before",
        ),
        (
            {"motor.m2.lugre": {"stiffness": 1e3, "damping": 1.0, "coulomb": 2.0}},
            "motor m2 has lugre, a friction that depends on the motion before",
        ),
        (
            {"motor.m2.cogging": {"harmonics": [6], "sin": [0.03]}},
            "motor m2 has cogging, expected none",
        ),
        ({"tool.speed_max": 1.0}, " has limits other than of motor torque and speed"),
        (
            {f"{FIRST}.counterbalance": {"sin": [5.0]}},
            ": given a counterbalance (q1), expected none",
        ),
        (
            {"element.fore.body.rotational_drag": 2.0},
            ": given bodies with rotational_drag (fore), expected none",
        ),
        (
            {"payload": {"mass": 3.0, "rotational_drag": 5.0}},
            ": given bodies with rotational_drag (payload), expected none",
        ),
    ],
    ids=range(13),
)
def test_moves_of_a_model_are_computed_at_once_or_it_says_why_not(
    changes: dict[str, object], why: str
) -> None:
    robot = flexgen.read("elbow", overrides=changes)
    assert closed_form_batch.unfit(robot) == (
        why if why.startswith(("the ", "motor ")) or not why else f"model elbow{why}"
    )
    if not changes:
        coupled = replace(robot, motor_coupling="complete")
        assert closed_form_batch.unfit(coupled) == (
            "model elbow has motor_coupling 'complete', expected 'simplified'"
        )
        free = flexgen.read("planar5_nmp")
        assert closed_form_batch.unfit(free) == (
            "model planar5_nmp: given coordinates without motor (q3), expected none"
        )


def test_a_grid_is_described_with_its_models_and_the_samples_of_its_moves(tmp_path: Path) -> None:
    """A sweep continues only where all of it is the same: a changed file of samples is another
    grid.
    """
    file = tmp_path / "path.csv"
    file.write_text("t s,x m\n0,0\n")
    move = Move("along", "sampled", (0.1, 0.2), 1.0, 5, file=str(file))
    grid = cases.Grid(
        ["elbow", "no_such_model"],
        parameters=[{"payload.mass": np.float64(2.0)}, {"motor.m1.ratio": np.array([3, 4])}],
        moves=[None, "line", move],
        options={"verify": False, "mesh": None},
    )
    told = grid.describe()
    assert told["parameters"] == [{"payload.mass": 2.0}, {"motor.m1.ratio": [3, 4]}]
    assert told["options"] == {"verify": False, "mesh": None} and told["moves"][:2] == [
        None,
        "line",
    ]
    (named,) = told["moves"][2].items()
    assert named[0] == "Move" and named[1]["name"] == "along" and named[1]["start"] == [0.1, 0.2]
    assert named[1]["samples"] == hashlib.sha256(file.read_bytes()).hexdigest()
    first, second = told["models"]
    assert first["model"] == "elbow" and second["model"] == "no_such_model"
    assert second["digest"].startswith(
        "unreadable: model: given 'no_such_model', expected a path ending in .toml or"
    )
    robot = replace(flexgen.read("elbow"), moves=(move,))
    before = cases.Grid([robot]).describe()["models"]
    assert before[0]["digest"].split()[1] == named[1]["samples"] and before[0]["model"] == "elbow"
    file.write_text("t s,x m\n0,1\n")
    after = cases.Grid([robot]).describe()["models"][0]["digest"].split()
    assert after[0] == before[0]["digest"].split()[0] and after[1] != named[1]["samples"]
    file.unlink()
    assert (
        cases.Grid([robot])
        .describe()["models"][0]["digest"]
        .endswith(" unreadable: No such file or directory")
    )


def test_moves_that_a_batch_takes_and_that_it_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint moves with a polynomial law, of a robot that fits, without verification; one batch for
    each time law.
    """
    robots = {
        "a": flexgen.read("elbow"),
        "b": flexgen.read("planar5_nmp"),
        "bad": "no model",
        "odd": flexgen.read("elbow"),
    }
    move = Move("swing", "joint", (0.1, 0.2), 1.0, 5, end=(0.3, -0.4))

    def fail(robot: object) -> Move:
        raise ArgumentError("no such move")

    def job(
        number: int, key: str = "a", method: str = "auto", of: object = None, **changes: object
    ) -> SimpleNamespace:
        chosen = of or (lambda robot: replace(move, **changes))  # type: ignore[arg-type]
        return SimpleNamespace(number=number, key=key, method=method, move_of=chosen)

    jobs = [
        job(0),
        job(1, method="closed-form", end=(0.0, 0.0)),
        job(2, duration=2.0),
        job(3, "b"),
        job(4, "bad"),
        job(5, method="lq"),
        job(6, of=fail),
        job(7, type="output_line"),
        job(8, start=(0.1,)),
        job(9, end=(0.1, 0.2, 0.3)),
        job(10, duration=0.0),
        job(11, profile=(1.0, 2.0)),
        job(12, start=(0.1, np.nan)),
        job(13, smoothness=3),  # the torque would jump
        job(14, "odd"),
        job(15, of=lambda robot: robot.moves[0].name),  # a line of the tool
    ]
    made = []
    sizes = []

    def moves(equations: str, law: TimeLaw, library: str) -> tuple[str, float]:
        made.append((equations, law.duration, law.smoothness, library))
        if equations == "equations of odd":
            raise ArgumentError("refused")
        return equations, law.duration

    def figures(
        robot: object, mover: tuple[str, float], starts: np.ndarray, ends: np.ndarray
    ) -> list[dict]:
        sizes.append((mover[1], starts.tolist(), ends.tolist()))
        return [{"torque_max": float(k)} for k in range(len(starts))]

    monkeypatch.setattr(batches, "_MOVERS", {})
    monkeypatch.setattr(batches, "JointMoves", moves)
    monkeypatch.setattr(batches, "structural_index", lambda equations: SimpleNamespace(index=4))
    monkeypatch.setattr(batches, "_library", lambda key, equations: f"library of {key}")
    monkeypatch.setattr(batches, "figures_or_reasons", figures)
    shard = SimpleNamespace(
        jobs=jobs, robots=robots, options={"verify": False, "batch": True, "mesh": None}
    )
    asked = batches.Batches(shard, lambda key, robot: f"equations of {key}")
    found = asked.rows()
    assert {number: row["torque_max"] for number, (row, _) in found.items()} == {
        0: 0.0,
        1: 1.0,
        2: 0.0,
    }
    assert all(
        row["move"] == "swing" and sorted(times) == ["cpu", "wall"]
        for row, times in found.values()
    )
    assert sizes == [
        (1.0, [[0.1, 0.2], [0.1, 0.2]], [[0.3, -0.4], [0.0, 0.0]]),
        (2.0, [[0.1, 0.2]], [[0.3, -0.4]]),
    ]
    of_a = ("equations of a", 1.0, 5, "library of a")
    assert made == [
        of_a,
        ("equations of a", 2.0, 5, "library of a"),
        ("equations of odd", 1.0, 5, "library of odd"),
    ]
    asked.rows()
    assert len(made) == 4  # those of a are kept, the other one is tried again
    for options in ({"verify": True}, {}, {"verify": False, "mesh": 1e-3}):
        shard.options = options
        assert asked.rows() == {}
    shard.options = {"verify": False}
    shard.jobs = [job(k, duration=3.0 + k) for k in range(batches.KEPT)]
    assert len(asked.rows()) == len(batches._MOVERS) == batches.KEPT == 4
    assert sorted(duration for _, duration, _ in batches._MOVERS) == [3.0, 4.0, 5.0, 6.0]
