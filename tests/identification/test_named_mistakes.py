"""Mistakes in records that are undone one by one: channels of a motion, stuck joints, a tracker
that moved, a clock.

Motions come from the inverse dynamics of elastic joints, poses from their statics.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses.frame_changes import find_frame_change
from flexgen.identification.rigid.channel_mistakes import find_channel_mistake, find_longest_run
from flexgen.identification.rigid.feasible_bodies import scales
from flexgen.identification.rigid.rigid_body import identify_rigid
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor

pytestmark = needs_compiler

HAND = {"name": "hand", "type": "tracker", "unit": "m", "position": [0.0, 0.0, 0.1]}
STOPS = ((0.9, -0.6), (-0.4, 0.8), (0.5, -0.9), (-0.8, 0.2), (0.3, 1.0))  # rad


@cache
def moves() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (n,), joints (n, 2) behind the motors and motor torques (n, 2) of an elbow."""
    steps = tuple(flexgen.MoveJ(stop, pause=0.1) for stop in STOPS)
    program = flexgen.Program(
        "moves",
        start=(0.0, 0.0),
        smoothness=5,
        steps=steps,
        joint_profile=(1.5, 6.0, 80.0, 1500.0),
    )
    robot = flexgen.read("elbow")
    motion = flexgen.solve(robot, program, verify=False).trajectory
    time = np.arange(0.0, motion.time[-1], 2e-3)
    at = motion.at(time)
    return time, at["q_m"] @ np.linalg.inv(robot.eta).T, at["tau_m"]


def exchanged(x: np.ndarray) -> np.ndarray:
    return x[:, ::-1]


def stuck(q: np.ndarray) -> np.ndarray:
    out = q.copy()
    out[len(q) // 2 :, 1] = q[len(q) // 2, 1]
    return out


Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
RATIO = np.abs(flexgen.read("elbow").eta).max(axis=1)
CHANGES: dict[str, Change] = {
    "the torques of m1 and m2 are exchanged": lambda q, tau: (q, exchanged(tau)),
    "the sign of the torques of m2 is wrong": lambda q, tau: (q, tau * [1.0, -1.0]),
    "the torques of m2 are on the arm side": lambda q, tau: (q, tau * [1.0, RATIO[1]]),
    "the angles are in degrees, read as radians": lambda q, tau: (np.degrees(q), tau),
    "the angles of m2 are stuck from t = ": lambda q, tau: (stuck(q), tau),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_mistake_of_a_channel_is_named(what: str) -> None:
    """Each one of the list; none in the record as it is."""
    time, q, tau = moves()
    regressor = Regressor(flexgen.read("elbow"))
    file = regressor.of_model()
    wrong = Motion(time, *CHANGES[what](q, tau))
    found = find_channel_mistake(regressor, [wrong], file, 0.3 * scales(file))
    assert found is not None and found.what.startswith(what)
    right = find_channel_mistake(regressor, [Motion(time, q, tau)], file, 0.3 * scales(file))
    assert right is None


@pytest.mark.slow
def test_rigid_fits_name_channels_and_clocks() -> None:
    """In the result of a fit; a clock 5 % slow is not called a wrong gravity."""
    time, q, tau = moves()
    found = identify_rigid("elbow", [Motion(time, q, exchanged(tau))])
    assert found.mistake is not None and "exchanged" in found.mistake.sentence
    slow = identify_rigid("elbow", [Motion(1.05 * time, q, tau)])
    assert slow.mistake is not None and slow.mistake.what.startswith("a clock")
    assert 3.0 < slow.mistake.value < 7.0
    assert identify_rigid("elbow", [Motion(time, q, tau)]).mistake is None


def poses() -> tuple[np.ndarray, np.ndarray]:
    """Commands (60, 2) and positions of a tracker with noise (60, 1, 3)."""
    robot = flexgen.read("elbow", overrides={"sensor": [HAND]})
    random = np.random.default_rng(1)
    q = random.uniform(-1.2, 1.2, (60, 2))
    return q, flexgen.tracker_positions(robot, q) + 2e-5 * random.normal(size=(60, 1, 3))


@pytest.mark.slow
def test_stuck_joints_and_moved_trackers_are_named() -> None:
    """Of static poses, where all else is right."""
    robot = flexgen.read("elbow", overrides={"sensor": [HAND]})
    q, seen = poses()
    held = q.copy()
    held[35:, 1] = q[35, 1]
    with pytest.raises(ArgumentError, match=r"probably q2 stuck at .* in 25 poses from row 36"):
        flexgen.calibrate(robot, flexgen.StaticPoses(held, seen), folds=0)
    moved = seen.copy()
    moved[20:] += [0.002, 0.0, -0.001]
    found = flexgen.calibrate(robot, flexgen.StaticPoses(q, moved), folds=0)
    assert "frame of the measurement that moved" in str(found.causes[0])
    assert found.causes[0].name.endswith("from row 21 of the poses")
    assert np.allclose(found.causes[0].value, [0.002, 0.0, -0.001], atol=5e-4)
    assert not flexgen.calibrate(robot, flexgen.StaticPoses(q, seen), folds=0).causes


def test_frame_changes_against_a_search_by_hand() -> None:
    """Row and shift by least squares on columns, for each row; noise has no step."""
    random = np.random.default_rng(3)
    for _ in range(20):
        assert find_frame_change(random.normal(size=(50, 1, 3)), 0.01) is None
    r = random.normal(size=(50, 2, 3))
    r[17:] += [6.0, -4.0, 2.0]
    r[4, 1] = np.nan
    found = find_frame_change(r, 0.01)
    assert found is not None
    left = {}
    for k in range(5, 46):
        step = np.broadcast_to((np.arange(50) >= k)[:, None], (50, 2))[:, :, None] * np.eye(3)[0]
        told = np.isfinite(r[:, :, 0])
        X = np.column_stack([np.ones(told.sum()), step[:, :, 0][told]])
        fits = [np.linalg.lstsq(X, r[:, :, c][told], rcond=None) for c in range(3)]
        left[k] = sum(float(fit[1][0]) for fit in fits), [float(fit[0][1]) for fit in fits]
    best = min(left, key=lambda k: left[k][0])
    assert found.row == best + 1
    assert np.allclose(found.shift, left[best][1])


@pytest.mark.parametrize("seed", range(5))
def test_longest_runs(seed: int) -> None:
    """Against a loop."""
    given = np.random.default_rng(seed).random(30) < 0.6
    first, last = find_longest_run(given)
    assert given[first:last].all()
    lengths = [len(part) for part in "".join("x" if g else " " for g in given).split()]
    assert last - first == max(lengths, default=0)
