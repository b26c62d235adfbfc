"""Frequency responses of one level of excitation as a block of a joint fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexgen.identification.commissioning.blocks import Channel
from flexgen.identification.commissioning.unknowns import Unknowns
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.parameters import DELAY, ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.model.elements import RobotModel
from flexgen.model.friction import NO_FRICTION

# Model error of each element that is expected anyway, as a part of it: without it the lines with
# least noise decide everything.
FLOOR = 0.02
FRICTION = ("viscous", "coulomb")


class ResponsesBlock:
    """Responses from motor torques to accelerations at some poses.

    Parameters
    ----------
    unknowns : Unknowns
    name : str
    data : Frf
    index : int
        Number of the level: which viscous frictions and delay are its own. Friction of a small
        motion about rest is another one than that of a long way: Coulomb friction of motors and
        joints counts as viscous.
    """

    kind = "responses"

    def __init__(self, unknowns: Unknowns, name: str, data: Frf, index: int) -> None:
        self.unknowns = unknowns
        self.name = name
        robot = _without_joint_friction(unknowns.robot, unknowns.rubbing)
        viscous = [
            f"{motor.name}.viscous"
            for motor, has in zip(robot.motors, unknowns.has_friction, strict=True)
            if has
        ]
        viscous += [f"{joint}.viscous" for joint in unknowns.rubbing]
        parts = unknowns.parts
        owners = [*(motor.name for motor in robot.motors), *unknowns.rubbing]
        first = parts.responses.start + index * (len(owners) + 1)
        own = np.exp(unknowns.start[first : first + len(owners)])
        start = {
            f"{owner}.viscous": float(value)
            for owner, value in zip(owners, own, strict=True)
            if f"{owner}.viscous" in viscous
        }
        places = {name: parts.model.start + k for k, name in enumerate(unknowns.vector.names)}
        of_joints = {f"{joint}.{kind}" for joint in unknowns.rubbing for kind in FRICTION}
        kept = [name for name in unknowns.vector.names if name not in of_joints]
        self.vector = ParameterVector(robot, [*kept, *viscous, DELAY], start=start)
        for j, owner in enumerate(owners):
            places[f"{owner}.viscous"] = first + j
        places[DELAY] = first + len(owners)
        self.columns = np.array([places[name] for name in self.vector.names])
        self.residuals = Residuals(self.vector, data, floor=FLOOR)
        self.residuals.average_springs(self._own(unknowns.start))

    def _own(self, x: np.ndarray) -> np.ndarray:
        """Numbers of these responses among all unknowns."""
        return x[self.columns]

    def channels(self, x: np.ndarray, derivatives: bool) -> list[Channel]:
        """See `Block`."""
        r, J = self.residuals.weight(self._own(x), derivatives)
        poses, lines, outputs, inputs = r.shape
        piece = np.repeat(np.arange(poses), 2 * lines)
        told = np.ones(len(piece), bool)
        out = []
        for i in range(outputs):
            for j in range(inputs):
                own = r[:, :, i, j]
                rows = np.zeros((0, self.unknowns.parts.size))
                if J is not None:
                    of_own = J[:, :, i, j]
                    both = np.stack([of_own.real, of_own.imag], axis=2)
                    rows = np.zeros((len(piece), self.unknowns.parts.size))
                    rows[:, self.columns] = both.reshape(len(rows), -1)
                residual = np.stack([own.real, own.imag], axis=2).ravel()
                title = f"response {i + 1} to motor {j + 1}"
                size = 1.0 / FLOOR
                out.append(Channel(title, residual, rows, piece, told, size, "1", neighbors=2))
        return out

    def set_free(self, free: np.ndarray) -> None:
        """See `Block`: derivatives in all unknowns cost little."""

    def relinearize(self, x: np.ndarray) -> None:
        """See `Block`: deflections over which springs that are not linear are averaged."""
        self.residuals.average_springs(self._own(x))


def _without_joint_friction(robot: RobotModel, joints: Sequence[str]) -> RobotModel:
    """The robot without the friction of some joints of the file."""
    elements = tuple(
        replace(
            element,
            dofs=tuple(
                replace(dof, friction=NO_FRICTION) if dof.name in joints else dof
                for dof in element.dofs
            ),
        )
        for element in robot.elements
    )
    return replace(robot, elements=elements)
