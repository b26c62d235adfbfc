"""Inverse dynamics: every method is judged by simulating the full model forward, and by the other methods."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path as Path_

import numpy as np
import pytest
from referee import Referee
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.errors import ArgumentError, SolverError
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.evaluate import evaluate
from flexgen.mechanics.statics import gear_twist, hold_joints, reach
from flexgen.model.elements import Move, Output
from flexgen.model.reader import model_names, read
from flexgen.problems.path import Path
from flexgen.simulation import simulate
from flexgen.solvers.collocation import collocate
from flexgen.solvers.drives import twists
from flexgen.solvers.full import Limits, limits_from_model
from flexgen.solvers.reduction import Reduction
from flexgen.solvers.solution import residual_max
from flexgen.solvers.tableaus import gauss, radau
from flexgen.trajectory import Trajectory

ROBOTS = Path_(__file__).parent / "robots"
COMPLETE = {
    "motor_coupling": "complete",
    "motor.m1.axis": [0, 0, 1],
    "motor.m1.carrier": "base",
    "motor.m2.axis": [0, 0, 1],
    "motor.m2.carrier": "arm1",
    "motor.m2.inertia": 0.01,
}
MICRON = 1e-6  # what a user is promised
RIGHT = 1e-8  # what the methods reach: a hundredth of it
BALANCE = 1e-9  # relative; the integrator's tolerance is 1e-11 a step


@pytest.mark.parametrize("name", ["planar5_mp", "planar5_nmp", "planar5_soft", "beam_arm"])
def test_collocation_is_verified_to_a_micron(name: str) -> None:
    solution = flexgen.solve(name)
    simulation = solution.simulation
    assert simulation is not None and simulation.tool_error_max_m is not None
    assert simulation.tool_error_max_m < RIGHT < MICRON
    assert simulation.energy_error < BALANCE
    assert solution.status == "solved" and solution.verdict == "Solve_Succeeded"
    # the machine stands still before it begins, at rest to the last digit
    assert np.abs(solution.trajectory["v_a"][0]).max() < 1e-9


@pytest.mark.parametrize("move", ["joints", "line"])
def test_closed_form_on_six_axes(move: str) -> None:
    solution = flexgen.solve("manutec_r3", move)
    assert solution.method == "closed-form"
    assert solution.tool_error_max_m is not None and solution.tool_error_max_m < MICRON / 10
    assert solution.tool_error_max_rad is not None and solution.tool_error_max_rad < 1e-7


@pytest.mark.long
def test_six_axes_with_twelve_elasticities() -> None:
    solution = flexgen.solve("manutec_r3_efjm")
    assert solution.method == "collocation" and solution.status == "solved"
    assert solution.tool_error_max_m is not None and solution.tool_error_max_m < MICRON
    assert solution.tool_error_max_rad is not None and solution.tool_error_max_rad < 1e-6


def test_the_torque_of_a_non_minimum_phase_arm_begins_before_the_path() -> None:
    solution = flexgen.solve("planar5_nmp", verify=False, mesh=1e-3)
    t, tau = solution.trajectory.time, solution.trajectory["tau_m"]
    before = np.abs(tau[t < 0] - tau[0]).max(axis=0)
    q3 = solution.trajectory["q_a"][:, 2]
    assert solution.lead_s > 0 and (before > 0).all()
    # it grows like exp(t / tau) with the slowest unstable zero, 892 rad/s
    window = (t > -0.008) & (t < -0.002)
    growth = np.polyfit(t[window], np.log(np.abs(q3[window] - q3[0])), 1)[0]
    assert growth == pytest.approx(892, rel=0.02)
    causal = flexgen.solve("planar5_mp", verify=False)
    t, q3 = causal.trajectory.time, causal.trajectory["q_a"][:, 2]
    assert np.abs(q3[t < 0] - q3[0]).max() < 1e-10


def test_a_wrong_torque_is_seen() -> None:
    """Planted bug: a torque one per mille off must not pass the verification."""
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(equations, verify=False)
    trajectory = solution.trajectory
    wrong = dict(trajectory.channels, tau_m=trajectory["tau_m"] * 1.001)
    assert (simulate(equations, dataclasses.replace(trajectory, channels=wrong)).tool_error_max_m or 0) > MICRON
    late = dict(trajectory.channels, tau_m=np.vstack([trajectory["tau_m"][:1], trajectory["tau_m"][:-1]]))
    assert (simulate(equations, dataclasses.replace(trajectory, channels=late)).tool_error_max_m or 0) > MICRON


def test_a_sign_error_in_the_coriolis_term_is_seen() -> None:
    """Planted bug: the solver works with c reversed, the machine does not."""

    class Bugged(Equations):
        def _inverse_dynamics(self):  # type: ignore[no-untyped-def]
            inputs, names, (tau,), names_out = super()._inverse_dynamics()
            h, g = super()._bias()[2][0], super()._gravity()[2][0]
            return inputs, names, [tau - 2 * (h - g)], names_out

    model = read("planar5_mp")
    bugged = Bugged(model)
    with pytest.raises(SolverError, match="does not satisfy the equations of motion"):
        flexgen.solve(bugged, verify=False)
    seen = flexgen.solve(bugged, method="collocation", mesh=0.005)
    assert seen.status == "inaccurate" and (seen.tool_error_max_m or 0) > 100 * MICRON


def test_the_error_falls_with_the_order_of_the_method() -> None:
    equations = flexgen.derive("planar5_mp")
    path = Path(equations, equations.model.move("line"))
    reduction = Reduction(equations)

    def deflections(h: float, stages: int) -> np.ndarray:
        n = round(0.5 / h)
        found = collocate(reduction, path, np.linspace(0.0, 0.5, n + 1), stages=stages)
        return found.q_e[:: n // 10, 0]

    # the shortest mesh with three stages is the reference; 20 ms and 10 ms are in the asymptotic range
    best = deflections(0.00125, 3)
    for stages, order in ((1, 2), (2, 4)):
        coarse, fine = (np.abs(deflections(h, stages) - best).max() for h in (0.01, 0.005))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.6)


def test_full_and_reduced_agree() -> None:
    equations = flexgen.derive("planar5_nmp")
    reduced = flexgen.solve(equations, verify=False)
    full = flexgen.solve(equations, method="full")
    assert full.tool_error_max_m is not None and full.tool_error_max_m < MICRON
    t = np.linspace(0, 0.5, 100)
    torques = [make_interp_spline(s.trajectory.time, s.trajectory["tau_m"], k=5)(t) for s in (reduced, full)]
    # what the tool does not feel is free: a torque ripple at the frequency of the mesh, a hundredth at most
    assert np.abs(torques[0] - torques[1]).max() < 1e-2 * np.abs(torques[0]).max()


def test_torque_limits_are_kept_and_their_price_is_told() -> None:
    equations = flexgen.derive("planar5_nmp")
    free = flexgen.solve(equations, verify=False)
    bound = tuple(0.9 * np.abs(free.trajectory["tau_m"]).max(axis=0))
    solution = flexgen.solve(equations, limits=Limits(torque=bound))
    assert solution.method == "full" and solution.status == "limited"
    assert (np.abs(solution.trajectory["tau_m"]).max(axis=0) <= np.array(bound) * (1 + 1e-12)).all()
    assert solution.tool_error_max_m is not None and 1e-4 < solution.tool_error_max_m < 1e-2
    # the plan itself is verified as closely as an exact path would be
    assert solution.plan_error_max is not None and solution.plan_error_max < 1e-5


def test_speed_limits_are_kept() -> None:
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(equations, limits=Limits(speed=(1000.0, 250.0)))
    assert solution.status == "limited"
    # bounded at the Gauss points; between them it may be passed by a trifle
    assert np.abs(solution.trajectory["v_m"][:, 1]).max() < 250.0 * 1.001


def test_limits_that_do_not_bind_change_nothing() -> None:
    solution = flexgen.solve("planar5_nmp", limits=Limits(torque=(30.0, 10.0)))
    assert solution.status == "solved" and (solution.tool_error_max_m or 1) < 2 * MICRON


def test_limits_of_the_model_file() -> None:
    assert limits_from_model(read("four_mass")).torque == (20.0,)
    with pytest.raises(ArgumentError, match="states none"):
        limits_from_model(read("planar5_mp"))
    with pytest.raises(ArgumentError, match="expected 2 positive numbers"):
        flexgen.solve("planar5_mp", limits=Limits(torque=(1.0, -2.0)))


def test_a_zero_may_pass_through_infinity_along_the_path() -> None:
    """There the rows that give the accelerations are singular between two samples; the motion itself is smooth."""
    solution = flexgen.solve(ROBOTS / "spatial.toml")
    assert (solution.method, solution.status) == ("collocation", "solved")
    assert (solution.tool_error_max_m or 1) < RIGHT


@pytest.mark.parametrize("damping", [1.0, 1e-2, 1e-6])
def test_gears_with_next_to_no_damping(damping: float) -> None:
    solution = flexgen.solve(read("planar5_nmp", overrides={"element.arm1.dof.q1.gear.damping": damping}))
    assert (solution.tool_error_max_m or 1) < RIGHT


def test_a_move_of_no_length_is_solved() -> None:
    solution = flexgen.solve(read("planar5_nmp", overrides={"move.line.displacement": [0.0, 0.0, 0.0]}))
    assert solution.status == "solved" and (solution.tool_error_max_m or 1) < 1e-12


def test_an_output_that_no_motor_moves_is_told() -> None:
    weights = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    model = dataclasses.replace(read("planar5_nmp"), output=Output("combination", "", weights, "rad"))
    with pytest.raises(SolverError, match="does not determine the actuated coordinates"):
        flexgen.solve(model, "joints")


def test_limits_below_gravity_are_told() -> None:
    with pytest.raises(SolverError, match=r"motor m1 needs 8\.57 N m to hold the arm"):
        flexgen.solve("planar5_nmp", limits=Limits(torque=(5.0, 6.0)))


def test_too_rough_a_move_is_warned_of() -> None:
    model = read("planar5_nmp@undamped", overrides={"move.line.smoothness": 3})
    solution = flexgen.solve(model, method="collocation", mesh=0.005)
    assert any("smoothness 3 makes the torque jump" in warning for warning in solution.warnings)
    assert not flexgen.solve("planar5_nmp", verify=False).warnings


def test_coarse_meshes_are_refused_or_seen() -> None:
    assert flexgen.solve("abb_arm", method="collocation", mesh=0.5).status == "inaccurate"
    for name, mesh in (("beam_arm", 0.1), ("planar5_nmp", 0.08)):
        with pytest.raises(SolverError, match="does not satisfy the equations of motion"):
            flexgen.solve(name, mesh=mesh, verify=False)


def test_gear_torque_channel_is_that_of_the_gears() -> None:
    for name, changes in (("planar5_nmp", COMPLETE), ("elbow@rigid", {}), ("elbow", {})):
        equations = flexgen.derive(read(name, overrides=changes))
        trajectory = flexgen.solve(equations, method="full", verify=False).trajectory
        if not equations.model.i_m:
            arm = [trajectory[x] for x in ("q_a", "v_a", "a_a")]
            right = evaluate(equations.function("inverse_dynamics"), *arm)[0]
            right = right - evaluate(equations.function("arm_forces"), *arm[:2])[0]
            close = 1e-2  # the torque's polynomial between the Gauss points, where the equations need not hold
        else:
            state = [trajectory[x] for x in ("q_a", "v_a", "q_m", "v_m")]
            right, close = evaluate(equations.function("gear_torque"), *state)[0], 1e-9
        assert np.abs(right - trajectory["tau_g"]).max() < close * np.abs(right).max()


def test_a_gear_with_a_kink_is_solved_by_the_full_method() -> None:
    solution = flexgen.solve("four_mass@piecewise")
    assert (solution.method, solution.status) == ("full", "solved")
    assert (solution.tool_error_max_m or 1) < 2 * MICRON
    exact = flexgen.solve("four_mass@piecewise", method="collocation", mesh=0.005)
    assert exact.status == "inaccurate"  # its torque would have to jump


@pytest.mark.long
def test_backlash_is_solved_by_the_full_method_when_the_closed_form_fails() -> None:
    said: list[str] = []
    solution = flexgen.solve("kr300@backlash", progress=said.append)
    assert any("trying the full model" in line for line in said)
    assert (solution.method, solution.status) == ("full", "solved")
    assert (solution.tool_error_max_m or 1) < 2 * MICRON and (solution.tool_error_max_rad or 1) < 2 * MICRON


def test_complete_motor_coupling() -> None:
    """Rotors that turn with their carriers: solved by the full method; leaving the coupling out shows in the tool."""
    complete = flexgen.derive(read("planar5_nmp", overrides=COMPLETE))
    solution = flexgen.solve(complete)
    assert solution.method == "full" and solution.status == "solved"
    assert (solution.tool_error_max_m or 1) < 2 * MICRON
    simple = read("planar5_nmp", overrides={"motor.m2.inertia": 0.01})
    careless = flexgen.solve(simple, verify=False)
    assert (simulate(complete, careless.trajectory).tool_error_max_m or 0) > 100 * MICRON


def test_flexible_joint_closed_form_against_the_textbook() -> None:
    """tau = J q_m'' + f + M a + c + g with q_m = q + K^-1 (M a + c + g), two undamped gears, derivatives by splines."""
    changes = {f"element.{e}.dof.{q}.gear.damping": 0.0 for e, q in (("upper", "q1"), ("fore", "q2"))}
    equations = flexgen.derive(read("elbow", overrides=changes))
    model = equations.model
    solution = flexgen.solve(equations, "joints", verify=False)
    t = solution.trajectory.time
    q, v, a = (solution.trajectory[x] for x in ("q_a", "v_a", "a_a"))
    load = evaluate(equations.function("inverse_dynamics"), q, v, a)[0]
    stiffness = np.array([7.5189e6, 4.0999e6])
    theta = make_interp_spline(t, q + load / stiffness, k=7)
    inertia = np.array([m.inertia for m in model.motors])
    ratio = np.diag(model.eta)
    torque = inertia * ratio * theta(t, 2) + load / ratio
    inner = slice(20, -20)  # a spline's derivative is poor at its ends
    assert np.abs(torque - solution.trajectory["tau_m"])[inner].max() < 1e-6 * np.abs(torque).max()


def test_drives_with_a_nonlinear_damped_gear_against_an_integrator() -> None:
    equations = flexgen.derive("four_mass")
    t = np.linspace(0, 0.2, 201)
    w = 2 * np.pi * 5
    amplitude = 3e4
    tau = amplitude * np.stack([np.sin(w * t) ** 2, w * np.sin(2 * w * t), 2 * w**2 * np.cos(2 * w * t)], axis=-1)
    p, dp, ddp = twists(equations, t, tau[:, None, :])
    spring = equations.function("gear_spring")
    damping = 0.08 * 220**2
    exact = solve_ivp(
        lambda s, x: (amplitude * np.sin(w * s) ** 2 - np.array(spring(x.reshape(1, -1))[0]).ravel()) / damping,
        (0, 0.2),
        [0.0],
        method="Radau",
        rtol=1e-10,
        atol=1e-14,
        t_eval=t,
    )
    # the spring's curvature jumps at its break, which costs the fixed steps of 1 ms some digits there
    assert np.abs(p[:, 0] - exact.y[0]).max() < 1e-4 * np.abs(p).max()
    fine = make_interp_spline(t, exact.y[0], k=5)
    away = np.abs(np.abs(p[:, 0]) - 0.064 / 220) > 1e-4  # from the break, where a spline through samples cannot follow
    assert np.abs(fine(t, 1) - dp[:, 0])[away].max() < 1e-2 * np.abs(dp).max()
    assert np.isfinite(ddp).all()


@pytest.mark.parametrize(
    "spring",
    [
        {"type": "linear", "stiffness": 2e5},
        {"type": "cubic", "stiffness": 2e5, "cubic": 1e9},
        {"type": "smooth", "low": 1e5, "high": 4e5, "break_at": 1e-3},
        {"type": "piecewise", "low": 1e5, "high": 4e5, "break_at": 1e-3},
        {"type": "backlash", "stiffness": 4e5, "gap": 1e-3, "smoothing": 1e-5},
    ],
)
def test_gear_twist_inverts_every_spring(spring: dict[str, object]) -> None:
    model = read("planar5_mp", overrides={"element.arm1.dof.q1.gear.spring": spring})
    equations = flexgen.derive(model)
    tau = np.linspace(-3000, 3000, 61)[:, None] * np.array([1.0, 0.5])
    back = evaluate(equations.function("gear_spring"), gear_twist(equations, tau))[0]
    assert np.abs(back - tau).max() < 1e-9 * 3000


@pytest.mark.parametrize("stages", [1, 2, 3, 4, 5])
def test_tableaus_keep_their_order_conditions(stages: int) -> None:
    assert gauss(stages).order == 2 * stages and radau(stages).order == 2 * stages - 1
    with pytest.raises(AssertionError, match="order condition"):
        dataclasses.replace(gauss(stages), b=gauss(stages).b * 1.001)


def test_residual_catches_an_answer_that_is_none() -> None:
    equations = flexgen.derive("planar5_mp")
    trajectory = flexgen.solve(equations, verify=False).trajectory
    wrong = dict(trajectory.channels, tau_m=trajectory["tau_m"] + 0.1)
    assert residual_max(equations, trajectory) < 1e-3
    assert residual_max(equations, dataclasses.replace(trajectory, channels=wrong)) == pytest.approx(0.1, rel=1e-2)


def test_simulation_from_rest_stays_at_rest() -> None:
    equations = flexgen.derive("planar5_mp")
    rest = hold_joints(equations, np.array([0.3, -1.1]))
    base = flexgen.solve(equations, verify=False).trajectory
    n = len(base.time)
    still = {name: np.zeros_like(values) for name, values in base.channels.items()}
    still |= {"q_a": np.tile(rest.q_a, (n, 1)), "q_m": np.tile(rest.q_m, (n, 1)), "tau_m": np.tile(rest.tau_m, (n, 1))}
    moved = simulate(equations, dataclasses.replace(base, channels=still)).trajectory["q_a"] - rest.q_a
    assert np.abs(moved).max() < 1e-12


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"move": "nowhere"}, "move: given 'nowhere', model planar5_mp has: line, joints"),
        ({"method": "magic"}, "method: given 'magic', expected one of"),
        ({"method": "closed-form"}, "has 1 non-actuated coordinates"),
        ({"mesh": -1.0}, "mesh: given -1.0"),
        ({"preview": float("nan")}, "preview: given nan"),
        ({"preview": -1.0}, "preview: given -1.0, expected zero or a positive time"),
        ({"accuracy": 0.0}, "accuracy: given 0.0"),
        ({"mesh": 1e-8}, "mesh: given 1e-08 s, which makes .* intervals"),
        ({"preview": 1e9}, "expected at most 20000"),
        ({"method": "collocation", "limits": Limits(torque=(1.0, 1.0))}, "cannot respect them"),
    ],
)
def test_wrong_questions_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        flexgen.solve("planar5_mp", **arguments)  # type: ignore[arg-type]


def test_a_path_out_of_reach_is_told() -> None:
    move = Move("away", "tool_line", (0.3, -1.1), 0.5, 5, displacement=(0.5, 0.0, 0.0))
    with pytest.raises(SolverError, match="leaves the workspace or passes a singular pose"):
        flexgen.solve("planar5_mp", move)


def test_a_trajectory_of_another_model_is_refused() -> None:
    trajectory = flexgen.solve("planar5_mp", verify=False).trajectory
    with pytest.raises(ArgumentError, match="was it written for another model"):
        simulate("manutec_r3", trajectory)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_trajectories_survive_a_file(tmp_path, suffix: str) -> None:  # type: ignore[no-untyped-def]
    equations = flexgen.derive("planar5_mp")
    solution = flexgen.solve(equations, verify=False)
    path = solution.trajectory.save(tmp_path / f"line.{suffix}")
    again = Trajectory.load(path)
    for name, values in solution.trajectory.channels.items():
        assert np.array_equal(again[name], values)
    assert simulate(equations, path).tool_error_max_m == simulate(equations, solution.trajectory).tool_error_max_m
    path.write_text("no trajectory")
    with pytest.raises(ArgumentError, match="no trajectory of flexgen"):
        Trajectory.load(path)


def test_columns_are_known_by_their_labels(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A file whose columns are in another order is the same file; other units or names are refused."""
    equations = flexgen.derive("elbow")
    trajectory = flexgen.solve(equations, verify=False).trajectory
    text = trajectory.save(tmp_path / "elbow.csv").read_text().splitlines()
    header = text[1].split(",")
    one, two = header.index("tau_m[m1] N m"), header.index("tau_m[m2] N m")

    def written(lines: list[str]) -> Trajectory:
        (tmp_path / "other.csv").write_text("\n".join(lines) + "\n")
        return Trajectory.load(tmp_path / "other.csv")

    swapped = [text[0]]
    for line in text[1:]:
        cells = line.split(",")
        cells[one], cells[two] = cells[two], cells[one]
        swapped.append(",".join(cells))
    assert simulate(equations, written(swapped)).tool_error_max_m == simulate(equations, trajectory).tool_error_max_m
    with pytest.raises(ArgumentError, match="tau_m: given in kN m, expected in N m"):
        simulate(equations, written([text[0], text[1].replace("] N m", "] kN m"), *text[2:]]))
    with pytest.raises(ArgumentError, match="q_a: given columns q1, q9, expected q1, q2"):
        simulate(equations, written([text[0], text[1].replace("q_a[q2]", "q_a[q9]"), *text[2:]]))
    with pytest.raises(ArgumentError, match="line 7: given 3 columns, expected"):
        written([*text[:6], "1,2,3", *text[7:]])
    with pytest.raises(ArgumentError, match="line 7: given text, expected numbers"):
        written([*text[:6], text[6].replace("0.", "o.", 1), *text[7:]])
    other = written([text[0].replace('"elbow"', '"shoulder"'), *text[1:]])
    assert "was written for model 'shoulder'" in simulate(equations, other).warnings[0]


