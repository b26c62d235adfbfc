"""Result of an identification: values with standard deviations, a status, weak directions, and the
new model file.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.calls.deprecation import warn_of_old
from flexgen.base.calls.progress import Choice
from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.registry import find_function, provides
from flexgen.base.rows import Part
from flexgen.base.spec.number_edit import with_numbers
from flexgen.base.spec.variants import with_variant
from flexgen.dynamics.mechanics.parameters import Parameter, names_of_numbers, select, with_values
from flexgen.feedback.loop.robustness import ControlName
from flexgen.identification.causes.explain import Cause
from flexgen.identification.causes.levels import AmplitudeTest
from flexgen.identification.estimator.fit_grade import Grade
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.status import FitStatus as FitStatus
from flexgen.identification.responses.content import (
    content_of_responses,
    deviation_text,
)
from flexgen.identification.responses.frequency_response import Frf
from flexgen.identification.responses.parameters import (
    SENSOR_DELAY,
    ParameterVector,
    is_of_drive,
    is_of_sensor,
    sensor_delays,
    with_sensor_delays,
)
from flexgen.model.elements import RobotModel
from flexgen.model.new_file import text_of_model, with_overrides, write_model_text
from flexgen.model.urdf.overlay_keys import has_table, overlay_key

WEAK = 0.5  # standard deviation of a logarithm above which the model keeps the value of its file
TIME_DOMAIN = "time domain"  # weights of a result of `refine`
# Sentence and advice on stiffnesses from responses with friction.
NO_LOAD = (
    "The model has Coulomb friction, which responses show as damping only: stiffnesses are those "
    "of gears at small torques, and gears that stiffen are softer there than under load.",
    "Find stiffnesses under load from loaded poses (calibrate), from a tracker along motions, or "
    "from all records at once (commission).",
)
# Name of the variant of an overlay that sets identified numbers for which the overlay has no key.
IDENTIFIED = "identified"


def with_coulomb(model: RobotModel) -> tuple[str, ...]:
    """Names of the viscous frictions of motors and joints whose friction has a Coulomb or Stribeck
    part too.
    """
    parts = [(motor.name, motor.friction) for motor in model.motors]
    parts += [(c.name, c.dof.friction) for c in model.coordinates if c.dof is not None]
    steps = ("coulomb", "stribeck", "load_coulomb", "load_stribeck")
    return tuple(
        f"{name}.viscous" for name, law in parts if any(getattr(law, step, 0.0) for step in steps)
    )


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class Estimated(FitResult):
    """Estimated parameters of a model.

    Parameters
    ----------
    vector : ParameterVector
    x : array (n,)
    formal_covariance : array (n, n)
        Of x, of logarithms for parameters with the scale "log", if the residuals are random: the
        accuracy of the parameters only where `covariance` is not None. It shows which directions
        the data determine.
    status : FitStatus
    """

    vector: ParameterVector
    x: np.ndarray
    formal_covariance: np.ndarray
    status: FitStatus = field()
    source: str = field(default="", kw_only=True)  # of the data, for the new model file
    # of sensors, by an earlier fit
    found_delays: Mapping[str, float] = field(default_factory=dict, kw_only=True)

    @property
    def problem(self) -> str:
        """Why the numbers cannot be used; empty where the model agrees with the measurement."""
        return "" if self.status.agrees else f"{self.status}: {self.status.sentence}"

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """The parameters, SI units, on the side where the model file states the number.

        Standard deviations are relative for parameters with the scale "log"; None where
        `covariance` is: under a model error the true errors are many times as large.
        """
        values = self.vector.values(self.x).tolist()
        deviations: list[float | None] = [None] * len(values)
        if self.status.has_deviations:
            deviations = np.sqrt(np.diag(self.formal_covariance)).tolist()
        return tuple(
            FittedNumber(
                u.name,
                value,
                u.parameter.unit,
                sd,
                is_relative=u.scale == "log",
                is_determined=not self.is_weak(u.name),
            )
            for u, value, sd in zip(self.vector.unknowns, values, deviations, strict=True)
        )

    @property
    def covariance(self) -> np.ndarray | None:
        """Covariance (n, n) of x; None where the status says that the residuals do not show the
        accuracy.
        """
        return self.formal_covariance if self.status.has_deviations else None

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of x (n, n), of the formal covariance."""
        sd = np.sqrt(np.diag(self.formal_covariance))
        return self.formal_covariance / np.outer(sd, sd)

    def is_weak(self, name: str) -> bool:
        """Whether the data do not determine a parameter: the model keeps the value of its file."""
        if name not in self.vector.names:
            raise ArgumentError(
                f"name: given {show_value(name)}, expected one of {', '.join(self.vector.names)}"
            )
        k = self.vector.names.index(name)
        return self.vector.unknowns[k].scale == "log" and bool(
            self.formal_covariance[k, k] > WEAK**2
        )

    def used(self) -> dict[str, float]:
        """Name -> value of the numbers of the model that change: without weak ones and those of
        the drives.
        """
        named = self.vector.named(self.x)
        out = {}
        for unknown in self.vector.unknowns:
            if not self.is_weak(unknown.name):
                out.update(
                    {
                        name: named[name]
                        for name in (unknown.name, *unknown.tied)
                        if not is_of_drive(name)
                    }
                )
        return out

    @property
    def sensor_delays(self) -> dict[str, float]:
        """``<sensor>.delay`` -> identified delay of a sensor [s]."""
        return dict(self.found_delays) | {
            name: x for name, x in self.values.items() if is_of_sensor(name)
        }

    @property
    def model(self) -> RobotModel:
        """The model with the identified values; weak parameters as they were."""
        return with_sensor_delays(with_values(self.vector.model, self.used()), self.sensor_delays)

    def write(self, path: str | Path, model_file: str | Path | None = None) -> Path:
        """Write the new model file: the text of the old one with other numbers, and their standard
        deviations.

        They and the correlations are also in its table ``[uncertainty]``, see `flexgen.predict`.

        Parameters
        ----------
        path : str or Path
        model_file : str or Path, optional
            The old file; default: that of the model.

        Raises
        ------
        ArgumentError, ModelError
            See `write_model`.
        """
        note = "" if self.status.has_deviations else f"{self.status}, no standard deviations"
        sd = {name: value for name, value in self.sd.items() if value is not None}
        values = self.used() | self.sensor_delays
        words = FileWords(self.source, self._mark, note, self._with_uncertainty)
        return write_model(path, self.vector.model, values, sd, words, model_file)

    @property
    def _mark(self) -> str:
        """Comment at the begin of a file with numbers of a fit that does not agree; else empty."""
        if self.status.agrees or self.status.has_deviations:
            return ""
        lines = [f"Status: {self.status}.", self.status.sentence, *self.load_note]
        return "".join(f"# {line}\n" for line in lines if line)

    @property
    def load_note(self) -> tuple[str, str]:
        """Sentence and advice on the load of stiffnesses; empty where there are none to make."""
        return "", ""

    def _with_uncertainty(self, text: str) -> str:
        """The text of the new model file with the table ``[uncertainty]``."""
        if self.covariance is None:
            return text
        names, covariance = self._relative_covariance(self.covariance)
        if not names:
            return text
        return str(find_function("Estimated.uncertainty")(text, names, covariance))

    def _relative_covariance(self, covariance: np.ndarray) -> tuple[list[str], np.ndarray]:
        """Names of the numbers of the model, tied ones too, and the covariance of their relative
        errors.
        """
        named = self.vector.named(self.x)
        found = []
        for k, unknown in enumerate(self.vector.unknowns):
            for name in (unknown.name, *unknown.tied):
                if not is_of_drive(name) and named[name] != 0.0:
                    found.append(
                        (name, k, 1.0 if unknown.scale == "log" else 1.0 / named[unknown.name])
                    )
        order = [k for _, k, _ in found]
        slopes = np.array([slope for *_, slope in found])
        return [name for name, *_ in found], covariance[np.ix_(order, order)] * np.outer(
            slopes, slopes
        )


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class IdentificationResult(Estimated):
    """Parameters identified from an experiment; see also `Estimated`.

    Parameters
    ----------
    cost : float
        Mean square of the weighted residuals, for one degree of freedom: 1 where model and noise
        are right.
    model_error : float
        Median part of ``|G|`` that the model does not explain; 0 where noise explains the
        residuals.
    starts, agreed : int
        Searches from different start values, and those that ended at the best cost.
    iterations : int
        Of the best search.
    at_bound : tuple of str
    weak : tuple of str
        Sentences on directions that the data do not determine.
    data : Frf
        The measured responses.
    variance : array (k, lines, n_m, n_m)
        Of the elements of the responses: noise and model error.
    deflection_sd : array (k, springs)
        Standard deviations of the deflections of springs that are not linear, over which they were
        averaged.
    weights : str
        ``"structured"``, ``"nls"``, ``"lls"`` or ``"time domain"``.
    wall_s : float [s]
    causes : tuple of Cause
        Faults of the model or the record of which one explains most of the misfit, the best first;
        see the module `flexgen.identification.causes.explain`. Empty where the model fits, and
        where no single one explains it.
    amplitude : AmplitudeTest or None
        Whether the responses depend on the level of the excitation, where they were given at
        several.
    held_out : tuple of float
        Part of each of the responses that were not fitted which neither model nor noise explains.
    grade : Grade or None
        Misfit by element and band, and whether the model is good enough for feedforward; None
        after `refine`.

    Examples
    --------
    >>> responses = flexgen.frf(
    ...     flexgen.measure(flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10))
    ... )
    >>> found = flexgen.identify("elbow", responses, starts=1)
    >>> f"{found.values['q1.stiffness']:.2e} N m/rad", found.weak
    ('7.52e+06 N m/rad', ())
    """

    cost: float
    model_error: float
    starts: int
    agreed: int
    iterations: int
    at_bound: tuple[str, ...]
    weak: tuple[str, ...] = field()
    data: Frf
    variance: np.ndarray
    deflection_sd: np.ndarray
    weights: str
    wall_s: float
    causes: tuple[Cause, ...] = field(default=(), kw_only=True)
    amplitude: AmplitudeTest | None = field(default=None, kw_only=True)
    held_out: tuple[float, ...] = field(default=(), kw_only=True)
    grade: Grade | None = field(default=None, kw_only=True)

    def __repr__(self) -> str:
        return (
            f"<IdentificationResult {self.vector.model.name}: {self.status}, {len(self.vector)} "
            f"parameters, cost {self.cost:.3g}, {self.agreed} of {self.starts} starts>"
        )

    def is_weak(self, name: str) -> bool:
        """Whether the data do not determine a parameter: the model keeps the value of its file.

        By its standard deviation, or because frequency responses show the mean slope of a friction
        law only: the viscous friction, fitted together with Coulomb friction, absorbs the errors
        of the latter.
        """
        hidden = self.weights != TIME_DOMAIN and name in with_coulomb(self.vector.model)
        return hidden or super().is_weak(name)

    @property
    def load_note(self) -> tuple[str, str]:
        """Sentence and advice on stiffnesses of a robot with friction; empty where the status has
        none to make.

        A motor with Coulomb friction passes little of its torque to the gear, and the responses
        are those of gears under small torques. A gear that stiffens is softer there than under
        load.
        """
        if self.status is not FitStatus.MODEL_ERROR or self.weights == TIME_DOMAIN:
            return "", ""
        stiff = [name for name in self.used() if name.endswith(".stiffness")]
        if not stiff or not with_coulomb(self.vector.model):
            return "", ""
        return NO_LOAD

    def figures(self) -> dict[str, Any]:
        """The former name of `to_dict`."""
        warn_of_old("IdentificationResult: given figures(), expected its new name, to_dict()")
        return self.to_dict()

    def content(self) -> tuple[Part, ...]:
        """Status and misfit, the parameters, and the bands of the misfit."""
        return content_of_responses(self)

    def verdict(
        self,
        move: Any = None,
        *,
        truth: Any = None,
        samples: int = 10,
        control: ControlName = "feedback",
        progress: Choice = None,
    ) -> Any:
        """Tool errors of feedforward with this model; see
        `flexgen.identification.responses.verdict.verdict`.
        """
        return find_function("IdentificationResult.verdict")(
            self, move, truth=truth, samples=samples, control=control, progress=progress
        )


