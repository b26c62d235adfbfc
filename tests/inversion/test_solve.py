"""Inverse dynamics: every answer is judged by simulating the full model forward."""

from __future__ import annotations

import dataclasses
from pathlib import Path as Path_

import casadi as ca
import numpy as np
import pytest
from referee import Referee
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from shipped_models import shipped

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.statics import reach
from flexgen.inversion.judge.status import Status
from flexgen.model.elements import Move, Output
from flexgen.model.reader import model_names, read
from flexgen.paths.path import Path
from flexgen.simulation.open_loop import UNSTABLE
from flexgen.simulation.simulate import simulate

ROBOTS = Path_(__file__).parents[1] / "support" / "robots"
MICRON = 1e-6  # what a user is promised
RIGHT = 1e-8  # what the methods reach: a hundredth of it
BALANCE = 1e-9  # relative; the integrator's tolerance is 1e-11 a step
COUPLED = {"motor.m2.drives": ["q1", "q2"], "motor.m2.ratio": [30.0, 100.0]}


def errors_on_path(solution: flexgen.Solution) -> tuple[float, float]:
    """Largest error [m] and [rad] while the reference moves.

    The claimed error covers the time after it too, without feedback, in which the arm drifts by
    its remaining motion; a solved move keeps the accuracy there.
    """
    assert solution.simulation is not None
    run = solution.simulation.trajectory
    y_ref = solution.trajectory["y_ref"]
    moving = np.flatnonzero((y_ref != y_ref[-1]).any(axis=1))
    own = slice(0, moving[-1] + 1 if len(moving) else None)
    units = np.array(run.units["error"])
    in_m, in_rad = (
        np.linalg.norm(run["error"][own][:, units == unit], axis=1).max() for unit in ("m", "rad")
    )
    return float(in_m), float(run["turn"][own].max() if "turn" in run else in_rad)


