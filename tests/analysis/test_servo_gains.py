"""Gains of a servo by frequencies: against the mass matrix, and in the C library against the same
gains in the file.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

import flexgen
from flexgen.analysis.servo_gains import servo_with_gains
from flexgen.model.position_servo.filters import Notch
from flexgen.model.position_servo.keys import ServoTable


def test_gains_of_a_stiff_arm_are_those_of_its_mass_matrix() -> None:
    """J = J_m + M_jj / eta^2 at home; the speed gain of a late servo is smaller."""
    model = flexgen.read("elbow@rigid")
    given = ServoTable("ppi", 4.0, 30.0, 0.5, notch=(Notch(60.0),), sample_time=1e-3, delay=2e-3)
    made = servo_with_gains(replace(model, servo=given))
    M = np.array(flexgen.derive(model).function("mass_matrix")(np.array(model.home)))
    ratio = np.diag(model.eta)
    J = np.array([m.inertia for m in model.motors]) + np.diag(M) / ratio**2
    assert made is not None and made.type == "cascade" and made.position_hz is None
    assert (made.notch, made.sample_time, made.delay) == (given.notch, 1e-3, 2e-3)
    assert_allclose(made.position_gain, 8 * np.pi)
    assert_allclose(made.integral_gain, np.pi)
    soft = 1 / (
        ratio**2
        * np.diag(np.linalg.inv(M + np.diag(ratio**2 * [m.inertia for m in model.motors])))
    )
    assert_allclose(made.speed_gain, np.minimum(60 * np.pi * J, 0.3 * soft / 3e-3), rtol=1e-9)
    fast = servo_with_gains(replace(model, servo=replace(given, speed_hz=1.0)))
    assert fast is not None
    assert_allclose(fast.speed_gain, 2 * np.pi * J, rtol=1e-9)
    assert servo_with_gains(model) is None and servo_with_gains(replace(model, servo=made)) is made


def test_frequencies_that_are_not_given_are_parts_of_the_lowest_one() -> None:
    """With locked motors; 10 Hz where nothing is elastic."""
    made = servo_with_gains(replace(flexgen.read("elbow@rigid"), servo=ServoTable("ppi")))
    assert made is not None
    assert_allclose(
        [made.position_gain[0], made.integral_gain[0]], 2 * np.pi * np.array([5.0, 1.0])
    )
    model = replace(
        flexgen.read("elbow"), gravity=(0.0, 0.0, 0.0), servo=ServoTable("ppi", integral_hz=0.0)
    )
    soft = servo_with_gains(model)
    equations = flexgen.derive(model)
    home = np.array(model.home)
    torque = equations.function("gear_torque")
    still = np.zeros(2)
    K = np.array(
        [
            np.array(torque(home + each, still, model.eta @ home, still)).ravel()
            for each in 1e-6 * np.eye(2)
        ]
    )
    K = -K.T / 1e-6
    lowest = np.sqrt(
        np.linalg.eigvals(
            np.linalg.solve(np.array(equations.function("mass_matrix")(home)), K)
        ).min()
    )
    assert soft is not None and soft.integral_gain == (0.0, 0.0)
    assert_allclose(soft.position_gain, 0.5 * lowest, rtol=1e-6)


def test_a_library_has_the_gains_of_frequencies(tmp_path: Path) -> None:
    """A servo given by frequencies yields the C files of one given by their gains, except for
    digests of the model.
    """
    model = replace(
        flexgen.read("elbow"), servo=ServoTable("ppi", speed_hz=20.0, speed_feedforward=0.7)
    )
    written = []
    for k, servo in enumerate((model.servo, servo_with_gains(model))):
        made = flexgen.generate(
            replace(model, servo=servo), tmp_path / str(k), parts=["position"], build=False
        )
        text = {file.name: file.read_text() for file in made.files if file.suffix in (".c", ".h")}
        written.append(
            {
                name: re.sub(r"[0-9a-f]{64}|STREAM_KEY = \d+", "digest", each)
                for name, each in text.items()
            }
        )
    assert written[0] == written[1] and "elbow_servo_defaults" in "".join(written[0].values())
