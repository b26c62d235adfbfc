"""`refine`: fit parameters by simulation of the experiment on the nonlinear model (output error).

    r = w^2 (Q(x) - Q) / sd
    at the excited lines; Q: spectra of the motor angles in the closed loop

Noise moves the motors, and so smooths the step of a friction law: the mean change that it causes
is simulated with noise of other seeds and added to the noise-free spectra.

Frequency responses are biased by friction and by springs that are not linear. Here the drives,
references and the nonlinear model are simulated in C with the parameters x as arguments, without
noise, and compared with the measured angles. That needs good start values (those of the frequency
responses) and a known drive. Derivatives are forward differences in x: their simulations begin in
the state of the simulation at x, in a first search shortly before the measured period, in a second
one a period before it.

Source: L. Ljung, System Identification, 2nd ed. 1999, ch. 7 (output error).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.calls.deadline import check_time, is_over, keep_best, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.parameters import select
from flexgen.feedback.loop.closed_loop import ClosedLoop, Snapshot, integration_steps
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Sums
from flexgen.identification.experiments.excitation import Plan
from flexgen.identification.experiments.experiment import FINER, Experiment, fade_in, largest_rate
from flexgen.identification.responses.graybox import COST_MOST, SMALL_ERROR, weak_directions
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import (
    CONSTANT,
    DELAY,
    ParameterVector,
    cascade_at,
    is_of_drive,
    is_of_sensor,
)
from flexgen.identification.responses.result import TIME_DOMAIN, FitStatus, IdentificationResult
from flexgen.identification.responses.spectra import spectrum

STEP = 1e-4  # of forward differences in x, mostly logarithms
# standard deviations from the minimum where the search ends: forward differences show no more
DISTANCE = 0.03
# derivatives are used again after a step in x, or a relative change of the cost, below it
NEAR = 0.01
LITTLE = 0.06
# time constants of the position control that simulations for derivatives begin before the period
SETTLED = 10.0
LAGS = 20
# simulations with noise, and the first of their seeds, unlike those of `measure`
SEEDS = 16
SEED = 7_919_000
ROUGH_DISTANCE = 2.0  # the same, of the first search
FRICTION = ("viscous", "coulomb", "load_coulomb", "beta")  # of each motor and joint that has them


class Simulated:
    """Simulation of an experiment in closed loop, and its residuals, as functions of parameters.

    The motor angles that are simulated with the parameters x are compared with the measured ones
    as spectra at the excited frequencies; see the module. All runs are simulated together, each in
    one lane of the batch.

    Parameters
    ----------
    vector : ParameterVector
        The parameters x: names, model and start values.
    experiment : Experiment
        Plan, references of the drives and measured motor angles.
    runs : sequence of (int, int, int)
        Numbers of pose, realization and experiment of each run.
    progress : callable, optional
        Is called with a sentence before each simulation.

    Attributes
    ----------
    reference, fading : array (samples, runs, 2 n_m)
        One period of the references of the drives: motor angles [rad], then feedforward torques
        [N m], which `spectra` sets to those that hold the pose. ``fading`` begins at rest.
    measured : array (runs, lines, n_m) [rad/s^2]
        ``w^2 Q``: spectra of the angles, mean over the measured periods, as accelerations.
    sd : array (1, lines, n_m) [rad/s^2]
        Standard deviations of ``measured``.
    shift : array (runs, lines, n_m) [rad/s^2]
        Mean change of the spectra by noise; zero before `use_noise`.
    last : int
        Samples before the measured period at which simulations for derivatives begin.
    steps : int
        Integration steps in a sample.
    """

    def __init__(
        self,
        vector: ParameterVector,
        experiment: Experiment,
        runs: Sequence[tuple[int, int, int]],
        progress: Callable[[str], None] | None = None,
    ) -> None:
        self.vector = vector
        self.plan = experiment.plan
        self.runs = tuple(runs)
        self.progress = progress
        plan = self.plan
        names = vector.of_model
        self.library = library_with(
            vector.model, ("forward_dynamics",), parameters=names, progress=progress
        )
        self.local = LocalModel(vector.model, self.library.parameter_names)
        self.poses = plan.poses[[pose for pose, _, _ in self.runs]]  # (runs, n_m) [rad]
        self.reference = np.zeros((plan.samples, len(self.runs), 2 * len(plan.motors)))
        for lane, run in enumerate(self.runs):
            self.reference[:, lane, : len(plan.motors)] = experiment.reference(*run)
        self.fading = fade_in(self.reference)
        # A change of a parameter excites a transient, which decays with the time constant 1/gain
        # of the position control. Derivatives are taken after `SETTLED` time constants, and after
        # a quarter of a period at least, a period at most. Without position control nothing but
        # the period bounds this time.
        lowest_gain = float(plan.controller.position_gain.min())
        sample_s = plan.hardware.sample_s
        settled = SETTLED / lowest_gain / sample_s if lowest_gain > 0 else plan.samples
        self.last = min(plan.samples, max(plan.samples // 4, math.ceil(settled)))
        # w^2: a spectrum of angles becomes one of accelerations
        w2 = (2 * np.pi * plan.frequencies[:, None]) ** 2
        # (runs, periods, lines, n_m)
        measured = np.array([experiment.q_m[run] for run in self.runs])
        self.measured = w2 * measured.mean(axis=1)
        self.sd = _standard_deviation(w2 * measured)
        self.quiet = replace(
            plan.hardware, encoder_noise_rad=0.0, encoder_resolution_rad=0.0, torque_noise_Nm=0.0
        )
        # As many as in the simulated experiment. Step times rate is at most 1/FINER at the start,
        # and the integration is stable below 2.78: so the search may make friction, whose slope at
        # rest sets the largest rate, far steeper.
        self.steps = integration_steps(plan.hardware, FINER * largest_rate(self.local, plan.poses))
        self.shift = np.zeros_like(self.measured)
        self.count = self.measured.size  # of complex residuals
        self.simulations = 0  # that have been run, for the progress
        # x, Jacobian and cost where derivatives were computed last; `sums` uses them again nearby
        self._known: tuple[np.ndarray, np.ndarray, float] | None = None
        # Whether simulations for derivatives begin a whole period before the measured one, which
        # is more accurate, or only `last` samples before it.
        self.whole = False
        # States of the last simulation at x from which those for derivatives begin: a period, and
        # `last` samples, before the measured period.
        self._before: tuple[Snapshot, Snapshot] | None = None

    def spectra(
        self, x: np.ndarray, begin: Snapshot | None = None, noise: int | None = None
    ) -> np.ndarray:
        """``w^2 Q`` (runs, lines, n_m) of a period after the transients.

        ``begin``: where these begin; ``noise``: seed of the noise of the drives; None: no noise.
        """
        check_time("identify")
        plan = self.plan
        named = self.vector.named(x)
        values = np.array([named[name] for name in self.library.parameter_names])
        rest = self.local.rest(values, self.poses)
        n_a = self.vector.model.n_a
        n_m = self.vector.model.n_m
        controller = cascade_at(plan.controller, named, plan.motors)
        loop = ClosedLoop(
            self.vector.model,
            self.library,
            self.quiet if noise is None else plan.hardware,
            controller,
            rest.y[:, :n_a],
            self.poses,
            0.0,
            seed=noise or 0,
            steps=self.steps,
            parameters=values,
        )
        loop.hold(rest.tau_m)
        self.reference[:, :, n_m:] = self.fading[:, :, n_m:] = rest.tau_m
        if begin is None or noise is not None:
            # One period more than in the experiment, whose mean over its periods has less of the
            # transient.
            loop.run(self.fading, plan.samples)
            for _ in range(max(plan.transients, 1) - 1):
                loop.run(self.reference, plan.samples)
            whole = loop.snapshot()
            loop.run(self.reference, plan.samples - self.last)
            if noise is None:
                self._before = whole, loop.snapshot()
        else:
            loop.restore(begin)
        loop.run(self.reference, (max(plan.transients, 1) + 1) * plan.samples - loop.sample)
        q = loop.run(self.reference, plan.samples).q_m
        self.simulations += 1
        w2 = (2 * np.pi * plan.frequencies[:, None]) ** 2
        return w2 * np.array([spectrum(q[:, lane], plan.lines) for lane in range(q.shape[1])])

    def use_whole(self) -> None:
        """From now on derivatives from simulations that begin a period before the measured one."""
        self.whole = True
        self._known = None

    def use_noise(self, x: np.ndarray) -> None:
        """From now on with the mean change of the spectra by noise, as it is at x; its own error
        counts in `sd`.
        """
        hardware = self.plan.hardware
        if not (
            hardware.encoder_noise_rad
            or hardware.encoder_resolution_rad
            or hardware.torque_noise_Nm
        ):
            return
        if self.progress is not None:
            self.progress(f"change of the motion by noise: {SEEDS} simulations")
        quiet = self.spectra(x)
        self.shift = (
            np.mean([self.spectra(x, noise=SEED + k) for k in range(SEEDS)], axis=0) - quiet
        )
        self.sd = self.sd * np.sqrt(1 + self.plan.periods / SEEDS)

    def residual(self, x: np.ndarray, begin: Snapshot | None = None) -> np.ndarray:
        """Weighted residuals (runs, lines, n_m)."""
        return (self.spectra(x, begin) + self.shift - self.measured) / self.sd

    def cost(self, x: np.ndarray) -> float:
        """Sum of their squares."""
        return float((np.abs(self.residual(x)) ** 2).sum())

    def _jacobian(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals r (n_r,) at x, (n_r, n)."""
        assert self._before is not None
        J = np.empty((len(r), len(x)), complex)
        begin = self._before[0 if self.whole else 1]
        for k in range(len(x)):
            if self.progress is not None:
                self.progress(
                    f"simulation {self.simulations + 1}, {self.plan.duration_s:.0f} s of robot "
                    "in the plan"
                )
            J[:, k] = (
                self.residual(x + STEP * (np.arange(len(x)) == k), begin).ravel() - r
            ) / STEP
        return J

    def sums(self, x: np.ndarray) -> Sums:
        """Sum of the squares, ``Re J^H r``, ``Re J^H J``."""
        r = self.residual(x).ravel()
        cost = float((np.abs(r) ** 2).sum())
        known = self._known
        if known is None or (
            np.abs(x - known[0]).max() > NEAR and abs(cost - known[2]) > LITTLE * known[2]
        ):
            known = self._known = x.copy(), self._jacobian(x, r), cost
        J = known[1]
        return cost, np.real(J.conj().T @ r), np.real(J.conj().T @ J)


