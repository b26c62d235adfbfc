"""Numbers of motors and joints that a library has as constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.codegen.emission.kinematic_functions import kinematic_constants
from flexgen.codegen.emission.motor_constants import motor_constants
from flexgen.model.elements import Dof, Gear, RobotModel


def with_dofs(model: RobotModel, dofs: tuple[Dof, ...]) -> RobotModel:
    elements = zip(model.elements, dofs, strict=True)
    return replace(model, elements=tuple(replace(e, dofs=(dof,)) for e, dof in elements))


@pytest.mark.parametrize("side", ["arm", "motor"])
def test_constants_of_motors_are_those_of_their_gears(side: str) -> None:
    """A damper of the motor side acts on the arm by the ratio squared; a rigid gear has none,
    whatever it states.
    """
    model = flexgen.read("elbow")
    first, second = (element.dofs[0] for element in model.elements)
    elastic = replace(second.gear, side=side, damping=3.0)
    rigid = Gear(True, side, None, 7.0)
    made = motor_constants(
        with_dofs(model, (replace(first, gear=rigid), replace(second, gear=elastic)))
    )
    factor = 1.0 if side == "arm" else model.eta[1, 1] ** 2
    assert made.gear_damping == (0.0, pytest.approx(3.0 * factor))
    assert made.damping_factor == (0.0, pytest.approx(factor))
    assert made.gear_is_rigid == (True, False)
    assert_allclose(np.array(made.eta) @ np.array(made.eta_inverse), np.eye(2), atol=1e-12)
    assert made.rotor_inertia == tuple(motor.inertia for motor in model.motors)
    assert made.gears == ("q1", "q2")


@pytest.mark.parametrize(
    ("kind", "limits", "interval", "around"),
    [
        ("translation", (None, None), (-1.0, 1.0), True),
        ("translation", (0.5, None), (0.5, 2.5), False),
        ("translation", (None, 0.5), (-1.5, 0.5), False),
        ("translation", (0.1, 0.4), (0.1, 0.4), False),
        ("rotation", (-1.0, 1.0), (-np.pi, np.pi), False),
        ("rotation", (None, None), (-np.pi, np.pi), False),
    ],
)
def test_starts_of_slides_are_between_their_limits_and_of_rotations_over_a_turn(
    kind: str,
    limits: tuple[float | None, float | None],
    interval: tuple[float, float],
    around: bool,
) -> None:
    model = flexgen.read("elbow")
    first, second = (element.dofs[0] for element in model.elements)
    changed = replace(second, type=kind, lower=limits[0], upper=limits[1])
    found = kinematic_constants(with_dofs(model, (first, changed)))
    assert (found.lower[1], found.upper[1]) == pytest.approx(interval)
    assert (found.around[1], found.is_rotation) == (around, (True, kind == "rotation"))
    assert found.i_g == tuple(model.i_g)


def test_coordinates_of_beams_start_as_slides_without_limits() -> None:
    model = flexgen.read("beam_arm")
    found = kinematic_constants(model)
    bending = [k for k, c in enumerate(model.coordinates) if c.dof is None and c.unit != "rad"]
    assert bending and found.i_g == tuple(model.i_g)
    for k in bending:
        assert (found.lower[k], found.upper[k], found.around[k]) == (-1.0, 1.0, True)
