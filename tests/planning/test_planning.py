"""`flexgen.plan_problem`: known optima, bounds, phases, obstacles, and what the verification
catches.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from double_integrator import INERTIA, double_integrator
from measured_numbers import check_numbers
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.inversion.judge.status import Status
from flexgen.planning.optimal import problem as planning_problem
from flexgen.planning.optimal import transcribe
from flexgen.planning.optimal.result import _between
from flexgen.planning.optimal.transcribe import Layout

MOTION = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
SCHEMES = ["gauss3", "radau", "hermite-simpson"]
TWO_MASS = Path(__file__).parents[1] / "support" / "robots" / "two_mass.toml"
TWO_MASS_TIME = 0.098881  # s, closed form: rest to rest over 0.5 rad with |u| <= 10, six digits


@pytest.fixture(scope="module")
def planar():
    return flexgen.derive("planar5_nmp")


def least_torque(model, mesh=20, move=None, scheme="gauss3", **bounds):
    problem = flexgen.plan_problem(model, move, mesh=mesh, scheme=scheme)
    problem.add_cost(ca.sumsqr(problem["tau_m"]))
    for name, size in bounds.items():
        problem.bound(name, -size, size)
    return problem


def bang_bang():
    """The least time of two masses in four phases of constant torque."""
    problem = flexgen.plan_problem(str(TWO_MASS), mesh=6, limits=False)
    phases = [problem] + [problem.then(0.03, mesh=6) for _ in range(3)]
    for k, phase in enumerate(phases):
        phase.free_time(0.002, 0.2, guess=0.03)
        phase.add_cost(1.0)
        phase.subject_to(phase["tau_m"] == 10.0 * (-1) ** k)
    return problem


# --- known optima --------------------------------------------------------------------------------
@pytest.mark.parametrize("scheme", SCHEMES)
def test_double_integrator_with_least_energy(tmp_path, scheme):
    problem = least_torque(flexgen.read(str(double_integrator(tmp_path))), 4, scheme=scheme)
    found = problem.solve()
    way = 1.5
    T = 2.0
    exact = INERTIA * 6 * way / T**2 * (1 - 2 * found.trajectory.time / T)
    assert found.status == Status.SOLVED
    # the optimum is linear in time, which all schemes represent: rounding and the tolerance of
    # IPOPT are left
    assert np.abs(found.trajectory["tau_m"][:, 0] - exact).max() < 1e-7
    assert found.details["cost"] == pytest.approx(12 * INERTIA**2 * way**2 / T**3, rel=1e-9)
    assert found.plan_error_max < 1e-9
    t = found.trajectory.time
    channels = found.trajectory
    assert (
        t[0] == 0.0
        and t[-1] == found.move.duration == T
        and found.intervals == 4
        and len(t) == 4 * 10 + 1
    )
    s = t / T
    motion = (way * (3 * s**2 - 2 * s**3), 6 * way / T * (s - s**2), 6 * way / T**2 * (1 - 2 * s))
    for name, law in zip(("q_a", "v_a", "a_a"), motion, strict=True):
        assert (
            np.abs(channels[name][:, 0] - channels[name][0, 0] * (name == "q_a") - law).max()
            < 1e-7
        )
    assert found.residual_max_Nm < 1e-7 and found.residual_relative < 1e-7 and not found.warnings
    assert (
        (found.cpu_s > 0 and found.wall_s > 0)
        and found.method == "plan"
        and found.preactuation_s == 0.0
    )


def test_least_time_of_two_masses_is_the_closed_form():
    """Bang-bang with three switches within intervals of 1 ms: the time is right to a thousandth of
    an interval.
    """
    problem = flexgen.plan_problem(str(TWO_MASS), mesh=100)
    problem.free_time(0.05, 0.3, guess=0.15)
    problem.add_cost(problem.duration, at="end")
    found = problem.solve()
    assert found.status == Status.SOLVED
    assert found.move.duration == pytest.approx(TWO_MASS_TIME, rel=1e-5)
    assert found.move.duration > TWO_MASS_TIME * (1 - 1e-5)
    assert np.abs(found.trajectory["tau_m"]).max() <= 10.0 * (1 + 1e-7)


def test_phases_find_the_switches_of_two_masses(monkeypatch):
    """Four phases of constant torque and free duration: no switch lies within an interval."""
    wall = iter((5.0, 7.5))
    cpu = iter((100.0, 101.25))
    clocks = SimpleNamespace(perf_counter=lambda: next(wall), process_time=lambda: next(cpu))
    monkeypatch.setattr(planning_problem, "time", clocks)
    found = bang_bang().solve()
    assert (found.wall_s, found.cpu_s) == (2.5, 1.25)
    durations = np.array(found.details["durations_s"])
    assert found.status == Status.SOLVED
    # the digits of the closed form
    assert durations.sum() == pytest.approx(TWO_MASS_TIME, abs=1e-6)
    w = np.sqrt(50.0 * (1 / 0.005 + 1 / 0.042))
    T = durations.sum()
    a = durations[1]  # half the distance of the outer switches
    assert durations[2] == pytest.approx(a, rel=1e-6)
    assert 1 + np.cos(w * T / 2) - 2 * np.cos(w * a) == pytest.approx(0.0, abs=1e-5)
    assert 10.0 / 0.047 * (T**2 / 4 - 2 * a**2) == pytest.approx(0.5, rel=1e-6)
    t = found.trajectory.time
    assert (
        t[-1] == pytest.approx(T, rel=1e-12)
        and found.move.duration == t[-1]
        and found.intervals == 4 * 6
    )
    switches = np.cumsum(durations)[:3]
    for k, (low, high) in enumerate(zip([0.0, *switches], [*switches, T], strict=True)):
        inside = (t > low + 1e-9) & (t < high - 1e-9)
        assert (
            inside.any()
            and np.abs(found.trajectory["tau_m"][inside, 0] - 10.0 * (-1) ** k).max() < 1e-6
        )


@pytest.mark.slow
def test_a_free_time_law_beats_the_spline_law_on_the_same_path(planar):
    """Same path and torque limits as `flexgen.fastest`: the plan has more freedom, the rigid robot
    is the bound.
    """
    fastest = flexgen.fastest(planar.model, "line", coefficients=40)
    problem = flexgen.plan_problem(planar, "line", mesh=60, timing="free", limits=fastest.limits)
    problem.free_time(0.2, 1.0)
    problem.add_cost(problem.duration, at="end")
    problem.add_cost(1e-6 * ca.sumsqr(ca.diff(problem.nodes("tau_m").T)))
    problem.follow(tolerance=1e-5)
    found = problem.solve()
    assert found.status == Status.SOLVED
    assert fastest.rigid_s < found.move.duration < 1.01 * fastest.duration_s
    assert found.path_distance_max_m < 1.5e-5  # two rows of 1e-5
    assert (
        np.abs(found.trajectory["tau_m"]) <= np.array(fastest.limits.torque) * (1 + 1e-6)
    ).all()


# --- the transcription ---------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "order"), [("gauss3", 6), ("radau", 5), ("hermite-simpson", 4)]
)
def test_order_under_halving_of_the_mesh(planar, scheme, order):
    """A prescribed torque: the last node against an integration of the Lagrangian by another
    method.
    """
    torque = [lambda t: 12 + 8 * np.sin(9 * t), lambda t: 1 - 4 * np.sin(7 * t)]
    T = 0.2
    errors = []
    rate = planar.function("state_rate")
    for mesh in (8, 16):
        problem = flexgen.plan_problem(planar, mesh=mesh, scheme=scheme)
        problem.torque_continuous = False  # all torques are given
        problem.end_at(None)
        problem.free_time(T, T)
        t = problem["time"]
        problem.subject_to(problem["tau_m"][0] == 12 + 8 * ca.sin(9 * t))
        problem.subject_to(problem["tau_m"][1] == 1 - 4 * ca.sin(7 * t))
        found = problem.solve(verify=False)
        if not errors:
            start = np.r_[problem.y_start, np.zeros(planar.model.dof)]
            exact = solve_ivp(
                lambda t, x: np.array(rate(x, [f(t) for f in torque])).ravel(),
                (0, T),
                start,
                "Radau",
                rtol=1e-11,
                atol=1e-12,
            ).y[:, -1]
        errors.append(np.abs(found.trajectory["q_a"][-1] - exact[:3]).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.7, errors


def test_derivatives_are_those_of_casadi(planar):
    """Blocks against CasADi's differentiation of the whole program, at a random point."""
    problem = least_torque(planar, 3, tau_m=300.0, v_m=1000.0)
    problem.free_time(0.1, 1.0)
    problem.add_squares(problem.output_error)
    problem.avoid(flexgen.Sphere((0.5, 1.5, 0), 0.1), flexgen.HalfSpace((0, 1, 0), -2))
    problem.subject_to(problem["tool_velocity"][0] <= 3)
    problem.add_cost(ca.sumsqr(ca.diff(problem.nodes("q_m").T)))
    problem.subject_to(problem.nodes("time")[1] >= 0.02)
    problem.then(0.1, mesh=2).add_cost(problem.phases[1]["time"], at="end")
    made, x = program_of(problem)
    lam = ca.MX.sym("lam", made.g.numel())
    sigma = ca.MX.sym("sigma")
    lagrangian = sigma * made.cost + ca.dot(lam, made.g)
    pairs = [
        (made.gradient, ca.gradient(made.cost, made.x)),
        (made.jacobian, ca.jacobian(made.g, made.x)),
    ]
    rng = np.random.default_rng(1)
    point = [x * (1 + 0.1 * rng.normal(size=len(x))), rng.normal(size=made.g.numel()), 2.0]
    of_program = ca.Function("f", [made.x], [made.cost, made.g, made.jacobian])(point[0])
    check_numbers("program", start=x, at=[np.array(v) for v in of_program], scale=made.scale)
    for ours, theirs in pairs:
        a, b = (
            np.array(v) for v in ca.Function("f", [made.x, lam, sigma], [ours, theirs])(*point)
        )
        assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()
    # the Hessian of squares is the Gauss-Newton one: compare without them
    ours = made.hessian(sigma, lam) - made.hessian(ca.MX(0), 0 * lam)
    problem.content.squares.clear()
    made, x = program_of(problem)
    lagrangian = sigma * made.cost + ca.dot(lam, made.g)
    ours = made.hessian(sigma, lam)
    theirs = ca.triu(ca.hessian(lagrangian, made.x)[0])
    a, b = (np.array(v) for v in ca.Function("f", [made.x, lam, sigma], [ours, theirs])(*point))
    assert np.abs(a - b).max() <= 1e-11 * np.abs(b).max()


