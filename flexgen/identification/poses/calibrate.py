"""Calibration of an elastic robot from static poses: kinematics, compliances, mechanisms, masses,
in one least squares.

    q = command + zero + compliance * load of gravity,
    y = pose of the world in the measurement * kinematics(q)

Sources: S. Moberg, Linkoeping 2010 (extended flexible joint model); J. Tenhumberg and B. Baeuml,
Calibration of an elastic humanoid upper body and efficient compensation for motion planning, IEEE
Humanoids 2021 (lateral compliances).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexgen.base.calls.deadline import is_over, keep_best, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import CountOrZero, TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.identification.estimator.validation import validate
from flexgen.identification.poses.accuracy import (
    Accuracy,
    accuracy_of,
    find_undetermined,
    with_kept,
)
from flexgen.identification.poses.components import (
    Tilt,
    find_tilt,
    seen_others,
    tilt_slopes,
    whitening_of,
)
from flexgen.identification.poses.fit import Minimum, Poses, fit
from flexgen.identification.poses.mistakes import (
    DOUBTFUL,
    find_start,
    place_points,
    place_surfaces,
    scatter_of_shuffled,
    start_at_points,
)
from flexgen.identification.poses.parameters import (
    GROUPS,
    Priors,
    Unknown,
    length_of_scale,
    points_of,
    trackers_of,
    unknowns_of,
)
from flexgen.identification.poses.poses import StaticPoses, surfaces_of
from flexgen.identification.poses.result import Calibration
from flexgen.identification.poses.score_test import MOVED, Suspect, find_causes
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tolerance_test import ELSEWHERE, ToleranceTest, check_tolerances
from flexgen.identification.poses.tree import Tree
from flexgen.model.abilities import needs
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

FEWEST = 5  # poses
PULL = -2.0  # standard deviations below its bound at which a compliance is a sign of a wrong model
MANY = 1.5  # held-out error over that of the fit above which the poses are too few
# Fits with fewer numbers each, at most: numbers that are determined only until the first are kept.
ROUNDS = 3
GROSS = 6.0  # scales from which an error is gross


@checked_types
@reported("calibrate")
@needs("calibrate")
def calibrate(
    model: RobotModel | str | Path,
    poses: StaticPoses | str | Path,
    *,
    free: Sequence[str] = GROUPS,
    place: Sequence[str] = (),
    priors: Priors | None = None,
    folds: CountOrZero = 5,
    robust: bool = True,
    columns: Sequence[str] | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Calibration:
    """Calibrate a model with static poses: where trackers were measured at commanded joints.

    Minimizes ``sum rho(|y - y_measured|) + sum ((x - x_0)/sd)^2`` over the frame of the
    measurement, the positions of the trackers and the free numbers; compliances stay above 0. Only
    products of compliance and mass can be seen at rest: the priors fix what remains.

    Parameters
    ----------
    model : RobotModel, str or Path
        With linear springs, and a ``[[sensor]]`` of type ``tracker`` for each measured point.
    poses : StaticPoses, str or Path
        CSV file of static poses: commanded joints (``q1_rad`` or ``q1_deg``), positions of the
        trackers (``NAME_x_m`` or ``NAME_x_mm``, ...), or what they touch (``NAME_point``,
        ``NAME_touch``, ``NAME_reading_mm``); one line for each pose. See `StaticPoses.read`.
        Trackers that touch fixed points, without measured positions, determine neither the place
        of the base nor the zero of a joint about which all points turn, and no length scale: with
        ``placements`` one length is held.
    free : sequence of str
        Groups of numbers: ``zeros``, ``placements``, ``compliances``, ``mechanisms``, ``masses``;
        default: all. Zeros of the joints, placements of the elements, factors of ``mimic``
        (mechanisms), masses with centers of mass.
    place : sequence of str
        Elements whose place at their parent is not known. It is found in closed form first.
    priors : Priors, optional
        Standard deviations about the numbers of the model.
    folds : int
        Parts of the poses that are left out in turn, for the error on poses that were not fitted;
        0: none.
    robust : bool
        Huber's loss, which limits the weight of gross errors. False: plain least squares: gross
        errors keep their weight.
    columns : sequence of str, optional
        Names of the columns of a file without a header. Such as ``q1 deg,q2 deg,-,p_x,p_y,p_z``;
        without unit in SI units.
    time_limit : float, optional [s]
        Time limit; default: no limit. Then, or after Ctrl-C, the result is the best step so far;
        its ``ended`` says so. None or 0: unlimited.
    progress : callable or bool, optional

    Returns
    -------
    Calibration

    Raises
    ------
    ArgumentError
        The poses do not belong to the model, for instance with wrong units or signs; or a name is
        unknown.
    ModelError
        The model has a beam, or a spring that is not linear.
    SolverError
        A pose has no static equilibrium.

    Examples
    --------
    >>> import numpy as np
    >>> tracker = {"name": "p", "type": "tracker", "unit": "m", "element": "tool"}
    >>> robot = flexgen.read("elbow", overrides={"sensor": [tracker]})
    >>> # file: 7.5e6 N m/rad
    >>> softer = {"sensor": [tracker], "element.upper.dof.q1.gear.spring.stiffness": 4e6}
    >>> q = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 2))
    >>> seen = flexgen.tracker_positions(flexgen.read("elbow", overrides=softer), q)
    >>> found = flexgen.calibrate(robot, flexgen.StaticPoses(q, seen), free=["compliances"])
    >>> f"{1 / found.values['q1.compliance']:.2g} N m/rad"
    '4e+06 N m/rad'
    """
    tell = progress if callable(progress) else None
    robot = model if isinstance(model, RobotModel) else read(model)
    tree = Tree(robot)
    trackers = trackers_of(robot)
    if columns is not None and isinstance(poses, StaticPoses):
        raise ArgumentError("columns: given with poses in memory, expected a .csv file")
    data = poses if isinstance(poses, StaticPoses) else StaticPoses.read(poses, robot, columns)
    check_poses(robot, data, len(trackers), folds)
    _check_points(robot, data, place)
    touches = surfaces_of(data)
    unknowns, held = _unknowns(tree, free, place, priors or Priors(), data)
    with limit_fit("calibrate", time_limit, tell):
        statics = Statics(tree, data.commands, data.groups)
        if data.is_measured:
            found = find_start(statics, data, place, tell)
        else:
            found = start_at_points(statics, data)
        centers = place_points(statics, found, data.groups, len(data.point_names))
        found = replace(found, points=centers)
        frames, _ = _unknowns(tree, (), place, priors or Priors(), data)
        if touches is not None:
            touches, surfaces = place_surfaces(statics, found, touches)
            found = replace(found, surfaces=surfaces)
            frames += touches.unknowns()
            unknowns += touches.unknowns()
            statics = Statics(tree, data.commands, data.groups, touches)
        study = _Study(statics, data.targets, unknowns, robust, data.weights)
        known = dict(zip((u.name for u in frames), _start(frames, found), strict=True))
        before = fit(study.problem(frames), np.array(list(known.values())))
        start = np.array([known.get(u.name, u.start) for u in unknowns])
        found_all = _fit_determined(study, start, tell)
        study, result, accuracy, tilt = found_all.last
        taken = [u.name for u in unknowns] + [held]
        tolerances = _check_tolerances(found_all, unknowns, start, taken)
        causes = _causes(study, found_all, taken, tolerances)
        reason = reason_of_end()
        checked = folds > 0 and not reason
        held_out = None
        seen = None
        if checked:
            with keep_best():
                held_out, seen = study.cross_validate(result, tilt, folds, tell)
    stiff = study.statics.rest(Numbers.of(tree, study.unknowns, result.x), rigid=True)
    return Calibration(
        robot,
        data,
        tuple(unknowns),
        found_all.x,
        found_all.covariance,
        before.errors,
        result.errors,
        held_out,
        seen,
        np.linalg.norm(result.rest.points - stiff.points, axis=2),
        tilt,
        result.converged and not reason,
        _warn_scale(held)
        + _warn_unexplained(result, study.statics, data)
        + warnings_of(study.unknowns, result, accuracy.pull, held_out),
        reason,
        found_all.kept,
        causes,
        () if tolerances is None else tolerances.limits,
    )


class _Study:
    """Fits to all poses and to parts of them."""

    def __init__(
        self,
        statics: Statics,
        measured: np.ndarray,
        unknowns: Sequence[Unknown],
        robust: bool,
        weights: np.ndarray | None = None,
    ) -> None:
        self.weights = weights
        self.statics = statics
        self.measured = measured
        self.unknowns = unknowns
        self.robust = robust
        self.valid = np.isfinite(measured).all(axis=2)

    def problem(self, unknowns: Sequence[Unknown], whitening: np.ndarray | None = None) -> Poses:
        """That of all poses."""
        given = (self.statics, self.measured, unknowns, self.robust)
        return Poses(*given, whitening, self.weights)

    def of(self, unknowns: Sequence[Unknown]) -> _Study:
        """Study of the same poses with other numbers free."""
        return _Study(self.statics, self.measured, unknowns, self.robust, self.weights)

    def problem_with(self, tilt: Tilt | None, found: Minimum, of: _Study) -> Poses:
        """That of all poses, with the covariance of a tilt where there is one; ``of`` has the
        numbers that ``found`` is the minimum of.
        """
        if tilt is None:
            return self.problem(self.unknowns)
        return self.problem(self.unknowns, of._whitening(self.statics, found, tilt, self.valid))

    def fit(
        self, start: np.ndarray, tell: Callable[[str], None] | None
    ) -> tuple[Minimum, Accuracy, Tilt | None]:
        """Each point by itself first; then, where trackers share a tilt, with the covariance of
        each pose.
        """
        problem = self.problem(self.unknowns)
        found = fit(problem, start, progress=tell)
        tilt = self._tilt(found)
        if tilt is None or is_over():
            return found, accuracy_of(problem, found), None
        whitening = self._whitening(self.statics, found, tilt, self.valid)
        problem = self.problem(self.unknowns, whitening)
        found = fit(problem, found.x, found.rest.near, progress=tell)
        return found, accuracy_of(problem, found), self._tilt(found)

    def _tilt(self, found: Minimum) -> Tilt | None:
        if self.statics.groups is not None and (self.statics.groups >= 0).any():
            return None  # it would move the poses at a fixed point against each other
        if self.statics.touches is not None or self.weights is not None:
            return None  # a tilt is told from noise of three numbers with one deviation
        gross = (np.nan_to_num(found.sizes) > GROSS).any(axis=1)
        numbers = Numbers.of(self.statics.tree, self.unknowns, found.x)
        return find_tilt(self.statics, numbers, found.rest, self.measured, ~gross)

    def _whitening(
        self, statics: Statics, found: Minimum, tilt: Tilt, valid: np.ndarray
    ) -> np.ndarray:
        numbers = Numbers.of(statics.tree, self.unknowns, found.x)
        return whitening_of(
            tilt, tilt_slopes(statics, numbers, found.rest, [tilt.element])[0], valid
        )

    def cross_validate(
        self, whole: Minimum, tilt: Tilt | None, folds: int, tell: Callable[[str], None] | None
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Errors on poses left out, alone and with the other trackers of the pose; None: ended."""
        order = np.random.default_rng(0).permutation(len(self.measured))
        parts = [np.sort(order[k::folds]) for k in range(folds)]
        whitening = (
            None if tilt is None else self._whitening(self.statics, whole, tilt, self.valid)
        )

        def fit_without(others: list[np.ndarray]) -> tuple[Numbers, np.ndarray]:
            kept = np.sort(np.concatenate(others))
            inner = None if whitening is None else whitening[kept]
            weights = None if self.weights is None else self.weights[kept]
            part = (self.statics.among(kept), self.measured[kept], self.unknowns, self.robust)
            problem = Poses(*part, inner, weights)
            found = fit(problem, whole.x, whole.rest.near.among(kept))
            return problem.numbers(found.x), kept

        def errors_of(found: tuple[Numbers, np.ndarray], one: np.ndarray) -> np.ndarray:
            numbers, kept = found
            others = self.statics.among(one)
            rest = others.rest(numbers, whole.rest.near.among(one))
            alone = np.linalg.norm(rest.measured - self.measured[one], axis=2)
            groups = self.statics.groups
            touches = self.statics.touches
            if groups is not None:
                # the place of a point that no other pose touches is not known
                known = (groups < 0) | np.isin(groups, groups[kept])
                alone = np.where(known[one], alone, np.nan)
            if touches is not None:
                known = touches.find_known(kept) & ~touches.levels
                alone = np.where(known[one], alone, np.nan)
            if tilt is None:
                return alone[None]
            return np.array([alone, seen_others(others, numbers, rest, self.measured[one], tilt)])

        errors = validate(parts, fit_without, errors_of, tell)
        if errors is None:
            return None, None
        found = np.full((len(errors[0]), *self.measured.shape[:2]), np.nan)
        for one, error in zip(parts, errors, strict=True):
            found[:, one] = error
        return found[0], None if tilt is None else found[1]


