"""Inverse kinematics of the undeflected arm along a reference, and the speed and acceleration
limits of its joints.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import Evaluator, evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel
from flexgen.paths.reference import PathSample

NEWTON_STEPS = 40
CLOSE = 1e-12  # rad or m; Newton's method stops at a smaller step
REACHED = 1e-9  # error of the output that counts as solved
FINER = 8  # subintervals between two instants
# rad or m, longest step of Newton's method; a longer one may find another joint configuration
JUMP = 1.0
SINGULAR = 1e-7  # smallest allowed ratio of the singular values of the output Jacobian
SLACK = 1e-9  # rad or m: distance beyond a range that counts as rounding
MANY = 200  # instants
EVERY = 8  # of more, every eighth is solved alone, those between them at once
AT_ONCE = 8  # steps of Newton's method for those
# rad or m: solutions of those are not farther from their start than this and the change around
# them
NEAR = 0.05
SAME = 1e-6  # of the mean distance of instants; closer ones give no extrapolation


class InverseKinematics:
    """Inverse kinematics of a model without deflections; needs as many outputs as actuated
    coordinates.
    """

    def __init__(self, equations: Equations) -> None:
        self.equations = equations
        self.model = equations.model

    @cached_property
    def _position(self) -> ca.Function:
        """Error of the output to a target, and its Jacobian in the actuated coordinates."""
        map_ = output_map(self.equations)
        symbol = self.equations.lagrangian.chain.q_a
        if self.model.output.size != self.model.n_g:
            raise ArgumentError(
                f"model {self.model.name}: given {self.model.output.size} outputs and "
                f"{self.model.n_g} actuated coordinates, expected equal numbers: otherwise the "
                "output does not determine the joint configuration"
            )
        jacobian = ca.densify(ca.jacobian(map_.error, symbol[list(self.model.i_g)]))
        return ca.Function("position", [symbol, map_.target], [ca.densify(map_.error), jacobian])

    @cached_property
    def _velocity(self) -> ca.Function:
        """Jacobian W of the output in the actuated coordinates, and W' v."""
        map_ = output_map(self.equations)
        symbol = self.equations.lagrangian.chain.q_a
        v = ca.SX.sym("v", self.model.n_a)
        bias = ca.jtimes(ca.mtimes(map_.rate, v), symbol, v)
        return ca.Function(
            "velocity",
            [symbol, v],
            [ca.densify(map_.rate[:, list(self.model.i_g)]), ca.densify(bias)],
        )

    def follow(
        self, sample: PathSample, q_g: np.ndarray, at: np.ndarray | None = None
    ) -> np.ndarray:
        """Solve for the actuated coordinates (n, n_g) along a reference, each from the one before.

        Parameters
        ----------
        sample : PathSample
        q_g : array (n_g)
            Start of the iteration at the first instant.
        at : array (n,), optional
            Instants as parts of the time of the path, for the extrapolation and messages; default:
            equidistant.

        Raises
        ------
        SolverError
            The reference leaves the workspace or passes a singular pose.
        """
        return self._one_by_one(_targets(sample), q_g, at)

    def follow_many(self, sample: PathSample, q_g: np.ndarray, at: np.ndarray) -> np.ndarray:
        """As `follow`, faster: every eighth instant one after the other, then all at once from
        what they interpolate. Where that does not converge nearby, all one after the other.

        ``q_g`` (n_g,): joints before the first instant; ``at`` (n,): instants over the duration.
        """
        targets = _targets(sample)
        if len(targets) > MANY:
            some = np.unique(np.append(np.arange(0, len(targets), EVERY), len(targets) - 1))
            known = self._one_by_one(targets[some], q_g, at[some])
            guess = np.stack([np.interp(at, at[some], column) for column in known.T], axis=1)
            around = np.repeat(np.abs(np.diff(known, axis=0)), np.diff(some), axis=0)
            found = self._at_once(targets, guess, np.vstack([around, around[-1:]]))
            if found is not None:
                return found
        return self._one_by_one(targets, q_g, at)

    def _one_by_one(
        self, targets: np.ndarray, q_g: np.ndarray, at: np.ndarray | None
    ) -> np.ndarray:
        """Actuated coordinates (n, n_g) that reach ``targets``, by Newton's method, each from a
        linear extrapolation of those before; the first from ``q_g``. ``at`` (n,): instants over
        the duration, None: equidistant.

        Raises
        ------
        SolverError
            A pose is singular, or out of the workspace.
        """
        i_g = list(self.model.i_g)
        q = np.zeros(self.model.n_a)
        q[i_g] = q_g
        out = np.zeros((len(targets), len(i_g)))
        position = Evaluator(self._position)
        parts = np.linspace(0.0, 1.0, len(targets)) if at is None else at
        same = 0.0 if at is None else SAME * (at[-1] - at[0]) / max(len(at), 1)
        # instants for the extrapolation
        before = None
        last = 0
        for k, target in enumerate(targets):
            if before is not None:  # linear extrapolation
                ahead = 1.0 if at is None else (at[k] - at[k - 1]) / (at[last] - at[before])
                q[i_g] += ahead * (out[last] - out[before])
            for _ in range(NEWTON_STEPS):
                error, jacobian = position(q, target)
                if self.model.loops and not np.isfinite(jacobian).all():
                    raise SolverError(
                        f"inverse kinematics: loops cannot be closed {_instant(parts[k])}; the "
                        "path goes beyond a dead center of the linkage"
                    )
                sizes = np.linalg.svd(jacobian, compute_uv=False)
                if not sizes[-1] > SINGULAR * sizes[0]:
                    reason = obstacle(self.model, "reduced problem")
                    raise SolverError(
                        f"inverse kinematics: {reason}"
                        if reason
                        else f"inverse kinematics: a singular pose {_instant(parts[k])}"
                    )
                step = np.linalg.solve(jacobian, -error[:, 0])
                q[i_g] += step * min(1.0, JUMP / max(float(np.abs(step).max()), 1e-300))
                if np.abs(step).max() < CLOSE * (1 + np.abs(q).max()):
                    break
            if not np.abs(error).max() < REACHED * (1 + np.abs(target).max()):
                raise SolverError(
                    f"inverse kinematics: no solution {_instant(parts[k])}, error "
                    f"{np.abs(error).max():.2e}; the path leaves the workspace or passes a "
                    "singular pose"
                )
            out[k] = q[i_g]
            if k > 0 and parts[k] - parts[last] > same:
                before = last
                last = k
        return out

    def _at_once(
        self, targets: np.ndarray, guess: np.ndarray, around: np.ndarray
    ) -> np.ndarray | None:
        """Newton's method at all instants from ``guess`` (n, n_g); None where it does not
        converge, passes a singular pose, or goes farther from the guess than the joints move
        ``around`` (n, n_g) the instant.
        """
        i_g = list(self.model.i_g)
        n = len(guess)
        q = np.zeros((n, self.model.n_a))
        q[:, i_g] = guess
        for _ in range(AT_ONCE):
            error, jacobian = evaluate(self._position, q, targets)
            error = error.reshape(n, -1)
            jacobian = jacobian.reshape(n, -1, len(i_g))
            sizes = np.linalg.svd(jacobian, compute_uv=False)
            if not (sizes[:, -1] > SINGULAR * sizes[:, 0]).all():
                return None
            step = np.linalg.solve(jacobian, -error[:, :, None])[:, :, 0]
            q[:, i_g] += step
            if (np.abs(step).max(axis=1) < CLOSE * (1 + np.abs(q).max(axis=1))).all():
                break
        reached = np.abs(error).max(axis=1) < REACHED * (1 + np.abs(targets).max(axis=1))
        nearby = np.abs(q[:, i_g] - guess).max(axis=1) <= around.max(axis=1) + NEAR
        return q[:, i_g] if (reached & nearby).all() else None

    def velocities(self, sample: PathSample, q_g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations (n, n_g) of the actuated coordinates ``q_g`` (n, n_g) along
        a reference: ``W v = y'``, ``W a = y'' - W' v``.
        """
        n = len(q_g)
        i_g = list(self.model.i_g)
        q = np.zeros((n, self.model.n_a))
        v = np.zeros((n, self.model.n_a))
        q[:, i_g] = q_g
        W = evaluate(self._velocity, q, v)[0].reshape(n, len(i_g), -1)
        v_g = np.linalg.solve(W, sample.derivative(1)[:, :, None])[:, :, 0]
        v[:, i_g] = v_g
        bias = evaluate(self._velocity, q, v)[1].reshape(n, -1)
        return v_g, np.linalg.solve(W, (sample.derivative(2) - bias)[:, :, None])[:, :, 0]

    @property
    def has_limits(self) -> bool:
        """Whether the model limits any speed or acceleration."""
        dofs = [self.model.coordinates[i].dof for i in self.model.i_g]
        return any(d is not None and (d.speed_max or d.acceleration_max) for d in dofs) or any(
            motor.speed_max for motor in self.model.motors
        )

    def slowdown(self, v: np.ndarray, a: np.ndarray) -> float:
        """Factor by which the time of a motion must be multiplied to meet all limits; at most 1:
        none is exceeded.

        ``v``, ``a`` (n, n_g) or (n, m, n_g) of m motions: velocities and accelerations at
        equidistant instants, interpolated by cubic splines.
        """
        factor = 0.0
        n = np.arange(len(v))
        fine = np.linspace(0, len(v) - 1, FINER * (len(v) - 1) + 1)
        v, a = (
            np.concatenate([x, CubicSpline(n, x)(fine)]).reshape(-1, x.shape[-1]) for x in (v, a)
        )
        for k, i in enumerate(self.model.i_g):
            dof = self.model.coordinates[i].dof
            if dof is not None and dof.speed_max:
                factor = max(factor, float(np.abs(v[:, k]).max()) / dof.speed_max)
            if dof is not None and dof.acceleration_max:
                factor = max(factor, float(np.sqrt(np.abs(a[:, k]).max() / dof.acceleration_max)))
        speeds = np.abs(v @ self.model.eta.T).max(axis=0)
        for speed, motor in zip(speeds, self.model.motors, strict=True):
            if motor.speed_max:
                factor = max(factor, float(speed) / motor.speed_max)
        return factor


def beyond_range(robot: RobotModel, q_g: np.ndarray) -> tuple[str, ...]:
    """Sentences about the actuated coordinates (n, n_g) [rad or m] that leave their ranges of the
    model file.
    """
    out = []
    for k, i in enumerate(robot.i_g):
        coordinate = robot.coordinates[i]
        dof = coordinate.dof
        if dof is None:
            continue
        low = -np.inf if dof.lower is None else dof.lower
        high = np.inf if dof.upper is None else dof.upper
        beyond = np.maximum(low - q_g[:, k], q_g[:, k] - high)
        worst = int(np.argmax(beyond))
        if beyond[worst] > SLACK:
            out.append(
                f"coordinate {dof.name} goes to {q_g[worst, k]:.4g} {coordinate.unit}, its "
                f"range is {low:.4g} to {high:.4g} {coordinate.unit}"
            )
    return tuple(out)


def _targets(sample: PathSample) -> np.ndarray:
    """Position, and columns of the orientation, of the output (n, ...)."""
    targets = sample.y[:, :, 0]
    return (
        targets
        if sample.R is None
        else np.hstack([targets, sample.R.transpose(0, 2, 1).reshape(-1, 9)])
    )


def _instant(part: float) -> str:
    return "at the start" if part == 0 else f"after {100 * part:.3g} % of the time"
