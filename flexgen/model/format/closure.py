"""Closed loops in numbers: errors of the closure, their Jacobian, and the passive joints that
close the loops.

The two frames of a loop are compared in the frame of the last body that the branches to both have
in common, which no joint outside the loop moves:

    c(q_i, q_d) = 0,    dq_d = -c_d^-1 c_i dq_i

q_i: the coordinates, q_d: the passive joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.model.elements import Dof, Loop, LoopFrame, Placement, RobotModel

# Errors of a closure, in units of the size of the robot, that are rounding.
CLOSED = 1e-13
# Steps of the Newton iteration from one position; it converges in 4 to 15 where it does.
STEPS = 40
# Steps without a smaller error after which it has ended at an obstacle.
STALLED = 6
# Longest change of a passive joint in a step, in rad or sizes of the robot: an angle turns the
# direction of its lever by less than this.
LONGEST = 0.5
# Change of a coordinate, in rad or sizes of the robot, between two closures along a straight line:
# from each the next one is found on the same branch.
STRIDE = 0.1

IDENTITY = np.eye(3)
# A step along a branch: a constant pose, or a joint.
Step = Placement | Dof
Values = dict[str, float]


@dataclass(frozen=True)
class Branches:
    """The steps from the last common body of a loop to its two frames."""

    start: tuple[Step, ...]
    end: tuple[Step, ...]

    @property
    def joints(self) -> tuple[Dof, ...]:
        """The joints of both branches."""
        return tuple(step for step in (*self.start, *self.end) if isinstance(step, Dof))


def branches(model: RobotModel, loop: Loop) -> Branches:
    """The two `Branches` of a loop."""
    to_start = _elements_to(model, loop.start.element)
    to_end = _elements_to(model, loop.end.element)
    shared = sum(a == b for a, b in zip(to_start, to_end, strict=False))
    return Branches(
        _steps(model, to_start[shared:], loop.start), _steps(model, to_end[shared:], loop.end)
    )


def _elements_to(model: RobotModel, name: str) -> list[str]:
    """The elements from the base to one of them, base first."""
    found = [name]
    while found[0] != "base":
        found.insert(0, model.parents[found[0]])
    return found


def _steps(model: RobotModel, names: Sequence[str], frame: LoopFrame) -> tuple[Step, ...]:
    elements = {element.name: element for element in model.elements}
    steps: list[Step] = []
    for name in names:
        element = elements[name]
        steps += [element.origin, *element.dofs, element.link]
    return (*steps, frame)


def passive_joints(model: RobotModel) -> tuple[Dof, ...]:
    """The joints that closed loops move."""
    return tuple(
        dof for element in model.elements for dof in element.dofs if dof.passive is not None
    )


def shares(model: RobotModel) -> dict[str, dict[str, float]]:
    """Of each joint the factors of the coordinates and passive joints that it is the sum of."""
    dofs = [dof for element in model.elements for dof in element.dofs]
    return {dof.name: dict(dof.mimic) or {dof.name: 1.0} for dof in dofs}


def turn(axis: Sequence[float], angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about a unit axis (Rodrigues)."""
    x, y, z = axis
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out: np.ndarray = IDENTITY + np.sin(angle) * hat + (1.0 - np.cos(angle)) * hat @ hat
    return out


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``a x b`` (3,) of two vectors, faster than that of NumPy, which takes arrays of vectors."""
    x, y, z = a.tolist()
    u, v, w = b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


@dataclass(frozen=True)
class _End:
    """A frame at the end of a branch: position, rotation, and the axis, point and kind of each
    joint before it.
    """

    p: np.ndarray
    R: np.ndarray
    joints: tuple[tuple[Dof, np.ndarray, np.ndarray], ...]


def _walk(steps: Sequence[Step], values: Mapping[str, float]) -> _End:
    """The frame at the end of some steps, where joints have these ``values``."""
    p = np.zeros(3)
    R = IDENTITY
    joints: tuple[tuple[Dof, np.ndarray, np.ndarray], ...] = ()
    for step in steps:
        if isinstance(step, Placement):
            p = p + R @ np.array(step.position)
            R = R @ np.array(step.rotation)
            continue
        axis = R @ np.array(step.axis)
        joints = (*joints, (step, axis, p))
        if step.type == "rotation":
            R = R @ turn(step.axis, values[step.name])
        else:
            p = p + axis * values[step.name]
    return _End(p, R, joints)


def _columns(end: _End, sign: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Velocity and angular velocity (3,) of a frame for each of its joints."""
    out = {}
    for dof, axis, point in end.joints:
        if dof.type == "rotation":
            out[dof.name] = sign * cross(axis, end.p - point), sign * axis
        else:
            out[dof.name] = sign * axis, np.zeros(3)
    return out


