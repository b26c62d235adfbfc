"""Sensors of torques and forces against MuJoCo's, and their way into the closed loop."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from mujoco_referee import MujocoMachine, text

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics import sensors as sensor_graphs
from flexgen.dynamics.mechanics.beam import modal_beam
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.model.elements import RobotModel
from flexgen.simulation.environment.sense import shown_angles

ROBOTS = ("planar5_nmp", "elbow", "manutec_r3_18")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
POINT = (0.11, -0.07, 0.05)  # m: of the sensors in the body frames


def without_coulomb(name: str) -> dict[str, object]:
    """Overrides that leave viscous friction alone, as the referee knows it."""
    plain = flexgen.read(name)
    return {
        f"motor.{m.name}.friction.coulomb": 0.0
        for m in plain.motors
        if getattr(m.friction, "coulomb", 0.0)
    }


def sensed(name: str) -> RobotModel:
    """The robot with a torque sensor at each joint, and wrenches at each element and at the
    tool.
    """
    plain = flexgen.read(name, overrides=without_coulomb(name))
    joints = [c for c in plain.coordinates if c.dof is not None]
    sensors = [
        {
            "name": f"t_{c.name}",
            "type": "joint_torque",
            "coordinate": c.name,
            "unit": "N m" if c.unit == "rad" else "N",
        }
        for c in joints
    ]
    places = [element.name for element in plain.elements] + ["tool"]
    sensors += [
        {"name": f"w_{p}", "type": "wrench", "element": p, "unit": "N", "position": list(POINT)}
        for p in places
    ]
    return flexgen.read(name, overrides={"sensor": sensors, **without_coulomb(name)})


class Sensing(MujocoMachine):
    """The machine with MuJoCo's force and torque sensors at the same places."""

    def __init__(self, model: RobotModel) -> None:
        super().__init__(model)

    def wrenches(self) -> np.ndarray:
        """Force and moment at each site: what the parent exerts on the body that carries it."""
        return np.concatenate(
            [self.d.sensor(f"{kind} {name}").data for name in self.sites for kind in ("f", "m")]
        )

    @property
    def sites(self) -> list[str]:
        return [element.name for element in self.model.elements] + ["tool"]

    def _children(self, name: str, position: np.ndarray, rotation: np.ndarray) -> str:
        out = super()._children(name, position, rotation)
        if name == self.model.tip:
            tool = self.model.tool
            at = np.array(tool.position) + np.array(tool.rotation) @ POINT
            old = f'<site name="tool" pos="{text(tool.position)}"'
            site = f'<site name="at tool" pos="{text(at)}"{out.split(old)[1].split("/>")[0]}/>'
            out = out.replace(old, site + old)
        if name != "base":
            out += self._site(name, position, rotation)
        return out

    def _site(self, name: str, position: np.ndarray, rotation: np.ndarray) -> str:
        from mujoco_referee import quaternion

        return (
            f'<site name="at {name}" pos="{text(position + rotation @ POINT)}" '
            f'quat="{quaternion(rotation)}"/>'
        )

    def _tendons(self) -> str:
        kinds = (("f", "force"), ("m", "torque"))
        rows = "".join(
            f'<{kind} name="{k} {n}" site="at {n}"/>' for n in self.sites for k, kind in kinds
        )
        return super()._tendons() + f"<sensor>{rows}</sensor>"


def state_of(model: RobotModel) -> tuple[np.ndarray, ...]:
    """A state with deflections of the size of working loads, torques, and a force on the tool."""
    rng = np.random.default_rng(7)
    q_a = rng.uniform(-0.6, 0.6, model.n_a)
    v_a = rng.uniform(-1.0, 1.0, model.n_a)
    free = list(model.i_e)
    q_a[free] *= 1e-3
    q_m = model.eta @ (q_a[list(model.i_g)] + rng.uniform(-2e-3, 2e-3, model.n_g))
    v_m = model.eta @ v_a[list(model.i_g)]
    tau_m = rng.uniform(-2.0, 2.0, model.n_m)
    force = rng.uniform(-50.0, 50.0, 6)
    return q_a, v_a, q_m, v_m, tau_m, force


