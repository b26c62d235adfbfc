"""Run-time parameters: numbers of a model as symbols, arguments of the functions of a generated
library.

Names of parameters (each expands to the numbers that the model has):

==================== ==============================================================================
payload              mass and center of mass of the payload (``payload.mass``, ``payload.com_x``
                     ...)
stiffness            every number of every spring: ``<coordinate>.stiffness``, ``.cubic``,
                     ``.low`` ...
damping              of every gear and spring: ``<coordinate>.damping``
friction             of every motor and joint: ``<motor>.viscous``, ``.coulomb`` ...,
                     ``<coordinate>.viscous`` ...
payload.mass, ...    a single number, or all of one kind of one part: ``q2.stiffness``,
                     ``m1.friction``
m1.viscous, ...      a single number of a friction law, also one that is zero in the file
temperature          of the robot, where motors have friction of the type "gear"; only by its own
                     name
m1.inertia           inertia of a rotor; only by its own name
m1.cogging_cos_6 ..  a coefficient of a Fourier sum of a motor angle; only by its own name; of a
                     joint ``q1``: ``q1.transmission_error_sin_2``; also ``m1.torque_ripple_cos_6``
q1.lost_motion       of a gear with hysteresis; ``lost_motion``: of all;
                     ``q1.hysteresis_stiffness`` by its own name; of several elements
                     ``q1.lost_motion_1``, ``q1.hysteresis_stiffness_1`` ...
m1.lugre_coulomb     and other numbers of the table ``lugre`` of a motor; ``lugre_coulomb``: of all
rod.stiffness, ...   a number of a line: ``.damping``, ``.mass``, ``.length``, ``.preload``,
                     ``.pressure``, ``.volume``, ``.area``, ``.exponent``
arm1.mass, ...       mass, ``com_x`` .. and ``inertia_xx``, ``inertia_xy`` .. of a body; only by
                     their own names
==================== ==============================================================================

Units are those of the side where the number is stated: on the motor side angles, even where the
joint is a translation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import casadi as ca

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import provides
from flexgen.base.spec.arguments import is_number
from flexgen.base.spec.fourier import FourierSum
from flexgen.base.spec.parts import GearFriction
from flexgen.model.abilities import obstacle
from flexgen.model.elements import Body, Dof, Friction, Gear, Motor, RobotModel, Spring

if TYPE_CHECKING:
    from flexgen.base.spec.lines import Line
    from flexgen.base.spec.memory import HysteresisLaw

NOT_NEGATIVE = ">= 0"
_SPRING_UNITS = {
    "stiffness": "N m/rad",
    "cubic": "N m/rad^3",
    "low": "N m/rad",
    "high": "N m/rad",
    "break_at": "rad",
    "gap": "rad",
    "smoothing": "rad",
}
_LINEAR = {
    "N m/rad": "N/m",
    "N m/rad^3": "N/m^3",
    "rad": "m",
    "N m s/rad": "N s/m",
    "N m": "N",
    "s/rad": "s/m",
}


@dataclass(frozen=True)
class Parameter:
    """A number of the model that may change at run time: name, value in the file, unit, meaning.

    ``key``: dotted path of the number in a model file, such as ``motor.m1.friction.viscous``.
    ``inertia``: whether it belongs to a body or a rotor; then the functions are written from
    Lagrange's equations, without the recursions. ``bound``: ``">= 0"`` or ``"> 0"``, empty for a
    number that may be negative.
    """

    name: str
    value: float
    unit: str
    doc: str = ""
    key: str = ""
    inertia: bool = False
    bound: str = ""


@dataclass(frozen=True)
class Parametrized:
    """A model some of whose numbers are symbols.

    ``model``: a `RobotModel` with CasADi scalars in those places, for the rooms that derive
    equations only. ``given``: the model with its numbers. ``symbols`` (n_p): the scalars.
    ``parameters``: what they are, in that order.
    """

    model: RobotModel
    given: RobotModel
    symbols: ca.SX
    parameters: tuple[Parameter, ...]


def put_symbols(model: RobotModel, names: Sequence[str]) -> Parametrized:
    """Put symbols in the place of the numbers named; see the table above.

    Raises
    ------
    ArgumentError
        For a name that the model does not have; the message lists those that it has.
    """
    if isinstance(names, str):
        raise ArgumentError(f"parameters: given the text {names!r}, expected a sequence of names")
    chosen = select(model, names)
    if any(not parameter.key.startswith("payload") for parameter in chosen):
        reason = obstacle(model, "parameters")
        if reason is not None:
            raise ArgumentError(
                f"parameters other than those of the payload: given {model.title}, of which "
                f"{reason}"
            )
    symbols = ca.SX.sym("parameters", len(chosen))
    values = {parameter.name: symbols[k] for k, parameter in enumerate(chosen)}
    return Parametrized(with_values(model, values), model, symbols, chosen)


def select(model: RobotModel, names: Sequence[str]) -> tuple[Parameter, ...]:
    """The numbers of a model with these ``names``, in the order of the model; see the table above.

    Raises
    ------
    ArgumentError
        For a name that the model does not have; the message lists those that it has.
    """
    every = _with_groups(model)
    known = {group for _, groups in every for group in groups}
    for name in names:
        if name not in known:
            # numbers in no group (zero in the file, inertias of rotors) are too many to list
            listed = sorted(
                known - {parameter.name for parameter, groups in every if len(groups) == 1}
            )
            raise ArgumentError(
                f"parameters: given {name!r}, expected some of {', '.join(listed)}"
            )
    chosen = tuple(
        parameter for parameter, groups in every if any(name in groups for name in names)
    )
    _check_needed(model, {parameter.name for parameter in chosen})
    return chosen


def _check_needed(model: RobotModel, chosen: set[str]) -> None:
    """ArgumentError for a number of a friction that has no effect: ``coulomb`` with ``beta`` 0."""
    parts = [(motor.name, motor.friction) for motor in model.motors]
    parts += [(c.name, c.dof.friction) for c in model.coordinates if c.dof is not None]
    for part, friction in parts:
        for key in fields(friction):
            if f"{part}.{key.name}" not in chosen:
                continue
            for needed in key.metadata["needs"].split():
                if getattr(friction, needed) == 0.0 and f"{part}.{needed}" not in chosen:
                    raise ArgumentError(
                        f"parameters: given {part}.{key.name} of a friction with {needed} = 0, "
                        f"expected {needed} > 0 in the model, or {part}.{needed} among the "
                        f"parameters: without it {key.name} has no effect"
                    )


def _with_groups(model: RobotModel) -> list[tuple[Parameter, tuple[str, ...]]]:
    """The numbers of a model, each with its own name and those of its groups."""
    every: list[tuple[Parameter, tuple[str, ...]]] = []

    def note(parameter: Parameter, *groups: str) -> Any:
        every.append((parameter, (parameter.name, *groups)))
        return parameter.value

    _walk(model, note)
    return every


def has_group(model: RobotModel, name: str) -> bool:
    """Whether `select` knows this name."""
    return any(name in groups for _, groups in _with_groups(model))


@provides("RobotModel.numbers")
def names_of_numbers(model: RobotModel) -> list[str]:
    """The names of all numbers of a model that may be parameters, in its order."""
    found: dict[str, float] = {}
    _walk(model, lambda parameter, *groups: found.setdefault(parameter.name, parameter.value))
    return list(found)


def with_values(model: RobotModel, values: Mapping[str, Any]) -> RobotModel:
    """The model with other values of some numbers; the keys of ``values`` are names of
    parameters.
    """
    if not values:
        return model
    return _walk(model, lambda parameter, *groups: values.get(parameter.name, parameter.value))


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
        replace(
            element,
            dofs=tuple(
                _dof(dof, f"element.{element.name}.dof.{dof.name}", visit) for dof in element.dofs
            ),
            body=_body(element.body, element.name, visit),
        )
        for element in model.elements
    )
    motors = tuple(_motor(motor, visit) for motor in model.motors)
    lines = tuple(_line(line, visit) for line in model.lines)
    warm = model.temperature
    if any(isinstance(motor.friction, GearFriction) for motor in model.motors):
        warm = visit(
            Parameter("temperature", warm, "deg C", "motors and gears", "temperature"),
            "temperature",
        )
    return replace(
        model,
        elements=elements,
        motors=motors,
        payload=_payload(model.payload, visit),
        temperature=warm,
        lines=lines,
    )


def _body(body: Body, name: str, visit: Visit) -> Body:
    """Ten numbers, each by its own name only."""

    def number(kind: str, value: float, unit: str, key: str) -> Any:
        key = f"element.{name}.body.{key}"
        return visit(
            Parameter(f"{name}.{kind}", value, unit, f"body of {name}: {kind}", key, inertia=True)
        )

    mass = number("mass", body.mass, "kg", "mass")
    com = tuple(
        number(f"com_{axis}", x, "m", f"com.{k}")
        for k, (axis, x) in enumerate(zip("xyz", body.com, strict=True))
    )
    entries = {}
    # the order of a model file
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))):
        kind = f"inertia_{'xyz'[i]}{'xyz'[j]}"
        entries[i, j] = entries[j, i] = number(kind, body.inertia[i][j], "kg m^2", f"inertia.{k}")
    inertia = tuple(tuple(entries[i, j] for j in range(3)) for i in range(3))
    return replace(body, mass=mass, com=com, inertia=inertia)


def _payload(payload: Body, visit: Visit) -> Body:
    """The payload with mass and center of mass replaced by what the visitor returns, in the group
    ``payload``.
    """
    mass = visit(
        Parameter(
            "payload.mass", payload.mass, "kg", "payload: mass", "payload.mass", bound=NOT_NEGATIVE
        ),
        "payload",
    )
    doc = (
        "payload: center of mass in the frame that the tool is attached to; "
        "its inertia about the center stays that of the file"
    )
    com = tuple(
        visit(
            Parameter(f"payload.com_{axis}", x, "m", doc, f"payload.com.{k}"),
            "payload",
            "payload.com",
        )
        for k, (axis, x) in enumerate(zip("xyz", payload.com, strict=True))
    )
    return replace(payload, mass=mass, com=com)


def _dof(dof: Dof, key: str, visit: Visit) -> Dof:
    """The degree of freedom with friction, counterbalance, gear or spring replaced by what the
    visitor returns; ``key``: its place in the model file.
    """
    units = _linear if dof.type == "translation" else _angular
    part = f"{dof.name}, arm side" if dof.gear is not None else dof.name
    changes: dict[str, Any] = {
        "friction": _friction(dof.friction, dof.name, part, units, key, visit)
    }
    if dof.counterbalance:
        changes["counterbalance"] = tuple(
            tuple(
                visit(
                    Parameter(
                        f"{dof.name}.counterbalance_{name}_{k + 1}",
                        value,
                        "N m",
                        f"counterbalance of {part}",
                        f"{key}.counterbalance.{name}.{k}",
                    )
                )
                for name, value in zip(("sin", "cos"), pair, strict=True)
            )
            for k, pair in enumerate(dof.counterbalance)
        )
    if dof.gear is not None:
        changes["gear"] = _gear(dof.gear, dof.name, units, f"{key}.gear", visit)
    if dof.spring is not None:
        changes["spring"] = _spring(dof.spring, dof.name, part, units, f"{key}.spring", visit)
        changes["damping"] = _damping(dof.damping, dof.name, part, units, key, visit)
    return replace(dof, **changes)


def _gear(gear: Gear, name: str, units: Units, key: str, visit: Visit) -> Gear:
    """The gear of joint ``name`` with spring, damping, transmission error and hysteresis replaced
    by what the visitor returns; rigid gears as they are. ``units``: those of the joint; a spring
    on the motor side has those of a rotation.
    """
    if gear.spring is None:
        return gear
    joint = units
    part = f"{name}, {gear.side} side"
    units = _angular if gear.side == "motor" else units
    spring = _spring(gear.spring, name, part, units, f"{key}.spring", visit)
    damping = _damping(gear.damping, name, part, units, key, visit)
    # (in units of the joint, whatever the side of the spring)
    error = _fourier_sum(
        gear.transmission_error, f"{name}.transmission_error", joint("rad"), key, visit
    )
    at = f"{key}.hysteresis"
    own = f"hysteresis of {part}"

    def element(given: HysteresisLaw, n: str, place: str) -> HysteresisLaw:
        """An element of hysteresis with lost motion and stiffness replaced. ``n``, ``place``: ends
        of its names, and of its key where there are several, which then belong to a group of their
        gear.
        """
        lost = Parameter(
            f"{name}.lost_motion{n}",
            given.lost_motion,
            joint("rad"),
            own,
            f"{at}{place}.lost_motion",
        )
        stiff = Parameter(
            f"{name}.hysteresis_stiffness{n}",
            given.stiffness,
            units("N m/rad"),
            own,
            f"{at}{place}.stiffness",
        )
        of_gear = (
            [f"{name}.lost_motion"] if n else [],
            [f"{name}.hysteresis_stiffness"] if n else [],
        )
        wide = visit(lost, "lost_motion", *of_gear[0])
        steep = visit(stiff, *of_gear[1])
        return replace(given, lost_motion=wide, stiffness=steep)

    hysteresis = gear.hysteresis
    if isinstance(hysteresis, tuple):
        hysteresis = tuple(
            element(each, f"_{k + 1}", f".{k}") for k, each in enumerate(hysteresis)
        )
    elif hysteresis is not None:
        hysteresis = element(hysteresis, "", "")
    return replace(
        gear, spring=spring, damping=damping, transmission_error=error, hysteresis=hysteresis
    )


def _damping(value: float, name: str, part: str, units: Units, key: str, visit: Visit) -> Any:
    """The damping constant of ``part``, or its replacement by the visitor, in the group
    ``damping``.
    """
    doc = f"damping of {part}"
    unit = units("N m s/rad")
    parameter = Parameter(
        f"{name}.damping", value, unit, doc, f"{key}.damping", bound=NOT_NEGATIVE
    )
    return visit(parameter, "damping")


def _spring(spring: Spring, name: str, part: str, units: Units, key: str, visit: Visit) -> Spring:
    """The spring with all its numbers replaced by what the visitor returns, in the group
    ``stiffness``.
    """

    def number(kind: str) -> Parameter:
        value = getattr(spring, kind)
        unit = units(_SPRING_UNITS[kind])
        doc = f"spring of {part}"
        bound = NOT_NEGATIVE if kind in ("cubic", "gap") else "> 0"
        return Parameter(f"{name}.{kind}", value, unit, doc, f"{key}.{kind}", bound=bound)

    return replace(
        spring, **{field.name: visit(number(field.name), "stiffness") for field in fields(spring)}
    )


def _motor(motor: Motor, visit: Visit) -> Motor:
    """The motor with inertia, friction, bristles and harmonics replaced by what the visitor
    returns.
    """
    part = f"motor {motor.name}, motor side"
    key = f"motor.{motor.name}"
    rotor = Parameter(
        f"{motor.name}.inertia",
        motor.inertia,
        "kg m^2",
        f"rotor of {part}",
        f"{key}.inertia",
        inertia=True,
    )
    inertia = visit(rotor)
    sums: dict[str, Any] = {
        name: _fourier_sum(getattr(motor, name), f"{motor.name}.{name}", unit, key, visit)
        for name, unit in (("cogging", "N m"), ("torque_ripple", "1"))
    }
    friction = _friction(motor.friction, motor.name, part, _angular, key, visit)
    lugre = motor.lugre
    if lugre is not None:
        from flexgen.base.spec.memory import LUGRE

        of = f"{motor.name}.lugre"
        at = f"{key}.lugre"
        units = {row.name: row.unit for row in LUGRE.keys}
        given = {
            k: Parameter(f"{of}_{k}", getattr(lugre, k), units[k], f"lugre of {part}", f"{at}.{k}")
            for k in units
        }
        lugre = replace(lugre, **{k: visit(each, f"lugre_{k}") for k, each in given.items()})
    return replace(motor, inertia=inertia, friction=friction, lugre=lugre, **sums)


# Numbers of lines that may be parameters, with their units and bounds.
_LINE_NUMBERS = {
    "stiffness": ("N/m", "> 0"),
    "length": ("m", NOT_NEGATIVE),
    "preload": ("N", ""),
    "area": ("m^2", "> 0"),
    "pressure": ("Pa", "> 0"),
    "volume": ("m^3", "> 0"),
    "exponent": ("1", "> 0"),
}


def _group_of(value: Any, group: str) -> tuple[str, ...]:
    """The group of a number of a line; none for zero: a line that is a mass only has no spring,
    and one without a damper is not given one.
    """
    return () if is_number(value) and value == 0 else (group,)


def _line(line: Line, visit: Visit) -> Line:
    """The line with its numbers replaced by what the visitor returns: stiffness and damping in the
    groups of springs where it has them, the others by their own names only.
    """
    key = f"line.{line.name}"
    doc = f"line {line.name}"
    mass = visit(Parameter(f"{line.name}.mass", line.mass, "kg", doc, f"{key}.mass", inertia=True))
    damper = Parameter(
        f"{line.name}.damping",
        line.damping,
        "N s/m",
        f"damping of {doc}",
        f"{key}.damping",
        bound=NOT_NEGATIVE,
    )
    changes = {
        "mass": mass,
        "damping": visit(damper, *_group_of(line.damping, "damping")),
    }
    for one in fields(line):
        if one.name in _LINE_NUMBERS:
            unit, bound = _LINE_NUMBERS[one.name]
            value = getattr(line, one.name)
            number = Parameter(
                f"{line.name}.{one.name}", value, unit, doc, f"{key}.{one.name}", bound=bound
            )
            groups = _group_of(value, "stiffness") if one.name == "stiffness" else ()
            changes[one.name] = visit(number, *groups)
    return replace(line, **changes)


def _fourier_sum(
    given: FourierSum | None, name: str, unit: str, key: str, visit: Visit
) -> FourierSum | None:
    """The sum ``name``, "PART.KIND", with its cosine and sine coefficients [unit] replaced by what
    the visitor returns; None without one.
    """
    if given is None:
        return None
    part, kind = name.split(".")

    def coefficients(of: str) -> tuple[Any, ...]:
        """The ``"cosine"`` or ``"sine"`` coefficients after `visit`, each named with its
        harmonic.
        """
        return tuple(
            visit(
                Parameter(
                    f"{name}_{of}_{k}", x, unit, f"{kind} of {part}", f"{key}.{kind}.{of}.{i}"
                )
            )
            for i, (k, x) in enumerate(zip(given.harmonics, getattr(given, of), strict=True))
        )

    return replace(given, cos=coefficients("cos"), sin=coefficients("sin"))


def _friction(
    friction: Friction, name: str, part: str, units: Units, key: str, visit: Visit
) -> Friction:
    """The friction with all its numbers replaced by what the visitor returns.

    Terms that are zero in the file belong to no group: they cost nothing and stay zero unless they
    are named.
    """
    return replace(
        friction,
        **{
            field.name: visit(
                Parameter(
                    f"{name}.{field.name}",
                    value,
                    units(field.metadata["unit"]),
                    f"friction of {part}",
                    f"{key}.friction.{field.name}",
                    bound="" if field.metadata["signed"] else NOT_NEGATIVE,
                ),
                *(
                    ("friction", f"{name}.friction")
                    if value != 0.0 and not field.metadata["alone"]
                    else ()
                ),
            )
            for field in fields(friction)
            for value in (getattr(friction, field.name),)
        },
    )
