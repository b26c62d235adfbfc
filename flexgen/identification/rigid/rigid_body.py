"""Rigid-body parameters from the torques along recorded motions: base parameters, feasible fit.

See `flexgen.identification.rigid.rigid_columns` for the torques: they are linear in the numbers pi
of the bodies (10 of each, the payload in the last one), in friction and rotors, and nearly so in
compliances of gears and in a delay. Only some combinations of the bodies' numbers, the base
parameters, can be determined. An unconstrained fit gives bodies that are not physically
consistent: here the pseudo-inertia

    P = [[tr(I)/2 1 - I, h], [h', m]] = L L'

of each body is positive definite by its factor L, and the bodies of the model file are a weak
prior. The payload of the file is a known constant: pi = pi_bodies(L) + pi_payload, and only the
bodies without it are fitted.

Source: M. Gautier and W. Khalil, IEEE TRA 6(3), 1990 (base parameters); P. Wensing, S. Kim and
J.-J. Slotine, IEEE RA-L 3(1), 2018 (pseudo-inertia); C. Rucker and P. Wensing, IEEE RA-L 7(2),
2022 (log-Cholesky parameters).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flexgen.base.calls.deadline import best_known, is_over, reason_of_end
from flexgen.base.errors import ArgumentError
from flexgen.identification.estimator.covariance import Blocks, covariance_of
from flexgen.identification.estimator.minimize import minimize
from flexgen.identification.estimator.problem import Prior, Problem, Sums
from flexgen.identification.estimator.residuals import rms
from flexgen.identification.estimator.score import Limit
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.estimator.validation import Piece, parts_of, validate
from flexgen.identification.rigid import rigid_accuracy
from flexgen.identification.rigid.channel_mistakes import find_channel_mistake
from flexgen.identification.rigid.feasible_bodies import Feasible, scales, units
from flexgen.identification.rigid.feasible_motors import is_possible
from flexgen.identification.rigid.payload_test import (
    NOT_TESTED,
    Normal,
    PayloadTest,
    check_payload,
)
from flexgen.identification.rigid.rigid_columns import BLOCK, Columns, band_of
from flexgen.identification.rigid.rigid_mistakes import Mistake, find_causes
from flexgen.identification.rigid.rigid_model import in_a_file, rigid_model
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor, payload_in
from flexgen.model.elements import RobotModel
from flexgen.model.format.format_robot import HARMONICS
from flexgen.model.reader import read

PRIOR = 1.0  # relative deviation of the bodies of the model file
# rad, or lengths of bodies: deviation of a deflection that the file does not have, under the
# torques
LARGEST = 0.01
# of the period of the band: deviation of the delay of the torques; a sample where that is more
LATE = 1.5e-3
# of fits with deviations from the residuals of the last one, at least and at most
ROUNDS = 4
MOST = 25
FADES_SETTLED = 1e-3  # relative change
# change of the delay, in such periods, and over its deviation: it has settled
SETTLED = 3e-6
SETTLED_SD = 0.2
# parts of each recording that are left out in turn
PARTS = 4
PARTS_MOST = 100


class _Numbers(NamedTuple):
    """Bodies (10 bodies,), frictions (n_m, columns), and lags (n_g + 1,)."""

    pi: np.ndarray
    friction: np.ndarray
    lags: np.ndarray


class _Prior(NamedTuple):
    """Bodies of the file, their deviations, and those of the lags, which are zero in the file.

    ``pi``: with the payload; ``payload``: what the payload has in it, known.
    """

    pi: np.ndarray
    sd: np.ndarray
    lags_sd: np.ndarray
    payload: np.ndarray

    def information(self, frictions: int) -> np.ndarray:
        """Of the bodies, of so many frictions, which have none, and of the lags."""
        return np.concatenate([self.sd**-2.0, np.zeros(frictions), self.lags_sd**-2.0])


@dataclass(frozen=True, eq=False)
class RigidFit:
    """Result of `identify_rigid`.

    ``model``: with the new bodies, rotors, frictions and counterbalance, and the payload of the
    file; ``file``: the model before; ``pi`` (10 bodies,): with the payload in the last body;
    ``friction`` (n_m, columns): coefficients of each motor, motor side: viscous [N m s/rad of the
    joint], Coulomb and constant [N m], rotor [N m s^2/rad of the joint], then those of the
    counterbalance [N m], and, where ``fades`` has one, friction at rest that falls with speed [N
    m] and a change of its fade; ``sd`` (n_m,) [N m]: deviation of the torques from the model;
    ``covariance``: of ``pi``, then of ``friction`` row by row, then of ``lags``; ``left_out``
    (n_m,): errors on parts of the recordings that were left out of the fit, as `relative_errors`;
    None: not computed; ``status``: from these; ``lags`` (n_g + 1,): compliances of the gears that
    the file does not have [rad/(N m) or m/N, arm side], and the delay of the torques [s];
    ``fades`` (n_m,) [s/rad or s/m, of the joint]: of friction that falls with speed as sigma /
    cosh(fade v), 0: none; ``speed`` (n_m,): see `Columns`; ``limit_hz``: all torques are compared
    below it; ``mistake``: what explains a large part of the errors; ``payload``: whether
    the torques contradict that of the file.
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
    status: FitStatus
    lags: np.ndarray
    fades: np.ndarray
    speed: np.ndarray
    limit_hz: float
    mistake: Mistake | None = None
    payload: PayloadTest = NOT_TESTED

    @property
    def texts(self) -> tuple[str, str]:
        """Sentence and advice of the status."""
        return self.status.texts(rigid_accuracy.TEXTS)

    @property
    def numbers_sd(self) -> np.ndarray | None:
        """Standard deviations of all numbers, as in ``covariance``; None where the status has
        none.
        """
        return np.sqrt(np.diag(self.covariance)) if self.status.has_deviations else None

    @property
    def lags_sd(self) -> np.ndarray | None:
        """Standard deviations of ``lags``; None where the status has none."""
        return None if self.numbers_sd is None else self.numbers_sd[-len(self.lags) :]

    def validated(self, fitted: Sequence[Motion], others: Sequence[Motion]) -> RigidFit:
        """The fit with the status that it has on recordings that were not fitted.

        Parameters
        ----------
        fitted, others : sequences of Motion
            Those of the fit, and others.
        """
        if self.status is FitStatus.MODEL_ERROR:
            return self
        (error, scale), (there, there_scale) = (
            self._errors(motions) for motions in (fitted, others)
        )
        return replace(self, status=rigid_accuracy.status_of(error, scale, there, there_scale))

    def _columns(self, motions: Sequence[Motion], limit: float = np.inf) -> Columns:
        """The terms along motions whose links bend under the torques of this fit, of all
        samples.
        """
        columns = Columns(Regressor(self.file), motions, self.counterbalance, limit, self.speed)
        columns = columns.with_fades(self.fades, self.friction[:, -2])
        return columns.bent(self.pi, self.friction, self.lags, self.limit_hz)

    def _errors(self, motions: Sequence[Motion]) -> tuple[np.ndarray, np.ndarray]:
        """Rms of the errors and deviations of the torques of samples that move (n_m,)."""
        return (
            self._columns(motions, self.limit_hz)
            .below(self.limit_hz)
            .errors(self.pi, self.friction)
        )

    def torques(self, motion: Motion) -> np.ndarray:
        """Torques of the motors that ``model`` needs for a motion (n, n_m) [N m], motor side.

        Gears deflect as in the model, which has neither the compliances nor the delay of ``lags``.
        Comparable with ``motion.torques``: friction is filtered as these are.
        """
        columns = self._of_model([motion], np.inf, 0.0)
        return np.asarray(columns.torques(self.pi, self._friction)[0])

    @property
    def _friction(self) -> np.ndarray:
        """Coefficients of the motors of ``model``, as ``friction``."""
        return in_a_file(self.file, self.friction, self.fades)

    def _of_model(self, motions: Sequence[Motion], limit: float, delay: float) -> Columns:
        """The terms along motions where gears bend as in ``model``."""
        columns = Columns(Regressor(self.file), motions, self.counterbalance, limit, self.speed)
        columns = columns.with_fades(self.fades, self._friction[:, -2])
        return columns.bent_by_model(self.pi, self._friction, delay, self.limit_hz)

    def model_errors(self, motion: Motion) -> np.ndarray:
        """Rms of the error of the torques of ``model`` over the standard deviation of the torque
        of each motor, of samples that move (n_m,).

        That of feedforward with the model, below ``limit_hz``: friction at rest and at reversals
        is not taken out of the torques. The delay of the record is.
        """
        columns = self._of_model([motion], self.limit_hz, float(self.lags[-1]))
        error, scale = columns.below(self.limit_hz, stiction=True).errors(self.pi, self._friction)
        return error / scale

    def gear_torques(self, motion: Motion) -> np.ndarray:
        """Torques through the gears (n, n_g), arm side: those of the motors less friction and
        rotors.
        """
        columns = self._columns([motion])
        friction = columns.of_motors(0, self.friction)  # a counterbalance is a load
        return np.asarray((columns.measured[0] - columns.known[0] - friction) @ self.file.eta)

    def relative_errors(self, motion: Motion) -> np.ndarray:
        """Rms of the error over the standard deviation of the torque of each motor, of samples
        that move (n_m,).

        Both below ``limit_hz``, without what friction can do at rest and at reversals, and with
        the deflections of ``lags``.
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
        Its bodies are the prior, its payload, rotors, gear ratios and springs of gears are kept.
    motions : sequence of Motion
        Of one sample time.
    counterbalance : mapping, optional
        Name of a joint -> number of harmonics of its angle, from the second one, that the torque
        of its motor may have in addition to gravity, which has the first. Harmonics of the file
        that are not fitted stay.
    prior : float
        Relative standard deviation of the bodies of the file.
    parts : int
        Each recording is cut into so many parts; the fit is repeated without each of them, and
        judged by its errors there. 0: it is not checked.

    Raises
    ------
    ArgumentError
        The motions do not fit the robot.
    """
    robot = model if isinstance(model, RobotModel) else read(model)
    regressor = Regressor(robot)
    extra = dict(counterbalance or {})
    _check(robot, motions, extra, prior, parts)
    limit = band_of(regressor, motions)
    file = regressor.of_model()
    flat = Columns(regressor, motions, extra, limit)
    load = np.sqrt(np.mean((np.vstack(flat.measured) @ robot.eta) ** 2, axis=0))
    size = np.where(
        [robot.coordinates[i].unit == "rad" for i in robot.i_g],
        1.0,
        np.divide(*units(file)[1::-1]),
    )
    lags_sd = np.append(
        LARGEST * size / np.maximum(load, 1e-12), max(LATE * flat.period, motions[0].step)
    )
    carried = payload_in(robot)
    weak = _Prior(file, prior * scales(file - carried), lags_sd, carried)
    at = _Numbers(file, np.zeros((robot.n_m, flat.F[0].shape[2])), np.zeros(robot.n_g + 1))
    mistake: Mistake | None = None
    payload = NOT_TESTED
    scales_hidden: tuple[Limit, ...] = ()
    sd = np.maximum(np.std(np.vstack(flat.below(limit).measured), axis=0), 1e-12)
    for _ in range(1 + robot.n_m):  # more only where friction falls with speed
        flat, at, sd, change = _settle(flat, limit, weak, at, sd)
        whole = flat.bent(*at, limit)
        columns = whole.below(limit)
        error = np.vstack(columns.measured) - np.vstack(columns.torques(at.pi, at.friction))
        error_rms, scale = columns.errors(at.pi, at.friction)
        terms = columns.by_motor()
        information = weak.information(at.friction.size)
        weight = 1.0 / (sd * np.sqrt(columns.correlated))
        n = len(file)
        m = len(file) + at.friction.size
        block = max(1, round(BLOCK * flat.period / columns.step))
        blocks = Blocks.of_outputs(terms, error, weight, block)
        found = covariance_of(blocks, np.diag(information))
        payload = check_payload(robot, file, _normal(terms, error, weight, information, at))
        if not (error_rms > rigid_accuracy.NOTICED * scale).any():
            break
        if is_over():
            break
        if (error_rms > rigid_accuracy.LARGE * scale).any():
            if payload.is_clear:
                break
            mistake = find_channel_mistake(regressor, motions, file, weak.sd)
            if mistake is not None:
                break
        mistake, more, scales_hidden = find_causes(
            whole, limit, at[:2], terms, error, weight, information
        )
        if not more.any():
            break
        flat, at = _with_fades(flat, flat.fades + more, at)
    payload = replace(payload, limits=(*payload.limits, *scales_hidden))
    if payload.is_clear:
        mistake = None  # what a payload does may look like it
    elif mistake is not None:
        payload = NOT_TESTED
    skipped = parts == 0 or is_over()
    there = None if skipped else _leave_out(columns, weak, at, sd, parts)
    status = rigid_accuracy.status_of(error_rms, scale, there, None if there is None else scale)
    possible = is_possible(
        robot, np.concatenate(columns.F), at.friction, found[n:m, n:m], scale, flat.fades
    )
    settled = change < max(SETTLED * flat.period, SETTLED_SD * np.sqrt(found[-1, -1]))
    if mistake is not None or not settled or not possible:
        status = FitStatus.MODEL_ERROR
    if reason := reason_of_end():
        status = FitStatus.of_value(reason)
    return RigidFit(
        model=rigid_model(
            robot, regressor.bodies(at.pi - carried), extra, at.friction, flat.fades, flat.speed
        ),
        file=robot,
        pi=at.pi,
        friction=at.friction,
        sd=sd,
        base_parameters=regressor.base_parameters(),
        counterbalance=extra,
        covariance=found,
        left_out=None if there is None else there / scale,
        status=status,
        lags=at.lags,
        fades=flat.fades,
        speed=flat.speed,
        limit_hz=limit,
        mistake=mistake,
        payload=payload,
    )


