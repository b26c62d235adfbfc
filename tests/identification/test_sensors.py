"""Sensors of a model file: what they measure, their rows of the linear model, and what is
refused.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from identification_cases import NOISY, poses_of, without_coulomb
from measured_numbers import check_numbers
from shipped_models import elastic_models

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.sensors import sensor_signals
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import with_sensor_delays
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.response_outputs import channels
from flexgen.identification.responses.result import FitStatus
from flexgen.model.elements import RobotModel

W = 2 * np.pi * np.geomspace(1.0, 100.0, 12)
ELASTIC = elastic_models()


def with_sensors(name: str) -> RobotModel:
    """The model with one sensor of each kind."""
    plain = flexgen.read(name)
    last = plain.elements[-1].name
    first = plain.coordinates[0]
    sensors = [
        {
            "name": "acc",
            "type": "accelerometer",
            "element": last,
            "position": [0.1, -0.2, 0.05],
            "unit": "m/s^2",
        },
        {
            "name": "tool_acc",
            "type": "accelerometer",
            "element": "tool",
            "axes": ["z", [1, 1, 0]],
            "unit": "g",
        },
        {"name": "rate", "type": "gyro", "element": last, "unit": "deg/s", "delay_s": 1e-3},
        {"name": "link", "type": "link_encoder", "coordinate": first.name, "unit": first.unit},
        {"name": "seen", "type": "tracker", "position": [0.0, 0.05, 0.1], "unit": "mm"},
    ]
    return flexgen.read(name, overrides={"sensor": sensors})


@pytest.mark.parametrize("name", ELASTIC)
def test_derivatives_of_sensor_rows_are_those_of_central_differences(name: str) -> None:
    model = with_sensors(name)
    local = LocalModel(model, ["stiffness", "damping", "payload.mass"], channels(model))
    # a payload of a gram does not feel a step of 1e-4 of it
    sizes = [1.0 if name == "payload.mass" else 1e-3 for name in local.names]
    values = np.where(local.values == 0, sizes, local.values)
    q_m = poses_of(model, 2, spread=0.2) @ model.eta.T
    drive = Drive(5e-4, 2e-4, has_images=False)
    exact = local.response(values, q_m, W, drive).dG
    assert exact is not None and exact.shape[2] == model.n_m + 12
    for k, value in enumerate(values):
        step = 1e-4 * abs(value)
        up, down = (
            local.response(
                values + s * step * (np.arange(len(values)) == k), q_m, W, drive, derivatives=False
            ).G
            for s in (1.0, -1.0)
        )
        numeric = (up - down) / (2 * step)
        difference, scale = (
            np.abs(x).max(axis=(0, 1, 3)) for x in (numeric - exact[..., k], exact[..., k])
        )
        starts = np.cumsum([0, model.n_m, 3, 2, 3, 1])  # of the outputs of one kind
        worst, largest = (np.maximum.reduceat(x, starts) for x in (difference, scale))
        least = 1e-6 * scale.max()  # an output that does not feel the parameter shows rounding
        assert (worst <= 1e-5 * np.maximum(largest, least)).all()


def test_a_row_that_does_not_move_with_the_pose_is_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The tilt of an accelerometer changes with the deflections at rest."""
    model = with_sensors("manutec_r3_18")
    local = LocalModel(model, ["payload.mass"], channels(model))
    q_m = poses_of(model, 1, spread=0.2) @ model.eta.T
    exact = local.response(local.values, q_m, W, Drive()).dG
    real = local.outputs.at
    monkeypatch.setattr(local.outputs, "at", lambda *given: (real(*given)[0], 0 * real(*given)[1]))
    without = local.response(local.values, q_m, W, Drive()).dG
    assert exact is not None and without is not None
    difference = np.abs(exact - without)[0, :, model.n_m :].max()
    assert difference > 1e-4 * np.abs(exact[0, :, model.n_m :]).max()


