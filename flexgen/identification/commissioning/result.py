"""`Commissioning`: the result of a joint fit, and the model file that it writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flexgen.base.checks.type_checks import checked_result
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.base.rows import Column, Data, Part, Prose, Row, Shown, Table
from flexgen.base.spec.variants import with_variant
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.commissioning.joint_fit import JointFit
from flexgen.identification.commissioning.unknowns import COULOMB_WIDTH, linear_geometry
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.score import Limit
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.poses.model_file import changes_of
from flexgen.identification.poses.statics import Numbers
from flexgen.identification.poses.tree import Tree
from flexgen.identification.responses.result import whole_lists
from flexgen.identification.rigid.payload_test import NOT_TESTED, PayloadTest
from flexgen.model.elements import RobotModel, SmoothSpring
from flexgen.model.new_file import text_of_model, with_overrides, write_model_text
from flexgen.model.reader import read

VARIANT = "commissioned"
LARGEST_SD = 5.0  # relative, of the table [uncertainty]
# Change of a number over the deviation of its prior, from which on it is named.
FAR = 3.0
# Change of a number, relative, below which the file has it already.
SAME = 1e-9
# Ends of keys of springs, which are not those of the geometry.
SPRING_KEYS = (".spring", ".stiffness")
# A record that would determine a number, by its kind.
ADVICE = {
    "damping": "frequency responses at two or more poses",
    "stiffness": "static poses with another load, or a tracked motion that accelerates this axis",
    "low": "frequency responses at two levels of excitation, or poses where this gear has no load",
    "high": "static poses with the largest load on this gear",
    "break_at": "frequency responses at three levels of excitation",
    "viscous": "a tracked motion in which this joint moves fast",
    "coulomb": "a tracked motion in which this joint turns back often",
    "mass": "a motion of the axes before this body, far and fast",
    "com": "a motion in which this body turns against gravity",
    "inertia": "a fast motion of the axes before this body",
    "zero": "static poses over the whole range of this joint",
    "length": "static poses over the whole range of all joints",
}


@dataclass(frozen=True)
class HeldOut:
    """Root mean square of the errors of one channel on parts of a record that were not fitted, in
    ``unit``: with the model of the file, with the fitted one, and of positions with a rigid robot.
    """

    record: str
    channel: str
    unit: str
    before: float
    after: float
    rigid: float | None = None


@checked_result
@dataclass(frozen=True, eq=False, repr=False)
class Commissioning(FitResult):
    """A model of a robot, fitted to all of its records.

    Parameters
    ----------
    before : RobotModel
        Of the datasheet.
    form : RobotModel
        The same, where gears were given a curve with springs that have one.
    fit : JointFit
    status : FitStatus
        ``poorly validated``: the model is not written, `problem` has the reason.
    problems : tuple of str
        Reasons why the model is refused.
    held_out : tuple of HeldOut
        Errors on parts of the records that were not fitted.
    records : mapping
        Kind -> names of the records.
    notes : tuple of str
        What was done to the records, as sentences.
    wall_s : float [s]
    misfit : float or None
        Errors of positions on these parts over their elastic displacement; None: there is none.
    payload : PayloadTest
        Whether the torques contradict the payload of the file.
    quicker : tuple of str
        Moves of the file that accelerate more than all records with a tracker, as sentences.

    Examples
    --------
    >>> from pathlib import Path
    >>> Path("lab").mkdir()
    >>> softer = {"element.upper.dof.q1.gear.spring.stiffness": 5e6}  # file: 7.5e6 N m/rad
    >>> run = flexgen.control(flexgen.read("elbow", overrides=softer), sample_time=1e-3)
    >>> _ = run.trajectory().save("lab/move.csv")
    >>> found = flexgen.commission("elbow", "lab")
    >>> found.write("new.toml").name
    'new.toml'
    """

    before: RobotModel
    form: RobotModel
    fit: JointFit
    status: FitStatus = field()
    problems: tuple[str, ...]
    held_out: tuple[HeldOut, ...]
    records: Mapping[str, list[str]]
    notes: tuple[str, ...]
    wall_s: float
    misfit: float | None = None
    payload: PayloadTest = NOT_TESTED
    quicker: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Robot, status and records, in one line."""
        kinds = ", ".join(f"{len(names)} {kind}" for kind, names in self.records.items() if names)
        return f"<Commissioning {self.before.name}: {self.status}, {kinds}>"

    @property
    def problem(self) -> str:
        """Why the model is refused or not at its best; empty: use it."""
        if self.problems:
            return f"{self.status}: " + "; ".join(self.problems)
        usable = self.status in (FitStatus.FITTED, FitStatus.NOT_CHECKED)
        return "" if usable else f"{self.status}: {self.status.sentence}"

    @property
    def _chosen(self) -> list[int]:
        """Indices of the numbers that are the robot's: model, zeros, lengths, friction."""
        parts = self.fit.unknowns.parts
        own = (parts.model, parts.zeros, parts.lengths, parts.friction)
        return [int(k) for part in own for k in parts.entries(part)]

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """All numbers of the robot, SI units. Those that are not determined alone have the
        deviation of their prior.
        """
        unknowns = self.fit.unknowns
        vector = unknowns.vector
        values = unknowns.values(self.fit.written)
        out = []
        for k in self._chosen:
            name = unknowns.names[k]
            known = bool(self.fit.determined[k])
            sd = float(self.fit.sd[k])
            if k < unknowns.parts.model.stop:
                own = vector.unknowns[k]
                out.append(
                    FittedNumber(
                        name, float(values[k]), own.parameter.unit, sd, own.scale == "log", known
                    )
                )
                continue
            out.append(
                FittedNumber(
                    name, float(self.fit.written[k]), self._unit_of(name), sd, is_determined=known
                )
            )
        return tuple(out)

    def _unit_of(self, name: str) -> str:
        """Unit of a zero, a length or a friction."""
        kind = name.rpartition(".")[2]
        if kind == "viscous":
            return "N m s/rad"
        if kind in ("coulomb", "offset"):
            return "N m"
        units = {unknown.name: unknown.unit for unknown in self.fit.unknowns.places}
        return units.get(name, "rad")

    @cached_property
    def far(self) -> tuple[str, ...]:
        """Sentences on numbers that changed by many tolerances of the datasheet."""
        unknowns = self.fit.unknowns
        out = []
        for k in self._chosen:
            if unknowns.parts.friction.start <= k < unknowns.parts.friction.stop:
                continue
            change = (self.fit.written[k] - unknowns.start[k]) / unknowns.sd[k]
            if abs(change) > FAR:
                out.append(
                    f"{unknowns.names[k]} changed by {abs(change):.1f} tolerances of the "
                    "datasheet: check this number, and the records"
                )
        return tuple(out)

    @property
    def missing(self) -> tuple[str, ...]:
        """Sentences on numbers that the records do not determine, with a record that would."""
        groups: dict[str, list[str]] = {}
        for number in self.fitted:
            if number.is_determined:
                continue
            kind = number.name.rpartition(".")[2]
            key = kind if kind in ADVICE else kind.split("_")[0]
            key = key if key in ADVICE else "length"
            groups.setdefault(key, []).append(number.name)
        return tuple(
            f"not determined: {', '.join(names)}; record {ADVICE[key]}"
            for key, names in groups.items()
        )

    @property
    def weak(self) -> tuple[str, ...]:
        """As `missing`: the file keeps these numbers, but for what they share with others."""
        return self.missing

    @property
    def _frictions(self) -> dict[str, Any]:
        """Keys of the frictions of motors and their values: those of the file plus the changes."""
        unknowns = self.fit.unknowns
        part = unknowns.parts.friction
        found = self.fit.written[part].reshape(-1, 3)
        out: dict[str, Any] = {}
        for motor, has, (viscous, coulomb, _) in zip(
            self.before.motors, unknowns.has_friction, found.tolist(), strict=False
        ):
            if not has:
                continue
            key = f"motor.{motor.name}.friction"
            law = motor.friction
            new_viscous = max(0.0, getattr(law, "viscous", 0.0) + viscous)
            new_coulomb = max(0.0, getattr(law, "coulomb", 0.0) + coulomb)
            out[f"{key}.viscous"] = new_viscous
            if new_coulomb > 0.0:
                out[f"{key}.coulomb"] = new_coulomb
                out[f"{key}.beta"] = getattr(law, "beta", 0.0) or self._beta(motor.name)
        return out

    def _beta(self, motor: str) -> float:
        """Steepness of a Coulomb friction [s/rad] that the file does not have."""
        index = [m.name for m in self.before.motors].index(motor)
        top = self.fit.top_speeds[index] if len(self.fit.top_speeds) else 1.0
        return 1.0 / max(COULOMB_WIDTH * top, 1e-9)

    @property
    def changes(self) -> dict[str, Any]:
        """Keys of the model file with their new values."""
        unknowns = self.fit.unknowns
        named = unknowns.vector.named(self.fit.written[unknowns.parts.model])
        chosen = select(self.form, list(named))
        numbers = {
            p.key: named[p.name]
            for p in chosen
            if abs(named[p.name] - p.value) > SAME * max(abs(p.value), 1e-12)
        }
        curves = self._curves(named)
        inside = tuple(f"{key}." for key in (*curves, *self._joint_frictions(named)))
        single = {key: x for key, x in numbers.items() if not key.startswith(inside or (" ",))}
        out = dict(whole_lists(with_values(self.form, named), single))
        return out | curves | self._frictions | self._joint_frictions(named) | self._places

    @property
    def _places(self) -> dict[str, Any]:
        """Keys of the places of elements that zeros and lengths change."""
        unknowns = self.fit.unknowns
        if not unknowns.places:
            return {}
        written = dict(zip(unknowns.names, self.fit.written.tolist(), strict=True))
        geometry = linear_geometry(self.before)
        values = [written[unknown.name] for unknown in unknowns.places]
        moved = Numbers.of(Tree(geometry), unknowns.places, values)
        found = changes_of(geometry, moved)
        return {key: x for key, x in found.items() if not key.endswith(SPRING_KEYS)}

    @property
    def model(self) -> RobotModel:
        """The commissioned model, with its table ``[uncertainty]``.

        Raises
        ------
        ArgumentError
            The model of the datasheet is not from a file.
        """
        if not self.before.file:
            raise ArgumentError(
                "commission: given a model without a file, expected one that was read from a "
                ".toml file"
            )
        changes = with_overrides(self.before, self.changes | self._uncertainty)
        return read(self.before.file, self.before.variant or None, overrides=changes)

    def _curves(self, named: Mapping[str, float]) -> dict[str, Any]:
        """Springs of gears that have a curve in place of one stiffness, as whole tables."""
        out: dict[str, Any] = {}
        fitted = with_values(self.form, dict(named))
        for old, new in zip(self.before.elements, fitted.elements, strict=True):
            for was, dof in zip(old.dofs, new.dofs, strict=True):
                if was.gear is None or dof.gear is None:
                    continue
                spring = dof.gear.spring
                if isinstance(spring, SmoothSpring) and was.gear.spring != spring:
                    key = f"element.{old.name}.dof.{dof.name}.gear.spring"
                    out[key] = {"type": "smooth", **vars(spring)}
        return out

    def _joint_frictions(self, named: Mapping[str, float]) -> dict[str, Any]:
        """Friction of joints behind their gears, as whole tables."""
        rubbing = self.fit.unknowns.rubbing
        out: dict[str, Any] = {}
        fitted = with_values(self.form, dict(named))
        for old, new in zip(self.before.elements, fitted.elements, strict=True):
            for was, dof in zip(old.dofs, new.dofs, strict=True):
                law = dof.friction
                if dof.name not in rubbing or law.viscous == law.coulomb == 0.0:
                    continue
                if was.friction != law:
                    key = f"element.{old.name}.dof.{dof.name}.friction"
                    out[key] = {k: x for k, x in vars(law).items() if x}
        return out

    def write(self, path: str | Path) -> Path:
        """Write the model file with a further variant ``commissioned``: its numbers, and in
        ``[uncertainty]`` their standard deviations and correlations; the rest stays.

        Parameters
        ----------
        path : str or Path
            Read it as ``FILE@commissioned``.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            The model is refused, is not from a ``.toml`` file, or the file has this variant.
        """
        if self.problem:
            raise ArgumentError(
                f"write: given a fit that is refused ({self.problem}), expected one that predicts "
                "its records; nothing is written"
            )
        kinds = ", ".join(f"{len(names)} {kind}" for kind, names in self.records.items() if names)
        return write_commissioned(path, self.before, self.changes | self._uncertainty, kinds)

    @property
    def _uncertainty(self) -> dict[str, Any]:
        """Keys of the table ``[uncertainty]``: relative deviations of all numbers of the model."""
        unknowns = self.fit.unknowns
        values = unknowns.values(self.fit.written)
        sd = self.fit.sd
        own = np.sqrt(np.diag(self.fit.covariance))
        rows = [k for k in range(len(values)) if values[k] != 0.0]
        if not rows:
            return {}
        slopes = np.array(
            [
                1.0 if unknowns.vector.unknowns[k].scale == "log" else 1.0 / abs(values[k])
                for k in rows
            ]
        )
        correlation = self.fit.covariance[np.ix_(rows, rows)] / np.outer(own[rows], own[rows])
        np.fill_diagonal(correlation, 1.0)
        values_, vectors = np.linalg.eigh((correlation + correlation.T) / 2)
        clipped = (vectors * np.maximum(values_, 1e-4)) @ vectors.T
        root = np.sqrt(np.diag(clipped))
        correlation = np.round(clipped / np.outer(root, root), 6)
        np.fill_diagonal(correlation, 1.0)
        relative = np.minimum(sd[rows] * slopes, LARGEST_SD)
        lacking = min(self.misfit or 0.0, LARGEST_SD)
        return {
            **({"uncertainty.misfit": float(f"{lacking:.3g}")} if lacking else {}),
            "uncertainty.parameters": [unknowns.names[k] for k in rows],
            "uncertainty.sd": [float(f"{x:.6g}") for x in relative],
            "uncertainty.correlation": correlation.ravel().tolist(),
        }

    def content(self) -> tuple[Part, ...]:
        """Status, records, the numbers, errors on held-out parts, and what to record next."""
        kinds = ", ".join(f"{len(names)} {kind}" for kind, names in self.records.items() if names)
        verdict = self.problem or "the model predicts parts of the records that were not fitted"
        if self.status is FitStatus.NOT_CHECKED:
            verdict = "no part of the records could be held out: the model is not checked"
        return (
            Prose(f"{self.before.name}: {self.status}", is_title=True),
            Row("status", str(self.status), "", "status"),
            Row("records", kinds, "", "kinds_of_records"),
            Row("time of the fit", self.wall_s, "s", "wall_s"),
            Row("misfit of positions over elastic displacement", self.misfit, "", "misfit"),
            Prose(f"{verdict}.", "status"),
            self._table(),
            self._verdict(),
            *(Prose(f"possible cause: {one}", "causes") for one in self.causes),
            *self._hidden(),
            *(Prose(f"{line}.", "far") for line in self.far),
            *(Prose(f"{line}.", "missing") for line in self.missing),
            *(Prose(f"{line}.", "quicker") for line in self.quicker),
            *(Prose(f"{line}.", "notes") for line in self.notes),
            Data("missing", list(self.missing)),
            Data("quicker", list(self.quicker)),
            Data("causes", list(self.causes)),
            Data("not_visible", [vars(one) for one in self.not_visible]),
            Data("far", list(self.far)),
            Data("problem", self.problem),
        )

    @property
    def causes(self) -> tuple[str, ...]:
        """Single reasons for numbers that are far from the datasheet: the payload, a scale of all
        torques or positions, a length.
        """
        of_torques = [fault.name for fault in self.payload.faults]
        others = [one for one in self.fit.reasons.found if one.name not in of_torques]
        return (*map(str, self.payload.faults), *map(str, others))

    @property
    def not_visible(self) -> tuple[Limit, ...]:
        """Faults of the payload that no record shows, up to a limit."""
        shown = {"payload.mass", "payload.com"} - {one.name for one in self.payload.limits}
        tested = self.payload is not NOT_TESTED
        return tuple(one for one in self.fit.reasons.limits if not (tested and one.name in shown))

    def _hidden(self) -> list[Part]:
        """Faults that the records do not show."""
        limits = ", ".join(map(str, self.not_visible))
        text = f"not visible in these records: a wrong {limits}"
        return [Prose(text, "not_visible")] if limits else []

    def _table(self) -> Table:
        """Numbers before and after, with their deviation and the record that determines most."""
        unknowns = self.fit.unknowns
        start = unknowns.values(unknowns.start)
        cells = []
        for k, number in zip(self._chosen, self.fitted, strict=True):
            before = float(start[k]) if k < len(start) else float(unknowns.start[k])
            after = Shown(number.value, f"{number.value:.5g}")
            sd = number.sd or 0.0
            shown = f"{100 * sd:.2g} %" if number.is_relative else f"{sd:.2g}"
            source = "not determined"
            if number.is_determined:
                information = {name: row[k] for name, row in self.fit.information.items()}
                source = max(information, key=lambda name: information[name])
            cells.append((number.name, number.unit, before, after, Shown(sd, shown), source))
        columns = (
            Column("number", key="name"),
            Column("unit", key="unit"),
            Column("file", key="before"),
            Column("fitted", key="after"),
            Column("sd", key="sd"),
            Column("record", key="record"),
        )
        return Table(columns, tuple(cells), "Numbers", "numbers")

    def _verdict(self) -> Table:
        """Errors on held-out parts."""
        columns = (
            Column("record", key="record"),
            Column("held-out part of", key="channel"),
            Column("unit", key="unit"),
            Column("file", key="before"),
            Column("fitted", key="after"),
            Column("rigid", key="rigid"),
        )
        cells = tuple(
            (
                row.record,
                row.channel,
                row.unit,
                row.before,
                row.after,
                "" if row.rigid is None else row.rigid,
            )
            for row in self.held_out
        )
        return Table(columns, cells, "Errors on parts that were not fitted", "held_out")


def write_commissioned(
    path: str | Path, model: RobotModel, changes: Mapping[str, Any], source: str, dry: bool = False
) -> Path:
    """Write the model file with a further variant `VARIANT`; ``dry``: only check.

    Raises
    ------
    ArgumentError
        The model has no file, or one with this variant.
    """
    if not model.file:
        raise ArgumentError(
            "commission: given a model without a file, expected one that was read from a .toml "
            "file"
        )
    text, folder = text_of_model(model.file)
    sets = with_overrides(model, dict(changes))
    words = f"fitted to {source}"
    new = with_variant(text, Path(model.file).name, VARIANT, sets, words, model.variant)
    return write_model_text(path, new, folder, VARIANT, dry=dry)


@provides("Commissioning.check_file")
def check_file(path: str | Path, model: RobotModel) -> None:
    """Check before a fit that `Commissioning.write` can write the new model file; errors as
    there.
    """
    write_commissioned(path, replace(model), {}, "check", dry=True)