@checked_types
@reported("refine")
def refine(
    found: IdentificationResult,
    experiment: Experiment,
    *,
    free: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    runs: int = 1,
    time_limit: float | None = None,
    progress: Choice = None,
) -> IdentificationResult:
    """Refine identified parameters by simulation of the experiment on the nonlinear model.

    Parameters
    ----------
    found : IdentificationResult
        From the frequency responses of the same experiment; where the search begins. Its model
        error remains, unless friction or springs are not linear.
    experiment : Experiment
    free : sequence of str, optional
        Default: those of ``found``, and viscous and Coulomb friction and ``beta`` of motors and
        joints that have any.
    start : mapping, optional
        Other values to begin with.
    runs : int
        Experiments that are simulated at each pose.
    time_limit : float, optional [s]
        As in `identify`.
    progress : callable or bool, optional

    Returns
    -------
    IdentificationResult
        Weights ``"time domain"``; its ``data`` are the frequency responses of ``found``.

    Raises
    ------
    ArgumentError
        The experiment is another one, or a parameter cannot be simulated.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> # file: 7.5e6
    >>> robot = flexgen.read(
    ...     "elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 6e6}
    ... )
    >>> experiment = flexgen.measure(plan, robot)
    >>> found = flexgen.identify("elbow", flexgen.frf(experiment), starts=1)
    >>> f"{flexgen.refine(found, experiment).values['q1.stiffness']:.2e} N m/rad"
    '6.00e+06 N m/rad'
    """
    began = time.perf_counter()
    tell = progress if callable(progress) else None
    plan = experiment.plan
    model = found.vector.model
    _check(found, experiment, runs)
    names = list(found.vector.names) + frictions_of(found) if free is None else list(free)
    if any(is_of_sensor(name) for name in free or ()):
        raise ArgumentError(
            "free: given the delay of a sensor, which the motors do not show: 'identify' can "
            "fit it"
        )
    held = [
        name
        for name in names
        if is_of_sensor(name) or name == DELAY or f".{name}".endswith(CONSTANT)
    ]
    unknown = [name for name in dict.fromkeys(names) if name not in held]
    names = [name for name in unknown if not is_of_drive(name)]
    for parameter in select(model, names):
        if parameter.inertia:
            raise ArgumentError(
                f"free: given {parameter.name}, expected stiffness, damping, friction or payload"
            )
    begin = {
        name: value
        for name, value in found.used().items()
        if name in {p.name for p in select(model, names)}
    }
    vector = ParameterVector(
        model, unknown, start=begin | dict(start or {}), controller=plan.controller
    )
    simulated = Simulated(vector, experiment, _choose(plan, 0, runs), tell)
    problem = vector.problem(simulated.sums, simulated.cost)
    with limit_fit("refine", time_limit, tell):
        rough = minimize(problem, vector.start, Search(ROUGH_DISTANCE))
        fit = rough
        if not is_over():
            with keep_best():
                simulated.use_noise(rough.x)
        if not is_over():
            simulated.use_whole()
            fit = minimize(problem, rough.x, Search(DISTANCE))
        reason = reason_of_end()
    degrees = max(simulated.count - len(vector) / 2, 1.0)
    cost = fit.cost / degrees
    prior = np.diag(vector.prior_sd**-2.0)
    inverse = np.linalg.inv(fit.A + prior)
    # A cost above one: the residual is not only noise; the standard deviations grow with it.
    covariance = inverse @ (0.5 * max(cost, 1.0) * fit.A + prior) @ inverse
    return replace(
        found,
        vector=vector,
        x=fit.x,
        found_delays=found.sensor_delays,
        formal_covariance=covariance,
        status=FitStatus.of_value(reason)
        if reason
        else refined_status(fit, cost, simulated, found),
        cost=cost,
        model_error=0.0,
        starts=1,
        agreed=1,
        iterations=rough.iterations + fit.iterations * (fit is not rough),
        at_bound=tuple(
            name for name, held in zip(vector.names, fit.at_bound, strict=True) if held
        ),
        weak=weak_directions(vector, fit.A),
        weights=TIME_DOMAIN,
        grade=None,
        wall_s=time.perf_counter() - began,
    )


