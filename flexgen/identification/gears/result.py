"""Result of `flexgen.identify_gears`: numbers of gears with standard deviations, and the model
that has them.
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
from flexgen.base.spec.variants import with_variant
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.status import FitStatus
from flexgen.model.elements import RobotModel
from flexgen.model.new_file import text_of_model, with_overrides, write_model_text
from flexgen.model.reader import read

WEAK = 0.5  # standard deviation over a number, above which the record does not determine it
VARIANT = "identified"
LACKING = (
    "Hysteresis of another shape fits the record better, with another lost motion: {}. Fit one "
    "element more, or exponents. Standard deviations are not given: the errors may be many "
    "times those that noise causes."
)


# Where sentence and advice are not those of measured responses.
TEXTS = {
    FitStatus.MODEL_ERROR: (
        "The model differs from the record by more than the noise.",
        "Look at the loops of the picture: a wrong mass or payload, a missing spring, another "
        "friction, hysteresis or transmission error. Standard deviations are not given: the "
        "errors may be many times those that noise causes.",
    ),
    FitStatus.NOT_CONVERGED: (
        "The search for the best numbers did not come to an end.",
        (
            "Do not use the numbers; begin with a model that is nearer to the robot, or fit "
            "fewer numbers."
        ),
    ),
    FitStatus.NOISE_TOO_LARGE: (
        "The model agrees with the record below a part of the frequencies only, or but for "
        "large standard deviations: noise of the angles hides a gear, or an error of the model.",
        "Do not use the numbers; record a longer or a larger motion, or angles with less noise.",
    ),
}


@dataclass(frozen=True)
class Number:
    """A number that was identified: ``value`` and standard deviation ``sd``; ``change``: where the
    model has it.

    ``change``: dotted key of the model file, the key in its table or an empty text, and the index
    in its list or -1; no dotted key: a sum. ``determined``: by itself, or as an amplitude or a sum
    together with others.
    """

    name: str
    value: float
    sd: float
    unit: str
    change: tuple[str, str, int]
    determined: bool


def write_gears(
    path: str | Path,
    robot: RobotModel,
    changes: Mapping[str, Any],
    description: str,
    dry: bool = False,
) -> Path:
    """Write the model file with the changes as a further variant `VARIANT`; ``dry``: only check.

    Raises
    ------
    ArgumentError
        The model has no file, or one with this variant.
    """
    text, folder = text_of_model(robot.file)
    sets = with_overrides(robot, changes)
    new = with_variant(text, Path(robot.file).name, VARIANT, sets, description, robot.variant)
    return write_model_text(path, new, folder, VARIANT, dry=dry)


@provides("GearFit.check_file")
def check_file(path: str | Path, robot: RobotModel) -> None:
    """Check before a fit that `GearFit.save` can write the new model file; errors as there."""
    write_gears(path, robot, {}, "check", dry=True)


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class GearFit(FitResult):
    """Hysteresis and transmission errors of gears, identified from motor angles and torques.

    Attributes
    ----------
    robot : RobotModel
        The model before.
    numbers : tuple of Number
        Names: of parameters of the model, and ``JOINT.hysteresis.lost_motion`` [rad or m at the
        joint], ``JOINT.hysteresis.stiffness`` [N m/rad, side of the spring] and
        ``JOINT.hysteresis.exponent``, of several elements the sums and with ``_1``, ``_2``, ...
        each, ``JOINT.transmission_error.cos_K`` and ``sin_K`` of the harmonic K [rad or m at the
        joint], ``MOTOR.cogging.cos_K`` and ``sin_K`` [N m].
    status : FitStatus
    unexplained, noise : arrays (n_m,) [N m]
        Root mean square of measured minus computed torques in the band, and the part of it that
        noise explains.
    band_hz : float [Hz]
        Frequencies that were compared.
    delay_s : float [s]
        Time by which torques were recorded later than angles.
    joints : tuple of str (k,)
        Joints of the loops.
    loops : array (n, k, 3)
        Deflections, torques z of the hysteresis, and these with what is unexplained, arm side.
    harmonics, cogging : tuples of int
        Of the transmission errors, and of the cogging.
    laws : dict
        Dotted key of a hysteresis -> exponent and gamma of its elements, where they are not Dahl's
        law.
    lacking : tuple of str
        Joints for which the record shows a further element of hysteresis, with another lost
        motion.
    notes : tuple of str
        What was done to the record, as sentences.

    Examples
    --------
    >>> cogging = {"motor.m1.cogging": {"harmonics": [6], "sin": [0.03]}}  # N m
    >>> record = flexgen.control(
    ...     flexgen.read("elbow", overrides=cogging), sample_time=1e-3
    ... ).trajectory()
    >>> found = flexgen.identify_gears("elbow", record, hysteresis=False, cogging=[6], free=[])
    >>> (
    ...     found.changes["motor.m1.cogging"]["harmonics"],
    ...     f"{found.values['m1.cogging.sin_6']:.3f} N m",
    ... )
    ([6], '0.030 N m')
    """

    robot: RobotModel
    numbers: tuple[Number, ...]
    status: FitStatus = field()
    unexplained: np.ndarray
    noise: np.ndarray
    band_hz: float
    delay_s: float
    joints: tuple[str, ...]
    loops: np.ndarray
    harmonics: tuple[int, ...] = ()
    cogging: tuple[int, ...] = ()
    laws: Mapping[str, tuple[dict[str, float], ...]] = field(default_factory=dict)
    lacking: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<GearFit {self.robot.title}: {self.sentence()}>"

    def __str__(self) -> str:
        """The figures as lines."""
        return lines_of(self.content())

    @property
    def problem(self) -> str:
        """Why the numbers cannot be used as they are."""
        if self.lacking:
            return f"{self.status}: {LACKING.format(', '.join(self.lacking))}"
        if self.status is FitStatus.FITTED:
            return ""
        return f"{self.status}: {' '.join(self.status.texts(TEXTS))}"

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

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """Sentences on joints of which the record shows an element of hysteresis more."""
        return tuple(
            f"hysteresis of {joint} has an element more, with another lost motion"
            for joint in self.lacking
        )

    def sentence(self) -> str:
        """The result in words."""
        found = list(
            dict.fromkeys(
                n.name.rpartition(".")[0] for n in self.numbers if n.determined and n.change[1]
            )
        )
        words = (
            ", ".join(name.replace("_", " ") for name in found)
            or "nothing that the record determines"
        )
        return words if self.status is FitStatus.FITTED else f"{self.status}, {words}"

    @cached_property
    def changes(self) -> dict[str, Any]:
        """Dotted key of the model file -> value, of what the record determines; for ``overrides``
        and ``--set``.
        """
        changes: dict[str, Any] = {}
        for number in self.numbers:
            key, name, index = number.change
            if not number.determined or not key:
                continue
            if not name:
                changes[key] = number.value
            elif key in self.laws:
                changes.setdefault(key, [dict(law) for law in self.laws[key]])[index][name] = (
                    number.value
                )
            else:
                orders = list(self.cogging if key.startswith("motor.") else self.harmonics)
                empty = {
                    "harmonics": orders,
                    "cos": [0.0] * len(orders),
                    "sin": [0.0] * len(orders),
                }
                changes.setdefault(key, empty)[name][index] = number.value
        alone = {key: changes[key][0] for key in self.laws if len(changes.get(key, ())) == 1}
        return changes | alone

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
        description = f"gears identified from motor angles and torques: {self.status}"
        return write_gears(path, self.robot, self.changes, description)

    def figures(self) -> tuple[Row, ...]:
        """The figures in SI units, for tables."""
        worst = int(np.argmax(self.unexplained / self.noise))
        left = float(self.unexplained[worst])
        return (
            *(number.row() for number in self.fitted),
            Row("unexplained torque, root mean square", left, "N m"),
            Row("noise in it", float(self.noise[worst]), "N m"),
            Row("compared up to", self.band_hz, "Hz", "band_hz"),
            Row("torques recorded late by", self.delay_s, "s", "delay_s"),
        )

    def content(self) -> tuple[Part, ...]:
        """The numbers, what is unexplained, and the changes of the model as data."""
        data = ("values", "sd", "changes", "status", "unexplained", "noise")
        return (
            Prose(f"{self.robot.title}: {self.sentence()}", is_title=True),
            Data("model", self.robot.title),
            *self.figures(),
            *(Prose(f"record: {note}") for note in self.notes),
            *(Data(name, getattr(self, name)) for name in data),
        )
