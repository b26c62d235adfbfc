"""Frequency responses of one level of excitation as a block of a joint fit."""

from __future__ import annotations

import numpy as np

from flexgen.identification.commissioning.blocks import Channel
from flexgen.identification.commissioning.unknowns import Unknowns
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.parameters import DELAY, ParameterVector
from flexgen.identification.responses.residuals import Residuals

# Model error of each element that is expected anyway, as a part of it: without it the lines with
# least noise decide everything.
FLOOR = 0.02


class ResponsesBlock:
    """Responses from motor torques to accelerations at some poses.

    Parameters
    ----------
    unknowns : Unknowns
    name : str
    data : Frf
    index : int
        Number of the level: which viscous frictions and delay are its own. Friction of a small
        motion about rest is another one than that of a long way.
    """

    kind = "responses"

    def __init__(self, unknowns: Unknowns, name: str, data: Frf, index: int) -> None:
        self.unknowns = unknowns
        self.name = name
        robot = unknowns.robot
        viscous = [
            f"{motor.name}.viscous"
            for motor, has in zip(robot.motors, unknowns.has_friction, strict=True)
            if has
        ]
        parts = unknowns.parts
        first = parts.responses.start + index * (robot.n_m + 1)
        own = np.exp(unknowns.start[first : first + robot.n_m])
        start = {
            f"{motor.name}.viscous": float(value)
            for motor, value in zip(robot.motors, own, strict=True)
            if f"{motor.name}.viscous" in viscous
        }
        names = [*unknowns.vector.names, *viscous, DELAY]
        self.vector = ParameterVector(robot, names, start=start)
        places = {name: parts.model.start + k for k, name in enumerate(unknowns.vector.names)}
        for j, motor in enumerate(robot.motors):
            places[f"{motor.name}.viscous"] = first + j
        places[DELAY] = first + robot.n_m
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
        rows = np.zeros((0, self.unknowns.parts.size))
        if J is not None:
            both = np.stack([J.real, J.imag], axis=4)
            rows = np.zeros((both.size // both.shape[-1], self.unknowns.parts.size))
            rows[:, self.columns] = both.reshape(len(rows), -1)
        residual = np.stack([r.real, r.imag], axis=4)
        told = np.ones(residual.size, bool)
        each = lines * outputs * inputs * 2
        size = 1.0 / FLOOR
        return [
            Channel(
                "responses",
                residual.ravel(),
                rows,
                np.repeat(np.arange(poses), each),
                told,
                size,
                "1",
                neighbors=outputs * inputs * 2,
            )
        ]

    def set_free(self, free: np.ndarray) -> None:
        """See `Block`: derivatives in all unknowns cost little."""

    def relinearize(self, x: np.ndarray) -> None:
        """See `Block`: deflections over which springs that are not linear are averaged."""
        self.residuals.average_springs(self._own(x))
