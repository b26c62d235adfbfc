"""The force of a process in the closed loop: MuJoCo under the same torques, the law of the hold,
shares of a wrong one.

MuJoCo gets the torques that the loop sent and the force itself; it shares no code with the loop in
C.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hysteretic import hysteretic
from process_forces import PLANE, duration_of, milling
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.cli.main import main
from flexgen.exports.mujoco.mujoco import mjcf
from flexgen.feedback.loop import case as loop_case
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.paths.force.process_force import ProcessForce, make_force

pytestmark = needs_compiler
mujoco = pytest.importorskip("mujoco")
MODEL = "planar5_nmp"
SAMPLE = 5e-4


@pytest.fixture(scope="module")
def equations():
    return flexgen.derive(MODEL)


@pytest.fixture(scope="module")
def force(equations):
    return milling(duration_of(equations), PLANE)


def difference_to_mujoco(run: flexgen.ControlRun, parts: int = 8) -> float:
    """Largest difference of the motor angles along the path, over the largest one of run and
    reference.

    MuJoCo begins at rest before the motion, under the torques that the loop sent, each held for a
    sample.
    """
    model = run.model
    reference = run.reference
    first, last = np.searchsorted(
        reference.time, (reference.begin - 0.01, reference.path_end)
    ).tolist()
    process = make_force(run.trajectory(), model, reference.path_end)
    m = mujoco.MjModel.from_xml_string(mjcf(model))
    m.opt.timestep = run.hardware.sample_s / parts
    d = mujoco.MjData(m)
    names = [c.name for c in model.coordinates] + [f"rotor.{motor.name}" for motor in model.motors]
    at = m.jnt_dofadr[[m.joint(name).id for name in names]]
    motors = [m.actuator(motor.name).id for motor in model.motors]
    site = m.site("tool").id
    body = m.site_bodyid[site]

    def push(m, d):
        f = process.at(np.array([d.time]))[0]
        d.xfrc_applied[body, :3] = f[:3]
        d.xfrc_applied[body, 3:] = f[3:] + np.cross(d.site_xpos[site] - d.xipos[body], f[:3])

    d.time = float(reference.time[first])
    d.qpos[at] = np.concatenate([run.nominal.q_a[first], run.nominal.q_m[first]])
    moved = [d.qpos[at].copy()]
    mujoco.set_mjcb_control(push)
    try:
        for k in range(first, last):
            d.ctrl[motors] = run.nominal.tau_m[k]
            mujoco.mj_step(m, d, parts)
            moved.append(d.qpos[at].copy())
    finally:
        mujoco.set_mjcb_control(None)
    q_m, wanted = (x[first : last + 1] for x in (run.nominal.q_m, reference.motion["q_m"]))
    return float(np.abs(np.array(moved)[:, model.n_a :] - q_m).max() / np.abs(q_m - wanted).max())


@pytest.mark.slow
def test_mujoco_under_the_torques_of_the_loop_moves_as_the_robot_in_it(
    equations, force, monkeypatch
):
    assert difference_to_mujoco(flexgen.control(equations, force=force, assumed_force=0.0)) < 1e-2
    right = ProcessForce.mean
    monkeypatch.setattr(ProcessForce, "mean", lambda self, t, width: -right(self, t, width))
    assert difference_to_mujoco(flexgen.control(equations, force=force, assumed_force=0.0)) > 0.3


@pytest.mark.slow
def test_the_error_of_a_known_force_is_that_of_the_hold(equations, force, monkeypatch):
    """Of order four in the sample time; both planted errors leave more than a thousand times as
    much.
    """
    errors = [
        flexgen.control(equations, force=force, sample_time=h).tool_error_max_m
        for h in (2 * SAMPLE, SAMPLE)
    ]
    assert errors[1] < 1e-8 and 10.0 < errors[0] / errors[1] < 25.0
    right = loop_case.motion_reference
    plain = flexgen.solve(equations, progress=False).trajectory

    def without_force(trajectory, path, sample_s, delay_s, library, time, known):
        made = right(trajectory, path, sample_s, delay_s, library, time, known)
        q_m = plain.at(np.clip(time, plain.time[0], plain.time[-1]))["q_m"]
        return replace(made, motion={**made.motion, "q_m": q_m})

    monkeypatch.setattr(loop_case, "motion_reference", without_force)
    assert flexgen.control(equations, force=force).tool_error_max_m > 1e-4
    monkeypatch.undo()
    mean = ProcessForce.mean
    monkeypatch.setattr(ProcessForce, "mean", lambda self, t, width: -mean(self, t, width))
    assert flexgen.control(equations, force=force).tool_error_max_m > 1e-4


def test_a_held_force_moves_a_mass_as_the_force_itself(monkeypatch):
    """The third power of a sine, integrated twice; means alone, planted, leave 1/12 of the second
    difference.
    """
    w = 2 * np.pi
    h = 0.02
    t = h * np.arange(201)
    process = make_force(
        lambda t: np.outer(np.sin(w * t) ** 3, [1.0, 0.0, 0.0]), flexgen.read("elbow"), t[-1]
    )
    exact = (np.sin(3 * w * t) / 9 - 3 * np.sin(w * t)) / 4

    def largest_error() -> float:
        held = w * w * process.held(t[:-1] + h / 2, h)[:, 0]
        v = np.concatenate([[0.0], np.cumsum(h * held)]) - 2 * w / 3
        x = np.concatenate([[0.0], np.cumsum(h * v[:-1] + h * h / 2 * held)])
        return float(np.abs(x - exact).max())

    assert largest_error() < 2e-4
    monkeypatch.setattr(ProcessForce, "held", ProcessForce.mean)
    assert largest_error() > 1e-3


@pytest.mark.parametrize("controller", ["ppi", "lqg"])
def test_a_force_that_is_wrong_by_a_fifth_leaves_a_fifth(equations, force, controller):
    none, wrong = (
        flexgen.control(
            equations, force=force, assumed_force=factor, controller=controller
        ).tool_error_max_m
        for factor in (0.0, 0.8)
    )
    assert none > 3e-4 and 0.15 < wrong / none < 0.21


def test_robots_rest_under_a_constant_force(equations, monkeypatch):
    """At rest before the move: no error at all; planted, rest without the force, the tool sags
    first.
    """
    constant = np.tile(200.0 * PLANE, (5, 1))
    run = flexgen.control(equations, force=constant, plants={"soft": {"stiffness": 0.8}})
    still = run.reference.time < run.reference.begin
    assert run.distance(run.nominal)[still].max() < 1e-8 and run.tool_error_max_m < 1e-6
    assert (
        np.ptp(run["soft"].error[still], axis=0).max() < 1e-6 < np.abs(run["soft"].error[0]).max()
    )
    monkeypatch.setattr(LocalDynamics, "under", lambda self, force, t: self)
    run = flexgen.control(equations, force=constant)
    assert run.distance(run.nominal)[still].max() > 1e-5


def test_the_force_of_a_solution_acts(equations, force):
    solution = flexgen.solve(equations, force=force, progress=False)
    runs = [flexgen.control(equations, solution=solution, force=given) for given in (None, force)]
    np.testing.assert_allclose(runs[0].nominal.error, runs[1].nominal.error, atol=1e-10)
    free = flexgen.control(equations, solution=solution, force=np.zeros((3, 2)))
    assert free.tool_error_max_m > 1e-4 and free.force_figures()["force_max_N"] == 0.0
    assert abs(free.force_figures()["assumed_force_max_N"] - 300.0) < 1.0


@pytest.mark.full
def test_six_axes_rest_until_the_motion_begins():
    """A solution under a force begins with a transient of its torque, which is not held before."""
    equations = flexgen.derive("manutec_r3_24")
    force = milling(duration_of(equations))
    run = flexgen.control(equations, force=force, sample_time=1.25e-4, torque_limits=False)
    assert run.distance(run.nominal)[run.reference.time < run.reference.begin].max() < 1e-9
    assert run.tool_error_max_m < 2e-6


@pytest.mark.slow
def test_gears_with_hysteresis_feel_the_force():
    equations = flexgen.derive(hysteretic("elbow"))
    force = milling(duration_of(equations), PLANE, hz=20.0)
    errors = [
        flexgen.control(equations, force=force, assumed_force=a).tool_error_max_m
        for a in (1.0, 0.0)
    ]
    assert errors[0] < 2e-5 < 2e-4 < errors[1]


@pytest.mark.slow
def test_command_figures_and_report(tmp_path, equations, force, capsys):
    t = np.linspace(0.0, duration_of(equations), 2001)
    solution = flexgen.solve(equations, force=force, verify=False, progress=False)
    file = str(solution.save(tmp_path / "force.npz"))
    words = [
        "--force",
        file,
        "--assumed-force",
        "0.8",
        "--out",
        str(tmp_path / "out.npz"),
        "--json",
    ]
    assert main(["control", MODEL, *words, "--report", str(tmp_path / "page")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (
        abs(found["force_error_max_N"] - 0.2 * found["force_max_N"]) < 1e-3 * found["force_max_N"]
    )
    out = flexgen.Trajectory.load(tmp_path / "out.npz")
    np.testing.assert_allclose(out.at(t[5:-5])["force"][:, :2], force(t)[5:-5], atol=1.0)
    page = (tmp_path / "page" / "index.html").read_text()
    assert "force that the feedforward assumes, largest" in page
    assert main(["control", MODEL, "--force", file]) == 0
    lines = capsys.readouterr().out.splitlines()
    for label in ("force of the process on the tool", "force that the feedforward assumes"):
        (line,) = (line for line in lines if line.startswith(label))
        assert line.split()[-2:] == ["299.5", "N"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"assumed_force": 0.8}, "given without a force"),
        ({"force": np.zeros((3, 2)), "assumed_force": -1.0}, "assumed_force: given -1.0"),
        ({"force": np.zeros((3, 4))}, "4 columns"),
        ({"force": "far.npz"}, "does not exist"),
    ],
)
def test_errors_name_what_was_given(equations, given, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.control(equations, **given)


def test_a_solution_states_its_own_force(equations):
    solution = flexgen.solve(equations, verify=False, progress=False)
    with pytest.raises(ArgumentError, match="a solution states its own"):
        flexgen.control(equations, solution=solution, force=np.zeros((3, 2)), assumed_force=0.5)