def _check(found: IdentificationResult, experiment: Experiment, runs: int) -> None:
    """ArgumentError where an experiment cannot be simulated, or is not that of the frequency
    responses.
    """
    plan = experiment.plan
    if plan.motors != found.data.motors or not np.array_equal(plan.poses, found.data.poses):
        raise ArgumentError(
            "experiment: given other motors or poses than those of the frequency responses"
        )
    if not plan.controller.speed_gain.any() or not (
        plan.amplitudes.any() or experiment.references is not None
    ):
        raise ArgumentError(
            f"experiment: given {experiment.source}, without the gains and references of its "
            "drives, expected tables [drive] and [[reference]] in the description of the "
            "recordings, or an experiment of 'measure'"
        )
    if not isinstance(runs, int) or not 1 <= runs <= plan.experiments * plan.realizations:
        most = plan.experiments * plan.realizations
        raise ArgumentError(
            f"runs: given {runs!r}, expected 1 to {most}, the experiments at each pose"
        )


def _choose(plan: Plan, first: int, count: int) -> list[tuple[int, int, int]]:
    """At each pose ``count`` experiments, other ones from pose to pose; with other ``first`` other
    ones.
    """
    every = [(r, e) for r in range(plan.realizations) for e in range(plan.experiments)]
    return [
        (k, *every[(k + i) % len(every)])
        for k in range(len(plan.poses))
        for i in range(first, first + count)
    ]


