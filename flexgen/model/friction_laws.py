"""Friction laws by their ``type`` in a model file; those of other packages have a method ``torque(w)``."""

from __future__ import annotations

import sys
from pathlib import Path

from flexgen.errors import ArgumentError
from flexgen.model.elements import FRICTION_LAWS, Friction, RobotModel
from flexgen.registry import added_names, extension


def law_names() -> tuple[str, ...]:
    """The names of all laws, the default one first."""
    return (*FRICTION_LAWS, *(name for name in added_names("frictions") if name not in FRICTION_LAWS))


def friction_law(name: str) -> type[Friction]:
    """The class of a law; ArgumentError where that of another package is none."""
    law = FRICTION_LAWS.get(name) or extension("frictions", name)
    if not (isinstance(law, type) and issubclass(law, Friction)):
        raise ArgumentError(f"entry point {name} of flexgen.frictions: given {law!r}, expected a subclass of Friction")
    return law


def added_sources(model: RobotModel) -> list[Path]:
    """The files with the friction laws of other packages that a model has."""
    laws = {type(c.dof.friction) for c in model.coordinates if c.dof is not None} | {
        type(motor.friction) for motor in model.motors
    }
    laws -= set(FRICTION_LAWS.values())
    return sorted(Path(file) for law in laws if (file := getattr(sys.modules.get(law.__module__), "__file__", None)))