def _normal(
    terms: list[np.ndarray],
    error: np.ndarray,
    weight: np.ndarray,
    information: np.ndarray,
    at: _Numbers,
) -> Normal:
    """Normal equations at the numbers of a fit."""
    X = np.vstack([x * w for x, w in zip(terms, weight, strict=True)])
    away = np.concatenate([np.zeros(at.friction.size), at.lags])
    others = information[len(at.pi) :]
    return Normal(X.T @ X, X.T @ (error * weight).T.ravel(), at.pi, others, away)


def _settle(
    flat: Columns, limit: float, prior: _Prior, at: _Numbers, sd: np.ndarray
) -> tuple[Columns, _Numbers, np.ndarray, float]:
    """The numbers where the weights follow the errors, the links the torques, the torques the
    delay, and fades theirs.

    Returns the columns before gears deflect, the numbers, the deviations of the torques, and the
    last change of the delay [s].
    """
    columns = (flat.bent(*at, limit) if at.friction.any() else flat).below(limit)
    began = time.perf_counter()
    for k in range(MOST):
        before = at
        at = _fit_bodies(columns, prior, at, sd)
        new = flat.fades
        if new.any():
            new = np.clip(new + at.friction[:, -1], new / 2, 2 * new)
        still = np.abs(new - flat.fades).max(initial=0.0) <= FADES_SETTLED * new.max(initial=0.0)
        flat, at = _with_fades(flat, new, at)
        columns = flat.bent(*at, limit).below(limit)
        error = np.vstack(columns.measured) - np.vstack(columns.torques(at.pi, at.friction))
        sd = np.maximum(rms(error, columns.samples_to_judge()), 1e-9 * sd)
        change = abs(at.lags[-1] - before.lags[-1])
        if k + 1 >= ROUNDS and change < SETTLED * flat.period and still:
            break
        best_known(time.perf_counter() - began)
        if is_over():
            break
    return flat, at, sd, change


