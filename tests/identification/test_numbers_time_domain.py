"""Refinement by simulation with the simulation replaced: linear residuals, whose fit is known in
closed form.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, field
from types import SimpleNamespace as Made
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.time_domain import (
    Simulated,
    Validation,
    validate,
    validate_on_others,
)
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.result import FitStatus

POSES = [[0.5, -0.3], [0.1, 0.2]]
refine: Any = inspect.unwrap(time_domain.refine)


def experiment(experiments: int = 3, realizations: int = 1, **more: Any) -> Any:
    """Of two motors at two poses."""
    poses = np.array(POSES)
    plan = {
        "motors": ("m1", "m2"),
        "poses": poses,
        "controller": Made(speed_gain=np.ones(2)),
        "amplitudes": np.ones(2),
    }
    plan |= {"experiments": experiments, "realizations": realizations, "periods": 4}
    return Made(plan=Made(**(plan | more)), references=None, source="runs.toml")


@dataclass(frozen=True)
class Found:
    """A result of the frequency responses."""

    vector: Any
    status: FitStatus = FitStatus.FITTED
    data: Any = field(default_factory=lambda: Made(motors=("m1", "m2"), poses=np.array(POSES)))
    sensor_delays: Any = ("delays",)
    x: Any = None
    found_delays: Any = None
    formal_covariance: Any = None
    cost: float = 9.0
    model_error: float = 9.0
    starts: int = 9
    agreed: int = 9
    iterations: int = 0
    at_bound: Any = None
    weak: Any = None
    weights: str = ""
    grade: Any = "of the frequency responses"
    wall_s: float = 0.0


class Linear:
    """Residuals ``J (x - best) + rest``."""

    def __init__(self, vector: ParameterVector, size: float) -> None:
        rng = np.random.default_rng(5)
        self.vector = vector
        self.told = list[str]()
        n = len(vector)
        self.J = rng.normal(size=(40, n)) + 1j * rng.normal(size=(40, n))
        self.rest = size * (rng.normal(size=40) + 1j * rng.normal(size=40))
        self.best = vector.start + 0.02
        self.count = 40
        self.sd = 1.0
        self.measured = np.full(40, 1e9)
        self.local = Made(springs=())

    def residual(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(self.J @ (x - self.best) + self.rest)

    def cost(self, x: np.ndarray) -> float:
        return float((np.abs(self.residual(x)) ** 2).sum())

    def sums(self, x: np.ndarray) -> Any:
        r = self.residual(x)
        return self.cost(x), np.real(self.J.conj().T @ r), np.real(self.J.conj().T @ self.J)

    def use_noise(self, x: np.ndarray) -> None:
        self.told.append("noise")

    def use_whole(self) -> None:
        self.told.append("whole")


@pytest.mark.parametrize("size", [0.1, 1.1])
def test_a_refinement_is_the_least_squares_fit_with_its_prior(
    size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its covariance is that of noise of variance one, or larger where the residuals are."""
    model = flexgen.read("elbow")
    made: dict[str, Any] = {}

    def simulated(vector: ParameterVector, given: Any, runs: Any, tell: Any) -> Linear:
        made.update(linear=Linear(vector, size), runs=runs)
        return made["linear"]

    monkeypatch.setattr(time_domain, "Simulated", simulated)
    first = ParameterVector(model, ["q1.stiffness", "q2.damping"])
    found = Found(first)
    object.__setattr__(
        found, "used", lambda: {"q1.stiffness": 5e6, "q2.damping": 500.0, "delay": 1e-3}
    )
    fine = refine(found, experiment(), start={"q2.damping": 550.0}, runs=2)
    linear = made["linear"]
    vector = fine.vector
    assert made["runs"] == [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 2)] and linear.told == [
        "noise",
        "whole",
    ]
    # the grade is that of another model
    assert fine.grade is None
    assert vector.names == first.names == ("q1.stiffness", "q2.damping")
    assert_allclose(vector.values(vector.start), [5e6, 550.0])
    A = np.real(linear.J.conj().T @ linear.J)
    weight = np.diag(vector.prior_sd**-2.0)
    move = np.linalg.solve(
        A + weight, np.real(linear.J.conj().T @ (linear.J @ np.full(2, 0.02) - linear.rest))
    )
    assert_allclose(fine.x, vector.start + move, rtol=0, atol=1e-6)
    cost = linear.cost(fine.x) / (40 - 1)
    assert fine.cost == pytest.approx(cost) and (cost > 1) == (size > 1)
    inverse = np.linalg.inv(A + weight)
    assert_allclose(
        fine.formal_covariance, inverse @ (0.5 * max(cost, 1.0) * A + weight) @ inverse
    )
    assert fine.status == (FitStatus.FITTED if size < 1 else FitStatus.SMALL_ERROR)
    assert (fine.model_error, fine.starts, fine.agreed, fine.weights) == (0.0, 1, 1, "time domain")
    assert fine.found_delays is found.sensor_delays and fine.at_bound == () and fine.weak == ()
    assert fine.iterations >= 2 and 0 < fine.wall_s < 60
    known = ["q2.damping", "delay", "m1.torque_constant"]  # the drive is not identified again
    assert refine(found, experiment(), free=known).vector.names == ("q2.damping",)
    assert made["runs"] == [(0, 0, 0), (1, 0, 1)]


