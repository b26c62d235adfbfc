"""Controllers by name, torques of hysteresis along a motion, counterbalances of a fit, mistakes of
a rigid model.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.hysteresis.hysteresis import Layer, torque_along
from flexgen.dynamics.hysteresis.hysteresis_law import Hysteresis
from flexgen.feedback.loop import named_controllers
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.gains import PID, PPI
from flexgen.feedback.loop.interface import PythonController
from flexgen.identification.rigid import counterbalances, rigid_mistakes


def layer(stiffness: float, slip: float) -> Layer:
    return Layer(
        np.array([stiffness, 0.0]),
        np.array([slip, 0.0]),
        (Hysteresis(1.0, 1.0), Hysteresis(1.0, 1.0)),
    )


def test_torques_of_elements_follow_a_motion_with_reversals() -> None:
    """``z' = K_h (1 - sign(p') z / W) p'`` by SciPy, the sum of two elements; a gear without one
    has none.
    """
    p = np.array([0.0, 0.1, 0.4, 0.4, 0.25, -0.6, -0.6, 0.3])
    layers = (layer(30.0, 4.0), layer(50.0, 9.0))
    found = torque_along(layers, np.stack([p, p], axis=1))
    expected = np.zeros(len(p))
    for K, W in ((30.0, 4.0), (50.0, 9.0)):
        z = 0.0
        for k, change in enumerate(np.diff(p), 1):
            if change:
                s = np.sign(change)
                made = solve_ivp(
                    lambda x, z, s=s, K=K, W=W: K * (s - z / W),
                    (0, abs(change)),
                    [z],
                    rtol=1e-10,
                    atol=1e-12,
                )
                z = float(made.y[0, -1])
            expected[k] += z
    assert_allclose(found[:, 0], expected, rtol=1e-7, atol=1e-9)
    assert not found[:, 1].any() and layers[0].present.tolist() == [True, False]
    assert layers[0].divisor.tolist() == [4.0, 1.0]


def test_before_a_reversal_an_element_is_its_tangent() -> None:
    """Where a search tries a deflection before it: value and slope continue."""
    one = layer(30.0, 4.0)
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


def test_counterbalances_of_a_fit_relieve_the_motor() -> None:
    """Harmonics from the second on, times the largest ratio of the joint, with the other sign;
    others are kept.
    """
    file = ((1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, 8.0))
    dofs = [Made(name="q1", counterbalance=file), Made(name="q2", counterbalance=())]
    coordinates = [Made(name="q1"), Made(name="q2")]
    eta = np.array([[10.0, 0.0], [-40.0, 20.0]])
    model: Any = Made(elements=[Made(dofs=dofs)], coordinates=coordinates, i_g=(0, 1), eta=eta)
    held = counterbalances.held_balances(model, {"q1": 2})
    assert held == {"q1": (file[0], (0.0, 0.0), (0.0, 0.0), file[3]), "q2": ()}
    friction = np.zeros((2, 8))
    friction[1, 4:] = 0.1, 0.2, 0.3, 0.4
    found = counterbalances.fitted_balances(model, {"q1": 2, "q2": 1}, friction)
    assert_allclose(found["q1"], [file[0], (4.0, 8.0), (12.0, 16.0), file[3]])
    assert_allclose(found["q2"], [(0.0, 0.0), (-2.0, -4.0)])


def test_a_mistake_that_explains_the_errors_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its value to first order; not one that a term of the fit could explain, or one below
    noise.
    """
    n = 400
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 8.0, n)
    terms = [np.sin(t)[:, None], np.cos(t)[:, None]]
    wrong = np.zeros((n, 2))
    other = np.zeros((n, 2))
    # the second one is a term of the fit
    wrong[:, 0] = np.sign(np.sin(3 * t))
    other[:, 1] = np.cos(t)
    columns = np.stack([other, wrong, 0.2 * rng.normal(size=(n, 2))], axis=2)
    names = [("a ratio times", 1.0), ("a torque times", 1.0), ("gravity more by", 0.0)]
    falling = np.zeros((n, 2, 4))
    falling[:, 0, 2] = np.exp(-np.abs(np.cos(2 * t)) / 0.1) * np.sign(np.cos(2 * t))
    fades = np.array([1.0, 1.0, 5.0, 5.0])
    monkeypatch.setattr(rigid_mistakes, "_candidates", lambda *given: (names, columns, 0.02))
    monkeypatch.setattr(rigid_mistakes, "_fade_columns", lambda *given: (fades, falling))
    noise = 0.05 * rng.normal(size=(n, 2))
    whole = Made(fades=np.zeros(2), period=2 / 3)

    def causes(error: np.ndarray) -> Any:
        search: Any = rigid_mistakes.find_causes
        none = np.zeros(1)
        return search(whole, 1.0, (none, none), terms, error, np.array([1.0, 2.0]), none)

    def found(error: np.ndarray) -> Any:
        mistake, fading = causes(error)
        assert fading.tolist() == [0.0, 0.0]
        return mistake

    mistake = found(0.3 * wrong + noise)
    assert mistake.what == "a torque times" and mistake.value == pytest.approx(1.3, abs=0.02)
    left = 0.3 * wrong[:, 0] + noise[:, 0]
    assert 0.9 < mistake.share <= 1 - (noise[:, 0] ** 2).sum() / (left**2).sum() + 0.05
    assert mistake.sentence == (
        f"a torque times about 1.3 explains {100 * mistake.share:.0f} % of the errors of a motor."
    )
    assert found(noise) is None  # a small part of the errors
    assert found(0.01 * wrong + noise) is None
    mistake, fading = causes(0.3 * falling[:, :, 2] + noise)  # a friction that falls with speed
    assert mistake is None and fading.tolist() == [5.0, 0.0]
    assert causes(-0.3 * falling[:, :, 2] + noise)[1].tolist() == [0.0, 0.0]  # it rises
    whole.fades[0] = 2.0  # it has one
    assert causes(0.3 * falling[:, :, 2] + noise)[1].tolist() == [0.0, 0.0]


