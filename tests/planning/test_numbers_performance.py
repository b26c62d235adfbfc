"""Numbers of flexgen/planning/fastest: known loads, bang-bang times, linear programs by hand,
rules of the searches.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from enlarged import rescaled
from measured_numbers import check_numbers
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import linprog
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.statics import gear_deflection
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.load import payload
from flexgen.identification.load.payload import identify_load
from flexgen.model.elements import Friction, RobotModel
from flexgen.paths.timing.time_laws import TimeLaw
from flexgen.planning.fastest import residual_vibration, time_search
from flexgen.planning.fastest.minimum_time import _limits_of
from flexgen.planning.fastest.rigid_time import _accelerate, _extreme, _time, joint_motion
from flexgen.planning.fastest.time_search import TimeSearch
from flexgen.planning.learning import commanded, learn
from flexgen.planning.learning.smoother import acting

LOADED = ("payload.mass", "payload.com_x", "payload.com_y", "payload.com_z")


def record(name: str | RobotModel, change: np.ndarray, h: float = 5e-3) -> Trajectory:
    """Motors of a robot that carries a payload changed by ``change``, along sines of its joints,
    gears bent.
    """
    equations = flexgen.derive(name)
    model = equations.model
    known = equations.model.payload
    around = np.array(known.inertia)  # of the payload and a point mass about their center together
    if change[0]:
        part = known.mass * (known.mass + change[0]) / change[0]
        around = around + part * (
            np.dot(change[1:], change[1:]) * np.eye(3) - np.outer(change[1:], change[1:])
        )
    full = derive(
        replace(model, payload=replace(known, inertia=tuple(map(tuple, around.tolist())))), LOADED
    )
    t = h * np.arange(400)
    g = list(equations.model.i_g)
    w = np.array([5.0, 3.7, 6.1, 4.3, 3.1, 5.3])[: len(g)]
    phase = np.arange(len(g))
    q, v, a = (np.zeros((len(t), model.n_a)) for _ in range(3))
    q[:, g] = 0.6 * np.sin(np.outer(t, w) + phase) + 0.3 * phase
    v[:, g] = 0.6 * w * np.cos(np.outer(t, w) + phase)
    a[:, g] = -0.6 * w**2 * np.sin(np.outer(t, w) + phase)
    values = np.array([p.value for p in full.parameters]) + change
    tau = evaluate(full.function("inverse_dynamics"), q, v, a, values)[0].reshape(q.shape)
    tau = (tau - evaluate(equations.function("arm_forces"), q, v)[0].reshape(q.shape))[:, g]
    q_m = (q[:, g] + gear_deflection(equations, tau).reshape(len(t), -1)) @ model.eta.T
    v_m = np.gradient(q_m, h, axis=0)
    friction = evaluate(equations.function("motor_friction"), v_m)[0].reshape(q_m.shape)
    inertia = np.array([m.inertia for m in model.motors])
    tau_m = tau @ np.linalg.inv(model.eta) + np.gradient(v_m, h, axis=0) * inertia + friction
    ports = {
        name: Port(name, (model.n_m,), unit, "of motors")
        for name, unit in (("q_m", "rad"), ("tau_m", "N m"))
    }
    labels = {name: tuple(m.name for m in model.motors) for name in ports}
    return Trajectory(t, {"q_m": q_m, "tau_m": tau_m}, ports, labels)


def test_a_known_load_is_identified() -> None:
    change = np.array([3.0, 0.1, 0.05, -0.08])
    given = record("manutec_r3", change)
    found = identify_load("manutec_r3", given, low_pass_hz=6.0)
    total = np.array([15.0, 0.1, 0.25, 0.1]) + change
    assert_allclose(np.r_[found.total_mass, found.total_com], total, atol=0.02)
    com = (total[0] * total[1:] - 15.0 * np.array([0.1, 0.25, 0.1])) / 3.0
    assert_allclose(found.com, com, atol=3e-3)
    assert found.mass == pytest.approx(found.total_mass - 15.0)
    assert_allclose(
        found.com,
        (found.total_mass * found.total_com - 15 * np.array([0.1, 0.25, 0.1])) / found.mass,
    )
    # 2.2
    assert (
        abs(found.mass - 3.0) < 0.5 * found.mass_sd
        and (np.abs(found.com - com) < 0.5 * found.com_sd).all()
    )


def test_the_load_of_a_tiny_quick_arm_is_that_of_the_large_one() -> None:
    """Lengths, masses and times by powers of two; its motion is 16 times as quick, as the low pass
    is.
    """
    given = record("elbow", np.array([2.0, 0.0, 0.0, 0.0]))
    length = 2.0**-6
    mass = 2.0**-20
    time = 2.0**-4
    large = flexgen.read("elbow@rigid")
    unit = mass * length**2
    tiny = rescaled(large, length, mass, time)
    channels = {"q_m": given["q_m"], "tau_m": given["tau_m"] * unit / time**2}
    found = [
        identify_load(*x)
        for x in (
            (large, given),
            (tiny, replace(given, time=time * given.time, channels=channels)),
        )
    ]
    assert found[1].mass / mass == pytest.approx(found[0].mass, rel=0.02)
    assert found[1].mass_sd / mass < 2 * found[0].mass_sd
    assert found[1].delay_s / time == pytest.approx(found[0].delay_s, abs=1e-4)


@pytest.mark.slow  # the quick one is a linear fit, see test_numbers_load
def test_the_mass_of_a_load_is_part_of_the_deviation_of_its_place() -> None:
    """1 kg far from the 15 kg of the file: the place follows from the total one by the mass, known
    to a tenth.
    """
    load = np.array([0.6, -0.3, 0.5])
    own = np.array([0.1, 0.25, 0.1])
    found = []
    given = record("manutec_r3", np.r_[1.0, (15 * own + load) / 16 - own])
    for seed in range(8):
        noise = 0.05 * np.random.default_rng(seed).standard_normal(given["tau_m"].shape)
        noisy = replace(given, channels=given.channels | {"tau_m": given["tau_m"] + noise})
        one = identify_load("manutec_r3", noisy, low_pass_hz=6.0)
        found.append(((one.com - load) / one.com_sd, one.com_sd))
    z, sd = np.array(found).transpose(1, 0, 2)
    # 2.6 without the mass
    assert 0.4 < np.sqrt((z**2).mean()) < 1.6 and np.median(sd[:, 0]) > 0.02


def test_noise_of_the_angles_does_not_enter_by_the_friction() -> None:
    """Coulomb friction of speeds that are noise has a mean; with it masses scattered by 9.5 g."""
    given = record("manutec_r3", np.array([3.0, 0.1, 0.05, -0.08]))
    found = []
    for seed in range(6):
        noise = 3e-3 * np.random.default_rng(seed).standard_normal(given["q_m"].shape)
        channels = given.channels | {"q_m": given["q_m"] + noise}
        found.append(
            identify_load("manutec_r3", replace(given, channels=channels), low_pass_hz=6.0).mass
        )
    assert np.std(found) < 4e-3 and np.mean(found) == pytest.approx(3.0, abs=0.015)


def test_a_load_turns_with_its_element_where_that_is_rigid() -> None:
    """The axes of a payload at the tip of a beam are others."""
    made = payload._Estimate(
        flexgen.read("beam_arm"), record("elbow", np.zeros(4)), 6.0, rigid=True
    )
    assert made.names == LOADED
    made = payload._Estimate(flexgen.read("elbow"), record("elbow", np.zeros(4)), 6.0, rigid=True)
    assert made.names[0] == f"{flexgen.read('elbow').tip}.inertia_xx" and made.names[6:] == LOADED


def test_records_that_do_not_determine_a_load_are_refused() -> None:
    given = record("elbow", np.array([2.0, 0.0, 0.0, 0.0]))
    load = identify_load("elbow", given)  # a planar arm does not turn the tool out of its plane
    assert load.mass == pytest.approx(2.0, rel=0.03) and "y not determined" in str(load)
    flat = replace(flexgen.read("elbow"), gravity=(0.0, 0.0, 0.0))
    quiet = replace(
        given, channels={"q_m": 0.0 * given["q_m"], "tau_m": 0.0 * given["tau_m"] + 1.0}
    )
    with pytest.raises(
        SolverError,
        match="load: the motion does not determine the mass; move the joints that carry",
    ):
        identify_load(flat, quiet)
    short = {name: given[name][:199] for name in ("q_m", "tau_m")}
    ports = given.ports
    labels = given.labels
    with pytest.raises(ArgumentError, match=r"record: given 199 samples, expected at least 200"):
        identify_load("elbow", Trajectory(given.time[:199], short, ports, labels))
    # seconds since 1970, in double precision
    rounded = identify_load("elbow", replace(given, time=1.7e9 + given.time))
    assert rounded.mass == pytest.approx(load.mass, rel=1e-4)
    with pytest.raises(
        ArgumentError,
        match=r"record: given 1 s, expected at least 1\.05 s: the low pass spoils 0\.5 s",
    ):
        identify_load("elbow", replace(given, time=2.5e-3 * np.arange(400)), low_pass_hz=8.0)
    back = given.time - 1.0 * (np.arange(400) > 200)
    with pytest.raises(ArgumentError, match=r"a time grid that does not increase"):
        identify_load("elbow", Trajectory(back, dict(given.channels), ports, labels))
    with pytest.raises(ArgumentError, match=r"given 2 columns of q_m, expected 6"):
        identify_load("manutec_r3", given)
    for low in (0.0, 40.0):
        with pytest.raises(
            ArgumentError, match=r"low_pass_hz: given .*, expected more than 0, below 40 Hz"
        ):
            identify_load("elbow", given, low_pass_hz=float(low))


def test_the_estimate_of_a_load_filters_torques_and_motion() -> None:
    """Gear torques of the record by hand; the stiffness of a spring without a motor is that of the
    model file.
    """
    given = record("elbow", np.zeros(4))
    model = flexgen.read("elbow")
    found = payload._Estimate(model, given, 8.0, False)

    def smooth(x: np.ndarray, times: float = 3.0) -> np.ndarray:
        return filtfilt(*butter(2, 2 * times * 8.0 * 5e-3), x, axis=0)

    def rate(x: np.ndarray) -> np.ndarray:
        """Differences of sixth order; beyond the ends the signal is turned over."""
        n = len(x)
        y = np.concatenate([2 * x[:1] - x[3:0:-1], x, 2 * x[-1:] - x[-2:-5:-1]])
        parts = [
            c * (y[3 + k : 3 + k + n] - y[3 - k : 3 - k + n])
            for k, c in ((1, 45.0), (2, -9.0), (3, 1.0))
        ]
        return sum(parts) / (60 * 5e-3)

    t = np.arange(400)[:, None] * 5e-3
    assert_allclose(rate(np.sin(6.0 * t))[3:-3], 6.0 * np.cos(6.0 * t)[3:-3], atol=1e-9)
    acceleration = rate(rate(smooth(given["q_m"])))
    speed = rate(smooth(given["q_m"]))
    friction = evaluate(derive(model).function("motor_friction"), speed)[0].reshape(speed.shape)
    needed = smooth(given["tau_m"] - friction) - acceleration * [m.inertia for m in model.motors]
    assert_allclose(found.tau_g, smooth(needed @ model.eta, 1.0), rtol=1e-9, atol=1e-9)
    bent = gear_deflection(derive(model), needed @ model.eta).reshape(400, -1)
    assert_allclose(
        found.q_geared, smooth(given["q_m"]) @ np.linalg.inv(model.eta).T - bent, atol=1e-9
    )
    assert (found.kept, found.effective) == (
        slice(100, -100),
        pytest.approx(200 * 5 / 3 * 8.0 * 5e-3, rel=1e-3),
    )
    rigid = payload._Estimate(model, given, 8.0, True)
    assert_allclose(rigid.q_geared, smooth(given["q_m"]) @ np.linalg.inv(model.eta).T, atol=1e-12)
    q, v, a = rigid.motion(np.zeros(4), np.zeros(model.n_a))
    assert_allclose(v, rate(q), atol=1e-12)
    assert_allclose(a, rate(v), atol=1e-10)
    soft = flexgen.read("planar5_nmp")
    estimate = object.__new__(payload._Estimate)
    estimate.robot = soft
    estimate.nominal = derive(soft)
    springs = [soft.coordinates[i].dof.spring.stiffness for i in soft.i_e]
    assert_allclose(estimate._stiffness(), springs, rtol=1e-6)


def test_deflections_of_coordinates_without_motor_hold_the_forces() -> None:
    """Spring equation ``k q_e = -(1 + softer) forces`` after three substitutions, slow motion;
    gears likewise.
    """
    model = flexgen.read("planar5_nmp")
    given = record("planar5_nmp", np.zeros(4))
    found = payload._Estimate(model, given, 5.0, False)
    values = found.of_file[-4:]
    softer = np.array([0.2, -0.1, 0.15])
    i_e = list(model.i_e)
    i_g = list(model.i_g)
    q, v, a = found.motion(values, softer)
    forces = found._smooth(found.forces(q, v, a, values))[found.kept][:, i_e]
    left = q[found.kept][:, i_e] * found.stiffness + (1 + softer[i_e]) * forces
    assert np.abs(left).max() < 0.02 * np.abs(forces).max()
    assert_array_equal(found.motion(values, np.zeros(3))[0][:, i_g], found.q_geared[:, i_g])
    stiff = found.q_m @ np.linalg.inv(model.eta).T
    assert_allclose(
        q[:, i_g], stiff - (1 + softer[i_g]) * (stiff - found.q_geared[:, i_g]), atol=1e-12
    )
    assert np.abs(stiff - found.q_geared[:, i_g]).max() > 1e-4


def test_torques_that_acted_are_those_sent_late() -> None:
    sent = np.array([[1.0], [2.0], [4.0], [8.0], [16.0]])
    assert_allclose(acting(sent, 0, 0.0)[:, 0], [1, 1, 2, 4, 8])
    assert_allclose(acting(sent, 1, 0.25)[:, 0], [1, 1, 1, 0.75 * 2 + 0.25, 0.75 * 4 + 0.25 * 2])


@pytest.mark.parametrize("size", [1e-6, 9e-5, 1.1e-4, 0.5, 3.0])
def test_the_angular_velocity_of_a_rotation_vector(size: float) -> None:
    r = np.array([[0.6, -0.48, 0.64]]) * size
    dr = np.array([[0.3, 1.1, -0.7]])
    e = 1e-5
    ahead, back = (Rotation.from_rotvec(r + s * e * dr) for s in (1, -1))
    expected = (ahead * back.inv()).as_rotvec() / (2 * e)
    assert_allclose(commanded._left_jacobian(r, dr), expected, rtol=1e-7, atol=1e-8)


def test_the_low_pass_of_learning_ends_in_constants() -> None:
    """Filtered inside, mean of half the blend at each end, an odd polynomial of degree 7
    between.
    """
    chance = np.random.default_rng(1)
    error = chance.normal(size=(200, 2)).cumsum(axis=0)
    period = 4e-3
    found = commanded.CommandedPath.filter(SimpleNamespace(period=period), error, 7.0)
    b, a = butter(2, 2 * 7.0 * period)
    smooth = filtfilt(b, a, error, axis=0, padlen=36)
    blend = 25  # 0.1 s
    assert_allclose(found[blend:-blend], smooth[blend:-blend], atol=1e-12)
    first = error[:12].mean(axis=0)
    last = error[-12:].mean(axis=0)
    assert_allclose(found[[0, -1]], [first, last], atol=1e-12)
    u = np.linspace(0, 1, blend)[:, None]
    ramp = 35 * u**4 - 84 * u**5 + 70 * u**6 - 20 * u**7
    assert_allclose(found[:blend], ramp * smooth[:blend] + (1 - ramp) * first, atol=1e-12)
    assert_allclose(
        found[-blend:], ramp[::-1] * smooth[-blend:] + (1 - ramp[::-1]) * last, atol=1e-12
    )
    short = commanded.CommandedPath.filter(SimpleNamespace(period=0.1), error[:20], 1.0)
    b, a = butter(2, 0.2)
    assert_allclose(short[2:-2], filtfilt(b, a, error[:20], axis=0, padlen=10)[2:-2], atol=1e-12)


class Learned:
    """A robot whose errors are given."""

    def __init__(self, errors: list[float], fails: int = -1) -> None:
        self.errors = errors
        self.asked = []
        self.time = np.zeros(3)
        self.outputs = 1
        self.fails = fails

    def case(self, correction: np.ndarray, iteration: int) -> tuple[float, int]:
        if len(self.asked) == self.fails:
            raise SolverError("no way")
        self.asked.append((correction.copy(), iteration))
        return float(self.errors[len(self.asked) - 1]), iteration

    def error(self, run: object, name: str) -> np.ndarray:
        return np.full((3, 1), run.size)

    def filter(self, error: np.ndarray, low: float) -> np.ndarray:
        return low * error


def iterate(robot: Learned, noisy: bool = False, iterations: int = 4, gain: float = 0.5) -> tuple:
    class Run(SimpleNamespace):
        unit = "m"

        def __getitem__(self, name: str) -> Run:
            return self

        def figures(self, found: Run) -> dict[str, float]:
            return {"error_max_m": found.size}

    def run(case: tuple[float, int]) -> Run:
        return Run(size=case[0])

    seen = (lambda x: x) if noisy else learn._plain
    return learn._iterate(robot, run, seen, "robot", iterations, gain, 10.0, lambda line: None)


@pytest.mark.parametrize(
    ("errors", "noisy", "best", "count", "text"),
    [
        ([1.0, 0.5, 0.2, 0.22, 0.1], False, 4, 5, ""),
        ([1.0, 0.5, 0.2, 0.229, 0.2], False, 2, 5, ""),
        (
            [1.0, 0.5, 0.2, 0.231, 0.1],
            False,
            2,
            4,
            "iteration 3: the error grows; the best iteration is 2",
        ),
        ([1.0, 0.5, 0.2, 1.04, 0.1], True, 4, 5, ""),
        (
            [1.0, 0.5, 0.2, 1.06, 0.1],
            True,
            2,
            4,
            "iteration 3: the error grows; the best iteration is 2",
        ),
        ([np.inf, 0.5], False, 0, 1, "the robot fails without correction"),
        ([1.0, np.nan, 0.1], False, 0, 2, "iteration 1: the error grows; the best iteration is 0"),
        ([1.0, 1.0, 1.0, 1.0, 1.0, 0.5], False, 0, 5, ""),
    ],
)
def test_learning_ends_where_the_error_grows(
    errors: list[float], noisy: bool, best: int, count: int, text: str
) -> None:
    robot = Learned(errors)
    runs, corrections, found, stopped, shown = iterate(robot, noisy)
    assert (found, len(runs), len(corrections), stopped) == (best, count, count, text)
    assert_array_equal(shown, [np.inf if not np.isfinite(e) else e for e in errors[:count]])
    assert [iteration for _, iteration in robot.asked] == list(range(count))
    expected = 0.0
    for k in range(count):
        assert_allclose(corrections[k], expected)
        expected -= (0.5 / (k + 1) if noisy else 0.5) * 10.0 * errors[k]


def test_a_corrected_path_without_inversion_ends_learning_but_not_the_first() -> None:
    runs, corrections, best, stopped, _ = iterate(Learned([1.0, 0.5, 0.4], fails=2))
    assert (len(runs), len(corrections), best) == (2, 2, 1)
    assert stopped == "iteration 2: the corrected path cannot be inverted (no way)"
    with pytest.raises(SolverError, match="no way"):
        iterate(Learned([1.0], fails=0))


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("iterations", 0, "iterations: given 0, expected 1 to 1000"),
        ("iterations", 1001, "iterations: given 1001"),
        ("gain", 0.0, "gain: given 0.0, expected more than 0, at most 2"),
        ("gain", 2.01, "gain: given 2.01"),
        ("measured_by", "eye", "measured_by: given 'eye', expected one of tracker, accelerometer"),
    ],
)
def test_wrong_arguments_of_learning(name: str, value: object, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        flexgen.learn("elbow", **{name: value})


def test_accelerometers_for_learning_are_those_of_the_model_or_one_at_the_tool() -> None:
    model = flexgen.read("elbow")
    found = learn._accelerometers(model, 1e-4)
    assert found.names[:2] == tuple(m.name for m in model.motors) and len(found.names) == 5
    assert_allclose(found.noise[:2], 1e-4)
    assert learn._places(model, SimpleNamespace(names=(model.motors[1].name,))).tolist() == [1]


def extreme(
    a: np.ndarray,
    b: np.ndarray,
    g: np.ndarray,
    torque: np.ndarray,
    top: float,
    h: float,
    after: float,
):
    """Largest x of the linear program over (u, x) by SciPy."""
    rows = np.vstack([np.c_[a, b], -np.c_[a, b], [[2 * h, 1.0], [-2 * h, -1.0]]])
    right = np.r_[torque - g, torque + g, after, 0.0]
    found = linprog([0.0, -1.0], rows, right, bounds=[(None, None), (0, min(top, 1e12))])
    return found.x[1] if found.status == 0 else None


def test_the_largest_squared_speed_is_that_of_a_linear_program() -> None:
    chance = np.random.default_rng(5)
    for k in range(25):
        a, b, g = chance.normal(size=(3, 3))
        torque = chance.uniform(0.3, 2.0, 3)
        top = np.inf if k % 3 == 0 else chance.uniform(0.1, 2.0)
        h = chance.uniform(0.01, 0.5)
        after = chance.uniform(0.0, 2.0)
        found = _extreme(a, b, g, torque, top, h, after)
        expected = extreme(a, b, g, torque, top, h, after)
        assert (found is None) == (expected is None)
        if found is not None and found < 1e11:
            assert found == pytest.approx(expected, rel=1e-6, abs=1e-7)


def test_the_next_squared_speed_is_that_of_the_weakest_motor() -> None:
    a = np.array([2.0, -1.0, 0.0])
    b = np.array([0.5, 0.1, 9.0])
    g = np.array([1.0, 0.2, 0.0])
    torque = np.full(3, 5.0)
    limits = [(5 - 1 - 0.5 * 3) / 2, (-5 - 0.2 - 0.1 * 3) / -1]
    assert _accelerate(a, b, g, torque, 3.0, 0.25) == pytest.approx(3.0 + 0.5 * min(limits))
    assert _accelerate(-a, b, g, torque, 3.0, 0.25) == pytest.approx(
        3.0 + 0.5 * min((-5 - 1 - 1.5) / -2, (5 - 0.2 - 0.3) / 1)
    )
    assert (
        _accelerate(np.array([1.0]), np.array([0.0]), np.array([9.0]), np.array([1.0]), 1.0, 1.0)
        == 0.0
    )


def test_the_shortest_time_of_a_mass_is_bang_bang() -> None:
    """2 sqrt(L m / F); with a largest speed v: L / v + m v / F; with weight the force that lifts
    is smaller.
    """
    s = np.linspace(0.0, 2.0, 101)
    ones = np.ones((101, 1))
    none = np.zeros((101, 1))
    free = np.full(101, np.inf)
    assert _time(s, 3 * ones, none, none, np.array([6.0]), free) == pytest.approx(
        2 * np.sqrt(2 * 3 / 6), rel=1e-6
    )
    slow = _time(s, 3 * ones, none, none, np.array([6.0]), np.full(101, 0.49))
    assert slow == pytest.approx(2 / 0.7 + 3 * 0.7 / 6, rel=1e-2)
    up = (6 - 1.5) / 3
    down = (6 + 1.5) / 3
    peak = np.sqrt(2 * 2.0 * up * down / (up + down))
    assert _time(s, 3 * ones, none, 1.5 * ones, np.array([6.0]), free) == pytest.approx(
        peak / up + peak / down, rel=2e-3
    )
    assert np.isnan(_time(s, none, none, 7 * ones, np.array([6.0]), free))
    with pytest.raises(
        SolverError, match="the rigid robot cannot leave a point of the path within the limits"
    ):
        _time(s, 3 * ones, none, 7 * ones, np.array([6.0]), free)


def search(n: int = 3, **more: object) -> TimeSearch:
    """A search without a robot."""
    out = object.__new__(TimeSearch)
    out.n = n
    out.tell = lambda line: None
    out.programs = 0
    out.inversions = 0
    out.swings = None
    for name, value in more.items():
        setattr(out, name, value)
    return out


def test_the_first_law_is_the_polynomial_a_little_slower() -> None:
    segment = SimpleNamespace(law=TimeLaw(2.0, 5))
    made = search(12, path=SimpleNamespace(duration=2.0, segments=(segment,)))
    x = made.start()
    assert (
        x[0] == 2.04 and len(x) == 13 and np.all(np.diff(x[1:]) >= 0) and x[1] >= 0 and x[-1] <= 1
    )
    law = made.law(x)
    t = np.linspace(0, 2.04, 50)
    assert_allclose(law(t, 0)[:, 0], TimeLaw(2.04, 5)(t, 0)[:, 0], atol=5e-3)
    move = flexgen.read("elbow").moves[0]
    made.path.move = replace(move, profile=(1.0, 2.0, 3.0), smoothness=3)
    timed = made.move(x)
    assert (timed.duration, timed.timing, timed.profile, timed.smoothness) == (
        2.04,
        tuple(x[1:]),
        (),
        5,
    )


def test_limits_are_those_given_then_those_of_the_model_then_the_torques_of_the_move() -> None:
    own = {"motor.m1.torque_max": 5.0, "motor.m2.speed_max": 7.0, "motor.m1.torque_rate_max": 80.0}
    model = flexgen.read("elbow", overrides=own)
    tau = np.array([[9.0, -3.0], [-8.0, 2.0], [-8.0, 2.0]])
    port = Port("tau_m", (2,), "N m", "of motors")
    labels = ("m1", "m2")
    moved = Trajectory(
        np.array([0.0, 0.1, 0.2]), {"tau_m": tau}, {"tau_m": port}, {"tau_m": labels}
    )
    default = SimpleNamespace(trajectory=moved)
    found = _limits_of(model, None, None, default)
    assert found == Limits((5.0, 3.0), (np.inf, 7.0), torque_rate=(80.0, np.inf))
    given = Limits(torque=(1.0, 2.0), speed=(3.0, 4.0), tool_speed=0.5, reserve=0.1)
    assert _limits_of(model, given, None, default) == replace(given, torque_rate=(80.0, np.inf))
    # largest rates: 170 and 50 N m/s
    found = _limits_of(model, Limits(speed=(3.0, 4.0)), 2.0, default)
    assert found == Limits((5.0, 3.0), (3.0, 4.0), torque_rate=(80.0, 100.0))


def test_samples_of_a_search_are_as_many_for_every_duration() -> None:
    at = search(samples=300)._instants(700, 200)
    assert_array_equal(at, np.arange(50, 651))
    assert_array_equal(
        search(samples=300)._instants(460, 100), np.clip(np.arange(-50, 551), 0, 458)
    )


def test_the_linear_program_of_a_step() -> None:
    """min dT + 5 sigma + 1e-3 |dc|, rows near a limit only; the order of the coefficients
    stays.
    """
    made = search(2)
    x = np.array([2.0, 0.3, 0.6])
    scale = 2.0
    trust = 0.08
    g = np.array([0.9, -0.95, 0.2])
    G = np.array([[-0.6, 0.5, 0.0], [0.4, 0.1, -0.7], [-99.0, 0.0, 0.0]])
    step = made._program(x, g, G, trust, scale)
    A = G[:2] * [2.0, 1.0, 1.0]
    e = np.eye(2)
    o = np.zeros((2, 1))
    rows = np.vstack(
        [
            np.c_[A, -np.ones(2), np.zeros((2, 2))],
            np.c_[-A, -np.ones(2), np.zeros((2, 2))],
            [[0, -1, 0, 0, 0, 0], [0, 1, -1, 0, 0, 0], [0, 0, 1, 0, 0, 0]],
            np.c_[o, e, o, -e],
            np.c_[o, -e, o, -e],
        ]
    )
    right = np.r_[1 - g[:2], 1 + g[:2], 0.3, 0.3, 0.4, np.zeros(4)]
    bounds = [(-trust, trust)] * 3 + [(0, None)] * 3
    expected = linprog([1, 0, 0, 5, 1e-3, 1e-3], rows, right, bounds=bounds).x[:3] * [2.0, 1, 1]
    assert_allclose(step, expected, atol=1e-9)
    assert step[0] < 0
    tight = made._program(np.array([1.0, 0.5, 0.5]), g, G, 0.5, 1.0)
    c = np.r_[0.0, np.array([0.5, 0.5]) + tight[1:], 1.0]
    assert np.all(np.diff(c) >= -1e-9)


def test_the_linear_program_of_less_vibration() -> None:
    made = search(2)
    trust = 0.1
    x = np.array([2.0, 0.3, 0.6])
    g = np.array([0.95, -0.99, 0.1])
    s = np.array([1.5, -1.2])
    G = np.array([[0.5, 0.1], [0.2, 0.4], [9.0, 9.0], [-2.0, 1.0], [1.0, 3.0]])
    step = made._calm_program(x, g, s, G, trust)
    A = G[:2]
    B = G[3:]
    one = np.ones((2, 1))
    none = np.zeros((2, 1))
    order = [[-1, 0, 0, 0], [1, -1, 0, 0], [0, 1, 0, 0]]
    rows = np.vstack(
        [
            np.c_[A, none, -one],
            np.c_[-A, none, -one],
            np.c_[B, -one, none],
            np.c_[-B, -one, none],
            order,
        ]
    )
    right = np.r_[1 - g[:2], 1 + g[:2], -s, s, 0.3, 0.3, 0.4]
    bounds = [(-trust, trust)] * 2 + [(0, None)] * 2
    expected = linprog([0, 0, 1, 30.0], rows, right, bounds=bounds).x[:2]
    assert_allclose(step, expected, atol=1e-9)


def test_slopes_of_the_search_are_differences_and_go_back_where_a_step_fails() -> None:
    G = np.array([[2.0, -1.0, 0.5], [0.3, 0.7, -4.0]])

    def constraints(x: np.ndarray, finer: int = 1) -> np.ndarray:
        if x[1] > 0.5:
            raise SolverError("none")
        return G @ x if x[2] < 0.9 or finer > 1 else np.array([np.nan, 0.0])

    made = search(constraints=constraints)
    x = np.array([3.0, 0.5, 0.6])
    assert_allclose(made._slopes(x, G @ x), G, rtol=1e-9)
    assert (
        made.try_constraints(np.array([3.0, 0.6, 0.1])) is None
        and made.try_constraints(np.array([3.0, 0.1, 0.95])) is None
    )
    edge = np.array([3.0, 0.5, 2.0])
    assert not made._slopes(edge, np.ones(2)).any()
    assert made.excess(np.array([-1.0, 0.0, 0.0])) == 1.0


def test_the_search_ends_at_the_shortest_time_within_the_limits() -> None:
    """g = ((T0/T)^2 (1 + (c - c0)^2), ...): the least T is T0 with c = c0."""
    best = np.array([0.4, 0.7])

    def constraints(x: np.ndarray, finer: int = 1) -> np.ndarray:
        made.inversions += 1
        shape = 1 + 4 * (x[1:] - best) ** 2
        return np.r_[(1.5 / x[0]) ** 2 * shape.sum() / 2, -0.1]

    made = search(2, constraints=constraints, start=lambda: np.array([3.0, 0.2, 0.5]))
    x, history = made.run()
    assert_allclose(x, [1.5, *best], atol=0.02)
    assert (
        history[0] == 3.0 and np.all(np.diff(history) < 1e-3) and made.programs < time_search.MOST
    )
    assert np.abs(constraints(x)).max() <= 1 + time_search.KEPT
    # measured when this test was written: rules of the trust region
    assert (made.programs, len(history)) == (28, 19)
    unable = search(2, constraints=lambda x, finer=1: np.array([2.0]), limits=flexgen.Limits())
    with pytest.raises(
        SolverError, match=r"cannot be kept on this path at any speed; .* needs 2 of a limit"
    ):
        unable._slow_down(np.array([1.0, 0.5]))
    with pytest.raises(
        SolverError, match=r"the first time law cannot be inverted \(a torque is not finite\)"
    ):
        search(
            2, constraints=lambda x, finer=1: np.array([np.nan]), start=lambda: np.ones(3)
        ).run()

    def refuses(x: np.ndarray, finer: int = 1) -> np.ndarray:
        raise SolverError("the path passes a singular pose")

    with pytest.raises(
        SolverError, match=r"cannot be inverted \(the path passes a singular pose\); .*\"joint\""
    ):
        search(2, constraints=refuses, start=lambda: np.ones(3)).run()


def test_a_law_is_slowed_down_until_its_limits_are_kept() -> None:
    made = search(constraints=lambda x, finer=1: np.array([finer / 3 * 1.2 / x[0]]))
    x = made._slow_down(np.array([1.0, 0.4]))
    assert x[1] == 0.4 and 1.2 / x[0] - 1 <= 4e-4 and x[0] <= 1.2
    excess = 1.2 / 1.0 - 1
    steps = [1.0]
    while excess > 4e-4:
        steps.append(steps[-1] * (1 + max(0.3 * excess, 1e-4)))
        excess = 1.2 / steps[-1] - 1
    assert x[0] == pytest.approx(steps[-1], rel=1e-12)


def calming(allowed: float) -> TimeSearch:
    """Vibration falls with the duration and with c near 0.5; limits hold for c <= 0.8."""

    def constraints(x: np.ndarray, finer: int = 1) -> np.ndarray:
        made.last = x
        return np.array([x[1] / 0.8, -0.3])

    def swing(x: np.ndarray) -> np.ndarray:
        return np.array([(1 + 20 * (x[1] - 0.5) ** 2) / x[0] ** 4, -0.1]) / allowed

    made = search(
        1, constraints=constraints, swing=swing, swings=allowed, model=flexgen.read("two_arm")
    )
    return made


def test_less_vibration_takes_the_shortest_of_the_longer_durations() -> None:
    made = calming(0.8)
    x = made.calm(np.array([1.0, 0.2]), [2.0, 1.0])
    assert x[0] == pytest.approx(1.06)  # 1.06^-4 = 0.79 <= 0.8 < 1.045^-4 = 0.84
    assert 0.4 < x[1] < 0.6 and made.programs > 2
    with pytest.raises(
        SolverError,
        match=r"vibration stays above 0\.01 rad with 2 times the shortest duration; allow",
    ):
        calming(0.01).calm(np.array([1.0, 0.5]), [1.0])
    x, worst = calming(10.0)._calmest(np.array([1.0, 0.2]))
    assert_array_equal(x, [1.0, 0.2])  # nothing to do
    assert worst == pytest.approx((1 + 20 * 0.09) / 10)
    x, worst = calming(1e-3)._calmest(np.array([1.0, 0.2]))
    assert x[1] == pytest.approx(0.5, abs=0.05) and worst == pytest.approx(1000.0, rel=0.05)


def test_vibrations_after_a_move_are_those_of_robots_with_other_springs() -> None:
    """Of `flexgen.planning.fastest.residual_vibration`: the static part is left out; without
    motion there is none.
    """
    solution = flexgen.solve("planar5_nmp", verify=False, progress=False)
    made = residual_vibration.ResidualVibration(derive("planar5_nmp"), lambda line: None)
    found = made(solution.trajectory, solution.move.duration)
    assert found.shape == (2, 200, 2)
    late = slice(150, None)
    assert np.abs(found[:, late].mean(axis=1)).max() < 0.1 * np.abs(found).max()
    check_numbers("vibration", 1e-4, found=found, rate=made._rate)
    channels = {
        name: np.repeat(x[:1], 3, axis=0) for name, x in solution.trajectory.channels.items()
    }
    rest = replace(solution.trajectory, time=np.array([0.0, 0.5, 1.0]), channels=channels)
    assert np.abs(made(rest, 1.0)).max() < 1e-3 * np.abs(found).max()


@pytest.mark.slow
def test_vibration_does_not_include_what_hysteresis_holds_at_rest() -> None:
    """The tool comes to rest 0.15 mm from where the springs alone would hold it; it vibrates as
    without hysteresis.
    """
    gears = {
        f"element.arm{k}.dof.q{k}.gear.hysteresis": {"lost_motion": 2.9e-4, "stiffness": 4e5}
        for k in (1, 2)
    }
    found = []
    for model in (flexgen.read("planar5_nmp"), flexgen.read("planar5_nmp", overrides=gears)):
        solution = flexgen.solve(model, verify=False, progress=False)
        made = residual_vibration.ResidualVibration(derive(model), lambda line: None)
        found.append(np.linalg.norm(made(solution.trajectory, solution.move.duration), axis=2))
    assert found[1].max() < found[0].max() < 1e-5  # m
    assert found[1][:, -1].max() < 1e-7  # 1.5e-4 with the rest of the springs


def test_a_law_that_is_slowed_down_keeps_the_bound_of_the_vibration() -> None:
    """Between its samples a limit allows 1.2 s or more; robots vibrate between 1.15 and 1.25 s."""

    def constraints(x: np.ndarray, finer: int = 1) -> np.ndarray:
        return np.array([(1.2 if finer > 1 else 0.5) / x[0]])

    def swing(x: np.ndarray) -> np.ndarray:
        return np.array([1.5 if 1.15 < x[0] < 1.25 else 0.5])

    x = search(1, constraints=constraints, swing=swing, swings=1.0).calm(
        np.array([1.0, 0.5]), [1.0]
    )
    assert x[0] == pytest.approx(1.3)


def test_a_bound_of_the_vibration_is_one_of_its_size() -> None:
    """Not of its components, each of which is below the bound here."""
    motion = SimpleNamespace(
        _vibration=lambda *_: np.array([[[0.9, 0.8], [0.3, -0.4]]]), swings=1.0, force=None
    )
    motion.found = None
    motion.model = SimpleNamespace(name="")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_search, "trajectory_of", lambda *_: None)
        assert_allclose(TimeSearch.swing(motion, np.array([1.0])), [np.hypot(0.9, 0.8), 0.5])


@pytest.mark.parametrize("move", ["joints", "line"])
def test_joints_along_a_path_have_the_derivatives_of_their_differences(move: str) -> None:
    """Moves of the joints and of the tool; they begin at the start of the path."""
    path = flexgen.plan("elbow", move)
    s = np.linspace(0.2, 0.8, 5) * path.duration
    h = 1e-4
    q, dq, ddq = joint_motion(path, s)
    more, less = (joint_motion(path, s + x)[0] for x in (h, -h))
    assert_allclose(dq, (more - less) / (2 * h), rtol=1e-5, atol=1e-6)
    assert_allclose(ddq, (more - 2 * q + less) / h**2, rtol=1e-3, atol=1e-3)
    first = joint_motion(path, np.array([1e-6, 0.1]))[0][0]
    assert_allclose(first, path.q_start[list(path.equations.model.i_g)], atol=1e-6)


def test_a_corrected_pose_is_turned_and_has_the_rates_of_its_rotation() -> None:
    """Position plus, rotation by the vector from the left; rates by differences of the corrected
    motion.
    """
    h = 2e-3
    n = 201
    t = h * np.arange(n)
    rise = (t / t[-1]) ** 4 * (1 - t / t[-1]) ** 4 * 256
    turns = rise[:, None] * [0.3, -0.2, 0.5]
    R = Rotation.from_rotvec(turns)
    w = np.array([(R[k + 1] * R[k - 1].inv()).as_rotvec() / (2 * h) for k in range(1, n - 1)])
    w = np.vstack([0 * w[:1], w, 0 * w[:1]])
    y = np.hstack(
        [rise[:, None] * [1.0, 2.0, 3.0], R.as_matrix().transpose(0, 2, 1).reshape(n, 9)]
    )
    v = np.gradient(y[:, :3], h, axis=0)
    made = object.__new__(commanded.CommandedPath)
    dy = np.hstack([v, w])
    ddy = np.gradient(np.hstack([v, w]), h, axis=0)
    vars(made).update(time=t, period=h, _R=R.as_matrix(), _y=y, _rates=(dy, ddy))
    correction = rise[:, None] * [1e-2, -2e-2, 3e-2, 0.05, 0.1, -0.08]
    found, rates, second = made._correct(correction)
    assert_allclose(found[:, :3], y[:, :3] + correction[:, :3], atol=1e-12)
    turned = Rotation.from_rotvec(correction[:, 3:]) * R
    assert_allclose(found[:, 3:], turned.as_matrix().transpose(0, 2, 1).reshape(n, 9), atol=1e-9)
    inside = slice(5, -5)
    expected = np.array(
        [(turned[k + 1] * turned[k - 1].inv()).as_rotvec() / (2 * h) for k in range(1, n - 1)]
    )
    assert_allclose(rates[1:-1][inside, 3:], expected[inside], atol=2e-3 * np.abs(expected).max())
    moved = np.gradient(found[:, :3], h, axis=0)
    assert_allclose(rates[inside, :3], moved[inside], atol=2e-3 * np.abs(moved).max())
    for part in (slice(0, 3), slice(3, 6)):
        slope = np.gradient(rates[:, part], h, axis=0)
        assert_allclose(second[inside, part], slope[inside], atol=2e-2 * np.abs(slope).max())


def test_the_mesh_of_a_search_is_a_part_of_the_duration() -> None:
    """Of `flexgen.planning.fastest.time_search`: what resolves the force, at most 5 ms."""
    search = SimpleNamespace(_resolving=0.004)
    found = [TimeSearch.mesh(search, duration) for duration in (0.5, 1.2, 8.0)]
    assert found == pytest.approx([0.002, 0.0048, 0.005])


def test_deviations_of_a_load_are_those_of_leaving_out_half_a_second() -> None:
    """Fewer than six blocks tell nothing."""
    rng = np.random.default_rng(0)
    estimate = object.__new__(payload._Estimate)
    estimate.h = 0.01
    estimate.block = 0.5
    r = rng.standard_normal((400, 2))
    J = rng.standard_normal((800, 5))
    prior = np.diag([0.0, 0.0, 0.0, 0.0, 3.0])
    expected = block_covariance(J.reshape(400, 2, 5), r, range(0, 400, 50), prior, by_axis=False)
    np.testing.assert_allclose(estimate._left_out(r, J, prior), expected)
    assert estimate._left_out(r[:251], J[:502], prior).any()
    assert not estimate._left_out(r[:250], J[:500], prior).any()


def test_frictions_that_changed_with_temperature_change_no_load() -> None:
    """Viscous friction 30 % less and the other 20 % more than in the model, motor by motor."""
    model = flexgen.read("manutec_r3")
    change = np.array([3.0, 0.1, 0.05, -0.08])
    laws = [
        Friction(viscous=0.7 * 2e-3, coulomb=1.2 * 0.2, beta=10.0),
        Friction(viscous=2e-3, coulomb=0.2, beta=10.0),
    ]
    robots = [
        replace(model, motors=tuple(replace(m, friction=law) for m in model.motors))
        for law in laws
    ]
    given = record(robots[0], change)
    found = identify_load(robots[1], given, low_pass_hz=6.0)
    assert_allclose(
        np.r_[found.total_mass, found.total_com],
        np.array([15.0, 0.1, 0.25, 0.1]) + change,
        atol=5e-3,
    )
    assert_allclose(found.friction, np.array([[0.7], [1.2]]) @ np.ones((1, 6)), atol=0.02)


def test_the_low_pass_of_a_load_is_near_the_lowest_natural_frequency_at_most() -> None:
    """17.4 Hz with the motors at rest; a hundredth of the stiffness gives a tenth."""
    springs = {
        f"element.{x}.gear.spring.stiffness": k
        for x, k in (("upper.dof.q1", 7.5189e4), ("fore.dof.q2", 4.0999e4))
    }
    for robot, rigid, expected in (
        (flexgen.read("elbow"), False, 8.0),
        (flexgen.read("elbow", overrides=springs), True, 8.0),
        (flexgen.read("elbow@rigid"), False, 8.0),
        (flexgen.read("elbow", overrides=springs), False, 1.5 * 1.742),
    ):
        home = np.tile(robot.eta @ np.asarray(robot.home), (1000, 1))
        assert payload._default_low_pass(robot, home, 2e-3, rigid) == pytest.approx(
            expected, rel=0.05
        )
    quick = np.sin(2 * np.pi * 4.0 * 2e-3 * np.arange(1000))[:, None] * np.ones(2)
    assert payload._default_low_pass(
        flexgen.read("elbow@rigid"), quick, 2e-3, False
    ) == pytest.approx(5 * 4.0, rel=0.2)
    assert payload._default_low_pass(
        flexgen.read("elbow@rigid"), quick, 6e-2, False
    ) == pytest.approx(0.1 / 6e-2)
