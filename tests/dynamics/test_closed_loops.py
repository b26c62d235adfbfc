"""Equations of robots with closed loops: equal to own equations in absolute coordinates with
multipliers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.codegen.build.model_library import library_with
from flexgen.codegen.recursion import arm
from flexgen.codegen.recursion.functions import fast_function, recursive_function
from flexgen.codegen.recursion.rods import with_rods_as_bodies
from flexgen.dynamics.mechanics import closed_loops, kinematics
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.model.format.closure import closed_values, closure, home_closure, passive_joints
from flexgen.model.inertia import mass_matrix
from tests.support.linkages import FOUR_BAR, drawn_text, home_of, read_text
from tests.support.worst_accelerations import worst_of


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


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_derivatives_pass_the_iteration(tmp_path: Path, order: int) -> None:
    """Passive joints of a spatial loop along a line: derivatives of the graph, of which the last
    three steps carry all, against a polynomial through positions from numbers.
    """
    model = read_text(tmp_path, drawn_text(np.random.default_rng(4), True))
    t = ca.SX.sym("t")
    start = home_of(model) + 0.1
    way = np.array([0.7, 0.3, 1.0, 0.1])
    joints = closed_loops.closed_joints(model, ca.SX(ca.DM(start)) + t * ca.DM(way))
    passive = [dof.name for dof in passive_joints(model)]
    x = ca.vertcat(*[joints[name] for name in passive])
    for _ in range(order):
        x = ca.jacobian(x, t)
    found = np.array(ca.Function("at", [t], [x])(0.0)).ravel()
    nodes = 0.3 * np.cos(np.pi * np.arange(25) / 24)
    values = [closed_values(model, start + s * way) for s in nodes]
    for name, derivative in zip(passive, found, strict=True):
        series = np.polynomial.Chebyshev.fit(nodes, [row[name] for row in values], 24)
        expected = float(series.deriv(order)(0.0))
        assert abs(derivative - expected) < 1e-13 * 100.0**order


def palletizer_differences(model: flexgen.RobotModel) -> float:
    """Largest relative difference of the recursion of a palletizer from its Lagrangian."""
    equations = flexgen.derive(model)
    rng = np.random.default_rng(1)
    worst = 0.0
    for name in ("output_constraint", "inversion_rows", "inversion_jacobians"):
        slow = equations.function(name)
        fast = recursive_function(equations, name)
        assert fast is not None
        given = [rng.uniform(-0.1, 0.1, slow.numel_in(k)) for k in range(slow.n_in())]
        given[0] = given[0] * 0.05 + home_of(model)
        for a, b in zip(slow.call(given), fast.call(given), strict=True):
            scale = np.abs(np.array(a)).max()
            worst = max(worst, float(np.abs(np.array(a - b)).max() / scale))
    return worst


def test_recursion_of_a_palletizer_is_that_of_the_lagrangian() -> None:
    """Planar loops with heavy rods, and the angle of the tool."""
    model = flexgen.read("palletizer")
    assert palletizer_differences(model) < 1e-11
    assert fast_function(flexgen.derive(model), "inversion_rows") is not None


def test_a_lost_middle_of_a_rod_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the rods' particles at the middle."""

    def lighter(model: flexgen.RobotModel) -> flexgen.RobotModel:
        made = with_rods_as_bodies(model)
        elements = [
            replace(e, body=replace(e.body, mass=e.body.mass / 2)) if "_middle" in e.name else e
            for e in made.elements
        ]
        return replace(made, elements=tuple(elements))

    monkeypatch.setattr(arm, "with_rods_as_bodies", lighter)
    assert palletizer_differences(flexgen.read("palletizer")) > 1e-5


def test_rods_without_a_loop_stay_lines() -> None:
    """No other robot has other bodies."""
    robot = flexgen.read("palletizer")
    alone = replace(robot, loops=robot.loops[1:])
    names = [line.name for line in with_rods_as_bodies(alone).lines if line.mass]
    assert names == ["drive_mass"]
    arm_model = flexgen.read("kr300_balancer")
    assert with_rods_as_bodies(arm_model) is arm_model


def test_states_whose_loops_cannot_be_closed_give_nan(tmp_path: Path) -> None:
    """A crank that is stretched beyond the reach of the coupler, by a Newton iteration that does
    not converge; and closed states far from home, where it does.
    """
    model = read_text(tmp_path, drawn_text(np.random.default_rng(0), True))
    torque = fast_function(flexgen.derive(model), "inverse_dynamics")
    assert torque is not None
    still = np.zeros(model.n_a)
    rng = np.random.default_rng(2)
    for _ in range(20):
        turned = home_of(model) + rng.uniform(-1.5, 1.5, model.n_a) * np.array([1, 0.1, 1, 0.01])
        assert np.isfinite(np.array(torque(turned, still, still))).all()
        with pytest.raises(flexgen.ArgumentError, match="open by"):
            closed_values(model, turned + np.array([0.0, 0.0, 0.0, 2.0]))
        found = np.array(torque(turned + np.array([0.0, 0.0, 0.0, 2.0]), still, still))
        assert np.isnan(found).all()


@pytest.mark.slow
def test_emitted_functions_refuse_states_that_cannot_be_closed(tmp_path: Path) -> None:
    """A status and no torque, of points and of whole paths."""
    model = read_text(tmp_path, drawn_text(np.random.default_rng(0), True))
    library = library_with(model, ["inverse_dynamics", *INVERSION], ("invert",))
    still = np.zeros((1, model.n_a))
    home = home_of(model)[None]
    assert np.isfinite(library.inverse_dynamics(home, still, still)).all()
    far = home + np.array([0.0, 0.0, 0.0, 2.0])
    with pytest.raises(flexgen.SolverError, match="not finite"):
        library.inverse_dynamics(far, still, still)
    y = np.tile(home[:, list(model.i_g)], (101, 1))
    motion = {"y": y, "dy": 0 * y, "ddy": 0 * y, "period": 2e-3, "n_pre": 10, "n_post": 10}
    assert np.isfinite(library.invert(**motion, q_start=home[0]).tau_m).all()
    with pytest.raises(flexgen.SolverError):
        library.invert(**motion, q_start=far[0])


def test_a_pose_in_which_a_loop_cannot_close_is_named(tmp_path: Path) -> None:
    robot = read_text(tmp_path, FOUR_BAR)
    with pytest.raises(
        flexgen.SolverError, match="not finite, as where a closed loop cannot close"
    ):
        flexgen.analyze(robot, [3.0, *[0.0] * (robot.n_a - 1)])
