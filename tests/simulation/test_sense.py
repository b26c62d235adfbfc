"""Sensors at rest: torques of joints carry gravity, encoders show their error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port

TORQUES = [
    {"name": f"torque{k}", "type": "joint_torque", "coordinate": f"q{k}", "unit": "N m"}
    for k in (1, 2)
]
ERROR = {"harmonics": [1, 3], "cos": [1e-3, 0.0], "sin": [0.0, 2e-3]}


def motion(q: np.ndarray, q_m: np.ndarray) -> Trajectory:
    zero = 0.0 * q
    data = {"q_a": q, "v_a": zero, "a_a": zero, "q_m": q_m}
    units = {"q_a": "rad", "v_a": "rad/s", "a_a": "rad/s^2", "q_m": "rad"}
    ports = {name: Port(name, (2,), unit, "of the arm") for name, unit in units.items()}
    labels = {name: ("m1", "m2") if name == "q_m" else ("q1", "q2") for name in data}
    return Trajectory(np.arange(float(len(q))), data, ports, labels)


def test_joint_torques_carry_gravity_and_encoders_show_their_error() -> None:
    """``q_m + sum_k c_k cos(k q_m) + s_k sin(k q_m)`` of the motor that has an error."""
    changes: dict[str, Any] = {"sensor": TORQUES, "motor.m2.encoder_error": ERROR}
    model = flexgen.read("elbow", overrides=changes)
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (5, 2))
    q_m = rng.uniform(-9, 9, (5, 2))
    seen = flexgen.sense(model, motion(q, q_m))
    equations = flexgen.derive(model)
    gravity = [np.array(equations.function("gravity")(x)).ravel() for x in q]
    assert_allclose(seen["y_s"], gravity, rtol=1e-12)
    assert seen.labels["y_s"] == ("torque1", "torque2") and seen.units["y_s"] == ("N m", "N m")
    error = 1e-3 * np.cos(q_m[:, 1]) + 2e-3 * np.sin(3 * q_m[:, 1])
    assert_allclose(seen["q_m"], q_m + np.stack([0 * error, error], axis=1), rtol=1e-13)
    assert seen.labels["q_m"] == ("m1", "m2")


def test_a_model_without_sensors_is_refused() -> None:
    none = np.zeros((2, 2))
    with pytest.raises(ArgumentError, match=r"model: given elbow without a \[\[sensor\]\], expec"):
        flexgen.sense("elbow", motion(none, none))
