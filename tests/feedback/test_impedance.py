"""Impedance at tool or joints and its feedback of torques: stiffness, contact, and passivity
against closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh, expm
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.feedback.laws import passivity
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.margins import LoopAtPose, as_linear, loops_at
from flexgen.feedback.loop.named_controllers import FeedforwardOnly
from flexgen.feedback.loop.plants import LocalDynamics

pytestmark = needs_compiler
T = 1e-3
RATIO = 50.0
MASS = 5.0
# kg, N s/m: of the motor, seen at the carriage
ROTOR = 0.25
FRICTION = 100.0
# of the elastic gear
SPRING = 2e6
DAMPER = 200.0
SLIDE = """
name = "slide"
description = "one axis: a carriage behind a motor"
source = "made for tests"
gravity = [0.0, 0.0, 0.0]
home_rad = [0.0]

[[element]]
name = "carriage"
body = {{ mass = {mass}, com = [0, 0, 0], inertia = [1.0, 1.0, 1.0] }}

[[element.dof]]
name = "q1"
type = "translation"
axis = [1, 0, 0]
gear = {gear}

[[motor]]
name = "m1"
drives = "q1"
ratio = {ratio}
inertia = {inertia}
friction = {{ viscous = {viscous} }}

[[sensor]]
name = "push"
type = "joint_torque"
coordinate = "q1"
unit = "N"

[output]
type = "joint"
joints = ["q1"]