@dataclass(frozen=True)
class FileWords:
    """Texts of a new model file.

    ``source``: of the data; ``head``: lines of comments for the beginning; ``note``: first line,
    instead of the place of the standard deviations; ``finish``: changes the text, not where the
    numbers are in a variant.
    """

    source: str
    head: str = ""
    note: str = ""
    finish: Callable[[str], str] = str


def write_model(
    path: str | Path,
    model: RobotModel,
    values: Mapping[str, float],
    sd: Mapping[str, float | str],
    words: FileWords,
    model_file: str | Path | None = None,
    dry: bool = False,
) -> Path:
    """Write a model file: the text of the old one with the values of some parameters and their
    standard deviations.

    Relative paths in the file, of samples and of a URDF file, lead to the same files from the new
    folder. The numbers of an overlay are those that it states; where it has no key for one, all of
    them are in its variant `IDENTIFIED`. The numbers of a model that was read with overrides are
    in this variant too, with the overrides.

    Parameters
    ----------
    path : str or Path
    model : RobotModel
    values, sd : mappings
        By the names of parameters; deviations may be missing; those that are texts are written as
        they are.
    words : FileWords
    model_file : str or Path, optional
        The old file; default: that of the model.
    dry : bool
        Write nothing: check before a fit, with any values, that its numbers can be written.

    Raises
    ------
    ArgumentError
        The model is not from a file.
    ModelError
        The numbers cannot be written there, because a variant sets them.
    """
    file = str(model_file or model.file)
    old, folder = text_of_model(file)
    variant = model.variant or None

    def check(again: RobotModel) -> None:
        for parameter in _numbers(again, values):
            if parameter.value != values[parameter.name]:
                raise ModelError(
                    file, 0, parameter.key,
                    f"a number that the variant {model.variant!r} sets to another one",
                    "a model without variant, or a variant that leaves the identified numbers "
                    "alone",
                )  # fmt: skip

    def write(text: str, chosen: str | None) -> Path:
        return write_model_text(path, text, folder, chosen, check, dry)

    overlay = tomllib.loads(old)
    if model.overrides or model.not_measured:  # the variant states which of these are measured
        numbers = {p.key: values[p.name] for p in _numbers(model, values)}
        return write(_as_variant(old, file, model, numbers, words), IDENTIFIED)
    given = (model, values, sd, words.source, file, words.note)
    if "urdf" not in overlay:
        text = words.head + write_parameters(old, *given)
        return write(words.finish(text), variant)
    numbers = {p.key: values[p.name] for p in _numbers(model, values)}
    own = {key: overlay_key(overlay, model, key) for key in numbers}
    try:
        if not all(has_table(overlay, key) for key in own.values()):
            raise ModelError(file, 0, "urdf", "a number without a table", "a table for each")
        text = words.head + write_parameters(old, *given, key_of=own.__getitem__)
        return write(words.finish(text), variant)
    except ModelError:  # also of a number of the overlay that is that of several links
        return write(_as_variant(old, file, model, numbers, words), IDENTIFIED)


