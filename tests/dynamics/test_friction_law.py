"""A friction law is added in two files: its numbers in model/elements.py, its torque in
dynamics/mechanics/force_laws.py.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.dynamics.mechanics import force_laws
from flexgen.model import elements
from flexgen.model.elements import Friction, friction_key
from flexgen.model.friction import GearFriction


@dataclass(frozen=True)
class Quadratic(Friction):
    """``type = "quadratic"``: the default law and a drag ``quadratic w abs(w)``."""

    quadratic: float = friction_key("N m s^2/rad^2", needs="viscous")


def quadratic_torque(friction: Quadratic, w: ca.SX) -> ca.SX:
    return force_laws.smooth_friction(friction, w) + friction.quadratic * w * ca.fabs(w)


@pytest.fixture
def law(monkeypatch):
    monkeypatch.setitem(elements.FRICTION_LAWS, "quadratic", Quadratic)
    monkeypatch.setitem(force_laws.FRICTION_TORQUES, Quadratic, quadratic_torque)


def read(**keys):
    return flexgen.read("planar5_nmp", overrides={"motor.m1.friction": keys})


def test_a_new_law_reaches_the_equations_and_the_parameters(law):
    robot = read(type="quadratic", viscous=0.5, quadratic=0.25)
    v_m = np.array([-3.0, 2.0])
    f_m = np.array(flexgen.derive(robot).function("motor_friction")(v_m)).ravel()
    assert f_m[0] == pytest.approx(0.5 * -3.0 - 0.25 * 9.0, rel=1e-15)
    names = [p.name for p in flexgen.derive(robot, parameters=["m1.friction"]).parameters]
    assert names == ["m1.viscous", "m1.quadratic"]
    assert flexgen.describe(robot)["motors"][0]["friction"] == {
        "type": "quadratic",
        "viscous": 0.5,
        "quadratic": 0.25,
    }


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"type": "quadratic", "quadratic": -1.0, "viscous": 1.0}, "a number >= 0"),
        ({"type": "quadratic", "quadratic": 1.0}, "a number > 0 together with quadratic"),
        ({"type": "smooth", "quadratic": 1.0}, "quadratic"),
        ({"type": "cubic"}, "smooth"),
        ({"coulomb": 1.0}, "a number > 0 together with coulomb or stribeck"),
        ({"stribeck": 1.0, "beta": 1.0}, "a number > 0 together with stribeck"),
    ],
)
def test_wrong_numbers_of_a_law_are_refused(law, keys, text):
    with pytest.raises(ModelError, match=text):
        read(**keys)


def test_the_type_of_the_default_law_may_be_written():
    assert read(type="smooth", viscous=0.5).motors[0].friction == Friction(viscous=0.5)


@pytest.mark.parametrize(
    ("load", "temperature", "missing"),
    [
        (1.0, None, "the temperature"),
        (None, 20.0, "the torque of the gear"),
        (None, None, "the temperature"),
    ],
)
def test_frictions_say_what_they_lack(load, temperature, missing):
    """A friction of gears depends on load and temperature; one that does not needs neither."""
    w = ca.SX.sym("w")
    law = GearFriction(coulomb=0.1, beta=2.0, load_coulomb=0.5, load_smoothing=0.3)
    carried = None if load is None else ca.SX(load)
    expected = f'friction: given type = "gear" without {missing}, on which it depends'
    with pytest.raises(ArgumentError, match=f"^{re.escape(expected)}$"):
        force_laws.friction_torque(law, w, carried, temperature)
    force_laws.friction_torque(GearFriction(coulomb=0.1, beta=2.0), w, None, 20.0)
    with pytest.raises(ArgumentError, match="friction: given a float, expected a law with a meth"):
        force_laws.friction_torque(3.0, w, None, 20.0)