def motion_of(
    model: RobotModel,
    q_a: np.ndarray,
    v_a: np.ndarray,
    a_a: np.ndarray,
    q_m: np.ndarray,
    force: np.ndarray,
):
    """A trajectory of two equal samples, with the names and units of the model's coordinates."""
    arm = [c.name for c in model.coordinates]
    rates = {"q_a": "", "v_a": "/s", "a_a": "/s^2"}
    units = {n: tuple(c.unit + rate for c in model.coordinates) for n, rate in rates.items()}
    units |= {"q_m": ("rad",) * model.n_m, "force": ("N",) * 3 + ("N m",) * 3}
    labels = {name: tuple(arm) for name in rates}
    labels |= {"q_m": tuple(m.name for m in model.motors), "force": WRENCH}
    values = {"q_a": q_a, "v_a": v_a, "a_a": a_a, "q_m": q_m, "force": force}
    ports = {
        name: Port(name, (len(x),), " or ".join(dict.fromkeys(units[name])), "")
        for name, x in values.items()
    }
    rows = {n: np.tile(x, (2, 1)) for n, x in values.items()}
    return Trajectory(np.array([0.0, 1.0]), rows, ports, labels, units=units)


def both(name: str) -> tuple[np.ndarray, np.ndarray, int]:
    """Signals of flexgen and of MuJoCo under the same motor torques and the same force on the
    tool.
    """
    model = sensed(name)
    q_a, v_a, q_m, v_m, tau_m, force = state_of(model)
    machine = Sensing(model)
    body = machine.m.body("payload").id
    machine.set_state(
        machine.P @ np.concatenate([q_a, q_m[list(model.i_m)]]), np.zeros(len(machine.at_v))
    )
    arm = machine.d.site("tool").xpos - machine.d.xipos[body]
    machine.d.xfrc_applied[body] = np.concatenate(
        [force[:3], force[3:] + np.cross(arm, force[:3])]
    )
    machine.forward_dynamics(q_a, v_a, q_m, v_m, tau_m)
    machine.d.qfrc_applied[machine.at_v[model.n_a :]] = tau_m
    mujoco.mj_forward(machine.m, machine.d)
    passive = machine.d.qfrc_passive[machine.at_v[: model.n_a]]
    frictions = np.array([c.dof.friction.viscous for c in model.coordinates])
    torques = passive + frictions * v_a
    a_a, _ = derive(model).pushed.function("forward_dynamics")(q_a, v_a, q_m, v_m, tau_m, force)
    a_a = np.array(a_a).ravel()
    seen = flexgen.sense(model, motion_of(model, q_a, v_a, a_a, q_m, force))["y_s"][0]
    return seen, np.concatenate([torques, machine.wrenches()]), model.n_a


@pytest.mark.parametrize("name", ROBOTS)
def test_torques_and_wrenches_are_those_of_mujoco(name: str) -> None:
    seen, known, n = both(name)
    assert np.abs(known).min(initial=np.inf, where=known != 0) > 0 and np.linalg.norm(known) > 100
    for part in (slice(0, n), slice(n, None)):
        assert np.abs(seen - known)[part].max() < 1e-9 * np.abs(known[part]).max()


def test_a_wrong_sign_of_the_force_on_the_tool_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    real = sensor_graphs.ca.gradient
    monkeypatch.setattr(sensor_graphs.ca, "gradient", lambda of, x: -real(of, x))
    seen, known, n = both("planar5_nmp")
    assert np.abs(seen - known)[n:].max() > 1.0


