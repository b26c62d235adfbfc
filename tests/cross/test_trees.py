"""Robots with branches: every function on each of its routes against MuJoCo, and with planted
bugs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_robots import Case
from random_trees import trees
from robot_checks import Found, check_mujoco, close
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from seeded_draws import on_draws

import flexgen
from flexgen.base.errors import ModelError
from flexgen.codegen.recursion import dh_chain
from flexgen.codegen.recursion.functions import RECURSIVE_BUILDERS, arm_of, recursive_function
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = 2
MORE = 10
ALL = 40
LARGEST = 1e-10  # of the largest entry of a result: recursion against Lagrange
STATE = ("q_a", "v_a", "a_a", "q_m", "v_m", "tau_m")


def on_trees(check, count: int, start: int = 0) -> None:
    """A check of that many random trees, the same ones every time."""
    on_draws(check, trees(), count, start)


def check_tree(case: Case) -> None:
    """Lagrange and the recursion against MuJoCo, and every function that has a recursion against
    Lagrange.
    """
    equations = derive(case.model)
    for route in ("lagrange", "fast"):
        check_mujoco(Found(equations, route), case)
    check_recursion(equations, case)


def check_recursion(equations, case: Case) -> None:
    """Every function with a recursion, against that of Lagrange's equations."""
    checked = 0
    for name in RECURSIVE_BUILDERS:
        fast = recursive_function(equations, name)
        if fast is None:
            continue
        slow = equations.function(name)
        checked = checked + 1
        for s in case.states:
            known = {port: getattr(s, port) for port in STATE} | {"a_m": 1.0 + 0.0 * s.q_m}
            arguments = [
                known.get(port, np.full(fast.size_in(port), 0.3)) for port in fast.name_in()
            ]
            for x, y in zip(fast.call(arguments), slow.call(arguments), strict=True):
                close(
                    name,
                    np.array(x),
                    np.array(y),
                    LARGEST,
                    1e-9 + np.abs(np.array(y)).max(initial=0.0),
                )
    assert checked >= 6


@pytest.mark.slow
def test_functions_of_a_sample_of_random_trees_agree():
    on_trees(check_tree, SAMPLE)


@pytest.mark.full
def test_functions_of_more_random_trees_agree():
    on_trees(check_tree, MORE, start=1)


@pytest.mark.full
def test_functions_of_forty_random_trees_agree():
    on_trees(check_tree, ALL, start=1)


def without_leads(lay):
    """The frames of joints without the rotation about z that only further children have."""

    def planted(*arguments):
        chain = lay(*arguments)
        return replace(
            chain, joints=tuple(replace(joint, lead=(1.0, 0.0)) for joint in chain.joints)
        )

    return planted


def on_the_last_joint(lay):
    """The load on the last joint, as if the robot were a chain."""

    def planted(*arguments):
        chain = lay(*arguments)
        return replace(chain, carrier=len(chain.joints) - 1)

    return planted


@pytest.mark.slow
@pytest.mark.parametrize("bug", [without_leads, on_the_last_joint])
def test_planted_bugs_of_the_frames_are_found(monkeypatch, bug):
    monkeypatch.setattr(dh_chain, "lay_frames", bug(dh_chain.lay_frames))

    def check(case: Case) -> None:
        arm_of.cache_clear()
        check_recursion(derive(case.model), case)

    with pytest.raises(AssertionError, match="found"):
        on_trees(check, 6)
    arm_of.cache_clear()


def test_an_element_on_another_parent_is_found():
    def check(case: Case) -> None:
        elements = list(case.model.elements)
        k = next(
            k for k in range(1, len(elements)) if case.model.parents[elements[k].name] != "base"
        )
        elements[k] = replace(elements[k], parent="base")
        check_mujoco(Found(derive(replace(case.model, elements=tuple(elements)))), case)

    with pytest.raises(AssertionError, match="found"):
        on_trees(check, 2)


# --- files ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["two_arm", "carried_arm"])
def two_arms(request) -> RobotModel:
    """Two arms on an elastic column; an arm on an elastic base that carries another. The tool: on
    the first branch.
    """
    return read(ROOT / "models" / f"{request.param}.toml")


