"""The joints of the rigid arm while its output follows a reference, and the limits that they have to keep."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from flexgen.errors import ArgumentError, SolverError
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.outputs import output_map
from flexgen.numerics.evaluate import evaluate
from flexgen.paths.reference import PathSample

STEPS = 40  # of Newton's method
CLOSE = 1e-12  # rad or m: a step that is smaller is the last
REACHED = 1e-9  # of the output
FINER = 8  # parts between two instants
JUMP = 1.0  # rad or m: longest step of Newton's method; more leads to another posture
SINGULAR = 1e-7  # relative size of the smallest singular value of the output's rate


class Posture:
    """Inverse kinematics of a model without deflection, as many outputs as actuated coordinates."""

    def __init__(self, equations: Equations) -> None:
        self.equations, self.model = equations, equations.model

    @cached_property
    def _place(self) -> ca.Function:
        map_, symbol = output_map(self.equations), self.equations.lagrangian.chain.q_a
        if self.model.output.size != self.model.n_g:
            raise ArgumentError(
                f"model {self.model.name}: {self.model.output.size} outputs and {self.model.n_g} actuated coordinates, "
                "expected as many: the output does not determine the posture"
            )
        slope = ca.densify(ca.jacobian(map_.error, symbol[list(self.model.i_g)]))
        return ca.Function("place", [symbol, map_.target], [map_.error, slope])

    @cached_property
    def _rate(self) -> ca.Function:
        map_, symbol = output_map(self.equations), self.equations.lagrangian.chain.q_a
        v = ca.SX.sym("v", self.model.n_a)
        bend = ca.jtimes(ca.mtimes(map_.rate, v), symbol, v)  # W' v
        return ca.Function("rate", [symbol, v], [ca.densify(map_.rate[:, list(self.model.i_g)]), ca.densify(bend)])

    def follow(self, sample: PathSample, q_g: np.ndarray) -> np.ndarray:
        """Actuated coordinates (n, n_g) along a reference, each from the one before, the first from ``q_g``.

        SolverError where the reference leaves the workspace or passes a singular pose.
        """
        targets = sample.y[:, :, 0]
        if sample.R is not None:
            targets = np.hstack([targets, sample.R.transpose(0, 2, 1).reshape(-1, 9)])
        i_g = list(self.model.i_g)
        q = np.zeros(self.model.n_a)
        q[i_g] = q_g
        out = np.zeros((len(targets), len(i_g)))
        for k, target in enumerate(targets):
            if k > 1:
                q[i_g] += out[k - 1] - out[k - 2]  # the postures go on as they did
            for _ in range(STEPS):
                error, slope = (np.array(x) for x in self._place(q, target))
                sizes = np.linalg.svd(slope, compute_uv=False)
                if not sizes[-1] > SINGULAR * sizes[0]:
                    raise SolverError(f"inverse kinematics: a singular pose {_share(k, len(targets))}")
                step = np.linalg.solve(slope, -error[:, 0])
                q[i_g] += step * min(1.0, JUMP / max(float(np.abs(step).max()), 1e-300))
                if np.abs(step).max() < CLOSE * (1 + np.abs(q).max()):
                    break
            if not np.abs(error).max() < REACHED * (1 + np.abs(target).max()):
                raise SolverError(
                    f"inverse kinematics: no posture {_share(k, len(targets))}, error {np.abs(error).max():.2e}; "
                    "the path leaves the workspace or passes a singular pose"
                )
            out[k] = q[i_g]
        return out

    def rates(self, sample: PathSample, q_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Speeds and accelerations (n, n_g) that go with postures on a reference."""
        n, i_g = len(q_g), list(self.model.i_g)
        q, v = np.zeros((n, self.model.n_a)), np.zeros((n, self.model.n_a))
        q[:, i_g] = q_g
        W = evaluate(self._rate, q, v)[0].reshape(n, len(i_g), -1)
        v_g = np.linalg.solve(W, sample.rates(1)[:, :, None])[:, :, 0]
        v[:, i_g] = v_g
        bend = evaluate(self._rate, q, v)[1].reshape(n, -1)
        return v_g, np.linalg.solve(W, (sample.rates(2) - bend)[:, :, None])[:, :, 0]

    @property
    def limited(self) -> bool:
        """Whether the model has any limit of speed or acceleration."""
        dofs = [self.model.coordinates[i].dof for i in self.model.i_g]
        return any(d is not None and (d.speed_max or d.acceleration_max) for d in dofs) or any(
            motor.speed_max for motor in self.model.motors
        )

    def excess(self, v: np.ndarray, a: np.ndarray) -> float:
        """By which factor motions (n, n_g) at even instants have to be slowed for all limits to hold; below 1: by none.

        Between the instants they are taken for cubic splines.
        """
        factor = 0.0
        n = np.arange(len(v))
        fine = np.linspace(0, len(v) - 1, FINER * (len(v) - 1) + 1)
        v, a = (np.vstack([x, CubicSpline(n, x)(fine)]) for x in (v, a))
        for k, i in enumerate(self.model.i_g):
            dof = self.model.coordinates[i].dof
            if dof is not None and dof.speed_max:
                factor = max(factor, float(np.abs(v[:, k]).max()) / dof.speed_max)
            if dof is not None and dof.acceleration_max:
                factor = max(factor, float(np.sqrt(np.abs(a[:, k]).max() / dof.acceleration_max)))
        turns = np.abs(v @ self.model.eta.T).max(axis=0)
        for turn, motor in zip(turns, self.model.motors, strict=True):
            if motor.speed_max:
                factor = max(factor, float(turn) / motor.speed_max)
        return factor


def _share(k: int, n: int) -> str:
    return "at its start" if k == 0 else f"after {100 * k / (n - 1):.3g} % of its time"