def test_a_beam_behind_a_sensor_is_held_by_its_whole_weight() -> None:
    plain = flexgen.read("beam_arm")
    base = {"name": "base", "type": "wrench", "element": plain.elements[0].name, "unit": "N"}
    model = flexgen.read("beam_arm", overrides={"sensor": [base]})
    still = np.zeros(model.n_a)
    seen = flexgen.sense(
        model, motion_of(model, still, still, still, np.zeros(model.n_m), np.zeros(6))
    )["y_s"][0]
    beams = sum(
        modal_beam(element.beam).mass for element in plain.elements if element.beam is not None
    )
    mass = beams + plain.payload.mass + sum(element.body.mass for element in plain.elements)
    assert beams > 0 and np.linalg.norm(seen[:3]) == pytest.approx(
        mass * np.linalg.norm(plain.gravity), rel=1e-12
    )


# --- the loop ------------------------------------------------------------------------------------

TORQUES = [
    {"name": "t1", "type": "joint_torque", "coordinate": "q1", "unit": "N m"},
    {"name": "flange", "type": "wrench", "element": "tool", "unit": "N"},
]


@pytest.mark.slow
def test_the_loop_measures_the_torque_of_the_gear_and_the_force_on_the_tool() -> None:
    """Against the springs of the gears at rest, and the weight of the payload of each robot."""
    model = flexgen.read("planar5_nmp", overrides={"sensor": TORQUES})
    push = flexgen.Disturbance("step", "tool.x", 30.0, start_s=0.2)
    run = flexgen.control(model, "line", plants={"heavy": {"payload": 3.0}}, disturbances=[push])
    gear = derive(model).function("gear_torque")
    before = np.searchsorted(run.reference.time, -0.1)
    for robot, mass in zip(run.runs, (0.0, 3.0), strict=True):
        still = np.zeros(model.n_a), np.zeros(model.n_m)
        held = np.array(gear(robot.q_a[before], still[0], robot.q_m[before], still[1])).ravel()
        assert robot.sensors[before, 0] == pytest.approx(held[0], rel=1e-6)
        assert np.linalg.norm(robot.sensors[before, 1:4]) == pytest.approx(
            9.81 * mass, rel=1e-6, abs=1e-6
        )
        # At rest again the wrench holds the weight against the push.
        p = robot.sensors[-1, 1:4]
        assert np.linalg.norm(p) == pytest.approx(np.hypot(30.0, 9.81 * mass), rel=1e-4)
    quiet = np.searchsorted(run.reference.time, 0.195)
    planned = run.reference.y_s
    assert (
        np.abs(run.nominal.sensors[:quiet] - planned[:quiet]).max() < 1e-2 * np.abs(planned).max()
    )


@pytest.mark.slow
def test_an_encoder_error_reaches_the_controller() -> None:
    """At rest the loop moves the motor until the encoder shows the reference: the error, turned
    round.
    """
    error = {"harmonics": [1, 2], "cos": [2e-3, 0.0], "sin": [0.0, 1e-3]}
    model = flexgen.read("planar5_nmp", overrides={"motor.m1.encoder_error": error})
    run = flexgen.control(model, "line")
    robot = run.nominal
    q = robot.q_m[-1, 0]
    assert shown_angles(model, robot.q_m) == pytest.approx(robot.measured, abs=1e-12)
    shown = q + 2e-3 * np.cos(q) + 1e-3 * np.sin(2 * q)
    assert robot.measured[-1, 0] == pytest.approx(shown, abs=1e-12)
    assert shown == pytest.approx(run.reference.motion["q_m"][-1, 0], abs=1e-5)
    plain = flexgen.control("planar5_nmp", "line")
    assert run.distance(robot).max() > 3 * plain.distance(plain.nominal).max()


