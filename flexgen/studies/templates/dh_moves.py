"""Home pose, output and moves of a new arm, within its ranges, speeds and torques."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from flexgen.base.errors import FlexgenError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.elements import Coordinate, RobotModel
from flexgen.model.format.format_tasks import TOOL
from flexgen.model.moves import Move
from flexgen.paths.geometry.redundancy import problem_of_move
from flexgen.paths.timing.joint_limits import InverseKinematics, beyond_range

CANDIDATES = 3000
"""Poses among which the home pose is chosen."""

CENTRAL = 0.7
"""Part of the range of a joint, about its middle, in which home is searched."""

UNLIMITED = {"rad": 2.0, "m": 0.5}
"""Range [rad, m] to both sides of 0 of a joint without limits."""

STEP = {"rad": math.radians(10.0), "m": 0.01}
"""Home is a multiple of this [rad, m]."""

STEADY = 0.4
"""Smallest singular value of the Jacobian along a move, as a part of that at home."""

SWING = {"rad": 1.4, "m": 1.0}
"""Largest change of a joint [rad, m] in a move of the tool."""

TURN = {"rad": 0.4, "m": 0.15}
"""Change of each joint [rad, m] in the move of the joints."""

SIZES = (0.3, 0.2, 0.1, 0.05)
"""Lengths of lines, as parts of the reach."""

ROUND = 0.25
"""Radius of the circle, as a part of the length of the line."""

SPEED_PART = 0.5
"""Part of its largest speed that a joint or motor reaches in a move."""

SPEED = {"rad": 1.5, "m": 0.5}
"""Largest speed [rad/s, m/s] in a move where the table has none."""

TORQUE_PART = 0.6
"""Part of its largest torque that a motor needs in a move, without elasticity."""

ACCELERATION = {"rad": 12.0, "m": 4.0}
"""Largest acceleration [rad/s^2, m/s^2] of a joint in a move."""

LONGEST = 20.0
"""Duration [s] beyond which a move is left out: its motors hardly hold the arm."""

DEXTEROUS = 1e-3
"""Median of the smallest singular value below which rows of the Jacobian are not an output."""

UPRIGHT = 1e-9
"""Angular velocity [rad/rad, rad/m] across the vertical of an upright tool: rounding."""

ANGLE = "tool_position_angle"
SMOOTHNESS = 5
INSTANTS = 129

_DIRECTIONS = [
    np.array(direction, dtype=float)
    for direction in (
        (0, 1, 0),
        (0, -1, 0),
        (1, 0, 0),
        (-1, 0, 0),
        (0, 0, -1),
        (0, 0, 1),
        (1, 1, 0),
        (-1, 1, 0),
        (1, -1, 0),
        (-1, -1, 0),
    )
]


@dataclass(frozen=True)
class Kept:
    """A move that the arm can do; ``why``: why its duration is not shorter."""

    move: Move
    why: str


def ranges(robot: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """Limits (n_g) of the actuated coordinates [rad or m]; infinite where there are none."""
    dofs = [robot.coordinates[i].dof for i in robot.i_g]
    low = [-np.inf if dof is None or dof.lower is None else dof.lower for dof in dofs]
    high = [np.inf if dof is None or dof.upper is None else dof.upper for dof in dofs]
    return np.array(low), np.array(high)


def reach(robot: RobotModel) -> float:
    """Length of the chain of frames [m]."""
    places = [place for e in robot.elements for place in (e.origin, e.link)] + [robot.tool]
    return max(sum(float(np.linalg.norm(place.position)) for place in places), 1e-3)


def joints_of(robot: RobotModel) -> list[Coordinate]:
    """The actuated coordinates."""
    return [robot.coordinates[i] for i in robot.i_g]


def draw_poses(robot: RobotModel, count: int, seed: int = 1) -> np.ndarray:
    """Poses (count, n_g) in the central part of all ranges, multiples of `STEP` if possible."""
    low, high = ranges(robot)
    units = [joint.unit for joint in joints_of(robot)]
    wide = np.array([UNLIMITED[unit] for unit in units])
    step = np.array([STEP[unit] for unit in units])
    low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2.0 * wide, -wide))
    high = np.where(np.isfinite(high), high, low + 2.0 * wide)
    low = np.maximum(low, -math.pi)
    high = np.minimum(high, math.pi)
    low, high = np.minimum(low, high), np.maximum(low, high)
    middle = 0.5 * (low + high)
    half = 0.5 * CENTRAL * (high - low)
    drawn = middle + half * np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(units)))
    rounded = np.round(drawn / step) * step
    return np.where((rounded > low) & (rounded < high), rounded, drawn)


class Arm:
    """An arm without moves, with the functions that evaluate its poses and motions."""

    def __init__(self, equations: Equations, axes: Sequence[int]) -> None:
        """``axes``: rows of the Jacobian (of 6) that the output prescribes; none: all joints."""
        self.equations = equations
        self.robot = equations.model
        self.axes = list(axes)
        self.reach = reach(self.robot)
        self.units = [joint.unit for joint in joints_of(self.robot)]

    def jacobians(self, q_g: np.ndarray) -> np.ndarray:
        """Jacobians (n, k, n_g) of the output, lengths in multiples of the reach."""
        J = evaluate(self.equations.function("jacobian"), self._expand(q_g))[0]
        J = J.reshape(len(q_g), 6, -1)[:, :, list(self.robot.i_g)].copy()
        J[:, :3] /= self.reach
        J[:, :, [unit == "m" for unit in self.units]] *= self.reach
        return J[:, self.axes] if self.axes else J

    def dexterity(self, q_g: np.ndarray) -> np.ndarray:
        """Smallest singular value (n) of the Jacobian: 0 in a singular pose."""
        return np.linalg.svd(self.jacobians(q_g), compute_uv=False)[:, -1]

    def home(self) -> np.ndarray:
        """The pose (n_g) of largest dexterity among many, reduced by large angles."""
        poses = draw_poses(self.robot, CANDIDATES)
        low, high = ranges(self.robot)
        if low[0] <= 0.0 <= high[0]:
            poses[:, 0] = 0.0
        far = np.mean(np.abs(poses) / np.array([UNLIMITED[unit] for unit in self.units]), axis=1)
        return poses[np.argmax(self.dexterity(poses) * (1.0 - 0.4 * np.minimum(far, 1.0)))]

    def _expand(self, q_g: np.ndarray) -> np.ndarray:
        q = np.zeros((*q_g.shape[:-1], self.robot.n_a))
        q[..., list(self.robot.i_g)] = q_g
        return q

    def accept(self, move: Move, least: float) -> Kept | None:
        """The move with a duration for its joints and motors; None: the arm cannot do it.

        ``least``: dexterity at the start; the move keeps the part `STEADY` of it, 0: any.
        """
        try:
            motion = self._joints(move)
        except FlexgenError:
            return None
        q, v, a = motion
        if beyond_range(self.robot, q) or (least and self.dexterity(q).min() < STEADY * least):
            return None
        swing = np.ptp(q, axis=0)
        limit = np.array([SWING[unit] for unit in self.units])
        if move.type != "joint" and (swing > limit).any():
            return None
        return self._choose_duration(move, q, v, a)

    def _joints(self, move: Move) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Actuated coordinates and their first two derivatives (n, n_g)."""
        _, path = problem_of_move(self.equations, move, None, None)
        sample = path.sample(np.linspace(0.0, path.duration, INSTANTS))
        if sample.q_g is not None:
            return sample.q_g[:, :, 0], sample.q_g[:, :, 1], sample.q_g[:, :, 2]
        kinematics = InverseKinematics(self.equations)
        q = kinematics.follow(sample, np.array(move.start))
        v, a = kinematics.velocities(sample, q)
        return q, v, a

    def _choose_duration(
        self, move: Move, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> Kept | None:
        """The shortest duration, in steps of 0.1 s, with a margin of speeds and torques; None
        beyond `LONGEST`.

        ``q``, ``v``, ``a`` (n, n_g): joints of the move at its own duration [rad, m, s].
        """
        speeds, why = self._speed_limits()
        accelerations = np.array([ACCELERATION[unit] for unit in self.units])
        by_speed = float((np.abs(v).max(axis=0) / speeds).max()) * move.duration
        by_acceleration = float(np.sqrt((np.abs(a).max(axis=0) / accelerations).max()))
        duration = max(by_speed, by_acceleration * move.duration, 0.3)
        duration = math.ceil(10.0 * duration - 1e-9) / 10.0
        reason = why
        while duration <= LONGEST:
            slower = move.duration / duration
            use = self._torque_use(q, v * slower, a * slower**2)
            if use <= TORQUE_PART:
                return Kept(replace(move, duration=duration), reason)
            reason = f"motors need at most {100 * TORQUE_PART:g} % of their torque"
            duration = math.ceil(10.0 * duration * 1.15) / 10.0
        return None

    def _speed_limits(self) -> tuple[np.ndarray, str]:
        """Speeds (n_g) [rad/s or m/s] that moves keep, and why, in words for the file."""
        known = True
        speeds = []
        for k, joint in enumerate(joints_of(self.robot)):
            factors = np.abs(self.robot.eta[:, k])
            limits = [
                motor.speed_max / factor
                for motor, factor in zip(self.robot.motors, factors, strict=True)
                if motor.speed_max and factor
            ]
            if joint.dof is not None and joint.dof.speed_max:
                limits.append(joint.dof.speed_max)
            known &= bool(limits)
            usual = SPEED[joint.unit]
            speeds.append(min(usual, SPEED_PART * min(limits)) if limits else usual)
        part = f"{100 * SPEED_PART:g} % of the speeds of the motors, and "
        return (
            np.array(speeds),
            (
                f"{part if known else ''}at most {SPEED['rad']:g} rad/s, "
                f"{ACCELERATION['rad']:g} rad/s^2"
            ),
        )

    def _torque_use(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> float:
        """Largest torque of the rigid arm, its rotors and motor friction, as a part of its limit;
        ``q``, ``v``, ``a`` (n, n_g). 0 without limits.
        """
        robot = self.robot
        limits = np.array([motor.torque_max or np.inf for motor in robot.motors])
        if not np.isfinite(limits).any():
            return 0.0
        inverse = self.equations.function("inverse_dynamics")
        tau = evaluate(inverse, self._expand(q), self._expand(v), self._expand(a))[0]
        tau = tau.reshape(len(q), -1)[:, list(robot.i_g)]
        at_motor = np.linalg.solve(robot.eta.T, tau.T).T
        rotor = np.array([motor.inertia for motor in robot.motors]) * (a @ robot.eta.T)
        w = v @ robot.eta.T
        for k, motor in enumerate(robot.motors):
            viscous = getattr(motor.friction, "viscous", 0.0)
            coulomb = getattr(motor.friction, "coulomb", 0.0)
            rotor[:, k] += viscous * w[:, k] + coulomb * np.sign(w[:, k])
        return float((np.abs(at_motor + rotor) / limits).max())

    def moves(self, home: np.ndarray, tool: bool) -> Iterator[Kept]:
        """A line and a circle of the tool, and a move of all joints: those that the arm can do."""
        rest = np.zeros_like(home[None])
        if self._torque_use(home[None], rest, rest) > TORQUE_PART:
            return
        if tool:
            line = self._first(self._lines(home), float(self.dexterity(home[None])[0]))
            yield from [line] if line else []
            length = self.reach * SIZES[1]
            if line is not None:
                length = float(np.linalg.norm(line.move.displacement))
            least = float(self.dexterity(home[None])[0])
            circle = self._first(self._circles(home, ROUND * length), least)
            yield from [circle] if circle else []
        joints = self._first(self._turns(home), 0.0)
        yield from [joints] if joints else []

    def _first(self, moves: Iterator[Move], least: float) -> Kept | None:
        return next((kept for move in moves if (kept := self.accept(move, least))), None)

    def _lines(self, home: np.ndarray) -> Iterator[Move]:
        """Straight lines from home to try, the longest first, in each direction; their duration of
        1 s is chosen later.
        """
        start = tuple(map(float, home))
        for size in SIZES:
            for direction in self._directions():
                length = self._round(size * self.reach)
                displacement = tuple(float(x) for x in length * direction)
                yield Move("line", "tool_line", start, 1.0, SMOOTHNESS, displacement)

    def _circles(self, home: np.ndarray, radius: float) -> Iterator[Move]:
        """Circles through home to try, of ``radius`` [m] and parts of it, about each axis and on
        both sides.
        """
        start = tuple(map(float, home))
        size = self._round(radius)
        for part in (1.0, 0.5, 0.25):
            for one, other in combinations([i for i in range(3) if i in self._positions()], 2):
                for sign in (1.0, -1.0):
                    center = np.zeros(3)
                    axis = np.zeros(3)
                    center[other] = sign * size * part
                    axis[3 - one - other] = 1.0
                    yield Move(
                        "circle",
                        "tool_circle",
                        start,
                        1.5,
                        SMOOTHNESS,
                        center=tuple(map(float, center)),
                        axis=tuple(map(float, axis)),
                        angle=2.0 * math.pi,
                    )

    def _turns(self, home: np.ndarray) -> Iterator[Move]:
        """Moves of all joints from home to try, by smaller and smaller steps, with signs that
        change from joint to joint; a step beyond the range is turned round.
        """
        low, high = ranges(self.robot)
        start = tuple(map(float, home))
        for part in (1.0, 0.5, 0.25, 0.1):
            end = []
            for k, (value, unit) in enumerate(zip(home, self.units, strict=True)):
                step = part * TURN[unit] * (-1.0) ** k
                end.append(value + step if low[k] <= value + step <= high[k] else value - step)
            degree = [math.radians(1.0) if unit == "rad" else 1e-3 for unit in self.units]
            rounded = np.round(np.array(end) / degree) * degree
            yield Move("joints", "joint", start, 1.0, SMOOTHNESS, end=tuple(map(float, rounded)))

    def _positions(self) -> list[int]:
        return [i for i in self.axes if i < 3]

    def _directions(self) -> list[np.ndarray]:
        """Unit vectors in the axes of the output."""
        free = self._positions()
        inside = [x for x in _DIRECTIONS if all(i in free for i in np.flatnonzero(x))]
        return [x / np.linalg.norm(x) for x in inside]

    @staticmethod
    def _round(length: float) -> float:
        """A length [m] of two digits."""
        return float(f"{length:.2g}")


def choose_axes(equations: Equations) -> list[int]:
    """Rows of the Jacobian that n joints determine: a pose or positions; none: the joints.

    A tool that only turns about the vertical has its positions and that angle (row 5), where the
    reader of model files knows such an output.
    """
    robot = equations.model
    number = robot.n_g
    poses = draw_poses(robot, CANDIDATES // 10)
    sets: list[tuple[int, ...]] = []
    if number >= 6:
        sets = [tuple(range(6))]
    elif number <= 3:
        sets = list(combinations(range(3), number))
    found = _best_axes(equations, sets, poses)
    if found or not 3 <= number <= 4 or ANGLE not in TOOL:
        return found
    tilt = Arm(equations, (3, 4)).jacobians(poses)
    if np.abs(tilt).max() > UPRIGHT:
        return []
    turning = [(*positions, 5) for positions in combinations(range(3), number - 1)]
    return _best_axes(equations, turning, poses)


def _best_axes(
    equations: Equations, sets: Sequence[tuple[int, ...]], poses: np.ndarray
) -> list[int]:
    """The rows of largest dexterity; none: all are singular."""
    best = [float(np.median(Arm(equations, axes).dexterity(poses))) for axes in sets]
    return list(sets[int(np.argmax(best))]) if best and max(best) > DEXTEROUS else []