@pytest.mark.parametrize(
    "name",
    [
        "planar5_mp",
        "planar5_nmp",
        "planar5_soft",
        pytest.param("beam_arm", marks=pytest.mark.slow),
    ],
)
def test_collocation_is_verified_to_a_micron(name: str) -> None:
    solution = flexgen.solve(name, method="collocation")
    simulation = solution.simulation
    assert simulation is not None and simulation.tool_error_max_m is not None
    assert simulation.tool_error_max_m < RIGHT < MICRON
    assert simulation.energy_error < BALANCE
    assert solution.status == Status.SOLVED and solution.verdict == "Solve_Succeeded"
    # the machine stands still before it begins, at rest to the last digit
    assert np.abs(solution.trajectory["v_a"][0]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("move", ["joints", "line"])
def test_closed_form_on_six_axes(move: str) -> None:
    solution = flexgen.solve("manutec_r3", move)
    assert solution.method == "closed-form"
    assert errors_on_path(solution)[0] < MICRON / 10 and errors_on_path(solution)[1] < 1e-7


@pytest.mark.full
def test_six_axes_with_twelve_elasticities() -> None:
    solution = flexgen.solve("manutec_r3_efjm", method="collocation")
    assert solution.status == Status.SOLVED
    assert solution.tool_error_max_m is not None and solution.tool_error_max_m < MICRON
    assert solution.tool_error_max_rad is not None and solution.tool_error_max_rad < 1e-6


@pytest.mark.parametrize("method", ["closed-form", "collocation", "full"])
def test_one_coordinate_is_enough(method: str) -> None:
    solution = flexgen.solve(ROBOTS / "one.toml", method=method)
    assert solution.simulation is not None
    assert np.abs(solution.simulation.trajectory["error"]).max() < MICRON
    # optimal control ends at rest to the tolerance of its solver; then the arm drifts under the
    # last torque
    assert (
        solution.tool_error_max_m is not None
        and solution.tool_error_max_m < (5 if method == "full" else 1) * MICRON
    )
    link = 0.1 + 5.0 * 0.4**2
    ratio = 50.0
    inertia = 1e-4
    q, a, tau = (solution.trajectory[name][:, 0] for name in ("q_a", "a_a", "tau_m"))
    by_hand = ((link + ratio**2 * inertia) * a + 5.0 * 9.81 * 0.4 * np.cos(q)) / ratio
    # there the torque is a polynomial on every interval of the mesh
    tolerance = 1e-3 if method == "full" else 1e-12
    assert np.abs(tau - by_hand).max() < tolerance * np.abs(by_hand).max()


def test_collocation_needs_no_elastic_coordinate() -> None:
    solution = flexgen.solve("elbow", method="collocation")
    assert solution.tool_error_max_m is not None and solution.tool_error_max_m < MICRON


def test_the_torque_of_a_non_minimum_phase_arm_begins_before_the_path() -> None:
    solution = flexgen.solve("planar5_nmp", verify=False, mesh=1e-3)
    t = solution.trajectory.time
    tau = solution.trajectory["tau_m"]
    before = np.abs(tau[t < 0] - tau[0]).max(axis=0)
    q3 = solution.trajectory["q_a"][:, 2]
    assert solution.preactuation_s > 0 and (before > 0).all()
    # it grows like exp(t / tau) with the slowest unstable zero, 892 rad/s
    window = (t > -0.008) & (t < -0.002)
    growth = np.polyfit(t[window], np.log(np.abs(q3[window] - q3[0])), 1)[0]
    assert growth == pytest.approx(892, rel=0.02)
    causal = flexgen.solve("planar5_mp", verify=False)
    t = causal.trajectory.time
    q3 = causal.trajectory["q_a"][:, 2]
    assert np.abs(q3[t < 0] - q3[0]).max() < 1e-10


def test_a_wrong_torque_is_seen() -> None:
    """Planted bug: a torque one per mille off must not pass the verification."""
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(equations, verify=False)
    trajectory = solution.trajectory
    wrong = dict(trajectory.channels, tau_m=trajectory["tau_m"] * 1.001)
    assert (
        simulate(equations, dataclasses.replace(trajectory, channels=wrong)).tool_error_max_m or 0
    ) > MICRON
    late = dict(
        trajectory.channels, tau_m=np.vstack([trajectory["tau_m"][:1], trajectory["tau_m"][:-1]])
    )
    assert (
        simulate(equations, dataclasses.replace(trajectory, channels=late)).tool_error_max_m or 0
    ) > MICRON


@pytest.mark.slow
def test_a_sign_error_in_the_coriolis_term_is_seen() -> None:
    """Planted bug: the solver works with c reversed, the simulation does not."""

    class Bugged(Equations):
        def function(self, name: str) -> ca.Function:
            right = super().function(name)
            if name != "inverse_dynamics":
                return right
            q, v, a = (ca.SX.sym(word, self.model.n_a) for word in ("q_a", "v_a", "a_a"))
            tau = right(q, v, a) - 2 * (self.function("bias")(q, v) - self.function("gravity")(q))
            return ca.Function(name, [q, v, a], [tau], ["q_a", "v_a", "a_a"], ["tau_a"])

    model = read("planar5_mp")
    bugged = Bugged(model)
    with pytest.raises(SolverError, match="does not satisfy the equations of motion"):
        flexgen.solve(bugged, method="collocation", verify=False)
    seen = flexgen.solve(bugged, method="collocation", mesh=0.005)
    assert seen.status == Status.TOLERANCE_NOT_MET and (seen.tool_error_max_m or 0) > 100 * MICRON


@pytest.mark.slow
@pytest.mark.parametrize("method", ["lq", pytest.param("collocation", marks=pytest.mark.full)])
def test_a_zero_may_pass_through_infinity_along_the_path(method: str) -> None:
    """There the rows that give the accelerations are singular between two samples; the motion
    itself is smooth.
    """
    solution = flexgen.solve(ROBOTS / "spatial.toml", method=method)
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < RIGHT


def test_a_move_of_no_length_is_solved() -> None:
    solution = flexgen.solve(
        read("planar5_nmp", overrides={"move.line.displacement": [0.0, 0.0, 0.0]})
    )
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < 1e-12


@pytest.mark.slow
def test_an_output_that_no_motor_moves_is_refused() -> None:
    weights = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    model = dataclasses.replace(
        read("planar5_nmp"), output=Output("combination", "", weights, "rad")
    )
    with pytest.raises(SolverError, match="does not determine the actuated coordinates"):
        flexgen.solve(model, "joints")


def test_a_move_that_is_not_smooth_enough_is_warned_of() -> None:
    model = read("planar5_nmp@undamped", overrides={"move.line.smoothness": 3})
    solution = flexgen.solve(model, method="collocation", mesh=0.005)
    assert any("smoothness 3 makes the torque jump" in warning for warning in solution.warnings)
    assert not flexgen.solve("planar5_nmp", verify=False).warnings


@pytest.mark.slow
def test_coarse_meshes_are_refused_or_seen() -> None:
    assert (
        flexgen.solve("abb_arm", method="collocation", mesh=0.5).status == Status.TOLERANCE_NOT_MET
    )
    for name, mesh in (("beam_arm", 0.1), ("planar5_nmp", 0.08)):
        with pytest.raises(SolverError, match="does not satisfy the equations of motion"):
            flexgen.solve(name, method="collocation", mesh=mesh, verify=False)
        with pytest.raises(SolverError):  # too coarse for the solver, or for its residual
            flexgen.solve(name, method="lq", mesh=mesh, verify=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"move": "nowhere"},
            "move: given 'nowhere', expected one of model planar5_mp: line, joints",
        ),
        ({"method": "magic"}, "method: given 'magic', expected one of"),
        ({"method": "closed-form"}, "given coordinates without motor .q3."),
        ({"mesh": -1.0}, "mesh: given -1.0"),
        ({"preview": float("nan")}, "preview: given nan"),
        ({"preview": -1.0}, "preview: given -1.0, expected zero or a positive time"),
        ({"accuracy": 0.0}, "accuracy: given 0.0"),
        ({"mesh": 1e-8}, "mesh: given 1e-08 s, which makes .* intervals"),
        ({"preview": 1e9}, "expected at most 900000"),
        ({"method": "collocation", "preview": 1e9}, "expected at most 20000"),
        ({"method": "discretized", "limits": Limits(torque=(1.0, 1.0))}, "cannot keep limits"),
    ],
)
def test_wrong_arguments_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        flexgen.solve("planar5_mp", **arguments)  # type: ignore[arg-type]


