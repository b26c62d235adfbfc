"""Start values of a calibration: elements and trackers of a made-up robot are found where they
were placed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.identification.poses import frames
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import SHIFTS, Tree

TURNED = [0.3, -0.2, 0.1, 2.0, 0.8, -1.0]  # of an element: m, rad
FRAME = np.array([1.0, 2.0, -0.5, 0.4, -0.6, 2.0])


def case(
    poses: int, *, element: str = "body2", shift: list[float] = TURNED
) -> tuple[Statics, Numbers, list[int]]:
    """A rigid robot with an element and trackers at other places, seen from another frame."""
    trackers = [
        {"name": "t", "type": "tracker", "unit": "m", "position": [0.05, 0.02, 0.1]},
        {
            "name": "u",
            "type": "tracker",
            "unit": "m",
            "element": "body1",
            "position": [0.1, 0.0, 0.05],
        },
    ]
    tree = Tree(flexgen.read("manutec_r3", overrides={"sensor": trackers}))
    at = [tree.index[f"{element}.{name}"] for name in SHIFTS]
    statics = Statics(tree, np.random.default_rng(3).uniform(-1.0, 1.0, (poses, 6)))
    true = Numbers.of(tree)
    shifts = true.shifts.copy()
    shifts[at] = shift
    none = np.zeros(len(tree.elastic))
    return (
        statics,
        replace(true, shifts=shifts, frame=FRAME, trackers=true.trackers + 0.1, compliances=none),
        at,
    )


def test_a_turned_element_is_found_with_the_trackers_and_the_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In 60 rounds; without the element the search ends in the round that lowers the error by less
    than a part of it.

    Positions do not tell a shift along the axis before the element from one of the frame: they are
    what is equal.
    """
    statics, true, _ = case(8)
    measured = statics.rest(true, rigid=True).measured.copy()
    measured[3, 0] = measured[5, 1] = np.nan
    pose = frames.best_pose
    calls = [0]

    def counted(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls[0] += 1
        return pose(a, b)

    monkeypatch.setattr(frames, "best_pose", counted)
    begin = Numbers.of(statics.tree)
    error, found = frames.search_start(
        statics, measured, ("body2",), replace(begin, compliances=true.compliances)
    )
    errors = frames.rigid_errors(statics, measured, found)
    assert np.isnan(errors[[3, 5], [0, 1]]).all() and np.isnan(errors).sum() == 2
    assert error == pytest.approx(np.nanmean(errors), rel=1e-9) and error < 1e-4
    assert calls == [120]  # of the element and of the frame, in each round
    soft = replace(found, compliances=np.full(len(found.compliances), 1e-4))
    assert_allclose(frames.rigid_errors(statics, measured, soft), errors, atol=1e-12)
    past: list[float] = []

    def noted(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R, t = pose(a, b)
        past.append(float(np.linalg.norm(t + a @ R.T - b, axis=1).mean()))
        return R, t

    monkeypatch.setattr(frames, "best_pose", noted)
    error, _ = frames.search_start(statics, measured, (), begin)
    part = -np.diff(past) / past[1:]
    assert error == pytest.approx(past[-1]) and (part[:-1] >= 1e-3).all() and part[-1] < 1e-3
    assert 10 < len(past) < 60 and error > 0.5


def test_one_step_places_an_element_and_the_trackers_where_they_are() -> None:
    """All else known; a tracker in front of the element, and positions that were not seen, tell
    nothing of it.
    """
    statics, true, at = case(6)
    shown = statics.rest(true, rigid=True).measured
    valid = np.ones(shown.shape[:2], bool)
    valid[2, 0] = False
    y = np.where(valid[..., None], shown, 1e3)
    wrong = replace(true, shifts=0.6 * true.shifts)
    rest = statics.rest(wrong, rigid=True)
    found = frames.place_element(statics, rest, wrong, "body2", y, valid)
    expected = Rotation.from_euler("XYZ", TURNED[3:]).as_matrix()
    assert_allclose(
        Rotation.from_euler("XYZ", found.shifts[at[3:]]).as_matrix(), expected, atol=1e-12
    )
    assert_allclose(found.shifts[at[:3]], TURNED[:3], atol=1e-12)
    # none on the element
    with_nothing = replace(statics.tree.model, sensors=statics.tree.model.sensors[1:])
    alone = Statics(Tree(with_nothing), statics.commands)
    one = replace(wrong, trackers=wrong.trackers[1:])
    rest_alone = alone.rest(one, rigid=True)
    assert frames.place_element(alone, rest_alone, one, "body2", y[:, 1:], valid[:, 1:]) is one

    lost = replace(true, trackers=np.zeros((2, 3)))
    moved, points = frames.place_trackers(statics, statics.rest(lost, rigid=True), lost, y, valid)
    assert_allclose(moved.trackers, true.trackers, atol=1e-12)
    assert_allclose(
        FRAME[:3] + points @ Rotation.from_euler("XYZ", FRAME[3:]).as_matrix().T, shown, atol=1e-12
    )


@pytest.mark.parametrize(("lost", "taken"), [(5, 63), (70, 60), (71, 130)])
def test_the_search_begins_from_eight_attitudes_on_some_of_the_poses(
    lost: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second one of 125 with all trackers; all where fewer than 60 were; then the best one
    with all poses.
    """
    statics, true, at = case(130)
    measured = statics.rest(true, rigid=True).measured.copy()
    measured[:lost, 1, 2] = np.nan
    calls: list[Any] = []

    def search(
        part: Statics, y: np.ndarray, placed: Any, numbers: Numbers, rounds: int = 60
    ) -> tuple[float, Numbers]:
        calls.append((len(part.commands), len(y), numbers.shifts[at], rounds))
        return abs(len(calls) - 6.0), replace(numbers, frame=np.full(6, float(len(calls))))

    monkeypatch.setattr(frames, "search_start", search)
    found = frames.start_frames(statics, measured, ("body2",))
    assert [call[:2] for call in calls] == [(taken, taken)] * 8 + [(130, 130)]
    assert [call[3] for call in calls] == [10] * 8 + [60] and found.frame[0] == 9.0
    turns = np.array([call[2] for call in calls])
    assert (
        not turns[0].any()
        and not turns[:, :3].any()
        and turns[1:8, 3:].all()
        and 2 < np.abs(turns).max() < np.pi
    )
    assert_allclose(turns[8], turns[5])  # of the smallest error


def test_a_search_from_the_frame_of_the_file_follows_where_the_first_error_is_large(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Larger than a twentieth of the mean distance of the points from their mean, which is 2
    here.
    """
    statics, _, _ = case(6)
    measured = np.tile([[[3.0, 5.0, 0.0], [-1.0, 5.0, 0.0]]], (6, 1, 1))
    begun: list[np.ndarray] = []
    answers = {"errors": [0.0999, 0.0]}

    def search(
        part: Statics, y: np.ndarray, placed: Any, numbers: Numbers
    ) -> tuple[float, Numbers]:
        begun.append(numbers.frame)
        return answers["errors"][len(begun) - 1], replace(
            numbers, frame=np.full(6, float(len(begun)))
        )

    monkeypatch.setattr(frames, "search_start", search)
    assert frames.start_frames(statics, measured, ()).frame[0] == 1.0 and len(begun) == 1
    for errors, best in (([0.1001, 0.11], 1.0), ([0.1001, 0.01], 2.0)):
        begun.clear()
        answers["errors"] = errors
        assert frames.start_frames(statics, measured, ()).frame[0] == best and len(begun) == 2
    shown = statics.rest(replace(Numbers.of(statics.tree), frame=FRAME), rigid=True).measured
    begun.clear()
    answers["errors"] = [1.0, 0.0]
    frames.start_frames(statics, shown, ())
    assert_allclose(begun[1], FRAME, atol=1e-9)  # of the trackers as the file has them


def test_angles_of_a_quarter_turn_do_not_suffer_from_rounding() -> None:
    for sign in (1.0, -1.0):
        R = Rotation.from_euler("y", sign * np.pi / 2).as_matrix()
        R[0, 2] *= 1 + 1e-12
        assert frames.angles_of(R)[1] == sign * np.pi / 2