def test_trajectories_are_regular_files(tmp_path) -> None:  # type: ignore[no-untyped-def]
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(ArgumentError, match="expected a regular file"):
        Trajectory.load(tmp_path / "pipe.npz")
    with pytest.raises(ArgumentError, match="no regular file"):
        flexgen.solve("elbow", verify=False).trajectory.save(tmp_path / "pipe.npz")


@pytest.mark.parametrize(
    ("name", "move"),
    [(name, move.name) for name in model_names() for move in read(name).moves if name != "manutec_r3_efjm"],
)
def test_every_shipped_move_is_solved(name: str, move: str) -> None:
    solution = flexgen.solve(name, move)
    assert solution.status == "solved"
    assert (solution.tool_error_max_m or 0) < 2 * MICRON and (solution.tool_error_max_rad or 0) < MICRON
    assert not solution.warnings, solution.warnings


@pytest.mark.long
def test_the_other_move_with_twelve_elasticities() -> None:
    solution = flexgen.solve("manutec_r3_efjm", "joints")
    assert solution.status == "solved" and (solution.tool_error_max_m or 1) < MICRON / 10


@pytest.mark.long
def test_the_referee_moves_the_tool_along_the_path() -> None:
    """The torque found, applied to Newton-Euler equations of another hand and integrated by another method."""
    model = read("planar5_nmp")
    solution = flexgen.solve(model, verify=False)
    trajectory = solution.trajectory
    tau = make_interp_spline(trajectory.time, trajectory["tau_m"], k=5)
    referee = Referee(model)

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        a_a, a_m = referee.forward_dynamics(x[:3], x[5:8], x[3:5], x[8:], tau(t))
        return np.concatenate([x[5:], a_a, a_m])

    start = np.concatenate([trajectory["q_a"][0], trajectory["q_m"][0], np.zeros(5)])
    ends = np.linspace(0.1, 0.5, 5)
    span = (trajectory.time[0], 0.5)
    done = solve_ivp(rate, span, start, method="RK45", rtol=1e-8, atol=1e-11, t_eval=ends)
    path = Path(flexgen.derive(model), model.move("line"))
    for k, t in enumerate(ends):
        q1, q2, q3 = done.y[:3, k]
        tool = 0.8 * np.exp(1j * q1) + 0.35 * np.exp(1j * (q1 + q2)) + 0.45 * np.exp(1j * (q1 + q2 + q3))
        reference = path.sample(np.array([t])).y[0, :, 0]
        # the tolerance of a lower-order integrator, a tenth of what is promised
        assert np.hypot(tool.real - reference[0], tool.imag - reference[1]) < MICRON / 10


