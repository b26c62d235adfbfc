"""`growth` in C against simulated motions with a perturbed start, and against the figure of `solve`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from emitted import loaded
from scipy.linalg import expm
from toolchain import needs_compiler

from flexgen.errors import ArgumentError
from flexgen.inversion.problem import HELD
from flexgen.inversion.reduced_problem import Reduction
from flexgen.inversion.sampling import samples
from flexgen.library.generate import generate
from flexgen.mechanics.equations import derive
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.runtime.library import Library, load
from flexgen.runtime.path_inversion import Inversion
from flexgen.simulation.growth import Motion, growth_along, linearize_along

pytestmark = needs_compiler

PERIOD, REACH = 5e-4, 1e-6  # s; size of a perturbation
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
    """Largest growth of differences of motions from neighboring starts, by Runge-Kutta steps of two samples."""
    n_a, n = motion.q_a.shape[1], len(side)
    x = np.tile(np.r_[motion.q_a[0], motion.q_m[0], motion.v_a[0], motion.v_m[0]], (n + 1, 1))
    x[1:, :n] += REACH * np.diag(side)

    def rate(x: np.ndarray, tau_m: np.ndarray) -> np.ndarray:
        q_a, q_m, v_a, v_m = np.split(x, [n_a, n, n + n_a], axis=1)
        torques = np.tile(tau_m, (n + 1, 1))
        return np.hstack([v_a, v_m, *library.forward_dynamics(q_a, v_a, q_m, v_m, torques)])

    largest, h = 1.0, 2 * PERIOD
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
    library, count = loaded("elbow"), 201
    q_a, q_m = np.array([1.5, 0.1]), np.zeros(2)
    A, _ = library.linearize(q_a, 0 * q_a, q_m, 0 * q_m, 0 * q_m)
    scale, n = np.tile(sides(read("elbow")), 2), A.shape[0] // 2
    step, product, expected = expm(A / scale[:, None] * scale * 1e-2), np.eye(2 * n), 1.0
    for _ in range(100):
        product = step @ product
        expected = max(expected, float(np.linalg.norm(product[:n, :n], 2)))
    q, m, zero = np.tile(q_a, (count, 1)), np.tile(q_m, (count, 1)), np.zeros((count, 2))
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
    inverter, given = library.invert, at_rest(library)
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
        k: np.pad(x, ((0, 500), (0, 0)), "edge") for k, x in vars(motion).items() if np.ndim(x) == 2
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
    along = linearize_along(equations, Motion(m.t, m.q_a, m.v_a, m.a_a, m.q_m, m.v_m, a_m, m.tau_m))
    whole = growth_along(along, HELD).movement
    assert whole > 1e8 and library.growth(motion) == pytest.approx(whole, rel=0.1)
