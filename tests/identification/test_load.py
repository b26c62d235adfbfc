"""Loads from short records of a rigid arm that is known: deviations by draws, directions that no
motion shows, and what is refused.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.load.compliances import stiffness_deviations
from flexgen.identification.load.payload import identify_load, values_of

H = 4e-3
COUNT = 900
PORTS = {x: Port(x, (2,), unit, "") for x, unit in (("q_m", "rad"), ("tau_m", "N m"))}
LABELS = {name: ("m1", "m2") for name in PORTS}
TRUE = np.array([30.0, 1.25, 0.0, -0.1])  # kg, m; the y of a planar arm shows nowhere


def record(noise: float, seed: int = 0, *, late: int = 0, **payload: Any) -> flexgen.Trajectory:
    """The rigid elbow with the load; white noise of the torques, over the largest."""
    mass, *com = TRUE.tolist()
    carried = {"mass": mass, "com": com} | payload
    robot = flexgen.read("elbow@rigid", overrides={"payload": carried})
    t = H * np.arange(COUNT)
    rates = np.array([3.1, 4.3])
    q = 0.6 * np.sin(t[:, None] * rates)
    v = 0.6 * rates * np.cos(t[:, None] * rates)
    a = -(rates**2) * q
    arm = evaluate(derive(robot).function("inverse_dynamics"), q, v, a)[0].reshape(q.shape)
    friction = evaluate(derive(robot).function("motor_friction"), v @ robot.eta.T)[0]
    inertia = np.array([m.inertia for m in robot.motors])
    tau = arm @ np.linalg.inv(robot.eta) + inertia * (a @ robot.eta.T)
    tau = np.roll(tau + friction.reshape(q.shape), late, axis=0)
    draws = np.random.default_rng(seed).standard_normal(tau.shape)
    tau = tau + noise * np.abs(tau).max(axis=0) * draws
    return flexgen.Trajectory(t, {"q_m": q @ robot.eta.T, "tau_m": tau}, PORTS, LABELS)


def test_a_load_has_the_deviations_of_its_draws() -> None:
    """Mass, center of mass and delay of records with noise of their own."""
    found = [identify_load("elbow@rigid", record(0.005, seed)) for seed in range(5)]
    numbers = np.array([[x.mass, x.com[0], x.com[2]] for x in found])
    sd = np.array([[x.mass_sd, x.com_sd[0], x.com_sd[2]] for x in found])
    away = (numbers - TRUE[[0, 1, 3]]) / sd
    assert np.abs(away).max() < 4.0 and 0.4 < np.sqrt((away**2).mean()) < 1.5
    assert (sd[:, 0] < 1.0).all() and (sd[:, 1:] < 0.1).all()
    late = identify_load("elbow@rigid", record(0.0, late=2))
    assert late.delay_s == pytest.approx(2 * H, rel=0.02)
    assert abs(late.mass - TRUE[0]) < 3 * late.mass_sd
    # what is left is the noise that the low pass of 8 Hz lets through, at the gears
    quiet = identify_load("elbow@rigid", record(0.0)).residual_Nm
    left = np.sqrt(np.mean([x.residual_Nm**2 for x in found], axis=0) - quiet**2)
    eta = np.abs(np.diag(flexgen.read("elbow@rigid").eta))
    white = 0.005 * np.abs(record(0.0)["tau_m"]).max(axis=0) * eta
    band = 3 * np.pi / 4 / np.sqrt(2) * 8.0 * H
    assert_allclose(left, white * np.sqrt(band), rtol=0.3)


def test_a_direction_that_no_motion_shows_is_known_by_the_file() -> None:
    """Within a meter of the center of mass of its payload."""
    load = identify_load("elbow@rigid", record(0.01))
    assert load.com_sd[1] == pytest.approx(1.0, rel=0.02) and abs(load.com[1]) < 1e-6
    assert str(load).count("y not determined") == 1 and "x not determined" not in str(load)


def refused(data: flexgen.Trajectory, **changes: Any) -> str:
    with pytest.raises(SolverError) as caught:
        identify_load(flexgen.read("elbow@rigid", overrides=changes), data)
    return str(caught.value)


def test_records_that_no_load_explains_are_refused() -> None:
    """Torques that no mass has, and a robot at rest without gravity."""
    data = record(0.0)
    wave = np.abs(data["tau_m"]).max(axis=0) * np.cos(13.0 * data.time)[:, None]
    other = {"q_m": data["q_m"], "tau_m": data["tau_m"] + 2.0 * wave}
    assert refused(flexgen.Trajectory(data.time, other, PORTS, LABELS)).startswith(
        "load: no load explains the record, "
    )
    still = {"q_m": 0 * data["q_m"] + 1.0, "tau_m": 1e-6 * data["tau_m"]}
    rest = flexgen.Trajectory(data.time, still, PORTS, LABELS)
    assert refused(rest, gravity=[0.0, 0.0, 0.0]).startswith(
        "load: the motion does not determine the mass; move the joints that carry the load"
    )


def test_the_center_of_a_mass_that_is_nearly_zero_is_near() -> None:
    assert_allclose(values_of(np.array([2.0, 0.4, -0.2, 0.0, 9.0]), 3.0), [2.0, 0.2, -0.1, 0.0])
    near = values_of(np.array([1e-6, 0.01, -0.01, 1e-6, 9.0]), 3.0)
    assert_allclose(near, [1e-6, 3.0, -3.0, 1.0])


def test_the_deviation_of_a_spring_is_that_of_the_model_file() -> None:
    """By name, else that of all stiffnesses, else a fifth; rigid gears have none."""
    stated = {"stiffness": 0.1, "parameters": ["q2.stiffness", "q3.stiffness"], "sd": [0.05, 0.0]}
    for uncertainty, expected in (
        (None, [0.2, 0.2, 0.2]),
        ({"masses": 0.03}, [0.2, 0.2, 0.2]),
        ({"stiffness": 0.1}, [0.1, 0.1, 0.1]),
        (stated, [0.1, 0.05, 0.0]),
    ):
        changes = {} if uncertainty is None else {"uncertainty": uncertainty}
        given = flexgen.read("planar5_nmp", overrides=changes)
        assert stiffness_deviations(given).tolist() == expected
    assert not stiffness_deviations(flexgen.read("elbow@rigid")).any()
    assert stiffness_deviations(flexgen.read("beam_arm")).tolist() == [0.2] * 4
