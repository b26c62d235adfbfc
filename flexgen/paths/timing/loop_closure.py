"""Joint moves of robots with kinematic loops: whether the loops stay closed."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.closed_loops import closed_joints
from flexgen.model.elements import RobotModel
from flexgen.model.format.closure import closed_values


@lru_cache(maxsize=8)
def _passive_joints(model: RobotModel) -> ca.Function:
    """Positions of all joints as functions of ``q_a`` (n_a), NaN where a loop cannot be closed."""
    q_a = ca.SX.sym("q_a", model.n_a)
    return ca.Function("joints", [q_a], [ca.vertcat(*closed_joints(model, q_a).values())])


def check_closed(model: RobotModel, move: str, t: np.ndarray, q_g: np.ndarray) -> None:
    """SolverError where joints ``q_g`` (n, n_g) at instants ``t`` (n,) [s] open a loop."""
    q_a = np.zeros((len(t), model.n_a))
    q_a[:, list(model.i_g)] = q_g
    joints = np.asarray(evaluate(_passive_joints(model), q_a)[0]).reshape(len(t), -1)
    open_at = np.flatnonzero(~np.isfinite(joints).all(axis=1))
    if not len(open_at):
        return
    k = int(open_at[0])
    try:
        closed_values(model, q_a[k])
        reason = "its closed loops cannot be closed on the straight line from home"
    except ArgumentError as error:
        reason = str(error).partition("at which ")[2].partition(",")[0]
    at = ", ".join(
        f"{model.coordinates[i].name} = {q_a[k, i]:.4g} {model.coordinates[i].unit}"
        for i in model.i_g
    )
    raise SolverError(
        f"move {move}: given joints that come to {at} at t = {t[k]:.4g} s, where {reason}, "
        "expected joints that keep them closed: the linkage has a dead center on the way; choose "
        "another start or end"
    )