[[move]]
name = "go"
type = "joint"
start_rad = [0.0]
end_rad = [0.01]
duration = 0.2
smoothness = 5
"""
RIGID = '{ type = "rigid" }'
LAW = f'{{ type = "linear", stiffness = {SPRING} }}'
ELASTIC = f'{{ type = "elastic", side = "arm", spring = {LAW}, damping = {DAMPER} }}'
UNDAMPED = f'{{ type = "elastic", side = "arm", spring = {LAW}, damping = 0.0 }}'


def slide(folder: Path, gear: str) -> Any:
    path = folder / "slide.toml"
    numbers = {
        "mass": MASS,
        "ratio": RATIO,
        "inertia": ROTOR / RATIO**2,
        "viscous": FRICTION / RATIO**2,
    }
    path.write_text(SLIDE.format(gear=gear, **numbers))
    return flexgen.read(path)


def checked(folder: Path, gear: str, K: float, B: float, delay: float = 0.0, **more: Any) -> Any:
    law = flexgen.Impedance(joint_stiffness=(K,), damping=(B,), **more)
    return flexgen.check_passivity(
        flexgen.control(slide(folder, gear), controller=law, sample_time=T, delay=delay)
    )


CASES = [
    (1e5, 40.0, 0.0),
    (1e5, 60.0, 0.0),
    (1e3, 20.0, 0.0),
    (3e4, 30.0, T),
    (3e4, 90.0, T),
    (4.5e4, 20.0, 2 * T),
]


def bound(K: float, B: float, delay: float) -> float:
    """Friction less what Colgate and Schenkel demand of a mass under a law with this stiffness and
    damping.
    """
    theta = np.geomspace(2 * np.pi * 0.1 * T, np.pi, 20001)
    law = (K + B / T * (1 - np.exp(-1j * theta))) * np.exp(-1j * theta * delay / T)
    return float(
        (FRICTION - T / 2 / (1 - np.cos(theta)) * np.real((1 - np.exp(-1j * theta)) * law)).min()
    )


@pytest.mark.parametrize(("K", "B", "delay"), CASES)
def test_the_margin_of_a_mass_is_the_bound_of_colgate_and_schenkel(
    K: float, B: float, delay: float, tmp_path: Path
) -> None:
    found = checked(tmp_path, RIGID, K, B, delay)
    known = bound(K, B, delay)
    if delay == 0.0:
        assert known == pytest.approx(FRICTION - K * T / 2 - B, rel=1e-9)
    assert found.margin == pytest.approx(known, abs=2e-3 * (FRICTION - known))
    assert found.passive is (known > 0) and (found.fails_hz is None) is (known > 0)


@pytest.mark.slow
def test_a_delay_that_the_check_forgets_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = LoopAtPose.__init__
    monkeypatch.setattr(
        LoopAtPose, "__init__", lambda self, m, c, h, delay, late=None: real(self, m, c, h, 0.0)
    )
    found = checked(tmp_path, RIGID, 4.5e4, 20.0, 2 * T)
    assert abs(found.margin - bound(4.5e4, 20.0, 2 * T)) > 10


def lifted(
    w: float, K: float, B: float, k_t: float, delay: float, n: int, damper: float = DAMPER
) -> float:
    """``mu`` of the elastic slide by hand: impedances of carriage, gear and rotor at the
    frequencies w + k w_s.
    """
    s = 1j * (w + 2 * np.pi / T * np.arange(-n, n))
    hold = (1 - np.exp(-s * T)) / s * np.exp(-s * delay)
    law = K + B / T * (1 - np.exp(-1j * w * T))
    sampled = np.outer(hold, np.ones(2 * n)) / T
    gear = np.diag(SPRING / s + damper)
    # Rotor: (m s + b) v = -gear (v - v_2) - (1 + k_t) hold law S (v/s) - k_t hold S gear (v - v_2)
    pulled = (np.eye(2 * n) + k_t * sampled) @ gear
    rotor = np.diag(ROTOR * s + FRICTION) + (1 + k_t) * law * sampled @ np.diag(1 / s) + pulled
    v = np.linalg.solve(rotor, pulled)  # of the rotor, over that of the carriage
    Z = np.diag(MASS * s) + gear @ (np.eye(2 * n) - v)
    return float(np.linalg.eigvalsh((Z + Z.conj().T) / 2)[0])


@pytest.mark.parametrize("k_t", [0.0, 0.1])
@pytest.mark.parametrize("delay", [0.0, 0.4 * T])
def test_the_margin_of_an_elastic_joint_is_that_of_its_impedances(
    k_t: float, delay: float, tmp_path: Path
) -> None:
    K = 2e4
    B = 30.0
    damper = 0.0 if k_t else DAMPER
    found = checked(tmp_path, UNDAMPED if k_t else ELASTIC, K, B, delay, torque_gain=k_t)
    at = slice(None, None, 13)
    w = 2 * np.pi * found.hz[at]
    n = passivity.ALIASES
    known = [
        2 * lifted(x, K, B, k_t, delay, n, damper) - lifted(x, K, B, k_t, delay, n // 2, damper)
        for x in w
    ]
    size = np.abs(known).max()
    assert found.margins[0, at] == pytest.approx(np.array(known), abs=2e-3 * size)
    if k_t:
        turned = [lifted(x, K, B, -k_t, delay, n, damper) for x in w]
        assert np.abs(found.margins[0, at] - turned).max() > 0.02 * size


def test_torque_feedback_behind_a_damped_gear_is_refused_since_it_is_never_passive(
    tmp_path: Path,
) -> None:
    """The torque has a part of the speed of the tool: with each alias the least damping falls,
    without end.
    """
    least = [lifted(2 * np.pi * 300.0, 2e4, 30.0, 0.3, 0.0, n) for n in (20, 80, 320)]
    assert least[2] < least[1] - 50 < least[0] - 100 and least[2] < 0.0
    with pytest.raises(
        ArgumentError, match="uses push, which a force on the tool changes as fast as a speed"
    ):
        checked(tmp_path, ELASTIC, 2e4, 30.0, torque_gain=0.3)
    with pytest.raises(
        ArgumentError, match="uses push, which a force on the tool changes at once"
    ):
        law = flexgen.Linear(
            *(np.array([x]) for x in ([[0.0]], [[0.0, 0.0]], [[0.0]], [[1.0, 1e-4]]))
        )
        flexgen.check_passivity(
            flexgen.control(slide(tmp_path, RIGID), controller=law, sample_time=T)
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"sensor.push.delay_s": T},
            r"sensor push: given delay_s = 0\.001 s, expected ones without delay",
        ),
        (
            {"element.carriage.dof.q1.gear": {"type": "rigid"}},
            "signal push, which a motor torque changes at once",
        ),
    ],
)
def test_lqg_refuses_sensors_that_its_filter_does_not_know(
    change: Any, message: str, tmp_path: Path
) -> None:
    slide(tmp_path, ELASTIC)
    model = flexgen.read(tmp_path / "slide.toml", overrides=change)
    with pytest.raises(ArgumentError, match=message):
        flexgen.control(model, controller=flexgen.LQG(), sample_time=T)
    assert (
        flexgen.control(model, controller=flexgen.LQG(sensors=False), sample_time=T)
        .margins()["end"]
        .stable
    )


@pytest.mark.slow
def test_a_passive_loop_is_stable_at_every_spring_and_another_is_not(tmp_path: Path) -> None:
    largest = {}
    for B in (20.0, 200.0):
        law = flexgen.Impedance(joint_stiffness=(1e5,), damping=(B,))
        run = flexgen.control(slide(tmp_path, RIGID), controller=law, sample_time=T)
        loop = run.loops()["end"]
        sizes = []
        # a wall that is touched: on the carriage and the rotor
        for stiffness in np.geomspace(1e2, 2e8, 200):
            A = loop.model.A.copy()
            A[1, 0] -= stiffness / (MASS + ROTOR)
            touched = type(loop.model)(**{**vars(loop.model), "A": A})
            sizes.append(LoopAtPose(touched, loop.controller, T, 0.0).largest_eigenvalue())
        largest[flexgen.check_passivity(run).passive] = max(sizes)
    assert largest[True] < 1.0 < largest[False]


# --- the law -------------------------------------------------------------------------------------


def sensed(**more: Any) -> Any:
    joints = ("q1", "q2")
    sensors = [
        {"name": f"t_{q}", "type": "joint_torque", "coordinate": q, "unit": "N m"} for q in joints
    ]
    return flexgen.read(
        "planar5_nmp", overrides={"sensor": sensors, "gravity": [0.0, 0.0, 0.0], **more}
    )


@pytest.mark.parametrize("k_t", [pytest.param(0.0, marks=pytest.mark.slow), 0.2])
def test_the_tool_gives_way_as_a_spring_of_the_stated_stiffness(k_t: float) -> None:
    """Displacement of the tool by the motors under a force is force over stiffness, with and
    without torque feedback.
    """
    model = sensed()
    K = (3e4, 6e4, 1e4)
    law = flexgen.Impedance(tool_stiffness=K, torque_gain=k_t)
    pushes = [flexgen.Disturbance("step", f"tool.{axis}", 20.0, start_s=-0.5) for axis in "xy"]
    for pushed in ((), pushes):
        run = flexgen.control(model, "line", controller=law, disturbances=pushed, sample_time=5e-4)
        if not pushed:
            free = run.nominal.q_m[-1]
    J = np.array(flexgen.derive(model).function("jacobian")(run.reference.motion["q_a"][-1]))[
        :3, :2
    ]
    moved = J @ np.linalg.inv(model.eta) @ (run.nominal.q_m[-1] - free)
    assert moved[:2] == pytest.approx([20.0 / K[0], 20.0 / K[1]], rel=0.01)


def test_a_file_of_the_law_is_the_law(tmp_path: Path) -> None:
    path = tmp_path / "soft.toml"
    path.write_text('type = "impedance"\njoint_stiffness = [1e6, 5e5]\ndamping_ratio = 1.0\n')
    law = flexgen.Impedance(joint_stiffness=(1e6, 5e5), damping_ratio=1.0)
    runs = [
        flexgen.control("planar5_nmp", controller=each, sample_time=1e-3)
        for each in (str(path), law)
    ]
    assert (runs[0].nominal.q_a == runs[1].nominal.q_a).all() and runs[
        1
    ].controller == "impedance at the joints"


def test_joint_stiffness_and_damping_are_those_of_the_motors() -> None:
    model = sensed()
    law = flexgen.Impedance(joint_stiffness=(1e6, 5e5), damping=(2e4, 1e4), torque_gain=0.5)
    run = flexgen.control(model, "line", controller=law, sample_time=5e-4)
    _, _, C, D = (x[-1] for x in run.law.matrices)
    inverse = np.linalg.inv(model.eta)
    assert pytest.approx(1.5 * inverse.T @ np.diag([2e4, 1e4]) @ inverse, rel=1e-12) == -C * 5e-4
    assert D[:, :2] + C == pytest.approx(1.5 * inverse.T @ np.diag([1e6, 5e5]) @ inverse, rel=1e-9)
    assert D[:, 2:] == pytest.approx(0.5 * inverse.T)


@pytest.mark.parametrize("gain", [0.0, 0.5])
def test_a_frequency_is_that_of_each_joint_alone_with_stiff_springs(gain: float) -> None:
    """K = w^2 M of each joint, and 2 zeta times the critical damping of the mechanism of the
    motors.

    Feedback of the torques makes rotors smaller by 1 + gain.
    """
    model = flexgen.read("elbow")
    law = flexgen.Impedance(frequency_hz=7.0, damping_ratio=0.6, torque_gain=gain)
    motion = [np.zeros((1, 2)) for _ in range(7)]
    K, D = (x[0] for x in law._of_motors(model, motion))
    equations = flexgen.derive(model)
    M = LocalDynamics(equations).matrices(motion, np.zeros(0))[0][0]
    with_motors = np.vstack([np.eye(2), model.eta])  # joints that move their motors
    inertia = with_motors.T @ M @ with_motors
    assert model.eta.T @ K @ model.eta == pytest.approx(
        (14 * np.pi) ** 2 * np.diag(np.diag(inertia)), rel=1e-9
    )
    inverse = np.linalg.inv(model.eta)
    rotors = np.diag([motor.inertia for motor in model.motors])
    values, vectors = eigh(K, inverse.T @ inertia @ inverse - rotors + rotors / (1.0 + gain))
    modal = vectors.T @ D @ vectors
    assert np.diag(modal) == pytest.approx(2 * 0.6 * np.sqrt(values), rel=1e-6)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"tool_stiffness": (1.0, 2.0)}, "tool_stiffness: given 2 numbers"),
        (
            {"tool_stiffness": (1.0,) * 3, "joint_stiffness": (1.0,)},
            "joint_stiffness: given with tool_stiffness",
        ),
        ({"joint_stiffness": (-1.0,)}, "joint_stiffness: given"),
        ({"damping": (1.0,)}, "damping: given 1 numbers, expected none"),
        ({"damping_ratio": 0.0}, "damping_ratio: given 0.0"),
        ({"torque_gain": -0.1}, "torque_gain: given -0.1"),
        ({"torque_gain": 100.1}, "torque_gain: given 100.1, expected 0 to 100"),
        ({"tool_stiffness": (1.0,) * 7}, "tool_stiffness: given 7 numbers, expected 3"),
        (
            {"frequency_hz": 1.001e5},
            "frequency_hz: given 100100.0, expected more than 0, at most 1e5",
        ),
        (
            {"tool_stiffness": (1.0,) * 6, "damping": (1.0,) * 3},
            "damping: given 3 numbers, expected 6 numbers",
        ),
    ],
)
def test_wrong_numbers_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.Impedance(**given)
    made = flexgen.Impedance(
        tool_stiffness=(1.0,) * 6, damping=(0.0,) * 6, torque_gain=100, frequency_hz=1e5
    )
    assert made.title == "impedance at the tool, torque feedback 100"
    assert flexgen.Impedance(joint_stiffness=(0.0,)).title == "impedance at the joints"


@pytest.mark.parametrize(
    ("name", "law", "text"),
    [
        ("planar5_nmp", {"torque_gain": 0.5}, "without a sensor of type joint_torque"),
        (
            "planar5_nmp",
            {"joint_stiffness": (1e6,)},
            "joint_stiffness: given 1 numbers, expected 2",
        ),
        ("planar5_nmp", {"tool_stiffness": (1e4, 0.0, 0.0)}, "leaves a motion of the motors free"),
        (
            "planar5_nmp",
            {"joint_stiffness": (1e10, 1e10)},
            "the sampled loop is unstable at 0.5 ms",
        ),
    ],
)
def test_what_does_not_fit_is_refused(name: str, law: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.control(name, controller=flexgen.Impedance(**law))


@pytest.fixture(scope="module")
def felt() -> Any:
    """A run of the elbow with torques behind springs and an accelerometer on the tool."""
    acc = {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"}
    late = {"name": "late", "type": "joint_torque", "coordinate": "q1", "unit": "N m"}
    own = {"name": "torque", "type": "joint_torque", "coordinate": "q2", "unit": "N m"}
    sensors = [own, acc | {"axes": ["x", "z"]}, late | {"delay_s": 1e-3}]
    undamped = {
        "element.upper.dof.q1.gear.damping": 0.0,
        "element.fore.dof.q2.gear.damping": 0.0,
    }
    model = flexgen.read("elbow", overrides=undamped | {"sensor": sensors})
    return flexgen.control(model, controller="ppi", sample_time=T, progress=False)


def using(run: Any, signal: int, memory: bool = False, factor: float = 1.0) -> Linear:
    """The law of a run with a weak feedback of one signal; ``memory``: through its state."""
    law = as_linear(run.law, T, 6)
    assert law is not None
    A, B, C, D = (x.copy() for x in (law.A, factor * law.B, law.C, factor * law.D))
    (B if memory else D)[0, signal] += 1e-6
    return Linear(A, B, C, D)


@pytest.mark.parametrize("memory", [False, True])
@pytest.mark.parametrize(
    ("signal", "text"),
    [
        (3, r"uses acc\.x, which a force on the tool changes at once"),
        (4, r"uses acc\.z, which a force on the tool changes at once"),
        (5, "uses late, which has a delay of 0.001 s"),
    ],
)
def test_signals_that_a_force_changes_at_once_have_no_passivity(
    felt: Any, signal: int, text: str, memory: bool
) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.check_passivity(replace(felt, law=using(felt, signal, memory)))


def test_torques_behind_springs_do_not_jump_with_a_force(
    felt: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Signals that the law does not use may."""
    monkeypatch.setattr(passivity, "FREQUENCIES", 4)
    found = flexgen.check_passivity(replace(felt, law=using(felt, 2)), low_hz=100.0)
    assert found.poses == ("begin", "middle", "end") and found.hz[0] == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("factor", "more", "text"),
    [
        (None, {}, "run: given the controller ppi .*, expected a linear one"),
        (1.0, {"low_hz": 0.9e-6}, "low_hz: given 9e-07, expected 1e-6 to "),
        (1.0, {"low_hz": 0.401 / T}, "low_hz: given .*, expected 1e-6 to "),
        (9.0, {}, "unstable at the pose begin .largest eigenvalue"),
    ],
)
def test_loops_that_cannot_be_checked_are_refused(
    felt: Any, factor: float | None, more: dict[str, float], text: str
) -> None:
    law = FeedforwardOnly() if factor is None else using(felt, 0, False, factor)
    with pytest.raises(ArgumentError, match=text):
        flexgen.check_passivity(replace(felt, law=law), **more)


