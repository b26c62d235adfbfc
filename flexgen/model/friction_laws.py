"""Friction laws by the value of the key ``type`` in a model file: those of flexgen, and those of other packages.

A law of another package is a subclass of `flexgen.model.elements.Friction`, a frozen dataclass with its own numbers
(`friction_key`) and a method ``torque(self, w)``: the torque [N m or N] against the CasADi expression ``w`` of the
velocity [rad/s or m/s]. It is found by an entry point of the group ``flexgen.frictions``, whose name is the ``type``.
"""

from __future__ import annotations

from flexgen.errors import ArgumentError
from flexgen.model.elements import FRICTION_LAWS, Friction
from flexgen.registry import added_names, extension


def law_names() -> tuple[str, ...]:
    """All values of ``type``, the default one first."""
    return (*FRICTION_LAWS, *(name for name in added_names("frictions") if name not in FRICTION_LAWS))


def friction_law(name: str) -> type[Friction]:
    """The class of a law; ArgumentError where that of another package is none."""
    if name in FRICTION_LAWS:
        return FRICTION_LAWS[name]
    law = extension("frictions", name)
    if not (isinstance(law, type) and issubclass(law, Friction) and hasattr(law, "torque")):
        raise ArgumentError(
            f"entry point {name} of flexgen.frictions: given {law!r}, expected a subclass of Friction with a method "
            "torque"
        )
    return law


def law_name(friction: Friction) -> str:
    """The ``type`` of a friction."""
    own = next((name for name, law in FRICTION_LAWS.items() if law is type(friction)), None)
    return own or next(name for name in added_names("frictions") if friction_law(name) is type(friction))
