"""`identify_spring`: stiffness curve and hysteresis of one gear from a locked or slow test.

    min  sum (spring(d) + sum_i z_i(d) + offset - tau)^2

over the numbers of the spring and of its elements of hysteresis, logarithms of them. Of each
record the offsets of torque and deflection are fitted along, and the part of their slip torques
at which the elements begin; so are those of records that are held out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.optimize import nnls

from flexgen.base.calls.deadline import limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.checks.bounds import CountOrZero, TimeLimit
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.memory import SHARPEST, Hysteresis
from flexgen.dynamics.hysteresis.hysteresis import elements_of
from flexgen.dynamics.hysteresis.hysteresis_law import is_dahl, shape_of
from flexgen.dynamics.mechanics.equations import robot_of
from flexgen.dynamics.mechanics.force_laws import stiffness_at_zero
from flexgen.dynamics.mechanics.lagrangian import gears as gears_of
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.estimator.layout import Layout
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Prior, Problem
from flexgen.identification.estimator.status import FitStatus, status_of_end
from flexgen.identification.gears.result import WEAK, Number
from flexgen.identification.gears.spring_loops import (
    SPRINGS,
    Branches,
    Element,
    branches_of,
    kind_of_spring,
    loop_torque,
    numbers_of_spring,
    spring_function,
    turning_points,
)
from flexgen.identification.gears.spring_result import STIFFNESSES, RecordOfSpring, SpringFit
from flexgen.identification.records.deflection_record import NAMES, read_deflection_record
from flexgen.model.elements import RobotModel
from flexgen.model.format.format_robot import ELEMENTS

# Residuals over those that noise explains, and over the range of the torques, from which on the
# law is wrong; below the second number the error is small.
NOISE = 1.5
SMALL = 0.01
# Errors of records that were held out over those of the fitted ones, and over the range of their
# torques: poorly validated are those above both.
WORSE = 2.0
POOR = 0.05
# Standard deviation of torques over their range, at least.
EXACT = 1e-4
# Part of the range of the deflections that the branches of a whole loop have at least.
LARGE = 0.3
# Time constants of creep that are tried [s], and the part of the squared error that an effect of
# time explains where it is named.
CREEP_S = tuple(np.geomspace(0.1, 30.0, 11).tolist())
NAMED = 0.3
# Step of the derivatives, in logarithms and parts, and blocks of a branch for deviations.
STEP = 1e-6
BLOCKS = 4
# Standard deviation of the prior of logarithms: numbers that no sample shows stay near the start.
WIDE = 5.0
# Least stiffness over the range of the torques per range of the deflections.
SOFTEST = 1e-3
# Least reach of an element over the range of the deflections.
NARROWEST = 1e-4
# Reaches of elements where the search begins, as parts of the range of the deflections.
REACHES = np.geomspace(0.003, 0.9, 14)
# Numbers of springs where the search begins: over the mean stiffness and half the range of the
# deflections, in the order of the numbers of each kind.
STARTS = {
    "linear": ((1.0,),),
    "cubic": ((0.8, 0.3), (1.0, 0.03)),
    "smooth": ((0.8, 1.2, 0.5), (0.4, 1.5, 0.5)),
    "piecewise": ((0.8, 1.2, 0.5), (0.4, 1.5, 0.5)),
    "backlash": ((1.2, 0.1, 0.03), (1.5, 0.3, 0.1)),
}
# Powers of the half range in the units of these numbers, and whether the mean stiffness is one.
POWERS = {
    "stiffness": 0,
    "low": 0,
    "high": 0,
    "cubic": -2,
    "break_at": 1,
    "gap": 1,
    "smoothing": 1,
}


@checked_types(own=("time_limit",))
@reported("identify_spring")
def identify_spring(
    model: str | Path | RobotModel,
    record: Mapping[str, np.ndarray] | str | Path,
    *,
    more: Sequence[Mapping[str, np.ndarray] | str | Path] = (),
    validate: Sequence[Mapping[str, np.ndarray] | str | Path] = (),
    joint: str | None = None,
    spring: Literal["linear", "cubic", "smooth", "piecewise", "backlash"] | None = None,
    elements: CountOrZero | None = None,
    exponents: bool = False,
    side: Literal["arm", "motor"] = "arm",
    names: Sequence[str] = NAMES,
    columns: Sequence[str] | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> SpringFit:
    """Identify the spring and the hysteresis of a gear from a locked or slow test.

    The joint is locked, and the motor turns it slowly through cycles of torque: the torque over
    the deflection is that of the spring and the hysteresis alone. The laws are those of the keys
    ``spring`` and ``hysteresis`` of a gear.

    Parameters
    ----------
    model : name, path or RobotModel
        Robot with the gear; of its gear the kind of the spring and the number of elements of
        hysteresis are taken, not their numbers.
    record : name of a .csv, .mat, .npz or .hebilog file, or mapping
        Deflection and torque of a test that reverses, with columns such as ``time s``,
        ``deflection deg`` and ``torque N m``. A mapping has arrays ``time``, ``deflection`` and
        ``torque`` in SI units.
    more : sequence of records
        Further records that are fitted, such as tests of other sizes.
    validate : sequence of records
        Records that are held out: the result states their errors.
    joint : str, optional
        Joint of the gear; default: that of the only elastic gear.
    spring : str, optional
        Kind of the spring; default: that of the model.
    elements : int, optional
        Elements of hysteresis; 0: none; default: those of the model, and one where it has none.
    exponents : bool
        Fit how sharply elements begin to slip, too; else exponents are those of the model.
    side : str
        Side of the gear of both columns: ``arm``, or ``motor`` with the angle of the motor while
        the joint is locked, and its torque.
    names : sequence of str
        Names of the columns of deflection and torque; a ``-`` before a name turns the sign.
    columns : sequence of str, optional
        Names of the columns of CSV files without a header.
    time_limit : float, optional [s]
        Time limit: then, or after Ctrl-C, the result is the best step so far, with the status
        "time limit" or "interrupted"; 0: no limit.
    progress : callable or bool, optional

    Returns
    -------
    SpringFit

    Raises
    ------
    ArgumentError
        The joint has no elastic gear, a record cannot be read or does not reverse, or its torque
        falls with the deflection.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 20.0, 2001)
    >>> d = 1e-3 * np.sin(0.2 * np.pi * t)
    >>> record = {"time": t, "deflection": d, "torque": 4e4 * d}
    >>> found = flexgen.identify_spring("elbow", record, joint="q1", elements=0)
    >>> f"{found.values['q1.spring.stiffness']:.3g} N m/rad"
    '4e+04 N m/rad'
    """
    tell: Callable[[str], None] = progress if callable(progress) else lambda line: None
    robot = robot_of(model)
    gear = _gear_of(robot, joint)
    if len(names) != len(NAMES):
        raise ArgumentError(
            f"names: given {len(names)} names, expected those of deflection and torque"
        )
    pair = (names[0], names[1])

    def read_branches(one: Mapping[str, np.ndarray] | str | Path) -> Branches:
        found = read_deflection_record(one, gear.unit, pair, columns)
        scale = gear.ratio if side == "motor" else 1.0
        found = replace(found, deflection=found.deflection / scale, torque=found.torque * scale)
        return branches_of(gear.in_file(found))

    fitted = [read_branches(one) for one in (record, *more)]
    held = [read_branches(one) for one in validate]
    kind = spring or kind_of_spring(gear.spring)
    laws = gear.laws(elements)
    problem = SpringProblem(kind, laws, exponents and bool(laws), fitted)
    with limit_fit("identify_spring", time_limit, tell):
        found = problem.solve(tell)
        reason = reason_of_end()
    return result_of(robot, gear, problem, found, held, reason)


@dataclass(frozen=True)
class GearOfTest:
    """A gear: its joint, the unit of its deflection, its ratio, its spring, and its key."""

    joint: str
    unit: str
    ratio: float
    side: str
    spring: Any
    hysteresis: Any
    key: str

    @property
    def scale(self) -> float:
        """Deflection on the side of the spring over that at the joint."""
        return self.ratio if self.side == "motor" else 1.0

    def in_file(self, record: Any) -> Any:
        """A record of the joint on the side to which the spring refers."""
        return replace(
            record, deflection=record.deflection * self.scale, torque=record.torque / self.scale
        )

    def laws(self, count: int | None) -> tuple[Hysteresis, ...]:
        """Laws of the elements, without sizes: those of the model where it has so many."""
        if count is not None and count > ELEMENTS:
            raise ArgumentError(
                f"elements: given {count}, expected a whole number from 0 to {ELEMENTS}"
            )
        own = elements_of(self.hysteresis)
        for law in own:
            if not isinstance(law, Hysteresis):
                raise ArgumentError(
                    f"hysteresis: given the law {type(law).__name__}, expected that of Bouc and "
                    "Wen"
                )
        if own and count in (None, len(own)):
            return tuple(shape_of(law) for law in own)  # type: ignore[misc]
        return (Hysteresis(1.0, 1.0),) * (1 if count is None else count)


def _gear_of(robot: RobotModel, joint: str | None) -> GearOfTest:
    """The elastic gear of a joint, or the only one."""
    places = {dof.name: element.name for element in robot.elements for dof in element.dofs}
    found = {}
    for i, (gear, _) in zip(robot.i_g, gears_of(robot), strict=True):
        if gear.spring is None:
            continue
        at = robot.coordinates[i]
        own = [m for m in robot.motors if m.drives == (at.name,)]
        found[at.name] = GearOfTest(
            at.name,
            at.unit,
            abs(own[0].ratio[0]) if own else 1.0,
            gear.side,
            gear.spring,
            gear.hysteresis,
            f"element.{places[at.name]}.dof.{at.name}.gear",
        )
    if not found:
        raise ArgumentError(
            f"{robot.title}: given a model without elastic gears, expected one with some"
        )
    if joint is None and len(found) > 1:
        raise ArgumentError(
            f"joint: given none, expected the joint of the gear that was tested: one of "
            f"{', '.join(found)}"
        )
    name = next(iter(found)) if joint is None else joint
    if name not in found:
        raise ArgumentError(f"joint: given {name!r}, expected one of {', '.join(found)}")
    return found[name]


@dataclass(frozen=True)
class Unknowns(Layout):
    """Unknowns: logarithms of the numbers of the spring, of stiffness and reach of each element
    and of their exponents; of each record its offsets over the sizes of its signals, and the part
    at which the elements begin.
    """

    spring: slice
    stiffness: slice
    reach: slice
    exponent: slice
    torque: slice
    deflection: slice
    start: slice


class SpringProblem:
    """Least squares of the torques of some records.

    ``kind`` of the spring; ``laws`` of the elements; ``exponents``: they are fitted.
    """

    def __init__(
        self, kind: str, laws: Sequence[Hysteresis], exponents: bool, records: Sequence[Branches]
    ) -> None:
        self.kind = kind
        self.laws = tuple(laws)
        self.exponents = exponents
        self.records = tuple(records)
        self.torque_of = spring_function(kind)
        self.names = numbers_of_spring(kind)
        count = len(self.laws)
        curved = kind != "linear"  # an offset of the deflection is not one of the torque
        self.layout = Unknowns.of(
            spring=len(self.names),
            stiffness=count,
            reach=count,
            exponent=count * exponents,
            torque=len(records),
            deflection=len(records) * curved,
            start=len(records) * bool(count),
        )
        for one in records if count else ():
            if len(one.turns) < 3:
                raise ArgumentError(
                    f"{one.name}: the deflection does not reverse, expected a test that goes up "
                    "and down; or fit elements=0"
                )
        self.size = np.array([np.ptp(one.torque) for one in records])
        self.width = np.array([np.ptp(one.deflection) for one in records])
        self.middle = np.array([(o.deflection.max() + o.deflection.min()) / 2 for o in records])
        # of the residuals: below a part of the range, laws are never exact
        self.sigma = np.maximum([one.noise[1] for one in records], EXACT * self.size)

    def spring(self, x: np.ndarray) -> np.ndarray:
        """Numbers of the spring, in the order of its class."""
        return np.exp(x[self.layout.spring])

    def elements(self, x: np.ndarray) -> list[Element]:
        """The elements of hysteresis."""
        lay = self.layout
        stiffness = np.exp(x[lay.stiffness])
        reach = np.exp(x[lay.reach])
        exponent = np.exp(x[lay.exponent])
        laws = self.laws
        if len(exponent):
            laws = tuple(
                replace(law, exponent=float(n)) for law, n in zip(laws, exponent, strict=True)
            )
        return [
            Element(float(k), float(r), law)
            for k, r, law in zip(stiffness, reach, laws, strict=True)
        ]

    def torques(self, x: np.ndarray) -> list[np.ndarray]:
        """Torques (n,) of each record."""
        lay = self.layout
        out = []
        elements = self.elements(x)
        for k, one in enumerate(self.records):
            shift = float(self.middle[k])
            if self.kind != "linear":
                shift += x[lay.deflection][k] * self.width[k]
            total = self.torque_of(one.deflection - shift, self.spring(x))
            if elements:
                total = total + loop_torque(elements, one, float(x[lay.start][k]))
            out.append(total + x[lay.torque][k] * self.size[k])
        return out

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Computed minus measured torques over their standard deviations (N,)."""
        rows = zip(self.torques(x), self.records, self.sigma, strict=True)
        return np.concatenate([(found - one.torque) / sigma for found, one, sigma in rows])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives (N, n) of the residuals, by central differences."""
        columns = []
        for k in range(len(x)):
            step = np.zeros(len(x))
            step[k] = STEP
            columns.append((self.residual(x + step) - self.residual(x - step)) / (2 * STEP))
        return np.stack(columns, axis=1)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (n,) of the unknowns."""
        lay = self.layout
        low = np.full(lay.size, -np.inf)
        high = np.full(lay.size, np.inf)
        low[lay.exponent] = 0.0
        high[lay.exponent] = np.log(SHARPEST)
        low[lay.start] = -1.0
        high[lay.start] = 1.0
        low[lay.torque] = -2.0
        high[lay.torque] = 2.0
        low[lay.deflection] = -2.0
        high[lay.deflection] = 2.0
        widest = float(self.width.max())
        # an element that does not slip within the test is a part of the spring
        low[lay.reach] = np.log(NARROWEST * widest)
        high[lay.reach] = np.log(widest)
        for k, name in enumerate(self.names):
            if name in ("break_at", "gap", "smoothing"):
                low[k] = np.log(1e-6 * widest)
                high[k] = np.log(10.0 * widest)
            elif name in STIFFNESSES:
                low[k] = np.log(SOFTEST * float((self.size / self.width).max()))
        return low, high

    def starts(self) -> list[np.ndarray]:
        """Where the search begins: for each guess of the spring, the elements that fit best.

        With a straight spring and Dahl's law the torque is linear in the stiffnesses, for given
        reaches: elements are added one by one, each with the reach of the least error.
        """
        columns: list[np.ndarray] = []
        reaches: list[float] = []
        best = self._linear(columns)
        for _ in self.laws:
            trials = []
            for reach in REACHES * self.width.max():
                element = [Element(1.0, float(reach), Hysteresis(1.0, 1.0))]
                column = [loop_torque(element, one, 0.0) for one in self.records]
                trials.append((self._linear([*columns, np.concatenate(column)])[1], reach, column))
            _, reach, column = min(trials, key=lambda trial: float(trial[0]))
            columns.append(np.concatenate(column))
            reaches.append(float(reach))
            best = self._linear(columns)
        numbers = best[0]
        mean = max(float(numbers[0]), 1e-3 * float((self.size / self.width).mean()))
        half = float(self.width.max()) / 2
        smallest = 1e-2 * mean
        out = []
        for guess in STARTS[self.kind]:
            spring = [
                factor * half ** POWERS[name] * (mean if POWERS[name] <= 0 else 1.0)
                for factor, name in zip(guess, self.names, strict=True)
            ]
            out.append(
                self.layout.join(
                    spring=np.log(spring),
                    stiffness=np.log(np.maximum(numbers[1 : 1 + len(self.laws)], smallest)),
                    reach=np.log(reaches) if reaches else np.zeros(0),
                    exponent=np.full(len(self.layout.entries(self.layout.exponent)), np.log(2.0)),
                )
            )
        return out

    def _linear(self, columns: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
        """Stiffnesses >= 0 of the straight spring and of the elements, and their error."""
        pairs = zip(self.records, self.middle, strict=True)
        d = np.concatenate([one.deflection - middle for one, middle in pairs])
        torque = np.concatenate([one.torque for one in self.records])
        at = np.repeat(np.arange(len(self.records)), [len(one.torque) for one in self.records])
        level = (at[:, None] == np.arange(len(self.records))) * self.size
        A = np.column_stack([d, *columns, level, -level]) / self.sigma[at, None]
        scale = np.linalg.norm(A, axis=0)
        found, error = nnls(A / scale, torque / self.sigma[at])
        return found / scale, float(error)

    def solve(self, tell: Callable[[str], None]) -> Minimum:
        """The best of the searches from all starts."""
        slope = [np.polyfit(one.deflection, one.torque, 1)[0] for one in self.records]
        if min(slope) <= 0.0:
            name = self.records[int(np.argmin(slope))].name
            raise ArgumentError(
                f"{name}: the torque falls with the deflection, expected one that rises: turn "
                "the sign of one of the columns, as names=('-deflection', 'torque') does"
            )
        found = []
        for start in self.starts():
            tell(f"fitting a {self.kind} spring with {len(self.laws)} elements of hysteresis")
            prior = Prior.of_sd(start, np.full(len(start), WIDE))
            problem = Problem(self.residual, self.jacobian, prior, self.bounds())
            found.append(minimize(problem, start, Search(stage="identify_spring", gain=1e-7)))
        return min(found, key=lambda one: one.cost)

    def predict(self, x: np.ndarray, held: Branches) -> np.ndarray:
        """Torques (n,) of a record that was held out, with its own offsets and its own begin."""
        laws = [element.law for element in self.elements(x)]
        alone = SpringProblem(self.kind, laws, False, [held])
        lay = alone.layout
        parts = self.layout.parts
        full = lay.join(**{name: x[parts[name]] for name in ("spring", "stiffness", "reach")})
        own = np.r_[lay.entries(lay.torque), lay.entries(lay.deflection), lay.entries(lay.start)]

        def inside(y: np.ndarray) -> np.ndarray:
            out = full.copy()
            out[own] = y
            return out

        low, high = alone.bounds()
        problem = Problem(
            lambda y: alone.residual(inside(y)),
            lambda y: alone.jacobian(inside(y))[:, own],
            Prior.of_sd(np.zeros(len(own)), np.full(len(own), WIDE)),
            (low[own], high[own]),
        )
        found = minimize(problem, np.zeros(len(own)), Search(stage="identify_spring", gain=1e-7))
        return alone.torques(inside(found.x))[0]


def deviations(problem: SpringProblem, x: np.ndarray) -> np.ndarray:
    """Covariance (n, n) of the unknowns, from what leaving out parts of branches changes."""
    starts = []
    first = 0
    for one in problem.records:
        for begin, end in pairwise(one.turns):
            cuts = np.linspace(begin, end, BLOCKS + 1)[:-1].astype(int)
            starts += [first + int(cut) for cut in cuts]
        first += len(one.torque)
    prior = np.eye(len(x)) / WIDE**2
    unique = sorted(set(starts))
    return block_covariance(problem.jacobian(x), problem.residual(x), unique, prior)


def result_of(
    robot: RobotModel,
    gear: GearOfTest,
    problem: SpringProblem,
    found: Minimum,
    held: Sequence[Branches],
    reason: str,
) -> SpringFit:
    """The result: numbers of the model, errors of all records, status."""
    torques = problem.torques(found.x)
    pairs = zip(problem.records, torques, strict=True)
    records = [error_of(one, torque, gear.scale, is_fitted=True) for one, torque in pairs]
    for one in held:
        predicted = problem.predict(found.x, one)
        records.append(error_of(one, predicted, gear.scale, is_fitted=False))
    lay = problem.layout
    stiff = [k for k, name in enumerate(problem.names) if name in STIFFNESSES]
    shape = np.r_[stiff, lay.entries(lay.reach), lay.entries(lay.exponent)]
    stuck = bool(found.at_bound[shape].any())
    status = status_of_end(status_of(records, found.converged, stuck), reason)
    return SpringFit(
        robot=robot,
        joint=gear.joint,
        key=gear.key,
        spring=problem.kind,
        numbers=numbers_of(gear, problem, found.x),
        status=status,
        records=tuple(records),
        laws=tuple(
            {} if is_dahl(law) else {"exponent": law.exponent, "gamma": law.gamma}
            for law in problem.laws
        ),
        causes=() if status is FitStatus.FITTED else causes_in_time(problem, found.x),
    )


def status_of(records: Sequence[RecordOfSpring], converged: bool, stuck: bool) -> FitStatus:
    """The status of a fit with these errors; ``stuck``: a stiffness of the spring or
    the shape of an element is at a bound."""
    fitted = [one for one in records if one.is_fitted]
    size = rms_of([one.error for one in fitted])
    worst = max((one.error for one in records if not one.is_fitted), default=0.0)
    if not converged:
        return FitStatus.NOT_CONVERGED
    if worst > max(WORSE * size, POOR):
        return FitStatus.POORLY_VALIDATED
    if stuck:
        return FitStatus.AT_BOUND
    if size <= NOISE * rms_of([one.noise for one in fitted]) + EXACT:
        return FitStatus.FITTED
    return FitStatus.SMALL_ERROR if size < SMALL else FitStatus.MODEL_ERROR


def rms_of(values: Sequence[float]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def error_of(
    record: Branches, torque: np.ndarray, scale: float, is_fitted: bool
) -> RecordOfSpring:
    """Errors of computed torques (n,) of a record; ``scale``: deflection on the side of the
    spring over that at the joint.
    """
    size = float(np.ptp(record.torque))
    slope = size / float(np.ptp(record.deflection))
    noise = float(np.hypot(record.noise[1], slope * record.noise[0]))
    points = np.column_stack([record.deflection / scale, record.torque * scale, torque * scale])
    widths = [width_of(record, one) for one in (record.torque, torque)]
    return RecordOfSpring(
        name=record.name,
        is_fitted=is_fitted,
        error=float(np.sqrt(np.mean((torque - record.torque) ** 2))) / size,
        noise=noise / size,
        width=None if widths[0] is None else widths[0] / scale,
        width_of_model=None if widths[1] is None else widths[1] / scale,
        points=points,
    )


def width_of(record: Branches, torque: np.ndarray) -> float | None:
    """Width of the loop at the middle of its torques, in the unit of the deflection: falling minus
    rising branches; None: they do not both cross it.
    """
    level = (torque.max() + torque.min()) / 2
    crossings: dict[bool, list[float]] = {True: [], False: []}
    turns = turning_points(record.deflection, LARGE * float(np.ptp(record.deflection)))
    for first, last in pairwise(turns):
        part = torque[first : last + 1] - level
        at = np.flatnonzero(part[:-1] * part[1:] <= 0.0)
        d = record.deflection[first : last + 1]
        if len(at):
            share = np.abs(part[at]) / np.maximum(np.abs(part[at]) + np.abs(part[at + 1]), 1e-300)
            between = d[at] + share * (d[at + 1] - d[at])
            crossings[bool(d[-1] > d[0])].append(float(np.mean(between)))
    if not all(crossings.values()):
        return None
    return float(np.mean(crossings[False]) - np.mean(crossings[True]))


def numbers_of(gear: GearOfTest, problem: SpringProblem, x: np.ndarray) -> tuple[Number, ...]:
    """The unknowns as numbers of the model file, with standard deviations."""
    covariance = deviations(problem, x)
    values = numbers_in_file(gear, problem, x)
    slopes = np.zeros((len(values), len(x)))
    for k in range(len(x)):
        step = np.zeros(len(x))
        step[k] = STEP
        ahead, behind = (numbers_in_file(gear, problem, x + s) for s in (step, -step))
        slopes[:, k] = (ahead - behind) / (2 * STEP)
    sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
    torque = "N m" if gear.unit == "rad" or gear.side == "motor" else "N"
    angle = "rad" if torque == "N m" else "m"
    units = {name: angle for name in ("break_at", "gap", "smoothing")}
    units["cubic"] = f"{torque}/{angle}^3"
    out = []
    for name in problem.names:
        unit = units.get(name, f"{torque}/{angle}")
        change = (f"{gear.key}.spring", name, 0)
        out.append((f"{gear.joint}.spring.{name}", unit, change))
    count = len(problem.laws)
    kinds = [("lost_motion", gear.unit), ("stiffness", f"{torque}/{angle}"), ("exponent", "")]
    for n in range(count):
        for name, unit in kinds[: 3 if problem.exponents else 2]:
            label = name if count == 1 else f"{name}_{n + 1}"
            change = (f"{gear.key}.hysteresis", name, n)
            out.append((f"{gear.joint}.hysteresis.{label}", unit, change))
    # an element is one number: its loop is known, or it is not
    known = sd < WEAK * np.abs(values)
    size = 3 if problem.exponents else 2
    for n in range(count):
        at = slice(len(problem.names) + size * n, len(problem.names) + size * (n + 1))
        known[at] = known[at].all()
    rows = zip(out, values.tolist(), sd.tolist(), known.tolist(), strict=True)
    return tuple(Number(name, v, s, unit, to, k) for (name, unit, to), v, s, k in rows)


def numbers_in_file(gear: GearOfTest, problem: SpringProblem, x: np.ndarray) -> np.ndarray:
    """Numbers of the spring, then lost motion [rad or m at the joint], stiffness and, where it is
    fitted, exponent of each element.
    """
    spring = problem.spring(x)
    zero = stiffness_at_zero(SPRINGS[problem.kind](*spring.tolist()))
    out = spring.tolist()
    for element in problem.elements(x):
        slip = element.stiffness * element.reach
        out += [2 * slip / (zero * gear.scale), element.stiffness]
        out += [element.law.exponent] if problem.exponents else []
    return np.array(out)


def causes_in_time(problem: SpringProblem, x: np.ndarray) -> tuple[str, ...]:
    """Sentences on effects of time that explain the residuals, the likeliest first.

    A law of hysteresis knows no time. Two effects that do are tried alone, each as one more
    column of the linear fit: torques that were recorded late by T, ``-T tau'``, and a spring that
    creeps, as one with a damper in series, whose torque fades with a time constant.
    """
    J = problem.jacobian(x)
    r = problem.residual(x)
    base = np.linalg.qr(J)[0]
    left = r - base @ (base.T @ r)
    found = []
    late = []
    creep: dict[float, list[np.ndarray]] = {seconds: [] for seconds in CREEP_S}
    for one, sigma in zip(problem.records, problem.sigma, strict=True):
        # stamps may repeat
        time = one.time + 1e-9 * np.arange(len(one.time))
        late.append(np.gradient(one.torque, time) / sigma)
        for seconds, parts in creep.items():
            parts.append(creep_deflection(one, seconds) / sigma)
    part, factor = explain_part(base, left, np.concatenate(late))
    if part > NAMED and factor > 0.0:
        found.append((part, f"the torques were recorded {1e3 * factor:.3g} ms late"))
    trials = [
        (*explain_part(base, left, -np.concatenate(parts)), seconds)
        for seconds, parts in creep.items()
    ]
    part, factor, seconds = max(trials)
    if part > NAMED and factor > 0.0:
        found.append((part, f"the spring creeps: its torque fades within some {seconds:.2g} s"))
    return tuple(
        f"{text} ({100 * part:.0f} % of the squared error)"
        for part, text in sorted(found, reverse=True)
    )


def creep_deflection(record: Branches, seconds: float) -> np.ndarray:
    """Deflection (n,) of a spring with a damper in series, from rest: the changes of the
    deflection fade with a time constant.
    """
    out = np.zeros(len(record.time))
    fade = np.exp(-np.diff(record.time) / seconds)
    for k, change in enumerate(np.diff(record.deflection)):
        out[k + 1] = fade[k] * (out[k] + change)
    return out


def explain_part(base: np.ndarray, left: np.ndarray, column: np.ndarray) -> tuple[float, float]:
    """Part of the squared residuals ``left`` (N,) that a column explains besides ``base``, and its
    factor.
    """
    own = column - base @ (base.T @ column)
    power = float(own @ own)
    if power <= 1e-12 * float(column @ column) or not np.any(left):
        return 0.0, 0.0
    factor = float(own @ left) / power
    return factor**2 * power / float(left @ left), factor
