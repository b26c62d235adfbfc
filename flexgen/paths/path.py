"""Paths: the reference of the output over time, with derivatives up to order 5, in position and
orientation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_class, checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.results import Result
from flexgen.base.rows import Column, Data, Part, Prose, Table
from flexgen.base.spec.arguments import is_whole
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move
from flexgen.paths.geometry.jets import JET, ORDER, chain_rule
from flexgen.paths.reference import PathSample, Reference
from flexgen.paths.timing.joint_limits import InverseKinematics, beyond_range
from flexgen.paths.timing.move_planner import plan_move
from flexgen.paths.timing.timed_segments import JointMotion, PlannedMove, TimedSegment

__all__ = ["ORDER", "Path", "PathSample", "chain_rule", "find_move", "plan"]

# instants at which `plan` solves the inverse kinematics; of each motion of many
CHECKED = 101
FEWEST = 33

# s, more than a day: the samples of longer paths do not fit into memory
LONGEST = 1e5


def _check_duration(name: str, duration: float) -> None:
    """ArgumentError where a move takes more than `LONGEST`."""
    if duration > LONGEST:
        raise ArgumentError(
            f"move {name}: given a duration of {duration:.6g} s, expected at most {LONGEST:g} s"
        )


# Columns of the segments of a path.
SEGMENTS = (
    Column("segment"),
    Column("space", key="space"),
    Column("start", "s", "start_s"),
    Column("duration", "s", "duration_s"),
    Column("continuous derivatives", key="smoothness"),
)


@checked_class
class Path(Result):
    """The reference of one move (or program) of one model at any instant; constant before 0 and
    after `duration`.

    Attributes
    ----------
    equations : Equations
    reference : Reference
    move : Move
        With the duration of the path where it is computed. Planned again, it gives the same path.
    segments : tuple of TimedSegment
        Motions from rest to rest, in order.
    duration : float [s]
    smoothness : int
        Number of continuous derivatives in time.
    q_start : array (n_a)
        Arm coordinates at the start, without deflections.
    pose : bool
        True if the output is position and orientation of the tool.

    Examples
    --------
    >>> path = flexgen.plan("elbow", "line")
    >>> output = path.sample([0.0, 0.5, 1.0]).y  # m, and derivatives in time
    >>> (output[-1, :, 0] - output[0, :, 0]).round(6)
    array([-0.3, -0.3])
    """

    def __init__(self, equations: Equations, move: Move) -> None:
        self.equations = equations
        self.reference = Reference(equations)
        self.pose = self.reference.pose
        _check_duration(move.name, move.duration)
        planned = self._plan(move)
        self.segments: tuple[TimedSegment, ...] = planned.segments
        self.q_start = self.reference.expand(planned.q_g)
        self.smoothness = min(segment.smoothness for segment in self.segments)
        last = self.segments[-1]
        self.duration = (
            move.duration
            if len(self.segments) == 1 and last.law.duration == move.duration
            else (last.start + last.law.duration)
        )
        _check_duration(move.name, self.duration)
        unchanged = move.duration == self.duration and move.type != "sampled"
        self.move = (
            move
            if unchanged
            else replace(move, start=tuple(map(float, planned.q_g)), duration=self.duration)
        )

    def _plan(self, move: Move) -> PlannedMove:
        """The segments of the move; of an output with joints after the tool, a move of the tool as
        a motion of all joints, which its posture chooses.
        """
        model = self.equations.model
        is_chosen = model.output.is_with_joints and not isinstance(move, JointMotion)
        if move.posture is None and not is_chosen:
            return plan_move(self.reference, move)
        from flexgen.paths.geometry.joint_follower import check_posture, joint_segments

        if move.posture is not None:
            check_posture(model, move.posture, move.name)
        if not is_chosen:
            return plan_move(self.reference, move)
        alone = Equations(replace(model, output=model.output.of_tool))
        planned = plan_move(Reference(alone), move)
        segments, _ = joint_segments(alone, planned.segments, planned.q_g, move.posture)
        return PlannedMove(tuple(segments), planned.q_g)

    def __repr__(self) -> str:
        title = self.equations.model.title
        return (
            f"<Path {title}, move {self.move.name}: {self.duration:.4g} s, {self.smoothness} "
            "continuous derivatives>"
        )

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which a derivative up to order 5 may jump [s], including both ends."""
        return np.unique(np.concatenate([segment.breaks for segment in self.segments]))

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on samples of the path: deviation, noise, kinks, and motion at their ends."""
        lines = (line for segment in self.segments for line in getattr(segment.curve, "notes", ()))
        return tuple(dict.fromkeys(lines))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The `notes` that say what is wrong with the samples."""
        segments = self.segments
        lines = (line for one in segments for line in getattr(one.curve, "warnings", ()))
        return tuple(dict.fromkeys(lines))

    def content(self) -> tuple[Part, ...]:
        """Duration, segments and notes."""
        model = self.equations.model.name
        cells = tuple(
            (k, s.space, s.start, s.law.duration, s.smoothness)
            for k, s in enumerate(self.segments, 1)
        )
        notes = self.notes
        return (
            Prose(f"{model}, {self.move.name}: {self.duration:.4g} s", is_title=True),
            Data("model", model),
            Data("move", self.move.name),
            Data("duration_s", self.duration),
            Data("smoothness", self.smoothness),
            Data("q_start", self.q_start.tolist()),
            Table(SEGMENTS, cells, "Segments", "segments"),
            *(Prose(f"note: {line}", "notes") for line in notes if line not in self.warnings),
            *([Data("notes", list(notes))] if notes else []),
        )

    def table(self) -> np.ndarray:
        """The path as the sampler of the emitted C reads it, see `flexgen.paths.path_table`.

        Returns
        -------
        array (n,)

        Raises
        ------
        ArgumentError
            A part of the path is a spline through samples, or in a frame that moves.
        """
        from flexgen.paths.path_table import path_table

        return path_table(
            self.reference, self.segments, self.duration, self.q_start, self.move.name
        )

    @checked_types(own=("t",))
    def sample(self, t: np.ndarray) -> PathSample:
        """The reference at the instants ``t`` [s], shape (n,); ArgumentError where they are
        none.
        """
        return self.sample_orders(t, JET)

    @checked_types(own=("t", "count"))
    def sample_orders(self, t: np.ndarray, count: int) -> PathSample:
        """The reference at the instants ``t`` [s], (n,), of joint moves with ``count``
        derivatives, from 0 on, 2 to 6.

        Returns
        -------
        PathSample

        Examples
        --------
        >>> flexgen.plan("elbow", "joints").sample_orders([0.0, 0.5], 3).y.shape
        (2, 2, 3)
        """
        t = _instants(t)
        if not is_whole(count, 2, JET):
            raise ArgumentError(
                f"count: given {show_value(count)}, expected 2 to {JET} derivatives, from 0 on"
            )

        def of(segment: TimedSegment, at: np.ndarray) -> PathSample:
            x, attitude = segment.at(at)
            return self.reference.sample(
                segment.space, x[:, :, :count] if segment.space == "joint" else x, attitude
            )

        if len(self.segments) == 1 or not len(t):
            return of(self.segments[0], t)
        starts = [segment.start for segment in self.segments]
        number = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1)
        found = []
        for k, segment in enumerate(self.segments):
            here = np.flatnonzero(number == k)
            if len(here):
                found.append((here, of(segment, t[here])))
        order = np.argsort(np.concatenate([here for here, _ in found]), kind="stable")

        def join(name: str) -> np.ndarray | None:
            values = [getattr(sample, name) for _, sample in found]
            if any(value is None for value in values):
                return None
            fewest = min(value.shape[-1] for value in values) if name in ("y", "w") else None
            return np.concatenate([value[..., :fewest] for value in values])[order]

        y = join("y")
        assert y is not None
        joints = all(segment.space == "joint" for segment in self.segments)
        return PathSample(y, join("R"), join("w"), join("q_g") if joints else None)


