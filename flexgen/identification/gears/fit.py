"""Gear parameters from motor angles and torques in the band of a record: least squares on the
driven arm.

    min over theta of sum over f, j of |tau_j(f) - tau_j(f; q_m, theta)|^2 / S_j(f)

theta: parameters of the model and K_h of each element of hysteresis, and its exponent, over their
values at the start, its lost motion, and coefficients of transmission errors; then, linear in the
torque, a viscous and a Coulomb friction, a constant torque and the cogging of each motor in
addition to the model, and the time by which torques are recorded late. S: density of the
residuals, at first that of the noise of the angles.

The noise of the angles is in the regressors, too, and least squares would choose the parameters
that pass least of it. So its part in the normal equations is subtracted: that of as much noise
that is added to the record,

    G(theta) = 2 J' r - mean J_+' r_+

Standard deviations are those of blocks, see `flexgen.identification.estimator.covariance`, with
these corrected matrices and scores.

Source: W. Fuller, Measurement Error Models, 1987, ch. 3 (corrected normal equations); L. Ljung,
System Identification, 2nd ed. 1999, sec. 9.3 (covariance).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.signal.windows import tukey
from scipy.stats import chi2

from flexgen.base.calls.deadline import check_time, is_over, keep_best
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.memory import SHARPEST
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.lagrangian import gear_stiffness
from flexgen.dynamics.mechanics.motor_harmonics import friction_along
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.estimator.covariance import Blocks, covariance_of
from flexgen.identification.estimator.layout import Layout
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Prior, Problem, Sums
from flexgen.identification.gears.driven_arm import DrivenArm, MotorMotion, Sought
from flexgen.identification.gears.motor_friction import MotorFriction
from flexgen.identification.gears.signals import Signals
from flexgen.identification.gears.whitening import TAPER, Whitening
from flexgen.identification.rigid.rests_of_motors import MOVING

STEP = 1e-3  # of differences in numbers over their values at the start, and lost motions
REACH = 30.0  # of these, at most; the least is its inverse
# K_h over its start, at least; factor from a bound at which a number is at it
STIFF = 0.2
NEAR = 1.05
# of the units of lost motions
LEAST_LOST = 1e-3
MOST_LOST = 50.0
NO_LOST = 0.02  # of these units: what is below it is none
SLOWEST = 2.0  # rate of a hysteresis times the integration step, at most
POSES = 20  # of the record, where eigenvalues are computed
STIFFER = 10.0  # K_h over its start up to which the integration is accurate
FORGOTTEN = 1e-5  # of its first effect, or of the torques, to which that of the start has decayed
# of a record, within which residuals depend on each other; at least so many
BLOCK_S = 1.0
FEWEST_BLOCKS = 10
CLOSE = (0.3, 0.05, 0.05)  # standard deviations from the minimum where the searches end
# pairs of samples of noise in each step with corrected normal equations; steps more
DRAWS = (1, 1, 3, 3)
MORE = 4
# standard deviations, at most, of a step after which there are no more, and of the last one
SMALL = 0.3
SETTLED = 2.0
# part of the information in a direction that is not noise, else it is not determined
LEAST_SIGNAL = 0.1
RANK = 1e-13  # of the normal equations, relative
FREE = 1e6  # standard deviation of priors that say nothing
# of the torques: residuals that are not weighted as if they were smaller, at first and later
FLOOR = (2e-3, 1e-4)
# of frequency; end of the first over that of all; samples of noise in them
BANDS = 8
LOWEST = 0.04
EXCESS_DRAWS = 4
UNLIKELY = 0.01  # probability of less noise in a band than there is
FINER = 3  # times as many steps, for the errors of those of the simulation
ROUNDING = 2.5e-6  # of the torques: errors of the simulation in a band
# Coulomb friction over its sd, over the torques; slow friction over the fast one
STICKS = 3.0
SOME = 2e-3
HOLDS = 0.1
ERROR_STEP = 1e-6  # rad or m, of differences in a transmission error


@dataclass(frozen=True)
class Numbers(Layout):
    """Entries of theta.

    Over their values at the start: numbers of the model (``parameters``), of each element its
    stiffness K_h (``stiffness``) and exponent; lost motions, coefficients of transmission errors;
    then, of each motor, numbers that the torques are linear in: a viscous and a Coulomb friction,
    a constant torque, cogging; and the delay of all.
    """

    parameters: slice
    stiffness: slice
    exponents: slice
    lost: slice
    errors: slice
    viscous: slice
    coulomb: slice
    constant: slice
    cogging: slice
    delay: slice

    @property
    def positive(self) -> slice:
        """Those over their values at the start."""
        return slice(0, self.exponents.stop)

    @property
    def simulated(self) -> slice:
        """Those of which the simulation depends."""
        return slice(0, self.errors.stop)

    @property
    def linear(self) -> slice:
        """Those that the torques are linear in."""
        return slice(self.errors.stop, self.size)


@dataclass(frozen=True)
class Estimate:
    """``theta`` (n,), its ``covariance``, residuals ``error`` (k, n_m) [N m], and whether the
    search ``converged``.
    """

    theta: np.ndarray
    covariance: np.ndarray
    error: np.ndarray
    converged: bool


class GearModel:
    """Torques of a record as a function of theta.

    Parameters
    ----------
    equations : Equations
        Without what is sought; parameters: the numbers that are fitted too.
    sought : Sought
    signals : Signals
    """

    def __init__(self, equations: Equations, sought: Sought, signals: Signals) -> None:
        self.equations = equations
        self.sought = sought
        self.signals = signals
        self.names = tuple(parameter.name for parameter in equations.parameters)
        values = np.array([parameter.value for parameter in equations.parameters])
        start = np.array([(x.K_h, x.exponent, x.lost, x.unit) for x in sought.elements]).reshape(
            -1, 4
        )
        self.at = [each.gear for each in sought.elements]
        self.n_m = equations.model.n_m
        self.count = len(start)
        self.layout = Numbers.of(
            parameters=len(values),
            stiffness=self.count,
            exponents=self.count * sought.exponents,
            lost=self.count,
            errors=2 * len(sought.errors) * len(sought.harmonics),
            viscous=self.n_m,
            coulomb=self.n_m,
            constant=self.n_m,
            cogging=2 * len(sought.cogging) * self.n_m,
            delay=1,
        )
        at = self.layout
        self.units = np.ones(at.size)
        self.units[at.parameters] = values
        self.units[at.stiffness] = start[:, 0]
        self.units[at.exponents] = start[: at.exponents.stop - at.exponents.start, 1]
        self.units[at.lost] = start[:, 3]
        self.start = np.zeros(at.size)
        self.start[at.positive] = 1.0
        self.start[at.lost] = np.clip(start[:, 2] / start[:, 3], LEAST_LOST, MOST_LOST)
        self.arm = DrivenArm(
            equations, sought.elements, sought.exponents, sought.errors, sought.harmonics
        )
        poses = signals.q_m[np.linspace(0, len(signals.time) - 1, POSES).astype(int)]
        steep = self.start.copy()
        steep[at.stiffness] *= STIFFER
        self.largest = 1e12
        steps = self.arm.steps(signals.sample_s, self.arm.fastest(poses, self.numbers(steep)))
        self.segments = self.arm.segments(signals.sample_s, steps)
        self.largest = SLOWEST / self.segments.step
        self.motion = MotorMotion.through(signals.time, signals.q_m, self.segments.steps)
        self.measured = signals.torques(signals.tau_m)
        self.first = 0
        self.late = np.gradient(self.measured, signals.sample_s, axis=0)
        self.friction = MotorFriction(signals, self.motion)
        self.first = self._forgets()
        self.measured = self.measured[self.first :]
        self.late = self.late[self.first :]
        self.units[at.linear] = self._sizes()
        self.step_errors = np.zeros_like(self.measured)

    def numbers(self, theta: np.ndarray) -> np.ndarray:
        """Numbers of the driven arm."""
        found = self.units * theta
        at = self.layout
        values = found[at.parameters]
        model = with_values(
            self.equations.model, dict(zip(self.names, values.tolist(), strict=True))
        )
        W = found[at.lost] * gear_stiffness(model, np.inf)[self.at] / 2
        return np.concatenate(
            [
                values,
                found[at.stiffness],
                W,
                found[at.exponents],
                found[at.errors],
                [self.largest],
            ]
        )

    def torques(
        self, points: Sequence[np.ndarray], motion: MotorMotion, start: np.ndarray | None = None
    ) -> np.ndarray:
        """Torques (points, k, n_m) in the band, from where the start is forgotten; ``start``: a
        state (n_x,).
        """
        linear = self.regressors(motion)
        found = self.arm_torques([self.numbers(x) for x in points], motion, start)
        return np.array(
            [
                x + linear @ theta[self.layout.linear]
                for theta, x in zip(points, found, strict=True)
            ]
        )

    def arm_torques(
        self, numbers: Sequence[np.ndarray], motion: MotorMotion, start: np.ndarray | None = None
    ) -> list[np.ndarray]:
        """Torques (k, n_m) of the arm alone in the band, for each of its ``numbers``; ``start``: a
        state (n_x,).
        """
        check_time("identify_gears")
        q_m = motion.samples[0, : self.n_m]
        starts = np.array([self.arm.rest(q_m, p) if start is None else start for p in numbers])
        found = self._simulate(np.array(numbers), motion, starts)
        return [self.friction.project(self.signals.torques(each)[self.first :]) for each in found]

    def take_out_standstill(self, found: Estimate) -> bool:
        """From now on compare torques after elimination of the friction at standstill; whether any
        motor has some.

        Motors with Coulomb friction, which the model has, or which this estimate of all torques
        found.
        """
        coulomb = self.layout.coulomb
        units = self.units[coulomb]
        variances = np.diag(found.covariance)[coulomb]
        least = np.maximum(
            STICKS * units * np.sqrt(variances), SOME * np.std(self.measured, axis=0)
        )
        found_some = np.abs(units * found.theta[coulomb]) > least
        largest = np.abs(self.motion.samples[:, self.n_m : 2 * self.n_m]).max(axis=0)
        model = self.equations.model
        speeds = np.array([MOVING * largest, largest])
        slow, fast = np.abs(
            friction_along(derive(model).function, model, speeds, np.zeros_like(speeds))
        )
        motors = found_some | (slow > HOLDS * fast)
        self.friction.take_out(self.first, motors)
        kept = self.measured, self.late, self.step_errors
        self.measured, self.late, self.step_errors = (self.friction.project(x) for x in kept)
        return bool(motors.any())

    def take_out_step_errors(self, theta: np.ndarray) -> None:
        """From now on compare torques without the errors that the steps of the simulation make at
        theta.
        """
        finer = copy(self)
        p = [self.numbers(theta)]
        finer.segments = self.segments.with_steps(FINER * self.segments.steps)
        motion = MotorMotion.through(self.signals.time, self.signals.q_m, finer.segments.steps)
        errors = self.arm_torques(p, self.motion)[0] - finer.arm_torques(p, motion)[0]
        self.measured = self.measured + errors - self.step_errors
        self.step_errors = errors

    def regressors(self, motion: MotorMotion) -> np.ndarray:
        """Derivatives (k, n_m, linear) of the torques in frictions, constants, cogging and
        delay.
        """
        n = self.n_m
        at = motion.samples
        q = at[:, :n]
        v = at[:, n : 2 * n]
        parts = [v, np.ones_like(v)]
        for k in self.sought.cogging:  # which helps the motor
            parts += [-np.cos(k * q), -np.sin(k * q)]
        smooth = [self.signals.torques(part) for part in parts]
        smooth.insert(1, self.friction.coulomb(motion))
        out = np.zeros((*smooth[0].shape, len(smooth) * n + 1))
        for k, part in enumerate(smooth):
            for j in range(n):
                out[:, j, k * n + j] = part[:, j]
        out = self.friction.project(out[self.first :])
        out[:, :, -1] = -self.late
        return out * self.units[self.layout.linear]

    def _sizes(self) -> np.ndarray:
        """Linear numbers whose torques are as large as those of the record, at the motor that each
        moves most.
        """
        size = np.sqrt((self.regressors(self.motion) ** 2).mean(axis=0))
        return np.asarray(
            np.std(self.measured, axis=0)[size.argmax(axis=0)]
            / np.maximum(size.max(axis=0), 1e-300)
        )

    def derivatives(self, theta: np.ndarray, motion: MotorMotion) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (k, n_m) and their derivatives (k, n_m, n) at theta."""
        at = self.layout
        steps = np.where(np.arange(at.errors.stop) < at.errors.start, STEP, ERROR_STEP)
        moved = [theta + step * (np.arange(len(theta)) == k) for k, step in enumerate(steps)]
        linear = self.regressors(motion)
        own, *changed = self.arm_torques([self.numbers(x) for x in (theta, *moved)], motion)
        J = (
            np.stack([x - own for x in changed], axis=2) / steps
            if changed
            else np.zeros((*own.shape, 0))
        )
        error = own + linear @ theta[at.linear] - self.measured
        return error, np.concatenate([J, linear], axis=2)

    def more_noise(self, seed: int, factor: float = 1.0) -> MotorMotion:
        """The motion with as much noise of the angles as the record has, once more, times a
        factor.
        """
        signals = self.signals
        q_m = signals.q_m + factor * signals.angle_noise(np.random.default_rng(seed))
        return MotorMotion.through(signals.time, q_m, self.segments.steps)

    def change_by_noise(self, theta: np.ndarray) -> np.ndarray:
        """Change of the torques (k, n_m) by additional noise of the angles."""
        return self.torques([theta], self.more_noise(0))[0] - self.torques([theta], self.motion)[0]

    def noise(self, theta: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Standard deviation (n_m,) of residuals that are noise of angles and torques [N m]."""
        lines, power = self._bands(error)
        of_torques = np.sqrt(2 * lines.sum() * self._white(lines, power)) / len(error)
        return np.asarray(np.hypot(self.change_by_noise(theta).std(axis=0), of_torques))

    def excess(self, theta: np.ndarray, error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Residuals over what noise explains, rms, the largest of all bands of frequency (n_m,);
        the same over what noise and the standard deviations of theta explain: (2, n_m).

        A wrong law shows at the frequencies of the motion, where noise of angles makes hardly any
        torque: a loop of another shape is 1e-5 of the torque there, behind noise of 1e-3 in all.
        """
        power = self._bands(error)[1]
        explained = self.noise_power(theta, error)[1]
        values, vectors = np.linalg.eigh(covariance)
        deviations = self.derivatives(theta, self.motion)[1] @ (
            vectors * np.sqrt(np.maximum(values, 0.0))
        )
        with_theta = explained + sum(self._bands(x)[1] for x in np.moveaxis(deviations, -1, 0))
        return np.array([np.sqrt(power / each).max(axis=0) for each in (explained, with_theta)])

    def noise_power(self, theta: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lines (bands, 1) of bands of frequency, and the power (bands, n_m) that noise explains
        in them.
        """
        own = self.torques([theta], self.motion)[0]
        drawn = [
            self.torques([theta], self.more_noise(seed))[0] - own for seed in range(EXCESS_DRAWS)
        ]
        lines, power = self._bands(error)
        least = (len(error) * ROUNDING * np.std(self.measured, axis=0)) ** 2 / 2
        noise = np.mean([self._bands(x)[1] for x in drawn], axis=0)
        return lines, noise + lines * self._white(lines, power) + least

    def _bands(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bands of frequency: their lines (bands, 1), and the power of (k, n_m) in them (bands,
        n_m).
        """
        n = len(x)
        signals = self.signals
        f = np.fft.rfftfreq(n, signals.sample_s)
        first = np.searchsorted(
            f, signals.band_hz * np.concatenate([[0.0], np.geomspace(LOWEST, 1.0, BANDS)])
        )
        lines = np.abs(np.fft.rfft(x * tukey(n, TAPER)[:, None], axis=0)) ** 2
        return np.diff(first).clip(1)[:, None], np.add.reduceat(
            lines[: first[-1]], first[:-1], axis=0
        )

    def _white(self, lines: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Power (n_m,) of the noise of the torques in a line: of the record, at most what the
        quietest residuals allow.

        What the drives of a robot make of noise in its loop are true torques, and no noise of
        their measurement.
        """
        of_record = (len(self.measured) * self.signals.torque_noise) ** 2 / (2 * lines.sum())
        allowed = 2 * power / chi2.ppf(UNLIKELY, 2 * lines)
        return np.asarray(np.minimum(of_record, allowed.min(axis=0)))

    def loops(self, theta: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Deflections of gears, torques of their elements, and these with the residuals: (k,
        gears, 3), arm side.
        """
        p = self.numbers(theta)
        gears = list(self.sought.gears)
        at = self.motion.samples
        (x,) = self._simulate(
            p[None], self.motion, self.arm.rest(at[0, : self.n_m], p)[None], states=True
        )
        kept = slice(self.signals.margin + self.first, len(at) - self.signals.margin)
        each = x[kept, x.shape[1] - self.count :]
        z = each @ np.equal.outer(self.at, gears)
        d = self.arm.deflections(x[kept], at[kept], p)[:, gears]
        return np.stack([d, z, z - (error @ self.equations.model.eta)[:, gears]], axis=2)

    def _simulate(
        self, p: np.ndarray, motion: MotorMotion, start: np.ndarray, states: bool = False
    ) -> np.ndarray:
        """Motor torques (k, n, n_m) at the samples, or states, from start states (k, n_x) with
        numbers p (k, n_p).
        """
        inputs = motion.inputs
        sets = np.zeros(len(p), np.int64)
        no_offset = np.zeros((len(p), inputs.shape[2]))
        return self.segments(start, inputs[None], sets, no_offset, p, states=states)

    def _forgets(self) -> int:
        """The first sample of the filtered torques that does not depend on how the motion
        began.
        """
        p = self.numbers(self.start)
        n = len(self.arm.free)
        at = self.motion.samples[0]
        rest = self.arm.rest(at[: self.n_m], p)
        moving = rest.copy()
        full = rest.copy()
        first = self.layout.stiffness.stop
        slip = p[first : first + self.count]
        moving[2 * n :] = -slip
        full[2 * n :] = slip
        moving[n : 2 * n] = self.arm.joint_speeds(at[self.n_m : 2 * self.n_m])
        first, second = (self.torques([self.start], self.motion, x)[0] for x in (moving, full))
        difference = np.abs(first - second)
        small = FORGOTTEN * np.maximum(difference.max(axis=0), np.std(self.measured, axis=0))
        late = np.flatnonzero((difference > small).any(axis=1))
        first_sample = int(late[-1]) + 1 if late.size else 0
        if first_sample > len(difference) / 2:
            what = "gears do"
            more = (
                "reversals whose torques are several times those of the hysteresis, and a "
                "longer record"
            )
            if not self.count:
                what = "arm does"
                more = "a longer record: a vibration behind the motors decays slowly"
            raise ArgumentError(
                f"record: given a motion in which the {what} not forget how it began, expected "
                f"{more}"
            )
        return first_sample


def estimate(model: GearModel, tell: Callable[[str], None]) -> Estimate:
    """Fit theta: least squares with two sets of weights, then steps with corrected normal
    equations.
    """
    theta = model.start
    free = np.full(len(model.start), FREE)
    (lower, upper) = bounds_of(model)
    white = Whitening(model.change_by_noise(theta), model, FLOOR[0])
    steps = 0

    def cost(theta: np.ndarray) -> float:
        return float((white(model.torques([theta], model.motion)[0] - model.measured) ** 2).sum())

    def sums(theta: np.ndarray) -> Sums:
        nonlocal steps
        steps += 1
        e, J = model.derivatives(theta, model.motion)
        tell(f"step {steps}: {100 * _misfit(e, model.measured):.3g} % of the torques unexplained")
        r = white(e).ravel()
        J = white(J).reshape(e.size, -1)
        return float(r @ r), J.T @ r, J.T @ J

    for close in CLOSE:
        problem = Problem.of_sums(sums, cost, Prior.of_sd(theta, free), (lower, upper))
        fit = minimize(problem, theta, Search(close, count=model.measured.size))
        theta = fit.x
        if is_over():
            return _best_step(model, fit, white)
        model.take_out_step_errors(theta)
        white = Whitening(
            model.torques([theta], model.motion)[0] - model.measured, model, FLOOR[1]
        )
        dropped = drop_elements(model, theta, lower, upper)
        if fit.wrong or (not dropped and close != CLOSE[0]):
            break
    found: Estimate | None = None
    with keep_best():
        # the noise is not what a wrong model is off by: one correction, for the deviations
        rounds = DRAWS[:1] if fit.wrong else (*DRAWS, *DRAWS[-1:] * MORE)
        for n, draws in enumerate(rounds, 1):
            tell(f"subtracting the part of the noise: step {n}")
            model.take_out_step_errors(theta)
            error, change, covariance = _correct(model, theta, white, lower < upper, draws)
            positive = model.layout.positive
            here = theta[positive]
            theta = theta - change
            theta[positive] = here * np.exp(np.clip(-change[positive] / here, -1.0, 1.0))
            theta = np.clip(theta, lower, upper)
            deviations = np.sqrt(np.diag(covariance))
            size = float((np.abs(change) / np.maximum(deviations, 1e-300)).max())
            found = Estimate(theta, covariance, error, fit.converged and size <= SETTLED)
            if n >= len(DRAWS) and size <= SMALL:
                break
    return _best_step(model, fit, white) if found is None else found


def _best_step(model: GearModel, fit: Minimum, white: Whitening) -> Estimate:
    """The estimate of a search that was ended.

    Without the correction for noise, with the formal covariance.
    """
    error = model.torques([fit.x], model.motion)[0] - model.measured
    free = np.diag(fit.A) > 0.0
    inner = np.ix_(free, free)
    covariance = np.diag(np.where(free, 0.0, FREE**2))
    degrees = max(error.size - int(free.sum()), 1)
    covariance[inner] = np.linalg.pinv(fit.A[inner], hermitian=True) * (fit.cost / degrees)
    return Estimate(fit.x, covariance, error, False)


def bounds_of(model: GearModel) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest theta."""
    at = model.layout
    lower = np.full(at.size, -np.inf)
    upper = np.full(at.size, np.inf)
    lower[at.positive] = 1 / REACH
    upper[at.positive] = REACH
    lower[at.stiffness] = STIFF
    exponent = model.units[at.exponents]
    lower[at.exponents] = 1.0 / exponent
    upper[at.exponents] = SHARPEST / exponent
    lower[at.lost] = LEAST_LOST
    upper[at.lost] = MOST_LOST
    return lower, upper


def element_entries(model: GearModel, k: int) -> tuple[int, int, slice]:
    """Entries of theta of an element: its stiffness, its lost motion, and its exponent, where that
    is fitted.
    """
    at = model.layout
    first = at.exponents.start + k
    shape = slice(first, first + model.sought.exponents)
    return at.stiffness.start + k, at.lost.start + k, shape


def drop_elements(
    model: GearModel, theta: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> bool:
    """Fix elements at none whose loop is narrow, or whose K_h is at a bound, as part of a spring;
    whether any.
    """
    any_dropped = False
    for k in range(model.count):
        K_h, lost, shape = element_entries(model, k)
        inside = lower[K_h] * NEAR < theta[K_h] < upper[K_h] / NEAR and theta[lost] > NO_LOST
        if inside or lower[lost] == upper[lost]:
            continue
        any_dropped = True
        for entries, value in ((K_h, 1.0), (lost, LEAST_LOST), (shape, 1.0)):
            theta[entries] = lower[entries] = upper[entries] = value
    return any_dropped


def _correct(
    model: GearModel, theta: np.ndarray, white: Whitening, free: np.ndarray, draws: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corrected normal equations at theta for numbers that are free; samples of noise come in
    pairs of both signs.

    Returns
    -------
    error : array (k, n_m)
        Residuals.
    change : array (n,)
        What is subtracted from theta.
    covariance : array (n, n)
        Of theta by the blocks and by the samples of noise; of directions that the noise does not
        let determine: 100 % of the number that a direction moves most.
    """
    error, J = model.derivatives(theta, model.motion)
    J = white(J * free)
    block = max(1, min(round(BLOCK_S / model.signals.sample_s), len(J) // FEWEST_BLOCKS))

    def squares(J: np.ndarray) -> np.ndarray:
        """J' J of each block, (blocks, n, n)."""
        at = range(block, len(J), block)
        return np.array([np.einsum("njp,njq->pq", part, part) for part in np.split(J, at)])

    raw = squares(J)
    scores = 2 * np.einsum("njp,nj->np", J, white(error))
    A = 2 * raw
    cut = np.arange(0, len(scores), block)
    own = scores / 2
    spread = np.zeros_like(raw[0])
    for seed in range(draws):
        pair = np.zeros_like(scores)
        for sign in (1.0, -1.0):
            e_more, J_more = model.derivatives(theta, model.more_noise(seed, sign))
            r_more = white(e_more)
            J_more = white(J_more * free)
            pair += np.einsum("njp,nj->np", J_more, r_more) / 2
            A -= squares(J_more) / (2 * draws)
        scores -= pair / draws
        parts = np.add.reduceat(pair - own, cut)
        parts -= parts.mean(axis=0)
        # of the part of the noise, which the record has by chance more or less of
        spread += parts.T @ parts / draws
    blocks = np.add.reduceat(scores, cut)
    return error, *_solve(A, raw.sum(axis=0), blocks, spread, free, model.layout.errors.start)


def _solve(
    A: np.ndarray,
    raw: np.ndarray,
    blocks: np.ndarray,
    spread: np.ndarray,
    free: np.ndarray,
    numbers: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Change of theta and its covariance, see `_correct`.

    ``A`` (blocks, n, n), ``blocks`` (blocks, n): matrix and gradient of each; ``raw`` (n, n): the
    matrix with its noise; ``spread`` (n, n): covariance of the gradient by samples of noise;
    ``numbers``: entries with sizes of 1.
    """
    n = len(raw)
    scale = np.sqrt(np.diag(raw))
    part = np.flatnonzero(free & (scale > 0.0))
    at = np.ix_(part, part)
    both = np.outer(scale[part], scale[part])
    # 1 where there is no noise
    values, vectors = eigh(A.sum(axis=0)[at] / both, raw[at] / both + RANK * np.eye(len(part)))
    known = values > LEAST_SIGNAL
    directions = np.zeros((n, len(part)))
    directions[part] = vectors / scale[part, None]
    found = directions[:, known]
    hidden = directions[:, ~known]
    values = values[known]
    inverse = (found / values) @ found.T
    along = Blocks(found.T @ A @ found, blocks @ found)
    nothing = np.zeros((len(values), len(values)))
    of_blocks = found @ covariance_of(along, nothing, corrected=True) @ found.T
    lost = np.eye(n)[:, [k for k in range(n) if k not in part]]
    # as large as the number that it moves most
    hidden = hidden / np.abs(hidden[:numbers]).max(axis=0, initial=1e-300)
    unknown = inverse @ spread @ inverse + lost @ lost.T + hidden @ hidden.T
    return inverse @ blocks.sum(axis=0), of_blocks + unknown


def _misfit(error: np.ndarray, measured: np.ndarray) -> float:
    """Root of the mean square of residuals over that of the torques, the largest of all motors."""
    return float((np.std(error, axis=0) / np.maximum(np.std(measured, axis=0), 1e-300)).max())