def test_a_path_out_of_reach_is_an_error() -> None:
    move = Move("away", "tool_line", (0.3, -1.1), 0.5, 5, displacement=(0.5, 0.0, 0.0))
    with pytest.raises(SolverError, match="leaves the workspace or passes a singular pose"):
        flexgen.solve("planar5_mp", move)


# By collocation these take 10 s to some minutes of processor time for each move; the long tests
# solve one each.
LARGE = ("manutec_r3_efjm", "manutec_r3_18", "manutec_r3_24", "manutec_r3_30", "kr300_efjm")


@pytest.mark.parametrize(
    ("name", "move"),
    [
        (name, move.name)
        for name in model_names()
        for move in shipped(name).moves
        if name not in LARGE
    ],
)
def test_every_shipped_move_is_solved(name: str, move: str) -> None:
    solution = flexgen.solve(name, move)
    assert solution.status == Status.SOLVED
    in_m, in_rad = errors_on_path(solution)
    assert in_m < 2 * MICRON and in_rad < MICRON
    assert solution.simulation is not None
    # then the feedback is named, and nothing else
    unstable = solution.simulation.growth_whole > UNSTABLE
    assert [text.split(":")[0] for text in solution.warnings] == [
        "the open loop is unstable"
    ] * unstable


@pytest.mark.full
def test_the_other_move_with_twelve_elasticities() -> None:
    solution = flexgen.solve("manutec_r3_efjm", "joints", "collocation", time_limit=None)
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < MICRON / 10


