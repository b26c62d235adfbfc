"""Contents of model files as JSON types, in SI units: the list of models, and one model in
full.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import FlexgenError, ModelError
from flexgen.base.spec.memory import LUGRE
from flexgen.base.spec.parts import GearFriction
from flexgen.base.spec.schema import write
from flexgen.model.elements import (
    Coordinate,
    Dof,
    Friction,
    Gear,
    Motor,
    RobotModel,
    kind_of_mode,
)
from flexgen.model.format.format import LOOP
from flexgen.model.format.format_lines import LINE
from flexgen.model.format.format_robot import (
    COGGING,
    ENCODER_ERROR,
    GEAR,
    JOINT_SPRING,
    RIPPLE,
    friction,
)
from flexgen.model.reader import model_names, read

# of a motor
TABLES = {
    "cogging": COGGING,
    "torque_ripple": RIPPLE,
    "encoder_error": ENCODER_ERROR,
    "lugre": LUGRE,
}


@checked_types
def models(broken: dict[str, str] | None = None) -> list[dict[str, Any]]:
    """List the models that can be selected by name.

    Parameters
    ----------
    broken : dict, optional
        Receives the reason for each file that is not a valid model (key ``name``) and each variant
        that cannot be read (key ``name@variant``). If it is omitted, the first such file or
        variant raises.

    Returns
    -------
    list of dict
        One dictionary per model with the keys
        ``name source n_m n_g n_e dof description variants``, sorted by name.

    Raises
    ------
    ModelError
        A file is not a valid model, and ``broken`` was not given.

    Examples
    --------
    >>> [each["name"] for each in flexgen.models()][:2]
    ['abb_arm', 'beam_arm']
    """
    rows = []
    for name in model_names():
        try:
            robot = read(name)
        except FlexgenError as error:
            if broken is None:
                raise
            broken[name] = str(error)
            continue
        wrong = _invalid_variants(robot)
        for variant, reason in wrong.items():
            if broken is None:
                raise reason
            broken[f"{name}@{variant}"] = str(reason)
        rows.append(
            {
                "name": name,
                "source": " ".join(robot.source.split()),
                **counts(robot),
                "description": robot.description,
                "variants": [variant for variant in robot.variants if variant not in wrong],
            }
        )
    return rows


def _invalid_variants(robot: RobotModel) -> dict[str, FlexgenError]:
    """Variants of a model file that cannot be read, with the error of each."""
    wrong: dict[str, FlexgenError] = {}
    for variant in robot.variants:
        try:
            read(robot.file, variant)
        except FlexgenError as error:
            if isinstance(error, ModelError):
                expected = f"{error.expected} (variant {variant})"
                error = ModelError(error.file, error.line, error.key, error.given, expected)
            wrong[variant] = error
    return wrong


def counts(robot: RobotModel) -> dict[str, int]:
    """Count motors, actuated and non-actuated arm coordinates, and degrees of freedom."""
    return {"n_m": robot.n_m, "n_g": robot.n_g, "n_e": robot.n_e, "dof": robot.dof}


@checked_types
def describe(
    model: str | Path | RobotModel,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Describe one model in full: coordinates, gears, motors, bodies, output, moves, variants.

    Parameters
    ----------
    model : name, path or RobotModel
    variant, overrides : optional
        As in `flexgen.read`.

    Returns
    -------
    dict
        The contents of the model file as JSON types, in SI units.

    Raises
    ------
    ModelError, ArgumentError
        The model or one of the variants of its file cannot be read.

    Examples
    --------
    >>> robot = flexgen.describe("elbow")
    >>> (
    ...     robot["dof"],
    ...     [motor["name"] for motor in robot["motors"]],
    ...     [move["name"] for move in robot["moves"]],
    ... )
    (4, ['m1', 'm2'], ['line', 'joints'])
    """
    if isinstance(model, RobotModel):
        robot = model
    else:
        robot = read(model, variant, overrides)
        for error in _invalid_variants(robot).values():
            raise error
    warm = any(isinstance(motor.friction, GearFriction) for motor in robot.motors)
    return {
        **_fields(robot, "name", "variant", "description"),
        "source": " ".join(robot.source.split()),
        "file": robot.file,
        **counts(robot),
        **_fields(robot, "gravity", "motor_coupling", "home", *["temperature"] * warm),
        "bodies": [
            _fields(element, "name") | _fields(element.body, "mass", "com")
            for element in robot.elements
        ],
        "coordinates": [_coordinate(c) for c in robot.coordinates],
        "motors": [_motor(robot, m) for m in robot.motors],
        "sensors": [
            _fields(
                sensor, "name", "type", "place", "channels", "unit", "noise", "sample_s", "delay_s"
            )
            for sensor in robot.sensors
        ],
        **({"loops": [write(LOOP, loop) for loop in robot.loops]} if robot.loops else {}),
        **({"lines": [write(LINE, line) for line in robot.lines]} if robot.lines else {}),
        "output": {
            **_fields(robot.output, "type", "size"),
            "axes": robot.output.axes
            if robot.output.type in ("tool_position", "tool_position_angle")
            else None,
            **(
                _fields(robot.output, "rotation_axis", "reference")
                if robot.output.has_angle
                else {}
            ),
            "weights": [list(row) for row in robot.output.weights] or None,
            "unit": {
                "combination": robot.output.unit,
                "tool_pose": "m and rad",
                "tool_position_angle": "m and rad",
            }.get(robot.output.type, "m"),
        },
        "moves": [
            {
                **_fields(move, "name", "type"),
                # None: computed from a profile, a file or steps
                "duration": move.duration or None,
                **_fields(move, "smoothness", "start"),
                "end": list(move.end) or None,
                "displacement": list(move.displacement) or None,
                "rotation": list(move.rotation) if any(move.rotation) else None,
            }
            for move in (*robot.moves, *robot.programs)
        ],
        "variants": list(robot.variants),
    }


