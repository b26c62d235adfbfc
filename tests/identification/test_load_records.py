"""Loads of elastic arms that are known: whole records, filters by hand, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from enlarged import rescaled
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import butter, filtfilt

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import gear_deflection
from flexgen.identification.load import payload
from flexgen.identification.load.payload import identify_load
from flexgen.model.elements import Friction, RobotModel

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


@pytest.mark.slow
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


@pytest.mark.slow
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
    made = payload.LoadEstimate(
        flexgen.read("beam_arm"), record("elbow", np.zeros(4)), 6.0, rigid=True
    )
    assert made.names == LOADED
    made = payload.LoadEstimate(
        flexgen.read("elbow"), record("elbow", np.zeros(4)), 6.0, rigid=True
    )
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
    """Gear torques of the record by hand."""
    given = record("elbow", np.zeros(4))
    model = flexgen.read("elbow")
    found = payload.LoadEstimate(model, given, 8.0, False)

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
    rigid = payload.LoadEstimate(model, given, 8.0, True)
    assert_allclose(rigid.q_geared, smooth(given["q_m"]) @ np.linalg.inv(model.eta).T, atol=1e-12)
    q, v, a = rigid.motion(np.zeros(4), np.zeros(model.n_a))
    assert_allclose(v, rate(q), atol=1e-12)
    assert_allclose(a, rate(v), atol=1e-10)


def test_deflections_of_coordinates_without_motor_hold_the_forces() -> None:
    """Spring equation ``k q_e = -(1 + softer) forces`` after three substitutions, slow motion;
    gears likewise.
    """
    model = flexgen.read("planar5_nmp")
    given = record("planar5_nmp", np.zeros(4))
    found = payload.LoadEstimate(model, given, 5.0, False)
    values = found.of_file[-4:]
    springs = [model.coordinates[i].dof.spring.stiffness for i in model.i_e]
    assert_allclose(found.stiffness, springs, rtol=1e-6)
    softer = np.array([0.2, -0.1, 0.15])
    i_e = list(model.i_e)
    i_g = list(model.i_g)
    q, v, a = found.motion(values, softer)
    needed = found.forces(q, v, a, values)
    forces = filtfilt(*butter(2, 2 * 3 * 5.0 * 5e-3), needed, axis=0)[found.kept][:, i_e]
    left = q[found.kept][:, i_e] * found.stiffness + (1 + softer[i_e]) * forces
    assert np.abs(left).max() < 0.02 * np.abs(forces).max()
    assert_array_equal(found.motion(values, np.zeros(3))[0][:, i_g], found.q_geared[:, i_g])
    stiff = found.q_m @ np.linalg.inv(model.eta).T
    assert_allclose(
        q[:, i_g], stiff - (1 + softer[i_g]) * (stiff - found.q_geared[:, i_g]), atol=1e-12
    )
    assert np.abs(stiff - found.q_geared[:, i_g]).max() > 1e-4


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
        assert payload.default_low_pass(robot, home, 2e-3, rigid) == pytest.approx(
            expected, rel=0.05
        )
    quick = np.sin(2 * np.pi * 4.0 * 2e-3 * np.arange(1000))[:, None] * np.ones(2)
    assert payload.default_low_pass(
        flexgen.read("elbow@rigid"), quick, 2e-3, False
    ) == pytest.approx(5 * 4.0, rel=0.2)
    assert payload.default_low_pass(
        flexgen.read("elbow@rigid"), quick, 6e-2, False
    ) == pytest.approx(0.1 / 6e-2)
