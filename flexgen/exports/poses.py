"""Poses for robot descriptions: chained placements, quaternions, roll-pitch-yaw angles."""

from __future__ import annotations

import math

import numpy as np

from flexgen.model.elements import Placement
from flexgen.paths.geometry.jets import quaternion


def chain(first: Placement, second: Placement) -> Placement:
    """The pose of a frame that is placed at ``second`` in a frame placed at ``first``."""
    R = np.array(first.rotation)
    position = np.array(first.position) + R @ np.array(second.position)
    turned = R @ np.array(second.rotation)
    return Placement(tuple(position.tolist()), tuple(map(tuple, turned.tolist())))


def pose_attributes(place: Placement) -> dict[str, np.ndarray]:
    """Position and quaternion as attributes of an MJCF element."""
    return {"pos": np.array(place.position), "quat": quaternion(np.array(place.rotation))}


def frame_about(axis: np.ndarray) -> np.ndarray:
    """A rotation matrix whose z axis is this unit vector."""
    x = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = x - (x @ axis) * axis
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation about a unit vector, ``1 + sin(a) [n] + (1 - cos(a)) [n]^2``, a in rad."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def roll_pitch_yaw(R: np.ndarray) -> np.ndarray:
    """Angles with ``R = Rz(yaw) Ry(pitch) Rx(roll)`` [rad]; at a pitch of 90 degrees with an
    arbitrary yaw.

    The yaw is taken out first, so that roll and pitch are exact however small the cosine of the
    pitch is.
    """
    cosine = math.hypot(R[0, 0], R[1, 0])
    yaw = math.atan2(R[1, 0], R[0, 0]) if cosine > 0.0 else 0.0
    c = math.cos(yaw)
    s = math.sin(yaw)
    rest = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R  # Ry(pitch) Rx(roll)
    return np.array([math.atan2(-rest[1, 2], rest[1, 1]), math.atan2(-R[2, 0], rest[0, 0]), yaw])
