"""Result of `flexgen.identify_spring`: numbers of a spring and its hysteresis, the loops of all
records, and the model that has the numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.display import lines_of
from flexgen.base.registry import provides
from flexgen.base.rows import Data, Part, Prose, Row
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.gears.result import Number, write_gears
from flexgen.model.elements import RobotModel
from flexgen.model.new_file import with_overrides
from flexgen.model.reader import read

STIFFNESSES = ("stiffness", "low", "high")  # numbers without which a spring is not known
# Where sentence and advice are not those of measured responses.
TEXTS = {
    FitStatus.MODEL_ERROR: (
        "The loops of the law differ from the record by more than the noise.",
        "Look at the loops of the picture: another kind of spring, more elements, or exponents. "
        "Standard deviations are not given.",
    ),
    FitStatus.SMALL_ERROR: (
        "The loops of the law agree with the record to 1 % of its torques; the rest is more than "
        "the noise.",
        "Use the numbers. Standard deviations are not given: noise causes only a part of the "
        "errors.",
    ),
    FitStatus.POORLY_VALIDATED: (
        "The law does not predict a record that was not fitted.",
        "Fit records of both sizes, or another kind of spring or more elements; a gear that "
        "creeps or warms up has no loop of its own.",
    ),
    FitStatus.NOT_CONVERGED: (
        "The search for the best numbers did not come to an end.",
        "Do not use the numbers; fit fewer elements, or their exponents not.",
    ),
    FitStatus.AT_BOUND: (
        "An element is as sharp, as small or as wide as it may be.",
        "Fit fewer elements, or their exponents not.",
    ),
}


@dataclass(frozen=True, eq=False)
class RecordOfSpring:
    """A record and its loop by the law.

    ``error`` and ``noise``: root mean squares over the range of its torques; ``width`` and
    ``width_of_model``: of the loop at the middle of its torques, at the joint [rad or m], None
    where the record has none; ``points`` (n, 3): deflection, measured and computed torque, at the
    joint.
    """

    name: str
    is_fitted: bool
    error: float
    noise: float
    width: float | None
    width_of_model: float | None
    points: np.ndarray


@provides("SpringFit.check_file")
def check_file(path: str | Path, robot: RobotModel) -> None:
    """Check before a fit that `SpringFit.save` can write the new model file; errors as there."""
    write_gears(path, robot, {}, "check", dry=True)


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class SpringFit(FitResult):
    """Spring and hysteresis of a gear, identified from a locked or slow test.

    Attributes
    ----------
    robot : RobotModel
        The model before.
    joint, key : str
        Joint of the gear, and the dotted key of the gear in the model file.
    spring : str
        Kind of the spring.
    numbers : tuple of Number
        ``JOINT.spring.NAME``, with the names and units of the model file, and
        ``JOINT.hysteresis.lost_motion`` [rad or m at the joint], ``stiffness`` and ``exponent``,
        of several elements with ``_1``, ``_2``, ...
    status : FitStatus
    records : tuple of RecordOfSpring
        Errors and loops of the fitted records, then of those that were held out.
    laws : tuple of dict
        Exponent and gamma of the elements, where they are not Dahl's law.
    causes : tuple of str
        Effects of time that explain a misfit: creep, torques that were recorded late.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 20.0, 2001)
    >>> d = 1e-3 * np.sin(0.2 * np.pi * t)
    >>> record = {"time": t, "deflection": d, "torque": 4e4 * d + 1e9 * d**3}
    >>> found = flexgen.identify_spring(
    ...     "elbow", record, joint="q1", elements=0, spring="cubic"
    ... )
    >>> sorted(found.changes["element.upper.dof.q1.gear.spring"])
    ['cubic', 'stiffness', 'type']
    """

    robot: RobotModel
    joint: str
    key: str
    spring: str
    numbers: tuple[Number, ...]
    status: FitStatus = field()
    records: tuple[RecordOfSpring, ...]
    laws: tuple[Mapping[str, float], ...] = ()
    causes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<SpringFit {self.robot.title}: {self.sentence()}>"

    def __str__(self) -> str:
        """The figures as lines."""
        return lines_of(self.content())

    @property
    def problem(self) -> str:
        """Why the numbers cannot be used as they are."""
        if self.status.agrees:
            return ""
        named = "".join(f" Likely: {cause}." for cause in self.causes)
        return f"{self.status}: {' '.join(self.status.texts(TEXTS))}{named}"

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """All numbers, with standard deviations where the status is "fitted"."""
        stated = self.status is FitStatus.FITTED
        return tuple(
            FittedNumber(
                number.name,
                number.value,
                number.unit,
                number.sd if stated else None,
                is_determined=bool(number.determined),
            )
            for number in self.numbers
        )

    def sentence(self) -> str:
        """The result in words."""
        count = len(self.laws)
        loops = f" and {count} element{'s' * (count > 1)} of hysteresis" if count else ""
        words = f"{self.spring} spring{loops} of {self.joint}"
        return words if self.status is FitStatus.FITTED else f"{self.status}, {words}"

    @cached_property
    def changes(self) -> dict[str, Any]:
        """Dotted key of the model file -> value: the spring, where the record determines its
        stiffness, and the elements of hysteresis that it determines; for ``overrides`` and
        ``--set``.
        """
        spring: dict[str, Any] = {"type": self.spring}
        elements: list[dict[str, float]] = [dict(law) for law in self.laws]
        known = [True] * len(elements)
        is_stiff = True
        for number in self.numbers:
            key, name, n = number.change
            if key.endswith(".spring"):
                spring[name] = number.value
                is_stiff = is_stiff and (number.determined or name not in STIFFNESSES)
            else:
                elements[n][name] = number.value
                known[n] = known[n] and number.determined
        kept = [one for one, is_known in zip(elements, known, strict=True) if is_known]
        changes: dict[str, Any] = {f"{self.key}.spring": spring} if is_stiff else {}
        if kept:
            changes[f"{self.key}.hysteresis"] = kept[0] if len(kept) == 1 else kept
        return changes

    @property
    def model(self) -> RobotModel:
        """The model with the changes; the one before comes from a file."""
        changes = with_overrides(self.robot, self.changes)
        return read(self.robot.file, self.robot.variant or None, overrides=changes)

    def write(self, path: str | Path) -> Path:
        """Write the model file with the changes as a further variant ``identified``.

        Returns
        -------
        Path
            The file; the model is ``FILE@identified``.

        Raises
        ------
        ArgumentError
            The model has no ``.toml`` file, or one with this variant.
        """
        description = f"spring of {self.joint} identified from a locked test: {self.status}"
        return write_gears(path, self.robot, self.changes, description)

    def figures(self) -> tuple[Row, ...]:
        """The figures in SI units, for tables."""
        rows = [number.row() for number in self.fitted]
        unit = next(c.unit for c in self.robot.coordinates if c.name == self.joint)
        for one in self.records:
            kind = "fitted" if one.is_fitted else "held out"
            rows.append(Row(f"{one.name}, {kind}: error over range of torques", one.error))
            if one.width is not None and one.width_of_model is not None:
                rows.append(Row(f"{one.name}: width of the loop", one.width, unit))
                rows.append(Row(f"{one.name}: that of the law", one.width_of_model, unit))
        return tuple(rows)

    def content(self) -> tuple[Part, ...]:
        """The numbers, the errors of the records, and the changes of the model as data."""
        data = ("values", "sd", "changes", "status", "causes")
        records = [
            {
                "name": one.name,
                "is_fitted": one.is_fitted,
                "error": one.error,
                "width": one.width,
                "width_of_model": one.width_of_model,
            }
            for one in self.records
        ]
        return (
            Prose(f"{self.robot.title}: {self.sentence()}", is_title=True),
            Data("model", self.robot.title),
            *self.figures(),
            *(Prose(cause) for cause in self.causes),
            *(Data(name, getattr(self, name)) for name in data),
            Data("records", records),
        )