def _with_fades(flat: Columns, fades: np.ndarray, at: _Numbers) -> tuple[Columns, _Numbers]:
    """Columns and numbers with these fades of friction that falls with speed."""
    if not fades.any():
        return flat, at
    kept = at.friction[:, :-1] if flat.fades.any() else np.pad(at.friction, ((0, 0), (0, 1)))
    return flat.with_fades(fades, kept[:, -1]), at._replace(
        friction=np.pad(kept, ((0, 0), (0, 1)))
    )


def _check(
    robot: RobotModel,
    motions: Sequence[Motion],
    counterbalance: Mapping[str, int],
    prior: float,
    parts: int,
) -> None:
    """Refuse arguments of `identify_rigid` that do not fit the robot or each other."""
    joints = [robot.coordinates[i].name for i in robot.i_g]
    for name, count in counterbalance.items():
        if name not in joints or not isinstance(count, int) or count < 1:
            raise ArgumentError(
                f"counterbalance: given {name!r}: {count!r}, expected one of "
                f"{', '.join(joints)} and >= 1"
            )
        if count > HARMONICS - 1:
            raise ArgumentError(
                f"counterbalance: given {count} harmonics for {name!r}, expected "
                f"{HARMONICS - 1} at most"
            )
        if (
            np.count_nonzero(robot.eta[:, joints.index(name)]) > 1
            or robot.coordinates[robot.i_g[joints.index(name)]].unit != "rad"
        ):
            raise ArgumentError(
                f"counterbalance: given {name!r}, expected a rotation with a motor of its own"
            )
    for motion in motions:
        if motion.q.shape[1] != robot.n_g or motion.tau_m.shape[1] != robot.n_m:
            raise ArgumentError(
                f"motion: given {motion.q.shape[1]} joints and {motion.tau_m.shape[1]} motors, "
                f"expected {robot.n_g}, {robot.n_m}"
            )
        if abs(motion.step - motions[0].step) > 0.01 * motions[0].step:
            raise ArgumentError(
                f"motion: given samples every {motion.step:.4g} s, expected "
                f"{motions[0].step:.4g} s as in the first one"
            )
    if not motions or not prior > 0:
        raise ArgumentError("motions, prior: expected at least one motion and a deviation > 0")
    if not isinstance(parts, int) or not (parts == 0 or 2 <= parts <= PARTS_MOST):
        raise ArgumentError(f"parts: given {parts!r}, expected 0 or 2 to {PARTS_MOST}")


