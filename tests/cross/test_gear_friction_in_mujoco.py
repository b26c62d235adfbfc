"""Friction that depends on load and temperature along moves: MuJoCo under the torques, with the
law of the tests.
"""

from __future__ import annotations

import pytest
from gear_friction import error_in_mujoco, loaded
from hysteretic import ARCMIN

import flexgen

pytest.importorskip("mujoco")
KNOWN = 5e-8  # m
NO_LOAD = {"load_coulomb": 0.0, "load_stribeck": 0.0}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("elbow", marks=pytest.mark.slow),
        pytest.param("planar5_nmp", marks=pytest.mark.slow),
        pytest.param("manutec_r3_18", marks=pytest.mark.full),
    ],
)
def test_mujoco_with_this_friction_follows_the_path(name: str) -> None:
    """At 40 degrees C; without the load, and with the torques for 20 degrees C, it does not."""
    models = loaded(name, 40.0), loaded(name, 40.0, **NO_LOAD), loaded(name, 20.0)
    paths = [flexgen.solve(model, verify=False, progress=False).trajectory for model in models]
    known, unknown, cold = (error_in_mujoco(name, path, 40.0) for path in paths)
    assert known < KNOWN < 1e-4 < unknown
    assert KNOWN < 1e-5 < cold < unknown


@pytest.mark.slow
def test_a_robot_without_load_does_not_follow_the_torques_for_one() -> None:
    """The referee tells the two robots apart: it is planted the wrong robot."""
    path = flexgen.solve(loaded("elbow"), verify=False, progress=False).trajectory
    assert error_in_mujoco("elbow", path, **NO_LOAD) > 1e-4


@pytest.mark.slow
def test_hysteresis_of_the_gears_is_in_the_load() -> None:
    """1 arcmin of lost motion in robot and inverse; the planted robot has the load of the springs
    alone.
    """
    path = flexgen.solve(loaded("elbow", 40.0, ARCMIN), verify=False, progress=False).trajectory
    assert error_in_mujoco("elbow", path, 40.0, ARCMIN) < 2e-8
    simulated = flexgen.simulate(loaded("elbow", 40.0, ARCMIN), path, feedback="ppi")
    assert simulated.tool_error_max_m < 1e-9
