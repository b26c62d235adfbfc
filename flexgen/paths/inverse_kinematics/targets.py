"""The joints of a pose of the tool that a move ends at: of all configurations the one that is
asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flexgen.base.errors import SolverError
from flexgen.model.elements import RobotModel
from flexgen.model.moves import PoseTarget
from flexgen.paths.inverse_kinematics.search import (
    JOINTS,
    SINGULAR,
    Configuration,
    configuration_at,
    kinematics,
)

TURN = 2 * np.pi
SLACK = 1e-9  # rad or m beyond a limit of a joint: rounding

Failure = Callable[[str, object, str], Exception]  # of a key, what was given, what is expected


def joints_of_target(
    model: RobotModel, target: PoseTarget, before: np.ndarray, wrong: Failure
) -> np.ndarray:
    """Actuated coordinates (n_g,) [rad or m] of the undeflected arm at a pose, in the
    configuration that is asked for.

    Parameters
    ----------
    model : RobotModel
        With six actuated coordinates.
    target : PoseTarget
    before : array (n_g,)
        Where the move begins; without ``turns`` each joint takes the turn within its limits that
        is closest to it.
    wrong : callable
        Makes the error of a key: ``configuration``, ``turns``, ``position`` or ``orientation``.

    Raises
    ------
    Exception
        That of ``wrong``: no configuration reaches the pose, the arm is singular there, none is as
        asked and within the limits, or several are.
    """
    _check(model, target, wrong)
    position = np.array(target.position, float)
    rotation = np.array(target.orientation, float)
    try:
        found = kinematics(model, position, rotation)
    except SolverError:
        raise wrong("position", target.position, "a pose where the arm is not singular") from None
    if not found:
        raise wrong(
            "position", target.position, "a pose that the tool can reach with this orientation"
        )
    asked = [c for c in found if not target.configuration or c.flags == target.configuration]
    if not asked:
        raise wrong("configuration", list(target.configuration), _choices(found))
    singular = min(asked, key=lambda c: c.distance)
    if singular.distance < SINGULAR:
        part = f" of the {singular.nearest_singularity}" if singular.nearest_singularity else ""
        raise wrong(
            "position", target.position, f"a pose that is farther from the singularity{part}"
        )
    placed = [(c, choose_turns(model, c.q, before, target.turns)) for c in asked]
    inside = [(c, q) for c, q in placed if q is not None]
    if not inside:
        key = "turns" if target.turns else "configuration" if target.configuration else "position"
        given = list(target.turns or target.configuration or target.position)
        raise wrong(key, given, f"joints within their limits; {_choices(found)}")
    if len(inside) > 1:
        raise wrong(
            "configuration",
            list(target.configuration) or "none",
            _choices([c for c, _ in inside])
            if not target.configuration
            else (
                f"the joints as end, because {len(inside)} solutions within the limits have "
                "these signs"
            ),
        )
    return np.asarray(inside[0][1])


def check_configuration(
    model: RobotModel, q_g: np.ndarray, configuration: Sequence[int], wrong: Failure
) -> None:
    """Refuse joints (n_g,) that are in another ``configuration`` than the one of three signs that
    is asked for, see `Configuration.flags`; ``wrong`` makes the error from key, given value and
    expected one.
    """
    if len(model.i_g) != JOINTS:
        raise wrong(
            "configuration",
            list(configuration),
            "none, because the arm has not six actuated coordinates",
        )
    if len(configuration) != 3 or not all(sign in (1, -1) for sign in configuration):
        raise wrong(
            "configuration", list(configuration), "1 or -1 for each of shoulder, elbow and wrist"
        )
    own = configuration_at(model, q_g)
    if not own.flags:
        raise wrong(
            "configuration", list(configuration), "none, because the arm has not six rotations"
        )
    if own.flags != tuple(configuration):
        expected = (
            f"{list(own.flags)}, in which the joints are here: a move of the tool cannot change it"
        )
        raise wrong("configuration", list(configuration), expected)


def _check(model: RobotModel, target: PoseTarget, wrong: Failure) -> None:
    """Raise the error of an invalid target."""
    if len(model.i_g) != JOINTS:
        raise wrong(
            "position", target.position, "end, because the arm has not six actuated coordinates"
        )
    if len(target.position) != 3 or not np.isfinite(target.position).all():
        raise wrong("position", target.position, "3 finite numbers")
    R = np.array(target.orientation, dtype=float)
    if R.shape != (3, 3) or not np.abs(R @ R.T - np.eye(3)).max() < 1e-6 or np.linalg.det(R) < 0:
        raise wrong("orientation", target.orientation, "a rotation matrix")
    if target.configuration and (
        len(target.configuration) != 3 or not all(sign in (1, -1) for sign in target.configuration)
    ):
        raise wrong(
            "configuration",
            list(target.configuration),
            "1 or -1 for each of shoulder, elbow and wrist",
        )
    if target.configuration and not all(model.coordinates[i].unit == "rad" for i in model.i_g):
        raise wrong(
            "configuration",
            list(target.configuration),
            "none, because the arm has not six rotations",
        )
    if target.turns and (
        len(target.turns) != len(model.i_g) or not all(k == int(k) for k in target.turns)
    ):
        raise wrong("turns", list(target.turns), f"{len(model.i_g)} whole numbers")


def choose_turns(
    model: RobotModel, q: np.ndarray, before: np.ndarray, turns: Sequence[int]
) -> np.ndarray | None:
    """The angles ``q`` (n_g,) [rad or m] with the given whole ``turns``, or with those closest to
    ``before`` (n_g,); None where one is beyond its limits.

    Without ``turns`` the two next turns to each side are tried, and the closest within the limits
    is taken; lengths stay as they are.
    """
    out = q.copy()
    for k, i in enumerate(model.i_g):
        c = model.coordinates[i]
        low = -np.inf if c.dof is None or c.dof.lower is None else c.dof.lower
        high = np.inf if c.dof is None or c.dof.upper is None else c.dof.upper
        if c.unit == "rad":
            least = np.remainder(q[k] + np.pi, TURN) - np.pi
            closest = round((before[k] - least) / TURN)
            tried = (
                [turns[k]]
                if turns
                else sorted(range(closest - 2, closest + 3), key=lambda n: abs(n - closest))
            )
            # of the turns within the limits the one that is closest to the start
            angles = sorted(
                (least + TURN * n for n in tried), key=lambda angle: abs(angle - before[k])
            )
        else:
            angles = [float(out[k])]
        fitting = [angle for angle in angles if low - SLACK <= angle <= high + SLACK]
        if not fitting:
            return None
        out[k] = fitting[0]
    return out


def _choices(found: Sequence[Configuration]) -> str:
    """The configurations of a pose in words."""
    signs = sorted({c.flags for c in found if c.within_limits}, reverse=True)
    if not any(signs):
        return "one of its configurations within the limits; give the joints as end"
    return (
        "one of the configurations "
        + ", ".join(str(list(one)) for one in signs)
        + " (shoulder, elbow, wrist)"
    )
