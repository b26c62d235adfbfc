"""Records that do not belong to the model: one mistake that explains them, or none.

Every record is compared with the model of the file before anything is fitted. A mistake is named
where the record with it is explained many times better. Then nothing is fitted: a wrong record
would be hidden in springs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.identification.commissioning.elastic_arm import ElasticArm
from flexgen.identification.commissioning.motion_block import Motion, MotionBlock
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.response_inputs import Drive
from flexgen.model.elements import RobotModel

# Unexplained part of the variance of torques from which on a mistake is looked for, and by which
# factor a mistake has to lower it.
DOUBTFUL = 0.1
NAMED = 0.25
# Without a named mistake: so much of it is left that no fit within tolerances explains it.
HOPELESS = 0.9
DEGREES = np.pi / 180
SCALE = 1.5  # factor of the torques of a motor from which on it is named
# Spread of the logarithms of responses over the model from which on a mistake is looked for.
SPREAD = 1.0


def check_motion(arm: ElasticArm, motion: Motion, index: int, tell: Callable[[str], None]) -> None:
    """ArgumentError where one mistake explains a motion, or nothing does."""
    tell(f"comparing {motion.name} with the model of the file")
    before = _find_unexplained(arm, motion, index)
    if before <= DOUBTFUL:
        return
    tell(f"{motion.name}: {100 * before:.0f} % of the torques are not explained, why?")
    left = [
        (_find_unexplained(arm, wrong, index), words) for words, wrong in _mistakes(arm, motion)
    ]
    least, words = min(left)
    if least < NAMED * before:
        raise ArgumentError(
            f"{motion.name}: given torques of which the model explains {100 * (1 - before):.0f} "
            f"%, expected those of this robot: probably {words}, which explains "
            f"{100 * (1 - least):.0f} %"
        )
    if before > HOPELESS:
        raise ArgumentError(
            f"{motion.name}: given torques of which the model explains nothing, expected those of "
            "this robot: check units, signs, sides of the gears, and the order of the columns"
        )


def _find_unexplained(arm: ElasticArm, motion: Motion, index: int) -> float:
    """Part of the variance of the torques that the model of the file with any friction leaves,
    the mean over the motors that move; 1 of a motion that cannot be simulated.
    """
    try:
        block = MotionBlock(arm, Motion(motion.name, motion.trajectory), index)
        channels = block.channels(arm.unknowns.start, False)
    except (FlexgenError, ArithmeticError, np.linalg.LinAlgError):
        return 1.0
    parts = []
    motors = [f"torque of {motor.name}" for motor in arm.robot.motors]
    for channel in channels:
        if channel.title not in motors:
            continue
        j = motors.index(channel.title)
        told = channel.told
        X = block.friction[told, j]
        r = channel.residual[told]
        scale = np.abs(X).max(axis=0)
        X = X / np.where(scale > 0.0, scale, 1.0)
        r = r - X @ np.linalg.lstsq(X, r, rcond=None)[0]
        parts.append(min(1.0, float(np.mean(r**2)) / max(channel.size**2, 1e-300)))
    return float(np.mean(parts)) if parts else 0.0


def _mistakes(arm: ElasticArm, motion: Motion) -> Iterator[tuple[str, Motion]]:
    """Single mistakes of a motion in words, and the motion without each of them."""
    robot = arm.robot
    motors = [motor.name for motor in robot.motors]
    q_m = motion.trajectory["q_m"]
    tau = motion.trajectory["tau_m"]

    def change(q: np.ndarray, torque: np.ndarray) -> Motion:
        channels = {"q_m": q, "tau_m": torque}
        record = motion.trajectory
        ports = {name: record.ports[name] for name in channels}
        labels = {name: record.labels[name] for name in channels}
        new = replace(record, channels=channels, ports=ports, labels=labels, meta={}, units={})
        return replace(motion, trajectory=new, positions=None)

    for i, j in combinations(range(robot.n_m), 2):
        order = list(range(robot.n_m))
        order[i] = j
        order[j] = i
        both = f"{motors[i]} and {motors[j]}"
        yield f"the torques of {both} are exchanged", change(q_m, tau[:, order])
        yield f"the angles of {both} are exchanged", change(q_m[:, order], tau)
        yield f"{both} are exchanged", change(q_m[:, order], tau[:, order])
    for j, motor in enumerate(motors):
        turn = np.where(np.arange(robot.n_m) == j, -1.0, 1.0)
        yield f"the sign of the torques of {motor} is wrong", change(q_m, tau * turn)
        yield f"the sign of the angles of {motor} is wrong", change(q_m * turn, tau)
        ratio = float(np.abs(robot.eta[j]).max())
        side = np.where(np.arange(robot.n_m) == j, ratio, 1.0)
        yield f"the torques of {motor} are on the arm side", change(q_m, tau / side)
        yield f"the angles of {motor} are on the arm side", change(q_m * side, tau)
    ratios = np.abs(robot.eta).max(axis=1)
    yield "all torques are on the arm side", change(q_m, tau / ratios)
    yield "all angles are on the arm side", change(q_m * ratios, tau)
    yield "the angles are in degrees", change(q_m * DEGREES, tau)
    yield "all torques have the wrong sign", change(q_m, -tau)


def check_responses(robot: RobotModel, name: str, data: Frf) -> None:
    """ArgumentError where one mistake explains responses.

    Compared are the logarithms of the sizes of the diagonal elements, without their mean: a
    misfit of 1 is a factor of e from line to line.
    """
    motors = [motor.name for motor in robot.motors]
    if tuple(motors) != data.motors:
        raise ArgumentError(
            f"{name}: given the motors {', '.join(data.motors)}, expected {', '.join(motors)} in "
            "this order"
        )
    local = LocalModel(robot, [], ())
    drive = Drive(data.sample_s, data.delay_s)
    n = len(motors)

    def spread(poses: np.ndarray, order: list[int]) -> float:
        found = local.response(
            np.zeros(0), poses, data.w, drive, speed_sd=data.speed_sd, derivatives=False
        ).G[:, :, :n]
        measured = data.G[:, :, order][:, :, :, order]
        ratio = np.abs(measured) / np.maximum(np.abs(found), 1e-300)
        logs = np.log(np.diagonal(ratio, axis1=2, axis2=3))
        return float(np.sqrt(np.mean(logs**2)))

    same = list(range(n))
    before = spread(data.poses, same)
    if before < SPREAD:
        return
    left = []
    for i, j in combinations(range(n), 2):
        order = list(range(n))
        order[i] = j
        order[j] = i
        words = f"{motors[i]} and {motors[j]} are exchanged"
        left.append((spread(data.poses[:, order], order), words))
    left.append((spread(data.poses * DEGREES, same), "the poses are in degrees"))
    least, words = min(left)
    if least < np.sqrt(NAMED) * before:
        raise ArgumentError(
            f"{name}: given responses that are off by a factor of {np.exp(before):.2g}, expected "
            f"those of this robot: probably {words}, which leaves a factor of {np.exp(least):.2g}"
        )
