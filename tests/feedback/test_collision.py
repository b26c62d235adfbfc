"""Laws, referees and refused input of `flexgen.feedback.observers.collision`."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError


def test_momenta_and_driving_torques_of_a_record() -> None:
    """Of a motion with speeds by differences: their balance without contact is that of the
    equations of motion.
    """
    model = flexgen.read("elbow")
    detector = flexgen.CollisionDetector(model, sample_s=1e-3)
    solution = flexgen.solve("elbow", progress=False)
    t = np.arange(0.0, 1.0, 1e-3)
    found = solution.trajectory.at(t)
    p, driven = detector._terms(found["q_m"], found["tau_m"])
    assert p.shape == driven.shape == (1000, 2)
    rate = np.gradient(p, 1e-3, axis=0)
    size = np.abs(driven).max(axis=0)
    assert (np.abs(rate - driven)[20:-20].mean(axis=0) < 0.05 * size).all() and np.abs(p).max() > 0
    for q, tau in (
        (found["q_m"][:2], found["tau_m"][:2]),
        (found["q_m"], found["tau_m"][:5]),
        (t, t),
    ):
        with pytest.raises(
            ArgumentError, match=r"^record: given shapes .*, expected \(n, 2\) twice$"
        ):
            detector._terms(q, tau)
    free = detector.calibrate([(found["q_m"], found["tau_m"])], margin=2.0)
    again = detector.detect(found["q_m"], found["tau_m"])
    assert again.sample is None
    assert_allclose(free, 2.0 * np.abs(again.residual).max(axis=0))
    pushed = detector.detect(found["q_m"], found["tau_m"] + 50.0 * free * (t > 0.5)[:, None])
    assert pushed.sample is not None and 500 <= pushed.sample < 560
    with pytest.raises(
        ArgumentError, match=r"^records: given none with motion, expected runs without contact$"
    ):
        detector.calibrate([])
    with pytest.raises(
        ArgumentError, match=r"^bandwidth_hz: given 100\.0, expected more than 0, below 100$"
    ):
        flexgen.CollisionDetector(model, sample_s=1e-3, bandwidth_hz=100.0)
    assert "samples of 1 ms, bandwidth " in repr(detector)
