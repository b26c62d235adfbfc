"""Reversals of motors with steep friction: samples, true errors, reasons, and checks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from claimed_error import claims_within, false_claims, simulated_error
from selection import ROOT

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.parameters import select
from flexgen.inversion import refinement
from flexgen.inversion.choice import is_worth_a_search
from flexgen.inversion.judge.reversals import unresolved_friction
from flexgen.inversion.methods.method_table import methods
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.elements import RobotModel
from flexgen.model.friction import Friction, GearFriction, memory_laws, steepness
from flexgen.paths.path import Path as MovePath

ROBOTS = ROOT / "tests" / "support" / "robots"
STEEP = Friction(viscous=1e-3, coulomb=0.3, beta=50.0)


# a line past the base, on which both motors of the elbow reverse
PASSING = flexgen.Move(
    "pass", "tool_line", (0.5, -1.2), 0.8, 5, displacement=(0.8115538, 0.0, -1.3876623)
)


def with_friction(name: str, friction: Friction) -> Equations:
    model = flexgen.read(name)
    motors = tuple(replace(motor, friction=friction) for motor in model.motors)
    return derive(replace(model, motors=motors))


@pytest.fixture(scope="module")
def steep() -> Equations:
    return with_friction("elbow", STEEP)


@pytest.fixture(scope="module")
def solution(steep: Equations) -> flexgen.Solution:
    return flexgen.solve(steep, PASSING, ignore_limits=True)


def test_a_reversal_within_microseconds_is_solved_and_its_error_is_true(
    solution: flexgen.Solution,
) -> None:
    steps = np.diff(solution.trajectory.time)
    assert solution.status == "solved" and solution.method == "closed-form"
    assert solution.residual_relative < 1e-3 and "attempts" not in solution.details
    # around the reversals only
    assert steps.min() < 0.1 * steps.max() and len(steps) < 1200
    assert false_claims(solution) == []


def test_without_its_samples_the_torque_has_the_step_at_another_instant(
    solution: flexgen.Solution, steep: Equations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the samples at equal steps alone, of which a saved file would have the spline."""
    monkeypatch.setattr("flexgen.inversion.judge.reversals.with_reversals", lambda *_: None)
    coarse = flexgen.solve(steep, PASSING, ignore_limits=True, method="closed-form")
    assert np.ptp(np.diff(coarse.trajectory.time)) < 1e-9
    assert coarse.residual_relative > 1e-3
    # and the simulation that shares no code sees it
    assert simulated_error(coarse) > 30 * simulated_error(solution)


def test_the_torque_holds_the_equations_of_the_motors_at_all_samples(
    solution: flexgen.Solution, steep: Equations
) -> None:
    """By hand: inertia, friction and the gear with linear spring and damper of each motor."""
    data = solution.trajectory
    v = data["v_m"]
    a = data["a_m"]
    q = data["q_m"]
    for j, motor in enumerate(steep.model.motors):
        friction = 1e-3 * v[:, j] + 0.3 * np.tanh(50.0 * v[:, j])
        dof = steep.model.coordinates[j].dof
        assert dof is not None and dof.gear is not None and dof.gear.side == "arm"
        twist = q[:, j] / motor.ratio[0] - data["q_a"][:, j]
        rate = v[:, j] / motor.ratio[0] - data["v_a"][:, j]
        pull = (dof.gear.spring.stiffness * twist + dof.gear.damping * rate) / motor.ratio[0]
        missing = motor.inertia * a[:, j] + friction + pull - data["tau_m"][:, j]
        # far below the step of 0.6 N m
        assert np.abs(missing).max() < 1e-6 * np.abs(data["tau_m"][:, j]).max()


@pytest.mark.slow
@pytest.mark.parametrize("beta", [1.0, 7.0, 50.0])
def test_arms_with_steep_friction_are_solved_in_seconds(beta: float, tmp_path: Path) -> None:
    """Drawn arms; benchmarks/reversals has thirty of them with ten moves each."""
    from arms_with_friction import arm, moves_of

    for number in (0, 1):
        model = arm(number, str(tmp_path))
        motors = tuple(
            replace(motor, friction=replace(motor.friction, beta=beta)) for motor in model.motors
        )
        equations = derive(replace(model, motors=motors))
        for move in moves_of(equations, number)[:3]:
            found = flexgen.solve(equations, move, ignore_limits=True)
            assert found.status == "solved" and found.method == "closed-form"
            assert found.cpu_s < 10.0 and claims_within(found, 60) in ([], None)


def test_robots_without_steep_friction_keep_their_samples() -> None:
    for friction in (Friction(), replace(STEEP, beta=0.1)):
        equations = with_friction("elbow", friction)
        found = flexgen.solve(equations, PASSING, ignore_limits=True)
        assert np.ptp(np.diff(found.trajectory.time)) < 1e-9


# --- searches and reasons ------------------------------------------------------------------------


def test_a_search_of_minutes_needs_something_to_gain(steep: Equations) -> None:
    problem = InversionProblem(steep, MovePath(steep, PASSING))
    known = methods()
    for name in ("lq", "bvp"):
        assert is_worth_a_search(problem, known[name], 1.0)
    for name in ("full", "collocation"):
        # without any motion everything is tried
        assert is_worth_a_search(problem, known[name], np.inf)
        assert not is_worth_a_search(problem, known[name], 1.05e-5)
    bending = derive("planar5_nmp")
    other = InversionProblem(bending, MovePath(bending, bending.model.moves[0]))
    assert not is_worth_a_search(other, known["full"], 1.05e-5)
    assert is_worth_a_search(other, known["full"], 1.0)