@dataclass(frozen=True)
class Validation:
    """Simulation of experiments that were not used.

    ``fit_percent``: ``100 (1 - |Q(x) - Q| / |Q|)`` of the accelerations of each motor; ``cost``:
    mean square of the weighted residuals, 1 where model and noise are right; ``white``: part of
    the correlations of the weighted residuals between lines (lags 1 to `LAGS`) of each motor
    within the 99 % band of white noise.
    """

    fit_percent: tuple[float, ...]
    cost: float
    white: tuple[float, ...]


def validate(
    found: IdentificationResult, experiment: Experiment, *, used: int = 1, progress: Choice = None
) -> Validation:
    """Simulate experiments that `refine` did not use, with the parameters that it found.

    Parameters
    ----------
    found : IdentificationResult
        Result of `refine`.
    experiment : Experiment
        With more than ``used`` experiments at each pose.
    used : int
        The ``runs`` of `refine`.
    progress : callable or bool, optional

    Raises
    ------
    ArgumentError
        There are no further experiments.
    """
    plan = experiment.plan
    if used >= plan.experiments * plan.realizations:
        raise ArgumentError(
            f"used: given {used}, expected fewer than the {used} experiments at each pose"
        )
    tell = progress if callable(progress) else None
    simulated = Simulated(found.vector, experiment, _choose(plan, used, 1), tell)
    simulated.use_noise(found.x)
    r = simulated.residual(found.x)  # (runs, lines, n_m)
    away, size = (np.linalg.norm(x, axis=(0, 1)) for x in (r * simulated.sd, simulated.measured))
    power = (np.abs(r) ** 2).sum(axis=(0, 1))
    count = r.shape[0] * r.shape[1]
    lags = [
        np.abs(np.real((r[:, lag:] * r[:, :-lag].conj()).sum(axis=(0, 1)))) / power
        for lag in range(1, min(LAGS, r.shape[1] - 1) + 1)
    ]
    # the real part of a correlation of complex noise has half of its variance
    white = (np.array(lags) < 2.58 / np.sqrt(2 * count)).mean(axis=0)
    return Validation(
        tuple((100 * (1 - away / size)).tolist()),
        float((np.abs(r) ** 2).sum() / r.size),
        tuple(white.tolist()),
    )


