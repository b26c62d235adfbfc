"""A known force on the tool over the place on a path, wherever the tool is at a time.

Place: 0 at the start, 1 at the end of the first motion from rest to rest, 2 at that of the second,
and so on; within a motion the part of its path parameter, of lines and arcs that of the length. A
time law that changes leaves it as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from scipy.interpolate import PPoly

from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.model.elements import RobotModel
from flexgen.paths.force.force_files import read_force
from flexgen.paths.force.process_force import ProcessForce, make_force
from flexgen.paths.path import Path

EXPECTED = (
    "the force over the place on the path, which is 0 at its start and 1, 2, ... at the ends of "
    "its motions: an array (n, 3) [N] of samples at equal steps of the place, (n, 6) with "
    "moments [N m], (n, 2) for an output with two axes; a function of the places (n,) that "
    "returns one; or a CSV file with the columns place, fx, fy, fz (, mx, my, mz)"
)


def make_place_force(given: Any, model: RobotModel, motions: int) -> ProcessForce:
    """The force over the place on a path of this many motions, 0 to ``motions`` in place of the
    time; `EXPECTED`.

    ArgumentError for something else, also for a force in time: a time law that changes would move
    it along the path.
    """
    if isinstance(given, Trajectory):
        raise ArgumentError(f"force: given in time, expected {EXPECTED}")
    if isinstance(given, str | FilePath):
        given = _read(FilePath(given), float(motions))
    return make_force(given, model, float(motions), EXPECTED)


def places(path: Path, t: np.ndarray) -> np.ndarray:
    """The places (n,) where the path is at the instants ``t`` (n,) [s]."""
    laws = [(segment.law, segment.start) for segment in path.segments]
    return np.sum(
        [law(t - start, 1)[:, 0] / law(np.array([1e9]), 1)[0, 0] for law, start in laws], axis=0
    )


def force_along(force: ProcessForce, path: Path) -> Callable[[np.ndarray], np.ndarray]:
    """The force (n, 6) as a function of instants (n,) [s] on a path, which `flexgen.solve`
    takes.
    """
    return lambda t: force.at(places(path, t))


def of_motion(force: ProcessForce | None, motion: int) -> ProcessForce | None:
    """The force over the place on one motion of a path, from 0 to 1; the motions are counted
    from 0.
    """
    return (
        None if force is None else ProcessForce(PPoly(force.curve.c, force.curve.x - motion), 1.0)
    )


def in_time(force: ProcessForce, path: Path) -> ProcessForce:
    """Force along a path as a function of time, with its time derivatives."""
    return make_force(force_along(force, path), path.equations.model, path.duration)


def _read(file: FilePath, last: float) -> Trajectory:
    """The columns of a file as a trajectory over the place; ArgumentError where it does not cover
    the path, 0 to ``last``.
    """
    found = read_force(file, "place", EXPECTED)
    begin = found.time[0]
    end = found.time[-1]
    if begin > 0.0 or end < last:
        raise ArgumentError(
            f"force: given the places {begin:g} to {end:g} in {file}, expected 0 to {last:g}, "
            "the path"
        )
    return found