@pytest.mark.parametrize("name", ["planar5_nmp", "manutec_r3_18", "beam_arm"])
def test_what_sensors_measure_along_a_motion(name: str) -> None:
    """Against differences of the positions of points that the kinematics gives, a second route to
    each signal.
    """
    model = with_sensors(name)
    equations = derive(model)
    y, dy, ddy = equations.y
    signals = ca.Function("signals", [y, dy, ddy], [sensor_signals(equations)])
    rng = np.random.default_rng(3)
    n = model.dof
    n_a = model.n_a
    q0, v, a = rng.normal(size=(3, n)) * np.array([[0.3], [0.5], [2.0]])
    found = np.array(signals(q0, v, a)).ravel()

    def tool(t: float) -> tuple[np.ndarray, np.ndarray]:
        p, R = equations.function("forward_kinematics")((q0 + v * t + a * t * t / 2)[:n_a])
        return np.array(p).ravel(), np.array(R)

    h = 1e-3  # five points: the error is of order h^4
    p, R = zip(*[tool(k * h) for k in (-2, -1, 0, 1, 2)], strict=True)
    second = np.array([-1, 16, -30, 16, -1]) / (12 * h * h)
    force = R[2].T @ (second @ np.array(p) - np.array(model.gravity))
    assert found[3:5] == pytest.approx([force[2], (force[0] + force[1]) / np.sqrt(2)], abs=1e-4)
    # The point of the tracker is fixed in the tool.
    assert found[9:12] == pytest.approx(p[2] + R[2] @ [0.0, 0.05, 0.1], abs=1e-12)
    assert found[8] == q0[0]


def test_a_robot_at_rest_feels_gravity_upwards() -> None:
    model = with_sensors("manutec_r3_18")
    equations = derive(model)
    signals = ca.Function("signals", [*equations.y], [sensor_signals(equations)])
    still = np.array(signals(*np.zeros((3, model.dof)))).ravel()
    assert np.linalg.norm(still[:3]) == pytest.approx(np.linalg.norm(model.gravity), rel=1e-12)


BAD = [
    ({"type": "accelerometer", "element": "no", "unit": "m/s^2"}, "sensor.s.element"),
    ({"type": "accelerometer", "element": "tool"}, "sensor.s.unit"),
    ({"type": "gyro", "element": "tool", "unit": "m/s^2"}, "sensor.s.unit"),
    ({"type": "link_encoder", "unit": "rad"}, "sensor.s.coordinate"),
    ({"type": "link_encoder", "coordinate": "q1", "unit": "m"}, "sensor.s.unit"),
    ({"type": "tracker", "unit": "m", "element": "no"}, "sensor.s.element"),
    ({"type": "tracker", "unit": "m", "axes": []}, "sensor.s.axes"),
    ({"type": "tracker", "unit": "m", "axes": ["x", "x"]}, "sensor.s.axes"),
    ({"type": "tracker", "unit": "m", "axes": [[0, 0, 0]]}, "sensor.s.axes"),
    ({"type": "tracker", "unit": "m", "axes": [[1, 2]]}, "sensor.s.axes"),
    ({"type": "tracker", "unit": "m", "noise": -1.0}, "sensor.s.noise"),
    ({"type": "tracker", "unit": "m", "sample_s": 0.0}, "sensor.s.sample_s"),
    ({"type": "radar", "unit": "m"}, "sensor.s.type"),
]


def test_identified_delays_are_those_of_their_sensors() -> None:
    model = planar()
    found = with_sensor_delays(model, {"rate.delay": 3e-3, "m1.delay": 9.0})
    assert [sensor.delay_s for sensor in found.sensors] == [
        0.0,
        3e-3,
        1e-3,
    ] and with_sensor_delays(model, {}) is model


@pytest.mark.parametrize(("entries", "key"), BAD)
def test_bad_sensors_are_refused(entries: dict[str, object], key: str) -> None:
    with pytest.raises(ModelError, match=key.replace(".", r"\.")):
        flexgen.read("planar5_nmp", overrides={"sensor": [{"name": "s", **entries}]})


# --- experiments ---------------------------------------------------------------------------------

TOOL = [
    {
        "name": "acc",
        "type": "accelerometer",
        "element": "tool",
        "unit": "m/s^2",
        "axes": ["x", "y"],
        "noise": 0.02,
    },
    {
        "name": "rate",
        "type": "gyro",
        "element": "tool",
        "unit": "rad/s",
        "axes": ["z"],
        "noise": 1e-4,
    },
    {
        "name": "seen",
        "type": "tracker",
        "unit": "m",
        "axes": ["x"],
        "noise": 1e-5,
        "sample_s": 2e-3,
        "delay_s": 1e-3,
    },
]


def planar(quiet: bool = False) -> RobotModel:
    sensors = flexgen.read("planar5_nmp", overrides={"sensor": TOOL}).sensors
    used = tuple(replace(sensor, noise=0.0) for sensor in sensors) if quiet else sensors
    return replace(without_coulomb("planar5_nmp"), sensors=used)


