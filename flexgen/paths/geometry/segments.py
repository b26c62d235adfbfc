"""Geometric segments of a path: straight lines and arcs, with the rotation of the tool along
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from flexgen.paths.geometry.jets import (
    Attitude,
    chain_rule,
    multiply_rotations,
    rotation_matrices,
    rotation_quaternion,
)
from flexgen.paths.geometry.trigonometry import sine_cosine

POSITION = 3  # coordinates of a curve of the tool that are lengths; an angle may follow
FLAT = 1e-9  # relative: three points are on a line, a radius or an axis is zero


class Segment(Protocol):
    """A geometric segment; its parameter runs from 0 to ``length``.

    ``by_arc_length``: the parameter is the arc length. ``rotation``: rotation vector [rad] of the
    tool, proportional to the parameter. ``total`` (d): displacement from start to end.
    """

    @property
    def length(self) -> float:
        """Range of the parameter."""
        ...

    @property
    def by_arc_length(self) -> bool:
        """Whether the parameter is the arc length."""
        ...

    @property
    def rotation(self) -> np.ndarray:
        """Rotation vector of the tool from start to end [rad]."""
        ...

    @property
    def total(self) -> np.ndarray:
        """Displacement from start to end."""
        ...

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, d, k) of the displacement from the start, from the jet (n, k) of the
        parameter.
        """
        ...


@dataclass(frozen=True)
class Line:
    """A straight line by ``total`` (d) with the ``rotation`` (3) of the tool; zero rotation for
    other coordinates.

    ``length``: length of the line, or ``radius`` times the angle of rotation if that is longer.
    """

    total: np.ndarray
    rotation: np.ndarray
    radius: float = 0.0
    largest: bool = False  # the length is the largest displacement of one coordinate

    @cached_property
    def _sizes(self) -> tuple[float, float]:
        line = (
            float(np.abs(self.total).max()) if self.largest else float(np.linalg.norm(self.total))
        )
        return line, self.radius * float(np.linalg.norm(self.rotation))

    @property
    def length(self) -> float:
        """Range of the parameter; 1 for a line of zero length."""
        return max(self._sizes) or 1.0

    @property
    def by_arc_length(self) -> bool:
        """Whether the parameter is the arc length."""
        return not self.largest and self._sizes[0] >= self._sizes[1] > -1 and self._sizes[0] > 0

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, d, k) from the jet (n, k) of the parameter."""
        return self.total[None, :, None] * (x / self.length)[:, None, :]


@dataclass(frozen=True)
class Arc:
    """An arc about ``center`` (3, from its start) [m] and unit ``axis`` by ``angle`` [rad], with a
    ``rotation`` (3).
    """

    center: np.ndarray
    axis: np.ndarray
    angle: float
    rotation: np.ndarray
    radius: float = 0.0  # m, scales the angle of rotation to a length

    @cached_property
    def arms(self) -> tuple[np.ndarray, np.ndarray]:
        """Radius vector at the start, and the same rotated by 90 deg about the axis [m]."""
        arm = -self.center + (self.center @ self.axis) * self.axis
        return arm, np.cross(self.axis, arm)

    @property
    def size(self) -> float:
        """Radius of the arc [m]."""
        return float(np.linalg.norm(self.arms[0]))

    @property
    def length(self) -> float:
        """Arc length, or ``radius`` times the angle of rotation if that is longer."""
        return (
            max(self.size * abs(self.angle), self.radius * float(np.linalg.norm(self.rotation)))
            or 1.0
        )

    @property
    def by_arc_length(self) -> bool:
        """Whether the parameter is the arc length."""
        return self.size * abs(self.angle) >= self.radius * float(np.linalg.norm(self.rotation))

    @property
    def total(self) -> np.ndarray:
        """Displacement from start to end [m]."""
        a, b = self.arms
        return (np.cos(self.angle) - 1) * a + np.sin(self.angle) * b

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, 3, k) from the jet (n, k) of the parameter."""
        a, b = self.arms
        phi = x * (self.angle / self.length)
        s, c = sine_cosine(phi[:, :1])
        cycle = [c * a + s * b, c * b - s * a, -c * a - s * b, s * a - c * b]
        out = np.stack(chain_rule([cycle[k % 4] for k in range(x.shape[1])], phi), axis=-1)
        half = sine_cosine(phi[:, :1] / 2)[0]  # 1 - cos without cancellation: the start is exact
        out[:, :, 0] = s * b - 2 * half**2 * a
        return out


@dataclass(frozen=True)
class WithAngle:
    """A line or arc with the angle [rad] of the tool about one axis as a fourth coordinate.

    The angle changes by ``rotation . axis``, in proportion to the parameter; ``axis``: a unit
    vector.
    """

    path: Line | Arc
    axis: np.ndarray

    @property
    def length(self) -> float:
        """Range of the parameter."""
        return self.path.length

    @property
    def by_arc_length(self) -> bool:
        """Whether the parameter is the arc length."""
        return self.path.by_arc_length

    @property
    def rotation(self) -> np.ndarray:
        """Rotation vector of the tool from start to end [rad]."""
        return self.path.rotation

    @property
    def angle(self) -> float:
        """Change of the angle from start to end [rad]."""
        return float(self.rotation @ self.axis)

    @property
    def total(self) -> np.ndarray:
        """Displacement from start to end, then the change of the angle, (4,)."""
        return np.append(self.path.total, self.angle)

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, 4, k) from the jet (n, k) of the parameter."""
        turned = self.angle * (x / self.length)
        return np.concatenate([self.path.displacement(x), turned[:, None, :]], axis=1)


def rotation_along(segment: Segment, x: np.ndarray) -> np.ndarray:
    """Jet (n, 4, k) of the tool's rotation since the start as a quaternion, from the jet (n, k) of
    the parameter.
    """
    angle = float(np.linalg.norm(segment.rotation))
    axis = segment.rotation / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    return rotation_quaternion(x * (angle / segment.length), axis)


def attitude_along(segment: Segment, x: np.ndarray, R: np.ndarray) -> Attitude:
    """Orientation (n, 3, 3) and angular velocity with derivatives (n, 3, k - 1) on a segment that
    starts at ``R`` (3, 3), from the jet ``x`` (n, k) of the parameter, the length covered [m or
    rad].
    """
    angle = float(np.linalg.norm(segment.rotation))
    w = segment.rotation[None, :, None] * (x[:, None, 1:] / segment.length)
    if angle == 0:
        return np.broadcast_to(R, (len(x), 3, 3)), w
    return multiply_rotations(
        rotation_matrices(segment.rotation / angle, x[:, 0] * (angle / segment.length)), R
    ), w


def circle_through(
    via: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Center, axis and angle (0 to 2 pi) [rad] of the arc from the origin through ``via`` to
    ``end``.

    None if the three points are on a line or coincide.
    """
    via = np.asarray(via, dtype=float)
    end = np.asarray(end, dtype=float)
    normal = np.cross(via, end)
    size = float(np.linalg.norm(normal))
    shortest = min(float(np.linalg.norm(d)) for d in (via, end, end - via))
    longest = max(float(np.linalg.norm(d)) for d in (via, end, end - via))
    if not shortest > FLAT * longest or not size > FLAT * longest * shortest:
        return None
    axis = normal / size
    center = (via @ via * np.cross(end, normal) - end @ end * np.cross(via, normal)) / (
        2 * size**2
    )
    arm = -center
    angle = float(np.arctan2(np.cross(arm, end - center) @ axis, arm @ (end - center)))
    return center, axis, angle if angle > 0 else angle + 2 * np.pi
