"""Serial arms as plain numbers: links, gears, springs and what rides on the last link.

The same classes hold the true robot, which `plant.py` simulates, and what its data sheet says,
which `datasheet.py` writes. All quantities are in SI units. Gears are described on the arm side:
the motor angle divided by the ratio is `theta`, the deflection is x = theta + e(theta) - q.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Friction:
    """Torque viscous w + coulomb tanh(w / width) against the speed w."""

    viscous: float = 0.0  # N m s/rad
    coulomb: float = 0.0  # N m
    width: float = 1.0  # rad/s: speed at which the Coulomb torque is developed to 76 %


@dataclass(frozen=True)
class Gear:
    """Motor, gear and drive of one joint.

    Torque on the joint: K x - (K - K0) d0 tanh(x / d0) + D x' + K_v (x - z), T z' = x - z. At no
    load its stiffness is K0, far beyond d0 it is K. The transmission error is
    e = error sin(cycles n theta), with the ratio n.
    """

    ratio: float
    rotor: float  # kg m^2, motor side
    stiffness: float  # K, N m/rad
    damping: float  # D, N m s/rad
    soft: float = 1.0  # K0 / K
    width: float = 1e-3  # d0, rad
    relaxing: float = 0.0  # K_v, N m/rad, of the Maxwell element
    relaxation: float = 0.1  # T, s
    error: float = 0.0  # rad, arm side
    cycles: float = 2.0  # per turn of the motor
    torque_max: float = 40.0  # N m, motor side
    motor_friction: Friction = field(default_factory=Friction)  # motor side
    joint_friction: Friction = field(default_factory=Friction)  # arm side
    drive: tuple[float, float, float] = (30.0, 0.5, 10.0)  # k_p 1/s, k_v N m s/rad, k_i 1/s


@dataclass(frozen=True)
class Axis:
    """A rotation between two links: of a gear, or of a spring without a motor."""

    name: str
    axis: Vector
    gear: Gear | None = None
    stiffness: float = 0.0  # N m/rad, of a spring
    damping: float = 0.0  # N m s/rad, of a spring
    range: tuple[float, float] = (-3.0, 3.0)  # rad, of a gear


@dataclass(frozen=True)
class Body:
    """Mass [kg], center of mass [m] and inertia about it (3, 3) [kg m^2]."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Link:
    """Origin in the frame of the link before [m], axes in their order, and the body."""

    name: str
    origin: np.ndarray
    axes: tuple[Axis, ...]
    body: Body


@dataclass(frozen=True)
class Chain:
    """An arm: links from the base to the flange; tool, payload and ball in the last frame."""

    name: str
    links: tuple[Link, ...]
    tool: np.ndarray  # m
    payload: Body
    ball: np.ndarray  # m: target of the tracker
    home: tuple[float, ...]  # rad

    @property
    def axes(self) -> list[Axis]:
        """All axes in the order of the chain."""
        return [axis for link in self.links for axis in link.axes]

    @property
    def gears(self) -> list[Gear]:
        """Those of the motors, in the order of the chain."""
        return [axis.gear for axis in self.axes if axis.gear is not None]

    @property
    def joints(self) -> list[Axis]:
        """The axes with a gear."""
        return [axis for axis in self.axes if axis.gear is not None]

    @property
    def ratios(self) -> np.ndarray:
        """Of the gears (n,)."""
        return np.array([gear.ratio for gear in self.gears])


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about a unit vector by an angle [rad], by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def rigid_pose(chain: Chain, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tool of the arm without deflections: position (3,) [m] and orientation (3, 3)."""
    place = np.zeros(3)
    turn = np.eye(3)
    angles = iter(q)
    for link in chain.links:
        place = place + turn @ link.origin
        for axis in link.axes:
            if axis.gear is not None:
                turn = turn @ rotation(np.array(axis.axis), next(angles))
    return place + turn @ chain.tool, turn


def rotation_vector(turn: np.ndarray) -> np.ndarray:
    """Vector (3,) [rad] of a small rotation matrix, to first order."""
    part = turn - turn.T
    return 0.5 * np.array([part[2, 1], part[0, 2], part[1, 0]])


def inverse(chain: Chain, position: np.ndarray, turn: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Joints (n,) [rad] of the arm without deflections near some others, by Newton's method.

    Arms with three joints reach the position, arms with six the orientation as well.
    """
    q = np.array(near, dtype=float)
    size = 3 if len(q) == 3 else 6

    def miss(angles: np.ndarray) -> np.ndarray:
        place, now = rigid_pose(chain, angles)
        return np.concatenate([place - position, rotation_vector(now @ turn.T)])[:size]

    step = 1e-6  # rad, of the differences
    for _ in range(20):
        error = miss(q)
        if np.abs(error).max() < 1e-12:
            return q
        slopes = [
            (miss(q + step * unit) - miss(q - step * unit)) / (2 * step) for unit in np.eye(len(q))
        ]
        q = q - np.linalg.solve(np.column_stack(slopes), error)
    raise ValueError(f"{chain.name}: no joints for the tool at {position.tolist()}")
