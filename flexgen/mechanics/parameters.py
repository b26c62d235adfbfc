"""Run-time parameters: numbers of a model as symbols, arguments of the functions of a generated library.

Names of parameters (each expands to the numbers that the model has):

==================== ==============================================================================================
payload              mass and center of mass of the payload (``payload.mass``, ``payload.com_x`` ...)
stiffness            every number of every spring: ``<coordinate>.stiffness``, ``.cubic``, ``.low`` ...
damping              of every gear and spring: ``<coordinate>.damping``
friction             of every motor and joint: ``<motor>.viscous``, ``.coulomb`` ..., ``<coordinate>.viscous`` ...
payload.mass, ...    a single number, or all of one kind of one part: ``q2.stiffness``, ``m1.friction``
==================== ==============================================================================================

Units are those of the side where the number is stated: on the motor side angles, even where the joint is a translation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca

from flexgen.errors import ArgumentError
from flexgen.model.elements import Body, Dof, Friction, Gear, Motor, RobotModel, Spring

_SPRING_UNITS = {
    "stiffness": "N m/rad", "cubic": "N m/rad^3", "low": "N m/rad", "high": "N m/rad", "break_at": "rad", "gap": "rad",
    "smoothing": "rad",
}  # fmt: skip
_LINEAR = {"N m/rad": "N/m", "N m/rad^3": "N/m^3", "rad": "m", "N m s/rad": "N s/m", "N m": "N", "s/rad": "s/m"}


@dataclass(frozen=True)
class Parameter:
    """A number of the model that may change at run time: name, value in the file, unit, meaning."""

    name: str
    value: float
    unit: str
    doc: str = ""


@dataclass(frozen=True)
class Parametrized:
    """A model some of whose numbers are symbols.

    ``model``: a `RobotModel` with CasADi scalars in those places, for the rooms that derive equations only. ``given``:
    the model with its numbers. ``symbols`` (n_p): the scalars. ``parameters``: what they are, in that order.
    """

    model: RobotModel
    given: RobotModel
    symbols: ca.SX
    parameters: tuple[Parameter, ...]


def parametrized(model: RobotModel, names: Sequence[str]) -> Parametrized:
    """Put symbols in the place of the numbers named; see the table above.

    Raises
    ------
    ArgumentError
        For a name that the model does not have; the message lists those that it has.
    """
    if isinstance(names, str):
        raise ArgumentError(f"parameters: given the text {names!r}, expected a sequence of names")
    every: list[tuple[Parameter, tuple[str, ...]]] = []

    def note(parameter: Parameter, *groups: str) -> Any:
        every.append((parameter, (parameter.name, *groups)))
        return parameter.value

    _walk(model, note)
    known = sorted({group for _, groups in every for group in groups})
    for name in names:
        if name not in known:
            raise ArgumentError(f"parameters: given {name!r}, expected some of {', '.join(known)}")
    chosen = [parameter for parameter, groups in every if any(name in groups for name in names)]
    symbols = ca.SX.sym("parameters", len(chosen))
    at = {parameter.name: symbols[k] for k, parameter in enumerate(chosen)}

    def put(parameter: Parameter, *groups: str) -> Any:
        return at.get(parameter.name, parameter.value)

    return Parametrized(_walk(model, put) if chosen else model, model, symbols, tuple(chosen))


Visit = Callable[..., Any]
Units = Callable[[str], str]


def _angular(unit: str) -> str:
    """Units of a rotation."""
    return unit


def _linear(unit: str) -> str:
    """Units of a translation."""
    return _LINEAR.get(unit, unit)


def _walk(model: RobotModel, visit: Visit) -> RobotModel:
    """The model with every number that may be a parameter replaced by what the visitor returns."""
    elements = tuple(
        replace(element, dofs=tuple(_dof(dof, visit) for dof in element.dofs)) if element.dofs else element
        for element in model.elements
    )
    motors = tuple(_motor(motor, visit) for motor in model.motors)
    return replace(model, elements=elements, motors=motors, payload=_payload(model.payload, visit))


def _payload(payload: Body, visit: Visit) -> Body:
    mass = visit(Parameter("payload.mass", payload.mass, "kg", "payload: mass"), "payload")
    doc = (
        "payload: center of mass in the frame that the tool is attached to; "
        "its inertia about the center stays that of the file"
    )
    com = tuple(
        visit(Parameter(f"payload.com_{axis}", x, "m", doc), "payload", "payload.com")
        for axis, x in zip("xyz", payload.com, strict=True)
    )
    return replace(payload, mass=mass, com=com)


def _dof(dof: Dof, visit: Visit) -> Dof:
    units = _linear if dof.type == "translation" else _angular
    part = f"{dof.name}, arm side" if dof.gear is not None else dof.name
    changes: dict[str, Any] = {"friction": _friction(dof.friction, dof.name, part, units, visit)}
    if dof.gear is not None:
        changes["gear"] = _gear(dof.gear, dof.name, units, visit)
    if dof.spring is not None:
        changes["spring"] = _spring(dof.spring, dof.name, part, units, visit)
        changes["damping"] = _damping(dof.damping, dof.name, part, units, visit)
    return replace(dof, **changes)


def _gear(gear: Gear, name: str, units: Units, visit: Visit) -> Gear:
    if gear.spring is None:
        return gear
    part, units = f"{name}, {gear.side} side", _angular if gear.side == "motor" else units
    spring = _spring(gear.spring, name, part, units, visit)
    return replace(gear, spring=spring, damping=_damping(gear.damping, name, part, units, visit))


def _damping(value: float, name: str, part: str, units: Units, visit: Visit) -> Any:
    return visit(Parameter(f"{name}.damping", value, units("N m s/rad"), f"damping of {part}"), "damping")


def _spring(spring: Spring, name: str, part: str, units: Units, visit: Visit) -> Spring:
    def number(kind: str) -> Parameter:
        return Parameter(f"{name}.{kind}", getattr(spring, kind), units(_SPRING_UNITS[kind]), f"spring of {part}")

    return replace(spring, **{field.name: visit(number(field.name), "stiffness") for field in fields(spring)})


def _motor(motor: Motor, visit: Visit) -> Motor:
    return replace(
        motor, friction=_friction(motor.friction, motor.name, f"motor {motor.name}, motor side", _angular, visit)
    )


def _friction(friction: Friction, name: str, part: str, units: Units, visit: Visit) -> Friction:
    """Only terms that the file has: a friction that is zero there costs nothing and stays zero."""
    return replace(
        friction,
        **{
            field.name: visit(
                Parameter(f"{name}.{field.name}", value, units(field.metadata["unit"]), f"friction of {part}"),
                "friction",
                f"{name}.friction",
            )
            for field in fields(friction)
            if (value := getattr(friction, field.name)) != 0.0
        },
    )
