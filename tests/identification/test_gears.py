"""Fits of gears on a record by formulas: least squares of linear torques, numbers from their
entries, signals, steps, statuses and what is refused.

That they are right, long records of MuJoCo show (`tests/cross/test_identify_gears.py`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from hysteretic import with_law
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.gears import fit, further_elements, identify
from flexgen.identification.gears.driven_arm import Element, MotorMotion, Sought
from flexgen.identification.gears.result import GearFit, Number
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
    units = {"q_m": "rad", "tau_m": "N m"}
    ports = {name: Port(name, (2,), units[name], "made up") for name in given}
    labels = {name: tuple(f"m{j + 1}" for j in range(x.shape[1])) for name, x in given.items()}
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


@pytest.mark.parametrize("seconds", [5.2, 6.0, 9.0, 20.0])
def test_white_noise_of_a_record_has_its_standard_deviation_however_short_it_is(
    seconds: float,
) -> None:
    """Its spectrum is the mean of pieces of 4 s; where these are few, the median over the lines is
    below the mean.
    """
    found = signals_of(record_of(seconds, 1e-4), 2, 12.0)
    assert_allclose(np.array([found.angle_sd, found.torque_sd]).mean(), 1e-4, rtol=0.05)


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
    # their squares without the part of noise, next to those of the numbers of the fit
    white = fit.Whitening(model.measured, model, fit.FLOOR[1])
    _, raw, _ = further.equations(white)
    J = white(model.derivatives(theta, model.motion)[1]).reshape(expected.size, -1)
    column = white(expected[:, :, None]).ravel()
    k = len(theta) + 3
    assert raw[k, k] == pytest.approx(column @ column, rel=2e-3)
    size = np.sqrt(raw[k, k] * np.diag(raw)[: len(theta)])
    assert_allclose(raw[k, : len(theta)] / size, column @ J / size, atol=2e-3)


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


class Linear:
    """Torques that are linear in theta: two parameters, and friction of two motors; angles with
    noise change them.
    """

    def __init__(self, noise: float, late: float) -> None:
        rng = np.random.default_rng(7)
        self.layout = fit.Numbers.of(
            parameters=2,
            stiffness=0,
            exponents=0,
            lost=0,
            errors=0,
            viscous=2,
            coulomb=0,
            constant=0,
            cogging=0,
            delay=0,
        )
        self.count = 0
        self.start = np.array([1.0, 1.0, 0.0, 0.0])
        self.sought = Made(exponents=False)
        waves = rng.normal(size=(1500, 6))
        self.J = np.zeros((1500, 2, 4))
        self.J[:, 0, 0], self.J[:, 1, 0], self.J[:, 0, 1], self.J[:, 1, 1] = waves[:, :4].T
        self.J[:, 0, 2], self.J[:, 1, 3] = waves[:, 4:].T
        self.change = noise * rng.normal(size=(64, *self.J.shape))
        self.true = np.array([1.2, 0.8, 0.3, -0.2])
        self.motion = (0, 0.0)
        self.measured = self.J @ self.true + late * rng.normal(size=(1500, 2))
        self.signals = Made(sample_s=4e-3, band_hz=1e3)
        self.units = np.ones(2)
        self.J = self.J + noise * rng.normal(size=self.J.shape)  # as recorded, with noise

    def more_noise(self, seed: int, sign: float) -> tuple[int, float]:
        return seed, sign

    def torques(self, points: Any, motion: tuple[int, float]) -> np.ndarray:
        J = self.J + motion[1] * self.change[motion[0]]
        return np.array([J @ theta for theta in points])

    def derivatives(
        self, theta: np.ndarray, motion: tuple[int, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        J = self.J + motion[1] * self.change[motion[0]]
        return J @ theta - self.measured, J

    def take_out_step_errors(self, theta: np.ndarray) -> None:
        """There is no simulation."""

    def change_by_noise(self, theta: np.ndarray) -> np.ndarray:
        return self.change[0] @ theta


def test_a_linear_fit_is_that_of_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without noise of the angles; the deviations are those of white residuals."""
    monkeypatch.setattr(fit, "DRAWS", (2, 2))
    monkeypatch.setattr(fit, "BLOCK_S", 0.04)
    lines: list[str] = []
    made: Any = Linear(0.0, 1e-2)
    found = fit.estimate(made, lines.append)
    faded = fit.tukey(1500, fit.TAPER)[:, None, None]
    J = (faded * made.J).reshape(-1, 4)
    y = (faded[..., 0] * made.measured).ravel()
    expected = np.linalg.lstsq(J, y, rcond=None)[0]
    sd = 1e-2 * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert found.converged and (np.abs(found.theta - expected) < 1.2 * sd).all()
    assert_allclose(np.sqrt(np.diag(found.covariance)), sd, rtol=0.25)
    assert_allclose(found.error, made.J @ found.theta - made.measured, atol=1e-3)
    assert lines[-2:] == [
        "subtracting the part of the noise: step 1",
        "subtracting the part of the noise: step 2",
    ]
    assert lines[0].startswith("step 1: ") and lines[0].endswith(" % of the torques unexplained")


