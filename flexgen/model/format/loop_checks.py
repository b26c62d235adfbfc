"""Checks of the closed loops of a robot at its home position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexgen.base.spec.tables import Table
from flexgen.model.elements import Dof, RobotModel
from flexgen.model.format.closure import (
    CLOSED,
    Values,
    branches,
    closure,
    home_values,
    newton,
    passive_joints,
    robot_size,
)

# Condition number of the closure in the passive joints above which a loop is refused: a lever
# whose direction is within about 0.1 deg of a dead center.
CONDITION_MAX = 1e3
# Singular values below this part of the largest one are zero.
RANK = 1e-9
# Positions from which further configurations are looked for.
STARTS = 16
# Changes of the coordinates, in rad or sizes of the robot, at which the rank is compared with that
# at home: a loop that closes at home alone has another one.
NEAR = 0.05
# Two positions of a joint, in rad or sizes of the robot, that are one.
SAME = 1e-6
# A second configuration that is not farther than this many distances of the selected one from the
# position in the file leaves the choice open.
CLEARLY = 2.0
# Errors of a given position, in rad or sizes of the robot, that a hand drawing has.
ROUGH = 0.02


def check_loops(root: Table, model: RobotModel) -> None:
    """Raise an error for closed loops that do not determine the passive joints, with its number.

    They cannot be assembled at home, or have more or fewer independent equations than passive
    joints, are near a singular position, or have two configurations near the one that is given.
    """
    tables = _joint_tables(root)
    passive = passive_joints(model)
    inside = {dof.name for loop in model.loops for dof in branches(model, loop).joints}
    for dof in passive:
        if dof.name not in inside:
            raise tables[dof.name].fail(
                "passive", "a joint of a closed loop: a table [[loop]] whose two bodies it moves"
            )
    if not model.loops:
        return
    _check_beams(root, model)
    values, error = newton(model, home_values(model))
    if not error < 1e3 * CLOSED:
        values, error = _find_closed(model, values, error)
    if not error < 1e3 * CLOSED:
        _check_rank(root, model, values)
        _fail_open(root, model, values)
    found = _configurations(model, values)
    values = found[0]
    _check_rank(root, model, values)
    _check_condition(root, model, values)
    _check_mobility(root, model, values)
    _check_choice(tables, model, found)


def _joint_tables(root: Table) -> dict[str, Table]:
    """The tables of all joints, by name."""
    return {
        dof.text("name"): dof
        for element in root.tables("element")
        for dof in element.tables("dof", required=False)
    }


def _check_beams(root: Table, model: RobotModel) -> None:
    """Raise an error for an elastic beam inside a loop."""
    beams = {e.name for e in model.elements if e.beam is not None}
    for table, loop in zip(root.tables("loop"), model.loops, strict=True):
        for key, frame in (("from", loop.start), ("to", loop.end)):
            name = frame.element
            while name != "base":
                if name in beams:
                    raise table.fail(
                        key, "a body that no elastic beam carries", f"a body behind beam {name}"
                    )
                name = model.parents[name]


def _fail_open(root: Table, model: RobotModel, values: Values) -> None:
    """Raise the error of loops that cannot be assembled."""
    gaps = closure(model, values).gaps
    worst = int(np.argmax(gaps))
    table = root.tables("loop")[worst]
    if gaps[worst] < 1e3 * CLOSED * robot_size(model):
        raise table.fail(
            None,
            "axes that can coincide",
            "a loop that cannot be assembled at home: its axes stay apart",
        )
    raise table.fail(
        None,
        "lengths and positions with which its frames can coincide",
        "a loop that cannot be assembled at home: its frames stay at least "
        f"{gaps[worst]:.6g} m apart",
    )


def _find_closed(model: RobotModel, values: Values, error: float) -> tuple[Values, float]:
    """The position with the least error from several starts."""
    for start in _starts(model):
        found, other = newton(model, values | start)
        if other < error:
            values = found
            error = other
        if error < 1e3 * CLOSED:
            break
    return values, error


def _units(model: RobotModel, joints: Sequence[Dof]) -> np.ndarray:
    size = robot_size(model)
    return np.array([1.0 if dof.type == "rotation" else size for dof in joints])


def _starts(model: RobotModel) -> list[Values]:
    """Drawn positions of the passive joints."""
    rng = np.random.default_rng(0)
    passive = passive_joints(model)
    units = _units(model, passive)
    near = np.array([float(dof.passive or 0.0) for dof in passive])
    drawn = near + rng.uniform(-np.pi, np.pi, (STARTS, len(passive))) * np.where(
        units == 1.0, 1.0, units / np.pi
    )
    names = [dof.name for dof in passive]
    return [dict(zip(names, row.tolist(), strict=True)) for row in drawn]


def _distance(model: RobotModel, values: Values) -> float:
    """Largest difference of the passive joints from the positions of the file, in rad or sizes of
    the robot.
    """
    passive = passive_joints(model)
    given = np.array([values[dof.name] - float(dof.passive or 0.0) for dof in passive])
    return float(np.abs(given / _units(model, passive)).max(initial=0.0))


def _configurations(model: RobotModel, values: Values) -> list[Values]:
    """Configurations that close the loops at home, angles within half a turn of those of the file,
    the nearest one first.
    """
    passive = passive_joints(model)
    found = [values]
    for start in _starts(model):
        other, error = newton(model, values | start)
        if not error < 1e3 * CLOSED:
            continue
        for dof in passive:
            if dof.type == "rotation":
                turns = round((other[dof.name] - float(dof.passive or 0.0)) / (2.0 * np.pi))
                other[dof.name] -= 2.0 * np.pi * turns
        gaps = [
            np.abs([(other[d.name] - one[d.name]) for d in passive] / _units(model, passive)).max()
            for one in found
        ]
        if min(gaps) > SAME:
            found.append(other)
    return sorted(found, key=lambda one: _distance(model, one))


def _check_choice(tables: dict[str, Table], model: RobotModel, found: list[Values]) -> None:
    """Raise an error where the position of the file does not select one configuration."""
    if len(found) < 2:
        return
    first, second = (_distance(model, one) for one in found[:2])
    if first < ROUGH or second > CLEARLY * first:
        return
    passive = passive_joints(model)
    apart = [abs(found[0][dof.name] - found[1][dof.name]) for dof in passive]
    dof = passive[int(np.argmax(apart / _units(model, passive)))]
    shown = [
        f"{np.degrees(one[dof.name]):.4g} deg"
        if dof.type == "rotation"
        else f"{one[dof.name]:.4g} m"
        for one in found[:2]
    ]
    raise tables[dof.name].fail(
        "passive",
        f"a position nearer to one of the two configurations, {shown[0]} or {shown[1]}",
        "a position that selects neither",
    )


def _check_rank(root: Table, model: RobotModel, values: Values) -> None:
    """Raise an error where the equations and the passive joints are not as many."""
    passive = [dof.name for dof in passive_joints(model)]
    at = closure(model, values)
    rank = _rank(at.jacobian)
    table = root.tables("loop")[0]
    counts = f"{rank} independent equations of the loops, {len(passive)} passive joints"
    if rank > len(passive):
        raise table.fail(
            None,
            "as many passive joints: the loops are over-constrained",
            counts,
        )
    if _rank(at.of(passive)) < len(passive) and rank < len(passive):
        raise table.fail(None, "as many equations: the loops leave passive joints free", counts)


def _check_mobility(root: Table, model: RobotModel, values: Values) -> None:
    """Raise an error where the loops open as soon as a coordinate moves."""
    size = robot_size(model)
    rng = np.random.default_rng(0)
    for coordinate in model.coordinates:
        unit = 1.0 if coordinate.unit == "rad" else size
        moved = {coordinate.name: values[coordinate.name] + NEAR * unit * rng.uniform(0.5, 1.0)}
        _, error = newton(model, values | moved)
        if not error < 1e3 * CLOSED:
            raise root.tables("loop")[0].fail(
                None,
                "loops that stay closed where the coordinates move",
                f"loops that open by {error * size:.3g} m where {coordinate.name} moves by "
                f"{moved[coordinate.name] - values[coordinate.name]:.3g} {coordinate.unit}",
            )


def _rank(A: np.ndarray) -> int:
    s = np.linalg.svd(A, compute_uv=False)
    return int(np.sum(s > RANK * max(float(s.max(initial=0.0)), 1e-300)))


def _check_condition(root: Table, model: RobotModel, values: Values) -> None:
    """Raise an error near a dead center, where the passive joints are hardly determined."""
    joints = passive_joints(model)
    at = closure(model, values)
    A = at.of([dof.name for dof in joints]) * _units(model, joints)
    s = np.linalg.svd(A, compute_uv=False)
    least = s[len(joints) - 1] if len(s) >= len(joints) else 0.0
    condition = float(s[0] / least) if least > 0.0 else np.inf
    if condition > CONDITION_MAX:
        raise root.tables("loop")[0].fail(
            None,
            f"a home position whose closure has a condition number up to {CONDITION_MAX:g}: "
            "farther from a dead center",
            f"a condition number of {condition:.3g} of the closure at home",
        )