def program_of(problem):
    layout = Layout(tuple(problem.phases), ())
    start = problem._start(layout, None)
    scale = flexgen.planning.optimal.start.scales(layout, [], start)
    return problem._program(layout, scale, start, True, False), start / scale


def test_compiled_and_interpreted_programs_agree(planar):
    one, two = (least_torque(planar).solve(verify=False, compiled=c) for c in (False, True))
    assert np.abs(one.trajectory["tau_m"] - two.trajectory["tau_m"]).max() < 1e-6


def test_exact_and_gauss_newton_hessian_find_the_same_motion(planar):
    one, two = (
        least_torque(planar).solve(verify=False, hessian=h) for h in ("exact", "gauss-newton")
    )
    assert one.details["cost"] == pytest.approx(two.details["cost"], rel=1e-7)


@pytest.mark.parametrize("ending", ["npz", "csv"])
def test_saved_plan_with_torque_jumps_simulates_with_the_claimed_error(tmp_path, ending):
    robot = flexgen.derive(str(TWO_MASS))
    found = bang_bang().solve()
    torque = found.trajectory["tau_m"]
    t = found.trajectory.time
    assert np.abs(np.diff(torque[:, 0])).max() == pytest.approx(20.0)  # N m
    assert found.status == Status.SOLVED and found.plan_error_max < 1e-6
    file = found.trajectory.save(tmp_path / f"plan.{ending}")
    read = flexgen.simulate(robot, file)
    assert read.tool_error_max_rad == pytest.approx(found.plan_error_max, rel=1e-3, abs=1e-11)
    command = found.torque_command.save(tmp_path / f"torque.{ending}")
    fine = np.linspace(t[0], t[-1], 997)
    for saved in (file, command):
        between = flexgen.Trajectory.load(saved).at(fine)["tau_m"]
        assert np.abs(between - found.torque_command.at(fine)).max() < 1e-11 * np.abs(torque).max()
    # At the collocation points, which are not samples, the interpolated motion obeys the equations
    # of motion.
    nodes = t[::10]
    c = 0.5 + np.sqrt(0.15) * np.array([-1, 0, 1])
    at = (nodes[:-1, None] + np.diff(nodes)[:, None] * c).ravel()
    motion = found.trajectory.at(at)
    rows = evaluate(robot.function("residual"), *(motion[name] for name in MOTION))
    assert max(np.abs(row).max() for row in rows) < 1e-6 * np.abs(torque).max()