def _as_variant(
    old: str, file: str, model: RobotModel, numbers: Mapping[str, float], words: FileWords
) -> str:
    """The text of a model file with numbers, and the overrides of the model, as its variant."""
    line = f"identified parameters ({_one_line(words.source)}); {words.note}".rstrip("; ")
    changes = with_overrides(model, whole_lists(model, numbers))
    return words.head + with_variant(old, file, IDENTIFIED, changes, line, model.variant)


def whole_lists(model: RobotModel, numbers: Mapping[str, float]) -> dict[str, Any]:
    """The numbers by key; those of a list, such as a center of mass, as this list.

    A variant has no key for one number of a list.
    """
    single = {key: x for key, x in numbers.items() if not key.rpartition(".")[2].isdecimal()}
    stems = {key.rpartition(".")[0] for key in numbers if key not in single}
    lists: dict[str, list[float]] = {}
    for parameter in select(model, names_of_numbers(model)) if stems else ():
        stem = parameter.key.rpartition(".")[0]
        if stem in stems:
            value = numbers.get(parameter.key, parameter.value)
            lists.setdefault(stem, []).append(float(value))
    return single | lists


@provides("Estimated.check_file")
def check_file(path: str | Path, model: RobotModel, names: Iterable[str] = ()) -> None:
    """Check before a fit that `Estimated.write` can write numbers into a new model file.

    Errors as there. ``names``: of the numbers that are fitted, as far as they are those of the
    model.
    """
    values = {p.name: p.value for p in select(model, list(names))} if names else {}
    write_model(path, model, values, {}, FileWords("check"), dry=True)


