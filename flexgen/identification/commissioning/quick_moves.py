"""Moves of the file that are quicker than the records: what a robot does under their loads no
record shows.

Springs carry the accelerated masses: a motion with a tenth of the acceleration has a tenth of the
deflection, in which the noise of the tracker, friction and transmission errors hide the error of
a stiffness that then counts in full.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.commissioning.blocks import Block
from flexgen.identification.commissioning.motion_block import MotionBlock
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move
from flexgen.paths.path import CHECKED, FEWEST, Path, joints_along

# Acceleration of a move over the largest one of the tracked records from which on it is named.
QUICKER = 1.5


def find_quicker_moves(robot: RobotModel, blocks: Sequence[Block]) -> tuple[str, ...]:
    """Sentences on moves of the file that accelerate a joint more than all records that a tracker
    followed; empty where there is no such record.
    """
    recorded = _find_recorded(robot, blocks)
    if recorded is None:
        return ()
    equations = derive(robot)
    out = []
    for move in robot.moves:
        try:
            asked = _measure_accelerations(Path(equations, move))
        except FlexgenError:  # such as a move out of reach: `plan` has the reason
            continue
        ratio = asked / np.maximum(recorded, 1e-12)
        k = int(np.argmax(ratio))
        if ratio[k] > QUICKER:
            joint = robot.coordinates[robot.i_g[k]]
            out.append(_describe(move, joint.name, asked[k], recorded[k]))
    return tuple(out)


def _describe(move: Move, joint: str, asked: float, recorded: float) -> str:
    """One move, the joint and both accelerations."""
    return (
        f"move {move.name} accelerates {joint} with {asked:.2g} rad/s^2, the tracked motions with "
        f"{recorded:.2g} rad/s^2: record one as quick as the moves"
    )


def _find_recorded(robot: RobotModel, blocks: Sequence[Block]) -> np.ndarray | None:
    """Largest acceleration of each joint (n_g,) in the motions that a tracker followed."""
    found = []
    for block in blocks:
        if isinstance(block, MotionBlock) and block.positions is not None:
            motors = block.motion.samples[:, 2 * robot.n_m : 3 * robot.n_m]
            found.append(np.abs(motors @ np.linalg.inv(robot.eta).T).max(axis=0))
    return np.max(found, axis=0) if found else None


def _measure_accelerations(path: Path) -> np.ndarray:
    """Largest acceleration of each joint (n_g,) along a move of the arm without deflections."""
    robot = path.equations.model
    largest = np.zeros(robot.n_g)
    if robot.output.size != robot.n_g:
        return largest
    many = len(path.segments) > 1
    count = max(FEWEST, CHECKED // len(path.segments)) if many else CHECKED
    for segment, (_, speeds) in zip(path.segments, joints_along(path, speeds=True), strict=True):
        rates = np.gradient(speeds, segment.instants(count), axis=0)
        largest = np.maximum(largest, np.abs(rates).max(axis=0))
    return largest