@dataclass(frozen=True)
class _Determined:
    """A fit in which the numbers that the poses do not determine keep the value of the file.

    ``last``: the fit of the other numbers; ``x``, ``covariance``: of all numbers; ``kept``: names.
    """

    last: tuple[_Study, Minimum, Accuracy, Tilt | None]
    x: np.ndarray
    covariance: np.ndarray
    kept: tuple[str, ...]


def _fit_determined(
    study: _Study, start: np.ndarray, tell: Callable[[str], None] | None
) -> _Determined:
    """Fit all numbers, then those alone that the poses determine, until these are all free."""
    unknowns = study.unknowns
    found, accuracy, tilt = study.fit(start, tell)
    free = np.ones(len(unknowns), bool)
    x = found.x.copy()
    covariance = accuracy.covariance
    inner = study
    file_values = np.array([u.start for u in unknowns])
    for _ in range(ROUNDS):
        if is_over():
            break
        left_out = find_undetermined(inner.unknowns, x[free], accuracy.covariance)
        if not left_out:
            break
        fewer = free.copy()
        fewer[np.flatnonzero(free)[list(left_out)]] = False
        part = study.of([u for u, is_free in zip(unknowns, fewer, strict=True) if is_free])
        again = _fit_from(part, (x[fewer], start[fewer]), tell)
        if again is None:
            break  # with the values of the file the springs do not carry the arm
        inner = part
        free = fewer
        found, accuracy, tilt = again
        x = file_values.copy()
        x[free] = found.x
        whole = study.problem_with(tilt, found, inner)
        covariance = with_kept(whole, x, found.rest.near, free, accuracy.first)
    kept = tuple(u.name for u, is_free in zip(unknowns, free, strict=True) if not is_free)
    return _Determined((inner, found, accuracy, tilt), x, covariance, kept)


