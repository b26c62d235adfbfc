"""Load at the tool from one motion: mass and center of mass with their standard deviations.

The torques of the gears follow from the motors, those that the robot needs from its equations with
a load (m, c):

    eta' (tau_m + d tau_m' - J_m a_m - f(v_m; s)) = [M(q_a; m, c) a_a + c + g]_g,
    all low-passed both ways

Filtering and squaring do not commute, so the motion is first low-passed at a higher frequency. d:
time by which torques are recorded late; minus half a sample where a torque is held from its sample
on. s: the friction of each motor changes with temperature, f = (1 + s_1) f(v) + s_2 v f'(v), s = 0
+- `FRICTION_SD`. Where a motor with Coulomb friction stands still, its friction is any torque, and
is taken out (`flexgen.identification.rigid.rests_of_motors`). Gears and links deflect, each spring
by 1 + e_i times as much as in the model:

    q_g = eta^-1 q_m - (1 + e_i) tau_g/k,    q_e = -(1 + e_i) f_e(q, v, a; m, c)/k

where f_e are the forces on the coordinates without motor. A rigid model would put these
deflections into the load, and so would one with other springs: e_i = 0 +- the deviation of the
stiffness (`flexgen.identification.load.compliances`). Least squares in (m, m c, d, s, e), see
`flexgen.identification.estimator`; a load is within `CENTER_SD` of the center of mass in the file,
for what the motion does not show, such as the height in the tool of a palletizer. Standard
deviations are the larger ones of two: of residuals whose correlation in time is that of the low
pass, at least `LEAST_ERROR` of the torques, and of what leaving out four periods of the low pass
changes, half a second at most, since errors of the model last longer.

Source: cf. P. Khosla, T. Kanade, IEEE CDC 1985 (parameters of loads from torques).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from scipy.ndimage import correlate1d
from scipy.signal import butter, filtfilt

from flexgen.base.calls.deadline import is_over, limit_fit, reason_of_end
from flexgen.base.calls.progress import Choice, Progress, reported, silent
from flexgen.base.checks.bounds import TimeLimit
from flexgen.base.checks.type_checks import checked_result, checked_types
from flexgen.base.display import short_repr
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.numerics.low_pass import bandwidth
from flexgen.base.rows import Part, Prose
from flexgen.base.spec.arguments import is_number
from flexgen.dynamics.hysteresis.hysteresis import without_hysteresis
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.dynamics.mechanics.statics import gear_deflection, reach
from flexgen.feedback.loop.gains import lowest_locked_hz
from flexgen.identification.estimator.covariance import block_covariance
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.layout import Layout
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Linearization, Prior, Problem, Squares
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.load.compliances import stiffness_deviations
from flexgen.identification.records.motor_record import read_motor_record
from flexgen.identification.rigid.rests_of_motors import MOVING, Rests, largest_of_unit
from flexgen.model.abilities import needs
from flexgen.model.elements import RobotModel

# of the torques; at most, times the lowest natural frequency with motors at rest
LOW_PASS_HZ = 8.0
OF_LOWEST = 1.5
# the same of quick motions, times their band; at most, of the sample rate
OF_BAND = 5.0
HALF = 0.1
# low pass of the motion: times that of the torques; at most, times the sample rate
OF_MOTION = 3.0
HIGHEST = 0.4
# Steps of a search, at most; searches, each with the prior of the center of mass that follows from
# the mass of the last one; relative change of its width, below which there are no more.
STEPS = 20
SEARCHES = 4
SETTLED = 1e-2
# Standard deviations from the minimum where the first search ends, whose prior is not the last
# one.
ROUGH = 1.0
# The same of the others: derivatives by differences show no more of springs, and a user sees less.
DISTANCE = 0.05
# of a step: largest difference of a time from that of equal steps, such as by the rounding of a
# clock
EVEN = 0.02
# deflections change the torques by little, these change the deflections by less
DEFLECTION_STEPS = 3
ENDS = 0.5  # s at both ends of a record that the low pass spoils
LEAST = 0.05  # and between them
# of white noise through the low pass, both sides, over its frequency
NOISE_BAND = 3 * np.pi / 4 / np.sqrt(2)
FEWEST = 200  # samples
FARTHEST = 3.0  # m, center of mass of the whole payload; the reach of a robot with a longer one
# of central differences
RATES = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60
SIDE = 3
AXES = ("xx", "yy", "zz", "xy", "yz", "xz")  # of an inertia, in the order of the parameters
UNEXPLAINED = 0.5  # of the torques, root mean square, at most
FRICTION_SD = 0.3  # relative, of each motor
# of the mass of the robot, 1 kg at most: where the search begins, and what it takes for exact
UNIT = 0.01
# m, or the reach: of the center of mass about that of the file, for directions that no motion
# shows
CENTER_SD = 1.0
LEAST_LOAD = 1e-3  # of the whole payload, for that deviation
UNKNOWN = 0.3  # m, or of the reach: a center of mass with a larger deviation is not known
LEAST_ERROR = 1e-4  # of the torques: deflections and filters are not more exact
# of a record, each left out once; fewer tell too little about five numbers
BLOCK_S = 0.5
FEWEST_BLOCKS = 6
# of the friction at the largest speed, at that one: a motor with less has no friction at
# standstill
STICKS = 0.05
# Changes of the load, relative, and of compliances, after which what springs change of the torques
# is computed anew.
FRESH = 1e-2
SOFTER = 1e-2  # of a compliance, a step of differences
FITTED = 5  # numbers of a load without a prior of their own: mass, center of mass, delay


@checked_result
@dataclass(frozen=True)
class Load(FitResult):
    """A load: ``mass`` [kg] and ``com`` (3,) [m] in the frame that the tool is attached to, with
    standard deviations.

    ``mass`` and ``com`` are the difference from the payload of the model file (``file_mass``,
    ``file_com``, ``file_inertia`` (3, 3) [kg m^2] about its center of mass); `is_total` where that
    has no mass.

    These are those of a model with right masses and dimensions; frictions of motors and springs
    may be off. The load is taken for a point mass: its inertia is not identified, and that of the
    payload of the file stays. Directions that the motion does not show have a deviation of about 1
    m, or the reach of a shorter arm: those with more than ``unknown_m`` [m] are printed as not
    determined. ``total_mass``, ``total_com``, ``total_com_sd``, ``total_inertia`` (3, 3) about
    ``total_com``:
    of the load and the payload of the model file together; the deviation of the mass is
    ``mass_sd``. ``residual_Nm``: root mean square of the residual gear torques (n_g,), arm side.
    ``delay_s``: time by which torques were recorded late [s].
    ``friction`` (2, n_m): viscous and other friction of each motor over those of the model.
    ``notes``: what was done to the record, as sentences. ``ended``: "time limit" or "interrupted"
    where the search was ended from outside, and the load is that of its best step; else empty.

    Examples
    --------
    >>> record = flexgen.solve(
    ...     flexgen.read("manutec_r3", overrides={"payload.mass": 20.0}), verify=False
    ... ).trajectory
    >>> load = flexgen.identify_load("manutec_r3", record)  # payload in the file: 15 kg
    >>> f"{load.mass:.1f} kg of {load.total_mass:.1f} kg"
    '5.0 kg of 20.0 kg'
    """

    mass: float
    mass_sd: float
    com: np.ndarray
    com_sd: np.ndarray
    total_mass: float
    total_com: np.ndarray
    residual_Nm: np.ndarray
    delay_s: float
    friction: np.ndarray
    unknown_m: float = UNKNOWN
    notes: tuple[str, ...] = ()
    ended: str = ""
    file_mass: float = 0.0
    file_com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    file_inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    total_com_sd: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    total_inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    __repr__ = short_repr

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """Mass and center of mass; a direction that the motion does not show is not
        determined.
        """
        is_found = bool(2 * self.mass_sd < abs(self.mass))
        mass = FittedNumber("mass", self.mass, "kg", self.mass_sd, is_determined=is_found)
        center = zip("xyz", self.com.tolist(), self.com_sd.tolist(), strict=True)
        return mass, *(
            FittedNumber(f"com_{axis}", x, "m", sd, is_determined=is_found and sd < self.unknown_m)
            for axis, x, sd in center
        )

    @cached_property
    def status(self) -> FitStatus:
        """Not checked by other motions; of a search that was ended from outside, the reason."""
        return FitStatus.of_value(self.ended) if self.ended else FitStatus.NOT_CHECKED

    @property
    def problem(self) -> str:
        """Why the load cannot be used: the search was ended from outside."""
        if not self.ended:
            return ""
        return f"{self.ended}: the load is that of the best step of the search"

    @property
    def is_total(self) -> bool:
        """Whether ``mass`` and ``com`` are all at the tool: the payload of the file has no
        mass.
        """
        return self.file_mass == 0.0

    def _entries(self) -> dict[str, Any]:
        of = "total at the tool" if self.is_total else "difference from the payload of the file"
        inertia = "not identified: point mass, and the inertia of the payload of the file"
        return {"mass_and_com_are": of, "inertia_is": inertia, **super()._entries()}

    def content(self) -> tuple[Part, ...]:
        """The sentences of the text, and all fields as data."""
        return *(Prose(line) for line in str(self).splitlines()), *self._data()

    def __str__(self) -> str:
        """Mass, center of mass, of which payload, inertia that was assumed, and frictions."""
        viscous, other = (", ".join(f"{x:.2f}" for x in row) for row in self.friction)
        friction = (
            f"\nfriction of the motors over that of the model: viscous {viscous}; other {other}"
        )
        friction += "".join(f"\nrecord: {note}" for note in self.notes)
        shown = self.com_sd < self.unknown_m
        is_found = 2 * self.mass_sd < abs(self.mass)
        load = f"load {self.mass:.3f} +- {self.mass_sd:.3f} kg, center of mass "
        load += _center(self.com, self.com_sd, shown) if is_found else "not determined"
        inertia = "\ninertia is not identified: the load is taken for a point mass"
        if self.is_total:
            of = "\nthis is the total at the tool: the payload of the model file has no mass"
            if self.file_inertia.any():
                inertia += f", with the inertia of that payload, {_six(self.file_inertia)}"
            return load + of + inertia + friction
        # what a small difference does not show is that of the file
        known = shown if is_found else self.total_com_sd < self.unknown_m
        of = (
            "\nthis is the difference from the payload of the model file, "
            f"{self.file_mass:.3f} kg; total at the tool {self.total_mass:.3f} +- "
            f"{self.mass_sd:.3f} kg, center of mass "
            + _center(self.total_com, self.total_com_sd, known)
        )
        inertia += (
            f", the inertia of the payload of the file stays, {_six(self.file_inertia)}; "
            f"of both together {_six(self.total_inertia)}"
        )
        return load + of + inertia + friction


def _center(com: np.ndarray, sd: np.ndarray, known: np.ndarray) -> str:
    """A center of mass (3,) [m] as text; ``known`` (3,): directions that are determined."""
    each = (
        f"{axis} {1e3 * x:.1f} +- {1e3 * s:.1f} mm" if is_known else f"{axis} not determined"
        for axis, x, s, is_known in zip("xyz", com, sd, known, strict=True)
    )
    return ", ".join(each) + " in the frame of the last tip"


def _six(inertia: np.ndarray) -> str:
    """An inertia tensor (3, 3) as text."""
    if not inertia.any():
        return "0 kg m^2"
    numbers = ", ".join(
        f"{inertia['xyz'.index(name[0]), 'xyz'.index(name[1])]:.3g}" for name in AXES
    )
    return f"({numbers}) kg m^2 about its center of mass ({', '.join(AXES)})"


@checked_types(own=("time_limit",))
@reported("identify_load")
@needs("identify_load")
def identify_load(
    model: str | FilePath | RobotModel | Equations,
    record: Trajectory | str | FilePath,
    *,
    low_pass_hz: float | None = None,
    rigid: bool = False,
    columns: Sequence[str] | None = None,
    time_limit: TimeLimit | None = None,
    progress: Choice = None,
) -> Load:
    """Identify the load at the tool, mass and center of mass, from a record of motor angles and
    torques.

    Frictions of the motors, and how soft the springs are, are found with it. The springs are known
    as the table ``[uncertainty]`` states (``stiffness``, or a number by name), or up to 20 %
    (standard deviation) where it has none.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
        Without the load, or with another one as payload.
    record : Trajectory, or the name of its file
        Channels ``q_m`` [rad] and ``tau_m`` [N m], motor side, as of `ControlRun.trajectory`; a
        CSV or MAT file of a logger, or a ``.toml`` file that describes one, see
        `flexgen.identification.records.motor_record`.
    low_pass_hz : float, optional [Hz]
        Of the torques; that of the motion is three times as high; default: 8, or five times the
        band of a quick motion, but at most 1.5 times the lowest natural frequency with the motors
        at rest.
    rigid : bool
        Without deflections, for comparison.
    columns : sequence of str, optional
        Names of the columns of a CSV file without a header, such as ``t,q1,q2,m1,m2`` (SI units,
        or with a unit).
    time_limit : float, optional [s]
        Time limit: then, or after Ctrl-C, the result is the best step so far; 0: no limit.
    progress : callable or bool, optional

    Returns
    -------
    Load

    Raises
    ------
    ArgumentError
        The record is too short, is of other motors, or has units or times that cannot be used.
    SolverError
        The motion does not determine the mass, or no load was found.

    Examples
    --------
    >>> loaded = flexgen.control(
    ...     "manutec_r3", plants={"loaded": {"payload": 8.0}}, sample_time=1e-3
    ... )
    >>> load = flexgen.identify_load("manutec_r3", loaded.trajectory("loaded"))
    >>> f"{load.mass:.1f} kg"
    '8.0 kg'
    """
    robot = robot_of(model)
    found = read_motor_record(robot, record, columns)
    tell: Progress = progress if callable(progress) else silent
    with limit_fit("identify_load", time_limit, tell):
        load = LoadEstimate(robot, found.trajectory, low_pass_hz, rigid).solve(tell)
    return replace(load, notes=found.notes) if found.notes else load


@dataclass(frozen=True)
class Numbers(Layout):
    """Numbers x of a load: mass and first moments of the whole payload, delay of the torques,
    frictions, compliances.
    """

    body: slice
    delay: slice
    friction: slice
    springs: slice

    @property
    def found(self) -> slice:
        """All without a prior of the springs: body and delay."""
        return slice(self.body.start, self.delay.stop)


class LoadEstimate:
    """Filtered torques and motion, and the residuals of a load."""

    def __init__(
        self, robot: RobotModel, record: Trajectory, low_pass_hz: float | None, rigid: bool
    ) -> None:
        time = record.time - record.time[0]
        h = float(time[-1]) / (len(time) - 1)
        if len(time) < FEWEST or np.abs(time - h * np.arange(len(time))).max() > EVEN * h:
            raise ArgumentError(
                f"record: given {len(time)} samples, expected at least {FEWEST}, equidistant"
            )
        for name in ("q_m", "tau_m"):
            if record[name].shape[1] != robot.n_m:
                raise ArgumentError(
                    f"record: given {record[name].shape[1]} columns of {name}, expected "
                    f"{robot.n_m}"
                )
        if low_pass_hz is None:
            low_pass_hz = default_low_pass(robot, record["q_m"], h, rigid)
        if not (is_number(low_pass_hz) and 0 < low_pass_hz < 0.2 / h):
            raise ArgumentError(
                f"low_pass_hz: given {low_pass_hz!r}, expected more than 0, below {0.2 / h:.4g} Hz"
            )
        quick = max(1.0, low_pass_hz / LOW_PASS_HZ)
        ends = ENDS / quick
        self.block = BLOCK_S / quick
        if h * len(time) < 2 * ends + LEAST / quick:
            raise ArgumentError(
                f"record: given {h * len(time):.3g} s, expected at least "
                f"{2 * ends + LEAST / quick:.3g} s: the low pass spoils {ends:.3g} s at both "
                "ends; begin before the motion and end after it"
            )
        self.robot = robot
        self.h = h
        self.rigid = rigid
        self._filter = butter(2, 2 * low_pass_hz * h)
        self._of_motion = butter(2, 2 * min(OF_MOTION * low_pass_hz * h, HIGHEST))
        self.spoiled = round(ends / h)
        self.kept = slice(self.spoiled, -self.spoiled)
        q_m = record["q_m"]
        v_m = self._rate(self._smooth(q_m))
        a_m = self._rate(v_m)
        carrier = next(element for element in robot.elements if element.name == robot.tip)
        # else its axes are others
        turned = [f"{robot.tip}.inertia_{axes}" for axes in AXES if carrier.beam is None]
        self.names = (*turned, "payload.mass", "payload.com_x", "payload.com_y", "payload.com_z")
        self.equations: Equations = derive(without_hysteresis(robot), self.names)
        self.of_file = np.array([p.value for p in self.equations.parameters])
        friction, faster = (  # of noise it would have a mean
            evaluate(self.equations.function("motor_friction"), x)[0].reshape(q_m.shape)
            for x in (v_m, 1.01 * v_m)
        )
        inertia = np.array([m.inertia for m in robot.motors])
        needed = self._smooth(record["tau_m"] - friction) - inertia * a_m
        tau_g = needed @ robot.eta
        self.tau_g = self._low_pass(tau_g)
        largest = np.abs(self.tau_g[self.kept]).max(axis=0)
        self.scale = np.maximum(largest, 1e-3 * largest.max())
        self.late = self._low_pass(self._rate(self._smooth(record["tau_m"])) @ robot.eta)
        # the second has viscous friction alone
        parts = np.hstack([friction, (faster - friction) / 0.01])
        self.friction = self._low_pass(
            self._smooth(parts)[:, :, None] * np.vstack([robot.eta, robot.eta])
        )
        self.to_arm = np.linalg.inv(robot.eta).T
        self.q_m = self._smooth(q_m)
        self.nominal = derive(robot)
        self.length = reach(self.nominal)
        self.farthest = max(FARTHEST, self.length)
        self.unit = min(1.0, UNIT * sum(element.body.mass for element in robot.elements)) or 1.0
        # arm angles behind the gears; they do not depend on the load
        self.q_geared = np.zeros((len(q_m), robot.n_a))
        self.q_geared[:, list(robot.i_g)] = self.q_m @ self.to_arm
        # of the gears, with the springs of the model
        self.deflection = np.zeros((len(q_m), robot.n_g))
        self.stiffness_sd = np.zeros(robot.n_a)
        if not rigid:
            self.deflection = gear_deflection(self.nominal, tau_g).reshape(len(q_m), -1)
            self.q_geared[:, list(robot.i_g)] -= self.deflection
            self.stiffness = self._stiffness()
            self.stiffness_sd = stiffness_deviations(robot)
        self._rests, share = self._standstill(v_m, low_pass_hz)
        self.moving = share * len(time[self.kept])  # samples that are judged
        self.effective = self.moving * min(1.0, NOISE_BAND * low_pass_hz * h)  # independent ones

    def _standstill(self, v_m: np.ndarray, low_pass_hz: float) -> tuple[list[Rests], float]:
        """Filtered stiction regressors of each motor, and the share of samples in motion."""
        ratio = np.abs(self.robot.eta).max(axis=1)
        most = ratio * largest_of_unit(self.robot, v_m / ratio)
        slow, fast = (
            np.abs(evaluate(self.equations.function("motor_friction"), x[None])[0].ravel())
            for x in (MOVING * most, most)
        )
        least = np.where(slow > STICKS * fast, MOVING * most, -1.0)
        rests = [
            Rests(
                v,
                x,
                low_pass_hz * self.h,
                lambda y: self._low_pass(self._smooth(y)),
                1,
                self.spoiled,
                self.spoiled,
            )
            for v, x in zip(v_m.T, least, strict=True)
        ]
        return rests, float(np.mean(np.abs(v_m[self.kept]) > least))

    def see(self, tau: np.ndarray) -> np.ndarray:
        """Gear torques (n, n_g) over their scale, after elimination of the friction at standstill,
        of the samples kept.
        """
        motors = tau[self.kept] @ self.to_arm.T
        known = np.stack(
            [rest.project(x) for rest, x in zip(self._rests, motors.T, strict=True)], axis=1
        )
        return np.asarray(known @ self.robot.eta / self.scale)

    def _smooth(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(filtfilt(*self._of_motion, x, axis=0))

    def _low_pass(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(filtfilt(*self._filter, x, axis=0))

    def motion(
        self, values: np.ndarray, softer: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Arm coordinates with deflections, velocities and accelerations (n, n_a), for a load.

        ``softer`` (n_a,): compliances over those of the model, less 1.
        """
        q = self.q_geared.copy()
        i_e = list(self.robot.i_e)
        i_g = list(self.robot.i_g)
        q[:, i_g] -= softer[i_g] * self.deflection
        if i_e and not self.rigid:
            for _ in range(DEFLECTION_STEPS):
                v = self._rate(q)
                forces = self.forces(q, v, self._rate(v), values)[:, i_e]
                q[:, i_e] = -self._smooth(forces) * (1.0 + softer[i_e]) / self.stiffness
        v = self._rate(q)
        return q, v, self._rate(v)

    def _rate(self, x: np.ndarray) -> np.ndarray:
        """Central differences of sixth order: those of second order are 1e-4 off at 1 Hz and 4 ms,
        which is seen.
        """
        padded = np.pad(x, ((SIDE, SIDE), (0, 0)), mode="reflect", reflect_type="odd")
        return np.asarray(correlate1d(padded, RATES, axis=0)[SIDE:-SIDE] / self.h)

    def _stiffness(self) -> np.ndarray:
        """Stiffness of the springs without motor at rest (n_e,)."""
        zero = np.zeros((1, self.robot.n_a))
        step = 1e-6
        out = []
        for i in self.robot.i_e:
            moved = zero.copy()
            moved[0, i] = step
            tau = evaluate(self.nominal.function("elastic_torque"), moved, zero)[0].ravel()
            out.append(-tau[list(self.robot.i_e).index(i)] / step)
        return np.array(out)

    def forces(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, values: np.ndarray
    ) -> np.ndarray:
        """Forces that the arm needs (n, n_a)."""
        body = np.concatenate(
            [self.of_file[:-4] + self._inertia(values)[: len(self.of_file) - 4], values]
        )
        return evaluate(self.equations.function("inverse_dynamics"), q, v, a, body)[0].reshape(
            q.shape
        )

    def _inertia(self, values: np.ndarray) -> np.ndarray:
        """Increase of the payload's inertia by the load, an additional point mass."""
        mass = self.of_file[-4]
        com = self.of_file[-3:]
        load = values[0] - mass
        moved = values[0] * (values[1:] - com)
        if np.linalg.norm(moved) >= abs(load) * self.farthest:
            return np.zeros(len(AXES))
        x, y, z = moved / load
        own = np.array([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -y * z, -x * z])
        return own * mass * load / values[0]

    def solve(self, tell: Progress = silent) -> Load:
        """The load of least squares.

        Raises
        ------
        SolverError
            The motion does not determine the mass, or no load explains the record.
        """
        residuals = _Residuals(self)
        x = residuals.start
        distance = ROUGH
        for _ in range(SEARCHES):
            hidden = residuals.hidden(x)
            found = self._search(residuals, x, distance, tell)
            x = found.x
            change = abs(residuals.hidden(found.x) / hidden - 1.0)
            if is_over() or (change < SETTLED and distance < ROUGH):
                break
            distance = DISTANCE
        prior = residuals.prior(x)
        r = residuals(x).reshape(-1, self.scale.size)
        J = residuals.jacobian(x)
        size = np.sqrt(self._variance(r))
        formal = np.linalg.inv(J.T @ J / size**2 + prior.information)
        covariances = [formal, self._left_out(r / size, J / size, prior.information)]
        reason = reason_of_end()
        if not (found.converged or reason):
            raise SolverError(
                f"load: no solution in {found.iterations} steps; does the record belong to the "
                f"model {self.robot.name}?"
            )
        unexplained = float(np.linalg.norm(r) / np.linalg.norm(self.see(self.tau_g)))
        if not (unexplained < UNEXPLAINED or reason):
            raise SolverError(
                f"load: no load explains the record, {100 * unexplained:.0f} % of the torques "
                f"are left; does it belong to the model {self.robot.name}, in rad and N m of "
                "the motors?"
            )
        return replace(self._result(x, residuals.layout, r, covariances), ended=reason)

    def _search(
        self, residuals: _Residuals, x: np.ndarray, distance: float, tell: Progress
    ) -> Minimum:
        """The least squares from x (n,), with the variance of the errors that are left."""

        def tell_load(step: int, here: Linearization) -> None:
            tell(f"step {step}: load {here.x[0] - self.of_file[-4]:.3f} kg")

        def scale(r: np.ndarray) -> float:
            return float(np.sqrt(self._variance(r.reshape(-1, self.scale.size))))

        # numbers of different units
        search = Search(
            distance, curvature=True, steps=STEPS, stage="identify_load", tell=tell_load
        )
        prior = residuals.prior(x)
        problem = Problem(residuals, residuals.jacobian, prior, residuals.bounds, Squares(scale))
        return minimize(problem, x, search)

    def _result(
        self, x: np.ndarray, layout: Numbers, r: np.ndarray, covariances: list[np.ndarray]
    ) -> Load:
        """The load of these numbers and residuals (n, n_g)."""
        own = self.of_file[-4]
        center = self.of_file[-3:]
        body = x[layout.body]
        bodies = [each[layout.body, layout.body] for each in covariances]
        mass = body[0] - own
        mass_sd = np.sqrt(max(each[0, 0] for each in bodies))
        is_some = abs(mass) > 1e-9 * self.unit
        com = (body[1:] - own * center) / mass if is_some else np.full(3, np.nan)
        # of com in the mass and the first moments
        slopes = np.column_stack([-com, np.eye(3)]) / (mass or np.nan)
        com_sd = np.sqrt(np.max([np.diag(slopes @ each @ slopes.T) for each in bodies], axis=0))
        left = np.sqrt((r**2).sum(axis=0) / self.moving) * self.scale
        friction = 1.0 + x[layout.friction].reshape(2, -1).cumsum(axis=0)[::-1]
        total = values_of(body, self.farthest)
        of_total = np.column_stack([-total[1:], np.eye(3)]) / total[0]
        total_com_sd = np.sqrt(
            np.max([np.diag(of_total @ each @ of_total.T) for each in bodies], axis=0)
        )
        of_file = np.array(self.robot.payload.inertia)
        # that of a payload on a beam stays: see the names of the inertia
        is_added = len(self.of_file) == len(AXES) + 4
        of_load = _tensor(self._inertia(total)) if is_added else np.zeros((3, 3))
        numbers = (
            float(mass),
            float(mass_sd),
            com,
            com_sd,
            float(body[0]),
            total[1:],
            left,
            x[layout.delay].item(),
        )
        return Load(
            *numbers,
            friction,
            UNKNOWN * (min(1.0, self.length) or 1.0),
            file_mass=float(own),
            file_com=center,
            file_inertia=of_file,
            total_com_sd=total_com_sd,
            total_inertia=of_file + of_load,
        )

    def _variance(self, r: np.ndarray) -> float:
        """Of an error that is independent of the others: more than that of the samples (n, n_g),
        which are alike.
        """
        tau = self.see(self.tau_g)
        return float((r**2).sum() + LEAST_ERROR**2 * (tau**2).sum()) / max(
            self.effective * r.shape[1] - FITTED, 1.0
        )

    def _left_out(self, r: np.ndarray, J: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """Covariance from blocks of the record, of weighted residuals (n, n_g); zero for few
        blocks.
        """
        starts = range(0, len(r), max(round(self.block / self.h), 1))
        if len(starts) < FEWEST_BLOCKS:
            return np.zeros(prior.shape)
        # the priors of frictions and springs are wide already
        return block_covariance(J.reshape(*r.shape, -1), r, starts, prior, by_axis=False)


class _Residuals:
    """Residuals of the torques over their scale, as functions of the `Numbers` x."""

    def __init__(self, of: LoadEstimate) -> None:
        self.of = of
        self.soft = np.flatnonzero(of.stiffness_sd)
        self.layout = Numbers.of(
            body=4, delay=1, friction=of.friction.shape[1], springs=len(self.soft)
        )
        own = of.of_file[-4]
        center = of.of_file[-3:]
        mass = own + of.unit
        self.start = self.layout.join(body=np.r_[mass, mass * center])
        self.length = min(1.0, of.length) or 1.0
        # first moments about the center of mass of the file
        self.about = np.column_stack([-center, np.eye(3)])
        q, v, _ = of.motion(self._load(self.start), np.zeros(len(of.stiffness_sd)))
        friction = evaluate(of.nominal.function("arm_forces"), q, v)[0]
        self.arm_friction = friction.reshape(-1, of.robot.n_a)
        self._J = np.zeros((of.see(of.tau_g).size, self.layout.size))
        self._J[:, self.layout.delay] = -of.see(of.late).reshape(-1, 1)
        for j, k in enumerate(self.layout.entries(self.layout.friction)):
            self._J[:, k] = of.see(of.friction[:, j]).ravel()
        self._last = np.zeros(0), np.zeros(0)
        # x where the columns of the springs were computed
        self._of_springs = np.full(self.layout.size, np.inf)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The mass is positive."""
        lower = np.full(self.layout.size, -np.inf)
        lower[self.layout.body.start] = 1e-6 * self.of.unit
        return lower, np.full(self.layout.size, np.inf)

    def hidden(self, x: np.ndarray) -> float:
        """Deviation of the first moments [kg m] about the center of mass of the file."""
        mass = x[0]
        own = self.of.of_file[-4]
        return CENTER_SD * self.length * max(abs(mass - own), LEAST_LOAD * mass)

    def prior(self, x: np.ndarray) -> Prior:
        """The prior for a load of the mass that x has."""
        at = self.layout
        n = self.layout.size
        information = np.zeros((n, n))
        information[at.body, at.body] = self.about.T @ self.about / self.hidden(x) ** 2
        known = self.layout.join(
            friction=FRICTION_SD**-2.0, springs=self.of.stiffness_sd[self.soft] ** -2.0
        )
        return Prior(np.zeros(n), information + np.diag(known))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Residuals (n,); those of the last x are kept."""
        if not np.array_equal(self._last[0], x):
            self._last = x.copy(), self._residual(x)
        return self._last[1]

    def _residual(self, x: np.ndarray) -> np.ndarray:
        of = self.of
        at = self.layout
        softer = np.zeros(len(of.stiffness_sd))
        softer[self.soft] = x[at.springs]
        load = self._load(x)
        tau = of._low_pass(of.forces(*of.motion(load, softer), load) - self.arm_friction)
        friction = np.einsum("njg,j->ng", of.friction, x[at.friction])
        needed = of.tau_g + x[at.delay] * of.late - friction
        return of.see(tau[:, list(of.robot.i_g)] - needed).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the residuals (n, numbers), by differences; those in the springs only
        after large changes.

        Raises
        ------
        SolverError
            The motion does not determine the mass.
        """
        at = self.layout
        unit = self.of.unit
        arm = 1e-4 * self.length * max(x[0], unit)
        sizes = dict(zip(at.entries(at.body), (1e-3 * unit, arm, arm, arm), strict=True))
        away = x - self._of_springs
        of_load = np.abs(away[at.body] / [1.0, *3 * [self.length]]).max() / (unit + abs(x[0]))
        if not max(of_load, np.abs(away[at.springs]).max(initial=0.0)) < FRESH:
            sizes |= dict.fromkeys(at.entries(at.springs), SOFTER)
            self._of_springs = x.copy()
        r = self(x)
        for k, size in sizes.items():
            there = self._residual(x + size * (np.arange(at.size) == k))
            self._J[:, k] = (there - r) / size
        deviation = np.sqrt(self.of._variance(r.reshape(-1, self.of.scale.size)))
        if not _is_determined(self._J[:, at.found], self.about * deviation / self.hidden(x)):
            raise SolverError(
                "load: the motion does not determine the mass; move the joints that carry the load"
            )
        return self._J

    def _load(self, x: np.ndarray) -> np.ndarray:
        return values_of(x[self.layout.body], self.of.farthest)


def _tensor(six: np.ndarray) -> np.ndarray:
    """The tensor (3, 3) of an inertia in the order of `AXES`."""
    xx, yy, zz, xy, yz, xz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def values_of(body: np.ndarray, farthest: float) -> np.ndarray:
    """Mass and center of mass from mass and first moments; that of a mass that is nearly zero is
    kept near.
    """
    return np.concatenate([body[:1], np.clip(body[1:4] / body[0], -farthest, farthest)])


def _is_determined(J: np.ndarray, prior: np.ndarray) -> bool:
    """Whether the first number has a column of its own; ``prior`` (3, 4): rows of the first
    four.
    """
    rows = np.vstack([J, np.pad(prior, ((0, 0), (0, J.shape[1] - 4)))])
    own = rows[:, 0]
    others = rows[:, 1:] / np.maximum(np.linalg.norm(rows[:, 1:], axis=0), 1e-300)
    left = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    return bool(np.linalg.norm(left) > 1e-6 * np.linalg.norm(own))


def default_low_pass(robot: RobotModel, q_m: np.ndarray, h: float, rigid: bool) -> float:
    """Low pass of the torques [Hz] for motor angles (n, n_m) every h [s]."""
    most = min(max(LOW_PASS_HZ, OF_BAND * bandwidth([np.diff(q_m, axis=0)], h)), HALF / h)
    q_m = q_m[:1]
    q_a, still, quiet = (np.zeros((1, n)) for n in (robot.n_a, robot.n_a, robot.n_m))
    q_a[:, list(robot.i_g)] = q_m @ np.linalg.inv(robot.eta).T
    lowest = (
        0.0 if rigid else lowest_locked_hz(robot, (q_a, still, still, q_m, quiet, quiet, quiet))
    )
    return min(most, OF_LOWEST * lowest) if lowest else most
