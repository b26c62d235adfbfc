"""Collision detection: the residual sample by sample from its definition, thresholds, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError

H = 1e-3
ELBOW = flexgen.read("elbow@rigid")


def moved(model: Any, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    t = H * np.arange(count)[:, None]
    q = np.array([0.3, -0.2]) + 0.2 * np.sin(np.array([21.0, 33.0]) * t) * np.array([1.0, 0.7])
    return q @ model.eta.T, 40.0 * np.cos(np.array([17.0, 11.0]) * t)


def residual_of(model: Any, q_m: np.ndarray, tau: np.ndarray, bandwidth: float) -> np.ndarray:
    """The residual sample by sample from the definition of the equations."""
    e = flexgen.derive(model)
    inverse = np.linalg.inv(model.eta)
    inertia = np.diag([m.inertia for m in model.motors])
    friction = e.function("motor_friction")
    r = []
    first = None
    total = np.zeros(2)
    before = None
    for k in range(len(q_m)):
        v_m = (q_m[k] - q_m[max(k - 1, 0)]) / H
        q = inverse @ q_m[k]
        v = inverse @ v_m
        M = np.array(e.function("mass_matrix")(q))
        bias = np.array(e.function("inverse_dynamics")(q, v, np.zeros(2))).ravel()
        p = inverse.T @ M @ v + inertia @ v_m
        first = p if first is None else first
        r.append(2 * np.pi * bandwidth * (p - first - total))
        change = (M - (M if before is None else before)) / H
        force = tau[k] - np.array(friction(v_m)).ravel() + inverse.T @ (change @ v - bias)
        total = total + H * (force + r[-1])
        before = M
    return np.array(r)


def test_a_detector_integrates_the_momentum_of_the_definition() -> None:
    """Each sign, the first difference, the motor side, the bandwidth and the margin; the first
    sample above a threshold is the hit.
    """
    detector = flexgen.CollisionDetector(ELBOW, H, 20.0)
    assert repr(detector) == f"<CollisionDetector {ELBOW.title}: samples of 1 ms, bandwidth 20 Hz>"
    q_m, tau = moved(ELBOW)
    expected = residual_of(ELBOW, q_m, tau, 20.0)
    free = detector.detect(q_m, tau)
    assert free.sample is None
    assert_allclose(free.residual, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    largest = np.abs(expected).max(axis=0)
    found = detector.calibrate([(q_m[:20], tau[:20]), (q_m, tau)], 0.9)
    assert_allclose(found, 0.9 * largest, rtol=1e-6)
    hit = np.flatnonzero((np.abs(expected) > 0.9 * largest).any(axis=1))[0]
    assert detector.detect(q_m, tau).sample == hit
    detector.calibrate([(q_m, tau)])
    assert_allclose(detector.thresholds, 1.2 * largest, rtol=1e-6)
    assert detector.detect(q_m, tau).sample is None


def test_false_alarms_are_as_rare_as_the_number_of_runs_states() -> None:
    """The largest of k + 1 runs that can be exchanged is the last one once in k + 1 times, for
    each motor; a margin below one states nothing.
    """
    detector = flexgen.CollisionDetector(ELBOW, H)
    assert detector.false_alarms == 1.0
    record = moved(ELBOW)
    for count, margin, expected in ((1, 1.0, 1.0), (9, 1.0, 0.2), (99, 1.2, 0.02), (99, 0.9, 1.0)):
        detector.calibrate([record] * count, margin)
        found = detector.detect(*record).false_alarms
        assert found == detector.false_alarms == pytest.approx(expected)


def detect(q_m: np.ndarray, tau_m: np.ndarray) -> Any:
    return flexgen.CollisionDetector(ELBOW, H).detect(q_m, tau_m)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        *(
            (lambda q=q, tau=tau: detect(q, tau), r"record: given shapes .*, expected \(n, 2\) tw")
            for q, tau in (
                (np.zeros((2, 2)), np.zeros((2, 2))),
                (np.zeros((3, 2)), np.zeros((3, 1))),
                (np.zeros(3), np.zeros(3)),
                (np.zeros((3, 1)), np.zeros((3, 1))),
            )
        ),
        *(
            (
                lambda hz=hz: flexgen.CollisionDetector(ELBOW, H, hz),
                "bandwidth_hz: given .*, expected more than 0, below 100",
            )
            for hz in (0.0, 100.0, float("nan"))
        ),
        (lambda: flexgen.CollisionDetector(ELBOW, 0.0), "sample_s: given 0.0, expected a time"),
        (
            lambda: flexgen.CollisionDetector(ELBOW, H).calibrate([]),
            "records: given none with motion, expected runs without contact",
        ),
    ],
)
def test_what_does_not_fit_is_refused(call: Any, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        call()


def test_a_contact_is_found_soon_after_it_begins() -> None:
    model = flexgen.read("elbow")
    detector = flexgen.CollisionDetector(model, H)
    t = np.arange(0.0, 1.0, H)
    found = flexgen.solve("elbow", progress=False).trajectory.at(t)
    free = detector.calibrate([(found["q_m"], found["tau_m"])], margin=2.0)
    push = 50.0 * free * (t > 0.5)[:, None]
    pushed = detector.detect(found["q_m"], found["tau_m"] + push)
    assert pushed.sample is not None and 500 <= pushed.sample < 560