def validate_on_others(found: IdentificationResult, checked: Validation) -> IdentificationResult:
    """The result with the status ``poorly validated`` where it agreed, and other experiments do
    not.
    """
    fails = checked.cost > COST_MOST and min(checked.fit_percent) < 100 * (1 - SMALL_ERROR)
    return (
        replace(found, status=FitStatus.POORLY_VALIDATED)
        if fails and found.status.agrees
        else found
    )


def refine_and_validate(
    found: IdentificationResult,
    experiment: Experiment,
    time_limit: float | None = None,
    progress: Choice = None,
) -> tuple[IdentificationResult, Validation | None]:
    """Parameters refined on one experiment at each pose, and their status on another; None: there
    is only one.
    """
    fine = refine(found, experiment, time_limit=time_limit, progress=progress)
    single = experiment.plan.experiments * experiment.plan.realizations < 2
    if single or fine.status.ended_early:
        return fine, None
    checked = validate(fine, experiment)
    return validate_on_others(fine, checked), checked


def frictions_of(found: IdentificationResult) -> list[str]:
    """Friction numbers of motors and joints that the model file has."""
    model = found.vector.model
    parts = [(motor.name, motor.friction) for motor in model.motors]
    parts += [(c.name, c.dof.friction) for c in model.coordinates if c.dof is not None]
    return [
        f"{part}.{name}"
        for part, friction in parts
        for name in FRICTION
        if getattr(friction, name, 0.0) > 0.0
        and (
            name != "beta"
            or friction.coulomb > 0.0
            or getattr(friction, "load_coulomb", 0.0) > 0.0
        )
    ]


def refined_status(
    fit: Minimum, cost: float, simulated: Simulated, found: IdentificationResult
) -> FitStatus:
    """Status of a refinement, by its search, its cost and the residual of the motion."""
    if not fit.converged or fit.at_bound.any():
        return FitStatus.AT_BOUND if fit.converged else FitStatus.NOT_CONVERGED
    relative = np.linalg.norm(simulated.residual(fit.x) * simulated.sd) / np.linalg.norm(
        simulated.measured
    )
    bent = simulated.local.springs or any(name.endswith("coulomb") for name in frictions_of(found))
    # the angles of one experiment show less than all responses
    if found.status == FitStatus.MODEL_ERROR and not bent:
        return FitStatus.MODEL_ERROR
    wrong = FitStatus.MODEL_ERROR if relative > SMALL_ERROR else FitStatus.SMALL_ERROR
    return wrong if cost > COST_MOST else FitStatus.FITTED


def _standard_deviation(spectra: np.ndarray) -> np.ndarray:
    """Deviation of the mean over the periods (1, lines, n_m), from all robots together and
    neighboring lines.

    ``spectra`` (runs, periods, lines, n_m). Without noise: a small part of the signal, so that
    nothing is divided by zero.
    """
    periods = spectra.shape[1]
    variance = np.var(spectra, axis=1, ddof=1).mean(axis=0) / periods
    smooth = np.empty_like(variance)
    for line in range(len(variance)):
        smooth[line] = variance[max(0, line - 3) : line + 4].mean(axis=0)
    least = (1e-6 * np.sqrt((np.abs(spectra) ** 2).mean(axis=(0, 1)))) ** 2
    return np.sqrt(smooth + least)[None]