@pytest.mark.parametrize("factor", [0.1, 0.01])
def test_fast_moves_of_light_machines(factor: float) -> None:
    """The same arm with time running faster: stiffness and gravity by factor^-2, damping by factor^-1."""
    changes: dict[str, object] = {
        "gravity": [0.0, -9.81 / factor**2, 0.0],
        "move.line.duration": 0.5 * factor,
        "element.arm3.dof.q3.spring.stiffness": 1.5e5 / factor**2,
        "element.arm3.dof.q3.damping": 150.0 / factor,
    }
    for element, joint, stiffness, damping in (("arm1", "q1", 4e5, 400.0), ("arm2", "q2", 2.5e5, 250.0)):
        changes[f"element.{element}.dof.{joint}.gear.spring.stiffness"] = stiffness / factor**2
        changes[f"element.{element}.dof.{joint}.gear.damping"] = damping / factor
    for motor in ("m1", "m2"):
        changes[f"motor.{motor}.friction.viscous"] = 20e-4 / factor
    solution = flexgen.solve(read("planar5_nmp", overrides=changes))
    slow = flexgen.solve("planar5_nmp", verify=False)
    assert (solution.tool_error_max_m or 1) < RIGHT
    largest = [np.abs(s.trajectory["tau_m"]).max() for s in (solution, slow)]
    assert largest[0] * factor**2 == pytest.approx(largest[1], rel=1e-4)


