"""Tool errors of feedforward on the true robot, in the closed loop of its drives.

The feedforward is a table over time: motor torques and motor angles, as `flexgen solve --out
FILE.csv` and `Solution.trajectory` have them. The error is the distance of the tool from the test
path in the frame of the base, with sag.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.commissioning.chains import Chain, rigid_pose
from benchmarks.commissioning.paths import Path as ToolPath
from benchmarks.commissioning.paths import test_paths
from benchmarks.commissioning.plant import Motion, Plant

BEFORE = 0.05  # s at rest before the feedforward begins
AFTER = 0.5  # s after the path that count


@dataclass(frozen=True)
class Feedforward:
    """Time (N,) [s] with 0 at the beginning of the path; torques and angles (N, n), motor side."""

    time: np.ndarray
    torques: np.ndarray  # N m
    angles: np.ndarray  # rad


@dataclass(frozen=True)
class Score:
    """Tool errors of one path [m]."""

    path: str
    largest: float
    rms: float
    moving: float  # largest one without the error at rest at the start
    motors: float  # largest error of a motor angle behind the gear [rad, arm side]


def read_feedforward(file: Path) -> Feedforward:
    """From a `.csv` file with the columns `time s`, `tau_m[m1] N m` and `q_m[m1] rad`."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(line for line in stream if not line.startswith("#")))
    values = np.array(rows[1:], dtype=float)
    columns = {kind: [] for kind in ("time", "tau_m", "q_m")}  # type: dict[str, list[int]]
    for number, name in enumerate(rows[0]):
        kind = name.split("[")[0].split(" ")[0]
        if kind in columns:
            columns[kind].append(number)
    if not all(columns.values()):
        raise ValueError(f"{file}: columns time, tau_m and q_m are needed, found {rows[0]}")
    return Feedforward(
        values[:, columns["time"][0]], values[:, columns["tau_m"]], values[:, columns["q_m"]]
    )


def as_feedforward(given: Any) -> Feedforward:
    """From a file, a `Feedforward`, or a solution with `trajectory.time`, `tau_m` and `q_m`."""
    if isinstance(given, Feedforward):
        return given
    if isinstance(given, str | Path):
        return read_feedforward(Path(given))
    motion = given.trajectory
    return Feedforward(
        np.asarray(motion.time), np.asarray(motion["tau_m"]), np.asarray(motion["q_m"])
    )


def cascade_alone(chain: Chain, path: ToolPath) -> Feedforward:
    """The angles of the arm without deflections, and no torques."""
    time = np.linspace(0.0, path.duration, 201)
    angles = chain.ratios * path.joints(chain, time)
    return Feedforward(time, np.zeros_like(angles), angles)


def named_path(plant: Plant, name: str) -> ToolPath:
    """A test path of this arm."""
    found = {path.name: path for path in test_paths(plant.chain)}
    if name not in found:
        raise ValueError(f"no test path {name}; there are {', '.join(found)}")
    return found[name]


def drive(plant: Plant, given: Feedforward, duration: float) -> tuple[np.ndarray, Motion]:
    """Times of the path (N,) [s] and the motion under this feedforward."""
    sample = plant.hardware.sample_s
    begin = min(given.time[0], 0.0) - BEFORE
    time = begin + sample * np.arange(round((duration + AFTER - begin) / sample))
    inside = np.clip(time, given.time[0], given.time[-1])
    return time, plant.run(
        CubicSpline(given.time, given.angles)(inside),
        CubicSpline(given.time, given.torques)(inside),
    )


def score(plant: Plant, solution_or_arrays: Any, path: str) -> Score:
    """Largest and rms tool error [m] of a feedforward on a test path.

    Parameters
    ----------
    plant
        The true robot.
    solution_or_arrays
        A `.csv` file of `flexgen solve --out`, a solution, or a `Feedforward`.
    path
        Name of a test path: `line`, `circle`, `corner`, `line_far`, `line_near`.

    """
    tested = named_path(plant, path)
    given = as_feedforward(solution_or_arrays)
    time, motion = drive(plant, given, tested.duration)
    place, _ = rigid_pose(plant.chain, tested.start())
    misses = motion.tool - place - tested.displacement(time)
    counted = time >= 0.0
    errors = np.linalg.norm(misses[counted], axis=1)
    moved = np.linalg.norm(misses[counted] - misses[0], axis=1)
    wanted = CubicSpline(given.time, given.angles)(np.clip(time, given.time[0], given.time[-1]))
    motors = np.abs((wanted - motion.angles) / plant.ratio)[counted].max()
    return Score(
        path,
        float(errors.max()),
        float(np.sqrt(np.mean(errors**2))),
        float(moved.max()),
        float(motors),
    )
