"""`growth` in C against simulated motions with a perturbed start, and against the figure of
`solve`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from emitted import loaded
from scipy.linalg import expm
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.generate import generate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.problem.problem import HELD
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.model.reader import read
from flexgen.paths.force.process_force import make_force
from flexgen.paths.path import Path
from flexgen.runtime.inversion.path_inversion import Inversion
from flexgen.runtime.library import Library, load
from flexgen.simulation.verification.growth import Motion, growth_along, linearize_along

pytestmark = needs_compiler

PERIOD = 5e-4  # s
REACH = 1e-6  # size of a perturbation
UPRIGHT = FilePath(__file__).parents[1] / "support" / "robots" / "upright.toml"


def inverted(library: Library, model: Any) -> tuple[Any, Inversion]:
    """The equations, and the motion of the first move of a model."""
    equations = derive(model)
    path = Path(equations, equations.model.moves[0])
    n = round(path.duration / PERIOD) + 1
    y, dy, ddy = samples(Reduction(equations), path, PERIOD, n)
    options = {"n_pre": 60, "n_post": 200, "samples_per_interval": 10}
    return equations, library.invert(y, dy, ddy, period=PERIOD, q_start=path.q_start, **options)


def first_part(motion: Inversion, n: int) -> Inversion:
    """The first n samples of a motion."""
    return replace(motion, **{key: x[:n] for key, x in vars(motion).items() if np.ndim(x) == 2})


def moving_part(motion: Inversion, held: float) -> Inversion:
    """The motion until it is at rest, and ``held`` [s] with its last sample."""
    speed = np.abs(motion.v_a).max(axis=1)
    n = int(np.flatnonzero(speed > 1e-4 * speed.max())[-1]) + 1
    more = ((0, round(held / PERIOD)), (0, 0))
    arrays = {
        key: np.pad(x[:n], more, "edge") for key, x in vars(motion).items() if np.ndim(x) == 2
    }
    return replace(motion, **arrays)


def simulated_growth(library: Library, motion: Inversion, side: np.ndarray) -> float:
    """Largest growth of differences of motions from neighboring starts, by Runge-Kutta steps of
    two samples.
    """
    n_a = motion.q_a.shape[1]
    n = len(side)
    x = np.tile(np.r_[motion.q_a[0], motion.q_m[0], motion.v_a[0], motion.v_m[0]], (n + 1, 1))
    x[1:, :n] += REACH * np.diag(side)

    def rate(x: np.ndarray, tau_m: np.ndarray) -> np.ndarray:
        q_a, q_m, v_a, v_m = np.split(x, [n_a, n, n + n_a], axis=1)
        torques = np.tile(tau_m, (n + 1, 1))
        return np.hstack([v_a, v_m, *library.forward_dynamics(q_a, v_a, q_m, v_m, torques)])

    largest = 1.0
    h = 2 * PERIOD
    for k in range(0, len(motion.tau_m) - 2, 2):
        first, middle, last = motion.tau_m[k : k + 3]
        a = rate(x, first)
        b = rate(x + h / 2 * a, middle)
        c = rate(x + h / 2 * b, middle)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, last))
        if k % 20 == 18:
            grown = (x[1:, :n] - x[0, :n]) / side / REACH
            largest = max(largest, float(np.linalg.norm(grown, 2)))
    return largest


def sides(model: Any) -> np.ndarray:
    """Of each position of a state: from the arm side to its own."""
    return np.r_[np.ones(model.n_a), [max(motor.ratio) for motor in model.motors]]


def test_growth_at_a_constant_state_is_that_of_the_matrix_exponential() -> None:
    library = loaded("elbow")
    count = 201
    q_a = np.array([1.5, 0.1])
    q_m = np.zeros(2)
    A, _ = library.linearize(q_a, 0 * q_a, q_m, 0 * q_m, 0 * q_m)
    scale = np.tile(sides(read("elbow")), 2)
    n = A.shape[0] // 2
    step = expm(A / scale[:, None] * scale * 1e-2)
    product = np.eye(2 * n)
    expected = 1.0
    for _ in range(100):
        product = step @ product
        expected = max(expected, float(np.linalg.norm(product[:n, :n], 2)))
    q = np.tile(q_a, (count, 1))
    m = np.tile(q_m, (count, 1))
    zero = np.zeros((count, 2))
    motion = Inversion(
        q, zero, zero, zero, m, zero, zero, 0, 0, 1.0 / (count - 1), 0.0, 0.0, 0.0, 0, 0, True
    )
    assert expected > 2 and library.growth(motion) == pytest.approx(expected, rel=1e-2)
    for word, changed in (("motion", q), ("tau_m", replace(motion, tau_m=zero[1:]))):
        with pytest.raises(ArgumentError, match=word):
            library.growth(changed)
    with pytest.raises(ArgumentError, match="not finite"):
        library.growth(replace(motion, q_a=np.nan * q))
    assert library.growth(replace(motion, a_a=zero[:0])) == library.growth(motion)
    library.close()
    with pytest.raises(ArgumentError, match="closed"):
        library.growth(motion)


def at_rest(library: Library) -> dict[str, Any]:
    """Arguments of `invert` for an elbow that stays where it is."""
    y = np.tile(library.forward_kinematics(np.array([0.4, 0.2]))[0][::2], (21, 1))
    zero = np.zeros((21, library.sizes["n_y"]))
    return {
        "y": y,
        "dy": zero,
        "ddy": zero,
        "period": 1e-3,
        "q_start": np.array([0.4, 0.2]),
        "n_post": 100,
    }


def test_invert_reports_the_growth_where_it_is_asked_for() -> None:
    library = loaded("elbow")
    given = at_rest(library)
    motion = library.invert(**given, growth=True)
    assert motion.growth == library.growth(motion) > 1.01
    limited = library.invert_limited(**given, growth=True, torque_max=np.full(2, 1e4))
    assert limited.growth == pytest.approx(motion.growth, rel=1e-9) and not limited.limits_active
    assert np.isnan(library.invert(**given).growth) and np.isnan(
        library.invert_limited(**given).growth
    )
    ended = library.invert(**given, growth=True, settled=0.5)
    assert len(ended.q_a) < len(motion.q_a) and ended.growth == library.growth(ended)
    with pytest.raises(ArgumentError, match="growth: given 1, expected True or False"):
        library.invert(**given, growth=1)


def test_growth_without_arrays_for_the_motion_is_refused_before_anything_is_solved(
    monkeypatch: Any,
) -> None:
    library = loaded("elbow")
    inverter = library.invert
    given = at_rest(library)
    whole = inverter._results
    for missing in ("q_a", "v_a", "q_m", "v_m", "tau_m"):
        fewer = {missing: None}
        monkeypatch.setattr(inverter, "_results", lambda total, fewer=fewer: whole(total) | fewer)
        with pytest.raises(ArgumentError, match="null pointer"):
            inverter(**given, growth=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["elbow", "planar5_nmp"])
def test_growth_of_a_move_is_that_of_a_simulation_with_perturbed_start(name: str) -> None:
    library = loaded(name)
    equations, motion = inverted(library, name)
    found = library.growth(motion)
    assert found > 1.2
    whole = moving_part(motion, HELD)
    assert found == pytest.approx(
        simulated_growth(library, whole, sides(equations.model)), rel=0.02
    )
    # samples at rest after the movement do not count
    longer = {
        k: np.pad(x, ((0, 500), (0, 0)), "edge")
        for k, x in vars(motion).items()
        if np.ndim(x) == 2
    }
    assert library.growth(replace(motion, **longer)) == pytest.approx(found, rel=1e-3)


@pytest.mark.slow
def test_growth_of_an_upright_arm_is_that_of_a_simulation_and_of_solve(tmp_path: FilePath) -> None:
    library = load(generate(UPRIGHT, tmp_path / "upright").directory)
    equations, motion = inverted(library, UPRIGHT)
    short = first_part(motion, 1201)
    expected = simulated_growth(library, short, sides(equations.model))
    assert 10 < expected < 1e4 and library.growth(short) == pytest.approx(expected, rel=0.05)
    a_m = np.gradient(motion.v_m, motion.t, axis=0)
    m = motion
    along = linearize_along(
        equations, Motion(m.t, m.q_a, m.v_a, m.a_a, m.q_m, m.v_m, a_m, m.tau_m)
    )
    whole = growth_along(along, HELD).movement
    assert whole > 1e8 and library.growth(motion) == pytest.approx(whole, rel=0.1)


# --- under a force on the tool ----------------------------------------------------------------

SMALL = 1e-5  # rad, m, rad/s, m/s: central differences, error some 1e-8 of accelerations


def expected_growth(library: Library, model: Any, state: Any, f_tool: np.ndarray) -> float:
    """Of a constant state for one second, by central differences of the forward dynamics."""
    q_a, q_m, tau_m = state
    n_a = model.n_a
    n = model.dof
    i_m = list(model.i_m)

    def accelerations(x: np.ndarray) -> np.ndarray:
        motors = q_m.copy()
        speeds = 0.0 * q_m
        motors[i_m] = x[n_a:n]
        speeds[i_m] = x[n + n_a :]
        a_a, a_m, _ = library.forward_dynamics_tool_force(
            x[:n_a], x[n : n + n_a], motors, speeds, tau_m, f_tool
        )
        return np.r_[a_a, a_m[i_m]]

    side = np.ones(n)
    side[n_a:] = np.abs(model.eta).max(axis=1)[i_m]
    scale = np.tile(side, 2)
    at = np.r_[q_a, q_m[i_m], np.zeros(n)]
    A = np.eye(2 * n, k=n)
    for k, x in enumerate(np.diag(SMALL * scale)):
        change = (accelerations(at + x) - accelerations(at - x)) / (2 * SMALL)
        A[n:, k] = change / side
    step = expm(A * 1e-2)
    product = np.eye(2 * n)
    found = 1.0
    for _ in range(100):
        product = step @ product
        found = max(found, float(np.linalg.norm(product[:n, :n], 2)))
    return found


def still(state: Any, count: int = 201) -> Inversion:
    """The motion that stays in a state for one second."""
    q_a, q_m, tau_m = (np.tile(x, (count, 1)) for x in state)
    zero = 0.0 * q_a
    none = 0.0 * q_m
    period = 1.0 / (count - 1)
    return Inversion(
        q_a, zero, zero, none, q_m, none, tau_m, 0, 0, period, 0.0, 0.0, 0.0, 0, 0, True
    )


@pytest.mark.parametrize(
    "name, variant, force",
    [
        ("elbow", None, [-30000.0, 0.0, 8000.0, 0.0, 0.0, 0.0]),
        ("elbow", "rigid", [-30000.0, 0.0, 8000.0, 0.0, 0.0, 0.0]),
        pytest.param(
            "kr300_efjm",
            None,
            [-900.0, 600.0, -1800.0, 2700.0, -2400.0, 2100.0],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_growth_under_a_force_is_that_of_differences_of_the_forward_dynamics(
    name: str, variant: str | None, force: list[float], tmp_path: FilePath
) -> None:
    model = read(name, variant)
    f_tool = np.array(force)
    library = load(generate(model, tmp_path / "made", parts=("force",)).directory)
    q_a = np.zeros(model.n_a)
    i_g = list(model.i_g)
    q_a[i_g] = np.linspace(0.3, 0.8, len(i_g))
    q_m = model.eta @ q_a[i_g]
    state = q_a, q_m, np.linspace(1.0, 2.0, model.n_m)
    own = f_tool if model.output.type == "tool_pose" else f_tool[list(model.output.tool_rows)]
    path = np.zeros((1, 3 * len(own)))
    path[0, : len(own)] = own
    motion = still(state)
    expected = expected_growth(library, model, state, f_tool)
    assert library.growth(motion, force=path) == pytest.approx(expected, rel=1e-2)
    # planted: none, of the other direction, and of a pose without the moments
    plain = library.growth(motion)
    fewer = np.where(np.arange(path.shape[1]) < 3, path, 0.0)
    wrong = [plain, library.growth(motion, force=-path)]
    wrong += [library.growth(motion, force=fewer)] if len(own) > 3 else []
    assert all(abs(other - expected) > 0.05 * expected for other in wrong), (expected, wrong)


def forced_motion(
    library: Library, name: str, move: str | None, force: list[float]
) -> tuple[Any, Any, np.ndarray, Inversion]:
    """The equations, the force in time and at the samples of a move, and the motion under it."""
    equations = derive(read(name))
    model = equations.model
    named = [m for m in model.moves if move is None or m.name == move]
    path = Path(equations, named[0])
    period = 2e-3
    n = round(path.duration / period) + 1
    process = make_force(lambda t: np.tile(force, (len(t), 1)), model, path.duration)
    F = process.on_output(model, np.arange(n) * period)
    y, dy, ddy = samples(Reduction(equations), path, period, n)
    options = {"n_pre": 100, "n_post": 200, "force": F, "growth": True}
    motion = library.invert(y, dy, ddy, period=period, q_start=path.q_start, **options)
    return equations, process, F, motion


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, move, force",
    [
        ("planar5_nmp", "joints", [-2000.0, 0.0, 0.0]),
        ("manutec_r3_18", None, [200.0, -300.0, 400.0, 150.0, -180.0, 160.0]),
    ],
)
def test_growth_along_a_move_under_a_force_is_that_of_the_simulation(
    name: str, move: str | None, force: list[float]
) -> None:
    library = loaded(name, "force")
    equations, process, F, m = forced_motion(library, name, move, force)
    a_m = np.gradient(m.v_m, m.t, axis=0)
    given = Motion(m.t, m.q_a, m.v_a, m.a_a, m.q_m, m.v_m, a_m, m.tau_m, process.at(m.t)[:, :6])
    expected = growth_along(linearize_along(equations, given), HELD).movement
    assert m.growth == library.growth(m, force=F) == pytest.approx(expected, rel=1e-2)
    # planted: without the force, and with that of the other sign
    assert abs(library.growth(m) - expected) > 0.3 * expected
    assert abs(library.growth(m, force=-F) - expected) > 0.3 * expected


def test_a_force_that_growth_cannot_take_is_refused() -> None:
    library = loaded("elbow", "force")
    plain = loaded("elbow")
    motion = still((np.array([1.5, 0.1]), np.zeros(2), np.zeros(2)))
    with pytest.raises(ArgumentError, match="growth, force: given to a library without forces"):
        plain.growth(motion, force=np.zeros((201, 6)))
    for wrong in (np.zeros((201, 2)), np.zeros(6), np.zeros((0, 6)), np.zeros((202, 6))):
        with pytest.raises(
            ArgumentError, match=r"growth, force: given shape .* expected \(n, 6\)"
        ):
            library.growth(motion, force=wrong)
    with pytest.raises(ArgumentError, match="not finite"):
        library.growth(motion, force=np.full((201, 6), np.inf))
    # the force before the path and after it is that of its ends
    one = library.growth(motion, force=np.full((1, 6), 9.0))
    assert one == library.growth(motion, force=np.full((150, 6), 9.0))
    assert one == library.growth(replace(motion, n_pre=50), force=np.full((100, 6), 9.0))
    # no force has the bits of none, and those of a library without forces
    none = library.growth(motion)
    assert none == library.growth(motion, force=np.zeros((201, 6))) == plain.growth(motion)
