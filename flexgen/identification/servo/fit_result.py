"""Result of `flexgen.identify_servo`: the servo with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import lines_of
from flexgen.base.files.atomic_files import write_text
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.base.spec.toml_text import toml
from flexgen.feedback.positions.servo import Servo
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.servo.record import ServoRecord

ENOUGH = 0.9  # explained, of the lag of the robot
LEFT = 1.5  # unexplained, over the noise
# of the samples where a command moves: from here on steps of the angles are not like noise
REPEATED = 0.4
# Gains of each motor, with their units.
UNITS = {"position_gain": "1/s", "speed_gain": "N m s/rad", "integral_gain": "1/s"}
GAINS = tuple(UNITS)


@checked_result
@dataclass(frozen=True, repr=False)
class ServoFit(FitResult):
    """A position servo that was identified.

    Attributes
    ----------
    servo : Servo
        With the gains of each motor.
    latency_s : float [s]
        From the time of a command in the record to its effect; for ``"hold"`` to the sample of the
        servo that it changes first.
    gain_sd : array (3, n_m)
        Relative standard deviations of position, speed and integral gains, those of a right model:
        texts have them where it `is_explained` only; zero of a gain that stayed zero.
    common_sd : mapping of str to float
        Standard deviations of the numbers that all motors share.
    unexplained : array (n_m,) [rad]
        Root mean square of the difference of measured and simulated angles, motor side.
    noise : array (n_m,) [rad]
        Its part that changes from sample to sample, as the noise of the angles does.
    explained : float
        Part of the sum of squares of commands minus angles that the servo explains.
    converged : bool
        Whether the search ended.
    motors : tuple of str
        Names of the motors.
    record : ServoRecord
        That was fitted.
    interpolation : str
        Of the robot between two commands.
    model : str
        Of the robot.
    ended : str
        ``"time limit"`` or ``"interrupted"`` where the search was ended from outside: the servo is
        that of its best step. Else empty.

    Examples
    --------
    >>> import numpy as np
    >>> # a robot that is sent the planned motor angles
    >>> run = flexgen.command_positions("elbow").today
    >>> joints = np.linalg.inv(run.model.eta).T
    >>> sent, measured = run.reference.motion["q_m"] @ joints, run.nominal.measured @ joints
    >>> found = flexgen.identify_servo(
    ...     "elbow", flexgen.ServoRecord(run.reference.time, sent, measured)
    ... )
    >>> found.servo.sample_time, found.motors
    (0.0005, ('m1', 'm2'))
    """

    servo: Servo
    latency_s: float
    gain_sd: np.ndarray
    common_sd: Mapping[str, float]
    unexplained: np.ndarray
    noise: np.ndarray
    explained: float
    converged: bool
    motors: tuple[str, ...]
    record: ServoRecord
    interpolation: str
    model: str
    ended: str = ""

    def __repr__(self) -> str:
        return f"<ServoFit {self.model}: {self.sentence()}>"

    def __str__(self) -> str:
        """The figures as lines."""
        return lines_of(self.content())

    @property
    def left(self) -> float:
        """Ratio of the unexplained residual to the noise, of the motor with the largest ratio."""
        return float((self.unexplained / np.maximum(self.noise, 1e-300)).max())

    @property
    def is_explained(self) -> bool:
        """Whether noise explains the difference of measured and simulated angles."""
        return self.converged and self.left < LEFT

    @cached_property
    def status(self) -> FitStatus:
        """Of the search and of its result: "fitted" where noise explains the rest."""
        if self.ended:
            return FitStatus.of_value(self.ended)
        if not self.converged:
            return FitStatus.NOT_CONVERGED
        right = self.is_explained and self.explained >= ENOUGH
        return FitStatus.FITTED if right else FitStatus.MODEL_ERROR

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """Gains, ``MOTOR.position_gain``, with relative deviations, and the numbers that all
        motors share.
        """
        stated = self.is_explained
        gains = []
        for (word, unit), deviations in zip(UNITS.items(), self.gain_sd, strict=True):
            each = np.asarray(getattr(self.servo.feedback, word), dtype=float).tolist()
            for motor, value, own in zip(self.motors, each, deviations.tolist(), strict=True):
                name = f"{motor}.{word}"
                gains.append(FittedNumber(name, value, unit, own if stated else None, True))
        servo = self.servo
        shared = (servo.speed_feedforward, servo.reference_filter_s, self.latency_s)
        common = [
            FittedNumber(name, value, "s" if name.endswith("_s") else "", sd if stated else None)
            for (name, sd), value in zip(self.common_sd.items(), shared, strict=True)
        ]
        return (*gains, *common)

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """Likely reasons of what is unexplained."""
        found = []
        if self.converged and not self.is_explained:
            found.append("other torque filters, structure, delay or model")
        if self.repeated > REPEATED:
            found.append("angles that repeat from sample to sample")
        return tuple(found)

    @property
    def repeated(self) -> float:
        """Part of the samples with a command that moves in which the measured angle repeats, of
        the worst joint.
        """
        moves = np.diff(self.record.command, axis=0) != 0.0
        same = np.diff(self.record.angle, axis=0) == 0.0
        return float(((moves & same).sum(axis=0) / np.maximum(moves.sum(axis=0), 1)).max())

    @property
    def problem(self) -> str:
        """Why the servo cannot be used: it explains too little, or the search did not end."""
        if self.ended:
            return f"{self.ended}: the servo is that of the best step of the search"
        if self.explained >= ENOUGH:
            return (
                ""
                if self.converged
                else "the search did not end; begin with gains nearer to those of the robot"
            )
        return (
            f"the servo explains {100 * self.explained:.0f} % of the lag of the robot, expected "
            f"{100 * ENOUGH:.0f} %: another structure, interpolation, sample time or delay, or "
            "another model"
        )

    def sentence(self) -> str:
        """The fit in words."""
        more = (
            f"; {self.left:.2g} times the noise is left: other torque filters, structure, delay "
            "or model"
        )
        found = f"servo identified, {100 * self.explained:.4g} % of the lag of the robot explained"
        coarse = (
            f"; angles repeat in {100 * self.repeated:.0f} % of the samples: finer angles, or a "
            "faster motion"
        )
        return self.problem or found + more * (not self.is_explained) + coarse * (
            self.repeated > REPEATED
        )

    def figures(self) -> tuple[Row, ...]:
        """The figures in SI units, for tables."""
        rows = [_figure(number) for number in self.fitted]
        worst = float(self.unexplained.max())
        return (
            *rows,
            Row("unexplained, root mean square, motor side", worst, "rad"),
        )

    def content(self) -> tuple[Part, ...]:
        """Gains and what is unexplained, and figures of the fit as data."""
        servo = self.servo
        own = ("speed_feedforward", "reference_filter_s", "sample_time", "delay")
        return (
            Prose(f"{self.model}: {self.sentence()}", is_title=True),
            *self.figures(),
            *(Prose(f"record: {note}") for note in self.record.notes),
            *(Data(name, getattr(servo, name)) for name in own),
            *(Data(name, np.asarray(getattr(servo.feedback, name))) for name in GAINS),
            *self._data("servo", "record"),
        )

    def write(self, path: str | Path) -> Path:
        """Write the servo to a file ``.toml`` that `Servo.read` and the command line take."""
        servo = self.servo
        values = {name: np.asarray(getattr(servo.feedback, name)).tolist() for name in GAINS}
        values |= {
            name: getattr(servo, name)
            for name in ("speed_feedforward", "reference_filter_s", "sample_time", "delay")
        }
        description = (
            f"servo of {self.model}, identified from {Path(self.record.source).name or 'a record'}"
            + (f"; {self.ended}: best step of the search" if self.ended else "")
        )
        lines = [f"description = {toml(description)}", 'type = "cascade"']
        lines += [f"{name} = {toml(value)}" for name, value in values.items()]
        for each in getattr(servo.feedback, "filters", ()):
            kind = {"LowPass": "low_pass", "Notch": "notch"}[type(each).__name__]
            lines += [
                "",
                f"[[{kind}]]",
                *(f"{name} = {toml(value)}" for name, value in vars(each).items()),
            ]
        return write_text(Path(path), "\n".join(lines) + "\n")


def _figure(number: FittedNumber) -> Row:
    """The row of a number: gains by their motor."""
    motor, _, gain = number.name.rpartition(".")
    if motor:
        return number.row(f"{gain.replace('_', ' ')} of {motor}", digits=5)
    return number.row(number.name.removesuffix("_s").replace("_", " "))
