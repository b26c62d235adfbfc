"""A load says of which payload it is the difference, and with which inertia."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.identification.load.payload import Load

TENSOR = ((0.3, 0.02, -0.01), (0.02, 0.4, 0.03), (-0.01, 0.03, 0.5))
SIX = [0.3, 0.4, 0.5, 0.02, 0.03, -0.01]


def found_of(of_file: dict, true: dict) -> Load:
    """The load that the motion of an arm with the payload ``true`` shows."""
    robot = flexgen.read("manutec_r3", overrides={"payload": true})
    record = flexgen.solve(robot, verify=False, progress=False).trajectory
    return flexgen.identify_load(
        flexgen.read("manutec_r3", overrides={"payload": of_file}), record
    )


def test_a_load_is_the_difference_from_the_payload_of_the_file() -> None:
    """The total is a rigid body of both: its inertia by Steiner's rule, and torques that fit
    it.
    """
    file = {"mass": 4.0, "com": [0.05, 0.1, 0.05], "inertia": SIX}
    point = np.array([0.1, -0.05, 0.2])
    total = 4.0 + 6.0
    com = (4.0 * np.array(file["com"]) + 6.0 * point) / total
    inertia = np.array(TENSOR)
    for mass, place in ((4.0, np.array(file["com"])), (6.0, point)):
        arm = place - com
        inertia = inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    six = inertia[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]].tolist()
    load = found_of(file, {"mass": total, "com": com.tolist(), "inertia": six})
    assert abs(load.mass - 6.0) < 0.01 and not load.is_total
    assert load.total_mass == pytest.approx(10.0, abs=0.01)
    assert_allclose(load.total_inertia, inertia, atol=5e-3)
    # the tolerance tells it from the inertia of the file
    assert np.abs(load.total_inertia - TENSOR).max() > 0.1
    assert_allclose(load.file_inertia, TENSOR)
    assert (np.abs(load.total_com - com) < 3 * load.total_com_sd + 1e-4).all()
    text = str(load)
    assert "this is the difference from the payload of the model file, 4.000 kg" in text
    assert f"total at the tool {load.total_mass:.3f} +- {load.mass_sd:.3f} kg" in text
    assert "(0.3, 0.4, 0.5, 0.02, 0.03, -0.01) kg m^2 about its center of mass" in text
    entries = json.loads(json.dumps(load.to_dict()))
    assert entries["mass_and_com_are"] == "difference from the payload of the file"
    assert entries["inertia_is"].startswith("not identified: point mass")
    assert entries["file_mass"] == 4.0 and len(entries["total_inertia"]) == 3


def test_a_load_of_a_file_without_payload_is_the_total() -> None:
    load = found_of({"mass": 0.0, "com": [0.0, 0.0, 0.0]}, {"mass": 6.0, "com": [0.1, -0.05, 0.2]})
    assert load.is_total and load.mass == load.total_mass
    assert "this is the total at the tool" in str(load) and "difference" not in str(load)
    assert load.to_dict()["mass_and_com_are"] == "total at the tool"
