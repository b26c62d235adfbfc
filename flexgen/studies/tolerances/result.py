"""Result of `flexgen.predict`: errors, bands, shares, and their text."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import format_size
from flexgen.base.results import Result
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.inversion.solution import Solution
from flexgen.simulation.motor_feedback import MotorFeedback

UNITS = ("m", "rad")
SHOWN = 8  # shares in the text
LACKING = "what the model lacks (misfit)"


@dataclass(frozen=True)
class Share:
    """Part of the variance of the output error that a source has: ``name``, ``kind``,
    ``share``.
    """

    name: str
    kind: str
    share: float


@dataclass(frozen=True)
class Band:
    """Between ``low`` and ``high`` (k, n) are 95 % of the robots at each instant; ``planned`` (k,
    n).
    """

    names: tuple[str, ...]
    planned: np.ndarray
    low: np.ndarray
    high: np.ndarray


@checked_result
@dataclass(frozen=True, repr=False)
class Prediction(Result):
    """Errors of robots that are known up to the tolerances of their model.

    Attributes
    ----------
    solution : Solution
        The feedforward.
    feedback : MotorFeedback
        The motor feedback around it.
    sources : tuple of str (n,)
        Numbers of the model that are not known exactly.
    sd : array (n,)
        Their relative standard deviations, of the payload [kg].
    robots, seed : int
        Simulated robots, and seed of their draws.
    error_m, error_rad : float or None [m], [rad]
        Largest error of the output over the motion, which 95 % of the robots keep; None where the
        output has no such part, or a robot is unstable.
    errors_m, errors_rad : array (robots,) or None [m], [rad]
        Of the simulated robots.
    time : array (k,) [s]
        Of the bands.
    torque : Band [N m]
        Of the motors.
    deflection : Band [rad or m]
        Of springs, arm side: what a gear adds to the angle of its motor, or a joint without motor.
    shares : tuple of Share
        Parts of the variance of the error where it is largest, to first order; the largest first.
    to_halve : tuple of str
        What to measure so that the error is half as large.
    ended : str
        Empty; ``"time limit"`` or ``"interrupted"`` where fewer robots were simulated than asked
        for.

    Examples
    --------
    >>> found = flexgen.predict(
    ...     flexgen.read("elbow", overrides={"uncertainty": {"stiffness": 0.1}})
    ... )
    >>> found.torque.high.shape, found.shares[0].name
    ((200, 2), 'q1.stiffness')
    """

    solution: Solution
    feedback: MotorFeedback
    sources: tuple[str, ...]
    sd: np.ndarray
    robots: int
    seed: int
    error_m: float | None
    error_rad: float | None
    errors_m: np.ndarray | None
    errors_rad: np.ndarray | None
    time: np.ndarray
    torque: Band
    deflection: Band
    shares: tuple[Share, ...]
    to_halve: tuple[str, ...]
    ended: str = ""

    def __repr__(self) -> str:
        return (
            f"<Prediction {self.solution.model.title}, {self.solution.move.name}: "
            f"{self.sentence()}>"
        )

    def __str__(self) -> str:
        """The figures as lines."""
        model = self.solution.model
        unknown = model.not_measured_sentence
        lines = [*self.lines(), *([unknown] if unknown else [])]
        return "\n".join([f"{model.title}, move {self.solution.move.name}", *lines])

    @property
    def problem(self) -> str:
        """Why there is no error, or why fewer robots were simulated than asked for; else empty."""
        if self.error_m is None and self.error_rad is None:
            return "a robot with the motor feedback is unstable"
        return f"{self.ended}: the figures are those of {self.robots} robots" if self.ended else ""

    def sentence(self) -> str:
        """The error in words."""
        what = "output" if self.solution.model.output.type == "combination" else "tool"
        values = [
            f"<= {format_size(x, u)}"
            for x, u in ((self.error_m, "m"), (self.error_rad, "rad"))
            if x is not None
        ]
        return f"{what} error 95 % {' and '.join(values) or 'not known: ' + self.problem}"

    def lines(self) -> list[str]:
        """The main figures in words."""
        shown = [
            f"{share.name} {100 * share.share:.0f} %"
            for share in self.shares[:SHOWN]
            if share.share >= 0.005
        ]
        few = [LACKING if name == "misfit" else name for name in self.to_halve[:SHOWN]]
        more = f" and {len(self.to_halve) - SHOWN} more" if len(self.to_halve) > SHOWN else ""
        count = f"{len(self.sources)} uncertain numbers, {self.robots} robots simulated"
        count += f", then {self.ended}" if self.ended else ""
        return [
            f"{self.sentence()} with motor feedback ({count})",
            self.feedback.title,
            f"shares of the variance: {', '.join(shown)}",
            f"to halve the error, measure {', '.join(few)}{more}",
        ]

    def figures(self) -> tuple[Row, ...]:
        """The figures in SI units, for tables."""
        what = "output" if self.solution.model.output.type == "combination" else "tool"
        return (
            Row(
                f"{what} error with motor feedback that 95 % of the robots keep",
                self.error_m,
                "m",
                "error_m",
            ),
            Row(
                f"{what} error with motor feedback that 95 % of the robots keep",
                self.error_rad,
                "rad",
                "error_rad",
            ),
            Row("motor feedback", self.feedback.title, "", "motor_feedback"),
            Row("uncertain numbers", len(self.sources)),
            Row("robots simulated", self.robots, "", "robots"),
            *(
                Row(f"share of {s.name}", f"{100 * s.share:.1f}", "%")
                for s in self.shares
                if s.share >= 0.005
            ),
            Row("to halve the error, measure", ", ".join(self.to_halve)),
        )

    def content(self) -> tuple[Part, ...]:
        """The figures, and the bands and errors of all robots as data."""
        known = {figure.key for figure in self.figures()}
        model = self.solution.model
        unknown = model.not_measured
        said: list[Part] = []
        if unknown:
            said = [Prose(model.not_measured_sentence), Data("not_measured", list(unknown))]
        return (
            Prose(f"{self.solution.model.title}, move {self.solution.move.name}", is_title=True),
            Data("model", self.solution.model.title),
            Data("move", self.solution.move.name),
            *self.figures(),
            *said,
            *self._data("solution", "feedback", *known),
        )
