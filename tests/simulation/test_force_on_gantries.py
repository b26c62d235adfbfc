"""A force on the tool of a gantry, against the closed form of a mass on a spring.

m a - F = K d,     q_m = n (x + d),     tau_m = J q_m'' + K d/n
"""

from __future__ import annotations

import numpy as np
import pytest
from one_axis import one_axis

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.simulation.verification.growth import Motion, linearize_along

MASS = 80.0
STIFFNESS = 2e6
RATIO = 300.0
ROTOR = 1e-3
SIZE = 150.0
DURATION = 0.5
ELASTIC = (
    f'{{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = {STIFFNESS} '
    "} }"
)
GANTRY = one_axis(
    "gantry", ELASTIC, mass=MASS, ratio=RATIO, rotor=ROTOR, way=0.3, duration=DURATION
)


def pushing(t: np.ndarray) -> np.ndarray:
    """SIZE sin^6(pi t/T) along x [N]."""
    return np.outer(SIZE * np.sin(np.pi * np.clip(t / DURATION, 0.0, 1.0)) ** 6, [1.0, 0.0, 0.0])


def test_the_torques_of_a_gantry_under_a_force(tmp_path):
    file = tmp_path / "gantry.toml"
    file.write_text(GANTRY)
    solution = flexgen.solve(file, force=pushing, progress=False)
    assert solution.status and solution.tool_error_max_m < 1e-8
    path = np.polynomial.Polynomial(0.3 * bell())
    t = np.linspace(0.0, DURATION, 801)
    s = t / DURATION
    w = np.pi / DURATION
    a = path.deriv(2)(s) / DURATION**2
    jounce = path.deriv(4)(s) / DURATION**4
    sin = np.sin(w * t)
    cos = np.cos(w * t)
    F = SIZE * sin**6
    ddF = SIZE * w**2 * (30 * sin**4 * cos**2 - 6 * sin**6)
    expected = ROTOR * RATIO * (a + (MASS * jounce - ddF) / STIFFNESS) + (MASS * a - F) / RATIO
    found = solution.trajectory.at(t)["tau_m"][:, 0]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def change_of_dynamics(model: str, force: list[float]) -> float:
    """Largest difference of the linear dynamics at rest with a force on the tool and without."""
    equations = flexgen.derive(model)
    robot = equations.model
    arm = np.full((2, robot.n_a), 0.3)
    motors = np.full((2, robot.n_m), 0.3)
    given = [arm, 0 * arm, 0 * arm, motors, 0 * motors, 0 * motors, 0 * motors]
    time = np.array([0.0, 1.0])
    plain = linearize_along(equations, Motion(time, *given))
    pushed = linearize_along(equations, Motion(time, *given, force=np.tile(force, (2, 1))))
    return float(np.abs(pushed.A - plain.A).max())


def test_a_force_has_no_stiffness_where_the_tool_does_not_turn(tmp_path):
    """That of the elbow, which turns, is noticed."""
    file = tmp_path / "gantry.toml"
    file.write_text(GANTRY)
    force = [SIZE, -SIZE, 2 * SIZE, 10.0, 20.0, 30.0]
    assert change_of_dynamics(str(file), force) == 0.0
    assert change_of_dynamics("elbow", force) > 1.0


def bell() -> np.ndarray:
    """The polynomial from 0 to 1 whose first five derivatives vanish at both ends: its slope is as
    (s (1 - s))^5.
    """
    slope = (np.polynomial.Polynomial([0, 1]) * np.polynomial.Polynomial([1, -1])) ** 5
    rise = slope.integ()
    return rise.coef / rise(1.0)


@pytest.mark.parametrize("factor", [float("nan"), float("inf"), -1.0])
def test_a_wrong_factor_of_the_assumed_force_is_named(tmp_path, factor):
    file = tmp_path / "gantry.toml"
    file.write_text(GANTRY)
    with pytest.raises(
        ArgumentError, match=r"assumed_force: given .*, expected a finite number >= 0"
    ):
        flexgen.control(file, force=pushing, assumed_force=factor)