def test_the_reason_names_the_friction_that_no_mesh_resolves(
    steep: Equations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: no samples are added, and a result is accepted by its residual only."""
    monkeypatch.setattr("flexgen.inversion.judge.reversals.with_reversals", lambda *_: None)
    problem = InversionProblem(steep, MovePath(steep, PASSING))
    found = refinement.make_solution(
        problem, "closed-form", refinement.run_method(methods()["closed-form"], problem, 0.0)
    )
    reason = unresolved_friction(steep, found.trajectory)
    assert "the friction of motor m" in reason and "(beta = 50)" in reason
    smooth = derive("elbow")
    plain = flexgen.solve(smooth, PASSING, ignore_limits=True)
    assert unresolved_friction(smooth, plain.trajectory) == ""


def test_a_friction_that_no_integrator_follows_is_refused_at_once_with_its_beta() -> None:
    equations = with_friction("elbow", replace(STEEP, beta=2e8))
    with pytest.raises(SolverError, match=r"the friction of motor m\d slows it down .* beta"):
        flexgen.solve(equations, method="closed-form", time_limit=60.0)
    rows = [row for row in flexgen.check(equations).errors if row.key.endswith("friction.beta")]
    assert {row.key for row in rows} >= {"motor.m1.friction.beta"}


def test_very_stiff_gears_without_damping_are_solved_or_named() -> None:
    def stiff(stiffness: float) -> RobotModel:
        change = {
            f"element.{element}.dof.{joint}.gear": {
                "type": "elastic",
                "side": "arm",
                "spring": {"type": "linear", "stiffness": stiffness},
            }
            for element, joint in (("upper", "q1"), ("fore", "q2"))
        }
        return flexgen.read("elbow", overrides=change)

    solved = flexgen.solve(stiff(1e9), method="closed-form", time_limit=60.0)
    assert solved.status == "solved" and solved.cpu_s < 20.0
    with pytest.raises(SolverError, match=r"the fastest mode oscillates at \S+ Hz"):
        flexgen.solve(stiff(1e12), method="closed-form", time_limit=60.0)


def test_check_compares_the_friction_with_the_change_of_speed_in_a_sample(
    steep: Equations,
) -> None:
    model = replace(steep.model, moves=(PASSING,))
    rows = [row for row in flexgen.check(model).findings if "at a reversal" in row.quantity]
    assert {row.mark for row in rows} == {"unusual"} and "s/rad" in rows[0].advice
    # the speeds of the motors by the joints: those of a gear without deflection
    mild = tuple(replace(motor, friction=replace(STEEP, beta=0.05)) for motor in model.motors)
    assert all(
        row.mark == "ok"
        for row in flexgen.check(replace(model, motors=mild)).findings
        if "at a reversal" in row.quantity
    )


# --- Coulomb friction without beta ---------------------------------------------------------------


def test_coulomb_friction_without_beta_is_an_error_everywhere(tmp_path: Path) -> None:
    for made in (
        lambda: Friction(coulomb=0.3),
        lambda: Friction(stribeck=0.3, beta=2.0),
        lambda: GearFriction(load_coulomb=0.1, beta=1.0),
        lambda: replace(STEEP, beta=0.0),
    ):
        with pytest.raises(ArgumentError, match="has no effect"):
            made()
    for change in (
        {"motor.m1.friction": {"coulomb": 0.3}},
        {"element.fore.dof.q2.friction": {"coulomb": 0.3}},
    ):
        with pytest.raises(flexgen.ModelError, match="beta"):
            flexgen.read("elbow", overrides=change)
    model = flexgen.read("elbow")
    with pytest.raises(ArgumentError, match=r"m1\.coulomb of a friction with beta = 0"):
        select(model, ["m1.coulomb"])
    assert [p.name for p in select(model, ["m1.coulomb", "m1.beta"])] == ["m1.coulomb", "m1.beta"]


def test_the_steepness_of_a_law_is_that_of_its_fastest_part() -> None:
    assert steepness(Friction(viscous=1.0, beta=5.0)) == 0.0
    assert steepness(STEEP) == 50.0
    assert steepness(Friction(stribeck=0.1, alpha=70.0, beta=5.0)) == 70.0


# --- frictions with a state ----------------------------------------------------------------------


def test_the_error_two_seconds_after_the_end_is_that_of_a_simulation_with_bristles() -> None:
    """Torques 0.1 % too large: the arm slides and sticks.

    The linearization is wrong by a factor of four.
    """
    from bristled import NUMBERS, bristled

    from flexgen.simulation.after_end import errors_after_end

    model = bristled("elbow", {"m1": NUMBERS, "m2": NUMBERS})
    data = flexgen.solve(model, method="closed-form").trajectory
    pushed = replace(data, channels={**data.channels, "tau_m": 1.001 * data["tau_m"]})
    near, far = (
        flexgen.simulate(model, pushed, held=held, feedback="none") for held in (0.5, 2.0)
    )
    assert near.later_error_max_m == pytest.approx(far.tool_error_max_m, rel=1e-3)
    assert memory_laws(model)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flexgen.simulation.after_end.simulate_after_end", errors_after_end)
        predicted = flexgen.simulate(model, pushed, held=0.5, feedback="none")
    assert predicted.later_error_max_m != pytest.approx(far.tool_error_max_m, rel=0.2)
