"""Paths: what the output shall do, with its time derivatives up to the fifth, in position and orientation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import casadi as ca
import numpy as np

from flexgen.errors import ArgumentError
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.evaluate import evaluate
from flexgen.model.elements import Move
from flexgen.problems.timing import TimeLaw

ORDER = 5  # highest derivative of the reference


@dataclass(frozen=True)
class PathSample:
    """Reference at n instants.

    ``y`` (n, n_y, 6): rows of the output that are positions (3 for a pose), last axis: derivatives 0 to 5. For a pose
    also ``R`` (n, 3, 3), the orientation in the world, and ``w`` (n, 3, 5), the angular velocity (world axes) and its
    derivatives 0 to 4. ``q_g`` (n, n_g, 6) where the move is one of joints.
    """

    y: np.ndarray
    R: np.ndarray | None = None
    w: np.ndarray | None = None
    q_g: np.ndarray | None = None

    def rates(self, k: int) -> np.ndarray:
        """k-th derivative (k >= 1) of the output, (n, n_y): of the twist's integral for a pose."""
        if self.w is None:
            return self.y[:, :, k]
        return np.hstack([self.y[:, :, k], self.w[:, :, k - 1]])


def chain_rule(f: list[np.ndarray], s: np.ndarray) -> list[np.ndarray]:
    """Time derivatives of ``f(s(t))`` by Faa di Bruno's formula.

    ``f``: derivatives with respect to s, each (n, m), from order 0; ``s`` (n, k): s and its time derivatives.
    """
    n = len(f) - 1
    bell = [[np.zeros(len(s)) for _ in range(n + 1)] for _ in range(n + 1)]
    bell[0][0] = np.ones(len(s))
    for i in range(1, n + 1):
        for k in range(1, i + 1):
            bell[i][k] = sum(
                (comb(i - 1, j - 1) * s[:, j] * bell[i - j][k - 1] for j in range(1, i - k + 2)), np.zeros(len(s))
            )
    return [f[0], *(sum(f[k] * bell[i][k][:, None] for k in range(1, i + 1)) for i in range(1, n + 1))]  # type: ignore[list-item]


class Path:
    """The reference of one move of one model at any instant; constant before 0 and after `duration`."""

    def __init__(self, equations: Equations, move: Move) -> None:
        self.equations, self.move = equations, move
        self.law = TimeLaw(move.duration, move.smoothness)
        self.duration = move.duration
        model = equations.model
        sizes = {"start": (move.start, model.n_g)}
        if move.type == "joint":
            sizes["end"] = (move.end, model.n_g)
        elif move.type == "tool_line":
            sizes |= {"displacement": (move.displacement, 3), "rotation": (move.rotation, 3)}
        elif move.type == "output_line":
            sizes["displacement"] = (move.displacement, model.output.size)
        else:
            raise ArgumentError(f"move {move.name}: given type {move.type!r}, expected tool_line, joint or output_line")
        for name, (values, size) in sizes.items():
            if len(values) != size or not np.isfinite(values).all():
                raise ArgumentError(f"move {move.name}: given {name} {values}, expected {size} finite numbers")
        self.pose = model.output.type == "tool_pose"
        self.q_start = self.full(move.start)
        p, R = evaluate(equations.function("forward_kinematics"), self.q_start)
        self.p_start, self.R_start = p[0], R[0]
        self.y_start = evaluate(equations.function("output"), self.q_start)[0][0]
        if move.type == "tool_line" and model.output.type == "combination":
            raise ArgumentError(
                f"move {move.name}: a tool_line needs a tool output, expected an output_line or joint move"
            )
        self.axis, self.angle = np.array([0.0, 0.0, 1.0]), float(np.linalg.norm(move.rotation))
        if self.angle > 0:
            self.axis = np.array(move.rotation) / self.angle

    def full(self, q_g: tuple[float, ...]) -> np.ndarray:
        """Arm coordinates with the given actuated ones and undeflected elements."""
        q = np.zeros(self.equations.model.n_a)
        q[list(self.equations.model.i_g)] = q_g
        return q

    def sample(self, t: np.ndarray) -> PathSample:
        """The reference at the instants ``t`` [s]."""
        s = self.law(np.asarray(t, dtype=float), ORDER)
        if self.move.type == "joint":
            return self._joint(s)
        if self.move.type == "output_line":
            return PathSample(self._line(self.y_start, np.array(self.move.displacement), s))
        axes = ["xyz".index(axis) for axis in self.equations.model.output.axes]
        if self.pose:
            axes = [0, 1, 2]
        y = self._line(self.p_start[axes], np.array(self.move.displacement)[axes], s)
        if not self.pose:
            return PathSample(y)
        w = self.axis[None, :, None] * (self.angle * s[:, None, 1:])
        return PathSample(y, _rotations(self.axis, self.angle * s[:, 0]) @ self.R_start, w)

    @staticmethod
    def _line(start: np.ndarray, displacement: np.ndarray, s: np.ndarray) -> np.ndarray:
        y = displacement[None, :, None] * s[:, None, :]
        y[:, :, 0] += start
        return y

    @cached_property
    def _along(self) -> ca.Function:
        """Output and its derivatives with respect to s along the straight line in joint space."""
        model = self.equations.model
        s = ca.SX.sym("s")
        delta = ca.DM(self.full(self.move.end) - self.q_start)
        q = ca.DM(self.q_start) + delta * s
        y = self.equations.function("output")(q)
        outputs = [y]
        for _ in range(ORDER):
            outputs.append(ca.jacobian(outputs[-1], s))
        if model.output.type == "tool_pose":
            R = self.equations.function("forward_kinematics")(q)[1]
            w = ca.mtimes(self.equations.function("jacobian")(q), delta)[3:]
            turning = [w]
            for _ in range(ORDER - 1):
                turning.append(ca.jacobian(turning[-1], s))
            outputs += [ca.densify(R), *turning]
        return ca.Function("along", [s], [ca.densify(x) for x in outputs])

    def _joint(self, s: np.ndarray) -> PathSample:
        values = evaluate(self._along, s[:, 0][:, None])
        y = np.stack(chain_rule(values[: ORDER + 1], s), axis=-1)
        delta = np.array(self.move.end) - np.array(self.move.start)
        q_g = self._line(np.array(self.move.start), delta, s)
        if not self.pose:
            return PathSample(y, q_g=q_g)
        R, turning = values[ORDER + 1], values[ORDER + 2 :]
        inner = chain_rule(turning, s)  # d^k/dt^k of w_s(s(t))
        w = [
            sum((comb(k, i) * inner[i] * s[:, k - i + 1, None] for i in range(k + 1)), np.zeros((len(s), 3)))
            for k in range(ORDER)
        ]
        return PathSample(y, R, np.stack(w, axis=-1), q_g)


def _rotations(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) about one axis."""
    x, y, z = axis
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sine * hat + (1 - cosine) * (hat @ hat)