def _fit_from(
    study: _Study, starts: Sequence[np.ndarray], tell: Callable[[str], None] | None
) -> tuple[Minimum, Accuracy, Tilt | None] | None:
    """The fit from the first start from which the robot has equilibria; None: from none."""
    for start in starts:
        try:
            return study.fit(start, tell)
        except SolverError:
            continue
    return None


def _check_tolerances(
    found: _Determined, unknowns: Sequence[Unknown], start: np.ndarray, taken: Sequence[str]
) -> ToleranceTest | None:
    """Whether the poses contradict the tolerances of a data sheet, for a reason; None: not tested,
    as for touches, whose places are not known.
    """
    part, minimum, _, tilt = found.last
    statics = part.statics
    touched = statics.groups is not None and bool((statics.groups >= 0).any())
    if is_over() or touched or statics.touches is not None:
        return None
    with keep_best():
        problem = part.of(unknowns).problem_with(tilt, minimum, part)
        return check_tolerances(problem, minimum, start, taken)
    return None


def _causes(
    study: _Study, found: _Determined, taken: Sequence[str], tolerances: ToleranceTest | None
) -> tuple[Suspect, ...]:
    """Numbers that the poses contradict, the one that explains most first."""
    if is_over():
        return ()
    _, minimum, _, tilt = found.last
    more: tuple[Suspect, ...] = ()
    with keep_best():
        more = find_causes(study.problem_with(tilt, minimum, study), minimum, taken)
    if tolerances is None or not tolerances.causes:
        return more
    if minimum.scale > ELSEWHERE * tolerances.scale:
        return tolerances.causes
    known = [*tolerances.worse, *(cause.name for cause in tolerances.causes)]
    others = [cause for cause in more if cause.z is None or cause.name not in known]
    moved = [cause for cause in others if cause.z is None or cause.name.startswith(MOVED)]
    return (*moved, *tolerances.causes, *(cause for cause in others if cause not in moved))


