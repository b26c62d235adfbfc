"""Elements of Bouc and Wen in gears: closed forms, an own integrator, Masing's loop, energy, model
files, errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hysteretic import (
    ARCMIN,
    BENT,
    SLIPS,
    Element,
    Logistic,
    hysteretic,
    joint_stiffness,
    with_elements,
)
from numpy.testing import assert_allclose
from scipy.integrate import quad, simpson, solve_ivp
from scipy.special import hyp2f1

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.memory import Hysteresis
from flexgen.dynamics.hysteresis import hysteresis as layers_of
from flexgen.dynamics.hysteresis import hysteresis_law as law
from flexgen.dynamics.hysteresis.hysteresis import (
    elements_of,
    gear_hysteresis,
    gear_layers,
    torque_along,
)
from flexgen.dynamics.hysteresis.hysteretic_gears import hysteretic_deflections
from flexgen.views.reports.texts import description_text

KEY = "element.upper.dof.q1.gear"
DAMPINGS = (f"{KEY}.damping", "element.fore.dof.q2.gear.damping")
PERIOD = 0.2  # s, of the torques
LAWS = [(1.0, 0.3), (1.5, 0.0), (2.0, 0.5), (3.7, -0.4), (20.0, 0.0)]


def elbow(elements: Sequence[Element], damping: float | None = 0.0) -> flexgen.RobotModel:
    return with_elements(
        "elbow", elements, **({} if damping is None else dict.fromkeys(DAMPINGS, damping))
    )


def torque(t: np.ndarray | float, size: float) -> Any:
    """size sin(w t)^3 with a slow part, whose loops are within one another."""
    w = 2 * np.pi / PERIOD
    return size * np.sin(w * np.asarray(t)) ** 3 * (1.0 - 0.6 * np.asarray(t))


def samples(t: np.ndarray, size: float) -> np.ndarray:
    """The torque of the first gear, -0.4 of it of the second, and two derivatives (n, 2, 3), by
    complex steps.
    """
    h = 1e-30
    w = 2 * np.pi / PERIOD
    c = 1.0 - 0.6 * t
    s = np.sin(w * t)
    cos = np.cos(w * t)
    first = size * np.imag(np.sin(w * (t + 1j * h)) ** 3 * (1.0 - 0.6 * (t + 1j * h))) / h
    second = size * (3 * w**2 * s * (2 * cos**2 - s**2) * c - 2 * 0.6 * 3 * w * s**2 * cos)
    one = np.stack([torque(t, size), first, second], axis=1)
    return np.stack([one, -0.4 * one], axis=1)


@pytest.mark.parametrize(("n", "gamma"), LAWS)
def test_the_curve_is_the_hypergeometric_function(n: float, gamma: float) -> None:
    """u = y F(1, 1/n; 1 + 1/n; y^n) while the torque grows, with -(1 - 2 gamma) |y|^n while it
    falls to zero.
    """
    curve = law.curve_of(Hysteresis(1.0, 1.0, n, gamma))
    y = np.linspace(1e-6, 0.999, 400)
    grows = y * hyp2f1(1, 1 / n, 1 + 1 / n, y**n)
    falls = -y * hyp2f1(1, 1 / n, 1 + 1 / n, -(1 - 2 * gamma) * y**n)
    assert_allclose(curve.at(grows), y, rtol=0, atol=3e-12)
    assert_allclose(curve.at(falls), -y, rtol=0, atol=3e-12)
    assert_allclose(
        curve.path(np.concatenate([y, -y])), np.concatenate([grows, falls]), rtol=1e-8, atol=3e-12
    )
    assert curve.at(np.array([1e9])) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.slow
def test_the_curve_of_a_law_of_another_package_is_its_solution() -> None:
    """y = (E - 1)/(E + bend), E = exp((1 + bend) u); it is that of Dahl's law for bend = 0."""
    u = np.linspace(-0.3, 40.0, 2000)
    for bend in (0.6, 0.0, -0.4):
        E = np.exp((1.0 + bend) * u)
        exact = (E - 1.0) / (E + bend)
        curve = law.curve_of(law.shape_of(Logistic(1e-4, 1e5, bend)))
        assert_allclose(curve.at(u), exact, rtol=0, atol=1e-10)
        assert_allclose(curve.path(exact[:400]), u[:400], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("slope", "told"),
    [
        (lambda y: 1.1 - y, "its slope.y. is 2.1, 1.1 and 0.1 at -1, 0 and 1, at least 0.1"),
        (lambda y: (1.0 - y) * (1.0 - 3.0 * y), "expected 1 at 0, positive numbers before 1"),
        (lambda y: np.nan * y, "is nan"),
        (lambda y: (1.0 - y) ** 2, "a fall to 0 at 1 with a slope of -0.05 or less"),
        (lambda y: (1.0 - y) * (1.0 + 0.5 * np.abs(y - 0.3) - 0.15), "choose a smoother slope"),
    ],
)
def test_invalid_laws_of_other_packages_are_refused(
    slope, told, monkeypatch: pytest.MonkeyPatch
) -> None:
    law.shape_of.cache_clear()
    law.curve_of.cache_clear()
    monkeypatch.setattr(Logistic, "slope", lambda self, y: slope(y))
    with pytest.raises(ArgumentError, match=f"hysteresis law Logistic.*{told}"):
        law.curve_of(law.shape_of(Logistic(1e-4, 1e5, 0.123)))