def _instants(t: Any) -> np.ndarray:
    """The instants of a caller as an array (n,) [s]; ArgumentError for others, and for numbers
    that are not finite.
    """
    try:
        found = (
            np.zeros((0, 0)) if isinstance(t, bytes | bytearray) else np.asarray(t, dtype=float)
        )
    except (TypeError, ValueError, OverflowError):
        found = np.zeros((0, 0))
    if found.ndim != 1 or not np.isfinite(found).all():
        given = (
            f"shape {np.shape(t)}"
            if isinstance(t, np.ndarray) and found.ndim != 1
            else show_value(t)
        )
        raise ArgumentError(f"t: given {given}, expected instants in s, shape (n,)")
    return found


@checked_types
def plan(
    model: str | FilePath | RobotModel | Equations,
    move: str | Move | None = None,
    *,
    ignore_limits: bool = False,
) -> Path:
    """Plan a move: a path in time, checked by the inverse kinematics of the undeflected arm and
    the joints' ranges.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: the first.
    ignore_limits : bool
        Also plan a path beyond the range of a joint.

    Returns
    -------
    Path
        `Path.sample` gives the output and its derivatives at any instants.

    Raises
    ------
    ArgumentError, ModelError
        The move is unknown or does not fit the model.
    SolverError
        The path leaves the range of a joint or the workspace, passes a singular pose, or a
        position in which a closed loop comes apart; the message names the instant.

    Examples
    --------
    >>> flexgen.plan("elbow", "line").duration
    1.0
    """
    equations = model if isinstance(model, Equations) else derive(model)
    path = Path(equations, find_move(equations.model, move))
    check_range(path, ignore_limits)
    return path