def test_edited_torques_of_a_plan_are_refused_by_simulate(planar, tmp_path):
    found = least_torque(planar, 5).solve(verify=False)
    found.trajectory["tau_m"][7] *= 1.01
    with pytest.raises(
        ArgumentError, match=r"from the polynomials of degree 2 .* remove torque_degree"
    ):
        flexgen.simulate(planar, found.trajectory)


# --- constraints ---------------------------------------------------------------------------------
def test_least_torques_need_less_than_a_straight_line(planar):
    found = least_torque(planar, 40).solve()
    line = flexgen.solve(planar, "line", verify=False).trajectory
    tau = line["tau_m"]
    t = line.time
    assert found.status == Status.SOLVED and found.plan_error_max < 1e-5
    assert found.details["cost"] < 0.6 * ((tau[:-1] ** 2).sum(axis=1) * np.diff(t)).sum()
    assert found.trajectory["y_ref"][0] == pytest.approx(line["y_ref"][0], abs=1e-6)
    assert found.trajectory["y_ref"][-1] == pytest.approx(line["y_ref"][-1], abs=1e-6)


@pytest.mark.slow
def test_bounds_hold_at_all_instants(planar):
    free = least_torque(planar, 60).solve(verify=False).trajectory
    torque = 0.8 * np.abs(free["tau_m"]).max(axis=0)
    speed = 0.9 * np.abs(free["v_m"]).max(axis=0)
    found = least_torque(planar, 60, tau_m=torque, v_m=speed).solve()
    assert found.status == Status.SOLVED
    check_numbers("bounds", 1e-5, found=found.to_dict(), motion=dict(found.trajectory.channels))
    grid = np.linspace(0.0, 0.5, 4001)
    assert (np.abs(found.torque_command.at(grid)) <= torque * (1 + 1e-6)).all()
    # (a mesh of 8 ms)
    assert (np.abs(found.simulation.trajectory["v_m"]) <= speed * (1 + 1e-5)).all()
    assert np.abs(found.trajectory["tau_m"][:, 0]).max() > 0.99 * torque[0]  # and one is active


