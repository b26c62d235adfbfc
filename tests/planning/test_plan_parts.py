"""Parts of a plan: meshes, comparisons, signals, ends at rest, bounds and sizes of unknowns, and
limits as constraints of real phases.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.planning.optimal import arguments, signals
from flexgen.planning.optimal.signals import Signals
from flexgen.planning.optimal.start import scales
from flexgen.planning.optimal.transcribe import Layout


# --- arguments -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("mesh", "nodes"),
    [
        (4, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (0.5, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (0.6, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (2.0, [0.0, 1.0]),
        ([1e-10, 0.3, 1 + 1e-10], [0.0, 0.3, 1.0]),
        (arguments.MOST, np.linspace(0.0, 1.0, arguments.MOST + 1)),
    ],
)
def test_meshes_are_counts_lengths_or_nodes(mesh: Any, nodes: list[float]) -> None:
    found = arguments.mesh_nodes(mesh, 2.0)
    assert_allclose(found, nodes)
    assert found[0] == 0.0 and found[-1] == 1.0


COUNTS = "mesh: given .*, expected a number of intervals, a length in s or relative nodes"
NODES = "mesh: given .*, expected increasing relative nodes from 0 to 1"
RANGE = f"mesh: given .*, which makes .* intervals, expected 1 to {arguments.MOST}"


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        *((x, COUNTS) for x in (None, True, "8", b"8")),
        *((x, NODES) for x in ([0.0], [[0.0, 1.0]], [0.0, 0.5, 0.5, 1.0], [0.0, 0.6, 0.5, 1.0])),
        *((x, NODES) for x in ([0.0, "x"], [0.0, np.nan, 1.0], [0.1, 1.0], [0.0, 0.9])),
        *((x, RANGE) for x in (0, -1, arguments.MOST + 1, 1e-9)),
        *((x, "mesh: given .*, expected a number > 0") for x in (0.0, -0.5)),
    ],
)
def test_other_meshes_are_refused(mesh: Any, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        arguments.mesh_nodes(mesh, 2.0)


@pytest.mark.parametrize(
    "given",
    [
        ("p", ["a"], 0.0, 2.0, 2.1),
        ("p", ["a"], 0.0, 2.0, -0.1),
        ("p", ["a"], 0.0, 2.0, np.nan),
        ("p", ["p"], 0.0, 1.0, 0.5),
        ("", [], 0.0, 1.0, 0.5),
        (3, [], 0.0, 1.0, 0.5),
        ("p", [], "0", 1.0, 0.5),
        ("p", [], np.nan, 1.0, 0.5),
    ],
)
def test_parameters_have_a_new_name_and_a_guess_within_bounds(given: Any) -> None:
    arguments.check_parameter("p", ["a"], 0.0, 2.0, 0.0)
    arguments.check_parameter("p", [], -np.inf, np.inf, 1.0)
    with pytest.raises(ArgumentError, match=r"^parameter"):
        arguments.check_parameter(*given)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_comparisons_become_expressions_below_zero(kind: Any) -> None:
    x = kind.sym("x")
    y = kind.sym("y")
    value, equal = signals.split_comparison(x <= 2 * y, "rule")
    assert ca.Function("f", [x, y], [value])(5.0, 2.0) == 1.0 and equal == [False]
    value, equal = signals.split_comparison(x == y, "rule")
    assert ca.Function("f", [x, y], [value])(5.0, 2.0) == 3.0 and equal == [True]
    for wrong in (x + y, x, ca.sin(x), 3, "x"):
        text = r"rule: given .*, expected a comparison such as problem\['v_m'\] <= "
        with pytest.raises(ArgumentError, match=text):
            signals.split_comparison(wrong, "rule")


def test_comparisons_of_several_parts_are_split_one_by_one() -> None:
    x = ca.SX.sym("x", 2)
    value, equal = signals.split_comparison(ca.vertcat(x[0] < 3, x[1] == 4), "rule")
    found = np.array(ca.Function("f", [x], [value])([5.0, 6.0])).ravel()
    assert found.tolist() == [2.0, 2.0] and equal == [False, True]
    with pytest.raises(ArgumentError, match="expected a comparison"):
        signals.split_comparison(ca.vertcat(x[0] < 3, x[1]), "rule")


def test_signals_of_a_plan_by_their_definitions() -> None:
    """Of an arm with a joint without motor: names, labels, units and values."""
    equations = derive("planar5_nmp")
    model = equations.model
    made = Signals(equations, with_path=True, tracked=False, name="_1")
    rng = np.random.default_rng(4)
    y, dy, ddy = (rng.normal(size=model.dof + 1) for _ in range(3))
    tau = rng.normal(size=model.n_m)
    time = 0.7
    names = list(made._signals)
    at = ca.Function("at", made.symbols, [made[name] for name in names])
    values = dict(
        zip(names, (np.array(x).ravel() for x in at(y, dy, ddy, tau, time, [])), strict=True)
    )
    n_a = model.n_a
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    motors = [model.n_a + k for k in range(model.n_m)]
    assert model.n_m == len(model.i_m) == 2 and len(i_e) == 1
    p, R = (np.array(x) for x in equations.function("forward_kinematics")(y[:n_a]))
    h = 1e-6
    ahead, behind = (
        [np.array(x) for x in equations.function("forward_kinematics")(y[:n_a] + s * h * dy[:n_a])]
        for s in (1, -1)
    )
    spin = (ahead[1] - behind[1]) / (2 * h) @ R.T
    expected = {
        "q_a": (y[:n_a], "rad"),
        "v_a": (dy[:n_a], "rad/s"),
        "a_a": (ddy[:n_a], "rad/s^2"),
        "q_m": (y[motors], "rad"),
        "v_m": (dy[motors], "rad/s"),
        "a_m": (ddy[motors], "rad/s^2"),
        "tau_m": (tau, "N m"),
        "power_m": (tau * dy[motors], "W"),
        "gear_deflection": (np.linalg.solve(model.eta, y[motors]) - y[i_g], "rad"),
        "elastic_deflection": (y[i_e], "rad"),
        "tool_position": (p.ravel(), "m"),
        "tool_rotation": (R.T.ravel(), "1"),
        "tool_velocity": ((ahead[0] - behind[0]).ravel() / (2 * h), "m/s"),
        "tool_turn_rate": ([spin[2, 1], spin[0, 2], spin[1, 0]], "rad/s"),
        "output": (np.array(equations.function("output")(y[:n_a])).ravel(), "m"),
        "time": ([time], "s"),
        "s": (y[-1:], "1"),
        "s_rate": (dy[-1:], "1/s"),
        "s_acceleration": (ddy[-1:], "1/s^2"),
    }
    assert list(values) == list(expected)
    for name, (value, unit) in expected.items():
        signal, entries = made.find(name)
        assert_allclose(values[name], value, atol=1e-7, err_msg=name)
        assert signal.units == (unit,) * len(entries) and len(entries) == len(
            signal.labels
        ) == len(values[name])
    arm = tuple(c.name for c in model.coordinates)
    motor = tuple(m.name for m in model.motors)
    assert made.find("a_a")[0].labels == arm and made.find("power_m")[0].labels == motor
    assert made.find(f"v_a[{arm[1]}]")[1] == [1]
    assert len(made) == len(expected) and made.reference.numel() == 0
    with pytest.raises(
        ArgumentError, match=r"^signal tool_position: given entry 'w', expected one of x, y, z"
    ):
        made.find("tool_position[w]")
    assert Signals(equations, with_path=False, tracked=True).reference.numel() == model.output.size


# --- ends and unknowns ---------------------------------------------------------------------------
def layout_of(problem: flexgen.PlanProblem) -> Layout:
    return Layout(
        tuple(problem.phases), tuple(parameter.symbol for parameter in problem.parameters)
    )


def test_a_plan_rests_at_the_ends_that_are_stated() -> None:
    """Two phases: the problem begins and ends at rest; the rest between them is stated once or
    twice alike.
    """
    problem = flexgen.plan_problem("planar5_nmp", mesh=4)
    model = problem.equations.model
    rests = problem._rests()
    assert [(number, where, s) for number, where, _, s in rests] == [
        (0, "start", None),
        (0, "end", None),
    ]
    assert (
        rests[0][2] is problem.y_start
        and rests[1][2] is problem.y_end
        and rests[0][2].shape == (model.dof,)
    )
    later = problem.then(0.5, mesh=3)
    assert [(number, where) for number, where, *_ in problem._rests()] == [
        (0, "start"),
        (1, "end"),
    ]
    middle = np.zeros(model.n_a)
    middle[list(model.i_g)] = [0.3, -0.9]
    problem.end_at(middle)
    assert [(number, where) for number, where, *_ in problem._rests()] == [
        (0, "start"),
        (0, "end"),
        (1, "end"),
    ]
    later.start_at(middle)
    assert len(problem._rests()) == 3
    problem.end_at(None)
    assert [(number, where) for number, where, *_ in problem._rests()] == [
        (0, "start"),
        (1, "start"),
        (1, "end"),
    ]
    problem.end_at(middle + 0.1)
    with pytest.raises(
        ArgumentError,
        match=r"^start_at: given another start of phase 1 than the end of phase 0; state ",
    ):
        problem._rests()
    free = flexgen.plan_problem("planar5_nmp", mesh=4, timing="free")
    assert [(number, where, s) for number, where, _, s in free._rests()] == [
        (0, "start", 0.0),
        (0, "end", 1.0),
    ]
    free.then(0.5, mesh=3)
    assert [(number, where, s) for number, where, _, s in free._rests()] == [
        (0, "start", 0.0),
        (1, "end", 1.0),
    ]
    free.end_at(middle)
    free.phases[1].start_at(None)
    assert [s for *_, s in free._rests()] == [0.0, None, 1.0]


@pytest.mark.parametrize("timing", ["given", "free"])
def test_bounds_of_a_plan_hold_it_at_rest_and_its_numbers_in_their_ranges(timing: Any) -> None:
    """Coordinates and speeds at both ends; in the middle the path parameter is free."""
    problem = flexgen.plan_problem("planar5_nmp", mesh=4, timing=timing)
    later = problem.then(0.5, mesh=3)
    later.free_time(0.2, 0.9)
    problem.parameter("mass", 1.0, 3.0, 2.0)
    middle = np.zeros(problem.equations.model.n_a)
    problem.end_at(middle)
    layout = layout_of(problem)
    rests = problem._rests()
    scale = np.linspace(1.0, 2.0, layout.size)
    low, high = (x * scale for x in problem._bounds(layout, scale, rests))
    n = problem.equations.model.dof
    y = np.concatenate([rests[0][2], [0.0] if timing == "free" else []])
    assert_allclose(low[layout.node(0, 0)], np.concatenate([y, 0 * y]), atol=1e-12)
    assert_allclose(high[layout.node(0, 0)], low[layout.node(0, 0)])
    end = layout.node(0, -1).reshape(2, -1)
    assert_allclose(low[end[:, :n]], [rests[1][2], 0 * rests[1][2]], atol=1e-12)
    assert np.isinf(low[end[:, n:]]).all() and end.shape[1] - n == (timing == "free")
    last = np.concatenate([rests[2][2], [1.0] if timing == "free" else []])
    assert_allclose(low[layout.node(1, 3)], np.concatenate([last, 0 * last]), atol=1e-12)
    T = problem.path.duration
    assert_allclose(low[layout.theta], [T, 0.2, 1.0])
    assert_allclose(high[layout.theta], [T, 0.9, 3.0])
    bound = np.isfinite(low)
    assert bound.sum() == 2 * (len(y) + n + len(last)) + 3 and np.isinf(high[~bound]).all()


def test_sizes_of_unknowns_follow_from_the_start() -> None:
    """Motors by their ratios, accelerations by a rate, torques by the largest of each, at least a
    part of all.
    """
    problem = flexgen.plan_problem("planar5_nmp", mesh=3)
    problem.parameter("mass", guess=-4.0)
    problem.parameter("small", guess=0.1)
    layout = layout_of(problem)
    mesh = problem.mesh
    model = problem.equations.model
    start = np.zeros(layout.size)
    tau = np.zeros((3 * mesh.s, model.n_m))
    tau[2, 0] = -6.0
    tau[4, 0] = 5.0
    n = mesh.n
    start[: mesh.size] = mesh.pack(
        np.zeros((4, 2 * n)), np.zeros((3, mesh.s, n)), tau.reshape(3, mesh.s, model.n_m)
    )
    found = scales(layout, problem.parameters, start)
    y, dy, ddy, torque = mesh.unpack(found[: mesh.size])
    ratio = np.abs(model.eta).max(axis=1)[list(model.i_m)]
    side = np.concatenate([np.ones(model.n_a), ratio])
    assert_allclose(y, np.tile(side, (4, 1)))
    assert_allclose(dy, y)
    assert_allclose(ddy, np.broadcast_to(ddy[0, 0, 0] * side, ddy.shape))
    assert_allclose(torque[..., 0], 6.0)
    assert 0.0 < torque[0, 0, 1] < 1.0 and np.ptp(torque[..., 1]) == 0.0
    assert_allclose(found[layout.theta], [problem.given_duration, 4.0, 1.0])
    nothing = scales(layout, [], 0 * start)
    assert_allclose(mesh.unpack(nothing[: mesh.size])[3], 1e-6)


def test_a_free_time_is_clipped_into_its_bounds() -> None:
    problem = flexgen.plan_problem("planar5_nmp", mesh=3)
    T = problem.given_duration
    problem.free_time(0.5 * T, 0.8 * T)
    assert problem.given_duration == 0.8 * T and problem.duration_bounds == (0.5 * T, 0.8 * T)
    problem.free_time(1.0, 2.0, 1.5)
    assert problem.given_duration == 1.5
    problem.free_time(1.0, 1.0)
    assert problem.duration_bounds == (1.0, 1.0)
    for wrong in ((0.0, 1.0, None), (1.0, -2.0, None), (1.0, 2.0, 0.0)):
        with pytest.raises(
            ArgumentError, match=r"^free_time: given .*, expected a positive time in s$"
        ):
            problem.free_time(*wrong)
    with pytest.raises(
        ArgumentError,
        match=r"^free_time: given 2\.0 to 1\.0 s, expected a lower bound below the upper ",
    ):
        problem.free_time(2.0, 1.0)


@pytest.mark.parametrize("scheme", ["gauss3", "radau", "hermite-simpson"])
@pytest.mark.parametrize("timing", ["given", "free"])
def test_torques_of_one_scheme_are_continuous(scheme: Any, timing: Any) -> None:
    """A path over its parameter has that parameter as one more coordinate."""
    problem = flexgen.plan_problem("elbow", "line", timing=timing, scheme=scheme, mesh=4)
    assert problem.torque_continuous == (scheme == "hermite-simpson")
    assert problem.mesh.n == problem.equations.model.dof + (timing == "free")


# --- limits --------------------------------------------------------------------------------------
def phase_of(model: Any, limits: Limits | None, **more: Any) -> Any:
    return flexgen.plan_problem(model, mesh=3, limits=True if limits is None else limits, **more)


def value(phase: Any, name: str, **given: np.ndarray) -> tuple[np.ndarray, Any]:
    """A constraint of a phase at a motion of its coordinates, and its row."""
    (row,) = (row for row in phase.content.rows["path"] if row.name == name)
    s = phase.signals
    function = ca.Function("value", s.symbols, [ca.densify(row.value)])
    sizes = [x.numel() for x in s.symbols]
    point = [
        given.get(key, np.zeros(n))
        for key, n in zip(("y", "dy", "ddy", "tau"), sizes, strict=False)
    ]
    return np.array(function(*point, *[np.zeros(n) for n in sizes[4:]])).ravel(), row


def test_ranges_and_rates_of_joints_are_the_smaller_ones() -> None:
    """Of the file and of the limits that are given."""
    model = flexgen.read("elbow")
    own = ({"lower": -1.0, "upper": 2.0, "speed_max": 3.0}, {"acceleration_max": 5.0})
    elements = [
        replace(e, dofs=(replace(e.dofs[0], **more),))
        for e, more in zip(model.elements, own, strict=True)
    ]
    model = replace(model, elements=tuple(elements))
    limits = Limits(joint_speed=(2.0, 4.0), joint_acceleration=(np.inf, 6.0))
    bands = phase_of(model, limits).content.bands
    expected = {"q_a[q1]": (-1.0, 2.0), "v_a[q1]": (-2.0, 2.0), "v_a[q2]": (-4.0, 4.0)}
    expected |= {"a_a[q2]": (-5.0, 5.0)}
    found = {name: (float(b.lower[0]), float(b.upper[0])) for name, b in bands.items()}
    assert {name: found[name] for name in expected} == expected
    assert "a_a[q1]" not in found


def test_torques_at_speeds_are_lines_in_four_quadrants() -> None:
    """Between the points of a curve; a reserve is taken off the torque."""
    curve = ((0.0, 10.0), (100.0, 6.0), (200.0, 0.0))
    phase = phase_of("elbow", Limits(reserve=0.2, torque_speed=(curve, ())))
    names = [row.name for row in phase.content.rows["path"]]
    assert names == ["torque of m1 at its speed"]
    for speed, largest in ((50.0, 8.0), (100.0, 6.0), (150.0, 3.0)):
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            for part, inside in ((0.999, True), (1.001, False)):
                dy = np.array([0.0, 0.0, signs[1] * speed, 0.0])
                tau = np.array([signs[0] * 0.8 * part * largest, 0.0])
                found, row = value(phase, names[0], dy=dy, tau=tau)
                assert bool((found <= row.upper).all()) is inside and np.isinf(row.lower).all()


def test_torques_of_gears_are_those_of_springs_or_of_the_motor() -> None:
    """Of a rigid gear the torque that rotor and friction leave."""
    rng = np.random.default_rng(1)
    elastic = phase_of("elbow", Limits(gear_torque=(50.0, np.inf), reserve=0.1))
    model = elastic.equations.model
    y = np.r_[0.3, 0.5, model.eta @ [0.301, 0.502]]
    dy = rng.normal(size=4)
    found, row = value(elastic, "gear torque of q1", y=y, dy=dy)
    spring = elastic.equations.function("gear_torque")(y[:2], dy[:2], y[2:], dy[2:])
    assert_allclose(found, np.array(spring).ravel()[:1])
    assert row.upper.tolist() == [45.0] and len(elastic.content.rows["path"]) == 1
    rigid = phase_of("elbow@rigid", Limits(gear_torque=(50.0, 60.0)))
    model = rigid.equations.model
    tau = rng.normal(size=2)
    dy, ddy = rng.normal(size=(2, 2))
    friction = np.array(rigid.equations.function("motor_friction")(model.eta @ dy)).ravel()
    inertia = np.array([m.inertia for m in model.motors])
    left = tau - inertia * (model.eta @ ddy) - friction
    for k, name in enumerate(("q1", "q2")):
        found, row = value(rigid, f"gear torque of {name}", dy=dy, ddy=ddy, tau=tau)
        assert_allclose(found, [model.eta[:, k] @ left])


def test_speed_and_acceleration_of_the_tool_are_squares_over_their_bounds() -> None:
    """By differences of the position of the tool."""
    phase = phase_of("elbow", Limits(tool_speed=2.0, tool_acceleration=5.0))
    rng = np.random.default_rng(2)
    y, dy, ddy = rng.normal(size=(3, 4))
    forward = phase.equations.function("forward_kinematics")

    def place(t: float) -> np.ndarray:
        q = y[:2] + dy[:2] * t + ddy[:2] * t * t / 2
        return np.array(forward(q)[0]).ravel()

    h = 1e-4
    v = (place(h) - place(-h)) / (2 * h)
    a = (place(h) - 2 * place(0.0) + place(-h)) / h**2
    found, row = value(phase, "speed of the tool", y=y, dy=dy, ddy=ddy)
    assert_allclose(found, [v @ v / 4.0], rtol=1e-6)
    assert row.upper.tolist() == [1.0]
    found, _ = value(phase, "acceleration of the tool", y=y, dy=dy, ddy=ddy)
    assert_allclose(found, [a @ a / 25.0], rtol=1e-5)
