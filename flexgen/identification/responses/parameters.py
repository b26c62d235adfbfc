"""The parameter vector of an identification: which numbers are free, their scales, bounds, ties
and priors.

    theta = exp(x) (scale "log"), theta = x (scale "linear")

Names are those of `flexgen.dynamics.mechanics.parameters`, and those of the drives: ``delay`` [s],
``<motor>.torque_constant`` (torque of the motor over the recorded one), ``<sensor>.delay`` [s]
(from the motion to the sample, added to that of the motors' angles; ``sensor_delay``: of all
sensors), and the gains of `flexgen.feedback.loop.controllers.Cascade`: ``<motor>.position_gain``,
``.speed_gain``, ``.integral_gain``, for fits in closed loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.parameters import Parameter, select
from flexgen.feedback.loop.controllers import Cascade
from flexgen.identification.estimator.problem import Prior, Problem, Sums
from flexgen.identification.responses.response_inputs import Drive, with_drive
from flexgen.model.elements import RobotModel

# of the logarithm, about the start: so weak that only directions without information feel it
PRIOR_SD = 2.0
DELAY = "delay"
CONSTANT = ".torque_constant"
SENSOR_DELAY = ".delay"  # of one sensor
SENSOR_DELAYS = "sensor_delay"  # and of all
PRODUCTS = (".inertia_xy", ".inertia_yz", ".inertia_xz")  # of inertia, which may be negative
GAINS = {".position_gain": "1/s", ".speed_gain": "N m s/rad", ".integral_gain": "1/s"}


@dataclass(frozen=True)
class Unknown:
    """One number to identify.

    Parameters
    ----------
    parameter : Parameter
        Name, value in the model, unit and meaning.
    start : float
        Where the search begins.
    scale : str
        ``"log"`` for numbers that are positive, else ``"linear"``.
    lower, upper : float
        Bounds, in the unit of the parameter.
    prior_sd : float
        Standard deviation of a Gaussian prior about the start; of the logarithm for the scale
        "log".
    tied : tuple of str
        Names of other parameters that change by the same factor.
    """

    parameter: Parameter
    start: float
    scale: str
    lower: float
    upper: float
    prior_sd: float
    tied: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.parameter.name


class ParameterVector:
    """The free numbers of a model and of its drives.

    Parameters
    ----------
    model : RobotModel
    free : sequence of str
        Names of what is identified, groups such as ``stiffness`` included. Numbers of a group that
        are zero stay zero.
    fixed : sequence of str
        Names that stay as they are although a group in ``free`` has them.
    start : mapping, optional
        Values to begin with; default: those of the model.
    bounds : mapping, optional
        Name -> (lower, upper); a number that begins at its lower bound of zero has the scale
        ``"linear"``.
    priors : mapping, optional
        Name -> standard deviation of the prior.
    ties : mapping, optional
        Name -> name of the free parameter that it follows by a constant factor, that of the start
        values.
    controller : Cascade, optional
        Of the drives, where their gains are parameters.

    Raises
    ------
    ArgumentError
        A name that the model does not have, a start that is not possible, or no free parameter.
    """

    def __init__(
        self,
        model: RobotModel,
        free: Sequence[str],
        *,
        fixed: Sequence[str] = (),
        start: Mapping[str, float] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        priors: Mapping[str, float] | None = None,
        ties: Mapping[str, str] | None = None,
        controller: Cascade | None = None,
    ) -> None:
        self.model = model
        start = dict(start or {})
        bounds = dict(bounds or {})
        priors = dict(priors or {})
        ties = dict(ties or {})
        drive = [name for name in free if is_of_drive(name)]
        of_model = [name for name in free if name not in drive]
        held = {p.name for p in select(model, [name for name in fixed if not is_of_drive(name)])}
        held |= {name for name in fixed if is_of_drive(name)}
        parameters = [
            p for p in select(model, of_model) if p.name not in held and p.name not in ties
        ]
        # Of a group, what is zero stays zero: such as the cubic part of a spring that has none.
        parameters = [
            p for p in parameters if p.value != 0.0 or p.name in of_model or p.name in start
        ]
        parameters += [
            p for p in _drive_parameters(model, drive, controller) if p.name not in held
        ]
        known = {p.name for p in parameters}
        for what, names in (
            ("start", start),
            ("bounds", bounds),
            ("priors", priors),
            ("ties", ties.values()),
        ):
            for name in names:
                if name not in known:
                    raise ArgumentError(
                        f"{what}: given {name!r}, expected one of the free "
                        f"{', '.join(sorted(known))}"
                    )
        self.unknowns = tuple(
            _unknown(
                p,
                start,
                bounds,
                priors,
                tuple(sorted(a for a, b in ties.items() if b == p.name)),
            )
            for p in parameters
        )
        if not self.unknowns:
            raise ArgumentError(
                "free: given no parameter, expected some, such as 'stiffness', 'q1.damping'"
            )
        self.names = tuple(u.name for u in self.unknowns)
        self._tied = {p.name: p.value for p in select(model, sorted(ties))}
        self._log = np.array([u.scale == "log" for u in self.unknowns])

    def __len__(self) -> int:
        return len(self.unknowns)

    @property
    def start(self) -> np.ndarray:
        """x at the start, (n,)."""
        return self.x(np.array([u.start for u in self.unknowns]))

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, (n,) each."""
        lower, upper = (
            np.array([getattr(u, side) for u in self.unknowns]) for side in ("lower", "upper")
        )
        return self.x(lower), self.x(upper)

    @property
    def prior_sd(self) -> np.ndarray:
        """Standard deviations of the priors of x, (n,)."""
        return np.array([u.prior_sd for u in self.unknowns])

    def problem(
        self, sums: Callable[[np.ndarray], Sums], cost: Callable[[np.ndarray], float]
    ) -> Problem:
        """The problem of estimation with these sums of squares, see `Problem.of_sums`."""
        return Problem.of_sums(sums, cost, Prior.of_sd(self.start, self.prior_sd), self.bounds)

    def x(self, values: np.ndarray) -> np.ndarray:
        """The vector x of values of the parameters."""
        with np.errstate(divide="ignore"):
            return np.where(self._log, np.log(np.where(self._log, values, 1.0)), values)

    def values(self, x: np.ndarray) -> np.ndarray:
        """Values of the parameters at x."""
        return np.where(self._log, np.exp(np.where(self._log, x, 0.0)), x)

    def dvalues(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of `values` in x, (n,)."""
        return np.where(self._log, self.values(x), 1.0)

    def named(self, x: np.ndarray) -> dict[str, float]:
        """Name -> value, tied parameters included."""
        out = {
            u.name: float(value) for u, value in zip(self.unknowns, self.values(x), strict=True)
        }
        for unknown in self.unknowns:
            for name in unknown.tied:
                out[name] = self._tied[name] * out[unknown.name] / unknown.start
        return out

    def drive_at(self, x: np.ndarray, drive: Drive) -> Drive:
        """The drive with the values of x."""
        return with_drive(drive, self.named(x), [motor.name for motor in self.model.motors])

    @property
    def of_model(self) -> tuple[str, ...]:
        """Names of the numbers of the model that change with x, tied ones included."""
        names = {
            name for u in self.unknowns for name in (u.name, *u.tied) if not is_of_drive(name)
        }
        return tuple(p.name for p in select(self.model, sorted(names)))


def is_of_drive(name: str) -> bool:
    """Whether a parameter belongs to drives or sensors, not to the equations of motion; also names
    of groups.
    """
    return is_of_sensor(name) or name == DELAY or f".{name}".endswith((CONSTANT, *GAINS))


def is_of_sensor(name: str) -> bool:
    """Whether a parameter is the delay of a sensor, or of all sensors."""
    return name == SENSOR_DELAYS or name.endswith(SENSOR_DELAY)


def with_sensor_delays(model: RobotModel, delays: Mapping[str, float]) -> RobotModel:
    """The model whose sensors have the delays ``<sensor>.delay`` [s]."""
    sensors = (
        replace(s, delay_s=delays.get(s.name + SENSOR_DELAY, s.delay_s)) for s in model.sensors
    )
    return replace(model, sensors=tuple(sensors)) if delays else model


def cascade_at(controller: Cascade, values: Mapping[str, float], motors: Sequence[str]) -> Cascade:
    """The controller with other gains (``<motor>.speed_gain`` ...)."""
    gains: dict[str, Any] = {}
    for kind in GAINS:
        before = getattr(controller, kind[1:])
        gains[kind[1:]] = np.array(
            [values.get(motor + kind, old) for motor, old in zip(motors, before, strict=True)]
        )
    return replace(controller, **gains)


def _drive_parameters(
    model: RobotModel, names: Sequence[str], controller: Cascade | None
) -> list[Parameter]:
    """Delay, torque constants, gains, and the delays of sensors."""
    out = [p for name in names if is_of_sensor(name) for p in sensor_delays(model, name)]
    motors = [motor.name for motor in model.motors]
    known = {f"{motor}{kind}": (motor, kind) for kind in (CONSTANT, *GAINS) for motor in motors}
    for name in names:
        if is_of_sensor(name):
            continue
        if name == DELAY:
            out.append(
                Parameter(DELAY, 0.0, "s", "delay of the torques behind the measured angles")
            )
            continue
        chosen = [one for one, (_, kind) in known.items() if kind == f".{name}"] or [name]
        for one in chosen:
            if one not in known:
                raise ArgumentError(f"free: given {one!r}, expected one of {', '.join(known)}")
            motor, kind = known[one]
            if kind == CONSTANT:
                out.append(
                    Parameter(one, 1.0, "1", f"torque of motor {motor} over the recorded torque")
                )
                continue
            if controller is None:
                raise ArgumentError(
                    f"free: given {one!r}, which only 'refine' can fit: it simulates the drives"
                )
            gain = float(getattr(controller, kind[1:])[motors.index(motor)])
            if gain or chosen == [name]:  # of a group, what is zero stays zero
                out.append(
                    Parameter(
                        one,
                        gain,
                        GAINS[kind],
                        f"{kind[1:].replace('_', ' ')} of the drive of {motor}",
                    )
                )
    return out


def sensor_delays(model: RobotModel, name: str) -> list[Parameter]:
    """The delay of one sensor (``<sensor>.delay``), or of all (``sensor_delay``).

    Raises
    ------
    ArgumentError
        There is no such sensor.
    """
    doc = "from the motion to the sample of sensor"
    found = [
        Parameter(
            s.name + SENSOR_DELAY, s.delay_s, "s", f"{doc} {s.name}", f"sensor.{s.name}.delay_s"
        )
        for s in model.sensors
        if name in (SENSOR_DELAYS, s.name + SENSOR_DELAY)
    ]
    if not found:
        known = (
            ", ".join(s.name + SENSOR_DELAY for s in model.sensors)
            or "no delay: the model file has no [[sensor]]"
        )
        raise ArgumentError(
            f"free: given {name!r}, expected {'one of ' if model.sensors else ''}{known}"
        )
    return found


def _unknown(
    parameter: Parameter,
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    priors: Mapping[str, float],
    tied: tuple[str, ...],
) -> Unknown:
    """One number with its start, scale, bounds and prior."""
    name = parameter.name
    first = float(start.get(name, parameter.value))
    late = name == DELAY or is_of_sensor(name)
    signed = late or ".com_" in name or name.endswith((".offset", *PRODUCTS))
    begins_at_zero = first == 0.0 and name in bounds and bounds[name][0] == 0.0
    scale = "linear" if signed or begins_at_zero else "log"
    if not math.isfinite(first) or (scale == "log" and first <= 0.0):
        raise ArgumentError(
            f"start of {name}: given {first!r} {parameter.unit}, expected a number > 0; name "
            f"one, as in "
            f'start={{"{name}": 0.01}} (--start {name}=0.01)'
        )
    lower, upper = bounds.get(
        name, (1e-6 * first, 1e6 * first) if scale == "log" else (-np.inf, np.inf)
    )
    if not lower <= first <= upper or (scale == "log" and lower <= 0.0):
        raise ArgumentError(
            f"bounds of {name}: given {lower!r} to {upper!r} {parameter.unit}, expected an "
            f"interval that contains the start {first!r}" + ", above 0" * (scale == "log")
        )
    usual = PRIOR_SD if scale == "log" else 1e-2 if late else 1e3
    sd = float(priors.get(name, usual))
    if not sd > 0.0:
        raise ArgumentError(
            f"prior of {name}: given a standard deviation of {sd!r}, expected a number > 0"
        )
    return Unknown(parameter, first, scale, float(lower), float(upper), sd, tied)
