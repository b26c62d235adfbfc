"""Identification of a rigid arm from described files: motions, fit, errors, and the way back to a
model file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from flexgen.base.calls.deadline import is_over, limit_fit
from flexgen.base.calls.progress import Choice, reported
from flexgen.base.errors import ArgumentError
from flexgen.base.rows import Part
from flexgen.dynamics.mechanics.parameters import select
from flexgen.identification.estimator.fit_result import FitResult, FittedNumber
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.records.description import Description, read_description
from flexgen.identification.records.gear_deflection import GearDeflection, gear_deflection
from flexgen.identification.responses.result import FileWords, write_model
from flexgen.identification.rigid.content import content_of_rigid
from flexgen.identification.rigid.feasible_bodies import (
    body_of,
    numbers_of,
    pseudo_inertia,
    scales,
)
from flexgen.identification.rigid.rigid_body import RigidFit, identify_rigid
from flexgen.identification.rigid.rigid_mistakes import Mistake
from flexgen.identification.rigid.rigid_regressor import BODY, Motion, payload_in
from flexgen.model.elements import RobotModel

STEP = 1e-6  # of differences
# kg, m, kg m^2: smaller numbers are rounding errors, and a model file has none below 1e-18
ROUNDING = 1e-15
# Relative deviation of bodies that CAD states.
CAD = 0.1
# Bodies within it are taken where no motor has errors that are larger by more than this factor.
AS_GOOD = 1.05
# Or where its errors, over the standard deviation of its torque, are below this: friction differs
# by more between two runs.
GOOD = 0.01
# Share of the mass of the last body that a right payload leaves in a fit.
LEAST_BODY = 0.05
FRICTION = ("viscous", "coulomb", "beta", "offset")
FALLING = ("stribeck", "alpha")


@dataclass(frozen=True, eq=False, repr=False)
class RigidIdentification(FitResult):
    """Result of `identify_bodies`: bodies, rotors and frictions of a rigid arm, and stiffnesses of
    its gears.

    ``fit``; ``errors``: those of each motor relative to the standard deviation of its torque,
    without friction at rest and at reversals, one row for each recording, by ``fitted``, and
    ``validated`` or ``left out``; ``model_errors``: those of the torques of the new model, with
    this friction, by ``fitted`` and ``validated``, see `RigidFit.model_errors`; ``gears``: by the
    joint, where a link has an encoder; ``source``: of the recordings; ``notes``: what was done to
    their files, as sentences.
    """

    fit: RigidFit
    errors: dict[str, list[list[float]]]
    gears: dict[str, GearDeflection]
    source: str
    notes: tuple[str, ...] = ()
    model_errors: dict[str, list[list[float]]] = field(default_factory=dict)

    @cached_property
    def fitted(self) -> tuple[FittedNumber, ...]:
        """The `numbers` with their `deviations`, in the units of the model file."""
        units = {p.name: p.unit for p in select(self.fit.model, list(self.numbers))}
        return tuple(
            FittedNumber(name, value, units[name], self.deviations.get(name))
            for name, value in self.numbers.items()
        )

    @cached_property
    def status(self) -> FitStatus:
        """Of the fit."""
        return self.fit.status

    @cached_property
    def weak(self) -> tuple[str, ...]:
        """The number of combinations of bodies that the motions determine."""
        fit = self.fit
        return (f"{fit.base_parameters} base parameters of {len(fit.pi)} numbers are determined",)

    @cached_property
    def causes(self) -> tuple[Mistake, ...]:
        """The mistake that explains a large part of the errors, where there is one."""
        return () if self.fit.mistake is None else (self.fit.mistake,)

    @cached_property
    def numbers(self) -> dict[str, float]:
        """See `rigid_numbers`."""
        return rigid_numbers(self.fit)

    @cached_property
    def deviations(self) -> dict[str, float]:
        """See `rigid_deviations`."""
        return rigid_deviations(self.fit)

    @property
    def lags(self) -> list[tuple[str, str, float, float | None]]:
        """Name, unit, value and deviation of each compliance that the file does not have, and of
        the delay.
        """
        fit = self.fit
        model = self.fit.file
        units = ["rad/(N m)" if model.coordinates[i].unit == "rad" else "m/N" for i in model.i_g]
        names = [f"{model.coordinates[i].name}.compliance" for i in model.i_g]
        sd = [None] * len(fit.lags) if fit.lags_sd is None else fit.lags_sd.tolist()
        return list(zip([*names, "delay"], [*units, "s"], fit.lags.tolist(), sd, strict=True))

    def content(self) -> tuple[Part, ...]:
        """See `content_of_rigid`."""
        return content_of_rigid(self)

    def write(self, path: str | Path) -> Path:
        """Write the new model file, see `write_rigid`."""
        return write_rigid(self.fit, path, self.source)


@reported("identify_bodies")
def identify_bodies(
    model: RobotModel,
    recordings: str | Path,
    *,
    validate: str | Path | None = None,
    counterbalance: Mapping[str, int] | None = None,
    time_limit: float | None = None,
    progress: Choice = None,
) -> RigidIdentification:
    """Fit bodies and friction of a rigid arm to described recordings; see `identify_rigid`.

    Parameters
    ----------
    model : RobotModel
    recordings, validate : str or Path
        Descriptions of the recordings that are fitted, and of others that the fit must predict;
        without these, it is judged on parts of the recordings that are left out in turn.
    counterbalance : mapping, optional
    time_limit : float, optional [s]
        Then, or after Ctrl-C, the result is the best step so far, with the status ``time limit``
        or ``interrupted``.
    progress : callable or bool, optional
    """
    data = read_description(recordings)
    others = None if validate is None else motions_of(read_description(validate))
    if callable(progress):
        progress(f"fitting the bodies of {model.name} to {len(data.recordings)} recordings")
    fitted = motions_of(data)
    tell = progress if callable(progress) else None
    more = {} if others is None else {"parts": 0}
    with limit_fit("identify", time_limit, tell):
        fit = identify_rigid(model, fitted, counterbalance=counterbalance, **more)
        fit = near_file(fit, fitted)
    errors = {"fitted": [fit.relative_errors(motion).tolist() for motion in fitted]}
    if others is not None:
        errors["validated"] = [fit.relative_errors(motion).tolist() for motion in others]
        ended = fit.status in (FitStatus.TIME_LIMIT, FitStatus.INTERRUPTED)
        fit = fit if ended else fit.validated(fitted, others)
    elif fit.left_out is not None:
        errors["left out"] = [fit.left_out.tolist()]
    of_model = {"fitted": [fit.model_errors(motion).tolist() for motion in fitted]}
    if others is not None:
        of_model["validated"] = [fit.model_errors(motion).tolist() for motion in others]
    gears = gear_deflections(fit, data)
    if not fit.status.has_deviations:
        gears = {name: gear.without_interval(str(fit.status)) for name, gear in gears.items()}
    return RigidIdentification(fit, errors, gears, str(recordings), data.notes, of_model)


def near_file(fit: RigidFit, motions: Sequence[Motion]) -> RigidFit:
    """The fit, with bodies near those of the model file where they explain the motions as well.

    Torques show combinations of bodies. A wide prior leaves the split of a combination to small
    errors of the torques, and bodies can be far from those of CAD that explain the same torques.
    The fit is therefore repeated with the prior `CAD`, and taken where the errors of each motor
    are at most `AS_GOOD` times those before, or `GOOD`. Status, mistake and errors of left out
    parts stay.
    """
    if is_over():
        return fit
    close = identify_rigid(
        fit.file, motions, counterbalance=fit.counterbalance, prior=CAD, parts=0
    )
    errors = ([each.relative_errors(m) for m in motions] for each in (close, fit))
    near, wide = (np.array(each) for each in errors)
    if (near > np.maximum(AS_GOOD * wide, GOOD)).any() or is_over():
        return fit
    return replace(
        close, status=fit.status, mistake=fit.mistake, left_out=fit.left_out, payload=fit.payload
    )


def gear_deflections(fit: RigidFit, data: Description) -> dict[str, GearDeflection]:
    """The gears of the joints that have a link encoder in the recordings, by the joint."""
    model = data.model
    names = [model.coordinates[i].name for i in model.i_g]
    sensors = {name: sensor for sensor in model.sensors for name in sensor.channels}
    motions = motions_of(data)
    torques, joints = (
        np.vstack(x) for x in ([fit.gear_torques(m) for m in motions], [m.q for m in motions])
    )
    t = data.recordings[0][1].sample_s * np.arange(len(joints))
    out = {}
    for c, sensor in enumerate(sensors[channel] for channel in data.sensors):
        if sensor.type == "link_encoder" and sensor.place in names:
            j = names.index(sensor.place)
            link = np.concatenate([run.signals[:, c] for _, run in data.recordings])
            out[sensor.place] = gear_deflection(t, joints[:, j], link, torques[:, j])
    return out


def motions_of(data: Description) -> list[Motion]:
    """The recordings as motions of the joints; springs of the gears are small."""
    inverse = np.linalg.inv(data.model.eta).T
    return [Motion(run.t, run.q_m @ inverse, run.tau_m) for _, run in data.recordings]


def rigid_numbers(fit: RigidFit) -> dict[str, float]:
    """Name -> value of all bodies, rotors and frictions, as the model file has them."""
    model = fit.model
    out = {}
    names = [f"{element.name}.{name}" for element in model.elements for name in BODY]
    names += [f"{motor.name}.{name}" for motor in model.motors for name in (*FRICTION, "inertia")]
    for motor, before in zip(model.motors, fit.file.motors, strict=True):
        if motor.friction.stribeck or before.friction.stribeck:
            names += [f"{motor.name}.{name}" for name in FALLING]
    names += list(_balance_places(fit))
    for parameter in select(model, names):
        out[parameter.name] = parameter.value if abs(parameter.value) > ROUNDING else 0.0
    return out


def leaves_a_body(fit: RigidFit) -> bool:
    """Whether the payload of the file leaves a last body that can be that of the robot.

    A payload that is heavier than that of the recordings leaves next to nothing of it.
    """
    before = fit.file.elements[-1].body.mass
    row = fit.pi[-10:] - numbers_of(fit.file.payload)
    positive = np.linalg.eigvalsh(pseudo_inertia(row))[0] > 0
    return bool(positive and row[0] >= LEAST_BODY * before)


def _balance_places(fit: RigidFit) -> dict[str, tuple[int, int]]:
    """Names of the fitted numbers of counterbalances -> their place in the frictions."""
    model = fit.file
    out = {}
    joints = [model.coordinates[i].name for i in model.i_g]
    for name, count in fit.counterbalance.items():
        j = int(np.argmax(np.abs(model.eta[:, joints.index(name)])))
        for k in range(count):
            out[f"{name}.counterbalance_sin_{k + 2}"] = j, 4 + 2 * k
            out[f"{name}.counterbalance_cos_{k + 2}"] = j, 5 + 2 * k
    return out


def rigid_deviations(fit: RigidFit) -> dict[str, float]:
    """Name -> standard deviation of the numbers of the fit, in their units; empty where the status
    has none.

    The rotors' and bodies' numbers are combinations of those of the fit; their deviations follow
    by differences.
    """
    if not fit.status.has_deviations:
        return {}
    model = fit.model
    pi = fit.pi - payload_in(fit.file)
    n = len(pi)
    body = fit.covariance[:n, :n]
    out: dict[str, float] = {}
    for k, element in enumerate(model.elements):
        row = pi[10 * k : 10 * k + 10]
        rows = slice(10 * k, 10 * k + 10)
        J = np.empty((10, 10))
        at = _in_file(row)
        for i, size in enumerate(scales(row)):
            J[:, i] = (_in_file(row + STEP * size * (np.arange(10) == i)) - at) / (STEP * size)
        sd = np.sqrt(np.maximum(np.diag(J @ body[rows, rows] @ J.T), 0.0))
        out |= {f"{element.name}.{name}": float(x) for name, x in zip(BODY, sd, strict=True)}
    sd = np.sqrt(np.diag(fit.covariance)[n : n + fit.friction.size]).reshape(fit.friction.shape)
    for j, motor in enumerate(model.motors):
        ratio = float(np.abs(model.eta[j]).max())
        columns = [0, 1, 2, 3]
        names = ["viscous", "coulomb", "offset", "inertia"]
        if motor.friction.stribeck:
            columns = [*columns, -2, -1]
            names = [*names, *FALLING]
        size = [ratio, 1.0, 1.0, ratio, 1.0, ratio][: len(names)]
        out |= {
            f"{motor.name}.{name}": float(x)
            for name, x in zip(names, sd[j, columns] / size, strict=True)
        }
    names = [model.coordinates[i].name for i in model.i_g]
    for name, (j, column) in _balance_places(fit).items():
        ratio = float(abs(model.eta[j, names.index(name.partition(".")[0])]))
        out[name] = float(sd[j, column]) * ratio
    return out


def _in_file(row: np.ndarray) -> np.ndarray:
    """The numbers of a model file, in the order of `BODY`, of a body with these ten numbers."""
    body = body_of(row)
    I = body.inertia  # noqa: E741
    return np.array([body.mass, *body.com, I[0][0], I[1][1], I[2][2], I[0][1], I[1][2], I[0][2]])


def write_rigid(fit: RigidFit, path: str | Path, source: str) -> Path:
    """Write the new model file: the old text with the numbers of bodies, rotors and frictions
    replaced.

    Raises
    ------
    ArgumentError
        The model is not from a ``.toml`` file with ``[[element]]`` tables, or its payload leaves
        next to nothing of the last body.
    """
    payload = fit.file.payload
    if payload.mass and not leaves_a_body(fit):
        last = fit.file.elements[-1]
        raise ArgumentError(
            f"model file: given a payload of {payload.mass:.4g} kg, expected less: of the body "
            f"{last.name} of {last.body.mass:.4g} kg, {fit.pi[-10] - payload.mass:.4g} kg remain "
            "in the fit; correct [payload], or remove it: the new file then has it in this body"
        )
    head = (
        "# Bodies: only combinations of these numbers are determined; each body by itself may "
        "be another one.\n"
        "# Standard deviations are in the units of the numbers.\n"
    )
    note = "" if fit.status.has_deviations else f"{fit.status}, no standard deviations"
    if not fit.status.agrees:
        head = "".join(f"# {line}\n" for line in (f"Status: {fit.status}.", *fit.texts)) + head
    sd = {name: f"{value:.2g}" for name, value in rigid_deviations(fit).items()}
    words = FileWords(source, head, note)
    return write_model(path, with_places(fit), rigid_numbers(fit), sd, words)


def with_places(fit: RigidFit) -> RobotModel:
    """The model before the fit, with zero counterbalances where the fit has some: so that their
    numbers have names.
    """
    longer = {
        dof.name: len(dof.counterbalance) for element in fit.model.elements for dof in element.dofs
    }
    elements = tuple(
        replace(
            e,
            dofs=tuple(
                replace(
                    dof,
                    counterbalance=dof.counterbalance
                    + ((0.0, 0.0),) * (longer[dof.name] - len(dof.counterbalance)),
                )
                for dof in e.dofs
            ),
        )
        for e in fit.file.elements
    )
    return replace(fit.file, elements=elements)
