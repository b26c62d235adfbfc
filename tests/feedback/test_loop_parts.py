"""Parts of a closed loop: gains, laws step by step, channels, hardware, references, and errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from law_cases import arm, at_rest, case_of, solution_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import eigh
from scipy.signal import cont2discrete
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop import interface, named_controllers, python_files
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.closed_loop import ClosedLoop, integration_steps
from flexgen.feedback.loop.controller_files import system_controller
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.gains import PID, PPI, motor_inertias
from flexgen.feedback.loop.hardware import DriveHardware, SensorChannels
from flexgen.feedback.loop.interface import Measurement, PythonController, Reference, Setup
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.reference import MotionReference, time_grid
from flexgen.feedback.loop.robots_in_c import seeds_of
from flexgen.feedback.loop.timing import Timing
from flexgen.model.position_servo.filters import LowPass, Notch

pytestmark = needs_compiler
NONE = np.zeros(0)
ELBOW = flexgen.read("elbow")


def planned(q_m: float, tau: float = 0.0, *sensors: float) -> Reference:
    return Reference(np.array([q_m]), np.array(sensors), np.array([tau]), NONE, NONE, NONE)


def measured(q_m: float, *sensors: float) -> Measurement:
    return Measurement(np.array([q_m]), np.array(sensors))


# --- laws ----------------------------------------------------------------------------------------
def test_a_cascade_stops_its_integral_at_the_torque_limit() -> None:
    law = Cascade(np.array([10.0]), np.array([0.5]), np.array([4.0]), (), np.array([3.0]))
    law.begin(0.01).reset()
    assert law.step(0, measured(0.0), planned(0.0, 1.0))[0] == pytest.approx(1.0)
    last = np.zeros(3)
    # motor, reference, torque; the second one is above the limit, so its part is not kept
    samples = (((0.005, 0.02, 0.0), True), ((0.006, 0.05, 2.0), False), ((0.006, 0.05, 0.0), True))
    for (q, ref, tau), kept in samples:
        w = (ref - last[1]) / 0.01 + 10 * (ref - q) - (q - last[0]) / 0.01
        expected = tau + 0.5 * (w + 4 * (last[2] + w * 0.01))
        found = law.step(1, measured(q), planned(ref, tau))[0]
        assert found == pytest.approx(expected) and (abs(found) <= 3.0) == kept
        last[:] = q, ref, last[2] + kept * w * 0.01
    law.reset()
    assert law.step(0, measured(0.3), planned(0.3))[0] == 0.0


def test_parts_of_a_linear_controller_follow_each_other() -> None:
    rng = np.random.default_rng(1)
    A, B, C, D = (rng.normal(size=(2, *shape)) for shape in ((1, 1), (1, 2), (1, 1), (1, 2)))
    law = Linear(A, B, C, D, 2)
    law.reset()
    z = np.zeros(1)
    for k in range(6):
        e = rng.normal(size=2)
        p = min(k // 2, 1)
        u = law.step(k, measured(1.0, 2.0), planned(1.0 + e[0], 7.0, 2.0 + e[1]))
        assert u == pytest.approx(7.0 + C[p] @ z + D[p] @ e)
        z = A[p] @ z + B[p] @ e


def test_gains_of_a_pid_are_those_of_its_cascade() -> None:
    k_p, k_i, k_d = np.array([[10.0, 6.0], [12.5, 0.0], [2.0, 3.0]])
    found = PID(k_p, k_i, k_d).cascade()
    assert_allclose(found.position_gain + found.integral_gain, k_p / k_d)
    assert_allclose(found.position_gain * found.integral_gain, k_i / k_d)
    assert_array_equal(found.speed_gain, k_d)
    assert (found.position_gain >= found.integral_gain).all()


def test_gains_by_frequencies() -> None:
    """Speed gains by the inertia of stiff gears, at most 0.3 of the rotor's by the delay; the
    frequencies that are not given are below the lowest one with locked motors.
    """
    motion = at_rest(ELBOW)
    stiff, soft = motor_inertias(ELBOW, motion)
    M = np.array(derive(ELBOW).function("mass_matrix")(motion[0][0]))
    back = np.linalg.inv(ELBOW.eta)
    rotor = np.array([m.inertia for m in ELBOW.motors])
    assert_allclose(stiff, np.diag(back.T @ M @ back) + rotor, rtol=1e-6)
    assert_allclose(soft, rotor, rtol=1e-6)
    found = PPI(2.0, 5.0, 0.5).cascade(ELBOW, 1e-3, motion)
    assert_allclose(found.position_gain, 4 * np.pi)
    assert_allclose(found.integral_gain, np.pi)
    assert_allclose(found.speed_gain, np.minimum(10 * np.pi * stiff, 0.3 * soft / 1e-3))
    assert_allclose(PPI(2.0, 1e5, 0.5).cascade(ELBOW, 0.5, motion).speed_gain, 0.6 * soft)
    assert_array_equal(found.torque_max, [m.torque_max or 0.0 for m in ELBOW.motors])
    K = np.diag([e.dofs[0].gear.spring.stiffness for e in ELBOW.elements])
    lowest = np.sqrt(eigh(K, M, eigvals_only=True)[0]) / (2 * np.pi)
    part = PPI(speed_hz=7.0).frequencies(ELBOW, motion)
    ratios = [part["position_hz"] / lowest, part["speed_hz"], part["integral_hz"] / lowest]
    assert ratios == pytest.approx([0.5, 7.0, 0.1], rel=1e-2)


def test_systems_of_python_control_are_sampled_by_the_trapezoidal_rule() -> None:
    rng = np.random.default_rng(5)
    A, B, C, D = (rng.normal(size=shape) for shape in ((2, 2), (2, 3), (1, 2), (1, 3)))
    for dt in (0, None, 0.1, True):
        found = system_controller(SimpleNamespace(A=A, B=B, C=C, D=D, dt=dt), 0.1)
        own = (A, B, C, D)
        own = cont2discrete(own, 0.1, "bilinear")[:4] if dt in (0, None) else own
        assert all(np.allclose(x[0], y) for x, y in zip(found.matrices, own, strict=True))
        none = SimpleNamespace(A=np.zeros((0, 0)), B=[], C=[], D=2.0, dt=dt)
        shapes = [x.shape[1:] for x in system_controller(none, 0.1).matrices]
        assert shapes == [(0, 0), (0, 1), (1, 0), (1, 1)]


# --- controllers by name, file or object ---------------------------------------------------------
class Law:
    """A law of another package."""

    def reset(self) -> None:
        """Nothing."""

    def step(self, k: int, y: Any, ref: Any) -> Any:
        """No torque."""
        return 0.0


def test_controllers_by_name_or_object() -> None:
    """With the title that results have, and the speed that sample time and delay leave."""
    motion = at_rest(ELBOW)

    def made(given: Any, h: float = 1e-3, model: Any = ELBOW) -> tuple[Any, str]:
        return named_controllers.controller_of(given, model, h, 0.5 * h, motion)

    hz = PPI().frequencies(ELBOW, motion)
    shown = "/".join(f"{x:.3g}" for x in hz.values())
    assert made("ppi", 1e-6)[1] == made(PPI(), 1e-6)[1] == f"ppi {shown} Hz"
    used = PPI().speeds_in_use(ELBOW, 3e-3, motion)
    law, name = made("ppi", 2e-3)
    assert_allclose(law.speed_gain, PPI().cascade(ELBOW, 3e-3, motion).speed_gain)
    assert_allclose(used, law.speed_gain / (2 * np.pi * motor_inertias(ELBOW, motion)[0]))
    assert name == (
        f"ppi {hz['position_hz']:.3g}/{used.min():.3g} to {used.max():.3g}/"
        f"{hz['integral_hz']:.3g} Hz (position/speed/integral; speed cut from "
        f"{hz['speed_hz']:.3g} Hz, because sample time and delay are 3 ms)"
    )
    law, name = made("ppi_notch")
    lowest = hz["position_hz"] / 0.5
    (notch,) = law.filters
    assert tuple(vars(notch).values()) == (pytest.approx(lowest), 0.3, 0.9)
    assert name == f"ppi with a notch at {lowest:.3g} Hz"
    nothing, name = made("none")
    assert name == "feedforward only"
    assert isinstance(nothing, named_controllers.FeedforwardOnly)
    fixed = Cascade(np.ones(2), np.ones(2), np.zeros(2))
    assert made(fixed) == (fixed, "Cascade")
    assert isinstance(made(Law())[0], PythonController) and made(Law())[1] == "Law"
    pid, name = made(PID(np.ones(2), np.zeros(2), np.ones(2)))
    assert (type(pid), name) == (Cascade, "PID")
    assert made(SimpleNamespace(A=[], B=[], C=[], D=np.eye(2), dt=0))[1] == "state space"
    assert made("lqg")[1] == "lqg"


TWO = """
class Own:
    def step(self): return 2