def stepped(loop: LoopAtPose, push: np.ndarray, out: np.ndarray, hz: float, steps: int) -> float:
    """The margin under forces that are constant between ``steps`` instants of each sample, by
    integration in time.

    ``push`` (2 n, k): state changed by the forces; ``out`` (k, n): positions of the tool.
    """
    m = loop.model
    n = len(loop.model.A) // 2
    k = push.shape[1]
    dt = loop.sample_s / steps
    A, B, C, D = (x[0] for x in loop.controller.matrices)
    size = 2 * n + len(A)
    rates = np.zeros((2 * n + len(D) + k,) * 2)
    rates[: 2 * n] = np.hstack([m.A, m.B, push])
    step = expm(rates * dt)[: 2 * n]
    # all in terms of the state of robot and controller at the sample and of the forces of the
    # sample
    x = np.eye(2 * n, size + steps * k)
    law = np.zeros((len(D), size + steps * k))
    law[:, : 2 * n] = -D @ m.C
    law[:, 2 * n : size] = -C
    speeds = []
    for i in range(steps):
        force = np.eye(k, size + steps * k, size + i * k)
        after = step @ np.vstack([x, law, force])
        speeds.append(out @ (after - x)[:n] / dt)  # means
        x = after
    own = np.zeros((len(A), size + steps * k))
    own[:, : 2 * n] = B @ m.C
    own[:, 2 * n : size] = A
    S = np.vstack([x, own])
    v = np.vstack(speeds)
    z = np.exp(2j * np.pi * hz * loop.sample_s)
    H = v[:, size:] + v[:, :size] @ np.linalg.solve(z * np.eye(size) - S[:, :size], S[:, size:])
    Z = np.linalg.inv(H)
    return float(np.linalg.eigvalsh((Z + Z.conj().T) / 2)[0])


