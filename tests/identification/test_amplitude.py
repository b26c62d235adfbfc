"""The amplitude test: nonlinearities that a model lacks are named from two levels, and linear
faults are not.

The robots are integrated in the time domain with the laws themselves, see `amplitude_plant`.
Describing functions are compared with means over random numbers and with loops in the time domain.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import amplitude_plant as plant
import numpy as np
import pytest
from identification_cases import exact_responses, poses_of

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.causes import levels as at_levels
from flexgen.identification.responses import amplitude
from flexgen.identification.responses.describing_functions import (
    average_coulomb,
    average_hysteresis,
    average_spring,
)
from flexgen.identification.responses.gear_changes import fit_changes
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.rigid.missing_springs import without

LEVELS = 1.0, 1 / 3
HORIZONTAL = {"gravity": [0.0, 0.0, 0.0]}
# Robots, standard deviations of the deflections of their gears at the full level [rad], and
# Coulomb friction [N m]; the gears of elbow are loaded by gravity.
ROBOTS = {
    "planar5_nmp": (
        flexgen.read("planar5_nmp", overrides=HORIZONTAL),
        np.array([2.0e-4, 1.06e-4]),
        0.04,
    ),
    "elbow": (flexgen.read("elbow"), np.array([2.64e-4, 2.47e-4]), 0.12),
}
NONLINEAR = ("backlash", "stiffness that rises", "hysteresis", "Coulomb friction")
LINEAR = ("nothing", "payload", "masses", "missing spring", "delay")


def law_of(name, cause, factor=1.0):
    """The law that is planted; sizes are those of a gear, times a factor."""
    robot, sd, friction = ROBOTS[name]
    K = np.array([robot.coordinates[i].dof.gear.spring.stiffness for i in robot.i_g])
    return {
        "backlash": lambda: plant.backlash(K, 0.15 * factor * sd),
        "stiffness that rises": lambda: plant.cubic(0.1 * factor * K / (1.5 * sd) ** 2),
        "hysteresis": lambda: plant.hysteresis(0.3 * K, 0.15 * factor * K * sd),
        "Coulomb friction": lambda: plant.coulomb(factor * friction * np.array([1.0, 0.7])),
    }.get(cause, plant.Law)()


def truth_of(name, fault, factor=1.0):
    """The robot with a linear fault, and the delay of its torques in samples."""
    robot = ROBOTS[name][0]
    bodies = [f"{element.name}.mass" for element in robot.elements]
    changed = {"payload": bodies[-1:], "masses": bodies}.get(fault, [])
    size = 1.0 + 0.3 * factor
    return with_values(robot, {p.name: size * p.value for p in select(robot, changed)}), int(
        fault == "delay"
    )


@cache
def responses(name, cause, seed=0, factor=1.0):
    """Frequency responses at both levels, noise 1e-4 rad."""
    robot = ROBOTS[name][0]
    given = {"poses": 3, "lines": 30, "period_s": 2.0, "periods": 3, "transients": 3, "seed": seed}
    plan = flexgen.excite(robot, **given, hardware=DriveHardware(5e-4), progress=False)
    truth, late = truth_of(name, cause, factor)
    law = law_of(name, cause, factor)
    runs = [plant.at_level(plan, level) for level in LEVELS]
    measured = [
        plant.simulate(run, truth, law, seed=2 * seed + k, late=late) for k, run in enumerate(runs)
    ]
    return tuple(flexgen.frf(experiment) for experiment in measured)


def identified(name, cause, seed=0, factor=1.0):
    robot = ROBOTS[name][0]
    data = responses(name, cause, seed, factor)
    model = without(robot, "q3") if cause == "missing spring" else robot
    return flexgen.identify(model, data[0], starts=1, levels=data[1:], progress=False)


once_identified = cache(identified)  # where nothing is planted


@pytest.mark.parametrize(
    "cause", [*(pytest.param(x, marks=pytest.mark.slow) for x in NONLINEAR[:-1]), NONLINEAR[-1]]
)
def test_a_nonlinearity_is_named(cause):
    found = once_identified("planar5_nmp", cause).amplitude
    assert (
        cause in found.causes[0].words and len(found.causes) == 1 and found.causes[0].share > 0.9
    )
    assert found.sentence.startswith("the levels differ by") and cause in found.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.full) for k in (2, 3))])
@pytest.mark.parametrize("cause", NONLINEAR)
@pytest.mark.parametrize("name", ROBOTS)
def test_each_nonlinearity_is_named_on_each_robot(name, cause, seed):
    """Other phases, noise and poses, and sizes from 0.7 to 1.3 times those of above."""
    found = identified(name, cause, seed, np.random.default_rng(seed).uniform(0.7, 1.3)).amplitude
    assert found.causes and cause in found.causes[0].words


@pytest.mark.parametrize(
    "fault", ["nothing", pytest.param("missing spring", marks=pytest.mark.slow)]
)
def test_a_linear_robot_is_not_called_nonlinear(fault):
    assert not identified("planar5_nmp", fault).amplitude.differs


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.full)])
@pytest.mark.parametrize("fault", LINEAR)
@pytest.mark.parametrize("name", ROBOTS)
def test_no_linear_fault_is_called_nonlinear(name, fault, seed):
    """The fits themselves are wrong: each fault but none is a model error."""
    if fault == "missing spring" and name == "elbow":
        pytest.skip("elbow has no spring without motor")
    found = identified(name, fault, seed)
    assert not found.amplitude.differs
    assert (str(found.status) == "fitted") == (fault == "nothing")


@pytest.mark.slow
def test_numbers_of_a_law_are_those_that_were_planted():
    """Coulomb friction within 10 %, the half width of a dead band, a small part of the motion,
    within 35 %.
    """
    friction, gap = (
        once_identified("planar5_nmp", cause).amplitude.causes[0].words
        for cause in NONLINEAR[::-3]
    )
    found = [float(word[1:].strip("+-")) for word in friction.split() if word.startswith("(")]
    np.testing.assert_allclose(found, [0.04, 0.028], rtol=0.1)
    found = [float(word.strip("(+-")) for word in gap.split() if word.startswith("(")]
    np.testing.assert_allclose(found, [0.03, 0.0159], rtol=0.35)


@pytest.mark.slow
def test_without_distortion_two_laws_are_not_told_apart(monkeypatch):
    """Planted: in the horizontal plane the changes of stiffness alone fit a dead band and a cubic
    spring alike.
    """
    monkeypatch.setattr(amplitude, "DISTORTION_SD", 1e9)
    assert len(identified("planar5_nmp", "stiffness that rises").amplitude.causes) == 2


@pytest.mark.slow
def test_a_wrong_sign_of_the_speed_dependence_is_seen(monkeypatch):
    """Planted: a Coulomb friction whose viscous equivalent rises with the speed explains
    nothing.
    """
    monkeypatch.setattr(amplitude, "average_coulomb", lambda speed: average_coulomb(1 / speed))
    found = identified("planar5_nmp", "Coulomb friction").amplitude
    assert found.causes == () and "do not explain it" in found.sentence


@pytest.mark.slow
def test_a_friction_that_the_model_has_is_not_named_again():
    """Responses that differ with amplitude, from a model that has the friction: distortion is the
    remaining difference, and no cause is named.
    """
    robot, _, friction = ROBOTS["planar5_nmp"]
    own = [
        replace(m.friction, coulomb=c * friction, beta=20.0)
        for m, c in zip(robot.motors, (1.0, 0.7), strict=True)
    ]
    model = replace(
        robot, motors=tuple(replace(m, friction=f) for m, f in zip(robot.motors, own, strict=True))
    )
    data = responses("planar5_nmp", "Coulomb friction")
    found = flexgen.identify(model, data[0], starts=1, levels=data[1:], progress=False).amplitude
    assert (
        found.differs
        and not found.changed
        and found.causes == ()
        and "distortion" in found.sentence
    )


@pytest.mark.slow
def test_the_result_is_printed_and_saved():
    found = once_identified("planar5_nmp", "hysteresis")
    assert f"amplitude test: {found.amplitude.sentence}" in found.to_text()
    assert found.to_dict()["amplitude"]["causes"][0]["words"] == found.amplitude.causes[0].words
    alone = replace(found, amplitude=None)
    assert "amplitude" not in alone.to_dict()


def test_a_model_with_backlash_is_refused():
    dead_band = {"type": "backlash", "stiffness": 4e5, "gap": 1e-4, "smoothing": 1e-5}
    robot = flexgen.read("planar5_nmp", overrides={"element.arm1.dof.q1.gear.spring": dead_band})
    with pytest.raises(
        ArgumentError,
        match="levels: given a model with backlash in the gear of q1, expected other",
    ):
        at_levels.elastic_gears(robot)


def test_changes_are_those_of_a_model_with_other_numbers():
    """Against the responses of the model itself; planted: the changes with the other sign."""
    robot = ROBOTS["planar5_nmp"][0]
    changed = {"q1.stiffness": 1.1, "q2.stiffness": 0.9, "q1.damping": 1.3, "m1.viscous": 2.0}
    truth = with_values(
        robot, {p.name: changed[p.name] * p.value for p in select(robot, list(changed))}
    )
    w = 2 * np.pi * np.geomspace(2.0, 120.0, 40)
    poses = poses_of(robot, 1)
    before, after = (exact_responses(each, poses, w, Drive(5e-4)) for each in (robot, truth))
    vector = ParameterVector(robot, ["stiffness"])
    K = at_levels.elastic_gears(robot)[1]
    level = at_levels.level_of(Residuals(vector, before), before, vector.start, K)
    found = fit_changes(level.model, 0, after.G[0], after.variance[0], np.zeros(8))
    k, h, d, v = (
        unit * x for unit, x in zip(level.model.units, found.x.reshape(4, 2), strict=True)
    )
    np.testing.assert_allclose(k, [0.1 * K[0], -0.1 * K[1]], rtol=2e-3)
    np.testing.assert_allclose([d[0], v[0]], [0.3 * 400.0, 20e-4], rtol=0.05)
    assert np.abs(h / K).max() < 2e-3
    step = 1e-6 * np.eye(8)
    central = [
        (level.model.response(0, found.x + z) - level.model.response(0, found.x - z)) / 2e-6
        for z in step
    ]
    exact = level.model.derivative(0, found.x)
    np.testing.assert_allclose(exact, np.moveaxis(central, 0, -1), atol=1e-6 * np.abs(exact).max())
    wrong = replace(level.model, L=-level.model.L)
    assert abs(fit_changes(wrong, 0, after.G[0], after.variance[0], np.zeros(8)).x[0] - 0.1) > 0.05


def test_describing_functions_of_springs_and_friction_are_means_over_a_gaussian():
    e = np.random.default_rng(0).standard_normal(2_000_000)
    for sd, mean, gap in ((1.0, 0.0, 0.3), (0.4, 0.5, 0.6), (2.0, -1.0, 0.5)):
        d = mean + sd * e
        torque = np.sign(d) * np.maximum(np.abs(d) - gap, 0)
        left = torque - torque.mean() - (N := (torque * e).mean() / sd) * sd * e
        found = average_spring(
            lambda x, b=gap: x - np.clip(x, -b, b), np.array([torque.mean()]), np.array([sd])
        )
        np.testing.assert_allclose(
            [found[0][0], found[1][0]], [N, left.std() / (N * sd)], rtol=1e-2
        )
    c = 0.7
    sd = 0.8
    mean = 0.5
    N, e3 = average_spring(
        lambda d: d + c * d**3, np.array([mean + c * mean * (mean**2 + 3 * sd**2)]), np.array([sd])
    )
    assert N[0] == pytest.approx(1 + 3 * c * (sd**2 + mean**2), rel=1e-6)
    assert e3[0] == pytest.approx(
        c * np.sqrt(6 * sd**6 + 18 * mean**2 * sd**4) / (N[0] * sd), rel=1e-5
    )
    assert average_coulomb(2.0) == pytest.approx((np.sign(e) * e).mean() / 2, rel=1e-3)


def test_the_describing_function_of_hysteresis_is_that_of_a_loop_in_time():
    """A spring in series with a slider, stepped through sines with amplitudes of Rayleigh's
    distribution.
    """
    slip = 0.6
    sd = 1.0
    count = 2000
    amplitudes = np.linspace(0.01, 6.0, 240)
    t = 2 * np.pi * np.arange(2 * count) / count
    d = amplitudes[:, None] * np.sin(t)
    torque = np.zeros_like(d)
    z = np.zeros(len(d))
    for k in range(1, len(t)):
        z = np.clip(z + d[:, k] - d[:, k - 1], -slip, slip)
        torque[:, k] = z
    turn = np.exp(-1j * t[count:])
    N = (torque[:, count:] @ turn) / (d[:, count:] @ turn)
    weight = amplitudes**3 * np.exp(-((amplitudes / sd) ** 2) / 2)
    found = average_hysteresis(np.array([slip]), np.array([sd]))[0]
    assert abs(found - (N @ weight) / weight.sum()) < 2e-3
    assert found.imag > 0
