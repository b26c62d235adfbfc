"""Arms for the tests of model-based laws, and their runs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.feedback.laws.study import ARM
from flexgen.feedback.loop.case import Case, control_case
from flexgen.model.elements import CubicSpring, Friction, RobotModel

ONE_JOINT = """
name = "soft_joint"
description = "one joint with a soft spring: four integrators, nearly"
source = "made for tests"
gravity = [0.0, 0.0, 0.0]
home_deg = [0.0]

[[element]]
name = "link"
body = { mass = 1.0, com = [0, 0, 0], inertia = [1.0, 1.0, 1.0] }

[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 0, 1]
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 0.5 } }

[[motor]]
name = "m1"
drives = "q1"
ratio = 1.0
inertia = 1.0

[tool]
position = [1.0, 0, 0]

[output]
type = "joint"
joints = ["q1"]

[[move]]
name = "turn"
type = "joint"
start_deg = [0.0]
end_deg = [1.0]
duration = 1.0
smoothness = 5
"""


def arm(
    *,
    damped: bool = True,
    rubbing: bool = True,
    cubic: float = 0.0,
    stiffness: float = 1.0,
    drag: float = 0.0,
) -> RobotModel:
    """The three-axis arm, with or without damping and friction of its drives, springs and
    frictions changed.
    """
    model = flexgen.read(ARM)
    elements = []
    for element in model.elements:
        (dof,) = element.dofs
        gear = dof.gear
        spring = replace(gear.spring, stiffness=stiffness * gear.spring.stiffness)
        if cubic:
            spring = CubicSpring(spring.stiffness, cubic * spring.stiffness)
        gear = replace(gear, spring=spring, damping=gear.damping if damped else 0.0)
        friction = Friction(viscous=drag, coulomb=drag, beta=5.0) if drag else dof.friction
        elements.append(replace(element, dofs=(replace(dof, gear=gear, friction=friction),)))
    motors = (
        model.motors if rubbing else tuple(replace(m, friction=Friction()) for m in model.motors)
    )
    return replace(model, elements=tuple(elements), motors=motors)


def coupled() -> RobotModel:
    """The three-axis arm without damping, springs on the arm side, its third motor driving the
    second joint too.
    """
    model = arm(damped=False)
    elements = []
    for element, motor in zip(model.elements, model.motors, strict=True):
        (dof,) = element.dofs
        spring = replace(
            dof.gear.spring, stiffness=dof.gear.spring.stiffness * motor.ratio[0] ** 2
        )
        elements.append(
            replace(
                element, dofs=(replace(dof, gear=replace(dof.gear, side="arm", spring=spring)),)
            )
        )
    last = replace(model.motors[2], drives=("q2", "q3"), ratio=(-35.0, 60.0))
    return replace(model, elements=tuple(elements), motors=(*model.motors[:2], last))


@cache
def solution_of(model: RobotModel) -> flexgen.Solution:
    """The feedforward of the first move."""
    return flexgen.solve(model, progress=False)


def case_of(model: RobotModel, sample_time: float = 1e-3, delay: float = 0.0, **options) -> Case:
    """A loop around the first move."""
    options.setdefault("exact_state", True)
    return control_case(
        model, sample_time=sample_time, delay=delay, solution=solution_of(model), **options
    )


def one_joint(folder: Path) -> RobotModel:
    """A joint whose own dynamics is a thousand times slower than the poles of the tests."""
    path = folder / "soft_joint.toml"
    path.write_text(ONE_JOINT)
    return flexgen.read(path)


def at_rest(model: RobotModel, *poses: list[float]) -> list[np.ndarray]:
    """Points ``q_a v_a a_a q_m v_m a_m tau_m`` of a motion: rest at poses, by default at home."""
    equations = derive(model)
    held = [hold_joints(equations, np.array(pose)) for pose in poses or (model.home,)]
    q_a, q_m, tau = (
        np.array([getattr(h, name) for h in held]) for name in ("q_a", "q_m", "tau_m")
    )
    return [q_a, 0 * q_a, 0 * q_a, q_m, 0 * q_m, 0 * q_m, tau]
