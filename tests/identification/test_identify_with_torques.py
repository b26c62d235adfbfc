"""Torques of joints and wrenches in frequency responses and fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from identification_cases import NOISY, poses_of, without_coulomb

import flexgen
from flexgen.base.errors import ModelError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses import response_outputs
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.response_outputs import channels
from flexgen.identification.responses.result import FitStatus
from flexgen.model.elements import RobotModel

W = 2 * np.pi * np.geomspace(1.0, 80.0, 10)
RUBBING = {"type": "smooth", "viscous": 20.0, "coulomb": 30.0, "beta": 100.0}

SENSORS = """
[[sensor]]
name = "torque"
type = "joint_torque"
coordinate = "q1"
unit = "N m"

[[sensor]]
name = "flange"
type = "wrench"
element = "tool"
position = [0.1, 0.05, 0.02]
unit = "N"
"""


def sensed(
    name: str, encoders: bool = False, payload: float = 20.0, **overrides: object
) -> RobotModel:
    """The robot with a torque sensor at each joint, a wrench at the tool, and link encoders."""
    plain = without_coulomb(name)
    joints = [c for c in plain.coordinates if c.dof is not None]
    sensors: list[dict[str, object]] = [
        {
            "name": f"t_{c.name}",
            "type": "joint_torque",
            "coordinate": c.name,
            "unit": "N m",
            "noise": 1.0,
        }
        for c in joints
    ]
    sensors.append(
        {
            "name": "flange",
            "type": "wrench",
            "element": "tool",
            "position": [0.1, 0.05, 0.02],
            "unit": "N",
            "noise": 0.5,
            "moment_noise": 0.02,
        }
    )
    if encoders:
        sensors += [
            {"name": f"e_{c.name}", "type": "link_encoder", "coordinate": c.name, "unit": "rad"}
            for c in joints
        ]
    no_coulomb = {f"motor.{m.name}.friction.coulomb": 0.0 for m in flexgen.read(name).motors}
    return flexgen.read(
        name,
        overrides={"sensor": sensors, "payload": {"mass": payload}, **no_coulomb, **overrides},
    )


def rubbing() -> RobotModel:
    return sensed("planar5_nmp", True, **{"element.arm1.dof.q1.friction": RUBBING})


def test_derivatives_are_those_of_central_differences() -> None:
    """In springs, dampers, the payload and the friction of a joint, by which torques change
    directly too.
    """
    model = rubbing()
    local = LocalModel(
        model,
        ["stiffness", "damping", "payload.mass", "q1.viscous", "q1.coulomb"],
        channels(model),
    )
    q_m = poses_of(model, 2, spread=0.2) @ model.eta.T
    given = {"speed_sd": np.full(2, 3.0)}
    drive = Drive(5e-4, 2e-4, has_images=False)
    exact = local.response(local.values, q_m, W, drive, **given).dG
    assert exact is not None and exact.shape[2] == 2 + 3 + 6 + 3
    for k, value in enumerate(local.values):
        step = 1e-4 * abs(value)
        up, down = (
            local.response(
                local.values + s * step * (np.arange(len(local.values)) == k),
                q_m,
                W,
                drive,
                **given,
            ).G
            for s in (1.0, -1.0)
        )
        difference = np.abs((up - down) / (2 * step) - exact[..., k]).max(axis=(0, 1, 3))
        scale = np.abs(exact[..., k]).max(axis=(0, 1, 3))
        assert (difference <= 1e-5 * np.maximum(scale, 1e-6 * scale.max())).all(), local.names[k]


def torques_by_springs(
    model: RobotModel, local: LocalModel, G: np.ndarray, q_a: np.ndarray, q_m: np.ndarray
) -> np.ndarray:
    """Responses (lines, 2, n_m) of the torques of the two gears, from those of motors and link
    encoders.
    """
    gear = derive(model).function("gear_torque")
    symbols = [ca.SX.sym(name, n) for name, n in (("q", 3), ("v", 3), ("a", 2), ("b", 2))]
    tau = gear(*symbols)
    slopes = ca.Function("slopes", symbols, [ca.jacobian(tau, x) for x in symbols])
    by_q, by_v, by_m, by_r = (np.array(x) for x in slopes(q_a, np.zeros(3), q_m, np.zeros(2)))
    s = 1j * W[:, None, None]
    names = list(local.outputs.names)
    links = G[:, [2 + names.index(f"e_q{k}") for k in (1, 2, 3)]] / s**2
    motors = G[:, :2] / s**2
    return np.asarray((by_q + s * by_v) @ links + (by_m + s * by_r) @ motors)


@pytest.mark.parametrize("planted", ["", "friction", "masses"])
def test_torques_of_gears_are_those_of_their_springs(
    planted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They follow from the motion of the arm; spring and damper of the gears are the other
    route.
    """
    model = rubbing()
    q_m = poses_of(model, 1, spread=0.2) @ model.eta.T
    speeds = np.full(2, 3.0)
    if planted == "friction":
        monkeypatch.setattr(response_outputs, "is_linear", lambda friction: True)
    local = LocalModel(model, ["payload.mass"], channels(model))
    rest = local.rest(local.values, q_m)
    real = local.outputs.at
    if planted == "masses":
        monkeypatch.setattr(local.outputs, "at", lambda y, dy, p, sd: real(y, dy, 0.5 * p, sd))
    G = local.response(local.values, q_m, W, Drive(), speed_sd=speeds, derivatives=False).G[0]
    expected = torques_by_springs(model, local, G, rest.y[0, :3], q_m[0])
    error = np.abs(G[:, 2:4] - expected).max() / np.abs(expected).max()
    assert error < 1e-10 if not planted else error > 1e-3


