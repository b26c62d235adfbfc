"""Torques of the motors of a rigid arm along recorded motions, term by term, and what gears and
delays change.

    tau_m(t) = eta^-T Y(q, v, a) pi + J_m eta a + F phi,      q(t) = eta^-1 q_m(t) - d(t),
    d = law(tau_g) + c tau_g

F: viscous friction, Coulomb friction, a constant and a change of the rotor's inertia for each
motor, functions of chosen joints for a counterbalance, and friction that falls with speed, sigma /
cosh(alpha v). The links follow the motors less the deflections d of the gears, those of the model
file and more in proportion to the torque: without them, a hundredth of the torque is wrong, and no
block of the errors shows it. The torques tau_g that bend them are those recorded, less rotors and
friction: from the bodies, they would grow from round to round above the lowest natural frequency.
Torques are recorded a delay later than the angles; the delay and the compliances c are numbers of
a fit.

All terms are filtered alike, and so the equation holds for what is kept: what is slower than the
limit, and what friction at standstill cannot do (see
`flexgen.identification.rigid.rests_of_motors`).

Source: M. Gautier, ICRA 1997 (the same filter for all terms).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from scipy.interpolate import make_interp_spline

from flexgen.base.numerics.low_pass import LENGTH, LowPass, bandwidth
from flexgen.base.numerics.polynomial_filter import WINDOW, smooth_forces
from flexgen.dynamics.mechanics.statics import gear_damping, gear_deflection
from flexgen.identification.estimator.residuals import rms
from flexgen.identification.rigid.counterbalances import held_balances
from flexgen.identification.rigid.rests_of_motors import MOVING, Rests, largest_of_unit
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor

COULOMB_SPEED = 5e-4  # of the largest speed: width of the Coulomb step
BAND = 5.0  # limit of the filter over the band of the motion
SHORTEST = 4.0  # length of a record over that of the filter
# samples of a whole record that share one error: the errors of a model are not white
CORRELATED = 50
# limit of the filter times the step, from which on the polynomials are the filter
WIDEST = 2.0 / WINDOW
BLOCK = 0.75  # periods of the band of the motion: blocks whose errors are taken as independent
# limit of the torques that bend gears over that of the filter, which would count twice
WIDER = 4.0
# of the splines whose derivatives are taken: finite differences bend gears up to a percent too
# little
DEGREE = 5
RATE = 20.0  # samples that are kept before the filter, over its limit
FADED = 300.0  # fade times speed, from which on nothing of the friction is there
# rounds of the deflections under the torques of a model: each leaves a part of their error of the
# square of the frequency over the natural one
BENDS = 2
SOME = 500  # samples of a motion that show the size of the torques
TERMS = ("Y", "F", "Z", "known", "held", "measured")


def band_of(regressor: Regressor, motions: Sequence[Motion]) -> float:
    """Limit of the filter [Hz]: a multiple of the band of the powers of the joints; infinite: none
    is of use.
    """
    step = motions[0].step
    file = regressor.of_model()
    some = [tuple(x[:: max(1, len(x) // SOME)] for x in motion.derivatives) for motion in motions]
    size = np.sqrt(np.mean(np.vstack([regressor(*state) @ file for state in some]) ** 2, axis=0))
    limit = BAND * bandwidth(
        [motion.derivatives[1] * size[list(regressor.model.i_g)] for motion in motions], step
    )
    limit = max(limit, SHORTEST * LENGTH / (min(len(motion.t) for motion in motions) * step))
    return limit if limit * step < WIDEST else np.inf


class Columns:
    """Terms of the torques of motions, motor side.

    Of the bodies Y (n, n_m, 10 bodies), of the motors F (n, n_m, columns), of changes of the
    compliances and of the delay Z (n, n_m, n_g + 1); known rotors, held counterbalances and
    frictions of joints that the file states, and measured torques (n, n_m). Only so many samples
    are kept as have what is slower than ``limit`` [Hz]. ``speed`` (n_m,) [rad/s or m/s, of the
    joint]: the largest one of the joints of this unit, in the motions of the fit; ``period`` [s]:
    of the band of the motion.
    """

    def __init__(
        self,
        regressor: Regressor,
        motions: Sequence[Motion],
        counterbalance: Mapping[str, int],
        limit: float = np.inf,
        speed: np.ndarray | None = None,
    ) -> None:
        model = regressor.model
        step = motions[0].step
        every = (
            1
            if np.isinf(limit)
            else max(1, int(1 / (step * max(2 * WIDEST / step + limit, RATE * limit))))
        )
        self.regressor = regressor
        self.step = every * step
        self.t = [motion.t[::every] - motion.t[0] for motion in motions]
        self.states = [tuple(x[::every] for x in motion.derivatives) for motion in motions]
        self.links = self.states
        self.recorded = [motion.torques[::every] for motion in motions]
        self.correlated = float(CORRELATED)
        self._inverse = np.linalg.inv(model.eta).T  # motor torques from arm torques
        ratio = np.abs(model.eta).max(axis=1)
        inertia = np.array([motor.inertia for motor in model.motors])
        self._names = [model.coordinates[i].name for i in model.i_g]
        self._counterbalance = counterbalance
        self.fades = np.zeros(model.n_m)
        self._speeds = [motion.derivatives[1] @ model.eta.T / ratio for motion in motions]
        top = largest_of_unit(model, np.vstack(self._speeds))
        self.speed = np.maximum(top, 1e-12) if speed is None else speed
        self.period = BAND / min(limit, WIDEST / step)
        self._every = every
        self.Y = []
        self.F = []
        self.Z = []
        self.known = []
        self.held = []
        self.braking: list[np.ndarray] = []
        self.measured = self.recorded
        moving = [np.abs(v) > MOVING * self.speed for v in self._speeds]
        self.moving = [x[::every] for x in moving]
        self._moves = np.vstack(moving).any(axis=0)  # torques of motors that never do are kept
        self._rests: dict[float, list[list[Rests]]] = {}
        for motion, (q, v, a) in zip(motions, self.states, strict=True):
            self.Y.append(self.motor_side(regressor(q, v, a)))
            self.Z.append(np.zeros((len(q), model.n_m, model.n_g + 1)))
            speed = v @ model.eta.T
            rotor = a @ model.eta.T / ratio
            width = COULOMB_SPEED * self.speed * ratio
            sign = smooth_forces(np.tanh(motion.derivatives[1] @ model.eta.T / width))[::every]
            columns = np.stack([speed / ratio, sign, np.ones_like(speed), rotor], axis=2)
            self.F.append(np.concatenate([columns, self._harmonics(q)], axis=2))
            self.known.append(inertia * (a @ model.eta.T))
            self.braking.append(self._braking(motion))
            self.held.append(self._relief(q) + self.braking[-1])

    def motor_side(self, Y: np.ndarray) -> np.ndarray:
        """Torques of motors (n, n_m, ...) from those of the arm (n, n_g, ...)."""
        return np.einsum("ji,ni...->nj...", self._inverse, Y)

    def _rates(self, x: np.ndarray) -> list[np.ndarray]:
        """Slow signals (n, ...) with their first two derivatives."""
        t = self.step * np.arange(len(x))
        spline = make_interp_spline(t, x, k=DEGREE)
        return [x, spline(t, 1), spline(t, 2)]

    def _relief(self, q: np.ndarray) -> np.ndarray:
        """Torques (n, n_m) by the harmonics of counterbalances that are not fitted."""
        relief = np.zeros_like(q)
        held = held_balances(self.regressor.model, self._counterbalance)
        for i, name in enumerate(self._names):
            for k, (sine, cosine) in enumerate(held[name], 1):
                relief[:, i] += sine * np.sin(k * q[:, i]) + cosine * np.cos(k * q[:, i])
        return -relief @ self._inverse.T

    def _braking(self, motion: Motion) -> np.ndarray:
        """Torques (n, n_m) against the friction of the joints, which the file states."""
        friction = self.regressor.joint_friction(motion.derivatives[1])
        return smooth_forces(friction)[:: self._every] @ self._inverse.T

    def _harmonics(self, q: np.ndarray) -> np.ndarray:
        """Sines and cosines of multiples of the angles, from the second one (n, n_m, columns)."""
        eta = self.regressor.model.eta
        columns = []
        for k in range(2, max(self._counterbalance.values(), default=0) + 2):
            for function in (np.sin, np.cos):
                column = np.zeros((len(q), len(eta)))
                for name, count in self._counterbalance.items():
                    if k < count + 2:
                        i = self._names.index(name)
                        column[:, int(np.argmax(np.abs(eta[:, i])))] = function(k * q[:, i])
                columns.append(column)
        return np.stack(columns, axis=2) if columns else np.zeros((len(q), len(eta), 0))

    def with_fades(self, fades: np.ndarray, sizes: np.ndarray) -> Columns:
        """All samples, with two more columns for friction that falls with speed: its size, and
        changes of its fade.

        Parameters
        ----------
        fades, sizes : arrays (n_m,) [s/rad or s/m, of the joint; N m]
            Where a fade is zero, the motor has no such friction, and the columns are zero.
        """
        out = copy(self)
        base = self.F[0].shape[2] - 2 * bool(self.fades.any())
        out.fades = fades
        out.F = [F[:, :, :base] for F in self.F]
        if fades.any():
            more = self.fade_columns(fades)
            there = (fades > 0) * np.stack([np.ones_like(sizes), sizes])
            out.F = [
                np.concatenate([F, (x * there[:, None]).transpose(1, 2, 0)], 2)
                for F, x in zip(out.F, more, strict=True)
            ]
        return out

    def fade_columns(self, fades: np.ndarray) -> list[np.ndarray]:
        """Friction of size one that falls with speed, and its derivative by the fade, of each
        motion (2, n, n_m).
        """
        out = []
        for v in self._speeds:
            level = np.tanh(v / (COULOMB_SPEED * self.speed)) / np.cosh(
                np.minimum(np.abs(fades * v), FADED)
            )
            rows = level, -level * v * np.tanh(fades * v)
            out.append(np.stack([smooth_forces(x)[:: self._every] for x in rows]))
        return out

    def largest_speeds(self) -> np.ndarray:
        """Of the motors (n_m,) [rad/s or m/s, of the joint]."""
        return np.asarray(np.abs(np.vstack(self._speeds)).max(axis=0))

    def of_motors(self, k: int, friction: np.ndarray, *, offset: bool = True) -> np.ndarray:
        """Torques (n, n_m) of rotors and friction in motion k, without counterbalances."""
        count = friction.shape[1]
        at = [c for c in range(count) if c < 4 or (self.fades.any() and c >= count - 2)]
        if not offset:
            at.remove(2)
        return np.asarray(np.einsum("njc,jc->nj", self.F[k][:, :, at], friction[:, at]))

    def bent(
        self, pi: np.ndarray, friction: np.ndarray, lags: np.ndarray, limit: float
    ) -> Columns:
        """All samples, where the gears bend under the torques of these numbers and torques are
        late.

        Parameters
        ----------
        pi, friction : arrays (10 bodies,), (n_m, columns)
        lags : array (n_g + 1,) [rad/(N m) or m/N; s]
            Compliances that the model file does not have, arm side, and the delay.
        limit : float [Hz]
            Of the filter; torques that are more than `WIDER` times as fast bend nothing.
        """
        out = copy(self)
        model = self.regressor.model
        n_g = self.regressor.model.n_g
        out.links = []
        out.Y = []
        out.F = []
        out.Z = []
        out.held = []
        out.measured = []
        low = self._low_of_bends(limit)
        for k in range(len(self.states)):
            out.measured.append(self._late(k, lags[n_g]))
            own = self.known[k] + self.of_motors(k, friction, offset=False)
            torque = low.whole((out.measured[k] - own) @ model.eta)
            links = self._links_under(k, torque, lags[:n_g])
            out._append(self, k, links)
            changes = self.regressor.changes(links, pi, self._rates(-torque))
            total = (
                out.Y[k] @ pi
                + self.known[k]
                + out.held[k]
                + np.einsum("njc,jc->nj", out.F[k], friction)
            )
            late = -self._rates(total)[1][:, :, None]
            out.Z.append(np.concatenate([self.motor_side(changes), late], axis=2))
        return out

    def bent_by_model(
        self, pi: np.ndarray, friction: np.ndarray, delay: float, limit: float
    ) -> Columns:
        """All samples, where the gears bend as in the model file under the torques of these
        numbers, and the recorded torques are late by ``delay`` [s].

        The torques are those of a model with these numbers along the motion alone: the recorded
        ones bend nothing. Each of `BENDS` rounds takes the loads of the links of the round before.
        """
        out = copy(self)
        model = self.regressor.model
        low = self._low_of_bends(limit)
        zeros = np.zeros(model.n_g)
        for _ in range(BENDS):
            loads = []
            for k in range(len(self.states)):
                total = out.torques(pi, friction)[k]
                own = self.known[k] + self.of_motors(k, friction)
                loads.append(low.whole((total - own) @ model.eta))
            out = copy(self)
            out.links = []
            out.Y = []
            out.F = []
            out.held = []
            for k, load in enumerate(loads):
                out._append(self, k, self._links_under(k, load, zeros))
        out.measured = [self._late(k, delay) for k in range(len(self.states))]
        return out

    def _low_of_bends(self, limit: float) -> LowPass:
        """Filter of the torques that bend gears."""
        return LowPass(self.step, WIDEST / self.step if np.isinf(limit) else WIDER * limit)

    def _late(self, k: int, delay: float) -> np.ndarray:
        """Recorded torques (n, n_m) of motion k, a delay [s] later than the angles."""
        at = np.clip(self.t[k] + delay, 0.0, self.t[k][-1])
        return np.asarray(make_interp_spline(self.t[k], self.recorded[k], k=3)(at))

    def _links_under(
        self, k: int, torque: np.ndarray, compliances: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Angles of the links of motion k, with two derivatives, where torques (n, n_g) bend the
        gears.
        """
        equations = self.regressor.equations
        rate = self._rates(gear_deflection(equations, torque))[1]
        elastic = gear_deflection(equations, torque - gear_damping(equations) * rate)
        bend = self._rates(elastic + compliances * torque)
        return tuple(x - d for x, d in zip(self.states[k], bend, strict=True))

    def _append(self, before: Columns, k: int, links: tuple[np.ndarray, ...]) -> None:
        """Terms of motion k, of columns before gears bend, along these angles of the links."""
        self.links.append(links)
        self.Y.append(self.motor_side(self.regressor(*links)))
        harmonics = self._harmonics(links[0])
        F = before.F[k]
        rows = F[:, :, :4], harmonics, F[:, :, 4 + harmonics.shape[2] :]
        self.F.append(np.concatenate(rows, axis=2))
        self.held.append(self._relief(links[0]) + self.braking[k])

    def below(self, limit: float, *, stiction: bool = False) -> Columns:
        """A copy with all terms low-passed to a limit [Hz], at fewer samples; infinite: no filter.

        `slow` filters, and eliminates the unknown friction of motors at standstill; with
        ``stiction``, it stays in the torques. ``moving``: kept samples in motion; ``correlated``:
        kept samples for one that is independent.
        """
        out = copy(self)
        low = None if np.isinf(limit) else LowPass(self.step, limit)
        for name in TERMS:
            rows = list(enumerate(getattr(self, name)))
            if stiction:
                setattr(out, name, [x if low is None else low(x) for _, x in rows])
            else:
                setattr(out, name, [self.slow(k, x, limit) for k, x in rows])
        if low is None:
            return out
        out.moving = [low.kept(x) for x in self.moving]
        out.step = self.step * low.every
        out.correlated = max(1.0, 0.5 / (limit * out.step))
        return out

    def slow(self, k: int, x: np.ndarray, limit: float) -> np.ndarray:
        """Torques (n, n_m, ...) in motion k below the limit [Hz], after elimination of the
        friction at standstill.
        """
        low = None if np.isinf(limit) else LowPass(self.step, limit)
        out = x if low is None else low(x)
        rests = [rest.project(out[:, j]) for j, rest in enumerate(self._rests_of(limit, low)[k])]
        return np.stack(rests, axis=1)

    def _rests_of(self, limit: float, low: LowPass | None) -> list[list[Rests]]:
        """Filtered stiction regressors of each motor in each motion; the same for all numbers of a
        fit.
        """
        if limit not in self._rests:

            def slow(x: np.ndarray) -> np.ndarray:
                rows = smooth_forces(x)[:: self._every]
                return rows if low is None else low(rows)

            cut = min(limit, WIDEST * self._every / self.step) * self.step / self._every
            every = self._every * (1 if low is None else low.every)
            reach = WINDOW + (0 if low is None else (2 * low.half + low.every) * self._every)
            least = np.where(self._moves, MOVING * self.speed, -1.0)
            self._rests[limit] = [
                [Rests(x, y, cut, slow, every, reach) for x, y in zip(v.T, least, strict=True)]
                for v in self._speeds
            ]
        return self._rests[limit]

    def by_motor(self) -> list[np.ndarray]:
        """Terms (n, numbers) of each motor: bodies, frictions of all motors row by row, lags."""
        Y, F, Z = (np.concatenate(x) for x in (self.Y, self.F, self.Z))
        n, motors, count = F.shape
        X = []
        for j in range(motors):
            friction = np.zeros((n, motors * count))
            friction[:, j * count : (j + 1) * count] = F[:, j]
            X.append(np.hstack([Y[:, j], friction, Z[:, j]]))
        return X

    def part(self, pieces: Sequence[tuple[int, slice]]) -> Columns:
        """Some samples of some motions: number of the motion, and samples."""
        out = copy(self)
        for name in (*TERMS, "moving"):
            of = getattr(self, name)
            setattr(out, name, [of[run][samples] for run, samples in pieces])
        return out

    def samples_to_judge(self) -> np.ndarray:
        """Samples (n, n_m) where a motor moves, and all where it never does."""
        moving = np.vstack(self.moving)
        return moving | ~moving.any(axis=0)

    def errors(self, pi: np.ndarray, friction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rms of the errors, and deviations of the torques, of samples that move (n_m,); nan: none
        does.
        """
        moving = np.vstack(self.moving)
        torque = np.vstack(self.measured)
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