def check_poses(robot: RobotModel, data: StaticPoses, count: int, folds: int) -> None:
    """ArgumentError where poses do not fit the model, or are too few."""
    expected = (robot.n_g, count)
    given = (data.commands.shape[1], data.positions.shape[1])
    if given != expected:
        raise ArgumentError(
            f"poses: given {given[0]} joints and {given[1]} trackers, expected {expected[0]} "
            f"and {expected[1]}, those of model {robot.name}"
        )
    if len(data) < FEWEST:
        raise ArgumentError(f"poses: given {len(data)}, expected at least {FEWEST}")
    different = len(np.unique(data.commands, axis=0))
    if different < FEWEST:
        raise ArgumentError(
            f"poses: given {len(data)} with {different} different commands, expected at least "
            f"{FEWEST} that differ"
        )
    if folds != 0 and not 2 <= folds <= len(data):
        raise ArgumentError(
            f"folds: given {folds}, expected 0, or 2 to {len(data)}, the number of poses"
        )
    if not np.isfinite(data.targets).all(axis=2).any(axis=0).all():
        raise ArgumentError(
            "poses: given a tracker that was seen in no pose, expected at least one position of "
            "each"
        )


def _check_points(robot: RobotModel, data: StaticPoses, place: Sequence[str]) -> None:
    """Refuse what fixed points with measured positions, or without any, cannot start from."""
    seen = np.isfinite(data.positions).all(axis=2)
    if not data.point_names and not np.any(data.touches != ""):
        return
    if not data.is_measured:
        if place:
            raise ArgumentError(
                f"place: given {', '.join(place)} and touches only, expected measured "
                "positions for elements without a known place"
            )
        return
    trackers = [sensor.name for sensor in trackers_of(robot)]
    touches = surfaces_of(data)
    only_levels = np.zeros(len(trackers), bool)
    if touches is not None:
        only_levels = (touches.touched == touches.levels).all(axis=0) & ~seen.any(axis=0)
    counts = zip(trackers, seen.sum(axis=0).tolist(), only_levels.tolist(), strict=True)
    for name, count, is_level in counts:
        if count < FEWEST and not is_level:
            raise ArgumentError(
                f"poses: given {count} measured positions of {name} beside touches, expected "
                f"none of any tracker, or at least {FEWEST} of each"
            )