@pytest.mark.slow
def test_measured_responses_of_sensors_are_those_of_the_linear_model() -> None:
    model = planar(quiet=True)
    plan = flexgen.excite(model, poses=poses_of(model, 2), speed_rms=0.005, f_max=100.0)
    experiment = flexgen.measure(plan, model)
    assert Experiment.from_data(*experiment.data()).orders == experiment.orders == (0, 0, 1, 2)
    found = flexgen.frf(experiment)
    local = LocalModel(model, (), found.sensors)
    exact = local.response(
        local.values, found.poses, found.w, Drive(plan.hardware.sample_s), derivatives=False
    ).G
    assert found.outputs == ("m1", "m2", "acc.x", "acc.y", "rate.z", "seen.x")
    assert np.median(np.abs(found.G / exact - 1)) < 1e-4
    worst = np.abs(found.G - exact).max(axis=(0, 1, 3)) / np.abs(exact).max(axis=(0, 1, 3))
    assert worst.max() < 2e-3
    # Planted: the delay of the tracker forgotten.
    late = replace(model, sensors=(*model.sensors[:2], replace(model.sensors[2], delay_s=0.0)))
    wrong = LocalModel(late, (), found.sensors)
    without = wrong.response(wrong.values, found.poses, found.w, Drive(5e-4), derivatives=False).G
    assert np.abs(found.G - without)[:, :, 5].max() > 0.1 * np.abs(exact[:, :, 5]).max()


@pytest.mark.slow
def test_sensors_make_parameters_more_accurate_by_as_much_as_predicted(tmp_path: Path) -> None:
    model = planar()
    errors = {}
    predicted = {}
    for sensors in ((), None):
        plan = flexgen.excite(
            model,
            poses=poses_of(model, 2),
            speed_rms=0.02,
            f_max=100.0,
            hardware=NOISY,
            sensors=sensors,
        )
        chain = []
        for seed in range(4):
            data = flexgen.frf(flexgen.measure(plan, model, seed=seed))
            found = flexgen.identify(model, Frf.load(data.save(tmp_path / "frf.npz")), starts=1)
            assert found.status == FitStatus.FITTED and found.weights == "structured"
            truth = {u.name: u.parameter.value for u in found.vector.unknowns}
            chain.append([np.log(found.values[n] / truth[n]) / found.sd[n] for n in truth])
        errors[sensors] = np.sqrt(np.mean(np.square(chain)))
        predicted[sensors] = np.sqrt(np.mean(np.square(list(plan.predicted.values()))))
        assert 0.6 < errors[sensors] < 1.5  # 4 chains of 7 parameters
        achieved = np.sqrt(np.mean(np.square([found.sd[n] for n in truth])))
        assert achieved == pytest.approx(predicted[sensors], rel=0.3)
    assert predicted[None] < 0.8 * predicted[()]


@pytest.mark.slow
def test_recordings_with_sensors_are_those_of_the_experiment(tmp_path: Path) -> None:
    model = planar()
    plan = flexgen.excite(
        model, poses=poses_of(model, 1), speed_rms=0.02, f_max=100.0, hardware=NOISY
    )
    path = tmp_path / "robot.toml"
    text = Path(model.file).read_text()
    for sensor in TOOL[:2]:
        rows = "\n".join(f"{key} = {json.dumps(value)}" for key, value in sensor.items())
        text += f"\n[[sensor]]\n{rows}\n"
    path.write_text(text)
    robot = replace(model, sensors=flexgen.read(path).sensors, file=str(path))
    plan = replace(plan, model=str(path), sensors=channels(robot))
    writer = RecordingWriter(tmp_path / "raw", plan, robot)
    first = flexgen.frf(flexgen.measure(plan, robot, raw=writer))
    second = flexgen.frf(read_experiment(writer.finish()))
    assert second.sensors == first.sensors and second.orders == first.orders == (0, 0, 1)
    check_numbers("sensors", plan=plan, first=first)
    assert np.abs(first.G - second.G).max() < 1e-9 * np.abs(first.G).max()


def saved_with_sensors(path: Path, delays: dict[str, float]) -> RobotModel:
    """planar5_nmp in a file of its own whose sensors state these delays."""
    text = Path(flexgen.read("planar5_nmp").file).read_text()
    for sensor in TOOL:
        rows = {**sensor, "delay_s": delays[str(sensor["name"])]}
        text += "\n[[sensor]]\n" + "".join(
            f"{key} = {json.dumps(value)}\n" for key, value in rows.items()
        )
    path.write_text(text)
    return replace(
        without_coulomb("planar5_nmp"), sensors=flexgen.read(path).sensors, file=str(path)
    )


