"""The amplitude test on responses that are made up: laws by closed forms, planted laws are found
with their numbers; changes of gears by least squares.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from identification_cases import noisy_responses
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.special import erfc

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.causes import levels as at_levels
from flexgen.identification.responses import amplitude
from flexgen.identification.responses.amplitude import (
    LAWS,
    Comparison,
    Level,
    Motion,
    Nonlinearity,
    compare,
    difference,
)
from flexgen.identification.responses.gear_changes import Linearization, fit_changes

BY_NAME = {law.name: law for law in LAWS}
SIZES = np.array([1.0, 1 / 3])  # of the motions of the levels
# deflections of gears [rad] and speeds of motors [rad/s]
UNITS = np.array([2e-4, 3e-4]), np.array([1.5, 2.5])
# of the motions of three poses, mean 1
WIDE = 1.0 + 0.3 * np.array([[0.5, -0.5], [0.0, 0.0], [-0.5, 0.5]])


def bench() -> Linearization:
    """Two motors with gears on two links that are coupled, at three poses, 12 lines."""
    w = 2 * np.pi * np.geomspace(2.0, 100.0, 12)
    s = 1j * w[:, None, None]
    stiffness = np.array([4e3, 2e3])
    inertia = np.array([0.05, 0.03])
    # deflections, then motor angles
    rows = np.block([[-np.eye(2), np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
    parts = []
    for pose in (0.2, 0.7, 1.2):
        M = np.diag([*(0.0, 0.0), *inertia]) + 0.0
        M[:2, :2] = [[0.6 + 0.2 * np.cos(pose), 0.1 * np.cos(pose)], [0.1 * np.cos(pose), 0.2]]
        K = rows[:2].T @ np.diag(stiffness) @ rows[:2]
        D = rows[:2].T @ np.diag([3.0, 2.0]) @ rows[:2] + np.diag([0.0, 0.0, 0.3, 0.2])
        inverse = np.linalg.inv(s**2 * M + s * D + K)
        B = np.vstack([np.zeros((2, 2)), np.eye(2)])
        motors = rows[2:]
        parts.append(
            (
                s**2 * motors @ inverse @ B,
                s**2 * (motors @ inverse @ rows.T),
                rows @ inverse @ rows.T,
                rows @ inverse @ B,
            )
        )
    G, L, S, P = (np.array(x) for x in zip(*parts, strict=True))
    return Linearization(w, G, L, S, P, stiffness, inertia)


def motions(torque: float = 0.0) -> list[Motion]:
    return [Motion(size * WIDE, size * WIDE, torque * np.ones((3, 2))) for size in SIZES]


def levels_with(name: str, z: list[list[float]], torque: float = 0.0) -> list[Level]:
    """Responses of the bench where a law has the numbers ``z``, and the motions that the law was
    evaluated for.
    """
    model = bench()
    rng = np.random.default_rng(4)
    out = []
    for size, effect in zip(
        SIZES, BY_NAME[name].effects(np.array(z), motions(torque)), strict=True
    ):
        # the linear model is the robot at the first level: the law adds to it what differs there
        x = (
            effect.changes() - [1.0, 1.0, *6 * [0.0]]
            if name in ("backlash", "cubic")
            else effect.changes()
        )
        G = np.array([model.response(k, x[k]) for k in range(3)])
        error = np.zeros(3) if effect.distortion is None else effect.distortion.mean(axis=1)
        noise = rng.standard_normal((*G.shape, 2)) @ [1, 1j] / np.sqrt(2)
        G = G * (1 + 0.05 * error[:, None, None, None] * noise)
        # torque of the gears over the stiffness of the model
        sd = size * WIDE * UNITS[0] * (1 + x[:, :2])
        out.append(
            Level(
                model,
                G,
                1e-10 * np.abs(G) ** 2,
                torque * UNITS[0] * np.ones((3, 2)),
                sd,
                size * WIDE * UNITS[1],
            )
        )
    return out


def test_effects_of_laws_by_closed_forms() -> None:
    """Deflections of mean zero: a cubic spring adds its mean square, a dead band the part of the
    time outside of it.
    """
    sizes = np.array([size * WIDE for size in SIZES])
    c = np.array([0.3, 0.7])
    gap = np.array([0.4, 0.1])
    found = BY_NAME["cubic"].effects(c[None], motions())
    mean = (1 + c * sizes[0] ** 2).mean(axis=0)
    for effect, sd in zip(found, sizes, strict=True):
        assert_allclose(effect.stiffness, (1 + c * sd**2) / mean, rtol=1e-5)
        assert_allclose(
            effect.distortion, c / 3 * np.sqrt(6) * sd**3 / ((1 + c * sd**2) * sd), rtol=1e-4
        )
        assert not effect.loss.any() and not effect.friction.any()
        assert_allclose(effect.changes(), np.hstack([effect.stiffness, np.zeros((3, 6))]))
    found = BY_NAME["backlash"].effects(gap[None], motions())
    mean = erfc(gap / sizes[0] / np.sqrt(2)).mean(axis=0)
    for effect, sd in zip(found, sizes, strict=True):
        assert_allclose(effect.stiffness, erfc(gap / sd / np.sqrt(2)) / mean, rtol=2e-3)
    loaded = BY_NAME["cubic"].effects(c[None], motions(0.5))
    # bent by the load
    assert (loaded[1].stiffness > BY_NAME["cubic"].effects(c[None], motions())[1].stiffness).all()
    found = BY_NAME["Coulomb"].effects(np.array([[0.2, 0.5]]), motions())
    for effect, sd in zip(found, sizes, strict=True):
        assert_allclose(effect.friction, np.array([0.2, 0.5]) * np.sqrt(2 / np.pi) / sd)
        assert not effect.stiffness.any() and not effect.loss.any() and effect.distortion is None
    stuck, slipping = (
        BY_NAME["hysteresis"].effects(np.array([[0.3, 0.3], [x, x]]), motions())
        for x in (50.0, 0.5)
    )
    assert_allclose(stuck[0].stiffness, 0.3)
    assert_allclose(stuck[0].loss, 0.0, atol=1e-12)
    assert (slipping[0].stiffness < slipping[1].stiffness).all() and (
        slipping[0].loss > 0.01
    ).all()
    assert_allclose(slipping[1].changes()[:, 2:4], slipping[1].loss)


@pytest.mark.parametrize(
    ("name", "z"),
    [
        ("Coulomb", [[0.05, 0.15]]),
        ("hysteresis", [[0.4, 0.25], [0.5, 0.8]]),
        ("backlash", [[0.3, 0.2]]),
        ("cubic", [[0.4, 0.8]]),
    ],
)
def test_a_planted_law_is_found_with_its_numbers(name: str, z: list[list[float]]) -> None:
    levels = levels_with(name, z)
    found = compare(levels)
    assert found.differs and found.changed and found.ratio > 100 and found.changes > 10
    assert [cause.law for cause in found.causes] == [name]
    best = found.causes[0]
    assert 0.99 < best.share <= 1.0 and sorted(best.numbers) == [0, 1]
    assert_allclose(np.array([best.numbers[j] for j in (0, 1)]).T, z, rtol=0.06)
    model = levels[0].model
    frequency = np.exp(np.log(model.w).mean())
    assert_allclose(found.deflection, UNITS[0], rtol=0.01)
    assert_allclose(found.friction, model.inertia * frequency * UNITS[1], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "z", "named"),
    [("Coulomb", [[0.1, 0.001]], 0), ("hysteresis", [[0.001, 0.3], [0.6, 0.6]], 1)],
)
def test_a_gear_without_the_law_is_not_named(name: str, z: list[list[float]], named: int) -> None:
    """Its effect is below a fifth of the largest."""
    found = compare(levels_with(name, z)).causes
    assert [(cause.law, sorted(cause.numbers)) for cause in found] == [(name, [named])]


@pytest.mark.slow
def test_levels_that_do_not_differ_have_no_cause() -> None:
    levels = levels_with("Coulomb", [[0.0, 0.0]])
    found = compare(levels)
    assert not found.differs and not found.changed and found.causes == () and found.ratio < 1e-6
    assert found.deflection.tolist() == [0.0, 0.0] and found.changes == 0.0
    rng = np.random.default_rng(2)  # distortion alone: responses differ at random, gears do not
    noise = rng.standard_normal((*levels[1].G.shape, 2)) @ [1, 1j]
    found = compare([levels[0], replace(levels[1], G=levels[1].G * (1 + 0.02 * noise))])
    assert found.differs and not found.changed and found.causes == () and 0.0 < found.changes < 2.0
    # no law changes the damping alone
    damped = [np.zeros(8), np.array([0.0, 0.0, 0.0, 0.0, 0.4, -0.2, 0.0, 0.0])]
    model = levels[0].model
    levels = [
        replace(x, G=np.array([model.response(k, change) for k in range(3)]))
        for x, change in zip(levels, damped, strict=True)
    ]
    found = compare(levels)
    assert found.changed and found.causes == ()


def test_the_difference_of_responses_by_hand() -> None:
    """Over noise, a 500th of the responses and a 20th of what the model itself changes; the
    model's is subtracted.
    """
    G = np.full((1, 2, 1, 1), 10.0 + 0j)
    one, other = (SimpleNamespace(G=g + 0 * G) for g in (10.0, 12.0))
    levels: list[Any] = [
        SimpleNamespace(G=G, model=one, variance=np.full(G.shape, 0.01)),
        SimpleNamespace(G=G + 2.5, model=other, variance=np.full(G.shape, 0.02)),
    ]
    ratio, size = difference(levels)
    assert ratio == pytest.approx(
        0.5**2 / (0.01 + 0.02**2 + 0.02 + 0.1**2)
    ) and size == pytest.approx(0.05)
    levels.append(SimpleNamespace(G=G - 1.0, model=one, variance=np.full(G.shape, 0.02)))
    both = difference(levels)
    assert both[0] == pytest.approx((ratio + 1.0 / (0.01 + 0.02**2 + 0.02)) / 2)
    assert both[1] == pytest.approx(0.075)  # the median of 0.05 and 0.1, twice each
    around = Comparison(2.0, 0.1, 3.0, (), np.zeros(1), np.zeros(1))
    assert not around.differs and not around.changed
    assert replace(around, ratio=2.1).differs and replace(around, ratio=2.1).changed
    assert not replace(around, ratio=2.1, changes=2.0).changed


def test_a_fit_of_changes_finds_those_of_the_responses() -> None:
    """With its distortion: the part of the responses that is left beyond the noise, and nothing
    without any.
    """
    model = bench()
    x = np.array([0.2, -0.1, 0.05, 0.02, 0.1, 0.05, 0.1, 0.2])
    G = model.response(1, x)
    exact = fit_changes(model, 1, G, 1e-12 * np.abs(G) ** 2, np.zeros(8))
    assert_allclose(exact.x, x, atol=2e-3)
    assert exact.distortion < 1e-4
    noise = np.random.default_rng(1).standard_normal((*G.shape, 2)) @ [1, 1j] / np.sqrt(2)
    rough = fit_changes(model, 1, G * (1 + 0.03 * noise), 1e-12 * np.abs(G) ** 2, np.zeros(8))
    assert rough.distortion == pytest.approx(0.03, rel=0.25)
    ratio = np.sqrt(np.diag(rough.covariance) / np.diag(exact.covariance))
    assert ratio.min() > 10
    known = fit_changes(model, 1, G * (1 + 0.03 * noise), 0.03**2 * np.abs(G) ** 2, np.zeros(8))
    assert known.distortion < 0.02  # it is noise


@pytest.mark.parametrize(
    ("law", "numbers", "words"),
    [
        ("Coulomb", {0: (0.1,), 1: (0.2,)}, "Coulomb friction of m1 (0.2 N m), m2 (0.8 N m)"),
        ("backlash", {1: (0.3,)}, "backlash of q2 (+-0.15 mrad)"),
        (
            "cubic",
            {0: (0.12,)},
            "a stiffness that rises with the deflection of q1 (12 % more at 0.2 mrad rms)",
        ),
        (
            "hysteresis",
            {1: (0.1, 2.0)},
            "hysteresis of q2 (10 % of the stiffness slips at 1 mrad)",
        ),
    ],
)
def test_the_words_of_causes(law: str, numbers: dict[int, tuple[float, ...]], words: str) -> None:
    robot = flexgen.read("elbow")
    found = Comparison(2.0, 0.1, 3.0, (), np.array([2e-4, 5e-4]), np.array([2.0, 4.0]))
    cause = Nonlinearity(law, 0.5, numbers, 0.0)
    assert at_levels.cause_in_words(cause, found, robot, list(robot.i_g)).words == words


def test_the_sentence_of_the_amplitude_test() -> None:
    one, two = (
        at_levels.NonlinearCause(f"{x} of q1", share)
        for x, share in (("backlash", 0.9), ("hysteresis", 0.876))
    )
    test = at_levels.AmplitudeTest(5.0, 0.0234, True, True, (one, two))
    words = "the levels differ by 2.3 % of the responses; backlash of q1 explains 90 % of it, or "
    assert test.sentence == f"{words}hysteresis of q1 explains 88 % of it"
    assert replace(test, changed=False).sentence == (
        "the levels differ by 2.3 % of the responses by distortion, and stiffness, loss and "
        "friction of gears and motors do not"
    )
    assert replace(test, causes=()).sentence == (
        "the levels differ by 2.3 % of the responses; backlash, a stiffness that rises with the "
        "deflection, hysteresis, Coulomb friction of gears and motors do not explain it"
    )
    assert (
        replace(test, differs=False).sentence
        == "no difference between the levels beyond the noise"
    )
    assert test.to_dict() == {
        "sentence": test.sentence,
        "differs": True,
        "changed": True,
        "difference_over_noise": 5.0,
        "difference_over_response": 0.0234,
        "causes": [
            {"words": "backlash of q1", "share": 0.9},
            {"words": "hysteresis of q1", "share": 0.876},
        ],
    }


def test_a_spring_whose_distortion_is_that_of_the_other_does_not_exclude_it() -> None:
    """A dead band distorts more at a smaller amplitude, a cubic spring less; the order of the
    levels does not count.
    """
    sizes = np.array([1.0, 0.3])
    falls = np.array([-3.1, -2.6])
    for law, distortion, doubted in (
        ("cubic", falls, True),
        ("cubic", falls[::-1], False),
        ("backlash", falls, False),
        ("backlash", falls[::-1], True),
        ("hysteresis", falls, False),
    ):
        assert amplitude.contradicted(law, distortion, sizes) is doubted
        assert amplitude.contradicted(law, distortion[::-1], sizes[::-1]) is doubted


def test_changes_of_gears_are_a_compromise_of_responses_and_prior() -> None:
    """With much noise they are zero with the covariance of the prior; else the least squares of an
    own program.
    """
    rng = np.random.default_rng(4)

    def of(*shape: int) -> np.ndarray:
        return 0.1 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))

    model = Linearization(
        w=np.geomspace(2.0, 50.0, 12),
        G=of(2, 12, 1, 1),
        L=of(2, 12, 1, 2),
        S=of(2, 12, 2, 2),
        P=of(2, 12, 2, 1),
        stiffness=np.array([3.0]),
        inertia=np.array([0.2]),
    )
    x = np.array([0.3, -0.1, 0.2, 0.5])
    h = 1e-6
    assert model.frequency == pytest.approx(10.0)
    assert_allclose(model.prior, [2.0, 0.5, 0.5, 5.0])
    assert_allclose(model.units, [[3.0], [3.0], [0.3], [2.0]])
    for k in range(4):
        high, low = (model.response(1, x + s * h * np.eye(4)[k]) for s in (1, -1))
        assert_allclose(
            model.derivative(1, x)[..., k], (high - low) / (2 * h), rtol=1e-5, atol=1e-8
        )
    G = model.response(1, x)
    loud = fit_changes(model, 1, G, np.full(G.shape, 1e12), x)
    assert_allclose(loud.x, 0.0, atol=1e-6)
    assert_allclose(loud.covariance, np.diag(model.prior**2) / 2, rtol=1e-6, atol=1e-9)
    variance = np.full(G.shape, 1e-2)
    found = fit_changes(model, 1, G, variance, np.zeros(4))

    def residual(x: np.ndarray) -> np.ndarray:
        away = (model.response(1, x) - G) / np.sqrt(variance + 1e-6 * np.abs(G) ** 2)
        return np.concatenate([away.real.ravel(), away.imag.ravel(), x / [2.0, 0.5, 0.5, 5.0]])

    assert_allclose(
        found.x, least_squares(residual, np.zeros(4), xtol=1e-12).x, rtol=1e-3, atol=1e-4
    )
    assert found.distortion == 0.0


def test_levels_of_other_experiments_and_of_the_same_speed_are_refused() -> None:
    data = replace(noisy_responses(), speed_sd=np.ones((2, 2)))
    half = replace(data, speed_sd=0.5 * np.ones((2, 2)))
    near = replace(half, poses=data.poses + 5e-4)
    at_levels.check_levels(data, [half, replace(data, speed_sd=1.31 * data.speed_sd), near])
    wrong: list[dict[str, Any]] = [
        {"motors": ("m2", "m1")},
        {"w": 1.1 * data.w},
        {"w": data.w[:3]},
        {"poses": data.poses + 2e-3},
    ]
    for changes in wrong:
        with pytest.raises(
            ArgumentError, match=r"^levels, 2: given responses of other motors, po"
        ):
            at_levels.check_levels(data, [half, replace(half, **changes)])
    for factor in (1.29, 1.0, 1 / 1.29):
        same = replace(data, speed_sd=factor * data.speed_sd)
        with pytest.raises(
            ArgumentError, match=f"^levels, 1: given {factor:.3g} times the speeds"
        ):
            at_levels.check_levels(data, [same])
