"""Numbers of flexgen/simulation by other routes: closed forms, SciPy, quadrature and
differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import PPoly
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.torque_curve import SAMPLES
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation import after_end, result, simulate, start
from flexgen.simulation import run as runs
from flexgen.simulation.integration import hold, integrators
from flexgen.simulation.motor_feedback import MotorFeedback
from flexgen.simulation.verification import growth

LABELS = ("m1", "m2")
VALUES = np.array(
    [[1.0, -2.0], [4.0, 0.5], [2.0, 3.0], [-1.0, 1.0], [0.5, -3.0], [1.5, 2.5], [0.0, 1.0]]
)
TICKS = 0.3 + 0.1 * np.arange(7)


def command(kind: str, delay: float = 0.02) -> hold.TorqueCommand:
    return hold.TorqueCommand(TICKS, VALUES, LABELS, kind, 0.1, delay, {"model": "x"})


@pytest.mark.parametrize("kind", ["zoh", "linear", "spline"])
def test_a_held_torque_is_the_same_at_instants_and_between_edges(kind: str) -> None:
    """A step, a line and a spline between arrivals; constant before the first and after the
    last.
    """
    held = command(kind)
    edges = TICKS + 0.02
    assert_allclose(held.edges, edges[[0, -1]] if kind == "spline" else edges)
    words = {"zoh": "zero-order hold", "linear": "straight lines", "spline": "spline"}
    assert held.title().endswith("at 100 ms, delay 20 ms") and command(kind, 0.0).title().endswith(
        "at 100 ms"
    )
    assert repr(held) == f"<TorqueCommand: {held.title()}, 7 ticks from 0.3 s>" and kind in words
    for k in range(6):
        t = edges[k] + np.array([0.0, 0.03, 0.09])
        expected = {
            "zoh": VALUES[k] + 0 * t[:, None],
            "linear": VALUES[k] + (t - edges[k])[:, None] / 0.1 * np.diff(VALUES, axis=0)[k],
        }
        if kind in expected:
            assert_allclose(held.at(t + 1e-12), expected[kind], atol=1e-9)
        assert_allclose(held.between(edges[k], edges[k + 1])(t), held.at(t + 1e-12), atol=1e-9)
    assert_allclose(held.at(edges), VALUES, atol=1e-12)
    assert_allclose(held.at(np.array([0.0, 9.0])), VALUES[[0, -1]])
    for early, late in ((0.0, 0.3), (0.2, 0.32)):
        assert_allclose(held.between(early, late)(0.31), VALUES[0])
    assert_allclose(held.between(0.92, 1.5)(1.2), VALUES[-1])
    made = held.trajectory()
    assert made.meta == {
        "model": "x",
        "kind": "torque command",
        "hold": kind,
        "sample_time": 0.1,
        "delay": 0.02,
    }
    again = hold.command_in(made.time, made["tau_m"], LABELS, made.meta)
    assert (
        (again is None)
        if kind == "spline"
        else (again is not None and again.edges.tolist() == held.edges.tolist())
    )


def test_polynomial_torques_jump_at_the_ends_of_their_intervals(tmp_path: Any) -> None:
    curve = PPoly(np.array([[[2.0, 0.0], [1.0, -1.0]], [[1.0, 3.0], [5.0, 0.0]]]), [0.0, 0.5, 1.0])
    torque = hold.PolynomialTorque(
        np.array([0.0, 0.5, 1.0]), curve([0.0, 0.5, 1.0]), LABELS, "spline", 0.5, 0.0, {}, curve
    )
    assert (
        torque.title() == "polynomials of degree 1 on 2 intervals"
        and torque.edges.tolist()
        == [
            0.0,
            0.5,
            1.0,
        ]
    )
    assert_allclose(
        torque.at(np.array([-1.0, 0.25, 0.5, 0.75, 2.0])),
        [[1, 3], [1.5, 3], [5, 0], [5.25, -0.25], [5.5, -0.5]],
    )
    for begin, end, at, expected in (
        (0.0, 0.5, 0.25, [1.5, 3.0]),
        (0.5, 1.0, 0.75, [5.25, -0.25]),
        (-0.5, 0.0, -0.2, [1.0, 3.0]),
        (1.0, 2.0, 1.5, [5.5, -0.5]),
    ):
        assert_allclose(torque.between(begin, end)(at), expected)
    made = torque.trajectory()
    assert (
        len(made.time) == 2 * SAMPLES + 1
        and made.meta["torque_degree"] == 1
        and made.meta["torque"] == "limited"
    )
    again = hold.command_in(
        made.time, made["tau_m"], LABELS, {**made.meta, "move": "line", "other": 1}
    )
    assert isinstance(again, hold.PolynomialTorque) and again.meta == {"move": "line"}
    assert (again.sample_time, again.delay, again.hold) == (0.5, 0.0, "spline")
    assert_allclose(again.curve.c, curve.c, atol=1e-12)


def test_a_trajectory_with_held_torques_states_sample_time_and_delay() -> None:
    meta = {"hold": "zoh", "sample_time": 0.1}
    found = hold.command_in(TICKS, VALUES, LABELS, meta)
    assert found is not None and (found.hold, found.sample_time, found.delay, found.meta) == (
        "zoh",
        0.1,
        0.0,
        {},
    )
    found = hold.command_in(TICKS, VALUES, LABELS, {**meta, "delay": 0.3})
    assert found is not None and found.delay == 0.3
    assert hold.command_in(TICKS, VALUES, LABELS, {}) is None
    for changed, given in (({"sample_time": 0.1001}, "0.1001"), ({"sample_time": None}, "None")):
        with pytest.raises(
            ArgumentError,
            match=f"sample time {given} s at other instants, expected rows one sample",
        ):
            hold.command_in(TICKS, VALUES, LABELS, {**meta, **changed})
    for changed, words in (
        ({"hold": "cubic"}, "hold: given 'cubic', expected one of"),
        ({"sample_time": 0.0}, "sample_time: given 0.0, expected a positive time in s"),
        ({"delay": -1e-3}, "delay: given -0.001, expected zero or a positive time in s"),
    ):
        with pytest.raises(ArgumentError, match=words):
            hold.command_in(TICKS, VALUES, LABELS, {**meta, **changed})


def test_held_torques_have_the_means_of_the_continuous_one() -> None:
    """By quadrature: means with the second difference taken back, and the straight lines of least
    squared distance.
    """
    t = 0.2 + np.linspace(0.0, 1.0, 41)
    tau = np.stack([np.sin(3.0 * t), t**2], axis=1)
    curve = hold.extend_constant(t, tau, False)
    time, values = hold.hold_torque(t, tau, "spline", 0.1, 0.04)
    # the first arrives at the start or before it
    assert_allclose(time, 0.2 + 0.1 * np.arange(-1, 11), atol=1e-12)
    assert_allclose(values, curve(time + 0.04), atol=1e-12)
    edges = time + 0.04

    def moment(k: int, weight: Any) -> np.ndarray:
        def at(s: float) -> np.ndarray:
            return weight((s - edges[k]) / 0.1) * curve(np.array([s]))[0]

        knots = np.unique(np.clip([edges[k], edges[k + 1], *t], edges[k], edges[k + 1]))
        # exact for degree 9 between the knots
        points, weights = np.polynomial.legendre.leggauss(5)
        out = np.zeros(2)
        for a, b in pairwise(knots):
            out += sum(
                w * (b - a) / 2 * at(a + (b - a) * (x + 1) / 2)
                for x, w in zip(points, weights, strict=True)
            )
        return out / 0.1

    means = np.array([moment(k, lambda x: 1.0) for k in range(11)] + [tau[-1]])
    limited = hold.hold_torque(t, tau, "zoh", 0.1, 0.04, limited=True)[1]
    assert_allclose(
        limited,
        [
            *hold._moments(t, hold.extend_constant(t, tau, True), edges)[0]
            + hold._moments(t, hold.extend_constant(t, tau, True), edges)[1],
            tau[-1],
        ],
        atol=1e-12,
    )
    padded = np.vstack([means[:1], means, means[-1:]])
    expected = means - (padded[:-2] - 2 * means + padded[2:]) / 12
    held = hold.hold_torque(t, tau, "zoh", 0.1, 0.04)[1]
    assert_allclose(held[:-1], expected[:-1], atol=1e-8)
    assert_array_equal(held[-1], tau[-1])
    lines = hold.hold_torque(t, tau, "linear", 0.1, 0.04)[1]
    assert_allclose(lines[[0, -1]], curve(edges[[0, -1]]), atol=1e-12)
    for k in range(1, 11):
        right = moment(k - 1, lambda x: x) + moment(k, lambda x: 1 - x)
        assert_allclose((lines[k - 1] + 4 * lines[k] + lines[k + 1]) / 6, right, atol=1e-8)
    bounded = hold.hold_torque(t, tau, "linear", 0.1, 0.04, limited=True)[1]
    assert (bounded <= tau.max(axis=0)).all() and (bounded >= tau.min(axis=0)).all()
    assert_allclose(hold._projection(tau[:2], tau[:1], tau[:1]), tau[:2])
    one = hold._projection(
        np.array([[1.0], [0.0], [2.0]]), np.array([[0.0], [0.5]]), np.array([[0.7], [0.0]])
    )
    # (1 + 4 u + 2) / 6 = 0.7 + 0.5
    assert_allclose(one.ravel(), [1.0, (0.7 + 0.5 - 0.5) * 1.5, 2.0])


def test_ticks_cover_the_motion_and_are_at_most_a_million(monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.array([1.0, 1.5, 2.0])
    tau = np.zeros((3, 1))
    for delay, first, last in (
        (0.0, 1.0, 2.0),
        (0.3, 0.5, 1.75),
        (0.25, 0.75, 1.75),
        (5.0, -4.0, -3.0),
    ):
        time, _ = hold.hold_torque(t, tau, "zoh", 0.25, delay)
        assert_allclose(time[[0, -1]], [first, last], atol=1e-12)
        assert time[0] + delay <= t[0] + 1e-9 and time[-1] + delay >= t[-1] - 1e-9
        assert_allclose(np.diff(time), 0.25)
    monkeypatch.setattr(hold, "MOST", 8)
    assert len(hold.hold_torque(t, tau, "zoh", 0.125)[0]) == 9
    words = (
        r"sample_time: given 0\.1 s, which makes 10 ticks, expected at most 8; take a longer "
        r"sample time"
    )
    with pytest.raises(ArgumentError, match=words):
        hold.hold_torque(t + 4.0, tau, "zoh", 0.1, 0.4)


# --- integration ---------------------------------------------------------------------------------

A = np.array([[0.0, 1.0], [-4.0, -0.3]])


def linear(matrix: np.ndarray, compiled: Any = None) -> integrators.Rates:
    return integrators.Rates(lambda t, x: matrix @ x, lambda t, x: matrix, compiled, None)


def test_linear_motions_are_exponentials_and_stiff_ones_change_the_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    t = np.linspace(0.5, 2.5, 9)
    x = np.array([1.0, -2.0])
    found = integrators.integrate(linear(A), x, t, 1e-11, np.full(2, 1e-12))
    assert_allclose(found.states, [expm(A * (s - 0.5)) @ x for s in t], atol=1e-9)
    assert found.method == "DOP853" and 50 < found.evaluations < 5000
    monkeypatch.setattr(integrators, "BLOCK", 50)
    monkeypatch.setattr(integrators, "RATE", 100.0)
    stiff = np.array([[-1.0, 0.0], [0.0, -400.0]])
    lines: list[str] = []
    clock = iter(np.arange(0.0, 1e5, 2.0))
    monkeypatch.setattr(integrators.time, "perf_counter", lambda: float(next(clock)))
    found = integrators.integrate(linear(stiff), x, t, 1e-11, np.full(2, 1e-12), lines.append)
    assert found.method == "LSODA"
    assert_allclose(found.states, [expm(stiff * (s - 0.5)) @ x for s in t], atol=1e-8)
    assert (
        lines[0].startswith("simulation: t = ")
        and "of 2.500 s, " in lines[0]
        and lines[-1].endswith("LSODA")
    )
    dense = np.linspace(0.5, 2.5, 2001)  # a step for each instant is not stiff
    assert (
        integrators.integrate(linear(stiff), x, dense, 1e-11, np.full(2, 1e-12)).method == "DOP853"
    )
    assert_allclose(
        integrators.integrate(linear(A), x, t[:1], 1e-11, np.full(2, 1e-12)).states, [x]
    )
    monkeypatch.setattr(integrators, "EVALUATIONS", 60)
    monkeypatch.setattr(integrators, "LONG", 30.0)
    with pytest.raises(
        SolverError, match=r"stopped at t = \S+ of 2\.5 s after \d+ evaluations; check the units"
    ):
        integrators.integrate(linear(stiff), x, t, 1e-11, np.full(2, 1e-12))


def test_a_motion_that_is_not_finite_names_its_instant() -> None:
    loop = integrators.Rates(
        lambda t, x: x * (np.nan if t > 1.0 else 1.0), lambda t, x: np.eye(1), None, None
    )  # type: ignore[arg-type]
    with pytest.raises(
        SolverError,
        match=r"simulation: failed at t = \S+ s \(.+\); check the torque, and the numbers",
    ):
        integrators.integrate(loop, np.ones(1), np.linspace(0.0, 2.0, 5), 1e-8, np.ones(1))


def test_the_implicit_method_has_to_advance_within_its_patience(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    t = np.array([0.0, 10.0])

    def check(nfev: int, at: float, mark: tuple[float, int] = (1.0, 0)) -> Any:
        return integrators._check_advance(Made(nfev=nfev, t=at), mark, t)  # type: ignore[arg-type]

    patience = integrators.PATIENCE
    most = integrators.EVALUATIONS_STIFF
    assert (patience, most, integrators.ADVANCE) == (100_000, 400_000, 1e-3)
    assert check(patience - 1, 1.0) == (1.0, 0)
    assert check(patience, 1.011) == (1.011, patience)
    assert check(2 * patience, 1.02, (1.011, patience + 1)) == (1.011, patience + 1)
    words = (
        r"stopped at t = 1\.009 of 10 s after 100000 evaluations of the implicit method: the "
        r"equations of motion are"
    )
    with pytest.raises(SolverError, match=words):
        check(patience, 1.009)
    with pytest.raises(SolverError, match="after 400000 evaluations"):
        check(most, 9.0, (1.0, most - 5))


def test_the_motion_after_the_end_is_that_of_the_linearization() -> None:
    f = np.array([0.3, -0.1])
    x = np.array([1.0, 2.0])
    found: Any = Made(
        last=x, rates=Made(jacobian=lambda t, at: A * (t == 4.0), rate=lambda t, at: f * (at == x))
    )
    for held in (0.0, 0.5, 2.0, 3.0):
        states = after_end.errors_after_end(found, 4.0, held)
        assert states.shape == (64, 2)
        for k in (0, 31, 63):
            s = max(2.0 - held, 0.0) * (k + 1) / 64
            assert_allclose(
                states[k], x + np.linalg.solve(A, (expm(A * s) - np.eye(2)) @ f), atol=1e-12
            )


def test_rates_with_and_without_feedback_have_the_derivatives_they_state() -> None:
    equations = derive("elbow")
    robot = equations.model
    n = robot.dof
    n_m = robot.n_m
    rng = np.random.default_rng(1)
    motors = MotorFeedback(
        rng.normal(size=(n_m, n)),
        np.array([3.0, 4.0]),
        np.array([0.2, 0.1]),
        np.array([5.0, 6.0]),
        {"position_hz": 0.5, "speed_hz": 3.0, "integral_hz": 0.1},
    )
    assert (
        motors.title
        == "P-PI motor feedback, continuous, position 0.5 Hz, speed 3 Hz, integral 0.1 Hz"
    )
    function = runs._rate(equations)
    u = rng.normal(size=n_m)
    for feedback in (None, motors):
        size = 2 * n + 2 + (n_m if feedback else 0)
        x = 0.1 * rng.normal(size=size)
        reference = np.concatenate([u, rng.normal(size=2 * n_m)]) if feedback else u
        rates = runs.rates_of(equations, function, None, lambda t, r=reference: r, feedback)
        if feedback:
            q = feedback.rows @ x[:n]
            v = feedback.rows @ x[n : 2 * n]
            w = reference[2 * n_m :] + feedback.position_gain * (reference[n_m : 2 * n_m] - q) - v
            torque = u + feedback.speed_gain * (w + feedback.integral_gain * x[2 * n + 2 :])
            assert_allclose(
                rates.rate(0.0, x),
                [*np.array(function(x[: 2 * n + 2], torque)).ravel(), *w],
                rtol=1e-12,
            )
        else:
            assert_array_equal(rates.rate(0.0, x), np.array(function(x, u)).ravel())
        h = 1e-5
        slope = np.stack(
            [
                (rates.rate(0.0, x + h * e) - rates.rate(0.0, x - h * e)) / (2 * h)
                for e in np.eye(size)
            ],
            axis=1,
        )
        found = rates.jacobian(0.0, x)
        observers = [2 * n, 2 * n + 1]
        assert not found[observers].any() and not found[:, observers].any()
        slope[observers] = slope[:, observers] = 0.0
        assert_allclose(found, slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


def test_the_method_of_a_run_is_the_implicit_one_if_any_part_needed_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """States, evaluations and methods of the parts between corners, put together by a stand-in of
    the integrator.
    """
    calls: list[tuple[float, float]] = []
    methods = iter(["DOP853", "LSODA", "DOP853"])

    def part(
        rates: Any, x: np.ndarray, t: np.ndarray, rtol: float, atol: np.ndarray, progress: Any
    ) -> Any:
        calls.append((float(t[0]), float(t[-1])))
        assert rtol == 1e-7 and atol.tolist() == [runs.ATOL] * 4 + [runs.ATOL_WORK] * 2
        return integrators.Integration(x + (t - t[0])[:, None], 10 * len(calls), next(methods))

    monkeypatch.setattr(runs, "integrate", part)
    monkeypatch.setattr(runs, "_rates", lambda equations, progress: ("f", None))
    monkeypatch.setattr(runs, "rates_of", lambda equations, f, in_c, given, feedback: given)
    t = np.linspace(0.0, 1.0, 6)
    robot = Made(dof=2, n_m=2, coordinates=(), motors=())
    found = runs.run(
        Made(model=robot), t, lambda a, b: (a, b), np.arange(4.0), [1, 4], 1e-7, None, None
    )  # type: ignore[arg-type]
    assert_allclose(calls, [(0.0, 0.2), (0.2, 0.8), (0.8, 1.0)])
    assert (found.evaluations, found.integrator, found.rates) == (60, "LSODA", (t[4], t[5]))
    assert_allclose(found.states, np.array([0.0, 1, 2, 3, 0, 0]) + t[:, None], atol=1e-15)
    assert_allclose(found.last, found.states[-1])


# --- around the integration ----------------------------------------------------------------------


def test_edges_of_torques_are_instants_of_the_integration() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.3])
    assert simulate._with_edges(t, [2], None)[2] == [2]
    near = 0.1 + 0.5e-9 * 0.1
    torque: Any = Made(
        edges=np.array([-0.05, 0.0, 0.05, near, 0.2 + 3e-9 * 0.1, 0.25, 0.3, 0.4]), sample_time=0.1
    )
    instants, own, corners = simulate._with_edges(t, [3], torque)
    assert_allclose(instants, [0.0, 0.05, 0.1, 0.2, 0.2 + 3e-10, 0.25, 0.3], rtol=0, atol=1e-14)
    assert_array_equal(instants[own], t)
    assert corners == [1, 2, 4, 5, 6]


def test_the_time_after_the_end_holds_the_last_values() -> None:
    t = np.array([0.0, 0.5, 1.0])
    given = {"x": np.array([[1.0], [2.0], [7.0]])}
    for held in (0.0, 1.5 * simulate.HELD_STEP, 10 * simulate.HELD_STEP):
        instants, channels = simulate._with_held_end(t, given, held)
        more = int(np.ceil(held / simulate.HELD_STEP))
        assert len(instants) == 3 + more and instants[-1] == pytest.approx(1.0 + held)
        assert_allclose(np.diff(instants[2:]), held / max(more, 1))
        assert channels["x"].ravel().tolist() == [1.0, 2.0] + [7.0] * (1 + more)


@pytest.mark.parametrize("height", [0.0, 5e3, -5e3])
def test_the_error_of_the_energy_is_relative_to_what_is_exchanged_at_any_height(
    height: float,
) -> None:
    """A weight of 2 N is lifted by 1 m with 3 J, of which 0.9 J are lost and 0.06 J too little are
    there at the end.
    """
    q = ca.SX.sym("q")
    v = ca.SX.sym("v")
    none = ca.SX.sym("none", 0)
    energy = ca.Function("energy", [q, v, none, none], [v**2 / 2, 2.0 * q])
    made: Any = Made(function={"energy": energy}.__getitem__)
    lifted = np.array([[0.0], [0.5], [1.0]])
    speed = np.array([[0.0], [0.4], [np.sqrt(0.08)]])
    work = np.array([0.0, 1.5, 3.0])
    loss = np.array([0.0, 0.42, 0.9])
    motion = lifted + height, speed, np.empty((3, 0)), np.empty((3, 0))
    assert simulate._energy_error(made, motion, work, loss) == pytest.approx(0.06 / 3.0, rel=1e-6)
    still = np.full((3, 1), height), np.zeros((3, 1)), *motion[2:]
    rounding = 1e-12 * np.abs(height) * np.array([0.0, 1.0, -1.0])
    assert simulate._energy_error(made, still, rounding, np.zeros(3)) < 1e-6


def test_errors_of_outputs_are_in_metres_and_radians() -> None:
    q = np.array([[0.1, 0.2], [0.3, -0.1]])
    elbow = derive("elbow")
    y = np.array([np.array(elbow.function("output")(x)).ravel() for x in q])
    error, in_m, in_rad = result.output_error(
        elbow, {"y_ref": y + np.array([[0.3, -0.4], [0.1, 0.0]])}, q
    )
    assert_allclose(error, [[-0.3, 0.4], [-0.1, 0.0]], atol=1e-14)
    assert in_m == pytest.approx(0.5) and in_rad is None
    turned = Rotation.from_rotvec([[0.0, 0.2, 0.0], [0.5, 0.0, 0.0]]).as_matrix()
    R = np.array([np.array(elbow.function("forward_kinematics")(x)[1]) for x in q])
    found = result._turn_error(elbow, {"R_ref": (turned @ R).reshape(2, 9)}, q)
    assert_allclose(found, [0.2, 0.5], atol=1e-9)
    masses = derive("four_mass")
    x = np.zeros((2, masses.model.n_a))
    m = masses.model.output.size
    error, in_m, in_rad = result.output_error(masses, {"y_ref": np.full((2, m), 0.25)}, x)
    assert in_m == pytest.approx(0.25 * np.sqrt(m)) and in_rad is None


def test_the_error_of_a_pose_is_a_distance_and_an_angle() -> None:
    """The reference is the pose of the tool, moved and turned by known amounts; the last sample is
    after the record.
    """
    equations = derive("manutec_r3")
    robot = equations.model
    rng = np.random.default_rng(3)
    assert robot.output.type == "tool_pose"
    q_a = rng.uniform(-0.5, 0.5, (4, robot.n_a))
    places = [[np.array(x) for x in equations.function("forward_kinematics")(q)] for q in q_a]
    off = np.array([[0.0, 0.0, 0.0], [3e-3, 0.0, -4e-3], [1e-3, 2e-3, 2e-3], [0.0, 0.0, 0.02]])
    angles = np.array([0.0, 0.02, 1.5, 3.0])
    turns = Rotation.from_rotvec(angles[:, None] * [0.6, 0.0, 0.8]).as_matrix()
    given = {
        "y_ref": np.array([p.ravel() for p, _ in places]) - off,
        "R_ref": np.array(
            [(turn @ R).ravel() for turn, (_, R) in zip(turns, places, strict=True)]
        ),
        "tau_m": rng.normal(size=(4, robot.n_m)),
    }
    data: Any = Made(time=np.array([0.0, 0.1, 0.2]))
    more = [rng.normal(size=(4, n)) for n in (robot.n_a, robot.n_m, robot.n_m)]
    in_m, in_rad, found = result.record_motion(equations, data, given, (q_a, *more))
    assert in_m == pytest.approx(0.02) and in_rad == pytest.approx(3.0)
    assert_allclose(found["error"], off[:3], atol=1e-12)
    assert_allclose(found["turn"], angles[:3, None], atol=1e-7)
    assert found.labels["error"] == ("x", "y", "z") and found.labels["turn"] == ("angle",)
    assert (found.ports["error"].unit, found.ports["turn"].unit) == ("m", "rad")
    for name, values in zip(
        ("q_a", "v_a", "q_m", "v_m", "tau_m"), (q_a, *more, given["tau_m"]), strict=True
    ):
        assert_array_equal(found[name], values[:3])
    del given["R_ref"]
    in_m, in_rad, found = result.record_motion(equations, data, given, (q_a, *more))
    assert in_m == pytest.approx(0.02) and in_rad is None and "turn" not in found
    del given["y_ref"]
    in_m, in_rad, found = result.record_motion(equations, data, given, (q_a, *more))
    assert in_m is None and in_rad is None and "error" not in found


def test_speeds_of_the_start_come_from_the_first_sample_or_are_zero() -> None:
    robot = flexgen.read("elbow")
    names_a = [c.name for c in robot.coordinates]
    names_m = [robot.motors[j].name for j in robot.i_m]

    def data(unit: str = "rad/s", value: float = 2.0, names: list[str] = names_a[::-1]) -> Any:
        labels = {"v_a": tuple(names), "v_m": tuple(names_m)}
        columns = {
            "v_a": np.array([[float(k), value] for k in (1, 5)]),
            "v_m": np.full((2, len(names_m)), 9.0),
        }
        ports = {
            k: Port(k, (len(x),), unit if k == "v_a" else "rad/s", "") for k, x in labels.items()
        }
        return Trajectory(np.array([0.0, 1.0]), columns, ports, labels, {})

    assert start._first_speed(robot, data(), False).tolist() == [0.0] * robot.dof
    assert start._first_speed(robot, data(), True).tolist() == [2.0, 1.0] + [9.0] * len(names_m)
    assert start._first_speed(robot, data("rad/s or m/s"), True).tolist()[:2] == [2.0, 1.0]
    for wrong, words in (
        (data("deg/s"), rf"moving: given v_a in deg/s, expected rad/s \(column {names_a[0]}\)"),
        (data(value=np.inf), "moving: given speeds that are not finite, expected finite numbers"),
        (
            data(names=["a", "b"]),
            f"moving: the trajectory has no channel v_a of {robot.name}, expected its speeds",
        ),
    ):
        with pytest.raises(ArgumentError, match=words):
            start._first_speed(robot, wrong, True)
    given = {"q_a": np.array([[0.1, 0.2]]), "q_m": np.array([[3.0, 4.0]])}
    rest: Any = Made(q_a=np.array([7.0, 8.0]), q_m=np.array([5.0, 6.0]))
    i_m = list(robot.i_m)
    assert start.start_state(robot, data(), given, None, False).tolist()[: robot.dof] == [
        0.1,
        0.2,
        *given["q_m"][0][i_m],
    ]
    assert start.start_state(robot, data(), given, rest, False).tolist()[: robot.dof] == [
        7.0,
        8.0,
        *rest.q_m[i_m],
    ]


def test_growth_of_perturbations_is_that_of_the_exponential() -> None:
    """A saddle: cosh along one axis; sizes beyond every number; the grid has 50 intervals at
    least.
    """
    saddle = np.array([[0.0, 1.0], [9.0, 0.0]])
    step = expm(0.01 * saddle)
    found = growth._log_growth(np.array([step] * 200), 1)
    assert_allclose(found, np.log(np.cosh(3 * 0.01 * np.arange(1, 201))), atol=1e-12)
    assert growth._log_growth(np.array([1e100 * np.eye(2)] * 10), 1)[-1] == pytest.approx(
        1000 * np.log(10)
    )
    equations = derive("four_mass")
    n_a = equations.model.n_a
    n_m = equations.model.n_m
    n = equations.model.dof
    t = np.linspace(0.0, 0.1, 201)
    arm = np.zeros((201, n_a))
    motors = np.zeros((201, n_m))
    along = growth.linearize_along(
        equations, growth.Motion(t, arm, arm, arm, motors, motors, motors, motors)
    )
    steps = expm(along.means * along.lengths[:, None, None])
    assert steps.shape == (50, 2 * n, 2 * n) and along.rest == 0.0
    state = np.array(
        equations.function("linearize")(arm[0], arm[0], motors[0], motors[0], motors[0])[0]
    )
    scale = np.ones(2 * n)
    scale[n_a:n] = scale[n + n_a :] = np.abs(equations.model.eta).max(axis=1)[
        list(equations.model.i_m)
    ]
    product = np.linalg.multi_dot(list(steps[::-1]))
    expected = expm(0.1 * state) * scale / scale[:, None]
    assert_allclose(product, expected, atol=1e-9 * np.abs(expected).max())


# --- what is given -------------------------------------------------------------------------------
def recorded(
    meta: dict[str, Any] | None = None, **changes: tuple[Any, tuple[str, ...], str] | None
) -> Trajectory:
    """Three samples of the elbow: numbers, labels and unit of each channel; None: without it."""
    numbers = np.arange(6.0).reshape(3, 2)
    rows: dict[str, Any] = {
        "tau_m": (numbers, ("m2", "m1"), "N m"),
        "q_a": (numbers / 8, ("q1", "q2"), "rad"),
        "q_m": (numbers * 8, ("m1", "m2"), "rad"),
        "y_ref": (numbers / 2, ("z", "x"), "m"),
        "v_a": (numbers * [[0], [1], [1]], ("q1", "q2"), "rad/s"),
    }
    rows = {name: row for name, row in (rows | changes).items() if row is not None}
    ports = {
        name: Port(name, (len(labels),), unit, "") for name, (_, labels, unit) in rows.items()
    }
    labels = {name: row[1] for name, row in rows.items()}
    return Trajectory(
        0.1 * np.arange(3),
        {name: np.array(row[0]) for name, row in rows.items()},
        ports,
        labels,
        meta or {},
    )


def test_channels_of_a_simulation_have_the_columns_of_the_model() -> None:
    robot = flexgen.read("elbow")
    numbers = np.arange(6.0).reshape(3, 2)
    found, warnings = simulate._read_channels(robot, recorded({"model": "elbow", "variant": ""}))
    assert sorted(found) == ["q_a", "q_m", "tau_m", "y_ref"] and warnings == ()
    assert_array_equal(found["tau_m"], numbers[:, ::-1])
    assert_array_equal(found["q_a"], numbers / 8)
    assert_array_equal(found["q_m"], numbers * 8)
    assert_array_equal(found["y_ref"], numbers[:, ::-1] / 2)
    mixed = recorded(q_a=(numbers, ("q2", "q1"), "rad or m"), y_ref=None)
    assert_array_equal(simulate._read_channels(robot, mixed)[0]["q_a"], numbers[:, ::-1])
    moving = recorded(
        {"model": "arm", "variant": "soft"}, v_a=(numbers - 2e-6, ("q1", "q2"), "rad/s")
    )
    _, warnings = simulate._read_channels(robot, moving)
    other = "the trajectory was written for {}, this is {}"
    of_other = (other.format("model 'arm'", "'elbow'"), other.format("variant 'soft'", "'none'"))
    start = (
        "the trajectory does not start at rest; the simulation does: expect an error at the start"
    )
    assert warnings == (start, *of_other)
    assert simulate._read_channels(robot, moving, moving=True)[1] == of_other
    slow = recorded(v_a=(numbers * [[0], [1], [1]] + 0.9e-6, ("q1", "q2"), "rad/s"))
    assert simulate._read_channels(robot, slow)[1] == ()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"q_m": None},
            "trajectory: channel q_m is missing; write one with 'flexgen solve elbow --out FILE'",
        ),
        (
            {"tau_m": (np.zeros((3, 2)), ("m1", "m3"), "N m")},
            "trajectory channel tau_m: given columns m1, m3, expected m1, m2; take the model that "
            "it was written for",
        ),
        (
            {"q_m": (np.zeros((3, 2)), ("m1", "m2"), "gon")},
            "trajectory channel q_m, column m1: given 'gon', an unknown unit, expected an angle "
            "in rad, mrad, urad, deg, arcmin, rev",
        ),
        (
            {"q_m": (np.zeros((3, 2)), ("m1", "m2"), "rad or m")},
            "trajectory channel q_m, column m1: given 'rad or m', an unknown unit, expected an "
            "angle in rad, mrad, urad, deg, arcmin, rev",
        ),
        (
            {"q_a": (np.full((3, 2), np.inf), ("q1", "q2"), "rad")},
            "trajectory channel q_a: given NaN or infinity, expected finite numbers",
        ),
        (
            {"y_ref": (np.zeros((3, 2)), ("x", "y"), "m")},
            "trajectory channel y_ref: given columns x, y, expected x, z; take the model that it "
            "was written for",
        ),
        (
            {"y_ref": (np.full((3, 2), np.nan), ("x", "z"), "m")},
            "trajectory channel y_ref: given NaN or infinity, expected finite numbers",
        ),
    ],
)
def test_channels_that_are_not_those_of_the_model_are_refused(
    changes: dict[str, Any], text: str
) -> None:
    with pytest.raises(ArgumentError) as caught:
        simulate._read_channels(flexgen.read("elbow"), recorded(**changes))
    assert str(caught.value) == text


def test_arguments_of_a_simulation_are_within_their_ranges() -> None:
    given = recorded()
    for held in (None, 0.0, 60.0):
        for rtol in (2e-14, 9.9e-3):
            for feedback in ("auto", "none", "ppi"):
                simulate._check_choices(given, rtol, held, feedback)
    usual = {"trajectory": "a.csv", "rtol": 1e-9, "held": None, "feedback": "auto"}
    for changes, text in (
        ({"trajectory": 3}, "trajectory: given int, expected a Trajectory or the path of a file"),
        (
            {"rtol": 1e-14},
            "rtol: given 1e-14, expected a relative tolerance between 1e-14 and 1e-2",
        ),
        ({"rtol": 1e-2}, "rtol: given 0.01, expected a relative tolerance between 1e-14 and 1e-2"),
        ({"held": -0.1}, "held: given -0.1, expected a time between 0 and 60 s"),
        ({"held": 60.1}, "held: given 60.1, expected a time between 0 and 60 s"),
        ({"feedback": "pid"}, "feedback: given 'pid', expected one of auto, none, ppi"),
    ):
        with pytest.raises(ArgumentError) as caught:
            simulate._check_choices(**{**usual, **changes})  # type: ignore[arg-type]
        assert str(caught.value) == text


@dataclass(frozen=True)
class Alone:
    """The errors of a simulation in open loop."""

    tool_error_max_m: float | None = None
    tool_error_max_rad: float | None = None
    later_error_max_m: float | None = None
    later_error_max_rad: float | None = None


@pytest.mark.parametrize(
    ("whole", "later", "errors", "kept", "rtol"),
    [
        # rounding is 1e-12: below a tenth of the error
        (None, 0.0, Alone(1e-11), Alone(1e-11), 1e-9),
        (None, 0.0, Alone(0.9e-11), None, 1e-9),
        (9.9, 0.0, Alone(1e-6), Alone(1e-6), 1e-9),
        (10.0, 0.0, Alone(1e-6), Alone(1e-6), 1e-10),
        (1e6, 0.0, Alone(None, 1.1e-5), Alone(None, 1.1e-5), 1e-10),
        (1e6, 0.0, Alone(0.9e-5, 0.9e-5), None, 1e-10),
        (1e6, 0.0, Alone(), None, 1e-10),
        (0.99e11, 0.0, Alone(1.0), Alone(1.0), 1e-10),
        (1.01e11, 0.0, Alone(9.0), None, None),  # it falls: rounding grows to more than 0.1 m
        (1e3, 1e6, Alone(1e-3, None, 1.1e-5), Alone(1e-3, None, 1.1e-5), 1e-10),
        # the later error is that of rounding
        (1e3, 1e6, Alone(1e-3, None, 0.9e-5, 1e-6), Alone(1e-3), 1e-10),
        # rounding is below 1e-10 m
        (1e3, 99.0, Alone(1e-3, None, 1e-10), Alone(1e-3, None, 1e-10), 1e-10),
        (1e3, 1e6, "failed", None, 1e-10),
    ],
    ids=range(13),
)
def test_errors_in_open_loop_are_told_where_rounding_does_not_decide_them(
    whole: float | None,
    later: float,
    errors: Alone | str,
    kept: Alone | None,
    rtol: float | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[float] = []

    def once(task: Any, rtol: float, feedback: Any, progress: Any) -> Any:
        assert (task, feedback) == ("task", None)
        asked.append(rtol)
        if errors == "failed":
            raise SolverError("it fell")
        return errors

    monkeypatch.setattr(simulate, "_simulate_once", once)
    found: Any = simulate._simulate_open_loop(
        "task",  # type: ignore[arg-type]
        1e-9,
        None if whole is None else growth.Growth(1.0, whole, later),
        None,
    )
    assert found == kept and asked == ([] if rtol is None else [pytest.approx(rtol)])