@dataclass(frozen=True)
class Closure:
    """Errors of all loops (m,), [m] and sines of angles, and their derivatives in the joints.

    ``jacobian`` (m, n): columns of ``names``, coordinates and passive joints; ``gaps`` [m]: the
    distance of the origins of each loop.
    """

    error: np.ndarray
    jacobian: np.ndarray
    names: tuple[str, ...]
    gaps: np.ndarray

    def of(self, names: Sequence[str]) -> np.ndarray:
        """Columns of some joints."""
        return self.jacobian[:, [self.names.index(name) for name in names]]


def closure(model: RobotModel, values: Mapping[str, float]) -> Closure:
    """The `Closure` of a robot whose coordinates and passive joints have these ``values``."""
    sums = shares(model)
    joints = {name: sum(x * values[k] for k, x in own.items()) for name, own in sums.items()}
    names = tuple(dict.fromkeys(k for own in sums.values() for k in own))
    errors = []
    rows = []
    gaps = []
    for loop in model.loops:
        found = branches(model, loop)
        first, second = (_walk(steps, joints) for steps in (found.start, found.end))
        error = _error(loop.type, first, second)
        moved: dict[str, np.ndarray] = {}
        for end, sign in ((first, -1.0), (second, 1.0)):
            for name, (speed, spin) in _columns(end, sign).items():
                rate = _error_rate(loop.type, first, second, speed, spin)
                for k, x in sums[name].items():
                    moved[k] = moved.get(k, np.zeros(len(error))) + x * rate
        errors.append(error)
        rows.append(np.array([moved.get(k, np.zeros(len(error))) for k in names]).T)
        gaps.append(float(np.linalg.norm(second.p - first.p)))
    return Closure(np.concatenate(errors), np.vstack(rows), names, np.array(gaps))


def _error(kind: str, first: _End, second: _End) -> np.ndarray:
    """Errors of a loop: distance (3), and sines of the angles between axes (2 or 3)."""
    distance = second.p - first.p
    if kind == "point":
        return distance
    E = first.R.T @ second.R
    if kind == "axis":
        return np.array([*distance, E[0, 2], E[1, 2]])
    tilt = np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2.0
    return np.array([*distance, *tilt])


def _error_rate(
    kind: str, first: _End, second: _End, speed: np.ndarray, spin: np.ndarray
) -> np.ndarray:
    """Rate of `_error` where the second frame moves relative to the first one with ``speed`` and
    ``spin`` (3,).
    """
    if kind == "point":
        return speed
    E = first.R.T @ second.R
    own = first.R.T @ spin
    rate = np.array([cross(own, column) for column in E.T]).T
    if kind == "axis":
        return np.array([*speed, rate[0, 2], rate[1, 2]])
    tilt = [rate[2, 1] - rate[1, 2], rate[0, 2] - rate[2, 0], rate[1, 0] - rate[0, 1]]
    return np.array([*speed, *np.array(tilt) / 2.0])


