"""Misfit of a fitted model: errors of positions on parts of records that were not fitted, over the
elastic displacement of what was measured.

Friction of joints, transmission errors, springs that the model lacks or calls linear: no deviation
of a number says what they do. The errors of positions grow with the load as the elastic
displacement does:

    rho^2 = sum |y_model - y_measured|^2 / sum |u - mean u|^2,      u = y_elastic - y_rigid

both over the held-out parts of a record: without the mean, which is the frame of the tracker.
Noise of the tracker is in it, and poses with gross errors count less, as in the fit. The largest
rho of all records counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flexgen.identification.commissioning.blocks import Block, Channel
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.motion_block import MotionBlock
from flexgen.identification.commissioning.poses_block import PosesBlock

POSITIONS = "positions"  # title of the channel


def measure_misfit(
    blocks: Sequence[Block], x: np.ndarray, held_out_rows: Callable[[Channel], np.ndarray]
) -> float | None:
    """The largest relative misfit rho of all records at unknowns x; None: no position was held
    out, or nothing is elastic.
    """
    found = []
    for block in blocks:
        if not isinstance(block, PosesBlock | MotionBlock):
            continue
        block.relinearize(x)
        channel = next((c for c in block.channels(x, False) if c.title == POSITIONS), None)
        if channel is None:
            continue
        rows = held_out_rows(channel) & channel.told
        moved = _displacement(block, x)
        away = np.where(rows.reshape(moved.shape), moved, np.nan)
        if not rows.any():
            continue
        size = float(np.nansum((away - np.nanmean(away, axis=0)) ** 2))
        if size > 0.0:
            found.append(float(np.sqrt(np.sum(channel.residual[rows] ** 2) / size)))
    return max(found, default=None)


def _displacement(block: PosesBlock | MotionBlock, x: np.ndarray) -> np.ndarray:
    """Elastic displacement (N, 3 k) [m] of the trackers in the world at the rows of a record."""
    arm = block.arm
    p = arm.numbers(x)
    zeros = arm.unknowns.zeros(x)
    if isinstance(block, PosesBlock):
        q_m = (block.commands + zeros) @ arm.robot.eta.T
        return arm.points(arm.rest(q_m, p), q_m, p) - _rigid_points(arm, q_m, p)
    shift = arm.robot.eta @ zeros
    found = block.simulate(p[None], shift[None])[0, :, arm.robot.n_m :]
    return block.inner(found - _rigid_points(arm, block.q_m + shift, p))


def _rigid_points(arm: ElasticArm, q_m: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Trackers (N, 3 k) [m] in the world of the arm without deflections."""
    joints = np.zeros((len(q_m), arm.robot.dof))
    joints[:, list(arm.robot.i_g)] = q_m @ np.linalg.inv(arm.robot.eta).T
    return arm.points(joints[:, arm.driven.free], q_m, p)
