"""Arms with more motors than outputs: a move becomes a motion of all joints, which are then the
outputs.

A joint move determines all joints. A move of the tool does not: the joints change as little as
possible, or as the posture of the move says (`flexgen.paths.geometry.joint_follower`). Where all
coordinates have a motor, the joints are the outputs: the torques follow their motion exactly, and
with it the tool. Where others have none, as the tilt of a carriage, the outputs are those of the
tool and as many joints as motors are left: the torques follow the path of the tool exactly, with
the deflections. A model file that names these joints itself (``joints`` of its output) has as many
outputs as motors, and needs nothing of this.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np
from scipy.linalg import qr

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.model.elements import Output, RobotModel
from flexgen.model.moves import Move, Posture
from flexgen.paths.geometry.joint_follower import (
    SINGULAR,
    Follower,
    check_posture,
    joint_segments,
)
from flexgen.paths.path import Path
from flexgen.paths.timing.timed_segments import JointMotion, TimedSegment

# instants of each motion at which the outputs of tool and joints are checked to be independent
CHECKED = 33


def is_redundant(model: RobotModel) -> bool:
    """Whether the outputs do not determine the joints: fewer outputs than motors."""
    return model.output.size < model.n_g == model.n_m


def problem_of_move(
    equations: Equations, move: Move, fixed_joint: str | None, log: Callable[[str], None] | None
) -> tuple[Equations, Path]:
    """The path of a move, and its equations: with all joints as outputs where the outputs do not
    determine them.

    ``fixed_joint``: see `joint_problem`; ArgumentError for another arm. ``log``: for messages.
    """
    model = equations.model
    if not is_redundant(model):
        if fixed_joint is not None and model.output.is_with_joints:
            move = replace(move, posture=Posture.hold(fixed_joint))
        elif fixed_joint is not None:
            expected = "None, because the outputs determine all joints"
            raise ArgumentError(
                f"fixed_joint: given {fixed_joint!r} for model {model.name}, expected {expected}"
            )
        return equations, Path(equations, move)
    joints, path = joint_problem(equations, move, fixed_joint)
    if log is not None:
        rule = f", {path.move.rule}" if isinstance(path.move, JointMotion) else ""
        log(
            f"{model.output.size} outputs, {model.n_m} motors: the outputs of this move are all "
            f"joints{rule}"
        )
    return joints, path


def joint_problem(
    equations: Equations, move: Move, fixed_joint: str | None = None
) -> tuple[Equations, Path]:
    """The equations with all joints as outputs, and the path of these.

    Parameters
    ----------
    equations : Equations
        Of a model with more motors than outputs.
    move : Move
    fixed_joint : str, optional
        An actuated coordinate that does not move in a move of the tool.

    Raises
    ------
    ArgumentError
        The joint is unknown, or the posture of the move does not fit the model.
    SolverError
        The path leaves the workspace or passes a singular pose.
    """
    model = equations.model
    names = [model.coordinates[i].name for i in model.i_g]
    if fixed_joint is not None and fixed_joint not in names:
        raise ArgumentError(
            f"fixed_joint: given {fixed_joint!r}, expected one of {', '.join(names)}"
        )
    joints = derive(_with_joint_outputs(model))
    if move.type == "joint" or isinstance(move, JointMotion):
        return joints, Path(joints, move)
    path = Path(equations, move)
    spaces = {segment.space for segment in path.segments}
    posture = move.posture if fixed_joint is None else Posture.hold(fixed_joint)
    if posture is not None:
        check_posture(model, posture, move.name)
    q_g = path.q_start[list(model.i_g)]
    segments, follower = joint_segments(equations, path.segments, q_g, posture)
    if spaces != {"joint"} and model.n_e:
        joints = derive(_with_joints(follower, segments))
    rule = "least change of the joints" + (f", {posture.text}" if posture is not None else "")
    common = {field.name: getattr(path.move, field.name) for field in fields(Move)}
    return joints, Path(joints, JointMotion(**common, segments=tuple(segments), rule=rule))


def _with_joint_outputs(model: RobotModel) -> RobotModel:
    """The model with all its actuated coordinates as outputs."""
    rows = tuple(tuple(float(i == k) for k in range(model.n_a)) for i in model.i_g)
    units = {model.coordinates[i].unit for i in model.i_g}
    return replace(
        model, output=Output("combination", "", rows, units.pop() if len(units) == 1 else "mixed")
    )


def _with_joints(follower: Follower, segments: Sequence[TimedSegment]) -> RobotModel:
    """The model with joints as outputs after those of the tool, as many outputs as motors.

    They are those that, in the middle of the path, move most in the motions of the joints at which
    the tool rests.
    """
    model = follower.model
    i_g = list(follower.model.i_g)
    q = np.concatenate(
        [
            s.at(s.start + s.law.duration * np.linspace(0.0, 1.0, CHECKED))[0][:, :, 0]
            for s in segments
        ]
    )
    W = np.array([follower.jacobian(x) for x in q])
    spare = np.linalg.svd(W[len(W) // 2])[2][model.output.size :]
    held = np.flatnonzero(~follower.free)
    # a joint that is kept is an output; of the others those that move most while the tool rests
    order = [k for k in qr(spare, pivoting=True)[2] if k not in held]
    chosen = sorted([*held, *order][: len(spare)])
    sums = np.eye(len(i_g))[chosen]
    sizes = np.array([np.linalg.svd(np.vstack([one, sums]), compute_uv=False) for one in W])
    if not (sizes[:, -1] > SINGULAR * sizes[:, 0]).all():
        raise SolverError(
            "redundant arm: the joints that the tool leaves free change too much along the path; "
            "shorten it, or keep a joint (fixed_joint, --fixed-joint)"
        )
    rows = np.zeros((len(sums), model.n_a))
    rows[:, i_g] = sums
    output = replace(model.output, weights=tuple(tuple(map(float, row)) for row in rows))
    return replace(model, output=output)
