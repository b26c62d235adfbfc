"""Damped gears: after the path their deflections decay with D / K, and the torques last until
then.

The reference shares no code with flexgen: the two masses of one axis of a gantry under the torque
as a spline.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from selection import ROOT
from toolchain import needs_compiler

import flexgen
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.problem import problem as problems
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.studies.sweeps.closed_form_batch import JointMoves

GANTRY = ROOT / "tests" / "support" / "robots" / "gantry.toml"
LAG = 600.0 / 9e5  # s: D / K of its belt
STROKE = 0.4  # m
HELD = 0.5  # s


def with_damping(model: RobotModel, factor: float) -> RobotModel:
    """All gears with their damping multiplied."""
    elements = []
    for element in model.elements:
        dofs = []
        for dof in element.dofs:
            gear = dof.gear
            if gear is not None and not gear.rigid:
                gear = dataclasses.replace(gear, damping=factor * gear.damping)
            dofs.append(dataclasses.replace(dof, gear=gear))
        elements.append(dataclasses.replace(element, dofs=tuple(dofs)))
    return dataclasses.replace(model, elements=tuple(elements))


def error_at_the_end(solution: flexgen.Solution) -> float:
    """Largest distance of the carriage of the gantry from its goal in the half second after the
    last sample [m].
    """
    t = solution.trajectory.time
    torque = solution.trajectory["tau_m"][:, 0]
    curve = CubicSpline(t, torque)
    mass = 18.0
    rotor = 0.002
    ratio = 50.0

    def rate(now: float, x: np.ndarray) -> np.ndarray:
        belt = 9e5 * (x[1] / ratio - x[0]) + 600.0 * (x[3] / ratio - x[2])
        given = curve(now) if now < t[-1] else torque[-1]
        return np.array([x[2], x[3], belt / mass, (given - belt / ratio) / rotor])

    x = np.zeros(4)
    worst = 0.0
    for begin, end in ((t[0], t[-1]), (t[-1], t[-1] + HELD)):
        found = solve_ivp(
            rate, (begin, end), x, "DOP853", np.linspace(begin, end, 50), rtol=1e-12, atol=1e-13
        )
        x = found.y[:, -1]
        worst = float(np.abs(found.y[0] - STROKE).max())
    return worst


@pytest.mark.parametrize(
    "method", ["closed-form", pytest.param("lq", marks=[needs_compiler, pytest.mark.slow]), "auto"]
)
@pytest.mark.parametrize("move", ["fast", "four_bounds"])
def test_a_gantry_stops_where_it_should(method: str, move: str) -> None:
    """95 and 11 mm off when the torques ended with the path."""
    solution = flexgen.solve(read(GANTRY), move, method)
    trajectory = solution.trajectory
    assert solution.status is flexgen.Status.SOLVED and solution.tool_error_max_m < 5e-8
    assert error_at_the_end(solution) < 6e-8
    assert trajectory.time[-1] > solution.move.duration + 14 * LAG
    assert not trajectory["tau_m"][-1].any() and not trajectory["v_m"][-1].any()
    if method != "lq":
        assert solution.method == "closed-form" and "attempts" not in solution.details


def test_a_gear_that_decays_slowly_is_warned_of() -> None:
    """D / K of 0.33 s: after five seconds 3e-7 of the deflection are left."""
    model = with_damping(read(GANTRY), 500.0)
    solution = flexgen.solve(model, "fast", "closed-form", verify=False)
    assert len(solution.warnings) == 1 and "D/K = 0.333 s" in solution.warnings[0]
    assert not flexgen.solve(
        with_damping(model, 0.1), "fast", "closed-form", verify=False
    ).warnings


@pytest.mark.slow
@needs_compiler
def test_arms_with_slow_gears_end_at_rest_by_lq() -> None:
    """The passive joint has settled long before the gears, whose deflections decay with 24 ms."""
    model = with_damping(read("planar5_nmp"), 60.0)
    lag = float(problems.gear_lag_times(derive(model)).max())
    solution = flexgen.solve(model, "line", "lq")
    assert 0.02 < lag < 0.1 and solution.trajectory.time[-1] > solution.move.duration + 14 * lag
    assert solution.status is flexgen.Status.SOLVED and (solution.tool_error_max_m or 1.0) < 5e-8


def test_sweeps_have_the_same_samples_after_the_path() -> None:
    equations = derive(GANTRY)
    mover = JointMoves(equations, TimeLaw(0.08, 5))
    one = flexgen.solve(equations, "fast", "closed-form", verify=False).trajectory
    torque = mover.torques(np.zeros((1, 1)), np.full((1, 1), STROKE))[0]
    assert one.time == pytest.approx(mover.t, abs=1e-15) and mover.t[-1] > 0.08 + 14 * LAG
    assert np.abs(torque - one["tau_m"]).max() < 1e-9 * np.abs(torque).max()
    assert np.abs(torque[mover.t > 0.08]).max() > 1e-3  # N m: it is not over with the path


def sampled(equations: Equations, period: float) -> dict:
    """Arguments of the C along the move ``fast``."""
    path = Path(equations, equations.model.move("fast"))
    y, dy, ddy = samples(Reduction(equations), path, period, round(path.duration / period) + 1)
    return {"y": y, "dy": dy, "ddy": ddy, "period": period, "q_start": path.q_start}


@pytest.mark.slow
@needs_compiler
def test_the_c_ends_where_the_gears_have_settled() -> None:
    equations = derive(with_damping(read(GANTRY), 10.0))  # D / K of 6.7 ms
    given = sampled(equations, 2e-4)
    n = 401
    library = inversion_library(equations, "lq")
    whole = library.invert(**given, n_pre=20, n_post=2000)
    found = library.invert(**given, n_pre=20, n_post=2000, settled=1e-8)
    rows = 20 + n + found.n_post
    assert whole.n_post == 2000 and found.n_post == pytest.approx(
        problems.LAGS * 10 * LAG / 2e-4, abs=1.0
    )
    assert (found.tau_m[: rows - 1] == whole.tau_m[: rows - 1]).all() and not found.tau_m[-1].any()
    written = found.tau_m.base
    assert written is not None and len(written) == 20 + n + 2000 and not written[rows:].any()
    # N m: what is left out; 4 at the end of the path
    assert np.abs(whole.tau_m[rows]).max() < 1e-6
    assert np.abs(whole.tau_m[20 + n]).max() > 1.0
    short = library.invert(**given, n_pre=20, n_post=100, settled=1e-8)
    assert short.n_post == 100 and (short.tau_m == whole.tau_m[: 20 + n + 100]).all()