@pytest.mark.full
def test_the_referee_moves_the_tool_along_the_path() -> None:
    """The torque found, applied to Newton-Euler equations of another hand and integrated by
    another method.
    """
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
        tool = (
            0.8 * np.exp(1j * q1)
            + 0.35 * np.exp(1j * (q1 + q2))
            + 0.45 * np.exp(1j * (q1 + q2 + q3))
        )
        reference = path.sample(np.array([t])).y[0, :, 0]
        # the tolerance of a lower-order integrator, a tenth of what is promised
        assert np.hypot(tool.real - reference[0], tool.imag - reference[1]) < MICRON / 10


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.1, 0.01])
def test_fast_moves_of_light_machines(factor: float) -> None:
    """An arm with time scaled by a factor: stiffness and gravity by factor^-2, damping by
    factor^-1.
    """
    changes: dict[str, object] = {
        "gravity": [0.0, -9.81 / factor**2, 0.0],
        "move.line.duration": 0.5 * factor,
        "element.arm3.dof.q3.spring.stiffness": 1.5e5 / factor**2,
        "element.arm3.dof.q3.damping": 150.0 / factor,
    }
    for element, joint, stiffness, damping in (
        ("arm1", "q1", 4e5, 400.0),
        ("arm2", "q2", 2.5e5, 250.0),
    ):
        changes[f"element.{element}.dof.{joint}.gear.spring.stiffness"] = stiffness / factor**2
        changes[f"element.{element}.dof.{joint}.gear.damping"] = damping / factor
    for motor in ("m1", "m2"):
        changes[f"motor.{motor}.friction.viscous"] = 20e-4 / factor
    solution = flexgen.solve(read("planar5_nmp", overrides=changes))
    slow = flexgen.solve("planar5_nmp", verify=False)
    assert errors_on_path(solution)[0] < RIGHT
    largest = [np.abs(s.trajectory["tau_m"]).max() for s in (solution, slow)]
    assert largest[0] * factor**2 == pytest.approx(largest[1], rel=1e-4)


def test_the_accuracy_of_small_arms_is_relative_to_their_size() -> None:
    assert reach(flexgen.derive("planar5_nmp")) == pytest.approx(1.6, rel=1e-3)
    assert reach(flexgen.derive("four_mass")) == 1.0
    small = {
        "element.arm2.origin.position": [8e-4, 0, 0],
        "element.arm3.origin.position": [3.5e-4, 0, 0],
    }
    small["tool.position"] = [4.5e-4, 0, 0]
    assert reach(flexgen.derive(read("planar5_nmp", overrides=small))) == pytest.approx(
        1.6e-3, rel=1e-3
    )


@pytest.mark.parametrize(
    ("name", "method"),
    [pytest.param("planar5_nmp", "lq", marks=pytest.mark.slow), ("elbow", "closed-form")],
)
def test_coupled_motors(name: str, method: str) -> None:
    solution = flexgen.solve(read(name, overrides=COUPLED))
    assert solution.method == method and solution.status == Status.SOLVED
    assert (solution.tool_error_max_m or 1) < RIGHT
    # both motors carry the first joint now: the torques are others than without the coupling
    alone = flexgen.solve(name, verify=False)
    assert np.abs(solution.trajectory["tau_m"] - alone.trajectory["tau_m"]).max() > 0.1


@pytest.mark.parametrize(
    ("move", "message"),
    [
        (Move("x", "toolline", (0.3, -1.1), 0.5, 5), "given type 'toolline'"),
        (
            Move("x", "tool_line", (0.3,), 0.5, 5, displacement=(0.1, 0.0, 0.0)),
            "expected 2 finite numbers",
        ),
        (Move("x", "tool_line", (0.3, -1.1), 0.5, 5), "given displacement"),
        (Move("x", "joint", (0.3, -1.1), 0.5, 5, end=(float("inf"), 0.0)), "given end"),
    ],
)
def test_wrong_moves_are_refused(move: Move, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        flexgen.solve("planar5_mp", move)