@pytest.mark.parametrize(("n", "gamma"), LAWS)
def test_the_first_loading_is_an_integral(n: float, gamma: float) -> None:
    """An undamped gear: K_h p/W = int_0^x dx/(1 - x^n) by quadrature, x = (tau - K p)/W."""
    model = elbow([Element(1.0, 0.7, n, gamma)])
    K = joint_stiffness(model)[0]
    (layer,) = gear_layers(model)
    t = np.linspace(0.0, 0.04, 81)
    tau = samples(t, 4.0 * layer.slip[0])
    p, z = hysteretic_deflections(flexgen.derive(model), t, tau)
    assert_allclose(K * p[:, 0] + z[:, 0], tau[:, 0, 0], rtol=0, atol=1e-9 * layer.slip[0])
    x = z[:, 0] / layer.slip[0]
    assert x[-1] > 0.8
    expected = [quad(lambda v: 1.0 / (1.0 - v**n), 0.0, end, epsrel=1e-12)[0] for end in x]
    assert_allclose(layer.stiffness[0] * p[:, 0] / layer.slip[0], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("elements", "damping"),
    [(BENT, 9e3), *(pytest.param(x, 2e3, marks=pytest.mark.slow) for x in (SLIPS, BENT))],
)
def test_damped_gears_follow_an_own_integrator(
    elements: Sequence[Element], damping: float
) -> None:
    """D p' = tau - K p - sum z and each z' in the form with beta, by a library's integrator."""
    model = elbow(elements, damping)
    K = joint_stiffness(model)[:1]
    D = damping
    layers = gear_layers(model)
    t = np.linspace(0.0, 0.45, 1801)
    size = 4.0 * sum(x.slip[0] for x in layers)
    p, z = hysteretic_deflections(flexgen.derive(model), t, samples(t, size))

    def rate(at: float, x: np.ndarray) -> np.ndarray:
        r = (float(torque(at, size)) - K[0] * x[0] - x[1:].sum()) / D
        return np.array(
            [
                r,
                *(
                    r * each.slope(z, np.sign(r), K[0])
                    for each, z in zip(elements, x[1:], strict=True)
                ),
            ]
        )

    start = np.zeros(1 + len(layers))
    least = np.array([1e-14] + [1e-9] * len(layers))
    found = solve_ivp(rate, (0.0, t[-1]), start, "LSODA", t, rtol=1e-10, atol=least, max_step=1e-4)
    assert_allclose(p[:, 0], found.y[0], rtol=0, atol=1e-7 * np.abs(p[:, 0]).max())
    assert_allclose(z[:, 0], found.y[1:].sum(axis=0), rtol=0, atol=2e-6 * size / 4)


