"""Rigid-body parameters from the torques along recorded motions: regressor, base parameters, feasible fit.

    tau_m = eta^-T Y(q, v, a) pi + J_m eta a + F phi,      pi: mass, mass x center of mass, inertia about the origin

of each body (10 numbers, the payload in the last body); F: viscous friction, Coulomb friction, a constant and a change
of the rotor's inertia for each motor, and functions of chosen joints for a counterbalance. The torques are linear in
pi; only some combinations, the base parameters, can be determined. An unconstrained fit gives bodies that are
not physically consistent: here the pseudo-inertia

    P = [[tr(I)/2 1 - I, h], [h', m]] = L L'

of each body is positive definite by its factor L, and the bodies of the model file are a weak prior.

Source: M. Gautier and W. Khalil, IEEE TRA 6(3), 1990 (base parameters); P. Wensing, S. Kim and J.-J. Slotine, IEEE RA-L
3(1), 2018 (pseudo-inertia); C. Rucker and P. Wensing, IEEE RA-L 7(2), 2022 (log-Cholesky parameters).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np

from flexgen.analysis.feasible_bodies import Feasible, body_of, numbers_of, scales
from flexgen.analysis.feasible_motors import is_possible
from flexgen.errors import ArgumentError
from flexgen.identification.recordings import rigid_accuracy
from flexgen.identification.recordings.counterbalances import fitted_balances, held_balances
from flexgen.identification.recordings.rigid_accuracy import RigidStatus
from flexgen.mechanics.equations import Equations
from flexgen.model.elements import Body, Friction, Motor, RobotModel
from flexgen.model.format_robot import HARMONICS
from flexgen.model.friction import refuse_harmonics
from flexgen.model.reader import read
from flexgen.numerics.evaluate import evaluate
from flexgen.numerics.polynomial_filter import WINDOW, derivatives, smooth_forces
from flexgen.numerics.residual_statistics import covariance, parts_of, rms
from flexgen.numerics.trust_region import Sums, minimize

COULOMB_SPEED = 5e-4  # rad/s or m/s, arm side: width of the Coulomb step
MOVING = 0.01  # rad/s or m/s: slower samples are not judged, friction at standstill is not determined
CORRELATED = 50  # samples that share one error: the errors of a model are not white
PRIOR = 1.0  # relative deviation of the bodies of the model file
RANK = 1e-9  # of singular values of base parameters
PARTS, PARTS_MOST = 4, 100  # parts of each recording that are left out in turn
BODY = ("mass", "com_x", "com_y", "com_z", "inertia_xx", "inertia_yy", "inertia_zz", "inertia_xy", "inertia_yz",
          "inertia_xz")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded motion: ``t`` (n,) [s], ``q`` (n, n_g) [rad or m, joints], ``tau_m`` (n, n_m) [N m, motor side]."""

    t: np.ndarray
    q: np.ndarray
    tau_m: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.t)
        if self.q.ndim != 2 or self.tau_m.ndim != 2 or len(self.q) != n or len(self.tau_m) != n or n <= WINDOW:
            raise ArgumentError(
                f"motion: given t {self.t.shape}, q {self.q.shape}, tau_m {self.tau_m.shape}, expected (n,), (n, n_g), "
                f"(n, n_m) with n > {WINDOW}"
            )
        for name in ("t", "q", "tau_m"):
            bad = np.argwhere(~np.isfinite(getattr(self, name)))
            if len(bad):
                raise ArgumentError(f"motion: {name} is not finite at sample {bad[0][0]}")
        steps = np.diff(self.t)
        if not np.all(np.abs(steps - np.median(steps)) < 0.05 * np.median(steps)):
            k = int(np.argmax(np.abs(steps - np.median(steps))))
            raise ArgumentError(
                f"motion: the time goes from {self.t[k]:.6g} to {self.t[k + 1]:.6g} s, expected equal steps"
            )

    @cached_property
    def derivatives(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Joints, speeds and accelerations (n, n_g), from polynomials over `WINDOW` samples."""
        return derivatives(self.q, float(np.median(np.diff(self.t))))

    @cached_property
    def torques(self) -> np.ndarray:
        """Torques (n, n_m) through the filter of the accelerations: faster torques are not those of a rigid body."""
        return smooth_forces(self.tau_m)


class Regressor:
    """``Y(q, v, a)`` of a chain of rigid bodies: torques of the arm for each of the 10 numbers of each body.

    Parameters
    ----------
    model : RobotModel
        Its gears are taken as rigid; springs without motor are refused.
    """

    def __init__(self, model: RobotModel) -> None:
        if model.n_e:
            raise ArgumentError(
                f"model {model.name}: given {model.n_e} coordinates without motor, expected a rigid arm"
            )
        refuse_harmonics(model, "identify_rigid")
        self.model = model
        names = [f"{element.name}.{name}" for element in model.elements for name in BODY]
        empty = replace(model, payload=Body())
        equations = Equations(empty, names)
        lag = equations.lagrangian
        # The torques are linear in mass, mass x center and inertia about the origin: their derivatives in these at a
        # body of mass 1 at its origin are those in mass, center and inertia about the center.
        at = [1.0 if p.name.endswith(".mass") else 0.0 for p in equations.parameters]
        Y = ca.substitute(ca.jacobian(equations.arm_left, equations.symbols), equations.symbols, ca.DM(at))
        self._function = ca.Function("regressor", [lag.chain.q_a, lag.chain.v_a, lag.a_a], [ca.densify(Y)])
        self.names = tuple(p.name for p in equations.parameters)

    def __call__(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """The regressor at n states, (n, n_a, 10 bodies)."""
        return evaluate(self._function, q, v, a)[0].reshape(-1, self.model.n_a, len(self.names))

    def bodies(self, pi: np.ndarray) -> tuple[Body, ...]:
        """Bodies with these numbers (10 bodies,)."""
        return tuple(body_of(row) for row in pi.reshape(-1, 10))

    def of_model(self) -> np.ndarray:
        """The numbers of the bodies of the model, payload in the last one, (10 bodies,)."""
        rows = [numbers_of(element.body) for element in self.model.elements]
        rows[-1] = rows[-1] + numbers_of(self.model.payload)
        return np.concatenate(rows)

    def base_parameters(self, states: int = 500, seed: int = 0) -> int:
        """Number of combinations that any motion can determine: the rank at random states."""
        rng = np.random.default_rng(seed)
        Y = self(*(rng.uniform(-2, 2, (states, self.model.n_a)) for _ in range(3))).reshape(-1, len(self.names))
        values = np.linalg.svd(Y / np.maximum(np.linalg.norm(Y, axis=0), 1e-300), compute_uv=False)
        return int((values > RANK * values[0]).sum())


@dataclass(frozen=True, eq=False)
class RigidFit:
    """Result of `identify_rigid`.

    ``model``: with the new bodies, rotors, frictions and counterbalance; ``file``: the model before; ``pi``
    (10 bodies,); ``friction`` (n_m, columns): coefficients of each motor, motor side: viscous [N m s/rad of the joint],
    Coulomb and constant [N m], rotor [N m s^2/rad of the joint], then those of the counterbalance [N m]; ``sd`` (n_m,)
    [N m]: deviation of the torques from the model; ``covariance``: of ``pi`` and then of ``friction`` row by row;
    ``left_out`` (n_m,): errors on parts of the recordings that were left out of the fit, as `relative_errors`; None:
    not computed; ``status``: from these.
    """

    model: RobotModel
    file: RobotModel
    pi: np.ndarray
    friction: np.ndarray
    sd: np.ndarray
    base_parameters: int
    counterbalance: dict[str, int]
    covariance: np.ndarray
    left_out: np.ndarray | None
    status: RigidStatus

    @property
    def numbers_sd(self) -> np.ndarray | None:
        """Standard deviations of ``pi`` and then of ``friction`` row by row; None where the status has none."""
        return np.sqrt(np.diag(self.covariance)) if self.status.has_deviations else None

    def validated(self, fitted: Sequence[Motion], others: Sequence[Motion]) -> RigidFit:
        """The fit with the status that it has on recordings that were not fitted.

        Parameters
        ----------
        fitted, others : sequences of Motion
            Those of the fit, and others.
        """
        if self.status is RigidStatus.MODEL_ERROR:
            return self
        (error, scale), (there, there_scale) = (self._errors(motions) for motions in (fitted, others))
        return replace(self, status=rigid_accuracy.status_of(error, scale, there, there_scale))

    def _errors(self, motions: Sequence[Motion]) -> tuple[np.ndarray, np.ndarray]:
        """Rms of the errors and deviations of the torques of samples that move (n_m,)."""
        columns = _Columns(Regressor(self.file), motions, self.counterbalance)
        return columns.errors(self.pi, self.friction)

    def torques(self, motion: Motion) -> np.ndarray:
        """Torques of the motors along a motion (n, n_m) [N m], motor side."""
        columns = _Columns(Regressor(self.file), [motion], self.counterbalance)
        found: np.ndarray = columns.torques(self.pi, self.friction)[0]
        return found

    def gear_torques(self, motion: Motion) -> np.ndarray:
        """Torques through the gears (n, n_g), arm side: those of the motors less friction and rotors."""
        columns = _Columns(Regressor(self.file), [motion], self.counterbalance)
        friction = np.einsum("njc,jc->nj", columns.F[0][:, :, :4], self.friction[:, :4])  # a counterbalance is a load
        out: np.ndarray = (motion.torques - columns.known[0] - friction) @ self.file.eta
        return out

    def relative_errors(self, motion: Motion) -> np.ndarray:
        """Rms of the error over the standard deviation of the torque of each motor, of samples that move (n_m,).

        Both through the filter of the motion.
        """
        error, scale = self._errors([motion])
        return error / scale


def identify_rigid(
    model: RobotModel | str | Path,
    motions: Sequence[Motion],
    *,
    counterbalance: Mapping[str, int] | None = None,
    prior: float = PRIOR,
    parts: int = PARTS,
) -> RigidFit:
    """Fit bodies and friction of a rigid arm to recorded motions.

    Parameters
    ----------
    model : RobotModel, str or Path
        Its bodies are the prior, its rotors and gear ratios are kept.
    motions : sequence of Motion
    counterbalance : mapping, optional
        Name of a joint -> number of harmonics of its angle, from the second one, that the torque of its motor may have
        in addition to gravity, which has the first. Harmonics of the file that are not fitted stay.
    prior : float
        Relative standard deviation of the bodies of the file.
    parts : int
        Each recording is cut into so many parts; the fit is repeated without each of them, and judged by its errors
        there. 0: it is not checked.

    Raises
    ------
    ArgumentError
        The motions do not fit the robot.
    """
    robot = model if isinstance(model, RobotModel) else read(model)
    regressor = Regressor(robot)
    extra = dict(counterbalance or {})
    joints = [robot.coordinates[i].name for i in robot.i_g]
    for name, count in extra.items():
        if name not in joints or not isinstance(count, int) or count < 1:
            raise ArgumentError(
                f"counterbalance: given {name!r}: {count!r}, expected one of {', '.join(joints)} and >= 1"
            )
        if count > HARMONICS - 1:
            raise ArgumentError(
                f"counterbalance: given {count} harmonics for {name!r}, expected {HARMONICS - 1} at most"
            )
        if (
            np.count_nonzero(robot.eta[:, joints.index(name)]) > 1
            or robot.coordinates[robot.i_g[joints.index(name)]].unit != "rad"
        ):
            raise ArgumentError(f"counterbalance: given {name!r}, expected a rotation with a motor of its own")
    for motion in motions:
        if motion.q.shape[1] != robot.n_g or motion.tau_m.shape[1] != robot.n_m:
            raise ArgumentError(
                f"motion: given {motion.q.shape[1]} joints and {motion.tau_m.shape[1]} motors, expected {robot.n_g}, "
                f"{robot.n_m}"
            )
    if not motions or not prior > 0:
        raise ArgumentError("motions, prior: expected at least one motion and a deviation > 0")
    if not isinstance(parts, int) or not (parts == 0 or 2 <= parts <= PARTS_MOST):
        raise ArgumentError(f"parts: given {parts!r}, expected 0 or 2 to {PARTS_MOST}")
    columns = _Columns(regressor, motions, extra)
    file = pi = regressor.of_model()
    sd = np.maximum(np.std(np.vstack(columns.measured), axis=0), 1e-12)
    friction = np.zeros((robot.n_m, columns.F[0].shape[2]))
    for _ in range(4):  # the weights follow the errors
        pi, friction = _fit_bodies(columns, file, pi, sd, prior)
        error = np.vstack([m - t for m, t in zip(columns.measured, columns.torques(pi, friction), strict=True)])
        sd = np.maximum(np.sqrt(np.mean(error**2, axis=0)), 1e-9 * sd)
    error_rms, scale = columns.errors(pi, friction)
    there = None if parts == 0 else _leave_out(columns, file, pi, sd, prior, parts)
    status = rigid_accuracy.status_of(error_rms, scale, there, None if there is None else scale)
    bodies = regressor.bodies(pi)
    balances = fitted_balances(robot, extra, friction)
    elements = tuple(
        replace(e, body=body, dofs=tuple(replace(dof, counterbalance=balances[dof.name]) for dof in e.dofs))
        for e, body in zip(robot.elements, bodies, strict=True)
    )
    fitted = replace(robot, elements=elements, payload=Body(), motors=_motors(robot, friction))
    covariance = _covariance(columns, file, error, sd, prior)
    if not is_possible(robot, np.concatenate(columns.F), friction, covariance[len(pi) :, len(pi) :], scale):
        status = RigidStatus.MODEL_ERROR
    left_out = None if there is None else there / scale
    return RigidFit(fitted, robot, pi, friction, sd, regressor.base_parameters(), extra, covariance, left_out, status)


def _leave_out(
    columns: _Columns, file: np.ndarray, pi: np.ndarray, sd: np.ndarray, prior: float, parts: int
) -> np.ndarray:
    """Rms errors (n_m,) on each part of the recordings of the fit to all others."""
    pieces, error, moving = parts_of([len(m) for m in columns.measured], parts), [], []
    for one in pieces:
        others = columns.part([piece for piece in pieces if piece is not one])
        found = _fit_bodies(others, file, pi, sd, prior)
        here = columns.part([one])
        error.append(here.measured[0] - here.torques(*found)[0])
        moving.append(here.moving[0])
    return rms(np.vstack(error), np.vstack(moving))


def _covariance(columns: _Columns, file: np.ndarray, error: np.ndarray, sd: np.ndarray, prior: float) -> np.ndarray:
    """Covariance of the bodies' numbers and of the frictions, row by row."""
    Y, F = np.concatenate(columns.Y), np.concatenate(columns.F)
    n, motors, count = F.shape
    X = []
    for j in range(motors):
        x = np.zeros((n, len(file) + motors * count))
        x[:, : len(file)] = Y[:, j]
        x[:, len(file) + j * count : len(file) + (j + 1) * count] = F[:, j]
        X.append(x)
    information = np.concatenate([(prior * scales(file)) ** -2.0, np.zeros(motors * count)])
    block = max(1, round(rigid_accuracy.BLOCK_S / columns.step))
    return covariance(X, error, 1.0 / (sd * np.sqrt(CORRELATED)), information, block)


def _motors(model: RobotModel, friction: np.ndarray) -> tuple[Motor, ...]:
    """The motors with the friction and the inertia that were found; a number below zero is not a valid result."""
    out = []
    for j, motor in enumerate(model.motors):
        ratio = float(np.abs(model.eta[j]).max())
        viscous, coulomb, offset, rotor = friction[j, :4].tolist()
        law = Friction(
            viscous=max(viscous / ratio, 0.0),
            coulomb=max(coulomb, 0.0),
            beta=1.0 / (COULOMB_SPEED * ratio) if coulomb > 0 else 0.0,
            offset=offset,
        )
        inertia = motor.inertia + rotor / ratio
        out.append(replace(motor, friction=law, inertia=inertia if inertia > 0 else motor.inertia))
    return tuple(out)


class _Columns:
    """Regressors of motions, motor side: of the bodies Y (n, n_m, 10 bodies), of the motors F (n, n_m, columns)."""

    def __init__(self, regressor: Regressor, motions: Sequence[Motion], counterbalance: Mapping[str, int]) -> None:
        model = regressor.model
        inverse = np.linalg.inv(model.eta).T  # motor torques from arm torques
        inertia = np.array([motor.inertia for motor in model.motors])
        names = [model.coordinates[i].name for i in model.i_g]
        most = max(counterbalance.values(), default=0)
        self.step = float(np.median(np.diff(motions[0].t)))
        held = held_balances(model, counterbalance)
        self.Y, self.F, self.known, self.held = [], [], [], []
        self.measured = [motion.torques for motion in motions]
        self.moving = [np.abs(m.derivatives[1] @ model.eta.T) > MOVING * np.abs(model.eta).max(axis=1) for m in motions]
        for motion in motions:
            q, v, a = motion.derivatives
            self.Y.append(np.einsum("ji,nip->njp", inverse, regressor(q, v, a)))
            speed = v @ model.eta.T
            scale = COULOMB_SPEED * np.abs(model.eta).max(axis=1)
            ratio = np.abs(model.eta).max(axis=1)
            rotor = a @ model.eta.T / ratio
            columns = [speed / ratio, smooth_forces(np.tanh(speed / scale)), np.ones_like(speed), rotor]
            for k in range(2, most + 2):
                for function in (np.sin, np.cos):
                    column = np.zeros_like(speed)
                    for name, count in counterbalance.items():
                        if k < count + 2:
                            j = int(np.argmax(np.abs(model.eta[:, names.index(name)])))
                            column[:, j] = function(k * q[:, names.index(name)])
                    columns.append(column)
            self.F.append(np.stack(columns, axis=2))
            self.known.append(inertia * (a @ model.eta.T))
            relief = np.zeros_like(q)
            for i, name in enumerate(names):
                for k, (sine, cosine) in enumerate(held[name], 1):
                    relief[:, i] += sine * np.sin(k * q[:, i]) + cosine * np.cos(k * q[:, i])
            self.held.append(-relief @ inverse.T)

    def part(self, pieces: Sequence[tuple[int, slice]]) -> _Columns:
        """Some samples of some motions: number of the motion, and samples."""
        out = copy(self)
        for name in ("Y", "F", "known", "held", "measured", "moving"):
            of = getattr(self, name)
            setattr(out, name, [of[run][samples] for run, samples in pieces])
        return out

    def errors(self, pi: np.ndarray, friction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rms of the errors, and deviations of the torques, of samples that move (n_m,); nan: none does."""
        moving, torque = np.vstack(self.moving), np.vstack(self.measured)
        count = moving.sum(axis=0)
        mean = (torque * moving).sum(axis=0) / np.where(count > 0, count, np.nan)
        error = torque - np.vstack(self.torques(pi, friction))
        return rms(error, moving), rms(torque - mean, moving)

    def torques(self, pi: np.ndarray, friction: np.ndarray) -> list[np.ndarray]:
        """Torques of each motion (n, n_m)."""
        return [
            known + held + Y @ pi + np.einsum("njc,jc->nj", F, friction)
            for Y, F, known, held in zip(self.Y, self.F, self.known, self.held, strict=True)
        ]


def _fit_bodies(
    columns: _Columns, file: np.ndarray, start: np.ndarray, sd: np.ndarray, prior: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bodies and friction of least weighted squares; friction is eliminated, since the torques are linear in it."""
    motors = len(sd)
    Y, F, known, held = (np.concatenate(x) for x in (columns.Y, columns.F, columns.known, columns.held))
    target = np.concatenate(columns.measured) - known - held
    weight = 1.0 / (sd * np.sqrt(CORRELATED))
    reduced_Y, reduced_t, solvers = [], [], []
    for j in range(motors):  # the part of rows that friction cannot explain
        U, s, Vt = np.linalg.svd(F[:, j], full_matrices=False)
        keep = s > 1e-9 * s[0]
        U, solve = U[:, keep], (Vt[keep].T / s[keep]) @ U[:, keep].T
        solvers.append(solve)
        reduced_Y.append((Y[:, j] - U @ (U.T @ Y[:, j])) * weight[j])
        reduced_t.append((target[:, j] - U @ (U.T @ target[:, j])) * weight[j])
    big = np.vstack(reduced_Y)
    N, b, c = big.T @ big, big.T @ np.concatenate(reduced_t), float(sum(t @ t for t in reduced_t))
    scale = prior * scales(file)
    maps = Feasible(len(file) // 10)

    def sums(x: np.ndarray) -> Sums:
        pi, J = maps.pi(x), maps.jacobian(x)
        away = (pi - file) / scale
        value = c - 2 * b @ pi + pi @ N @ pi + away @ away
        gradient = N @ pi - b + away / scale
        return float(value), J.T @ gradient, J.T @ (N + np.diag(scale**-2.0)) @ J

    def cost(x: np.ndarray) -> float:
        pi = maps.pi(x)
        away = (pi - file) / scale
        return float(c - 2 * b @ pi + pi @ N @ pi + away @ away)

    x = maps.x(start)
    free = np.full(len(x), np.inf)
    fit = minimize(sums, cost, x, x, np.full(len(x), 1e3), (-free, free))
    pi = maps.pi(fit.x)
    friction = np.array([solvers[j] @ (target[:, j] - Y[:, j] @ pi) for j in range(motors)])
    return pi, friction