def write_parameters(
    text: str,
    model: RobotModel,
    values: Mapping[str, float],
    sd: Mapping[str, float | str],
    source: str,
    file: str,
    note: str = "",
    key_of: Callable[[str], str] = str,
) -> str:
    """The text of a model file with the values of some parameters, each with a comment on its
    accuracy.

    Comments of an earlier identification on the same parameters are removed: they are of the old
    values. ``key_of``: the key in the file from that of the parameter.
    """
    chosen = _numbers(model, values)
    numbers = {key_of(p.key): values[p.name] for p in chosen}
    notes = {
        key_of(p.key): f"{p.name}: sd {_percent(sd[p.name], p.name)}"
        for p in chosen
        if p.name in sd
    }
    accuracy = note or "each has its standard deviation in a comment"
    head = f"# Identified parameters ({_one_line(source)}): {accuracy}.\n"
    return head + with_numbers(
        _without_notes(text, {p.name for p in chosen}), numbers, file, notes
    )


def _one_line(source: str) -> str:
    """The source of data as a part of one line of a comment."""
    return "".join(x if x.isprintable() else "?" for x in source)[:200] or "measurement"


def _numbers(model: RobotModel, names: Iterable[str]) -> list[Parameter]:
    """The numbers of the model with these names, and the delays of its sensors."""
    late = [name for name in names if is_of_sensor(name)]
    return [
        *select(model, sorted(set(names) - set(late))),
        *(p for name in late for p in sensor_delays(model, name)),
    ]


def _without_notes(text: str, names: set[str]) -> str:
    """The text without comments of an earlier identification on these parameters."""

    def keep(found: re.Match[str]) -> str:
        notes = [note for note in found[1].split("; ") if note.partition(": sd ")[0] not in names]
        return f"  # {'; '.join(notes)}" if notes else ""

    return re.sub(
        r"  # ((?:[^\s:;#]+: sd [^\s;#]+(?: %)?(?:; |$))+)$", keep, text, flags=re.MULTILINE
    )


def _percent(sd: float | str, name: str) -> str:
    if isinstance(sd, str):
        return sd
    signed = ".com_" in name or name.endswith((".offset", SENSOR_DELAY))
    return deviation_text(sd, not signed)