@pytest.mark.slow
def test_delays_of_sensors_are_found_within_their_deviations(tmp_path: Path) -> None:
    """Simulated in time with delays that the model file does not state; without them the fit is a
    model error.
    """
    late = {"acc": 5e-4, "rate": 0.0, "seen": 1.5e-3}
    truth = saved_with_sensors(tmp_path / "truth.toml", late)
    model = saved_with_sensors(tmp_path / "robot.toml", {"acc": 0.0, "rate": 0.0, "seen": 1e-3})
    scores = []
    for seed in range(3):
        plan = flexgen.excite(
            model,
            poses=poses_of(model, 2),
            speed_rms=0.02,
            f_max=100.0,
            hardware=NOISY,
            lines=30,
            period_s=2.0,
        )
        data = flexgen.frf(flexgen.measure(plan, truth, seed=seed))
        found = flexgen.identify(
            model, data, free=["stiffness", "damping", "sensor_delay"], starts=1
        )
        assert found.status == FitStatus.FITTED
        for name, exact in late.items():
            sd = found.sd[f"{name}.delay"]
            assert sd is not None and sd < 2e-5
            scores.append((found.values[f"{name}.delay"] - exact) / sd)
    # nine numbers
    assert np.abs(scores).max() < 4 and 0.4 < np.sqrt(np.mean(np.square(scores))) < 2
    fixed = flexgen.identify(model, data, free=["stiffness", "damping"], starts=1)
    assert fixed.status == FitStatus.MODEL_ERROR
    text = found.write(tmp_path / "new.toml").read_text()
    again = {sensor.name: sensor.delay_s for sensor in flexgen.read(tmp_path / "new.toml").sensors}
    assert (
        again["seen"] == found.values["seen.delay"] == found.model.sensors[2].delay_s
        and "seen.delay: sd " in text
    )


def test_a_delay_of_a_sensor_that_is_not_there_is_refused() -> None:
    model = planar()
    plan = flexgen.excite(
        model, poses=poses_of(model, 1), speed_rms=0.02, f_max=100.0, sensors=["acc.x"]
    )
    data = flexgen.frf(flexgen.measure(plan, model))
    with pytest.raises(
        ArgumentError, match=r"free: given 'nose\.delay', expected one of acc\.delay, rate\.delay"
    ):
        flexgen.identify(model, data, free=["stiffness", "nose.delay"])
    with pytest.raises(
        ArgumentError, match=r"free: given 'seen\.delay', expected a sensor of the data: acc"
    ):
        flexgen.identify(model, data, free=["stiffness", "seen.delay"])
    with pytest.raises(ArgumentError, match="expected no delay: the model file has no"):
        flexgen.identify(without_coulomb("planar5_nmp"), data, free=["sensor_delay"])


def test_sensors_that_do_not_fit_are_refused() -> None:
    model = planar()
    plan = flexgen.excite(model, poses=poses_of(model, 1), speed_rms=0.02, f_max=100.0)
    with pytest.raises(
        ArgumentError, match=r"sensor channel: given 'nose', expected one of acc\.x"
    ):
        flexgen.excite(model, poses=poses_of(model, 1), sensors=["nose"])
    slow = replace(model, sensors=(replace(model.sensors[2], sample_s=7e-4),))
    with pytest.raises(
        ArgumentError, match=r"seen\.x: given sample_s = 0\.0007 s, expected a multiple"
    ):
        flexgen.measure(replace(plan, sensors=("seen.x",)), slow)
    slower = replace(model, sensors=(replace(model.sensors[2], sample_s=0.05),))
    with pytest.raises(ArgumentError, match="less than half a period of the highest frequency"):
        flexgen.measure(replace(plan, sensors=("seen.x",)), slower)
    with pytest.raises(ArgumentError, match="expected none: the model file has no"):
        flexgen.measure(plan, without_coulomb("planar5_nmp"))
    still = replace(
        model,
        sensors=(replace(model.sensors[1], axes=((1.0, 0.0, 0.0),), labels=("x",), noise=0.0),),
    )
    with pytest.raises(ArgumentError, match=r"the sensor channels rate\.x do not move"):
        flexgen.frf(flexgen.measure(replace(plan, sensors=("rate.x",)), still))
