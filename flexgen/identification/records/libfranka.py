"""Logs of libfranka, the interface of Franka robots: the CSV text of ``franka::logToCSV``.

Its columns are ``time`` [ms], ``success_rate``, then with indices from 0 to 6 ``state.q``,
``state.q_d`` [rad], ``state.dq``, ``state.dq_d`` [rad/s], ``state.tau_J`` (measured by sensors on
the link side) and ``state.tau_ext_hat_filtered`` [N m], then the commands ``cmd.``: of positions
``cmd.q_d`` [rad]. Positions that no motion generator sent are zeros there; then ``state.q_d`` are
the positions that the robot follows.

Source: libfranka, src/log.cpp (Apache-2.0).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.model.elements import RobotModel

JOINTS = 7
FIRST = "state.q[0]"  # a column that all logs have
TIME = "time"  # ms
# By the quantity of a joint: ending of the column of flexgen, with its unit, and that of the log.
QUANTITIES = {
    "angle": ("_rad", "state.q"),
    "torque": ("_torque_Nm", "state.tau_J"),
}
COMMAND = "_command_rad"
SENT = "cmd.q_d"
FOLLOWED = "state.q_d"


def is_log(names: Mapping[str, Any]) -> bool:
    """Whether columns with these names are those of a log of libfranka."""
    return FIRST in names


def columns_of_log(where: str, arrays: Mapping[str, Any], robot: RobotModel) -> dict[str, Any]:
    """The columns of a log by the names that records of flexgen have.

    Parameters
    ----------
    where : str
        File, for errors.
    arrays : mapping of str to array (n,)
        Columns of the log by their names.
    robot : RobotModel
        Its seven actuated joints are those of the log, in their order.

    Returns
    -------
    dict of str to array (n,)
        ``time_ms``, and of each joint ``JOINT_rad``, ``JOINT_torque_Nm``, ``JOINT_command_rad``.

    Raises
    ------
    ArgumentError
        The robot has another number of joints, or the log lacks a column.
    """
    joints = [robot.coordinates[i].name for i in robot.i_g]
    if len(joints) != JOINTS:
        raise ArgumentError(
            f"{where}: given a log of a robot with {JOINTS} joints, expected {len(joints)}, "
            f"{', '.join(joints)}, as {robot.title} has; choose the model of the recorded robot"
        )
    sent = [f"{SENT}[{k}]" for k in range(JOINTS)]
    is_sent = all(name in arrays and np.any(arrays[name]) for name in sent)
    sources = dict(QUANTITIES.values()) | {COMMAND: SENT if is_sent else FOLLOWED}
    found = {"time_ms": _column(where, arrays, TIME)}
    for ending, name in sources.items():
        for k, joint in enumerate(joints):
            found[f"{joint}{ending}"] = _column(where, arrays, f"{name}[{k}]")
    return found


def _column(where: str, arrays: Mapping[str, Any], name: str) -> Any:
    """A column of a log; ArgumentError with the name of one that is missing."""
    if name not in arrays:
        raise ArgumentError(
            f"{where}: given a log of libfranka without the column {name!r}, expected all columns "
            "that franka::logToCSV writes"
        )
    return arrays[name]