def same_functions(first: RobotModel, second: RobotModel) -> None:
    """Equal inverse dynamics and tool pose at random states."""
    a = derive(first)
    b = derive(second)
    rng = np.random.default_rng(3)
    q, v, dv = rng.uniform(-1, 1, (3, first.n_a))
    assert [c.name for c in first.coordinates] == [c.name for c in second.coordinates]
    for name, arguments in (
        ("inverse_dynamics", (q, v, dv)),
        ("forward_kinematics", (q,)),
        ("sensors", (q, v, dv)),
    ):
        if name == "sensors" and not first.sensors:
            continue
        for x, y in zip(
            a.function(name).call(arguments), b.function(name).call(arguments), strict=True
        ):
            close(name, np.array(x), np.array(y), 1e-12, 1e-12 + np.abs(np.array(y)).max())


def test_a_tree_is_the_same_after_urdf_and_overlay(two_arms, tmp_path):
    overlay = flexgen.export_urdf(two_arms, tmp_path / "two.urdf").details["overlay"]
    assert f'branches = ["{two_arms.elements[-1].name}"]' in overlay.read_text()
    again = read(overlay)
    assert again.parents == two_arms.parents and again.tip == two_arms.tip
    same_functions(two_arms, again)


def test_a_tree_in_mujoco_moves_as_the_model(two_arms, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    file = flexgen.export_mujoco(two_arms, tmp_path / "two.xml").path
    m = mujoco.MjModel.from_xml_path(str(file))
    d = mujoco.MjData(m)
    q = np.random.default_rng(4).uniform(-1, 1, two_arms.n_a)
    for coordinate, x in zip(two_arms.coordinates, q, strict=True):
        d.joint(coordinate.name).qpos[0] = x
    mujoco.mj_forward(m, d)
    p, R = (np.array(x) for x in derive(two_arms).function("forward_kinematics")(q))
    np.testing.assert_allclose(d.site("tool").xpos, p.ravel(), atol=1e-12)
    np.testing.assert_allclose(d.site("tool").xmat.reshape(3, 3), R, atol=1e-12)


@pytest.mark.slow
def test_the_joints_of_all_branches_follow_in_mujoco(two_arms):
    """The torques of `solve`, open loop, on another plant with another integrator, until the path
    ends.
    """
    pytest.importorskip("mujoco")
    from mujoco_referee import MujocoMachine

    machine = MujocoMachine(two_arms)
    n = two_arms.n_a
    k = two_arms.n_m
    move = flexgen.solve(two_arms, verify=False).trajectory
    start = move.at(move.time[0])
    torque = make_interp_spline(move.time, move.channels["tau_m"], 5)

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        q_a, q_m, v_a, v_m = np.split(x, (n, n + k, 2 * n + k))
        return np.concatenate([v_a, v_m, *machine.forward_dynamics(q_a, v_a, q_m, v_m, torque(t))])

    x = np.concatenate([np.ravel(start[name]) for name in ("q_a", "q_m", "v_a", "v_m")])
    # later the unstable arms, at rest, have grown to all that rounding gives
    times = move.time[move.time <= 1.0]
    found = solve_ivp(slope, times[[0, -1]], x, "DOP853", t_eval=times, rtol=1e-9, atol=1e-11)
    error = np.abs(found.y[:n].T - move.channels["q_a"][: len(times)])[:, list(two_arms.i_g)]
    assert error.max() < 1e-6 and np.ptp(move.channels["q_a"], axis=0).max() > 0.29


def test_a_parent_that_comes_later_or_does_not_exist_is_refused(tmp_path):
    text = (ROOT / "models" / "two_arm.toml").read_text()
    for wrong in ("left2", "torsso"):
        (tmp_path / "m.toml").write_text(text.replace('parent = "torso"', f'parent = "{wrong}"'))
        with pytest.raises(ModelError, match=r"element\[5\].parent|element.left1.parent"):
            read(tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text(text.replace('element = "right2"', 'element = "right3"'))
    with pytest.raises(ModelError, match=r"tool.element.*right"):
        read(tmp_path / "m.toml")
