"""Numbers of the fit of gears on a made-up record: signals, torques, derivatives, weights, steps,
and the result.

Of `flexgen.identification.gears.signals`, `flexgen.identification.gears.driven_arm`,
`flexgen.identification.gears.fit`, `flexgen.identification.gears.identify` and
`flexgen.identification.gears.result`. That they are right, long records of MuJoCo show
(`tests/cross/test_identify_gears.py`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hysteretic import with_law
from measured_numbers import check_numbers
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.gears import fit, further_elements, identify
from flexgen.identification.gears.driven_arm import Element, MotorMotion, Sought
from flexgen.identification.gears.signals import Signals, signals_of

pytestmark = needs_compiler
FREE = ["q1.stiffness", "q1.damping"]


def record_of(seconds: float = 5.2, noise: float = 1e-6, **changes: Any) -> Trajectory:
    """Two motors of `elbow` in a motion by formulas, with torques by other ones."""
    t = 1e-3 * np.arange(int(1e3 * seconds))
    rng = np.random.default_rng(5)
    waves = np.sin(9.0 * t[:, None] * [1.0, 1.3] + [0.0, 1.0]) + 0.4 * np.sin(
        31.0 * t[:, None] * [1.0, 0.8]
    )
    torque = 3.0 * np.cos(9.0 * t[:, None] * [1.0, 1.3]) + np.tanh(np.sin(7.0 * t))[:, None] * [
        1.0,
        -0.5,
    ]
    channels = {"q_m": 30.0 * waves, "tau_m": torque}
    given = {name: x + noise * rng.normal(size=x.shape) for name, x in channels.items()} | changes
    ports = {name: Port(name, (x.shape[1],), "rad", "made up") for name, x in given.items()}
    labels = {name: tuple(f"{name}{j}" for j in range(x.shape[1])) for name, x in given.items()}
    return Trajectory(t, given, ports, labels, {})


@cache
def robot() -> flexgen.RobotModel:
    """With so much damping that the gears forget how a short motion began."""
    changed = {"upper.dof.q1": 4e4, "fore.dof.q2": 2e4}
    return flexgen.read(
        "elbow", overrides={f"element.{place}.gear.damping": D for place, D in changed.items()}
    )


@cache
def signals() -> Signals:
    return signals_of(record_of(), 2, 12.0)


@cache
def made() -> fit.GearModel:
    """Two elements at the first gear, one with another law at the second, whose transmission error
    is sought, too.
    """
    elements = (Element(0, 4e6, 3e-5), Element(0, 2e6, 6e-5, 2.0), Element(1, 3e6, 4e-5, 1.5, 0.2))
    sought = Sought(elements, True, (1,), (1, 3), (2,))
    return fit.GearModel(derive(robot(), FREE), sought, signals())


def moved() -> np.ndarray:
    """A theta none of whose entries is where the search begins."""
    model = made()
    theta = model.start * (1.0 + 0.1 * np.cos(np.arange(len(model.start))))
    at = model.layout
    theta[at.errors] = 2e-5 * np.arange(1.0, 1.0 + len(theta[at.errors]))
    theta[at.linear] = 1e-4 * np.arange(1.0, 1.0 + len(theta[at.linear])) / model.units[at.linear]
    return theta


def test_signals_in_the_band_of_a_record_are_what_they_were() -> None:
    of_noise = signals_of(record_of(noise=1e-4), 2, None)
    again = signals().angle_noise(np.random.default_rng(2))
    check_numbers(
        "gear_signals",
        given=signals(),
        found=of_noise,
        noise=[x.torque_noise for x in (signals(), of_noise)],
        again=again,
        margin=signals().margin,
        torques=signals().torques(signals().tau_m),
    )


@pytest.mark.parametrize("seconds", [5.2, 6.0, 9.0, 20.0])
def test_white_noise_of_a_record_has_its_standard_deviation_however_short_it_is(
    seconds: float,
) -> None:
    """Its spectrum is the mean of pieces of 4 s; where these are few, the median over the lines is
    below the mean.
    """
    found = signals_of(record_of(seconds, 1e-4), 2, 12.0)
    assert_allclose(np.array([found.angle_sd, found.torque_sd]).mean(), 1e-4, rtol=0.05)


def test_the_model_of_a_record_is_what_it_was() -> None:
    """Numbers of the arm, torques and derivatives; the loops, and what noise explains."""
    model = made()
    theta = moved()
    error, J = model.derivatives(theta, model.motion)
    J = np.moveaxis(J, -1, 0) / np.abs(J).max(axis=(0, 1))[:, None, None]
    check_numbers(
        "gear_model",
        1e-5,
        start=model.start,
        units=model.units,
        numbers=model.numbers(theta),
        first=model.first,
        bounds=np.clip(fit.bounds_of(model), -1e3, 1e3),
        step=model.segments.step,
        e=error,
        J=J,
        loops=model.loops(theta, error),
        noise=model.noise(theta, error),
        excess=model.excess(theta, error, 1e-6 * np.eye(len(theta))),
        misfit=fit._misfit(error, model.measured),
    )


def test_torques_of_a_noisy_loop_do_not_hide_a_wrong_law() -> None:
    """White noise of the torques is no more than the quietest band of the residuals has, and hides
    no slow error.
    """
    theta = moved()
    rng = np.random.default_rng(8)
    quiet = made()
    noisy = copy(quiet)
    noisy.signals = replace(quiet.signals, torque_sd=1e3 * quiet.signals.torque_noise)
    k = len(quiet.measured)
    slow = 1e-3 * np.sin(2 * np.pi * 0.2 * quiet.signals.sample_s * np.arange(k))
    white = quiet.signals.torques(1e-6 * rng.normal(size=(k + 2 * quiet.signals.margin, 2)))
    error = slow[:, None] * [1.0, 0.0] + white
    none = np.zeros((len(theta), len(theta)))
    assert noisy.excess(theta, error, none)[0, 0] > 3.0 * identify.EXCESS
    of_torques = noisy.noise(theta, white)
    assert_allclose(
        of_torques, np.hypot(white.std(axis=0), quiet.change_by_noise(theta).std(axis=0)), rtol=0.5
    )


def test_white_torques_are_noise_in_bands_of_few_lines_too() -> None:
    """The quietest of the bands has less than its part by chance, and most of all one of few
    lines.
    """
    model = copy(made())
    model.signals = replace(model.signals, torque_sd=np.ones(2))
    rng = np.random.default_rng(3)
    k = len(model.measured)
    lines = model._bands(model.measured)[0]
    assert lines.min() < 4
    level = (k * model.signals.torque_noise) ** 2 / (2 * lines.sum())
    found = [
        model._white(lines, level * rng.gamma(lines, 1.0, (len(lines), 2))) for _ in range(300)
    ]
    assert np.mean(np.array(found) < 0.999 * level) < 0.12  # 8 bands, 1 % each
    assert (np.mean(found, axis=0) > 0.95 * level).all()


def test_a_step_with_corrected_normal_equations_is_what_it_was() -> None:
    model = made()
    theta = moved()
    e = model.torques([theta], model.motion)[0] - model.measured
    white = fit.Whitening(e, model, fit.FLOOR[1])
    lower, upper = bounds = fit.bounds_of(model)
    weak = theta.copy()
    weak[model.layout.lost.start + 1] = 0.01
    dropped = fit.drop_elements(model, weak, lower, upper)
    _, change, covariance = fit._correct(model, theta, white, lower < upper, 2)
    sd = np.sqrt(np.diag(covariance))
    assert dropped and not fit.drop_elements(model, weak, lower, upper)
    check_numbers(
        "gear_step",
        1e-4,
        weights=white(e),
        bounds=np.clip(bounds, -1e3, 1e3),
        theta=weak,
        change=change / sd,
        correlation=covariance / np.outer(sd, sd),
        sd=sd,
    )


@pytest.mark.parametrize("converged", [True, False])
def test_the_result_of_a_fit_has_the_numbers_of_the_model(converged: bool) -> None:
    model = made()
    theta = moved()
    n = len(theta)
    spread = 1e-2 * np.diag(np.arange(1.0, n + 1)) + 1e-4
    error = model.torques([theta], model.motion)[0] - model.measured
    found = fit.Estimate(theta, spread, error * converged, converged)
    result = identify.result_of(robot(), select(robot(), FREE), model, found)
    assert str(result.status) == ("model error" if converged else "not converged"), result.status
    names = [number.name for number in result.numbers]
    assert names[:8] == [
        *FREE,
        "q1.hysteresis.lost_motion",
        "q1.hysteresis.stiffness",
        "q1.hysteresis.lost_motion_1",
        "q1.hysteresis.stiffness_1",
        "q1.hysteresis.exponent_1",
        "q1.hysteresis.lost_motion_2",
    ]
    name = "converged" if converged else "open"
    check_numbers(
        f"gear_result_{name}",
        1e-5,
        result=result,
        known=[number.determined for number in result.numbers],
    )


TORQUES: Any = {"tau_m": np.outer([1.0, 0.0, 1.0, 0.0], [2.0, 6.0])}  # N m, of two motors


def test_elements_begin_as_those_of_the_model_or_as_fractions_of_the_spring() -> None:
    """n elements share the stiffness of the spring; their lost motions are around one arcmin, by
    factors of two.
    """
    K = [dof.gear.spring.stiffness for element in robot().elements for dof in element.dofs]
    found = identify._first_elements(robot(), (0, 1), 3, False, TORQUES)
    arcmin = np.pi / 180 / 60
    assert [x.gear for x in found] == [0, 0, 0, 1, 1, 1]
    assert_allclose([x.K_h for x in found], np.repeat(K, 3) / 3)
    assert_allclose([x.lost / arcmin for x in found], [0.5, 1.0, 2.0] * 2)
    assert {(x.exponent, x.gamma) for x in found} == {(1.0, 0.0)}
    assert [x.exponent for x in identify._first_elements(robot(), (1,), None, True, TORQUES)] == [
        2.0
    ]
    table = [
        {"stiffness": 3e3, "lost_motion": 2e-4},
        {"stiffness": 1e3, "lost_motion": 4e-4, "exponent": 3.0, "gamma": 0.3},
    ]
    bent = flexgen.read("elbow", overrides={"element.upper.dof.q1.gear.hysteresis": table})
    own = identify._first_elements(bent, (0,), None, True, TORQUES)
    assert [(x.K_h, x.exponent, x.gamma) for x in own] == [(3e3, 2.0, 0.0), (1e3, 3.0, 0.3)]
    assert_allclose([x.lost for x in own], [2e-4, 4e-4])
    assert len(identify._first_elements(bent, (0,), 1, False, TORQUES)) == 1
    with pytest.raises(
        ArgumentError, match="given the law Logistic, expected that of Bouc and Wen"
    ):
        identify._first_elements(with_law("elbow"), (0,), None, False, TORQUES)


@pytest.mark.parametrize("given", [0, 9, True])
def test_counts_of_elements_have_bounds(given: Any) -> None:
    with pytest.raises(
        ArgumentError, match=f"elements: given {given}, expected a whole number from 1 to 8"
    ):
        identify._first_elements(robot(), (0,), given, False, TORQUES)


def test_lost_motions_of_translations_are_found_against_their_deflections() -> None:
    """With 1 arcmin read as 291 um a lost motion below 5.8 um was none."""
    sliding = flexgen.read("elbow", overrides={"element.fore.dof.q2.type": "translation"})
    first, second = identify._first_elements(sliding, (0, 1), None, False, TORQUES)
    # the standard deviation of the force over the stiffness
    slide = float(3.0 * sliding.eta[1, 1] / 4.0999e6)
    assert (first.unit, second.unit) == pytest.approx((np.pi / 180 / 60, slide))
    assert (first.lost, second.lost) == (first.unit, second.unit)


def test_errors_of_the_steps_are_taken_out_of_the_comparison() -> None:
    """Residuals are those of a simulation with ten times as many steps, and stay so; none
    accumulate.
    """
    model = fit.GearModel(derive(robot(), FREE), Sought(()), signals())
    fine = copy(model)
    recorded = model.measured
    theta = model.start
    fine.segments = model.arm.segments(model.signals.sample_s, 10 * model.segments.steps)
    motion = MotorMotion.through(model.signals.time, model.signals.q_m, fine.segments.steps)
    exact = fine.torques([theta], motion)[0] - recorded
    coarse = model.torques([theta], model.motion)[0]
    before = np.abs(coarse - recorded - exact).max()
    for _ in range(2):
        model.take_out_step_errors(theta)
        assert np.abs(coarse - model.measured - exact).max() < before / 40  # of fourth order: 1/81


def test_a_further_element_is_one_of_a_model_that_has_it() -> None:
    """Its torques are those of a fit whose second gear has one element more, as weak."""
    model = made()
    theta = moved()
    further = further_elements.FurtherElements(model, theta)
    assert further.gears == [0, 0, 0, 1, 1]
    K = further.K[3]
    lost = further.lost[3]
    size = further_elements.SMALL
    elements = (*model.sought.elements, Element(1, K, lost, 1.0, unit=lost))
    sought = replace(model.sought, elements=elements)
    with_it = fit.GearModel(model.equations, sought, model.signals)
    values, shapes, parts, rest = np.split(
        theta,
        [x.stop for x in (model.layout.stiffness, model.layout.exponents, model.layout.lost)],
    )
    none, weak = (
        np.concatenate([values, [k], shapes, [1.0], parts, [k], rest]) for k in (1e-9, size)
    )
    steps = model.segments.steps
    sample_s = model.signals.sample_s
    with_it.first = model.first
    with_it.largest = model.largest
    with_it.segments = with_it.arm.segments(sample_s, steps)
    expected = np.subtract(*with_it.torques([weak, none], model.motion)) / size
    found = further._derivatives(model.motion)[:, :, 3]
    assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_linear_numbers_have_the_size_of_the_torques_in_every_unit() -> None:
    """A search in N m s/rad, N m and s at once depended on the unit of torque: a robot 1,000 times
    as heavy.
    """
    model = made()
    columns = model.regressors(model.motion)
    size = np.sqrt((columns**2).mean(axis=0))
    most = size.argmax(axis=0)
    assert_allclose(size.max(axis=0), np.std(model.measured, axis=0)[most], rtol=1e-12)
    assert len(set(most)) == 2
