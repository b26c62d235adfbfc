"""Faults that the bodies of a rigid fit hide: the payload, a common scale of all torques; lags and
axes with both signs wrong.

The motions are those of a two-link arm in closed form, by sums over its points; nothing of it is
flexgen's.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.identification.rigid.channel_mistakes import find_channel_mistake
from flexgen.identification.rigid.feasible_bodies import scales
from flexgen.identification.rigid.rigid_body import RigidFit, identify_rigid
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor
from flexgen.model.elements import RobotModel

pytestmark = needs_compiler

GRAVITY = 9.81
STEP = 2e-3  # s
NOISE = 1e-3  # of the torque of a motor
RATIO = np.array([1872 / 7, 757 / 3])
ROTOR = 0.0118 * RATIO  # kg m^2: on the motor side times the ratio
PAYLOAD = (120.0, (1.1, 0.1))  # kg, m: along the forearm and across it


def robot(mass: float, center: tuple[float, float]) -> RobotModel:
    """Elbow with this payload in the file, and stiff gears."""
    x, z = center
    payload = {"mass": mass, "com": [x, 0.0, z], "inertia": [2.0, 3.0, 3.0]}
    stiff = {f"element.{e}.dof.{q}.gear.spring.stiffness": 1e11 for e, q in LINKS}
    return flexgen.read("elbow", overrides={"payload": payload} | stiff)


LINKS = (("upper", "q1"), ("fore", "q2"))


@cache
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (n,), joints (n, 2) and motor torques (n, 2) with the payload `PAYLOAD`."""
    t = np.arange(0.0, 20.0, STEP)
    w = 2 * np.pi * np.array([[0.1, 0.25, 0.4], [0.15, 0.2, 0.45]])
    size = np.array([[0.5, 0.2, 0.1], [0.6, 0.25, 0.12]])
    phase = np.outer(t, np.ones(6)).reshape(-1, 2, 3) * w + np.arange(6).reshape(2, 3)
    q = (size * np.sin(phase)).sum(axis=2)
    v = (size * w * np.cos(phase)).sum(axis=2)
    a = (-size * w**2 * np.sin(phase)).sum(axis=2)
    torque = np.zeros((len(t), 2))
    mass, (along, across) = PAYLOAD
    # points: mass, place on the upper arm, along and across the forearm
    points = ((339.12 * 0.97, 0.441, 0.0, 0.0), (190.25 * 1.02, 1.15, 0.465, 0.0))
    for m, upper, x, z in (*points, (mass, 1.15, along, across)):
        torque += _of_point(m, upper, x, z, q, v, a)
    torque[:, 0] += (88.67 + 48.64 + 3.0) * a[:, 0] + (48.64 + 3.0) * a[:, 1]
    torque[:, 1] += (48.64 + 3.0) * (a[:, 0] + a[:, 1])
    motor = torque / RATIO + ROTOR * a + 0.4 * np.tanh(v / 1e-3) + 0.3 * v
    noise = np.random.default_rng(2).normal(size=motor.shape)
    return t, q, motor + NOISE * motor.std(axis=0) * noise


def _of_point(
    m: float, upper: float, x: float, z: float, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """Torques (n, 2) of a mass at a place of the arm, by the accelerations in the plane."""
    first = q[:, 0]
    second = q.sum(axis=1)
    # derivatives of the place (x, z) in both angles, and in the angles twice
    of_upper = upper * np.array([np.cos(first), -np.sin(first)])
    twice_upper = upper * np.array([-np.sin(first), -np.cos(first)])
    c = np.cos(second)
    s = np.sin(second)
    of_fore = np.array([-x * s + z * c, -x * c - z * s])
    twice_fore = np.array([-x * c - z * s, x * s - z * c])
    has_fore = bool(x or z)
    both = v.sum(axis=1)
    acceleration = of_upper * a[:, 0] + twice_upper * v[:, 0] ** 2
    if has_fore:
        acceleration = acceleration + of_fore * a.sum(axis=1) + twice_fore * both**2
    force = m * (acceleration + np.array([[0.0], [GRAVITY]]))
    one = of_upper + of_fore * has_fore
    return np.stack([(one * force).sum(axis=0), (of_fore * force).sum(axis=0) * has_fore], axis=1)


def fitted(model: RobotModel, factor: float = 1.0) -> RigidFit:
    """Fit of the motion, whose torques are too large by a factor."""
    t, q, torque = motion()
    return identify_rigid(model, [Motion(t, q, factor * torque)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "factor", "name", "value", "within"),
    [
        (robot(60.0, PAYLOAD[1]), 1.0, "payload.mass", (120.0,), 5.0),
        (robot(120.0, (0.1, 1.1)), 1.0, "payload.com", (1.1, 0.0, 0.1), 0.02),
        (robot(*PAYLOAD), 1.2, "the scale of all torques", (1.2,), 0.02),
    ],
)
def test_faults_that_bodies_hide_are_named(
    model: RobotModel, factor: float, name: str, value: tuple[float, ...], within: float
) -> None:
    """With the true value; the fit explains the torques with other bodies."""
    found = fitted(model, factor)
    t, q, torque = motion()
    assert found.relative_errors(Motion(t, q, factor * torque)).max() < 1e-3
    best = found.payload.faults[0]
    assert best.name == name and best.share > 0.9
    assert np.allclose(best.value, value, rtol=0.0, atol=within)


@pytest.mark.slow
def test_a_right_payload_is_not_named() -> None:
    """Nor is the scale of torques; the direction that no motion shows is stated."""
    found = fitted(robot(*PAYLOAD))
    assert found.mistake is None and found.payload.faults == ()
    assert [limit.name for limit in found.payload.limits] == ["payload.com"]


Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
TURN = np.array([1.0, -1.0])
CHANGES: dict[str, Change] = {
    "all torques are 0.2 s late": lambda q, tau: (q[100:], tau[:-100]),
    "all torques are 0.05 s early": lambda q, tau: (q[:-25], tau[25:]),
    "both signs of m2, of angles and torques, are wrong": lambda q, tau: (q * TURN, tau * TURN),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", CHANGES)
def test_lags_and_both_signs_are_named(what: str) -> None:
    """None in the record as it is, see `test_named_mistakes`."""
    t, q, torque = motion()
    regressor = Regressor(robot(*PAYLOAD))
    file = regressor.of_model()
    q, torque = CHANGES[what](q, torque)
    wrong = Motion(t[: len(q)], q, torque)
    found = find_channel_mistake(regressor, [wrong], file, 0.3 * scales(file))
    assert found is not None and found.what == what
