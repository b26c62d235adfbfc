"""Paths: the reference of the output over time, with its derivatives up to the fifth, in position and orientation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

from flexgen.errors import ArgumentError
from flexgen.mechanics.equations import Equations, derive
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move
from flexgen.paths.jets import ORDER, chain_rule
from flexgen.paths.joint_limits import Posture
from flexgen.paths.move_planner import PlannedMove
from flexgen.paths.reference import PathSample, Reference
from flexgen.paths.timed_segments import TimedSegment

__all__ = ["ORDER", "Path", "PathSample", "chain_rule", "named_move", "plan"]

CHECKED = 101  # instants at which `plan` solves the inverse kinematics


class Path:
    """The reference of one move (or program) of one model at any instant; constant before 0 and after `duration`.

    Attributes
    ----------
    equations : Equations
    move : Move
        With the duration and the smoothness that the path has, where they are computed.
    legs : list of Leg
        Runs from rest to rest, one after the other.
    duration : float [s]
    smoothness : int
        Number of continuous derivatives in time.
    q_start : array (n_a)
        Arm coordinates at the start, elements undeflected.
    pose : bool
        Whether the output is position and orientation of the tool.
    """

    def __init__(self, equations: Equations, move: Move) -> None:
        self.equations = equations
        self.reference = Reference(equations)
        self.pose = self.reference.pose
        routes = PlannedMove(self.reference, move)
        self.legs: list[TimedSegment] = routes.legs
        self.q_start = self.full(tuple(routes.q_g))
        self.smoothness = min(leg.smoothness for leg in self.legs)
        last = self.legs[-1]
        self.duration = (
            move.duration
            if len(self.legs) == 1 and last.law.duration == move.duration
            else (last.start + last.law.duration)
        )
        plain = move.duration == self.duration and move.smoothness == self.smoothness and move.type != "sampled"
        self.move = (
            move
            if plain
            else replace(move, start=tuple(map(float, routes.q_g)), duration=self.duration, smoothness=self.smoothness)
        )

    def full(self, q_g: tuple[float, ...]) -> np.ndarray:
        """Arm coordinates with the given actuated ones and undeflected elements."""
        return self.reference.full(q_g)

    @property
    def breaks(self) -> np.ndarray:
        """Instants at which a derivative up to the fifth may jump [s], the ends among them."""
        return np.unique(np.concatenate([leg.breaks for leg in self.legs]))

    def sample(self, t: np.ndarray) -> PathSample:
        """The reference at the instants ``t`` [s]."""
        t = np.asarray(t, dtype=float)
        if len(self.legs) == 1 or not len(t):
            return self.reference.sample(self.legs[0].space, *self.legs[0].at(t))
        at = np.clip(np.searchsorted([leg.start for leg in self.legs], t, side="right") - 1, 0, len(self.legs) - 1)
        parts = []
        for k, leg in enumerate(self.legs):
            here = np.flatnonzero(at == k)
            if len(here):
                parts.append((here, self.reference.sample(leg.space, *leg.at(t[here]))))
        order = np.argsort(np.concatenate([here for here, _ in parts]), kind="stable")

        def joined(name: str) -> np.ndarray | None:
            values = [getattr(sample, name) for _, sample in parts]
            return None if any(value is None for value in values) else np.concatenate(values)[order]

        y = joined("y")
        assert y is not None
        every = all(leg.space == "joint" for leg in self.legs)
        return PathSample(y, joined("R"), joined("w"), joined("q_g") if every else None)


def plan(model: str | FilePath | RobotModel | Equations, move: str | Move | None = None) -> Path:
    """Plan a move: a path in time, checked by the inverse kinematics of the undeflected arm.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    move : str or Move, optional
        A move or program of the model file; default: its first.

    Returns
    -------
    Path
        `Path.sample` gives the output and its derivatives at any instants.

    Raises
    ------
    ArgumentError, ModelError
        The move is unknown or does not fit the model.
    SolverError
        The path leaves the workspace or passes a singular pose; the text says where.
    """
    equations = model if isinstance(model, Equations) else derive(model)
    path = Path(equations, named_move(equations.model, move))
    sample = path.sample(np.linspace(0.0, path.duration, CHECKED))
    robot = equations.model
    if sample.q_g is None and robot.output.size == robot.n_g:
        Posture(equations).follow(sample, path.q_start[list(robot.i_g)])
    return path


def named_move(robot: RobotModel, move: str | Move | None) -> Move:
    """The move or program with this name (None: the first one); a `Move` is returned as it is."""
    if isinstance(move, Move):
        return move
    if move is not None and not isinstance(move, str):
        raise ArgumentError(f"move: given {move!r}, expected the name of a move or a flexgen.Move")
    try:
        return robot.move(move)
    except KeyError:
        names = ", ".join(m.name for m in (*robot.moves, *robot.programs)) or "none"
        raise ArgumentError(f"move: given {move!r}, expected one of model {robot.name}: {names}") from None