@pytest.mark.slow
def test_the_arm_goes_around_obstacles(planar):
    free = least_torque(planar, 30, "joints")
    tool = np.array(
        [planar.function("output")(q) for q in free.solve(verify=False).trajectory["q_a"]]
    )[:, :, 0]
    ball = flexgen.Sphere((*tool[150], 0.0), 0.05, name="ball")
    problem = least_torque(planar, 30, "joints")
    problem.avoid(ball, margin=0.01)
    found = problem.solve(accuracy=1e-4)
    points = planar.function("chain_points")
    for q in found.simulation.trajectory["q_a"][::5]:
        corners = np.array(points(q))
        assert np.linalg.norm(corners - np.array(ball.center)[:, None], axis=0).min() > 0.06 - 1e-4
    assert (
        found.status == Status.SOLVED
        and found.details["cost"] > 1.001 * free.solve(verify=False).details["cost"]
    )


def test_a_wall_keeps_the_arm_on_its_side(planar):
    free = least_torque(planar, 20, "joints").solve(verify=False).trajectory
    lowest = min(float(np.array(planar.function("chain_points")(q))[0, -1]) for q in free["q_a"])
    problem = least_torque(planar, 20, "joints")
    problem.avoid(flexgen.HalfSpace((-2.0, 0.0, 0.0), -1.6))
    assert lowest < 1.6
    found = problem.solve(accuracy=1e-3)
    ends = [
        float(np.array(planar.function("chain_points")(q))[0, -1]) for q in found.trajectory["q_a"]
    ]
    assert found.status == Status.SOLVED and max(ends) <= 1.6 + 1e-6
    check_numbers("wall", 1e-5, found=found.to_dict(), motion=dict(found.trajectory.channels))


