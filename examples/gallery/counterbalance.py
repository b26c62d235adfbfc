"""A gas spring at the second axis of a large arm: static torque without it, with it, and along a
move.
"""

from dataclasses import replace

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.model.elements import RobotModel

QUESTION = (
    "How much of the weight of an arm does a gas spring carry, and what does it do in motion?"
)
LITERATURE = """
A spring of zero free length between a point at the height h above a hinge and one at the \
distance r along a link gives
the moment k h r sin(q), that of a weight, in every pose: the link floats (J. L. Herder, \
Energy-free Systems, 2001).
Gas of p V^n = constant gives about this moment, with a force that grows along the stroke.
"""
AXIS = 1  # of the gears: the second one


def axis_torque(robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torque of the second gear [N m], arm side, in a motion of the gears (n, 6); the other
    coordinates at rest at zero.
    """
    motion = np.zeros((3, len(q), robot.n_a))
    motion[:, :, list(robot.i_g)] = q, v, a
    equations = flexgen.derive(robot)
    needed = evaluate(equations.function("inverse_dynamics"), *motion)[0]
    acting = evaluate(equations.function("arm_forces"), *motion[:2])[0]
    return (needed - acting)[:, robot.i_g[AXIS]]


def show(page: Page) -> None:
    """Torques of the second axis at rest over its angle, and along a move, with and without the
    gas spring.
    """
    robot = flexgen.read("kr300_balancer")
    plain = replace(robot, lines=())
    angles = np.radians(np.linspace(-140.0, -5.0, 28))
    poses = np.tile(robot.home, (len(angles), 1))
    poses[:, AXIS] = angles
    path = flexgen.plan(robot, "joints")
    time = np.linspace(0.0, path.duration, 101)
    motion = path.sample(time).q_g.transpose(2, 0, 1)[:3]
    at_rest = [axis_torque(one, poses, 0 * poses, 0 * poses) for one in (plain, robot)]
    moved = [axis_torque(one, *motion) for one in (plain, robot)]
    rows = []
    for name, still, torque in zip(("without", "with"), at_rest, moved, strict=True):
        rms = float(np.sqrt(np.mean(torque**2)))
        rows.append([name, float(np.abs(still).max()), float(np.abs(torque).max()), rms])
    page.table(["gas spring", "at rest, N m", "in the move, N m", "RMS of the move, N m"], rows)
    left, right = page.figure(3.2).subplots(1, 2)
    for name, still, torque in zip(("without", "with"), at_rest, moved, strict=True):
        left.plot(np.degrees(angles), still / 1e3, label=f"{name} gas spring")
        right.plot(time, torque / 1e3)
    left.set_xlabel("angle of axis 2, degrees")
    left.set_ylabel("torque of axis 2 at rest, kN m")
    right.set_xlabel("time, s")
    right.set_ylabel("torque of axis 2 in a move, kN m")
    left.legend(fontsize=8)


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
