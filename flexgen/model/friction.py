"""Friction laws: the default law, those of other packages by their ``type`` in a model file;
models with states.

The torque of a law is in `flexgen.dynamics.mechanics.force_laws`; a law of another package has a
method ``torque(w)``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

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
    return [motor.name for motor in model.motors if motor.friction.loaded]


class MemoryLaw(NamedTuple):
    """A law with a state.

    ``key``: of its table in a model file. ``find``: names of the parts of a robot that have it.
    ``exponential``: its C calls the mathematical library.
    """

    key: str
    find: Callable[[Any], Sequence[str]]
    exponential: bool


LAWS = (
    MemoryLaw("hysteresis", hysteretic_joints, exponential=False),
    MemoryLaw("lugre", bristled_motors, exponential=True),
)


def memory_laws(model: Any) -> tuple[MemoryLaw, ...]:
    """The laws with a state that a robot has, in the order of `LAWS`."""
    return tuple(law for law in LAWS if law.find(model))


def steepness(law: Friction) -> float:
    """Steepness of a friction at rest [s/rad or s/m]: ``beta``, or ``alpha`` where it is larger.

    Its sign changes with the speed within about 1/steepness. 0 for a law without such a part, and
    for laws of other packages without ``beta``.
    """
    if not (law.coulomb or law.stribeck or getattr(law, "load_coulomb", 0.0)):
        return 0.0
    return max(law.beta, law.alpha if law.stribeck else 0.0, getattr(law, "load_alpha", 0.0))


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