@pytest.mark.slow
def test_soft_tracking_states_that_limits_keep_the_tool_off():
    model = flexgen.read("planar5_nmp@soft")
    exact = flexgen.solve(model, "line", verify=False)
    needed = np.abs(exact.trajectory["tau_m"]).max(axis=0)
    problem = flexgen.plan_problem(
        model, "line", mesh=60, limits=flexgen.Limits(tuple(0.9 * needed))
    )
    problem.add_squares(1e3 * problem.output_error)
    problem.add_cost(1e-6 * ca.sumsqr(ca.diff(problem.nodes("tau_m").T)))
    found = problem.solve(guess=exact)
    assert found.status == Status.LIMITS_ACTIVE
    assert 1e-4 < found.tool_error_max_m < 3e-3 and found.plan_error_max < 1e-5
    assert found.path_distance_max_m <= found.tool_error_max_m * (1 + 1e-9)


def test_a_periodic_motion_ends_as_it_begins(planar):
    problem = flexgen.plan_problem(planar, mesh=40)
    problem.periodic()
    problem.free_time(0.8, 0.8)
    problem.add_cost(ca.sumsqr(problem["tau_m"]))
    problem.subject_to(
        problem.nodes("q_a")[0, 20] - problem.nodes("q_a")[0, 0] == 0.3, name="swing"
    )
    problem.subject_to(
        problem.nodes("q_a")[0, 10] - problem.nodes("q_a")[0, 0] == 0.25, name="early swing"
    )
    problem.bound("q_a[q1]", 0.2, 1.0)
    problem.bound("q_a[q2]", -1.6, -0.8)
    found = problem.solve(accuracy=1e-4)
    q = found.simulation.trajectory["q_a"]
    v = found.simulation.trajectory["v_a"]
    assert found.status == Status.SOLVED
    check_numbers("periodic", 1e-5, found=found.to_dict(), motion=dict(found.trajectory.channels))
    assert np.abs(v[0]).max() > 1e-2  # it does not start at rest
    assert np.abs(q[-1] - q[0]).max() < 1e-4 and np.abs(v[-1] - v[0]).max() < 1e-2
    assert q[200, 0] - q[0, 0] == pytest.approx(0.3, abs=1e-4)


def test_an_unknown_number_is_found(tmp_path):
    """The least bound of the torque with which the double integrator makes its way in time: 4 J
    y / T^2.
    """
    problem = flexgen.plan_problem(flexgen.read(str(double_integrator(tmp_path))), mesh=20)
    problem.parameter("unused")
    assert vars(problem.parameters[0]) | {"symbol": None} == {
        "symbol": None,
        "lower": -np.inf,
        "upper": np.inf,
        "guess": 0.0,
    }
    problem.parameters.clear()
    problem.unknowns.pop()
    largest = problem.parameter("largest", 0.0, 100.0, guess=10.0)
    problem.add_cost(largest, at="end")
    problem.subject_to(problem["tau_m"] <= largest)
    problem.subject_to(-problem["tau_m"] <= largest)
    found = problem.solve()
    assert found.details["parameters"]["largest"] == pytest.approx(
        4 * INERTIA * 1.5 / 2.0**2,
        rel=1e-5,  # the barrier of IPOPT keeps 1e-7 of the scale from each of forty active bounds
    )


@pytest.mark.slow
def test_a_warm_start_takes_fewer_iterations(planar):
    problem = least_torque(planar, 30)
    size = np.abs(problem.solve(verify=False).trajectory["tau_m"]).max(axis=0)
    problem.bound("tau_m", -0.9 * size, 0.9 * size)
    cold = problem.solve(accuracy=1e-3)
    problem.bound("tau_m", -0.88 * size, 0.88 * size)
    warm = problem.solve(accuracy=1e-3, warm=True)
    again = problem.solve(accuracy=1e-3)
    assert cold.status == warm.status == Status.SOLVED
    assert warm.iterations < again.iterations
    assert warm.details["cost"] == pytest.approx(again.details["cost"], rel=1e-6)