def check_range(path: Path, ignore_limits: bool = False) -> None:
    """SolverError where the path leaves the workspace, passes a singular pose or leaves the range
    of a joint.

    Of motions of an output that does not determine the joints, nothing is checked.
    """
    robot = path.equations.model
    found = [q_g for q_g, _ in joints_along(path)]
    beyond = () if not found or ignore_limits else beyond_range(robot, np.concatenate(found))
    if beyond:
        raise SolverError(
            f"move {path.move.name}: {'; '.join(beyond)}; choose another target or path: more "
            "time does not help; ignore_limits (--ignore-limits) plans it nevertheless"
        )


def joints_along(path: Path, speeds: bool = False) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Actuated coordinates and their speeds (n, n_g) along each motion from rest to rest, at
    instants in all sections.

    Motions of an output that does not determine the joints are left out. Without ``speeds`` the
    second is empty.
    """
    robot = path.equations.model
    kinematics = InverseKinematics(path.equations)
    q_g = path.q_start[list(robot.i_g)]
    count = max(FEWEST, CHECKED // len(path.segments))
    for segment in path.segments:
        t = segment.instants(CHECKED if len(path.segments) == 1 else count)
        x, attitude = segment.at(t)
        if segment.space == "joint":
            if robot.loops:
                from flexgen.paths.timing.loop_closure import check_closed  # here: few have loops

                check_closed(robot, path.move.name, t, x[:, :, 0])
            q_g = x[-1, :, 0]
            yield x[:, :, 0], x[:, :, 1]
        elif robot.output.size == robot.n_g:
            sample = path.reference.sample(segment.space, x, attitude)
            at = t / path.duration
            found = (
                kinematics.follow(sample, q_g)
                if len(t) == CHECKED
                else kinematics.follow_many(sample, q_g, at)
            )
            q_g = found[-1]
            yield (
                found,
                kinematics.velocities(sample, found)[0] if speeds else np.zeros((0, robot.n_g)),
            )


def find_move(robot: RobotModel, move: str | Move | None) -> Move:
    """The move or program with this name (None: the first one); a `Move` is returned as it is."""
    if isinstance(move, Move):
        return move
    if move is not None and not isinstance(move, str):
        raise ArgumentError(f"move: given {move!r}, expected the name of a move or a flexgen.Move")
    return robot.move(move)
