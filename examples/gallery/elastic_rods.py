"""A palletizer with elastic rods, whose torques come from models that lack an elasticity."""

from dataclasses import replace

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.model.elements import Dof, LinearSpring, RobotModel

QUESTION = "How far off its path is a palletizer whose model takes its rods as rigid?"
LITERATURE = """
Constraint embedding gives the equations of a closed loop in its independent coordinates (R. \
Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 8), as many as motors where all \
bodies are rigid.
The stretch of a rod is one more coordinate; at the tool its deflection is larger by the ratio \
of the levers, here 1.3 m to 0.3 m.
"""
RODS = ("drive_stretch", "level_stretch", "wrist_stretch")
RIGID = 1e3  # times stiffer: the tool moves by less than 1 um
CASES = {
    "all springs": ((), 1.0),
    "rods 20 % softer": (RODS, 0.8),
    "rods rigid": (RODS, RIGID),
    "bearing rigid": (("bearing",), RIGID),
}


def change_springs(robot: RobotModel, names: tuple[str, ...], factor: float) -> RobotModel:
    """The robot with springs and dampers of some joints multiplied by a factor."""

    def changed(dof: Dof) -> Dof:
        if dof.name not in names or not isinstance(dof.spring, LinearSpring):
            return dof
        spring = LinearSpring(factor * dof.spring.stiffness)
        return replace(dof, spring=spring, damping=factor * dof.damping)

    elements = [replace(e, dofs=tuple(map(changed, e.dofs))) for e in robot.elements]
    return replace(robot, elements=tuple(elements))


def show(page: Page) -> None:
    """Tool error of the elastic robot, with feedback of its motors, under the torques and the
    motor angles of each model.
    """
    robot = flexgen.read("palletizer")
    axes = page.figure().subplots()
    rows = []
    for name, (names, factor) in CASES.items():
        model = change_springs(robot, names, factor)
        solution = flexgen.solve(model, "lift", verify=False, progress=False)
        run = flexgen.simulate(robot, solution.trajectory, feedback="ppi", progress=False)
        error = 1e6 * np.linalg.norm(run.trajectory["error"][:, :3], axis=1)
        rows.append([name, 1e6 * (run.tool_error_max_m or 0.0), float(error[-1])])
        axes.semilogy(run.trajectory.time, error, label=name)
    page.table(["torques of a model with", "tool error, um", "at the end, um"], rows)
    axes.set_xlabel("time, s")
    axes.set_ylabel("tool error, µm")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