def robot_size(model: RobotModel) -> float:
    """Largest length [m] of the loops, the unit of their errors."""
    lengths = [
        float(np.linalg.norm(step.position))
        for loop in model.loops
        for found in (branches(model, loop),)
        for step in (*found.start, *found.end)
        if isinstance(step, Placement)
    ]
    return max(lengths, default=0.0) or 1.0


def newton(model: RobotModel, values: Values) -> tuple[Values, float]:
    """Passive joints that close the loops, from those of ``values``, by a Gauss-Newton iteration
    with bounded steps; and the largest error that is left, in sizes of the robot.
    """
    passive = [dof.name for dof in passive_joints(model)]
    size = robot_size(model)
    units = np.array([1.0 if d.type == "rotation" else size for d in passive_joints(model)])
    best = dict(values)
    least = np.inf
    now = dict(values)
    stalled = 0
    for _ in range(STEPS):
        at = closure(model, now)
        error = float(np.abs(at.error).max()) / size
        stalled = 0 if error < least else stalled + 1
        if error < least:
            best = dict(now)
            least = error
        elif least < CLOSED or stalled == STALLED:
            break
        step = -np.linalg.lstsq(at.of(passive) * units, at.error, rcond=1e-12)[0]
        step *= min(1.0, LONGEST / max(float(np.abs(step).max(initial=0.0)), 1e-300))
        moved = np.array([now[k] for k in passive]) + step * units
        now |= dict(zip(passive, moved.tolist(), strict=True))
    return best, least


def home_values(model: RobotModel) -> Values:
    """Coordinates at home, with springs at rest, and the passive joints near which the file has
    them.
    """
    values = {c.name: 0.0 for c in model.coordinates}
    actuated = (model.coordinates[i].name for i in model.i_g)
    values |= dict(zip(actuated, model.home, strict=True))
    return values | {dof.name: float(dof.passive or 0.0) for dof in passive_joints(model)}


def home_closure(model: RobotModel) -> Values:
    """Coordinates and passive joints at home, of the configuration that the file selects."""
    values = home_values(model)
    return newton(model, values)[0] if model.loops else values


def closed_values(model: RobotModel, q_a: np.ndarray) -> Values:
    """Coordinates and passive joints at ``q_a`` (n_a,) [rad, m], on the branch of the home
    position: closed step by step along the straight line from there.

    Raises
    ------
    ArgumentError
        The loops cannot be closed on the way.
    """
    names = [coordinate.name for coordinate in model.coordinates]
    if not model.loops:
        return dict(zip(names, q_a.tolist(), strict=True))
    values = home_closure(model)
    start = np.array([values[name] for name in names])
    way = np.asarray(q_a, float) - start
    count = max(1, int(np.ceil(np.abs(way).max(initial=0.0) / STRIDE)))
    size = robot_size(model)
    for k in range(1, count + 1):
        here = dict(zip(names, (start + way * (k / count)).tolist(), strict=True))
        values, error = newton(model, values | here)
        if not error < 1e3 * CLOSED:
            worst = model.loops[int(np.argmax(closure(model, values).gaps))]
            raise ArgumentError(
                f"model {model.name}: given coordinates at which its closed loop {worst.name} is "
                f"open by {error * size:.3g} m, expected coordinates at which it can be closed"
            )
    return values


def dependence(model: RobotModel, values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Derivatives of every joint in the coordinates, by the names of both, where loops are
    closed.
    """
    names = [coordinate.name for coordinate in model.coordinates]
    out = {name: {name: 1.0} for name in names}
    if model.loops:
        at = closure(model, values)
        passive = [dof.name for dof in passive_joints(model)]
        slopes = -np.linalg.lstsq(at.of(passive), at.of(names), rcond=1e-12)[0]
        out |= {
            name: dict(zip(names, row.tolist(), strict=True))
            for name, row in zip(passive, slopes, strict=True)
        }
    for name, own in shares(model).items():
        if own != {name: 1.0}:
            out[name] = {k: x for k, x in own.items() if k in names}
    return out
