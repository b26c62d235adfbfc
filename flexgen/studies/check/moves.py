"""Checks of the moves of a model: can they be planned, within the ranges and speeds of joints and
motors?
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flexgen.base.errors import FlexgenError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import make_holder
from flexgen.model.elements import RobotModel
from flexgen.model.friction import steepness
from flexgen.model.moves import Move
from flexgen.paths.path import CHECKED, FEWEST, Path, joints_along
from flexgen.studies.check.finding import ERROR, MARKS, OK, UNUSUAL, Finding, make_finding
from flexgen.studies.check.numbers import (
    HOME,
    MOVE_SPEED,
    MOVE_SPEED_TRANSLATION,
    REVERSAL,
    report_still,
)

SAMPLE = 1e-3  # s: usual sample time of drives and controllers
POSES = 5  # of a move, at which springs and the torques that hold the arm are checked

# Advice for an output that no torques can make follow a path.
FEWER = (
    'type = "joint"; of the tool "tool_position", or "tool_position_angle" with its rotation '
    "about one axis"
)


def moves(equations: Equations, home: Sequence[Finding] = ()) -> Iterator[Finding]:
    """The findings of all moves and programs; those of the pose at ``home`` are not repeated."""
    robot = equations.model
    if robot.output.size > robot.n_m:
        yield Finding(
            ERROR,
            "output",
            "number of outputs",
            f"{robot.output.size} outputs, {robot.n_m} motors",
            "at most as many outputs as motors",
            FEWER,
            99.0,
        )
        return
    changes = np.zeros(robot.n_m)
    still = _Still(equations, {(one.key, _plain(one)): _size(one) for one in home})
    for move in (*robot.moves, *robot.programs):
        key = f"{'program' if move in robot.programs else 'move'}.{move.name}"
        try:
            found = _joints(equations, move)
        except FlexgenError as error:
            advice = "start, displacement or end of the move; lengths of the arm in m"
            yield Finding(
                ERROR,
                key,
                "path of the arm without deflections",
                str(error),
                "a path",
                advice,
                99.0,
            )
            continue
        if found is None:
            yield Finding(
                OK, key, "range of the joints", "not checked: more joints than outputs", "-"
            )
            continue
        yield _range(robot, key, found[0])
        yield from _speeds(robot, key, found[1])
        changes = np.maximum(changes, found[2])
        yield from still.findings(key, found[0])
    yield from _reversals(robot, changes)


def _plain(finding: Finding) -> str:
    """The quantity of a finding without the place at which it was found."""
    return finding.quantity.partition(f" {HOME}")[0].partition(" in the ")[0]


def _size(finding: Finding) -> tuple[int, float]:
    """Mark and distance of a finding, larger for worse ones."""
    return MARKS.index(finding.mark), finding.distance


class _Still:
    """Springs and motors that hold the arm at poses of the moves."""

    def __init__(
        self, equations: Equations, known: dict[tuple[str, str], tuple[int, float]]
    ) -> None:
        """``known``: for each finding at home, by its key and quantity, how far it is from the
        usual.
        """
        self.equations = equations
        self.known = known
        self.hold = make_holder(equations)
        self.mass_matrix = equations.function("mass_matrix")

    def findings(self, key: str, q_g: np.ndarray) -> Iterator[Finding]:
        """Findings with a worse mark at a pose of the move than before; else that there is none.

        ``key``: ``"move.<name>"`` or ``"program.<name>"``; ``q_g`` (n, n_g): its joints [rad, m],
        of which `POSES` are judged.
        """
        kind, _, name = key.partition(".")
        robot = self.equations.model
        worst = dict[tuple[str, str], Finding]()
        rows = np.linspace(0, len(q_g) - 1, min(POSES, len(q_g))).round().astype(int)
        for pose in q_g[rows]:
            try:
                rest = self.hold(pose, None)
            except FlexgenError as error:
                advice = "stiffness of the springs without motor, masses, gravity"
                text = "equilibrium at a pose of it"
                yield Finding(ERROR, key, text, str(error), "one", advice, 9.0)
                return
            M = evaluate(self.mass_matrix, rest.q_a)[0].reshape(robot.n_a, robot.n_a)
            for finding in report_still(robot, M, rest, f"in the {kind} {name}"):
                place = finding.key, _plain(finding)
                before = self.known.get(place, (0, 0.0))
                farther = place not in worst or _size(finding) > _size(worst[place])
                if farther and _size(finding)[0] > before[0]:
                    worst[place] = finding
        self.known |= {place: _size(finding) for place, finding in worst.items()}
        yield from worst.values()
        if not worst:
            text = "springs, and motors that hold it"
            yield Finding(OK, key, text, f"as at home at {len(rows)} poses", "as at home")


def _joints(equations: Equations, move: Move) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Actuated coordinates and their speeds (n, n_g) along a move, and `_changes`.

    None where the output does not determine them.
    """
    path = Path(equations, move)
    found = list(joints_along(path, speeds=True))
    if not found:
        return None
    q_g, v_g = (np.concatenate(values) for values in zip(*found, strict=True))
    return q_g, v_g, _changes(path, [v @ equations.model.eta.T for _, v in found])


