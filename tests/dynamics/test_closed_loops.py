"""Equations of robots with closed loops: equal to own equations in absolute coordinates with
multipliers.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.codegen.recursion.functions import fast_function
from flexgen.dynamics.mechanics import closed_loops, kinematics
from flexgen.model.format.closure import closed_values, closure, home_closure
from flexgen.model.inertia import mass_matrix
from tests.support.linkages import FOUR_BAR, drawn_text, home_of, read_text
from tests.support.multipliers import Multipliers

SPREAD = {"rad": 0.2, "m": 3e-3}


def worst_of(model: flexgen.RobotModel, count: int, spread: float = 1.0) -> float:
    """Largest relative difference of the accelerations at drawn states."""
    own = Multipliers(model)
    equations = flexgen.derive(model)
    forward = equations.function("forward_dynamics")
    rng = np.random.default_rng(7)
    home = home_of(model)
    scale = np.array([SPREAD[c.unit] * (1.0 if c.actuated else 0.1) for c in model.coordinates])
    worst = 0.0
    for _ in range(count):
        q = home + spread * scale * rng.uniform(-1.0, 1.0, model.n_a)
        v = rng.uniform(-2.0, 2.0, model.n_a) * scale / scale.max()
        near = closed_values(model, q)
        at = own.close(q, np.array([near[name] for name in own.passive]) + 1e-3)
        q_m = model.eta @ q[list(model.i_g)] + rng.uniform(-0.1, 0.1, model.n_m)
        v_m = model.eta @ v[list(model.i_g)] + rng.uniform(-1.0, 1.0, model.n_m)
        tau = rng.uniform(-5.0, 5.0, model.n_m)
        expected = own.motion(at, v, q_m, v_m, tau)
        found = [np.array(x).ravel() for x in forward(q, v, q_m, v_m, tau)]
        for a, b in zip(found, expected, strict=True):
            worst = max(worst, float(np.abs(a - b).max() / np.abs(b).max()))
    return worst


def test_four_bar_accelerations_are_those_of_multipliers(tmp_path: Path) -> None:
    """100 random states, asked 1e-9."""
    assert worst_of(read_text(tmp_path, FOUR_BAR), 100, 2.0) < 1e-10


@pytest.mark.slow
def test_palletizer_accelerations_are_those_of_multipliers() -> None:
    """Three loops, elastic and heavy rods, a balancer: asked 1e-9."""
    assert worst_of(flexgen.read("palletizer"), 20) < 1e-9


def test_multipliers_find_a_lost_term(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Passive speeds without the part of one coordinate."""
    right = kinematics.joint_motions

    def wrong(model: flexgen.RobotModel, q: ca.SX, v: ca.SX) -> dict[str, tuple[ca.SX, ca.SX]]:
        found = right(model, q, v)
        less = right(model, q, ca.vertcat(v[:-1], 0))
        return found | {"q3": (found["q3"][0], less["q3"][1])}

    monkeypatch.setattr(kinematics, "joint_motions", wrong)
    assert worst_of(read_text(tmp_path, FOUR_BAR), 3) > 1e-4


@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("seed", range(15))
def test_drawn_loops_are_those_of_multipliers(tmp_path: Path, seed: int, spatial: bool) -> None:
    """30 random robots, asked 1e-10 of the equations."""
    model = read_text(tmp_path, drawn_text(np.random.default_rng(seed), spatial))
    assert worst_of(model, 3) < 1e-10


@pytest.mark.parametrize("spatial", [False, True])
def test_loops_stay_closed_and_on_their_branch(tmp_path: Path, spatial: bool) -> None:
    """At states around home: the closure of the graphs is that of the numbers."""
    model = read_text(tmp_path, drawn_text(np.random.default_rng(3), spatial))
    q_a = ca.SX.sym("q_a", model.n_a)
    joints = closed_loops.closed_joints(model, q_a)
    at = ca.Function("at", [q_a], list(joints.values()))
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = home_of(model) + rng.uniform(-0.3, 0.3, model.n_a)
        values = dict(zip(joints, map(float, at(q)), strict=True))
        assert np.abs(closure(model, values).error).max() < 1e-14
        expected = closed_values(model, q)
        assert max(abs(values[name] - expected[name]) for name in values) < 1e-11


@pytest.mark.parametrize("kind", ["point", "axis", "pose"])
def test_jacobian_of_the_closure_is_its_derivative(tmp_path: Path, kind: str) -> None:
    """Central differences at an open position."""
    text = drawn_text(np.random.default_rng(5), True)
    model = read_text(tmp_path, text)
    loops = tuple(type(loop)(loop.name, kind, loop.start, loop.end) for loop in model.loops)
    open_model = flexgen.read(tmp_path / "robot.toml")
    object.__setattr__(open_model, "loops", loops)
    rng = np.random.default_rng(1)
    values = {name: x + rng.uniform(-0.5, 0.5) for name, x in home_closure(model).items()}
    at = closure(open_model, values)
    for k, name in enumerate(at.names):
        up, down = (closure(open_model, values | {name: values[name] + h}) for h in (1e-6, -1e-6))
        assert np.abs((up.error - down.error) / 2e-6 - at.jacobian[:, k]).max() < 1e-8


@pytest.mark.parametrize("spatial", [False, True])
def test_recursion_gives_the_functions_of_the_lagrangian(tmp_path: Path, spatial: bool) -> None:
    """Every function that the recursion has, at drawn states near home."""
    model = read_text(tmp_path, drawn_text(np.random.default_rng(2), spatial))
    equations = flexgen.derive(model)
    names = ("bias", "mass_matrix", "gravity", "forward_dynamics", "tool_motion", "jacobian")
    rng = np.random.default_rng(0)
    for name in (*names, "inversion_jacobians", "inversion_rows", "output_constraint"):
        slow = equations.function(name)
        fast = fast_function(equations, name)
        assert fast is not None
        given = [rng.uniform(-0.1, 0.1, slow.numel_in(k)) for k in range(slow.n_in())]
        given[0] = given[0] + home_of(model)
        for a, b in zip(slow.call(given), fast.call(given), strict=True):
            assert np.abs(np.array(a - b)).max() <= 1e-9 * (1.0 + np.abs(np.array(a)).max())


def test_numeric_mass_matrix_has_loops(tmp_path: Path) -> None:
    """Without CasADi, equal to the graphs."""
    model = read_text(tmp_path, FOUR_BAR)
    q = home_of(model) + np.array([0.1, -0.1, 1e-3])
    expected = np.array(flexgen.derive(model).function("mass_matrix")(q))
    assert np.abs(mass_matrix(model, q) - expected).max() < 1e-10 * np.abs(expected).max()