def test_small_arms_are_judged_by_their_size() -> None:
    assert reach(flexgen.derive("planar5_nmp")) == pytest.approx(1.6, rel=1e-3)
    assert reach(flexgen.derive("four_mass")) == 1.0
    small = {"element.arm2.origin.position": [8e-4, 0, 0], "element.arm3.origin.position": [3.5e-4, 0, 0]}
    small["tool.position"] = [4.5e-4, 0, 0]
    assert reach(flexgen.derive(read("planar5_nmp", overrides=small))) == pytest.approx(1.6e-3, rel=1e-3)


COUPLED = {"motor.m2.drives": ["q1", "q2"], "motor.m2.ratio": [30.0, 100.0]}


@pytest.mark.parametrize(("name", "method"), [("planar5_nmp", "collocation"), ("elbow", "closed-form")])
def test_coupled_motors(name: str, method: str) -> None:
    solution = flexgen.solve(read(name, overrides=COUPLED))
    assert solution.method == method and solution.status == "solved"
    assert (solution.tool_error_max_m or 1) < RIGHT
    # both motors carry the first joint now: the torques are others than without the coupling
    alone = flexgen.solve(name, verify=False)
    assert np.abs(solution.trajectory["tau_m"] - alone.trajectory["tau_m"]).max() > 0.1