# --- several phases ------------------------------------------------------------------------------
@pytest.mark.parametrize("where", ["end", "start"])
def test_the_rest_between_two_phases_holds(tmp_path, where):
    problem = least_torque(flexgen.read(str(double_integrator(tmp_path))), 5)
    phase = problem.then(1.0, mesh=5)
    phase.add_squares(phase["tau_m"])
    (problem.end_at if where == "end" else phase.start_at)([2.0])
    found = problem.solve()
    k = int(np.abs(found.trajectory.time - 2.0).argmin())
    at = found.trajectory
    assert found.status == Status.SOLVED and at["q_a"][k] == pytest.approx(2.0, abs=1e-8)
    assert at["v_a"][k] == pytest.approx(0.0, abs=1e-8)
    (problem if where == "end" else phase).bound("q_a", -9, 1.9)
    with pytest.raises(SolverError, match=f"'bound of q_a' is violated by 0.1 at the {where}"):
        problem.solve()
    problem.end_at([2.0])
    phase.start_at([1.0])
    with pytest.raises(ArgumentError, match="another start of phase 1"):
        problem.solve()


def test_the_reference_continues_in_the_next_phase(tmp_path):
    """Two phases of 1 s along a path of 2 s: its samples at the time since the beginning."""
    problem = flexgen.plan_problem(flexgen.read(str(double_integrator(tmp_path))), mesh=4)
    problem.free_time(1.0, 1.0)
    for phase in (problem, problem.then(1.0, mesh=4)):
        phase.add_squares(phase["output"] - phase.reference)
    found = problem.solve(verify=False).trajectory
    inside = (found.time >= 0.0) & (found.time <= 2.0)
    wanted = problem.path.sample(found.time[inside]).y[:, :, 0]
    assert np.allclose(found["y_ref"][inside], wanted, rtol=0, atol=1e-6)
    assert np.ptp(wanted) > 1.0


def test_obstacles_and_paths_hold_in_phases_that_are_added_afterwards(planar):
    stated = []
    for late in (True, False):
        problem = flexgen.plan_problem(planar, "line", mesh=3)
        phase = None if late else problem.then(0.1, mesh=2)
        problem.avoid(flexgen.Sphere((0.5, 1.5, 0), 0.1), margin=0.01)
        problem.follow(1e-3)
        phase = phase or problem.then(0.1, mesh=2)
        stated.append(
            [(row.name, row.slack, str(row.value)) for row in phase.content.rows["path"]]
        )
    assert stated[0] == stated[1] and [row[0] for row in stated[0]] == [
        "sphere 1",
        "distance from the path",
    ]


# --- what must not be called a solution ----------------------------------------------------------
def test_a_mesh_that_is_too_coarse_is_seen_by_the_simulation():
    """On 20 intervals IPOPT finds a solution that is not a motion of the robot: the simulation
    rejects it.
    """
    found = least_torque("planar5_nmp@soft", 20, "joints").solve()
    assert found.verdict == "Solve_Succeeded" and found.status == Status.TOLERANCE_NOT_MET
    assert found.plan_error_max > 0.1 and "finer mesh" in found.warnings[-1]
    assert (
        least_torque("planar5_nmp@soft", 20, "joints").solve(verify=False).status
        == Status.TOLERANCE_NOT_MET
    )


def test_planted_wrong_equations_are_seen(planar, monkeypatch):
    """Equations with the sign of one torque wrong: the program is solved, the simulation tells."""
    right = transcribe.residual_of

    def wrong(equations, y, dy, ddy, tau):
        return right(equations, y, dy, ddy, ca.vertcat(tau[0], -tau[1]))

    monkeypatch.setattr(transcribe, "residual_of", wrong)
    for verify in (True, False):
        found = least_torque(planar, 20).solve(verify=verify)
        assert found.status == Status.TOLERANCE_NOT_MET


