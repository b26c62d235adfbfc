"""Friction laws by their ``type`` in a model file; those of other packages have a method ``torque(w)``."""

from __future__ import annotations

import sys
from pathlib import Path

from flexgen.errors import ArgumentError
from flexgen.model.elements import FRICTION_LAWS, Friction, RobotModel
from flexgen.registry import extension


def friction_law(name: str) -> type[Friction]:
    """The law that another package has added under a name; ArgumentError where it is none."""
    law = extension("frictions", name)
    if not (isinstance(law, type) and issubclass(law, Friction) and hasattr(law, "torque")):
        what = f"given {law!r}, expected a subclass of Friction with a method torque"
        raise ArgumentError(f"entry point {name} of flexgen.frictions: {what}")
    return law


def added_sources(model: RobotModel) -> list[Path]:
    """The files with the friction laws of other packages that a model has."""
    laws = [c.dof.friction for c in model.coordinates if c.dof is not None] + [m.friction for m in model.motors]
    modules = [sys.modules.get(type(law).__module__) for law in laws if type(law) not in FRICTION_LAWS.values()]
    return sorted({Path(file) for module in modules if (file := getattr(module, "__file__", None))})
