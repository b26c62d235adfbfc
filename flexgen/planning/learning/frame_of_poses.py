"""Frame of a tracker from static poses, which it measured from the place where it still is.

A path is short: a frame that is estimated from it hides a constant offset of the tool and a
tilt. Poses at rest all over the range of the robot give the frame

    p(q) + A(q) b ~ R y + c,      y measured, p of the model, R a rotation, A that of the tracker

with sag in p, and the mean of their errors. It is that of the base as the model has it. The place
of the tracker on its body is corrected by b, with `PLACE` as its standard deviation before: what
the poses do not show of it stays. The columns are those of `flexgen calibrate`: ``q1_rad`` or
``q1_deg`` for each joint, and ``NAME_x_mm``, ``NAME_y_mm``, ``NAME_z_mm`` of a tracker of the
model; an empty cell is a point that was not seen. Poses with errors of more than `GROSS` times the
median do not count.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.files.record_columns import column_of
from flexgen.base.files.record_tables import read_arrays
from flexgen.model.elements import RobotModel
from flexgen.paths.inverse_kinematics.forward import tracker_positions
from flexgen.planning.learning.alignment import pose_of, procrustes

SIZE_MAX = 100_000_000  # bytes of a file
FEWEST = 8  # points
GROSS = 5.0
ROUNDS = 6
PLACE = 5e-3  # m: standard deviation of the place of a tracker on its body
SMALLEST = 1e-6  # m: least noise of a tracker
# Largest rms error over the size of the cloud of points: the poses are of another robot, or in
# other units.
ALIKE = 0.01


def frame_of_poses(path: str | Path, model: RobotModel) -> tuple[np.ndarray, float, int]:
    """Pose of a tracker in the base (6,), position [m] and rotation vector [rad], rms error of
    the points [m], and their number.

    Raises
    ------
    ArgumentError
        The file cannot be read, has no joints, no tracker of the model or too few poses, or does
        not fit the model.
    """
    file = Path(path)
    if file.suffix not in (".csv", ".npz", ".mat") or not file.is_file():
        raise ArgumentError(f"{file}: cannot be read: expected static poses, .csv, .npz or .mat")
    arrays = read_arrays(file, SIZE_MAX)
    commands, points = _columns(file, arrays, model)
    p, turned = _positions(model, commands)
    seen = np.isfinite(points).all(axis=2)
    if seen.sum() < FEWEST:
        raise ArgumentError(f"{file}: given {seen.sum()} points, expected {FEWEST} or more")
    k = np.nonzero(seen)[1]
    R, c, away = _fit(points[seen], p[seen], turned[seen], k)
    rms = float(np.sqrt((away**2).mean()))
    p = p[seen]
    size = float(np.ptp(p, axis=0).max())
    if rms > ALIKE * size:
        raise ArgumentError(
            f"{file}: given poses that differ by {rms:.3g} m from those of model {model.name}, "
            f"which are {size:.3g} m apart, expected less than {ALIKE:.0%}: another robot, other "
            "units, or a frame of the other hand; flexgen calibrate names the mistake"
        )
    return pose_of(R, c), rms, len(away)


def _positions(model: RobotModel, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, k, 3) [m] of the trackers, and orientations (N, k, 3, 3) of their bodies."""
    trackers = [s for s in model.sensors if s.type == "tracker"]
    moved = [
        replace(s, name=f"{s.name}_{i}", position=tuple(np.add(s.position, step)))
        for s in trackers
        for i, step in enumerate([np.zeros(3), *np.eye(3)])
    ]
    found = tracker_positions(replace(model, sensors=tuple(moved)), commands)
    found = found.reshape(len(commands), len(trackers), 4, 3)
    steps = found[:, :, 1:] - found[:, :, :1]
    return found[:, :, 0], steps.transpose(0, 1, 3, 2)


def _fit(
    y: np.ndarray, p: np.ndarray, turned: np.ndarray, tracker: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation, translation [m], and the errors (n,) [m] of the points that count.

    ``y`` (n, 3) measured, ``p`` (n, 3) of the model, ``turned`` (n, 3, 3), ``tracker`` (n,): its
    number.
    """
    count = int(tracker.max()) + 1
    b = np.zeros((count, 3))
    kept = np.ones(len(y), bool)
    for _ in range(ROUNDS):
        target = p + np.einsum("nij,nj->ni", turned, b[tracker])
        R, c = procrustes(y[kept], target[kept])
        left = y @ R.T + c - target
        # changes of rotation and translation, and of the places of the trackers
        rows = np.zeros((len(y), 3, 6 + 3 * count))
        rows[:, :, :3] = np.eye(3)
        middle = y @ R.T + c
        for i, axis in enumerate(np.eye(3)):
            rows[:, :, 3 + i] = np.cross(axis, middle)
        for j in range(count):
            rows[tracker == j, :, 6 + 3 * j : 9 + 3 * j] = -turned[tracker == j]
        noise = max(float(np.sqrt((left[kept] ** 2).mean())), SMALLEST)
        A = rows[kept].reshape(-1, rows.shape[2]) / noise
        prior = np.eye(rows.shape[2])[6:] / PLACE
        sides = np.concatenate([-left[kept].ravel() / noise, -b.ravel() / PLACE])
        b += np.linalg.lstsq(np.vstack([A, prior]), sides, rcond=None)[0][6:].reshape(b.shape)
        target = p + np.einsum("nij,nj->ni", turned, b[tracker])
        R, c = procrustes(y[kept], target[kept])
        away = np.linalg.norm(y @ R.T + c - target, axis=1)
        kept = away <= GROSS * float(np.median(away))
    return R, c, away[kept]


def _columns(
    file: Path, arrays: dict[str, np.ndarray], model: RobotModel
) -> tuple[np.ndarray, np.ndarray]:
    """Commanded joints (N, n_g) [rad or m] and points (N, k, 3) [m], nan where not seen."""
    names = [s.name for s in model.sensors if s.type == "tracker"]
    if not names:
        raise ArgumentError(
            f"poses: given {file} with model {model.name}, which has no [[sensor]] of type "
            '"tracker", expected the point that the poses show'
        )
    found = {column_of(text).name.lower(): text for text in arrays}
    where = f"{file}:1"

    def values(name: str, si: str) -> np.ndarray:
        """A column in SI units, nan where it is empty."""
        text = found[name.lower()]
        x = np.ma.filled(np.ma.asanyarray(arrays[text]).astype(float), np.nan)
        return np.asarray(x * column_of(text).factor(where, si))

    joints = [model.coordinates[i] for i in model.i_g]
    lacking = [joint.name for joint in joints if joint.name.lower() not in found]
    axes = [f"{name}_{axis}" for name in names for axis in "xyz"]
    shown = [name for name in names if all(f"{name}_{a}".lower() in found for a in "xyz")]
    if lacking or not shown:
        wanted = f"{lacking[0]}_rad" if lacking else f"{axes[0]}_mm, {axes[1]}_mm, {axes[2]}_mm"
        raise ArgumentError(
            f"{where}: given the columns {', '.join(arrays)[:200]}, expected also {wanted}"
        )
    commands = np.stack([values(joint.name, joint.unit) for joint in joints], axis=1)
    if not np.isfinite(commands).all():
        raise ArgumentError(f"{file}: given a pose with an empty joint, expected all joints")
    nothing = np.full(len(commands), np.nan)
    columns = [values(name, "m") if name.rpartition("_")[0] in shown else nothing for name in axes]
    return commands, np.stack(columns, axis=1).reshape(len(commands), len(names), 3)