@pytest.mark.parametrize("name", ["planar5_nmp", pytest.param("two_arm", marks=pytest.mark.slow)])
def test_margins_of_arms_are_those_of_a_count_of_energy(name: str) -> None:
    """Of forces in 24 steps of a sample, with the force on the masses of the arm: no series over
    frequencies.
    """
    run = flexgen.control(name, controller="ppi", sample_time=T, progress=False)
    found = flexgen.check_passivity(run)
    model = passivity.with_viscous_friction(run.model)
    equations = flexgen.derive(run.model)
    at = np.array(list(run.pose_samples.values()))
    loop = loops_at(model, run.law, T, run.delay_s, run.reference.points(at), at)[0]
    q_a = run.reference.motion["q_a"][at[0]]
    n = len(loop.model.A) // 2
    n_a = model.n_a
    J = evaluate(equations.function("jacobian"), q_a[None])[0].reshape(6, n_a)[:3]
    mass = evaluate(equations.function("mass_matrix"), q_a[None])[0].reshape(n_a, n_a)
    U, sizes, _ = np.linalg.svd(J, full_matrices=False)
    U = U[:, sizes > 1e-6 * sizes[0]]
    push = np.zeros((2 * n, U.shape[1]))
    out = np.zeros((U.shape[1], n))
    push[n : n + n_a] = np.linalg.solve(mass, J.T @ U)
    out[:, :n_a] = U.T @ J
    for k in (3, 40, 190):  # the integral part gives energy at low frequencies
        known = stepped(loop, push, out, float(found.hz[k]), 24)
        assert found.margins[0, k] == pytest.approx(known, rel=0.02)
    assert found.margins[0, 3] < 0.0 < found.margins[0, 190]
