"""Boxes around a robot, such as the floor, a column or a fence, which the poses of an experiment
keep away from.

The links are lines between the origins of their elements, and to the tool, about which nothing may
be nearer than the clearance. The first line of the base, which stands on the floor, is not
compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.elements import RobotModel

POINTS = 21  # of a line that are compared with a box


@checked_class
@dataclass(frozen=True)
class Box:
    """A box along the axes of the world.

    Parameters
    ----------
    lower, upper : sequence (3,) [m]
        Its corners; infinite numbers make a floor, a wall or a column of it.

    Raises
    ------
    ArgumentError
        There are not three numbers, or an upper one is not above the lower one.

    Examples
    --------
    >>> inf = float("inf")
    >>> floor = flexgen.Box((-inf, -inf, -inf), (inf, inf, 0.0))
    >>> floor.distance([[0.3, 0.0, 0.25], [0.3, 0.0, -1.0]]).tolist()
    [0.25, 0.0]
    """

    lower: Sequence[float]
    upper: Sequence[float]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            given = np.asarray(getattr(self, name), dtype=float)
            if given.shape != (3,) or np.isnan(given).any():
                raise ArgumentError(
                    f"box, {name}: given {getattr(self, name)!r}, expected three numbers in m"
                )
            object.__setattr__(self, name, tuple(given.tolist()))
        if any(high <= low for low, high in zip(self.lower, self.upper, strict=True)):
            raise ArgumentError(
                f"box: given from {self.lower} to {self.upper}, expected upper numbers above the "
                "lower ones"
            )

    def distance(self, points: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
        """Distance (n,) [m] of points (n, 3) [m] from the box; zero within it."""
        given = np.asarray(points, dtype=float)
        outside = np.maximum(0.0, np.maximum(self.lower - given, given - self.upper))
        return np.asarray(np.linalg.norm(outside, axis=-1))


class Surroundings:
    """Boxes around a robot.

    Parameters
    ----------
    model : RobotModel
    boxes : sequence of Box
    clearance : float [m]
        Least distance of the lines of the links from the boxes.
    """

    def __init__(self, model: RobotModel, boxes: Sequence[Box], clearance: float) -> None:
        self.model = model
        self.boxes = tuple(boxes)
        self.clearance = clearance
        chain = derive(model).lagrangian.chain
        names = [*chain.frames]
        parents = [model.parents[name] for name in names]
        # begin and end of each link, by their places among the origins
        self._links = [
            (names.index(parent), k, parent, name)
            for k, (name, parent) in enumerate(zip(names, parents, strict=True))
            if parent in names
        ]
        self._links.append((names.index(model.tip), len(names), model.tip, "the tool"))
        points = ca.vertcat(*(frame.p for frame in chain.frames.values()), chain.tool.p)
        self._origins = ca.Function("origins", [chain.q_a], [ca.densify(points)])

    def find_contact(self, q_g: np.ndarray, room: np.ndarray) -> str | None:
        """Why the links come too near to a box at joints ``q_g`` (n_g,) that move by ``room``
        (n_g,) [rad or m], or None.
        """
        if not self.boxes:
            return None
        moves = np.vstack([np.zeros(len(room)), np.diag(room), -np.diag(room)])
        q_a = np.zeros((len(moves), self.model.n_a))
        q_a[:, list(self.model.i_g)] = q_g + moves
        origins = evaluate(self._origins, q_a)[0].reshape(len(moves), -1, 3)
        share = np.linspace(0.0, 1.0, POINTS)[:, None]
        for first, last, parent, name in self._links:
            begin = origins[:, None, first]
            line = begin + share * (origins[:, None, last] - begin)
            nearest = [float(box.distance(line).min()) for box in self.boxes]
            if min(nearest) < self.clearance:
                box = self.boxes[int(np.argmin(nearest))]
                return (
                    f"the link from {parent} to {name} comes within {min(nearest):.3g} m of the "
                    f"box from {box.lower} to {box.upper}, expected {self.clearance:g} m"
                )
        return None
