"""Rules and formulas of several rooms against definitions: singular motions, passivity, steps of
users, drives.
"""

from __future__ import annotations

from inspect import signature
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import eigh
from scipy.sparse import csc_matrix

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.tables import Table, parse_bytes
from flexgen.codegen.build.model_library import library_with
from flexgen.codegen.emission.spec import LibrarySpec
from flexgen.dynamics.hysteresis import hysteretic_gears, lugre
from flexgen.dynamics.mechanics.equations import derive
from flexgen.exports.fmu import plant
from flexgen.feedback.laws import passivity
from flexgen.feedback.laws.impedance import Impedance
from flexgen.feedback.loop import interface
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.sampled_model import PoseModel
from flexgen.feedback.positions import command
from flexgen.identification.records import experiment_file
from flexgen.identification.responses.residuals import Residuals
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.simulation.motor_feedback import default_feedback


# --- inversion -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("gaps", "solved", "doubtful"),
    [
        # the ratio of the singular values of ((1, 1), (1, 1 + g)) is g/4
        ((2e-9, 1.0), False, True),
        ((8e-9, 1.0), True, True),
        ((2e-5, 1.0), True, True),
        ((8e-5, 1.0), True, False),
        ((1.0, -1.0), True, True),  # singular between the two
    ],
)
def test_a_motion_is_doubtful_where_its_rows_are_nearly_singular(
    gaps: tuple[float, float], solved: bool, doubtful: bool
) -> None:
    """Rows of any size; the accelerations and their derivatives are solutions of the rows."""
    sizes = np.array([[[30.0], [2e-3]]])
    G = sizes * np.array([[[1.0, 1.0], [1.0, 1.0 + g]] for g in gaps])
    zeros = {f"{name}{k}": np.full((2, 1), 0.1 * k) for name in ("rate", "row") for k in range(5)}
    made: Any = object.__new__(Reduction)
    vars(made).update(model=Made(n_a=2), n_y=1, i_e=(1,))
    vars(made).update(_at=lambda chain: {"G": G.reshape(2, 4), "W": np.ones((2, 2)), **zeros})
    vars(made).update(
        _picking=lambda W: np.broadcast_to(np.diag([2.0, 1.0]), (2, 2, 2)),
        _motion=lambda chain: chain,
    )
    sample: Any = Made(derivative=lambda k: np.full((2, 1), float(k)))
    q = np.array([[0.1, 0.2], [0.3, 0.4]])
    v_e = np.array([[0.5], [0.6]])
    found, seen = made.motion(sample, q, v_e)
    assert (found is not None, seen) == (solved, doubtful)
    if solved:
        assert found[0] is q
        assert_allclose(found[1], [[0.5, 0.5], [0.5, 0.6]])
        for k in (2, 3, 4):
            right = np.array([k - 0.1 * k, -0.1 * (k - 2)])
            assert_allclose(
                np.einsum("kij,kj->ki", G, found[k]), np.tile(right, (2, 1)), rtol=1e-4, atol=1e-9
            )


# --- laws ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(4))
def test_the_least_power_of_a_force_is_an_eigenvalue(seed: int) -> None:
    """``min Re(f^* v) / |v|^2`` for ``v = Q f``, sizes of forces far apart."""
    rng = np.random.default_rng(seed)
    Q = (rng.normal(size=(4, 4)) + 1j * rng.normal(size=(4, 4))) * np.array([0.1, 1.0, 3.0, 10.0])[
        :, None
    ]
    Q = Q + 3 * np.diag(np.abs(np.diag(Q)))
    assert passivity._least(Q) == pytest.approx(
        eigh((Q + Q.conj().T) / 2, Q.conj().T @ Q)[0][0], rel=1e-7
    )


