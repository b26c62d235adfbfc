"""A wall in simulation and loop against MuJoCo with forces that the test computes, and against
energy.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from mujoco_referee import MujocoMachine
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation.environment import wall as walls

STIFFNESS = 2e4
DAMPING = 150.0


@cache
def solved(name: str = "planar5_nmp") -> Any:
    return flexgen.solve(robot(name), "line")


@cache
def robot(name: str = "planar5_nmp") -> Any:
    """Without Coulomb friction, which the referee does not know."""
    plain = flexgen.read(name)
    coulomb = [m.name for m in plain.motors if getattr(m.friction, "coulomb", 0.0)]
    return flexgen.read(
        name, overrides={f"motor.{name}.friction.coulomb": 0.0 for name in coulomb}
    )


def wall_before_the_end(**numbers: Any) -> Any:
    """A wall across the line of the tool, two centimeters before its end."""
    y = solved().trajectory["y_ref"]
    way = np.append(y[-1] - y[0], 0.0)
    n = -way / np.linalg.norm(way)
    return flexgen.Wall(
        np.append(y[-1], 0.0) + 0.02 * n, 3.0 * n, **{"stiffness": STIFFNESS, **numbers}
    )


class Touched(MujocoMachine):
    """The machine before a plane; its own force on the tool."""

    def __init__(self, model: Any, wall: Any) -> None:
        super().__init__(model)
        self.wall = wall
        self.n = np.array(wall.normal) / np.linalg.norm(wall.normal)
        self.body = self.m.body("payload").id

    def push(self, q_a: np.ndarray, v_a: np.ndarray) -> np.ndarray:
        """The force on the tool, (3,)."""
        import mujoco

        x, dx = (
            self.P @ np.concatenate([part, np.zeros(len(self.model.i_m))]) for part in (q_a, v_a)
        )
        self.set_state(x, dx)
        J = np.zeros((3, self.m.nv))
        mujoco.mj_jacSite(self.m, self.d, J, None, self.m.site("tool").id)
        p = self.d.site("tool").xpos
        v = J[:, self.at_v] @ dx
        depth = -self.n @ (p - self.wall.point) - self.wall.gap
        size = self.wall.stiffness * depth - self.wall.damping * (self.n @ v)
        return self.n * size if depth > 0 and size > 0 else np.zeros(3)

    def rate(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """The rate of q_a, v_a, q_m, v_m, all motors behind elastic gears."""
        n_a = self.model.n_a
        n_m = self.model.n_m
        q_a, v_a, q_m, v_m = np.split(x, np.cumsum([n_a, n_a, n_m]))
        force = self.push(q_a, v_a)
        self.set_state(np.concatenate([q_a, q_m]), np.concatenate([v_a, v_m]))
        arm = self.d.site("tool").xpos - self.d.xipos[self.body]
        self.d.xfrc_applied[self.body] = np.concatenate([force, np.cross(arm, force)])
        a_a, a_m = self.forward_dynamics(q_a, v_a, q_m, v_m, tau)
        self.d.xfrc_applied[:] = 0.0
        return np.concatenate([v_a, a_a, v_m, a_m])


@pytest.mark.slow
def test_a_simulation_with_a_wall_is_that_of_mujoco_with_the_force_of_the_test() -> None:
    wall = wall_before_the_end(damping=DAMPING, gap=0.003)
    found = flexgen.simulate(robot(), solved().trajectory, wall=wall, feedback="none", held=0.0)
    assert found.energy_error < 1e-8
    motion = found.trajectory
    machine = Touched(robot(), wall)
    tau = solved().trajectory
    begin = np.concatenate([motion[name][0] for name in ("q_a", "v_a", "q_m", "v_m")])
    t = motion.time
    from flexgen.base.motion.torque_curve import torque_curve

    curve = torque_curve(t, tau["tau_m"], limited=tau.meta.get("torque") == "limited")
    known = solve_ivp(
        lambda s, x: machine.rate(x, curve(s)),
        (t[0], t[-1]),
        begin,
        "DOP853",
        [t[-1]],
        rtol=1e-9,
        atol=1e-10,
    )
    last = np.concatenate([motion[name][-1] for name in ("q_a", "v_a", "q_m", "v_m")])
    assert np.abs(motion["contact"]).max() > 50
    n_a = robot().n_a
    assert np.abs(known.y[:n_a, -1] - last[:n_a]).max() < 2e-7
    force = machine.push(last[:n_a], last[n_a : 2 * n_a])
    assert motion["contact"][-1] == pytest.approx(force, abs=1e-9 * np.abs(force).max() + 1e-9)


def test_the_wall_of_the_loop_is_that_of_mujoco() -> None:
    """The commanded torques, held between the samples, on MuJoCo's robot: from rest until the tool
    has bounced.
    """
    wall = wall_before_the_end(damping=DAMPING)
    run = flexgen.control(
        robot(), "line", solution=solved(), controller="ppi", wall=wall, sample_time=1e-3
    )
    nominal = run.nominal
    assert nominal.contact is not None
    touching = np.flatnonzero(np.abs(nominal.contact).max(axis=1))
    first = touching[0] - 30
    last = touching[0] + 40
    # The loop records angles; speeds at the start are those of the plan, which the tool follows
    # before the wall.
    machine = Touched(robot(), wall)
    m = run.reference.motion
    x = np.concatenate([nominal.q_a[first], m["v_a"][first], nominal.q_m[first], m["v_m"][first]])
    for k in range(first, last):
        tau = nominal.tau_m[k]
        x = solve_ivp(
            lambda _, z, u=tau: machine.rate(z, u), (0, 1e-3), x, "DOP853", rtol=1e-8, atol=1e-10
        ).y[:, -1]
    q_a = x[: robot().n_a]
    error = np.abs(q_a - nominal.q_a[last]).max()
    assert error < 3e-6
    free = flexgen.control(robot(), "line", solution=solved(), controller="ppi", sample_time=1e-3)
    assert np.abs(free.nominal.q_a[last] - q_a).max() > 300 * error  # without the wall


@pytest.mark.slow
def test_a_wrench_measures_the_wall_and_robots_with_hysteresis_touch_it() -> None:
    flange = {"name": "flange", "type": "wrench", "element": "tool", "unit": "N"}
    lossy = {"lost_motion": 1e-9, "stiffness": 1e3}
    more = {"sensor": [flange]}
    wall = wall_before_the_end(damping=DAMPING)
    runs = []
    for each in (more, more | {"element.arm1.dof.q1.gear.hysteresis": lossy}):
        model = flexgen.read("planar5_nmp", overrides=each)
        run = flexgen.control(
            model, "line", wall=wall, plants={"heavy": {"payload": 1.0}}, sample_time=1e-3
        )
        runs.append(run)
        contact = run.nominal.contact
        seen = run.nominal.sensors
        assert contact is not None and np.abs(contact).max() > 100
        # A tool without mass carries what the wall pushes.
        assert np.linalg.norm(seen[:, :3], axis=1) == pytest.approx(
            np.linalg.norm(contact, axis=1), abs=1e-6
        )
        heavy = run["heavy"].contact
        assert heavy is not None and np.abs(heavy - contact).max() > 0.1
    plain, hysteretic = (run.nominal.contact for run in runs)
    assert plain is not None and hysteretic is not None
    assert np.abs(plain - hysteretic).max() < 1e-2 * np.abs(plain).max()


def work_of(wall: Any) -> tuple[float, float]:
    """Work that a wall takes in a whole contact, by the trapezoidal rule, and the largest energy
    of its spring [J].
    """
    start = solved().trajectory
    found = flexgen.simulate(robot(), start, wall=wall, feedback="none", held=0.0)
    motion = found.trajectory
    v = np.array(
        [
            np.array(derive(robot()).function("jacobian")(q))[:3] @ u
            for q, u in zip(motion["q_a"], motion["v_a"], strict=True)
        ]
    )
    power = -np.einsum("ij,ij->i", motion["contact"], v)
    work = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(motion.time))])
    touching = np.abs(motion["contact"]).max(axis=1) > 0
    begins = np.flatnonzero(np.diff(touching.astype(int)) == 1)
    ends = np.flatnonzero(np.diff(touching.astype(int)) == -1)
    first = begins[0]
    last = ends[ends > begins[0]][0] + 1
    deepest = np.linalg.norm(motion["contact"], axis=1).max() / wall.stiffness
    return float(work[last] - work[first]), wall.stiffness * deepest**2 / 2


@pytest.mark.full
def test_the_spring_of_a_wall_gives_back_what_it_takes() -> None:
    stiff = {"stiffness": 3e5}
    kept, stored = work_of(wall_before_the_end(**stiff))
    lost, _ = work_of(wall_before_the_end(damping=1000.0, **stiff))
    assert abs(kept) < 5e-3 * stored and lost > 0.1 * stored


def test_the_force_never_pulls_and_begins_at_the_gap() -> None:
    wall = flexgen.Wall((1.0, 0.0, 0.0), (-2.0, 0.0, 0.0), 1e4, 500.0, gap=0.01)
    equations = derive(robot())
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (4000, robot().n_a))
    v = np.random.default_rng(2).uniform(-3.0, 3.0, q.shape)
    force = walls.contact_force(wall, equations, q, v)
    x = evaluate(equations.function("forward_kinematics"), q)[0].reshape(len(q), 3)[:, 0]
    assert (force[:, 0] <= 0).all() and not force[:, 1:].any()
    assert not force[x < 1.01].any() and (force[x > 1.01, 0] < 0).mean() > 0.3


def test_a_wall_that_pulls_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walls.ca, "fmax", lambda a, b: b)
    with pytest.raises(AssertionError):
        test_the_force_never_pulls_and_begins_at_the_gap()


@pytest.mark.parametrize(
    ("entries", "text"),
    [
        ({"point": (0.0, 1.0)}, "wall, point"),
        ({"normal": (0.0, 0.0, 0.0)}, "wall, normal"),
        ({"stiffness": 0.0}, "wall, stiffness"),
        ({"damping": -1.0}, "wall, damping"),
        ({"gap": float("nan")}, "wall, gap"),
    ],
)
def test_bad_walls_are_refused(entries: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.Wall(
            **{"point": (1.0, 0.0, 0.0), "normal": (-1.0, 0.0, 0.0), "stiffness": 1e4, **entries}
        )


def test_a_tool_that_begins_behind_the_wall_is_refused() -> None:
    wall = wall_before_the_end()
    turned = flexgen.Wall(wall.point, [-x for x in wall.normal], 1e4)
    for call in (flexgen.control, flexgen.simulate):
        more = (
            {"solution": solved()}
            if call is flexgen.control
            else {"trajectory": solved().trajectory}
        )
        with pytest.raises(ArgumentError, match="in which the tool begins"):
            call(robot(), wall=turned, **more)