def _fields(item: Any, *names: str) -> dict[str, Any]:
    """Attributes as JSON types."""
    values = ((name, getattr(item, name)) for name in names)
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values}


def _other_fields(item: Any, *names: str) -> dict[str, Any]:
    """All attributes of a data class but these, as JSON types: numbers that a new key of the file
    adds among them.
    """
    return _fields(item, *(field.name for field in fields(item) if field.name not in names))


def _friction(law: Friction) -> dict[str, Any] | None:
    return write(friction(), law) if law != type(law)() else None


def _gear(gear: Gear) -> dict[str, Any]:
    return write(GEAR, gear) | ({} if gear.rigid else {"damping": gear.damping})


def _coordinate(coordinate: Coordinate) -> dict[str, Any]:
    dof = coordinate.dof
    row = _fields(coordinate, "name", "unit", "actuated", "element")
    row["type"] = "beam mode" if dof is None else dof.type
    return row | ({"mode": kind_of_mode(coordinate)} if dof is None else _dof(dof))


def _dof(dof: Dof) -> dict[str, Any]:
    """A degree of freedom as JSON types, for the description of a model."""
    return {
        "axis": list(dof.axis),
        "gear": None if dof.gear is None else _gear(dof.gear),
        "spring": None if dof.spring is None else write(JOINT_SPRING, dof.spring),
        "damping": dof.damping if dof.spring is not None else None,
        "friction": _friction(dof.friction),
        **_other_fields(
            dof, "name", "type", "axis", "gear", "spring", "damping", "friction", "counterbalance"
        ),
    } | (
        {"counterbalance": [list(pair) for pair in dof.counterbalance]}
        if dof.counterbalance
        else {}
    )


def _motor(robot: RobotModel, motor: Motor) -> dict[str, Any]:
    """A motor as JSON types, with the units of its ratios, for the description of a model."""
    units = {coordinate.name: coordinate.unit for coordinate in robot.coordinates}
    return {
        **_fields(motor, "name", "drives", "ratio"),
        "ratio_unit": [f"rad/{units[name]}" for name in motor.drives],
        "inertia": motor.inertia,
        "friction": _friction(motor.friction),
        **_other_fields(
            motor, "name", "drives", "ratio", "inertia", "friction", "axis", "carrier", *TABLES
        ),
        **{
            key: None if getattr(motor, key) is None else write(form, getattr(motor, key))
            for key, form in TABLES.items()
        },
    }