@pytest.mark.slow
def test_a_strain_gauge_reads_the_deflection_and_its_responses_are_those_of_the_linear_model() -> (
    None
):
    gauge = {
        "name": "bend",
        "type": "strain",
        "coordinate": "q3",
        "unit": "um/m",
        "gauge": 2e4,
        "offset": -3.0,
    }
    plain = without_coulomb("planar5_nmp")
    model = flexgen.read("planar5_nmp", overrides={"sensor": [gauge], **plain})
    run = flexgen.control(model, "line")
    assert run.nominal.sensors[:, 0] == pytest.approx(
        2e-2 * run.nominal.q_a[:, 2] - 3e-6, rel=1e-12, abs=1e-15
    )
    plan = flexgen.excite(model, poses=[[0.3, -1.1]], speed_rms=0.005, f_max=100.0, lines=12)
    found = flexgen.frf(flexgen.measure(plan, model))
    local = LocalModel(model, (), found.sensors)
    exact = local.response(
        local.values, found.poses, found.w, Drive(plan.hardware.sample_s), derivatives=False
    ).G
    assert found.outputs == ("m1", "m2", "bend")
    assert np.abs(found.G - exact)[:, :, 2].max() < 2e-3 * np.abs(exact[:, :, 2]).max()


BAD = [
    ({"type": "joint_torque", "unit": "N m"}, "sensor.s.coordinate"),
    ({"type": "joint_torque", "coordinate": "q1", "unit": "N"}, "sensor.s.unit"),
    ({"type": "wrench", "element": "no", "unit": "N"}, "sensor.s.element"),
    (
        {"type": "wrench", "element": "tool", "unit": "N", "moment_noise": -1.0},
        "sensor.s.moment_noise",
    ),
    ({"type": "strain", "coordinate": "q1", "unit": "1", "gauge": 1.0}, "sensor.s.coordinate"),
    ({"type": "strain", "coordinate": "q3", "unit": "1"}, "sensor.s.gauge"),
]


@pytest.mark.parametrize(("entries", "key"), BAD)
def test_bad_sensors_are_refused(entries: dict[str, object], key: str) -> None:
    with pytest.raises(ModelError, match=key.replace(".", r"\.")):
        flexgen.read("planar5_nmp", overrides={"sensor": [{"name": "s", **entries}]})


def test_what_is_not_covered_is_refused() -> None:
    plain = flexgen.read("elbow")
    with pytest.raises(ArgumentError, match=r"given elbow without a \[\[sensor\]\]"):
        flexgen.sense(plain, flexgen.solve(plain).trajectory)
    rotors = {
        f"motor.m1.{key}": value for key, value in (("axis", [0, 0, 1]), ("carrier", "base"))
    }
    rotors |= {
        f"motor.m2.{key}": value for key, value in (("axis", [0, 0, 1]), ("carrier", "upper"))
    }
    model = flexgen.read(
        "elbow", overrides={"motor_coupling": "complete", "sensor": [TORQUES[1]], **rotors}
    )
    with pytest.raises(ArgumentError, match=r'sensor flange: .*motor_coupling = "complete"'):
        flexgen.excite(model, poses=[[0.5, -0.3]], sensors=["flange.fx"])


def test_a_filter_uses_the_torque_of_a_joint() -> None:
    """The emitted signals are those of `sense`."""
    model = flexgen.read("planar5_nmp", overrides={"sensor": [{**TORQUES[0], "noise": 0.1}]})
    ekf = flexgen.ExtendedKalmanFilter(model, ("motors", "t1"), sample_time=1e-3)
    ekf.reset(np.array([30.0, -110.0]))
    first = ekf.step(np.array([30.0, -110.0, 0.0]), np.zeros(2))
    assert first.innovation.shape == (3,)
    a, b = (x[0] for x in (first.q_a[None], first.v_a[None]))
    library = library_with(model, ["sensors"])
    motion = motion_of(model, a, b, np.array([1.0, 2.0, 3.0]), np.zeros(2), np.zeros(6))
    seen = flexgen.sense(model, motion)["y_s"][0]
    assert library.sensors(a, b, np.array([1.0, 2.0, 3.0])) == pytest.approx(seen, rel=1e-12)
