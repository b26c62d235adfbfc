"""Poses of the tool as the ends of joint moves, and joint configurations, in the tables of moves and programs."""

from __future__ import annotations

from collections.abc import Sequence

from flexgen.model.checked_table import Table
from flexgen.model.component_tables import rotation_matrix
from flexgen.model.elements import Coordinate
from flexgen.model.moves import PoseTarget

POSE_KEYS = ("position", "rpy_rad", "rpy_deg", "configuration", "turns")
MOST_TURNS = 100


def read_target(table: Table, actuated: Sequence[Coordinate]) -> PoseTarget | None:
    """Read the pose that a joint move ends at; None where its table has no key of a pose."""
    given = [key for key in POSE_KEYS if key in table]
    if not given:
        return None
    if table.unit_key("end", required=False) is not None:
        raise table.fail(given[0], "either end or a pose of the tool", "both")
    if len(actuated) != 6:
        names = ", ".join(c.name for c in actuated)
        raise table.fail(
            given[0], f"end, because the arm has not six actuated coordinates but {len(actuated)}: {names}"
        )
    position = table.vector("position", 3, what="m, world axes and origin")
    key = table.unit_key("rpy", required=True)
    assert key is not None
    orientation = rotation_matrix(table.vector(key, 3, what="roll, pitch, yaw"), key.endswith("_deg"))
    return PoseTarget(position, orientation, read_configuration(table), _turns(table, actuated))


def read_configuration(table: Table) -> tuple[int, ...]:
    """Read the signs of shoulder, elbow and wrist; empty if the key is missing."""
    if "configuration" not in table:
        return ()
    values = table.vector("configuration", 3, what="signs of shoulder, elbow and wrist")
    if not all(value in (-1.0, 1.0) for value in values):
        raise table.fail("configuration", "1 or -1 for each of shoulder, elbow and wrist")
    return tuple(int(value) for value in values)


def _turns(table: Table, actuated: Sequence[Coordinate]) -> tuple[int, ...]:
    """Read the whole turns of each joint; empty if the key is missing."""
    if "turns" not in table:
        return ()
    values = table.vector("turns", len(actuated), what="whole turns of " + ", ".join(c.name for c in actuated))
    if not all(value == int(value) and abs(value) <= MOST_TURNS for value in values):
        raise table.fail("turns", f"whole numbers from -{MOST_TURNS} to {MOST_TURNS}")
    for c, value in zip(actuated, values, strict=True):
        if value and c.unit != "rad":
            raise table.fail("turns", f"0 for {c.name}, which is a length")
    return tuple(int(value) for value in values)
