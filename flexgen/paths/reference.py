"""References: the output of a model along a curve of the tool, the outputs or the joints."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.spec.arguments import is_whole
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.paths.geometry.jets import Attitude
from flexgen.paths.geometry.segments import POSITION


@checked_result
@dataclass(frozen=True)
class PathSample(Result):
    """Reference at n instants.

    ``y`` (n, n_y, 6): rows of the output but the rotation of a pose, last axis: derivatives
    0 to 5. For a pose also ``R`` (n, 3, 3), the orientation in the world, and ``w`` (n, 3, 5), the
    angular velocity (world axes) and its derivatives 0 to 4. ``q_g`` (n, n_g, 6) where the move is
    one of joints.

    Examples
    --------
    >>> sample = flexgen.plan("elbow", "line").sample([0.0, 0.5, 1.0])
    >>> sample.y.shape  # instants, positions, derivatives
    (3, 2, 6)
    """

    y: np.ndarray
    R: np.ndarray | None = None
    w: np.ndarray | None = None
    q_g: np.ndarray | None = None

    __repr__ = short_repr

    @checked_types(own=("k",))
    def derivative(self, k: int) -> np.ndarray:
        """k-th derivative (k >= 1) of the output, (n, n_y); of a pose, the (k - 1)-th derivative
        of its twist.
        """
        least = 0 if self.w is None else 1
        most = self.y.shape[2] - 1
        if not is_whole(k, least, most):
            raise ArgumentError(
                f"k: given {show_value(k)}, expected the order of a derivative, {least} to {most}"
            )
        if self.w is None:
            return self.y[:, :, k]
        return np.hstack([self.y[:, :, k], self.w[:, :, k - 1]])


class Reference:
    """The output of a model while its tool, its outputs or its joints follow a curve."""

    def __init__(self, equations: Equations) -> None:
        self.equations = equations
        self.model = equations.model
        self._references: dict[int, ca.Function] = {}  # by the number of derivatives
        self.pose = self.model.output.type == "tool_pose"
        self.tool = self.model.output.type != "combination"
        self.axes = list(self.model.output.tool_rows)
        # of a curve of the tool: position, then an angle
        self.columns = [*self.axes, *[POSITION] * self.model.output.has_angle]

    def expand(self, q_g: np.ndarray | tuple[float, ...]) -> np.ndarray:
        """Arm coordinates (n_a) without deflections, from the actuated ones (n_g)."""
        q = np.zeros(self.model.n_a)
        q[list(self.model.i_g)] = q_g
        return q

    def tool_pose(self, q_g: np.ndarray | tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Position (3) [m] and orientation (3, 3) of the tool of the undeflected arm."""
        p, R = evaluate(self.equations.function("forward_kinematics"), self.expand(q_g))
        return p[0], R[0]

    def tool_start(self, q_g: np.ndarray | tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Start of a curve of the tool: position (3) [m], then an angle if any; orientation."""
        p, R = self.tool_pose(q_g)
        if not self.model.output.has_angle:
            return p, R
        return np.append(p, self.outputs(q_g)[self.model.output.tool_size - 1]), R

    def outputs(self, q_g: np.ndarray | tuple[float, ...]) -> np.ndarray:
        """The outputs of the undeflected arm (n_y; 3 for a pose)."""
        return evaluate(self.equations.function("output"), self.expand(q_g))[0][0]

    def _joint_reference(self, count: int) -> ca.Function:
        """Output and its first derivatives in time, ``count`` in all, from those of the joints,
        each (n_g).
        """
        g = [ca.SX.sym(f"q{k}", self.model.n_g) for k in range(count)]
        pick = ca.DM(np.eye(self.model.n_a)[:, list(self.model.i_g)])
        q = ca.mtimes(ca.sparsify(pick), g[0])
        v = ca.mtimes(ca.sparsify(pick), g[1])

        def derivatives(x: ca.SX, count: int) -> list[ca.SX]:
            out = [x]
            for k in range(1, count):
                out.append(ca.jtimes(out[-1], ca.vertcat(*g[:k]), ca.vertcat(*g[1 : k + 1])))
            return out

        y = derivatives(self.equations.function("output")(q), count)
        if self.pose:
            R = self.equations.function("forward_kinematics")(q)[1]
            w = [ca.mtimes(self.equations.function("jacobian")(q), v)[3:]]
            for _ in range(count - 2):
                w.append(ca.jtimes(w[-1], ca.vertcat(*g[:-1]), ca.vertcat(*g[1:])))
            y += [R, *w]
        return ca.Function("joint_reference", g, [ca.densify(x) for x in y])

    def sample(self, space: str, x: np.ndarray, attitude: Attitude | None) -> PathSample:
        """The reference from the time derivatives ``x`` (n, d, 6) of a curve and the orientation
        along it.

        Of joints with fewer derivatives, two or more, the reference has as many.
        """
        if space == "joint":
            return self._joints(x)
        if space == "output":
            return PathSample(x)
        if not self.pose or attitude is None:
            return PathSample(x[:, self.columns])
        return PathSample(x, *attitude)

    def _joints(self, q_g: np.ndarray) -> PathSample:
        """The reference of joints with derivatives ``q_g`` (n, n_g, count): the output with as
        many derivatives; for poses also orientation and angular velocity. A function for each
        count is kept.
        """
        count = q_g.shape[2]
        if count not in self._references:
            self._references[count] = self._joint_reference(count)
        function = self._references[count]
        values = evaluate(function, *[np.ascontiguousarray(q_g[:, :, k]) for k in range(count)])
        y = np.stack([value.reshape(len(q_g), -1) for value in values[:count]], axis=-1)
        if not self.pose:
            return PathSample(y, q_g=q_g)
        w = np.stack(values[count + 1 :], axis=-1)
        return PathSample(y, values[count], w, q_g)