def test_noise_of_the_angles_does_not_make_the_numbers_smaller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Least squares with noisy columns find less than there is; the corrected equations do not."""
    monkeypatch.setattr(fit, "DRAWS", (4, 8))
    made: Any = Linear(0.3, 1e-2)
    found = fit.estimate(made, lambda line: None)
    J = made.J.reshape(-1, 4)
    y = made.measured.ravel()
    plain = np.linalg.lstsq(J, y, rcond=None)[0]
    sd = np.sqrt(np.diag(found.covariance))
    assert (np.abs(plain - made.true)[:2] > 5 * sd[:2]).all() and (
        np.abs(found.theta - made.true) < 3 * sd
    ).all()
    assert found.converged and (sd < 0.02).all() and (sd > 2e-3).all()


def entries(
    harmonics: tuple[int, ...] = (1, 4), cogging: tuple[int, ...] = (2, 3)
) -> tuple[Any, np.ndarray]:
    """A fit of both gears of `elbow`: a parameter, three elements, errors of both gears, and
    cogging.
    """
    elements = (Element(0, 4e6, 3e-5), Element(0, 2e6, 6e-5, 2.0), Element(1, 3e6, 4e-5, 1.5, 0.2))
    sought = fit.Sought(elements, True, (0, 1), harmonics, cogging)
    made: Any = Made(sought=sought, at=[0, 0, 1], n_m=2)
    made.layout = fit.Numbers.of(
        parameters=1, stiffness=3, exponents=3, lost=3, errors=4 * len(harmonics),
        viscous=2, coulomb=2, constant=2, cogging=4 * len(cogging), delay=1,
    )  # fmt: skip
    n = made.layout.size
    made.units = np.concatenate(
        [[2.0, 10.0, 20.0, 30.0, 1.0, 2.0, 1.5], np.full(3, 1e-3), np.ones(n - 10)]
    )
    return made, 1.0 + np.arange(float(n))


def test_numbers_of_a_fit_are_its_entries_times_their_units() -> None:
    robot = flexgen.read("elbow", overrides={"element.upper.dof.q1.gear.side": "motor"})
    made, theta = entries()
    n = len(theta)
    model_key = "element.upper.dof.q1.gear"
    root = np.diag(0.01 * theta)
    root[1, 2] = 0.02
    covariance = root @ root.T
    stiff: Any = Made(name="q1.stiffness", unit="N m/rad", key="k")
    numbers = identify.GearNumbers(
        robot, [stiff], made, fit.Estimate(theta, covariance, np.zeros((1, 2)), True)
    )
    found = {number.name: number for number in numbers.all()}
    sd = np.sqrt(np.diag(covariance))
    assert (found["q1.stiffness"].value, found["q1.stiffness"].change) == (2.0, ("k", "", -1))
    assert (
        found["q1.stiffness"].sd == pytest.approx(2 * sd[0]) and found["q1.stiffness"].determined
    )
    of_first = "q1.hysteresis."
    of_other = "q2.hysteresis."
    ratio = robot.motors[0].ratio[0] ** 2  # of its square: a stiffness on the side of the motor
    assert found[of_first + "stiffness_1"].value == pytest.approx(10 * theta[1] / ratio)
    assert found[of_first + "stiffness"].value == pytest.approx(
        (10 * theta[1] + 20 * theta[2]) / ratio
    )
    both = np.array([10.0, 20.0]) @ covariance[1:3, 1:3] @ [10.0, 20.0]
    assert found[of_first + "stiffness"].sd == pytest.approx(np.sqrt(both) / ratio)
    assert (
        found[of_first + "exponent_2"].value == 2 * theta[5]
        and found[of_other + "exponent"].value == 1.5 * theta[6]
    )
    assert found[of_first + "lost_motion"].value == pytest.approx(1e-3 * (theta[7] + theta[8]))
    assert found[of_other + "lost_motion"].change == (
        "element.fore.dof.q2.gear.hysteresis",
        "lost_motion",
        0,
    )
    assert found[of_first + "lost_motion_2"].change == (
        f"{model_key}.hysteresis",
        "lost_motion",
        1,
    )
    assert (
        found[of_first + "lost_motion"].change == ("", "", -1)
        and of_other + "lost_motion_1" not in found
    )
    at = 10
    # of each gear the cosines, then the sines
    for joint, place in (("q1", "upper"), ("q2", "fore")):
        for kind in ("cos", "sin"):
            for index, order in enumerate((1, 4)):
                number = found[f"{joint}.transmission_error.{kind}_{order}"]
                assert (number.value, number.sd, number.unit) == (
                    theta[at],
                    pytest.approx(sd[at]),
                    "rad",
                )
                assert number.change == (
                    f"element.{place}.dof.{joint}.gear.transmission_error",
                    kind,
                    index,
                )
                at += 1
    at += 6  # frictions
    # of each harmonic the cosines of all motors, then the sines
    for index, order in enumerate((2, 3)):
        for kind in ("cos", "sin"):
            for motor in ("m1", "m2"):
                number = found[f"{motor}.cogging.{kind}_{order}"]
                assert (number.value, number.unit) == (theta[at], "N m")
                assert number.change == (f"motor.{motor}.cogging", kind, index)
                at += 1
    assert at == n - 1 and len(found) == 1 + 8 + 3 + 8 + 8


@pytest.mark.parametrize(("part", "known"), [(0.49, True), (0.51, False)])
def test_numbers_are_determined_by_half_of_their_size(part: float, known: bool) -> None:
    """Those of a Fourier sum by its amplitude, those of the elements of a gear together."""
    made, theta = entries((1,), ())
    theta[10:14] = [0.0, 1.0, -3.0, 4.0]
    sd = np.full(len(theta), 1e-3)
    sd[0] = part * theta[0]
    sd[3] = part * theta[3]
    sd[11] = part
    sd[12] = 5 * part
    stiff: Any = Made(name="q1.stiffness", unit="N m/rad", key="k")
    found = fit.Estimate(theta, np.diag(sd**2), np.zeros((1, 2)), True)
    numbers = identify.GearNumbers(flexgen.read("elbow"), [stiff], made, found)
    told = {number.name: number.determined for number in numbers.all()}
    assert (
        told["q1.stiffness"]
        == told["q2.hysteresis.lost_motion"]
        == told["q2.hysteresis.exponent"]
        == known
    )
    assert told["q1.hysteresis.lost_motion"] and told["q1.hysteresis.exponent_1"]
    for joint in ("q1", "q2"):
        assert (
            told[f"{joint}.transmission_error.cos_1"]
            == told[f"{joint}.transmission_error.sin_1"]
            == known
        )
    theta[8] = fit.NO_LOST  # too narrow to be one
    told = {number.name: number.determined for number in numbers.all()}
    assert not told["q1.hysteresis.stiffness_1"] and not told["q1.hysteresis.lost_motion"]


@pytest.mark.parametrize(
    ("error", "excess", "converged", "status"),
    [
        ([1.0, 1.0], [2.9, 2.9], True, "FITTED"),
        ([3.5, 1.0], [0.0, 0.0], True, "FITTED"),
        # hypot(1.5 * 2, 5e-4 * 4000) = 3.61, 5.0 of the other motor
        ([1.0, 3.7], [0.0, 0.0], True, "FITTED"),
        ([3.7, 1.0], [0.0, 0.0], True, "MODEL_ERROR"),
        ([3.5, 1.0], [3.1, 0.0], True, "MODEL_ERROR"),
        ([1.0, 1.0], [[0.0, 3.1], [0.0, 2.9]], True, "NOISE_TOO_LARGE"),
        ([1.0, 1.0], [[0.0, 3.1], [0.0, 2.9]], False, "NOT_CONVERGED"),
        ([3.7, 1.0], [[0.0, 3.1], [0.0, 2.9]], True, "MODEL_ERROR"),
        ([1.0, 1.0], [0.0, 0.0], False, "NOT_CONVERGED"),
        ([9.0, 1.0], [0.0, 0.0], False, "MODEL_ERROR"),
    ],
)
def test_the_status_of_gears_follows_from_residuals(
    error: list[float],
    excess: list[Any],
    converged: bool,
    status: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = flexgen.read("elbow")
    wave = np.array([[1.0], [-1.0]])
    made: Any = Made(
        noise=lambda theta, e: np.array([2.0, 2.0]),
        measured=wave * [4000.0, 8000.0],
        units=np.array([1.0, 2.0]),
        layout=Made(delay=slice(1, 2)),
        excess=lambda theta, e, covariance: np.array(excess) * np.ones((2, 2)),
        loops=lambda theta, e: "loops",
        signals=Made(band_hz=30.0),
        sought=Made(gears=(1,), harmonics=(1,), cogging=(2,)),
    )
    monkeypatch.setattr(identify, "GearNumbers", lambda *_: Made(all=lambda: (), laws=dict))
    monkeypatch.setattr(identify, "GearFit", Made)
    asked: list[int] = []
    monkeypatch.setattr(identify, "gears_that_lack_elements", lambda fit, found: tuple(asked))
    found = fit.Estimate(np.array([1.0, 5e-4]), np.eye(2), wave * error, converged)
    result: Any = identify.result_of(robot, (), made, found)
    assert (
        result.status is FitStatus[status] and result.joints == ("q2",) and result.delay_s == 1e-3
    )
    assert_allclose(result.unexplained, error)
    asked.append(1)
    lacking: Any = identify.result_of(robot, (), made, found)
    assert lacking.status is (FitStatus.MODEL_ERROR if status == "FITTED" else FitStatus[status])
    assert (result.lacking, lacking.lacking) == ((), ("q2",) if status == "FITTED" else ())
    wide = fit.Estimate(found.theta, np.diag([1.0, np.inf]), wave * 1.0, True)
    assert identify.result_of(robot, (), made, wide).status is not FitStatus.FITTED


def gear_fit(robot: flexgen.RobotModel, status: FitStatus = FitStatus.FITTED) -> GearFit:
    """Two springs, of which one is not determined, an element of hysteresis, and a transmission
    error.
    """
    q1 = "element.upper.dof.q1.gear"
    q2 = "element.fore.dof.q2.gear"
    rows = (
        ("q1.stiffness", 6e6, (f"{q1}.spring.stiffness", "", -1), True),
        ("q2.stiffness", 9e6, (f"{q2}.spring.stiffness", "", -1), False),
        ("q1.hysteresis.stiffness_1", 5e5, (f"{q1}.hysteresis", "stiffness", 0), True),
        ("q1.hysteresis.lost_motion_1", 2e-4, (f"{q1}.hysteresis", "lost_motion", 0), True),
        ("q1.hysteresis.lost_motion", 2e-4, ("", "", -1), True),
        ("q2.transmission_error.cos_1", 3e-5, (f"{q2}.transmission_error", "cos", 0), True),
        ("q2.transmission_error.sin_4", -4e-5, (f"{q2}.transmission_error", "sin", 1), True),
        ("m2.cogging.sin_6", 0.05, ("motor.m2.cogging", "sin", 0), True),
    )
    numbers = tuple(
        Number(name, value, 0.01 * abs(value), "", change, known)
        for name, value, change, known in rows
    )
    return GearFit(
        robot=robot,
        numbers=numbers,
        status=status,
        unexplained=np.array([1.0, 2.0]),
        noise=np.array([0.1, 0.1]),
        band_hz=20.0,
        delay_s=0.0,
        joints=("q1", "q2"),
        loops=np.zeros((2, 4, 3)),
        harmonics=(1, 4),
        cogging=(6,),
        laws={f"{q1}.hysteresis": ({},)},
    )


def test_the_model_of_a_fit_has_what_the_record_determines(tmp_path: Path) -> None:
    robot = flexgen.read("elbow")
    found = gear_fit(robot)
    model = found.model
    first, second = (element.dofs[0].gear for element in model.elements)
    assert first is not None and second is not None
    assert first.spring.stiffness == 6e6 and second.spring.stiffness == 4.0999e6
    assert (first.hysteresis.stiffness, first.hysteresis.lost_motion) == (5e5, 2e-4)
    error = second.transmission_error
    assert error is not None and tuple(error.harmonics) == (1, 4)
    assert tuple(error.cos) == (3e-5, 0.0) and tuple(error.sin) == (0.0, -4e-5)
    assert tuple(model.motors[1].cogging.sin) == (0.05,)  # type: ignore[union-attr]
    assert model.motors[0] == robot.motors[0]
    file = found.save(tmp_path / "arm.toml")
    assert file == tmp_path / "arm.toml" and flexgen.read(file).motors == robot.motors
    again = flexgen.read(f"{file}@identified")
    assert again.elements == model.elements and again.motors == model.motors
    assert "gears identified from motor angles and torques: fitted" in file.read_text()
    wrong = gear_fit(robot, FitStatus.MODEL_ERROR)
    assert wrong.sd["q1.stiffness"] is None and found.sd["q1.stiffness"] == 6e4
    assert (
        wrong.problem.startswith("model error: The model differs from the record")
        and found.problem == ""
    )
    assert wrong.save(tmp_path / "fit.json").read_text().startswith("{")


def test_a_fit_is_added_to_the_file_of_its_model_only(tmp_path: Path) -> None:
    """On top of the variant that was identified; a file that has the variant, or no file, is
    refused.
    """
    heavy = gear_fit(flexgen.read("elbow@payload")).save(tmp_path / "heavy.toml")
    assert flexgen.read(f"{heavy}@identified").payload == flexgen.read("elbow@payload").payload
    with pytest.raises(
        ArgumentError,
        match=r"^write: given a model of heavy\.toml, which has a variant 'identified'",
    ):
        gear_fit(flexgen.read(heavy)).save(tmp_path / "twice.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["heavy.toml"]


# --- a record ------------------------------------------------------------------------------------
def test_signals_in_the_band_of_a_record_are_what_their_filters_leave() -> None:
    """A slow wave stays, a quick one does not; noise of the filters by draws."""
    t = 1e-3 * np.arange(6000)
    slow, quick = (np.sin(2 * np.pi * hz * t)[:, None] * [1.0, -2.0] for hz in (2.0, 40.0))
    found = signals_of(record_of(6.0, 0.0, q_m=slow + quick, tau_m=slow), 2, 12.0)
    at = t[0] + found.time
    assert_allclose(found.q_m[:, 0], np.sin(2 * np.pi * 2.0 * at), atol=2e-3)
    twice = found.torques(found.tau_m)
    inner = slice(found.margin, len(at) - found.margin)
    assert_allclose(twice[:, 1], -2 * np.sin(2 * np.pi * 2.0 * at[inner]), atol=2e-3)
    rng = np.random.default_rng(3)
    noisy = signals_of(record_of(20.0, 1e-3), 2, 12.0)
    clean = signals_of(record_of(20.0, 0.0), 2, 12.0)
    noise = noisy.torques(noisy.tau_m) - clean.torques(clean.tau_m)
    assert_allclose(noise.std(axis=0), noisy.torque_noise, rtol=0.15)
    drawn = np.array([noisy.angle_noise(rng) for _ in range(3)])
    assert_allclose(drawn.std(axis=(0, 1)), (noisy.q_m - clean.q_m).std(axis=0), rtol=0.15)


@pytest.mark.parametrize(
    ("changes", "motors", "band", "text"),
    [
        ({}, 3, None, "given 2 columns of q_m, expected 3"),
        ({"lost": True}, 2, None, "given NaN or infinity in q_m, expected finite numbers"),
        ({"step": 2.2e-5}, 2, None, "given unequal steps in time, expected the same step"),
        ({"still": 1}, 2, None, "given motor 2 at rest, expected that all motors move"),
        ({"still": 0}, 2, None, "given motor 1, 2 at rest, expected that all motors move"),
        ({}, 2, 50.1, "band_hz: given 50.1, expected a number > 0, at most 50 Hz"),
        ({}, 2, 0.0, "band_hz: given 0.0, expected a number > 0, at most 50 Hz"),
        # 6 filters of 2 * 301 + 1 samples
        ({"seconds": 1.0}, 2, 10.0, "given 0.999 s, expected at least 3.61 s to compare motions"),
    ],
)
def test_records_that_cannot_be_compared_are_refused(
    changes: dict[str, Any], motors: int, band: float | None, text: str
) -> None:
    record = record_of(changes.get("seconds", 3.0), 0.0)
    q = record["q_m"].copy()
    t = record.time.copy()
    if "lost" in changes:
        q[7, 1] = np.nan
    q[:, changes.get("still", 2) :] = 3.0
    t[20] += changes.get("step", 0.0)
    given = Trajectory(t, {"q_m": q, "tau_m": q}, record.ports, record.labels, {})
    with pytest.raises(ArgumentError) as caught:
        signals_of(given, motors, band)
    assert text in str(caught.value)


# --- the model of a record -----------------------------------------------------------------------
def test_derivatives_of_a_model_are_differences_of_its_torques() -> None:
    """Of all numbers, at a theta none of whose entries is where the search begins."""
    model = made()
    theta = moved()
    error, J = model.derivatives(theta, model.motion)
    assert_allclose(error, model.torques([theta], model.motion)[0] - model.measured)
    for k in range(len(theta)):
        h = 1e-3 * max(abs(theta[k]), 1e-4)
        e = h * (np.arange(len(theta)) == k)
        more, less = model.torques([theta + e, theta - e], model.motion)
        slope = (more - less) / (2 * h)
        assert_allclose(J[:, :, k], slope, atol=5e-2 * np.abs(slope).max())
    at = model.layout
    numbers = model.numbers(theta)
    K = model.units[at.parameters] * theta[at.parameters]
    stiffness = np.array([K[0], K[0], 4.0999e6])
    lost = (model.units * theta)[at.lost]
    found = [*K, *(model.units * theta)[at.stiffness], *(lost * stiffness / 2)]
    assert_allclose(numbers[: len(found)], found)
    assert numbers[-1] == model.largest


def test_bounds_of_the_numbers_of_gears() -> None:
    """Springs and elements within a factor, exponents from 1 on, lost motions in parts of their
    units, others free.
    """
    model = made()
    lower, upper = fit.bounds_of(model)
    at = model.layout
    exponents = model.units[at.exponents]
    for part, low, high in (
        (at.parameters, 1 / fit.REACH, fit.REACH),
        (at.stiffness, fit.STIFF, fit.REACH),
        (at.exponents, 1 / exponents, fit.SHARPEST / exponents),
        (at.lost, fit.LEAST_LOST, fit.MOST_LOST),
        (at.errors, -np.inf, np.inf),
        (at.linear, -np.inf, np.inf),
    ):
        assert_allclose(lower[part], low * np.ones(lower[part].shape))
        assert_allclose(upper[part], high * np.ones(lower[part].shape))


@pytest.mark.parametrize(
    ("stiffness", "lost", "dropped"),
    [
        (1.0, 1.0, False),
        (fit.REACH / fit.NEAR * 1.01, 1.0, True),
        (fit.STIFF * fit.NEAR * 0.99, 1.0, True),
        (fit.REACH / fit.NEAR * 0.99, 1.0, False),
        (1.0, fit.NO_LOST * 0.99, True),
        (1.0, fit.NO_LOST * 1.01, False),
    ],
)
def test_an_element_without_a_loop_is_fixed_at_none(
    stiffness: float, lost: float, dropped: bool
) -> None:
    """The second one: it becomes a part of its spring, once."""
    model = made()
    lower, upper = fit.bounds_of(model)
    theta = moved()
    own = [part.start + 1 for part in (model.layout.stiffness, model.layout.lost)]
    theta[own] = stiffness, lost
    theta[model.layout.lost.start] = 1.0
    before = theta.copy()
    assert fit.drop_elements(model, theta, lower, upper) is dropped
    fixed = {own[0]: 1.0, model.layout.exponents.start + 1: 1.0, own[1]: fit.LEAST_LOST}
    others = np.setdiff1d(np.arange(len(theta)), list(fixed) if dropped else [])
    assert (theta[others] == before[others]).all() and (lower[others] < upper[others]).all()
    if dropped:
        assert all(theta[k] == lower[k] == upper[k] == value for k, value in fixed.items())
        assert not fit.drop_elements(model, theta, lower, upper)


@pytest.mark.parametrize(
    ("answers", "status"),
    [
        (["FITTED"], "NOISE_TOO_LARGE"),
        (["MODEL_ERROR", "FITTED"], "NOISE_TOO_LARGE"),
        (["MODEL_ERROR", "MODEL_ERROR"], "MODEL_ERROR"),
        (["too short"], "MODEL_ERROR"),
    ],
)
def test_narrower_bands_show_what_noise_hides(answers: list[str], status: str) -> None:
    """0.6 and 0.36 of the band."""
    bands: list[float] = []
    told: list[str] = []

    def narrow(hz: float) -> GearFit:
        bands.append(hz)
        if answers[len(bands) - 1] == "too short":
            raise ArgumentError("record: given 1 s")
        return gear_fit(flexgen.read("elbow"), FitStatus[answers[len(bands) - 1]])

    wide = gear_fit(flexgen.read("elbow"), FitStatus.MODEL_ERROR)
    found = identify.in_narrower_bands(wide, narrow, told.append)
    assert bands == pytest.approx([12.0, 7.2][: len(answers)]) and found.band_hz == 20.0
    assert found.status is FitStatus[status]
    words = "model error: comparing motions below"
    assert told == [f"{words} {band:.3g} Hz only" for band in bands]


# --- what is asked -------------------------------------------------------------------------------
TORQUES: Any = {"tau_m": np.outer([1.0, 0.0, 1.0, 0.0], [2.0, 6.0])}  # N m, of two motors


def test_elements_begin_as_those_of_the_model_or_as_fractions_of_the_spring() -> None:
    """n elements share the stiffness of the spring; their lost motions are around one arcmin, by
    factors of two.
    """
    K = [dof.gear.spring.stiffness for element in robot().elements for dof in element.dofs]
    found = identify.first_elements(robot(), (0, 1), 3, False, TORQUES)
    arcmin = np.pi / 180 / 60
    assert [x.gear for x in found] == [0, 0, 0, 1, 1, 1]
    assert_allclose([x.K_h for x in found], np.repeat(K, 3) / 3)
    assert_allclose([x.lost / arcmin for x in found], [0.5, 1.0, 2.0] * 2)
    assert {(x.exponent, x.gamma) for x in found} == {(1.0, 0.0)}
    sharp = identify.first_elements(robot(), (1,), None, True, TORQUES)
    assert [x.exponent for x in sharp] == [2.0]
    table = [
        {"stiffness": 3e3, "lost_motion": 2e-4},
        {"stiffness": 1e3, "lost_motion": 4e-4, "exponent": 3.0, "gamma": 0.3},
    ]
    bent = flexgen.read("elbow", overrides={"element.upper.dof.q1.gear.hysteresis": table})
    own = identify.first_elements(bent, (0,), None, True, TORQUES)
    assert [(x.K_h, x.exponent, x.gamma) for x in own] == [(3e3, 2.0, 0.0), (1e3, 3.0, 0.3)]
    assert_allclose([x.lost for x in own], [2e-4, 4e-4])
    assert len(identify.first_elements(bent, (0,), 1, False, TORQUES)) == 1
    # with 1 arcmin read as 291 um a lost motion of a translation below 5.8 um was none
    sliding = flexgen.read("elbow", overrides={"element.fore.dof.q2.type": "translation"})
    first, second = identify.first_elements(sliding, (0, 1), None, False, TORQUES)
    # the standard deviation of the force over the stiffness
    slide = float(3.0 * sliding.eta[1, 1] / 4.0999e6)
    assert (first.lost, second.lost) == pytest.approx((arcmin, slide))
    assert (first.unit, second.unit) == (first.lost, second.lost)


MOST = f"expected at most {identify.MOST} different whole numbers from 1 to {identify.HIGHEST}"
MANY = list(range(1, identify.MOST + 2))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        *(({"cogging": x}, MOST) for x in ([0], [identify.HIGHEST + 1], [1, 1], [1.0], MANY)),
        *(
            ({"elements": x}, f"elements: given {x}, expected a whole number from 1")
            for x in (0, 9)
        ),
        ({"joints": ["q9"]}, "joints: given ['q9'], expected some of q1, q2"),
    ],
)
def test_numbers_of_elements_and_harmonics_have_bounds(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        flexgen.identify_gears("elbow", record_of(), **given)
    assert text in str(caught.value)


def test_laws_of_other_authors_are_refused() -> None:
    with pytest.raises(ArgumentError, match="given the law Logistic, expected that of Bouc and W"):
        flexgen.identify_gears(with_law("elbow"), record_of())


def test_errors_of_gears_need_joints_with_a_motor_of_their_own() -> None:
    """Only where harmonics are asked for; here the record is too short for more."""
    drives = {"motor.m1.drives": ["q1", "q2"], "motor.m1.ratio": [250.0, -90.0]}
    coupled = flexgen.read("elbow", overrides=drives)
    for given, text in (
        ({"harmonics": [1]}, "harmonics: given for q1, whose motors drive other joints too"),
        ({"band_hz": 10.0}, "record: given 0.999 s, expected at least "),
    ):
        with pytest.raises(ArgumentError, match=text):
            flexgen.identify_gears(coupled, record_of(1.0), hysteresis=False, **given)
