"""Segments of a path: straight lines and arcs, each from 0 along its own length, with the turn that goes with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from flexgen.paths.jets import Attitude, chain_rule, turning, turns

FLAT = 1e-9  # relative: three points are on a line, a radius or an axis is zero


class Segment(Protocol):
    """A piece of a path. ``length`` is what its parameter runs over; ``led`` tells whether that is its arc length.

    ``turn``: rotation vector [rad] of the tool, in step with the parameter. ``total`` (d): displacement over it all.
    """

    @property
    def length(self) -> float:
        """What the parameter runs over."""
        ...

    @property
    def led(self) -> bool:
        """Whether the parameter is the arc length."""
        ...

    @property
    def turn(self) -> np.ndarray:
        """Rotation vector of the tool from end to end [rad]."""
        ...

    @property
    def total(self) -> np.ndarray:
        """From the start to the end."""
        ...

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, d, k) of the way from the start, from the jet (n, k) of the parameter."""
        ...


@dataclass(frozen=True)
class Straight:
    """A straight line by ``total`` (d), of the tool with a ``turn`` (3), or of any coordinates (turn zero).

    ``length``: of the line, or of the turn at ``radius`` where that is longer.
    """

    total: np.ndarray
    turn: np.ndarray
    radius: float = 0.0
    largest: bool = False  # the length is that of the coordinate that moves farthest

    @cached_property
    def _sizes(self) -> tuple[float, float]:
        line = float(np.abs(self.total).max()) if self.largest else float(np.linalg.norm(self.total))
        return line, self.radius * float(np.linalg.norm(self.turn))

    @property
    def length(self) -> float:
        """What the parameter runs over; 1 for a line that does not move at all."""
        return max(self._sizes) or 1.0

    @property
    def led(self) -> bool:
        """Whether the parameter is the arc length."""
        return not self.largest and self._sizes[0] >= self._sizes[1] > -1 and self._sizes[0] > 0

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, d, k) from the jet (n, k) of the parameter."""
        return self.total[None, :, None] * (x / self.length)[:, None, :]


@dataclass(frozen=True)
class Arc:
    """An arc about ``center`` (3, from its start) [m] and a unit ``axis`` by ``angle`` [rad], with a ``turn`` (3)."""

    center: np.ndarray
    axis: np.ndarray
    angle: float
    turn: np.ndarray
    radius: float = 0.0  # m, at which the turn of the tool counts

    @cached_property
    def _arms(self) -> tuple[np.ndarray, np.ndarray]:
        """From the axis to the start, and the same a quarter turn later [m]."""
        arm = -self.center + (self.center @ self.axis) * self.axis
        return arm, np.cross(self.axis, arm)

    @property
    def size(self) -> float:
        """Radius of the arc [m]."""
        return float(np.linalg.norm(self._arms[0]))

    @property
    def length(self) -> float:
        """Arc length, or that of the turn at the tool's radius where that is longer."""
        return max(self.size * abs(self.angle), self.radius * float(np.linalg.norm(self.turn))) or 1.0

    @property
    def led(self) -> bool:
        """Whether the parameter is the arc length."""
        return self.size * abs(self.angle) >= self.radius * float(np.linalg.norm(self.turn))

    @property
    def total(self) -> np.ndarray:
        """From its start to its end [m]."""
        a, b = self._arms
        return (np.cos(self.angle) - 1) * a + np.sin(self.angle) * b

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Jet (n, 3, k) from the jet (n, k) of the parameter."""
        a, b = self._arms
        phi = x * (self.angle / self.length)
        c, s = np.cos(phi[:, :1]), np.sin(phi[:, :1])
        turns = [c * a + s * b, c * b - s * a, -c * a - s * b, s * a - c * b]
        out = np.stack(chain_rule([turns[k % 4] for k in range(x.shape[1])], phi), axis=-1)
        half = np.sin(phi[:, :1] / 2)  # 1 - cos without cancellation: the start is exact
        out[:, :, 0] = s * b - 2 * half**2 * a
        return out


def turned(segment: Segment, x: np.ndarray) -> np.ndarray:
    """Jet (n, 4, k) of the quaternion by which the tool has turned, from the jet (n, k) of the parameter."""
    angle = float(np.linalg.norm(segment.turn))
    axis = segment.turn / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    return turning(x * (angle / segment.length), axis)


def attitude_along(segment: Segment, x: np.ndarray, R: np.ndarray) -> Attitude:
    """Orientation and angular velocity on a segment that begins with ``R`` (3, 3), from the jet of the parameter."""
    angle = float(np.linalg.norm(segment.turn))
    w = segment.turn[None, :, None] * (x[:, None, 1:] / segment.length)
    if angle == 0:
        return np.broadcast_to(R, (len(x), 3, 3)), w
    return turns(segment.turn / angle, x[:, 0] * (angle / segment.length)) @ R, w


def circle_through(via: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Centre, axis and angle (0 to 2 pi) [rad] of the arc from the origin through ``via`` to ``end``.

    None where the three points are on a line or coincide.
    """
    via, end = np.asarray(via, dtype=float), np.asarray(end, dtype=float)
    normal = np.cross(via, end)
    size = float(np.linalg.norm(normal))
    shortest = min(float(np.linalg.norm(d)) for d in (via, end, end - via))
    longest = max(float(np.linalg.norm(d)) for d in (via, end, end - via))
    if not shortest > FLAT * longest or not size > FLAT * longest * shortest:
        return None
    axis = normal / size
    center = (via @ via * np.cross(end, normal) - end @ end * np.cross(via, normal)) / (2 * size**2)
    arm = -center
    angle = float(np.arctan2(np.cross(arm, end - center) @ axis, arm @ (end - center)))
    return center, axis, angle if angle > 0 else angle + 2 * np.pi
