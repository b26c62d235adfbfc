"""`identify_gears`: hysteresis and transmission errors of gears from a record of motor angles and
torques.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from flexgen.base.calls.deadline import is_over, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import TimeLimit
from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.fourier import HIGHEST, MOST
from flexgen.base.spec.memory import Hysteresis
from flexgen.dynamics.hysteresis.hysteresis import gear_layers, without_hysteresis
from flexgen.dynamics.hysteresis.hysteresis_law import is_dahl
from flexgen.dynamics.mechanics.equations import derive, robot_of
from flexgen.dynamics.mechanics.lagrangian import gear_stiffness
from flexgen.dynamics.mechanics.lagrangian import gears as gears_of
from flexgen.dynamics.mechanics.parameters import Parameter, names_of_numbers, select
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.gears.driven_arm import ARCMIN, Element, Sought
from flexgen.identification.gears.fit import NO_LOST, Estimate, GearModel, estimate
from flexgen.identification.gears.further_elements import gears_that_lack_elements
from flexgen.identification.gears.result import WEAK, GearFit, Number
from flexgen.identification.gears.signals import Signals, signals_of
from flexgen.identification.records.motor_record import read_motor_record
from flexgen.model.abilities import needs
from flexgen.model.elements import Coordinate, RobotModel
from flexgen.model.format.format_robot import ELEMENTS
from flexgen.model.friction import hysteretic_joints

SHARP = 2.0  # exponent where the search for it begins, at least
# residuals over those that noise explains, and over the torques: more is a model error
NOISE = 1.5
LEAST = 5e-4
EXCESS = 3.0  # the same in a band of frequencies
# times the band: where noise hides a gear, the model agrees in a narrower one
NARROWER = (0.6, 0.36)
# Statuses after which narrower bands show nothing more.
ENDS = (FitStatus.FITTED, FitStatus.NOISE_TOO_LARGE)


@checked_types(own=("band_hz", "harmonics", "cogging", "time_limit"))
@reported("identify_gears")
@needs("identify_gears")
def identify_gears(
    model: str | FilePath | RobotModel,
    record: Trajectory | str | FilePath,
    *,
    joints: Sequence[str] | None = None,
    hysteresis: bool = True,
    elements: int | None = None,
    exponents: bool = False,
    harmonics: Sequence[int] = (),
    cogging: Sequence[int] = (),
    free: Sequence[str] | None = None,
    band_hz: float | None = None,
    columns: Sequence[str] | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> GearFit:
    """Identify hysteresis, transmission errors and cogging from a record of motor angles and
    torques.

    The laws are those of the keys ``hysteresis``, ``transmission_error`` and ``cogging`` of a
    model file. The equations of motion are those of the model, with the motors where they were
    measured; see `flexgen.identification.gears.fit`.

    Parameters
    ----------
    model : name, path or RobotModel
        Masses, inertias and payload as they are.
    record : Trajectory, or the name of its file
        Channels ``q_m`` [rad] and ``tau_m`` [N m], motor side, of a minute of motion; a CSV or MAT
        file of a logger, or a ``.toml`` file that describes one, see
        `flexgen.identification.records.motor_record`; gears with hysteresis reverse in it under
        torques that are several times those of their hysteresis.
    joints : sequence of str, optional
        Those whose gears are identified; default: all with an elastic gear.
    hysteresis : bool
        Fit their hysteresis.
    elements : int, optional
        Elements of each gear; default: those of the model, and one where it has none.
    exponents : bool
        Fit how sharply elements begin to slip, too; else exponents are those of the model, as
        ``gamma`` always is.
    harmonics : sequence of int
        Of the transmission errors of these gears, periods in a turn of the motor; default: none.
    cogging : sequence of int
        Harmonics of the cogging of all motors; default: none.
    free : sequence of str, optional
        Other numbers of the model that are fitted too, see
        `flexgen.dynamics.mechanics.parameters`; default: stiffness and damping of these gears;
        frictions and constant torques of the motors, and a delay of the torques, always are.
    band_hz : float, optional [Hz]
        Frequencies that are compared; default: as far as the motion is above the noise of the
        angles. Where the model agrees only below 0.6 or 0.36 of that, or but for the standard
        deviations, the status is "noise too large".
    columns : sequence of str, optional
        Names of the columns of a CSV file without a header, such as ``t,q1,q2,m1,m2`` (SI units,
        or with a unit).
    time_limit : float, optional [s]
        Time limit: then, or after Ctrl-C, the result is the best step so far, with the status
        "time limit" or "interrupted"; 0: no limit.
    progress : callable or bool, optional

    Returns
    -------
    GearFit

    Raises
    ------
    ArgumentError
        The record does not fit the model, is too short, or the initial transient of the gears does
        not decay in it.
    SolverError
        The simulated motion is not finite.

    Examples
    --------
    >>> error = {"harmonics": [1], "cos": [5e-5]}  # rad at the joint
    >>> robot = flexgen.read(
    ...     "elbow", overrides={"element.upper.dof.q1.gear.transmission_error": error}
    ... )
    >>> record = flexgen.control(robot, sample_time=1e-3).trajectory()
    >>> found = flexgen.identify_gears("elbow", record, hysteresis=False, harmonics=[1])
    >>> f"{found.values['q1.transmission_error.cos_1']:.2e} rad"
    '5.00e-05 rad'
    """
    tell: Callable[[str], None] = progress if callable(progress) else lambda line: None
    robot = robot_of(model)
    read = read_motor_record(robot, record, columns)
    data = read.trajectory
    chosen = _choose(robot, joints)
    gears = chosen if hysteresis else ()
    _refuse_ignored(robot, gears)
    names = [robot.coordinates[robot.i_g[k]].name for k in chosen]
    plain = without_hysteresis(robot)
    free = _default_free(plain, names) if free is None else list(free)
    fitted = (
        [parameter for parameter in select(plain, free) if parameter.value > 0.0] if free else []
    )
    orders = _orders("harmonics", harmonics)
    of_motors = _orders("cogging", cogging)
    if orders:
        _refuse_coupled(robot, names)
    first = first_elements(robot, gears, elements, exponents, data)
    sought = Sought(first, exponents, chosen if orders else (), orders, of_motors)
    equations = derive(plain, [parameter.name for parameter in fitted])

    def fit(signals: Signals) -> GearFit:
        model = GearModel(equations, sought, signals)
        return result_of(robot, fitted, model, _estimate(model, tell))

    with limit_fit("identify_gears", time_limit, tell):
        result = fit(signals_of(data, robot.n_m, band_hz))
        final = band_hz is not None or result.lacking or result.status in ENDS or is_over()
        if not final:
            result = in_narrower_bands(
                result, lambda hz: fit(signals_of(data, robot.n_m, hz)), tell
            )
    return replace(result, notes=read.notes) if read.notes else result


def _estimate(model: GearModel, tell: Callable[[str], None]) -> Estimate:
    """The estimate, again without what friction does at standstill where motors have some."""
    found = estimate(model, tell)
    if is_over() or not model.take_out_standstill(found):
        return found
    tell("leaving out what friction does at standstill")
    return estimate(model, tell)


def _default_free(robot: RobotModel, joints: Sequence[str]) -> list[str]:
    """Stiffness and damping of the gears of joints, where their springs have one stiffness."""
    known = set(names_of_numbers(robot))
    wanted = [f"{joint}.{kind}" for joint in joints for kind in ("stiffness", "damping")]
    return [name for name in wanted if name in known]


def _refuse_coupled(robot: RobotModel, joints: Sequence[str]) -> None:
    """ArgumentError where a joint has no motor of its own: errors follow the angle of one."""
    own = {motor.drives[0] for motor in robot.motors if len(motor.drives) == 1}
    coupled = [name for name in joints if name not in own]
    if coupled:
        raise ArgumentError(
            f"harmonics: given for {', '.join(coupled)}, whose motors drive other joints too, "
            "expected joints with a motor of their own; choose them with joints, or leave "
            "harmonics out"
        )


def _refuse_ignored(robot: RobotModel, gears: Sequence[int]) -> None:
    """ArgumentError where the robot has gears with hysteresis that are not fitted."""
    known = {robot.coordinates[robot.i_g[k]].name for k in gears}
    ignored = [name for name in hysteretic_joints(robot) if name not in known]
    if ignored:
        raise ArgumentError(
            f"joints, hysteresis: given a fit without that of {', '.join(ignored)}, which "
            f"{robot.title} has, expected these joints too, or a model without their hysteresis"
        )


def in_narrower_bands(
    result: GearFit, fit: Callable[[float], GearFit], tell: Callable[[str], None]
) -> GearFit:
    """The result, as one that noise spoils where the model agrees in a narrower band."""
    for part in NARROWER:
        band = part * result.band_hz
        tell(f"{result.status}: comparing motions below {band:.3g} Hz only")
        try:
            agrees = fit(band).status is FitStatus.FITTED
        except ArgumentError:  # the record is too short for it
            break
        if is_over():
            break
        if agrees:
            return replace(result, status=FitStatus.NOISE_TOO_LARGE)
    return result


def first_elements(
    robot: RobotModel, gears: Sequence[int], count: int | None, exponents: bool, record: Trajectory
) -> tuple[Element, ...]:
    """Elements of the gears where the search begins: those of the model where it has so many.

    Lost motions are in units of 1 arcmin, of a translation of its deflection under the torques of
    the record.
    """
    if count is not None and (count is True or not 1 <= count <= ELEMENTS):
        raise ArgumentError(
            f"elements: given {show_value(count)}, expected a whole number from 1 to {ELEMENTS}"
        )
    K = gear_stiffness(without_hysteresis(robot), np.inf)
    out = []
    for k in gears:
        found = []
        unit = ARCMIN
        if robot.coordinates[robot.i_g[k]].unit == "m":
            unit = float((record["tau_m"] @ robot.eta[:, k]).std() / K[k]) or ARCMIN
        for x in (x for x in gear_layers(robot) if x.present[k]):
            if not isinstance(law := x.laws[k], Hysteresis):
                raise ArgumentError(
                    f"hysteresis: given the law {type(law).__name__}, expected that of Bouc and "
                    "Wen"
                )
            found.append(
                Element(k, x.stiffness[k], 2 * x.slip[k] / K[k], law.exponent, law.gamma, unit)
            )
        if count not in (None, len(found)) or not found:
            n = count or 1
            found = [
                Element(k, K[k] / n, unit * 2.0 ** (j - (n - 1) / 2), unit=unit) for j in range(n)
            ]
        out += [
            replace(each, exponent=max(each.exponent, SHARP)) if exponents else each
            for each in found
        ]
    return tuple(out)


def _orders(name: str, given: Sequence[int]) -> tuple[int, ...]:
    """Harmonics in rising order; ArgumentError where they are none."""
    found: list[Any] = list(given) if isinstance(given, (list, tuple)) else [given]
    whole = all(type(k) is int and 1 <= k <= HIGHEST for k in found)
    if not whole or len(set(found)) < len(found) or len(found) > MOST:
        raise ArgumentError(
            f"{name}: given {show_value(given)}, expected at most {MOST} different whole "
            f"numbers from 1 to {HIGHEST}"
        )
    return tuple(sorted(found))


def _choose(robot: RobotModel, joints: Sequence[str] | None) -> tuple[int, ...]:
    """Numbers of the elastic gears of these joints; None: of all."""
    elastic = {
        robot.coordinates[i].name: k
        for k, (i, (gear, _)) in enumerate(zip(robot.i_g, gears_of(robot), strict=True))
        if gear.spring is not None
    }
    if not elastic:
        raise ArgumentError(
            f"{robot.title}: given a model without elastic gears, expected one with some"
        )
    wrong = [name for name in joints or () if name not in elastic]
    if wrong:
        raise ArgumentError(
            f"joints: given {show_value(wrong)}, expected some of {', '.join(elastic)}"
        )
    return tuple(k for name, k in elastic.items() if joints is None or name in joints)


def result_of(
    robot: RobotModel, fitted: Sequence[Parameter], fit: GearModel, found: Estimate
) -> GearFit:
    """The numbers of the model that a fit found, with its status."""
    noise = fit.noise(found.theta, found.error)
    error = found.error.std(axis=0)
    size = fit.measured.std(axis=0)
    finite = bool(np.isfinite(found.covariance).all())
    reason = reason_of_end()
    known = found.covariance if finite else np.zeros_like(found.covariance)
    excess = np.ones((2, robot.n_m)) if reason else fit.excess(found.theta, found.error, known)
    status = FitStatus.FITTED
    if not found.converged or not finite:
        status = FitStatus.NOT_CONVERGED
    if (error > np.hypot(NOISE * noise, LEAST * size)).any() or (excess[1] > EXCESS).any():
        status = FitStatus.MODEL_ERROR
    elif status is FitStatus.FITTED and (excess[0] > EXCESS).any():
        # what is left may be the errors of numbers that the noise lets determine poorly
        status = FitStatus.NOISE_TOO_LARGE
    status = FitStatus.of_value(reason) if reason else status
    lacking = gears_that_lack_elements(fit, found) if status is FitStatus.FITTED else ()
    numbers = GearNumbers(robot, fitted, fit, found)
    return GearFit(
        robot=robot,
        numbers=numbers.all(),
        status=FitStatus.MODEL_ERROR if lacking else status,
        unexplained=error,
        noise=noise,
        band_hz=fit.signals.band_hz,
        delay_s=(fit.units * found.theta)[fit.layout.delay].item(),
        joints=tuple(robot.coordinates[robot.i_g[k]].name for k in fit.sought.gears),
        lacking=tuple(robot.coordinates[robot.i_g[k]].name for k in lacking),
        laws=numbers.laws(),
        loops=fit.loops(found.theta, found.error),
        harmonics=fit.sought.harmonics,
        cogging=fit.sought.cogging,
    )


@dataclass(frozen=True)
class GearNumbers:
    """The entries of theta as numbers of the model."""

    robot: RobotModel
    fitted: Sequence[Parameter]
    fit: GearModel
    found: Estimate

    def all(self) -> tuple[Number, ...]:
        """Parameters, hysteresis, transmission errors, cogging."""
        return (*self._parameters(), *self._hysteresis(), *self._errors(), *self._cogging())

    def _at(self, k: int) -> tuple[float, float]:
        """The number of entry k, and its standard deviation."""
        unit = float(self.fit.units[k])
        sd = np.sqrt(max(self.found.covariance[k, k], 0.0))
        return unit * float(self.found.theta[k]), unit * float(sd)

    def _parameters(self) -> list[Number]:
        found = [(parameter, *self._at(k)) for k, parameter in enumerate(self.fitted)]
        return [
            Number(p.name, x, sd, p.unit, (p.key, "", -1), sd < WEAK * x) for p, x, sd in found
        ]

    def _hysteresis(self) -> list[Number]:
        out = []
        fit = self.fit
        for k, at in self._elements():
            joint, key = self._joint(k)
            unit = joint.unit
            ratio = gears_of(self.robot)[k][1]
            rows = [("lost_motion", unit, 1.0, fit.layout.lost.start)]
            rows.append(
                (
                    "stiffness",
                    "N/m" if unit == "m" and ratio == 1.0 else "N m/rad",
                    ratio**2,
                    fit.layout.stiffness.start,
                )
            )
            shape = [("exponent", "", 1.0, fit.layout.exponents.start)] * fit.sought.exponents
            sums = [
                self._sum_of([first + each for each in at], scale) for _, _, scale, first in rows
            ]
            wide = self.found.theta[fit.layout.lost][at] > NO_LOST
            known = bool(wide.all()) and all(sd < WEAK * x for x, sd in sums)
            for (name, own, _, _), found in zip(rows, sums, strict=True):
                if len(at) > 1:
                    out.append(
                        Number(f"{joint.name}.hysteresis.{name}", *found, own, ("", "", -1), known)
                    )
            for n, each in enumerate(at):
                for name, own, scale, first in (*rows, *shape):
                    label = name if len(at) == 1 else f"{name}_{n + 1}"
                    change = (f"{key}.hysteresis", name, n)
                    found = self._sum_of([first + each], scale)
                    out.append(
                        Number(f"{joint.name}.hysteresis.{label}", *found, own, change, known)
                    )
        return out

    def _elements(self) -> list[tuple[int, list[int]]]:
        """Gears and the numbers of their elements."""
        return [
            (k, [n for n, gear in enumerate(self.fit.at) if gear == k])
            for k in self.fit.sought.gears
        ]

    def laws(self) -> dict[str, tuple[dict[str, float], ...]]:
        """Exponent and gamma of the elements of gears that are not Dahl's, and not fitted, in
        `GearFit.changes`.
        """
        out = {}
        for k, at in self._elements():
            elements = [self.fit.sought.elements[n] for n in at]
            shapes = [{"exponent": each.exponent, "gamma": each.gamma} for each in elements]
            out[f"{self._joint(k)[1]}.hysteresis"] = tuple(
                {} if is_dahl(Hysteresis(1.0, 1.0, **shape)) else shape for shape in shapes
            )
        return out

    def _sum_of(self, entries: Sequence[int], scale: float) -> tuple[float, float]:
        """The sum of numbers of one kind over a scale, and its standard deviation."""
        at = list(entries)
        units = self.fit.units[entries] / scale
        variance = units @ self.found.covariance[np.ix_(at, at)] @ units
        return float(units @ self.found.theta[at]), float(np.sqrt(max(variance, 0.0)))

    def _errors(self) -> list[Number]:
        out = []
        k = self.fit.layout.errors.start
        orders = self.fit.sought.harmonics
        for gear in self.fit.sought.errors:
            joint, key = self._joint(gear)
            pairs = [(k + at, k + len(orders) + at) for at in range(len(orders))]
            out += self._sum(
                f"{joint.name}.transmission_error",
                joint.unit,
                f"{key}.transmission_error",
                orders,
                pairs,
            )
            k += 2 * len(orders)
        return out

    def _cogging(self) -> list[Number]:
        out = []
        n = self.fit.n_m
        orders = self.fit.sought.cogging
        first = self.fit.layout.cogging.start
        for j, motor in enumerate(self.robot.motors):
            pairs = [
                (first + 2 * at * n + j, first + (2 * at + 1) * n + j) for at in range(len(orders))
            ]
            out += self._sum(
                f"{motor.name}.cogging", "N m", f"motor.{motor.name}.cogging", orders, pairs
            )
        return out

    def _sum(
        self,
        name: str,
        unit: str,
        key: str,
        orders: Sequence[int],
        pairs: Sequence[tuple[int, int]],
    ) -> list[Number]:
        """Coefficients of a Fourier sum, whose entries of theta are ``pairs``; determined by their
        amplitude.
        """
        out = []
        for at, (order, pair) in enumerate(zip(orders, pairs, strict=True)):
            (c, c_sd), (s, s_sd) = (self._at(k) for k in pair)
            known = max(c_sd, s_sd) < WEAK * np.hypot(c, s)
            out.append(Number(f"{name}.cos_{order}", c, c_sd, unit, (key, "cos", at), known))
            out.append(Number(f"{name}.sin_{order}", s, s_sd, unit, (key, "sin", at), known))
        return out

    def _joint(self, gear: int) -> tuple[Coordinate, str]:
        """The coordinate of a gear, and the key of the gear in the model file."""
        joint = self.robot.coordinates[self.robot.i_g[gear]]
        places = {
            dof.name: element.name for element in self.robot.elements for dof in element.dofs
        }
        return joint, f"element.{places[joint.name]}.dof.{joint.name}.gear"
