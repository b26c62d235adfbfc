"""An arm on a track: one line of the tool with the carriage at rest, carried along, and chosen by
weights.
"""

from dataclasses import replace

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Posture

QUESTION = "Which motion of the track should carry an arm, and what does the choice change?"
LITERATURE = """
The least weighted change of the joints is the pseudoinverse of the Jacobian (D. E. Whitney, 1969).
The output decides the zeros: \
with the carriage as output, or a joint of the arm, the same robot has other ones.
"""
CHOICES = {
    "carriage at rest": Posture.hold("rail"),
    "carried by 0.3 m": Posture(("rail",), (0.3,)),
    "carried by 0.6 m": Posture(("rail",), (0.6,)),
    "weight 1": None,
    "weight 25": Posture(weighted=("rail",), weights=(25.0,)),
}


def lowest_zero(robot: RobotModel, joint: str) -> tuple[float, float]:
    """Frequency [Hz] of the slowest vibration that the output does not see, with this joint as the
    last output, and its real part [1/s].
    """
    row = tuple(float(c.name == joint) for c in robot.coordinates)
    chosen = replace(robot, output=replace(robot.output, weights=(row,)))
    zeros = np.array(flexgen.analyze(chosen).zeros.zeros)
    slowest = min(zeros, key=abs)
    return float(abs(slowest) / (2 * np.pi)), float(slowest.real)


def show(page: Page) -> None:
    """Carriage, joints and torques of the choices."""
    robot = flexgen.read("track_arm")
    line = robot.move("carried")
    axes = page.figure(3.2).subplots(1, 1)
    rows = []
    for name, posture in CHOICES.items():
        path = flexgen.plan(robot, replace(line, posture=posture))
        time = np.linspace(0.0, path.duration, 121)
        q_g = path.sample(time).q_g
        turn = float(np.abs(q_g[:, 1:, 0] - q_g[0, 1:, 0]).max())
        solution = flexgen.solve(robot, replace(line, posture=posture), verify=False)
        torque = np.abs(solution.trajectory["tau_m"]).max(axis=0)
        way = float(q_g[-1, 0, 0] - q_g[0, 0, 0])
        rows.append([name, way, turn, float(torque[0]), float(torque[2])])
        axes.plot(time, q_g[:, 0, 0], label=name)
    axes.set(xlabel="time, s", ylabel="carriage, m")
    axes.legend()
    page.table(
        ["joint as output", "slowest zero, Hz", "real part, 1/s"],
        [[joint, *lowest_zero(robot, joint)] for joint in ("rail", "q1", "q3")],
    )
    page.table(["choice", "carriage, m", "largest joint, rad", "rail, N m", "axis 2, N m"], rows)


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
