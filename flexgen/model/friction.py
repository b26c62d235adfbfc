"""Friction laws: the default law, those of other packages by their ``type`` in a model file;
models with states.

The torque of a law is in `flexgen.dynamics.mechanics.force_laws`; a law of another package has a
method ``torque(w)``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, TypeVar

from flexgen.base.errors import ArgumentError
from flexgen.base.registry import extension
from flexgen.base.spec.parts import Friction as Friction
from flexgen.base.spec.parts import GearFriction as GearFriction
from flexgen.base.spec.parts import friction_key as friction_key

NO_FRICTION = Friction()
Law = TypeVar("Law")

# Value of the key ``type`` in the model file -> law. A new law is a subclass of Friction with its
# own numbers, one entry here, and its torque in `flexgen.dynamics.mechanics.force_laws`; the first
# entry is the default.
FRICTION_LAWS: dict[str, type[Friction]] = {"smooth": Friction, "gear": GearFriction}


def find_law(group: str, name: str, base: type[Law], method: str) -> type[Law]:
    """The law that another package has added under a name; ArgumentError where it is none."""
    law = extension(group, name)
    if not (isinstance(law, type) and issubclass(law, base) and hasattr(law, method)):
        what = f"given {law!r}, expected a subclass of {base.__name__} with a method {method}"
        raise ArgumentError(f"entry point {name} of flexgen.{group}: {what}")
    return law


def added_sources(model: Any) -> list[Path]:
    """The files with the laws of friction and hysteresis of a `RobotModel` that other packages
    have added.
    """
    dofs = [coordinate.dof for coordinate in model.coordinates if coordinate.dof is not None]
    found = [
        dof.gear.hysteresis
        for dof in dofs
        if dof.gear is not None and dof.gear.hysteresis is not None
    ]
    elements = (one for each in found for one in (each if isinstance(each, tuple) else (each,)))
    laws = (*(part.friction for part in (*dofs, *model.motors)), *elements)
    modules = [
        sys.modules.get(type(law).__module__)
        for law in laws
        if not type(law).__module__.startswith("flexgen.")
    ]
    return sorted(
        {Path(file) for module in modules if (file := getattr(module, "__file__", None))}
    )


def hysteretic_joints(model: Any) -> list[str]:
    """Names of the coordinates of a `RobotModel` whose gears have hysteresis."""
    dofs = (coordinate.dof for coordinate in model.coordinates)
    return [
        dof.name
        for dof in dofs
        if dof is not None and dof.gear is not None and dof.gear.hysteresis is not None
    ]


def bristled_motors(model: Any) -> list[str]:
    """Names of the motors of a `RobotModel` whose friction has a state, the table ``lugre``."""
    return [motor.name for motor in model.motors if motor.lugre is not None]


def loaded_motors(model: Any) -> list[str]:
    """Names of the motors of a `RobotModel` whose friction depends on the torques of their
    gears.
    """
    return [
        each.name
        for each in model.motors
        if isinstance(each.friction, GearFriction) and each.friction.loaded
    ]


def steepness(law: Friction) -> float:
    """Steepness of a friction at rest [s/rad or s/m]: ``beta``, or ``alpha`` where it is larger.

    Its sign changes with the speed within about 1/steepness. 0 for a law without such a part, and
    for laws of other packages without ``beta``.
    """
    if not (law.coulomb or law.stribeck or getattr(law, "load_coulomb", 0.0)):
        return 0.0
    return max(law.beta, law.alpha if law.stribeck else 0.0, getattr(law, "load_alpha", 0.0))


def refuse_load(model: Any, what: str) -> None:
    """ArgumentError for a model with such a friction: ``what`` does not take it into account."""
    if names := loaded_motors(model):
        raise ArgumentError(
            f"{what}: given {model.title}, whose motor {names[0]} has a friction that depends "
            "on the torque of its gear, expected motors without it, which only solve (within "
            "limits by lq), simulate, control, learn, predict, fastest, plan_problem, "
            "command_positions, identify, generate and exports other than that of MuJoCo take "
            "into account; set load_coulomb, load_stribeck and load_smoothing of its friction "
            "to 0"
        )


def refuse_lugre(model: Any, what: str) -> None:
    """ArgumentError for a model with such a friction: ``what`` does not take it into account."""
    if names := bristled_motors(model):
        raise ArgumentError(
            f"{what}: given {model.title}, whose motor {names[0]} has lugre, expected motors "
            "without it, which only solve, simulate, control, learn, predict, fastest, "
            "command_positions, generate and exports other than that of MuJoCo take into "
            "account; remove the table lugre"
        )


def refuse_hysteresis(model: Any, what: str) -> None:
    """ArgumentError for a model with elements that have a state: ``what`` does not take them into
    account.
    """
    refuse_lugre(model, what)
    if names := hysteretic_joints(model):
        raise ArgumentError(
            f"{what}: given {model.title}, whose gear of {names[0]} has hysteresis, expected "
            "gears without it, which only solve, simulate, control, learn, predict, fastest, "
            "command_positions, generate, identify_gears and exports other than that of MuJoCo "
            "take into account; remove the table hysteresis of the gear from the model file"
        )


def harmonic_sums(model: Any) -> dict[str, Any]:
    """All Fourier sums of motor angles in a `RobotModel`, by what has them, such as "motor m1 has
    cogging".
    """
    found: dict[str, Any] = {}
    for coordinate in model.coordinates:
        gear = None if coordinate.dof is None else coordinate.dof.gear
        if gear is not None and gear.transmission_error is not None:
            found[f"gear of {coordinate.name} has transmission_error"] = gear.transmission_error
    for motor in model.motors:
        for key in ("cogging", "torque_ripple"):
            if getattr(motor, key) is not None:
                found[f"motor {motor.name} has {key}"] = getattr(motor, key)
    return found


def has_harmonics(model: Any) -> str:
    """The first Fourier sum of a motor angle in a `RobotModel`, such as "motor m1 has cogging";
    empty: none.
    """
    return next(iter(harmonic_sums(model)), "")


def refuse_harmonics(model: Any, what: str, *, load: bool = True) -> None:
    """ArgumentError for a model with Fourier sums of a motor angle or friction with a state, which
    ``what`` ignores.

    ``load``: it also ignores that a friction depends on the torque of a gear.
    """
    if load:
        refuse_load(model, what)
    refuse_lugre(model, what)
    if found := has_harmonics(model):
        raise ArgumentError(
            f"{what}: given {model.title}, whose {found}, expected gears and motors without "
            "transmission_error, cogging and torque_ripple, which only solve, simulate, "
            "control, learn, measure, predict, fastest, command_positions, generate and "
            "exports other than that of MuJoCo take into account; remove these tables from the "
            "model file"
        )
