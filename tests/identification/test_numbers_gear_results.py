"""Fits of gears with the simulation replaced: linear torques, numbers from their entries, bands,
and refusals.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.gears import fit, identify
from flexgen.identification.gears.driven_arm import Element
from flexgen.identification.gears.result import GearFit, Number
from flexgen.identification.gears.signals import signals_of


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
    monkeypatch.setattr(identify, "GearFit", lambda **given: Made(**given))
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


@pytest.mark.parametrize(
    ("answers", "asked", "status"),
    [
        ({30.0: "FITTED"}, [30.0], "FITTED"),
        ({30.0: "NOISE_TOO_LARGE"}, [30.0], "NOISE_TOO_LARGE"),
        ({30.0: "MODEL_ERROR", 18.0: "FITTED"}, [30.0, 18.0], "NOISE_TOO_LARGE"),
        (
            {30.0: "NOT_CONVERGED", 18.0: "MODEL_ERROR", 10.8: "FITTED"},
            [30.0, 18.0, 10.8],
            "NOISE_TOO_LARGE",
        ),
        (
            {30.0: "MODEL_ERROR", 18.0: "MODEL_ERROR", 10.8: "MODEL_ERROR"},
            [30.0, 18.0, 10.8],
            "MODEL_ERROR",
        ),
        ({30.0: "MODEL_ERROR", 18.0: "too short"}, [30.0, 18.0], "MODEL_ERROR"),
    ],
)
@pytest.mark.parametrize("given", [False, True])
def test_narrower_bands_show_what_noise_hides(
    answers: dict[float, str],
    asked: list[float],
    status: str,
    given: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0.6 and 0.36 of the band, unless it was given."""
    bands: list[float] = []

    def signals(record: Any, motors: int, band_hz: float | None) -> Any:
        bands.append(round(band_hz or 30.0, 9))
        if answers[bands[-1]] == "too short":
            raise ArgumentError("record: given 1 s")
        return Made(band_hz=bands[-1])

    def result(robot: Any, fitted: Any, model: Any, found: Any) -> Any:
        made = object.__new__(flexgen.GearFit)
        vars(made).update(
            status=FitStatus[answers[bands[-1]]], band_hz=bands[-1], numbers=fitted, joints=model
        )
        return made

    monkeypatch.setattr(identify, "signals_of", signals)
    monkeypatch.setattr(identify, "GearModel", lambda equations, sought, signals: sought)
    monkeypatch.setattr(identify, "estimate", lambda model, tell: None)
    monkeypatch.setattr(
        fit.Sought, "take_out_standstill", lambda sought, found: False, raising=False
    )
    monkeypatch.setattr(identify, "result_of", result)
    monkeypatch.setattr(
        identify, "replace", lambda found, status: Made(status=status, band_hz=found.band_hz)
    )
    t = np.array([0.0, 1.0])
    names = {"q_m": "rad", "tau_m": "N m"}
    ports = {name: Port(name, (2,), unit, "") for name, unit in names.items()}
    record = Trajectory(
        t, {name: np.zeros((2, 2)) for name in names}, ports, dict.fromkeys(names, ("m1", "m2"))
    )
    lines: list[str] = []
    options: dict[str, Any] = {"band_hz": 30.0} if given else {}
    found: Any = identify.identify_gears(
        "elbow", record, harmonics=[3, 1], progress=lines.append, **options
    )
    first = answers[30.0]
    assert bands == (asked[:1] if given else asked) and found.band_hz == 30.0
    assert found.status is FitStatus[first if given else status]
    words = FitStatus[first]
    told = [f"{words}: comparing motions below {band:.3g} Hz only" for band in asked[1:]]
    assert [line for line in lines if "comparing" in line] == ([] if given else told)
    if asked == [30.0]:
        assert [p.name for p in found.numbers] == [
            "q1.stiffness",
            "q1.damping",
            "q2.stiffness",
            "q2.damping",
        ]
        sought = found.joints
        assert (sought.errors, sought.harmonics, sought.cogging, sought.exponents) == (
            (0, 1),
            (1, 3),
            (),
            False,
        )
        assert [each.gear for each in sought.elements] == [0, 1]


def test_harmonics_are_some_whole_numbers() -> None:
    most = identify.MOST
    highest = identify.HIGHEST
    assert identify._orders("cogging", [3, 1, highest]) == (1, 3, highest)
    assert identify._orders("cogging", list(range(1, most + 1))) == tuple(range(1, most + 1))
    text = f"expected at most {most} different whole numbers from 1 to {highest}"
    for given in ([0], [highest + 1], [1, 1], [1.0], [True], 1.5, list(range(1, most + 2))):
        with pytest.raises(ArgumentError) as caught:
            identify._orders("cogging", given)  # type: ignore[arg-type]
        assert str(caught.value).startswith("cogging: given ") and str(caught.value).endswith(text)


def record(t: np.ndarray, q_m: np.ndarray) -> Trajectory:
    channels = {"q_m": q_m, "tau_m": q_m}
    ports = {name: Port(name, (x.shape[1],), "rad", "made up") for name, x in channels.items()}
    return Trajectory(
        t,
        channels,
        ports,
        {name: tuple(f"m{j}" for j in range(q_m.shape[1])) for name in channels},
        {},
    )


def test_records_that_cannot_be_compared_are_refused() -> None:
    t = 5.0 + 1e-3 * np.arange(3000)
    q = np.sin(9 * t[:, None] * [1.0, 1.3])
    lost = q.copy()
    still = q.copy()
    uneven = t.copy()
    lost[7, 1] = np.nan
    still[:, 1] = 3.0
    uneven[20] += 2.2e-5  # a little more than what counts as equal
    for given, motors, band, text in (
        (record(t, q), 3, None, "record: given 2 columns of q_m, expected 3"),
        (
            record(t, lost),
            2,
            None,
            "record: given NaN or infinity in q_m, expected finite numbers",
        ),
        (
            record(uneven, q),
            2,
            None,
            "record: given unequal steps in time, expected the same step between all samples",
        ),
        (
            record(t, still),
            2,
            None,
            "record: given motor 2 at rest, expected that all motors move",
        ),
        (
            record(t, 0 * q),
            2,
            None,
            "record: given motor 1, 2 at rest, expected that all motors move",
        ),
        (record(t, q), 2, 50.1, "band_hz: given 50.1, expected a number > 0, at most 50 Hz"),
        (record(t, q), 2, 0.0, "band_hz: given 0.0, expected a number > 0, at most 50 Hz"),
        (
            record(t[:1000], q[:1000]),
            2,
            10.0,  # 6 filters of 2 * 301 + 1 samples
            "record: given 0.999 s, expected at least 3.62 s to compare motions below 10 Hz",
        ),
    ):
        with pytest.raises(ArgumentError) as caught:
            signals_of(given, motors, band)
        assert str(caught.value) == text
    assert signals_of(record(t, q), 2, 49.9).band_hz == 49.9


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