class Other:
    def __init__(self, number): self.number = number
    def step(self): return 3

class Plain: pass
from collections import OrderedDict
"""


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        (TWO, "", "given 2 classes with step(), expected one, or its name: FILE:Class"),
        (TWO, ":Plain", "given no class 'Plain' with step(), expected one of Own, Other"),
        (TWO, ":Other", "Other(): TypeError: "),
        ("class Plain: pass\n", ":A", "given no class 'A' with step(), expected one of none"),
        ("1 / 0\n", "", "ZeroDivisionError while it was loaded: division by zero"),
    ],
)
def test_python_files_without_the_class_are_refused(
    tmp_path: Path, text: str, name: str, said: str
) -> None:
    file = tmp_path / "law.py"
    file.write_text(text)
    with pytest.raises(ArgumentError) as refused:
        python_files.object_of_file(f"{file}{name}")
    assert said.replace("FILE", str(file)) in str(refused.value)


def test_classes_of_a_python_file(tmp_path: Path) -> None:
    """The one that is named, or the only one with ``step`` that the file itself defines."""
    found = [python_files.is_python(x) for x in ("a.py", "a.py:B", "a.pyx", "a.so")]
    assert found == [True, True, False, False]
    file = tmp_path / "two.py"
    file.write_text(TWO)
    assert python_files.object_of_file(f"{file}:Own").step() == 2
    file.write_text(TWO.partition("class Other")[0])
    assert python_files.object_of_file(str(file)).step() == 2


@pytest.mark.parametrize(
    ("returned", "expected"),
    [
        ([1, 2], [1.0, 2.0]),
        (np.arange(4.0)[::2], [0.0, 2.0]),
        ([1.0], "returned shape (1,), expected (2,)"),
        ([1.0, np.nan], "returned [ 1. nan], expected finite torques"),
        ("x", "raised ValueError: could not convert string to float: 'x'"),
    ],
)
def test_steps_of_a_controller_of_a_user_are_checked(returned: Any, expected: Any) -> None:
    own = SimpleNamespace(step=lambda k, y, ref: returned if (k, y, ref) == (7, 1, 2) else None)
    found = interface.check_step(own, 7, 1, 2, 2)  # type: ignore[arg-type]
    assert (found if isinstance(found, str) else found.tolist()) == expected


def test_a_step_that_is_slow_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 0.0, 1.005])
    monkeypatch.setattr(interface, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    own = SimpleNamespace(step=lambda k, y, ref: [0.0])
    none: Any = None
    assert not isinstance(interface.check_step(own, 0, none, none, 1), str)
    said = interface.check_step(own, 0, none, none, 1)
    assert said == "took 1.00 s, expected less than 1.0 s"


# --- channels and hardware -----------------------------------------------------------------------
def test_channels_by_name_with_their_noises() -> None:
    """Of the robot's sensors by sensor or channel, and of sensors that every robot may have; their
    noises by channel, sensor or group.
    """
    axes = channels_of(ELBOW, "tool_accelerometer").model.sensors[0]
    own = replace(axes, name="acc")
    model = replace(ELBOW, sensors=(own,))
    n = len(own.channels)
    found = channels_of(model, ("motors", "acc"), {"motors": 2e-4, own.channels[0]: 0.7})
    assert found.names == ("m1", "m2", *own.channels)
    assert found.index.tolist() == list(range(2 + n))
    assert_allclose(found.noise, [2e-4, 2e-4, 0.7, *[own.noise] * (n - 1)])
    assert_allclose(channels_of(model, "acc", {"acc": 0.3}).noise, 0.3)
    found = channels_of(model, (own.channels[-1], "m2"))
    assert found.index.tolist() == [1 + n, 1] and found.noise.tolist() == [own.noise, 1e-4]
    assert channels_of(model, "motors", 3e-4).noise.tolist() == [3e-4, 3e-4]
    virtual = channels_of(model, ("tool_accelerometer", "tool_gyro", "link_encoders"))
    assert virtual.accelerating and not channels_of(model, ("tool_gyro", "m1")).accelerating
    assert virtual.noise.tolist() == [0.05] * 3 + [1e-3] * 3 + [1e-5] * 2
    assert virtual.index.tolist() == list(range(2, 10))
    kinds = [(s.type, s.place, s.unit) for s in virtual.model.sensors]
    assert kinds == [
        ("accelerometer", "tool", "m/s^2"),
        ("gyro", "tool", "rad/s"),
        ("link_encoder", "q1", "rad"),
        ("link_encoder", "q2", "rad"),
    ]
    encoders = channels_of(model, "link_encoders", {"link_encoders": 4e-5})
    assert encoders.noise.tolist() == [4e-5] * 2


@pytest.mark.parametrize(
    ("hardware", "rate", "steps"),
    [
        (DriveHardware(1e-3), 900.0, 1),
        (DriveHardware(1e-3), 3100.0, 4),
        (DriveHardware(1e-3, 0.4e-3), 1900.0, 5),
        (DriveHardware(1e-3, 0.5e-3), 2900.0, 4),
        (
            DriveHardware(1e-3, 1e-3 / np.pi),
            10.0,
            1 + int(np.argmin([abs(round(k / np.pi) / k - 1 / np.pi) for k in range(1, 65)])),
        ),
    ],
)
def test_steps_of_the_integration_make_the_delay_whole(
    hardware: DriveHardware, rate: float, steps: int
) -> None:
    assert integration_steps(hardware, rate) == steps


def test_hardware_of_a_model_has_its_limits() -> None:
    curve = ((0.0, 4.0), (100.0, 3.0))
    motors = [replace(m, torque_max=x) for m, x in zip(ELBOW.motors, (None, 4.0), strict=True)]
    model = replace(ELBOW, motors=(replace(motors[0], torque_speed=curve), motors[1]))
    found = DriveHardware.from_model(model, sample_s=1.0)
    assert found == DriveHardware(1.0, torque_max_Nm=(0.0, 4.0), torque_speed=(curve, ()))
    lists = DriveHardware(torque_speed=[list(map(list, curve)), []])
    assert lists.torque_speed == (curve, ())


def test_seeds_are_those_of_split_mix() -> None:
    """The published sequence of SplitMix64 for seed 1234567, whose state the first number
    shifts.
    """

    def numbers(state: int, count: int) -> list[int]:
        out = []
        mask = 2**64 - 1
        for _ in range(count):
            state = (state + 0x9E3779B97F4A7C15) & mask
            z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & mask
            z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
            out.append(z ^ (z >> 31))
        return out

    assert numbers(1234567, 3) == [6457827717110365317, 3203168211198807973, 9817491932198370423]
    start = (5 * 0x9E3779B97F4A7C15 + 0x2545F4914F6CDD1D) % 2**64
    assert seeds_of(5, 2).ravel().tolist() == numbers(start, 8)


# --- references ----------------------------------------------------------------------------------
@pytest.mark.parametrize("exact", [True, False])
def test_the_planned_motion_of_a_law_rests_outside_the_trajectory(exact: bool) -> None:
    """Cubic joints: values and derivatives in closed form, also where they are asked ahead."""
    t = np.linspace(0.2, 1.2, 101)[:, None]
    scale = np.array([1.0, -2.0, 0.5])
    rows = {"q": t**3 * scale, "v": 3 * t**2 * scale, "a": 6 * t * scale}
    channels = {f"{x}_{end}": y for x, y in rows.items() for end in "am"} | {"tau_m": rows["q"]}
    ports = {name: Port(name, (3,), "", "") for name in channels}
    labels = dict.fromkeys(channels, ("1", "2", "3"))
    motion = case_of(arm(damped=False), 1e-2, exact_state=exact).law_motion()
    time = np.array([0.0, 0.2, 0.5, 1.2, 1.4])
    reference = replace(motion.reference, time=time)
    made = replace(
        motion, trajectory=Trajectory(t[:, 0], channels, ports, labels), reference=reference
    )
    at = time + 0.1
    inside = np.clip(at, 0.2, 1.2)
    moving = (at >= 0.2) & (at <= 1.2)
    rates = (3 * at**2, 6 * at, 6 + 0 * at, 0 * at)
    expected = np.stack([inside**3, *(np.where(moving, x, 0.0) for x in rates)], axis=1)
    assert_allclose(made.arm(0.1), expected[:, :, None] * scale, atol=1e-6)
    q, v = made.motors()[:, :, 1].T
    assert_allclose(q, -2 * np.clip(time, 0.2, 1.2) ** 3, atol=1e-6)
    assert_allclose(v, np.where((time >= 0.2) & (time <= 1.2), -6 * time**2, 0), atol=1e-6)
    x = np.random.default_rng(0).normal(size=(4, 3, 2))
    wanted = x.copy()
    if not exact:
        wanted[:, 1] = np.r_[[[0.0, 0.0]], np.diff(x[:, 0], axis=0) / 1e-2]
    assert_allclose(made.difference(x), wanted)
    n_s = sum(len(s.channels) for s in made.model.sensors)
    assert made.state_channel == (3 + n_s if exact else -1)
    links = made.link_channels("x")
    assert links is None if exact else links is not None
    assert replace(made, delay_s=0.02).timing(True) == Timing(1e-2, 0.02, True, not exact)


def test_samples_around_a_motion_and_their_parts() -> None:
    time = time_grid(-0.1, 0.25, 0.1, 0.15, 0.2)
    assert_allclose(time, -0.1 + 0.1 * np.arange(-2, 7))
    rng = np.random.default_rng(1)
    names = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
    m = {name: rng.normal(size=(9, 2)) for name in names}
    held = rng.normal(size=(9, 2))
    y = rng.normal(size=(9, 3))
    made = MotionReference(time, m, held, y, np.zeros((9, 2)), None, -0.1, 0.25, 0.2)
    for name, part in zip(names, made.parts(4), strict=True):
        assert_array_equal(part, m[name][[2, 6, 8]])
    tail = [held, m["v_m"], m["q_a"], m["v_a"]]
    assert_array_equal(made.rows(), np.hstack([m["q_m"], y, *tail]))
    state = [m["q_a"], m["v_a"], m["q_m"], m["v_m"]]
    assert_array_equal(made.rows(True), np.hstack([m["q_m"], y, *state, *tail]))


# --- what is refused -----------------------------------------------------------------------------
def loop(**changes: Any) -> ClosedLoop:
    """A loop of three elbows without feedback."""
    usual: dict[str, Any] = {
        "model": ELBOW,
        "library": library_with(ELBOW, ("forward_dynamics", "forward_dynamics_tool_force")),
        "hardware": DriveHardware(1e-3),
        "controller": named_controllers.FeedforwardOnly(),
        "q_a": np.zeros((3, 2)),
        "q_m": np.zeros((3, 2)),
        "rate": 1000.0,
    }
    return ClosedLoop(**usual | changes)


def run(shape: tuple[int, ...], value: float = 0.0) -> Any:
    made = loop(steps=2)
    reference = np.zeros((1, 3, made.setup.n_ref))
    return made.run(reference, 5, disturbances=np.full(shape, value))


def pid(**changes: Any) -> Any:
    gains = {"k_p": np.array([10.0]), "k_i": np.array([0.0]), "k_d": np.array([2.0])}
    return PID(**gains | changes).cascade()


def linear(**changes: Any) -> Any:
    none = {name: np.zeros((1, 1)) for name in "ABCD"}
    return Linear(**none | changes)


def cascade(**changes: Any) -> Any:
    ones = dict.fromkeys(("position_gain", "speed_gain", "integral_gain"), np.ones(2))
    return Cascade(**ones | changes).compiled(Setup(np.zeros((3, 2)), 1e-3, 2, 4, 8))


def channels(*names: Any, noise: Any = None) -> Any:
    return channels_of(ELBOW, names, noise)


def sensor(**changes: Any) -> Any:
    own = {"name": "a", "type": "gyro", "element": "tool", "unit": "rad/s", "noise": 0.1}
    model = flexgen.read("elbow", overrides={"sensor": [own | changes]})
    solution = solution_of(ELBOW)
    return flexgen.control(model, controller="none", solution=solution, sample_time=1e-3)


def signals(part: int) -> SensorChannels:
    parts = [np.zeros(1) for _ in range(4)]
    parts[part] = -np.ones(1)
    return SensorChannels(*parts)


def links(model: Any) -> Any:
    return replace(
        case_of(arm(damped=False), 1e-2, exact_state=False).law_motion(), model=model
    ).link_channels("x")


REFUSED: list[tuple[Callable[[], Any], str]] = [
    (lambda: pid(k_i=np.array([13.0])), r"k_i: given \[13\.\], expected at most .* = \[12\.5\]"),
    (lambda: pid(k_d=np.array([0.0])), r"k_d: given \[0\.\], expected gains > 0"),
    (lambda: linear(samples=0), "samples: given 0, expected a whole number >= 1"),
    (lambda: linear(A=np.ones(3)), "A: given .*, expected finite numbers, shape"),
    (lambda: linear(D=np.array([[np.nan]])), "D: given"),
    (lambda: PPI(position_hz=-1.0), "position_hz: given -1.0, expected 0 to 1e5 Hz"),
    (lambda: PPI(speed_hz=1.1e5), "speed_hz: given 110000.0"),
    (lambda: PPI(filters=3), "filters: given 3, expected filters"),  # type: ignore[arg-type]
    (lambda: LowPass(250.0).section(2e-3), "given 250.0 Hz, expected more than 0 and less than"),
    (lambda: Notch(0.0).section(2e-3), "given 0.0 Hz, expected more than 0 and less than 250 Hz"),
    *(
        (lambda name=name, x=x: cascade(**{name: x}), f"{name}: given .*, expected 2 finite num")
        for name in ("position_gain", "speed_gain", "integral_gain", "torque_max")
        for x in (np.ones(3), np.ones((2, 2)), np.full(2, np.inf))
    ),
    (
        lambda: system_controller(SimpleNamespace(A=[], B=[], C=[], D=1.0, dt=0.2), 0.1),
        r"given a system with dt = 0\.2 s, expected 0\.1 s or 0",
    ),
    (
        lambda: named_controllers.controller_of("pp", ELBOW, 1e-3, 0.0, at_rest(ELBOW)),
        r"controller: given 'pp', expected one of ppi, ppi_notch, none, .* a file \.toml",
    ),
    (
        lambda: named_controllers.controller_of(
            "ppi_notch",
            flexgen.read("elbow@rigid"),
            1e-3,
            0.0,
            at_rest(flexgen.read("elbow@rigid")),
        ),
        "the model elbow has no elasticity, so no notch frequency; use ppi",
    ),
    (lambda: python_files.object_of_file("no.py:A"), "expected a file no.py that is there"),
    (lambda: channels(), r"outputs: given \(\), expected names: motors, m1, m2, tool_acc"),
    (lambda: channels(1), r"outputs: given \(1,\), expected names"),
    (lambda: channels("motors", "m1"), "given 'm1' twice, expected each channel once"),
    (lambda: channels("nothing"), "given 'nothing', expected one of motors, m1, m2"),
    (lambda: channels("motors", noise={"x": 1.0}), "noise: given 'x', expected one of the outp"),
    (lambda: channels("motors", noise=0.0), "noise of m1: given 0.0, expected a number > 0"),
    (lambda: DriveHardware(0.0), "sample_s: given 0.0, expected a time > 0 in s"),
    (lambda: DriveHardware(delay_s=float("inf")), "delay_s: given inf, expected a time >= 0"),
    (lambda: DriveHardware(delay_s=-1e-9), "delay_s: given -1e-09"),
    *(
        (lambda name=name: DriveHardware(**{name: -1e-9}), f"{name}: given -1e-09")
        for name in ("encoder_resolution_rad", "encoder_noise_rad", "torque_noise_Nm")
    ),
    (
        lambda: DriveHardware(torque_speed=(((0.0, 1.0), (5.0, 2.0)), ())),
        r"torque_speed: given \(\(0.0, 1.0\).*the torque falls",
    ),
    (lambda: DriveHardware(torque_speed=((), ((0.0, 1.0),))), "torque_speed: .*two or more poin"),
    *((lambda k=k: signals(k), "sensors, .*expected 1 finite numbers >= 0") for k in (0, 2, 3)),
    (lambda: Noises(ELBOW, 0.0), "torque_noise: given 0.0"),
    (lambda: Noises(ELBOW, 1.0, 0.0), "disturbance_rate: given 0.0"),
    (lambda: Noises(ELBOW, 1.0, 1.0, -1.0), "tool_force: given -1.0, expected a number >= 0"),
    (lambda: sensor(delay_s=1.4e-3), r"sensor a: given delay_s = 0\.0014 s, expected a multiple"),
    (lambda: sensor(sample_s=2e-3), r"sensor a: given sample_s = 0\.002 s, expected 0\.001 s"),
    (
        lambda: time_grid(0.0, 2.000001, 1e-6, 0.0, 0.0),
        "sample_time: given 1e-06 s, which makes 2000003 samples, expected 2000000",
    ),
    (
        lambda: links(flexgen.read("elbow")),
        "controller x: given the model elbow without a sensor of type link_encoder for q1, q2",
    ),
    (lambda: loop(q_a=np.zeros((2, 2))), r"q_a, q_m: given shapes \(2, 2\), \(3, 2\), expected"),
    (lambda: loop(q_m=np.zeros((3, 1))), r"expected \(lanes, 2\), \(lanes, 2\)"),
    (
        lambda: loop(library=library_with(arm(), ("forward_dynamics",))),
        "library: given .*, expected one of elbow in double precision",
    ),
    (lambda: loop(delay_samples=-1), "given 0 s and -1 samples, expected 0 to 64"),
    (lambda: loop(delay_samples=np.array([0, 65, 1])), "given 0 s and array.*expected 0 to 64"),
    (lambda: loop(steps=0), "steps: given 0, expected a whole number from 1 to 1000"),
    (lambda: loop(steps=3, rate=7600.0), r"steps: 3 integration steps .* is 7\.6e\+03 1/s"),
    (lambda: loop(rate=1.1e6), r"steps: 1100 integration steps a sample of 0\.001 s"),
    (
        lambda: loop(hardware=DriveHardware(1e-3, 0.5022e-3), steps=2),
        "delay_s: given 0.0005022, expected a whole number of integration steps of 0.0005 s",
    ),
    (lambda: loop(sensors=SensorChannels.ideal(2)), "sensors: given 2 channels, expected 0"),
    *(
        (lambda shape=shape: run(shape), r"disturbances: given shape .*\(10, 8, 1 or 3\)")
        for shape in ((10, 8), (9, 8, 1), (10, 7, 1), (10, 8, 2))
    ),
    (lambda: run((10, 8, 3), np.nan), "disturbances: given entries that are not finite"),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_what_does_not_fit_is_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=f"(?s){message}"):
        call()


@pytest.mark.parametrize(
    ("changes", "n_y"),
    [
        ({}, 2),
        ({"delay_samples": 64, "steps": 3, "rate": 7400.0}, 2),
        ({"hardware": DriveHardware(1e-3, 0.5e-3), "steps": 2, "exact_state": True}, 10),
    ],
)
def test_loops_at_the_edge_of_their_ranges(changes: dict[str, Any], n_y: int) -> None:
    assert loop(**changes).setup.n_y == n_y
    run((10, 8, 1))
    run((10, 8, 3))