@pytest.mark.parametrize("delay", [0.0, 2e-3])
def test_a_law_takes_from_the_passivity_of_a_damped_joint(
    delay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``(d + Re((D + K/s) e^(-s t)))/l^2``: damping d, a fast law with D < 0, torques t late, a
    tool at l.
    """
    m = 2.0
    d = 8.0
    K = 100.0
    D = -3.0
    length = 0.5
    T = 1e-5
    none = np.zeros((1, 0))
    push = np.array([[0.0, 0.0, 0.0], [length / m, 0.0, 0.0]])
    A = np.array([[0.0, 1.0], [0.0, -d / m]])
    B = np.array([[0.0], [1 / m]])
    C = np.array([[1.0, 0.0]])
    robot = PoseModel(A, B, push, none, C, none, none, none)
    law = Linear(np.zeros((1, 1)), np.ones((1, 1)), np.array([[-D / T]]), np.array([[K + D / T]]))
    monkeypatch.setattr(
        passivity, "evaluate", lambda function, q: [np.array([[length, 0, 0, 0, 0, 0]])]
    )
    monkeypatch.setattr(passivity, "_check_signals", lambda *given: None)
    equations: Any = Made(model=Made(n_a=1), function=lambda name: name)
    hz = np.array([0.5, 2.0, 5.0])
    s = 2j * np.pi * hz
    found = passivity._margins(
        LoopAtPose(robot, law, T, delay), equations, {"q_a": np.zeros(1)}, hz
    )
    expected = (d + ((D + K / s) * np.exp(-s * delay)).real) / length**2
    assert_allclose(found, expected, rtol=2e-3, atol=1e-2)
    # K: a spring with late forces
    assert_allclose(expected, (d + D - K * delay) / length**2, rtol=5e-3)


def test_controllers_with_signals_that_a_force_changes_at_once_have_no_passivity() -> None:
    """A torque behind a spring does not jump with a force: what the force does to the links takes
    time. Others do.
    """
    sensors = [
        {"name": "torque1", "type": "joint_torque", "coordinate": "q1", "unit": "N m"},
        {
            "name": "acc",
            "type": "accelerometer",
            "element": "tool",
            "axes": ["x", "z"],
            "unit": "m/s^2",
        },
    ]
    equations = derive(flexgen.read("elbow", overrides={"sensor": sensors}))
    q = np.array([0.3, 0.5])
    mass, J = (np.array(equations.function(name)(q)) for name in ("mass_matrix", "jacobian"))
    push = np.zeros((8, 3))
    push[4:6] = np.linalg.solve(mass, J[:3].T)
    point = {"q_a": q, "v_a": np.array([0.2, -0.4]), "a_a": np.zeros(2)}

    def check(*used: int, memory: bool = False, scale: float = 1.0) -> None:
        gains = np.zeros((2, 5))
        gains[0, list(used)] = 1.0
        none = np.zeros((2, 2))
        B, D = (gains, 0 * gains) if memory else (0 * gains, gains)
        loop: Any = Made(
            model=Made(A=np.zeros((8, 8)), push=scale * push, C=np.zeros((5, 8))),
            controller=Made(matrices=tuple(x[None] for x in (none, B, none, D))),
        )
        passivity._check_signals(loop, equations, point)

    check(0, 1)
    check(0, 1, 2)
    check(2, memory=True)
    for signal, name in ((3, r"acc\.x"), (4, r"acc\.z")):
        for memory in (False, True):
            with pytest.raises(
                ArgumentError,
                match=f"controller that uses {name}, which a force on the tool changes a",
            ):
                check(0, signal, memory=memory)
    with pytest.raises(
        ArgumentError,
        match="controller that uses torque1, which a force on the tool changes at once",
    ):
        check(2, scale=0.5)


def test_torques_of_gears_need_a_sensor_each_without_delay() -> None:
    model = flexgen.read("elbow")

    def sensor(kind: str, place: str, delay: float = 0.0, channels: int = 1) -> Any:
        return Made(type=kind, place=place, delay_s=delay, channels=("a",) * channels)

    def channels(*sensors: Any, gain: float = 2.0) -> list[int]:
        own: Any = Made(
            sensors=sensors,
            n_m=2,
            i_g=model.i_g,
            i_m=model.i_m,
            coordinates=model.coordinates,
            name="arm",
        )
        law: Any = object.__new__(Impedance)
        object.__setattr__(law, "torque_gain", gain)
        return Impedance._torque_channels(law, own)

    assert channels(gain=0.0) == []
    both = (
        sensor("wrench", "tool", channels=6),
        sensor("joint_torque", "q2"),
        sensor("gyro", "q1", channels=3),
    )
    assert channels(*both, sensor("joint_torque", "q1"), sensor("joint_torque", "q1")) == [
        2 + 6 + 1 + 3,
        2 + 6,
    ]
    text = (
        r"^controller, torque_gain: given 2 and the model arm without a sensor of type "
        r"joint_torque, with delay_s = "
    )
    with pytest.raises(ArgumentError, match=text + r"0, at q1, expected one at each gear$"):
        channels(*both, sensor("joint_torque", "q1", 1e-3))
    with pytest.raises(ArgumentError, match=r"0, at q1, q2, expected"):
        channels()


# --- loop ----------------------------------------------------------------------------------------
def test_steps_of_a_controller_of_a_user_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 0.5, 10.0, 11.0, 20.0, 21.005, *np.zeros(20)])
    monkeypatch.setattr(interface.time, "perf_counter", lambda: next(clock))

    def step(returned: Any) -> Any:
        asked: list[Any] = []

        def answer(*given: Any) -> Any:
            asked.append(given)
            return returned

        own = Made(step=answer)
        found = interface.check_step(own, 7, "y", "ref", 2)  # type: ignore[arg-type]
        assert asked == [(7, "y", "ref")]
        return found

    assert_array_equal(step([1, 2]), [1.0, 2.0])
    assert_array_equal(step(np.arange(4.0)[::2]), [0.0, 2.0])
    assert step([1, 2]) == "took 1.00 s, expected less than 1.0 s"
    assert step([1.0]) == "returned shape (1,), expected (2,)"
    assert step([1.0, np.nan]) == "returned [ 1. nan], expected finite torques"
    assert step("x") == "raised ValueError: could not convert string to float: 'x'"


# --- simulation ----------------------------------------------------------------------------------
def test_the_default_feedback_of_motors_is_below_the_lowest_locked_frequency() -> None:
    """A half, three times and a tenth of it; gravity changes it little. Speed gains by the inertia
    of stiff gears.
    """
    equations = derive("elbow")
    model = equations.model
    q = np.array([0.3, -0.4])
    found = default_feedback(equations, q, model.eta @ q, np.zeros(2))
    M = np.array(equations.function("mass_matrix")(q))
    springs: list[Any] = [element.dofs[0].gear for element in model.elements]
    K = np.diag([float(gear.spring.stiffness) for gear in springs])
    lowest = np.sqrt(eigh(K, M, eigvals_only=True)[0]) / (2 * np.pi)
    assert_allclose(found.position_gain, np.pi * lowest, rtol=1e-3)
    assert_allclose(found.integral_gain, 0.2 * np.pi * lowest, rtol=1e-3)
    back = np.linalg.inv(model.eta)
    inertia = np.diag(back.T @ M @ back) + [m.inertia for m in model.motors]
    assert_allclose(found.speed_gain, 6 * np.pi * lowest * inertia, rtol=1e-3)
    names = ["position_hz", "speed_hz", "integral_hz"]
    assert list(found.frequencies) == names
    assert_allclose(
        list(found.frequencies.values()), np.array([0.5, 3.0, 0.1]) * lowest, rtol=1e-3
    )


# --- memory --------------------------------------------------------------------------------------
def test_speeds_between_samples_are_cubic_and_reverse_at_their_roots() -> None:
    roots = [[0.25, 0.5, 0.75], [-0.5, 0.4, 2.0], [1.5, 3.0, -1.0], [0.2, 0.9, 5.0]]
    cubic = np.array([Polynomial.fromroots(each).coef for each in roots]).T * [1.0, -3.0, 2.0, 0.1]
    found = lugre._reversals(cubic, 1e-9)
    expected: Any = [
        [0, 0.25, 0.5, 0.75, 1],
        [0, 0.4, 1, 1, 1],
        [0, 1, 1, 1, 1],
        [0, 0.2, 0.9, 1, 1],
    ]
    assert_allclose(found.T, expected, atol=1e-9)
    assert_allclose(lugre._reversals(cubic, 1e9)[1:], 1.0)
    low = np.array([0.0, 0.1, 0.2, 0.5])
    high = np.array([1.0, 0.4, 0.9, 0.6])
    whole: list[Any] = [Polynomial(cubic[:, k]).integ() for k in range(4)]
    areas: list[Any] = [f(b) - f(a) for f, a, b in zip(whole, low, high, strict=True)]
    assert_allclose(lugre._integral(cubic, low, high), areas)
    values: Any = [Polynomial(cubic[:, k])(high[k]) for k in range(4)]
    assert_allclose(lugre._value(cubic, high), values)


def test_time_constants_since_a_reversal() -> None:
    """Within an interval, or between two of opposite ways; a rest between them changes nothing."""
    turned = np.arange(1.0, 8.0)
    way = np.array([1.0, 1.0, 0.0, -1.0, -1.0, -1.0, -1.0])
    reverses = np.array([False] * 4 + [True, False, False])
    assert_allclose(lugre._since_reversal(turned, way, reverses), [0, 1, 3, 0, 4, 0, 6])


def test_torques_between_samples_are_quintics() -> None:
    # in the part of the step
    h = 0.02
    gears = [Polynomial([1, -2, 3, 4, -5, 6]), Polynomial([0, 1, 0, -2, 0, 3])]
    left, right = (
        np.array([[p.deriv(k)(x) / h**k for k in range(3)] for p in gears]) for x in (0.0, 1.0)
    )
    assert_allclose(
        hysteretic_gears._quintic(h, left, right), np.array([p.coef for p in gears]).T, atol=1e-10
    )


# --- identification ------------------------------------------------------------------------------
def drive(text: str) -> Any:
    root = Table("bench.toml", parse_bytes(text.encode(), "bench.toml"), "")
    return experiment_file._drive(root, 1e-3, 2)


def test_drives_of_recordings_have_gains_filters_and_noise() -> None:
    hardware, found = drive("delay_s = 2e-4")
    assert (hardware.sample_s, hardware.delay_s) == (1e-3, 2e-4)
    assert not found.position_gain.any() and not found.speed_gain.any() and found.filters == ()
    assert_array_equal(
        [hardware.encoder_resolution_rad, hardware.encoder_noise_rad, hardware.torque_noise_Nm],
        0.0,
    )
    gains = "[drive]\nposition_gain = [3, 0]\nspeed_gain = [1, 2]\n"
    noise = "encoder_resolution_rad = 1e-4\nencoder_noise_rad = 2e-4\ntorque_noise_Nm = 0.3\n"
    filters = "[drive.low_pass]\nfrequency_hz = 40\ndamping = 0.8\n"
    filters += "[drive.notch]\nfrequency_hz = 12\nzero_damping = 0.05\npole_damping = 0.5\n"
    hardware, found = drive(gains + noise)
    values = [
        hardware.encoder_resolution_rad,
        hardware.encoder_noise_rad,
        hardware.torque_noise_Nm,
        hardware.delay_s,
    ]
    assert_array_equal(values, [1e-4, 2e-4, 0.3, 0.0])
    assert_array_equal(
        np.array([found.position_gain, found.speed_gain, found.integral_gain]),
        [[3, 0], [1, 2], [0, 0]],
    )
    _, found = drive(gains + "integral_gain = [5, 6]\n")
    assert_array_equal(found.integral_gain, [5, 6])
    with pytest.raises(ModelError, match=r"speed_gain: .*expected numbers > 0"):
        drive(gains.replace("[1, 2]", "[1, 0]"))
    with pytest.raises(ModelError, match=r"position_gain: .*expected numbers >= 0"):
        drive(gains.replace("[3, 0]", "[3, -1]"))
    with pytest.raises(ModelError, match=r"delay_s"):
        drive("delay_s = -1e-3")
    _, found = drive(gains + filters)
    assert found.filters == (LowPass(40.0, 0.8), Notch(12.0, 0.05, 0.5))


def test_the_part_that_noise_does_not_explain_is_of_the_worst_element() -> None:
    """Squares of residuals above their number by 8 deviations, 30 where the variances are of
    single elements.
    """
    made: Any = object.__new__(Residuals)
    G = np.ones((1, 100, 1, 2), complex)
    size = np.sqrt(np.array([1.5, 4.5]) + 0j)  # of a residual
    vars(made).update(_noisy=None, data=Made(G=10 * G), response=lambda x: Made(G=G))
    vars(made).update(_weigh=lambda r: (np.where(r.G == 1.0, size, 3.0) * np.ones(G.shape), None))
    assert made.find_unexplained(np.zeros(1)) == pytest.approx(np.sqrt((450 - 100) / 900))
    for excess, found in ((2.99, 0.0), (3.01, np.sqrt(301 / 900))):
        size[1] = np.sqrt(1 + excess)
        assert made.find_unexplained(np.zeros(1)) == pytest.approx(found, abs=1e-9)
    made._noisy = (None, np.full((1, 100, 2), 0.5))
    limit = 8 / np.sqrt(50)
    for part, found in ((0.99, 0.0), (1.01, np.sqrt(0.5 * 1.01 * limit / 9))):
        size[:] = 0.1, np.sqrt(0.5 * (1 + part * limit))
        assert made.find_unexplained(np.zeros(1)) == pytest.approx(found, abs=1e-9)
    vars(made).update(weight=lambda x, slopes: (np.array([3 + 4j, 2.0]), None))
    assert made.misfit(np.zeros(1)) == 29.0


# --- servos --------------------------------------------------------------------------------------
def test_bounds_of_commands_are_one_for_each_joint() -> None:
    model = flexgen.read("elbow")
    assert command._limit(model, "speed", None) is None
    assert_array_equal(command._limit(model, "speed", [1, 2]), [1.0, 2.0])
    for bad in ([1.0], [1.0, 0.0], [1.0, np.inf], [[1.0, 2.0]]):
        with pytest.raises(
            ArgumentError, match=r"^speed: given .*, expected 2 numbers > 0, one for each joint$"
        ):
            command._limit(model, "speed", bad)
    servo: Any = Made(sample_time=4e-3)
    for period in (4e-3, 4e-3 * (1 - 1e-10), command.LONGEST_S):
        command._check_period(period, servo)
    text = (
        rf"^period: given .*, expected from 0\.004 s, the sample time of the servo, to "
        rf"{command.LONGEST_S:g} s$"
    )
    for wrong in (4e-3 * (1 - 1e-8), 1.001 * command.LONGEST_S, "fast", np.nan):
        with pytest.raises(ArgumentError, match=text):
            command._check_period(wrong, servo)


def test_limits_that_commands_reach_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Differences of the samples over the period, and of these once more."""
    r = np.array([[0.0, 0.0], [1.0, 0.2], [3.0, 0.4], [4.0, 0.7]])
    h = 0.1
    within: list[Any] = []

    def fit_within(*given: Any) -> np.ndarray:
        within.append(given)
        return np.ones((4, 2))

    monkeypatch.setattr(command, "fit_within", fit_within)
    B = csc_matrix(np.eye(4))
    found, active = command._fit(
        B, r, h, (np.array([20.1, 3.1]), np.array([101.0, 11.0])), ["q1", "q2"]
    )
    assert_allclose(found, r, atol=1e-12)
    assert active == () and not within
    found, active = command._fit(
        B, r, h, (np.array([19.9, 3.1]), np.array([101.0, 9.9])), ["q1", "q2"]
    )
    assert active == ("speed of q1", "acceleration of q2") and (found == 1.0).all()
    assert command._fit(B, r, h, (None, np.array([99.0, 9.0])), ["q1", "q2"])[1] == (
        "acceleration of q1",
        "acceleration of q2",
    )


# --- exports -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("fastest", "step"),
    [
        (10.0, 1e-3),
        (60.0, 5e-4),
        (100.0, 5e-4),
        (101.0, 2e-4),
        (500.0, 1e-4),
        (3e4, 1e-6),
        (0.0, 1e-3),
    ],
)
def test_steps_of_a_block_are_short_numbers(
    fastest: float, step: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The largest 1, 2 or 5 times a power of ten below a twentieth of the shortest time constant,
    and 1 ms.
    """
    # M a + R x = 0, M of diagonal 1, 2
    K = np.array([[fastest**2, 0.0, 0.5 * fastest, 0.0], [0.0, 0.0, 0.0, 0.0]])
    asked: list[Any] = []

    def evaluate(function: str, *given: Any) -> tuple[np.ndarray, ...]:
        asked.append((function, given))
        if function == "accelerations":
            return np.zeros((1, 2)), np.zeros((1, 0))
        return np.diag([1.0, 2.0]).reshape(1, 4), np.hstack([K * [[1.0], [2.0]], np.ones((2, 3))])[
            None
        ]

    monkeypatch.setattr(plant, "evaluate", evaluate)
    equations: Any = Made(model=Made(dof=2), parameters=[Made(value=3.0)])
    graphs: Any = Made(accelerations="accelerations", jacobians="jacobians")
    held: Any = Made(tau_m=np.array([7.0]))
    assert plant._default_step(graphs, equations, np.zeros(4), held) == step
    assert_array_equal(asked[0][1][1], [7.0, 0, 0, 0, 0, 0, 0])


def test_outputs_of_a_block_are_named_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each depends on the states that its row of the pattern has."""
    pattern = np.zeros((2 * 2 + 3 + 9 + 3 + 3 + 2, 5), bool)
    pattern[0, 1] = pattern[-1, [0, 4]] = True
    monkeypatch.setattr(plant, "_pattern", lambda function, argument: pattern)
    graphs: Any = Made(output=None)
    found = plant._outputs(flexgen.read("elbow"), graphs)
    names = [f"motor.{m}.{x}" for x in ("angle", "speed") for m in ("m1", "m2")]
    names += [f"tool.position[{i}]" for i in (1, 2, 3)]
    names += [f"tool.rotation[{i},{j}]" for i in (1, 2, 3) for j in (1, 2, 3)]
    names += [f"tool.velocity[{i}]" for i in (1, 2, 3)] + [
        f"tool.angular_velocity[{i}]" for i in (1, 2, 3)
    ]
    assert [one.name for one in found] == [*names, "deflection.q1", "deflection.q2"]
    units = (
        ["rad"] * 2
        + ["rad/s"] * 2
        + ["m"] * 3
        + ["1"] * 9
        + ["m/s"] * 3
        + ["rad/s"] * 3
        + ["rad"] * 2
    )
    assert [one.unit for one in found] == units
    assert found[0].depends == (1000 * plant.STATE + 1,) and found[1].depends == ()
    assert found[-1].depends == (1000 * plant.STATE, 1000 * plant.STATE + 4)


def test_libraries_have_one_vector_of_parameters_and_run_on_other_processors_unless_asked() -> (
    None
):
    """Both would change the digits or the shapes of arrays of a user."""
    assert LibrarySpec.__dataclass_fields__["per_point"].default is False
    assert LibrarySpec.__dataclass_fields__["force"].default is False
    assert LibrarySpec.__dataclass_fields__["precision"].default == "double"
    defaults = {name: one.default for name, one in signature(library_with).parameters.items()}
    assert (defaults["per_point"], defaults["native"], defaults["parameters"]) == (
        False,
        False,
        (),
    )
