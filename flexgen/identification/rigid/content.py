"""Content of the identification of a rigid arm: frictions and rotors, errors, gears.

``found`` is a `RigidIdentification`, whose module imports this one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.base.rows import Column, Data, Part, Prose, Shown, Table

# Numbers of a motor, with their units.
KINDS = {"inertia": "kg m^2", "viscous": "N m s/rad", "coulomb": "N m", "offset": "N m"}
# The same of friction that falls with speed.
FALLING = {"stribeck": "N m", "alpha": "s/rad"}
LAGS = tuple(map(Column, ("lag", "unit", "value", "+-")))


def content_of_rigid(found: Any) -> tuple[Part, ...]:
    """Status and errors, frictions and rotors of the motors, lags, gears and counterbalances."""
    fit = found.fit
    mistake = [] if fit.mistake is None else [fit.mistake.sentence]
    band = "through the filter of the motion"
    if np.isfinite(fit.limit_hz):
        band = f"below {fit.limit_hz:.4g} Hz"
    gears = [f"  {name}: {gear.sentence}" for name, gear in found.gears.items()]
    if gears:
        of = "stiffness of the gears from the link encoders, arm side, 90 % interval:"
        gears.insert(0, of)
    lags = tuple((k, unit, x, "" if sd is None else sd) for k, unit, x, sd in found.lags)
    springs = _springs(found)
    return (
        Prose(
            f"{fit.model.name}: {fit.status}, {fit.base_parameters} base parameters of "
            f"{len(fit.pi)} numbers",
            "status",
            is_title=True,
        ),
        Prose(" ".join(fit.texts), "status"),
        *(Prose(f"One mistake can be the reason: {line}", "mistake") for line in mistake),
        Prose(
            f"errors: rms over the standard deviation of the torque, {band}, of samples that "
            "move. Error of the bodies: without what friction can do at rest and at reversals; "
            "left out: on quarters of the recordings, of the fit to the others. Error of the "
            "file: of feedforward with the new model file, with that friction, the springs of "
            "the file, and without the delay",
            "errors",
        ),
        *_payload(fit),
        _motors(found),
        Prose(
            "Compliances of gears that the model file does not have, and the delay of torques "
            "after angles:",
            "lags",
        ),
        Table(LAGS, lags, "Lags"),
        *(Prose(line, "springs") for line in springs),
        _balance(found),
        *(Prose(line, "gears") for line in gears),
        *(Prose(f"{line}.", "notes") for line in found.notes),
        *_data(found),
    )


def _payload(fit: Any) -> list[Part]:
    """A payload that the torques contradict, and what they do not show of it."""
    out: list[Part] = [Prose(f"possible cause: {fault}", "causes") for fault in fit.payload.faults]
    if fit.payload.limits:
        faults = ", ".join(map(str, fit.payload.limits))
        out.append(
            Prose(
                "not visible in these motions, since bodies and friction do nearly the same: a "
                f"wrong {faults}",
                "not_visible",
            )
        )
    return out


def _both(found: Any, name: str) -> Shown:
    """A number with its deviation."""
    value = found.numbers.get(name, 0.0)
    text = f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.4g}"
    sd = found.deviations.get(name)
    return Shown(value, text if sd is None else f"{text} +- {sd:.2g}")


def _motors(found: Any) -> Table:
    """Numbers and errors of each motor."""
    kinds = KINDS | (FALLING if found.fit.fades.any() else {})
    runs = [
        (f"{name} {k}, error of the {of}", run)
        for of, errors in (("bodies", found.errors), ("file", found.model_errors))
        for name, each in errors.items()
        for k, run in enumerate(each, 1)
    ]
    columns = (
        Column("motor"),
        *(Column(kind, unit) for kind, unit in kinds.items()),
        *(Column(name, "%") for name, _ in runs),
    )
    cells = tuple(
        (
            motor.name,
            *(_both(found, f"{motor.name}.{kind}") for kind in kinds),
            *(100 * run[j] for _, run in runs),
        )
        for j, motor in enumerate(found.fit.model.motors)
    )
    return Table(columns, cells, "Motors")


def _balance(found: Any) -> Table:
    """Counterbalances of the joints."""
    names = [name for name in found.numbers if ".counterbalance_" in name]
    columns = Column("counterbalance"), Column("N m, arm side")
    return Table(columns, tuple((name, _both(found, name)) for name in names), "Counterbalances")


def _springs(found: Any) -> list[str]:
    """A sentence on gears that deflect otherwise than in the model file; none: the recordings
    show none.
    """
    other = [
        name.partition(".")[0]
        for name, _, value, sd in found.lags[:-1]
        if sd is not None and abs(value) > 3 * sd
    ]
    if not other:
        return []
    return [
        f"Gears of {', '.join(other)} deflect otherwise than in the model file. The numbers "
        "above take that into account, the springs of the new file do not: identify them from "
        "frequency responses."
    ]


def _data(found: Any) -> tuple[Data, ...]:
    """Entries of JSON, SI units; stiffnesses on the arm side with their 90 % interval."""
    fit = found.fit
    parameters = [
        {"name": name, "value": value, "sd": found.deviations.get(name)}
        for name, value in found.numbers.items()
    ]
    lags = [{"name": k, "unit": unit, "value": x, "sd": sd} for k, unit, x, sd in found.lags]
    data: dict[str, Any] = {
        "model": fit.model.name,
        "status": fit.status,
        "parameters": parameters,
        "base_parameters": fit.base_parameters,
        "mistake": None if fit.mistake is None else vars(fit.mistake),
        "motors": [motor.name for motor in fit.model.motors],
        "relative_errors": found.errors,
        "model_errors": found.model_errors,
        "notes": list(found.notes),
        "limit_hz": fit.limit_hz if np.isfinite(fit.limit_hz) else None,
        "lags": lags,
        "bodies": {element.name: vars(element.body) for element in fit.model.elements},
    }
    names = ("stiffness", "interval", "skew_s")
    gears = {
        joint: {name: getattr(gear, name) for name in names} for joint, gear in found.gears.items()
    }
    if gears:
        data["gear_stiffness"] = gears
    return tuple(Data(name, value) for name, value in data.items())