class Law:
    """A law of another package."""

    def reset(self) -> None:
        """Nothing."""

    def step(self, k: int, y: Any, ref: Any) -> Any:
        """No torque."""
        return 0.0


def test_controllers_by_name_file_or_object(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the title that results have; without elasticity there is no notch; unknown names list
    the known ones.
    """
    model = flexgen.read("elbow")
    motion = [np.zeros((3, 2))] * 7
    asked: list[Any] = []
    asked_hz = {"position_hz": 12.345, "speed_hz": 1.0}
    used_hz = [1.0, 1.0]

    def cascade(self: PPI, model: Any, late: float, begin: Any) -> str:
        asked.append((late, [len(x) for x in begin], self.filters))
        return "cascade"

    monkeypatch.setattr(PPI, "cascade", cascade)
    monkeypatch.setattr(PPI, "frequencies", lambda self, model, begin: dict(asked_hz))
    monkeypatch.setattr(PPI, "speeds_in_use", lambda self, model, late, begin: np.array(used_hz))
    lowest = [4.56]
    monkeypatch.setattr(named_controllers, "lowest_locked_hz", lambda model, motion: lowest[0])

    def made(given: Any) -> tuple[Any, str]:
        return named_controllers.controller_of(given, model, 1e-3, 5e-4, motion)

    assert made("ppi") == made(PPI()) == ("cascade", "ppi 12.3/1 Hz")
    assert asked[0][:2] == (pytest.approx(1.5e-3), [1] * 7) and asked[0][2] == ()
    used_hz[:] = [0.5, 0.25]
    assert made("ppi")[1] == (
        "ppi 12.3/0.25 to 0.5 Hz (position/speed/integral; speed cut from 1 Hz, because sample "
        "time and delay are 1.5 ms)"
    )
    assert made("ppi_notch") == ("cascade", "ppi with a notch at 4.56 Hz")
    (notch,) = asked[-1][2]
    assert tuple(vars(notch).values()) == (4.56, 0.3, 0.9)
    lowest[0] = 0.0
    with pytest.raises(
        ArgumentError, match="the model elbow has no elasticity, so no notch frequency; use ppi"
    ):
        made("ppi_notch")
    nothing, name = made("none")
    assert name == "feedforward only" and isinstance(nothing, named_controllers.FeedforwardOnly)
    with pytest.raises(
        ArgumentError,
        match=r"controller: given 'pp', expected one of ppi, ppi_notch, none, .* a file \.t",
    ):
        made("pp")
    own, name = made(Law())
    assert isinstance(own, PythonController) and name == "Law"
    fixed = Cascade(np.ones(2), np.ones(2), np.zeros(2))
    assert made(fixed) == (fixed, "Cascade")
    pid, name = made(PID(np.ones(2), np.ones(2), 0.1 * np.ones(2)))
    assert name == "PID" and not isinstance(pid, PID)
    monkeypatch.setattr(named_controllers, "names", lambda group: ("mine",))
    monkeypatch.setattr(named_controllers, "extension", lambda group, name: lambda gain: gain)
    with pytest.raises(
        ArgumentError,
        match=r"given 'mine', which cannot be made without parameters .*give a file \.toml",
    ):
        made("mine")
