"""Mistakes in a file of poses: units, signs, columns. Such poses are refused, with the mistake
that explains them.

A rigid robot, with the frame and the trackers fitted in closed form, explains most of the motion
of its trackers: the median error of each is a small part of the median distance from its mean.
Where it is not, each single mistake is undone in turn. Poses are refused where this leaves much
less of the error, or most of the motion is not explained.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.identification.poses.frames import ENOUGH, rigid_errors, start_frames
from flexgen.identification.poses.parameters import trackers_of
from flexgen.identification.poses.poses import StaticPoses, surfaces_of
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.touches import Touches
from flexgen.model.elements import RobotModel

# parts of the scatter from which on mistakes are tried, and poses refused
DOUBTFUL = 0.1
UNEXPLAINED = 0.5
SHUFFLES = (
    8  # of the commands, for the scatter of the trackers of poses that have nothing in common
)
STILL = 1e-9  # m: largest motion of a tracker that no joint moves
# most of the error that is left where a mistake is named, which is below `DOUBTFUL`, too
NAMED = 1 / 3
# part of the poses in which a joint has one value, and number of the others, at least, where it is
# stuck
STUCK = 0.1
FEWEST = 8


def find_start(
    statics: Statics,
    data: StaticPoses,
    place: Sequence[str],
    progress: Callable[[str], None] | None = None,
) -> Numbers:
    """The numbers of `start_frames`; poses that a robot with them does not explain are refused.

    Raises
    ------
    ArgumentError
        A single mistake explains the errors, which the text names; or most of the motion is not
        explained.
    """
    if progress is not None:
        progress("frame of the measurement, trackers and unknown places")
    start = start_frames(statics, data.positions, place)
    error, scatter = agreement(statics, data.positions, start)
    # errors of trackers that do not move, such as those of one pose given many times, are rounding
    if error <= max(DOUBTFUL * scatter, STILL):
        return start
    if scatter < STILL:
        raise ArgumentError(
            f"{data.source or 'poses'}: given positions of a tracker that are all equal, expected "
            "those of poses that differ"
        )
    if progress is not None:
        progress(
            f"{100 * error / scatter:.0f} % of the motion is not explained: searching for a "
            "mistake in the poses"
        )
    left = []
    for words, wrong in possible_mistakes(statics.model, data):
        part = statics.with_commands(wrong.commands)
        found = agreement(part, wrong.positions, start_frames(part, wrong.positions, place))
        left.append((found[0] / max(found[1], 1e-300), words))
    least, words = min(left)
    named = least < min(NAMED * error / scatter, DOUBTFUL)
    if not named and error <= UNEXPLAINED * scatter:
        return start
    advice = f"probably {words}" if named else "check units, signs and the order of the columns"
    raise ArgumentError(
        f"{data.source or 'poses'}: given positions that scatter by {scatter:.3g} m, of which "
        f"the model leaves {error:.3g} m unexplained, expected poses of {statics.model.name}: "
        f"{advice}"
    )


def start_at_points(statics: Statics, data: StaticPoses) -> Numbers:
    """The numbers of the model file, for poses without measured positions: there is no frame.

    Raises
    ------
    ArgumentError
        The trackers are not nearer to what they touch than those of shuffled commands; or a
        single mistake explains where they are, which the text names.
    """
    numbers = Numbers.of(statics.tree)
    error = _scatter_at_points(statics, numbers, data)
    expected = scatter_of_shuffled(statics, numbers, data)
    if error <= max(DOUBTFUL * expected, STILL):
        return numbers
    left = []
    for words, wrong in _mistakes_at_points(statics.model, data):
        part = statics.with_commands(wrong.commands)
        found = _scatter_at_points(part, numbers, wrong)
        if found < NAMED * error:
            left.append((found / max(scatter_of_shuffled(part, numbers, wrong), STILL), words))
    least, words = min(left, default=(np.inf, ""))
    named = least < DOUBTFUL
    if not named and error <= UNEXPLAINED * expected:
        return numbers
    advice = f"probably {words}" if named else "check units, signs and the order of the columns"
    raise ArgumentError(
        f"{data.source or 'poses'}: given poses at fixed points or surfaces where the trackers "
        f"of the model scatter by {error:.3g} m, and with shuffled commands by {expected:.3g} m; "
        f"expected poses of {statics.model.name}: {advice}"
    )


def scatter_of_shuffled(statics: Statics, numbers: Numbers, data: StaticPoses) -> float:
    """Median distance [m] of the trackers from what they touch, of commands in any order."""
    rng = np.random.default_rng(0)
    shuffled = [
        _scatter_at_points(
            statics.with_commands(rng.permuted(data.commands, axis=0)), numbers, data
        )
        for _ in range(SHUFFLES)
    ]
    return float(np.median(shuffled))


def place_points(statics: Statics, numbers: Numbers, groups: np.ndarray, count: int) -> np.ndarray:
    """Means (count, 3) [m] of the trackers that touch each fixed point, of a rigid robot."""
    there = statics.rest(numbers, rigid=True).measured
    return np.array([there[groups == k].mean(axis=0) for k in range(count)]).reshape(-1, 3)


def place_surfaces(
    statics: Statics, numbers: Numbers, touches: Touches
) -> tuple[Touches, np.ndarray]:
    """The surfaces where the trackers of a rigid robot touch them, and their numbers (m, 3)."""
    touching = Statics(statics.tree, statics.commands, None, touches)
    there = touching.rest(numbers, rigid=True)
    touches = touching.touches or touches
    return touches.place(there.points, there.tips)


def _scatter_at_points(statics: Statics, numbers: Numbers, data: StaticPoses) -> float:
    """Median distance [m] of the trackers from the mean at their point, or from their surface."""
    groups = data.groups
    touches = surfaces_of(data)
    touching = Statics(statics.tree, statics.commands, None, touches)
    there = touching.rest(numbers, rigid=True)
    away = [
        np.linalg.norm(there.points[groups == k] - there.points[groups == k].mean(axis=0), axis=1)
        for k in range(int(groups.max()) + 1)
    ]
    if touching.touches is not None:
        touches = touching.touches
        placed, surfaces = touches.place(there.points, there.tips)
        away.append(np.abs(placed.residuals(there.points, there.tips, surfaces))[touches.touched])
    return float(np.median(np.concatenate(away)))


def agreement(statics: Statics, measured: np.ndarray, numbers: Numbers) -> tuple[float, float]:
    """Medians [m] of the errors of a rigid robot, and of the distances from their mean, of the
    worst tracker.

    Trackers that only springs move, as on a base, do not count: a rigid robot explains nothing of
    their motion.
    """
    seen = np.isfinite(measured).all(axis=2).any(axis=0)
    measured = np.where(seen[:, None], measured, 0.0)  # of a level: it does not count
    error = np.where(
        trackers_that_move(statics, numbers) & seen,
        np.nanmedian(rigid_errors(statics, measured, numbers), axis=0),
        0.0,
    )
    distance = np.nanmedian(
        np.linalg.norm(measured - np.nanmean(measured, axis=0), axis=2), axis=0
    )
    worst = np.argmax(error / np.maximum(distance, 1e-300))
    return float(error[worst]), float(distance[worst])


def trackers_that_move(statics: Statics, numbers: Numbers) -> np.ndarray:
    """Whether the joints move each tracker (k,)."""
    return np.asarray(np.ptp(statics.rest(numbers, rigid=True).points, axis=0).max(axis=1) > STILL)


def possible_mistakes(model: RobotModel, data: StaticPoses) -> Iterator[tuple[str, StaticPoses]]:
    """Single mistakes in words, and some of the poses without them."""
    step = max(1, len(data) // ENOUGH)
    some = StaticPoses(data.commands[::step], data.positions[::step])
    trackers = [sensor.name for sensor in trackers_of(model)]
    for words, commands in _mistakes_of_commands(model, some.commands):
        yield words, replace(some, commands=commands)
    yield from _stuck_joints(model, data)
    for words, factor in (("mm, read as m", 1e-3), ("m, read as mm", 1e3)):
        yield f"positions in {words}", replace(some, positions=some.positions * factor)
    for k, c in product(range(len(trackers)), range(3)):
        one = np.ones((len(trackers), 3))
        one[k, c] = 1e-3
        yield (
            f"{'xyz'[c]} of {trackers[k]} in mm, read as m",
            replace(some, positions=some.positions * one),
        )
    yield (
        "positions in a left-handed frame",
        replace(some, positions=some.positions * [-1.0, 1.0, 1.0]),
    )
    for i, j in combinations(range(len(trackers)), 2):
        order = _exchange(len(trackers), i, j)
        yield (
            f"exchanged trackers {trackers[i]} and {trackers[j]}",
            replace(some, positions=some.positions[:, order]),
        )


def _mistakes_at_points(model: RobotModel, data: StaticPoses) -> Iterator[tuple[str, StaticPoses]]:
    """Those of poses at fixed points and surfaces: all poses, some points have few."""
    for words, commands in _mistakes_of_commands(model, data.commands):
        yield words, replace(data, commands=commands)
    if data.readings is None:
        return
    for words, factor in (
        ("1000 times too large, as of mm read as m", 1e-3),
        ("1000 times too small, as of m read as mm", 1e3),
    ):
        yield f"readings {words}", replace(data, readings=data.readings * factor)


def _mistakes_of_commands(
    model: RobotModel, commands: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """Single mistakes of the commanded joints in words, and the commands without them."""
    joints = [c for c in model.coordinates if c.actuated]
    turns = np.array([c.unit == "rad" for c in joints])
    for words, factor in (
        ("degrees, read as radians", np.pi / 180),
        ("radians, read as degrees", 180 / np.pi),
    ):
        yield f"joints in {words}", commands * np.where(turns, factor, 1.0)
        for k in np.flatnonzero(turns).tolist():
            one = np.where(np.arange(len(joints)) == k, factor, 1.0)
            yield f"{joints[k].name} in {words}", commands * one
    if not turns.all():
        for words, factor in (("mm, read as m", 1e-3), ("m, read as mm", 1e3)):
            yield f"slides in {words}", commands * np.where(turns, 1.0, factor)
    for k, joint in enumerate(joints):
        signs = np.where(np.arange(len(joints)) == k, -1.0, 1.0)
        yield f"the sign of {joint.name}", commands * signs
    for i, j in combinations(range(len(joints)), 2):
        if joints[i].unit == joints[j].unit:
            order = _exchange(len(joints), i, j)
            yield (
                f"exchanged columns of {joints[i].name} and {joints[j].name}",
                commands[:, order],
            )


def _stuck_joints(model: RobotModel, data: StaticPoses) -> Iterator[tuple[str, StaticPoses]]:
    """Joints whose commands keep one value in many poses while others change, and some of the
    poses without these.
    """
    joints = [c for c in model.coordinates if c.actuated]
    for k, joint in enumerate(joints):
        q = data.commands[:, k]
        values, counts = np.unique(q, return_counts=True)
        stuck = q == values[np.argmax(counts)]
        others = np.ptp(data.commands[stuck], axis=0) > 0.0
        kept = np.flatnonzero(~stuck)
        if len(kept) < FEWEST or stuck.sum() < STUCK * len(q) or not others.any():
            continue
        kept = kept[:: max(1, len(kept) // ENOUGH)]
        first = int(np.flatnonzero(stuck)[0]) + 1
        words = f"{joint.name} stuck at {q[stuck][0]:.4g} in {stuck.sum()} poses from row {first}"
        yield words, StaticPoses(data.commands[kept], data.positions[kept])


def _exchange(count: int, i: int, j: int) -> list[int]:
    """The numbers below ``count`` with two of them exchanged."""
    order = list(range(count))
    order[i] = j
    order[j] = i
    return order