def test_measured_responses_are_those_of_the_linear_model() -> None:
    model = sensed("planar5_nmp")
    quiet = replace(
        model, sensors=tuple(replace(x, noise=0.0, moment_noise=None) for x in model.sensors)
    )
    chosen = ["t_q1", "t_q2", "flange.fx", "flange.fy", "flange.mz"]
    plan = flexgen.excite(
        quiet, poses=poses_of(quiet, 1), speed_rms=0.005, f_max=100.0, lines=12, sensors=chosen
    )
    found = flexgen.frf(flexgen.measure(plan, quiet))
    local = LocalModel(quiet, (), found.sensors)
    exact = local.response(
        local.values, found.poses, found.w, Drive(plan.hardware.sample_s), derivatives=False
    ).G
    assert found.outputs == ("m1", "m2", *chosen)
    worst = np.abs(found.G - exact).max(axis=(0, 1, 3)) / np.abs(exact).max(axis=(0, 1, 3))
    assert worst.max() < 2e-3


def test_the_payload_and_springs_are_found(tmp_path: Path) -> None:
    """With torques they are more accurate than with motors alone; errors are as large as
    stated.
    """
    names = ["stiffness", "damping", "payload.mass"]
    truth = sensed(
        "planar5_nmp", payload=23.0, **{"element.arm1.dof.q1.gear.spring.stiffness": 3.2e5}
    )
    model = sensed("planar5_nmp")
    sd = {}
    for sensors in ((), ("t_q1", "t_q2", "flange.fx", "flange.fy", "flange.mz")):
        plan = flexgen.excite(
            model,
            poses=poses_of(model, 2),
            speed_rms=0.02,
            f_max=100.0,
            lines=24,
            hardware=NOISY,
            sensors=sensors,
        )
        found = flexgen.identify(
            model, flexgen.frf(flexgen.measure(plan, truth)), free=names, starts=1
        )
        assert found.status == FitStatus.FITTED, str(found)
        for name, exact in (("payload.mass", 23.0), ("q1.stiffness", 3.2e5)):
            assert abs(np.log(found.values[name] / exact)) < 4 * found.sd[name]
        sd[sensors] = [found.sd[name] for name in ("payload.mass", "q1.stiffness")]
    without, with_torques = sd.values()
    assert (np.array(with_torques) < 0.8 * np.array(without)).all()


@pytest.mark.slow
def test_recordings_have_the_units_of_each_channel(tmp_path: Path) -> None:
    """Torques in N m and forces in kN, of a file that states them."""
    model = sensed("planar5_nmp")
    path = tmp_path / "robot.toml"
    path.write_text(Path(model.file).read_text() + SENSORS)
    robot = replace(model, sensors=flexgen.read(path).sensors, file=str(path))
    plan = flexgen.excite(
        robot, poses=poses_of(robot, 1), speed_rms=0.02, f_max=50.0, lines=8, hardware=NOISY
    )
    moving = tuple(name for name in channels(robot) if name not in ("flange.fz",))
    plan = replace(plan, model=str(path), sensors=moving)
    writer = RecordingWriter(tmp_path / "raw", plan, robot)
    first = flexgen.frf(flexgen.measure(plan, robot, raw=writer))
    written = writer.finish()
    second = flexgen.frf(read_experiment(written))
    assert (
        second.sensors
        == first.sensors
        == ("torque", *(f"flange.{x}" for x in ("fx", "fy", "mx", "my", "mz")))
    )
    assert np.abs(first.G - second.G).max() < 1e-9 * np.abs(first.G).max()
    text = Path(written).read_text()
    assert text.count('unit = "N m"') >= 4
    Path(written).write_text(
        text.replace(
            '"flange.fx"\nname = "s_2"\nunit = "N"', '"flange.fx"\nname = "s_2"\nunit = "kN"'
        )
    )
    third = flexgen.frf(read_experiment(written))
    assert np.abs(third.G[:, :, 3] / second.G[:, :, 3] - 1e3).max() < 1e-6
    Path(written).write_text(
        text.replace(
            '"flange.mx"\nname = "s_4"\nunit = "N m"', '"flange.mx"\nname = "s_4"\nunit = "N"'
        )
    )
    with pytest.raises(ModelError, match=r'given "N", expected one of "N m"'):
        read_experiment(written)
