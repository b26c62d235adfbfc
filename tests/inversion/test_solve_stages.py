"""The parts of an inversion: collocation methods, gears and motors, residuals and the guards of
the verdict.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.tableaus import gauss, radau
from flexgen.dynamics.mechanics.statics import gear_deflection
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.collocation import collocate
from flexgen.inversion.problem.motor_side import deflections
from flexgen.inversion.problem.problem import InversionProblem, _graded_nodes
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.solution import residual_rows
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.simulation.simulate import simulate

RIGHT = 1e-8  # what the methods reach: a hundredth of it


def test_the_error_falls_with_the_order_of_the_method() -> None:
    equations = flexgen.derive("planar5_mp")
    path = Path(equations, equations.model.move("line"))
    reduction = Reduction(equations)

    def deflections(h: float, stages: int) -> np.ndarray:
        n = round(0.5 / h)
        found = collocate(reduction, path, np.linspace(0.0, 0.5, n + 1), stages=stages)
        return found.q_e[:: n // 10, 0]

    # the shortest mesh with three stages is the reference; 20 ms and 10 ms are in the asymptotic
    # range
    best = deflections(0.00125, 3)
    for stages, order in ((1, 2), (2, 4)):
        coarse, fine = (np.abs(deflections(h, stages) - best).max() for h in (0.01, 0.005))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.6)


@pytest.mark.parametrize("damping", [1.0, 1e-2, 1e-6])
def test_gears_with_next_to_no_damping(damping: float) -> None:
    solution = flexgen.solve(
        read("planar5_nmp", overrides={"element.arm1.dof.q1.gear.damping": damping})
    )
    assert (solution.tool_error_max_m or 1) < RIGHT


def test_flexible_joint_closed_form_against_the_textbook() -> None:
    """tau = J q_m'' + f + M a + c + g with q_m = q + K^-1 (M a + c + g), two undamped gears,
    derivatives by splines.
    """
    changes = {
        f"element.{e}.dof.{q}.gear.damping": 0.0 for e, q in (("upper", "q1"), ("fore", "q2"))
    }
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


@pytest.mark.slow
def test_drives_with_a_nonlinear_damped_gear_against_an_integrator() -> None:
    equations = flexgen.derive("four_mass")
    t = np.linspace(0, 0.2, 201)
    w = 2 * np.pi * 5
    amplitude = 3e4
    tau = amplitude * np.stack(
        [np.sin(w * t) ** 2, w * np.sin(2 * w * t), 2 * w**2 * np.cos(2 * w * t)], axis=-1
    )
    p, dp, ddp = deflections(equations, t, tau[:, None, :])
    spring = equations.function("gear_law")
    damping = 0.08 * 220**2
    exact = solve_ivp(
        lambda s, x: (
            (amplitude * np.sin(w * s) ** 2 - np.array(spring(x.reshape(1, -1))[0]).ravel())
            / damping
        ),
        (0, 0.2),
        [0.0],
        method="Radau",
        rtol=1e-10,
        atol=1e-14,
        t_eval=t,
    )
    # the spring's curvature jumps at its break, which costs the fixed steps of 1 ms some digits
    # there
    assert np.abs(p[:, 0] - exact.y[0]).max() < 1e-4 * np.abs(p).max()
    fine = make_interp_spline(t, exact.y[0], k=5)
    # from the break, where a spline through samples cannot follow
    away = np.abs(np.abs(p[:, 0]) - 0.064 / 220) > 1e-4
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
    back = evaluate(equations.function("gear_law"), gear_deflection(equations, tau))[0]
    assert np.abs(back - tau).max() < 1e-9 * 3000


@pytest.mark.parametrize("stages", [1, 2, 3, 4, 5])
def test_tableaus_keep_their_order_conditions(stages: int) -> None:
    assert gauss(stages).order == 2 * stages and radau(stages).order == 2 * stages - 1
    with pytest.raises(AssertionError, match="order condition"):
        dataclasses.replace(gauss(stages), b=gauss(stages).b * 1.001)


def test_the_residual_rejects_a_wrong_solution() -> None:
    equations = flexgen.derive("planar5_mp")
    trajectory = flexgen.solve(equations, verify=False).trajectory
    wrong = dict(trajectory.channels, tau_m=trajectory["tau_m"] + 0.1)
    assert residual_rows(equations, trajectory).max() < 1e-3
    assert residual_rows(
        equations, dataclasses.replace(trajectory, channels=wrong)
    ).max() == pytest.approx(0.1, rel=1e-2)


@pytest.mark.slow
def test_an_undamped_nonlinear_gear() -> None:
    cubic = {"type": "cubic", "stiffness": 4e5, "cubic": 2e10}
    changes = {"element.arm1.dof.q1.gear.spring": cubic, "element.arm1.dof.q1.gear.damping": 0.0}
    solution = flexgen.solve(read("planar5_mp", overrides=changes))
    assert (solution.tool_error_max_m or 1) < RIGHT


def test_guards_of_the_verdicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bugs: a simulation that loses energy, and an NLP that calls open constraints a
    success.
    """
    import flexgen.base.numerics.nlp as nlp
    import flexgen.inversion.judge.verification as solving

    def leaking(*arguments: object, **options: object) -> object:
        return dataclasses.replace(simulate(*arguments, **options), energy_error=1e-3)

    monkeypatch.setattr(solving, "simulate", leaking)
    assert (
        flexgen.solve("planar5_mp", method="collocation", mesh=0.005).status
        == Status.TOLERANCE_NOT_MET
    )
    monkeypatch.setattr(solving, "simulate", simulate)
    monkeypatch.setattr(nlp, "_violation", lambda *bounds: 1.0)
    with pytest.raises(SolverError, match="Solve_Succeeded"):
        flexgen.solve("planar5_mp", method="collocation", mesh=0.005)


@pytest.mark.parametrize(
    ("duration", "step"), [(4.0, 1e-3), (0.4, 1e-3), (0.2, 5e-4), (0.01, 2.5e-5)]
)
def test_a_torque_has_a_sample_each_millisecond_and_at_least_400(
    duration: float, step: float
) -> None:
    problem = SimpleNamespace(path=SimpleNamespace(duration=duration), harmonic_step=np.inf)
    assert InversionProblem.step.func(problem) == pytest.approx(step, rel=1e-12)  # type: ignore


@pytest.mark.parametrize(
    ("early", "longest", "shortest"), [(0.3, 0.02, 1e-3), (0.05, 0.02, 1e-4), (4e-4, 0.02, 1e-3)]
)
def test_nodes_before_the_path_become_closer_towards_it(
    early: float, longest: float, shortest: float
) -> None:
    nodes = _graded_nodes(early, longest, shortest)
    assert nodes is not None and nodes[0] == pytest.approx(-early) and nodes[-1] == 0.0
    steps = np.diff(nodes)[::-1]  # from the path on
    assert (
        steps[0] <= shortest * (1 + 1e-12)
        and steps.max() <= longest
        and np.all(np.diff(steps) >= -1e-12)
    )
    assert (
        _graded_nodes(early, longest, longest) is None
        and _graded_nodes(0.0, longest, shortest) is None
    )