def _unknowns(
    tree: Tree, free: Sequence[str], place: Sequence[str], priors: Priors, data: StaticPoses
) -> tuple[list[Unknown], str]:
    """The free numbers of the model and the fixed points; and the one that is held for the scale.

    Touches alone have no frame of the measurement, and where none states a length all lengths can
    grow alike.
    """
    found = unknowns_of(tree, free, place, priors)
    held = ""
    if not data.is_measured:
        touches = surfaces_of(data)
        lengths = touches is not None and touches.has_scale
        held = length_of_scale(tree) if "placements" in free and not lengths else ""
        found = [u for u in found if u.kind != "frame" and u.name != held]
    return [*found, *points_of(data.point_names)], held


def _warn_scale(held: str) -> tuple[str, ...]:
    if not held:
        return ()
    return (
        f"touches without a length have no length scale: {held} is held at the model file, the "
        "other lengths and their deviations are relative to it; a few measured positions "
        "determine it",
    )


def _start(unknowns: Sequence[Unknown], found: Numbers) -> np.ndarray:
    """Values of the frame of the measurement, the trackers and the places, from the search in
    closed form.
    """
    arrays = {
        "frame": found.frame,
        "tracker": found.trackers,
        "node": found.shifts,
        "point": found.points,
        "surface": found.surfaces,
    }
    return np.array([arrays[u.kind][u.at if len(u.at) > 1 else u.at[0]] for u in unknowns])


