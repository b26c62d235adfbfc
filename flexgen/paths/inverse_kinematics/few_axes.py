"""Joint configurations of arms whose output is the position of the tool and its angle.

Newton's method in the actuated coordinates of the undeflected arm, from many starts spread over
their ranges. A SCARA has two configurations, a palletizer up to four.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import turn_angle
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.model.elements import RobotModel

# Of these starts, tens lead to each of up to four configurations.
STARTS = 256
STEPS = 60  # of Newton's method from a start
# rad or m: a step is cut to it, so that it stays where the linearization means something
LONGEST = 0.5
# m or rad, relative to 1 + the largest entry: error of the output that counts as solved
REACHED = 1e-10
SAME_POSE = 1e-7  # m or rad: of the whole pose; the tilt is not among the outputs
SAME = 1e-6  # rad or m: closer configurations are one
FLAT = 1e-12  # relative: singular values that are rounding
TURN = 2 * np.pi


def has_few_axes(model: RobotModel) -> bool:
    """Whether position and angle of the tool determine the actuated coordinates, fewer than
    six.
    """
    return model.output.has_angle and model.output.tool_size == model.n_g


class FewAxes:
    """The search for one robot; see `has_few_axes`."""

    def __init__(self, equations: Equations) -> None:
        self.equations = equations
        self.model = equations.model
        if not has_few_axes(self.model):
            raise ArgumentError(
                f"model {self.model.name}: expected an output of position and angle for all axes"
            )
        self.i_g = list(self.model.i_g)
        symbol = equations.lagrangian.chain.q_a
        map_ = output_map(equations)
        rate = ca.densify(map_.rate[:, self.i_g])
        self._error = ca.Function("error", [symbol, map_.target], [ca.densify(map_.error), rate])
        self.rotary = np.array([self.model.coordinates[i].unit == "rad" for i in self.i_g])
        self.low, self.high = (self._ends(name) for name in ("lower", "upper"))

    def _ends(self, name: str) -> np.ndarray:
        """Limits (n_g,) of the joints, half a turn or a meter where there is none."""
        sign = 1.0 if name == "upper" else -1.0
        out = []
        for i, rotary in zip(self.i_g, self.rotary, strict=True):
            dof = self.model.coordinates[i].dof
            given = None if dof is None else getattr(dof, name)
            out.append(sign * (np.pi if rotary else 1.0) if given is None else float(given))
        return np.array(out)

    def _full(self, q_g: np.ndarray) -> np.ndarray:
        q = np.zeros((len(q_g), self.model.n_a))
        q[:, self.i_g] = q_g
        return q

    def _errors(self, q_g: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Error (n, n_y), its angle within half a turn, and the Jacobian (n, n_y, n_g)."""
        n = len(q_g)
        error, J = evaluate(self._error, self._full(q_g), np.tile(target, (n, 1)))
        error = error.reshape(n, -1).copy()
        error[:, -1] -= TURN * np.round(error[:, -1] / TURN)
        return error, J.reshape(n, -1, len(self.i_g))

    def target(self, position: np.ndarray, R: np.ndarray) -> np.ndarray:
        """The output (n_y,) of a pose of the tool: rows of its position, and the angle."""
        from flexgen.dynamics.mechanics.tool_angle import plane_axes

        output = self.model.output
        x, y = plane_axes(output)
        u = R[:, "xyz".index(output.reference)]
        return np.append(position[list(output.tool_rows)], np.arctan2(u @ y, u @ x))

    def all_at(self, position: np.ndarray, R: np.ndarray) -> list[np.ndarray]:
        """Configurations (n_g,) [rad or m] with the tool at ``position`` (3,) [m] and orientation
        ``R`` (3, 3), by damped Newton iterations from random starts.

        Rotations are within half a turn of the middle of their limits.
        """
        target = self.target(position, R)
        rng = np.random.default_rng(0)
        q = rng.uniform(self.low, self.high, (STARTS, len(self.i_g)))
        for _ in range(STEPS):
            error, J = self._errors(q, target)
            # damped next to singular poses, where a whole step would be long
            square = J.transpose(0, 2, 1) @ J
            size = FLAT * np.trace(square, axis1=1, axis2=2)[:, None, None]
            right = J.transpose(0, 2, 1) @ error[:, :, None]
            step = -np.linalg.solve(square + size * np.eye(len(self.i_g)), right)[:, :, 0]
            longest = np.abs(step).max(axis=1, keepdims=True)
            q = q + step * np.minimum(1.0, LONGEST / np.maximum(longest, 1e-300))
        error, _ = self._errors(q, target)
        q = q[np.abs(error).max(axis=1) < REACHED * (1.0 + np.abs(target).max())]
        middle = np.where(self.rotary, (self.low + self.high) / 2, 0.0)
        q = np.where(self.rotary, q - TURN * np.round((q - middle) / TURN), q)
        found: list[np.ndarray] = []
        for one in q:
            apart = [np.abs(self._change(one, other)).max() for other in found]
            if not apart or min(apart) > SAME:
                found.append(one)
        return [one for one in found if self.error(one, position, R) < SAME_POSE]

    def _change(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        change = one - other
        return np.where(self.rotary, change - TURN * np.round(change / TURN), change)

    def error(self, q_g: np.ndarray, position: np.ndarray, R: np.ndarray) -> float:
        """Of the whole pose: the larger of position [m] and rotation [rad]."""
        p, own = evaluate(self.equations.function("forward_kinematics"), self._full(q_g[None]))
        off = float(np.abs(p.reshape(-1) - position).max())
        return max(off, float(turn_angle(own.reshape(1, 3, 3), R[None])[0]))

    def distance(self, q_g: np.ndarray) -> tuple[float, int]:
        """Smallest over largest singular value of the Jacobian; the sign of its determinant."""
        _, J = self._errors(q_g[None], np.zeros(self.model.output.size))
        sizes = np.linalg.svd(J[0], compute_uv=False)
        return float(sizes[-1] / sizes[0]), 1 if np.linalg.det(J[0]) >= 0 else -1

    def within_limits(self, q_g: np.ndarray) -> bool:
        """Whether all joints are within the limits of the model file."""
        for value, i in zip(q_g, self.i_g, strict=True):
            dof = self.model.coordinates[i].dof
            low, high = (None, None) if dof is None else (dof.lower, dof.upper)
            if (low is not None and value < low) or (high is not None and value > high):
                return False
        return True