def _changes(path: Path, speeds: list[np.ndarray]) -> np.ndarray:
    """Largest speed change of each motor in a sample of 1 ms with a reversal, (n_m,) [rad/s]."""
    count = CHECKED if len(path.segments) == 1 else max(FEWEST, CHECKED // len(path.segments))
    times = [segment.instants(count) for segment in path.segments]
    largest = np.zeros(speeds[0].shape[1])
    if [len(t) for t in times] != [len(v) for v in speeds]:
        # motions that the output does not determine are left out
        return largest
    for t, v in zip(times, speeds, strict=True):
        rates = np.abs(np.diff(v, axis=0)) / np.diff(t)[:, None]
        turning = np.where(v[:-1] * v[1:] < 0.0, rates, 0.0).max(axis=0, initial=0.0)
        largest = np.maximum(largest, SAMPLE * turning)
    return largest


def _reversals(robot: RobotModel, changes: np.ndarray) -> Iterator[Finding]:
    """Whether the friction of each motor changes its sign within a sample of 1 ms at a reversal.

    ``changes`` (n_m,) [rad/s]: see `_changes`; 0: the motor does not reverse. Laws of friction
    without ``beta`` have no finding.
    """
    for motor, change in zip(robot.motors, changes, strict=True):
        beta = steepness(motor.friction)
        if not beta or not change:
            continue
        advice = (
            f"beta at most {REVERSAL.high / change:.2g} s/rad for samples of 1 ms along these "
            "moves (1/beta is the speed at which the friction is 76 % developed); or a controller "
            "that samples faster"
        )
        text = "beta times the change of the motor speed in 1 ms at a reversal of the moves"
        key = f"motor.{motor.name}.friction.beta"
        yield make_finding(key, text, beta * float(change), "", REVERSAL, advice)


def _range(robot: RobotModel, key: str, q_g: np.ndarray) -> Finding:
    """Whether each joint stays between its limits; ``q_g`` (n, n_g): joints of the move ``key``
    [rad, m].
    """
    beyond = []
    for k, i in enumerate(robot.i_g):
        joint = robot.coordinates[i]
        assert joint.dof is not None
        low = float(q_g[:, k].min())
        high = float(q_g[:, k].max())
        for limit, value, side in ((joint.dof.lower, low, -1.0), (joint.dof.upper, high, 1.0)):
            if limit is not None and side * (value - limit) > 1e-9:
                beyond.append(
                    f"{joint.name} reaches {value:.4g} {joint.unit}, limit {limit:.4g} "
                    f"{joint.unit}"
                )
    if not beyond:
        return Finding(OK, key, "range of the joints", "within the limits", "within the limits")
    advice = "start and displacement of the move, lower and upper of the joint (_deg or _rad)"
    return Finding(
        ERROR, key, "range of the joints", "; ".join(beyond), "within the limits", advice, 1.0
    )


def _speeds(robot: RobotModel, key: str, v_g: np.ndarray) -> Iterator[Finding]:
    """The fastest joint, and joints and motors beyond their own limits; ``v_g`` (n, n_g): joint
    speeds of the move ``key`` [rad/s, m/s].
    """
    fastest = np.abs(v_g).max(axis=0)
    v_m = np.abs(v_g @ robot.eta.T).max(axis=0)
    advice = "duration of the move in s, its displacement in m, angles in _deg or _rad"
    for unit, usual in (("rad", MOVE_SPEED), ("m", MOVE_SPEED_TRANSLATION)):
        of_unit = [k for k, i in enumerate(robot.i_g) if robot.coordinates[i].unit == unit]
        if of_unit:
            speed = max(float(fastest[k]) for k in of_unit)
            yield make_finding(key, "largest joint speed", speed, f"{unit}/s", usual, advice)
    joints = [robot.coordinates[i] for i in robot.i_g]
    rows = [
        (j.name, j.dof.speed_max, float(v), f"{j.unit}/s")
        for j, v in zip(joints, fastest, strict=True)
        if j.dof
    ]
    rows += [
        (m.name, m.speed_max, float(v), "rad/s") for m, v in zip(robot.motors, v_m, strict=True)
    ]
    over = [
        f"{name} {v:.4g} {unit}, limit {limit:.4g}"
        for name, limit, v, unit in rows
        if limit and v > limit
    ]
    if over:
        text = "; ".join(over)
        yield Finding(
            UNUSUAL,
            key,
            "speeds",
            text,
            "within the limits",
            f"speed_max (rad/s, not rpm); {advice}",
            0.5,
        )