def _leave_out(
    columns: Columns, prior: _Prior, at: _Numbers, sd: np.ndarray, parts: int
) -> np.ndarray | None:
    """Rms errors (n_m,) on each part of the recordings of the fit to all others; None: the time
    was over.
    """

    def fit(others: list[Piece]) -> _Numbers:
        return _fit_bodies(columns.part(others), prior, at, sd)

    def errors(found: _Numbers, one: Piece) -> np.ndarray:
        here = columns.part([one])
        late = here.Z[0] @ (found.lags - at.lags)
        return here.measured[0] - here.torques(found.pi, found.friction)[0] - late

    pieces = parts_of([len(m) for m in columns.measured], parts)
    error = validate(pieces, fit, errors)
    if error is None:
        return None
    return rms(np.vstack(error), np.vstack([columns.part([one]).moving[0] for one in pieces]))


def _fit_bodies(columns: Columns, prior: _Prior, start: _Numbers, sd: np.ndarray) -> _Numbers:
    """The numbers of least weighted squares; friction and lags are eliminated, since the torques
    are linear in them.
    """
    Y, F, Z, known, held = (
        np.concatenate(x) for x in (columns.Y, columns.F, columns.Z, columns.known, columns.held)
    )
    target = np.concatenate(columns.measured) - known - held
    weight = 1.0 / (sd * np.sqrt(columns.correlated))
    X = np.concatenate([Y, Z], axis=2)
    reduced_X = []
    reduced_t = []
    solvers = []
    for j in range(len(sd)):  # the part of rows that friction cannot explain
        U, s, Vt = np.linalg.svd(F[:, j], full_matrices=False)
        keep = s > 1e-9 * s[0]
        U = U[:, keep]
        solve = (Vt[keep].T / s[keep]) @ U.T
        solvers.append(solve)
        reduced_X.append((X[:, j] - U @ (U.T @ X[:, j])) * weight[j])
        reduced_t.append((target[:, j] - U @ (U.T @ target[:, j])) * weight[j])
    big = np.vstack(reduced_X)
    n = len(prior.pi)
    N = big.T @ big
    b = big.T @ np.concatenate(reduced_t)
    P = prior.lags_sd**-2.0
    lagged = np.linalg.solve(
        N[n:, n:] + np.diag(P), np.column_stack([N[n:, :n], b[n:] - P * start.lags])
    )
    b = b[:n] - N[:n, n:] @ lagged[:, n]
    N = N[:n, :n] - N[:n, n:] @ lagged[:, :n]
    maps = Feasible(n // 10, units(prior.pi - prior.payload))
    square = sum(float(t @ t) for t in reduced_t)

    def cost(x: np.ndarray) -> float:
        pi = maps.pi(x) + prior.payload
        away = (pi - prior.pi) / prior.sd
        return float(square + pi @ N @ pi - 2 * b @ pi + away @ away)

    def sums(x: np.ndarray) -> Sums:
        pi = maps.pi(x) + prior.payload
        J = maps.jacobian(x)
        gradient = N @ pi - b + (pi - prior.pi) / prior.sd**2
        return cost(x), J.T @ gradient, J.T @ (N + np.diag(prior.sd**-2.0)) @ J

    x = maps.x(start.pi - prior.payload)
    free = np.full(len(x), np.inf)
    near = Prior.of_sd(x, np.full(len(x), 1e3))
    best = minimize(Problem.of_sums(sums, cost, near, (-free, free)), x)
    pi = maps.pi(best.x) + prior.payload
    change = lagged[:, n] - lagged[:, :n] @ pi
    rest = target - Y @ pi - Z @ change
    return _Numbers(
        pi, np.array([solve @ rest[:, j] for j, solve in enumerate(solvers)]), start.lags + change
    )