def test_an_undamped_nonlinear_gear() -> None:
    cubic = {"type": "cubic", "stiffness": 4e5, "cubic": 2e10}
    changes = {"element.arm1.dof.q1.gear.spring": cubic, "element.arm1.dof.q1.gear.damping": 0.0}
    solution = flexgen.solve(read("planar5_mp", overrides=changes))
    assert (solution.tool_error_max_m or 1) < RIGHT


@pytest.mark.parametrize(
    ("move", "message"),
    [
        (Move("x", "toolline", (0.3, -1.1), 0.5, 5), "given type 'toolline'"),
        (Move("x", "tool_line", (0.3,), 0.5, 5, displacement=(0.1, 0.0, 0.0)), "expected 2 finite numbers"),
        (Move("x", "tool_line", (0.3, -1.1), 0.5, 5), "given displacement"),
        (Move("x", "joint", (0.3, -1.1), 0.5, 5, end=(float("nan"), 0.0)), "given end"),
    ],
)
def test_wrong_moves_are_refused(move: Move, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        flexgen.solve("planar5_mp", move)


def test_wrong_limits_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"expected flexgen\.Limits"):
        flexgen.solve("planar5_mp", limits=(1.0, 2.0))  # type: ignore[arg-type]


def test_guards_of_the_verdicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bugs: a simulation that loses energy, and an NLP that calls open constraints a success."""
    import flexgen.solvers.nlp as nlp
    import flexgen.solvers.solve as solving

    def leaking(*arguments: object, **options: object) -> object:
        return dataclasses.replace(simulate(*arguments, **options), energy_error=1e-3)  # type: ignore[arg-type]

    monkeypatch.setattr(solving, "simulate", leaking)
    assert flexgen.solve("planar5_mp", method="collocation", mesh=0.005).status == "inaccurate"
    monkeypatch.setattr(solving, "simulate", simulate)
    monkeypatch.setattr(nlp, "_violation", lambda *bounds: 1.0)
    with pytest.raises(SolverError, match="Solve_Succeeded"):
        flexgen.solve("planar5_mp", method="collocation", mesh=0.005)


def test_exceeded_limits_are_warned_of() -> None:
    changes = {
        "motor.m1.torque_max": 20.0,
        "element.arm2.dof.q2.speed_max": 1.0,
        "element.arm1.dof.q1.acceleration_max": 2.0,
    }
    warnings = flexgen.solve(read("planar5_nmp", overrides=changes), verify=False).warnings
    assert len(warnings) == 3
    assert "motor m1: torque 24.48 N m exceeds its limit 20 N m" in warnings