def test_parameters_and_experiments_that_cannot_be_simulated_are_refused() -> None:
    found = Found(ParameterVector(flexgen.read("elbow"), ["q1.stiffness"]))
    object.__setattr__(found, "used", dict)
    others = "experiment: given other motors or poses than those of the frequency responses"
    no_drive = (
        "experiment: given runs.toml, without the gains and references of its drives, expected "
        "tables [drive] and [[reference]] in the description of the recordings, or an "
        "experiment of 'measure'"
    )
    runs = "expected 1 to 6, the experiments at each pose"
    sensor = (
        "free: given the delay of a sensor, which the motors do not show: 'identify' can fit it"
    )
    for given, more, text in (
        (experiment(motors=("m2", "m1")), {}, others),
        (experiment(poses=np.zeros((2, 2))), {}, others),
        (experiment(controller=Made(speed_gain=np.zeros(2))), {}, no_drive),
        (experiment(amplitudes=np.zeros(2)), {}, no_drive),
        (experiment(realizations=2), {"runs": 7}, f"runs: given 7, {runs}"),
        (experiment(realizations=2), {"runs": 0}, f"runs: given 0, {runs}"),
        (experiment(realizations=2), {"runs": 1.5}, f"runs: given 1.5, {runs}"),
        (experiment(), {"free": ["q1.stiffness", "tip.delay"]}, sensor),
        (
            experiment(),
            {"free": ["q1.stiffness", "m1.inertia"]},
            "free: given m1.inertia, expected stiffness, damping, friction or payload",
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            refine(found, given, **more)
        assert str(caught.value) == text
    time_domain._check(found, experiment(realizations=2), 6)  # type: ignore[arg-type]
    recorded = experiment(amplitudes=np.zeros(2))
    recorded.references = np.zeros(3)
    time_domain._check(found, recorded, 1)  # type: ignore[arg-type]


def test_experiments_are_others_from_pose_to_pose() -> None:
    plan: Any = experiment(2, 2, poses=range(3)).plan
    every = [(0, 0), (0, 1), (1, 0), (1, 1)]
    for first, count in ((0, 1), (1, 2), (3, 1)):
        found = time_domain._choose(plan, first, count)
        assert found == [
            (k, *every[(k + i) % 4]) for k in range(3) for i in range(first, first + count)
        ]


def test_a_validation_compares_accelerations_and_correlations_of_lines(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Residuals of the first motor are noise about a mean; those of the second one are the same at
    all lines.
    """
    rng = np.random.default_rng(3)
    runs = 8
    lines = 30
    r = rng.normal(size=(runs, lines, 2)) + 1j * rng.normal(size=(runs, lines, 2))
    r[..., 0] += 0.7
    r[..., 1] = 0.5 + 0.3j
    measured = 50 * (rng.normal(size=(runs, lines, 2)) + 1j)
    made: dict[str, Any] = {}

    def simulated(vector: Any, given: Any, chosen: Any, tell: Any) -> Any:
        made.update(vector=vector, chosen=chosen)
        found = {"residual": lambda x: x * r, "sd": np.full((1, 1, 2), 3.0), "measured": measured}
        return Made(use_noise=lambda x: made.update(noise=x), **found)

    monkeypatch.setattr(time_domain, "Simulated", simulated)
    found: Any = Made(vector="vector", x=1.0)
    checked = validate(found, experiment(3), used=2)
    assert made == {"vector": "vector", "noise": 1.0, "chosen": [(0, 0, 2), (1, 0, 0)]}
    for j in range(2):
        away = np.sqrt((np.abs(3 * r[..., j]) ** 2).sum() / (np.abs(measured[..., j]) ** 2).sum())
        assert checked.fit_percent[j] == pytest.approx(100 * (1 - away))
        count = 0
        for lag in range(1, 21):
            product = sum(
                r[i, k + lag, j] * r[i, k, j].conjugate()
                for i in range(runs)
                for k in range(lines - lag)
            )
            correlation = abs(product.real) / (np.abs(r[..., j]) ** 2).sum()
            count += correlation < 2.5758 / np.sqrt(2 * runs * lines)
        assert checked.white[j] == count / 20
    assert 0.2 < checked.white[0] < 0.8 and checked.white[1] == 0.0
    assert checked.cost == pytest.approx((np.abs(r) ** 2).mean())
    validate(found, experiment(2, 2), used=3)
    for given, used, count in ((experiment(3), 3, 3), (experiment(2, 2), 5, 5)):
        with pytest.raises(ArgumentError) as caught:
            validate(found, given, used=used)
        assert (
            str(caught.value)
            == f"used: given {used}, expected fewer than the {count} experiments at each pose"
        )
    r = r[:, :2]
    measured = measured[:, :2]
    assert validate(found, experiment(3)).white[1] == 0.0  # of the one lag between two lines
    assert made["chosen"] == [(0, 0, 1), (1, 0, 2)]


@pytest.mark.parametrize(
    ("cost", "fit", "status", "expected"),
    [
        (2.01, 99.89, "FITTED", "POORLY_VALIDATED"),
        (2.01, 99.89, "SMALL_ERROR", "POORLY_VALIDATED"),
        (2.01, 99.89, "MODEL_ERROR", "MODEL_ERROR"),
        (1.99, 10.0, "FITTED", "FITTED"),
        (2.01, 99.91, "FITTED", "FITTED"),
    ],
)
def test_a_fit_is_poorly_validated_where_others_deviate(
    cost: float, fit: float, status: str, expected: str
) -> None:
    found: Any = Found(None, FitStatus[status])
    checked = Validation((99.99, fit), cost, (1.0, 1.0))
    assert validate_on_others(found, checked).status == FitStatus[expected]


class Quadratic(Simulated):
    """Spectra that are quadratic in two parameters, without a simulation."""

    def __init__(self) -> None:
        hardware = Made(encoder_noise_rad=0.0, encoder_resolution_rad=0.0, torque_noise_Nm=0.0)
        self.plan: Any = Made(hardware=hardware, periods=4, duration_s=7.6)
        self.measured = np.array([[[1.0 + 1j], [2.0]]])
        self.sd = np.array([[[0.5], [0.25]]])
        self.shift = np.array([[[0.1], [0.2j]]])
        self.simulations = 0
        self.progress = None
        self.whole = False
        self._known = None
        self._before: Any = ("a period", "shortly")
        self.begun: list[Any] = []

    def spectra(self, x: np.ndarray, begin: Any = None, noise: int | None = None) -> np.ndarray:
        self.simulations += 1
        self.begun.append((begin, noise))
        late = 0.0 if noise is None else 1e-3 * (noise - 7_919_000)
        return np.array([[[x[0] ** 2 + 1j * x[1] + late], [3 * x[0] * x[1]]]])


def test_sums_of_a_simulation_are_those_of_its_differences() -> None:
    """Derivatives begin shortly before the period, then a whole one before it; small steps use the
    same ones.
    """
    made = Quadratic()
    x = np.array([1.2, -0.4])
    r = (np.array([1.44 - 0.4j + 0.1, -1.44 + 0.2j]) - [1.0 + 1j, 2.0]) / [0.5, 0.25]
    assert_allclose(made.residual(x).ravel(), r)
    assert made.cost(x) == pytest.approx((np.abs(r) ** 2).sum())
    made.begun.clear()
    cost, g, A = made.sums(x)
    J = np.array([[2.4, 1j], [-1.2, 3.6]]) / np.array([[0.5], [0.25]])
    assert made.begun == [
        (None, None),
        ("shortly", None),
        ("shortly", None),
    ] and cost == pytest.approx(made.cost(x))
    assert_allclose(A, np.real(J.conj().T @ J), rtol=1e-3)
    assert_allclose(g, np.real(J.conj().T @ r), rtol=1e-3)
    # Known derivatives serve again where x moved by at most 0.01, or the cost changed by at most
    # 0.06 of it.
    for step, change, count in (
        (0.0099, 0.9, 1),
        (0.0101, 0.059, 1),
        (0.0101, 0.061, 3),
        (-0.0101, -0.061, 3),
    ):
        there = x + np.array([0.0, step])
        made._known = (x, np.ones((2, 2)), made.cost(there) / (1 + change))
        made.begun.clear()
        assert (made.sums(there)[2] == 2.0).all() == (count == 1) and len(made.begun) == count
    made._known = None
    made.use_whole()
    made.begun.clear()
    made.sums(x)
    assert made.begun == [(None, None), ("a period", None), ("a period", None)]
    lines: list[str] = []
    made.progress = lines.append
    made._known = None
    made.simulations = 4
    made.sums(x)
    assert lines == [
        "simulation 6, 8 s of robot in the plan",
        "simulation 7, 8 s of robot in the plan",
    ]


def test_noise_shifts_spectra_by_its_mean_over_sixteen_simulations() -> None:
    made = Quadratic()
    x = np.array([1.2, -0.4])
    lines = list[str]()
    before = made.shift, made.sd
    made.use_noise(x)
    assert (made.shift, made.sd) == before and not made.begun
    made.progress = lines.append
    made.plan.hardware.torque_noise_Nm = 1e-3
    made.use_noise(x)
    assert made.begun == [(None, None)] + [(None, 7_919_000 + k) for k in range(16)]
    assert_allclose(made.shift, [[[7.5e-3], [0.0]]], atol=1e-15)
    assert_allclose(made.sd, before[1] * np.sqrt(1 + 4 / 16))
    assert lines == ["change of the motion by noise: 16 simulations"]


class Loop:
    """A closed loop whose motors follow the reference with a gain, and with a deviation that
    fades.
    """

    made: ClassVar[list[Loop]] = []

    def __init__(self, *given: Any, seed: int, steps: int, parameters: np.ndarray) -> None:
        self.given = given
        self.seed = seed
        self.steps = steps
        self.parameters = parameters
        self.sample = 0
        self.calls = list[Any]()
        Loop.made.append(self)

    def hold(self, torque: np.ndarray) -> None:
        self.torque = torque

    def run(self, reference: np.ndarray, count: int) -> Any:
        self.calls.append((round(float(np.abs(reference[0, 0, :2]).max()), 9), count))
        rows = reference[(self.sample + np.arange(count)) % len(reference)]
        assert (rows[:, :, 2:] == self.torque).all()
        self.sample += count
        return Made(q_m=self.parameters[0] * rows[:, :, :2])

    def snapshot(self) -> int:
        return self.sample

    def restore(self, begin: int) -> None:
        self.sample = begin


@pytest.mark.parametrize(
    ("gain", "last", "transients"),
    [(100.0, 100, 0), (100.0, 100, 3), (1000.0, 50, 1), (40.0, 200, 2), (0.0, 200, 1)],
)
def test_spectra_are_those_of_a_period_after_the_transients(
    gain: float, last: int, transients: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Derivatives begin ten time constants of the position control before it, a quarter of a
    period at least.
    """
    poses = np.array([[0.5, -0.3], [0.1, 0.2], [7.0, 7.0]])
    n = 200
    h = 1e-3
    hardware = DriveHardware(h, 0.0, 1e-5, 1e-4, 0.2)
    cascade = Cascade(np.array([gain, 2 * gain]), np.ones(2), np.zeros(2))
    lines = np.array([1, 3, 7])
    f = np.array([5.0, 15.0, 35.0])
    plan = Made(
        poses=poses,
        samples=n,
        motors=("m1", "m2"),
        controller=cascade,
        hardware=hardware,
        lines=lines,
        frequencies=f,
    )
    plan.transients = transients
    wave = sum(
        a * np.cos(2 * np.pi * k * np.arange(n) / n + p)
        for a, k, p in ((0.3, 1, 0.2), (0.2, 3, 1.0), (0.1, 7, 2.0))
    )
    runs = [(1, 0, 2), (0, 1, 0)]
    shown = np.random.default_rng(3).normal(size=(3, 2, 3, 4, 3, 2)) + 0j
    given = Made(
        plan=plan,
        q_m=shown,
        reference=lambda k, r, e: poses[k] + np.outer(wave, [1.0, 10 * k + r + e]),
    )
    rest = Made(y=np.arange(8.0).reshape(2, 4), tau_m=np.array([[1.0, 2.0], [3.0, 4.0]]))
    local = Made(
        rest=lambda values, at: rest if (at == poses[[1, 0]]).all() and values == [3.0] else None
    )
    monkeypatch.setattr(
        time_domain, "library_with", lambda *_, **more: Made(parameter_names=more["parameters"])
    )
    monkeypatch.setattr(time_domain, "LocalModel", lambda model, names: local)
    monkeypatch.setattr(time_domain, "largest_rate", lambda local, at: 1e3 * len(at))
    monkeypatch.setattr(
        time_domain, "integration_steps", lambda hardware, rate: (hardware.sample_s, rate)
    )
    monkeypatch.setattr(time_domain, "ClosedLoop", Loop)
    Loop.made.clear()
    named = {"q1.stiffness": 3.0, "m2.speed_gain": 5.0}
    vector: Any = Made(model=Made(n_a=3, n_m=2), of_model=("q1.stiffness",), named=lambda x: named)
    made = Simulated(vector, given, runs)  # type: ignore[arg-type]
    assert_allclose(
        made.measured, (2 * np.pi * f[:, None]) ** 2 * shown[[1, 0], [0, 1], [2, 0]].mean(axis=1)
    )
    assert (
        made.last == last
        and made.count == 12
        and not made.shift.any()
        and made.shift.shape == (2, 3, 2)
    )
    assert_allclose(
        made.sd,
        time_domain._standard_deviation(
            (2 * np.pi * f[:, None]) ** 2 * shown[[1, 0], [0, 1], [2, 0]]
        ),
    )
    found = made.spectra(np.zeros(1))
    parts = (
        np.array([0.3 * np.exp(0.2j), 0.2 * np.exp(1j), 0.1 * np.exp(2j)])[:, None]
        * (2 * np.pi * f[:, None]) ** 2
    )
    assert_allclose(found, 3 * np.array([parts * [1.0, 12.0], parts * [1.0, 1.0]]), rtol=1e-9)
    (loop,) = Loop.made
    quiet, law, y, at, noise = loop.given[2:]
    assert (quiet.encoder_resolution_rad, quiet.encoder_noise_rad, quiet.torque_noise_Nm) == (
        0.0,
        0.0,
        0.0,
    )
    assert_allclose(law.speed_gain, [1.0, 5.0])
    assert_allclose(y, [[0, 1, 2], [4, 5, 6]])
    assert_allclose(at, poses[[1, 0]])
    assert (noise, loop.seed, loop.steps) == (
        0.0,
        0,
        (h, time_domain.FINER * 3e3),
    ) and loop.torque is rest.tau_m
    whole = max(transients, 1) * n
    first = round(float(np.abs(given.reference(1, 0, 2)[0]).max()), 9)
    assert loop.calls[0] == (0.2, n)  # fades in from the pose
    assert loop.calls[1:] == [(first, n)] * (whole // n - 1) + [
        (first, n - last),
        (first, last),
        (first, n),
    ]
    assert made._before == (whole, whole + n - last) and made.simulations == 1
    for begin, run in zip((whole, whole + n - last), (n, last), strict=True):
        assert_allclose(made.spectra(np.zeros(1), begin), found)  # type: ignore[arg-type]
        assert Loop.made[-1].calls == [(first, run), (first, n)]
    made._before = None
    made.spectra(np.zeros(1), noise=11)
    loop = Loop.made[-1]
    assert (
        loop.given[2] is hardware
        and loop.seed == 11
        and made._before is None
        and made.simulations == 4
    )
    assert sum(count for _, count in loop.calls) == whole + 2 * n