def _warn_unexplained(found: Minimum, statics: Statics, data: StaticPoses) -> tuple[str, ...]:
    """The part of the motion that the calibrated model does not explain, where that is more than a
    tenth. Trackers at fixed points do not move: there, of what shuffled commands would move.
    """
    measured = data.positions
    seen = np.isfinite(measured).all(axis=2)
    if seen.any():
        measured = measured[:, seen.any(axis=0)]  # without levels
        mean = np.nanmean(measured, axis=0)
        motion = float(np.nanmedian(np.linalg.norm(measured - mean, axis=2)))
    else:
        seen = np.isfinite(data.targets).all(axis=2)
        motion = scatter_of_shuffled(statics, Numbers.of(statics.tree), data)
    part = float(np.median(found.errors[seen])) / max(motion, 1e-9)
    if part <= DOUBTFUL:
        return ()
    return (
        f"the calibrated model leaves {100 * part:.0f} % of the motion of the trackers "
        "unexplained: check units, signs and the order of the columns, and the joints and "
        "mechanisms of the model",
    )


def warnings_of(
    unknowns: Sequence[Unknown], found: Minimum, pulls: np.ndarray, held_out: np.ndarray | None
) -> tuple[str, ...]:
    """Warnings about the fitted numbers and the measured poses."""
    out = []
    wrong = [
        u.name.removesuffix(".compliance")
        for u, pull in zip(unknowns, pulls, strict=True)
        if pull < PULL
    ]
    if wrong:
        out.append(
            f"the measurements ask for a negative compliance of {', '.join(wrong)}: a "
            "mechanism, a spring below it or a mass of the model is wrong or missing"
        )
    ratio = (
        1.0
        if held_out is None
        else float(np.nanmean(held_out) / max(np.nanmean(found.errors), 1e-9))
    )
    if ratio > MANY:
        out.append(
            f"the mean error on poses that were not fitted is {ratio:.2g} times that of the "
            "fit: measure more poses or free fewer groups"
        )
    gross = np.flatnonzero((np.nan_to_num(found.sizes) > GROSS).any(axis=1))
    if len(gross):
        shown = ", ".join(str(k + 1) for k in gross[:10]) + (", ..." if len(gross) > 10 else "")
        out.append(
            f"{len(gross)} poses have an error above {1e3 * GROSS * found.scale:.3g} mm: rows "
            f"{shown} of the poses"
        )
    if not found.converged:
        out.append("the search did not end at a minimum")
    return tuple(out)
