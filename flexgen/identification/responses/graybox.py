"""`identify`: fit the physical parameters of a model to frequency responses at several poses.

One vector of parameters for all poses; first element by element, then, where the noise explains
the residuals, with weights from the structure of the noise. Several starts show whether the
minimum is the global one.

Source: E. Wernholt and S. Moberg, Automatica 47(6), 2011 (nonlinear gray-box identification using
local models).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexgen.base.calls.deadline import is_over, keep_best, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import Count, NotNegative, TimeLimit
from flexgen.base.checks.counts import STARTS, count_of, show_value
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, FlexgenError, SolverError
from flexgen.base.numerics.records import TRANSIENT
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.feedback.loop.gains import lowest_locked_hz
from flexgen.identification.causes.explain import Cause, explain, hidden_causes
from flexgen.identification.causes.levels import compare_levels
from flexgen.identification.estimator.fit_grade import Grade, grade
from flexgen.identification.estimator.minimize import Minimum, minimize
from flexgen.identification.estimator.status import status_of_end
from flexgen.identification.estimator.validation import WORSE
from flexgen.identification.experiments.plan import default_free
from flexgen.identification.motions.motion_correction import (
    correct_responses,
    find_shift,
    obstacle,
)
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.parameters import SENSOR_DELAY, ParameterVector, is_of_sensor
from flexgen.identification.responses.residuals import (
    RESIDUALS,
    ResidualName,
    Residuals,
    over_lines,
)
from flexgen.identification.responses.result import (
    WEAK,
    FitStatus,
    IdentificationResult,
    with_coulomb,
)
from flexgen.model.abilities import needs
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

COST_LEAST = 0.5  # of a good fit
COST_MOST = 2.0  # for one degree of freedom
POLISHES = 2  # fits with weights from the structure of the noise
AVERAGINGS = 3  # fits with springs averaged over the deflections that follow from the last fit
REWEIGHTINGS = 4  # fits with a model error
NEIGHBORS = 15  # and lines over which it is averaged
SMALL_ERROR = 1e-3  # a model error that is too small to mention
WITHOUT_NOISE = 1e-7  # relative deviation of responses that differ by rounding alone
SAME = 1e-3  # relative difference of costs at the same minimum
# Part of responses that were not fitted which is not explained, over that of the fitted ones and
# as a part, from which on both together the model is poorly validated.
POOR = 0.05
SPREAD = 1.5  # further starts are off by up to this factor


@checked_types
@reported("identify")
@needs("identify")
def identify(
    model: RobotModel | str | Path,
    data: Frf,
    *,
    free: Sequence[str] | None = None,
    fixed: Sequence[str] = (),
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, float] | None = None,
    ties: Mapping[str, str] | None = None,
    residual: ResidualName = "nls",
    structured: bool = True,
    floor: NotNegative | None = None,
    starts: Count = 3,
    spread: float = SPREAD,
    seed: int = 0,
    source: str = "",
    levels: Sequence[Frf] = (),
    validate: Sequence[Frf] = (),
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> IdentificationResult:
    """Fit parameters of a model to frequency responses.

    Parameters
    ----------
    model : RobotModel, str or Path
    data : Frf
    free : sequence of str, optional
        Parameters: ``stiffness``, ``damping``, ``q1.stiffness``, ``m1.viscous``, ``delay``,
        ``sensor_delay``, ``torque_constant``, ...; default: stiffness, damping and the viscous
        frictions of the model. See `flexgen.dynamics.mechanics.parameters`; of one sensor:
        ``acc.delay``.
    fixed : sequence of str
        Parameters that stay.
    start : mapping, optional
        Where the search begins. Values by name.
    bounds, priors, ties
        See `flexgen.identification.responses.parameters.ParameterVector`.
    residual : str
        ``"nls"``: differences (default); ``"lls"``: of complex logarithms. The latter are less
        sensitive to bad start values.
    structured : bool
        End with weights from the structure of the noise, where the noise explains the residuals.
    floor : float, optional
        Model error as a part of the responses, such as 0.02; default: as much as the residuals
        need. It is added to the standard deviations of the data.
    starts : int
        Number of searches. One from the start values, the others from random ones.
    spread : float
        The random start values are off by up to this factor.
    seed : int
    source : str
        Of the data, for the new model file.
    levels : sequence of Frf
        Responses of the same experiment with other amplitudes: also tell whether the robot is
        nonlinear, and why. Amplitudes such as a third: ``amplitude`` of the result tells whether
        hysteresis, backlash, a stiffness that rises with the deflection or Coulomb friction, which
        the model lacks, explains it.
    validate : sequence of Frf
        Responses that are not fitted, such as those at other poses: what the model does not
        explain of each is ``held_out`` of the result.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the result is the best step so far,
        with the status ``time limit`` or ``interrupted``. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    IdentificationResult

    Raises
    ------
    ArgumentError
        A name is unknown, data belong to another robot, or the levels are of other poses or
        alike.
    SolverError
        The model has no equilibrium at the poses of the data.

    Examples
    --------
    >>> plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    >>> # file: 7.5e6
    >>> robot = flexgen.read(
    ...     "elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 6e6}
    ... )
    >>> found = flexgen.identify("elbow", flexgen.frf(flexgen.measure(plan, robot)), starts=1)
    >>> f"{found.values['q1.stiffness']:.2e} N m/rad"
    '6.00e+06 N m/rad'
    """
    tell = progress if callable(progress) else None
    robot = model if isinstance(model, RobotModel) else read(model)
    _check(robot, data, residual, floor, starts, spread)
    for held in validate:
        _check(robot, held, residual, floor, starts, spread, "validate")
    names = default_free(robot) if free is None else free
    vector = ParameterVector(
        robot, names, fixed=fixed, start=start, bounds=bounds, priors=priors, ties=ties
    )
    with limit_fit("identify", time_limit, tell):
        found = _fit(vector, data, residual, structured, floor, (starts, spread, seed), tell)
        tested = None
        if levels and not is_over():
            with keep_best():
                tested = compare_levels(
                    Residuals(vector, data, deflection_sd=found.deflection_sd), found.x, levels
                )
        held_out = (
            () if is_over() else tuple(find_unexplained_part(vector, x, found.x) for x in validate)
        )
        within = find_unexplained_part(vector, data, found.x) if held_out else 0.0
    poor = max(held_out, default=0.0) > max(WORSE * within, POOR)
    known = found.status not in (FitStatus.NOT_CONVERGED, FitStatus.AT_BOUND)
    status = found.status
    if poor and known and not status.ended_early:
        status = FitStatus.POORLY_VALIDATED
    return replace(found, source=source, amplitude=tested, held_out=held_out, status=status)


def find_unexplained_part(vector: ParameterVector, data: Frf, x: np.ndarray) -> float:
    """Part of the responses that a model with the parameters ``x`` and the noise do not explain,
    of the element with the largest; see `Residuals.find_unexplained`.
    """
    residuals = Residuals(vector, data)
    residuals.average_springs(x)
    if not obstacle(data):
        residuals = residuals.on(correct_responses(residuals, x)[0])
    return residuals.find_unexplained(x)


def _confirm(status: FitStatus, causes: tuple[Cause, ...]) -> FitStatus:
    """The status after the search for causes: of a fit that agrees, a hidden one is a model
    error.
    """
    if status is not FitStatus.FITTED:
        return status
    if causes:
        return FitStatus.MODEL_ERROR
    # A search that was ended early may have missed the cause that matters.
    return status_of_end(status, reason_of_end())


def _fit(
    vector: ParameterVector,
    data: Frf,
    residual: str,
    structured: bool,
    floor: float | None,
    starts: tuple[int, float, int],
    tell: Callable[[str], None] | None,
) -> IdentificationResult:
    """The fit: element by element from several starts, then with a model error or with the
    structure of the noise.
    """
    began = time.perf_counter()
    recorded = {
        sensor.name for sensor in vector.model.sensors if set(sensor.channels) & set(data.sensors)
    }
    for name in vector.names:
        if is_of_sensor(name) and name.removesuffix(SENSOR_DELAY) not in recorded:
            raise ArgumentError(
                f"free: given {name!r}, expected a sensor of the data: "
                f"{', '.join(recorded) or 'none'}"
            )
    residuals = Residuals(vector, data, residual, floor or 0.0)
    residuals.average_springs(vector.start)
    degrees = max(residuals.count - len(vector) / 2, 1.0)  # complex residuals, real parameters
    fits = _searches(vector, residuals, *starts, tell)
    best = min(fits, key=lambda fit: fit.objective)
    agreed = sum(fit.objective <= best.objective * (1 + SAME) + 1e-9 * degrees for fit in fits)
    if residuals.local.springs:
        for _ in range(AVERAGINGS):
            residuals.average_springs(best.x)
            if is_over():
                break
            best = _search(residuals, best.x)
    measured = data
    unsure = 0.0
    if not obstacle(data) and not is_over():
        if tell is not None:
            tell("correction for large motions")
        data, unsure = correct_responses(residuals, best.x)
        residuals = residuals.on(data, floor or 0.0)
        best = _search(residuals, best.x)
    error = floor or 0.0
    if floor is None and best.cost > COST_MOST * degrees and not is_over():
        left = residuals.find_unexplained(best.x)
        error, residuals, best = _with_model_error(vector, data, residuals, best, degrees, tell)
        error = left if error <= SMALL_ERROR < left else error
    explained = (
        data.total is None and error == 0.0 and COST_LEAST <= best.cost / degrees <= COST_MOST
    )
    if structured and explained and residual == "nls" and not is_over():
        residuals, best, left = _with_structure(vector, data, residuals, best, degrees)
        error = (
            left if floor is None and data.noise_UU is not None and left > SMALL_ERROR else error
        )
    cost = best.cost / degrees
    status = status_of_end(fit_status(best, cost, error, data, floor is not None), reason_of_end())
    causes: tuple[Cause, ...] = ()
    explicable = floor is None and residual == "nls" and status is not FitStatus.NOISE_TOO_LARGE
    # A cause of less would explain rounding, such as a delay of 1e-11 s.
    explicable &= max(error, data.relative_sd()) > WITHOUT_NOISE
    if explicable and not is_over():
        fitted = status is FitStatus.FITTED
        with keep_best():
            causes = (
                hidden_causes(residuals, best.x) if fitted else explain(residuals.on(data), best.x)
            )
        causes = () if is_over() else causes  # of a part of the causes one may seem the best
        status = _confirm(status, causes)
    covariance = residuals.covariance(best.x, best.A)
    if unsure:
        away = unsure * find_shift(residuals, best.x, best.A, measured.G)
        covariance = covariance + np.outer(away, away)
    return IdentificationResult(
        vector=vector,
        x=best.x,
        formal_covariance=covariance,
        status=status,
        cost=cost,
        model_error=error,
        starts=len(fits),
        agreed=agreed,
        iterations=best.iterations,
        at_bound=tuple(
            name for name, held in zip(vector.names, best.at_bound, strict=True) if held
        ),
        weak=(*weak_directions(vector, best.A), *hidden_numbers(vector, data, best.A, covariance)),
        data=measured,
        variance=residuals.variance,
        deflection_sd=residuals.deflection_sd,
        weights=residuals.kind,
        causes=causes,
        grade=_grade(residuals, best.x, measured),
        wall_s=time.perf_counter() - began,
    )


def _grade(residuals: Residuals, x: np.ndarray, data: Frf) -> Grade | None:
    """The grade of the model at x; None where its responses cannot be inverted."""
    vector = residuals.vector
    named = vector.named(x)
    model = with_values(vector.model, {name: named[name] for name in vector.of_model})
    still = np.zeros((1, model.n_a))
    quiet = np.zeros((1, model.n_m))
    arm = np.zeros((1, model.n_a))
    arm[:, list(model.i_g)] = data.poses[:1] @ np.linalg.inv(model.eta).T
    motion = (arm, still, still, data.poses[:1], quiet, quiet, quiet)
    try:
        return grade(data, residuals.response(x).G, lowest_locked_hz(model, motion))
    except (np.linalg.LinAlgError, FlexgenError):
        return None


def _check(
    robot: RobotModel,
    data: Frf,
    residual: str,
    floor: float | None,
    starts: int,
    spread: float,
    name: str = "data",
) -> None:
    """ArgumentError where data, those of the parameter ``name``, or settings cannot be used."""
    motors = tuple(motor.name for motor in robot.motors)
    if motors != data.motors:
        raise ArgumentError(
            f"{name}: given the motors {', '.join(data.motors)}, expected {', '.join(motors)} in "
            f"this order, those of {robot.name}"
        )
    if residual not in RESIDUALS:
        raise ArgumentError(
            f"residual: given {residual!r}, expected one of {', '.join(RESIDUALS)}"
        )
    count_of("starts", starts, STARTS)
    if not (is_number(spread) and spread >= 1.0):
        raise ArgumentError(f"spread: given {show_value(spread)}, expected a number >= 1")
    if floor is not None and not 0 <= floor < 1:
        raise ArgumentError(f"floor: given {floor!r}, expected a part of |G| between 0 and 1")


def _with_structure(
    vector: ParameterVector, data: Frf, residuals: Residuals, best: Minimum, freedom: float
) -> tuple[Residuals, Minimum, float]:
    """Fit again with weights from the structure of the noise, which are more accurate.

    The structure is noise of the motor torques and of the measured angles. It has few unknowns, so
    its covariances are more certain than those of single elements of the responses. A transient or
    a wrong model breaks the structure: then the misfit becomes implausible, more than `COST_MOST`
    for each degree of freedom, and the given fit stays.

    Parameters
    ----------
    vector, data
        Parameters and measured frequency responses.
    residuals, best
        The given fit, with weights of single elements: its residuals and its minimum.
    freedom : float
        Degrees of freedom of the fit: complex residuals minus half the number of parameters.

    Returns
    -------
    tuple of Residuals, Minimum and float
        The accepted fit, and the largest relative error of an element of the responses that noise
        does not explain. This number is that of the fit with the structure, also where that fit is
        rejected: it then tells how wrong the model is. Where the time limit is over it is that of
        the given fit.
    """
    structured = Residuals(vector, data, deflection_sd=residuals.deflection_sd)
    fit = best
    # repeated, since the levels of torque and angle noise depend on the fitted responses
    for _ in range(POLISHES):
        if is_over():
            return residuals, best, residuals.find_unexplained(best.x)
        structured.use_structure(fit.x)
        fit = _search(structured, fit.x)
    # Scaled to the number of residuals of the given fit: noisy directions of the excitation count
    # less in the fit with the structure.
    misfit = structured.misfit(fit.x) * residuals.count / structured.count
    unexplained = structured.find_unexplained(fit.x)
    if misfit > COST_MOST * freedom:
        return residuals, best, unexplained
    return structured, replace(fit, cost=misfit), unexplained


def _search(residuals: Residuals, start: np.ndarray) -> Minimum:
    return minimize(residuals.problem, start)


def _searches(
    vector: ParameterVector,
    residuals: Residuals,
    starts: int,
    spread: float,
    seed: int,
    tell: Callable[[str], None] | None,
) -> list[Minimum]:
    """The search from the start values, and others from random ones; those without an equilibrium
    are left out.
    """
    rng = np.random.default_rng(seed)
    fits: list[Minimum] = []
    reason: SolverError | None = None
    for k in range(starts):
        away = rng.uniform(-1, 1, len(vector)) * np.log(spread) if k else np.zeros(len(vector))
        log = np.array([u.scale == "log" for u in vector.unknowns])
        if tell is not None:
            tell(f"start {k + 1} of {starts}")
        if fits and is_over():
            break
        try:
            start = vector.start + np.where(log, away, 0.0)
            fits.append(_search(residuals, start))
        except SolverError as error:
            reason = error
    if not fits:
        raise reason or SolverError("identify: no search was possible")
    return fits


def _with_model_error(
    vector: ParameterVector,
    data: Frf,
    plain: Residuals,
    best: Minimum,
    degrees: float,
    tell: Callable[[str], None] | None,
) -> tuple[float, Residuals, Minimum]:
    """The size of the model error, the residuals with it in their weights, and their fit.

    First one part of ``|G|`` for all elements, for which the cost is 1 for each degree of freedom.
    Then, for each element by itself, the part of its residuals above the noise, averaged over
    neighboring lines: friction and missing springs do not disturb all channels in the same way.
    """
    noise = plain.variance
    size = np.abs(data.G) ** 2
    difference = np.abs(plain.response(best.x).G - data.G) ** 2
    low = 0.0
    high = 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (
            (middle, high)
            if (difference / (noise + middle**2 * size)).sum() > degrees
            else (low, middle)
        )
    residuals = plain.on(data, high)
    best = _search(residuals, best.x)
    error = high
    for k in range(REWEIGHTINGS):
        if is_over():
            break
        difference = np.abs(residuals.response(best.x).G - data.G) ** 2
        extra = np.maximum(over_lines(difference - noise, NEIGHBORS), 0.0)
        error = float(np.sqrt(np.median(extra / size)))
        if tell is not None:
            tell(
                f"model error {100 * error:.2g} % of the responses, fit {k + 1} of {REWEIGHTINGS}"
            )
        residuals = residuals.on(data, extra=extra)
        best = _search(residuals, best.x)
    return error, residuals, best


def fit_status(fit: Minimum, cost: float, error: float, data: Frf, stated: bool) -> FitStatus:
    """The status of a fit; ``stated``: the user has stated the model error."""
    if not fit.converged:
        return FitStatus.NOT_CONVERGED
    if fit.at_bound.any():
        return FitStatus.AT_BOUND
    if error > SMALL_ERROR or any(TRANSIENT in line for line in data.warnings):
        return FitStatus.MODEL_ERROR
    if cost > COST_MOST:
        # A misfit that is known to be small, as that of responses without noise, is not an error
        # of the model.
        return FitStatus.SMALL_ERROR if error > 0.0 and not stated else FitStatus.MODEL_ERROR
    # Responses without noise fit better than any noise allows, and rightly.
    if cost < COST_LEAST and data.relative_sd() > WITHOUT_NOISE:
        return FitStatus.NOISE_TOO_LARGE
    return FitStatus.FITTED


def hidden_numbers(
    vector: ParameterVector, data: Frf, A: np.ndarray, covariance: np.ndarray
) -> tuple[str, ...]:
    """Sentences on a transient, on what noise of torques hides, and on viscous frictions with
    Coulomb friction.
    """
    found = [line for line in data.warnings if TRANSIENT in line]
    if data.speed_sd.any() and (reason := obstacle(data)):
        found.append(f"the responses are not corrected for large motions: {reason}")
    rows = zip(
        vector.unknowns,
        np.diag(np.linalg.pinv(2 * A, hermitian=True)),
        np.diag(covariance),
        strict=True,
    )
    if names := [
        u.name for u, formal, variance in rows if u.scale == "log" and formal < WEAK**2 < variance
    ]:
        why = (
            "noise of the torques causes too much of the motion that shows them; excite with a "
            "higher speed"
        )
        found.append(f"not determined by the data: {', '.join(names)}: {why}")
    if names := [name for name in with_coulomb(vector.model) if name in vector.names]:
        found.append(
            f"frequency responses do not tell {', '.join(names)} from Coulomb friction: the "
            "values of the file are kept; refine with the experiment"
        )
    return tuple(found)


def weak_directions(vector: ParameterVector, A: np.ndarray) -> tuple[str, ...]:
    """Sentences on combinations of parameters that the data do not determine: ``2 A`` is their
    information.
    """
    log = np.array([u.scale == "log" for u in vector.unknowns])
    scale = np.where(log, 1.0, vector.prior_sd)  # a unit for those without logarithm
    values, vectors = np.linalg.eigh(2 * A * np.outer(scale, scale))
    out = []
    for value, direction in zip(values, vectors.T, strict=True):
        sd = 1.0 / np.sqrt(max(value, 1e-300))
        if sd < WEAK:
            break
        order = np.argsort(-np.abs(direction))
        main = [k for k in order if abs(direction[k]) > 0.3][:4]
        size = f"{100 * sd:.0f} %" if sd < 10 else "more than a factor of 10"
        if len(main) == 1:
            out.append(f"{vector.names[main[0]]} is not determined by the data (sd {size})")
            continue
        sign = np.sign(direction[main[0]])
        up = [vector.names[k] for k in main if np.sign(direction[k]) == sign]
        down = [vector.names[k] for k in main if np.sign(direction[k]) != sign]
        words = f"{', '.join(up)} can change together" + (
            f", and {', '.join(down)} against them" if down else ""
        )
        out.append(f"{words} (sd {size})")
    return tuple(out)