def test_a_constraint_broken_between_the_points_is_seen(planar):
    """Five intervals: the tool cuts through a small ball between the instants of the mesh."""
    problem = flexgen.plan_problem(planar, "line", mesh=5)
    problem.add_squares(problem.output_error)
    middle = np.r_[problem.path.sample(np.array([0.24])).y[0, :, 0], 0.0]
    problem.avoid(flexgen.Sphere(tuple(middle), 0.006), samples=0)
    found = problem.solve(guess="lq", accuracy=1.0)
    tool = np.array(
        [np.array(planar.function("forward_kinematics")(q)[0]) for q in found.trajectory["q_a"]]
    )[:, :, 0]
    assert (
        np.linalg.norm(tool - middle, axis=1).min() < 1e-3 and found.verdict == "Solve_Succeeded"
    )
    assert (
        found.status == Status.TOLERANCE_NOT_MET and "'sphere 1' is violated" in found.warnings[0]
    )


def test_nan_between_the_points_is_seen(tmp_path):
    """The root is NaN for 4 ms between two collocation points only."""
    problem = least_torque(flexgen.read(str(double_integrator(tmp_path))), 5)
    problem.subject_to(ca.sqrt(ca.fabs(problem["time"] - 0.5) - 0.002), -9, 9, name="root")
    found = problem.solve()
    assert found.verdict == "Solve_Succeeded" and found.status == Status.TOLERANCE_NOT_MET
    assert "'root' is violated by nan" in found.warnings[0]


def test_the_distance_from_the_path_is_checked_between_the_points(planar):
    for mesh, exact in ((40, True), (6, False)):
        problem = least_torque(planar, mesh, "line")
        problem.follow(1e-4)
        found = problem.solve(verify=False)
        tool = np.array(
            [np.array(planar.function("output")(q))[:, 0] for q in found.trajectory["q_a"]]
        )
        assert found.verdict == "Solve_Succeeded"
        check_numbers(
            f"follow_{mesh}", 1e-5, found=found.to_dict(), motion=dict(found.trajectory.channels)
        )
        assert (np.abs(tool - found.trajectory["y_ref"]).max() <= 1e-4) == exact
        assert (found.warnings == ()) == exact and (
            "'distance from the path'" in str(found.warnings)
        ) != exact


def test_infeasible_problems_name_the_constraint(planar):
    found = least_torque(planar, 20, v_m=20.0).solve()
    assert found.status == Status.TOLERANCE_NOT_MET and found.simulation is None
    assert "Infeasible" in found.verdict and "largest violated constraint is" in found.verdict
    problem = least_torque(planar, 20)
    problem.subject_to(problem["tool_position"][0], upper=0.9, at="end", name="behind the wall")
    with pytest.raises(
        SolverError,
        match=r"'behind the wall' is violated by .* at the end, where the arm is at rest",
    ):
        problem.solve()


# --- what a plan offers --------------------------------------------------------------------------
@pytest.mark.slow
def test_a_plan_can_be_drawn_reported_and_simulated(planar, tmp_path):
    found = least_torque(planar, 10).solve(accuracy=1e-2)
    found.plot().savefig(tmp_path / "plan.png")
    assert found.report(tmp_path / "report").exists()
    again = flexgen.simulate(planar, found.trajectory, command=found.torque_command)
    assert np.abs(again.trajectory["q_a"] - found.simulation.trajectory["q_a"]).max() < 1e-9
    assert found.to_dict()["method"] == "plan" and "planar5_nmp" in str(found)
    assert replace(found, simulation=None).tool_error_max_m is None


@pytest.mark.parametrize(("duration", "count"), [(1e-4, 10), (0.04, 20), (10.0, 1000)])
def test_a_solution_is_checked_each_millisecond_between_its_nodes(duration, count):
    """At least as often as a torque has samples on an interval, at most 1000 times; the longest
    interval is a half.
    """
    phase = SimpleNamespace(number=1, mesh=SimpleNamespace(h=np.array([0.2, 0.5, 0.3])))
    assert _between(phase, np.array([9.0, duration])) == pytest.approx(
        (np.arange(count) + 0.5) / count
    )
