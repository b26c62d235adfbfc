"""Start values of poses that are not known, in closed form: the robot as a rigid one, a pose after
the other.

The rotation and shift that bring points ``a`` to points ``b`` best, ``min sum |b - t - R a|^2``,
follow from a singular value decomposition of ``sum (a - mean a)(b - mean b)'``; a tracker's
position on its body is linear. Repeated in turn for the frame of the measurement, each element
without a known place, and the trackers, the error falls each time.

Source: K. S. Arun, T. S. Huang and S. D. Blostein, Least-squares fitting of two 3-D point sets,
IEEE PAMI 9 (1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexgen.identification.poses.statics import Numbers, Rest, Statics, frame_rotation
from flexgen.identification.poses.tree import SHIFTS

ROUNDS = 60
CHANGE = 1e-3  # part of the error by which a round has to lower it
# poses at which every tracker is seen: the others do not take part in the search for an attitude
ENOUGH = 60
# of the scatter of the measured points: an error from which on a second frame is tried
WRONG = 0.05
TRIED = 8  # attitudes of the elements without a known place that the search starts from


def best_pose(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and shift (3,) that bring the points ``a`` (N, 3) to ``b`` (N, 3) best."""
    mean_a = a.mean(axis=0)
    mean_b = b.mean(axis=0)
    U, _, Vt = np.linalg.svd((a - mean_a).T @ (b - mean_b))
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    return R, mean_b - R @ mean_a


def angles_of(R: np.ndarray) -> np.ndarray:
    """Angles (3,) [rad] of rotations about x, then the new y, then the new z."""
    sine = float(np.clip(R[0, 2], -1.0, 1.0))
    return np.array(
        [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(sine), np.arctan2(-R[0, 1], R[0, 0])]
    )


def start_frames(statics: Statics, measured: np.ndarray, placed: Sequence[str]) -> Numbers:
    """Numbers with the frame of the measurement, the trackers and the places of the elements
    ``placed`` found.

    ``measured`` (N, k, 3) [m]; entries that are missing are nan. Without elements to place one
    search is enough, or another one from the frame that the trackers of the model file give; with
    them the best of several, from other attitudes of these elements.
    """
    tree = statics.tree
    first = replace(Numbers.of(tree), compliances=np.zeros(len(tree.elastic)))
    if not placed:
        error, numbers = search_start(statics, measured, placed, first)
        valid = np.isfinite(measured).all(axis=2)
        if (
            error
            <= WRONG
            * np.linalg.norm(measured[valid] - measured[valid].mean(axis=0), axis=1).mean()
        ):
            return numbers
        R, t = best_pose(statics.rest(first, rigid=True).points[valid], measured[valid])
        other = search_start(
            statics, measured, placed, replace(first, frame=np.concatenate([t, angles_of(R)]))
        )
        return min((error, numbers), other, key=lambda one: one[0])[1]
    found = []
    random = np.random.default_rng(0)
    rows = np.flatnonzero(np.isfinite(measured).all(axis=(1, 2)))
    rows = rows[:: len(rows) // ENOUGH] if len(rows) >= ENOUGH else np.arange(len(measured))
    part = statics.among(rows)
    for trial in range(TRIED):
        shifts = first.shifts.copy()
        for name in placed if trial else ():
            at = [tree.index[f"{name}.{s}"] for s in SHIFTS[3:]]
            shifts[at] = random.uniform(-np.pi, np.pi, 3)
        found.append(
            search_start(
                part, measured[rows], placed, replace(first, shifts=shifts), rounds=ROUNDS // 6
            )
        )
    best = min(found, key=lambda one: one[0])
    return search_start(statics, measured, placed, best[1])[1]


def rigid_errors(statics: Statics, measured: np.ndarray, numbers: Numbers) -> np.ndarray:
    """Distances (N, k) [m] of the trackers of a rigid robot from where they were measured; nan
    where they were not.
    """
    return np.asarray(
        np.linalg.norm(statics.rest(numbers, rigid=True).measured - measured, axis=2)
    )


def search_start(
    statics: Statics,
    measured: np.ndarray,
    placed: Sequence[str],
    numbers: Numbers,
    rounds: int = ROUNDS,
) -> tuple[float, Numbers]:
    """The rounds of the search from given numbers: mean error [m] and the numbers at its end."""
    valid = np.isfinite(measured).all(axis=2)
    y = np.where(valid[..., None], measured, 0.0)
    last = np.inf
    rest = statics.rest(numbers, rigid=True)
    for _ in range(rounds):
        for name in placed:
            numbers = place_element(statics, rest, numbers, name, y, valid)
        rest = statics.rest(numbers, rigid=True) if placed else rest
        numbers, points = place_trackers(statics, rest, numbers, y, valid)
        R, t = best_pose(points[valid], y[valid])
        numbers = replace(numbers, frame=np.concatenate([t, angles_of(R)]))
        rest = replace(rest, points=points)
        error = float(np.linalg.norm(t + points @ R.T - y, axis=2)[valid].mean())
        if last - error < CHANGE * error:
            break
        last = error
    return error, numbers


def place_element(
    statics: Statics, rest: Rest, numbers: Numbers, name: str, y: np.ndarray, valid: np.ndarray
) -> Numbers:
    """The pose of an element at its parent, from the trackers that it carries."""
    tree = statics.tree
    nodes = np.array([tree.index[f"{name}.{s}"] for s in SHIFTS])
    R_before = rest.posture.frame(nodes[0])[0]
    p_before = rest.posture.axes(nodes[:1])[1][0]
    R_after, p_after = rest.posture.frame(nodes[-1])
    world = (y - numbers.frame[:3]) @ frame_rotation(numbers.frame)
    inner = []
    outer = []
    for k, mount in enumerate(statics.places):
        if not tree.carries[nodes[0], mount.node]:
            continue
        rows = valid[:, k]
        inner.append(_in_frame(R_after, p_after, rest.points[:, k])[rows])
        outer.append(_in_frame(R_before, p_before, world[:, k])[rows])
    if not inner:
        return numbers
    a = np.concatenate(inner)
    b = np.concatenate(outer)
    R, t = best_pose(a, b)
    shifts = numbers.shifts.copy()
    shifts[nodes] = np.concatenate([t, angles_of(R)])
    return replace(numbers, shifts=shifts)


def place_trackers(
    statics: Statics, rest: Rest, numbers: Numbers, y: np.ndarray, valid: np.ndarray
) -> tuple[Numbers, np.ndarray]:
    """The position of each tracker on its body: the mean of what is seen; and the points (N, k, 3)
    in the world.
    """
    world = (y - numbers.frame[:3]) @ frame_rotation(numbers.frame)
    found = numbers.trackers.copy()
    points = rest.points.copy()
    for k, mount in enumerate(statics.places):
        if not valid[:, k].any():
            continue  # a level, or touches alone
        R = rest.posture.frame(mount.node)[0] @ mount.rotation
        origin = statics.tree.point(rest.posture, mount, np.zeros(3))
        found[k] = _in_frame(R, origin, world[:, k])[valid[:, k]].mean(axis=0)
        points[:, k] = origin + R @ found[k]
    return replace(numbers, trackers=found), points


def _in_frame(R: np.ndarray, p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3) of the world in frames (N)."""
    return np.einsum("nji,nj->ni", R, points - p)
