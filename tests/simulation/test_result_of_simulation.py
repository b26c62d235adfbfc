"""Laws, referees and refused input of `flexgen.simulation.result`."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from made_results import made_trajectory
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from flexgen.dynamics.mechanics.equations import derive
from flexgen.simulation import result


def test_errors_of_outputs_are_in_metres_and_radians() -> None:
    q = np.array([[0.1, 0.2], [0.3, -0.1]])
    elbow = derive("elbow")
    y = np.array([np.array(elbow.function("output")(x)).ravel() for x in q])
    error, in_m, in_rad = result.output_error(
        elbow, {"y_ref": y + np.array([[0.3, -0.4], [0.1, 0.0]])}, q
    )
    assert_allclose(error, [[-0.3, 0.4], [-0.1, 0.0]], atol=1e-14)
    assert in_m == pytest.approx(0.5) and in_rad is None
    masses = derive("four_mass")
    x = np.zeros((2, masses.model.n_a))
    m = masses.model.output.size
    error, in_m, in_rad = result.output_error(masses, {"y_ref": np.full((2, m), 0.25)}, x)
    assert in_m == pytest.approx(0.25 * np.sqrt(m)) and in_rad is None


def test_the_error_of_a_pose_is_a_distance_and_an_angle() -> None:
    """The reference is the pose of the tool, moved and turned by known amounts; the last sample is
    after the record.
    """
    equations = derive("manutec_r3")
    robot = equations.model
    rng = np.random.default_rng(3)
    assert robot.output.type == "tool_pose"
    q_a = rng.uniform(-0.5, 0.5, (4, robot.n_a))
    places = [[np.array(x) for x in equations.function("forward_kinematics")(q)] for q in q_a]
    off = np.array([[0.0, 0.0, 0.0], [3e-3, 0.0, -4e-3], [1e-3, 2e-3, 2e-3], [0.0, 0.0, 0.02]])
    angles = np.array([0.0, 0.02, 1.5, 3.0])
    turns = Rotation.from_rotvec(angles[:, None] * [0.6, 0.0, 0.8]).as_matrix()
    given = {
        "y_ref": np.array([p.ravel() for p, _ in places]) - off,
        "R_ref": np.array(
            [(turn @ R).ravel() for turn, (_, R) in zip(turns, places, strict=True)]
        ),
        "tau_m": rng.normal(size=(4, robot.n_m)),
    }
    data: Any = Made(time=np.array([0.0, 0.1, 0.2]))
    more = [rng.normal(size=(4, n)) for n in (robot.n_a, robot.n_m, robot.n_m)]
    in_m, in_rad, found = result.record_motion(equations, data, given, (q_a, *more))
    assert in_m == pytest.approx(0.02) and in_rad == pytest.approx(3.0)
    assert_allclose(found["error"], off[:3], atol=1e-12)
    assert_allclose(found["turn"], angles[:3, None], atol=1e-7)
    assert found.labels["error"] == ("x", "y", "z") and found.labels["turn"] == ("angle",)
    assert (found.ports["error"].unit, found.ports["turn"].unit) == ("m", "rad")
    for name, values in zip(
        ("q_a", "v_a", "q_m", "v_m", "tau_m"), (q_a, *more, given["tau_m"]), strict=True
    ):
        assert_array_equal(found[name], values[:3])
    del given["R_ref"]
    in_m, in_rad, found = result.record_motion(equations, data, given, (q_a, *more))
    assert in_m == pytest.approx(0.02) and in_rad is None and "turn" not in found
    del given["y_ref"]
    in_m, in_rad, found = result.record_motion(equations, data, given, (q_a, *more))
    assert in_m is None and in_rad is None and "error" not in found


@pytest.mark.parametrize(
    ("errors", "text"),
    [
        ((3e-3, 0.02), "3 mm and 20 mrad"),
        ((3e-3, None), "3 mm"),
        ((None, 0.02), "20 mrad"),
        ((None, None), "tool error not measured (the trajectory has no reference)"),
    ],
)
def test_errors_are_told_with_their_units(errors: tuple[Any, Any], text: str) -> None:
    trajectory = made_trajectory(derive("elbow"))
    run = result.Simulation(trajectory, *errors, 1e-9, 5.0, 9.0, 100, 0.1, held_s=0.5)
    line, *_ = result.error_lines(run)
    assert text in line and ("until 0.5 s after the end" in line) == any(errors)