def slips(p: np.ndarray, stiffness: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """Maxwell's slip model, springs with Coulomb friction behind them: torques (n,) along
    deflections from rest.
    """
    z = np.zeros(len(slip))
    out = np.zeros(len(p))
    for k, change in enumerate(np.diff(p), 1):
        z = np.clip(z + stiffness * change, -slip, slip)
        out[k] = z.sum()
    return out


@pytest.mark.slow
def test_sharp_elements_are_maxwell_slip_with_masings_loop() -> None:
    """Exponent 20: within 4 % of the slip torques; a loop is twice its first loading, and returns
    to where it began.
    """
    model = elbow([Element(each.lost, each.stiffness, 20.0) for each in SLIPS])
    layers = gear_layers(model)
    K_h, W = (np.array([getattr(x, name)[0] for x in layers]) for name in ("stiffness", "slip"))
    way = np.concatenate(
        [np.linspace(a, b, 1500) for a, b in ((0.0, 1.0), (1.0, -1.0), (-1.0, 0.2), (0.2, -1.0))]
    )
    p = 1.2 * (W / K_h).max() * way
    z = torque_along(layers, np.stack([p, 0 * p], axis=1))[:, 0]
    assert_allclose(z, slips(p, K_h, W), rtol=0, atol=0.04 * W.sum())
    first = z[:1500]
    back = z[1500:3000]
    half = np.interp((p[1499] - p[1500:3000]) / 2, p[:1500], first)
    assert_allclose((z[1499] - back) / 2, half, rtol=0, atol=0.04 * W.sum())
    # the small loop is closed and forgotten
    assert z[-1] == pytest.approx(z[2999], abs=0.04 * W.sum())


@pytest.mark.slow
@pytest.mark.parametrize("elements", [SLIPS, pytest.param(BENT, marks=pytest.mark.full)])
def test_a_cycle_loses_the_area_of_the_loop(elements: Sequence[Element]) -> None:
    """Of the fourth one: int z dp, and the area between the branches that an integrator in p
    gives.
    """
    model = elbow(elements)
    layers = gear_layers(model)
    K = joint_stiffness(model)[:1]
    a = 2e-4
    p = a * np.sin(np.linspace(0.0, 8 * np.pi, 16_001))
    z = torque_along(layers, np.stack([p, 0 * p], axis=1))[:, 0]
    # from reversal to reversal
    work = sum(simpson(z[k : k + 2001], x=p[k : k + 2001]) for k in (11_000, 13_000))

    def branch(start: np.ndarray, s: float, length: float = 2 * a) -> Any:
        def rate(_: float, x: np.ndarray) -> np.ndarray:
            slopes = [s * each.slope(z, s, K[0]) for each, z in zip(elements, x[:-1], strict=True)]
            return np.append(slopes, s * x[:-1].sum())

        return solve_ivp(
            rate, (0.0, length), np.append(start, 0.0), "DOP853", rtol=1e-11, atol=1e-9
        ).y[:, -1]

    found = [branch(np.zeros(len(layers)), 1.0, a)]
    for k in range(7):
        found.append(branch(found[-1][:-1], (-1.0) ** (k + 1)))
    assert work == pytest.approx(found[-2][-1] + found[-1][-1], rel=1e-5)


@cache
def solved() -> flexgen.Solution:
    """Before errors are planted."""
    return flexgen.solve(elbow(BENT, None), progress=False)


@pytest.mark.parametrize(
    "planted",
    ["one element", *(pytest.param(x, marks=pytest.mark.slow) for x in ("gamma", "exponent"))],
)
def test_planted_errors_of_the_law_are_found(
    planted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the stage alone: the simulation integrates the elements itself."""
    model = elbow(BENT, None)
    right = solved()
    assert right.status == "solved" and right.tool_error_max_m < 2e-8
    own = law.curve_of
    changes = {
        "gamma": lambda law: own(replace(law, gamma=-0.5 * law.gamma)),
        "exponent": lambda law: own(replace(law, exponent=law.exponent + 0.2)),
    }
    if planted == "one element":
        from flexgen.dynamics.hysteresis import hysteretic_gears as stage

        monkeypatch.setattr(stage, "gear_layers", lambda model: gear_layers(model)[:1])
    else:
        monkeypatch.setattr(layers_of, "curve_of", changes[planted])
    wrong = flexgen.solve(model, verify=False, progress=False)
    assert flexgen.simulate(model, wrong.trajectory).tool_error_max_m > 1e-6


def test_one_element_by_dahls_law_in_parts_is_the_whole() -> None:
    """Two elements of half the torque and half the stiffness have the bits of none of the others,
    but their motion.
    """
    whole = elbow([Element(1.0, 0.8)])
    parts = elbow([Element(0.5, 0.4)] * 2)
    t = np.linspace(0.0, 0.3, 301)
    found = [
        hysteretic_deflections(flexgen.derive(model), t, samples(t, 2e3))
        for model in (whole, parts)
    ]
    for one, two in zip(*found, strict=True):
        assert_allclose(two, one, rtol=0, atol=1e-12 * np.abs(one).max())


def test_a_list_of_one_table_is_the_table() -> None:
    table = {"lost_motion": 1e-4, "stiffness": 1e6}
    one, listed = (
        flexgen.read("elbow", overrides={f"{KEY}.hysteresis": x}) for x in (table, [table])
    )
    assert one.elements == listed.elements


def test_model_files_keep_the_elements(tmp_path) -> None:
    model = elbow(BENT, None)
    again = flexgen.read(flexgen.export_urdf(model, tmp_path / "elbow.urdf").details["overlay"])
    assert again.coordinates[0].dof.gear.hysteresis == model.coordinates[0].dof.gear.hysteresis


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"exponent": 0.9}, "exponent.*expected a number >= 1, at most 20"),
        ({"exponent": 21.0}, "exponent"),
        ({"gamma": 0.6}, "gamma.*expected a number >= -1, at most 0.5"),
        ({"beta": 0.5}, "beta"),
    ],
)
def test_wrong_numbers_of_an_element_are_refused(given: dict[str, float], told: str) -> None:
    right = {"lost_motion": 1e-4, "stiffness": 1e6}
    with pytest.raises(ModelError, match=told):
        flexgen.read("elbow", overrides={f"{KEY}.hysteresis": [right, right | given]})


def test_wrong_lists_are_refused() -> None:
    right = {"lost_motion": 1e-4, "stiffness": 1e6}
    for wrong, told in (
        ([], "a list of tables, not empty"),
        ([right] * 9, "at most 8 tables"),
        (3.0, "a table"),
    ):
        with pytest.raises(ModelError, match=told):
            flexgen.read("elbow", overrides={f"{KEY}.hysteresis": wrong})


def test_lost_motions_of_elements_are_numbers_of_the_model() -> None:
    """One by one, those of a gear, and all; a factor changes the torques at which they slip."""
    from flexgen.dynamics.mechanics.parameters import select, with_values

    model = elbow(SLIPS)
    assert [p.name for p in select(model, ["q1.lost_motion"])] == [
        f"q1.lost_motion_{k}" for k in (1, 2, 3)
    ]
    assert (
        len(select(model, ["lost_motion"])) == 6
        and len(select(model, ["q2.hysteresis_stiffness"])) == 3
    )
    wide = with_values(model, {"q1.lost_motion_2": 0.6 * ARCMIN})
    before, after = (np.array([x.slip for x in gear_layers(each)]) for each in (model, wide))
    assert_allclose(after / before, [[1.0, 1.0], [2.0, 1.0], [1.0, 1.0]], rtol=1e-12)


def test_the_description_has_the_lost_motion_of_all_elements() -> None:
    for model in (elbow(SLIPS), hysteretic("elbow")):
        assert f"lost motion {ARCMIN:.3g} rad" in description_text(flexgen.describe(model))


@dataclass(frozen=True)
class Quadratic:
    """A law of another package."""

    def slope(self, y: Any) -> Any:
        return 1.0 - 0.5 * y - 0.5 * y**2


def test_the_rate_of_another_law_is_that_of_its_slope_in_either_direction() -> None:
    other: Any = Quadratic()
    for rate, expected in (
        (2.0, 2 * (1 - 0.25 - 0.125)),
        (-3.0, -3 * (1 + 0.25 - 0.125)),
        (0.0, 0.0),
    ):
        assert_allclose(law.law_rate(other, rate, 2.0, 4.0), expected, rtol=1e-15)


def test_before_a_reversal_an_element_is_its_tangent() -> None:
    """Where a search tries a deflection before it: value and slope continue."""
    both = (Hysteresis(1.0, 1.0), Hysteresis(1.0, 1.0))
    one = layers_of.Layer(np.array([30.0, 0.0]), np.array([4.0, 0.0]), both)
    s = np.array([1.0, 1.0])
    z_r = np.array([-1.5, 0.0])
    none = np.zeros(2)
    (z, rise), (ahead, rise_ahead), (back, _) = (
        one.along(np.full(2, way), z_r, s, none) for way in (0.0, 1e-6, -1e-3)
    )
    slope = 30.0 * (1 + 1.5 / 4.0)
    assert z[0] == -1.5 and rise.tolist() == [pytest.approx(slope), 0.0]
    assert (ahead[0] - z[0]) / (1e-6 * 4.0 / 30.0) == pytest.approx(slope, rel=1e-5)
    assert back[0] == pytest.approx(-1.5 - slope * 1e-3 * 4.0 / 30.0, rel=1e-9)
    assert rise_ahead[0] == pytest.approx(slope * np.exp(-1e-6))


def test_layers_are_the_elements_of_all_gears_one_after_the_other() -> None:
    """Slip is half the lost motion times the stiffness of the spring; a gear without an element
    has zeros.
    """
    one = {"stiffness": 2e5, "lost_motion": 1e-4}
    two = {"stiffness": 1e5, "lost_motion": 4e-4, "exponent": 3.0}
    plain = flexgen.read("elbow")
    second = plain.elements[1].name
    changes: dict[str, Any] = {
        "element.upper.dof.q1.gear.hysteresis": [one, two],
        f"element.{second}.dof.q2.gear.hysteresis": one,
    }
    model = flexgen.read("elbow", overrides=changes)
    gears: list[Any] = [element.dofs[0].gear for element in plain.elements]
    k = np.array([gear.spring.stiffness for gear in gears])
    expected = [([2e5, 2e5], 1e-4 * k / 2), ([1e5, 0.0], [4e-4 * k[0] / 2, 0.0])]
    for layer, (stiffness, slip) in zip(gear_layers(model), expected, strict=True):
        np.testing.assert_allclose(layer.stiffness, stiffness)
        np.testing.assert_allclose(layer.slip, slip, rtol=1e-14)
    whole = gear_hysteresis(model)
    np.testing.assert_allclose(whole.stiffness, [3e5, 2e5])
    np.testing.assert_allclose(whole.slip, [5e-4 * k[0] / 2, 1e-4 * k[1] / 2], rtol=1e-14)
    (none,) = gear_layers(plain)
    assert not none.stiffness.any() and not none.slip.any()
    own: Any = model.elements[0].dofs[0].gear
    assert elements_of(None) == () and len(elements_of(own.hysteresis)) == 2
    assert elements_of(elements_of(own.hysteresis)[0]) == own.hysteresis[:1]


def stepped(given: Hysteresis, K: float, W: float, p: np.ndarray, parts: int = 40) -> np.ndarray:
    """Torques at samples by the written law of Bouc and Wen, with steps of Runge and Kutta."""

    def rate(z: float, s: float) -> float:
        power = abs(z / W) ** given.exponent
        return K * (s * (1 - given.gamma * power) - (1 - given.gamma) * power * np.sign(z / W))

    z = 0.0
    out = [0.0]
    for change in np.diff(p):
        h = abs(change) / parts
        s = float(np.sign(change))
        for _ in range(parts):
            a = rate(z, s)
            b = rate(z + h * a / 2, s)
            c = rate(z + h * b / 2, s)
            z += h * (a + 2 * b + 2 * c + rate(z + h * c, s)) / 6
        out.append(z)
    return np.array(out)


def test_torques_of_two_layers_along_reversing_deflections() -> None:
    """Dahl's law and one with a sharp knee, of two gears, one of which rests for a sample."""
    first = [0.0, 1.0, 1.8, 0.9, -0.4, 0.2, 2.0, 1.5]
    second = [0.0, -0.5, -0.9, -0.9, 0.3, 1.5, 0.2, -2.0]
    p = np.array([first, second]).T
    dahl = Hysteresis(1.0, 1.0)
    sharp = Hysteresis(1.0, 1.0, 2.0, 0.5)
    layers = [
        (np.array([4.0, 2.0]), np.array([3.0, 1.0]), (dahl, sharp)),
        (np.array([1.0, 5.0]), np.array([0.5, 4.0]), (dahl, dahl)),
    ]
    made = [layers_of.Layer(K, W, tuple(map(law.shape_of, laws))) for K, W, laws in layers]
    found = torque_along(made, p)
    for gear in range(2):
        each = [stepped(laws[gear], K[gear], W[gear], p[:, gear]) for K, W, laws in layers]
        np.testing.assert_allclose(found[:, gear], sum(each), rtol=1e-4, atol=1e-5)
