"""Static poses as a block of a joint fit: positions of trackers at rest."""

from __future__ import annotations

import numpy as np

from flexgen.identification.commissioning.blocks import Channel
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.poses.poses import StaticPoses
from flexgen.identification.poses.statics import frame_rotation
from flexgen.identification.poses.statics import frame_slopes as rotation_slopes

GROSS = 2.5  # standard deviations of a pose from which on its weight falls, as Huber's function
MEDIAN = 1.538  # median length of a vector of three unit Gaussians


class PosesBlock:
    """Measured positions (N, k, 3) [m] at commands (N, n_g).

    Parameters
    ----------
    arm : ElasticArm
    name : str
    poses : StaticPoses
    of_lengths : array (N, 3 k, lengths)
        Derivatives of the positions in the world in the lengths.
    """

    kind = "poses"

    def __init__(
        self, arm: ElasticArm, name: str, poses: StaticPoses, of_lengths: np.ndarray
    ) -> None:
        self.arm = arm
        self.name = name
        self.commands = poses.commands
        self.measured = poses.positions.reshape(len(poses.commands), -1)
        self.of_lengths = of_lengths
        self.weight = np.ones(len(self.measured))
        self._near: np.ndarray | None = None

    def channels(self, x: np.ndarray, derivatives: bool) -> list[Channel]:
        """See `Block`."""
        unknowns = self.arm.unknowns
        parts = unknowns.parts
        robot = self.arm.robot
        p = self.arm.numbers(x)
        q_m = (self.commands + unknowns.zeros(x)) @ robot.eta.T
        free = self.arm.rest(q_m, p, self._near)
        points = self.arm.points(free, q_m, p) + self.of_lengths @ x[parts.lengths]
        residual = in_frame(x[parts.frame], points) - self.measured
        told = np.isfinite(residual)
        residual = np.where(told, residual, 0.0) * self.weight[:, None]
        n, rows = residual.shape
        J = np.zeros((0, parts.size))
        if derivatives:
            self._near = free
            of_motors, of_numbers = self.arm.point_slopes(free, q_m, p)
            world = np.zeros((n, rows, parts.size))
            count = len(self.arm.names)
            order = [self.arm.names.index(name) for name in unknowns.vector.names]
            change = unknowns.vector.dvalues(x[parts.model])
            world[:, :, parts.model] = of_numbers[:, :, order] * change
            world[:, :, parts.trackers] = of_numbers[:, :, count:]
            world[:, :, parts.zeros] = of_motors @ robot.eta
            world[:, :, parts.lengths] = self.of_lengths
            J = turn_rows(x[parts.frame], world)
            J[:, :, parts.frame] = frame_slopes(x[parts.frame], points)
            J = J * (told * self.weight[:, None])[:, :, None]
            J = J.reshape(n * rows, -1)
        piece = np.repeat(np.arange(n), rows)
        spread = self.measured - np.nanmean(self.measured, axis=0)
        size = float(np.sqrt(np.nanmean(spread**2)))
        channel = Channel(
            "positions", residual.ravel(), J, piece, told.ravel(), size, "m", neighbors=0
        )
        return [channel]

    def set_free(self, free: np.ndarray) -> None:
        """See `Block`: derivatives in all unknowns cost little."""

    def relinearize(self, x: np.ndarray) -> None:
        """Weights of poses with gross errors."""
        self.weight = np.ones(len(self.measured))
        (channel,) = self.channels(x, False)
        r = channel.residual.reshape(len(self.measured), -1, 3)
        lengths = np.linalg.norm(r, axis=2)
        seen = channel.told.reshape(r.shape).all(axis=2)
        scale = float(np.median(lengths[seen])) / MEDIAN
        worst = np.where(seen, lengths, 0.0).max(axis=1) / (MEDIAN * max(scale, 1e-12))
        self.weight = np.sqrt(np.minimum(1.0, GROSS / np.maximum(worst, 1e-12)))


def in_frame(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3 k) of the world in the frame of the measurement, whose pose is ``frame`` (6,);
    empty: the world.
    """
    if not len(frame):
        return points
    R = frame_rotation(frame)
    return (points.reshape(len(points), -1, 3) @ R.T + frame[:3]).reshape(points.shape)


def turn_rows(frame: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Derivatives (N, 3 k, n) of points in the world, in the frame of the measurement."""
    if not len(frame):
        return rows
    n, k, count = rows.shape
    out = np.einsum("ij,nkjm->nkim", frame_rotation(frame), rows.reshape(n, k // 3, 3, count))
    return np.asarray(out.reshape(n, k, count))


def frame_slopes(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Derivatives (N, 3 k, 6) of points in the frame of the measurement in its pose."""
    n, rows = points.shape
    out = np.zeros((n, rows // 3, 3, len(frame)))
    out[:, :, :, :3] = np.eye(3)
    for i, slope in enumerate(rotation_slopes(frame)):
        out[:, :, :, 3 + i] = points.reshape(n, -1, 3) @ slope.T
    return out.reshape(n, rows, -1)
